-- A raw serial dump as records: what `cat /dev/ttyUSB0 > run.yapp` saved.  Pure Lua, 5.2 and 5.4; the file is
-- anything with read and seek.

local M = {}

local CHUNK = 65536
local PROBE = 1048576 -- a dump has a frame with a good CRC this early, or it is not taken for one

--- Whether a file is a dump: it holds a frame with a good CRC.
-- new_framer  function() -> a yapp_stream
function M.recognise(file, new_framer)
  local framer, length = new_framer(), 0
  while length < PROBE do
    local bytes = file:read(CHUNK)
    if not bytes or #bytes == 0 then return false end
    for _, event in ipairs(framer:feed(bytes)) do
      if event.good then return true end
    end
    length = length + #bytes
  end
  return false
end

local Dump = {}
Dump.__index = Dump

--- A dump about to be read from its first byte.
-- new_framer  function() -> a yapp_stream
-- time_of     function(frame bytes) -> seconds, nanoseconds of the message's own time stamp, nil without one
function M.new(new_framer, time_of)
  return setmetatable({ framer = new_framer(), time_of = time_of, events = {}, next = 1, offsets = {}, times = {},
    seconds = 0, nanoseconds = 0 }, Dump)
end

-- The next event of the stream, reading on as far as it takes.
function Dump:event(file)
  while not self.events[self.next] do
    if self.ended then return nil end
    local bytes = file:read(CHUNK)
    if bytes and #bytes > 0 then
      self.events = self.framer:feed(bytes)
    else
      self.events, self.ended = self.framer:finish(), true
    end
    self.next = 1
  end
  local event = self.events[self.next]
  self.events[self.next], self.next = false, self.next + 1
  return event
end

--- The next record.
-- returns  { offset =, bytes =, seconds =, nanoseconds = }, nil at the end.  A record is a frame or a range of bytes
--          that belong to none.  Its time is the controller's own where the message has a time stamp, else that of
--          the record before.
function Dump:read(file)
  local event = self:event(file)
  if not event then return nil end
  local offset, bytes = event.from, event.bytes
  local seconds, nanoseconds
  if event.good then seconds, nanoseconds = self.time_of(bytes) end
  if seconds then
    self.seconds, self.nanoseconds = seconds, nanoseconds
  else -- a second look cannot work these out
    self.times[offset] = { self.seconds, self.nanoseconds }
  end
  self.offsets[#self.offsets + 1] = offset -- in order: the next one says where this one ends
  return { offset = offset, bytes = bytes, seconds = self.seconds, nanoseconds = self.nanoseconds }
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
  local stop = next_offset(self.offsets, offset) or self.framer:offset()
  if not file:seek("set", offset) then return nil end
  local bytes = file:read(stop - offset)
  if not bytes then return nil end
  local seconds, nanoseconds
  local time = self.times[offset]
  if time then
    seconds, nanoseconds = time[1], time[2]
  else
    seconds, nanoseconds = self.time_of(bytes)
  end
  return { offset = offset, bytes = bytes, seconds = seconds, nanoseconds = nanoseconds }
end

return M
