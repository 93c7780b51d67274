-- SPDX-License-Identifier: GPL-2.0-or-later
-- The common part of the readers of text logs: the lines of a file, a CAN frame as a packet, and a
-- log that reads its frames in order and once more.  Pure Lua.
local char, match = string.char, string.match
local memo = require "yapp.base.memo"
local utf8 = require "yapp.base.utf8"

local M = {}

local BLOCK = 65536 -- bytes read at once
-- Bytes of a line.  The longest lines with a frame are candump's of 64 bytes in binary digits, 700
-- characters.  The rest of a longer line is skipped.
local MAX_LINE = 4096
local MAX_REPORTED = 3 -- lines for each reason
local TOO_LONG = "a line longer than 4096 bytes, skipped"
local UNREADABLE = "the file cannot be read behind byte %d (%s): a compressed file may be " ..
  "damaged, or cut off; what was read until there is shown"
local COMMENT = "^%s*[#;/]"
local SECOND = 1000000000 -- nanoseconds
local MARK = "\239\187\191" -- a byte order mark, in front of UTF-8

--- Why a line gives no frame.
M.ID = "no such CAN id, line skipped"
M.DATA = "the data bytes do not fit, line skipped"

-- Lines -------------------------------------------------------------------------------------------

local Lines = {}
Lines.__index = Lines

