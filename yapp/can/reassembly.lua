-- SPDX-License-Identifier: GPL-2.0-or-later
-- Reassembly: finds the CAN frames of YAPP, and makes messages of their Start, Middle and End
-- fragments ("Multi-Frame CAN YAPP").  Pure Lua.
--
-- A slot is ID, CTL and Seq on one bus: usually one message at a time is open there, else
-- can.interleaved has several.  A message is reported once, by the frame that decides it.  Its
-- record is
--   1 .. n     frame keys of its fragments (base.frame_key)
--   slot, source; time = of its latest frame
--   size, crc, reserved (nil for 0)  as its Start says
--   chunks     while it alone is open in its slot: the bytes of the fragments behind the Start, up
--              to the first that the capture truncated; received = number of bytes on the bus;
--              is_truncated
--   status     nil while it is open; then "good", "bad" (CRC), "incomplete", "overrun" or
--              "truncated" (by the capture)
--   payload    once its last fragment has come
--   padding    of CAN FD, nil for 0
--   received   bytes, of an incomplete or overrun message; calculated = CRC, of a bad one
--   has_fault  see mark_fault
--   twin       the message whose Start is the same and came next to this one's; is_copy = true once
--              the twin has ended
--   is_overtaken  see can.interleaved

local can_id = require "yapp.wire.can_id"
local frame_key = require "yapp.base.frame_key"
local interleaved = require "yapp.can.interleaved"

local M = {}

local concat = table.concat
local END = can_id.END

local MAX_OPEN = 1024 -- an open message costs memory until something ends it
local MAX_IN_SLOT = 4 -- open messages of one slot
local MAX_WASTE = 4096 -- bytes behind the size of a message that does not end
local MAX_DISTANCE = 0.02 -- seconds between a frame and its copy, as of reading.copies

local LOSSES = { -- by status
  incomplete = "The message that started in frame %d is incomplete: %d of %d bytes came",
  overrun = "The message that started in frame %d has %d bytes instead of %d",
}
local DUPLICATE = {
  expert = "fragment.duplicate",
  text = "Duplicate of a fragment before it: the CRC is good without it",
}
local DUPLICATES = { DUPLICATE }

local Reassembly = {}
Reassembly.__index = Reassembly

--- Make the reassembly of one capture.
-- capture     a capture.capture, asked whether a time is real
-- on_unknown  function(id, seq), called at each Start of an ID that has no message type
function M.new(capture, on_unknown)
  return setmetatable({
    capture = capture,
    on_unknown = on_unknown,
    max_open = MAX_OPEN, -- slots that may be open at once
    open = {}, -- [slot] = the message that is open there, or can.interleaved of several
    open_count = 0,
    ended = {}, -- [slot] = the good message that ended there last
    accepted = {}, -- [message ID] = true once a Start of it was accepted
    -- For revisits, by frame key.  If a read filter (-R) drops a packet, the next one gets its
    -- number, and the later one wins.
    transfers = {}, -- the message of a fragment; false if it turned out to be of none
    kept_anomalies = {},
    -- Of the newest frame:
    anomalies = false,
    keeps = true, -- true if it may be visited again
  }, Reassembly)
end

-- Losses -----------------------------------------------------------------------------------------

-- Add an anomaly of the newest frame: { expert = name of an expert item, text }.
-- text, ...  as for string.format
local function add_anomaly(self, expert, text, ...)
  self.anomalies = self.anomalies or {}
  table.insert(self.anomalies, { expert = expert, text = text:format(...) })
end

-- A message ends.  If a recorder holds its Start twice, the other one may be lost without a word.
local function mark_twin(message)
  if message.twin then message.twin.is_copy = true end
end

-- End a message that has more or fewer bytes than its size, or no End.
local function lose(self, message, received)
  mark_twin(message)
  local status = received > message.size and "overrun" or "incomplete"
  message.status, message.chunks, message.received = status, nil, received
  if message.is_copy then return end
  local number = frame_key.number(message[1])
  add_anomaly(self, "fragment." .. status, LOSSES[status], number, received, message.size)
end

local function close(self, slot)
  self.open[slot], self.open_count = nil, self.open_count - 1
end

-- Give up all open messages: too many Starts came without their Ends.
local function give_up_all(self)
  local text = "%d messages are open: all of them are given up"
  add_anomaly(self, "fragment.incomplete", text, self.open_count)
  for _, open in pairs(self.open) do
    for _, message in ipairs(open.messages or { open }) do
      message.status, message.chunks = "incomplete", nil
    end
  end
  self.open, self.open_count = {}, 0
end

-- Good and damaged messages ----------------------------------------------------------------------

