-- SPDX-License-Identifier: GPL-2.0-or-later
-- A raw serial dump as packets: what `cat /dev/ttyUSB0 > run.yapp` saved.  Pure Lua.

local M = {}

local CHUNK = 65536
local AHEAD = 1048576 -- how far to look for a time stamp; what is read on the way is kept
local LONGEST = 65536 -- bytes of no frame in one record: Wireshark takes four times as much

-- A record is an exported PDU: it names its dissector, and a UDP port type says that it is complete
-- in itself.  Bytes between frames may look like the start of one, which only what follows them has
-- proved wrong.
local DISSECTOR, UDP = "\0\12\0\12", "\0\24\0\4\0\0\0\3\0\0\0\0" -- tags, each with its length
local FRAME = DISSECTOR .. "yapp_serial\0" .. UDP
local SKIPPED = DISSECTOR .. "yapp_skipped" .. UDP

local UNKNOWN = {} -- a time

local Dump = {}
Dump.__index = Dump

-- Reads on; whether there was anything more.
function Dump:fill(file)
  if self.ended then return false end
  local bytes = self.head or file:read(CHUNK) or ""
  self.head, self.ended = nil, bytes == ""
  local events = self.ended and self.framer:finish() or self.framer:feed(bytes)
  for _, event in ipairs(events) do
    self.last = self.last + 1
    self.events[self.last] = event
  end
  return true
end

-- The next event, which stays where it is; nil at the end.
function Dump:peek(file)
  while self.next > self.last and self:fill(file) do end
  return self.events[self.next]
end

-- Takes it.
function Dump:drop()
  self.events[self.next] = nil
  self.next = self.next + 1
end

-- Takes the next frame, or all bytes of no frame in front of it, however they were read.
function Dump:take_record(file)
  local event = self:peek(file)
  if not event then return nil end
  self:drop()
  if event.status ~= "skipped" then return event end
  local bytes, from = event.bytes, event.from
  event = self:peek(file)
  while #bytes < LONGEST and event and event.status == "skipped" do
    self:drop()
    bytes = bytes .. event.bytes
    event = self:peek(file)
  end
  local rest = bytes:sub(LONGEST + 1)
  if rest ~= "" then
    self.next = self.next - 1
    self.events[self.next] = { status = "skipped", from = from + LONGEST, bytes = rest }
  end
  return { status = "skipped", from = from, bytes = bytes:sub(1, LONGEST) }
end

-- The controller's own time of a frame, nil without one.
function Dump:stamp(event)
  if event.status ~= "good" then return nil end
  local seconds, nanoseconds = self.time_of(event.bytes)
  return seconds and { seconds, nanoseconds }
end

--- Opens a dump.
-- @param file at its first byte, or behind `head`; a pipe will do
-- @param options { new_framer = function() -> a serial.stream; time_of = function(frame bytes) ->
--   seconds, nanoseconds of the message's own time stamp, nil without one }
-- @param head the first bytes, where they have been read already
-- @return a log with read and seek_read; nil for a file that holds no frame with a good CRC
function M.open(file, options, head)
  local self = setmetatable({
    framer = options.new_framer(),
    time_of = options.time_of,
    head = head ~= "" and head or nil,
    decimals = 9,
    events = {}, -- read, and not given as records yet: events[next] to events[last]
    next = 1,
    last = 0,
    ended = false,
    time = nil, -- of the record before; of the first one that has a time
    records = {}, -- { length, time, is_skipped }, by offset
  }, Dump)
  local at, found = 1, false
  while not (found and (self.time or self.framer:offset() >= AHEAD)) and self:fill(file) do
    while at <= self.last and not self.time do
      found = found or self.events[at].status == "good"
      self.time = self:stamp(self.events[at])
      at = at + 1
    end
  end
  return found and self or nil
end

local function packet(record, offset, bytes)
  local time = record.time
  return offset, (record.is_skipped and SKIPPED or FRAME) .. bytes, time[1], time[2]
end

--- The next record: a frame or a range of bytes that belong to none.
-- @return its offset, the packet's bytes (an exported PDU), seconds and nanoseconds; nil at the
--   end.  The time is the controller's own where the message has a time stamp, else that of the
--   record before; in front of the first one, that of the first one if it comes soon, else nil
function Dump:read(file)
  local event = self:take_record(file)
  if not event then return nil end
  self.time = self:stamp(event) or self.time
  local record = {
    length = #event.bytes, time = self.time or UNKNOWN, is_skipped = event.status == "skipped",
  }
  self.records[event.from] = record
  return packet(record, event.from, event.bytes)
end

--- A record again.
-- @param offset of a record that was read before
-- @return as from read
function Dump:seek_read(file, offset)
  local record = self.records[offset]
  if not record or not file:seek("set", offset) then return nil end
  local bytes = file:read(record.length)
  if not bytes then return nil end
  return packet(record, offset, bytes)
end

return M