--- Make the lines of a file.
-- text  string: the first bytes of the file, which is right behind them
function M.lines(text)
  return setmetatable({
    text = text, -- a part of the file
    base = 0, -- the offset of the text
    pos = text:sub(1, #MARK) == MARK and #MARK + 1 or 1, -- index at which the next line begins
    number = 0, -- of the line read last
  }, Lines)
end

--- Go to an offset, inside the text where possible.
function Lines:go_to(file, offset)
  local pos = offset - self.base + 1
  if pos >= 1 and pos <= #self.text then
    self.pos = pos
    return
  end
  file:seek("set", offset)
  self.text, self.base, self.pos = "", offset, 1
end

-- Read more bytes behind the line that begins at pos.  Keep only the beginning of a line
-- that is too long.
-- returns  false at the end of the file
function Lines:read_on(file)
  local begin = self.text:sub(self.pos, self.pos + MAX_LINE)
  local more, why = file:read(BLOCK)
  if why then error(UNREADABLE:format(self.base + self.pos - 1, why), 0) end
  self.base = self.base + #self.text - #begin
  self.text = begin .. (more or "")
  self.pos = 1
  return #self.text > #begin
end

--- Go on behind a line of the text.
-- pos      index in the text at which the next line begins
-- returns  the offset of the line
function Lines:skip_to(pos)
  local offset = self.base + self.pos - 1
  self.pos = pos
  self.number = self.number + 1
  return offset
end

--- Read the next line.
-- returns  the line without its "\n", and its offset; nil at the end.  A line that is too long may
--          have lost its end
function Lines:next(file)
  local stop = self.text:find("\n", self.pos, true)
  while not stop and self:read_on(file) do
    stop = self.text:find("\n", 1, true)
  end
  if not stop and self.pos > #self.text then return nil end
  local line = self.text:sub(self.pos, (stop or 0) - 1)
  return line, self:skip_to((stop or #self.text) + 1)
end

-- Bytes -------------------------------------------------------------------------------------------

--- Make a table of bytes by their digits, filled as it is read; nil for other digits.
-- value_of  function(digits), which returns a number or nil
function M.byte_table(value_of)
  return memo(function(digits)
    local value = value_of(digits)
    return value and value <= 255 and char(value) or nil
  end)
end

-- Two hex digits, or the eight binary ones of candump -i, to a byte.
local BASES = { [2] = 16, [8] = 2 }
M.BYTES = M.byte_table(function(digits)
  local base = BASES[#digits]
  return base and tonumber(digits, base)
end)

--- Return so many data bytes, and the index behind them; nil if there are fewer.
-- data     text that begins with them
-- pattern  of a byte, which captures its digits and the index behind it
-- bytes    from byte_table
function M.parse_bytes(data, count, pattern, bytes)
  local found, index = {}, 1
  for i = 1, count do
    local digits, stop = match(data, pattern, index)
    found[i] = bytes[digits or ""]
    if not found[i] then return nil end
    index = stop
  end
  return table.concat(found), index
end

-- Packets -----------------------------------------------------------------------------------------

-- Flags in the upper bits of a SocketCAN id (linux/can.h).
M.EXTENDED = 0x80000000
M.REMOTE = 0x40000000
M.ERROR = 0x20000000

local function big_endian(number)
  return (("%08X"):format(number):gsub("%x%x", M.BYTES))
end

--- Return the bytes of a packet before the CAN frame's length: the same for all frames with this id
-- on a bus.  (Wireshark takes the id in the host's order here, and this is the usual one.)
-- number  of the bus
-- record  { id = 32 bits with SocketCAN's flags, fd, sent = booleans or nil }
function M.head(number, record)
  local protocol = record.fd and "\0\13" or "\0\12"
  local sent = record.sent and "\4" or "\0"
  -- Linux cooked capture v2: protocol, reserved, interface index, device type, packet type, no
  -- address
  return protocol .. "\0\0" .. big_endian(number) .. "\1\24" .. sent .. ("\0"):rep(9) ..
    big_endian(record.id):reverse()
end

--- Return a frame as a packet of link type LINUX_SLL2: the cooked header, the SocketCAN header, the
-- data.
-- number  of the bus
-- record  as for M.head, and { length = bytes, flags = 4 FDF, 2 ESI, 1 BRS, raw_dlc = 9 to 15
--         or 0, data = bytes }
function M.packet(number, record)
  local lengths = char(record.length, record.flags, 0, record.raw_dlc)
  return M.head(number, record) .. lengths .. record.data
end

-- The parts of a line -----------------------------------------------------------------------------

--- Return whether a text has one of these patterns.
function M.has_one_of(line, patterns)
  for _, pattern in ipairs(patterns) do
    if line:find(pattern) then return true end
  end
  return false
end

--- Return the seconds since 1970 of a local time, or nil if it does not exist.
-- date  { year, month, day, hour, min, sec = numbers or their digits }, which os.time may change
function M.seconds_of(date)
  local written = ("%02d-%02d %02d:%02d"):format(date.month, date.day, date.min, date.sec)
  local is_known, seconds = pcall(os.time, date)
  -- 30 February is moved into March.  The hour may be moved, if summer time leaves it out.
  return is_known and os.date("%m-%d %M:%S", seconds) == written and seconds or nil
end

-- Logs --------------------------------------------------------------------------------------------

local Log = {}
Log.__index = Log

--- Make a log.
-- head    string: the first bytes of the file, which is right behind them
-- report  function(text), called with a note on a line
-- log     table: the state of the format, with
--         record      function(log, line, offset), which returns the frame in a line, or nil: a
--                     record as packet needs it, and { bus = key of buses; seconds, nanoseconds =
--                     nil without a time }.  offset = of the line; nil if it has been read before
--         per_second  unit of times
function M.open(head, report, log)
  log.report = report
  log.lines = M.lines(head)
  log.again = M.lines("") -- for the frames that are read once more
  log.others = 0 -- number of lines without a frame
  log.skipped = {} -- number of lines, by reason
  log.pending = {} -- texts for the packet list, at the next frame
  log.comments = {} -- texts of the packet list, by the frame's offset
  log.buses = {} -- { number, name = fit to be printed }, by the record's bus
  log.times = {} -- by the frame's offset, if its record has none
  log.shifts = {} -- by the frame's offset: seconds to add to the time of its record
  log.drops = {} -- as readers.log returns them
  log.unread, log.doubtful = 0, 0 -- number of lines since the latest frame: not understood
  log.has_frame = false -- true if one was read
  return setmetatable(log, Log)
end

--- Report a line, at once and in the packet list at the next frame.  Of each reason only the first
-- lines are reported.
-- why          text
-- is_harmless  true if the packet list need not say it
function Log:skip(line, why, is_harmless)
  local count = (self.skipped[why] or 0) + 1
  self.skipped[why] = count
  if count > MAX_REPORTED then return end
  local shown = utf8.printable(line:sub(1, 50):match("^%s*(.-)%s*$"))
  local message = ('line %d: %s: "%s"'):format(self.lines.number, why, shown)
  if count == MAX_REPORTED then message = message .. "; further ones are not reported" end
  self.report(message)
  if not is_harmless then self.pending[#self.pending + 1] = message end
end

--- Report a line that was not understood.  It counts as a lost packet.
-- is_doubtful  true if it may be no frame: then it counts only if it stands between two frames
function Log:lose(line, why, is_doubtful)
  local kind = is_doubtful and "doubtful" or "unread"
  self[kind] = self[kind] + 1
  self:skip(line, why)
end

-- Set the frame behind the latest drops, and its time; none at the end of the file.
local function place_drops(self, frame, time)
  local count = self.unread + (frame and self.has_frame and self.doubtful or 0)
  self.unread, self.doubtful, self.has_frame = 0, 0, true
  if count > 0 then self.drops[#self.drops + 1] = { count = count } end
  for i = #self.drops, 1, -1 do
    local drop = self.drops[i]
    if drop.frame then break end
    drop.frame, drop.time = frame, time
  end
end

-- Return the seconds and nanoseconds of a frame, nil without a time.
local function time_of(self, record, offset)
  local time = self.times[offset]
  if not time then
    local shift = self.shifts[offset]
    return shift and record.seconds + shift or record.seconds, record.nanoseconds
  end
  local rest = time % self.per_second
  return math.floor((time - rest) / self.per_second), rest * (SECOND / self.per_second)
end

--- Read the next frame.
-- lines    of the log
-- returns  as read
function M.next(self, lines, file)
  local line, offset = lines:next(file)
  if not line then return lines == self.lines and place_drops(self) or nil end
  local record
  if #line > MAX_LINE then
    self:lose(line, TOO_LONG, line:find(COMMENT) ~= nil)
  else
    record = self:record(line, lines == self.lines and offset)
  end
  if not record then
    self.others = self.others + 1
    return M.next(self, lines, file)
  end
  if #self.pending > 0 then
    self.comments[offset] = table.concat(self.pending, "\n")
    self.pending = {}
  end
  local bus, seconds, nanoseconds = self.buses[record.bus], time_of(self, record, offset)
  if lines == self.lines then
    local time = seconds and seconds + nanoseconds / SECOND
    place_drops(self, self.lines.number - self.others, time)
  end
  return offset, M.packet(bus.number, record), seconds, nanoseconds, bus, self.comments[offset]
end

Log.next = M.next

--- Read the next frame.
-- file     the file that was opened
-- returns  its offset, the packet's bytes (link type LINUX_SLL2), the seconds and nanoseconds since
--          1970 or since the first frame (nil without a time), the bus { number, name }, a comment
--          or nil.  Nil at the end
function Log:read(file)
  return self:next(self.lines, file)
end

--- Read a frame once more.
-- file     a second handle of the same file, used for nothing else
-- offset   of the frame, from read
-- returns  the same as read
function Log:seek_read(file, offset)
  self.again:go_to(file, offset)
  return self:next(self.again, file)
end

return M