-- End a message that has all its bytes.
-- fields     of its CAN ids (wire.can_id)
-- padding    how many of the payload's bytes are CAN FD padding
-- truncated  true if the capture truncated it; else the CRC decides
local function finish(self, message, fields, payload, padding, truncated)
  if padding > 0 then
    message.padding, payload = padding, payload:sub(1, message.size)
  end
  message.payload, message.chunks = payload, nil
  if truncated then
    message.status = "truncated"
    return
  end
  local calculated = can_id.crc(fields, payload, message.reserved)
  if calculated == message.crc then
    message.status = "good"
    self.ended[message.slot] = message
  else
    message.status, message.calculated = "bad", calculated
  end
end

-- End the open message of a slot with its last frame.
local function end_message(self, message, frame, padding)
  local chunks = message.chunks
  close(self, frame.slot)
  message.time = frame.time
  if padding then
    finish(self, message, frame.can_id, concat(chunks), padding, chunks.is_truncated)
  else
    message.payload = concat(chunks)
    lose(self, message, chunks.received)
  end
  return "last", message
end

-- Messages that are open at the same time --------------------------------------------------------

-- Return whether a frame came so soon before or after another one that it may be its copy.
local function is_near(self, time, other_time)
  return math.abs(time - other_time) < MAX_DISTANCE and self.capture:is_time_real(time)
end

-- Assign frames of a group to a message.  Until then, they seemed to be of the newest one when they
-- came.
local function assign_frames(self, message, frames)
  local transfers = self.transfers
  for i = #message, 2, -1 do
    if transfers[message[i]] == message then transfers[message[i]] = false end
    message[i] = nil
  end
  for i, frame in ipairs(frames) do
    local key = frame.key
    local seeming = transfers[key] -- of another slot, if a read filter dropped this frame
    local is_open = seeming and not seeming.status and seeming.slot == message.slot
    message[i + 1] = key
    if seeming == false or is_open then transfers[key] = message end
  end
end

local function give_up_oldest(self, group)
  local message, frames, received = group:remove_oldest()
  assign_frames(self, message, frames)
  lose(self, message, received)
end

-- Make the newest message of a group the only one of its slot: it gets all frames since its Start.
local function reopen_newest(self, group, slot)
  while group.messages[2] do give_up_oldest(self, group) end
  local message, frames, received = group:remove_oldest()
  assign_frames(self, message, frames)
  message.chunks = { received = received }
  for i, frame in ipairs(frames) do message.chunks[i] = frame.data end
  self.open[slot] = message
  return message
end

