-- SPDX-License-Identifier: GPL-2.0-or-later
-- The numbers in the bytes of a payload, little endian ("YAPP Data Types", "Time"): integers of one
-- to eight bytes, IEEE 754, times; and their texts.  Pure Lua.

local M = {}

local abs = math.abs
local byte, format = string.byte, string.format

local BILLION = 1000000000

--- Return the number of up to six bytes.
-- index  in the payload, 1-based
function M.count(payload, index, size)
  local count = 0
  for i = index + size - 1, index, -1 do
    count = count * 0x100 + byte(payload, i)
  end
  return count
end

-- Divide an integer by 10^9: long division, a byte a step.
-- returns  the quotient, and the rest, of the same sign
local function divide(payload, index, size, is_signed)
  local quotient, rest = 0, byte(payload, index + size - 1)
  if is_signed and rest >= 0x80 then rest = rest - 0x100 end
  for i = index + size - 2, index, -1 do
    local dividend = rest * 0x100 + byte(payload, i)
    rest = dividend % BILLION
    quotient = quotient * 0x100 + (dividend - rest) / BILLION
  end
  if quotient < 0 and rest > 0 then return quotient + 1, rest - BILLION end
  return quotient, rest
end

--- Return an integer of seven or eight bytes: a number up to 2^53, beyond that its decimal digits.
function M.integer64(payload, index, size, is_signed)
  local billions, rest = divide(payload, index, size, is_signed)
  if abs(billions) < 9007199 then return billions * BILLION + rest end
  return format("%.0f%09.0f", billions, abs(rest))
end

--- Split a signed 64 bit count of nanoseconds exactly ("Time").
-- offset   in the payload, 0-based
-- returns  seconds, nanoseconds; both negative, or zero, for a negative time
function M.time(payload, offset)
  local a, b, c, d, e, f, g, h = byte(payload, offset + 1, offset + 8)
  if h > 0 or g >= 0x20 then return divide(payload, offset + 1, 8, true) end
  local high = e + f * 0x100 + g * 0x10000 -- the usual time: a double holds it
  local number = high * 0x100000000 + d * 0x1000000 + c * 0x10000 + b * 0x100 + a
  local rest = number % BILLION
  return (number - rest) / BILLION, rest
end

--- Return an IEEE 754 number of four or eight bytes.
function M.ieee(payload, index, size)
  local high = M.count(payload, index + size - 4, 4)
  local low = size == 8 and M.count(payload, index, 4) or 0
  local steps = size == 4 and 2 ^ 23 or 2 ^ 20 -- of the mantissa, in the four highest bytes
  local highest = 2 ^ 31 / steps - 1 -- exponent
  local sign, bias = high >= 2 ^ 31 and -1 or 1, (highest - 1) / 2
  local exponent = math.floor(high % 2 ^ 31 / steps)
  local mantissa = (high % steps + low / 2 ^ 32) / steps
  if exponent == highest then return mantissa == 0 and sign * math.huge or 0 / 0 end
  if exponent == 0 then return sign * mantissa * 2 ^ (1 - bias) end
  return sign * (1 + mantissa) * 2 ^ (exponent - bias)
end

--- Return the number with the fewest digits that is equal as a float of four bytes: 0.1 for
-- 0.10000000149.
-- value  finite
function M.shortest(value)
  if value == 0 then return value end -- COMPAT 5.4: the text "-0" is an integer there
  for digits = 6, 8 do
    local short = tonumber(format("%." .. digits .. "g", value))
    local large = short * (2 ^ 29 + 1) -- rounds off the digits that four bytes cannot hold
    if large - (large - short) == value then return short end
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
