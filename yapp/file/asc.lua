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
local BASES = { hex = 16, dec = 10 } -- of ids and data
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

local DATE = "(%S+)%s+(%d+)%s+(%d+):(%d+):(%d+)%.?(%d*)%s*([ap]?)m?%s+(%d%d%d%d)"

-- "Tue Nov 14 10:13:20.001 pm 2023", the recorder's local time, in microseconds since 1970; nil for
-- no date.  python-can writes 1 ms as ".1".
local function read_date(date)
  local name, day, hour, min, sec, fraction, half, year = date:lower():match(DATE)
  local month = MONTHS[name or ""]
  if not month then return nil end
  if half ~= "" then hour = hour % 12 end
  if half == "p" then hour = hour + 12 end
  local time = { year = year, month = month, day = day, hour = hour, min = min, sec = sec }
  local milliseconds = tonumber(fraction:sub(1, 3)) or 0
  return os.time(time) * SECOND + milliseconds * 1000
end

-- The time in front of a line, "12.000123", in microseconds, and what is behind it; nil for a line
-- without.  (Of a pattern that goes on behind the digits, a thousand digits would be tried a
-- thousand times over.)
local function read_stamp(line)
  local whole, fraction, at = line:match("^%s*(%d*)%.?(%d*)()")
  local rest = line:match("^%s+(.*)$", at)
  if not rest or whole == "" or #whole > 7 then return nil end -- 115 days
  local microseconds = tonumber((fraction .. "000000"):sub(1, 6))
  return tonumber(whole) * SECOND + microseconds, rest
end

-- A line
-- --------------------------------------------------------------------------------------------

-- "8404000x": the number, with SocketCAN's flag of an extended one
local function read_id(id, base)
  local digits, extended = id:match("^(%x+)(x?)$")
  local value = #digits <= 10 and tonumber(digits, base)
  if not value then return nil end
  if extended == "" then return value < 0x800 and value or nil end
  return value < 0x20000000 and value + text.EXTENDED or nil
end

-- So many data bytes, and what is behind them; nil where there are fewer
local function read_data(data, count, base)
  local bytes, at = {}, 1
  for i = 1, count do
    local digits, stop = data:match("^%s*(%x%x?%x?)%f[%X]()", at)
    local value = digits and tonumber(digits, base)
    if not value or value > 255 then return nil end
    bytes[i] = string.char(value)
    at = stop
  end
  return table.concat(bytes), data:sub(at)
end

-- "d 8 FD 7F ...", "r 8": a length of 9 to 15 means 8
local function read_classic(record, rest, base)
  local kind, code, data = rest:match("^%s*([dr])%s*(%x?)%s*(.*)$")
  record.length = math.min(tonumber(code or "", 16) or 0, 8)
  if kind == "r" then
    record.id = record.id + text.REMOTE
    record.data = ""
  elseif kind == "d" and code ~= "" then
    record.data = read_data(data, record.length, base)
  end
end

-- Behind the id: a name or none, BRS, ESI, DLC, length, data, duration, bits, flags
local FLEXIBLE = "^%s*%S-%s*%f[%S]([01])%s+([01])%s+%x%s+(%d+)(.*)$"

local function read_flexible(record, rest, base)
  local brs, esi, length, data = rest:match(FLEXIBLE)
  record.length = tonumber(length)
  if not length or record.length > 64 then return end
  local bytes, behind = read_data(data, record.length, base)
  if not bytes then return end
  record.data = bytes
  local flags = tonumber(behind:match("^%s*%d+%s+%d+%s+(%x+)") or "1000", 16)
  if flags % 0x2000 >= 0x1000 then
    record.fd = true
    record.flags = FDF + BRS * brs + ESI * esi
  end
end

local FRAME = "^(%d%d?%d?)%s+(%x+x?)%s+([RT]x)(%s.*)$"

--- Reads one line.
-- @param line without its end
-- @param base 10 or 16, of the file's ids and data
-- @return a record { stamp = microseconds, number = channel, id = with SocketCAN's flags, fd, sent,
--   length, flags, raw_dlc = 0, data }, or nil for a line that is no frame
function M.parse(line, base)
  local stamp, rest = read_stamp(line)
  if not stamp then return nil end
  local record = { stamp = stamp, flags = 0, raw_dlc = 0 }
  local channel = rest:match("^C?A?N?F?D?%s*(%d%d?%d?)%s+[RTx]*%s*ErrorFrame")
  if channel then
    record.number = tonumber(channel)
    record.id = text.ERROR + BUS_ERROR
    record.length = 8
    record.data = ("\0"):rep(8)
    return record
  end
  -- The head of a line of CAN FD in the order of a classic one's.
  local classic, swapped = rest:gsub("^CANFD%s+(%d+)%s+([RT]x)%s+(%x+x?)%s", "%1 %3 %2 ")
  local number, id, direction, behind = classic:match(FRAME)
  record.id = id and read_id(id, base)
  if not record.id then return nil end
  record.number = tonumber(number)
  record.sent = direction == "Tx" or nil
  local read = swapped == 1 and read_flexible or read_classic
  read(record, behind, base)
  return record.data and record
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
  if not date or not BASES[base] then return nil end
  date = read_date(date)
  local channel, has_several = nil, false
  for other in head:gmatch("\n%s*[%d.]+%s+(%d+)%s+%x+x%s") do
    has_several = has_several or other ~= (channel or other)
    channel = other
  end
  return setmetatable({
    has_several = has_several, -- channels in the first lines
    base = BASES[base],
    is_relative = stamps == "relative",
    date = date, -- of the file; nil if unknown
    start = date, -- what stamps count from
    began = nil, -- the block whose first stamp is to come
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

-- The time of a line.  A block of a log says when it began: python-can counts from there, CANoe
-- from the date of the file.
function Log:count(stamp)
  local began, date = self.began, self.date
  if began then
    local is_since_date = date and math.abs(date + stamp - began) < 2 * SECOND
    self.start = is_since_date and date or began
    self.began = nil
  end
  self.clock = self.is_relative and self.clock + stamp or stamp
end

--- Reads the next frame.
-- @param file the file it was opened with
-- @return as candump's read; the bus is { number = the channel, name }, without a date in the file
--   there is no time
function Log:read(file)
  local line, offset = self.lines:next(file)
  while line do
    local stamp = read_stamp(line)
    if stamp then
      self:count(stamp)
      local record = M.parse(line, self.base)
      if record then
        self.times[offset] = self.start and self.start + self.clock
        return self:packet(record, offset)
      end
    else
      local block = line:match("^%s*[Bb]egin%s+[Tt]riggerblock%s+(.*)")
      if block then self.began = read_date(block) end
    end
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
