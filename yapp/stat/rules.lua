-- SPDX-License-Identifier: GPL-2.0-or-later
-- The rules of `check`: their measures, a row each, and how they are read.  The list of rules in
-- errors, the help and the verdicts follow from the rows.  Pure Lua, 5.2 to 5.5.
--
-- A rule is {
--   text     as the user wrote it: name=limit and suffixes
--   source   name of the only source that it judges, nil for all
--   kind     a row of stat.kinds, or of the measures below
--   low, high  the limits of what its measure returns
--   message, field  compiled, nil for a rule about none
--   points   the limits of each value of the field, where the measure counts those outside: a list
--            of one { low, high }; of `over` of several, with x = a value of the field `other`
--   tests    the condition of the messages that it judges: list of { field, low, high }, with mask
--            of a flag, whose value is 0 or 1; condition = its text
--   after    seconds for which they must have held
--   hold     seconds for which values must be outside
--   measure  see below; needs_time = true if it can be judged only with time stamps
--   is_default  true if it stands for `check` without rules }
-- Its values are those of stat.judge.

local groups = require "yapp.stat.groups"
local input = require "yapp.base.input"
local joined = require "yapp.base.joined"
local judge = require "yapp.stat.judge"
local kinds = require "yapp.stat.kinds"
local mapped = require "yapp.base.mapped"
local output = require "yapp.stat.output"

local M = {}

local choose, decimal, demand, find = input.choose, input.decimal, input.demand, input.find

local INFINITE = math.huge
local RANGE = "a range is A..B, A.. or ..B, from the lower to the higher end"
local POINTS = "the points are X:A..B;X:A..B, from the lowest X to the highest"

--- Return whether a rule is about a source, by the name that it gives.
function M.is_of(rule, source)
  return not rule.source or source.name == rule.source
end

-- Limits ------------------------------------------------------------------------------------------
--
-- These functions read the lowest and the highest value of what a measure returns, and the points
-- of a rule about each value.  They raise errors.

local function read_number(text)
  local value = decimal(text)
  return demand(value and value >= 0 and value, "%q is not a number", text)
end

local function at_most(text)
  return -INFINITE, read_number(text)
end

local function within(text)
  local low, high = text:match("^(.-)%.%.(.*)$")
  low = low == "" and -INFINITE or decimal(low or "")
  high = high == "" and INFINITE or decimal(high or "")
  demand(low and high and low <= high and text ~= "..", RANGE)
  return low, high
end

local function at_least_or_within(text)
  if text:find("..", 1, true) then return within(text) end
  return read_number(text), INFINITE
end

local function each_within(text)
  local low, high = within(text)
  return -INFINITE, 0, { { low = low, high = high } } -- of how many values lie outside
end

