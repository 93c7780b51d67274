-- SPDX-License-Identifier: GPL-2.0-or-later
-- What is kept of CAN frames for when Wireshark dissects them again.  Pure Lua.
--
-- Messages that have ended are kept as text, by slot in the order of their Starts; so nothing is
-- kept
-- of a fragment.  Frames 7, 8 and 10 with offset 16 make a good message of 9 bytes:
--
--   starts[1] = 7 * 2^17 + 16
--   texts[1] = "|\3\1\2" and the payload: "!" where a fault is set; number of fragments; distances
--   of
--     their packets
--
-- Another message, so if it is broken, has padding or more than 255 fragments:
--
--   texts[2] = "bad 0 9 3341729467 0 0 0 131072 262144\n" and the payload: status; 1 where a fault
--   is
--     set; size; CRC; reserved bytes; padding; bytes received; distances of the frame keys

local can_id = require "yapp.wire.can_id"
local crc = require "yapp.wire.crc"
local frame_key = require "yapp.base.frame_key"

local M = {}

local NONE = {}
local byte, concat, insert, max, sub = string.byte, table.concat, table.insert, math.max, string.sub
local last_until, number_of = frame_key.last_until, frame_key.number
local PACKET = frame_key.PACKET

-- [distance of two frame keys] = as a character
local CHARS = {}
for packets = 1, 255 do CHARS[packets * PACKET] = string.char(packets) end

local FAULT = byte("!")
local MAX_BEFORE = 8 -- messages of a slot that may begin behind one and before it ends

local DUPLICATE = {
  expert = "fragment.duplicate",
  text = "Duplicate of the fragment before it: the CRC is good without it",
}

local Store = {}
Store.__index = Store

--- Make the store of one capture.
function M.new()
  return setmetatable({
    -- [slot] = { source, starts = frame keys, texts, deltas, latest = message that was found last,
    -- at
    -- = index of its text, index = of the fragment }
    slots = {},
    buses = {}, -- [bus] = true where it has slots
    anomalies = {}, -- [frame key] = list, with message_key of the frame
    originals = {}, -- [frame key of a fragment that came twice] = that of the fragment it repeats
  }, Store)
end

