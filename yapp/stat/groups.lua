-- SPDX-License-Identifier: GPL-2.0-or-later
-- What a statistic gathers of each source: counts, times, gaps, values; and of the sources of one
-- message, how far these lie apart.  Pure Lua, 5.2 to 5.5.

local decode, output = require("yapp.message.decode"), require("yapp.stat.output")
local tell = require("yapp.stat.tell")

local M = {}

local INFINITE = math.huge
local NO_NUMBER = 0 / 0
local NONE = { seen = 0 }

-- The number that a value is: in its unit, a time in seconds, flags and codes as they are sent; NaN
-- for a reserved count, nil where the message does not have the field.
local function number_of(field, index, raws, payload)
  if field.kind == "time" then
    local seconds, nanoseconds = decode.time(payload, field.offset)
    return seconds + nanoseconds / 1e9
  end
  local value = raws[index]
  if value == nil then return nil end
  if not (field.values or field.flags) then value = decode.value(field, value) end
  return tonumber(value) or NO_NUMBER -- of 64 bits a text, where a double is not exact
end

-- A number with the digits that people see.
local function rounded(field, value)
  if value ~= value or field.kind ~= "float" and not field.scale then return value end
  return decode.rounded(field, value)
end

local NUMERIC = {
  uint = true,
  int = true,
  float = true,
  ieee = true,
}

