-- SPDX-License-Identifier: GPL-2.0-or-later
-- What a statistic gathers of each source: counts, times, gaps, values; and of the sources of one
-- message, how far these lie apart.  Pure Lua, 5.2 to 5.5.

local decode, output = require("yapp.message.decode"), require("yapp.stat.output")
local tell = require("yapp.stat.tell")

local M = {}

local INFINITE = math.huge
local NO_NUMBER = 0 / 0
local NO_LIMITS = {}

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

-- Values ----------------------------------------------------------------------------------------

local Values = {}
Values.__index = Values

--- What is gathered of a field: count, min, sum, max of its numbers; seen = of all of it, outside =
-- of those beyond the limits, the worst of them and its frame.
-- limits  { low, high = either nil }, nil for none; reserved counts are beyond all
function M.values(message, field, limits)
  limits = limits or NO_LIMITS
  return setmetatable({ field = field, index = message.index[field], limits = limits,
    low = limits.low or -INFINITE, high = limits.high or INFINITE,
    count = 0, min = INFINITE, sum = 0.0, max = -INFINITE,
    seen = 0, outside = 0, by = 0, worst = nil, frame = nil }, Values)
end

local function beyond(self, value)
  return value ~= value and INFINITE or math.max(self.low - value, value - self.high)
end

local function note(self, record, raws)
  local value = number_of(self.field, self.index, raws, record.payload)
  if not value then return end
  self.seen = self.seen + 1
  if value == value then
    self.count, self.sum = self.count + 1, self.sum + value
    self.min, self.max = math.min(self.min, value), math.max(self.max, value)
  end
  if beyond(self, value) <= 0 then return end
  value = rounded(self.field, value)
  local by = beyond(self, value)
  if by > 0 then self.outside = self.outside + 1 end
  if by > self.by then self.by, self.worst, self.frame = by, value, record.frame end
end

--- Their count, min, mean and max, for a row.
function Values:put(row)
  row.count = self.count
  if self.count == 0 then return row end
  row.min, row.max = output.number(rounded(self.field, self.min)),
    output.number(rounded(self.field, self.max))
  row.mean = output.number(self.sum / self.count)
  return row
end

local NUMERIC = { uint = true, int = true, float = true, ieee = true }

--- Values of the fields of a message that can be averaged, as they are no codes.
function M.numeric(message)
  local list = {}
  for _, field in ipairs(message.fields) do
    if NUMERIC[field.kind] and not field.values then
      list[#list + 1] = M.values(message, field)
    end
  end
  return list
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
  local value = number_of(self.field, self.index, raws, record.payload) or NO_NUMBER
  self.latest[record.source] = { value = rounded(self.field, value), rel = record.rel }
  local low, high, count = INFINITE, -INFINITE, 0
  for _, one in pairs(self.latest) do
    local age = tell.span(one.rel, record.rel)
    local is_good = not self.every or age <= self.late() * self.every
    if is_good and one.value == one.value then
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

--- values_of  function(message) -> list of M.values that are gathered of each source of it
function M.new(values_of)
  return setmetatable({ values_of = values_of, by_source = {}, list = {}, buses = {} }, Groups)
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
  group = { source = source, message = message, counts = {}, count = 0,
    values = message and self.values_of(message) or {}, bus_order = self.buses[bus] }
  self.by_source[source], self.list[#self.list + 1] = group, group
  return group
end

local function add(group, kind, event)
  local count, record = group.counts[kind], event.record or event
  if not count then
    count = { seen = 0, frame = event.frame }
    group.counts[kind] = count
  end
  if count.record ~= record then count.seen = count.seen + 1 end
  count.record = record
end

--- Counts an event: a message that has several of one kind once, and of faults those that rose.
function Groups:event(event)
  local kind = event.kind
  if kind == "absent" or kind == "fault" and event.event ~= "raised" then return end
  local group = group_of(self, event.source)
  add(group, tell.KINDS[kind].counts_as or kind, event)
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
  group.gap_min = math.min(gap, group.gap_min or gap)
end

--- Takes a record; returns the message and its raw values where it is good and fits.
function Groups:message(record)
  local group = group_of(self, record.source)
  if record.kind ~= "message" then return end
  if group.last then note_gap(group, tell.span(group.last, record.rel), record.frame) end
  group.first, group.last = group.first or record.rel, record.rel
  group.last_frame, group.count = record.frame, group.count + 1
  group.is_unsure = group.is_unsure or record.is_unsure
  if not record.fits then return end
  local raws = decode.read(group.message, record.payload)
  for _, values in ipairs(group.values) do note(values, record, raws) end
  return group.message, raws
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
