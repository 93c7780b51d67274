-- SPDX-License-Identifier: GPL-2.0-or-later
-- Finds messages that the recorder holds twice: it hears its own sends, or records with `-i any`,
-- at a mirror port, behind a radio that repeats.  Pure Lua.
--
-- A copy has the bytes of an earlier message of its source, and comes less than 20 ms and less than
-- half a period after it: a controller that hangs repeats its bytes after a whole period.  It is in
-- another packet: no recorder writes a part of one twice.  A sender may repeat a message without a
-- clock, as a Command: that is a copy only where messages with a clock are recorded twice, too.

local memo = require "yapp.base.memo"
local number_of = require "yapp.base.frame_key".number

local Copies = {}
Copies.__index = Copies

local abs, min = math.abs, math.min
local MAX_DISTANCE = 0.02 -- seconds
local HALF_NANOSECOND = 5e-10 -- rounding error of a difference of two times
local MAX_KEPT = 16 -- messages of a source within this time

-- The latest messages of a source, oldest first.
local function new_list(source)
  local message_type = source.type
  return {
    distance = min(MAX_DISTANCE, (message_type and message_type.every or 1) / 2) - HALF_NANOSECOND,
    has_clock = message_type and message_type.time ~= nil or false,
    bus = source.line and "line" or source.bus_key or false,
  }
end

--- Make the finder of one capture.
-- capture  a capture.capture, asked whether a time is real
function Copies.new(capture)
  return setmetatable({
    capture = capture,
    by_source = memo(new_list), -- [source] = its latest messages that are no copies, see new_list
    are_doubled = {}, -- [bus key, or "line"] = true once a message with a clock had a copy there
    originals = {}, -- [frame key of a copy] = that of its original, for revisits
    copied_in = setmetatable({}, { __mode = "k" }), -- [message] = latest packet with a copy of it
  }, Copies)
end

-- Return whether a message with the same payload may be a copy of an earlier one.
local function is_repeated(kept, message, distance)
  return kept.seq == message.seq and kept.status == message.status and
    abs(message.time - kept.time) < distance
end

-- Find the original of a message among the latest ones of its source.
-- returns  its frame key; nil for a message that is no copy
local function find_in(self, list, message)
  local payload = message.payload
  for i = 1, #list do
    local kept = list[i]
    if kept.payload == payload and is_repeated(kept, message, list.distance) then
      local number = number_of(message.key)
      if number_of(kept.key) ~= number and self.copied_in[kept] ~= number then
        if not self.capture:is_time_real(message.time) then return nil end
        if list.has_clock then self.are_doubled[list.bus] = true end
        if not self.are_doubled[list.bus] then return nil end
        self.copied_in[kept] = number
        return kept.key
      end
    end
  end
end

--- Find the original of a message, in the order of the capture.
-- message       see Reading:read_message
-- visited       true on a revisit: then return the same as before
-- is_only_pass  true if it is never asked for again
-- returns       frame key of the message that it is a copy of; nil if it is none
function Copies:find(message, visited, is_only_pass)
  if visited then return self.originals[message.key] end
  local list, time = self.by_source[message.source], message.time
  local original = find_in(self, list, message)
  -- A read filter may have dropped a copy whose number this packet has.
  if not is_only_pass then self.originals[message.key] = original end
  if original then return original end
  while list[1] and (abs(time - list[1].time) >= list.distance or #list == MAX_KEPT) do
    table.remove(list, 1)
  end
  list[#list + 1] = message
end

return Copies
