-- SPDX-License-Identifier: GPL-2.0-or-later
-- From the payload of a message to its values, by the compiled catalogue: numbers as they lie
-- there, little endian ("YAPP Data Types", "YAPP Float Compression", "Time"), what they mean, and
-- what is remarkable in them.  Pure Lua.

local band = require("yapp.base.bits").band
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

local byte, format, concat = string.byte, string.format, table.concat
local HUGE = math.huge

--- The bits that two numbers of 32 bits have in common.
M.band = band

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
  local exponent = d % 0x80 * 2 + (c >= 0x80 and 1 or 0)
  return ieee(d >= 0x80 and -1 or 1, exponent, c % 0x80 * 0x10000 + b * 0x100 + a, 0xFF, 23)
end

-- Eight bytes as two halves of 32 bits, of the magnitude, and whether the number is negative.
local function halves(payload, at, signed)
  local a, b, c, d, e, f, g, h = byte(payload, at, at + 7)
  local low = a + b * 0x100 + c * 0x10000 + d * 0x1000000
  local high = e + f * 0x100 + g * 0x10000 + h * 0x1000000
  if not signed or h < 0x80 then return high, low, false end
  if low == 0 then return 0x100000000 - high, 0, true end -- two's complement: invert, add one
  return 0xFFFFFFFF - high, 0x100000000 - low, true
end

local BILLION = 1000000000

-- Long division by 10^9, 16 bits a step: no intermediate leaves the exact range of a double.
local function divide(high, low)
  if high < 0x200000 then -- all of it is exact
    local number = high * 0x100000000 + low
    local rest = number % BILLION
    return (number - rest) / BILLION, rest
  end
  local quotient, rest = 0, 0
  for i = 1, 4 do
    local half = i < 3 and high or low
    local limb = i % 2 == 1 and (half - half % 0x10000) / 0x10000 or half % 0x10000
    rest = rest * 0x10000 + limb
    local left = rest % BILLION
    quotient, rest = quotient * 0x10000 + (rest - left) / BILLION, left
  end
  return quotient, rest
end

--- An IEEE 754 number of eight bytes, 1-based at.
function M.float64(payload, at)
  local high, low = halves(payload, at)
  local positive = high % 0x80000000
  local rest = positive % 0x100000
  local sign = high == positive and 1 or -1
  return ieee(sign, (positive - rest) / 0x100000, rest * 2 ^ 32 + low, 0x7FF, 52)
end

--- An integer of eight bytes: a number up to 2^53, beyond that its decimal digits as a string.
-- payload  string; at: 1-based; signed: whether it is in two's complement
function M.integer64(payload, at, signed)
  local high, low, negative = halves(payload, at, signed)
  if high < 0x200000 then
    local number = high * 0x100000000 + low
    return negative and -number or number
  end
  local billions, rest = divide(high, low)
  return format("%s%.0f%09.0f", negative and "-" or "", billions, rest)
end

--- A signed 64 bit count of nanoseconds ("Time"), split exactly.
-- payload  string; offset: 0-based
-- returns  seconds, nanoseconds; both negative, or zero, for a negative time
function M.time(payload, offset)
  local high, low, negative = halves(payload, offset + 1, true)
  local seconds, rest = divide(high, low)
  if negative then return -seconds, -rest end
  return seconds, rest
end

--- The count of a compressed float of seven or eight bytes, as near as a double comes; -1 - n for
-- the reserved count that is n below the highest.
function M.count(payload, at, size)
  local count, reserved = 0.0, true
  for i = size - 1, 0, -1 do
    local b = byte(payload, at + i)
    count, reserved = count * 0x100 + b, reserved and b >= (i > 0 and 0xFF or 0xFB)
  end
  return reserved and byte(payload, at) - 0x100 or count
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
  if raw < 0 then return nil, -1 - raw end -- of M.count
  -- One division at the end, so that the middle of a symmetric range is 0 and not nearly 0.
  local steps = field.top - divisor
  return (field.min * steps + raw * (field.max - field.min)) / steps
end

-- The nearest number that four bytes can hold: what a sum with a large number leaves of it.
local function to_float32(value)
  local is_normal = math.abs(value) >= 2 ^ -126
  local large = is_normal and value * (2 ^ 29 + 1) or 1.5 * 2 ^ -97
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

--- A time in seconds with nine digits behind the point.
function M.seconds(seconds, nanoseconds)
  if seconds >= 0 and nanoseconds >= 0 then return format("%d.%09d", seconds, nanoseconds) end
  return format("-%d.%09d", -seconds, -nanoseconds)
end

--- The text of a string field: up to its first NUL, fit to be printed.
function M.text(raw)
  return utf8.printable(raw:match("^%Z*"))
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
  if field.kind == "float" then return "%." .. DIGITS[field.size] .. "g" end
  return field.scale and "%.15g" or nil
end

--- A value with the digits that its count can carry, so that a filter with == 1.1 matches.
function M.rounded(field, value)
  local shape = M.format_of(field)
  if shape then return tonumber(format(shape, value)) end
  return field.size == 4 and M.shortest(value) or value
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
  return field.cases and not field.cases[raw] or field.kind == "bool" and raw > 1
end

--- What is remarkable in the values: one entry an expert item.
-- message  compiled
-- raws     from M.read
-- returns  a list of { index of field, expert }, nil when there is nothing
function M.remarks(message, raws)
  local remarks = {}
  local function add(i, expert) remarks[#remarks + 1] = { i, expert } end
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
