-- SPDX-License-Identifier: GPL-2.0-or-later
-- Numbers as they lie in a payload, little endian ("YAPP Data Types", "YAPP Float Compression",
-- "Time").  Pure Lua.

local M = {}

local byte, format = string.byte, string.format
local HUGE = math.huge

--- COMPAT 5.4: a quotient is a float there, and NSTime takes integers only.
local whole = rawget(math, "tointeger") or function(n) return n end

--- An IEEE 754 number of four bytes, 1-based at.
function M.float32(payload, at)
  local a, b, c, d = byte(payload, at, at + 3)
  local sign, exponent = d >= 0x80 and -1 or 1, d % 0x80 * 2 + (c >= 0x80 and 1 or 0)
  local mantissa = c % 0x80 * 0x10000 + b * 0x100 + a
  if exponent == 0xFF then return mantissa == 0 and sign * HUGE or 0 / 0 end
  if exponent == 0 then return sign * (mantissa * 2 ^ -149) end
  return sign * (mantissa + 0x800000) * 2 ^ (exponent - 150)
end

--- An IEEE 754 number of eight bytes, 1-based at.
function M.float64(payload, at)
  local a, b, c, d, e, f, g, h = byte(payload, at, at + 7)
  local sign, exponent = h >= 0x80 and -1 or 1, h % 0x80 * 16 + (g - g % 16) / 16
  local low, high = a + b * 0x100 + c * 0x10000 + d * 0x1000000, e + f * 0x100 + g % 16 * 0x10000
  local mantissa = low + high * 2 ^ 32
  if exponent == 0x7FF then return mantissa == 0 and sign * HUGE or 0 / 0 end
  if exponent == 0 then return sign * (mantissa * 2 ^ -1074) end
  return sign * (mantissa + 2 ^ 52) * 2 ^ (exponent - 1075)
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
  seconds, rest = whole(seconds), whole(rest)
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

-- Half of the distance to the next number that four bytes can hold.
local function half_step(value)
  local size = value < 0 and -value or value
  local exponent = math.floor(math.log(size, 2))
  while 2 ^ exponent > size do exponent = exponent - 1 end -- a logarithm is not exact
  while 2 ^ (exponent + 1) <= size do exponent = exponent + 1 end
  if exponent < -126 then return 2 ^ -150 end
  return 2 ^ (exponent - (2 ^ exponent == size and 25 or 24))
end

--- The number with the fewest digits that is the same in so many bytes: 0.1 for the four bytes
-- nearest to it.
-- value  finite; size: 4 or 8
function M.shortest(value, size)
  if value == 0 then return value end
  if size == 8 then
    local short = tonumber(format("%.15g", value))
    return short == value and short or value
  end
  local half = half_step(value)
  for digits = 6, 8 do
    local short = tonumber(format("%." .. digits .. "g", value))
    if math.abs(short - value) < half then return short end
  end
  return tonumber(format("%.9g", value))
end

return M
