-- SPDX-License-Identifier: GPL-2.0-or-later
-- All that is known of a file's CAN frames: reassembly of Start, Middle, End ("Multi-Frame CAN
-- YAPP"), and what was said of each frame, for later looks.  Pure Lua.
--
-- It is told facts of frames, in the order of the capture, and asked what they are.  Of each frame
-- its entry is kept: the message that it is a part of, which all parts share, or { address,
-- source } of a frame that stands alone.  A message has
--   1 .. n      the looks of its frames (memory.passes)
--   address, size, crc, reserved (nil when 0)   of its Start; source, as whom it came from
--   status      nil while it is open; "good", "bad" (CRC), "short", "overrun", "unverified" (bytes
--               not captured), "cut" (a new Start came)
--   chunks      while it is open: what came, and received = how many bytes; repeated = bytes of
--               frames that are as the one before, is_cut = whether bytes were not captured: nil
--               where there was nothing of the kind
--   received    bytes, once it is known that they do not fit
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

local abs, concat, floor, min = math.abs, table.concat, math.floor, math.min
local update = crc.update
local END = can_id.END

local MAX_OPEN = 1024 -- an open message costs memory until something ends it: the oldest make room
local MAX_RUNS = 8 -- of frames alike, in which one that came twice is looked for
local MAX_SPAN = 1000 -- frames from the first to the last of a message that is kept small
local BUS = 0x20000000 -- keys of messages have 29 bits

-- Reassembly of one pass -------------------------------------------------------------------------

local Reassembly = {}
Reassembly.__index = Reassembly

