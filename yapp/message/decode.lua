-- SPDX-License-Identifier: GPL-2.0-or-later
-- From the payload of a message to its values, by the compiled catalogue: numbers as they lie
-- there, little endian ("YAPP Data Types", "YAPP Float Compression", "Time"), what they mean, and
-- what is remarkable in them.  Pure Lua.

local bits = require("yapp.base.bits")
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

local byte, find, format, sub = string.byte, string.find, string.format, string.sub
local concat = table.concat
local HUGE = math.huge
local band, common = bits.band, bits.common

-- Numbers ----------------------------------------------------------------------------------------

-- An IEEE 754 number from its parts.
-- highest  exponent of infinity; digits: bits of the mantissa
local function ieee(sign, exponent, mantissa, highest, digits)
  if exponent == highest then return mantissa == 0 and sign * HUGE or 0 / 0 end
  local bias = (highest - 1) / 2 + digits
  if exponent == 0 then return sign * (mantissa * 2 ^ (1 - bias)) end
  return sign * (mantissa + 2 ^ digits) * 2 ^ (exponent - bias)
end

--- An IEEE 754 number of four bytes, 1-based at.
function M.float32(payload, at)
  local a, b, c, d = byte(payload, at, at + 3)
  local sign = d >= 0x80 and -1 or 1
  local exponent = d % 0x80 * 2 + (c >= 0x80 and 1 or 0)
  local mantissa = c % 0x80 * 0x10000 + b * 0x100 + a
  return ieee(sign, exponent, mantissa, 0xFF, 23)
end

--- The little endian number of so many bytes, as near as a double comes; 1-based at.
function M.count(payload, at, size)
  local count = 0.0 -- COMPAT 5.4: integers of eight bytes wrap around
  for i = at + size - 1, at, -1 do
    count = count * 0x100 + byte(payload, i)
  end
  return count
end

--- An IEEE 754 number of eight bytes, 1-based at.
function M.float64(payload, at)
  local g, h = byte(payload, at + 6, at + 7)
  local sign = h >= 0x80 and -1 or 1
  local exponent = h % 0x80 * 16 + (g - g % 16) / 16
  local mantissa = g % 16 * 2 ^ 48 + M.count(payload, at, 6)
  return ieee(sign, exponent, mantissa, 0x7FF, 52)
end

local BILLION = 1000000000

-- An integer of eight bytes divided by 10^9: the quotient, and the rest, of the same sign.
local function divide(payload, at, signed)
  local a, b, c, d, e, f, g, h = byte(payload, at, at + 7)
  if h == 0 and g < 0x20 then -- the usual one: a double holds it
    local high = e + f * 0x100 + g * 0x10000
    local number = high * 0x100000000 + d * 0x1000000 + c * 0x10000 + b * 0x100 + a
    local rest = number % BILLION
    return (number - rest) / BILLION, rest
  end
  -- Long division, a byte a step.  Of a negative number the highest byte is below 0.
  local quotient, rest = 0, signed and h >= 0x80 and h - 0x100 or h
  for i = at + 6, at, -1 do
    local dividend = rest * 0x100 + byte(payload, i)
    rest = dividend % BILLION
    quotient = quotient * 0x100 + (dividend - rest) / BILLION
  end
  if quotient < 0 and rest > 0 then return quotient + 1, rest - BILLION end
  return quotient, rest
end

--- An integer of eight bytes: a number up to 2^53, beyond that its decimal digits as a string.
-- payload  string; at: 1-based; signed: whether it is in two's complement
function M.integer64(payload, at, signed)
  local billions, rest = divide(payload, at, signed)
  if math.abs(billions) < 9007199 then return billions * BILLION + rest end
  return format("%.0f%09.0f", billions, math.abs(rest))
end

--- A signed 64 bit count of nanoseconds ("Time"), split exactly.
-- payload  string; offset: 0-based
-- returns  seconds, nanoseconds; both negative, or zero, for a negative time
function M.time(payload, offset)
  return divide(payload, offset + 1, true)
