-- SPDX-License-Identifier: GPL-2.0-or-later
-- What stands behind -z yapp,...: from the text to options and rules.  Pure Lua, 5.2 to 5.5.

local input, words = require("yapp.message.check"), require("yapp.stat.output").words

local M = {}

local demand, set = input.demand, input.set

M.WHATS = { "summary", "faults", "events", "compare", "csv", "check" }

-- The kinds of events that `check` alone judges, in this order; skipped bytes it does not: a shell
-- may write between the frames.
local ILLS = "fault crc incomplete reboot stale silence invalid absent unknown"
-- What may happen N times; what of a message's coming has a limit.
local COUNTED, MEASURES = set(ILLS .. " skipped"), set("count rate gap")
local RULES = (ILLS .. " skipped"):gsub("%S+", "%0=N,") .. " MESSAGE.count=N, MESSAGE.rate=HZ, " ..
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
  return input.is_finite(value) and value or nil
end

-- Functions from here on raise what is wrong.

-- A number that is not below 0; without a fraction where it counts.
local function limit_of(text, what, is_count)
  local value = number(text)
  local is_good = value and value >= 0 and not (is_count and text:find("%D"))
  return demand(is_good and value, "%q is not a %s", text, what)
end

-- An end of a range, which may be left out.
local function end_of(text, none)
  if text == "" then return none end
  return demand(number(text), RANGE)
end

-- A..B, A.. or ..B
local function add_range(rule, text)
  local low, high = text:match("^(.-)%.%.(.*)$")
  demand(low and text ~= "..", RANGE)
  rule.kind = "range"
  rule.low, rule.high = end_of(low, -math.huge), end_of(high, math.huge)
  demand(rule.low <= rule.high, "nothing lies in this range")
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
  rule.kind, rule.is_spread, rule.limit = "spread", true, limit_of(value, "spread")
end

-- "fault=0", "motor.rate=9.5", "motor.dc_voltage=40..55": { text, source, kind = one of COUNTED, of
-- MEASURES, "range" or "spread", limit = number, message, field, low, high }
local function read_rule(text, catalogue, source)
  local name, value = text:match("^([^=]*)=(.*)$")
  local rule = { text = text, source = source, kind = name }
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

local OF_CSV = set("replace all json")

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
  local folder, chosen = options.folder or "", options.chosen
  demand(folder ~= "" and (folder ~= "-" or chosen), "it is csv,FOLDER or csv,-,MESSAGE")
  demand(not (chosen and options.json), "csv,- prints a table; json is for csv,FOLDER")
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
    options.judges_unknown = options.judges_unknown or name == "unknown"
  end
end

function finish.check(options, catalogue)
  local rules = options.rules
  if rules[1] or options.problems[1] then
    -- What was not decoded was not checked.
    if not options.judges_unknown then
      rules[#rules + 1] = read_rule("unknown=0", catalogue)
    end
    demand(not options.unused, "no rule follows %s: it is for those behind it", options.unused)
    return
  end
  for i, kind in ipairs(words(ILLS)) do
    rules[i] = read_rule(kind .. "=0", catalogue, options.source)
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
  table.insert(options.problems, part .. ": " .. why)
end

--- Reads the argument of -z.
-- text       "yapp,check,fault=0,motor.rate=9,filter=can.bus_id == 1, or so"
-- catalogue  compiled
-- returns    { what =, json = true or nil, filter = or nil, folder =, chosen =, replace =, all =,
--            rules =, junit =, problems = list of texts, each with the option that it is about }
function M.read(text, catalogue)
  local head, filter = text:match("^(.-),filter=(.*)$") -- a display filter, commas and all
  local what, rest = (head or text):match("^yapp,([^,]*)(.*)$")
  local problems = {}
  local options = { what = what, filter = filter, rules = {}, problems = problems }
  if not read[what] then
    problems[1] = text .. ": it is yapp," .. table.concat(M.WHATS, " or yapp,")
    return options
  end
  for part in rest:gmatch(",([^,]*)") do
    try(options, part, read[what], part, catalogue)
  end
  if finish[what] then
    try(options, what, finish[what], catalogue)
  end
  if filter and not filter:find("%S") then
    problems[#problems + 1] = "filter=: the display filter is missing"
  end
  return options
end

return M
