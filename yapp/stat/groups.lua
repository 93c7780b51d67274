-- SPDX-License-Identifier: GPL-2.0-or-later
-- The gathering of a statistic: of each source counts, times, gaps and values; of all sources of
-- one message, how far their values lie apart.  Pure Lua, 5.2 to 5.5.

local field_kinds = require "yapp.message.field_kinds"
local joined = require "yapp.base.joined"
local kinds = require "yapp.stat.kinds"
local memo = require "yapp.base.memo"
local output = require "yapp.stat.output"

local M = {}

local span = kinds.span
local INFINITE = math.huge

--- Return a number with the digits that people see.
function M.round(field, value)
  local shape = field.shape
  return shape and tonumber(shape:format(value)) or value -- NaN stays
end

--- Return a number without noise: 10, not 9.9999999999999982.
function M.clean(value)
  return tonumber(("%.12g"):format(value)) or value -- infinity
end

-- Values ----------------------------------------------------------------------------------------

--- Find how far the latest values of all sources lie apart: the largest spread so far, and the
-- event that shows it.  Needs values of two sources at one time.
-- values   { spread, latest, latest_at }, see Groups:new_values
-- longest  seconds for which a value stays valid
function M.update_spread(values, value, event, longest)
  local spread, low, high, count = values.spread, INFINITE, -INFINITE, 0
  values.latest, values.latest_at = value, event.at
  for _, member in ipairs(spread) do
    local latest = member.latest
    if latest == latest and span(member.latest_at, event.at) <= longest then
      low, high, count = math.min(low, latest), math.max(high, latest), count + 1
    end
  end
  if count < 2 then return end
  local apart = M.clean(high - low)
  if apart > (spread.worst or -1) then
    spread.worst, spread.frame, spread.rel = apart, event.frame, event.time
  end
end

-- Groups ----------------------------------------------------------------------------------------

-- Of a kind of event: seen = how many, frame and values = of the first, cause = of the latest.
local function new_count()
  return { seen = 0, values = kinds.NOTHING }
end

local Groups = {}

--- Make a class of statistics that gather by source.  A group is the record of a source: {
--   source, type = the source's
--   counts = { [kind of event] = see new_count }
--   count = of good messages, decoded = of those that were decoded; last = event of the latest one
--   length = of all gaps; gap_min, gap_max = seconds, gap_max_frame
--   silent = how long it has been silent at the capture's end, if that is a silence
--   is_unreliable = true if one of them had an unreliable history
--   values = of Groups:new_values }
-- class    its own methods, see stat.answer; new_values and add_values, if it gathers other values
--          than those of all fields that are numbers; compares = true if it gathers their spreads
-- returns  it, with class.new(options, context), which makes a statistic:
--   options  of stat.options
--   context  { dates = a stat.dates; settings = see stat.taps; and the rest for output.print }
function M.class(class)
  class.__index = class
  function class.new(options, context)
    local self = setmetatable({
      options = options,
      context = context,
      list = {}, -- of groups; by_source = the same, by source
      capture = { counts = memo(new_count) }, -- a group: the events of the whole capture
      absent = {}, -- by source: true if none of its messages came
      -- By field, or by rule: a list of the values of each source, with worst, frame and rel, see
      -- M.update_spread.
      spreads = memo(),
    }, class)
    self.by_source = memo(function(source)
      local message_type = source.type
      return {
        source = source,
        type = message_type,
        counts = memo(new_count),
        count = 0,
        decoded = 0,
        length = 0,
        values = message_type and not options.brief and self:new_values(message_type)
          or kinds.NOTHING,
      }
    end, self.list)
    return self
  end
  return setmetatable(class, { __index = Groups })
end

