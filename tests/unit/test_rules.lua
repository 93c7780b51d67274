-- SPDX-License-Identifier: GPL-2.0-or-later
-- Rules about values: random rules over random messages, against a model that knows nothing of the plugin's.
-- Times are whole milliseconds, and numbers are exact: values lie on limits, gaps last just as long as they may.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local answers = require("answers")
local catalogue_of = require("yapp.message.catalogue")
local judge = require("yapp.stat.judge")
local levels = require("levels")
local mapped = require("yapp.base.mapped")
local memo = require("yapp.base.memo")
local options_of = require("yapp.stat.options")
local rules_of = require("yapp.stat.rules")

local T = { setUp = answers.setUp, tearDown = answers.tearDown }

local LATE, INFINITE = 250, math.huge -- ms: 2.5 periods of 100
local CATALOGUE, PROBLEMS = catalogue_of.compile {
  { name = "m", title = "M", id = 0x210, size = 5, every = 0.1,
    { "a", "float8", "A", min = 0, max = 250 }, { "b", "float8", "B", min = -125, max = 125 },
    { "c", "float8", "C", min = 0, max = 25 }, { "mode", "uint8", "Mode", values = { [0] = "off", [1] = "on" } },
    { "bits", "uint8", "Bits", group = "state", flags = { { "on", 0x01, "On" }, { "slow", 0x30, "Slow" } } },
    differences = { { "d", "a", "b", "D" } } },
}
lu.assertEquals(PROBLEMS, {})
local SOURCES = {}
for i = 1, 3 do SOURCES[i] = { bus_key = 1, bus = "can0", id = i, name = "s" .. i, type = CATALOGUE.messages[1] } end

local function pick(...) return (select(math.random(select("#", ...)), ...)) end

