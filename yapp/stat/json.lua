-- SPDX-License-Identifier: GPL-2.0-or-later
-- JSON lines with their keys in a fixed order.  Pure Lua, 5.2 and 5.4.

local M = {}

local format = string.format

local ESCAPES = { ['"'] = '\\"', ["\\"] = "\\\\", ["\n"] = "\\n", ["\r"] = "\\r", ["\t"] = "\\t" }

local function text(value)
  local plain = value
  -- Bytes that are no UTF-8 would make the line unreadable for all.
  local ascii = require("yapp.base.utf8").ascii(value)
  if ascii:find("[\128-\255]") then plain = ascii:gsub("[\128-\255]", "?") end
  return '"' .. plain:gsub('[%c"\\]', function(c) return ESCAPES[c] or format("\\u%04x", c:byte()) end) .. '"'
end

-- The shortest text that reads back as the same number; null for what JSON has no number for.
local function number(value)
  if value ~= value or value == math.huge or value == -math.huge then return "null" end
  if value % 1 == 0 and value > -2 ^ 53 and value < 2 ^ 53 then return format("%d", value) end
  local shown = format("%.15g", value)
  return tonumber(shown) == value and shown or format("%.17g", value)
end

--- A value: string, number, boolean, nil (null), or { json = text } for what is JSON already.
function M.value(value)
  local kind = type(value)
  if kind == "number" then return number(value) end
  if kind == "string" then return text(value) end
  if kind == "table" then return value.json end
  return value == nil and "null" or tostring(value)
end

--- An object of these keys, in this order, with the values that a table has under them; what it has not is null.
function M.object(keys, values)
  local parts = {}
  for i, key in ipairs(keys) do parts[i] = text(key) .. ":" .. M.value(values[key]) end
  return "{" .. table.concat(parts, ",") .. "}"
end

--- A list of values.
function M.list(values)
  local parts = {}
  for i, value in ipairs(values) do parts[i] = M.value(value) end
  return "[" .. table.concat(parts, ",") .. "]"
end

--- What is JSON already, as a value.
function M.raw(json)
  return { json = json }
end

--- A time of the capture with nine digits, as text.
-- seconds, nanoseconds  integers, nanoseconds 0 .. 999,999,999
function M.time_text(seconds, nanoseconds)
  if seconds < 0 and nanoseconds > 0 then -- -1 s and 9e8 ns are -0.1 s
    return format("-%d.%09d", -seconds - 1, 1000000000 - nanoseconds)
  end
  return format("%d.%09d", seconds, nanoseconds)
end

--- The same as a number.
function M.time(seconds, nanoseconds)
  return { json = M.time_text(seconds, nanoseconds) }
end

--- A span in seconds with nine digits, nil for nil.
function M.seconds(value)
  return value and { json = (format("%.9f", value):gsub("^%-(0%.0+)$", "%1")) }
end

return M
