-- SPDX-License-Identifier: GPL-2.0-or-later
-- Reassembly: finds the CAN frames of YAPP, and makes messages of their Start, Middle and End
-- fragments ("Multi-Frame CAN YAPP").  Pure Lua.
--
-- A slot is ID, CTL and Seq on one bus: usually one message at a time is open there.  Another Start
-- may come while it is open: it lost its End, the recorder holds the Start twice, or the frames are
-- of two buses that nothing tells apart.  Then each open message gets the frames behind its Start,
-- and at an End can.search decides.  It also finds frames that came twice.
--
-- A message is reported once, by the frame that decides it.  Its record is a transfer:
--   1 .. n     frame keys of its fragments (base.frame_key); while it is open, of those that it may
--              have
--   slot, source; time = of its latest frame
--   size, crc, reserved (nil for 0)  as its Start says
--   chunks     while it is open: the bytes of the fragments behind the Start, up to the first that
--              the capture truncated; received = number of bytes on the bus; is_truncated;
--              may_skip = true if there was another message; ends = { [frame key] = true } of the
--              Ends that fit none
--   older      the message of the slot that was open before it, or nil
--   status     nil while it is open; then "good", "bad" (CRC), "incomplete", "overrun" or
--              "truncated" (by the capture)
--   payload    once its last fragment has come
--   padding    of CAN FD, nil for 0
--   received   bytes, of an incomplete or overrun message; calculated = CRC, of a bad one
--   has_fault  see mark_fault
--   twin       the message whose Start is the same and came next to this one's; is_copy = true once
--              the twin has ended
--   is_overtaken  true if a message with a later Start has ended

local can_id = require "yapp.wire.can_id"
local number_of = require "yapp.base.frame_key".number
local search = require "yapp.can.search"

local Reassembly = {}
Reassembly.__index = Reassembly

local concat = table.concat
local END = can_id.END

local MAX_IN_SLOT = 4 -- open messages of one slot
local MAX_DISTANCE = 0.02 -- seconds between a frame and its copy, as of reading.copies

local DUPLICATES = { { expert = "fragment.duplicate" } }

--- Make the reassembly of one capture.
-- capture     a capture.capture, asked whether a time is real
-- on_unknown  function(id, seq), called at each Start of an ID that has no message type
function Reassembly.new(capture, on_unknown)
  return setmetatable({
    capture = capture,
    on_unknown = on_unknown,
    open = {}, -- [slot] = the newest message that is open there
    ended = {}, -- [slot] = the good message that ended there last
    accepted = {}, -- [message ID] = true once a Start of it was accepted
    -- For revisits, by frame key.  If a read filter (-R) drops a packet, the next one gets its
    -- number, and the later one wins.
    transfers = {}, -- the message of a fragment, as it seems while several are open; false if it
    -- is of none
    kept_anomalies = {},
    anomalies = false, -- of the newest frame
  }, Reassembly)
end

-- The end of a message ---------------------------------------------------------------------------

-- Add an anomaly of the newest frame.
-- expert, text  name and label of an expert item; nil for no label
local function add_anomaly(self, expert, text)
  self.anomalies = self.anomalies or {}
  table.insert(self.anomalies, { expert = expert, text = text })
end

-- End a message with a status.  If a recorder holds its Start twice, the other one may be lost
-- without a word.
local function close(transfer, status)
  transfer.status, transfer.chunks, transfer.older = status, nil, nil
  if transfer.twin then transfer.twin.is_copy = true end
end

-- End a message that has more or fewer bytes than its size, or no End.
local function lose(self, transfer)
  local received = transfer.chunks.received
  local status = received > transfer.size and "overrun" or "incomplete"
  close(transfer, status)
  transfer.received = received
  if transfer.is_copy then return end
  local text = ("The message that started in frame %d has %d of %d bytes"):format(
    number_of(transfer[1]), received, transfer.size)
  add_anomaly(self, "fragment." .. status, text)
end