-- Messages of the sources by time, { at = ms, frame, source, values by field, flags, is_reboot }, and their events.
local function random_messages()
  local messages, events = {}, {}
  for _, source in ipairs(SOURCES) do
    local at, counts, flags = math.random(0, 99), { math.random(250), math.random(250), math.random(250) }, {}
    for i = 1, 60 do
      at = at + (math.random(20) > 1 and pick(60, 100, 100, 140, LATE, LATE + 1) or math.random(260, 900))
      local one = { at = at, source = source, mode = pick(0, 1, 1, 1), bytes = "" }
      one.is_reboot = i > 1 and math.random(50) == 1
      for field = 1, 3 do
        counts[field] = math.max(0, math.min(250, counts[field] + math.random(-25, 25)))
        local is_number = math.random(15) > 1
        one.bytes = one.bytes .. string.char(is_number and counts[field] or pick(251, 255))
        one[field] = is_number and counts[field] or nil
      end
      for name, bits in pairs { on = 0x01, slow = pick(0x10, 0x20, 0x30) } do
        if math.random(10) == 1 then flags[name] = not flags[name] and bits or nil end
      end
      one.on, one.slow = flags.on, flags.slow
      one.a, one.b, one.c = one[1], one[2] and one[2] - 125, one[3] and one[3] / 10
      one.d = one.a and one.b and one.a - one.b
      one.bytes = one.bytes .. string.char(one.mode, (flags.on or 0) + (flags.slow or 0))
      messages[#messages + 1] = one
    end
  end
  table.sort(messages, function(x, y) return x.at * 9 + x.source.id < y.at * 9 + y.source.id end)
  for frame, one in ipairs(messages) do
    one.frame = frame
    local change = one.is_reboot and { reboot = 5 } or nil
    events[frame] = answers.record(frame, one.at / 1000, { source = one.source, payload = one.bytes, change = change })
  end
  events[#events + 1] = answers.record(#events + 1, events[#events].time) -- another message
  return messages, events
end

-- Random rules ---------------------------------------------------------------------------------------------------

local LOW, HIGH = { a = 0, b = -125, c = 0, d = -100, mode = 0 }, { a = 250, b = 125, c = 25, d = 300, mode = 1 }

local function random_ends(field, has_both)
  local low, high = math.random(LOW[field], HIGH[field]), math.random(LOW[field], HIGH[field])
  low, high = math.min(low, high), math.max(low, high)
  local kind = has_both and 5 or math.random(5)
  return kind == 1 and -INFINITE or low, kind == 2 and INFINITE or high
end

local function range_text(low, high)
  return (low == -INFINITE and "" or low) .. ".." .. (high == INFINITE and "" or high)
end

-- A part of a condition: its text, and whether it holds; nil where a value is reserved.
local function random_test()
  local kind = math.random(4)
  if kind == 1 then return "mode=1", function(one) return one.mode == 1 end end
  if kind == 2 then
    local field = pick("a", "b", "c", "d")
    local low, high = random_ends(field)
    return field .. "=" .. range_text(low, high), function(one)
      local value = one[field]
      return value and value >= low and value <= high
    end
  end
  local flag, is_not = pick("on", "slow"), kind == 3
  return (is_not and "!" or "") .. "state." .. flag, function(one) return (one[flag] ~= nil) ~= is_not end
end

local MEASURES = mapped(rules_of.OF_FIELD, function(row) return row.name == "value" and "" or row.name end)
local function random_rule()
  local field, words, limit = pick("a", "b", "c", "d", "mode"), {}
  local measure = pick("", "", "over", rawget(table, "unpack")(MEASURES))
  local rule = { field = field, measure = measure, tests = {}, after = pick(0, 0, 300, 1000), hold = 0, points = {} }
  if measure == "over" then
    rule.other = pick("a", "b")
    local first = LOW[rule.other] + pick(0, 32)
    for i = 1, math.random(2, 3) do
      local low, high = random_ends(field, true)
      rule.points[i] = { x = first + 64 * i, low = low, high = high }
      words[i] = rule.points[i].x .. ":" .. range_text(low, high)
    end
    measure, limit = ("over(%s)"):format(rule.other), table.concat(words, ";")
  elseif measure == "" or measure == "mean" or measure == "ratio" then
    rule.low, rule.high = random_ends(field)
    limit = range_text(rule.low, rule.high)
    if measure == "" then rule.points[1] = { low = rule.low, high = rule.high } end
  else
    limit = measure == "special" and pick(0, 0.0625, 0.125) or math.random(0, 200)
    rule.low, rule.high = -INFINITE, limit
  end
  words = {}
  for i = 1, pick(0, 1, 1, 2) do words[i], rule.tests[i] = random_test() end
  rule.condition = words[1] and " when=" .. table.concat(words, "&") or ""
  if rule.after > 0 then rule.condition = rule.condition .. (" after=%g"):format(rule.after / 1000) end
  local has_hold = (rule.measure == "" or rule.measure == "over") and math.random(2) == 1
  if has_hold then rule.hold = pick(200, 500, 1000) end
  rule.text = ("m.%s%s=%s%s"):format(field, measure == "" and "" or "." .. measure, limit, rule.condition) ..
    (has_hold and (" for=%g"):format(rule.hold / 1000) or "")
  return rule
end

-- The model ------------------------------------------------------------------------------------------------------

-- Sets which messages of a source a rule judges, one.is_judged, nil where nothing tells; and the number of the
-- stretch that each belongs to, which a gap, a reboot, or a condition that does not hold ends.
local function choose_judged(rule, messages)
  local stretch, since, last = 0, nil, nil
  for _, one in ipairs(messages) do
    local is_unknown, is_false = false, false
    if one.is_reboot or last and one.at - last > LATE then since, stretch = nil, stretch + 1 end
    last = one.at
    for _, test in ipairs(rule.tests) do
      local holds = test(one)
      is_unknown, is_false = is_unknown or holds == nil, is_false or holds == false
    end
    one.is_judged, one.stretch = nil, stretch
    if is_false then
      one.is_judged, since, stretch = false, nil, stretch + 1
    elseif not is_unknown then
      since = since or one.at
      one.is_judged = one.at - since >= rule.after
    end
  end
end

local function limits_of(rule, one)
  local x, points = one[rule.other], rule.points
  if not rule.other then return points[1].low, points[1].high end
  for i = 2, x and #points or 0 do
    local from, to = points[i - 1], points[i]
    if x >= from.x and x <= to.x then
      local function between(a, b) return a + (b - a) * (x - from.x) / 64 end
      return between(from.low, to.low), between(from.high, to.high)
    end
  end
end

local function percent_of(margin, low, high)
  local range = high - low
  if range == INFINITE then range = math.min(math.abs(low), math.abs(high)) end
  return range > 0 and tonumber(("%.3g"):format(margin / range * 100)) or nil
end

-- The value nearest to a limit, or farthest outside; and how many values break the rule.
local function find_worst(rule, messages)
  local row, best, worst, outside = {}, nil, nil, 0
  for _, one in ipairs(messages) do
    local value, low, high = one[rule.field]
    if one.is_judged and value then low, high = limits_of(rule, one) end
    if low then
      local found = { value = value, frame = one.frame, at = one.at, low = low, high = high }
      found.margin = math.min(value - low, high - value)
      if found.margin >= 0 or row[1] and row.stretch ~= one.stretch then row = {} end
      if not best or found.margin < best.margin then best = found end
      if found.margin < 0 then
        row[#row + 1], row.stretch = found, one.stretch
        if one.at - row[1].at >= rule.hold then
          for _, member in ipairs(row) do
            if not member.is_counted then outside = outside + 1 end
            member.is_counted = true
            if not worst or member.margin < worst.margin then worst = member end
          end
        end
      end
    end
  end
  return worst or best, outside
end

local function mean_distance(rule, messages)
  local row, sum, count = {}, 0, 0
  for _, one in ipairs(messages) do
    if one.is_judged and one[rule.field] then
      if row.stretch ~= one.stretch then row = { stretch = one.stretch } end
      row[#row + 1] = one[rule.field]
      if row[3] then sum, count = sum + math.abs(row[#row - 1] - (row[#row - 2] + row[#row]) / 2), count + 1 end
    end
  end
  return sum / math.max(1, count)
end

-- Of a source: how many values are judged, how many of them are numbers, their mean; how many lie outside the points.
local function count_values(rule, messages)
  local found = { seen = 0, count = 0, beyond = 0, sum = 0 }
  for _, one in ipairs(messages) do
    if one.is_judged and rule.other and not limits_of(rule, one) then
      found.beyond = found.beyond + 1
    elseif one.is_judged then
      found.seen = found.seen + 1
      if one[rule.field] then found.count, found.sum = found.count + 1, found.sum + one[rule.field] end
    end
  end
  return found
end

-- The verdict on a source: { ok, seen, frame, worst, margin, percent, note }, each nil for null.
-- may_be_reserved  true if another rule says how many values may be
local function verdict_of(rule, by_source, source, may_be_reserved)
  local found, counted, means, row = nil, {}, {}, {}
  for i, messages in ipairs(by_source) do
    choose_judged(rule, messages)
    counted[i] = count_values(rule, messages)
    if i ~= source and counted[i].count > 0 then means[#means + 1] = counted[i].sum / counted[i].count end
  end
  local own, messages = counted[source], by_source[source]
  if own.beyond > 0 then
    row.note = ("of %d values, %.3g %% more never judged: %s outside the points"):format(own.count,
      own.beyond / (own.beyond + own.seen) * 100, rule.other)
  elseif own.seen == 0 and rule.condition ~= "" then
    row.note = "the condition never held:" .. rule.condition
  elseif own.count > 0 then
    row.note = ("of %d values"):format(own.count)
  end
  local has_limits = rule.measure == "" or rule.measure == "over"
  if own.seen > 0 and (own.count > 0 or rule.measure == "special" or has_limits and may_be_reserved) then
    if has_limits then
      found, row.seen = find_worst(rule, messages)
    elseif rule.measure == "special" then
      row.seen = (own.seen - own.count) / own.seen
    elseif rule.measure == "noise" then
      row.seen = mean_distance(rule, messages)
    elseif rule.measure == "mean" or means[1] then
      table.sort(means)
      local middle = means[2] and (means[1] + means[2]) / 2 or means[1]
      row.seen = own.sum / own.count
      if rule.measure == "ratio" then
        row.note = means[2] and "of 2 other sources" or "of 1 other source"
        row.seen = middle ~= 0 and row.seen / middle or nil
        if middle == 0 then row.note = nil end
      end
    else
      row.note = nil -- a ratio to no other source
    end
  end
  if not row.seen then
    row.note = row.note or answers.TOO_FEW .. rule.condition
    return row
  end
  local low, high = rule.low, rule.high
  if has_limits then low, high = 0, 0 end
  row.ok = row.seen >= low - 1e-12 and row.seen <= high + 1e-12
  row.frame, row.worst = found and found.frame, found and found.value
  if found and rule.field == "mode" then return row end
  found = found or { margin = math.min(row.seen - low, high - row.seen), low = low, high = high }
  row.margin, row.percent = found.margin, percent_of(found.margin, found.low, found.high)
  if row.ok and row.percent and row.percent < 5 then
    local mark = row.percent < 0 and "outside, but not for so long" or "close to its limit"
    row.note = row.note and row.note .. ", " .. mark or mark
  end
  return row
end

-- The verdict on the spread of all sources: of the latest values, none older than LATE.
local function verdict_of_spread(rule, messages, by_source)
  local latest, row = {}, {}
  for _, own in ipairs(by_source) do choose_judged(rule, own) end
  for _, one in ipairs(messages) do
    local low, high, count = INFINITE, -INFINITE, 0
    local is_known = one.is_judged ~= nil
    if is_known then latest[one.source] = { at = one.at, value = one.is_judged and one[rule.field] or nil } end
    for _, other in pairs(is_known and latest or {}) do
      if other.value and one.at - other.at <= LATE then
        low, high, count = math.min(low, other.value), math.max(high, other.value), count + 1
      end
    end
    local apart = math.floor((high - low) * 10 + 0.5) / 10
    if count > 1 and apart > (row.seen or -1) then row.seen, row.frame = apart, one.frame end
  end
  if not row.seen then return { note = answers.TOO_FEW .. rule.condition } end
  row.ok, row.margin = row.seen <= rule.high, rule.high - row.seen
  row.percent = percent_of(row.margin, rule.low, rule.high)
  if row.ok and row.percent and row.percent < 5 then row.note = "close to its limit" end
  return row
end

-- Rows of JSON by rule and source.
local function read_rows(printed)
  local rows = {}
  for _, line in ipairs(answers.lines(printed)) do
    local rule, source, note = line:match('"rule":"(.-)".-"source":"?([^",]*).*"note":"?(.-)"?}$')
    local row = { note = note ~= "null" and note or nil }
    for key, value in line:gmatch('"(%l+)":([%l%d.e+-]+)') do
      if value == "true" or value == "false" then row[key] = value == "true" else row[key] = tonumber(value) end
    end
    row.id, row.limit = nil, nil
    rows[rule .. " " .. source] = row
  end
  return rows
end

function T.test_random_rules()
  for seed = 1, levels.size(40, 1000) do
    math.randomseed(seed)
    local messages, events = random_messages()
    local rules, texts, has_special, by_source = {}, {}, {}, { {}, {}, {} }
    for _, one in ipairs(messages) do table.insert(by_source[one.source.id], one) end
    for i = 1, 12 do
      rules[i] = random_rule()
      texts[i] = rules[i].text
      if rules[i].measure == "special" then has_special[rules[i].field] = true end
    end
    local what = "check,json," .. table.concat(texts, ",")
    local rows = read_rows((answers.run({ what }, events, { catalogue = CATALOGUE })))
    for _, rule in ipairs(rules) do
      local is_spread = rule.measure == "spread"
      for i = 1, is_spread and 1 or 3 do
        local expected = is_spread and verdict_of_spread(rule, messages, by_source) or
          verdict_of(rule, by_source, i, has_special[rule.field])
        local found, where = rows[rule.text .. (is_spread and " null" or " s" .. i)], seed .. ": " .. rule.text
        local percent = expected.percent or 0
        lu.assertAlmostEquals(found.percent or 0, percent, math.abs(percent) / 199, where) -- three digits, but for ties
        found.percent = expected.percent
        lu.assertAlmostEquals(found, expected, 1e-9, where)
        lu.assertEquals({ found.worst, found.note }, { expected.worst, expected.note }, where)
      end
    end
  end
end

-- What `watch` shows: of the numbers that a controller's latest message has, the one nearest to its limit.
function T.test_the_nearest_limit_of_a_message()
  for seed = 1, levels.size(15, 300) do
    math.randomseed(seed)
    local messages, events = random_messages()
    local texts, rules = {}, {}
    for i = 1, 3 do
      rules[i] = random_rule()
      texts[i] = rules[i].text
    end
    local options = options_of.parse("yapp,check," .. table.concat(texts, ","), CATALOGUE)
    local state = judge.new({ options = options, spreads = memo(function() return {} end) }, SOURCES[1].type)
    local before, seen = nil, {}
    for frame, one in ipairs(messages) do
      if one.source == SOURCES[1] then
        judge.add(state, events[frame], LATE / 1000, before)
        before, seen[#seen + 1] = events[frame], one
        local least = nil
        for _, rule in ipairs(rules) do
          choose_judged(rule, seen)
          local value, low, high = one[rule.field]
          if one.is_judged and value and rule.points[1] then low, high = limits_of(rule, one) end
          local share = low and percent_of(math.min(value - low, high - value), low, high)
          if share and not (least and least.share <= share) then
            least = { text = rule.text, value = value, share = share }
          end
        end
        local found = judge.latest(state, frame)
        if found then found = { text = found.rule.text, value = found.value, share = found.room } end
        lu.assertEquals(found, least)
      end
    end
    lu.assertNil(judge.latest(state, 0))
  end
end

return T
