-- SPDX-License-Identifier: GPL-2.0-or-later
-- The frames of a slot that do not make up its message in the usual way.  Pure Lua.
--
-- They are pooled
--   when a Start comes while a message is open: it may supersede that, or come from another bus;
--   when a message is too long, but has frames that came twice.
-- An End looks for the frames that, with it, make up one of the open messages: its size and its CRC
-- decide.  Each frame adds credit, which limits the steps of the search.  If the pool has more
-- bytes than its open messages can use, all of them are given up.

local can_id = require "yapp.wire.can_id"
local crc = require "yapp.wire.crc"
local frame_key = require "yapp.base.frame_key"

local M = {}

local MAX_SUPERSEDED = 3 -- a message that more Starts than this superseded is given up
local MAX_WASTE = 4096   -- bytes in the pool beyond those that its messages can use
local CREDIT_PER_FRAME, MAX_CREDIT = 32, 4096 -- steps of the search

local Pool = {}
Pool.__index = Pool

-- Withdraw an anomaly: a later frame has proved that nothing is wrong.
local function withdraw(anomaly)
  anomaly.is_withdrawn, anomaly.is_open = true, false
end

-- Add a Middle or End.
local function add_frame(self, frame)
  table.insert(self.frames, frame)
  table.insert(self.keys, frame.key)
  frame.from, self.bytes = self.bytes, self.bytes + frame.length
end

local function new_frame(key, data, length, is_end)
  return {
    key = key,
    data = data,
    length = length, -- on the bus
    from = 0, -- number of bytes of the frames before it
    is_end = is_end,
    is_taken = false, -- by a good message
    orphan = nil, -- its anomaly
  }
end

--- Open the message of a Start.
-- is_retry  true if its last fragment was shown as that of a broken message
function Pool:open_message(message, is_retry)
  message.chunks = nil
  table.insert(self.open, {
    message = message,
    start = self.starts, -- of the pool when it was opened
    anomaly = nil, -- that it is superseded: withdrawn if it turns out good
    is_retry = is_retry,
  })
end

