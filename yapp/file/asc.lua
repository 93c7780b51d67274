-- SPDX-License-Identifier: GPL-2.0-or-later
-- Vector's ASC, the text log of CANoe, CANalyzer and python-can, as packets.  Pure Lua.
--
--   date Tue Nov 14 22:13:20.001 2023
--   base hex  timestamps absolute
--   Begin Triggerblock Tue Nov 14 22:13:20.001 2023
--    0.001000 1  8408000x        Rx   d 8 FD 7F FD 7F FD 7F FD 7F
--    0.002000 CANFD   1 Rx   840C000x                          1 0 d 32 FD 7F ...
local text = require("yapp.file.text")

local M = {}

local HEAD = 4096 -- bytes
local BUS_ERROR = 0x80
local FDF, BRS, ESI = 4, 1, 2 -- of a SocketCAN frame
local SECOND = 1000000 -- times are in microseconds: that many are exact in every Lua

local MONTHS = {}
for number, names in ipairs {
  "jan jän", "feb", "mar mär mrz", "apr", "may mai", "jun",
  "jul", "aug", "sep", "oct okt", "nov", "dec dez",
} do
  for name in names:gmatch("%S+") do MONTHS[name] = number end
end

-- Times
-- ---------------------------------------------------------------------------------------------

-- "Tue Nov 14 10:13:20.001 pm 2023", the recorder's local time, in microseconds since 1970; nil for
-- no date.  python-can writes 1 ms as ".1".
local function read_date(date)
  local name, day, hour, min, sec, fraction, half, year =
    date:lower():match("(%S+)%s+(%d+)%s+(%d+):(%d+):(%d+)%.?(%d*)%s*([ap]?)m?%s+(%d%d%d%d)")
  local month = name and MONTHS[name]
  if not month then return nil end
  if half ~= "" then hour = hour % 12 end
  if half == "p" then hour = hour + 12 end
  local time = { year = year, month = month, day = day, hour = hour, min = min, sec = sec }
  local seconds = os.time(time)
  return seconds and seconds * SECOND + (tonumber(fraction:sub(1, 3)) or 0) * 1000
end

-- The time in front of a line, "12.000123", in microseconds, and what is behind it; nil for a line
-- without.  (Of a pattern that goes on behind the digits, a thousand digits would be tried a
-- thousand times over.)
local function read_stamp(line)
  local whole, fraction, at = line:match("^%s*(%d*)%.?(%d*)()")
  local rest = line:match("^%s+(.*)$", at)
  if not rest or whole == "" or #whole > 7 then return nil end -- 115 days
  return tonumber(whole) * SECOND + tonumber((fraction .. "000000"):sub(1, 6)), rest
end

-- A line
-- --------------------------------------------------------------------------------------------

-- "8404000x": the number, with SocketCAN's flag of an extended one
local function read_id(id, base)
  local digits, extended = id:match("^(%x+)(x?)$")
  local value = digits and #digits <= 10 and tonumber(digits, base)
  if not value or value >= (extended == "x" and 0x20000000 or 0x800) then return nil end
  return extended == "x" and value + text.EXTENDED or value
end

-- So many data bytes, and what is behind them; nil where there are fewer
local function read_data(data, count, base)
  local bytes, at = {}, 1
  for i = 1, count do
    local digits, stop = data:match("^%s*(%x+)()", at)
    local value = digits and #digits <= 3 and tonumber(digits, base)
    if not value or value > 255 then return nil end
    bytes[i], at = string.char(value), stop
  end
  return table.concat(bytes), data:sub(at)
end

-- "d 8 FD 7F ...", "r 8": a length of 9 to 15 means 8
local function read_classic(record, rest, base)
  local kind, code, data = rest:match("^%s*([dr])%s*(%x?)%s*(.*)$")
  if not kind or kind == "d" and code == "" then return nil end
  record.length = math.min(tonumber(code, 16) or 0, 8)
  if kind == "d" then
    record.data = read_data(data, record.length, base)
  else
    record.id, record.data = record.id + text.REMOTE, ""
  end
end

-- Behind the id: a name or none, BRS, ESI, DLC, length, data, duration, bits, flags
local FLEXIBLE = "^%s*%S-%s*%f[%S]([01])%s+([01])%s+%x%s+(%d+)(.*)$"

local function read_flexible(record, rest, base)
  local brs, esi, length, data = rest:match(FLEXIBLE)
  length = tonumber(length)
  if not length or length > 64 then return nil end
  local bytes, behind = read_data(data, length, base)
  local flags = tonumber((behind or ""):match("^%s*%d+%s+%d+%s+(%x+)") or "1000", 16)
  record.length, record.data = length, bytes
  if flags % 0x20 >= 0x10 then
    record.id, record.data = record.id + text.REMOTE, bytes and ""
  elseif flags % 0x2000 >= 0x1000 then
    record.fd, record.flags = true, FDF + BRS * brs + ESI * esi
  end
  if not record.fd and length > 8 then record.data = nil end
