-- SPDX-License-Identifier: GPL-2.0-or-later
-- The dates of packets: exact times since 1970.  Pure Lua, 5.2 to 5.5.

local Dates = {}
Dates.__index = Dates

local floor, format = math.floor, string.format

--- Make the dates of a capture.  Until Dates:set_first, its first packet came in 1970.
function Dates.new()
  return setmetatable({ seconds = 0, nanoseconds = 0 }, Dates)
end

--- Set when the first packet was captured: integers, since 1970.
function Dates:set_first(seconds, nanoseconds)
  self.seconds, self.nanoseconds = seconds, nanoseconds
end

--- Return a time as seconds and nanoseconds; exact for captures of up to 48 days, as a double has
-- 2^22 s to half a nanosecond.
-- rel      seconds since the first packet
-- returns  integers, nanoseconds 0 .. 999,999,999
function Dates:exact(rel)
  local nanoseconds = self.nanoseconds + floor(rel % 1 * 1e9 + 0.5)
  local seconds = self.seconds + floor(rel) + floor(nanoseconds / 1e9)
  return seconds, nanoseconds % 1e9
end

--- Return a time as a number with nine digits behind the point, a text.
function Dates:text(rel)
  local seconds, nanoseconds = self:exact(rel)
  if seconds < 0 and nanoseconds > 0 then -- -3 s and 400,000,000 ns are -2.6 s
    return format("-%d.%09d", -1 - seconds, 1e9 - nanoseconds)
  end
  return format("%d.%09d", seconds, nanoseconds)
end

--- Return a time as a value of a row, see stat.output; people read it in UTC, to the microsecond.
function Dates:value(rel)
  local seconds, nanoseconds = self:exact(rel)
  local ok, date = pcall(os.date, "!%Y-%m-%d %H:%M:%S", seconds) -- on Windows from 1970 to 3000
  local shown = ok and date or format("%d", seconds)
  return { json = self:text(rel), text = format("%s.%06d", shown, floor(nanoseconds / 1000)) }
end

return Dates
