-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,summary: each source with its rate, gaps, losses, and the range of its values; and
-- -z yapp,compare: the values of all sources of a message beside each other.  Pure Lua, 5.2 to 5.5.
--
-- Good messages are counted and make rates, gaps and values; beside them stand those with a bad CRC
-- and those that are incomplete.

local groups, output = require("yapp.stat.groups"), require("yapp.stat.output")

local M = {}

local words = output.words
local KEYS = words("bus id source message count rate gap_min gap_mean gap_max gap_max_frame " ..
  "crc_bad incomplete late reboots values invalid skipped")
-- The kinds of events that are counted, by key.
local COUNTS = {
  crc_bad = "crc",
  incomplete = "incomplete",
  late = "late",
  reboots = "reboot",
  invalid = "invalid",
  skipped = "skipped",
}
local RANGE = words("min mean max")
local VALUES = words("bus id source message field unit min mean max count")

local Summary = groups.class { tells_changes = true }

--- See groups.class.
M.new = Summary.new

local function row_of(group)
  local rate, gap_mean = groups.pace(group)
  local row = output.row(group.source, {
    count = group.count,
    rate = rate,
    gap_min = output.seconds(group.gap_min),
    gap_mean = output.seconds(gap_mean),
    gap_max = output.seconds(group.gap_max),
    gap_max_frame = group.gap_max_frame,
  })
  for key, kind in pairs(COUNTS) do
    row[key] = groups.seen(group, kind)
  end
  return row
end

--- last  { rel = } of the last packet of any kind; nil where there was none
function Summary:finish(last)
  local rows, shown, context = {}, {}, self.context
  for i, group in ipairs(self:sorted()) do
    local names, ranges = {}, {}
    for j, values in ipairs(group.values) do
      local row = groups.row(group, values)
      names[j], ranges[row.field] = row.field, output.object(RANGE, row)
      if row.min then shown[#shown + 1] = row end
    end
    rows[i] = row_of(group)
    rows[i].values = output.object(names, ranges)
  end
  local sources = output.count(#rows, "source")
  local title = ("YAPP summary: %s in %.3f s"):format(sources, last and last.rel or 0)
  output.print(context, title, KEYS, rows)
  if shown[1] and not context.json then
    context.out("\n" .. output.table(VALUES, shown, context.width))
  end
end

-- compare -----------------------------------------------------------------------------------------

local COMPARED = words("message field unit spread time frame sources")
local OF_SOURCE = words("bus id source count min mean max")
-- For people: a line for each field and source.
local SHOWN = words("field unit source min mean max spread rel frame")

-- Of no event, so that records need not wait for their packets, see stat.feed.
local Compare = groups.class { compares = true, event = false }

--- See groups.class.
M.compare = Compare.new

-- The row of a field; people see those of its sources, the first with what they have in common.
local function compared_row(self, list, place, shown)
  local spread, sources, first = list[1].values[place].spread, {}, #shown + 1
  for i, group in ipairs(list) do
    local row = groups.row(group, group.values[place])
    sources[i] = output.object(OF_SOURCE, row)
    row.source = output.who(group.source)
    if i > 1 then row.field, row.unit = nil, nil end
    shown[#shown + 1] = row
  end
  local row = shown[first]
  row.spread, row.frame, row.rel = spread.worst, spread.frame, output.seconds(spread.rel)
  return {
    message = list[1].message.name,
    field = row.field,
    unit = row.unit,
    spread = spread.worst,
    time = spread.rel and output.time(self.context.clock(spread.rel)),
    frame = spread.frame,
    sources = output.list(sources),
  }
end

-- The groups of each message that has several, in the order of the second ones.
local function compared(self)
  local by_message, lists = {}, {}
  for _, group in ipairs(self:sorted()) do
    local message = group.message
    if message then
      local list = by_message[message] or {}
      by_message[message], list[#list + 1] = list, group
      if #list == 2 then lists[#lists + 1] = list end
    end
  end
  return lists
end

--- Prints a table for each message.
function Compare:finish()
  local context, lists = self.context, compared(self)
  for i, list in ipairs(lists) do
    local rows, shown = {}, {}
    for place in ipairs(list[1].values) do
      rows[place] = compared_row(self, list, place, shown)
    end
    local title = ("YAPP compare: %d sources of %s"):format(#list, list[1].message.title)
    if context.json then
      output.print(context, title, COMPARED, rows)
    else
      if i > 1 then context.out("\n") end
      output.print(context, title, SHOWN, shown)
    end
  end
  if not (lists[1] or context.json) then
    context.out("YAPP compare: no message has several sources\n")
  end
end

return M