-- pass     of memory.passes, whose entries get that of each frame, by look
-- options  as for M.new
local function new_reassembly(pass, options)
  return setmetatable({
    pass = pass,
    entries = pass.entries,
    source_of = options.source_of,
    claim = options.claim,
    -- by look: a list of { expert =, text =, message = or nil, void = true once it is taken back }
    faults = {},
    -- by slot (a message's key and bus): the message that is open there, or a can.pool of several
    open = {},
    open_count = 0,
    recalled = {}, -- the message of the latest look at one that is kept small
    claimed = {}, -- unknown IDs of which a Start without a Seq has come: then others may have one
  }, Reassembly)
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

--- Takes back what was said at a frame of a message that came out good, or of a frame that has
-- found its message.
-- is_void  function(fault) -> boolean
function Reassembly:take_back(look, is_void)
  local list = self.faults[look] or {}
  for i = #list, 1, -1 do
    if is_void(list[i]) then table.remove(list, i).void = true end
  end
  if #list == 0 then self.faults[look] = nil end
end

--- A Middle or End whose message is not known.
-- returns  its entry
function Reassembly:orphan(address, source, look)
  local kind = address.ctrl == END and "End" or "Middle"
  self:fault(look, "fragment.orphan", kind .. " of a message whose Start is not here")
  return self:alone(address, source)
end

--- The entry of a frame that stands alone.
function Reassembly:alone(address, source)
  self.claim(address.id)
  return { address = address, source = source, delta = nil }
end

--- A message has more or fewer bytes than its size.
-- returns  its status
function Reassembly:misfit(message, received, look)
  message.received = received
  local start = floor(message[1])
  if received < message.size then
    local text = "The message that started in frame %d ends with %d of %d bytes"
    text = text:format(start, received, message.size)
    self:fault(look, "fragment.incomplete", text, message)
    return "short"
  end
  local text = "%d bytes for the %d of the message that started in frame %d"
  self:fault(look, "fragment.overrun", text:format(received, message.size, start), message)
  return "overrun"
end

--- Ends a message: with a status when it is known, else the CRC decides.
function Reassembly.finish(_, message, payload, look, status)
  message.payload, message.last, message.status, message.chunks = payload, look, status, nil
  if status then return end
  local seed = can_id.seed(message.address, message.size, message.reserved)
  local calculated = update(seed, payload, 1, #payload)
  if calculated == message.crc then
    message.status = "good"
  else
    message.status, message.calculated = "bad", calculated
  end
end

-- Starts -----------------------------------------------------------------------------------------

-- What is wrong with a Start, as far as it was captured.
local function check_start(self, frame, look, size, reserved, source)
  local known = source.size
  if frame.reported > 8 then
    local text = "A Start has 8 bytes, this one has %d"
    self:fault(look, "size.mismatch", text:format(frame.reported))
  elseif frame.reported < 8 then
    local text = "A Start has 8 bytes, this one has %d: its message cannot be put together"
    self:fault(look, "fragment.incomplete", text:format(frame.reported))
  end
  if not reserved then return end
  if size == 0 then
    self:fault(look, "size.mismatch", "The size of the message is 0")
  elseif known and (size > known or size < (source.min_size or known)) then
    local text = "The size is %d bytes, the catalogue says %d"
    self:fault(look, "size.mismatch", text:format(size, known))
  end
  if reserved ~= 0 then
    self:fault(look, "reserved.nonzero", ("The reserved bytes are 0x%04x, not 0"):format(reserved))
  end
end

-- Whether a Start is surely YAPP's: a plausible one, and of an unknown ID one that does not number
-- itself, or follows such; or for a known ID one that the capture cut.
local function is_plausible(self, frame, size, reserved, is_known)
  local address = frame.address
  if address.ctl ~= 0 or frame.reported ~= 8 then return false end
  if not reserved then return is_known end
  if reserved ~= 0 or size <= 8 then return false end
  return is_known or address.seq == 0 or self.claimed[address.id]
end

-- Empties a slot.
local function close(self, slot)
  self.open[slot], self.open_count = nil, self.open_count - 1
end

-- Empties a slot of messages that have not ended.
local function cut(self, slot)
  local open = self.open[slot]
  close(self, slot)
  for _, message in ipairs(open.messages or { open }) do
    message.status, message.chunks = message.status or "cut", nil
  end
end

-- The slots with the oldest Starts make room for one more: it is said there.
local function make_room(self, look)
  local slots = {}
  for slot in pairs(self.open) do slots[#slots + 1] = slot end
  local function started(slot)
    local open = self.open[slot]
    return (open.messages and open:newest() or open)[1]
  end
  table.sort(slots, function(a, b) return started(a) < started(b) end)
  local count = #slots - floor(MAX_OPEN / 2)
  for i = 1, count do cut(self, slots[i]) end
  self:fault(look, "fragment.incomplete",
    ("%d messages are open: the oldest %d are given up"):format(#slots, count))
end

-- A Start came while something is open in its slot.  On a bus that is told from others it cuts that
-- off; else it may be another bus's, and what follows decides.
-- returns  a pool where what was open stays open; nil where not
local function overtake(self, slot, frame, look)
  local open = self.open[slot]
  local message = open.messages and open:newest() or open
  local chunks = message.chunks
  if not message.status and not message.overtaken then
    local received = chunks and chunks.received or open:received()
    local text = "A new Start cuts off the message that started in frame %d: %d of %d bytes"
    text = text:format(floor(message[1]), received, message.size)
    self:fault(look, "fragment.incomplete", text, message)
  end
  if frame.bus or message.status or chunks and chunks.is_cut then return cut(self, slot) end
  if not open.messages then open = pool.new(self, open) end
  self.open[slot] = open
  if open:overtake() then return open end
  close(self, slot)
end

local function start(self, slot, frame, look)
  local address = frame.address
  local source = self.source_of(address.id, frame.bus)
  local sum, size, reserved = can_id.start(frame.data)
  local known = source.size
  if not frame.is_wide and not is_plausible(self, frame, size, reserved, known) then
    return nil
  end
  if not self.claimed[address.id] then
    self.claimed[address.id] = true
    self.claim(address.id)
  end
  local others = self.open[slot] and overtake(self, slot, frame, look)
  if size ~= known or reserved ~= 0 or frame.reported ~= 8 then
    check_start(self, frame, look, size, reserved, source)
    if not reserved or size == 0 then return self:alone(address, source) end
  end
  -- With room for the usual message of five frames, and for the names that it will have.
  local message = {
    look, nil, nil, nil, nil,
    address = address,
    source = source,
    size = size,
    crc = sum,
    chunks = { nil, nil, nil, nil, received = 0 },
    status = nil,
    payload = nil,
    last = nil,
  }
  if reserved ~= 0 then message.reserved = reserved end
  if others then
    others:add(message)
    return message
  end
  if self.open_count >= MAX_OPEN then make_room(self, look) end
  self.open[slot], self.open_count = message, self.open_count + 1
  return message
end

-- Middles and Ends -------------------------------------------------------------------------------

-- CAN may deliver a frame twice (its sender did not see the acknowledgement): where a message is
-- too long by frames of one run of frames alike, and its CRC is good without them, they are left
-- out.
-- frame    the last one; needed: the bytes that it should have, with nothing left out
-- returns  whether it is so: then the message is ended
local function leave_out(self, message, frame, needed, look)
  local chunks, at, runs = message.chunks, 1, 0
  while at < #chunks and runs < MAX_RUNS do
    local first = at
    -- an End is sent once
    while at + 1 < #chunks and chunks[at + 1] == chunks[first] do at = at + 1 end
    for count = 1, at - first do
      needed = needed + #chunks[first]
      local padding = can_id.padding(frame.data, frame.reported, needed)
      if padding then
        runs = runs + 1
        local rest = concat(chunks, "", at + 1, #chunks - 1) .. frame.data:sub(1, needed)
        self:finish(message, concat(chunks, "", 1, at - count) .. rest, look)
        if message.status == "good" then
          if padding > 0 then message.padding = padding end
          for _ = 1, count do
            self:fault(table.remove(message, first + 2), "fragment.duplicate",
              "The frame before it once more: the CRC says that the message has one of them")
          end
          return true
        end
      end
    end
    needed = needed - (at - first) * #chunks[first]
    at = at + 1
  end
  return false
end

-- The End of a message that has not as many bytes as its size says.
local function finish_unusual(self, message, frame, look)
  local chunks = message.chunks
  local needed = frame.reported + message.size - chunks.received
  local padding = can_id.padding(frame.data, frame.reported, needed)
  if padding then
    message.padding = padding
    chunks[#chunks] = frame.data:sub(1, needed)
    return self:finish(message, concat(chunks), look, chunks.is_cut and "unverified" or nil)
  end
  if chunks.repeated and not chunks.is_cut and
    leave_out(self, message, frame, needed, look) then return end
  self:finish(message, concat(chunks), look, self:misfit(message, chunks.received, look))
  message.calculated = nil
end

-- Bytes that are as the ones before, or were not all captured.  Behind such nothing is known to be
-- in its place.
local function take_odd(chunks, at, data, reported)
  if chunks.is_cut then return end
  if data == chunks[at - 1] then chunks.repeated = (chunks.repeated or 0) + reported end
  chunks.is_cut = #data < reported
  chunks[at] = data
end

-- A Middle or End where no message waits for it that came so far as it should.
local function continue_other(self, slot, frame, look)
  local message, address = self.open[slot], frame.address
  if not message then
    local source = self.source_of(address.id, frame.bus)
    local is_known = address.ctl == 0 and source.size
    if not frame.is_wide and not is_known then return nil end
    return self:orphan(address, source, look)
  end
  if message.messages then
    local entry = message:frame(frame, look)
    if #message.messages == 0 then close(self, slot) end
    return entry
  end
  message[#message + 1] = look
  self:misfit(message, message.received + frame.reported, look)
  if address.ctrl == END then
    close(self, slot)
    self:finish(message, "", look, message.status)
  end
  return message
end

local function continue(self, slot, frame, look)
  local message = self.open[slot]
  local chunks = message and message.chunks
  if not chunks then return continue_other(self, slot, frame, look) end
  local data, reported, at = frame.data, frame.reported, #message
  local received = chunks.received + reported
  message[at + 1] = look
  chunks.received = received
  if data == chunks[at - 1] or #data < reported or chunks.is_cut then
    take_odd(chunks, at, data, reported)
  else
    chunks[at] = data
  end
  if frame.address.ctrl ~= END then
    local too_many = received - message.size
    if too_many > 0 and too_many > min(chunks.repeated or 0, MAX_RUNS * reported) then
      message.status, message.chunks = self:misfit(message, received, look), nil
    end
    return message
  end
  close(self, slot)
  if received == message.size then
    self:finish(message, concat(chunks), look, chunks.is_cut and "unverified" or nil)
  else
    finish_unusual(self, message, frame, look)
  end
  return message
end

-- Other frames -----------------------------------------------------------------------------------

local function single(self, _, frame)
  local address = frame.address
  local source = self.source_of(address.id, frame.bus)
  if not frame.is_wide then
    if not source.size or address.ctl ~= 0 then return nil end
    local least = source.min_size or source.size
    if not can_id.single_size(frame.data, frame.reported, least, source.size) then return nil end
  end
  return self:alone(address, source)
end

local function undefined(self, _, frame, look)
  if not frame.is_wide then return nil end
  local address = frame.address
  self:fault(look, "can.ctrl.invalid", ("CAN CTRL is %d; 0 to 3 are defined"):format(address.ctrl))
  return self:alone(address, self.source_of(address.id, frame.bus))
end

-- By CAN CTRL: (reassembly, slot, frame, look) -> the frame's entry, nil where it is not YAPP's.
local TAKERS = { [0] = single, start, continue, continue }
for ctrl = #TAKERS + 1, 15 do TAKERS[ctrl] = undefined end

-- What is kept -----------------------------------------------------------------------------------

-- A good message is kept small: at its last frame the seconds since the source's previous one, "!"
-- where a fault is set, else "|", its key and payload, at the others the look of the last one,
-- negative at its Start.  (Frames 7, 8 and 10 make a message: of 7 -10 is kept, of 8 10, of 10 the
-- text.)

-- Returns whether that goes.
local function make_small(pass, message, delta)
  local entries, first, last = pass.entries, message[1], message.last
  if message.blamed or message.padding or message.reserved or last - first > MAX_SPAN or
    pass:has_fractions(message) then return false end
  for i = 2, #message - 1 do entries[message[i]] = last end
  local mark = message.has_fault and "!" or "|"
  entries[first] = -last
  entries[last] = (delta or "") .. mark .. message.address.key_bytes .. message.payload
  return true
end

-- A message from what is kept of it; nil where that is another one.
local function make_big(self, last, address, source)
  local entries = self.entries
  local delta, mark, key, payload = entries[last]:match("^([^|!]*)([|!])(....)(.*)$")
  if key ~= address.key_bytes then return nil end
  local message = {
    last,
    address = address,
    source = source,
    size = #payload,
    crc = update(can_id.seed(address, #payload), payload),
    payload = payload,
    status = "good",
    last = last,
    delta = tonumber(delta),
    has_fault = mark == "!",
  }
  local at = last
  repeat
    at = at - 1
    if entries[at] == last or entries[at] == -last then table.insert(message, 1, at) end
  until entries[at] == -last
  self.recalled = message
  return message
end

-- The entry of a frame from what is kept; nil where that is of another id: a read filter rejected
-- that frame.  Most are asked for in order, so the message is often the latest: a tenth of two
-- passes.
local function recall(self, frame, look)
  local entries, address = self.entries, frame.address
  local entry = entries[look]
  local last = type(entry) == "number" and abs(entry) or look
  if type(entries[last]) ~= "string" then
    return entry and entry.address.key == address.key and entry or nil
  end
  local source, known = self.source_of(address.id, frame.bus), self.recalled
  if known.last == last and known.source == source and known.address.key == address.key then
    return known
  end
  return make_big(self, last, address, source)
end

-- The memory -------------------------------------------------------------------------------------

local Memory = {}
Memory.__index = Memory

--- The memory of one capture file.
-- options   { source_of = function(id, bus) -> of whom a frame is: a table, the same each time,
--           which entries have as source; it has bus, size = of the payload of a known message,
--           min_size = of the shortest that is right, nil where that is the size;
--             claim = function(id): a frame of this ID is ours;
--             new_history = function() -> a message.history, one for each pass }
function M.new(options)
  local all = passes.new(options.new_history)
  local first = new_reassembly(all.first, options)
  -- And second, where there is a second pass.
  return setmetatable({ options = options, passes = all, first = first }, Memory)
end

-- Which reassembly a frame belongs to that is looked at again, its look, and whether it is taken
-- now; nil where none had it.
local function find(self, frame)
  local pass, look, is_now = self.passes:look(frame.number, frame.place, true, frame.knows_bus)
  if not pass then return nil end
  if pass == self.first.pass then return self.first, look, is_now end
  self.second = self.second or new_reassembly(pass, self.options)
  return self.second, look, is_now
end

--- What a frame is.
-- frame    { address = wire.can_id.address of its 29-bit id, number, place = where in its packet,
--          is_again = whether Wireshark has shown it before, data = captured bytes, reported = its
--          length on the bus, bus = number, false where there is one or nothing says; knows_bus =
--          whether this is known; is_wide = whether the user says that every extended frame is
--          YAPP, else only what is surely YAPP is claimed; is_only_pass = whether no frame is
--          looked at again: then none is kept }: gets entry, look, pass = which has it, is_now =
--          whether that took it just now, faults = what is wrong with it: false or a list of {
--          expert =, text =, message = or nil, void = whether it has been taken back since }
-- returns  its entry; nil for a frame that is not YAPP's
function Memory:look(frame)
  local reassembly, is_now = self.first, true
  local look, entry
  if frame.is_again then
    reassembly, look, is_now = find(self, frame)
    if not look then return nil end
  else
    look = reassembly.pass:next(frame.number, frame.place)
  end
  if is_now then
    if not frame.knows_bus then reassembly.pass.is_partial = true end
    local address, bus = frame.address, frame.bus
    local slot = bus and address.key + bus * BUS or address.key
    entry = TAKERS[address.ctrl](reassembly, slot, frame, look)
    if not entry then
      reassembly.pass.left = look
    elseif not frame.is_only_pass then
      reassembly.entries[look] = entry
    end
  else
    entry = recall(reassembly, frame, look)
  end
  if not entry then return nil end
  frame.entry = entry
  frame.look = look
  frame.pass = reassembly.pass
  frame.is_now = is_now
  frame.faults = reassembly.faults[look] or false
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

--- What is new in a message (see message.history).
-- m       as History:note takes it, and has_fault = whether it has a fault flag set; gets delta,
--         and is_unsure: whether what came before is not known, as nothing tells the buses
-- frame   its last, or only, one, as look filled it in
function Memory.change(_, m, frame)
  local entry, pass = frame.entry, frame.pass
  if frame.is_now then
    if m.has_fault then entry.has_fault = true end
    if not frame.knows_bus then entry.is_unsure = true end
  end
  m.is_unsure = entry.is_unsure or false
  m.delta = false
  if m.is_unsure then return nil end
  if not frame.is_now then
    m.delta = entry.delta or false
    return pass:change(frame.look, m)
  end
  local change, delta = pass:note(frame.look, m)
  m.delta = delta or false
  if frame.is_only_pass then return change end
  if entry.status ~= "good" or not make_small(pass, entry, delta) then entry.delta = delta end
  return change
end

--- How things stand at it, once Memory:change has told.
function Memory.standing(_, m, frame)
  return not m.is_unsure and frame.pass:standing(m)
end

--- The messages of the pass that was made last that never ended, in the order of their Starts.
function Memory:unfinished()
  local list, pass = {}, self.passes:last()
  for _, open in pairs((self.second or self.first).open) do
    for _, message in ipairs(open.messages or { open }) do
      -- It may have gone on behind a frame from which on the buses were not known.
      local is_unsure = message.source.bus and pass.is_partial
      if not message.status and not message.overtaken and not is_unsure then
        list[#list + 1] = message
      end
    end
  end
  table.sort(list, function(a, b) return a[1] < b[1] end)
  return list
end

return M
