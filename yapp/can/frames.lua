-- SPDX-License-Identifier: GPL-2.0-or-later
-- What is kept of the CAN frames of one pass: what each of them is, and what is wrong with it.  Pure Lua, 5.2 and 5.4.
--
-- All is kept by look: a number that grows, whose whole part is the frame's number (see can.memory).

local archive = require("yapp.base.archive")

local M = {}

local byte, char, sub = string.byte, string.char, string.sub
local unpack = rawget(table, "unpack")

local MAX_COUNT = 64 -- of frames, in the small form of a good message
local PACKED = 9 -- bytes of it besides distances and payload: count, key, CRC
local MAX_SIZE = archive.MAX_TEXT - MAX_COUNT - PACKED -- of a payload in it
local MAX_DISTANCE = archive.MAX_DISTANCE

local Frames = {}
Frames.__index = Frames

--- Nothing is known yet.
-- can_id   the module
-- It has entries, by look: a message whose table is kept; all else is in its archive, which is asked second.  And
-- faults, by look: a list of { expert =, text =, void = nil or true once it is taken back }.  And has_fractions:
-- whether any look may have one.  And is_only_pass, to be set: whether nobody will look at a frame again.
function M.new(can_id)
  return setmetatable({ can_id = can_id, archive = archive.new(true), entries = {}, faults = {}, distances = {} },
    Frames)
end

--- Says that something is wrong at a frame; of a message that may still come out good, where it is given.
function Frames:fault(look, expert, text, message)
  local list = self.faults[look]
  if not list then
    list = {}
    self.faults[look] = list
  end
  list[#list + 1] = { expert = expert, text = text, message = message }
  if message then
    message.blamed = message.blamed or {}
    message.blamed[#message.blamed + 1] = look
  end
end

-- Takes back the faults of a frame that is_void says so of.
local function take_back(self, look, is_void)
  local list = self.faults[look]
  for i = list and #list or 0, 1, -1 do
    if is_void(list[i]) then table.remove(list, i).void = true end
  end
  if list and #list == 0 then self.faults[look] = nil end
end

-- Takes back what was said of a message that came out good after all.
local function forgive(self, message)
  for _, look in ipairs(message.blamed) do
    take_back(self, look, function(fault) return fault.message == message end)
  end
end

--- A frame that belongs to no message.
-- can_id  its 29-bit id: CAN CTRL says what it is
function Frames:alone(look, can_id)
  local kept = self.archive
  kept.extras[look] = can_id
  if look >= kept.due then kept:pack(look) end
end

--- A Middle or End whose message is not known.
function Frames:orphan(look, address)
  self:alone(look, address.can_id)
  self:fault(look, "fragment.orphan",
    ("%s of a message whose Start is not here"):format(address.ctrl == self.can_id.END and "End" or "Middle"))
end

local OF_NO_MESSAGE = { ["fragment.orphan"] = true, ["fragment.duplicate"] = true }

--- A frame becomes a message's: that it seemed to be nobody's, or one delivered twice, is void.
function Frames:give(look, message)
  if self.faults[look] then
    take_back(self, look, function(fault) return OF_NO_MESSAGE[fault.expert] end)
  end
  self.archive.extras[look] = nil
  self.entries[look] = message
end

--- A good message has another frame with the same bytes instead of one of its frames.
function Frames:exchange(look, other)
  local message = self:entry(look)
  for i = 1, message.count do
    if message[i] == look then message[i] = other end
  end
  table.sort(message)
  for i = 1, message.count do self:give(message[i], message) end
end

--- A frame that CAN delivered twice: its message is whole without it.
function Frames:duplicate(look, message)
  self.entries[look] = message
  self:fault(look, "fragment.duplicate", "The frame before it once more: the CRC says that the message has one of them")
end

-- Whether the distances of a message's looks are no whole numbers.
local function has_fractions(message)
  for i = 1, message.count do
    if (message.last - message[i]) % 1 ~= 0 then return true end
  end
  return false
end

--- A message came out good.  What a later look at it needs is little: which frames it had, and their bytes; the usual
-- message keeps both as one string.
-- is_settled  whether nothing that comes can change its frames: of the only pass it leaves nothing behind then
-- returns     whether the table of the message is needed no more
function Frames:good(message, is_settled)
  if message.blamed then -- rare: it stays as it is
    forgive(self, message)
    return false
  end
  local entries, count, last, kept = self.entries, message.count, message.last, self.archive
  local is_usual = not (message.reserved or message.padding or message.duplicates) and count <= MAX_COUNT
  if is_settled and self.is_only_pass then
    for i = 1, count do entries[message[i]] = nil end
    if last >= kept.due then kept:pack(last) end
    return is_usual
  end
  if not is_usual or message.size > MAX_SIZE or last - message[1] > MAX_DISTANCE or
    self.has_fractions and has_fractions(message) then return false end
  local distances = self.distances
  for i = 1, count do
    local look = message[i]
    distances[i], entries[look] = last - look, nil
  end
  -- Count, distances, key, and the CRC as the Start has it.
  kept.extras[last] = char(count, unpack(distances, 1, count)) .. message.address.key_bytes ..
    sub(message.sent, 1, 4) .. message.payload
  if last >= kept.due then kept:pack(last) end
  return true
end

local function take_out(packed, last, can_id)
  local count = byte(packed)
  local message = { byte(packed, 2, count + 1) }
  for i = 1, count do message[i] = last - message[i] end
  local a, b, c, d, e, f, g, h = byte(packed, count + 2, count + PACKED)
  message.address = can_id.address(a * 0x1000000 + b * 0x10000 + c * 0x100 + d)
  message.crc = e + f * 0x100 + g * 0x10000 + h * 0x1000000
  message.count, message.last, message.status, message.payload = count, last, "good", sub(packed, count + PACKED + 1)
  message.size = #message.payload
  message.received = message.size
  return message
end

--- What a frame is.
-- returns  its message; or nil and the CAN id of a frame that belongs to none; or nothing for one that is not YAPP's
function Frames:entry(look)
  local message = self.entries[look]
  if message then return message end
  local extra = self.archive:get(look)
  if not extra then
    local last = self.archive:last_of(look)
    return last and self:entry(last)
  end
  if type(extra) == "number" then return nil, extra end
  return take_out(extra, look, self.can_id)
end

--- Whether anything is known of a look.
function Frames:has(look)
  return self.entries[look] ~= nil or self.archive:get(look) ~= nil or self.archive:last_of(look) ~= nil
end

return M
