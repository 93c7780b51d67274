-- SPDX-License-Identifier: GPL-2.0-or-later
-- Messages of one key that interleave, where a capture does not tell its buses apart.  Pure Lua.
--
-- A Start that comes while a message with the same key is open may supersede it, or come from
-- another bus.  From then on the frames of that key are pooled.  An End looks for the frames that,
-- with it, make up one of the open messages: its size and its CRC decide.  Each frame adds credit,
-- which limits the steps of the search.  If the pool has more bytes than its open messages can use,
-- all of them are given up.

local can_id = require "yapp.wire.can_id"
local crc = require "yapp.wire.crc"
local frame_key = require "yapp.base.frame_key"

local M = {}

local MAX_SUPERSEDED = 3 -- a message that more Starts than this superseded is given up
local MAX_WASTE = 4096   -- bytes in the pool beyond what its messages can use
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

-- Open a message.
local function open_message(self, message, is_retry)
  message.chunks = nil
  table.insert(self.open, {
    message = message,
    start = self.starts, -- of the pool when it was opened
    anomaly = nil, -- what said that it is superseded: withdrawn if it turns out good
    is_retry = is_retry, -- whether its last fragment was shown as that of a broken message
    is_copy = false, -- whether a good message has the same Start
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
  open_message(self, message, false)
  return self
end

--- Open the message of a Start.
function Pool:open_message(message)
  open_message(self, message, false)
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

-- Give up copies of good messages that came too long ago to end yet: each search would try them.
-- time  of the newest frame
local function give_up_copies(self, time)
  local open = {}
  for _, candidate in ipairs(self.open) do
    if candidate.is_copy and not self.reassembly:is_near(candidate.message.time, time) then
      give_up(self, candidate)
    else
      open[#open + 1] = candidate
    end
  end
  self.open = open
end

--- Note a Start: it supersedes the open messages; give up those that are too old.
-- anomaly  the one that notes this of the newest message, or nil
-- time     of the Start
-- returns  whether any is left
function Pool:supersede(anomaly, time)
  local open = self.open
  local newest = open[#open]
  newest.message.status = "superseded"
  if anomaly then newest.anomaly, anomaly.is_open = anomaly, true end
  self.starts = self.starts + 1
  if self.starts - open[1].start > MAX_SUPERSEDED then give_up(self, table.remove(open, 1)) end
  give_up_copies(self, time)
  drop_frames(self)
  return self.open[1] ~= nil
end

-- Search depth first over the frames from `first` on; the newest frame has to be the last taken.  If
-- no Start superseded another, leave out only frames that equal the one before.
-- goal     { crc = as sent, frames = those that are taken so far, padding = found }
-- needed   bytes that the message still lacks; spare = those of the frames beyond these
-- returns  whether these are a complete message
local function search(self, goal, first, register, needed, spare)
  local last, count = #self.frames, #goal.frames
  for i = first, last do
    local frame = self.frames[i]
    local data, length = frame.data, frame.length
    self.credit = self.credit - 1
    if self.credit < self.reserve then return false end
    goal.frames[count + 1] = frame
    -- What is truncated proves nothing.
    local is_complete = #data == length
    if i == last then
      goal.padding = is_complete and can_id.padding(data, length, needed)
      return goal.padding and crc.update(register, data, 1, needed) == goal.crc
    end
    if is_complete and length < needed and not frame.is_end and
      search(self, goal, i + 1, crc.update(register, data), needed - length, spare) then
      return true
    end
    for k = #goal.frames, count + 1, -1 do goal.frames[k] = nil end
    local before = self.frames[i - 1]
    if self.starts == 0 and not (before and before.data == data) then return false end
    spare = spare - length
    if spare < 0 then return false end
  end
end

-- The padding of the newest frame if all that came since the newest Start is its message; nil if
-- not.
local function padding_since_start(self, message)
  local last = self.frames[#self.frames]
  local needed = message.size - self:received(message) + last.length
  return can_id.padding(last.data, last.length, needed)
end

local function frames_behind(self, message)
  local list = {}
  for i = first_behind(self, message), #self.frames do list[#list + 1] = self.frames[i] end
  return list
end

-- Return the frames since the newest Start if together they are its message.  The CRC decides;
-- where bytes are truncated, their number does.
-- register  CRC register in front of the payload
-- returns   list of frames, padding; nil where it does not
local function all_since_start(self, message, register)
  local padding = padding_since_start(self, message)
  if not padding then return nil end
  local frames = frames_behind(self, message)
  for i, frame in ipairs(frames) do
    local is_last = i == #frames
    if frame.is_end and not is_last then return nil end
    if #frame.data < frame.length then return frames, padding end
    register = crc.update(register, frame.data, 1, #frame.data - (is_last and padding or 0))
  end
  if register == message.crc then return frames, padding end
end

-- Give frames to a message.  Return its payload, which ends with the first truncated frame, and
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
      candidate.is_copy, other.status = true, "superseded"
    end
  end
end

-- Note the frames that a message was good without.
local function note_duplicates(self)
  local original
  for _, frame in ipairs(self.frames) do
    if frame.is_taken then
      original = frame
    else
      self.reassembly:note_duplicate(frame.key, original.key)
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
    if self.starts == 0 then note_duplicates(self) end
  end
  drop_frames(self)
  return message
end

-- End the message that an End completes: the newest with all frames that came since its Start,
-- else, oldest first, whichever fits.
-- returns  the message; nil if it completes none
local function complete(self)
  local open = self.open
  local function seed_of(message)
    return can_id.seed(self.can_id, message.size, message.reserved)
  end
  local newest = open[#open].message
  local frames, padding = all_since_start(self, newest, seed_of(newest))
  if frames then return finish_candidate(self, #open, frames, padding) end
  for i, candidate in ipairs(open) do
    local message, before = candidate.message, open[i - 1]
    -- Let each message use its share of the credit: the oldest is usually broken, and searches most
    -- frames.
    self.reserve = self.credit * (1 - 1 / (#open - i + 1))
    local goal = { crc = message.crc, frames = {}, padding = false }
    local first, size = first_behind(self, message), message.size
    -- What does not complete a message completes no copy of it either.
    if not (before and have_same_start(before.message, message)) and
      search(self, goal, first, seed_of(message), size, self:received(message) - size) then
      return finish_candidate(self, i, goal.frames, goal.padding)
    end
  end
end

-- An End that completes no message seems to end the newest.  But the End may be of another bus.  So
-- if other messages are open, a copy of the newest stays open for later frames.
local function end_newest(self)
  local index, status = #self.open, nil
  local message = self.open[index].message
  if index > 1 then
    local copy = { status = "superseded" }
    for name, value in pairs(message) do copy[name] = value end
    open_message(self, copy, true)
  end
  local padding = padding_since_start(self, message)
  if not padding then status = self.reassembly:misfit(message, self:received(message)) end
  finish_candidate(self, index, frames_behind(self, message), padding, status)
end

-- Whether the pool has more bytes than all open messages can use: then none of them will be good.
local function is_full(self)
  local limit = MAX_WASTE
  for _, candidate in ipairs(self.open) do limit = limit + candidate.message.size end
  return self.bytes > limit
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
    kind, pooled.orphan = "other", self.reassembly:orphan(frame)
    pooled.orphan.is_open = true
  else
    newest[#newest + 1], newest.time = frame.key, frame.time -- as it seems
    if is_end then
      end_newest(self)
      kind = "last"
    end
  end
  if is_full(self) then
    if kind == "fragment" then self.reassembly:misfit(newest, self.bytes) end
    for _, candidate in ipairs(self.open) do give_up(self, candidate) end
    self.open = {}
    drop_frames(self)
  end
  return kind, kind ~= "other" and newest or nil
end

return M