local function each_within_at_points(text)
  local points, last = {}, -INFINITE
  for part in text:gmatch("[^;]+") do
    local x, range = part:match("^(.-):(.*)$")
    local point = { x = decimal(x or "") }
    point.low, point.high = within(range or "")
    demand(point.x and point.x > last and point.high - point.low < INFINITE, POINTS)
    points[#points + 1], last = point, point.x
  end
  return -INFINITE, 0, points
end

-- Measures ----------------------------------------------------------------------------------------
--
-- A measure is a function(group, rule, check), which returns the value to judge, nil for none; its
-- frame; a note; and of stat.judge the value that is nearest to a limit, or farthest outside.

local function measure_gap(group, _, check)
  if group.count == 0 then return nil end
  local gap, to_end = group.gap_max or 0, check.ending.length_since(group.last)
  return math.max(gap, to_end), gap >= to_end and group.gap_max_frame or group.last.frame
end

-- A measure of the values that a rule judged.
local function measure_values(group, rule, check)
  local series, kind = group.values[rule], rule.kind
  local found, note = series.worst or series.nearest, judge.describe(series)
  -- Where a rule says how many values may be reserved, all may be.
  local special = ("%s.%s.special"):format(rule.message.name, rule.field.name)
  local may_be = (rule.points or kind.name == "special") and check.options.rules[special]
  if series.seen == 0 or series.count == 0 and not may_be then return nil, nil, note end
  return kind.value(series), found and found.frame, note, found
end

local function count_outside(series) return series.outside end
local function mean_of(series) return series.sum / series.count end

-- Divide the mean of a source by the median of the other sources' means.
local function measure_ratio(group, rule, check)
  local own, _, note = measure_values(group, rule, check)
  if not own then return nil, nil, note end
  local means = mapped(check.list, function(other)
    local is_other = other ~= group and other.type == group.type
    return is_other and measure_values(other, rule, check)
  end)
  local middle = means[1] and groups.median(means) or 0
  if middle == 0 then return nil end
  return own / middle, nil, ("of %s"):format(output.count(#means, "other source"))
end

-- name     of the measure
-- text     a rule of it, as errors and docs/rules.md name it
-- help     its meaning, for people
-- limits   see above; nil for at_most
-- measure  see above; or value = function(series of stat.judge) -> what it is, and
--          add = function(series, number), where the series must gather more; nil for none
-- is_count true if it has no margin
-- needs_past, needs_time, sees_end, can_mend, scope  as in rows of kinds

--- MESSAGE.NAME=LIMIT
M.OF_MESSAGE = input.rows("name text help", {
  {
    "count",
    "MESSAGE.count=N",
    "at least N messages came",
    limits = at_least_or_within,
    measure = function(group) return group.count, group.last and group.last.frame end,
    is_count = true,
    can_mend = true,
  },
  {
    "rate",
    "MESSAGE.rate=A..B",
    "the mean rate lies within these Hz",
    limits = at_least_or_within,
    measure = function(group) return groups.rate(group), group.last and group.last.frame end,
    needs_past = true,
    needs_time = true,
    can_mend = true,
  },
  {
    "gap",
    "MESSAGE.gap=S",
    "no gap between two messages is longer than S seconds",
    measure = measure_gap,
    needs_past = true,
    needs_time = true,
    sees_end = true,
  },
})

--- MESSAGE.FIELD=LIMIT of the first row, MESSAGE.FIELD.NAME=LIMIT of all; they may have suffixes.
M.OF_FIELD = input.rows("name text help", {
  {
    "value",
    "MESSAGE.FIELD=A..B",
    "all values but reserved ones lie within",
    limits = each_within,
    value = count_outside,
  },
  {
    "over",
    "MESSAGE.FIELD.over(OTHER)=X:A..B;X:A..B",
    "all lie within limits that depend on OTHER, linear between the points X",
    limits = each_within_at_points,
    value = count_outside,
  },
  {
    "special",
    "MESSAGE.FIELD.special=X",
    "at most this share of the values is reserved, 0.05 for 5 %",
    value = function(series) return (series.seen - series.count) / series.seen end,
    can_mend = true,
  },
  {
    "mean",
    "MESSAGE.FIELD.mean=A..B",
    "the mean of all values but reserved ones lies within",
    limits = within,
    value = mean_of,
    can_mend = true,
  },
  {
    "ratio",
    "MESSAGE.FIELD.ratio=A..B",
    "the mean, divided by the median of the other sources' means, lies within",
    limits = within,
    measure = measure_ratio,
    value = mean_of,
    can_mend = true,
  },
  {
    "noise",
    "MESSAGE.FIELD.noise=X",
    "values lie in the mean at most X from the mean of their neighbours",
    add = judge.add_noise,
    value = function(series) return series.noise / math.max(series.noisy, 1) end,
    can_mend = true,
  },
  {
    "spread",
    "MESSAGE.FIELD.spread=X",
    "the spread of all sources is never more than X",
    measure = function(_, rule, check)
      local spread = check.spreads[rule]
      return spread.worst, spread.frame
    end,
    scope = "capture",
    needs_time = true,
  },
})

--- All of these rows.
M.LIST = joined(M.OF_MESSAGE, M.OF_FIELD)

-- How many events of a kind there are.
local function count_events(group, rule)
  local kind = rule.kind
  local count = group.counts[kind.name]
  local needed = kind.needs_values and group.decoded or kind.needs_past and group.count
  if needed == 0 then return nil end
  return count.seen, count.frame, count.values.note
end

-- The kinds that count in another way, by name.
local of_kind = {}

function of_kind.absent(_, rule, check)
  local rows = mapped(check.context.settings.sources.rows, function(row)
    return row.type and M.is_of(rule, row) and row
  end)
  if not (rows[1] or rule.is_default) then
    return nil, nil, "no source is named with a message: see yapp.sources"
  end
  local names = mapped(rows, function(row)
    return check.absent[row] and (row.name or output.bus_and_id(row))
  end)
  return #names, nil, table.concat(names, ", ")
end

function of_kind.missing(group, rule, check)
  local seen, frame, note = count_events(group, rule)
  local is_numbered = check.ending.events.by_source[group.source].is_numbered
  return seen, frame, not is_numbered and "Seq No is constant" or note
end

-- Reading -----------------------------------------------------------------------------------------
--
-- These functions raise errors.

local function find_field(message, name)
  return choose(joined(message.fields, message.generated), name, "field")
end

-- Return the test of a part of a condition: FLAG, !FLAG, FIELD=NUMBER or FIELD=A..B.
local function parse_test(message, text)
  local sign, name, value = text:match("^(!?)([^=]*)=?(.*)$")
  if value ~= "" then
    local low, high = within(decimal(value) and value .. ".." .. value or value)
    return { field = find_field(message, sign .. name), low = low, high = high }
  end
  local flags, state = {}, sign == "" and 1 or 0
  for _, field in ipairs(message.flag_fields) do
    for _, flag in ipairs(field.flags) do
      flags[#flags + 1] = {
        name = flag.filter:sub(#message.filter + 2), -- status.enabled
        field = field,
        mask = flag.mask,
        low = state,
        high = state,
      }
    end
  end
  return choose(flags, name, "flag")
end

--- What may stand behind a rule about values; key = where the rule has its number.
M.SUFFIXES = input.rows("name text help", {
  {
    "when",
    "when=CONDITION",
    "judge only while it holds, a flag or a range",
  },
  {
    "after",
    "after=S",
    "only once it has held for S seconds",
    key = "after",
  },
  {
    "for",
    "for=S",
    "fail only if values are outside for S seconds",
    key = "hold",
  },
})

-- Set what stands behind a rule: " when=C after=S for=S".
local function set_suffixes(rule, text)
  rule.condition = text:gsub(" for=%S*", "")
  for name, value in text:gmatch("([^ =]+)=?(%S*)") do
    local suffix = choose(M.SUFFIXES, name, "suffix")
    demand(rule.points or rule.field and name ~= "for",
      "%s= is for rules about values, such as motor.dc_voltage=40..55", name)
    if suffix.key then
      rule[suffix.key] = read_number(value)
    else
      for part in value:gmatch("[^&]+") do
        table.insert(rule.tests, parse_test(rule.message, part))
      end
    end
  end
  rule.needs_time = rule.kind.needs_time or rule.after > 0 or rule.hold > 0
end

-- Set what a rule is about: COUNT, MESSAGE.NAME, MESSAGE.FIELD, MESSAGE.FIELD.NAME or
-- MESSAGE.FIELD.over(OTHER).
local function set_subject(rule, options)
  rule.kind = find(kinds.RULES, rule.name)
  if rule.kind then return end
  local message, word, measure, other =
    rule.name:match("^([^.]+)%.([^.]+)%.?(%l*)%(?([^()]*)%)?$")
  local _, names = find(joined(kinds.RULES, M.LIST))
  demand(message, "no rule %q; known: %s; options are %s, filter=EXPRESSION", rule.name, names,
    options.row.options)
  rule.message = choose(options.catalogue.messages, message, "message")
  rule.kind = measure == "" and find(M.OF_MESSAGE, word)
  if rule.kind then return end
  -- A field of the user's may have the name of a measure: NAME.value is the field.
  rule.kind = choose(M.OF_FIELD, measure == "" and "value" or measure, "measure")
  rule.field = find_field(rule.message, word)
  rule.other = rule.kind.name == "over" and find_field(rule.message, other)
end

--- Read a rule: "fault=0", "motor.rate=9.5", "motor.dc_voltage=40..55 when=status.enabled for=1".
-- options  of stat.options: source = name of the only source that it judges, or nil
function M.parse(text, options)
  text = text:gsub("%s+", " "):gsub(" ?= ?", "=")
  local name, limit, suffixes = text:match("^([^=]*)=?(%S*)(.*)$")
  local rule = {
    text = text,
    name = name,
    limit = limit,
    source = options.source,
    tests = {},
    after = 0,
    hold = 0,
  }
  set_subject(rule, options)
  local kind = rule.kind
  rule.measure = kind.measure or kind.value and measure_values or of_kind[kind.name] or count_events
  rule.low, rule.high, rule.points = (kind.limits or at_most)(limit)
  set_suffixes(rule, suffixes)
  return rule
end

return M
