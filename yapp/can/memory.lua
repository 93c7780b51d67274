-- SPDX-License-Identifier: GPL-2.0-or-later
-- All that is known of a file's CAN frames: reassembly of Start, Middle, End ("Multi-Frame CAN
-- YAPP"), and what was said of each frame, for later looks.  Pure Lua.
--
-- It is told facts of frames, in the order of the capture, and asked what they are.  Of each frame
-- its entry is kept: the message that it is a part of, which all parts share, or { address } of a
-- frame that stands alone.  A message has
--   1 .. n      the looks of its frames (memory.passes)
--   address, size, crc, reserved (nil when 0)   of its Start; bus
--   status      nil while it is open; "good", "bad" (CRC), "short", "overrun", "unverified" (bytes
--               not captured), "cut" (a new Start came)
--   chunks, received, repeated, is_cut   while it is open: what came, how many bytes, those of frames
--               that are as the one before, whether bytes were not captured
--   payload, padding (nil when 0), calculated (of a bad CRC)   once it has ended
--   last        the look of the frame that ended it: what is shown of the message stands there
--   blamed      the looks at which something was said to be wrong with it, or nil
--   delta, has_fault, is_unsure   of the history and the reader, for later looks; a frame alone has
--               these too

local can_id = require "yapp.wire.can_id"
local crc = require "yapp.wire.crc"
local passes = require "yapp.memory.passes"
local pool = require "yapp.can.pool"

local M = {}

local concat, floor, min = table.concat, math.floor, math.min
local END = can_id.END

local MAX_OPEN = 1024 -- an open message costs memory until something ends it: the oldest make room
local MAX_RUNS = 8 -- of frames alike, in which one that came twice is looked for
local MAX_SPAN = 1000 -- frames from the first to the last of a message that is kept small
local BUS = 0x20000000 -- keys of messages have 29 bits

-- Reassembly of one pass -------------------------------------------------------------------------

local Reassembly = {}
Reassembly.__index = Reassembly

