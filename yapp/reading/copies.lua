-- SPDX-License-Identifier: GPL-2.0-or-later
-- Finds messages that the recorder holds twice: its own sends and what it hears, `-i any`, a mirror
-- port, a radio that repeats.  Pure Lua.
--
-- A copy has the bytes of an earlier message of its source, and comes less than 20 ms and less than
-- half a period after it: a controller that hangs repeats its bytes after a whole period.  Without
-- times of packets nothing is a copy.

local M = {}

local abs, max, min = math.abs, math.max, math.min
local MAX_DISTANCE = 0.02 -- seconds
local HALF_NANOSECOND = 5e-10 -- rounding error of a difference of two times
local MAX_KEPT = 16 -- messages of a source within this time

local Copies = {}
Copies.__index = Copies

--- Make the finder of one capture.
-- buses  a host.buses, asked whether the capture lacks times or a clock
function M.new(buses)
  return setmetatable({
    is_timed = not buses:lacks_clock(),
    -- If not, at the time of the first packet it is not known yet whether times advance.
    stamps_differ = buses:stamps_differ(),
    -- [source] = list of its latest messages that are no copies, and
    --   start   when the first one came
    --   others  when other sources' latest messages came, see stands_still; nil until it is asked
    by_source = {},
    originals = {}, -- [frame key of a copy] = that of its original, for revisits
  }, Copies)
end

-- The CRC as it was sent is equal if the bytes are, unless it is bad.
local function bad_crc_of(message)
  return message.status == "bad" and message.transfer.crc
end

-- Entries are used again for later messages: most sources need one.
local function fill(entry, message)
  entry.key, entry.time, entry.seq = message.key, message.time, message.seq
  entry.payload, entry.bad_crc = message.payload, bad_crc_of(message)
end

-- Keep a message that is no copy, in the entry of one that is too old.
local function keep(list, message, distance)
  for _, entry in ipairs(list) do
    if abs(message.time - entry.time) >= distance then return fill(entry, message) end
  end
  local entry = #list < MAX_KEPT and {} or table.remove(list, 1)
  fill(entry, message)
  list[#list + 1] = entry
end

-- Return when the latest of some messages came.
local function latest_of(list)
  local latest = list.start
  for _, entry in ipairs(list) do latest = max(latest, entry.time) end
  return latest
end

-- Whether the stamps of a source mean nothing: it has had one stamp, as some programs give all that
-- they send, while another source advanced.  It is asked at each copy with that stamp.
local function stands_still(self, list)
  local before, now = list.others, {}
  for source, other in pairs(self.by_source) do
    now[source] = latest_of(other)
    if before and now[source] - (before[source] or other.start) >= MAX_DISTANCE then return true end
  end
  list.others = before or now
  return false
end

-- Return the frame key of an equal message that is near, nil for none.
local function find_in(self, list, message, distance)
  local bad_crc = bad_crc_of(message)
  for _, entry in ipairs(list) do
    local is_equal = entry.payload == message.payload and entry.seq == message.seq
    if is_equal and entry.bad_crc == bad_crc and abs(message.time - entry.time) < distance then
      return not (message.time == list.start and stands_still(self, list)) and entry.key or nil
    end
  end
end

--- Whether time stamps tell what is a copy.
-- time  of a message or packet, seconds since the first packet
function Copies:can_judge(time)
  return self.is_timed and (self.stamps_differ or time ~= 0)
end

--- Find the original of a message, in the order of the capture.
-- message       of reading.messages; on a revisit, return what was found before
-- is_only_pass  whether it is never asked for again
-- returns       frame key of the message that it is a copy of; nil if it is none
function Copies:find(message, is_only_pass)
  if message.visited then return self.originals[message.key] end
  if not self.is_timed then return nil end
  local source, time = message.source, message.time
  local of_type = source.message
  local distance = of_type and of_type.every or 1
  distance = min(MAX_DISTANCE, distance / 2) - HALF_NANOSECOND
  local list = self.by_source[source]
  if not list then
    list = { start = time, others = nil }
    self.by_source[source] = list
  end
  local original = self:can_judge(time) and find_in(self, list, message, distance) or nil
  -- A read filter may have dropped a copy whose number this packet has.
  if not is_only_pass and original ~= self.originals[message.key] then
    self.originals[message.key] = original
  end
  if not original then keep(list, message, distance) end
  return original
end

return M
