-- SPDX-License-Identifier: GPL-2.0-or-later
-- The rules of `check`: their measures, a row each, and how they are read.  The list of rules in
-- errors, the help and the verdicts follow from the rows.  Pure Lua, 5.2 to 5.5.
--
-- A rule is {
--   text     as the user wrote it; limit = its part behind the first =
--   source   name of the only source that it judges, nil for all
--   kind     a row of stat.kinds, or of the measures below
--   low, high  the limits of what its measure returns
--   message, field  compiled, nil for a rule about none
--   least, most  the limits of each value of the field, where the measure counts those outside; or
--            of `over`: other = a field, points = list of { x = its value, low, high }
--   condition  of the messages that it judges, nil for all: {
--     text     as the user wrote it
--     tests    list of { field, low, high }, with mask of a flag, whose value is 0 or 1
--     after    seconds for which they must have held }
--   hold     seconds for which values must be outside
--   is_default  true if it stands for `check` without rules }
-- Its values are those of stat.judge.

local field_kinds = require "yapp.message.field_kinds"
local groups = require "yapp.stat.groups"
local input = require "yapp.base.input"
local joined = require "yapp.base.joined"
local judge = require "yapp.stat.judge"
local kinds = require "yapp.stat.kinds"
local output = require "yapp.stat.output"

local M = {}

local demand, decimal, find = input.demand, input.decimal, input.find

local INFINITE = math.huge
local NO_VALUE = judge.NO_VALUE
local RANGE = "a range is A..B, A.. or ..B"
local POINTS = "the points are X:A..B;X:A..B, two or more"
local SAME_SEQ = "Seq No is constant"

-- Measures ----------------------------------------------------------------------------------------
--
-- A measure is a function(group, rule, check), which returns the value to judge, its frame, a note,
-- and of stat.judge the value that is nearest to a limit, or farthest outside.  If there is none to
-- judge: nil, nil, why.

local function measure_rate(group)
  local rate = groups.rate(group) or group.count == 1 and 0 or nil
  if not rate then return nil, nil, "no two messages at different times" end
  return rate, group.last.frame
end

local function measure_gap(group, _, check)
  if group.count == 0 then return nil, nil, NO_VALUE end
  local gap, frame = group.gap_max or 0, group.gap_max_frame
  local to_end = check.ending.length_since(group.last)
  if to_end > gap then gap, frame = to_end, nil end
  return gap, frame or group.last.frame
end

-- Return whether a rule judges which share of a field's values is reserved.
local function has_special(check, group, field)
  for _, rule in ipairs(check.options.rules) do
    local is_about = rule.field == field and M.is_of(rule, group.source)
    if is_about and rule.kind.name == "special" then return true end
  end
end

-- A measure of the values that a rule judged.
local function measure_values(group, rule, check)
  local values, kind = group.values[rule], rule.kind
  local why = judge.explain(group.values, rule)
  if not why and values.count == 0 and kind.name ~= "special" then
    local is_known = kind.judges_values and has_special(check, group, rule.field)
    why = not is_known and "all its values are reserved"
  end
  if why then return nil, nil, why end
  local found = values.outside > 0 and values.worst or values.nearest
  return kind.value(values), found.frame, judge.describe(values), found.value and found
end

local function count_outside(values) return values.outside end
local function mean_of(values) return values.sum / values.count end

