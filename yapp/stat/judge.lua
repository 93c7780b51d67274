-- SPDX-License-Identifier: GPL-2.0-or-later
-- The values that rules are about: which of them a rule judges, and how they lie in its limits.
-- Pure Lua, 5.2 to 5.5.
--
-- Rules of one message type often share fields and conditions: of each message these are worked out
-- once, and then each rule looks at its own value.

local band = require("yapp.base.bits").band
local groups = require "yapp.stat.groups"
local span = require("yapp.stat.kinds").span

local M = {}

local round = groups.round
local NO_NUMBER = 0 / 0

--- Why nothing of a source can be judged.
M.NO_VALUE = "no good message of it was decoded"
M.ALL_RESERVED = "all its values are reserved"
local INFINITE = math.huge

-- Plans -------------------------------------------------------------------------------------------

--- Return what the rules of a message type need of a message.
-- rules    of stat.rules
-- returns  { fields, conditions = lists, each without repetitions;
--            list of { rule; field, other, condition = indices in these lists, or nil } }
function M.plan(rules, message_type)
  local plan, indices = { fields = {}, conditions = {} }, {}
  local function index_of(list, one, key)
    if one and not indices[key] then
      list[#list + 1] = one
      indices[key] = #list
    end
    return one and indices[key]
  end
  for _, rule in ipairs(rules) do
    if rule.field and rule.message == message_type then
      local condition = rule.condition
      plan[#plan + 1] = {
        rule = rule,
        field = index_of(plan.fields, rule.field, rule.field),
        other = index_of(plan.fields, rule.other, rule.other),
        condition = index_of(plan.conditions, condition, condition and condition.text),
      }
    end
  end
  return plan
end

-- Make the record of a rule and a source.
local function new_series(rule)
  return {
    rule = rule,
    field = rule.field,
    points = rule.points, -- of `over`; low, high = limits of each number, nil for none
    low = rule.limits and rule.limits.low,
    high = rule.limits and rule.limits.high,
    seen = 0, -- number of values that are judged
    count = 0, -- of those that are numbers; sum = theirs
    sum = 0.0,
    beyond = 0, -- number of values that no limit is for: see `over`
    -- Of the number nearest to a limit; room = how far it lies within, negative if outside.
    nearest = { room = INFINITE },
    outside = 0, -- number of values that break the rule
    worst = { room = 0 }, -- of the one that is farthest outside
    stretch = nil, -- of values outside in a row: { since, count, worst = like the one above }
    longest = 0, -- seconds of the longest stretch
    -- Where the sources are compared, see groups.update_spread:
    spread = nil,
    latest = NO_NUMBER,
    latest_at = nil,
  }
end

--- Make the state of a source: its series in the order of the plan, and by rule.
-- spreads  [rule] = spread of groups
function M.new(plan, spreads)
  local state = {
    plan = plan,
    last = nil, -- time of the latest message
    numbers = {}, -- of the fields in a message
    holds = {}, -- of the conditions: true, false, or nil if their field has no number
    since = {}, -- when they began to hold, false while they do not
  }
  for i, entry in ipairs(plan) do
    local rule = entry.rule
    local series = new_series(rule)
    if rule.is_spread then
      series.spread = spreads[rule]
      table.insert(series.spread.members, series)
    end
    state[i], state[rule] = series, series
  end
  return state
end

-- Conditions --------------------------------------------------------------------------------------

-- Return whether a test holds; nil if the message does not tell.
local function is_met(test, raws)
  local field = test.field
  if test.mask then
    local raw = raws[field.index]
    if not raw then return nil end
    return (band(raw, test.mask) ~= 0) ~= test.is_not
  end
  local value = groups.number_in(field, raws)
  if not value or value ~= value then return nil end
  if value >= test.low and value <= test.high then return true end
  value = round(field, value)
  return value >= test.low and value <= test.high
end

local function are_met(tests, raws)
  local are_known = true
  for _, test in ipairs(tests) do
    local is_true = is_met(test, raws)
    if is_true == false then return false end
    are_known = are_known and is_true ~= nil
  end
  return are_known or nil
end

-- Return whether a condition holds, for as long as it must.
local function is_fulfilled(state, index, event)
  local condition = state.plan.conditions[index]
  local are_true = are_met(condition.tests, event.raws)
  if are_true == nil then return nil end
  if not are_true then
    state.since[index] = false
    return false
  end
  local since = state.since[index] or event.at
  state.since[index] = since
  return span(since, event.at) >= condition.after
end

-- Values ------------------------------------------------------------------------------------------

local function between(from, to, share)
  return from == to and to or from + (to - from) * share -- both may be infinite
end

-- Return the limits of `over` at a value of the other field; nil outside the points.
local function limits_at(points, x)
  if not (x >= points[1].x and x <= points[#points].x) then return nil end
  local i = 2
  while x > points[i].x do i = i + 1 end
  local from, to = points[i - 1], points[i]
  local share = (x - from.x) / (to.x - from.x)
  return between(from.low, to.low, share), between(from.high, to.high, share)
end

-- Return a number without noise: 10, not 9.9999999999999982.
local function clean(value)
  return tonumber(("%.12g"):format(value)) or value -- infinity
end

-- A value outside: it breaks the rule if it is so for long enough.
local function add_outside(series, found, event)
  local stretch = series.stretch
  if not stretch then
    stretch = { since = event.at, count = 0, worst = found }
    series.stretch = stretch
  end
  stretch.count = stretch.count + 1
  if found.room < stretch.worst.room then stretch.worst = found end
  local length = span(stretch.since, event.at)
  series.longest = math.max(series.longest, length)
  if length < series.rule.hold then return end
  series.outside, stretch.count = series.outside + stretch.count, 0
  if stretch.worst.room < series.worst.room then series.worst = stretch.worst end
end

-- Judge a number by its limits.
local function judge(series, value, low, high, event)
  local room, above = value - low, high - value
  if above < room then room = above end
  if room >= 0 and room >= series.nearest.room then
    series.stretch = nil
    return
  end
  value, low, high = round(series.field, value), clean(low), clean(high)
  room = clean(math.min(value - low, high - value))
  local found = { room = room, value = value, low = low, high = high, frame = event.frame }
  if room < series.nearest.room then series.nearest = found end
  if room < 0 then return add_outside(series, found, event) end
  series.stretch = nil
end

-- other  the value of the field that `over` names
local function add_value(series, value, other, event)
  local points, low, high = series.points, series.low, series.high
  if points then
    low, high = limits_at(points, other or NO_NUMBER)
    if not low then
      series.beyond = series.beyond + 1
      return
    end
  end
  series.seen = series.seen + 1
  if value ~= value then return end
  series.count = series.count + 1
  series.sum = series.sum + value
  if low then judge(series, value, low, high, event) end
end

--- Return why a rule judged no value of a source; nil if it did.
function M.explain(state, rule)
  local series = state[rule]
  if series.seen > 0 then return nil end
  if series.beyond > 0 then
    return ("%s was never within %s"):format(rule.other.name, rule.limit)
  end
  if not state.last then return M.NO_VALUE end
  local condition = rule.condition
  return condition and "the condition never held:" .. condition.text or M.ALL_RESERVED
end

--- Describe the values that a rule judged.
function M.describe(series)
  local rule = series.rule
  local texts = { ("of %d values"):format(series.count) }
  if series.beyond > 0 then
    local share = series.beyond / (series.beyond + series.seen) * 100
    texts[2] = ("%.3g %% more not judged: %s outside the points"):format(share, rule.other.name)
  end
  if rule.hold > 0 then
    texts[#texts + 1] = ("outside for %.3g s at most"):format(series.longest)
  end
  return table.concat(texts, ", ")
end

-- Work out the values and the conditions of a message.
-- begins  true if the conditions begin anew
local function read_message(state, event, begins)
  local plan, numbers, holds = state.plan, state.numbers, state.holds
  for i, field in ipairs(plan.fields) do numbers[i] = groups.number_in(field, event.raws) end
  for i in ipairs(plan.conditions) do
    if begins then state.since[i] = false end
    holds[i] = is_fulfilled(state, i, event)
  end
  return numbers, holds
end

-- Return whether conditions and stretches begin anew with a message: behind a gap and a reboot.
local function begins_anew(state, event, longest)
  local last, change = state.last, event.values.change
  state.last = event.at
  if change and change.reboot then return true end
  return last and (event.at < last or span(last, event.at) > longest)
end

--- Add a message.
-- longest  seconds: a longer gap breaks what must last
function M.add(state, event, longest)
  local begins = begins_anew(state, event, longest)
  local numbers, holds = read_message(state, event, begins)
  for i, entry in ipairs(state.plan) do
    local series, condition, is_judged = state[i], entry.condition, true
    if condition then is_judged = holds[condition] end
    if begins or is_judged == false then series.stretch = nil end
    local value = is_judged and numbers[entry.field]
    if value then add_value(series, value, numbers[entry.other], event) end
    if series.spread and is_judged ~= nil then
      groups.update_spread(series, value or NO_NUMBER, event, longest)
    end
  end
end

return M
