-- SPDX-License-Identifier: GPL-2.0-or-later
-- The measures of the rules of `check`, a row each.  The syntax of rules, the list of rules in
-- errors and the verdicts follow.  Pure Lua, 5.2 to 5.5.
--
-- A measure is a function(group, rule, check), which returns the value to judge, its frame, a
-- note, and the value that is farthest outside.  If there is none to judge: nil, nil, why.

local bits = require "yapp.base.bits"
local groups = require "yapp.stat.groups"
local input = require "yapp.base.input"
local joined = require "yapp.base.joined"
local kinds = require "yapp.stat.kinds"
local output = require "yapp.stat.output"

local M = {}

local INFINITE = math.huge
local NO_VALUE = "no good message of it was decoded"
local ALL_RESERVED = "all its values are reserved"
local SAME_SEQ = {
  value = "Seq No never changes: lost messages do not show",
  text = "Seq No never changes: lost messages do not show",
  short = "Seq No never changes",
}

local function measure_rate(group)
  local rate = groups.rate(group) or group.count == 1 and 0 or nil
  if not rate then return nil, nil, "no two messages at different times" end
  return rate, group.last_frame
end

local function measure_gap(group, _, check)
  if group.count == 0 then return nil, nil, NO_VALUE end
  local gap, frame = group.gap_max or 0, group.gap_max_frame
  local to_end = kinds.span(group.last + check.states[group.source].ahead, check.ending.now)
  if to_end > gap then gap, frame = to_end, nil end
  return gap, frame or group.last_frame
end

local function measure_range(group, rule)
  local values = group.values[rule.want]
  if values.seen == 0 then return nil, nil, NO_VALUE end
  if values.lets_reserved and values.count == 0 then
    return nil, nil, ALL_RESERVED
  end
  return values.outside, values.frame, ("of %d values"):format(values.seen), values.worst
end

-- Count the values outside of the range: none may be.
local function want_range(rule, field)
  local want = { field = field, low = rule.low, high = rule.high }
  rule.low, rule.high = -INFINITE, 0
  return want
end

local function want_numbers(rule, field)
  local want = want_range(rule, field)
  want.lets_reserved = true
  return want
end

local function measure_mean(group, rule)
  local values = group.values[rule.want]
  if values.seen == 0 then return nil, nil, NO_VALUE end
  if values.count == 0 then return nil, nil, ALL_RESERVED end
  return groups.row(group, values).mean, nil, ("of %d values"):format(values.count)
end

