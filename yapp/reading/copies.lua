-- SPDX-License-Identifier: GPL-2.0-or-later
-- Finds messages that the recorder holds twice: it hears its own sends, or records with `-i any`,
-- at a mirror port, behind a radio that repeats.  Pure Lua.
--
-- A copy has the bytes of an earlier message of its source, and comes less than 20 ms and less than
-- half a period after it: a controller that hangs repeats its bytes after a whole period.  A sender
-- may repeat a message without a clock, as a Command: that is a copy only where messages with a
-- clock are recorded twice, too.

local M = {}

local abs, min = math.abs, math.min
local MAX_DISTANCE = 0.02 -- seconds
local HALF_NANOSECOND = 5e-10 -- rounding error of a difference of two times
local MAX_KEPT = 16 -- messages of a source within this time

local SEQS = {} -- [Seq No] = as a character
for seq = 0, 255 do SEQS[seq] = string.char(seq) end

local Copies = {}
Copies.__index = Copies

--- Make the finder of one capture.
-- capture  a capture.capture, asked whether a time is real
function M.new(capture)
  return setmetatable({
    capture = capture,
    by_source = {}, -- [source] = its latest messages that are no copies, see new_list
    are_doubled = {}, -- [bus key, or "line"] = true once a message with a clock had a copy there
    originals = {}, -- [frame key of a copy] = that of its original, for revisits
  }, Copies)
end

-- The latest messages of a source: entries { key, time, text }, used in a ring.  A message takes
-- the entry of the oldest one if that is too old, so most sources need one entry.
local function new_list(source)
  local message_type = source.type
  return {
    oldest = 1, -- index of the entry to use next
    by_text = {}, -- [text_of a message] = its entry
    distance = min(MAX_DISTANCE, (message_type and message_type.every or 1) / 2) - HALF_NANOSECOND,
    has_clock = message_type and message_type.time ~= nil or false,
    bus = source.line and "line" or source.bus_key or false,
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
    table.insert(list, index, entry)
  elseif list.by_text[entry.text] == entry then
    list.by_text[entry.text] = nil
  end
  entry.key, entry.time, entry.text = message.key, message.time, text
  list.by_text[text] = entry
  list.oldest = index % #list + 1
end

-- Return whether a message is a copy of another one with the same bytes.
local function is_copy(self, list, message, equal)
  local time, are_doubled = message.time, self.are_doubled
  local is_near = abs(time - equal.time) < list.distance and self.capture:is_time_real(time)
  if is_near and list.has_clock then are_doubled[list.bus] = true end
  return is_near and are_doubled[list.bus] or false
end

--- Find the original of a message, in the order of the capture.
-- message       of reading.messages
-- visited       true on a revisit: then return the same as before
-- is_only_pass  true if it is never asked for again
-- returns       frame key of the message that it is a copy of; nil if it is none
function Copies:find(message, visited, is_only_pass)
  if visited then return self.originals[message.key] end
  local list, text = self.by_source[message.source], text_of(message)
  if not list then
    list = new_list(message.source)
    self.by_source[message.source] = list
  end
  local equal = list.by_text[text]
  local original = equal and is_copy(self, list, message, equal) and equal.key or nil
  -- A read filter may have dropped a copy whose number this packet has.
  if not is_only_pass and original ~= self.originals[message.key] then
    self.originals[message.key] = original
  end
  if not original then keep(list, message, text) end
  return original
end

return M
