-- SPDX-License-Identifier: GPL-2.0-or-later
-- The numbers in the bytes of a payload, little endian ("YAPP Data Types", "Time"): integers of any
-- size, IEEE 754, times; and their shortest texts.  Pure Lua.

local M = {}

local abs, floor = math.abs, math.floor
local byte, format = string.byte, string.format

--- Return the number of so many bytes, rounded to a double.
-- index  in the payload, 1-based
function M.count(payload, index, size)
  local count = size > 6 and 0.0 or 0 -- COMPAT 5.4: integers of eight bytes wrap around
  for i = index + size - 1, index, -1 do
    count = count * 0x100 + byte(payload, i)
  end
  return count
end

--- Return an IEEE 754 number.
-- digits  bits of its mantissa: 23 of four bytes, 52 of eight
function M.ieee(payload, index, size, digits)
  local bits_of_exponent = 8 * size - 1 - digits
  local a, b = byte(payload, index + size - 2, index + size - 1)
  local high = 2 ^ (15 - bits_of_exponent) -- the two highest bytes: sign, exponent, digits
  local top = b % 0x80 * 0x100 + a
  local exponent = floor(top / high)
  local mantissa = top % high * 2 ^ (digits - 15 + bits_of_exponent) +
    M.count(payload, index, size - 2)
  local sign, highest = b >= 0x80 and -1 or 1, 2 ^ bits_of_exponent - 1
  if exponent == highest then return mantissa == 0 and sign * math.huge or 0 / 0 end
  local bias = (highest - 1) / 2 + digits
  if exponent == 0 then return sign * (mantissa * 2 ^ (1 - bias)) end
  return sign * (mantissa + 2 ^ digits) * 2 ^ (exponent - bias)
end

local BILLION = 1000000000

-- Divide an integer of eight bytes by 10^9.
-- returns  the quotient, and the rest, of the same sign
local function divide(payload, index, is_signed)
  local a, b, c, d, e, f, g, h = byte(payload, index, index + 7)
  if h == 0 and g < 0x20 then -- the usual one: a double holds it
    local high = e + f * 0x100 + g * 0x10000
    local number = high * 0x100000000 + d * 0x1000000 + c * 0x10000 + b * 0x100 + a
    local rest = number % BILLION
    return (number - rest) / BILLION, rest
  end
  -- Long division, a byte a step.  The highest byte of a negative number counts as negative.
  local quotient, rest = 0, is_signed and h >= 0x80 and h - 0x100 or h
  for i = index + 6, index, -1 do
    local dividend = rest * 0x100 + byte(payload, i)
    rest = dividend % BILLION
    quotient = quotient * 0x100 + (dividend - rest) / BILLION
  end
  if quotient < 0 and rest > 0 then return quotient + 1, rest - BILLION end
  return quotient, rest
end

--- Return an integer of eight bytes: a number up to 2^53, beyond that its decimal digits.
function M.integer64(payload, index, is_signed)
  local billions, rest = divide(payload, index, is_signed)
  if abs(billions) < 9007199 then return billions * BILLION + rest end
  return format("%.0f%09.0f", billions, abs(rest))
end

--- Split a signed 64 bit count of nanoseconds exactly ("Time").
-- payload  string
-- offset   0-based
-- returns  seconds, nanoseconds; both negative, or zero, for a negative time
function M.time(payload, offset)
  return divide(payload, offset + 1, true)
end

-- Round to a number that four bytes can hold: adding and subtracting a large number rounds off the
-- digits below it.
local function to_float32(value)
  local large = 1.5 * 2 ^ -97
  if abs(value) >= 2 ^ -126 then large = value * (2 ^ 29 + 1) end
  return large - (large - value)
end

--- Return the number with the fewest digits that is equal as a float of four bytes: 0.1 for
-- 0.10000000149.
-- value  finite
function M.shortest(value)
  if value == 0 then return value end -- COMPAT 5.4: the text "-0" is an integer there
  for digits = 6, 8 do
    local short = tonumber(format("%." .. digits .. "g", value))
    if to_float32(short) == value then return short end
  end
  return tonumber(format("%.9g", value))
end

--- Return a time in seconds as a text with nine digits behind the point.
function M.seconds(seconds, nanoseconds)
  if seconds < 0 or nanoseconds < 0 then
    return format("-%d.%09d", -seconds, -nanoseconds)
  end
  return format("%d.%09d", seconds, nanoseconds)
end

return M
