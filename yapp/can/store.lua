-- SPDX-License-Identifier: GPL-2.0-or-later
-- The memory of CAN frames for revisits.  Pure Lua.
--
-- A good message is packed into a string, so nothing is kept of its fragments.  Frames 7, 8 and 10
-- with offset 16 make a good message of 9 bytes:
--
--   starts[1] = 7 * 2^17 + 16
--   messages[1] = "|\3\1\2" and the payload: "!" where a fault is set; number of fragments;
--                 distances of their packets
--
-- Any other message is kept as it is.

local frame_key = require "yapp.base.frame_key"

local M = {}

local byte, sub = string.byte, string.sub
local last_until, number_of = frame_key.last_until, frame_key.number
local PACKET = frame_key.PACKET

-- [distance of two frame keys] = as a character
local CHARS = {}
for packets = 1, 255 do CHARS[packets * PACKET] = string.char(packets) end

local FAULT = byte("!")
local MAX_BEFORE = 8 -- so many messages of a slot may begin inside another one

local DUPLICATES = { {
  expert = "fragment.duplicate",
  text = "Duplicate of the fragment before it: the CRC is good without it",
} }

local Store = {}
Store.__index = Store

--- Make the store of one capture.
function M.new()
  return setmetatable({
    slots = {}, -- [slot] = see new_slot
    -- [message key][frame key] = list: a frame of another message may get the frame key
    anomalies = {},
    originals = {}, -- [frame key of a fragment that came twice] = that of the fragment it repeats
  }, Store)
end

local function new_slot(source)
  return {
    source = source,
    starts = {}, -- frame keys, which ascend
    messages = {}, -- packed, or as they are
    latest = {}, -- the message that was found last
  }
end

-- Return the text of a message; nil for one that is not packed.
local function pack(message)
  local count, distances = CHARS[#message * PACKET], ""
  local is_usual = message.status == "good" and not (message.reserved or message.padding)
  if not (is_usual and count) then return nil end
  for i = 2, #message do
    local distance = CHARS[message[i] - message[i - 1]]
    if not distance then return nil end
    distances = distances .. distance
  end
  return (message.has_fault and "!" or "|") .. count .. distances .. message.payload
end

--- Keep a message that has ended.
function Store:keep(message)
  local slot = self.slots[message.slot]
  if not slot then
    slot = new_slot(message.source)
    self.slots[message.slot] = slot
  end
  local index = last_until(slot.starts, message[1]) + 1
  table.insert(slot.starts, index, message[1])
  table.insert(slot.messages, index, pack(message) or message)
end

--- Keep the anomalies of a frame.  If its message is not known yet, the list may be empty.
-- message_key  of its CAN id
-- list         see can.reassembly
function Store:keep_anomalies(key, message_key, list)
  local of_key = self.anomalies[message_key]
  if not of_key then
    of_key = {}
    self.anomalies[message_key] = of_key
  end
  of_key[key] = list
end

--- Keep that a fragment came twice.
-- key, original  frame keys: of the second one, and of the first
-- message_key    of their CAN id
function Store:keep_duplicate(key, message_key, original)
  self.originals[key] = original
  self:keep_anomalies(key, message_key, DUPLICATES)
end

--- Return the anomalies of a frame that still hold; nil where none were kept.
function Store:anomalies_of(key, message_key)
  local of_key, list = self.anomalies[message_key], {}
  local kept = of_key and of_key[key]
  if not kept then return nil end
  for _, anomaly in ipairs(kept) do
    if not anomaly.is_withdrawn then list[#list + 1] = anomaly end
  end
  return list
end

--- Forget the newest packet, see frame_key.forget.
-- key          of the first frame of the next packet
-- message_key  of the newest frame
-- message      of the newest frame, or false
function Store:forget(key, message_key, message)
  local of_key = self.anomalies[message_key]
  if of_key then of_key[key] = nil end
  self.originals[key] = nil
  if not message or number_of(message[#message]) ~= number_of(key) then return end
  local slot = message.payload and self.slots[message.slot]
  local index = slot and last_until(slot.starts, message[1])
  frame_key.forget(message, number_of(key))
  if not slot then return end
  slot.starts[index], slot.messages[index] = message[1], message
end

-- Return the message of a slot with this index.  A packed one has no `crc`: compute it if needed.
local function message_at(slot, index)
  local text, key = slot.messages[index], slot.starts[index]
  if type(text) == "table" then return text end
  local count = byte(text, 2)
  local payload = sub(text, count + 2)
  local message = {
    key, nil, nil, nil, nil,
    source = slot.source,
    has_fault = byte(text) == FAULT,
    status = "good",
    size = #payload,
    payload = payload,
  }
  for i = 2, count do
    key = key + byte(text, i + 1) * PACKET
    message[i] = key
  end
  return message
end

-- Return the message of a slot that has a frame as a fragment, and the index of the fragment; nil
-- for none.  A good message wins: a broken one only seemed to have the frame.
local function find_in(slot, key)
  local found, found_index = slot.latest, last_until(slot.latest, key)
  if found[found_index] == key and found.status == "good" then return found, found_index end
  local last = last_until(slot.starts, key)
  found = nil
  for i = last, math.max(last - MAX_BEFORE, 1), -1 do
    local message = message_at(slot, i)
    local index, is_good = last_until(message, key), message.status == "good"
    if message[index] == key and (is_good or not found) then
      found, found_index, slot.latest = message, index, message
      if is_good then break end
    end
  end
  return found, found_index
end

--- Return the message in a slot that has a frame as a fragment, and the index of the fragment; nil
-- for none.
function Store:find(slot, key)
  local of_slot = self.slots[slot]
  if of_slot then return find_in(of_slot, self.originals[key] or key) end
end

return M
