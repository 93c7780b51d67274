-- SPDX-License-Identifier: GPL-2.0-or-later
-- All that is known of a file's CAN frames.  Pure Lua, 5.2 and 5.4: it is told facts and asked what a frame is.
--
-- A pass is frames in order, and each pass numbers its own looks at them (can.pass); passes meet only at (frame
-- number, place in the packet, id).

local M = {}

local can_pass = require("yapp.can.pass")
local can_reassembly = require("yapp.can.reassembly")

local floor, plain, MAX_CREDIT = math.floor, can_reassembly.plain, can_reassembly.MAX_CREDIT
local new_pass, next_look, find_look = can_pass.new, can_pass.next_look, can_pass.find_look
local place_of, number_of = can_pass.place_of, can_pass.number_of

local LINKS, NOTHING = { "command_in", "previous_change", "next_change" }, {} -- in a change of message.history

local Memory = {}
Memory.__index = Memory

--- The memory of one capture file.
-- parts     the modules { can_id =, crc =, can_frames =, can_interleave =, can_repeated = }
-- options   { size_of = function(id, bus) -> payload size of a known message, nil for an unknown one;
--             new_history = function() -> a message.history, one for each pass;
--             has_buses = whether the file is known to have several buses }
-- It has is_again: whether a second look has been seen.  And highest: the highest number so far, infinity from then on.
-- A frame above it cannot have been looked at before, which saves asking Wireshark.  And usual: where the first frame
-- was in its packet, nil before it.  And short: by CAN CTRL, who takes a frame on the short way (see Memory:plain);
-- empty before the first frame, and once a second look has been seen.
function M.new(parts, options)
  local self = setmetatable({ parts = parts, size_of = options.size_of, new_history = options.new_history,
    is_mixed = options.has_buses or false, is_guessed = false, is_blind = false, is_again = false, reached = 0,
    highest = 0, short = NOTHING }, Memory)
  self.first = new_pass(self)
  self.reassembly, self.of_plain = self.first.reassembly, { pass = self.first, is_now = true } -- of the short way
  return self
end

--- Says that the first pass cannot know all of the facts.
function Memory:guess()
  self.is_guessed = true
end

--- Says that the first pass is the only one: what comes the short way leaves nothing behind.  Were there a second one
-- after all, it would find everything anew, as behind a first that had to guess.
function Memory:only_pass()
  self.first.kept.is_only_pass, self.is_guessed = true, true
end

--- tshark's taps see one of the first packets.  A first pass of two has none, and has had all packets before they do.
function Memory:tapped(number)
  if not self.is_again and self.highest <= number then self:only_pass() end
end

-- Whether nothing of a message is kept: there is nobody who would look at it again.
local function leaves_nothing(self, record)
  return record == self.of_plain and self.first.kept.is_only_pass
end

-- Takes a frame in the order of a pass; returns whether it is YAPP's, and its message.
local function take(self, pass, address, facts, look)
  if facts.doubtful then self.is_guessed = true end
  if not facts.informed and pass == self.first then self.is_blind = true end
  facts.look = look
  local is_ours, message = pass.reassembly:frame(address, facts)
  pass.is_taken = is_ours
  return is_ours, message
end

-- Whether a second pass goes on at this frame: it has seen all that the first knows in front of it.  Who asks for a
-- frame here and there, as sharkd does, gets what the first pass knows.
local function follows(self, number)
  local first = self.first
  for before = self.reached + 1, number - 1 do
    if first.repeats[before] or first.kept:has(before) then return false end
    self.reached = before
  end
  return true
end

-- Whether this look belongs to a second pass that refines a first one that had to guess.  A read filter leaves gaps:
-- then there is none.  In Wireshark a look for the packet list may not have the bus that a look for the details has:
-- the second pass is made of looks of one kind.
local function refines(self, facts)
  if not (self.is_guessed or self.is_blind) or self.first.is_filtered then return false end
  local second, number = self.second, facts.number
  if second and second.is_informed and not facts.informed then return false end
  if second and number < second.highest then return false end
  return number <= self.reached or follows(self, number)
end

