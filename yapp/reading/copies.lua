-- SPDX-License-Identifier: GPL-2.0-or-later
-- Finds messages that the recorder holds twice: it hears its own sends, or records with `-i any`,
-- at a mirror port, behind a radio that repeats.  Pure Lua.
--
-- A copy has the bytes of an earlier message of its source, and comes less than 20 ms and less than
-- half a period after it: a controller that hangs repeats its bytes after a whole period.  Without
-- times of packets nothing is a copy.

local M = {}

local abs, max, min = math.abs, math.max, math.min
local insert = table.insert
local MAX_DISTANCE = 0.02 -- seconds
local HALF_NANOSECOND = 5e-10 -- rounding error of a difference of two times
local MAX_KEPT = 16 -- messages of a source within this time

local SEQS = {} -- [Seq No] = as a character
for seq = 0, 255 do SEQS[seq] = string.char(seq) end

local Copies = {}
Copies.__index = Copies

--- Make the finder of one capture.
-- buses  a capture.capture, asked whether the capture has times and a clock
function M.new(buses)
  local _, has_clock = buses:has_times()
  return setmetatable({
    is_timed = has_clock,
    -- If not, at the time of the first packet it is not known yet whether times advance.
    stamps_differ = buses:stamps_differ(),
    by_source = {}, -- [source] = its latest messages that are no copies, see new_list
    originals = {}, -- [frame key of a copy] = that of its original, for revisits
  }, Copies)
end

-- The latest messages of a source: entries { key, time, text }.  A message takes the entry of the
-- oldest one if that is too old, so most sources need one entry.
local function new_list(message)
  local of_type = message.source.type
  return {
    oldest = 1, -- index of the entry to use next
    by_text = {}, -- [text_of a message] = its entry
    distance = min(MAX_DISTANCE, (of_type and of_type.every or 1) / 2) - HALF_NANOSECOND,
    start = message.time, -- when the first one came
    others = nil, -- when other sources' latest messages came, see stands_still; nil until asked
  }
end

-- Return a text that is equal for equal messages.  If the CRC is good, it follows from the bytes.
local function text_of(message)
  local text = SEQS[message.seq] .. message.payload
  return message.status == "bad" and text .. message.transfer.crc or text
end

-- Keep a message that is no copy.
local function keep(list, message, text)
  local index = list.oldest
  local entry = list[index]
  if not entry or #list < MAX_KEPT and abs(message.time - entry.time) < list.distance then
    entry = {}
    insert(list, index, entry)
  elseif list.by_text[entry.text] == entry then
    list.by_text[entry.text] = nil
  end
  entry.key, entry.time, entry.text = message.key, message.time, text
  list.by_text[text] = entry
  list.oldest = index % #list + 1
end

-- Return when the latest of some messages came.
local function latest_of(list)
  local latest = list.start
  for _, entry in ipairs(list) do latest = max(latest, entry.time) end
  return latest
end

-- Return whether the stamps of a source mean nothing: it has had one stamp, as some programs give
-- all that they send, while another source advanced.  It is asked at each copy with that stamp.
local function stands_still(self, list)
  local before, now = list.others, {}
  for source, other in pairs(self.by_source) do
    now[source] = latest_of(other)
    if before and now[source] - (before[source] or other.start) >= MAX_DISTANCE then return true end
  end
  list.others = before or now
  return false
end

--- Return whether time stamps tell copies from originals.
-- time  of a message or packet, seconds since the first packet
function Copies:can_judge(time)
  return self.is_timed and (self.stamps_differ or time ~= 0)
end

--- Find the original of a message, in the order of the capture.
-- message       of reading.messages
-- visited       true on a revisit: then return the same as before
-- is_only_pass  true if it is never asked for again
-- returns       frame key of the message that it is a copy of; nil if it is none
function Copies:find(message, visited, is_only_pass)
  if visited then return self.originals[message.key] end
  if not self.is_timed then return nil end
  local list, time, text = self.by_source[message.source], message.time, text_of(message)
  if not list then
    list = new_list(message)
    self.by_source[message.source] = list
  end
  local equal, original = list.by_text[text], nil
  if equal and abs(time - equal.time) < list.distance and self:can_judge(time) and
    not (time == list.start and stands_still(self, list)) then
    original = equal.key
  end
  -- A read filter may have dropped a copy whose number this packet has.
  if not is_only_pass and original ~= self.originals[message.key] then
    self.originals[message.key] = original
  end
  if not original then keep(list, message, text) end
  return original
end

return M