--- Make the values of a source: of the fields that are numbers and no codes.
function Groups:new_values(message_type)
  local list = {}
  for _, field in ipairs(joined(message_type.fields, message_type.generated)) do
    if field_kinds.is_number(field) then
      local values = {
        field = field,
        read = field_kinds.reader[field],
        count = 0, -- of numbers, whose least, sum and largest follow
        min = INFINITE,
        sum = 0.0,
        max = -INFINITE,
        spread = self.compares and self.spreads[field], -- of all sources
        latest = 0 / 0, -- no number; latest_at = when it came
      }
      list[#list + 1] = values
      if values.spread then table.insert(values.spread, values) end
    end
  end
  return list
end

--- Add the values of a message.
-- list     of Groups:new_values
-- longest  seconds for which a value stays valid
function Groups.add_values(list, event, longest)
  local raws = event.raws
  for i = 1, #list do
    local values = list[i]
    local value = values.read(raws)
    if value == value then -- no NaN
      values.count, values.sum = values.count + 1, values.sum + value
      if value < values.min then values.min = value end
      if value > values.max then values.max = value end
    end
    if values.spread then M.update_spread(values, value, event, longest) end
  end
end

local function add_message(self, event)
  local group = self.by_source[event.source]
  local last = group.last
  group.last = event
  if last then
    local gap = span(last.at, event.at)
    if gap > (group.gap_max or -INFINITE) then
      group.gap_max, group.gap_max_frame = gap, event.frame
    end
    group.gap_min = math.min(gap, group.gap_min or gap)
    group.length = group.length + gap
  end
  group.count = group.count + 1
  group.is_unreliable = group.is_unreliable or event.values.is_unreliable
  if not event.raws then return end
  group.decoded = group.decoded + 1
  local every = group.type.every
  local longest = every and self.context.settings.late * every or INFINITE
  self.add_values(group.values, event, longest, last)
end

-- amount  to add; nil for 1, but only once for all events of one message
local function count_event(group, kind, event, amount)
  local count, frame, cause = group.counts[kind], event.frame, event.cause or event
  if frame and frame < (count.frame or INFINITE) then
    count.frame, count.values = frame, event.values
  end
  if amount or count.cause ~= cause then count.seen = count.seen + (amount or 1) end
  count.cause = cause
end

--- Add an event, see stat.answer.  A fault counts when it rises.
function Groups:add_event(event)
  local kind, values = event.kind, event.values
  local row = kinds.BY_NAME[kind]
  if not row then return add_message(self, event) end
  if kind == "fault" and values.event ~= "raised" then return end
  if kind == "absent" then self.absent[event.source] = true end
  local group = row.scope == "capture" and self.capture or self.by_source[event.source]
  count_event(group, row.counts_as or kind, event, values[row.amount])
  if values.is_last then group.silent = values.length end
end

--- Return the mean gap in seconds, nil for fewer than two messages.
function M.mean_gap(group)
  return group.count > 1 and span(0, group.length) / (group.count - 1) or nil
end

--- Return the mean rate in Hz, nil where no two messages are at two times.
function M.rate(group)
  local gap = M.mean_gap(group)
  return gap and gap > 0 and 1 / gap or nil
end

--- Return the median of numbers, which it sorts.
function M.median(numbers)
  table.sort(numbers)
  local half = #numbers / 2
  return (numbers[math.floor(half + 0.5)] + numbers[math.floor(half + 1)]) / 2
end

--- Return a row with the range of a field of a source.
function M.row(group, values)
  local field, count = values.field, values.count
  local row = output.row(group.source, { field = field.name, unit = field.unit, count = count })
  if count == 0 then return row end
  local least, most = M.round(field, values.min), M.round(field, values.max)
  for name, value in pairs { min = least, mean = values.sum / count, max = most } do
    local short = field.rounded and field.rounded:format(value)
    row[name] = { value = value, text = value, short = short }
  end
  return row
end

--- Return all groups by bus, then by ID.  A stream itself has no ID and comes first.
-- by_controller  true if a controller's are together: by the last digit of the ID
function Groups:sort(by_controller)
  output.sort(self.list, function(group)
    local bus, id = group.source.bus, group.source.id or -16
    return output.sortable(bus or ""), by_controller and id % 16 or 0, id
  end)
  return self.list
end

return M