-- entries  the table that gets the entry of each frame, by look
-- size_of  function(id, bus) -> payload size of a known message, nil for an unknown one
-- It has faults, by look: a list of { expert =, text =, message = or nil, void = true once it is
-- taken back }.  And open, by slot (a message's key and bus): the message that is open there, or a
-- pool of several (can.pool).
local function new_reassembly(entries, size_of)
  return setmetatable({ entries = entries, size_of = size_of, faults = {}, open = {}, open_count = 0,
    claimed = {} }, -- unknown IDs of which a Start without a Seq has come: then others may have one
    Reassembly)
end

--- Says that something is wrong at a frame; of a message, where it is given.
function Reassembly:fault(look, expert, text, message)
  local list = self.faults[look] or {}
  self.faults[look] = list
  list[#list + 1] = { expert = expert, text = text, message = message }
  if message then
    message.blamed = message.blamed or {}
    message.blamed[#message.blamed + 1] = look
  end
end

--- Takes back what was said at a frame of a message that came out good, or of a frame that has found
-- its message.
-- is_void  function(fault) -> boolean
function Reassembly:take_back(look, is_void)
  local list = self.faults[look] or {}
  for i = #list, 1, -1 do
    if is_void(list[i]) then table.remove(list, i).void = true end
  end
  if #list == 0 then self.faults[look] = nil end
end

--- A Middle or End whose message is not known.
function Reassembly:orphan(address, look)
  self.entries[look] = { address = address }
  self:fault(look, "fragment.orphan", ("%s of a message whose Start is not here")
    :format(address.ctrl == END and "End" or "Middle"))
end

--- A message has more or fewer bytes than its size.
-- returns  its status
function Reassembly:misfit(message, received, look)
  message.received = received
  local start = floor(message[1])
  if received < message.size then
    self:fault(look, "fragment.incomplete", ("The message that started in frame %d ends with %d of %d bytes")
      :format(start, received, message.size), message)
    return "short"
  end
  self:fault(look, "fragment.overrun", ("%d bytes for the %d of the message that started in frame %d")
    :format(received, message.size, start), message)
  return "overrun"
end

--- Ends a message: with a status when it is known, else the CRC decides.
function Reassembly.finish(_, message, payload, look, status)
  message.payload, message.last, message.status, message.chunks = payload, look, status, nil
  if status then return end
  local header = can_id.header(message.address, message.size, message.reserved)
  local calculated = crc.update(crc.of(header), payload)
  if calculated == message.crc then
    message.status = "good"
  else
    message.status, message.calculated = "bad", calculated
  end
end

-- Starts -----------------------------------------------------------------------------------------

-- What is wrong with a Start, as far as it was captured.
local function check_start(self, frame, look, size, reserved, known)
  if frame.reported > 8 then
    self:fault(look, "size.mismatch", ("A Start has 8 bytes, this one has %d"):format(frame.reported))
  elseif frame.reported < 8 then
    self:fault(look, "fragment.incomplete",
      ("A Start has 8 bytes, this one has %d: its message cannot be put together"):format(frame.reported))
  end
  if not reserved then return end
  if size == 0 then
    self:fault(look, "size.mismatch", "The size of the message is 0")
  elseif known and size ~= known then
    self:fault(look, "size.mismatch", ("The size is %d bytes, the catalogue says %d"):format(size, known))
  end
  if reserved ~= 0 then
    self:fault(look, "reserved.nonzero", ("The reserved bytes are 0x%04x, not 0"):format(reserved))
  end
end

-- Whether a Start is surely YAPP's: a plausible one, and of an unknown ID one that does not number
-- itself, or follows such; or for a known ID one that the capture cut.
local function is_plausible(self, address, frame, size, reserved, is_known)
  if address.ctl ~= 0 or frame.reported ~= 8 then return false end
  if not reserved then return is_known end
  if reserved ~= 0 or size <= 8 then return false end
  return is_known or address.seq == 0 or self.claimed[address.id] == true
end

-- Empties a slot.
-- status  what becomes of a message there that is open; nil where it has ended
local function close(self, slot, status)
  local open = self.open[slot]
  self.open[slot], self.open_count = nil, self.open_count - 1
  for _, message in ipairs(status and (open.messages or { open }) or {}) do
    message.status, message.chunks = message.status or status, nil
  end
end

-- The slots with the oldest Starts make room.
local function make_room(self)
  local slots = {}
  for slot in pairs(self.open) do slots[#slots + 1] = slot end
  local function started(slot)
    local open = self.open[slot]
    return (open.messages and open:newest() or open)[1]
  end
  table.sort(slots, function(a, b) return started(a) < started(b) end)
  for i = 1, #slots - MAX_OPEN / 2 do close(self, slots[i], "cut") end
end

-- A Start came while something is open in its slot.  On a bus that is told from others it cuts that
-- off; else it may be another bus's, and what follows decides.
-- returns  a pool where what was open stays open; nil where not
local function overtake(self, slot, frame, look)
  local open = self.open[slot]
  local message = open.messages and open:newest() or open
  if not message.status and not message.overtaken then
    self:fault(look, "fragment.incomplete",
      ("A new Start cuts off the message that started in frame %d: %d of %d bytes")
      :format(floor(message[1]), open.messages and open:received() or open.received, message.size), message)
  end
  if frame.bus or message.status or message.is_cut then return close(self, slot, "cut") end
  if not open.messages then open = pool.new(self, open) end
  self.open[slot] = open
  if open:overtake() then return open end
  close(self, slot)
end

local function start(self, slot, address, frame, look)
  local sum, size, reserved = can_id.start(frame.data)
  local known = self.size_of(address.id, frame.bus)
  if not frame.is_wide and not is_plausible(self, address, frame, size, reserved, known ~= nil) then
    return false
  end
  self.claimed[address.id] = true
  local others = self.open[slot] and overtake(self, slot, frame, look)
  if size ~= known or reserved ~= 0 or frame.reported ~= 8 then
    check_start(self, frame, look, size, reserved, known)
  end
  if not reserved or size == 0 then
    self.entries[look] = { address = address }
    return true
  end
  -- With room for the usual message of five frames, and for the names that it will have.
  local message = { look, nil, nil, nil, nil, address = address, bus = frame.bus, size = size,
    crc = sum, reserved = reserved ~= 0 and reserved or nil, chunks = { nil, nil, nil, nil },
    received = 0, repeated = 0, is_cut = false, status = nil, payload = nil, last = nil }
  self.entries[look] = message
  if others then
    others:add(message)
    return true
  end
  if self.open_count >= MAX_OPEN then make_room(self) end
  self.open[slot], self.open_count = message, self.open_count + 1
  return true
end

-- Middles and Ends -------------------------------------------------------------------------------

-- CAN may deliver a frame twice (its sender did not see the acknowledgement): where a message is too
-- long by frames of one run of frames alike, and its CRC is good without them, they are left out.
-- excess   bytes too many; look: of the last frame
-- returns  whether it is so: then the message is ended
local function leave_out(self, message, excess, look)
  local chunks, at, runs = message.chunks, 1, 0
  while at < #chunks and runs < MAX_RUNS do
    local first = at
    while at + 1 < #chunks and chunks[at + 1] == chunks[first] do at = at + 1 end -- an End is sent once
    local count = excess / #chunks[first]
    if count % 1 == 0 and count <= at - first then
      runs = runs + 1
      self:finish(message, concat(chunks, "", 1, at - count) .. concat(chunks, "", at + 1), look)
      if message.status == "good" then
        for _ = 1, count do
          self:fault(table.remove(message, at - count + 2), "fragment.duplicate",
            "The frame before it once more: the CRC says that the message has one of them")
        end
        return true
      end
    end
    at = at + 1
  end
  return false
end

-- The End of a message that has not as many bytes as its size says.
local function finish_unusual(self, message, frame, look)
  local chunks, excess = message.chunks, message.received - message.size
  local needed = frame.reported - excess
  local padding = can_id.padding(frame.data, frame.reported, needed)
  if padding then
    message.padding = padding
    chunks[#chunks] = frame.data:sub(1, needed)
    return self:finish(message, concat(chunks), look, message.is_cut and "unverified" or nil)
  end
  local is_repeated = excess > 0 and message.repeated >= excess and not message.is_cut
  if is_repeated and leave_out(self, message, excess, look) then return end
  self:finish(message, concat(chunks), look, self:misfit(message, message.received, look))
  message.calculated = nil
end

-- A Middle or End of a message that has ended by too many bytes.
local function go_beyond(self, message, look, is_end)
  message.status = self:misfit(message, message.received, look)
  message.chunks = nil
  if is_end then self:finish(message, "", look, message.status) end
end

local function continue(self, slot, address, frame, look)
  local message, is_end = self.open[slot], address.ctrl == END
  if not message then
    if not frame.is_wide and not (address.ctl == 0 and self.size_of(address.id, frame.bus)) then
      return false
    end
    self:orphan(address, look)
    return true
  end
  if message.messages then
    message:frame(address, frame, look)
    if #message.messages == 0 then close(self, slot) end
    return true
  end
  local data, chunks, count = frame.data, message.chunks, #message + 1
  local received = message.received + frame.reported
  self.entries[look], message[count], message.received = message, look, received
  if is_end then close(self, slot) end
  if message.status then
    go_beyond(self, message, look, is_end)
    return true
  end
  if not message.is_cut then -- behind bytes that were not captured nothing is known to be in its place
    if data == chunks[count - 2] then message.repeated = message.repeated + frame.reported end
    chunks[count - 1] = data
    if #data < frame.reported then message.is_cut = true end
  end
  if not is_end then
    local too_many = received - message.size
    if too_many > 0 and too_many > min(message.repeated, MAX_RUNS * frame.reported) then
      go_beyond(self, message, look)
    end
  elseif received == message.size then
    self:finish(message, concat(chunks), look, message.is_cut and "unverified" or nil)
  else
    finish_unusual(self, message, frame, look)
  end
  return true
end

-- Other frames -----------------------------------------------------------------------------------

local function single(self, _, address, frame, look)
  if not frame.is_wide then
    local size = self.size_of(address.id, frame.bus)
    if not size or address.ctl ~= 0 then return false end
    if not can_id.padding(frame.data, frame.reported, size) then return false end
  end
  self.entries[look] = { address = address, delta = nil }
  return true
end

local function undefined(self, _, address, frame, look)
  if not frame.is_wide then return false end
  self.entries[look] = { address = address }
  self:fault(look, "can.ctrl.invalid", ("CAN CTRL is %d; 0 to 3 are defined"):format(address.ctrl))
  return true
end

local TAKERS = { [0] = single, start, continue, continue } -- by CAN CTRL

-- What is kept -----------------------------------------------------------------------------------

-- A good message is kept small: at its last frame { payload, address, delta, has_fault }, at the
-- others the look of the last one, negative at its Start.  (Frames 7, 8 and 10 make a message: of 7
-- -10 is kept, of 8 10, of 10 the table.)

local function can_be_small(message)
  local last = message.last
  if message.status ~= "good" or message.blamed or message.padding or message.reserved then return false end
  if last - message[1] > MAX_SPAN then return false end
  for i = 1, #message do
    if message[i] % 1 ~= 0 then return false end
  end
  return true
end

local function make_small(entries, message)
  local last = message.last
  for i = 2, #message - 1 do entries[message[i]] = last end
  entries[message[1]] = -last
  entries[last] = { message.payload, message.address, message.delta, message.has_fault }
end

-- The message of a frame from what is kept.
local function recall(entries, look)
  local entry = entries[look]
  local last = type(entry) == "number" and math.abs(entry) or look
  local kept = entries[last]
  if not kept or not kept[2] or type(kept[1]) ~= "string" then return entry end
  local payload, address = kept[1], kept[2]
  local message, at = { last }, last
  repeat
    at = at - 1
    if entries[at] == last or entries[at] == -last then table.insert(message, 1, at) end
  until entries[at] == -last
  message.address, message.size, message.payload, message.status = address, #payload, payload, "good"
  message.crc = crc.update(crc.of(can_id.header(address, #payload)), payload)
  message.last, message.delta, message.has_fault = last, kept[3], kept[4]
  return message
end

-- The memory -------------------------------------------------------------------------------------

local Memory = {}
Memory.__index = Memory

--- The memory of one capture file.
-- options   { size_of = function(id, bus) -> payload size of a known message, nil for an unknown one;
--             new_history = function() -> a message.history, one for each pass }
function M.new(options)
  return setmetatable({ size_of = options.size_of, passes = passes.new(options.new_history),
    by_pass = {} }, Memory)
end

--- What a frame is.
-- frame    { address = wire.can_id.address of its 29-bit id, number, place = where in its packet,
--          is_again = whether Wireshark has shown it before, data = captured bytes, reported = its
--          length on the bus, bus = number, nil where there is one or nothing says; knows_bus =
--          whether this is known; is_wide = whether the user says that every extended frame is YAPP,
--          else only what is surely YAPP is claimed }: gets entry, look, pass = which has it, is_now
--          = whether that took it just now, faults = what is wrong with it: nil or a list of
--          { expert =, text =, message = or nil, void = whether it has been taken back since }
-- returns  its entry; nil for a frame that is not YAPP's
function Memory:look(frame)
  local address = frame.address
  local pass, look, is_now = self.passes:look(frame.number, frame.place, frame.is_again, frame.knows_bus)
  if not pass then return nil end
  local reassembly = self.by_pass[pass]
  if not reassembly then
    reassembly = new_reassembly(pass.entries, self.size_of)
    self.by_pass[pass] = reassembly
  end
  local entry
  if is_now then
    if not frame.knows_bus then pass.is_partial = true end
    local slot = frame.bus and address.key + frame.bus * BUS or address.key
    if not (TAKERS[address.ctrl] or undefined)(reassembly, slot, address, frame, look) then return nil end
    entry = pass.entries[look]
  else
    entry = recall(pass.entries, look)
    -- Of another id: a read filter rejected that frame.
    if not entry or entry.address.key ~= address.key then return nil end
  end
  frame.entry, frame.look, frame.pass, frame.is_now = entry, look, pass, is_now
  frame.faults = reassembly.faults[look]
  return entry
end

--- Says that a frame of ours came, of which the id was not known: a second pass may know it.
function Memory:is_unknown()
  self.passes.first.is_partial = true
end

--- Where a part of a message leads to.
-- returns  the number of the frame that shows the message, nil where that is not known; and whether
--          the capture ends before the message does, said at its last frame
function Memory:outcome(frame)
  local message = frame.entry
  if message.last then return frame.pass:number(message.last) end
  local is_open = self.passes.is_again and not message.status and not message.overtaken
  return nil, is_open and message[#message] == frame.look
end

--- The numbers of the frames of a message, in order; without those that a read filter rejected.
function Memory.frames_of(_, frame)
  local numbers = {}
  for _, look in ipairs(frame.entry) do numbers[#numbers + 1] = frame.pass:number(look) end
  return numbers
end

--- What changed with a message since its source's previous good one (see message.history).
-- m       as History:note takes it; gets is_unsure: whether that is not known, as nothing tells the
--         buses
-- frame   its last, or only, one, as look filled it in
function Memory.change(_, m, frame)
  local entry = frame.entry
  if frame.is_now and not frame.knows_bus then entry.is_unsure = true end
  m.is_unsure = entry.is_unsure
  if m.is_unsure then return nil end
  if not frame.is_now then
    m.delta = entry.delta
    return frame.pass:change(frame.look, m)
  end
  local change
  change, entry.delta = frame.pass:note(frame.look, m)
  return change
end

--- A message has been read, in its last, or only, frame.
-- has_fault  whether it has a fault flag set
function Memory.is_read(_, frame, has_fault)
  local entry = frame.entry
  if not frame.is_now then return end
  if has_fault then entry.has_fault = true end
  if not entry.is_unsure and entry.size and can_be_small(entry) then
    make_small(frame.pass.entries, entry)
  end
end

--- The messages of the pass that was made last that never ended, in the order of their Starts.
function Memory:unfinished()
  local list, pass = {}, self.passes:last()
  local reassembly = self.by_pass[pass]
  for _, open in pairs(reassembly and reassembly.open or {}) do
    for _, message in ipairs(open.messages or { open }) do
      -- It may have gone on behind a frame from which on the buses were not known.
      local is_unsure = message.bus and pass.is_partial
      if not message.status and not message.overtaken and not is_unsure then list[#list + 1] = message end
    end
  end
  table.sort(list, function(a, b) return a[1] < b[1] end)
  return list
end

return M
