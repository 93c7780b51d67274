-- SPDX-License-Identifier: GPL-2.0-or-later
-- Finds datagrams of a byte stream that the recorder holds twice, as with `-i any` or a mirror
-- port.  Pure Lua.
--
-- Frames are cut over packets, so copies must not come between the bytes of their originals:
--   packet 1  |start of A|    packet 2  the same    packet 3  |end of A|    packet 4  the same
--
-- Equal bytes are no proof: idle controllers send the same values.  Two packets with the header of
-- one ID within 20 ms are.  From there on, the packet behind the original is expected once more.
-- If packets are smaller than a header, they prove nothing: see serial.streams.

local frame = require "yapp.wire.frame"
local memo = require "yapp.base.memo"

local M = {}

local abs = math.abs
local MAX_DISTANCE = 0.02 -- seconds, as of reading.copies
local MAX_KEPT = 1024 -- packets of a stream
local ID_TO = 7 -- bytes of a header behind its first, up to the ID

local Repeats = {}
Repeats.__index = Repeats

local function new_stream()
  return {
    count = 0, -- of originals
    copies = { [0] = 0 }, -- [number of an original, modulo MAX_KEPT] = how many copies came
    -- [bytes] = { number, time } of the latest original; those of the last 20 ms at least
    recent = {},
    older = {},
    since = nil, -- when `recent` began
  }
end

--- Make the finder.
-- can_judge  function(time): true if time stamps tell copies from originals, see reading.copies
function M.new(can_judge)
  return setmetatable({ can_judge = can_judge, by_stream = memo(new_stream) }, Repeats)
end

-- Return whether bytes have the header of a frame up to its ID.
local function has_id(bytes)
  local start = frame.find(bytes, 1)
  while start and start + ID_TO <= #bytes do
    if frame.has_id(bytes, start) then return true end
    start = frame.find(bytes, start + 1)
  end
  return false
end

-- Return whether a packet is a copy of an original with its bytes.
local function is_copy(stream, original, packet)
  if abs(packet.time - original.time) >= MAX_DISTANCE then return false end
  local copies, number = stream.copies, original.number
  local is_next = copies[(number - 1) % MAX_KEPT] > copies[number % MAX_KEPT]
  return is_next or has_id(packet.bytes)
end

local function keep(stream, packet)
  if not stream.since or abs(packet.time - stream.since) >= MAX_DISTANCE then
    stream.recent, stream.older, stream.since = {}, stream.recent, packet.time
  end
  stream.count = stream.count + 1
  stream.copies[stream.count % MAX_KEPT] = 0
  stream.recent[packet.bytes] = { number = stream.count, time = packet.time }
end

--- Expect that each packet of a stream comes twice in a row.
-- key  of the stream, of which no packet came yet
function Repeats:expect_pairs(key)
  self.by_stream[key].copies[0] = 1 -- as if that were so of a packet before the first one
end

--- Compare the next packet of a stream with those before.
-- packet   see serial.streams, and time = seconds since the first packet
-- returns  0, or n if it is the n-th copy of one before
function Repeats:copy_number(packet)
  if not self.can_judge(packet.time) then return 0 end
  local stream, bytes = self.by_stream[packet.stream], packet.bytes
  local original = stream.recent[bytes] or stream.older[bytes]
  if original and is_copy(stream, original, packet) then
    local index = original.number % MAX_KEPT
    stream.copies[index] = stream.copies[index] + 1
    return stream.copies[index]
  end
  keep(stream, packet)
  return 0
end

return M