-- Divide the mean of a source by the median of the other sources' means.
local function measure_ratio(group, rule, check)
  local own, _, note = measure_values(group, rule, check)
  if not own then return nil, nil, note end
  local means = {}
  for _, other in ipairs(check.list) do
    local is_other = other ~= group and other.type == group.type
    means[#means + 1] = is_other and measure_values(other, rule, check) or nil
  end
  if not means[1] then return nil, nil, "no other source of it has a value" end
  note = ("of %s"):format(output.count(#means, "other source"))
  local middle = groups.median(means)
  if middle == 0 then return nil, nil, "the median of the other sources is 0" end
  return own / middle, nil, note
end

local function measure_spread(_, rule, check)
  local spread = check.spreads[rule]
  if spread.worst then return spread.worst, spread.frame end
  local condition = rule.condition and rule.condition.text or ""
  return nil, nil, "no two sources of it have a value at one time" .. condition
end

-- name     of the measure
-- text     a rule of it, as errors and docs/rules.md name it
-- help     its meaning, for people
-- measure  see above; value = function(series of stat.judge) -> what it is
-- bound    the limit that a number is: "low" or "high"; is_count = true if it has no fraction
-- takes_range  true if the limit may be A..B, A.. or ..B; nothing else if there is no bound
-- judges_values  true if the limits are those of each value
-- needs_past, needs_time, can_fall, scope  as in rows of kinds

--- MESSAGE.NAME=LIMIT
M.OF_MESSAGE = {
  {
    name = "count",
    text = "MESSAGE.count=N",
    help = "at least N messages came",
    measure = function(group) return group.count, group.last and group.last.frame end,
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

--- MESSAGE.FIELD=LIMIT of the first row, MESSAGE.FIELD.NAME=LIMIT of the others; all of them may
-- have suffixes.
M.OF_FIELD = {
  {
    name = "range",
    text = "MESSAGE.FIELD=A..B",
    help = "all values but reserved ones lie within",
    measure = measure_values,
    value = count_outside,
    takes_range = true,
    judges_values = true,
  },
  {
    name = "over",
    text = "MESSAGE.FIELD.over(OTHER)=X:A..B;X:A..B",
    help = "all lie within limits that depend on OTHER, linear between the points X",
    measure = measure_values,
    value = count_outside,
    judges_values = true,
  },
  {
    name = "special",
    text = "MESSAGE.FIELD.special=X",
    help = "at most this share of the values is reserved, 0.05 for 5 %",
    measure = measure_values,
    value = function(values) return (values.seen - values.count) / values.seen end,
    bound = "high",
    can_fall = true,
  },
  {
    name = "mean",
    text = "MESSAGE.FIELD.mean=A..B",
    help = "the mean of all values but reserved ones lies within",
    measure = measure_values,
    value = mean_of,
    takes_range = true,
    can_fall = true,
  },
  {
    name = "ratio",
    text = "MESSAGE.FIELD.ratio=A..B",
    help = "the mean, divided by the median of the other sources' means, lies within",
    measure = measure_ratio,
    value = mean_of,
    takes_range = true,
    can_fall = true,
  },
  {
    name = "noise",
    text = "MESSAGE.FIELD.noise=X",
    help = "values lie in the mean at most X from the mean of their neighbours",
    measure = measure_values,
    value = function(values) return values.noisy > 0 and values.noise / values.noisy or 0 end,
    bound = "high",
    can_fall = true,
  },
  {
    name = "spread",
    text = "MESSAGE.FIELD.spread=X",
    help = "the spread of all sources is never more than X",
    measure = measure_spread,
    bound = "high",
    scope = "capture",
    needs_time = true,
  },
}

--- All of these rows.
M.LIST = joined(M.OF_MESSAGE, M.OF_FIELD)

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
  local names, is_named = {}, rule.is_default
  for _, row in ipairs(check.context.settings.sources:list()) do
    if row.type and M.is_of(rule, row) then
      is_named = true
      if check.absent[row] then names[#names + 1] = row.name or output.bus_and_id(row) end
    end
  end
  if not is_named then return nil, nil, "no source is named with a message: see yapp.sources" end
  return #names, nil, table.concat(names, ", ")
end

function of_kind.missing(group, rule, check)
  local seen, frame, note = count_events(group, rule)
  local is_numbered = check.ending.events.by_source[group.source].is_numbered
  if group.count > 1 and not is_numbered then note = SAME_SEQ end
  return seen, frame, note
end

--- Return whether a rule is about a source, by the name that it gives.
function M.is_of(rule, source)
  return not rule.source or source.name == rule.source
end

--- Measure the subject of a rule; see above.
function M.measure(group, rule, check)
  local kind = rule.kind
  return (kind.measure or of_kind[kind.name] or count_events)(group, rule, check)
end

-- Reading -----------------------------------------------------------------------------------------
--
-- These functions raise errors.

-- Return the ends of A..B, A.. or ..B.
local function parse_range(text)
  local low, high = text:match("^(.-)%.%.(.*)$")
  demand(low and text ~= "..", RANGE)
  low = low == "" and -INFINITE or demand(decimal(low), RANGE)
  high = high == "" and INFINITE or demand(decimal(high), RANGE)
  demand(low <= high, "nothing lies in this range")
  return low, high
end

local function parse_number(text, name, is_count)
  local value = decimal(text)
  local is_good = value and value >= 0 and not (is_count and text:find("%D"))
  return demand(is_good and value, "%q is not a number for %s", text, name)
end

-- Return the points of X:A..B;X:A..B.
local function parse_points(text)
  local points, last = {}, -INFINITE
  for part in text:gmatch("[^;]+") do
    local x, low, high = part:match("^(.-):(.-)%.%.(.*)$")
    local point = { x = decimal(x or ""), low = decimal(low or ""), high = decimal(high or "") }
    demand(point.x and point.low and point.high and point.low <= point.high, POINTS)
    demand(point.x > last, "%s does not lie above %s", x, last)
    points[#points + 1], last = point, point.x
  end
  demand(#points > 1, POINTS)
  return points
end

-- Set the limits of a rule by its measure.
local function set_limits(rule, text)
  local measure = rule.kind
  rule.limit = text
  if rule.other then
    rule.points = parse_points(text)
  elseif measure.takes_range and (not measure.bound or text:find("..", 1, true)) then
    rule.low, rule.high = parse_range(text)
  else
    rule[measure.bound] = parse_number(text, measure.name, measure.is_count)
  end
  if not measure.judges_values then return end
  rule.least, rule.most = rule.low, rule.high
  rule.low, rule.high = -INFINITE, 0 -- of how many values lie outside
end

-- Return a field of a message type, whose values are numbers.
local function find_field(message, name)
  local field, names = find(joined(message.fields, message.generated), name)
  demand(field, "%s has no field %q, but %s", message.name, name, names)
  demand(not field_kinds.BY_NAME[field.kind].is_text,
    "%s.%s is a text, which has no range", message.name, field.name)
  return field
end

-- MESSAGE.FIELD, MESSAGE.FIELD.spread and MESSAGE.FIELD.over(OTHER)
local function set_field(rule, name)
  local start, suffix, other = name:match("^(.*)%.(%l+)%(?([^()]*)%)?$")
  local kind = find(M.OF_FIELD, suffix)
  if not kind or (kind.name == "over") ~= (other ~= "") then kind = M.OF_FIELD[1] end
  if kind ~= M.OF_FIELD[1] then name = start end
  rule.kind, rule.field = kind, find_field(rule.message, name)
  rule.other = kind.name == "over" and find_field(rule.message, other) or nil
  local is_of_all = kind.scope == "capture"
  demand(not (rule.source and is_of_all), "a %s is of all sources, not of one", kind.name)
end

-- Return the test of a part of a condition: FLAG, !FLAG, FIELD=NUMBER or FIELD=A..B.
local function parse_test(message, text)
  local sign, name, value = text:match("^(!?)([^=]*)=?(.*)$")
  local flags, state = {}, sign == "" and 1 or 0
  for _, field in ipairs(message.fields) do
    for _, flag in ipairs(field.flags or { field.kind == "bool" and field or nil }) do
      local test = { field = field, mask = flag.mask or 0xFF, low = state, high = state }
      test.name = flag.filter:sub(#message.filter + 2) -- status.enabled
      flags[#flags + 1] = test
    end
  end
  local test, names = find(flags, name)
  demand(not test or value == "", "%s is a flag: write it without a value", name)
  if test then return test end
  demand(value ~= "", "%s has no flag %q, but %s; of a field, give a number or a range",
    message.name, name, names)
  demand(sign == "", "! is for flags")
  local number = decimal(value)
  test = { field = find_field(message, name), low = number, high = number }
  if not number then test.low, test.high = parse_range(value) end
  return test
end

--- What may stand behind a rule about values.
M.SUFFIXES = {
  {
    name = "when",
    text = "when=CONDITION",
    help = "judge only while it holds, a flag or a range",
    set = function(rule, value)
      for part in value:gmatch("[^&]+") do
        table.insert(rule.condition.tests, parse_test(rule.message, part))
      end
    end,
  },
  {
    name = "after",
    text = "after=S",
    help = "only once it has held for S seconds",
    set = function(rule, value) rule.condition.after = parse_number(value, "after") end,
  },
  {
    name = "for",
    text = "for=S",
    help = "fail only if values are outside for S seconds",
    set = function(rule, value)
      local measure = rule.kind
      demand(measure.judges_values, "%s is of all values: for= is for ranges and over",
        measure.name)
      rule.hold = parse_number(value, "for")
    end,
  },
}

-- Set what stands behind a rule: " when=C after=S for=S".
local function set_suffixes(rule, text)
  local condition = { text = text:gsub(" for=%S*", ""), tests = {}, after = 0 }
  rule.condition = condition.text ~= "" and condition or nil
  for word in text:gmatch("%S+") do
    local name, value = word:match("^(%l+)=(.+)$")
    local suffix, names = find(M.SUFFIXES, name)
    demand(suffix, "%s is none of what may follow a rule: %s", word, names)
    demand(rule.field, "%s= is for rules about values, such as motor.dc_voltage=40..55", name)
    suffix.set(rule, value)
  end
end

-- Remove needless blanks: "fault = 0", "motor.rate = 9 .. 11".
local function without_blanks(text)
  text = text:gsub("%s+", " "):gsub(" ?([=&:;]) ?", "%1"):gsub("! ", "!")
  return (text:gsub(" ?%.%.", ".."):gsub("%.%. ([%d.+-])", "..%1"))
end

--- Read a rule: "fault=0", "motor.rate=9.5", "motor.dc_voltage=40..55 when=status.enabled for=1".
-- source   name of the only source that it judges, or nil
-- options  the words that are no rules, for an error
function M.parse(text, catalogue, source, options)
  text = without_blanks(text)
  local name, value, suffixes = text:match("^([^=]*)=(%S*)(.*)$")
  local kind = kinds.BY_NAME[name]
  local rule = { text = text, source = source, kind = kind, low = -INFINITE, high = INFINITE }
  rule.hold = 0
  if not kind or kind.counts_as then
    local message_name, rest = (name or ""):match("^([^.]+)%.(.+)$")
    if not message_name then
      local texts = { table.concat(kinds.RULES, "=N, ") .. "=N" }
      for i, measure in ipairs(M.LIST) do texts[i + 1] = measure.text end
      demand(false, "a rule is one of %s; options are %s", table.concat(texts, ", "), options)
    end
    local message, names = find(catalogue.messages, message_name)
    rule.message = demand(message, "there is no message %q, but %s", message_name, names)
    -- A field of the user's may have the name of a measure: NAME.value is the field.
    local field_name = rest:match("^(.*)%.value$")
    rule.kind = find(M.OF_MESSAGE, rest)
    if not rule.kind then set_field(rule, field_name or rest) end
  end
  set_limits(rule, value)
  set_suffixes(rule, suffixes)
  return rule
end

return M
