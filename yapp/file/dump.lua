-- SPDX-License-Identifier: GPL-2.0-or-later
-- A raw serial dump as packets: what `cat /dev/ttyUSB0 > run.yapp` saved.  Pure Lua.

local M = {}

local CHUNK = 65536
local MAX_AHEAD = 1048576 -- bytes to search for a time stamp; they are kept
local MAX_SKIPPED = 65536 -- bytes of no frame in a record; Wireshark takes four times that

-- A record is an exported PDU: it names its dissector, and a UDP port type says that it is complete
-- in itself.  Bytes between frames may look like the start of a frame.  Only the bytes behind them
-- prove that they are not, so they have a dissector of their own.
local DISSECTOR, UDP = "\0\12\0\12", "\0\24\0\4\0\0\0\3\0\0\0\0" -- tags, each with its length
local FRAME = DISSECTOR .. "yapp_serial\0" .. UDP
local SKIPPED = DISSECTOR .. "yapp_skipped" .. UDP

local UNKNOWN = {} -- a time: { seconds, nanoseconds }

local Dump = {}
Dump.__index = Dump

-- Reads more bytes, and appends their events.
function Dump:fill(file)
  local bytes = self.head or file:read(CHUNK) or ""
  self.head, self.is_over = nil, bytes == ""
  self.framer:add(bytes, self.is_over, self.events)
end

-- Returns the controller's own time of a frame, nil for none.
function Dump:stamp(event)
  if event.status ~= "good" then return nil end
  local seconds, nanoseconds = self.time_of(event.bytes)
  return seconds and { seconds, nanoseconds }
end

--- Open a dump.
-- file     at its first byte, or behind `head`; a pipe will do
-- options  { new_framer = function() -> a serial.framer,
--            time_of = function(bytes of a frame) -> seconds, nanoseconds of the message's own time
--            stamp, nil for none }
-- head     string: the first bytes, if they have been read
-- returns  a log with read and seek_read; nil for a file that holds no good frame
function M.open(file, options, head)
  local self = setmetatable({
    framer = options.new_framer(),
    time_of = options.time_of,
    head = head,
    decimals = 9,
    lacks_clock = true, -- its times are those of controllers
    events = {}, -- of the file; false once it is a record
    next = 1, -- index of the first one that is no record yet
    is_over = false,
    time = nil,   -- of the latest record; before that, the first time stamp of the file
    records = {}, -- [offset] = { length = bytes, tags = FRAME or SKIPPED, time }
  }, Dump)
  local has_frame, index = false, 1
  while not (self.is_over or has_frame and (self.time or self.framer.from >= MAX_AHEAD)) do
    self:fill(file)
    for i = index, #self.events do
      local event = self.events[i]
      has_frame = has_frame or event.status == "good"
      self.time = self.time or self:stamp(event)
    end
    index = #self.events + 1
  end
  return has_frame and self or nil
end

-- Takes the next event, nil at the end.  All bytes between two frames are one event of at most
-- MAX_SKIPPED bytes, however they were read.
function Dump:next_event(file)
  local event = self.events[self.next]
  while not (self.is_over or event and (event.status ~= "skipped" or self.events[self.next + 1] or
    #event.bytes >= MAX_SKIPPED)) do
    self:fill(file)
    event = self.events[self.next]
  end
  if event and event.status == "skipped" and #event.bytes > MAX_SKIPPED then
    local from, bytes = event.from, event.bytes
    event.from, event.bytes = from + MAX_SKIPPED, bytes:sub(MAX_SKIPPED + 1)
    return { status = "skipped", from = from, bytes = bytes:sub(1, MAX_SKIPPED) }
  end
  if event then self.events[self.next], self.next = false, self.next + 1 end
  return event
end

-- Returns a record as Wireshark takes it.
local function packet(record, offset, bytes)
  return offset, record.tags .. bytes, record.time[1], record.time[2]
end

--- Read the next record: a frame, or bytes of no frame.
-- returns  its offset, the packet's bytes (an exported PDU), seconds and nanoseconds; nil at the
--          end.  The time is the controller's own if the message has a time stamp, else that of the
--          record before.  Records before the first time stamp get that one if it comes within
--          MAX_AHEAD bytes, else nil
function Dump:read(file)
  local event = self:next_event(file)
  if not event then return nil end
  self.time = self:stamp(event) or self.time
  local record = {
    length = #event.bytes,
    time = self.time or UNKNOWN,
    tags = event.status == "skipped" and SKIPPED or FRAME,
  }
  self.records[event.from] = record
  return packet(record, event.from, event.bytes)
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

return M
