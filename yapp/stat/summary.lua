-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,summary: each source with its rate, gaps, losses, and the range of its values; and
-- -z yapp,compare: the values of all sources of a message beside each other.  Pure Lua, 5.2 to 5.5.
--
-- Good messages are counted and make rates, gaps and values.  Messages with a bad CRC and
-- incomplete ones are counted separately.

local groups = require "yapp.stat.groups"
local joined = require "yapp.base.joined"
local kinds = require "yapp.stat.kinds"
local output = require "yapp.stat.output"

local M = groups.class { follows_changes = true }

local unpack = rawget(table, "unpack")

-- Besides, a column may have
--   kind   the kind of event that it counts
--   value  function(group) -> its value; without both it is group[key]
--   needs_time  true if it means nothing without time stamps
--   shape  a format of its value for people
--- The columns of summary, see output.columns.
M.COLUMNS = output.columns {
  { "who" },
  { "bus" },
  { "id" },
  { "source" },
  { "message" },
  { "count", "integer", "good messages" },
  { "rate", "number", "(count - 1) / (last - first)",
    unit = "Hz", needs_time = true, value = groups.rate, shape = "%.2f" },
  { "gap_min", "seconds", "the shortest time between two messages",
    unit = "s", where = "json text", title = "gap/s min", needs_time = true },
  { "gap_mean", "seconds", "the mean",
    unit = "s", where = "json text", title = "mean", needs_time = true, value = groups.mean_gap },
  { "gap_max", "seconds", "the longest",
    unit = "s", title = "max", short = "gap/s", needs_time = true },
  { "gap_max_frame", "integer", "the message behind the longest gap",
    where = "json text", title = "in frame", needs_time = true },
  { "crc_bad", "integer", "messages with a bad CRC",
    kind = "crc", title = "bad CRC", short = "CRC" },
  { "incomplete", "integer",
    "messages without their beginning, with bytes missing, truncated or unfinished",
    kind = "incomplete", short = "lost" },
  { "late", "integer", "silences between two messages", kind = "late" },
  -- JSON has it as an event.
  { "silent", where = "text window", title = "silent/s at the end", short = "silent/s" },
  { "reboots", "integer", "how often the controller's clock went back", kind = "reboot" },
  { "values", "values", "of each field of numbers `min`, `mean` and `max`", where = "json" },
  { "invalid", "integer", "messages with a value that the catalogue does not define",
    kind = "invalid", where = "json text" },
  { "skipped", "integer", "stretches of bytes in a stream that belong to no frame",
    kind = "skipped", where = "json text" },
  { "missing", "integer", "messages missing by Seq No", kind = "missing" },
  { "copies", "integer", "messages that were recorded a second time",
    kind = "copies", where = "json text" },
}
local RANGE = output.words("min mean max")
local VALUES = output.columns {
  { "who" },
  { "bus", where = "text" },
  { "id", where = "text" },
  { "source", where = "text" },
  { "message", where = "text" },
  { "field" },
  { "unit" },
  { "min" },
  { "mean" },
  { "max" },
  { "count", where = "text" },
}

--- Return the row of a source; its values are in JSON alone.
-- is_window  true if a column that counts nothing is left out
function M.row(group, ending, is_window)
  local row, names, ranges = {}, {}, {}
  for _, column in ipairs(M.COLUMNS.all) do
    local key, value = column.name, nil
    if column.kind then
      value = group.counts[column.kind].seen
      if is_window and value == 0 then value = nil end
    elseif not (column.needs_time and ending.lacks_times) then
      value = column.value and column.value(group) or group[key]
      if column.type == "seconds" then value = output.seconds(value) end
      if value and column.shape then
        value = { value = value, text = column.shape:format(value) }
      end
    end
    row[key] = value
  end
  for i, values in ipairs(group.values) do
    local of_field = groups.row(group, values)
    names[i], ranges[of_field.field] = of_field.field, output.object(RANGE, of_field)
  end
  row.values = output.object(names, ranges)
  return output.row(group.source, row) -- its own columns
end