-- End a message with its last frame.
-- padding  bytes of CAN FD padding; nil if the message has more or fewer bytes than its size
local function end_transfer(self, transfer, frame, padding)
  local chunks = transfer.chunks
  local payload = concat(chunks)
  transfer.time, transfer.payload = frame.time, payload
  if not padding then
    lose(self, transfer)
    return "last", transfer
  end
  if padding > 0 then
    payload = payload:sub(1, transfer.size)
    transfer.padding, transfer.payload = padding, payload
  end
  if chunks.is_truncated then
    close(transfer, "truncated")
    return "last", transfer
  end
  local calculated = can_id.crc(frame.can_id, payload, transfer.reserved)
  if calculated == transfer.crc then
    close(transfer, "good")
    self.ended[transfer.slot] = transfer
  else
    close(transfer, "bad")
    transfer.calculated = calculated
  end
  return "last", transfer
end

-- Several open messages of a slot ----------------------------------------------------------------

-- Return the open messages of a slot, the oldest first.
local function list_open(newest)
  local list = {}
  while newest do
    table.insert(list, 1, newest)
    newest = newest.older
  end
  return list
end

-- Let these be the open messages of a slot.
local function set_open(self, slot, list)
  for i, transfer in ipairs(list) do transfer.older = list[i - 1] end
  self.open[slot] = list[#list]
end

-- The frames of a newer message are the last ones of an older one.  So a frame has the same
-- distance from the end in each, 0 for the newest.

-- Take frames out of an open message.
-- is_removed  by distance
local function remove_frames(transfer, is_removed)
  local chunks, last, count = transfer.chunks, #transfer, 1
  for i = 2, last do
    local key, data = transfer[i], chunks[i - 1]
    transfer[i], chunks[i - 1] = nil, nil
    if is_removed[last - i] then
      chunks.received = chunks.received - #data
    else
      count = count + 1
      transfer[count], chunks[count - 1] = key, data
    end
  end
end

-- Give up open messages until so many are left.  A message has the frames before the next Start.
-- list  the oldest first
local function give_up(self, list, count)
  while #list > count do
    local transfer, newer = table.remove(list, 1), list[1]
    if newer then
      transfer.chunks.received = transfer.chunks.received - newer.chunks.received
      for i = #transfer, #transfer - #newer + 2, -1 do transfer[i] = nil end
      newer.older = nil
    end
    lose(self, transfer)
  end
end

-- Return the newest message that may have a frame, false for none.
local function heir_of(list, distance)
  for i = #list, 1, -1 do
    if #list[i] - 1 > distance then return list[i] end
  end
  return false
end

-- Leave the other frames of a good message to the messages that are open.  Report those that none
-- can have: frames that came twice, or strangers.
-- is_taken  by distance: its frames
-- returns   the others, by distance
local function leave_rest(self, transfer, is_taken, list)
  local chunks, rest, has_strangers, transfers = transfer.chunks, {}, false, self.transfers
  for i = 2, #transfer do
    local distance, key, owner = #transfer - i, transfer[i], transfer
    local seeming = transfers[key] -- of another slot, if a read filter dropped this frame
    local is_kept = seeming == false or seeming and seeming.slot == transfer.slot
    if not is_taken[distance] then
      rest[distance], owner = true, heir_of(list, distance)
      if not owner and chunks[i - 1] == chunks[i - 2] then
        owner = transfer
        if is_kept then self.kept_anomalies[key] = DUPLICATES end
      elseif not owner then
        has_strangers = true
      end
    end
    if is_kept then transfers[key] = owner end
  end
  if has_strangers then add_anomaly(self, "fragment.orphan") end
  return rest
end

-- End a message that the CRC found.
-- list, index  the open messages, the oldest first, and which of them it is
-- taken, padding  of can.search
local function complete(self, list, index, taken, padding, frame)
  local transfer, is_taken = table.remove(list, index), {}
  for _, i in ipairs(taken) do is_taken[#transfer - 1 - i] = true end
  remove_frames(transfer, leave_rest(self, transfer, is_taken, list))
  for i, other in ipairs(list) do
    other.is_overtaken = other.is_overtaken or i < index
    remove_frames(other, is_taken)
  end
  set_open(self, frame.slot, list)
  return end_transfer(self, transfer, frame, padding)
end

-- Decide which message an End completes: the newest one with all frames since its Start, else the
-- oldest one that has a good CRC.  It overtakes those with an earlier Start.
local function decide(self, newest, frame, padding)
  local list, fields = list_open(newest), frame.can_id
  local index, taken, zeros = #list, search(newest, fields, false)
  for i, transfer in ipairs(list) do
    if not taken and transfer.chunks.may_skip then
      index, taken, zeros = i, search(transfer, fields, true)
    end
  end
  if taken then return complete(self, list, index, taken, zeros, frame) end
  local ends, count = list[1].chunks.ends or {}, 1
  for _, key in ipairs(list[1]) do count = count + (ends[key] and 1 or 0) end
  if count >= #list then -- no other End is to come
    give_up(self, list, 1)
    self.open[frame.slot] = nil
    return end_transfer(self, newest, frame, padding)
  end
  ends[frame.key] = true
  for _, transfer in ipairs(list) do transfer.chunks.ends = ends end
  return "fragment", newest
end

-- Starts -----------------------------------------------------------------------------------------

-- Return whether a frame came so soon before or after another one that it may be its copy.
local function is_near(self, time, other_time)
  return math.abs(time - other_time) < MAX_DISTANCE and self.capture:is_time_real(time)
end

-- Give up the open messages of a slot that a new Start ends.  The fragments of a message come one
-- after the other, so a message that has waited is over.
-- has_message  false for a Start that has none: then nothing stays open
local function make_room(self, newest, frame, has_message)
  local list, time = list_open(newest), frame.time
  local is_late = time - newest.time >= MAX_DISTANCE and self.capture:is_time_real(time)
  local is_over = is_late or not has_message or newest.chunks.is_truncated
  give_up(self, list, is_over and 0 or MAX_IN_SLOT - 1)
  while list[1] and (list[1].is_overtaken or list[1].is_copy) do give_up(self, list, #list - 1) end
  set_open(self, frame.slot, list)
end

-- Open a message beside others.
local function add_beside(self, older, transfer)
  transfer.older, transfer.chunks.may_skip, older.chunks.may_skip = older, true, true
  local is_same = older.crc == transfer.crc and older.size == transfer.size
  if #older == 1 and is_same and is_near(self, transfer.time, older.time) then
    older.twin, transfer.twin = transfer, older -- a recorder holds their Start twice
  end
end

-- Add the anomalies of a Start's captured bytes.
local function check_start(self, frame, size, reserved)
  local source, length = frame.source, frame.reported
  local known = source.size
  if length ~= 8 then
    add_anomaly(self, length > 8 and "size.mismatch" or "fragment.incomplete")
  end
  if not reserved then return end
  if size == 0 or known and (size > known or size < source.min_size) then
    add_anomaly(self, "size.mismatch")
  end
  if reserved ~= 0 then add_anomaly(self, "reserved.nonzero") end
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
  local has_message = reserved and size > 0
  if self.open[slot] then make_room(self, self.open[slot], frame, has_message) end
  check_start(self, frame, size, reserved)
  if not has_message then return "other" end
  local transfer = {
    frame.key, nil, nil, nil, nil, -- with room for the usual message of five frames
    slot = slot,
    source = frame.source,
    time = frame.time,
    size = size,
    crc = sum,
    chunks = { nil, nil, nil, nil, received = 0, is_truncated = false },
    status = nil,
    payload = nil,
  }
  if reserved ~= 0 then transfer.reserved = reserved end
  if self.open[slot] then add_beside(self, self.open[slot], transfer) end
  self.open[slot] = transfer
  return "fragment", transfer
end

-- Middles and Ends -------------------------------------------------------------------------------

-- Return whether an End came twice: it equals that of the message that ended in its slot.
local function is_repeated_end(self, frame)
  local transfer = frame.can_id.ctrl == END and self.ended[frame.slot]
  if not transfer or not is_near(self, frame.time, transfer.time) then return false end
  local length = frame.reported - (transfer.padding or 0)
  return length > 0 and frame.data:sub(1, length) == transfer.payload:sub(-length)
end

-- Read a Middle or End of a slot without an open message.
local function add_orphan(self, frame)
  local fields = frame.can_id
  if not frame.accepts_all and (fields.ctl ~= 0 or not frame.source.size) then return nil end
  add_anomaly(self, is_repeated_end(self, frame) and "fragment.duplicate" or "fragment.orphan")
  return "other"
end

-- Add a Middle or End.
local function add_fragment(self, frame)
  local slot, data, reported = frame.slot, frame.data, frame.reported
  local newest, is_whole = self.open[slot], #data == reported
  if not newest then return add_orphan(self, frame) end
  if newest.older and not is_whole then -- the CRC cannot decide any more
    give_up(self, list_open(newest), 1)
  end
  local transfer = newest
  repeat
    local chunks, index = transfer.chunks, #transfer
    transfer[index + 1], transfer.time = frame.key, frame.time
    chunks.received = chunks.received + reported
    if not chunks.is_truncated then chunks[index], chunks.is_truncated = data, not is_whole end
    transfer = transfer.older
  until not transfer
  if frame.can_id.ctrl ~= END then return "fragment", newest end
  local chunks, excess = newest.chunks, newest.chunks.received - newest.size
  local padding = can_id.padding(data, reported, reported - excess)
  local has_choice = newest.older or excess > 0 and not (padding or chunks.is_truncated)
  if has_choice then return decide(self, newest, frame, padding) end
  self.open[slot] = nil
  return end_transfer(self, newest, frame, padding)
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
  add_anomaly(self, "can.ctrl.invalid")
  return "other"
end

-- By CAN CTRL: (reassembly, frame) -> kind, transfer.
local ADDERS = { [0] = add_single, add_start, add_fragment, add_fragment }
for ctrl = #ADDERS + 1, 15 do ADDERS[ctrl] = add_undefined end

-- Frames ------------------------------------------------------------------------------------------

--- Add the next frame of the capture.
-- frame    see reading.records
-- returns  nil for a frame that is not YAPP's, else its kind: "single"; "fragment", of a message;
--          "last", with which a message ends; "other", which has no message, as the anomalies say
--          the message of a fragment or single frame, as it seems while several are open
--          its list of anomalies, or false
function Reassembly:add(frame)
  local key = frame.key
  self.anomalies = false
  local kind, transfer = ADDERS[frame.can_id.ctrl](self, frame)
  local anomalies = self.anomalies
  if not frame.is_only_pass then
    local transfers, kept = self.transfers, self.kept_anomalies
    if kind == "fragment" or kind == "last" then
      transfers[key] = transfer or false
    elseif transfers[key] ~= nil then -- of a packet that a read filter dropped
      transfers[key] = nil
    end
    if kind == "other" or anomalies or kept[key] then
      kept[key] = anomalies or kind == "other" and {} or nil
    end
  end
  return kind, transfer, anomalies
end

--- Mark that a message has a fault flag set: revisits of its fragments show it.
function Reassembly.mark_fault(transfer)
  transfer.has_fault = true
end

--- Recall a frame that was added before.
-- returns  as Reassembly:add
function Reassembly:recall(frame)
  local key = frame.key
  local transfer, anomalies = self.transfers[key], self.kept_anomalies[key]
  if transfer and transfer.slot % can_id.BUS == frame.can_id.message_key then
    local is_last = transfer.payload and transfer[#transfer] == key
    return is_last and "last" or "fragment", transfer, anomalies
  elseif anomalies or transfer == false then
    return transfer == false and "fragment" or "other", nil, anomalies
  elseif frame.can_id.ctrl == 0 then
    return add_single(self, frame)
  end
end

--- Return the messages that the capture ends before, in the order of their Starts: a list of
-- { transfer, key = frame key of its latest frame }.
function Reassembly:unfinished()
  local list = {}
  for _, newest in pairs(self.open) do
    local open, behind = newest, 0 -- frames of the next Start
    while open do
      if not open.is_copy then
        list[#list + 1] = { transfer = open, key = open[#open - behind] }
      end
      open, behind = open.older, #open - 1
    end
  end
  table.sort(list, function(a, b) return a.transfer[1] < b.transfer[1] end)
  return list
end

return Reassembly
