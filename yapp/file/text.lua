-- SPDX-License-Identifier: GPL-2.0-or-later
-- The common part of the readers of text logs: the lines of a file, a CAN frame as a packet, and a
-- log that reads its frames in order and once more.  Pure Lua.
local char, find, sub = string.char, string.find, string.sub
local memo = require "yapp.base.memo"
local utf8 = require "yapp.base.utf8"

local M = {}

local BLOCK = 65536 -- bytes read at once
-- Bytes of a line that may have a frame.  A longer line is not understood.
local MAX_LINE = 4096
local MAX_REPORTED = 3 -- lines for each reason
local UNKNOWN = "not understood, counts as a lost packet"
local UNREADABLE = "the file cannot be read behind byte %d (%s): a compressed file may be " ..
  "damaged, or cut off; what was read until there is shown"
local SECOND = 1000000000 -- nanoseconds
local MARK = "\239\187\191" -- a byte order mark, in front of UTF-8

-- Lines -------------------------------------------------------------------------------------------

local Lines = {}
Lines.__index = Lines

--- Make the lines of a file.
-- text  string: the first bytes of the file, which is right behind them
function M.lines(text)
  return setmetatable({
    text = text, -- a part of the file
    base = 0, -- the offset of the text
    pos = sub(text, 1, #MARK) == MARK and #MARK + 1 or 1, -- index at which the next line begins
    number = 0, -- of the line read last
  }, Lines)
end

--- Go to an offset, inside the text where possible.
function Lines:go_to(file, offset)
  self.pos = offset - self.base + 1
  if self.pos >= 1 and self.pos <= #self.text then return end
  file:seek("set", offset)
  self.text, self.base, self.pos = "", offset, 1
end

-- Read more bytes behind the line that begins at pos.  Keep only the beginning of a line that is
-- too long.
-- returns  false at the end of the file
local function read_on(self, file)
  local begin = sub(self.text, self.pos, self.pos + MAX_LINE)
  local more, why = file:read(BLOCK)
  if why then error(UNREADABLE:format(self.base + self.pos - 1, why), 0) end
  self.base = self.base + #self.text - #begin
  self.text = begin .. (more or "")
  self.pos = 1
  return more ~= nil
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
  local stop = find(self.text, "\n", self.pos, true)
  while not stop and read_on(self, file) do stop = find(self.text, "\n", 1, true) end
  local from = self.pos
  if not stop and from > #self.text then return nil end
  stop = stop or #self.text + 1
  return sub(self.text, from, stop - 1), self:skip_to(stop + 1)
end

-- Packets -----------------------------------------------------------------------------------------

-- Flags in the upper bits of a SocketCAN id (linux/can.h).
M.EXTENDED = 0x80000000
M.REMOTE = 0x40000000
M.ERROR = 0x20000000

--- The bytes of hex digits: [two digits] = the byte.
M.BYTES = memo(function(digits) return char(tonumber(digits, 16)) end)

-- [number of 32 bits] = its bytes.
local BIG_ENDIAN = memo(function(number)
  return (("%08X"):format(number):gsub("%x%x", M.BYTES))
end)
local LITTLE_ENDIAN = memo(function(number) return BIG_ENDIAN[number]:reverse() end)

--- Return the bytes of a packet before the CAN frame's length: the same for all frames with this id
-- on a bus.  (Wireshark takes the id in the host's order here, and this is the usual one.)
-- number  of the bus
-- id      with SocketCAN's flags
-- fd, sent  booleans or nil
function M.head(number, id, fd, sent)
  -- Linux cooked capture v2: protocol, reserved, interface index, device type, packet type, no
  -- address
  return (fd and "\0\13\0\0" or "\0\12\0\0") .. BIG_ENDIAN[number] ..
    (sent and "\1\24\4" or "\1\24\0") .. "\0\0\0\0\0\0\0\0\0" .. LITTLE_ENDIAN[id]
end

--- Return a frame as a packet of link type LINUX_SLL2: the cooked header, the SocketCAN header, the
-- data.
-- number  of the bus
-- record  { id, fd, sent = as for M.head, length = bytes, flags = 4 FDF, 2 ESI, 1 BRS, raw_dlc = 9
--         to 15 or 0, data = bytes }
function M.packet(number, record)
  local lengths = char(record.length, record.flags, 0, record.raw_dlc)
  return M.head(number, record.id, record.fd, record.sent) .. lengths .. record.data
end

-- The parts of a file -----------------------------------------------------------------------------

--- Return so many data bytes, and the index behind them; nil if there are fewer.
-- data     text that begins with them
-- pattern  of a byte, which captures its digits and the index behind it
-- base     of the digits
function M.parse_bytes(data, count, pattern, base)
  local bytes, stop = {}, 1
  for i = 1, count do
    local digits
    digits, stop = data:match(pattern, stop)
    local value = digits and tonumber(digits, base)
    if not value or value > 255 then return nil end
    bytes[i] = char(value)
  end
  return table.concat(bytes), stop
end

--- Return whether a text has one of these patterns.
function M.has_one_of(line, patterns)
  for _, pattern in ipairs(patterns) do
    if find(line, pattern) then return true end
  end
  return false
end

--- Read the lines with which a file begins.
-- head     string: the first bytes of the file
-- is_all   true if they are the whole file
-- parse    function(line) -> record, is_known, see open
-- returns  { records = list of the frames in its whole lines, others = list of the lines that were
--          not understood, before = how many of these stand in front of the first frame,
--          has_several = true if there are several buses, stamps_differ = true if the frames have
--          different time stamps }
function M.survey(head, is_all, parse)
  local lines = is_all and head or head:match("^.*\n") or ""
  local records, others = {}, {}
  local found = { records = records, others = others, before = 0,
    has_several = false, stamps_differ = false }
  for line in lines:gsub("^" .. MARK, ""):gmatch("[^\n]+") do
    local record, is_known = parse(line)
    if record then
      records[#records + 1] = record
      if not records[2] then found.before = #others end
      if record.bus ~= records[1].bus then found.has_several = true end
      if record.stamp ~= records[1].stamp then found.stamps_differ = true end
    elseif not is_known then
      others[#others + 1] = line
    end
  end
  return found
end

-- Logs --------------------------------------------------------------------------------------------

local Log = {}
Log.__index = Log

--- Make a log.
-- head    string: the first bytes of the file, which is right behind them
-- report  function(text), called with a note on a line
-- log     the state of the format, with
--         parse  function(line), which returns the frame in a line: a record as packet needs it,
--                and { bus = its name or nil, stamp = the text of its time or nil, seconds,
--                nanoseconds = its time or nil }.  For a line without a frame: nil, and true if
--                such a line is known, so that it is no lost frame
--         note   function(log, line, record, offset), called once for each line, in their order
--         like   list of patterns: a line that has one was a frame
--         read_usual  function(log, lines), which reads a line of the usual form without a record:
--                it returns as Log:read, nil for another line; or nil
function M.open(head, report, log)
  log.report = report
  log.lines = M.lines(head)
  log.again = M.lines("") -- for the frames that are read once more
  log.frames = 0 -- that were read
  log.reported = {} -- number of lines, by reason
  log.pending = {} -- texts for the packet list, at the next frame
  log.comments = {} -- texts of the packet list, by the frame's offset
  log.buses = {} -- { number, name = fit to be printed }, by the record's bus
  log.is_taken = {} -- by number: true if a bus has it
  log.free = 0 -- all numbers below are taken
  log.times = {} -- by the frame's offset: nanoseconds since log.start, if its record lacks them
  log.start = 0 -- seconds since 1970
  log.drops = {} -- as readers.log returns them
  log.lost, log.doubtful = 0, 0 -- number of lines since the latest frame: not understood
  return setmetatable(log, Log)
end

--- Report a line, at once and in the packet list at the next frame.  Of each reason only the first
-- lines are reported.
-- why  text
function Log:quote(line, why)
  local count = (self.reported[why] or 0) + 1
  self.reported[why] = count
  if count > MAX_REPORTED then return end
  local shown = utf8.printable(line:sub(1, 50):match("^%s*(.-)%s*$"))
  local message = ('line %d: %s: "%s"'):format(self.lines.number, why, shown)
  if count == MAX_REPORTED then message = message .. "; further ones are not reported" end
  self.report(message)
  self.pending[#self.pending + 1] = message
end

-- Account for a line that was not understood: a lost packet.  One that is not like a frame counts
-- only between two frames: in front of them and behind them may be lines of a shell.
local function lose(self, line)
  local kind = M.has_one_of(line, self.like) and "lost" or "doubtful"
  self[kind] = self[kind] + 1
  self:quote(line, UNKNOWN)
end

-- Set the frame behind the latest drops, and its time; none at the end of the file.
local function place_drops(self, frame, time)
  local count = self.lost + (frame and frame > 1 and self.doubtful or 0)
  self.lost, self.doubtful = 0, 0
  if count > 0 then self.drops[#self.drops + 1] = { count = count } end
  for i = #self.drops, 1, -1 do
    local drop = self.drops[i]
    if drop.frame then break end
    drop.frame, drop.time = frame, time
  end
end

-- Add a bus.  Its number is the one its name ends in (can1 is 1) unless another bus has it, else
-- the first free one.
local function add_bus(self, name)
  while self.is_taken[self.free] do self.free = self.free + 1 end
  local number = tonumber(name:match("%f[%d]%d?%d?%d$"))
  if not number or self.is_taken[number] then number = self.free end
  self.is_taken[number] = true
  local bus = { number = number, name = utf8.printable(name) }
  self.buses[name] = bus
  self.pending[#self.pending + 1] = ("Interface index %d is %s"):format(number, bus.name)
end

-- Return the time of a frame, nil without one.
local function time_of(self, record, offset)
  local time = self.times[offset]
  if not time then return record.seconds, record.nanoseconds end
  return self.start + math.floor(time / SECOND), time % SECOND
end

-- Account for a frame that is read for the first time.
local function add_frame(self, record, offset)
  if record.bus and not self.buses[record.bus] then add_bus(self, record.bus) end
  if self.pending[1] then
    self.comments[offset] = table.concat(self.pending, "\n")
    self.pending = {}
  end
  self.frames = self.frames + 1
  local seconds, nanoseconds = time_of(self, record, offset)
  place_drops(self, self.frames, seconds and seconds + nanoseconds / SECOND)
end

-- Read the next frame of these lines, see Log:read.
local function read_any(self, lines, file)
  local line, offset = lines:next(file)
  if not line then return nil end
  local record, is_known
  if #line <= MAX_LINE then record, is_known = self.parse(line) end
  if lines == self.lines then
    if not (record or is_known) then lose(self, line) end
    self:note(line, record, offset)
    if record then add_frame(self, record, offset) end
  end
  if not record then return read_any(self, lines, file) end
  local bus = self.buses[record.bus]
  local seconds, nanoseconds = time_of(self, record, offset)
  local packet = M.packet(bus and bus.number or 0, record)
  return offset, packet, seconds, nanoseconds, bus, self.comments[offset]
end

-- The same; first try the usual form.
local function read(self, lines, file)
  if self.read_usual then
    local offset, packet, seconds, nanoseconds, bus = self:read_usual(lines)
    if offset then return offset, packet, seconds, nanoseconds, bus, self.comments[offset] end
  end
  return read_any(self, lines, file)
end

--- Read the next frame.
-- file     the file that was opened
-- returns  its offset, the packet's bytes (link type LINUX_SLL2), the seconds and nanoseconds since
--          1970 or since the first frame (nil without a time), the bus { number, name } or nil, a
--          comment or nil.  Nil at the end
function Log:read(file)
  local offset, packet, seconds, nanoseconds, bus, comment = read(self, self.lines, file)
  if not offset then place_drops(self) end
  return offset, packet, seconds, nanoseconds, bus, comment
end

--- Read a frame once more.
-- file     a second handle of the same file, used for nothing else
-- offset   of the frame, from read
-- returns  the same as read
function Log:seek_read(file, offset)
  self.again:go_to(file, offset)
  return read(self, self.again, file)
end

return M