--- End, see stat.answer.
function M:finish(ending, notes)
  local rows, shown, context = {}, {}, self.context
  for i, group in ipairs(self:sort(not context.json)) do
    for _, values in ipairs(context.json and kinds.NOTHING or group.values) do
      local row = groups.row(group, values)
      if row.min then shown[#shown + 1] = row end
    end
    rows[i] = M.row(group, ending, context.frames and not context.json)
  end
  local sources = output.count(#rows, "source")
  local title = ("YAPP summary: %s in %.3f s"):format(sources, ending.last or 0)
  output.print(context, title, M.COLUMNS, rows, notes)
  if shown[1] then
    context.out("\n")
    output.table(context, VALUES, shown)
  end
end

-- compare -----------------------------------------------------------------------------------------

local OF_SOURCE = output.words("bus id source count min mean max")
--- The columns of compare, see output.columns.  People read a line for each field and source.
M.COMPARED = output.columns {
  { "message", where = "json" },
  { "field", "string", "the field" },
  { "unit", "string", "its unit" },
  { "who", where = "text window" },
  { "min", where = "text window" },
  { "mean", where = "text window" },
  { "max", where = "text window" },
  { "spread", "number", "the largest difference of the sources at one time" },
  { "time", "time", "when they differ by it", where = "json" },
  { "rel", where = "text" },
  { "frame" },
  { "sources", "list", "`" .. table.concat(OF_SOURCE, " ") .. "`", where = "json" },
}
local Compare = groups.class { compares = true }

--- See groups.class.
M.compare = Compare.new

-- Sort the rows of a field, the odd ones first: by how far their mean is from the median.  Return
-- how odd the first one is: its distance beside the second one's, and 1 % of its values.
local function sort_odd(rows)
  local means, distances = {}, {}
  for _, row in ipairs(rows) do means[#means + 1] = row.mean end
  if not means[3] then return 0 end
  local middle = groups.median(means)
  for _, row in ipairs(rows) do distances[row] = math.abs((row.mean or middle) - middle) end
  output.sort(rows, function(row) return -distances[row] end)
  local first = rows[1]
  local floor = distances[rows[2]] + (math.abs(middle) + first.max - first.min) / 100
  return floor > 0 and distances[first] / floor or 0
end

-- Return the rows of a field: one for each source, the odd ones first; for JSON one.  The first has
-- the spread of all.
local function rows_of(self, list, index)
  local spread, sources, rows = list[1].values[index].spread, {}, {}
  for i, group in ipairs(list) do
    rows[i] = groups.row(group, group.values[index])
    sources[i] = output.object(OF_SOURCE, rows[i])
  end
  if self.context.json then rows = { rows[1] } end
  rows.odd = sort_odd(rows)
  for i = 2, #rows do rows[i].field, rows[i].unit = nil, nil end
  local row, rel = rows[1], spread.rel
  row.spread, row.frame, row.rel = spread.worst, spread.frame, output.seconds(rel)
  row.time = rel and self.context.dates:value(rel)
  row.sources = output.list(sources)
  return rows
end

local function sortable_name(group)
  return output.sortable(output.row(group.source, {}).who)
end

-- Return the groups of each message that has several: for people by name, first the message with
-- most fields, which says most of a controller.
local function list_compared(self)
  local by_type, lists = {}, {}
  for _, group in ipairs(self:sort()) do
    local message_type = group.type
    if message_type and group.count > 0 then
      local list = by_type[message_type] or {}
      by_type[message_type], list[#list + 1] = list, group
      if #list == 2 then lists[#lists + 1] = list end
    end
  end
  if self.context.json then return lists end
  for _, list in ipairs(lists) do output.sort(list, sortable_name) end
  output.sort(lists, function(list) return -#list[1].type.fields end)
  return lists
end

--- End: print a table for each message.
function Compare:finish(_, notes)
  local context, lists = self.context, list_compared(self)
  for i, list in ipairs(lists) do
    local fields = {}
    for index in ipairs(list[1].values) do fields[index] = rows_of(self, list, index) end
    output.sort(fields, function(rows) return -rows.odd end)
    local rows = joined(unpack(fields))
    local title = ("YAPP compare: %d sources of %s"):format(#list, list[1].type.title)
    if i > 1 and not context.json then context.out("\n") end
    output.print(context, title, M.COMPARED, rows, notes)
    notes = {}
  end
  if not lists[1] then
    output.print(context, "YAPP compare: no message has several sources", M.COMPARED, {}, notes)
  end
end

return M