--- The fields of a message that can be averaged, as they are no codes: a list of { field }.
function M.numeric(message)
  local list = {}
  for _, field in ipairs(message.fields) do
    if NUMERIC[field.kind] and not field.values then
      list[#list + 1] = { field = field }
    end
  end
  return list
end

-- Values ----------------------------------------------------------------------------------------

-- What is gathered of a field of a source: count, min, sum, max of its numbers; seen = of all of
-- it, outside = of those beyond the limits, the worst of them and its frame.
local function new_values(message, want)
  return {
    want = want,
    field = want.field,
    index = message.index[want.field],
    low = want.low or -INFINITE,
    high = want.high or INFINITE,
    count = 0,
    min = INFINITE,
    sum = 0.0,
    max = -INFINITE,
    seen = 0,
    outside = 0,
    by = 0,
    worst = nil,
    frame = nil,
  }
end

-- How far a number is beyond the limits; a reserved count is beyond all.
local function beyond(values, value)
  if value ~= value then return INFINITE end
  return math.max(values.low - value, value - values.high)
end

local function note_value(values, record, raws)
  local value = number_of(values.field, values.index, raws, record.payload)
  if not value then return end
  values.seen = values.seen + 1
  if value == value then
    values.count = values.count + 1
    values.sum = values.sum + value
    values.min = math.min(values.min, value)
    values.max = math.max(values.max, value)
  end
  if beyond(values, value) <= 0 then return end
  value = rounded(values.field, value)
  local by = beyond(values, value)
  if by <= 0 then return end
  values.outside = values.outside + 1
  if by > values.by then
    values.by, values.worst, values.frame = by, value, record.frame
  end
end

--- Puts field, unit, count, min, mean and max into a row.
function M.put(values, row)
  local field, count = values.field, values.count
  row.field, row.unit = field.name, field.unit
  row.count = count
  if count == 0 then return row end
  row.min = output.number(rounded(field, values.min))
  row.mean = output.number(values.sum / count)
  row.max = output.number(rounded(field, values.max))
  return row
end

-- Spread ----------------------------------------------------------------------------------------

-- How far the latest values of a field of all sources lie apart: worst, frame and rel of the most,
-- nil while no two sources had a value at a time.
local function new_spread(message, want)
  return {
    want = want,
    field = want.field,
    index = message.index[want.field],
    latest = {}, -- by source: { value, rel }
    worst = nil,
    frame = nil,
    rel = nil,
  }
end

local function note_spread(spread, record, raws, longest)
  local value = number_of(spread.field, spread.index, raws, record.payload) or NO_NUMBER
  spread.latest[record.source] = { value = rounded(spread.field, value), rel = record.rel }
  local low, high, count = INFINITE, -INFINITE, 0
  for _, one in pairs(spread.latest) do
    local is_old = tell.span(one.rel, record.rel) > longest
    if one.value == one.value and not is_old then
      low = math.min(low, one.value)
      high = math.max(high, one.value)
      count = count + 1
    end
  end
  if count < 2 then return end
  local apart = tonumber(("%.7g"):format(high - low)) -- no 0.30000000000000004
  if apart > (spread.worst or -1) then
    spread.worst, spread.frame, spread.rel = apart, record.frame, record.rel
  end
end

-- Groups ----------------------------------------------------------------------------------------

local Groups = {}
Groups.__index = Groups

local function none() return {} end

--- values   function(message) -> list of { field, low, high }: what is gathered of each of its
--          sources
-- spreads  the same of all its sources together; nil for nothing
-- late     function() -> how many periods of a message a value is good for
function M.new(values, spreads, late)
  return setmetatable({
    wants_of = values,
    wants_together = spreads or none,
    late = late,
    by_source = {},
    list = {},
    buses = {}, -- how many sources were there before it
    spreads = {}, -- by message
  }, Groups)
end

local function made(make, message, wants)
  local list = {}
  for i, want in ipairs(wants) do list[i] = make(message, want) end
  return list
end

--- What is gathered of a source: {
--   source, message = the source's, counts = { [kind of event] = { seen, frame = of the first } },
--   count = of good messages; first, last = their times, last_frame; gap_min, gap_max = seconds,
--   gap_max_frame; is_unsure = whether it is not known what came before one of them; values }
local function group_of(self, source)
  local group = self.by_source[source]
  if group then return group end
  local bus, message = source.bus_key or false, source.message
  self.buses[bus] = self.buses[bus] or #self.list
  group = {
    source = source,
    message = message,
    counts = {},
    count = 0,
    values = message and made(new_values, message, self.wants_of(message)) or {},
    bus_order = self.buses[bus],
  }
  if message and not self.spreads[message] then
    self.spreads[message] = made(new_spread, message, self.wants_together(message))
  end
  self.by_source[source] = group
  self.list[#self.list + 1] = group
  return group
end

local function add(group, kind, record)
  local count = group.counts[kind]
  if not count then
    count = { seen = 0, frame = record.frame }
    group.counts[kind] = count
  end
  if count.record ~= record then count.seen = count.seen + 1 end
  count.record = record
end

--- Counts an event: a message that has several of one kind once, and of faults those that rose.
function Groups:event(event)
  local kind, values, record = event.kind, event.values, event.record
  if kind == "absent" or kind == "fault" and values.event ~= "raised" then return end
  local group = group_of(self, event.source)
  add(group, tell.KINDS[kind].counts_as or kind, record)
  if kind == "silence" and not values.is_last then add(group, "late", record) end
end

--- How often, and first in which frame.
function M.seen(group, kind)
  local count = group.counts[kind] or NONE
  return count.seen, count.frame
end

local function note_gap(group, gap, frame)
  if gap > (group.gap_max or -1) then
    group.gap_max, group.gap_max_frame = gap, frame
  end
  group.gap_min = math.min(gap, group.gap_min or gap)
end

--- Takes a record.
function Groups:message(record)
  local group = group_of(self, record.source)
  if record.kind ~= "message" then return end
  if group.last then note_gap(group, tell.span(group.last, record.rel), record.frame) end
  group.first = group.first or record.rel
  group.last = record.rel
  group.last_frame = record.frame
  group.count = group.count + 1
  group.is_unsure = group.is_unsure or record.is_unsure
  if not record.fits then return end
  local message = group.message
  local raws, spreads = decode.read(message, record.payload), self.spreads[message]
  for _, values in ipairs(group.values) do note_value(values, record, raws) end
  if not spreads[1] then return end
  local longest = message.every and self.late() * message.every or INFINITE
  for _, spread in ipairs(spreads) do note_spread(spread, record, raws, longest) end
end

--- The mean rate in Hz; nil where two messages at least are not at two times.
function M.rate(group)
  local length = group.count > 1 and tell.span(group.first, group.last)
  return length and length > 0 and (group.count - 1) / length or nil
end

--- All groups: by bus as these showed, then by ID; a stream itself, which has none, first.
function Groups:sorted()
  table.sort(self.list, function(a, b)
    if a.bus_order ~= b.bus_order then return a.bus_order < b.bus_order end
    return (a.source.id or -1) < (b.source.id or -1)
  end)
  return self.list
end

return M
