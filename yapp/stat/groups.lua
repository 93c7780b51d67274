-- SPDX-License-Identifier: GPL-2.0-or-later
-- What a statistic gathers of each source: counts, times, gaps, values; and of the sources of one
-- message, how far these lie apart.  Pure Lua, 5.2 to 5.5.

local decode = require("yapp.message.decode")
local span = require("yapp.stat.tell").span

local M = {}

local COUNTED_AS = { unfinished = "incomplete" } -- kinds of events

--- The number that a value is: in its unit, a time in seconds, flags and codes as they are sent.
-- Nil for a reserved count, and for what a payload that was cut has no more.
-- raws  of message.decode
function M.number(field, raws, index, payload)
  if field.kind == "time" then
    if field.offset + field.size > #payload then return nil end
    local seconds, nanoseconds = decode.time(payload, field.offset)
    return seconds + nanoseconds / 1e9
  end
  local value = raws[index]
  if not (field.values or field.flags) then value = decode.value(field, value) end
  value = tonumber(value) -- of 64 bits a text, where a double is not exact
  return value == value and value or nil
end

--- A number with the digits that people see.
function M.rounded(field, value)
  if not value or field.kind ~= "float" and not field.scale then return value end
  return decode.rounded(field, value)
end

local NUMERIC = { uint = true, int = true, float = true, ieee = true }

--- The fields of a message whose values can be averaged, as they are no codes.
function M.numeric(message)
  local fields = {}
  for _, field in ipairs(message and message.fields or {}) do
    if NUMERIC[field.kind] and not field.values then fields[#fields + 1] = field end
  end
  return fields
end

-- Spread ----------------------------------------------------------------------------------------

local Spread = {}
Spread.__index = Spread

--- How far the latest values of a field of all sources lie apart.
-- late  function() -> how many periods of a message a value is good for
-- It has worst, frame and rel: the largest so far, nil while no two sources had a value at a time.
function M.spread(message, field, late)
  return setmetatable({ field = field, index = message.index[field], every = message.every,
    late = late, latest = {}, worst = nil, frame = nil, rel = nil }, Spread)
end

--- Takes a record of that message.
function Spread:note(record, raws)
  local value = M.rounded(self.field, M.number(self.field, raws, self.index, record.payload))
  self.latest[record.source.key] = value and { value = value, rel = record.rel }
  local low, high, count = math.huge, -math.huge, 0
  for _, one in pairs(self.latest) do
    if not self.every or span(one.rel, record.rel) <= self.late() * self.every then
      low, high, count = math.min(low, one.value), math.max(high, one.value), count + 1
    end
  end
  local apart = count > 1 and tonumber(("%.7g"):format(high - low)) -- no 0.30000000000000004
  if apart and apart > (self.worst or -1) then
    self.worst, self.frame, self.rel = apart, record.frame, record.rel
  end
end

-- Groups ----------------------------------------------------------------------------------------

local Groups = {}
Groups.__index = Groups

--- fields_of  function(message or nil) -> the fields whose values are gathered
function M.new(fields_of)
  return setmetatable({ fields_of = fields_of, by_key = {}, list = {}, buses = {}, bus_count = 0 },
    Groups)
end

--- What is gathered of a source: {
--   source, message = the source's, counts = { [kind of event] = { seen, frame = of the first } },
--   count = of good messages; first, last = their times, last_frame; gap_min, gap_max = seconds,
--   gap_max_frame; is_unsure = whether it is not known what came before one of them;
--   values = list of { field, index, count, sum, min, max } }
function Groups:of(source)
  local group = self.by_key[source.key]
  if group then return group end
  local bus = source.bus_key or false
  if not self.buses[bus] then
    self.bus_count = self.bus_count + 1
    self.buses[bus] = self.bus_count
  end
  group = { source = source, message = source.message, counts = {}, count = 0, values = {},
    order = #self.list + 1, bus_order = self.buses[bus] }
  for i, field in ipairs(self.fields_of(source.message)) do
    group.values[i] = { field = field, index = source.message.index[field], count = 0, sum = 0.0 }
  end
  self.by_key[source.key], self.list[group.order] = group, group
  return group
end

local function add(group, kind, event)
  local count = group.counts[kind] or { seen = 0, frame = event.frame }
  group.counts[kind] = count
  if count.record ~= event.record then count.seen = count.seen + 1 end
  count.record = event.record
end

--- Counts an event: a message that has several of one kind once, and of faults those that rose.
function Groups:event(event)
  local kind = event.kind
  if kind == "absent" or kind == "fault" and event.event ~= "raised" then return end
  local group = self:of(event.source)
  add(group, COUNTED_AS[kind] or kind, event)
  if kind == "silence" and not event.is_last then add(group, "late", event) end
end

--- How often, and first in which frame.
function M.seen(group, kind)
  local count = group.counts[kind]
  if count then return count.seen, count.frame end
  return 0
end

local function note_gap(group, gap, frame)
  if gap > (group.gap_max or -1) then group.gap_max, group.gap_max_frame = gap, frame end
  if gap < (group.gap_min or math.huge) then group.gap_min = gap end
end

--- Takes a record; returns the group, and for a good message that fits the raw values, where any
-- are gathered.
function Groups:message(record)
  local group = self:of(record.source)
  if record.kind ~= "message" then return group end
  if group.last then note_gap(group, span(group.last, record.rel), record.frame) end
  group.first, group.last = group.first or record.rel, record.rel
  group.last_frame, group.count = record.frame, group.count + 1
  group.is_unsure = group.is_unsure or record.is_unsure
  if not record.fits or not group.values[1] then return group end
  local raws = decode.read(group.message, record.payload)
  for _, row in ipairs(group.values) do
    local value = M.number(row.field, raws, row.index, record.payload)
    if value then
      row.min, row.max = math.min(row.min or value, value), math.max(row.max or value, value)
      row.count, row.sum = row.count + 1, row.sum + value
    end
  end
  return group, raws
end

--- The mean rate in Hz; nil where two messages at least are not at two times.
function M.rate(group)
  local length = group.count > 1 and span(group.first, group.last)
  return length and length > 0 and (group.count - 1) / length or nil
end

--- All groups: by bus as these showed, then by ID; a stream itself, which has none, first.  Values
-- get mean, and min and max as people see them.
function Groups:sorted()
  table.sort(self.list, function(a, b)
    if a.bus_order ~= b.bus_order then return a.bus_order < b.bus_order end
    local first, second = a.source.id or -1, b.source.id or -1
    if first ~= second then return first < second end
    return a.order < b.order
  end)
  for _, group in ipairs(self.list) do
    for _, row in ipairs(group.values) do
      row.mean = row.count > 0 and row.sum / row.count or nil
      row.min, row.max = M.rounded(row.field, row.min), M.rounded(row.field, row.max)
    end
  end
  return self.list
end

return M
