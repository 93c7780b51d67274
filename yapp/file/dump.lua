-- SPDX-License-Identifier: GPL-2.0-or-later
-- A raw serial dump as records: what `cat /dev/ttyUSB0 > run.yapp` saved.  Pure Lua, 5.2 and 5.4; the file is
-- anything with read and seek.

local M = {}

local CHUNK = 65536
local AHEAD = 1048576 -- how far to look for a time stamp; what is read on the way is kept
local LONGEST = 65536 -- bytes of no frame in one record: Wireshark takes four times as much

local UNKNOWN = {} -- a time

local Dump = {}
Dump.__index = Dump

-- Reads on; whether there was anything more.
function Dump:fill(file)
  if self.ended then return false end
  local bytes = self.head or file:read(CHUNK)
  self.head = nil
  local events
  if bytes and #bytes > 0 then
    events = self.framer:feed(bytes)
  else
    events, self.ended = self.framer:finish(), true
  end
  if self.next > self.last then self.events, self.next, self.last = {}, 1, 0 end
  for _, event in ipairs(events) do
    self.last = self.last + 1
    self.events[self.last] = event
  end
  return true
end

-- The next event, reading on as far as it takes; it stays the next one.
function Dump:peek(file)
  while self.next > self.last do
    if not self:fill(file) then return nil end
  end
  return self.events[self.next]
end

function Dump:drop()
  self.events[self.next] = nil
  self.next = self.next + 1
end

-- Takes the next event; the bytes of no frame between two frames are one, however they were read.
function Dump:take(file)
  local event = self:peek(file)
  if not event then return nil end
  self:drop()
  if event.kind ~= "skipped" then return event end
  local from, bytes = event.from, event.bytes
  while #bytes < LONGEST do
    local following = self:peek(file)
    if not following or following.kind ~= "skipped" then break end
    self:drop()
    bytes = bytes .. following.bytes
  end
  if #bytes > LONGEST then
    self.next = self.next - 1
    self.events[self.next] = { kind = "skipped", from = from + LONGEST, bytes = bytes:sub(LONGEST + 1) }
    bytes = bytes:sub(1, LONGEST)
  end
  return { kind = "skipped", from = from, bytes = bytes }
end

local function new_dump(new_framer, time_of, head)
  return setmetatable({ framer = new_framer(), time_of = time_of, head = head, events = {}, next = 1, last = 0,
    offsets = {}, times = {}, skipped = {} }, Dump)
end

-- The controller's own time of a frame, nil without one.
local function stamp(time_of, event)
  local seconds, nanoseconds = time_of(event.bytes)
  return seconds and { seconds, nanoseconds }
end

-- Reads on until a message has a time stamp, at most so far.
-- returns  whether there was a frame with a good CRC
function Dump:look_ahead(file)
  local found, at = false, 1
  while self.framer:offset() < AHEAD and self:fill(file) do
    for i = at, self.last do
      if self.events[i].good then
        found, self.time = true, stamp(self.time_of, self.events[i])
        if self.time then return true end
      end
    end
    at = self.last + 1
  end
  return found
end

-- Drops what comes before the next frame with a good CRC; returns that frame, or nil.
function Dump:find_frame(file)
  while self:peek(file) do
    if self.events[self.next].good then return self.events[self.next] end
    self:drop()
  end
end

--- A dump about to be read.
-- file        at its first byte, or behind `head`
-- new_framer  function() -> a serial.stream
-- time_of     function(frame bytes) -> seconds, nanoseconds of the message's own time stamp, nil without one
-- head        the first bytes, where they have been read already
-- returns     nil for a file that holds no frame with a good CRC.  Only where the first of them comes late is the file
--             read from its beginning again, so a pipe will do.
function M.open(file, new_framer, time_of, head)
  local dump = new_dump(new_framer, time_of, head ~= "" and head or nil)
  if dump:look_ahead(file) then return dump end
  local late = dump:find_frame(file)
  if not late or not file:seek("set", 0) then return nil end
  dump = new_dump(new_framer, time_of)
  dump.time = stamp(time_of, late)
  return dump
end

--- The next record.
-- returns  { offset =, bytes =, seconds =, nanoseconds =, skipped = true or nil }, nil at the end.  A record is a frame
--          or a range of bytes that belong to none (skipped).  Its time is the controller's own where the message has a
--          time stamp, else that of the record before; in front of the first one, that of the first one if it comes
--          soon, else nil.
function Dump:read(file)
  local event = self:take(file)
  if not event then return nil end
  local time = event.good and stamp(self.time_of, event)
  if time then
    self.time = time
  else -- a second look cannot work these out
    time = self.time or UNKNOWN
    self.times[event.from] = time
  end
  self.offsets[#self.offsets + 1] = event.from -- in order: the next one says where this one ends
  self.stop = event.from + #event.bytes
  local skipped = event.kind == "skipped" or nil
  if skipped then self.skipped[event.from] = true end
  return { offset = event.from, bytes = event.bytes, seconds = time[1], nanoseconds = time[2], skipped = skipped }
end

-- Where a record ends: where the next begins; nil for the last.
local function next_offset(offsets, offset)
  local low, high = 1, #offsets
  while low <= high do
    local middle = (low + high - (low + high) % 2) / 2
    if offsets[middle] <= offset then low = middle + 1 else high = middle - 1 end
  end
  return offsets[low]
end

--- A record again.
-- offset   of a record that was read before
-- returns  as from read
function Dump:read_again(file, offset)
  local stop = next_offset(self.offsets, offset) or self.stop
  if not file:seek("set", offset) then return nil end
  local bytes = file:read(stop - offset)
  if not bytes then return nil end
  local time = self.times[offset] or { self.time_of(bytes) }
  return { offset = offset, bytes = bytes, seconds = time[1], nanoseconds = time[2],
    skipped = self.skipped[offset] }
end

return M