-- Divide the mean of a source by the median of the other sources' means.
local function measure_ratio(group, rule, check)
  local own, _, note = measure_mean(group, rule)
  if not own then return nil, nil, note end
  local means = {}
  for _, other in ipairs(check.list) do
    local is_other = other ~= group and other.type == group.type
    means[#means + 1] = is_other and measure_mean(other, rule) or nil
  end
  if not means[1] then return nil, nil, "no other source of it has a value" end
  note = ("of %s"):format(output.count(#means, "other source"))
  local middle = groups.median(means)
  if middle == 0 then return nil, nil, "the median of the other sources is 0" end
  return own / middle, nil, note
end

local function measure_reserved(group, rule)
  local values = group.values[rule.want]
  if values.seen == 0 then return nil, nil, NO_VALUE end
  return (values.seen - values.count) / values.seen, nil, ("of %d values"):format(values.seen)
end

-- Count the values with another flag than those that the rule names, "only=ready+running".
local function want_only(rule, field)
  local flags, allowed, others = field.flags, 0, 0
  input.demand(flags, "%s.%s has no flags", rule.message.name, field.name)
  for name in rule.text:match("=(.*)$"):gmatch("[^+]+") do
    local flag, names = input.find(flags, name)
    input.demand(flag, "%s.%s has no flag %q, but %s", rule.message.name, field.name, name, names)
    allowed = bits.bor(allowed, flag.mask)
  end
  for _, flag in ipairs(flags) do
    if bits.band(flag.mask, allowed) == 0 then others = bits.bor(others, flag.mask) end
  end
  rule.high = 0
  return { field = field, mask = others, low = 0, high = 0 }
end

-- The note names the flags of the worst value.
local function measure_only(group, rule)
  local values = group.values[rule.want]
  if values.seen == 0 then return nil, nil, NO_VALUE end
  local names = {}
  for _, flag in ipairs(values.field.flags) do
    local is_set = values.worst and bits.band(values.worst, flag.mask) ~= 0
    if is_set then names[#names + 1] = flag.name end
  end
  names[#names + 1] = ("of %d values"):format(values.seen)
  return values.outside, values.frame, table.concat(names, ", ")
end

local function measure_spread(_, rule, check)
  local spread = check.spreads[rule.want]
  if not spread.worst then return nil, nil, "no two sources of it have a value at one time" end
  return spread.worst, spread.frame
end

-- name     of the measure
-- text     a rule of it, as errors and docs/statistics.md name it
-- help     its meaning, for people
-- measure  see above
-- bound    the limit that a number is: "low" or "high"; is_count = true if it has no fraction
-- takes_range  true if the limit may be A..B, A.. or ..B; nothing else if there is no bound.
--              Without both the limit is no number, and want sets it
-- want     of a field: function(rule, field) -> an entry of Groups:wants; nil: { field = field }
-- needs_past, needs_time, can_fall, scope  as in rows of kinds

--- MESSAGE.NAME=LIMIT
M.OF_MESSAGE = {
  {
    name = "count",
    text = "MESSAGE.count=N",
    help = "at least N messages came",
    measure = function(group) return group.count, group.last_frame end,
    bound = "low",
    is_count = true,
  },
  {
    name = "rate",
    text = "MESSAGE.rate=A..B",
    help = "the mean rate lies within these Hz",
    measure = measure_rate,
    bound = "low",
    takes_range = true,
    needs_past = true,
    needs_time = true,
    can_fall = true,
  },
  {
    name = "gap",
    text = "MESSAGE.gap=S",
    help = "no gap between two messages is longer than S seconds",
    measure = measure_gap,
    bound = "high",
    needs_past = true,
    needs_time = true,
  },
}

--- MESSAGE.FIELD=LIMIT of the first row, MESSAGE.FIELD.NAME=LIMIT of the others.
M.OF_FIELD = {
  {
    name = "range",
    text = "MESSAGE.FIELD=A..B",
    help = "all values lie within",
    measure = measure_range,
    takes_range = true,
    want = want_range,
  },
  {
    name = "numbers",
    text = "MESSAGE.FIELD.numbers=A..B",
    help = "all values but reserved ones lie within",
    measure = measure_range,
    takes_range = true,
    want = want_numbers,
  },
  {
    name = "mean",
    text = "MESSAGE.FIELD.mean=A..B",
    help = "the mean of all values but reserved ones lies within",
    measure = measure_mean,
    takes_range = true,
    can_fall = true,
  },
  {
    name = "ratio",
    text = "MESSAGE.FIELD.ratio=A..B",
    help = "the mean, divided by the median of the other sources' means, lies within",
    measure = measure_ratio,
    takes_range = true,
    can_fall = true,
  },
  {
    name = "reserved",
    text = "MESSAGE.FIELD.reserved=X",
    help = "at most this share of the values is reserved, 0.05 for 5 %",
    measure = measure_reserved,
    bound = "high",
    can_fall = true,
  },
  {
    name = "only",
    text = "MESSAGE.FIELD.only=FLAG+FLAG",
    help = "no flag but these is ever set",
    measure = measure_only,
    want = want_only,
  },
  {
    name = "spread",
    text = "MESSAGE.FIELD.spread=X",
    help = "the spread of all sources is never more than X",
    measure = measure_spread,
    bound = "high",
    scope = "capture",
    needs_time = true,
    want = function(_, field) return { field = field, is_spread = true } end,
  },
}

--- All of these rows.
M.LIST = joined(M.OF_MESSAGE, M.OF_FIELD)

-- Kinds of event ----------------------------------------------------------------------------------

-- How many events of a kind there are.
local function count_events(group, rule)
  local kind = rule.kind
  local count = groups.count(group, kind.name)
  local needed = kind.needs_values and group.decoded or kind.needs_past and group.count
  if needed == 0 then return nil, nil, NO_VALUE end
  return count.seen, count.frame, count.values.note
end

-- The kinds that count in another way, by name.
local of_kind = {}

function of_kind.absent(_, rule, check)
  local names, is_named, others = {}, rule.is_default, 0
  for _, row in ipairs(check.context.settings.sources:list()) do
    if M.is_of(rule, row) and row.type then
      is_named = true
      if check.absent[row] then names[#names + 1] = row.name or output.bus_and_id(row) end
    elseif M.is_of(rule, row) then
      others = others + 1
    end
  end
  if not is_named then return nil, nil, "no source is named with a message: see yapp.sources" end
  local count, more = #names, output.count(others, "name") .. " without a message not judged"
  if others > 0 then names[count + 1] = more end
  return count, nil, table.concat(names, ", ")
end

function of_kind.missing(group, rule, check)
  local seen, frame, note = count_events(group, rule)
  if group.count > 1 and not check.states[group.source].is_numbered then note = SAME_SEQ end
  return seen, frame, note
end

-- Rules -------------------------------------------------------------------------------------------

--- Return whether a rule is about a source, by the name that it gives.
function M.is_of(rule, source)
  return not rule.source or source.name == rule.source
end

--- Measure the subject of a rule; see above.
function M.measure(group, rule, check)
  local kind = rule.kind
  return (kind.measure or of_kind[kind.name] or count_events)(group, rule, check)
end

return M
