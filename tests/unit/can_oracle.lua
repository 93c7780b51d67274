-- SPDX-License-Identifier: GPL-2.0-or-later
-- What each CAN frame is, by the rules of the protocol's document, once more and as simply as they
-- can be said; of buses that are told apart, or of one.  And random frames of them.
local crc = require("yapp.wire.crc")
local words = require("can_words")

local M = {}

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
local FD = { 8, 12, 16, 20, 24, 32, 48, 64 }

-- A number of that many bytes, little endian; nil where they are not there.
local function number(data, at, count)
  local value = 0
  for i = at + count - 1, at, -1 do
    if i > #data then return nil end
    value = value * 256 + data:byte(i)
  end
  return value
end

local function two(n) return string.char(n % 256, (n - n % 256) / 256) end

local function is_good(message, payload)
  local header = "YP" .. string.char(message.seq, message.ctl) .. two(message.id) .. "\0\0" ..
    two(message.size) ..
    two(message.reserved)
  return crc.of(header .. payload) == message.crc
end

-- How many zeros behind the last bytes that are needed make the frame up to a length that CAN FD
-- has.
local function padding(frame, needed)
  if frame.reported == needed then return 0 end
  if needed < 1 or needed > frame.reported or frame.data:sub(needed + 1):find("[^%z]") then
    return nil
  end
  for _, length in ipairs(FD) do
    if length >= needed then
      return length == frame.reported and length > 8 and length - needed or nil
    end
  end
end