--- Make the pool of a message that is open.
-- reassembly  a can.reassembly, which gets the anomalies
-- fields      of the CAN ids (wire.can_id)
function M.new(reassembly, message, fields)
  local self = setmetatable({
    reassembly = reassembly,
    can_id = fields,
    open = {}, -- see open_message; oldest Start first
    frames = {}, -- see new_frame: those that no good message has taken
    keys = {}, -- of the frames
    bytes = 0, -- of the frames
    time = 0, -- of the newest frame
    starts = 0, -- number of Starts that superseded others
    credit = MAX_CREDIT,
    reserve = 0, -- credit to leave for other messages: of 400, with 4 open, the first may use 100
  }, Pool)
  for i, data in ipairs(message.chunks) do
    add_frame(self, new_frame(message[i + 1], data, #data, false))
  end
  self:open_message(message)
  return self
end

--- Return the open messages, oldest Start first.
function Pool:messages()
  local list = {}
  for i, candidate in ipairs(self.open) do list[i] = candidate.message end
  return list
end

-- Return the index of the first frame behind a Start.
local function first_behind(self, message)
  return frame_key.last_until(self.keys, message[1]) + 1
end

--- Return the number of bytes that came since the Start of a message.
function Pool:received(message)
  local frame = self.frames[first_behind(self, message)]
  return frame and self.bytes - frame.from or 0
end

-- Drop the frames that a good message has taken, and those in front of all open messages.
local function drop_frames(self)
  local frames, oldest = self.frames, self.open[1]
  local first = oldest and first_behind(self, oldest.message) or #frames + 1
  self.frames, self.keys, self.bytes = {}, {}, 0
  for i, frame in ipairs(frames) do
    if i >= first and not frame.is_taken then
      add_frame(self, frame)
    elseif frame.orphan then
      frame.orphan.is_open = false
    end
  end
end

local function give_up(self, candidate)
  if candidate.anomaly then candidate.anomaly.is_open = false end
  if not candidate.is_retry then self.reassembly:give_up(candidate.message) end
end

--- Supersede the open messages by a new Start; give up the messages that are too old.
-- anomaly  that of the newest message, or nil
-- returns  true if any is left
function Pool:supersede(anomaly)
  local open = self.open
  local newest = open[#open]
  newest.message.status = "superseded"
  if anomaly then newest.anomaly, anomaly.is_open = anomaly, true end
  self.starts = self.starts + 1
  if self.starts - open[1].start > MAX_SUPERSEDED then give_up(self, table.remove(open, 1)) end
  drop_frames(self)
  return self.open[1] ~= nil
end

-- Return whether the newest frame ends the message that the frames of a goal begin.  The CRC
-- decides; where bytes are truncated, it needs all frames.
-- needed  bytes that the frame should have
local function is_end_of(goal, frame, register, needed)
  local data, length = frame.data, frame.length
  goal.padding = can_id.padding(data, length, needed)
  if not goal.padding then return false end
  if not register or #data < length then return goal.takes_all end
  return crc.update(register, data, 1, needed) == goal.crc
end

-- Return whether a message may do without a frame: if no Start superseded another, without one
-- that came twice.
local function may_leave_out(self, goal, index)
  local before = self.frames[index - 1]
  local is_repeated = before and before.data == self.frames[index].data
  return not goal.takes_all and (self.starts > 0 or is_repeated)
end

-- Search depth first over the frames from `first` on; the newest frame has to be the last taken.
-- goal      { crc = as sent, frames = those that are taken so far, takes_all = true if none may be
--           left out, padding = found }
-- register  of the CRC; false behind a truncated frame
-- returns   true if these are a complete message
local function search(self, goal, first, register, needed)
  local last, count = #self.frames, #goal.frames
  for i = first, last do
    local frame = self.frames[i]
    local data, length = frame.data, frame.length
    self.credit = self.credit - 1
    if self.credit < self.reserve or self.bytes - frame.from < needed then return false end
    goal.frames[count + 1] = frame
    if i == last then return is_end_of(goal, frame, register, needed) end
    if length < needed and not frame.is_end then
      local next_register = register and #data == length and crc.update(register, data)
      if search(self, goal, i + 1, next_register, needed - length) then return true end
    end
    for k = #goal.frames, count + 1, -1 do goal.frames[k] = nil end
    if not may_leave_out(self, goal, i) then return false end
  end
end

-- Assign frames to a message.  Return its payload, which ends with the first truncated frame, and
-- whether there is such a frame.
local function assign_frames(message, frames)
  local chunks, is_truncated = {}, false
  for i = #message, 2, -1 do message[i] = nil end
  for i, frame in ipairs(frames) do
    message[i + 1] = frame.key
    if not is_truncated then chunks[i] = frame.data end
    is_truncated = is_truncated or #frame.data < frame.length
    if frame.orphan then withdraw(frame.orphan) end
  end
  return table.concat(chunks), is_truncated
end

local function have_same_start(a, b)
  return a.crc == b.crc and a.size == b.size
end

-- A recorder may hold the Start of a good message twice: it opened others, which are not lost.
local function forgive_copies(self, message)
  for _, candidate in ipairs(self.open) do
    local other = candidate.message
    if have_same_start(other, message) and self.reassembly:is_near(message.time, other.time) then
      other.status = "superseded"
    end
  end
end

-- Keep the duplicates: frames that a message was good without.
local function keep_duplicates(self)
  local original
  for _, frame in ipairs(self.frames) do
    if frame.is_taken then
      original = frame
    else
      self.reassembly:keep_duplicate(frame.key, self.can_id.message_key, original.key)
    end
  end
end

-- End an open message with these frames: with a status if it is known, else the CRC decides.
-- index    of its candidate
-- returns  the message
local function finish_candidate(self, index, frames, padding, status)
  local candidate = table.remove(self.open, index)
  local message = candidate.message
  message.time = self.time
  local payload, is_truncated = assign_frames(message, frames)
  if is_truncated then status = status or "truncated" end
  self.reassembly:finish(message, self.can_id, payload, padding, status)
  if message.status == "good" then -- else its frames may still be another's
    for _, frame in ipairs(frames) do frame.is_taken = true end
    if candidate.anomaly then withdraw(candidate.anomaly) end
    forgive_copies(self, message)
    if self.starts == 0 then keep_duplicates(self) end
  end
  drop_frames(self)
  return message
end

-- End the message that an End completes: the newest with all frames that came since its Start,
-- else, oldest first, whichever fits.
-- returns  the message; nil if it completes none
local function complete(self)
  local open = self.open
  for k = 0, #open do
    local i = k == 0 and #open or k
    local message, before = open[i].message, open[k - 1]
    local first, size = first_behind(self, message), message.size
    local goal = { crc = message.crc, frames = {}, takes_all = k == 0 }
    -- Let each message use its share of the credit: the oldest is usually broken, and searches most
    -- frames.
    self.reserve = self.credit * (1 - 1 / (#open - k + 1))
    local seed = can_id.seed(self.can_id, size, message.reserved)
    -- Frames that do not complete a message complete no copy of it either.
    if not (before and have_same_start(before.message, message)) and
      search(self, goal, first, seed, size) then
      return finish_candidate(self, i, goal.frames, goal.padding)
    end
  end
end

-- An End that completes no message seems to end the newest.  But the End may be of another bus.  So
-- if other messages are open, a copy of the newest stays open for later frames.
local function end_newest(self, last)
  local index, frames, status = #self.open, {}, nil
  local message = self.open[index].message
  if index > 1 then
    local copy = { status = "superseded" }
    for name, value in pairs(message) do copy[name] = value end
    self:open_message(copy, true)
  end
  local received = self:received(message)
  local padding = can_id.padding(last.data, last.length, message.size - received + last.length)
  if not padding then status = self.reassembly:add_misfit(message, received) end
  for i = first_behind(self, message), #self.frames do frames[#frames + 1] = self.frames[i] end
  finish_candidate(self, index, frames, padding, status)
end

-- Return whether the pool has more bytes than all open messages can use: then none of them will be
-- good.
local function is_full(self)
  local limit = MAX_WASTE
  for _, candidate in ipairs(self.open) do limit = limit + candidate.message.size end
  return self.bytes > limit
end

--- Forget the newest packet, see frame_key.forget.
-- key    of a frame of the next packet
-- other  a message in which the store forgets it
function Pool:forget(key, other)
  local number = frame_key.number(key)
  frame_key.forget(self.keys, number)
  for i, frame in ipairs(self.frames) do frame.key = self.keys[i] end
  for _, candidate in ipairs(self.open) do
    if candidate.message ~= other then frame_key.forget(candidate.message, number) end
  end
end

--- Add a Middle or End.
-- returns  as Reassembly:add
function Pool:add_fragment(frame)
  local newest, kind = self.open[#self.open].message, "fragment"
  local is_end = frame.can_id.ctrl == can_id.END
  local pooled = new_frame(frame.key, frame.data, frame.reported, is_end)
  add_frame(self, pooled)
  self.time = frame.time
  self.credit = math.min(math.max(self.credit, 0) + CREDIT_PER_FRAME, MAX_CREDIT)
  local completed = is_end and complete(self)
  if completed then return "last", completed end
  if newest.status then
    kind, pooled.orphan = "other", self.reassembly:add_orphan(frame)
    pooled.orphan.is_open = true
  else
    newest[#newest + 1], newest.time = frame.key, frame.time -- as it seems
    if is_end then
      end_newest(self, pooled)
      kind = "last"
    end
  end
  if is_full(self) then
    if kind == "fragment" then self.reassembly:add_misfit(newest, self.bytes) end
    for _, candidate in ipairs(self.open) do give_up(self, candidate) end
    self.open = {}
    drop_frames(self)
  end
  return kind, kind ~= "other" and newest or nil
end

return M