-- The text of a usual message; nil of another one.
local function short_text(message, has_fault)
  local count = CHARS[#message * PACKET]
  if message.status ~= "good" or message.reserved or message.padding then return nil end
  if not count then return nil end
  local distances = ""
  for i = 2, #message do
    local distance = CHARS[message[i] - message[i - 1]]
    if not distance then return nil end
    distances = distances .. distance
  end
  return (has_fault and "!" or "|") .. count .. distances .. message.payload
end

local function long_text(message, has_fault)
  local words = { message.status, has_fault and 1 or 0, message.size, message.crc,
    message.reserved or 0, message.padding or 0, message.received or 0 }
  for i = 2, #message do words[#words + 1] = message[i] - message[i - 1] end
  return concat(words, " ") .. "\n" .. (message.payload or "")
end

--- Keep a message that has ended.
-- delta      number, which its message gets as delta when it is found
-- has_fault  whether it has a fault flag set
function Store:keep(message, delta, has_fault)
  local slot = self.slots[message.slot]
  if not slot then
    slot = { source = message.source, starts = {}, texts = {}, deltas = {}, latest = {}, at = 0,
      index = 0 }
    self.slots[message.slot] = slot
    self.buses[can_id.bus(message.slot)] = true
  end
  local at = last_until(slot.starts, message[1], #slot.starts) + 1
  insert(slot.starts, at, message[1])
  insert(slot.texts, at, short_text(message, has_fault) or long_text(message, has_fault))
  insert(slot.deltas, at, delta)
  for key, original in pairs(message.duplicates or NONE) do self.originals[key] = original end
end

--- Keep the anomalies of a frame; of one whose message is not sure, also an empty list.
-- fields  of its CAN id
function Store:keep_anomalies(key, fields, list)
  list.message_key = fields.message_key
  self.anomalies[key] = list
end

--- Return the anomalies of a frame that still hold; nil where none were kept.
function Store:anomalies_of(frame)
  if self.originals[frame.key] then return { DUPLICATE } end
  local kept = self.anomalies[frame.key]
  if not kept or kept.message_key ~= frame.can_id.message_key then return nil end
  local list = {}
  for _, anomaly in ipairs(kept) do
    if not anomaly.void then list[#list + 1] = anomaly end
  end
  return list
end

--- Forget the newest packet, as its number comes again: a read filter dropped it.  The keys of its
-- frames become such as no frame has.
-- key      of the first frame of the packet that has the number now
-- message  of the newest frame, or false
function Store:drop(key, message)
  self.anomalies[key], self.originals[key] = nil, nil
  if not message or number_of(message[#message]) ~= number_of(key) then return end
  for i = #message, 1, -1 do
    if number_of(message[i]) == number_of(key) then message[i] = message[i] - 0.5 end
  end
  if not message.payload then return end
  local slot = self.slots[message.slot]
  local at = last_until(slot.starts, message[1] + 0.5)
  slot.starts[at], slot.texts[at] = message[1], long_text(message, slot.texts[at]:find("^!"))
end

-- Makes a message from its text.
local function read(slot, at, fields)
  local text, key = slot.texts[at], slot.starts[at]
  local message = { key, nil, nil, nil, nil, source = slot.source, delta = slot.deltas[at],
    has_fault = false, status = "good", size = 0, crc = 0, payload = nil }
  if text:find("^[|!]") then
    local count = byte(text, 2)
    message.has_fault, message.payload = byte(text) == FAULT, sub(text, count + 2)
    message.size = #message.payload
    message.crc = crc.update(can_id.seed(fields, message.size), message.payload)
    for i = 2, count do
      key = key + byte(text, i + 1) * PACKET
      message[i] = key
    end
    return message
  end
  local words, head, payload = {}, text:match("^(.-)\n(.*)$")
  for word in head:gmatch("%S+") do words[#words + 1] = tonumber(word) or word end
  message.status, message.has_fault = words[1], words[2] == 1
  message.size, message.crc = words[3], words[4]
  message.reserved, message.padding, message.received = words[5], words[6], words[7]
  message.payload = message.status ~= "superseded" and payload or nil
  for i = 8, #words do
    key = key + words[i]
    message[i - 6] = key
  end
  if message.status == "bad" then
    local seed = can_id.seed(fields, message.size, message.reserved)
    message.calculated = crc.update(seed, payload)
  end
  return message
end

-- The message of a slot that has a frame as a fragment, and the index of that; nil for none.
local function find_in(slot, key, fields)
  local latest, found = slot.latest, nil
  local index = last_until(latest, key, slot.index + 1)
  if latest[index] == key and latest.status == "good" then
    slot.index = index
    return latest, index
  end
  local last = last_until(slot.starts, key, slot.at + 1)
  for at = last, max(last - MAX_BEFORE, 1), -1 do
    local message = read(slot, at, fields)
    index = last_until(message, key)
    local has_it, is_good = message[index] == key, message.status == "good"
    -- A good one has the frame; a broken one only seemed to have it.
    if has_it and (is_good or not found) then
      found, slot.latest, slot.at, slot.index = message, message, at, index
    end
    if has_it and is_good then break end
  end
  return found, slot.index
end

--- Return the message that has a frame as a fragment, and the index of that; nil for none.
-- frame  as can.reassembly takes it
function Store:find(frame)
  local slots, fields, key = self.slots, frame.can_id, self.originals[frame.key] or frame.key
  local slot = slots[frame.slot]
  local found, index = nil, nil
  if slot then found, index = find_in(slot, key, fields) end
  if found then return found, index end
  -- Behind a packet that a read filter dropped no bus is known.
  for bus in pairs(self.buses) do
    slot = slots[can_id.slot(fields, bus)]
    if slot then found, index = find_in(slot, key, fields) end
    if found then return found, index end
  end
end

return M
