-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,summary: each source with its rate, gaps, losses, and the range of its values.  Pure Lua, 5.2 and 5.4.
--
-- Good messages are counted and make rates, gaps and values; beside them stand those with a bad CRC and those that are
-- incomplete.

local json, text = require("yapp.stat.json"), require("yapp.stat.text")
local groups = require("yapp.stat.groups")

local M = {}

local KEYS = { "bus", "id", "source", "message", "count", "rate", "gap_min", "gap_mean", "gap_max", "gap_max_frame",
  "crc_bad", "incomplete", "late", "reboots", "values" }
local RANGE = { "min", "mean", "max" }

local Summary = {}
Summary.__index = Summary

-- The kinds of fields whose values can be averaged, where they are no codes.
local NUMERIC = { uint = true, int = true, float = true, ieee = true }
local LARGEST = 1.7976931348623157e308 -- what is above it, or is not a number, is no value

-- A value grows evenly with the raw number that was sent: so these are gathered, within low and high, and the values
-- made at the end.
local function numeric(message)
  local fields = {}
  for i, field in ipairs(message and message.fields or {}) do
    if NUMERIC[field.kind] and not field.values then
      local is_float = field.kind == "float" -- compressed: its reserved counts are above the ordinary ones, or below 0
      fields[#fields + 1] = { index = i, field = field, count = 0, sum = 0.0, low = is_float and 0 or -LARGEST,
        high = is_float and field.ordinary or LARGEST }
    end
  end
  return fields
end

--- options  { json = boolean }
-- context  { out = function(text), decode = module }
function M.new(options, context)
  return setmetatable({ options = options, context = context, tells_changes = true, groups = groups.new(function(source)
    return { count = 0, crc_bad = 0, incomplete = 0, late = 0, reboots = 0, fields = numeric(source.message) }
  end) }, Summary)
end

local function note_gap(group, record)
  local gap = group.last and groups.span(group.last, record.rel)
  if not gap then return end
  if not group.gap_max or gap > group.gap_max then group.gap_max, group.gap_max_frame = gap, record.frame end
  if not group.gap_min or gap < group.gap_min then group.gap_min = gap end
end

function Summary:note_values(group, record)
  local decode = self.context.decode
  local raws, fields = decode.read(group.message, record.payload), group.fields
  for i = 1, #fields do
    local row = fields[i]
    local raw = raws[row.index]
    if type(raw) == "string" then raw = tonumber(raw) + 0.0 end -- of 64 bits: a text where a double is not exact
    if type(raw) == "number" and raw >= row.low and raw <= row.high then
      if row.count == 0 then
        row.min, row.max = raw, raw
      elseif raw < row.min then
        row.min = raw
      elseif raw > row.max then
        row.max = raw
      end
      row.count, row.sum = row.count + 1, row.sum + raw
    end
  end
end

function Summary:message(record)
  local group = self.groups:of(record)
  if record.lost then
    group.incomplete = group.incomplete + 1
  elseif record.is_bad then
    group.crc_bad = group.crc_bad + 1
  elseif record.good then
    local change = record.change
    note_gap(group, record)
    group.first, group.last, group.count = group.first or record.rel, record.rel, group.count + 1
    if change and change.late then group.late = group.late + 1 end
    if change and change.reboot then group.reboots = group.reboots + 1 end
    if record.fits then self:note_values(group, record) end
  end
end

-- What is worked out when all has been seen; the ends of a range have the digits of a single value.
local function conclude(group, decode)
  local span = group.count > 1 and groups.span(group.first, group.last)
  group.rate = span and span > 0 and (group.count - 1) / span or nil
  group.gap_mean = span and span / (group.count - 1) or nil
  for _, row in ipairs(group.fields) do
    if row.count > 0 then
      local field = row.field
      local min, max = decode.value(field, row.min), decode.value(field, row.max)
      if field.kind == "float" or field.scale then min, max = decode.rounded(field, min), decode.rounded(field, max) end
      row.mean, row.min, row.max = decode.value(field, row.sum / row.count), math.min(min, max), math.max(min, max)
    end
  end
end

local function line(group)
  local names, values = {}, {}
  for i, row in ipairs(group.fields) do
    local name = row.field.name
    names[i], values[name] = name, json.raw(json.object(RANGE, row))
  end
  return json.object(KEYS, { bus = group.source.bus, id = group.source.id, source = group.source.name,
    message = group.message and group.message.name, count = group.count, rate = group.rate,
    gap_min = json.seconds(group.gap_min), gap_mean = json.seconds(group.gap_mean),
    gap_max = json.seconds(group.gap_max), gap_max_frame = group.gap_max_frame, crc_bad = group.crc_bad,
    incomplete = group.incomplete, late = group.late, reboots = group.reboots,
    values = json.raw(json.object(names, values)) }) .. "\n"
end

local function milliseconds(seconds)
  return seconds and ("%.3f"):format(seconds * 1000) or false
end

local function source_table(list)
  local rows = {}
  for i, group in ipairs(list) do
    rows[i] = { group.source.bus, text.id(group.source.id), group.source.name,
      group.message and group.message.title or "unknown",
      group.count, group.rate and ("%.3f"):format(group.rate), milliseconds(group.gap_min),
      milliseconds(group.gap_mean), milliseconds(group.gap_max), group.gap_max_frame, group.crc_bad,
      group.incomplete, group.late, group.reboots }
  end
  return text.table({ "bus", "ID", "source", "message", ">count", ">rate/Hz", ">gap/ms min", ">mean", ">max",
    ">in frame", ">bad CRC", ">incomplete", ">late", ">reboots" }, rows)
end

local function value_table(list)
  local rows = {}
  for _, group in ipairs(list) do
    for _, row in ipairs(group.fields) do
      if row.count > 0 then
        rows[#rows + 1] = { group.source.bus, text.id(group.source.id), group.source.name, group.message.title,
          row.field.name, row.field.unit, text.number(row.min), text.number(row.mean), text.number(row.max), row.count }
      end
    end
  end
  return rows[1] and "\n" .. text.table({ "bus", "ID", "source", "message", "field", "unit", ">min", ">mean", ">max",
    ">values" }, rows) or ""
end

--- last  { rel = } of the last packet of any kind; nil where there was none
function Summary:finish(last)
  local list, out = self.groups:sorted(), self.context.out
  for _, group in ipairs(list) do conclude(group, self.context.decode) end
  if self.options.json then
    for _, group in ipairs(list) do out(line(group)) end
    return
  end
  out(("YAPP summary: %s in %.3f s\n"):format(text.count(#list, "source"), last and last.rel or 0))
  if #list > 0 then out("\n" .. source_table(list) .. value_table(list)) end
end

return M