-- Frames that came twice: a run of frames alike, of which some fewer are the message; the first
-- ones stay.
-- needed   bytes of the last frame if none came twice
-- returns  { [place] = true } of those too many
local function repeated(message, frame, needed)
  local chunks, at = message.chunks, 1
  while at < #chunks do
    local first = at
    while at + 1 < #chunks and chunks[at + 1] == chunks[first] do at = at + 1 end
    for count = 1, at - first do
      local rest, out = {}, {}
      for i, chunk in ipairs(chunks) do
        if i > first and i <= first + count then out[i] = true else rest[#rest + 1] = chunk end
      end
      if padding(frame, needed + count * #chunks[first]) and
        is_good(message, table.concat(rest):sub(1, message.size)) then return out end
    end
    at = at + 1
  end
end

-- What an End makes of its message.
local function finish(verdicts, message, frame, say)
  local at, needed = frame.number, frame.reported - (message.received - message.size)
  local zeros = padding(frame, needed)
  if message.status then return say(at, "overrun", "fragment.overrun") end
  if zeros then
    local status = message.is_cut and "unverified" or
      is_good(message, table.concat(message.chunks):sub(1, message.size)) and "good" or "bad"
    return say(at, status)
  end
  local excess = message.received - message.size
  local out = excess > 0 and not message.is_cut and repeated(message, frame, needed)
  if not out then
    return say(at, excess < 0 and "short" or "overrun",
      excess < 0 and "fragment.incomplete" or "fragment.overrun")
  end
  for place in pairs(out) do verdicts[message.frames[place]].faults[1] = "fragment.duplicate" end
  say(at, "good")
end

local function take_start(self, slot, frame, id, say)
  local known, data = words.KNOWN[id.id], frame.data
  local size, reserved = number(data, 5, 2), number(data, 7, 2)
  local is_plausible = id.ctl == 0 and frame.reported == 8 and (not reserved and known or
    reserved == 0 and size > 8 and (known or id.seq == 0 or self.claimed[id.id]))
  if not (frame.is_wide or is_plausible) then return end
  self.claimed[id.id] = true
  local before, faults = self.open[slot], {}
  if before and not before.status then faults[1] = "fragment.incomplete" end
  self.open[slot] = nil
  if frame.reported ~= 8 then
    faults[#faults + 1] = frame.reported > 8 and "size.mismatch" or "fragment.incomplete"
  end
  if reserved then
    if size == 0 or known and size ~= known then faults[#faults + 1] = "size.mismatch" end
    if reserved ~= 0 then faults[#faults + 1] = "reserved.nonzero" end
  end
  local is_message = reserved and size > 0
  say(frame.number, is_message and "part" or "start", unpack(faults))
  if not is_message then return end
  self.open[slot] = { id = id.id, seq = id.seq, ctl = id.ctl, crc = number(data, 1, 4), size = size,
    reserved = reserved,
    chunks = {}, frames = {}, received = 0, alike = 0 }
end

local function take_part(self, slot, frame, id, say, verdicts)
  local message, is_end = self.open[slot], id.ctrl == 3
  if not message then
    if frame.is_wide or id.ctl == 0 and words.KNOWN[id.id] then
      say(frame.number, "orphan", "fragment.orphan")
    end
    return
  end
  local chunks = message.chunks
  message.received = message.received + frame.reported
  if not message.is_cut then
    if frame.data == chunks[#chunks] then message.alike = message.alike + frame.reported end
    chunks[#chunks + 1], message.frames[#chunks + 1] = frame.data, frame.number
    message.is_cut = #frame.data < frame.reported
  end
  if is_end then
    self.open[slot] = nil
    return finish(verdicts, message, frame, say)
  end
  local too_many = message.received - message.size
  if message.status or too_many > 0 and too_many > math.min(message.alike, 8 * frame.reported) then
    message.status = "overrun"
    return say(frame.number, "part", "fragment.overrun")
  end
  say(frame.number, "part")
end

--- What each frame is, in the words of can_words.
function M.verdicts(frames)
  local self, verdicts = { open = {}, claimed = {} }, {}
  local function say(at, what, ...) verdicts[at] = { what = what, faults = { ... } } end
  for at, frame in ipairs(frames) do
    local rest = frame.can_id
    local id = { seq = rest % 256, ctl = (rest - rest % 256) / 256 % 64,
      ctrl = math.floor(rest / 2 ^ 14) % 16,
      id = math.floor(rest / 2 ^ 18) }
    local slot = table.concat({ frame.bus or 0, id.id, id.ctl, id.seq }, " ")
    say(at, "-")
    local known = words.KNOWN[id.id]
    if id.ctrl == 0 then
      if frame.is_wide or known and id.ctl == 0 and padding(frame, known) then say(at, "single") end
    elseif id.ctrl == 1 then
      take_start(self, slot, frame, id, say)
    elseif id.ctrl < 4 then
      take_part(self, slot, frame, id, say, verdicts)
    elseif frame.is_wide then
      say(at, "invalid", "can.ctrl.invalid")
    end
  end
  local texts = {}
  for at, verdict in ipairs(verdicts) do
    table.sort(verdict.faults)
    texts[at] = table.concat({ verdict.what, unpack(verdict.faults) }, "+")
  end
  return texts
end

-- Random frames -----------------------------------------------------------------------------------

local IDS = { { 0x210, 32 }, { 0x200, 17 }, { 0x123, 40 }, { 0x210, 34 } } -- with a usual size

-- The frames of a message, { CAN CTRL, data }; some of CAN FD with padding.
local function message_of(random, id, size)
  local bytes, step = {}, random(6) == 1 and 64 or 8
  for i = 1, size do
    bytes[i] = string.char(random(12) == 1 and random(256) - 1 or 65 + random(2))
  end
  local payload = table.concat(bytes)
  local frames = { { 1, words.start(id.id, payload,
    { ctl = id.ctl, seq = id.seq, wrong = random(30) == 1,
    reserved = random(30) == 1 and 5 or nil, size = random(40) == 1 and random(70) - 1 or nil }) } }
  for at = 1, size, step do
    local data = payload:sub(at, at + step - 1)
    for _, length in ipairs(step == 64 and FD or {}) do
      if length >= #data then
        data = data .. ("\0"):rep(length - #data)
        break
      end
    end
    frames[#frames + 1] = { at + step > size and 3 or 2, data }
  end
  return frames
end

local DAMAGE = {
  function(frames, at) table.remove(frames, at) end,                                -- lost
  function(frames, at) table.insert(frames, at, frames[at]) end,                    -- came twice
  function(frames, at) table.insert(frames, at, { 2, "strangers" }) end,            -- too many
  function(frames, at) frames[at] = { frames[at][1], frames[at][2]:sub(1, 3) } end, -- short
  -- cut by the capture
  function(frames, at) frames[at] = { frames[at][1], frames[at][2], 3 } end,
  function(frames, at) frames[at] = { frames[at][1], "?" .. frames[at][2]:sub(2) } end,
  -- no CAN CTRL that is defined
  function(frames, at) frames[at] = { 4 + at % 12, frames[at][2] } end,
  function(frames, at) for _ = 1, at do table.insert(frames, 1, frames[1]) end end, -- new Starts
  function(frames, at) for _ = at, #frames do table.remove(frames) end end,         -- cut off
  function(frames) table.insert(frames, { 0, "single" }) end,
}

--- Frames of one or several buses, some of them lost, damaged, twice.
-- returns  list of frames as can_words.look takes them
function M.random_frames(random)
  local streams, is_wide = {}, random(3) == 1
  for bus = 1, random(3) do
    streams[bus] = {}
    for _ = 1, 2 + random(8) do
      local kind = IDS[random(#IDS)]
      local id = { id = kind[1], ctl = is_wide and random(9) == 1 and 7 or 0,
        seq = random(9) == 1 and 3 or 0 }
      local frames = message_of(random, id, random(4) == 1 and 8 + random(60) or kind[2])
      if random(2) == 1 then DAMAGE[random(#DAMAGE)](frames, random(#frames)) end
      for _, frame in ipairs(frames) do
        table.insert(streams[bus], { can_id = words.can_id(id.id, frame[1], id.ctl, id.seq),
          reported = #frame[2],
          data = frame[2]:sub(1, frame[3] or -1), bus = bus, is_wide = is_wide })
      end
    end
  end
  local list = {}
  while #streams > 0 do
    local at = random(#streams)
    for _ = 1, random(3) do
      list[#list + 1] = table.remove(streams[at], 1)
      list[#list].number = #list
      if not streams[at][1] then
        table.remove(streams, at)
        break
      end
    end
  end
  return list
end

return M
