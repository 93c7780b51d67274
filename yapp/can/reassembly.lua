-- SPDX-License-Identifier: GPL-2.0-or-later
-- Reassembly: finds the CAN frames of YAPP, and makes messages of their Start, Middle and End
-- fragments ("Multi-Frame CAN YAPP").  Pure Lua.
--
-- A slot is ID, CTL and Seq on one bus: usually one message at a time is open there.  A message of
-- several frames is
--   1 .. n     frame keys of its fragments (base.frame_key)
--   slot, source; time = of its latest frame
--   size, crc, reserved (nil for 0)  as its Start says.  The stored record of a good message may
--              lack its crc and its time
--   chunks     while it is open and in no pool of can.interleaved: the bytes of the fragments
--              behind the Start, none of an overrun; received = their sum; repeated = bytes of
--              chunks that equal the one before, or nil; is_truncated = true if the payload goes on
--              behind the chunks: it is truncated by the capture, or too long
--   status     nil while it is open, but "overrun" if it is too long already, and "superseded" if a
--              pool keeps it open behind a new Start; then "good", "bad" (CRC), "incomplete",
--              "overrun", "truncated" (by the capture), or "superseded" by a new Start or given up
--   payload    once its last fragment has come
--   padding    of CAN FD, nil for 0
--   received   bytes, of an incomplete or overrun message; calculated = CRC, of a bad one
--   has_fault  of a stored one, as Reassembly:keep was told

local can_id = require "yapp.wire.can_id"
local frame_key = require "yapp.base.frame_key"
local interleaved = require "yapp.can.interleaved"
local store = require "yapp.can.store"

local M = {}

local concat = table.concat
local END = can_id.END

local MAX_OPEN = 1024 -- an open message costs memory until something ends it
local MAX_DISTANCE = 0.02 -- seconds between a frame and its copy, as of reading.copies

local MISFIT = { -- by status
  incomplete = "The message that started in frame %d ends with %d of %d bytes",
  overrun = "The message that started in frame %d has %d bytes instead of %d",
}

local Reassembly = {}
Reassembly.__index = Reassembly

--- Make the reassembly of one capture.
-- can_judge  function(time) -> true if time stamps tell copies from originals
-- on_unknown function(id, seq), called at each Start of an ID that has no message type
function M.new(can_judge, on_unknown)
  return setmetatable({
    can_judge = can_judge,
    on_unknown = on_unknown,
    max_open = MAX_OPEN, -- messages that may be open at once
    open = {}, -- [slot] = the message that is open there, or can.interleaved of several
    open_count = 0,
    ended = {}, -- [slot] = the good message that ended there last
    accepted = {}, -- [message ID] = true once a Start of it was accepted
    buses = {}, -- [bus, 0 for an unknown one] = true once a Start came there
    store = store.new(),
    -- Of the newest frame; false for none (COMPAT 5.2: nil makes the table anew).
    message = false,
    slot = -1, -- of no frame
    anomalies = false,
    keeps = true, -- true if it may be visited again
  }, Reassembly)
end

--- Add an anomaly of the newest frame.
-- message    the one that is lost by it, or nil
-- text, ...  as for string.format
-- returns    an anomaly: { expert = name of an expert item, text, lost = key of the Start of the
--            message that is lost, or nil, is_open = true if it may still be withdrawn,
--            is_withdrawn = true if a later frame has proved that nothing is wrong; is_copy =
--            true if a recorder holds the frame twice, so nothing is lost }
function Reassembly:add_anomaly(expert, message, text, ...)
  -- The others are nil until they are set: that halves the memory.
  local anomaly = { expert = expert, text = text:format(...), lost = message and message[1] }
  if not self.anomalies then self.anomalies = {} end
  table.insert(self.anomalies, anomaly)
  return anomaly
end

--- Return whether a frame came so soon before or after another one that it may be its copy.
function Reassembly:is_near(time, other_time)
  return math.abs(time - other_time) < MAX_DISTANCE and self.can_judge(time)
end

-- Return whether an End came twice: it equals that of the message that ended in its slot.
local function is_repeated_end(self, frame)
  local message = frame.can_id.ctrl == END and self.ended[frame.slot]
  if not message or not self:is_near(frame.time, message.time) then return false end
  local length = frame.reported - (message.padding or 0)
  return length > 0 and frame.data:sub(1, length) == message.payload:sub(-length)
