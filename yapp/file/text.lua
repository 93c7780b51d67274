-- SPDX-License-Identifier: GPL-2.0-or-later
-- The common part of the readers of text logs: the lines of a file, a CAN frame as a packet, and a
-- log that reads its frames in order and once more.  Pure Lua.
--
-- A format is {
--   stamp     pattern of the time in front of a line: its captures are the time, and the index
--             behind it
--   set_time  function(record, stamp), which sets the record's stamp, seconds and nanoseconds;
--             returns whether there is such a time, or may be none
--   forms     list of the forms of a line with a frame, behind the time, of which the first that
--             matches reads the line: {
--               pattern     its captures are the arguments of read
--               read        function(log, captures), which returns a record, with its time if that
--                           is among them; nil if it is damaged
--               like        pattern, in lower case: a line that has it was a frame
--               needs_time  true if a line without a time is of another program }
--   known     patterns, in lower case, of lines without a frame
--   event     pattern of others: such a line is known if it is not like a frame; or nil
--   note      function(log, line, record, offset), called once for each line, in their order
--   read_usual  function(log, lines), which reads a line of the usual form without a record: it
--             returns as Log:read, nil for another line; or nil }
-- A record is a frame as packet needs it, and { bus = its name or nil, stamp = to compare }.
local char, find, match, sub = string.char, string.find, string.match, string.sub
local memo = require "yapp.base.memo"
local utf8 = require "yapp.base.utf8"

local M = {}

local BLOCK = 65536 -- bytes read at once
-- Bytes of a line that may be understood.
local MAX_LINE = 4096
local MAX_REPORTED = 3 -- lines for each reason
local UNKNOWN = "not understood, counts as a lost packet"
local UNREADABLE = "the file cannot be read behind byte %d (%s): a compressed file may be " ..
  "damaged, or cut off; what was read until there is shown"
local SECOND = 1000000000 -- nanoseconds

-- Lines -------------------------------------------------------------------------------------------

local Lines = {}
Lines.__index = Lines