end

--- The count of a compressed float of seven or eight bytes; -1 - n for the reserved count that is n
-- below the highest.
function M.long_count(payload, at, size)
  local lowest, others = byte(payload, at), sub(payload, at + 1, at + size - 1)
  if lowest >= 0xFB and not find(others, "[^\255]") then return lowest - 0x100 end
  return M.count(payload, at, size)
end

-- Compressed floats: floatN <min; max> has counts 0 .. top, top = 2^N - 1.  The five highest are
-- reserved; the others map linearly:  value = min + count * (max - min) / (top - 5).  The
-- document's worked examples divide by top - 4; its mapping table and the 0 A of the captured
-- example prove top - 5.
M.MAPPING = 5
M.WORKED_EXAMPLES = 4

local divisor = M.MAPPING

--- Makes every compressed float divide by top - divisor.
-- new  M.MAPPING, or M.WORKED_EXAMPLES to reproduce the printed figures
function M.use_divisor(new)
  divisor = new
end

--- What compressed floats divide by, as top - divisor.
function M.divisor() return divisor end

--- The value of a compressed float, unrounded; nil and which special (0 .. 4) for a reserved count.
function M.float(field, raw)
  if raw > field.ordinary then return nil, field.top - raw end
  if raw < 0 then return nil, -1 - raw end -- of M.long_count
  -- One division at the end, so that the middle of a symmetric range is 0 and not nearly 0.
  local steps = field.top - divisor
  return (field.min * steps + raw * (field.max - field.min)) / steps
end

-- The nearest number that four bytes can hold: what a sum with a large number leaves of it.
local function to_float32(value)
  local large = 1.5 * 2 ^ -97
  if math.abs(value) >= 2 ^ -126 then large = value * (2 ^ 29 + 1) end
  return large - (large - value)
end

--- The number with the fewest digits that is the same in four bytes: 0.1 for those nearest to it.
-- value  finite
function M.shortest(value)
  if value == 0 then return value end -- COMPAT 5.4: the text "-0" is an integer there
  for digits = 6, 8 do
    local short = tonumber(format("%." .. digits .. "g", value))
    if to_float32(short) == value then return short end
  end
  return tonumber(format("%.9g", value))
end

-- Fields -----------------------------------------------------------------------------------------

-- What was read last: a table of statistics reads what the packet list has just read.
local latest = {}

