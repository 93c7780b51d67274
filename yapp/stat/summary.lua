-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,summary: each source with its rate, gaps, losses, and the range of its values; and
-- -z yapp,compare: the values of all sources of a message beside each other.  Pure Lua, 5.2 to 5.5.
--
-- Good messages are counted and make rates, gaps and values.  Messages with a bad CRC and
-- incomplete ones are counted separately.

local groups = require "yapp.stat.groups"
local memo = require "yapp.base.memo"
local output = require "yapp.stat.output"

local M = groups.class { follows_changes = true }

local insert = table.insert

local function shown_rate(group)
  local rate = groups.rate(group)
  return rate and { value = rate, text = ("%.2f"):format(rate) }
end

local function count_late(group)
  return group.counts.silence.seen - (group.silent and 1 or 0)
end

-- Besides, a column may have
--   kind   the kind of event that it counts
--   value  function(group) -> its value; without both it is group[key]
--   needs_time  true if it means nothing without time stamps
--- The columns of summary, see output.columns.
M.COLUMNS = output.columns({
  "bus id source message",
  { "count", "integer", "good messages" },
  {
    "rate",
    "number",
    "(count - 1) / (last - first)",
    unit = "Hz",
    needs_time = true,
    value = shown_rate,
  },
  {
    "gap_min",
    "seconds",
    "the shortest time between two messages",
    unit = "s",
    title = "gap/s min",
    needs_time = true,
  },
  {
    "gap_mean",
    "seconds",
    "the mean",
    unit = "s",
    title = "mean",
    needs_time = true,
    value = groups.mean_gap,
  },
  {
    "gap_max",
    "seconds",
    "the longest",
    unit = "s",
    title = "max",
    short = "gap/s",
    needs_time = true,
  },
  {
    "gap_max_frame",
    "integer",
    "the message behind the longest gap",
    title = "in frame",
    needs_time = true,
  },
  {
    "crc_bad",
    "integer",
    "messages with a bad CRC",
    kind = "crc",
    title = "bad CRC",
    short = "CRC",
  },
  {
    "incomplete",
    "integer",
    "messages without their beginning, with bytes missing, truncated or unfinished",
    kind = "incomplete",
    short = "lost",
  },
  { "late", "integer", "silences between two messages", value = count_late },
  { "silent", title = "silent/s at the end", short = "silent/s" }, -- JSON has it as an event
  { "reboots", "integer", "how often the controller's clock went back", kind = "reboot" },
  { "values", "values", "of each field of numbers `min`, `mean` and `max`" },
  {
    "invalid",
    "integer",
    "messages with a value that the catalogue does not define",
    kind = "invalid",
  },
  {
    "skipped",
    "integer",
    "stretches of bytes in a stream that belong to no frame",
    kind = "skipped",
  },
  { "missing", "integer", "messages missing by Seq No", kind = "missing" },
  { "copies", "integer", "messages that were recorded a second time", kind = "copies" },
}, "bus id source message count rate gap_min gap_mean gap_max gap_max_frame crc_bad incomplete " ..
  "late silent reboots invalid skipped missing copies",
  "who message count rate gap_max crc_bad incomplete late silent reboots missing")
local VALUES = output.columns({}, "bus id source message field unit min mean max count",
  "who field unit min mean max")

--- Return the row of a source; its values are in JSON alone.
-- is_window  true if a column that counts nothing is left out
function M.row(group, ending, is_window)
  local row, names, ranges = {}, {}, {}
  for _, column in ipairs(M.COLUMNS.all) do
    local value = nil
    if column.kind then
      value = group.counts[column.kind].seen
    elseif not (column.needs_time and ending.lacks_times) then
      value = column.value and column.value(group) or group[column.name]
    end
    if column.type == "seconds" then value = output.seconds(value) end
    if value ~= 0 or not is_window then row[column.name] = value end
  end
  for i, values in ipairs(group.values) do
    local range = groups.row(group, values)
    names[i], ranges[range.field] = range.field, output.object("min mean max", range)
  end
  row.values = output.object(names, ranges)
  return output.row(group.source, row)
