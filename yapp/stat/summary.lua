-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,summary: each source with its rate, gaps, losses, and the range of its values; and
-- -z yapp,compare: the values of all sources of a message beside each other.  Pure Lua, 5.2 to 5.5.
--
-- Good messages are counted and make rates, gaps and values; beside them stand those with a bad CRC
-- and those that are incomplete.

local groups, output = require("yapp.stat.groups"), require("yapp.stat.output")
local span = require("yapp.stat.tell").span

local M = {}

local KEYS = {
  "bus", "id", "source", "message", "count", "rate", "gap_min", "gap_mean", "gap_max",
  "gap_max_frame", "crc_bad", "incomplete", "late", "reboots", "values", "invalid", "skipped",
}
-- The kinds of events that are counted, by key.
local COUNTS = {
  crc_bad = "crc", incomplete = "incomplete", late = "late", reboots = "reboot",
  invalid = "invalid", skipped = "skipped",
}
local RANGE = { "min", "mean", "max" }
local VALUES = {
  "bus", "id", "source", "message", "field", "unit", "min", "mean", "max", "count",
}

local Summary = { tells_changes = true }
Summary.__index = Summary

--- context  { out = function(text), clock = function(rel) -> seconds since 1970, nanoseconds,
--          late = function() -> periods, json, width, frames = see output.print }
function M.new(_, context)
  return setmetatable({ context = context, groups = groups.new(groups.numeric) }, Summary)
end

function Summary:event(event) self.groups:event(event) end

function Summary:message(record) self.groups:message(record) end

-- Rows of a source's values; and the same as JSON.
local function ranges_of(group)
  local rows, names, ranges = {}, {}, {}
  for i, values in ipairs(group.values) do
    local field = values.field
    local row = values:put(output.row(group.source, { field = field.name, unit = field.unit }))
    names[i], ranges[field.name] = field.name, output.raw(output.object(RANGE, row))
    if values.count > 0 then rows[#rows + 1] = row end
  end
  return rows, output.raw(output.object(names, ranges))
end

local function row_of(group)
  local is_gap = group.count > 1
  local row = output.row(group.source, {
    count = group.count,
    rate = output.number(groups.rate(group)),
    gap_min = output.seconds(group.gap_min),
    gap_mean = output.seconds(is_gap and span(group.first, group.last) / (group.count - 1)),
    gap_max = output.seconds(group.gap_max),
    gap_max_frame = group.gap_max_frame,
  })
  for key, kind in pairs(COUNTS) do row[key] = groups.seen(group, kind) end
  return row
end

--- last  { rel = } of the last packet of any kind; nil where there was none
function Summary:finish(last)
  local rows, values, context = {}, {}, self.context
  for i, group in ipairs(self.groups:sorted()) do
    local ranges
    rows[i] = row_of(group)
    ranges, rows[i].values = ranges_of(group)
    for _, row in ipairs(ranges) do values[#values + 1] = row end
  end
  local title = ("YAPP summary: %s in %.3f s"):format(output.count(#rows, "source"),
    last and last.rel or 0)
  output.print(context, title, KEYS, rows)
  if values[1] and not context.json then
    context.out("\n" .. output.table(VALUES, values, context.width))
  end
end

-- compare -----------------------------------------------------------------------------------------

local COMPARED = { "message", "field", "unit", "spread", "time", "frame", "sources" }
local OF_SOURCE = { "bus", "id", "source", "count", "min", "mean", "max" }
-- For people: a line for each field and source.
local SHOWN = { "field", "unit", "source", "min", "mean", "max", "spread", "rel", "frame" }

local Compare = {}
Compare.__index = Compare

--- context  as for M.new
function M.compare(_, context)
  return setmetatable({ context = context, groups = groups.new(groups.numeric),
    spreads = {} }, Compare) -- by message: a list, as its values are
end

function Compare:message(record)
  local message, raws = self.groups:message(record)
  if not message then return end
  local spreads = self.spreads[message]
  if not spreads then
    spreads = {}
    for i, values in ipairs(groups.numeric(message)) do
      spreads[i] = groups.spread(message, values.field, self.context.late)
    end
    self.spreads[message] = spreads
  end
  for _, spread in ipairs(spreads) do spread:note(record, raws) end
end

-- The row of a field, and those of its sources for people.
local function compared_rows(self, message, list, place)
  local spread, sources, shown = self.spreads[message][place], {}, {}
  local row = { message = message.name, field = spread.field.name, unit = spread.field.unit,
    spread = output.number(spread.worst), frame = spread.frame, rel = output.seconds(spread.rel),
    time = spread.rel and output.time(self.context.clock(spread.rel)) }
  for i, group in ipairs(list) do
    local of_source = group.values[place]:put(output.row(group.source, {}))
    sources[i] = output.object(OF_SOURCE, of_source)
    of_source.source = output.who(group.source)
    shown[i] = of_source
  end
  row.sources = output.raw("[" .. table.concat(sources, ",") .. "]")
  for _, key in ipairs { "field", "unit", "spread", "rel", "frame" } do
    shown[1][key] = row[key] -- once
  end
  return row, shown
end

-- The sources of each message that has several: { message = list of groups }, and those messages.
local function compared(self)
  local lists, messages = {}, {}
  for _, group in ipairs(self.groups:sorted()) do
    local message = group.message
    if self.spreads[message] then
      lists[message] = lists[message] or {}
      table.insert(lists[message], group)
      if #lists[message] == 2 then messages[#messages + 1] = message end
    end
  end
  return lists, messages
end

function Compare:finish()
  local context, lists, messages = self.context, compared(self)
  for _, message in ipairs(messages) do
    local list, rows, all_shown = lists[message], {}, {}
    for place in ipairs(self.spreads[message]) do
      local shown
      rows[place], shown = compared_rows(self, message, list, place)
      for _, one in ipairs(shown) do all_shown[#all_shown + 1] = one end
    end
    local title = ("YAPP compare: %d sources of %s"):format(#list, message.title)
    if context.json then
      output.print(context, title, COMPARED, rows)
    else
      output.print(context, title, SHOWN, all_shown)
    end
  end
  if not (messages[1] or context.json) then
    context.out("YAPP compare: no message has several sources\n")
  end
end

return M
