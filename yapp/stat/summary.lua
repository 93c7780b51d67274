-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,summary: each source with its rate, gaps, losses, and the range of its values; and
-- -z yapp,compare: the values of all sources of a message beside each other.  Pure Lua, 5.2 to 5.5.
--
-- Good messages are counted and make rates, gaps and values; beside them stand those with a bad CRC
-- and those that are incomplete.

local groups, output = require("yapp.stat.groups"), require("yapp.stat.output")
local span = require("yapp.stat.tell").span

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

local Summary = { tells_changes = true }
Summary.__index = Summary

--- context  { out = function(text), clock = function(rel) -> seconds since 1970, nanoseconds,
--          late = function() -> periods, json, width, frames = see output.print }
function M.new(_, context)
  local gathered = groups.new(groups.numeric)
  return setmetatable({ context = context, groups = gathered }, Summary)
end

function Summary:event(event)
  self.groups:event(event)
end

function Summary:message(record)
  self.groups:message(record)
end

local function row_of(group)
  local count = group.count
  local length = count > 1 and span(group.first, group.last)
  local row = output.row(group.source, {
    count = count,
    rate = output.number(groups.rate(group)),
    gap_min = output.seconds(group.gap_min),
    gap_mean = output.seconds(length and length / (count - 1)),
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
  for i, group in ipairs(self.groups:sorted()) do
    local names, ranges = {}, {}
    for j, values in ipairs(group.values) do
      local row = groups.put(values, output.row(group.source, {}))
      names[j] = row.field
      ranges[row.field] = output.object(RANGE, row)
      if row.min then shown[#shown + 1] = row end
    end
    rows[i] = row_of(group)
    rows[i].values = output.object(names, ranges)
  end
  local sources = output.count(#rows, "source")
  local length = last and last.rel or 0
  local title = ("YAPP summary: %s in %.3f s"):format(sources, length)
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

local Compare = {}
Compare.__index = Compare

--- context  as for M.new
function M.compare(_, context)
  local gathered = groups.new(groups.numeric, groups.numeric, context.late)
  return setmetatable({ context = context, groups = gathered }, Compare)
end

function Compare:message(record)
  self.groups:message(record)
end

-- The row of a field; people see those of its sources, the first with what they have in common.
local function compared_row(self, spread, list, place, shown)
  local row, sources = {}, {}
  for i, group in ipairs(list) do
    local one = groups.put(group.values[place], output.row(group.source, {}))
    sources[i] = output.object(OF_SOURCE, one)
    row.message = group.message.name
    row.field, row.unit = one.field, one.unit
    one.source = output.who(group.source)
    if i == 1 then
      one.spread = output.number(spread.worst)
      one.frame = spread.frame
      one.rel = output.seconds(spread.rel)
      row.spread, row.frame = one.spread, one.frame
    else
      one.field, one.unit = nil, nil
    end
    shown[#shown + 1] = one
  end
  row.time = spread.rel and output.time(self.context.clock(spread.rel))
  row.sources = output.list(sources)
  return row
end

-- The sources by message, and the messages that have several, in order.
local function compared(self)
  local lists, messages = {}, {}
  for _, group in ipairs(self.groups:sorted()) do
    local message = group.message
    if message then
      local list = lists[message] or {}
      lists[message], list[#list + 1] = list, group
      if #list == 2 then
        messages[#messages + 1] = message
      end
    end
  end
  return lists, messages
end

function Compare:finish()
  local context = self.context
  local lists, messages = compared(self)
  for i, message in ipairs(messages) do
    if i > 1 and not context.json then context.out("\n") end
    local list, rows, shown = lists[message], {}, {}
    for place, spread in ipairs(self.groups.spreads[message]) do
      rows[place] = compared_row(self, spread, list, place, shown)
    end
    local title = ("YAPP compare: %d sources of %s"):format(#list, message.title)
    if context.json then
      output.print(context, title, COMPARED, rows)
    else
      output.print(context, title, SHOWN, shown)
    end
  end
  if not (messages[1] or context.json) then
    context.out("YAPP compare: no message has several sources\n")
  end
end

return M