end

--- Reads one line.
-- @param line without its end
-- @param base 10 or 16, of the file's ids and data
-- @return a record { stamp = microseconds, number = channel, id = with SocketCAN's flags, fd, sent,
--   length, flags, raw_dlc = 0, data }, or nil for a line that is no frame
function M.parse(line, base)
  local stamp, rest = read_stamp(line)
  if not stamp then return nil end
  local record = { stamp = stamp, flags = 0, raw_dlc = 0 }
  local channel = rest:match("^C?A?N?F?D?%s*(%d+)%s+[RTx]*%s*ErrorFrame")
  if channel then
    record.id = text.ERROR + BUS_ERROR
    record.length = 8
    record.data = ("\0"):rep(8)
  else
    local flexible, id, direction, behind
    rest, flexible = rest:gsub("^CANFD%s+(%d+)%s+([RT]x)%s+(%x+x?)%s", "%1 %3 %2 ")
    channel, id, direction, behind = rest:match("^(%d+)%s+(%x+x?)%s+([RT]x)(%s.*)$")
    record.id = id and read_id(id, base)
    if not record.id then return nil end
    record.sent = direction == "Tx" or nil
    local read = flexible == 1 and read_flexible or read_classic
    read(record, behind, base)
  end
  record.number = tonumber(channel)
  return record.data and record.number <= 0xFFFF and record or nil
end

-- A file
-- --------------------------------------------------------------------------------------------

local Log = {}
Log.__index = Log

--- Opens a file if it is ASC.
-- @param file with read and seek, at its begin
-- @return a log with read and seek_read; nil for another file
function M.open(file)
  local head = file:read(HEAD) or ""
  local date = head:match("^%s*date%s+([^\r\n]*)")
  local base, stamps = head:match("\n%s*base%s+(%a+)%s+timestamps%s+(%a+)")
  if not date or base ~= "hex" and base ~= "dec" then return nil end
  date = read_date(date)
  local channel, has_several = nil, false
  for other in head:gmatch("\n%s*[%d.]+%s+(%d+)%s+%x+x%s") do
    has_several = has_several or other ~= (channel or other)
    channel = other
  end
  return setmetatable({
    has_several = has_several, -- channels in the first lines
    base = base == "hex" and 16 or 10,
    is_relative = stamps == "relative",
    date = date, -- of the file; nil if unknown
    start = date, -- what stamps count from
    clock = 0, -- the stamp of a line, where they are relative the sum so far
    times = {}, -- by a frame's offset
    lines = text.lines(head),
    again = text.lines(""), -- wherever a frame is wanted again
  }, Log)
end

-- What read returns; buses are called as Wireshark's reader of BLF calls them.
function Log:packet(record, offset)
  local packet, time = text.packet(record.number, record), self.times[offset]
  local bus = { number = record.number, name = "CAN-" .. record.number }
  if not time then return offset, packet, nil, nil, bus end
  local rest = time % SECOND
  return offset, packet, math.floor((time - rest) / SECOND), rest * 1000, bus
end

-- A block of a log says when it began: python-can counts from there, CANoe from the date of the
-- file.
function Log:begin(began, stamp)
  local is_since_date = self.date and math.abs(self.date + stamp - began) < 2 * SECOND
  self.start = is_since_date and self.date or began
end

--- Reads the next frame.
-- @param file the file it was opened with
-- @return as candump's read; the bus is { number = the channel, name }, without a date in the file
--   there is no time
function Log:read(file)
  local began
  local line, offset = self.lines:next(file)
  while line do
    local stamp = read_stamp(line)
    if stamp and began then
      self:begin(began, stamp)
      began = nil
    end
    if stamp then self.clock = self.is_relative and self.clock + stamp or stamp end
    local record = M.parse(line, self.base)
    if record then
      self.times[offset] = self.start and self.start + self.clock
      return self:packet(record, offset)
    end
    local block = not stamp and line:match("^%s*[Bb]egin%s+[Tt]riggerblock%s+(.*)")
    if block then began = read_date(block) end
    line, offset = self.lines:next(file)
  end
end

--- Reads a frame again.
-- @param offset that read gave
-- @return the same as read gave; nil where there is no frame
function Log:seek_read(file, offset)
  self.again:go_to(file, offset)
  local record = M.parse(self.again:next(file) or "", self.base)
  if not record then return nil end
  return self:packet(record, offset)
end

return M
