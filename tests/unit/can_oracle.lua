-- SPDX-License-Identifier: GPL-2.0-or-later
-- What each CAN frame is, by the rules of the protocol's document, once more and as simply as they
-- can be said; of buses that are told apart, or of one.
--
-- tests/e2e/can_generator.py asks it, too: tests/unit/can_verdicts.lua.
local crc = require("yapp.wire.crc")

local M = {}

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
local FD = { 8, 12, 16, 20, 24, 32, 48, 64 }
M.KNOWN = { [0x000] = 7, [0x200] = 17, [0x210] = 32, [0x211] = 32 } -- sizes of known messages

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

-- The runs of equal chunks before the last one: list of { from, to }.
local function runs_of(chunks)
  local list, at = {}, 1
  while at < #chunks do
    local from = at
    while at + 1 < #chunks and chunks[at + 1] == chunks[from] do at = at + 1 end
    if at > from then list[#list + 1] = { from, at } end
    at = at + 1
  end
  return list
end

-- Frames that came twice: runs of frames alike, of which some fewer are the message; the first ones
-- stay.  Every choice is tried, most of the first run first.
-- needed   bytes of the last frame if none came twice
-- returns  { [index] = true } of those too many; padding
local function repeated(message, frame, needed)
  local chunks = message.chunks
  local runs, out = runs_of(chunks), {}
  local function try(index, rest_needed)
    local run = runs[index]
    if not run then
      local rest, zeros = {}, padding(frame, rest_needed)
      for i, chunk in ipairs(chunks) do
        if not out[i] then rest[#rest + 1] = chunk end
      end
      return zeros and is_good(message, table.concat(rest):sub(1, message.size)) and zeros
    end
    for count = run[2] - run[1], 0, -1 do
      for i = run[1] + 1, run[2] do out[i] = i > run[2] - count or nil end
      local zeros = try(index + 1, rest_needed + count * #chunks[run[1]])
      if zeros then return zeros end
    end
  end
  local zeros = try(1, needed)
  if zeros then return out, zeros end
end

-- A message has ended: its frames lead to the last one.
local function show(verdicts, message, out, zeros)
  local last, members = message.frames[#message.frames], { message.start }
  for i, frame in ipairs(message.frames) do
    if out[i] then
      verdicts[frame].anomalies[1] = "fragment.duplicate"
    else
      members[#members + 1] = frame
    end
    verdicts[frame].in_number = last
  end
  verdicts[message.start].in_number = last
  verdicts[last].members, verdicts[last].padding = members, zeros
end

-- What an End makes of its message.
local function finish(verdicts, message, frame, say)
  local at, excess = frame.number, message.received - message.size
  local needed, out = frame.reported - excess, {}
  local zeros = not message.status and padding(frame, needed)
  local status = message.is_cut and "truncated" or "good"
  if zeros then
    local payload = table.concat(message.chunks):sub(1, message.size)
    if not message.is_cut and not is_good(message, payload) then status = "bad" end
  elseif not message.status and excess > 0 and not message.is_cut then
    out, zeros = repeated(message, frame, needed)
    out = out or {}
  end
  if zeros then
    say(at, status)
    return show(verdicts, message, out, zeros)
  end
  show(verdicts, message, {}, 0)
  verdicts[at].members = nil
  local is_short = excess < 0 and not message.status
  say(at, is_short and "incomplete" or "overrun",
    is_short and "fragment.incomplete" or "fragment.overrun")
end

local function take_start(self, slot, frame, id, say)
  local known, data = self.known[id.id], frame.data
  local size, reserved = number(data, 5, 2), number(data, 7, 2)
  local is_plausible = id.ctl == 0 and frame.reported == 8 and (not reserved and known or
    reserved == 0 and size > 8 and (known or id.seq == 0 or self.accepted[id.id]))
  if not (frame.accepts_all or is_plausible) then return end
  self.accepted[id.id] = true
  local before, anomalies = self.open[slot], {}
  if before and not before.status then anomalies[1] = "fragment.incomplete" end
  self.broken[slot] = before and 4 or math.max((self.broken[slot] or 0) - 1, 0)
  self.verdicts[frame.number].may_mix = self.verdicts[frame.number].may_mix or before ~= nil
  self.open[slot] = nil
  if frame.reported ~= 8 then
    anomalies[#anomalies + 1] = frame.reported > 8 and "size.mismatch" or "fragment.incomplete"
  end
  if reserved then
    if size == 0 or known and size ~= known then anomalies[#anomalies + 1] = "size.mismatch" end
    if reserved ~= 0 then anomalies[#anomalies + 1] = "reserved.nonzero" end
  end
  local is_message = reserved and size > 0
  say(frame.number, is_message and "." or "start", unpack(anomalies))
  if not is_message then return end
  self.open[slot] = { id = id.id, seq = id.seq, ctl = id.ctl, crc = number(data, 1, 4), size = size,
    reserved = reserved, start = frame.number,
    chunks = {}, frames = {}, received = 0, alike = 0 }
end

local function take_fragment(self, slot, frame, id, say)
  local message, is_end = self.open[slot], id.ctrl == 3
  if not message then
    if frame.accepts_all or id.ctl == 0 and self.known[id.id] then
      say(frame.number, "orphan", "fragment.orphan")
    end
    return
  end
  local chunks = message.chunks
  message.received = message.received + frame.reported
  message.frames[#message.frames + 1] = frame.number
  if not message.is_cut then
    if frame.data == chunks[#chunks] then message.alike = message.alike + frame.reported end
    chunks[#chunks + 1] = frame.data
    message.is_cut = #frame.data < frame.reported
  end
  if is_end then
    self.open[slot] = nil
    finish(self.verdicts, message, frame, say)
    local what = self.verdicts[frame.number].what
    if what ~= "good" and what ~= "truncated" then self.broken[slot] = 4 end
    return
  end
  local too_many = message.received - message.size
  if message.status or too_many > 0 and too_many > message.alike then
    message.status = "overrun"
    return say(frame.number, ".", "fragment.overrun")
  end
  say(frame.number, ".")
end

--- What each frame is.
-- frames   list of { can_id =, data = captured bytes, reported = length, bus =, accepts_all =,
--          number = from 1 on }; can_id is nil of one that is no extended data frame
-- known    { [message ID] = size }; KNOWN if left out
-- returns  list of { what = in the words of can_words, anomalies = list, text = of both; in_number =
--          of the frame that shows its message; at the last frame of a message with all its bytes
--          members = numbers of its frames, padding; may_mix = whether a broken message may still wait
--          for frames of this key }
function M.verdicts(frames, known)
  local self = { open = {}, accepted = {}, broken = {}, verdicts = {}, known = known or M.KNOWN }
  local verdicts = self.verdicts
  local function say(at, what, ...)
    verdicts[at].what, verdicts[at].anomalies = what, { ... }
  end
  for at, frame in ipairs(frames) do
    verdicts[at] = { what = "-", anomalies = {}, may_mix = false }
    local rest = frame.can_id or 0
    local id = { seq = rest % 256, ctl = math.floor(rest / 256) % 64,
      ctrl = math.floor(rest / 2 ^ 14) % 16, id = math.floor(rest / 2 ^ 18) }
    local slot = table.concat({ frame.bus or 0, id.id, id.ctl, id.seq }, " ")
    verdicts[at].may_mix = (self.broken[slot] or 0) > 0
    local size = self.known[id.id]
    if not frame.can_id then
      verdicts[at].may_mix = false
    elseif id.ctrl == 0 then
      verdicts[at].padding = size and padding(frame, size)
      if frame.accepts_all or id.ctl == 0 and verdicts[at].padding then say(at, "single") end
    elseif id.ctrl == 1 then
      take_start(self, slot, frame, id, say)
    elseif id.ctrl < 4 then
      take_fragment(self, slot, frame, id, say)
    elseif frame.accepts_all then
      say(at, "invalid", "can.ctrl.invalid")
    end
  end
  for _, verdict in ipairs(verdicts) do
    -- A fragment of a message that does not end may turn out to be another's.
    verdict.may_mix = verdict.may_mix or verdict.what == "." and not verdict.in_number
    table.sort(verdict.anomalies)
    verdict.text = table.concat({ verdict.what, unpack(verdict.anomalies) }, "+")
  end
  return verdicts
end

return M
