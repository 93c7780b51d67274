-- SPDX-License-Identifier: GPL-2.0-or-later
-- A raw serial dump as packets: the file of `cat /dev/ttyUSB0 > run.yapp`.  Pure Lua.

local memo = require "yapp.base.memo"

local Dump = {}
Dump.__index = Dump

local CHUNK = 65536
local MAX_AHEAD = 1048576 -- bytes to search for a time stamp; they are kept
local MAX_SKIPPED = 65536 -- bytes of no frame in a record; Wireshark takes four times that
local ID_FROM, ID_TO = 5, 8 -- bytes of a frame that are its ID

-- A record is an exported PDU: it names its dissector, and its port type, UDP, says that it is
-- complete in itself.  Bytes between frames may look like the start of a frame.  Only the bytes
-- behind them prove that they are not, so they have the port type IPX, see serial.lines.
local TAGS = "\0\12\0\12yapp_serial\0\0\24\0\4\0\0\0%s\0\0\0\0" -- each with its length
local FRAME, SKIPPED = TAGS:format("\3"), TAGS:format("\5")

-- Times ------------------------------------------------------------------------------------------

-- A time is a number of nanoseconds, exact up to 2^53: a controller that runs for 104 days.
local SECOND = 1e9
local MAX_STEP = 1 * SECOND

-- Read more bytes, and append their findings.
function Dump:fill(file)
  local bytes = self.head or file:read(CHUNK) or ""
  self.head, self.is_over = nil, bytes == ""
  self.framer:add(bytes, self.is_over, self.findings)
end

-- Return the controller's own time of a frame, nil for none.
function Dump:stamp(finding)
  if finding.status ~= "good" then return nil end
  local seconds, nanoseconds = self.time_of(finding.bytes)
  return seconds and seconds * SECOND + nanoseconds
end

-- Return how far the time of the dump is ahead of a clock that begins with this stamp.  Messages of
-- one controller have one clock.  So use the clock of the latest message if that makes a small step
-- forward; else time goes on from the latest record.
--   latest record at 102.9 s, its clock 2.9 s: 3.0 s of another ID is 103.0 s, 0.05 s is 102.9 s
local function shift_of(self, stamp)
  local ahead = stamp + self.shift - self.time
  return ahead >= 0 and ahead < MAX_STEP and self.shift or self.time - stamp
end

-- Return the clock of an ID that goes on with a stamp, the one that advances least; nil for none.
-- The clock before a reboot does not: at its time the dump was long ago.
local function clock_of(self, clocks, stamp)
  local found
  for _, clock in ipairs(clocks) do
    local goes_on = clock.last <= stamp and stamp + clock.shift > self.time - MAX_STEP
    if goes_on and (not found or clock.last > found.last) then found = clock end
  end
  return found
end

-- Advance the time of the dump by a stamp.  It never goes back: a controller that rebooted has
-- a new clock, and so has another controller with the same ID.
-- id  of the message
local function advance(self, id, stamp)
  self.time = self.time or stamp
  local clock = clock_of(self, self.clocks[id], stamp)
  if not clock then
    clock = { shift = shift_of(self, stamp) }
    table.insert(self.clocks[id], clock)
  end
  clock.last, self.shift = stamp, clock.shift
  self.time = math.max(self.time, stamp + clock.shift)
end

--- Open a dump.
-- file     at its first byte, or behind `head`; a pipe will do
-- options  { new_framer = function() -> a serial.framer,
--            time_of = function(bytes of a frame) -> seconds, nanoseconds of the message's own time
--            stamp, nil for none }
-- head     string: the first bytes, if they have been read
-- returns  a log with read and seek_read; nil for a file that holds no good frame
function Dump.open(file, options, head)
  local self = setmetatable({
    framer = options.new_framer(),
    time_of = options.time_of,
    head = head,
    decimals = 9,
    lacks_clock = true, -- controllers made its times
    findings = {}, -- of the file; false once it is a record
    next = 1, -- index of the first one that is no record yet
    is_over = false,
    time = nil, -- of the latest record; before that, the first time stamp of the file
    clocks = memo(), -- by ID: list of { last = stamp, shift = of the dump's time from it }
    shift = 0, -- of the clock of the latest message that has one
    records = {}, -- [offset] = { length = bytes, tags = FRAME or SKIPPED, time }
  }, Dump)
  local has_frame, index = false, 1
  while not (self.is_over or has_frame and (self.time or self.framer.from >= MAX_AHEAD)) do
    self:fill(file)
    for i = index, #self.findings do
      local finding = self.findings[i]
      has_frame = has_frame or finding.status == "good"
      self.time = self.time or self:stamp(finding)
    end
    index = #self.findings + 1
  end
  return has_frame and self or nil
end

-- Return the next finding, nil at the end.  All bytes between two frames are one finding of at most
-- MAX_SKIPPED bytes, however they were read.
function Dump:next_finding(file)
  local finding = self.findings[self.next]
  local function may_grow()
    if not finding then return true end
    local is_last = finding.status == "skipped" and not self.findings[self.next + 1]
    return is_last and #finding.bytes < MAX_SKIPPED
  end
  while not self.is_over and may_grow() do
    self:fill(file)
    finding = self.findings[self.next]
  end
  if finding and finding.status == "skipped" and #finding.bytes > MAX_SKIPPED then
    local from, bytes = finding.from, finding.bytes
    finding.from, finding.bytes = from + MAX_SKIPPED, bytes:sub(MAX_SKIPPED + 1)
    return { status = "skipped", from = from, bytes = bytes:sub(1, MAX_SKIPPED) }
  end
  if finding then self.findings[self.next], self.next = false, self.next + 1 end
  return finding
end

-- Return a record as Wireshark takes it.
local function packet(record, offset, bytes)
  local time, data = record.time, record.tags .. bytes
  if not time then return offset, data end
  return offset, data, math.floor(time / SECOND), time % SECOND
end

--- Read the next record: a frame, or bytes of no frame.
-- returns  its offset, the packet's bytes (an exported PDU), seconds and nanoseconds; nil at the
--          end.  The time is the controller's own if the message has a time stamp, else that of the
--          record before.  It never goes back: if the controller reboots, it goes on.  Records
--          before the first time stamp get that one if it comes within MAX_AHEAD bytes, else nil
function Dump:read(file)
  local finding = self:next_finding(file)
  if not finding then return nil end
  local stamp = self:stamp(finding)
  if stamp then advance(self, finding.bytes:sub(ID_FROM, ID_TO), stamp) end
  local record = {
    length = #finding.bytes,
    time = self.time,
    tags = finding.status == "skipped" and SKIPPED or FRAME,
  }
  self.records[finding.from] = record
  return packet(record, finding.from, finding.bytes)
end

--- Read a record that was read before.
-- offset   of the record
-- returns  as Dump:read
function Dump:seek_read(file, offset)
  local record = self.records[offset]
  file:seek("set", offset)
  local bytes = file:read(record.length)
  if not bytes then return nil end
  return packet(record, offset, bytes)
end

return Dump
