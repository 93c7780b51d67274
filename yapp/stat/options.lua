-- SPDX-License-Identifier: GPL-2.0-or-later
-- What stands behind -z yapp,...: from the text to options and rules.  Pure Lua, 5.2 to 5.5.

local demand = require("yapp.message.check").demand
local KINDS = require("yapp.stat.tell").KINDS

local M = {}

M.WHATS = { "summary", "faults", "events", "compare", "csv", "check" }

-- Rules of what may happen N times, and the texts of those that `check` alone judges.
local COUNTED, ALL_IS_WELL = {}, {}
for _, kind in ipairs(KINDS) do
  if not kind.counts_as then
    COUNTED[#COUNTED + 1], COUNTED[kind.name] = kind.name, true
    if not kind.by_wish then
      ALL_IS_WELL[#ALL_IS_WELL + 1] = kind.name .. "=0"
    end
  end
end
local MEASURES = {
  count = true,
  rate = true,
  gap = true,
}
local RULES = table.concat(COUNTED, "=N, ") .. "=N, MESSAGE.count=N, MESSAGE.rate=HZ, " ..
  "MESSAGE.gap=S, MESSAGE.FIELD=A..B, MESSAGE.FIELD.spread=X, source=NAME, junit=FILE, json, " ..
  "filter=EXPRESSION"
local RANGE = "a range is A..B, A.. or ..B"

-- What has a name in a list; else nil and the names that there are.
local function find(list, name)
  local names = {}
  for i, one in ipairs(list) do
    if one.name == name then return one end
    names[i] = one.name
  end
  return nil, table.concat(names, ", ")
end

-- A number as people write it; nil for a hexadecimal one, nan, inf or a text.
local function number(text)
  local value = text:find("^[+-]?[%d.]+[eE]?[+-]?%d*$") and tonumber(text)
  return value and value - value == 0 and value or nil
end

-- Functions from here on raise what is wrong.

-- A number that is not below 0; without a fraction where it counts.
local function limit_of(text, what, is_count)
  local value = number(text)
  local is_good = value and value >= 0 and not (is_count and text:find("%D"))
  return demand(is_good and value, "%q is not a %s", text, what)
end

-- A..B, A.. or ..B
local function add_range(rule, text)
  local low, high = text:match("^(.-)%.%.(.*)$")
  demand(low and text ~= "..", RANGE)
  rule.kind, rule.low, rule.high = "range", number(low), number(high)
  demand(rule.low or low == "", RANGE)
  demand(rule.high or high == "", RANGE)
  local is_empty = rule.low and rule.high and rule.low > rule.high
  demand(not is_empty, "nothing lies in this range")
end

-- MESSAGE.FIELD=A..B and MESSAGE.FIELD.spread=X
local function add_field(rule, name, value)
  local message = rule.message
  local spread_of = name:match("^(.*)%.spread$")
  local field, names = find(message.fields, spread_of or name)
  demand(field, "%s has no field %q, but %s", message.name, spread_of or name, names)
  demand(field.kind ~= "string" and field.kind ~= "bytes",
    "%s.%s is a text, which has no range", message.name, field.name)
  rule.field = field
  if not spread_of then return add_range(rule, value) end
  demand(not rule.source, "a spread is of all sources, not of one")
  rule.kind, rule.limit = "spread", limit_of(value, "spread")
end

-- "fault=0", "motor.rate=9.5", "motor.dc_voltage=40..55": { text, source, kind = one of COUNTED, of
-- MEASURES, "range" or "spread", limit = number, message, field, low, high }
local function read_rule(text, catalogue, source)
  local name, value = text:match("^([^=]*)=(.*)$")
  local rule = {
    text = text,
    source = source,
    kind = name,
  }
  if COUNTED[name] then
    rule.limit = limit_of(value, "number of messages", true)
    return rule
  end
  local message_name, rest = (name or ""):match("^([^.]+)%.(.+)$")
  demand(message_name, "a rule is one of %s", RULES)
  local message, names = find(catalogue.messages, message_name)
  rule.message = demand(message, "there is no message %q, but %s", message_name, names)
  if MEASURES[rest] then
    rule.kind, rule.limit = rest, limit_of(value, rest, rest == "count")
  else
    add_field(rule, rest, value)
  end
  return rule
end

local OF_CSV = {
  replace = true,
  all = true,
  json = true,
}

-- read.WHAT: takes an option; finish.WHAT, behind the last one: what they come to.
local read, finish = {}, {}

function read.csv(options, part, catalogue)
  if not options.folder then
    options.folder = part
  elseif OF_CSV[part] then
    options[part] = true
  else
    demand(options.folder == "-" and not options.chosen,
      "the options of csv are replace, all, json, filter=EXPRESSION")
    options.chosen = find(catalogue.messages, part)
    demand(options.chosen, "there is no such message in the catalogue")
  end
end

function finish.csv(options)
  local folder = options.folder or ""
  demand(folder ~= "", "it is csv,FOLDER or csv,-,MESSAGE")
  if folder ~= "-" then return end
  demand(options.chosen, "it is csv,-,MESSAGE")
  demand(not options.json, "csv,- prints a table; json is for csv,FOLDER")
end

function read.check(options, part, catalogue)
  local name, value = part:match("^(%w+)=(.*)$")
  if part == "json" then
    options.json = true
  elseif name == "junit" or name == "source" then
    demand(value ~= "", "it is empty")
    options[name] = value
    options.unused = name == "source" and part or options.unused
  else
    options.unused = nil
    table.insert(options.rules, read_rule(part, catalogue, options.source))
  end
end

function finish.check(options, catalogue)
  local rules, is_judged = options.rules, false
  for _, rule in ipairs(rules) do
    is_judged = is_judged or rule.kind == "unknown"
  end
  if rules[1] or options.problems[1] then
    -- What was not decoded was not checked.
    if not is_judged then
      rules[#rules + 1] = read_rule("unknown=0", catalogue)
    end
    demand(not options.unused, "no rule follows %s: it is for those behind it", options.unused)
    return
  end
  for i, text in ipairs(ALL_IS_WELL) do
    rules[i] = read_rule(text, catalogue, options.source)
    rules[i].is_default = true
  end
end

function read.summary(options, part)
  demand(part == "json", "the options of %s are json, filter=EXPRESSION", options.what)
  options.json = true
end

read.faults, read.events, read.compare = read.summary, read.summary, read.summary

-- Calls a function that raises what is wrong with a part.
local function try(options, part, call, ...)
  local ok, why = pcall(call, options, ...)
  if ok then return end
  if part == "" then part = "an empty option" end
  options.problems[#options.problems + 1] = part .. ": " .. why
end

--- Reads the argument of -z.
-- text       "yapp,check,fault=0,motor.rate=9,filter=can.bus_id == 1, or so"
-- catalogue  compiled
-- returns    { what =, json = true or nil, filter = or nil, folder =, chosen =, replace =, all =,
--            rules =, junit =, problems = list of texts, each with the option that it is about }
function M.read(text, catalogue)
  local at = text:find(",filter=", 1, true) -- what follows is a display filter, commas and all
  local parts = {}
  for part in (text:sub(1, (at or 0) - 1) .. ","):gmatch("([^,]*),") do
    parts[#parts + 1] = part
  end
  local what = parts[2] or ""
  local options = {
    what = what,
    filter = at and text:sub(at + 8),
    problems = {},
  }
  if parts[1] ~= "yapp" or not read[what] then
    options.problems[1] = text .. ": it is yapp," .. table.concat(M.WHATS, " or yapp,")
    return options
  end
  options.rules = what == "check" and {} or nil
  for i = 3, #parts do
    try(options, parts[i], read[what], parts[i], catalogue)
  end
  if finish[what] then
    try(options, what, finish[what], catalogue)
  end
  if options.filter and not options.filter:find("%S") then
    options.problems[#options.problems + 1] = "filter=: the display filter is missing"
  end
  return options
end

return M
