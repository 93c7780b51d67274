-- SPDX-License-Identifier: GPL-2.0-or-later
-- The rules of -z yapp,check: from their text to what is judged.  Pure Lua, 5.2 and 5.4.

local M = {}

M.COUNTED = { fault = true, crc = true, incomplete = true, reboot = true, stale = true, unknown = true }
M.NAMES = "fault=N, crc=N, incomplete=N, reboot=N, stale=N, unknown=N, MESSAGE.count=N, MESSAGE.rate=HZ, " ..
  "MESSAGE.gap=S, MESSAGE.FIELD=A..B, source=NAME, junit=FILE, json, filter=EXPRESSION"
local MEASURES = { count = true, rate = true, gap = true }

-- A number as people write it; nil for a hexadecimal one, nan, inf or a text.
local function number(text)
  if not text:find("^[+-]?[%d.]+[eE]?[+-]?%d*$") then return nil end
  local value = tonumber(text)
  return value and value - value == 0 and value or nil
end

local function count(text)
  return text:find("^%d+$") and tonumber(text) or nil
end

local function names_of(list)
  local names = {}
  for i, one in ipairs(list) do names[i] = one.name end
  return table.concat(names, ", ")
end

-- MESSAGE.FIELD=A..B
local function range_rule(rule, message, name, low, high)
  local field = message.by_name[name]
  if not field then
    return nil, ("%s has no field %q, but %s"):format(message.name, name, names_of(message.fields))
  end
  if field.kind == "string" or field.kind == "bytes" then
    return nil, ("%s.%s is a text, which has no range"):format(message.name, name)
  end
  rule.kind, rule.field, rule.low, rule.high = "range", field, number(low), number(high)
  if low ~= "" and not rule.low or high ~= "" and not rule.high or low == "" and high == "" then
    return nil, "a range is A..B, A.. or ..B"
  end
  if rule.low and rule.high and rule.low > rule.high then return nil, "nothing lies in this range" end
  return rule
end

local function message_rule(rule, catalogue, message_name, name, value)
  for _, message in ipairs(catalogue.messages) do
    if message.name == message_name then rule.message = message end
  end
  if not rule.message then
    return nil, ("there is no message %q, but %s"):format(message_name, names_of(catalogue.messages))
  end
  local low, high = value:match("^(.-)%.%.(.*)$")
  if low then return range_rule(rule, rule.message, name, low, high) end
  if not MEASURES[name] then
    return nil, rule.message.by_name[name] and "a range is A..B, A.. or ..B" or
      ("%s is count, rate, gap or a field with a range, not %q"):format(rule.message.name, name)
  end
  rule.kind, rule.limit = name, name == "count" and count(value) or name ~= "count" and number(value)
  if not rule.limit or rule.limit < 0 then return nil, ("%q is not a %s"):format(value, name) end
  return rule
end

--- Reads one rule.
-- text       "fault=0", "motor.rate=9.5", "motor.dc_voltage=40..55"
-- catalogue  compiled
-- source     name that the rule is about, or nil for all
-- returns    { text =, source =, kind = "fault" ... "unknown", "count", "rate", "gap" or "range", limit = number,
--            message =, field =, low =, high = }; nil and what is wrong with it
function M.read(text, catalogue, source)
  local rule = { text = text, source = source }
  local name, value = text:match("^([^=]*)=(.*)$")
  if not name then return nil, "a rule is one of " .. M.NAMES end
  if M.COUNTED[name] then
    rule.kind, rule.limit = name, count(value)
    if not rule.limit then return nil, ("%q is not a number of messages"):format(value) end
    return rule
  end
  local message_name, what = name:match("^([^.]+)%.([^.]+)$")
  if not message_name then return nil, "a rule is one of " .. M.NAMES end
  return message_rule(rule, catalogue, message_name, what, value)
end

return M
