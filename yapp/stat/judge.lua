-- SPDX-License-Identifier: GPL-2.0-or-later
-- The values that rules are about: which of them a rule judges, and how they lie in its limits.
-- Pure Lua, 5.2 to 5.5.

local band = require("yapp.base.bits").band
local field_kinds = require "yapp.message.field_kinds"
local groups = require "yapp.stat.groups"
local span = require("yapp.stat.kinds").span

local M = {}

local round = groups.round
local NO_NUMBER = 0 / 0
local INFINITE = math.huge

-- Make the values of a source that a rule judges.  Besides the keys below it has
--   frame    of the latest number that has limits
--   nearest  the number that was nearest to a limit: { value, low, high, frame, room }
--   worst    the same of the values that break the rule: the one farthest outside
--   stretch  of values outside in a row: since = when the first came, and those that did not yet
--            break the rule
--   first, second  the latest two numbers, for noise
--   since    when its condition began to hold
local function new_series(rule, spreads)
  local series = {
    rule = rule,
    seen = 0, -- number of values that are judged
    count = 0, -- of those that are numbers; sum = theirs
    sum = 0.0,
    beyond = 0, -- number of values outside the points of `over`
    outside = 0, -- number of values that break the rule
    noise = 0.0, -- sum of how far numbers lie from the mean of their neighbours, noisy = how many
    noisy = 0,
    -- Where sources are compared, see groups.update_spread.
    field = rule.field,
    spread = rule.kind.scope == "capture" and spreads[rule],
    latest = NO_NUMBER,
  }
  if series.spread then table.insert(series.spread, series) end
  return series
end

--- Make the state of a source: its series, a list, also by rule; numbers = of the latest message by
-- field, which the rules share; readers = of these fields.
-- check  { options = see stat.options, its rules about values of the message type count; spreads =
--        see stat.groups }
function M.new(check, message_type)
  local state = { numbers = {}, readers = {} }
  local function read(field) state.readers[field] = field_kinds.reader[field] end
  for _, rule in ipairs(check.options.rules) do
    if rule.field and rule.message == message_type then
      local series = new_series(rule, check.spreads)
      state[#state + 1], state[rule] = series, series
      read(rule.field)
      if rule.other then read(rule.other) end
      for _, test in ipairs(rule.tests) do read(test.field) end
    end
  end
  return state
end

-- Begin what must last anew.
local function restart(series)
  series.since, series.stretch, series.first, series.second = nil, nil, nil, nil
end

-- Return whether a rule judges a message: whether its condition holds, for as long as it must; nil
-- if the message does not tell.
local function is_judged(series, numbers, at)
  local is_known, rule = true, series.rule
  for _, test in ipairs(rule.tests) do
    local value = numbers[test.field]
    if test.mask then value = band(value, test.mask) ~= 0 and 1 or 0 end
    if value < test.low or value > test.high then
      restart(series)
      return false
    end
    is_known = is_known and value == value
  end
  if not is_known then return nil end
  series.since = series.since or at
  return rule.after == 0 or span(series.since, at) >= rule.after
end

-- Return the limits of a value: of `over` at a value of the other field; nil outside the points.
local function limits_of(rule, numbers)
  local points = rule.points
  if not rule.other then return points[1].low, points[1].high end
  local x = numbers[rule.other]
  for i = 2, #points do
    local from, to = points[i - 1], points[i]
    if x >= from.x and x <= to.x then
      local share = (x - from.x) / (to.x - from.x)
      return from.low + (to.low - from.low) * share, from.high + (to.high - from.high) * share
    end
  end
end

--- Return how far a value lies within its limits, negative outside: in percent of their range, or
-- of the only limit, nil for 0; and in its unit.
-- one  { value, low, high }
function M.margin(one)
  local low, high = one.low, one.high
  local margin, range = math.min(one.value - low, high - one.value), high - low
  if range == INFINITE then range = math.min(math.abs(low), math.abs(high)) end
  return range > 0 and tonumber(("%.3g"):format(margin / range * 100)) or nil, margin
end

-- Return the record that lies farther outside, or nearer to a limit.
local function nearer(one, other)
  return one and one.room <= other.room and one or other
end

-- A value outside: it breaks the rule if it is so for long enough.
local function add_outside(series, found, at)
  local stretch = series.stretch or { since = at }
  series.stretch, stretch[#stretch + 1] = stretch, found
  if span(stretch.since, at) < series.rule.hold then return end
  for i, one in ipairs(stretch) do
    series.outside, series.worst, stretch[i] = series.outside + 1, nearer(series.worst, one), nil
  end
end

-- Judge a number by its limits.
local function judge(series, value, low, high, event)
  local room, nearest = math.min(value - low, high - value), series.nearest
  series.frame = event.frame
  if room < 0 or not nearest or room < nearest.room then
    value = round(series.field, value)
    room = math.min(value - low, high - value)
    local found = { value = value, low = low, high = high, frame = event.frame, room = room }
    series.nearest = nearer(nearest, found)
    if room < 0 then return add_outside(series, found, event.at) end
  end
  series.stretch = nil
end

--- Add a number to the noise of a series.
function M.add_noise(series, value)
  local first, second = series.first, series.second
  if first then
    series.noise = series.noise + math.abs(second - (first + value) / 2)
    series.noisy = series.noisy + 1
  end
  series.first, series.second = second, value
end

local function add_value(series, value, numbers, event)
  local rule, low, high = series.rule
  if rule.points then
    low, high = limits_of(rule, numbers)
    if not low then
      series.beyond = series.beyond + 1
      return
    end
  end
  series.seen = series.seen + 1
  if value ~= value then return end
  series.count, series.sum = series.count + 1, series.sum + value
  if low then judge(series, value, low, high, event) end
  if rule.kind.add then rule.kind.add(series, value) end
end

--- Add a message.
-- longest  seconds: a longer gap breaks what must last
-- last     the message before, nil for none
function M.add(state, event, longest, last)
  if not state[1] then return end
  local change, numbers = event.values.change, state.numbers
  local is_apart = last and (event.at < last.at or span(last.at, event.at) > longest)
  for field, read in pairs(state.readers) do numbers[field] = read(event.raws) end
  for _, series in ipairs(state) do
    if is_apart or change and change.reboot then restart(series) end
    local answer, value = is_judged(series, numbers, event.at), NO_NUMBER
    if answer then
      value = numbers[series.field]
      add_value(series, value, numbers, event)
    end
    if series.spread and answer ~= nil then groups.update_spread(series, value, event, longest) end
  end
end

--- Return the number of a message that is nearest to its limit, the latest message being in this
-- frame: { rule, value, room = in percent, see M.margin }; nil for none.
function M.latest(state, frame)
  local nearest
  for _, series in ipairs(state) do
    if series.frame == frame then
      local rule, numbers = series.rule, state.numbers
      local found = { rule = rule, value = round(rule.field, numbers[rule.field]) }
      found.low, found.high = limits_of(rule, numbers)
      found.room = M.margin(found)
      if found.room then nearest = nearer(nearest, found) end
    end
  end
  return nearest
end

--- Describe the values that a rule judged, or why it judged none; nil if it just met none.
function M.describe(series)
  local condition, beyond = series.rule.condition, series.beyond
  if beyond > 0 then
    local share = beyond / (beyond + series.seen) * 100
    return ("of %d values, %.3g %% more never judged: %s outside the points")
      :format(series.count, share, series.rule.other.name)
  elseif series.seen == 0 and condition ~= "" then
    return "the condition never held:" .. condition
  end
  return series.count > 0 and ("of %d values"):format(series.count) or nil
end

return M