-- What the first pass knows of a message that the second has not seen to its end.
-- returns  the message there; and whether it is surely the same: if the first mixed buses, it is where it has this from
--          the CRC or nothing of its kind came behind it; and likely where no other message was open when it ended
local function foreseen(self, message)
  local second, start = self.second, message[1]
  local look, same = find_look(self.first, floor(start), place_of(second, start), message.address.key)
  if not same or same[1] ~= look then return nil end
  local is_alone = not (same.status or same.from)
  if not self.is_mixed or same.status == "good" or is_alone then return same, true end
  if same.is_only then return same, false end
end

-- The second pass's look at a frame, and whether it is made now; nil where that pass has not come so far, or not by
-- here, and nil and false where it left the frame to others.
local function second_look(self, address, facts)
  local second = self.second
  if second then
    local look, message = find_look(second, facts.number, facts.place, address.key)
    if look then return look, false, message end
  end
  if not refines(self, facts) then return nil end
  if not second then
    second = new_pass(self)
    second.is_informed = facts.informed
    self.second = second
  end
  self.reached = math.max(self.reached, facts.number)
  local look = next_look(second, facts.number, facts.place)
  local is_ours, message = take(self, second, address, facts, look)
  if not is_ours then return nil, false end
  return look, true, message
end

-- The record of a frame that belongs to a message which has not ended here: where it leads to.
local function link(self, record, message)
  local pass, has_ended = record.pass, self.is_again
  if not message.last and pass == self.second then
    local same, is_sure = foreseen(self, message)
    if is_sure then
      message, pass = same, self.first
    else
      record.has_fault = same and self.first.archive:is_faulty(same.last) -- kept rather than lost
      has_ended = not record.is_now and pass.highest >= self.first.highest
    end
  end
  local last = message.last
  if last then
    record.leads_to, record.has_fault = number_of(pass, last), pass.archive:is_faulty(last)
  elseif has_ended and not message.status and not message.overtaken then
    record.is_unfinished = floor(message[message.count]) == floor(record.look)
  end
end

-- Fills in a record.
-- is_now  whether the look was made now; message: of the frame, nil for one that belongs to none
local function fill(self, record, pass, look, is_now, message)
  record.is_last, record.alone, record.leads_to, record.is_late = nil, nil, nil, nil
  record.is_unfinished, record.has_fault, record.faults = nil, nil, look and pass.faults[look]
  record.pass, record.look, record.message, record.is_now = pass, look, message, is_now
  if not message then
    record.alone = look and select(2, pass.kept:entry(look))
  elseif message.last == look then
    record.is_last = true
  elseif self.is_again or message.last then
    link(self, record, message)
  end
  return record
end

--- The short way to take a new frame of which nothing can be said but that it begins a message, is a part of one, or
-- ends it well.  The first frame, and that of a second bus, goes the long way: look notes what it says of the capture.
-- taker              self.short[CAN CTRL], not nil
-- number, data, bus  as look has them of a new frame, its number above self.highest, that is in the usual place, whole
--                    and, for sure, no remote frame
-- returns            its message, and whether that ends here; nil where it is not so: then nothing was done, and look
--                    takes it
function Memory:plain(taker, address, number, data, bus)
  local reassembly = self.reassembly
  if bus ~= self.first_bus and not self.is_mixed or reassembly.credit < MAX_CREDIT then return nil end
  local message, is_last = taker(reassembly, address, number, data, bus)
  if message then self.highest = number end
  return message, is_last
end

--- The record of a frame that has just come the short way, as look has it: until the next one.
function Memory:plain_record(number, message, is_last)
  local record = self.of_plain
  record.look, record.message, record.is_last = number, message, is_last
  return record
end

-- What came the short way, the first pass has to know before anything else comes.
local function catch_up(self)
  local first, highest = self.first, self.highest
  if highest > first.highest and not self.is_again then
    first.highest, first.latest, first.place, first.is_taken = highest, highest, self.usual, true
  end
end

