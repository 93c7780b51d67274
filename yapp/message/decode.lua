-- SPDX-License-Identifier: GPL-2.0-or-later
-- From the payload of a message to its values, by the compiled catalogue.  Pure Lua.

local bits = require("yapp.base.bits")
local numbers = require("yapp.message.numbers")
local utf8 = require("yapp.base.utf8")

local M = {}

--- What the reserved counts of compressed floats are, from the top down ("YAPP Float Compression"):
-- the index is what <field>.special says.
M.SPECIALS = {
  [0] = "Not a Number",
  "Positive Infinity",
  "Negative Infinity",
  "Out of Range High",
  "Out of Range Low",
}

local format, concat, band = string.format, table.concat, bits.band

M.MAPPING, M.WORKED_EXAMPLES = numbers.MAPPING, numbers.WORKED_EXAMPLES
M.use_divisor, M.divisor = numbers.use_divisor, numbers.divisor
M.float, M.time = numbers.float, numbers.time

--- The bits that two numbers of 32 bits have in common.
M.band = band

-- What was read last: a table of statistics reads what the packet list has just read.
local latest = {}

--- The raw values of a payload.
-- message  compiled
-- payload  string; may be shorter than the message where a capture cut it: only fields that are
--          whole are read
-- returns  { [index of field] = raw }, without times (see M.time), missing fields and cases that
--          are not chosen; and whether M.remarks has something to say
-- A raw is the integer or the count as sent, but for ieee the number, for a 64 bit integer beyond
-- 2^53 its decimal digits, for strings and bytes the bytes; of a compressed float of seven or eight
-- bytes -1 - n is the reserved count n.
function M.read(message, payload)
  if message == latest.message and payload == latest.payload then
    return latest.raws, latest.look
  end
  local missing = message.size - #payload
  local raws, look = message.read(missing > 0 and payload .. ("\0"):rep(missing) or payload)
  for i, field in ipairs(missing > 0 and message.fields or {}) do
    if field.offset + field.size > #payload then raws[i] = nil end
  end
  latest.message, latest.payload = message, payload
  latest.raws, latest.look = raws, look
  return raws, look
end

-- Values -----------------------------------------------------------------------------------------

--- A time in seconds with nine digits behind the point.
function M.seconds(seconds, nanoseconds)
  if seconds >= 0 and nanoseconds >= 0 then return format("%d.%09d", seconds, nanoseconds) end
  return format("-%d.%09d", -seconds, -nanoseconds)
end

local function escape(char) return format("\\x%02x", char:byte()) end

--- The text of a string field: up to its first NUL; where that is no UTF-8, or has control
-- characters, what is not printable ASCII is written \xNN.
function M.text(raw)
  local text = raw:match("^%Z*")
  if utf8.is_printable(text) then return text end
  return (text:gsub("[%c\128-\255]", escape))
end

--- Bytes as hexadecimal digits.
function M.hex(raw)
  return (raw:gsub(".", function(char) return format("%02x", char:byte()) end))
end

-- The value of a raw by kind, and where there is none which special.
local values = {
  float = numbers.float,
  string = function(_, raw) return M.text(raw) end,
  bytes = function(_, raw) return M.hex(raw) end,
}

function values.ieee(_, raw)
  if raw ~= raw then return nil, 0 end
  if raw - raw ~= 0 then return nil, raw > 0 and 1 or 2 end
  return raw
end

--- The value of a field in its unit, unrounded.
-- raw      from M.read
-- returns  a number; a string for strings, bytes (hexadecimal) and integers beyond 2^53; nil where
--          there is none, and then which special (0 .. 4, as <field>.special has it) for a float
--          that is no number
function M.value(field, raw)
  if not raw then return nil end
  local value_of = values[field.kind]
  if value_of then return value_of(field, raw) end
  return field.scale and raw * field.scale + field.zero or raw
end

-- The digits that a compressed float of so many bytes can carry.
local DIGITS = { 7, 7, 10, 10, 15, 15, 15, 15 }

--- The format of a value with as many digits as its count can carry: "%.7g"; nil for ieee and what
-- is no fraction.
function M.format_of(field)
  if field.kind == "float" then return "%." .. DIGITS[field.size] .. "g" end
  return field.scale and "%.15g" or nil
end

--- A value with the digits that its count can carry, so that a filter with == 1.1 matches.
function M.rounded(field, value)
  local shape = M.format_of(field)
  return shape and tonumber(format(shape, value)) or numbers.shortest(value, field.size)
end

--- The value of a difference of a message, at seven digits; nil where one of its two fields has
-- none.
function M.difference(message, difference, raws)
  local fields, a, b = message.fields, difference.a, difference.b
  local first, second = M.value(fields[a], raws[a]), M.value(fields[b], raws[b])
  return first and second and tonumber(format("%.7g", first - second)) or nil
end

-- Flags ------------------------------------------------------------------------------------------

--- The bits that are set and that no flag of the field defines, as a number.
function M.undefined(field, raw)
  return band(raw, field.undefined)
end

--- The filter names of the flags that are set, undefined bits as one number: "motor_overcurrent,
-- hall_timeout".
function M.flag_names(field, raw)
  local names = {}
  for _, flag in ipairs(field.flags) do
    if band(raw, flag.mask) ~= 0 then names[#names + 1] = flag.name end
  end
  local undefined = M.undefined(field, raw)
  if undefined ~= 0 then names[#names + 1] = format("undefined 0x%x", undefined) end
  return concat(names, ", ")
end

--- The bits of a field, by its index in the message, that are faults and set.
function M.alarms(message, raws, index)
  local raw = raws[index]
  return raw and raw ~= 0 and band(raw, message.fields[index].alarm_bits) or 0
end

--- Whether a fault is set in a message.
function M.has_alarm(message, raws)
  for _, field in ipairs(message.alarms) do
    if M.alarms(message, raws, message.index[field]) ~= 0 then return true end
  end
  return false
end

-- Remarks ----------------------------------------------------------------------------------------

-- What is remarkable in a value, by kind: one or two experts.
local remarks_of = {}

function remarks_of.float(field, raw)
  return M.value(field, raw) == nil and "value.special" or nil
end

remarks_of.ieee = remarks_of.float

function remarks_of.flags(field, raw)
  local alarm = band(raw, field.alarm_bits) ~= 0 and "fault.active" or nil
  local undefined = M.undefined(field, raw) ~= 0 and "flags.undefined" or nil
  return alarm or undefined, alarm and undefined
end

function remarks_of.uint(field, raw)
  local is_defined = not field.values or field.values[raw]
  return not (is_defined and (not field.cases or field.cases[raw])) and field.invalid or nil
end

remarks_of.int = remarks_of.uint

function remarks_of.bool(field, raw)
  return (raw > 1 or field.cases and not field.cases[raw]) and field.invalid or nil
end

--- What is remarkable in the values: one entry an expert item.
-- message  compiled
-- raws     from M.read
-- returns  a list of { index of field, expert }, nil when there is nothing
function M.remarks(message, raws)
  local remarks = {}
  for i, field in ipairs(message.fields) do
    local raw, experts_of = raws[i], remarks_of[field.kind]
    if raw and experts_of then
      for _, expert in ipairs { experts_of(field, raw) } do
        remarks[#remarks + 1] = { i, expert }
      end
    end
  end
  return remarks[1] and remarks or nil
end

return M
