-- SPDX-License-Identifier: GPL-2.0-or-later
-- What stands behind -z yapp,...: from the text to options and rules.  Pure Lua, 5.2 to 5.5.

local KINDS = require("yapp.stat.tell").KINDS

local M = {}

M.WHATS = { "summary", "faults", "events", "compare", "csv", "check" }

-- Rules of what may happen N times.
local COUNTED = {}
for _, kind in ipairs(KINDS) do
  if not kind.counts_as then COUNTED[#COUNTED + 1] = kind.name end
end
local MEASURES = { count = true, rate = true, gap = true }
local RULES = table.concat(COUNTED, "=N, ") .. "=N, MESSAGE.count=N, MESSAGE.rate=HZ, " ..
  "MESSAGE.gap=S, MESSAGE.FIELD=A..B, MESSAGE.FIELD.spread=X, source=NAME, junit=FILE, json, " ..
  "filter=EXPRESSION"
local RANGE = "a range is A..B, A.. or ..B"

local function set_of(list)
  local set = {}
  for _, one in ipairs(list) do set[one] = true end
  return set
end
local IS_WHAT, IS_COUNTED = set_of(M.WHATS), set_of(COUNTED)

local function find(list, name)
  for _, one in ipairs(list) do
    if one.name == name then return one end
  end
end

local function names_of(list)
  local names = {}
  for i, one in ipairs(list) do names[i] = one.name end
  return table.concat(names, ", ")
end

-- A number as people write it; nil for a hexadecimal one, nan, inf or a text.
local function number(text)
  if not text:find("^[+-]?[%d.]+[eE]?[+-]?%d*$") then return nil end
  local value = tonumber(text)
  return value and value - value == 0 and value or nil
end

local function count(text)
  return text:find("^%d+$") and tonumber(text) or nil
end

-- The limit of a rule: so many, or a number that is not below 0.
local function limited(rule, what, limit, value)
  rule.limit = limit
  if limit and limit >= 0 then return rule end
  return nil, ("%q is not a %s"):format(value, what)
end

-- A..B, A.. or ..B
local function range_rule(rule, value)
  local low, high = value:match("^(.-)%.%.(.*)$")
  if not low or value == ".." then return nil, RANGE end
  rule.kind, rule.low, rule.high = "range", number(low), number(high)
  if low ~= "" and not rule.low or high ~= "" and not rule.high then return nil, RANGE end
  if not (rule.low and rule.high and rule.low > rule.high) then return rule end
  return nil, "nothing lies in this range"
end

-- MESSAGE.FIELD=A..B and MESSAGE.FIELD.spread=X
local function field_rule(rule, name, value)
  local message, spread_of = rule.message, name:match("^(.*)%.spread$")
  local field = message.by_name[spread_of or name]
  if not field then
    local fields = names_of(message.fields)
    return nil, ("%s has no field %q, but %s"):format(message.name, spread_of or name, fields)
  end
  if field.kind == "string" or field.kind == "bytes" then
    return nil, ("%s.%s is a text, which has no range"):format(message.name, field.name)
  end
  rule.field = field
  if not spread_of then return range_rule(rule, value) end
  rule.kind = "spread"
  if rule.source then return nil, "a spread is of all sources, not of one" end
  return limited(rule, "spread", number(value), value)
end

-- "fault=0", "motor.rate=9.5", "motor.dc_voltage=40..55": { text, source, kind = one of COUNTED, of
-- MEASURES, "range" or "spread", limit = number, message, field, low, high }; nil and what is wrong
local function read_rule(text, catalogue, source)
  local rule = { text = text, source = source }
  local name, value = text:match("^([^=]*)=(.*)$")
  if IS_COUNTED[name] then
    rule.kind = name
    return limited(rule, "number of messages", count(value), value)
  end
  local message_name, rest = (name or ""):match("^([^.]+)%.(.+)$")
  if not message_name then return nil, "a rule is one of " .. RULES end
  rule.message = find(catalogue.messages, message_name)
  if not rule.message then
    local names = names_of(catalogue.messages)
    return nil, ("there is no message %q, but %s"):format(message_name, names)
  end
  if not MEASURES[rest] then return field_rule(rule, rest, value) end
  rule.kind = rest
  return limited(rule, rest, rest == "count" and count(value) or rest ~= "count" and number(value),
    value)
end

local function complain(options, part, why)
  if part == "" then part = "an empty option" end
  options.problems[#options.problems + 1] = part .. ": " .. why
end

local read = {}
local OF_CSV = { replace = true, all = true, json = true }

function read.csv(options, parts, catalogue)
  options.folder = table.remove(parts, 1) or ""
  if options.folder == "" then
    return complain(options, "csv", "it is csv,FOLDER or csv,-,MESSAGE")
  end
  local is_printed = options.folder == "-"
  for _, part in ipairs(parts) do
    if OF_CSV[part] then
      options[part] = true
    elseif is_printed and not options.chosen then
      options.chosen = find(catalogue.messages, part)
      if not options.chosen then
        complain(options, part, "there is no such message in the catalogue")
      end
    else
      complain(options, part, "the options of csv are replace, all, json, filter=EXPRESSION")
    end
  end
  if not is_printed or options.problems[1] then return end
  if not options.chosen then complain(options, "csv,-", "it is csv,-,MESSAGE") end
  if options.json then complain(options, "json", "csv,- prints a table; json is for csv,FOLDER") end
end

-- The rules where the user gave none: all is well.
local function all_rules(source)
  local rules = {}
  for _, kind in ipairs(COUNTED) do
    if not KINDS[kind].by_wish then
      rules[#rules + 1] =
        { text = kind .. "=0", kind = kind, limit = 0, source = source, is_default = true }
    end
  end
  return rules
end

local function complain_of_unused(options, part)
  if part then complain(options, part, "no rule follows: it is for those behind it") end
end

function read.check(options, parts, catalogue)
  local rules = {}
  local source, unused, is_unknown -- unused: "source=NAME", before a rule comes
  for _, part in ipairs(parts) do
    local name, value = part:match("^(%w+)=(.*)$")
    if part == "json" then
      options.json = true
    elseif name == "junit" then
      options.junit = value
      if value == "" then complain(options, part, "the file is missing") end
    elseif name == "source" then
      complain_of_unused(options, unused)
      source, unused = value, part
      if value == "" then complain(options, part, "the name is missing") end
    else
      local rule, problem = read_rule(part, catalogue, source)
      unused, is_unknown = nil, is_unknown or name == "unknown"
      rules[#rules + 1] = rule
      if problem then complain(options, part, problem) end
    end
  end
  if not rules[1] and not options.problems[1] then
    rules = all_rules(source)
  else
    complain_of_unused(options, unused)
    -- What was not decoded was not checked.
    if not is_unknown then rules[#rules + 1] = read_rule("unknown=0", catalogue) end
  end
  options.rules = rules
end

local function read_plain(options, parts)
  local known = ("the options of %s are json, filter=EXPRESSION"):format(options.what)
  for _, part in ipairs(parts) do
    if part == "json" then options.json = true else complain(options, part, known) end
  end
end

--- Reads the argument of -z.
-- text       "yapp,check,fault=0,motor.rate=9,filter=can.bus_id == 1, or so"
-- catalogue  compiled
-- returns    { what =, json = true or nil, filter = or nil, folder =, chosen =, replace =, all =,
--            rules =, junit =, problems = list of texts, each with the option that it is about }
function M.read(text, catalogue)
  local at = text:find(",filter=", 1, true) -- what follows is a display filter, commas and all
  local filter, parts = at and text:sub(at + 8), {}
  for part in (text:sub(1, (at or 0) - 1) .. ","):gmatch("([^,]*),") do parts[#parts + 1] = part end
  local is_ours = table.remove(parts, 1) == "yapp"
  local options = { what = table.remove(parts, 1) or "", filter = filter, problems = {} }
  if not is_ours or not IS_WHAT[options.what] then
    complain(options, text, "it is yapp," .. table.concat(M.WHATS, " or yapp,"))
  else
    (read[options.what] or read_plain)(options, parts, catalogue)
  end
  if filter and not filter:find("%S") then
    complain(options, "filter=", "the display filter is missing")
  end
  return options
end

return M
