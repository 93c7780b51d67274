-- SPDX-License-Identifier: GPL-2.0-or-later
-- What each CAN frame is, by the rules of the protocol's document, once more and as simply as they
-- can be said; of buses that are told apart, or of one.
--
-- tests/e2e/can_generator.py asks it, too: tests/unit/can_verdicts.lua.
local crc = require("yapp.wire.crc")

local M = {}

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
local MAX_TRIES = 300 -- a longer search nobody need do
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

local function bytes_of(frames)
  local count = 0
  for _, frame in ipairs(frames) do count = count + frame.reported end
  return count
end

local function payload_of(message, frames)
  local chunks = {}
  for i, frame in ipairs(frames) do
    chunks[i] = frame.data
    if #frame.data < frame.reported then break end
  end
  return table.concat(chunks):sub(1, message.size)
end

-- The frames that a message may have: all that came since its Start and that no other has.
local function frames_since(open, message)
  local list = {}
  for _, frame in ipairs(open.frames) do
    if frame.number > message.start then list[#list + 1] = frame end
  end
  return list
end

-- Whether a frame came twice.
local function is_repeated(frames, i)
  return i > 1 and frames[i - 1].data == frames[i].data
end

-- The first choice of frames, the last one among them, that is a good message.  Each may be left out
-- if another Start came (may_skip), else one that came twice.
-- returns  the chosen frames and the padding of the last
local function choose(self, message, frames, may_skip)
  local chosen = {}
  local function try(first, needed)
    for i = first, #frames do
      local frame = frames[i]
      if self.tries > MAX_TRIES or bytes_of({ unpack(frames, i) }) < needed then return nil end
      chosen[#chosen + 1], self.tries = frame, self.tries + 1
      if i == #frames then
        local zeros = padding(frame, needed)
        if zeros and is_good(message, payload_of(message, chosen)) then return zeros end
      elseif frame.reported < needed and not frame.is_end then
        local zeros = try(i + 1, needed - frame.reported)
        if zeros then return zeros end
      end
      chosen[#chosen] = nil
      if not (may_skip or is_repeated(frames, i)) then return nil end
    end
  end
  local zeros = try(1, message.size)
  if zeros then return chosen, zeros end
end

-- A message has ended: its frames lead to the last one.
local function show(verdicts, message, frames, zeros)
  local last, members = frames[#frames].number, { message.start }
  for _, frame in ipairs(frames) do
    members[#members + 1] = frame.number
    verdicts[frame.number].in_number = last
  end
  verdicts[message.start].in_number = last
  verdicts[last].members, verdicts[last].padding = members, zeros
end

local function remove(list, unwanted)
  local is_unwanted, rest = {}, {}
  for _, one in ipairs(unwanted) do is_unwanted[one] = true end
  for _, one in ipairs(list) do
    if not is_unwanted[one] then rest[#rest + 1] = one end
  end
  return rest
end

-- Of two Starts that are the same, one next to the other, the second message to end is a copy.
local function mark_twin(message)
  if message.twin then message.twin.is_copy = true end
end

-- Give up the oldest message, with the frames before the next Start.
local function give_up_oldest(open, anomalies)
  local message, own = table.remove(open.messages, 1), {}
  local next_one = open.messages[1]
  for _, frame in ipairs(frames_since(open, message)) do
    if not next_one or frame.number < next_one.start then own[#own + 1] = frame end
  end
  open.frames = remove(open.frames, own)
  mark_twin(message)
  if message.is_copy then return end
  anomalies[#anomalies + 1] = bytes_of(own) > message.size and "fragment.overrun" or
    "fragment.incomplete"
end

-- Remove a good message and its frames: whoever has an earlier Start was overtaken.  What lies in
-- front of all open Starts is nobody's.
local function remove_good(self, open, index, chosen, anomalies)
  local message = open.messages[index]
  local own, is_chosen, is_stranger = frames_since(open, message), {}, false
  for _, frame in ipairs(chosen) do is_chosen[frame] = true end
  table.remove(open.messages, index)
  for i = 1, index - 1 do open.messages[i].is_overtaken = true end
  mark_twin(message)
  local first = open.messages[1]
  for i, frame in ipairs(own) do
    local is_nobodys = not is_chosen[frame] and not (first and frame.number > first.start)
    if is_nobodys and is_repeated(own, i) then
      local verdict = self.verdicts[frame.number]
      verdict.anomalies[#verdict.anomalies + 1] = "fragment.duplicate"
      verdict.in_number = chosen[#chosen].number
    elseif is_nobodys then
      is_stranger = true
    end
  end
  if is_stranger then anomalies[#anomalies + 1] = "fragment.orphan" end
  open.frames = remove(open.frames, chosen)
  return message
end

-- The newest message has all frames since its Start.
local function end_newest(self, open, anomalies)
  local message = open.messages[1]
  local frames = frames_since(open, message)
  local last, received, is_truncated = frames[#frames], bytes_of(frames), false
  for _, frame in ipairs(frames) do is_truncated = is_truncated or #frame.data < frame.reported end
  local zeros = padding(last, message.size - received + last.reported)
  local what = "bad"
  if not zeros then
    what = received > message.size and "overrun" or "incomplete"
    mark_twin(message)
    if not message.is_copy then anomalies[#anomalies + 1] = "fragment." .. what end
  elseif is_truncated then
    what = "truncated"
  elseif is_good(message, payload_of(message, frames)) then
    what = "good"
  end
  show(self.verdicts, message, frames, zeros or 0)
  if not zeros then self.verdicts[last.number].members = nil end
  return what
end

local function take_start(self, slot, frame, id, say)
  local known, data = self.known[id.id], frame.data
  local size, reserved = number(data, 5, 2), number(data, 7, 2)
  local is_plausible = id.ctl == 0 and frame.reported == 8 and (not reserved and known or
    reserved == 0 and size > 8 and (known or id.seq == 0 or self.accepted[id.id]))
  if not (frame.accepts_all or is_plausible) then return end
  self.accepted[id.id] = true
  local open, anomalies, is_message = self.open[slot], {}, reserved and size > 0
  local is_late = open and self.time - open.time >= 0.02
  while open and open.messages[1] and (not is_message or is_late or open.is_truncated or
    #open.messages == 4 or open.messages[1].is_overtaken or open.messages[1].is_copy) do
    give_up_oldest(open, anomalies)
  end
  if open and not open.messages[1] then open = nil end
  self.open[slot] = open
  if frame.reported ~= 8 then
    anomalies[#anomalies + 1] = frame.reported > 8 and "size.mismatch" or "fragment.incomplete"
  end
  if reserved then
    if size == 0 or known and size ~= known then anomalies[#anomalies + 1] = "size.mismatch" end
    if reserved ~= 0 then anomalies[#anomalies + 1] = "reserved.nonzero" end
  end
  say(frame.number, is_message and "." or "start", unpack(anomalies))
  if not is_message then return end
  open = open or { messages = {}, frames = {}, is_truncated = false, is_unsure = false }
  local is_near = open.time and self.time - open.time < 0.02
  self.open[slot], open.time = open, self.time
  local messages = open.messages
  local before = messages[#messages]
  local message = { id = id.id, seq = id.seq, ctl = id.ctl,
    crc = number(data, 1, 4), size = size, reserved = reserved, start = frame.number, has_others = messages[1] ~= nil }
  for _, other in ipairs(messages) do other.has_others = true end
  local is_next = before and #frames_since(open, before) == 0
  if is_next and before.crc == message.crc and before.size == size and is_near then
    before.twin, message.twin = message, before
  end
  table.insert(messages, message)
end

-- Whether an End came twice: the payload before it ends like that.
local function is_repeated_end(self, slot, frame, id)
  local last = id.ctrl == 3 and self.ended[slot]
  if not last or math.abs(self.time - last.time) >= 0.02 then return false end
  local length = frame.reported - last.padding
  return length > 0 and frame.data:sub(1, length) == last.payload:sub(-length)
end

local function take_fragment(self, slot, frame, id, say)
  local open, anomalies = self.open[slot], {}
  if not open then
    if frame.accepts_all or id.ctl == 0 and self.known[id.id] then
      local came_twice = is_repeated_end(self, slot, frame, id)
      say(frame.number, "orphan", came_twice and "fragment.duplicate" or "fragment.orphan")
    end
    return
  end
  local messages, is_end = open.messages, id.ctrl == 3
  local newest = messages[#messages]
  open.time = self.time
  open.is_truncated = open.is_truncated or #frame.data < frame.reported
  while open.is_truncated and messages[2] do give_up_oldest(open, anomalies) end
  table.insert(open.frames, { number = frame.number, data = frame.data, reported = frame.reported,
    is_end = is_end })
  local what = "."
  if is_end then
    -- A single message whose bytes add up is what it is.
    local fits = not messages[2] and padding(frame, newest.size - bytes_of(frames_since(open, newest)) +
      frame.reported)
    local index, chosen, zeros = 0, nil, nil
    local function try(i, may_skip)
      if fits or chosen or open.is_truncated then return end
      index, self.tries = i, 0
      chosen, zeros = choose(self, messages[i], frames_since(open, messages[i]), may_skip)
      open.is_unsure = open.is_unsure or self.tries > MAX_TRIES
    end
    try(#messages, false) -- all frames since the newest Start
    for i, message in ipairs(messages) do
      if message.has_others then try(i, true) end
    end
    local ends = 0
    for _, one in ipairs(frames_since(open, messages[1])) do ends = ends + (one.is_end and 1 or 0) end
    if chosen then
      what = "good"
      local message = remove_good(self, open, index, chosen, anomalies)
      show(self.verdicts, message, chosen, zeros)
      self.payload = payload_of(message, chosen)
    elseif ends >= #messages then
      while messages[2] do give_up_oldest(open, anomalies) end
      self.payload = payload_of(newest, frames_since(open, newest))
      what = end_newest(self, open, anomalies)
      open.messages = {}
    end
    if what == "good" then
      self.ended[slot] = { payload = self.payload, time = self.time,
        padding = self.verdicts[frame.number].padding }
    end
  end
  if not open.messages[1] then self.open[slot] = nil end
  self.verdicts[frame.number].is_unsure = open.is_unsure
  say(frame.number, what, unpack(anomalies))
end

--- What each frame is.
-- frames   list of { can_id =, data = captured bytes, reported = length, bus =, accepts_all =,
--          number = from 1 on, time = seconds, its number in ms if left out }; can_id is nil of one that is
--          no extended data frame
-- known    { [message ID] = size }; KNOWN if left out
-- returns  list of { what = in the words of can_words, anomalies = list, text = of both; in_number =
--          of the frame that shows its message; at the last frame of a message with all its bytes
--          members = numbers of its frames, padding; is_unsure = whether the search among its frames
--          is so long that nobody need do it }
function M.verdicts(frames, known)
  local self = { open = {}, ended = {}, accepted = {}, verdicts = {}, known = known or M.KNOWN }
  local verdicts = self.verdicts
  local function say(at, what, ...)
    verdicts[at].what = what
    for _, anomaly in ipairs({ ... }) do table.insert(verdicts[at].anomalies, anomaly) end
  end
  for at, frame in ipairs(frames) do
    verdicts[at] = { what = "-", anomalies = {}, is_unsure = false }
    self.time = frame.time or frame.number / 1000
    local rest = frame.can_id or 0
    local id = { seq = rest % 256, ctl = math.floor(rest / 256) % 64,
      ctrl = math.floor(rest / 2 ^ 14) % 16, id = math.floor(rest / 2 ^ 18) }
    local slot = table.concat({ frame.bus or 0, id.id, id.ctl, id.seq }, " ")
    local size = self.known[id.id]
    if frame.can_id and id.ctrl == 0 then
      verdicts[at].padding = size and padding(frame, size)
      if frame.accepts_all or id.ctl == 0 and verdicts[at].padding then say(at, "single") end
    elseif frame.can_id and id.ctrl == 1 then
      take_start(self, slot, frame, id, say)
    elseif frame.can_id and id.ctrl < 4 then
      take_fragment(self, slot, frame, id, say)
    elseif frame.can_id and frame.accepts_all then
      say(at, "invalid", "can.ctrl.invalid")
    end
  end
  for _, verdict in ipairs(verdicts) do
    table.sort(verdict.anomalies)
    verdict.text = table.concat({ verdict.what, unpack(verdict.anomalies) }, "+")
  end
  return verdicts
end

return M
