-- SPDX-License-Identifier: GPL-2.0-or-later
-- Messages of one key that interleave, where a capture does not tell its buses apart.  Pure Lua, 5.2 and 5.4.
--
-- A Start that arrives while a message with the same key is open may cut it off, or come from another bus.  From then
-- on the frames of that key are pooled, and an End looks for the frames that, with it, make up one of the open
-- messages: its size and its CRC decide.  Two messages may have frames with the same bytes, so a frame that went to the
-- wrong one can still change hands.  The reassembly's credit bounds the search to a few steps a frame.
--
-- A frame in the pool has look, data, length (on the bus), is_end, and once a good message has it, owner: the frames
-- of that message, its Start at 0, and its index among them.

local M = {}

local concat = table.concat

local MAX_OVERTAKEN = 3 -- a message that more Starts than this overtook is given up
local MAX_WASTE = 4096  -- bytes in the pool beyond what its messages can use

local Pool = {}
Pool.__index = Pool

-- The table of a message may have served a longer one before (can.reassembly): what it still has of that goes, as
-- the looks of a message that changes hands are sorted.
local function trim(message)
  for i = #message, message.count + 1, -1 do message[i] = nil end
end

--- A pool for one key.
-- reassembly  gives seed, misfit, finish, spend, what is kept of frames, and the modules can_id and crc
-- first       the message that is open, with the looks and chunks of its frames
function M.new(reassembly, first)
  local self = setmetatable({ reassembly = reassembly, messages = { first }, frames = {} }, Pool)
  first.from = 1
  trim(first)
  for i = 1, first.parts do
    local data = first.chunks[i]
    self.frames[i] = { look = first[i + 1], data = data, length = #data }
  end
  return self
end

-- The frames since a message's Start that nobody else took, as they came.
local function leftovers(self, message)
  local taken, length = {}, 0
  for i = message.from, #self.frames do
    if not self.frames[i].owner then
      taken[#taken + 1] = i
      length = length + self.frames[i].length
    end
  end
  return taken, length
end

--- The message with the newest Start.
function Pool:newest()
  return self.messages[#self.messages]
end

--- How many bytes have come since the newest Start.
function Pool:received()
  local _, length = leftovers(self, self:newest())
  return length
end

-- What lies before the oldest message belongs to nobody any more.
local function drop_frames(self)
  local first, rest = self.messages[1].from, {}
  if first <= 64 then return end
  for i = first, #self.frames do rest[#rest + 1] = self.frames[i] end
  self.frames = rest
  for _, open in ipairs(self.messages) do open.from = open.from - first + 1 end
end

--- A Start arrived: the open messages are overtaken, and too old ones given up.
-- returns  whether any is left; without one the key is an ordinary one again
function Pool:overtake()
  local messages = self.messages
  for i = #messages, 1, -1 do
    local open = messages[i]
    open.overtaken = (open.overtaken or 0) + 1
    if open.overtaken > MAX_OVERTAKEN then
      open.status = "cut"
      table.remove(messages, i)
    end
  end
  if not messages[1] then return false end
  drop_frames(self)
  return true
end

--- The message that a Start opens.
function Pool:add(message)
  message.from = #self.frames + 1
  trim(message)
  self.messages[#self.messages + 1] = message
end

-- A free frame with the same bytes that could serve the message that has this one: it lies between the frames there
-- whose bytes are others.  The last such: those before it may be wanted next.
local function substitute(self, frame)
  local owner, data = frame.owner, frame.data
  local before, behind = frame.index - 1, frame.index + 1
  while before > 0 and owner[before].data == data do before = before - 1 end
  while owner[behind] and owner[behind].data == data and not owner[behind].is_end do behind = behind + 1 end
  if not owner[behind] then return nil end -- it is an End
  self.reassembly:spend(#self.frames / 32)
  for i = #self.frames, 1, -1 do
    local other = self.frames[i]
    if other.look > owner[before].look and other.look < owner[behind].look and other.data == data and
      not other.owner and not other.taken and not other.is_end and other.length == frame.length then
      return other
    end
  end
end

-- Takes a frame for the message that is being looked for; returns whether it can be had.
local function take(self, goal, frame)
  if frame.taken or #frame.data < frame.length then return false end -- what the capture cut proves nothing
  if frame.owner then
    frame.instead = goal.exchange and substitute(self, frame)
    if not frame.instead then return false end
    frame.instead.taken = true
  end
  frame.taken = true
  return true
end

local function put_back(frame)
  if frame.instead then frame.instead.taken = nil end
  frame.taken, frame.instead = nil, nil
end

-- Depth first over the frames from `at` on; the newest frame has to be the last taken.
-- goal     { crc =, exchange = whether a good message's frames may be had for others like them, padding = (found),
--          taken = places of the frames that are taken so far }
-- returns  those of a whole message; nil where there is none
local function search(self, goal, at, register, needed)
  local reassembly, frames, taken = self.reassembly, self.frames, goal.taken
  local last = #frames
  while at <= last do
    local frame = frames[at]
    local length = frame.length
    if not reassembly:spend(1) then return nil end
    if at == last then
      if #frame.data < length then return nil end
      goal.padding = reassembly.can_id.padding(frame.data, length, needed)
      if not goal.padding then return nil end
      if reassembly.crc.update(register, frame.data, 1, needed) ~= goal.crc then return nil end
      taken[#taken + 1] = at
      return taken
    elseif length < needed and not frame.is_end and take(self, goal, frame) then
      taken[#taken + 1] = at
      local behind = reassembly.crc.update(register, frame.data)
      if search(self, goal, at + 1, behind, needed - length) then return taken end
      taken[#taken] = nil
      put_back(frame)
    end
    at = at + 1
  end
end

-- Whether all that came since the newest Start makes up its message.
local function all_since_start(self, goal, message)
  local reassembly, frames = self.reassembly, self.frames
  local taken, length = leftovers(self, message)
  local last = frames[#frames]
  goal.padding = reassembly.can_id.padding(last.data, last.length, message.size - length + last.length)
  if not goal.padding then return nil end
  for i = 1, #taken - 1 do
    if frames[taken[i]].is_end then return nil end
  end
  local register = reassembly:seed(message)
  for _, at in ipairs(taken) do
    local data = frames[at].data
    if #data < frames[at].length then return taken end -- all there, but not to be verified
    register = reassembly.crc.update(register, data, 1, at == #frames and #data - goal.padding or #data)
  end
  return register == goal.crc and taken or nil
end

local function by_look(a, b) return a.look < b.look end

-- The free frame takes its place in the message that had this one.
local function hand_over(self, frame)
  local owner = frame.owner
  owner[frame.index] = frame.instead
  table.sort(owner, by_look)
  for i, member in ipairs(owner) do member.owner, member.index = owner, i end
  self.reassembly.kept:exchange(frame.look, frame.instead.look)
  put_back(frame)
end

-- The frames belong to a good message with this Start.
local function own(self, start, taken)
  local owner = { [0] = { look = start } }
  for i, at in ipairs(taken) do
    local frame = self.frames[at]
    owner[i] = frame
    frame.owner, frame.index = owner, i
  end
end

-- Gives frames to a message and ends it: status when it is known, else the CRC decides.
local function award(self, message, taken, status)
  local reassembly, frames, chunks = self.reassembly, self.frames, {}
  local start = message[1]
  for i = message.count, 2, -1 do message[i] = nil end
  message.count, message.received = 1, 0
  for i, at in ipairs(taken) do
    local frame = frames[at]
    if frame.instead then hand_over(self, frame) end
    frame.taken = nil
    message.count, message[i + 1] = i + 1, frame.look
    message.received = message.received + frame.length
    if not message.truncated then chunks[i] = frame.data end
    message.truncated = message.truncated or #frame.data < frame.length
    reassembly.kept:give(frame.look, message)
  end
  reassembly:finish(message, concat(chunks):sub(1, status and -1 or message.size), frames[#frames].look, status)
  if message.status == "good" then -- else its frames may still be another's
    own(self, start, taken)
  end
end

-- What a good message left of the frames since its Start: one with the bytes of the frame before it, which the message
-- has, came twice.
local function name_repeated(self, message)
  local frames = self.frames
  for i = message.from + 1, #frames do
    local frame, before = frames[i], frames[i - 1]
    local is_after_its = before.owner and before.owner[0].look == message[1] or before.repeats == message
    if is_after_its and not frame.owner and not frame.is_end and before.data == frame.data then
      frame.repeats = message
      self.reassembly.kept:duplicate(frame.look, message)
    end
  end
end

local function remove(list, item)
  for i = 1, #list do
    if list[i] == item then return table.remove(list, i) end
  end
end

-- Which message an End completes, and with which frames: first the newest with all that came since its Start, then,
-- oldest first, whatever fits, and in the end what fits when other messages exchange frames.
-- returns  message, taken, goal; nothing when it completes none
local function find_whole(self)
  local messages, reassembly = self.messages, self.reassembly
  local goal = { crc = messages[#messages].crc }
  local all = all_since_start(self, goal, messages[#messages])
  if all then return messages[#messages], all, goal end
  for _, exchange in ipairs { false, true } do
    for _, message in ipairs(messages) do
      goal = { crc = message.crc, exchange = exchange, taken = {} }
      local taken = search(self, goal, message.from, reassembly:seed(message), message.size)
      if taken then return message, taken, goal end
    end
  end
end

-- Whether an End completes a message; that one leaves the pool.
local function complete(self)
  local message, taken, goal = find_whole(self)
  if not message then return false end
  message.padding = goal.padding > 0 and goal.padding or nil
  remove(self.messages, message)
  award(self, message, taken)
  if message.status == "good" then name_repeated(self, message) end
  return true
end

-- An End that completes nothing: it ends the newest message, as far as anyone can see.  But it may be another bus's, so
-- that message stays for what may come.
local function end_newest(self, look)
  local newest, reassembly, ended = self:newest(), self.reassembly, {}
  local is_only = #self.messages == 1
  if is_only then ended = newest end
  for key, value in pairs(newest) do ended[key] = value end
  local taken, length = leftovers(self, newest)
  local last = self.frames[#self.frames]
  local padding = reassembly.can_id.padding(last.data, last.length, newest.size - length + last.length)
  local status = not padding and reassembly:misfit(newest, length, look) or nil
  ended.padding = padding and padding > 0 and padding or nil
  newest.overtaken = newest.overtaken or 0
  if is_only then self.messages = {} end
  award(self, ended, taken, status)
  ended.is_only = is_only
end

-- More bytes than all open messages can use: none of them will come out good.
local function overflow(self, newest, look)
  local limit = MAX_WASTE
  for _, message in ipairs(self.messages) do limit = limit + message.size end
  if self.bytes <= limit then return end
  self.reassembly:misfit(newest, self.bytes, look)
  for _, message in ipairs(self.messages) do message.status = message.status or "overrun" end
  self.messages = {}
end

--- Takes a Middle or End; the reassembly's kept:entry says what it is.
-- address, frame  as Reassembly:frame has them; one that is doubtful does not end a message that it does not complete
function Pool:frame(address, frame)
  local look, newest, kept = frame.look, self:newest(), self.reassembly.kept
  local is_end = address.ctrl == self.reassembly.can_id.END
  self.frames[#self.frames + 1] = { look = look, data = frame.data, length = frame.reported, is_end = is_end }
  self.bytes = (self.bytes or 0) + frame.reported
  if is_end and complete(self) then return end
  if newest.overtaken then return kept:orphan(look, address) end
  kept.entries[look] = newest
  newest.count, newest[newest.count + 1] = newest.count + 1, look -- as far as anyone can see
  if is_end and not frame.doubtful then return end_newest(self, look) end
  overflow(self, newest, look)
end

return M