--- Make the lines of a file.
-- text  string: the first bytes of the file, which is right behind them
function M.lines(text)
  return setmetatable({
    text = text, -- a part of the file
    base = 0, -- the offset of the text
    pos = 1, -- index at which the next line begins
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

--- Return a frame as a packet of link type LINUX_SLL2: the cooked header, the SocketCAN header, the
-- data.  (Wireshark takes the id in the host's order here, and this is the usual one.)
-- number  of the bus
-- record  { id = with SocketCAN's flags, data = bytes; fd, sent = booleans or nil; length = bytes,
--         or nil for those of the data; flags = 4 FDF, 2 ESI, 1 BRS, or nil }
function M.packet(number, record)
  -- Protocol, reserved, interface index, device type, packet type, no address
  return (record.fd and "\0\13\0\0" or "\0\12\0\0") .. BIG_ENDIAN[number] ..
    (record.sent and "\1\24\4" or "\1\24\0") .. "\0\0\0\0\0\0\0\0\0" ..
    LITTLE_ENDIAN[record.id] .. char(record.length or #record.data, record.flags or 0, 0, 0) ..
    record.data
end

-- A line ------------------------------------------------------------------------------------------

--- Return so many data bytes, and the index behind them; nil if there are fewer.
-- data     text that begins with them
-- pattern  of a byte, which captures its digits and the index behind it
-- base     of the digits
function M.parse_bytes(data, count, pattern, base)
  local bytes, stop = {}, 1
  for i = 1, count do
    local digits
    digits, stop = match(data, pattern, stop)
    local value = digits and tonumber(digits, base)
    if not value or value > 255 then return nil end
    bytes[i] = char(value)
  end
  return table.concat(bytes), stop
end

-- Return whether a record is of a frame that there may be.
local function is_good(record)
  local length = record.length or record.data and #record.data
  return record.id and length and length <= (record.fd and 64 or 8)
end

-- Return the record of a line, nil if it has no frame.
local function record_of(log, line)
  local format = log.format
  local stamp, from = match(line, format.stamp)
  for _, form in ipairs(format.forms) do
    local a, b, c, d, e, f, g = match(line, form.pattern, from)
    if a and (stamp or not form.needs_time) then
      local record = form.read(log, a, b, c, d, e, f, g)
      local has_frame = record and is_good(record) and format.set_time(record, stamp)
      return has_frame and record or nil
    end
  end
  return nil
end

-- Return what a line without a frame is: "known"; "lost", a frame before it was damaged, as by the
-- zeros that a file has where its recorder lost power; or "doubtful".
local function kind_of(format, line)
  if find(line, "\0", 1, true) then return "lost" end
  line = line:lower()
  for _, pattern in ipairs(format.known) do
    if find(line, pattern) then return "known" end
  end
  for _, form in ipairs(format.forms) do
    if find(line, form.like) then return "lost" end
  end
  return format.event and find(line, format.event) and "known" or "doubtful"
end

-- Logs --------------------------------------------------------------------------------------------

local Log = {}
Log.__index = Log

--- Parse a line.
-- line     text without its line end; colours are dropped
-- returns  its record; nil, and "known", "lost" or "doubtful" for a line without a frame
function Log:parse(line)
  if #line > MAX_LINE then return nil, "lost" end
  if find(line, "\27", 1, true) then line = line:gsub("\27%[[%d;]*m", "") end
  local record = record_of(self, line)
  return record, not record and kind_of(self.format, line) or nil
end

--- Make a log of the first bytes of a file, which may be of its format.
-- head    string
-- is_all  true if they are the whole file
-- format  see above
-- log     the state of the format, to which fields are added: { records = list of the frames in the
--         whole lines of the head, others = number of lines that were not understood, before =
--         text of those in front of the first frame, "" for none; has_several = true if there are
--         several buses, stamps_differ = true if the frames have different times }
function M.new(head, is_all, format, log)
  log.format = format
  log.records, log.others, log.before = {}, 0, ""
  log.has_several, log.stamps_differ = false, false
  setmetatable(log, Log)
  local lines = is_all and head or head:match("^.*\n") or ""
  for line in lines:gmatch("[^\n]+") do
    local record, kind = log:parse(line)
    local first = log.records[1] or record
    if record then
      table.insert(log.records, record)
      log.has_several = log.has_several or record.bus ~= first.bus
      log.stamps_differ = log.stamps_differ or record.stamp ~= first.stamp
    elseif kind ~= "known" then
      log.others = log.others + 1
      if not first then log.before = log.before .. line .. "\n" end
    end
  end
  return log
end

--- Begin to read the log.
-- head    string: the first bytes of the file, which is right behind them
-- report  function(text), called with a note on a line
-- returns  the log
function Log:open(head, report)
  self.report = report
  self.lines = M.lines(head)
  self.again = M.lines("") -- for the frames that are read once more
  self.frames = 0 -- that were read
  self.reported = {} -- number of lines, by reason
  self.buses = {} -- { number, name = fit to be printed }, by the record's bus
  self.bus_count = 0
  self.times = {} -- by the frame's offset: nanoseconds since self.start, if its record lacks them
  self.start = 0 -- seconds since 1970
  self.drops = {} -- as readers.log returns them
  self.placed = 0 -- number of drops with the frame behind them
  self.lost, self.doubtful = 0, 0 -- number of lines since the latest frame
  return self
end

--- Report a line.  Of each reason only the first lines are reported.
-- why  text
function Log:quote(line, why)
  local count = (self.reported[why] or 0) + 1
  self.reported[why] = count
  if count > MAX_REPORTED then return end
  local shown = utf8.printable(line:sub(1, 50):match("^%s*(.-)%s*$"))
  local message = ('line %d: %s: "%s"'):format(self.lines.number, why, shown)
  if count == MAX_REPORTED then message = message .. "; further ones are not reported" end
  self.report(message)
end

-- Set the frame behind the latest drops, and its time; none at the end of the file.  A doubtful
-- line counts only between two frames: in front of them and behind them may be lines of a shell.
local function place_drops(self, frame, time)
  local count = self.lost + (frame and frame > 1 and self.doubtful or 0)
  self.lost, self.doubtful = 0, 0
  if count > 0 then table.insert(self.drops, { count = count }) end
  for i = self.placed + 1, #self.drops do
    self.drops[i].frame, self.drops[i].time = frame, time
  end
  self.placed = #self.drops
end

-- Return the time of a frame, nil without one.
local function time_of(self, record, offset)
  local time = self.times[offset]
  if not time then return record.seconds, record.nanoseconds end
  return self.start + math.floor(time / SECOND), time % SECOND
end

-- Account for a frame that is read for the first time.
local function add_frame(self, record, offset)
  local name = record.bus
  if name and not self.buses[name] then
    self.buses[name] = { number = self.bus_count, name = utf8.printable(name) }
    self.bus_count = self.bus_count + 1
  end
  self.frames = self.frames + 1
  local seconds, nanoseconds = time_of(self, record, offset)
  place_drops(self, self.frames, seconds and seconds + nanoseconds / SECOND)
end

-- Read the next frame of these lines, see Log:read.
local function read_any(self, lines, file)
  local line, offset = lines:next(file)
  if not line then
    if lines == self.lines then place_drops(self) end
    return nil
  end
  local record, kind = self:parse(line)
  if lines == self.lines then
    if kind == "lost" or kind == "doubtful" then
      self[kind] = self[kind] + 1
      self:quote(line, UNKNOWN)
    end
    self.format.note(self, line, record, offset)
    if record then add_frame(self, record, offset) end
  end
  if not record then return read_any(self, lines, file) end
  local bus = self.buses[record.bus]
  local seconds, nanoseconds = time_of(self, record, offset)
  return offset, M.packet(bus and bus.number or 0, record), seconds, nanoseconds, bus
end

-- The same; first try the usual form.
local function read(self, lines, file)
  if self.read_usual then
    local offset, packet, seconds, nanoseconds, bus = self:read_usual(lines)
    if offset then return offset, packet, seconds, nanoseconds, bus end
  end
  return read_any(self, lines, file)
end

--- Read the next frame.
-- file     the file that was opened
-- returns  its offset, the packet's bytes (link type LINUX_SLL2), the seconds and nanoseconds since
--          1970 or since the first frame (nil without a time), the bus { number, name } or nil.
--          Nil at the end
function Log:read(file)
  return read(self, self.lines, file)
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
