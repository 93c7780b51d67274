-- SPDX-License-Identifier: GPL-2.0-or-later
-- What revisits need to know of CAN frames.  Pure Lua.
--
-- A good message is packed into a string, so nothing is kept of its fragments.  Frames 7, 8 and 10
-- with offset 16 make a good message of 9 bytes:
--
--   starts[1] = 7 * 2^17 + 16
--   texts[1] = "|\3\1\2" and the payload: "!" where a fault is set; number of fragments;
--              distances of their packets
--
-- A Start of 32 bytes without any fragment behind it is "-32".  Any other message is kept as it is,
-- in broken[1]: its text is "|" or "!" alone.

local can_id = require "yapp.wire.can_id"
local crc = require "yapp.wire.crc"
local frame_key = require "yapp.base.frame_key"

local M = {}

local NONE = {}
local byte, insert, sub = string.byte, table.insert, string.sub
local last_until, number_of = frame_key.last_until, frame_key.number
local PACKET = frame_key.PACKET

-- [distance of two frame keys] = as a character
local CHARS = {}
for packets = 1, 255 do CHARS[packets * PACKET] = string.char(packets) end

local FAULT, LONE = byte("!"), byte("-")
local MAX_BEFORE = 8 -- so many messages of a slot may begin inside another one

local DUPLICATE = {
  expert = "fragment.duplicate",
  text = "Duplicate of the fragment before it: the CRC is good without it",
}

local Store = {}
Store.__index = Store

--- Make the store of one capture.
function M.new()
  return setmetatable({
    slots = {}, -- [slot] = see new_slot
    anomalies = {}, -- [frame key] = a line for each: expert item, lost (-1 for nil), text
    originals = {}, -- [frame key of a fragment that came twice] = that of the fragment it repeats
  }, Store)
end

local function new_slot(source)
  return {
    source = source,
    starts = {}, -- frame keys, which ascend
    texts = {},
    broken = {}, -- messages, false for one that is packed
    latest = {}, -- the message that was found last
    at = 0, -- its index
    index = 0, -- of its fragment that was found
  }
end

-- Return the text of a message; nil for one that is not packed.
local function pack(message, has_fault)
  local count, distances = CHARS[#message * PACKET], ""
  if message.reserved or message.padding or not count then return nil end
  if message.status == "superseded" and #message == 1 then return "-" .. message.size end
  if message.status ~= "good" then return nil end
  for i = 2, #message do
    local distance = CHARS[message[i] - message[i - 1]]
    if not distance then return nil end
    distances = distances .. distance
  end
  return (has_fault and "!" or "|") .. count .. distances .. message.payload
end

--- Keep a message that has ended.
-- has_fault  whether it has a fault flag set
function Store:keep(message, has_fault)
  local slot = self.slots[message.slot]
  if not slot then
    slot = new_slot(message.source)
    self.slots[message.slot] = slot
  end
  local start, text = message[1], pack(message, has_fault)
  local at = last_until(slot.starts, start, #slot.starts) + 1
  insert(slot.starts, at, start)
  insert(slot.texts, at, text or has_fault and "!" or "|")
  insert(slot.broken, at, not text and message)
  for key, original in pairs(message.duplicates or NONE) do self.originals[key] = original end
end

local function line_of(anomaly)
  return ("%s %.1f %s\n"):format(anomaly.expert, anomaly.lost or -1, anomaly.text)
end

--- Keep the anomalies of a frame.  If its message is not known yet, the list may be empty.
function Store:keep_anomalies(key, list)
  local lines = ""
  for _, anomaly in ipairs(list) do
    if not anomaly.is_withdrawn then lines = lines .. line_of(anomaly) end
  end
  self.anomalies[key] = lines
end

--- Forget an anomaly of a frame, as nothing is wrong after all.
function Store:withdraw(key, anomaly)
  local lines, line = self.anomalies[key] or "", line_of(anomaly)
  local from, to = lines:find(line, 1, true)
  if from then self.anomalies[key] = sub(lines, 1, from - 1) .. sub(lines, to + 1) end
end

--- Return the anomalies of a frame that still hold; nil where none were kept.
function Store:anomalies_of(key)
  if self.originals[key] then return { DUPLICATE } end
  local lines, list = self.anomalies[key], {}
  if not lines then return nil end
  for expert, lost, text in lines:gmatch("(%S+) (%S+) ([^\n]*)\n") do
    lost = tonumber(lost)
    list[#list + 1] = { expert = expert, lost = lost >= 0 and lost or nil, text = text }
  end
  return list
end

--- Forget the newest packet: a read filter dropped it, and the next packet has its number.  Its
-- frames get keys that no frame has (key - 0.5).
-- key      of the first frame of the next packet
-- message  of the newest frame, or false
function Store:drop(key, message)
  self.anomalies[key], self.originals[key] = nil, nil
  if not message or number_of(message[#message]) ~= number_of(key) then return end
  local slot = message.payload and self.slots[message.slot]
  local at = slot and last_until(slot.starts, message[1])
  for i = #message, 1, -1 do
    if number_of(message[i]) == number_of(key) then message[i] = message[i] - 0.5 end
  end
  if not slot then return end
  slot.starts[at], slot.texts[at], slot.broken[at] = message[1], sub(slot.texts[at], 1, 1), message
end

-- Return the message of a slot with this index.
local function message_at(slot, at, fields)
  local text, key = slot.texts[at], slot.starts[at]
  local has_fault = byte(text) == FAULT
  if #text == 1 then
    local message = slot.broken[at]
    message.has_fault = has_fault
    return message
  end
  if byte(text) == LONE then
    return { key, source = slot.source, has_fault = false, status = "superseded",
      size = tonumber(sub(text, 2)) }
  end
  local count = byte(text, 2)
  local payload = sub(text, count + 2)
  local message = {
    key, nil, nil, nil, nil,
    source = slot.source,
    has_fault = has_fault,
    status = "good",
    size = #payload,
    crc = crc.update(can_id.seed(fields, #payload), payload),
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
local function find_in(slot, key, fields)
  local latest, found = slot.latest, nil
  local index = last_until(latest, key, slot.index + 1)
  if latest[index] == key and latest.status == "good" then
    slot.index = index
    return latest, index
  end
  local last = last_until(slot.starts, key, slot.at + 1)
  for at = last, math.max(last - MAX_BEFORE, 1), -1 do
    local message = message_at(slot, at, fields)
    local is_good = message.status == "good"
    index = last_until(message, key)
    if message[index] == key and (is_good or not found) then
      found, slot.latest, slot.at, slot.index = message, message, at, index
      if is_good then break end
    end
  end
  return found, slot.index
end

--- Return the message in a slot that has a frame as a fragment, and the index of the fragment; nil
-- for none.
-- frame  as can.reassembly takes it
function Store:find(slot, frame)
  local of_slot, key = self.slots[slot], self.originals[frame.key] or frame.key
  if of_slot then return find_in(of_slot, key, frame.can_id) end
end

return M
