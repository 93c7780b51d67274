-- SPDX-License-Identifier: GPL-2.0-or-later
-- The values that rules are about: which of them a rule judges, and how they lie in its limits.
-- Pure Lua, 5.2 to 5.5.

local band = require("yapp.base.bits").band
local groups = require "yapp.stat.groups"
local span = require("yapp.stat.kinds").span

local M = {}

local round = groups.round
local NO_NUMBER = 0 / 0
local INFINITE = math.huge

--- Why nothing of a source can be judged.
M.NO_VALUE = "no good message of it was decoded"

--- Make the state of a source: its series, a list, also by rule.
-- rules    of the source's message type
-- spreads  [rule] = spread of groups
function M.new(rules, spreads)
  local state = {
    last = nil, -- when the latest message came
    since = {}, -- by the text of a condition: when it began to hold; nil while it does not
  }
  for i, rule in ipairs(rules) do
    local series = {
      rule = rule,
      seen = 0, -- number of values that are judged
      count = 0, -- of those that are numbers; sum = theirs
      sum = 0.0,
      beyond = 0, -- number of values outside the points of `over`
      -- Of the number nearest to a limit; room = how far it lies within, negative if outside.
      nearest = { room = INFINITE },
      frame = nil, -- of the latest number that was judged: its value, room, low, high
      outside = 0, -- number of values that break the rule; worst = the farthest, like nearest
      worst = { room = 0 },
      stretch = nil, -- of values outside in a row: { since, count, worst }
      noise = 0.0, -- sum of how far numbers lie from the mean of their neighbours, count = of these
      noisy = 0,
      first = nil, -- the latest two numbers: first, second
      second = nil,
      -- Where sources are compared, see groups.update_spread.
      field = rule.field,
      spread = rule.kind.scope == "capture" and spreads[rule],
      latest = NO_NUMBER,
    }
    if series.spread then table.insert(series.spread.members, series) end
    state[i], state[rule] = series, series
  end
  return state
end

-- Return whether a condition holds, for as long as it must; nil if the message does not tell.
local function is_fulfilled(state, condition, event)
  local since, is_known, raws = state.since, true, event.raws
  for _, test in ipairs(condition.tests) do
    local value = groups.number_in(test.field, raws)
    if value and test.mask then value = band(value, test.mask) ~= 0 and 1 or 0 end
    value = value and round(test.field, value)
    if not value or value ~= value then
      is_known = false
    elseif value < test.low or value > test.high then
      since[condition.text] = nil
      return false
    end
  end
  if not is_known then return nil end
  since[condition.text] = since[condition.text] or event.at
  return span(since[condition.text], event.at) >= condition.after
end

