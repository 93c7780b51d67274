-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,summary: each source with its rate, gaps, losses, and the range of its values; and
-- -z yapp,compare: the values of all sources of a message beside each other.  Pure Lua, 5.2 to 5.5.
--
-- Good messages are counted and make rates, gaps and values; beside them stand those with a bad CRC
-- and those that are incomplete.

local groups, output = require("yapp.stat.groups"), require("yapp.stat.output")
local span = require("yapp.stat.tell").span

local M = {}

local RANGE = { "min", "mean", "max" }
-- The kinds of events that are counted: JSON key, kind, title.
local COUNTS = {
  { "crc_bad", "crc", ">bad CRC" }, { "incomplete", "incomplete", ">incomplete" },
  { "late", "late", ">late" }, { "reboots", "reboot", ">reboots" },
  { "invalid", "invalid", ">invalid" }, { "skipped", "skipped", ">skipped" },
}
local KEYS = {
  "bus", "id", "source", "message", "count", "rate", "gap_min", "gap_mean", "gap_max",
  "gap_max_frame", "crc_bad", "incomplete", "late", "reboots", "values", "invalid", "skipped",
}
local TITLES = {
  "bus", "ID", "source", "message", ">count", ">rate/Hz", ">gap/ms min", ">mean", ">max",
  ">in frame",
}
for _, row in ipairs(COUNTS) do TITLES[#TITLES + 1] = row[3] end
local SPARE = { "gap/ms min", "mean", "reboots", "late", "skipped", "bus", "message", "invalid" }

local Summary = { tells_changes = true }
Summary.__index = Summary

--- options  { json = boolean }
-- context  { out = function(text), clock = function(rel) -> seconds since 1970, nanoseconds,
--          late = function() -> periods, width = of a line or nil }
function M.new(options, context)
  local self = { options = options, context = context, groups = groups.new(groups.numeric) }
  function self.event(_, event) self.groups:event(event) end
  function self.message(_, record) self.groups:message(record) end
  return setmetatable(self, Summary)
end

local function gap_mean(group)
  return group.count > 1 and span(group.first, group.last) / (group.count - 1) or nil
end

local function ranges_json(group)
  local names, values = {}, {}
  for i, row in ipairs(group.values) do
    names[i], values[row.field.name] = row.field.name, output.raw(output.object(RANGE, row))
  end
  return output.raw(output.object(names, values))
end

local function line(group)
  local values = {
    rate = groups.rate(group), gap_min = output.seconds(group.gap_min),
    gap_mean = output.seconds(gap_mean(group)), gap_max = output.seconds(group.gap_max),
    values = ranges_json(group),
  }
  for _, count in ipairs(COUNTS) do values[count[1]] = groups.seen(group, count[2]) end
  return output.line(KEYS, group.source, values, group)
end

local function milliseconds(seconds)
  return seconds and ("%.3f"):format(seconds * 1000) or false
end

local function source_table(list, width)
  local rows = {}
  for i, group in ipairs(list) do
    local rate = groups.rate(group)
    local row = { output.source_cells(group.source, group.count, rate and ("%.3f"):format(rate),
      milliseconds(group.gap_min), milliseconds(gap_mean(group)), milliseconds(group.gap_max),
      group.gap_max_frame) }
    for j, count in ipairs(COUNTS) do row[10 + j] = groups.seen(group, count[2]) end
    rows[i] = row
  end
  return output.table(TITLES, rows, width, SPARE)
end

local function value_table(list, width)
  local rows = {}
  for _, group in ipairs(list) do
    for _, value in ipairs(group.values) do
      if value.count > 0 then
        rows[#rows + 1] = { output.source_cells(group.source, value.field.name, value.field.unit,
          output.number(value.min), output.number(value.mean), output.number(value.max),
          value.count) }
      end
    end
  end
  return rows[1] and "\n" .. output.table({ "bus", "ID", "source", "message", "field", "unit",
    ">min", ">mean", ">max", ">values" }, rows, width, { "values", "bus", "message" }) or ""
