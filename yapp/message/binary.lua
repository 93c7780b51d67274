-- SPDX-License-Identifier: GPL-2.0-or-later
-- The numbers in the bytes of a payload, little endian ("YAPP Data Types", "Time"): integers of one
-- to eight bytes, IEEE 754, times.  Pure Lua.

local little_endian = require "yapp.base.little_endian"

local M = {}

local byte, format = string.byte, string.format

local BILLION = 1000000000

-- Divide high * 2^40 + low by 10^9, exactly: 2^40 is 1099 * 10^9 + 511627776.
-- returns  the quotient, and the rest, of the same sign
local function divide(high, low)
  local number = high * 511627776 + low
  local rest = number % BILLION
  local quotient = high * 1099 + (number - rest) / BILLION
  if quotient < 0 and rest > 0 then return quotient + 1, rest - BILLION end
  return quotient, rest
end

--- Return an integer: a number up to 2^53, beyond that its decimal digits.
function M.integer(payload, index, size, is_signed)
  local low_size = size > 6 and 5 or 0
  local high_size = size - low_size
  local number, range = little_endian(payload, index + low_size, high_size), 0x100 ^ high_size
  if is_signed and number >= range / 2 then number = number - range end
  if size <= 6 then return number end
  local billions, rest = divide(number, little_endian(payload, index, 5))
  if math.abs(billions) < 9007199 then return billions * BILLION + rest end
  return format("%.0f%09.0f", billions, math.abs(rest))
end

--- Split a signed 64 bit count of nanoseconds exactly ("Time").
-- bytes    eight
-- returns  seconds, nanoseconds; both negative, or zero, for a negative time
function M.time(bytes)
  local a, b, c, d, e, f, g, h = byte(bytes, 1, 8)
  if h >= 0x80 then h = h - 0x100 end
  local low = e * 0x100000000 + d * 0x1000000 + c * 0x10000 + b * 0x100 + a
  return divide(h * 0x10000 + g * 0x100 + f, low)
end

--- Return an IEEE 754 number of four or eight bytes.
function M.ieee(payload, index, size)
  local high = little_endian(payload, index + size - 4, 4)
  local low = size == 8 and little_endian(payload, index, 4) or 0
  local steps = size == 4 and 2 ^ 23 or 2 ^ 20 -- of the mantissa, in the four highest bytes
  local highest = 2 ^ 31 / steps - 1 -- exponent
  local sign, bias = high >= 2 ^ 31 and -1 or 1, (highest - 1) / 2
  local exponent = math.floor(high % 2 ^ 31 / steps)
  local mantissa = (high % steps + low / 2 ^ 32) / steps
  if exponent == highest then return mantissa == 0 and sign * math.huge or 0 / 0 end
  if exponent == 0 then return sign * mantissa * 2 ^ (1 - bias) end
  return sign * (1 + mantissa) * 2 ^ (exponent - bias)
end

--- Return a time in seconds as a text with nine digits behind the point.
function M.seconds(seconds, nanoseconds)
  if seconds < 0 or nanoseconds < 0 then
    return format("-%d.%09d", -seconds, -nanoseconds)
  end
  return format("%d.%09d", seconds, nanoseconds)
end

return M