-- Return the limits of `over` at a value of the other field; nil outside the points.
local function limits_at(points, x)
  if not (x >= points[1].x and x <= points[#points].x) then return nil end
  local i = 2
  while x > points[i].x do i = i + 1 end
  local from, to = points[i - 1], points[i]
  local share = (x - from.x) / (to.x - from.x)
  return from.low + (to.low - from.low) * share, from.high + (to.high - from.high) * share
end

-- Return a number without noise: 10, not 9.9999999999999982.
local function clean(value)
  return tonumber(("%.12g"):format(value)) or value -- infinity
end

-- A value outside: it breaks the rule if it is so for long enough.
local function add_outside(series, found, event)
  local stretch = series.stretch or { since = event.at, count = 0, worst = found }
  series.stretch = stretch
  stretch.count = stretch.count + 1
  if found.room < stretch.worst.room then stretch.worst = found end
  if span(stretch.since, event.at) < series.rule.hold then return end
  series.outside, stretch.count = series.outside + stretch.count, 0
  if stretch.worst.room < series.worst.room then series.worst = stretch.worst end
end

-- Judge a number by its limits.
local function judge(series, value, low, high, event)
  local room, above = value - low, high - value
  if above < room then room = above end
  series.value, series.room, series.low, series.high = value, room, low, high
  series.frame = event.frame
  if room < 0 or room < series.nearest.room then
    value, low, high = round(series.field, value), clean(low), clean(high)
    room = math.min(value - low, high - value)
    local found = { room = room, value = value, low = low, high = high, frame = event.frame }
    if room < series.nearest.room then series.nearest = found end
    if room < 0 then return add_outside(series, found, event) end
  end
  series.stretch = nil
end

local function add_noise(series, value)
  local first, second = series.first, series.second
  if first then
    series.noise = series.noise + math.abs(second - (first + value) / 2)
    series.noisy = series.noisy + 1
  end
  series.first, series.second = second, value
end

-- other  the value of the field that `over` names
local function add_value(series, value, other, event)
  local rule = series.rule
  local low, high = rule.least, rule.most
  if rule.points then
    low, high = limits_at(rule.points, other or NO_NUMBER)
    if not low then
      series.beyond = series.beyond + 1
      return
    end
  end
  series.seen = series.seen + 1
  if value ~= value then return end
  series.count, series.sum = series.count + 1, series.sum + value
  if low then judge(series, value, low, high, event) end
  if rule.kind.name == "noise" then add_noise(series, value) end
end

-- Return whether a rule judges a message; nil if the message does not tell.
-- fulfilled  by the text of a condition: the answer, which rules share
local function is_judged_by(state, condition, event, fulfilled)
  if not condition then return true end
  local answer = fulfilled[condition.text]
  if answer == nil then
    answer = is_fulfilled(state, condition, event)
    fulfilled[condition.text] = answer
  end
  return answer
end

-- Return whether what must last begins anew with a message: behind a gap and a reboot.
local function begins_anew(state, event, longest)
  local last, change = state.last, event.values.change
  state.last = event.at
  if change and change.reboot then return true end
  return last and (event.at < last or span(last, event.at) > longest)
end

--- Add a message.
-- longest  seconds: a longer gap breaks what must last
function M.add(state, event, longest)
  local begins, numbers, fulfilled = begins_anew(state, event, longest), {}, {}
  if begins then state.since = {} end
  local function number(field) -- rules share fields and conditions: work them out once
    local value = numbers[field]
    if value == nil then
      value = groups.number_in(field, event.raws) or false
      numbers[field] = value
    end
    return value
  end
  for _, series in ipairs(state) do
    local rule = series.rule
    local is_judged = is_judged_by(state, rule.condition, event, fulfilled)
    if begins or is_judged == false then
      series.stretch, series.first, series.second = nil, nil, nil
    end
    local value = is_judged and number(rule.field)
    if value then add_value(series, value, rule.other and number(rule.other), event) end
    if series.spread and is_judged ~= nil then
      groups.update_spread(series, value or NO_NUMBER, event, longest)
    end
  end
end

-- Return how far the latest number lies within its limits: the share of their range, or of the only
-- limit.
local function share_of(series)
  local low, high = series.low, series.high
  local range = high - low
  if range == INFINITE then range = math.abs(high < INFINITE and high or low) end
  return range > 0 and series.room / range or series.room
end

--- Return the number of a message that is nearest to its limit, the latest message being in this
-- frame: { rule, value, share }, where share is negative outside; nil for none.
function M.latest(state, frame)
  local nearest = { share = INFINITE }
  for _, series in ipairs(state) do
    local share = series.frame == frame and share_of(series) or INFINITE
    if share < nearest.share then
      local value = round(series.field, series.value)
      nearest = { rule = series.rule, value = value, share = share }
    end
  end
  return nearest.rule and nearest
end

--- Return why a rule judged no value of a source; nil if it did.
function M.explain(state, rule)
  if state[rule].seen > 0 then return nil end
  if not state.last then return M.NO_VALUE end
  if state[rule].beyond > 0 then
    return ("%s was never within %s"):format(rule.other.name, rule.limit)
  end
  return rule.condition and "the condition never held:" .. rule.condition.text
    or "all its values are reserved"
end

--- Describe the values that a rule judged.
function M.describe(series)
  local text, beyond = ("of %d values"):format(series.count), series.beyond
  if beyond == 0 then return text end
  local shape = "%s, %.3g %% more not judged: %s outside the points"
  return shape:format(text, beyond / (beyond + series.seen) * 100, series.rule.other.name)
end

return M