end

--- last  { rel = } of the last packet of any kind; nil where there was none
function Summary:finish(last)
  local list, out = self.groups:sorted(), self.context.out
  if self.options.json then
    for _, group in ipairs(list) do out(line(group)) end
    return
  end
  local count = output.count(#list, "source")
  out(("YAPP summary: %s in %.3f s\n"):format(count, last and last.rel or 0))
  if not list[1] then return end
  out("\n" .. source_table(list, self.context.width) .. value_table(list, self.context.width))
end

-- compare -----------------------------------------------------------------------------------------

local COMPARED = { "message", "field", "unit", "spread", "time", "frame", "sources" }
local OF_SOURCE = { "bus", "id", "source", "count", "min", "mean", "max" }

local Compare = {}
Compare.__index = Compare

--- options, context  as for M.new
function M.compare(options, context)
  return setmetatable({ options = options, context = context, spreads = {},
    groups = groups.new(groups.numeric) }, Compare)
end

function Compare:message(record)
  local group, raws = self.groups:message(record)
  if not raws then return end
  local spreads = self.spreads[group.message]
  if not spreads then
    spreads = {}
    for i, row in ipairs(group.values) do
      spreads[i] = groups.spread(group.message, row.field, self.context.late)
    end
    self.spreads[group.message] = spreads
  end
  for _, spread in ipairs(spreads) do spread:note(record, raws) end
end

local function compared_line(message, spread, list, place, clock)
  local sources = {}
  for i, group in ipairs(list) do
    local line_of = output.line(OF_SOURCE, group.source, {}, group.values[place])
    sources[i] = output.raw(line_of:sub(1, -2))
  end
  local time = spread.rel and output.raw(output.time_text(clock(spread.rel)))
  return output.object(COMPARED, { message = message.name, field = spread.field.name,
    unit = spread.field.unit, spread = spread.worst, time = time, frame = spread.frame,
    sources = output.raw(output.list(sources)) }) .. "\n"
end

-- A row for each field and source; how far they lie apart stands in a field's first row.
local function compared_table(spreads, list, width)
  local rows = {}
  for i, spread in ipairs(spreads) do
    for j, group in ipairs(list) do
      local value, bus, id, name = group.values[i], output.source_cells(group.source)
      local row = { false, false, name or bus and bus .. " " .. id or id }
      row[4], row[5], row[6] = output.number(value.min), output.number(value.mean),
        output.number(value.max)
      if j == 1 then
        row[1], row[2], row[7] = spread.field.name, spread.field.unit, output.number(spread.worst)
        row[8], row[9] = output.span(spread.rel), spread.frame
      end
      rows[#rows + 1] = row
    end
  end
  return output.table({ "field", "unit", "source", ">min", ">mean", ">max", ">spread",
    ">since start/s", ">frame" }, rows, width, { "since start/s", "unit" })
end

-- The messages with several sources: a list of { message, list of groups }.
local function compared(self)
  local lists, found = {}, {}
  for _, group in ipairs(self.groups:sorted()) do
    local message = group.message
    if self.spreads[message] then
      lists[message] = lists[message] or {}
      table.insert(lists[message], group)
      if #lists[message] == 2 then found[#found + 1] = { message, lists[message] } end
    end
  end
  return found
end

function Compare:finish()
  local context, found, texts = self.context, compared(self), {}
  for i, row in ipairs(found) do
    local message, list = row[1], row[2]
    local spreads = self.spreads[message]
    for j, spread in ipairs(self.options.json and spreads or {}) do
      context.out(compared_line(message, spread, list, j, context.clock))
    end
    texts[i] = ("YAPP compare: %d sources of %s\n\n"):format(#list, message.title) ..
      compared_table(spreads, list, context.width)
  end
  if self.options.json then return end
  context.out(found[1] and table.concat(texts, "\n") or
    "YAPP compare: no message has several sources\n")
end

return M