end

--- Add that the message of a Middle or End is not known.
function Reassembly:add_orphan(frame)
  local name = can_id.CTRL_NAMES[frame.can_id.ctrl]
  local anomaly = self:add_anomaly("fragment.orphan", nil, "%s fragment: no Start captured", name)
  anomaly.is_copy = is_repeated_end(self, frame) or nil
  return anomaly
end

--- Add that a message has more or fewer bytes than its size.
-- returns  its status
function Reassembly:add_misfit(message, received)
  local status = received < message.size and "incomplete" or "overrun"
  message.received = received
  self:add_anomaly("fragment." .. status, message, MISFIT[status], frame_key.number(message[1]),
    received, message.size)
  return status
end

--- End a message.
-- fields   of its CAN ids (wire.can_id)
-- padding  how many of the payload's bytes are CAN FD padding; nil for none
-- status   where it is known; else the CRC decides between "good" and "bad"
function Reassembly:finish(message, fields, payload, padding, status)
  if (padding or 0) > 0 then
    message.padding, payload = padding, payload:sub(1, message.size)
  end
  message.payload, message.chunks, message.status = payload, nil, status
  if status then return end
  local calculated = can_id.crc(fields, payload, message.reserved)
  message.status = calculated == message.crc and "good" or "bad"
  -- COMPAT 5.2: only here, as to write nil under a name that has none makes the table anew.
  if message.status == "bad" then
    message.calculated = calculated
  else
    self.ended[message.slot] = message
  end
end

--- End a message that no last frame will show.  Keep a copy for revisits of its fragments:
-- it is a third as large.
function Reassembly:give_up(message)
  message.status, message.chunks = "superseded", nil
  if not self.keeps then return end
  local copy = { slot = message.slot, source = message.source, size = message.size,
    status = "superseded" }
  for i, key in ipairs(message) do copy[i] = key end
  self.store:keep(copy)
end

--- Keep that a fragment came twice.
-- key, original  frame keys: of the second one, and of the first
-- message_key    of their CAN id
function Reassembly:keep_duplicate(key, message_key, original)
  if self.keeps then self.store:keep_duplicate(key, message_key, original) end
end

-- Slots ------------------------------------------------------------------------------------------

local function close(self, slot)
  self.open[slot], self.open_count = nil, self.open_count - 1
end

-- The messages that are open in a slot, oldest Start first.
local function list_open(self, slot)
  local open = self.open[slot]
  return open and (open.messages and open:messages() or { open }) or {}
end

