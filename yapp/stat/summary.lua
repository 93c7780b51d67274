-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,summary: each source with its rate, gaps, losses, and the range of its values; and
-- -z yapp,compare: the values of all sources of a message beside each other.  Pure Lua, 5.2 to 5.5.
--
-- Good messages are counted and make rates, gaps and values.  Messages with a bad CRC and
-- incomplete ones are counted separately.

local groups = require "yapp.stat.groups"
local output = require "yapp.stat.output"

local M = {}

local words = output.words

-- The columns, a row each: { key in JSON,
--   type   "integer", "number", "seconds", "string" or "values" (an object by field)
--   unit   of a number
--   kind   the kind of event that it counts
--   where  it is shown, one after the other: "json", "text" and "window" }
-- A new column is a row here; fields.json has all of them, and yapp-tables follows.
local COLUMNS = {
  { "who", where = "window" },
  { "bus", type = "string", where = "json text" },
  { "id", type = "integer", where = "json text" },
  { "source", type = "string", where = "json text" },
  { "message", type = "string", where = "json text window" },
  { "count", type = "integer", where = "json text window" },
  { "rate", type = "number", unit = "Hz", where = "json text window" },
  { "gap_min", type = "seconds", unit = "s", where = "json text" },
  { "gap_mean", type = "seconds", unit = "s", where = "json text" },
  { "gap_max", type = "seconds", unit = "s", where = "json text window" },
  { "gap_max_frame", type = "integer", where = "json text" },
  { "crc_bad", type = "integer", kind = "crc", where = "json text window" },
  { "incomplete", type = "integer", kind = "incomplete", where = "json text window" },
  { "late", type = "integer", kind = "late", where = "json text window" },
  { "reboots", type = "integer", kind = "reboot", where = "json text" },
  { "values", type = "values", where = "json" },
  { "invalid", type = "integer", kind = "invalid", where = "json text" },
  { "skipped", type = "integer", kind = "skipped", where = "json text" },
  { "missing", type = "integer", kind = "missing", where = "json text" },
  { "copies", type = "integer", kind = "copies", where = "json text" },
}
local KEYS = output.keys(COLUMNS)

--- The columns of its JSON, as fields.json has them.
function M.describe()
  local list = {}
  for _, column in ipairs(COLUMNS) do
    if column.type then
      list[#list + 1] = output.object(words("name type unit title"), {
        name = column[1],
        type = column.type,
        unit = column.unit,
        title = output.title(column[1]),
      })
    end
  end
  return output.list(list)
end

local RANGE = words("min mean max")
local VALUES = {
  text = words("bus id source message field unit min mean max count"),
  window = words("who field unit min mean max"),
}

local Summary = groups.class { follows_changes = true }

--- See groups.class.
M.new = Summary.new

local function row_of(group, ending)
  local row = output.row(group.source, { count = group.count })
  if not ending.lacks_times then
    local rate, gap_mean = groups.pace(group)
    row.rate, row.gap_mean = rate, output.seconds(gap_mean)
    row.gap_min, row.gap_max = output.seconds(group.gap_min), output.seconds(group.gap_max)
    row.gap_max_frame = group.gap_max_frame
  end
  for _, column in ipairs(COLUMNS) do
    if column.kind then row[column[1]] = group.counts[column.kind].seen end
  end
  return row
end

--- End, see stat.derive.
function Summary:finish(ending, notes)
  local rows, shown, context = {}, {}, self.context
  for i, group in ipairs(self:sorted()) do
    local names, ranges = {}, {}
    for j, values in ipairs(group.values) do
      local row = groups.row(group, values)
      names[j], ranges[row.field] = row.field, output.object(RANGE, row)
      if row.min then shown[#shown + 1] = row end
    end
    rows[i] = row_of(group, ending)
    rows[i].values = output.object(names, ranges)
  end
  local sources = output.count(#rows, "source")
  local title = ("YAPP summary: %s in %.3f s"):format(sources, ending.rel or 0)
  output.print(context, title, KEYS, rows, notes)
  if shown[1] and not context.json then
    context.out("\n")
    output.table(context, VALUES, shown)
  end
end

-- compare -----------------------------------------------------------------------------------------

local OF_SOURCE = words("bus id source count min mean max")
local COMPARED = {
  json = words("message field unit spread time frame sources"),
  text = words("field unit who min mean max spread rel frame"), -- a line for each field and source
  window = words("field unit who min max spread"), -- the mean is in the window of Summary
}

local Compare = groups.class { compares = true, wants_messages_only = true }

--- See groups.class.
M.compare = Compare.new

-- Append the rows of a field: one for each source, the first with the spread of all and with what
-- JSON has, which is all that is needed there.
local function add_rows(self, list, index, rows)
  local spread, sources, first = list[1].values[index].spread, {}, #rows + 1
  for i, group in ipairs(list) do
    local row = groups.row(group, group.values[index])
    sources[i] = output.object(OF_SOURCE, row)
    if i > 1 then row.field, row.unit = nil, nil end
    if i == 1 or not self.context.json then rows[#rows + 1] = row end
  end
  local row, rel = rows[first], spread.rel
  row.spread, row.frame, row.rel = spread.worst, spread.frame, output.seconds(rel)
  row.time = rel and output.time(self.context.clock(rel))
  row.sources = output.list(sources)
end

-- Return the groups of each message that has several, in the order in which their second groups
-- come.
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

--- End: print a table for each message.
function Compare:finish(_, notes)
  local context, lists = self.context, compared(self)
  for i, list in ipairs(lists) do
    local rows = {}
    for index in ipairs(list[1].values) do add_rows(self, list, index, rows) end
    local title = ("YAPP compare: %d sources of %s"):format(#list, list[1].message.title)
    if i > 1 and not context.json then context.out("\n") end
    output.print(context, title, COMPARED, rows, notes)
    notes = {}
  end
  if not lists[1] then
    output.print(context, "YAPP compare: no message has several sources", COMPARED, {}, notes)
  end
end

return M
