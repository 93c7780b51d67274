-- SPDX-License-Identifier: GPL-2.0-or-later
-- Reassembly of YAPP over CAN: Start, Middle, End ("Multi-Frame CAN YAPP").  Pure Lua, 5.2 and 5.4: it takes frames in
-- order and says what each of them is.

local M = {}

local open_of = require("yapp.can.open")

local concat, floor, slot_of = table.concat, math.floor, open_of.slot

local CREDIT_PER_FRAME, MAX_CREDIT = 32, 4096 -- steps of the searches among frames
M.MAX_CREDIT = MAX_CREDIT
local MAX_REPEATED = 8 -- frames that a message may have too many, where they repeat others

local Reassembly = {}
Reassembly.__index = Reassembly

--- The reassembly of one pass over a capture file.
-- parts    the modules { can_id =, crc =, can_frames =, can_interleave =, can_repeated = }
-- size_of  function(id, bus) -> payload size of a known message, nil for an unknown one
-- It has kept, a can.frames: what each frame is.
--
-- A message has address (wire.can_id's), bus, size, crc, reserved (nil when 0), all from its Start; the looks of its
-- frames at 1 .. count, received (bytes); and when it has ended status: "good", "bad" (CRC), "short", "overrun", "cut"
-- (by a new Start), "unverified" (bytes not captured), payload, padding (nil when 0), calculated (a bad CRC), is_only
-- (whether no other message was open that its bytes may belong to), and last (the look of its last frame).
function M.new(parts, size_of)
  local open = open_of.new()
  return setmetatable({
    can_id = parts.can_id, crc = parts.crc, parts = parts, size_of = size_of, kept = parts.can_frames.new(parts.can_id),
    open = open, slots = open.slots, credit = MAX_CREDIT, seeds = {}, seed_count = 0,
    claimed = {}, -- unknown IDs of which a Start without a Seq has come: then others may have one
  }, Reassembly)
end

-- How a message ends ----------------------------------------------------------------------------------------------

--- The message has more or fewer bytes than its size; returns the status.
function Reassembly:misfit(message, received, look)
  if received < message.size then
    self.kept:fault(look, "fragment.incomplete", ("The message that started in frame %d ends with %d of %d bytes")
      :format(floor(message[1]), received, message.size), message)
    return "short"
  elseif received > message.size then
    self.kept:fault(look, "fragment.overrun", ("%d bytes for the %d of the message that started in frame %d")
      :format(received, message.size, floor(message[1])), message)
    return "overrun"
  end
end

--- The CRC register behind the header of a message: messages of one kind have the same header again and again.
function Reassembly:seed(message)
  local key = message.address.key * 0x10000 + message.size
  local seed = not message.reserved and self.seeds[key]
  if not seed then
    seed = self.crc.of(self.can_id.header(message.address, message.size, message.reserved))
    if self.seed_count == self.can_id.MAX_KEPT then self.seeds, self.seed_count = {}, 0 end
    if not message.reserved then self.seeds[key], self.seed_count = seed, self.seed_count + 1 end
  end
  return seed
end

--- Ends a message: status when it is known, else the CRC decides.
-- returns  whether the table of the message is needed no more, once this frame has been shown
function Reassembly:finish(message, payload, look, status)
  message.payload, message.last, message.chunks = payload, look, nil
  if status or message.truncated then
    message.status = status or "unverified"
    return
  end
  local calculated = self.crc.update(self:seed(message), payload)
  if calculated == message.crc then
    message.status = "good"
    return self.kept:good(message)
  else
    message.status, message.calculated, message.is_only = "bad", calculated, not message.from
  end
end

--- Pays for steps of a search; every frame that comes brings some credit.
-- returns  whether there was enough
function Reassembly:spend(steps)
  self.credit = self.credit - steps
  return self.credit >= 0
end

-- Starts ------------------------------------------------------------------------------------------------------------

-- A Start arrived while something is open in its slot.  On a bus that is told from others that is cut off; else it may
-- be another bus's, and what follows decides.
local function overtake(self, slot, open, frame)
  local newest = open.messages and open:newest() or open
  if not newest.status and not newest.overtaken then
    local received = open.messages and open:received() or open.received
    self.kept:fault(frame.look, "fragment.incomplete",
      ("A new Start cuts off the message that started in frame %d: %d of %d bytes")
      :format(floor(newest[1]), received, newest.size), newest)
  end
  if frame.bus and frame.is_apart or newest.status or newest.truncated then
    open_of.give_up(open)
    return self.open:close(slot)
  end
  if not open.messages then
    open = self.parts.can_interleave.new(self, open)
    self.slots[slot] = open
  end
  if not open:overtake() then self.open:close(slot) end
end

-- What is wrong with a Start, as far as it was captured.
local function check_start(kept, frame, size, reserved, known)
  local look = frame.look
  if frame.reported > 8 then
    kept:fault(look, "size.mismatch", ("A Start has 8 bytes, this one has %d"):format(frame.reported))
  end
  if reserved and size == 0 then
    kept:fault(look, "size.mismatch", "The size of the message is 0")
  elseif reserved and known and size ~= known then
    kept:fault(look, "size.mismatch", ("The size is %d bytes, the catalogue says %d"):format(size, known))
  end
  if reserved and reserved ~= 0 then
    kept:fault(look, "reserved.nonzero", ("The reserved bytes are 0x%04x, not 0"):format(reserved))
  end
  if frame.reported < 8 then
    kept:fault(look, "fragment.incomplete",
      ("A Start has 8 bytes, this one has %d: its message cannot be put together"):format(frame.reported))
  end
end

-- The table of a message that begins at a look.
local function new_message(self, look)
  local message = self.spare -- of an earlier message: a fifth of the garbage of a packet list
  if message then
    self.spare = nil
    message[1], message.status, message.payload, message.last = look, nil, nil, nil
    message.count, message.parts, message.received, message.repeats = 1, 0, 0, 0
  else -- with room for the usual message of five frames: saves Lua three steps of growth in each table
    message = { look, nil, nil, nil, nil, count = 1, parts = 0, received = 0, repeats = 0,
      chunks = { nil, nil, nil, nil }, status = nil, payload = nil, last = nil, reserved = nil }
  end
  return message
end

local function start(self, slot, address, frame)
  local look, known = frame.look, self.size_of(address.id, frame.bus)
  local crc, size, reserved = self.can_id.start(frame.data)
  if not frame.wide then -- a plausible one, or for a known ID one that the capture cut
    if address.ctl ~= 0 or frame.reported ~= 8 or not (reserved or known) then return false end
    if reserved and (reserved ~= 0 or size <= 8 or known and size ~= known) then return false end
    if not known and address.seq ~= 0 and not self.claimed[address.id] then return false end
  end
  if not known then self.claimed[address.id] = true end
  local open = self.slots[slot]
  if open then
    overtake(self, slot, open, frame)
    open = self.slots[slot]
  end
  if size ~= known or reserved ~= 0 or frame.reported ~= 8 then check_start(self.kept, frame, size, reserved, known) end
  if not reserved or size == 0 then
    self.kept:alone(look, address.can_id)
    return true
  end
  local message = new_message(self, look)
  message.address, message.bus, message.size, message.crc, message.sent = address, frame.bus, size, crc, frame.data
  if reserved ~= 0 then message.reserved = reserved end
  self.kept.entries[look] = message
  if open then open:add(message) else self.open:enter(slot, message) end
  return true, message
end

-- The End of the only message in its slot; returns as finish does.
local function complete(self, message, frame)
  local needed = message.size - message.received + frame.reported
  local padding = self.can_id.padding(frame.data, frame.reported, needed)
  if not padding and message.repeats > 0 and not message.truncated then
    padding = self.parts.can_repeated.take_out(self, message, frame)
  end
  local payload = concat(message.chunks, "", 1, message.parts)
  if not padding then
    return self:finish(message, payload, frame.look, self:misfit(message, message.received, frame.look))
  end
  if padding > 0 then
    message.padding, payload = padding, payload:sub(1, message.size)
  end
  return self:finish(message, payload, frame.look)
end

-- A Middle or End of the only message in its slot.
local function add_part(self, slot, message, frame, is_end)
  local look, count, reported = frame.look, message.count + 1, frame.reported
  local received = message.received + reported
  self.kept.entries[look] = message
  message.count, message[count], message.received = count, look, received
  if message.status then -- it had too many bytes before
    self:misfit(message, received, look)
  else
    if not message.truncated then
      local data, parts, chunks = frame.data, message.parts, message.chunks
      -- Whether it is the frame before it, delivered twice, is for the CRC to say.
      if data == chunks[parts] then message.repeats = message.repeats + reported end
      message.parts, chunks[parts + 1] = parts + 1, data
      if #data < reported then message.truncated = true end
    end
    if is_end then
      local chunks = message.chunks
      if complete(self, message, frame) then self.spare, message.chunks = message, chunks end
    elseif received > message.size and received > message.size + math.min(message.repeats, MAX_REPEATED * reported) then
      message.status = self:misfit(message, received, look)
      message.chunks = nil
    end
  end
  if is_end then self.open:close(slot) end
  return true, message
end

local function continue(self, slot, address, frame)
  local message = self.slots[slot]
  if not message then
    if not frame.wide and not (address.ctl == 0 and self.size_of(address.id, frame.bus)) then return false end
    self.kept:orphan(frame.look, address)
    return true
  end
  if frame.doubtful and not message.messages and not message.status and not message.truncated then
    message = self.parts.can_interleave.new(self, message)
    self.slots[slot] = message
  end
  if not message.messages then return add_part(self, slot, message, frame, address.ctrl == self.can_id.END) end
  message:frame(address, frame)
  if #message.messages == 0 then self.open:close(slot) end
  return true, (self.kept:entry(frame.look))
end

local function other(self, _, address, frame)
  if not frame.wide then return false end
  self.kept:alone(frame.look, address.can_id)
  self.kept:fault(frame.look, "can.ctrl.invalid", ("CAN CTRL is %d; 0 to 3 are defined"):format(address.ctrl))
  return true
end

local function single(self, _, address, frame)
  if not frame.wide then
    local size = self.size_of(address.id, frame.bus)
    if not (size and address.ctl == 0 and self.can_id.padding(frame.data, frame.reported, size)) then return false end
  end
  self.kept:alone(frame.look, address.can_id)
  return true
end

local TAKERS = { [0] = single, start, continue, continue }

--- Takes one CAN frame; frames come in order.
-- address  wire.can_id.address of its 29-bit id
-- frame    { look = a number that grows, whose whole part is the frame's number; data = captured bytes; reported = its
--          length on the bus; bus = number, nil where the capture does not say; is_apart = whether frames of other
--          buses have other numbers for sure; wide = whether the user says that every extended frame is YAPP, else only
--          what is surely YAPP is claimed; doubtful = whether it is a frame of zeros that may be a remote frame: size
--          and CRC say whether it belongs }
-- returns  whether it is YAPP's, and its message: kept:entry(frame.look) says the same at any later time
function Reassembly:frame(address, frame)
  if self.credit < MAX_CREDIT then self.credit = math.max(self.credit, 0) + CREDIT_PER_FRAME end
  return (TAKERS[address.ctrl] or other)(self, slot_of(address, frame.bus), address, frame)
end

-- The short way -----------------------------------------------------------------------------------------------------

-- A Start of a known message, with nothing open in its slot.
local function plain_start(self, address, look, data, bus)
  local slot, known = bus and slot_of(address, bus) or address.key, self.size_of(address.id, bus)
  if self.slots[slot] or #data ~= 8 or address.ctl ~= 0 then return nil end
  local crc, size, reserved = self.can_id.start(data)
  if size ~= known or size <= 8 or reserved ~= 0 then return nil end
  local message = new_message(self, look)
  message.address, message.bus, message.size, message.crc, message.sent = address, bus, size, crc, data
  self.kept.entries[look] = message
  self.open:enter(slot, message)
  return message
end

local function plain_middle(self, address, look, data, bus)
  local message = self.slots[bus and slot_of(address, bus) or address.key]
  local chunks = message and message.chunks
  if not chunks or message.truncated then return nil end
  local received, parts, count = message.received + #data, message.parts, message.count + 1
  if received >= message.size or data == chunks[parts] then return nil end
  self.kept.entries[look] = message
  message.count, message[count], message.received = count, look, received
  message.parts, chunks[parts + 1] = parts + 1, data
  return message
end

-- An End that has all that is missing, as the CRC says.
local function plain_end(self, address, look, data, bus)
  local slot = bus and slot_of(address, bus) or address.key
  local message = self.slots[slot]
  local chunks = message and message.chunks
  if not chunks or message.truncated or message.received + #data ~= message.size then return nil end
  local payload = concat(chunks, "", 1, message.parts) .. data
  if self.crc.update(self:seed(message), payload) ~= message.crc then return nil end
  local count = message.count + 1
  message.count, message[count], message.received = count, look, message.size
  message.payload, message.last, message.status, message.chunks = payload, look, "good", nil
  self.kept.entries[look] = message
  self.open:close(slot)
  if self.kept:good(message, true) then self.spare, message.chunks = message, chunks end
  return message, true
end

--- The short way: takes a frame of which nothing can be said but that it begins a message, is its next part, or all
-- that it lacks, as most frames are.
-- address          of the frame: its CAN CTRL is the index
-- look, data, bus  as Reassembly:frame has them
-- returns          its message, and whether it ends here; nil where it is not so: then nothing was done, and
--                  Reassembly:frame takes the frame
-- Not to be called while the reassembly's credit is below MAX_CREDIT: each frame that comes has to bring some.
M.plain = { plain_start, plain_middle, plain_end } -- by CAN CTRL

--- The messages that began and have not ended: at the end of the capture these are unfinished.
-- returns  list of messages
function Reassembly:unfinished()
  return self.open:unfinished()
end

return M