-- The same as M.read of a payload that is shorter than the message.
local function read_short(message, payload)
  local raws = message.read(payload .. ("\0"):rep(message.size - #payload))
  for i, field in ipairs(message.fields) do
    if field.offset + field.size > #payload then raws[i] = nil end
  end
  return raws, M.remarks(message, raws) ~= nil
end

--- The raw values of a payload.
-- message  compiled
-- payload  string; where it is shorter than the message, only fields that are whole are read; what
--          is behind the message is not read
-- returns  { [index of field] = raw }, without missing fields and cases that are not chosen; and
--          whether M.remarks has something to say
-- A raw is the integer or the count as sent, but for ieee the number, for a 64 bit integer beyond
-- 2^53 its decimal digits, for times (see M.time), strings and bytes the bytes; of a compressed
-- float of seven or eight bytes -1 - n is the reserved count n.
function M.read(message, payload)
  if message == latest.message and payload == latest.payload then
    return latest.raws, latest.look
  end
  local raws, look
  if #payload >= message.size then
    raws, look = message.read(payload)
  else
    raws, look = read_short(message, payload)
  end
  latest.message, latest.payload = message, payload
  latest.raws, latest.look = raws, look
  return raws, look
end

--- A time in seconds with nine digits behind the point.
function M.seconds(seconds, nanoseconds)
  if seconds < 0 or nanoseconds < 0 then
    return format("-%d.%09d", -seconds, -nanoseconds)
  end
  return format("%d.%09d", seconds, nanoseconds)
end

local function escape(char)
  return format("\\x%02x", char:byte())
end

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

--- An integer as a text; beyond 2^53 it is one.
function M.digits(value)
  return type(value) == "number" and format("%.0f", value) or value -- tostring has 14 in Lua 5.2
end

-- The value of a raw by kind, and where there is none which special.
local values = {
  float = M.float,
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
  if field.kind == "derived" then return "%.7g" end
  if field.kind == "float" then return "%." .. DIGITS[field.size] .. "g" end
  return field.scale and "%.15g" or nil
end

--- A value with the digits that its count can carry, so that a filter with == 1.1 matches.
function M.rounded(field, value)
  local shape = M.format_of(field)
  if shape then return tonumber(format(shape, value)) end
  return field.size == 4 and M.shortest(value) or value
end

local OPERATORS = {
  ["*"] = function(a, b) return a * b end,
  ["-"] = function(a, b) return a - b end,
  ["+"] = function(a, b) return a + b end,
}

--- Work out a generated value from its two fields.
-- item     of message.generated
-- returns  a number with seven digits, so that a filter with == matches; nil where one of the two
--          fields has no value
function M.derived(message, item, raws)
  local a = M.value(message.fields[item.a], raws[item.a])
  local b = M.value(message.fields[item.b], raws[item.b])
  if not (a and b) then return nil end
  -- COMPAT 5.4: products of integers wrap around
  local value = OPERATORS[item.operator](a + 0.0, b + 0.0)
  if value - value ~= 0 then return nil end -- too large
  return tonumber(format("%.7g", value))
end

-- Flags ------------------------------------------------------------------------------------------

--- The bits that are set and that no flag of the field defines, as a number.
function M.undefined(field, raw)
  return band(raw, field.undefined)
end

--- The filter names of the flags that are set, undefined bits as one number: "motor_overcurrent,
-- hall_timeout".
function M.flag_names(field, raw)
  if raw == field.named then return field.names end -- most do not change
  local names, flags = {}, field.flags
  for i = 1, #flags do
    if common(raw, flags[i].mask) ~= 0 then names[#names + 1] = flags[i].name end
  end
  local undefined = M.undefined(field, raw)
  if undefined ~= 0 then names[#names + 1] = format("undefined 0x%x", undefined) end
  field.named, field.names = raw, concat(names, ", ")
  return field.names
end

--- The bits of a field that are faults and set.
function M.alarms(field, raw)
  return raw and band(raw, field.alarm_bits) or 0
end

--- Whether a fault is set in a message.
function M.has_alarm(message, raws)
  for _, field in ipairs(message.alarms) do
    if M.alarms(field, raws[message.index[field]]) ~= 0 then return true end
  end
  return false
end

-- Remarks ----------------------------------------------------------------------------------------

local function is_invalid(field, raw)
  if field.values and not field.values[raw] then return true end
  if field.cases and not field.cases[raw] then return true end
  return field.kind == "bool" and raw > 1
end

--- What is remarkable in the values: one entry an expert item.
-- message  compiled
-- raws     from M.read
-- returns  a list of { index of field, expert }, nil when there is nothing
function M.remarks(message, raws)
  local remarks = {}
  local function add(i, expert)
    remarks[#remarks + 1] = { i, expert }
  end
  for i, field in ipairs(message.fields) do
    local raw = raws[i]
    if raw and field.special then
      if M.value(field, raw) == nil then add(i, "value.special") end
    elseif raw and field.flags then
      if M.alarms(field, raw) ~= 0 then add(i, "fault.active") end
      if M.undefined(field, raw) ~= 0 then add(i, "flags.undefined") end
    elseif raw and is_invalid(field, raw) then
      add(i, field.invalid)
    end
  end
  return remarks[1] and remarks or nil
end

return M