--- What a frame is.
-- address  wire.can_id.address of its 29-bit id
-- facts    { number, place = where in its packet, is_again = whether Wireshark has shown it before, data, reported,
--          bus, is_apart, informed = whether this pass can tell the bus, doubtful, wide: as for Reassembly:frame }
-- record   a table to fill in, of an earlier look or empty; its message is good until the next look
-- returns  nil for a frame that is not YAPP's, else the record:
--          { message = its message, or alone = the CAN id of a frame without one; is_last = whether the message ends
--            here; leads_to = number of the frame where it does; is_unfinished = whether it never does, and this is its
--            last frame; has_fault = whether the message has a fault flag set, as far as that is known;
--            faults = list of { expert, text } or nil; is_now = whether the frame was taken just now, in order;
--            is_late = whether no pass had its id in time }
function Memory:look(address, facts, record)
  local first, bus = self.first, facts.bus
  catch_up(self)
  if bus then
    self.first_bus = self.first_bus or bus
    if bus ~= self.first_bus then self.is_mixed = true end
  end
  if not facts.is_again then
    local look = next_look(first, facts.number, facts.place)
    if not self.is_again then self.highest, self.usual, self.short = facts.number, first.usual, plain end
    local is_ours, message = take(self, first, address, facts, look)
    return is_ours and fill(self, record, first, look, true, message) or nil
  end
  self.is_again, self.highest, self.short = true, math.huge, NOTHING
  local look, is_now, message = second_look(self, address, facts)
  if look then
    fill(self, record, self.second, look, is_now, message)
    local is_message = record.is_last or record.alone and address.ctrl == 0
    if is_message or self.is_guessed or self.is_mixed or facts.is_apart then return record end
    -- Else the second pass knows no more than the first, which knows what comes behind a frame.
  elseif is_now == false then
    return nil
  end
  local before, its = find_look(first, facts.number, facts.place, address.key)
  if before then return fill(self, record, first, before, false, its) end
  if look then return record end
  if not facts.wide then return nil end
  fill(self, record, first)
  record.alone, record.is_late = address.can_id, true
  return record
end

--- A frame that is not ours after all: a remote frame that an earlier pass could not tell.
-- facts  as for look
function Memory:pass_over(facts)
  if facts.is_again and refines(self, facts) then self.reached = math.max(self.reached, facts.number) end
end

--- The numbers of the frames of a message that has ended, in order; without those that a read filter rejected.
function Memory.frames_of(_, record)
  local numbers, message = {}, record.message
  for i = 1, message.count do numbers[#numbers + 1] = number_of(record.pass, message[i]) end
  return numbers
end

-- A change with numbers of frames for looks.
local function numbered(pass, change)
  for _, name in ipairs(change and LINKS or NOTHING) do
    change[name] = change[name] and number_of(pass, change[name])
  end
  return change
end

-- What the first pass, which told no buses, noted of a message: its source has none there.
local function blind_change(self, message)
  message.is_unsure = self.is_mixed -- several sources were one
  if message.is_unsure then return nil end
  local source, bus = message.source, message.bus
  message.source, message.bus = message.blind_source, nil
  local change = self.first.history:change(message)
  message.source, message.bus = source, bus
  return change
end

-- The next change of a message's alarms.  What is still to come the second pass has from the first, if that did not mix
-- buses.
local function next_change(self, message, record)
  local pass = record.is_now and record.pass == self.second and not self.is_mixed and self.first or record.pass
  local is_blind = pass == self.first and self.is_blind
  return pass.history:next_change(record.look, is_blind and message.blind_source or message.source)
end

--- What changed with a message since its source's previous good one (see message.history).
-- message  as History:note takes it, and blind_source = key of its source where no buses are told; number and delta are
--          filled in, and is_unsure = whether this is not known
-- record   of its last, or only, frame
-- returns  a change, or nil; its frames are numbers of frames
function Memory:change(message, record)
  local pass, look = record.pass, record.look
  if not look then return nil end -- is_late: no history has it
  local history, change = pass.history
  message.number = look
  if record.is_now then
    local delta
    change, delta = history:note(message)
    if not leaves_nothing(self, record) then pass.archive.deltas[look] = delta end
  else
    message.delta = pass.archive:delta(look)
    if pass == self.first and self.is_blind then
      change = blind_change(self, message)
    else
      change = history:change(message)
    end
  end
  if not change then return nil end
  if change.is_alarm or change.active_since then change.next_change = next_change(self, message, record) end
  return numbered(pass, change)
end

--- Notes that a message has a fault flag set, for later looks at its other frames.
function Memory:note_fault(record)
  local look, archive = record.look, record.pass.archive
  if look and not leaves_nothing(self, record) and not archive:is_faulty(look) then archive.faulty[look] = true end
end

--- The messages of the pass that was made last that never ended.
function Memory:unfinished()
  return (self.second or self.first).reassembly:unfinished()
end

return M