end

--- End, see stat.answer.
function M:finish(ending, notes)
  local rows, shown, context = {}, {}, self.context
  for i, group in ipairs(self:sort(not context.json)) do
    rows[i] = M.row(group, ending, context.frames and not context.json)
    for _, values in ipairs(group.values) do
      if values.count > 0 then insert(shown, groups.row(group, values)) end
    end
  end
  local title = ("YAPP summary: %s in %.3f s"):format(output.count(#rows, "source"),
    ending.length)
  output.print(context, title, M.COLUMNS, rows, notes)
  if shown[1] and not context.json then
    context.out("\n")
    output.table(context, VALUES, shown)
  end
end

-- compare -----------------------------------------------------------------------------------------

local OF_SOURCE = "bus id source count min mean max"
--- The columns of compare, see output.columns.  People read a line for each field and source.
M.COMPARED = output.columns({
  "message",
  { "field", "string", "the field" },
  { "unit", "string", "its unit" },
  { "spread", "number", "the largest difference of the sources at one time" },
  { "time", "time", "when they differ by it" },
  "frame",
  { "sources", "list", "`" .. OF_SOURCE .. "`" },
}, "field unit who min mean max spread rel frame", "field unit who min mean max spread")
local Compare = groups.class { compares = true }

--- See groups.class.
M.compare = Compare.new

-- Return the rows of a field, one for each source, the odd ones first: by how far their mean is
-- from the median.  The first has the spread of all.  odd = how odd that one is: its distance
-- beside the second one's, and 1 % of its values.
local function rows_of(self, list, index)
  local spread, rows, means = list[1].values[index].spread, {}, {}
  local function mean_of(row) return row.mean and row.mean.value end
  for i, group in ipairs(list) do
    rows[i] = groups.row(group, group.values[index])
    insert(means, mean_of(rows[i]))
  end
  local sources = output.objects(OF_SOURCE, rows)
  if means[3] then
    local middle = groups.median(means)
    local function distance(row)
      local mean = mean_of(row)
      return mean and math.abs(mean - middle) or -1 -- a source without a value is last
    end
    output.sort(rows, function(row) return -distance(row) end)
    local oddest = rows[1]
    local range = math.abs(middle) + oddest.max.value - oddest.min.value
    local floor = distance(rows[2]) + range / 100
    rows.odd = floor > 0 and distance(oddest) / floor
  end
  for i = 2, #rows do rows[i].field, rows[i].unit = nil, nil end
  local row, rel = rows[1], spread.rel
  row.spread, row.frame, row.rel = spread.worst, spread.frame, output.seconds(rel)
  row.time, row.sources = rel and self.context.dates:value(rel), sources
  return rows
end

-- Print the table of a message's sources: for people the oddest field first, for JSON a line for
-- each field.
local function print_compared(self, list, notes)
  local fields, rows, is_json = {}, {}, self.context.json
  for index in ipairs(list[1].values) do fields[index] = rows_of(self, list, index) end
  if not is_json then output.sort(fields, function(field) return -(field.odd or 0) end) end
  for _, field in ipairs(fields) do
    for i = 1, is_json and 1 or #field do insert(rows, field[i]) end
  end
  local title = ("YAPP compare: %d sources of %s"):format(#list, list[1].type.title)
  output.print(self.context, title, M.COMPARED, rows, notes)
end

--- End: print a table for each message that has several sources.
function Compare:finish(_, notes)
  local context, lists, count = self.context, {}, 0
  local by_type = memo(function() return {} end, lists)
  for _, group in ipairs(self:sort()) do
    if group.type and group.count > 0 then insert(by_type[group.type], group) end
  end
  for _, list in ipairs(lists) do
    if list[2] then
      count = count + 1
      if count > 1 and not context.json then context.out("\n") end
      print_compared(self, list, count == 1 and notes or {})
    end
  end
  if count == 0 then
    output.print(context, "YAPP compare: no message has several sources", M.COMPARED, {}, notes)
  end
end

return M