-- Report the frames that no message can have any more: frames that came twice, or strangers.
-- message  the good message among whose frames they came
local function report_rest(self, frames, message)
  local strangers = {}
  for _, frame in ipairs(frames) do
    if not frame.is_repeated then
      strangers[#strangers + 1] = frame
    elseif self.keeps then
      self.transfers[frame.key], self.kept_anomalies[frame.key] = message, DUPLICATES
    end
  end
  if not strangers[1] then return end
  local text = "Fragments of no message: %d, the first in frame %d"
  add_anomaly(self, "fragment.orphan", text, #strangers, frame_key.number(strangers[1].key))
end

-- End the message that an End completes.
-- returns  it; nil for none
local function complete(self, group, frame)
  local message, frames, padding, rest = group:complete()
  if not message then return nil end
  local chunks = {}
  for i, one in ipairs(frames) do chunks[i] = one.data end
  assign_frames(self, message, frames)
  mark_twin(message)
  message.time = frame.time
  finish(self, message, frame.can_id, concat(chunks), padding, false)
  report_rest(self, rest, message)
  if not group.messages[1] then close(self, frame.slot) end
  return message
end

-- Read a Middle or End of a slot in which several messages are open.
local function add_interleaved(self, group, frame)
  local data, is_end = frame.data, frame.can_id.ctrl == END
  if #data < frame.reported then -- the CRC cannot decide any more
    reopen_newest(self, group, frame.slot)
    return self:add_fragment(frame)
  end
  local newest = group.messages[#group.messages]
  newest[#newest + 1], newest.time = frame.key, frame.time -- as it seems
  group:add_frame(frame.key, data, is_end)
  if is_end then
    local message = complete(self, group, frame)
    if message then return "last", message end
    if group.end_count >= #group.messages then -- no other End is to come
      message = reopen_newest(self, group, frame.slot)
      local needed = #data + message.size - message.chunks.received
      return end_message(self, message, frame, can_id.padding(data, #data, needed))
    end
  elseif group:is_full() then
    while group.messages[1] do give_up_oldest(self, group) end
    close(self, frame.slot)
  end
  return "fragment", newest
end

-- Make room in a slot for the message of a new Start.
-- has_message  false for a Start that has none: then nothing stays open
-- returns      the group of the messages that stay open; nil if none does
local function make_room(self, open, frame, has_message)
  local chunks = open.chunks
  if chunks and chunks.is_truncated then
    lose(self, open, chunks.received)
    return close(self, frame.slot)
  end
  local group = chunks and interleaved.new(frame.can_id, open, true) or open
  local messages = group.messages
  while messages[1] do
    local oldest = messages[1]
    local may_stay = has_message and not (oldest.is_overtaken or oldest.is_copy)
    if may_stay and #messages < MAX_IN_SLOT then break end
    give_up_oldest(self, group)
  end
  if not messages[1] then return close(self, frame.slot) end
  self.open[frame.slot] = group
  return group
end

-- Starts -----------------------------------------------------------------------------------------

-- Add the anomalies of a Start's captured bytes.
local function check_start(self, frame, size, reserved)
  local known, least, length = frame.source.size, frame.source.min_size, frame.reported
  if length ~= 8 then
    local expert = length > 8 and "size.mismatch" or "fragment.incomplete"
    add_anomaly(self, expert, "A Start has 8 bytes, this one has %d", length)
  end
  if not reserved then return end
  if size == 0 then
    add_anomaly(self, "size.mismatch", "The size of the message is 0")
  elseif known and (size > known or size < least) then
    local text = "The size is %d bytes, the catalogue says %d"
    add_anomaly(self, "size.mismatch", text, size, known)
  end
  if reserved ~= 0 then
    add_anomaly(self, "reserved.nonzero", "The reserved bytes are 0x%04x, not 0", reserved)
  end
end

-- Return whether a Start is YAPP's.  Unless the user says that every frame is, it must be
-- plausible.  An unknown ID needs Seq No 0, or an earlier Start that was accepted.  The Start of a
-- known ID may be truncated.
local function is_plausible(self, frame, size, reserved)
  local fields, is_known = frame.can_id, frame.source.size
  if frame.accepts_all then return true end
  if fields.ctl ~= 0 or frame.reported ~= 8 then return false end
  if not reserved then return is_known end
  if reserved ~= 0 or size <= 8 then return false end
  return is_known or fields.seq == 0 or self.accepted[fields.id]
end

-- Make two messages twins if a recorder holds their Start twice: the second one came next.
local function add_twin(self, before, message)
  local is_same = before.crc == message.crc and before.size == message.size
  if #before == 1 and is_same and is_near(self, message.time, before.time) then
    before.twin, message.twin = message, before
  end
end

local function add_start(self, frame)
  local sum, size, reserved = can_id.start(frame.data)
  if not is_plausible(self, frame, size, reserved) then return nil end
  local slot, fields = frame.slot, frame.can_id
  self.accepted[fields.id] = true
  if not frame.source.size then self.on_unknown(fields.id, fields.seq) end
  local open, has_message = self.open[slot], reserved and size > 0
  local group = open and make_room(self, open, frame, has_message)
  check_start(self, frame, size, reserved)
  if not has_message then return "other" end
  local message = {
    frame.key, nil, nil, nil, nil, -- with room for the usual message of five frames
    slot = slot,
    source = frame.source,
    time = frame.time,
    size = size,
    crc = sum,
    chunks = not group and { nil, nil, nil, nil, received = 0, is_truncated = false } or nil,
    status = nil,
    payload = nil,
  }
  if reserved ~= 0 then message.reserved = reserved end
  if group then
    add_twin(self, group.messages[#group.messages], message)
    table.insert(group.messages, message)
    return "fragment", message
  end
  if self.open_count >= self.max_open then give_up_all(self) end
  self.open[slot], self.open_count = message, self.open_count + 1
  return "fragment", message
end

-- Middles and Ends -------------------------------------------------------------------------------

-- Return whether an End came twice: it equals that of the message that ended in its slot.
local function is_repeated_end(self, frame)
  local message = frame.can_id.ctrl == END and self.ended[frame.slot]
  if not message or not is_near(self, frame.time, message.time) then return false end
  local length = frame.reported - (message.padding or 0)
  return length > 0 and frame.data:sub(1, length) == message.payload:sub(-length)
end

-- Read a Middle or End of a slot without an open message.
local function add_orphan(self, frame)
  local fields = frame.can_id
  if not frame.accepts_all and (fields.ctl ~= 0 or not frame.source.size) then return nil end
  if is_repeated_end(self, frame) then
    self.anomalies = DUPLICATES
  else
    local name = can_id.CTRL_NAMES[fields.ctrl]
    add_anomaly(self, "fragment.orphan", "%s fragment: no Start captured", name)
  end
  return "other"
end

--- Add a Middle or End.
-- returns  as Reassembly:add
function Reassembly:add_fragment(frame)
  local message = self.open[frame.slot]
  if not message then return add_orphan(self, frame) end
  local chunks = message.chunks
  if not chunks then return add_interleaved(self, message, frame) end
  local data, reported, size, padding = frame.data, frame.reported, message.size, nil
  local received, is_end = chunks.received + reported, frame.can_id.ctrl == END
  local was_truncated, index = chunks.is_truncated, #message
  if #data < reported then chunks.is_truncated = true end
  if is_end then
    padding = can_id.padding(data, reported, size - chunks.received)
    if not padding and received > size and not chunks.is_truncated then
      return add_interleaved(self, interleaved.new(frame.can_id, message, false), frame)
    end
  end
  message[index + 1] = frame.key
  message.time = frame.time
  chunks.received = received
  if not was_truncated then chunks[index] = data end
  if is_end then return end_message(self, message, frame, padding) end
  if received > size + MAX_WASTE then
    close(self, frame.slot)
    lose(self, message, received)
  end
  return "fragment", message
end

-- Other frames -----------------------------------------------------------------------------------

-- A message of one frame has a record of its own, with these fields alone.
local function add_single(_, frame)
  local data, reported, source = frame.data, frame.reported, frame.source
  local size = source.size and can_id.single_size(data, reported, source.min_size, source.size)
  if not (frame.accepts_all or size and frame.can_id.ctl == 0) then return nil end
  return "single", {
    frame.key,
    source = source,
    size = size or reported,
    status = #data == reported and "good" or "truncated",
    payload = data:sub(1, size or reported),
    padding = reported - (size or reported),
  }
end

local function add_undefined(self, frame)
  if not frame.accepts_all then return nil end
  add_anomaly(self, "can.ctrl.invalid", "CAN CTRL is %d; 0 to 3 are defined", frame.can_id.ctrl)
  return "other"
end

-- By CAN CTRL: (reassembly, frame) -> kind, message.
local ADDERS = { [0] = add_single, add_start, Reassembly.add_fragment, Reassembly.add_fragment }
for ctrl = #ADDERS + 1, 15 do ADDERS[ctrl] = add_undefined end

-- Frames ------------------------------------------------------------------------------------------

--- Add the next frame of the capture.
-- frame    see reading.records
-- returns  nil for a frame that is not YAPP's, else its kind: "single"; "fragment", of a message;
--          "last", with which a message ends; "other", which has no message, as the anomalies say
--          the message of a fragment or single frame, as it seems while several are open
--          its list of anomalies, or false
function Reassembly:add(frame)
  local key, keeps = frame.key, not frame.is_only_pass
  self.anomalies, self.keeps = false, keeps
  local kind, message = ADDERS[frame.can_id.ctrl](self, frame)
  local anomalies = self.anomalies
  if keeps then
    local transfers, kept = self.transfers, self.kept_anomalies
    if kind == "fragment" or kind == "last" then
      transfers[key] = message
    elseif transfers[key] ~= nil then -- of a packet that a read filter dropped
      transfers[key] = nil
    end
    if kind == "other" or anomalies or kept[key] then
      kept[key] = anomalies or kind == "other" and {} or nil
    end
  end
  return kind, message, anomalies
end

--- Mark that a message has a fault flag set: revisits of its fragments show it.
function M.mark_fault(message)
  message.has_fault = true
end

--- Recall a frame that was added before.
-- returns  as Reassembly:add, and the index of the frame in its message; of a fragment that came
--          twice, the index of the one before
function Reassembly:recall(frame)
  local key = frame.key
  local message, anomalies = self.transfers[key], self.kept_anomalies[key]
  if message and message.slot % can_id.BUS == frame.can_id.message_key then
    local is_last = message.payload and message[#message] == key
    return is_last and "last" or "fragment", message, anomalies, frame_key.last_until(message, key)
  elseif anomalies or message == false then
    return message == false and "fragment" or "other", nil, anomalies
  elseif frame.can_id.ctrl == 0 then
    return add_single(self, frame)
  end
end

--- Return the messages that the capture ends before, in the order of their Starts: a list of
-- { message, is_lost = true if a later Start or an End came }.
function Reassembly:unfinished()
  local list = {}
  for _, open in pairs(self.open) do
    local messages, has_end = open.messages or { open }, (open.end_count or 0) > 0
    for i, message in ipairs(messages) do
      local is_lost = i < #messages or message.is_overtaken or has_end
      if not message.is_copy then list[#list + 1] = { message = message, is_lost = is_lost } end
    end
  end
  table.sort(list, function(a, b) return a.message[1] < b.message[1] end)
  return list
end

return M