-- Return the newest message of each slot, in the order of their Starts.
local function list_newest(self)
  local list = {}
  for slot in pairs(self.open) do
    local messages = list_open(self, slot)
    list[#list + 1] = messages[#messages]
  end
  table.sort(list, function(a, b) return a[1] < b[1] end)
  return list
end

-- Give up the messages with the oldest Starts, to make room for one more.
local function make_room(self)
  local list = list_newest(self)
  local count = #list - math.floor(self.max_open / 2)
  for i = 1, count do
    local slot = list[i].slot
    for _, message in ipairs(list_open(self, slot)) do self:give_up(message) end
    close(self, slot)
  end
  self:add_anomaly("fragment.incomplete", nil,
    "%d messages are open: the oldest %d are given up", #list, count)
end

-- Make a pool of the open message in the slot of a frame.
local function make_pool(self, message, frame)
  for i = 2, self.keeps and #message or 0 do
    self.store:keep_anomalies(message[i], frame.can_id.message_key, {})
  end
  local pool = interleaved.new(self, message, frame.can_id)
  self.open[frame.slot] = pool
  return pool
end

-- Return whether a Start came twice: it equals that of a message without further fragments.
local function is_repeated_start(self, message, frame)
  local sum, size = can_id.start(frame.data)
  return #message == 1 and message.crc == sum and message.size == size and
    self:is_near(frame.time, message.time)
end

-- A Start came while a message is open in its slot.  It may supersede that message, or be of
-- another bus: where no bus is known, or a converter lost the buses.  Later frames decide.
-- returns  a pool of can.interleaved if the message stays open, else nil
local function supersede(self, frame)
  local open, list = self.open[frame.slot], list_open(self, frame.slot)
  local newest, anomaly = list[#list], nil
  local chunks = newest.chunks
  if not newest.status then
    anomaly = self:add_anomaly("fragment.incomplete", newest,
      "A new Start supersedes the message that started in frame %d: %d of %d bytes came",
      frame_key.number(newest[1]), chunks and chunks.received or open:received(newest), newest.size)
    anomaly.is_copy = is_repeated_start(self, newest, frame) or nil
  end
  if open == newest then
    if chunks.is_truncated then
      self:give_up(open)
      return close(self, frame.slot)
    end
    open = make_pool(self, open, frame)
  end
  if open:supersede(anomaly) then return open end
  close(self, frame.slot)
end

-- Starts -----------------------------------------------------------------------------------------

-- Add the anomalies of a Start's captured bytes.
local function check_start(self, frame, size, reserved)
  local known, least, length = frame.source.size, frame.source.min_size, frame.reported
  if length ~= 8 then
    local expert = length > 8 and "size.mismatch" or "fragment.incomplete"
    self:add_anomaly(expert, nil, "A Start has 8 bytes, this one has %d", length)
  end
  if not reserved then return end
  if size == 0 then
    self:add_anomaly("size.mismatch", nil, "The size of the message is 0")
  elseif known and (size > known or size < least) then
    local text = "The size is %d bytes, the catalogue says %d"
    self:add_anomaly("size.mismatch", nil, text, size, known)
  end
  if reserved ~= 0 then
    self:add_anomaly("reserved.nonzero", nil, "The reserved bytes are 0x%04x, not 0", reserved)
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

local function add_start(self, frame)
  local sum, size, reserved = can_id.start(frame.data)
  if not is_plausible(self, frame, size, reserved) then return nil end
  local slot, fields = frame.slot, frame.can_id
  self.accepted[fields.id] = true
  if not frame.source.size then self.on_unknown(fields.id, fields.seq) end
  self.buses[frame.bus or 0] = true
  local several = self.open[slot] and supersede(self, frame)
  check_start(self, frame, size, reserved)
  if not reserved or size == 0 then return "other" end
  local message = {
    frame.key, nil, nil, nil, nil, -- with room for the usual message of five frames
    slot = slot,
    source = frame.source,
    time = frame.time,
    size = size,
    crc = sum,
    reserved = reserved ~= 0 and reserved or nil,
    chunks = { nil, nil, nil, nil, received = 0 },
    status = nil,
    payload = nil,
  }
  if several then
    several:open_message(message)
    return "fragment", message
  end
  if self.open_count >= self.max_open then make_room(self) end
  self.open[slot], self.open_count = message, self.open_count + 1
  return "fragment", message
end

-- Middles and Ends -------------------------------------------------------------------------------

-- Add a Middle or End whose slot has no message, or a pool.
local function add_other_fragment(self, frame, pool)
  local fields = frame.can_id
  if pool then
    local kind, message = pool:add_fragment(frame)
    if #pool:messages() == 0 then close(self, frame.slot) end
    return kind, message
  end
  if not frame.accepts_all and (fields.ctl ~= 0 or not frame.source.size) then return nil end
  self:add_orphan(frame)
  return "other"
end

-- End a message with its last frame.  A frame comes twice if its sender missed the acknowledgement,
-- or if a recorder holds it twice.  So a message that does not fit, and has such frames, is pooled:
-- if its CRC is good without some of them, the pool leaves these out.
local function end_message(self, message, frame)
  local chunks, status = message.chunks, nil
  local needed = frame.reported + message.size - chunks.received
  local padding = can_id.padding(frame.data, frame.reported, needed)
  if chunks.is_truncated then status = "truncated" end
  if not padding then
    if chunks.repeated and not status then
      message[#message], chunks[#chunks] = nil, nil -- the pool adds the frame
      return add_other_fragment(self, frame, make_pool(self, message, frame))
    end
    status = self:add_misfit(message, chunks.received)
  end
  close(self, frame.slot)
  self:finish(message, frame.can_id, concat(chunks), padding, status)
  return "last", message
end

local function add_fragment(self, frame)
  local message = self.open[frame.slot]
  local chunks = message and message.chunks
  if not chunks then return add_other_fragment(self, frame, message) end
  local data, reported, index = frame.data, frame.reported, #message
  local received = chunks.received + reported
  message[index + 1] = frame.key
  message.time = frame.time
  chunks.received = received
  if not chunks.is_truncated then
    if data == chunks[index - 1] then chunks.repeated = (chunks.repeated or 0) + reported end
    if #data < reported then chunks.is_truncated = true end
    chunks[index] = data
  end
  if frame.can_id.ctrl == END then
    return end_message(self, message, frame)
  end
  local excess = received - message.size
  if excess > 0 and excess > (chunks.repeated or 0) then
    message.status = self:add_misfit(message, received)
    message.chunks = { received = received, is_truncated = true } -- its bytes are of no use
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
  self:add_anomaly("can.ctrl.invalid", nil, "CAN CTRL is %d; 0 to 3 are defined", frame.can_id.ctrl)
  return "other"
end

-- By CAN CTRL: (reassembly, frame) -> kind, message.
local ADDERS = { [0] = add_single, add_start, add_fragment, add_fragment }
for ctrl = #ADDERS + 1, 15 do ADDERS[ctrl] = add_undefined end

-- Frames ------------------------------------------------------------------------------------------

--- Add the next frame of the capture.
-- frame    see reading.records
-- returns  nil for a frame that is not YAPP's, else its kind: "single"; "fragment", of a message;
--          "last", with which its message ends; "other", which has no message, as the anomalies say
--          the message of a fragment or single frame, else nil
--          its list of anomalies, or false
function Reassembly:add(frame)
  local keeps = not frame.is_only_pass
  self.anomalies, self.keeps = false, keeps
  local kind, message = ADDERS[frame.can_id.ctrl](self, frame)
  if keeps then
    self.message, self.slot = message or false, frame.slot
    -- It is not known yet which message an interleaved fragment belongs to, if any.
    local is_other = kind == "other" or kind == "fragment" and not message.chunks
    if self.anomalies or is_other then
      self.store:keep_anomalies(frame.key, frame.can_id.message_key, self.anomalies or {})
    end
  end
  return kind, message, self.anomalies
end

--- Keep the message that the newest frame has ended for revisits.
-- has_fault  true if it has a fault flag set
function Reassembly:keep(message, has_fault)
  message.has_fault = has_fault or false
  self.store:keep(message)
end

--- Forget the newest frame: a read filter dropped its packet, so the next one has its key.
function Reassembly:forget(key)
  local pool = self.open[self.slot]
  if pool and not pool.chunks then pool:forget(key, self.message) end
  self.store:forget(key, self.slot % can_id.BUS, self.message)
  self.message = false
end

-- Return the message in a slot that has a frame as a fragment, and the index of that; nil for none.
local function find_in(self, slot, key)
  local found, index = self.store:find(slot, key)
  if found then return found, index end
  for _, message in ipairs(list_open(self, slot)) do
    index = frame_key.last_until(message, key)
    if message[index] == key then return message, index end
  end
end

-- The same for all buses: once a read filter has dropped a packet, no bus is known on revisits.
local function find(self, frame)
  local message, index = find_in(self, frame.slot, frame.key)
  for bus in pairs(message and {} or self.buses) do
    message, index = find_in(self, can_id.slot(frame.can_id, bus), frame.key)
    if message then break end
  end
  return message, index
end

--- Recall a frame that was added before.
-- returns  as Reassembly:add, and the index of the frame in its message; of a fragment that came
--          twice, the index of the one before
function Reassembly:recall(frame)
  local message, index = find(self, frame)
  local anomalies = self.store:anomalies_of(frame.key, frame.can_id.message_key)
  if message then
    local is_last = message.payload and message[#message] == frame.key
    return is_last and "last" or "fragment", message, anomalies, index
  end
  local kind = anomalies and "other"
  if frame.can_id.ctrl == 0 then kind, message = add_single(self, frame) end
  return kind, message, anomalies
end

--- Return the messages that have neither ended nor been superseded, in the order of their Starts.
function Reassembly:unfinished()
  local list = {}
  for _, message in ipairs(list_newest(self)) do
    if not message.status then list[#list + 1] = message end
  end
  return list
end

return M
