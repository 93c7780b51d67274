-- SPDX-License-Identifier: GPL-2.0-or-later
-- Messages of one key that interleave, where a capture does not tell its buses apart.  Pure Lua.
--
-- A Start that comes while a message with the same key is open may cut it off, or come from another
-- bus.  From then on the frames of that key are pooled, and an End looks for the frames that, with
-- it, make up one of the open messages: its size and its CRC decide.  Every frame that comes brings
-- some credit, which bounds the search.
--
-- A frame in the pool has look, data, length (on the bus), is_end, and is_taken once a good message
-- has it.

local can_id = require "yapp.wire.can_id"
local crc = require "yapp.wire.crc"

local M = {}

local concat = table.concat

local MAX_OVERTAKEN = 3 -- a message that more Starts than this overtook is given up
local MAX_WASTE = 4096  -- bytes in the pool beyond what its messages can use
local CREDIT_PER_FRAME, MAX_CREDIT = 32, 4096 -- steps of the search

local Pool = {}
Pool.__index = Pool

--- A pool for one key.
-- reassembly  of can.memory, which is told what becomes of frames
-- message     the one that is open
-- It has messages: those that are open, oldest first, each with from: the place of its first frame;
-- and, once it is overtaken, bytes: of the frames that nobody took.
function M.new(reassembly, message)
  local self = setmetatable({
    reassembly = reassembly,
    messages = { message },
    frames = {},
    credit = MAX_CREDIT,
    since = 0, -- bytes that came since the newest Start and that no good message has
  }, Pool)
  for i, data in ipairs(message.chunks) do
    self.frames[i] = { look = message[i + 1], data = data, length = #data }
  end
  self.since = message.chunks.received
  message.from, message.chunks = 1, nil
  return self
end

--- The message with the newest Start.
function Pool:newest()
  return self.messages[#self.messages]
end

-- How many bytes came since a message's Start that nobody else took; and the places of their
-- frames.
local function leftovers(self, message)
  local places, length = {}, 0
  for i = message.from, #self.frames do
    local frame = self.frames[i]
    if not frame.is_taken then
      places[#places + 1] = i
      length = length + frame.length
    end
  end
  return length, places
end

--- How many bytes have come since the newest Start.
function Pool:received()
  return self.since
end

--- A Start came: the open messages are overtaken, and too old ones given up.
-- returns  whether any is left; without one the key is an ordinary one again
function Pool:overtake()
  local rest = {}
  for _, message in ipairs(self.messages) do
    message.overtaken = (message.overtaken or 0) + 1
    if message.overtaken > MAX_OVERTAKEN then
      message.status = "cut"
    else
      rest[#rest + 1] = message
    end
  end
  self.messages = rest
  if not rest[1] then return false end
  -- What lies before the oldest message is nobody's any more.
  local before, frames = rest[1].from - 1, {}
  for i = before + 1, #self.frames do frames[i - before] = self.frames[i] end
  self.frames = frames
  for _, message in ipairs(rest) do message.from = message.from - before end
  self.bytes = leftovers(self, rest[1])
  return true
end

--- The message that a Start opens.
function Pool:add(message)
  message.from, message.chunks = #self.frames + 1, nil
  self.messages[#self.messages + 1] = message
  self.since = 0
end

-- Depth first over the frames from `at` on; the newest frame has to be the last taken.
-- goal     { crc = as sent, places = of the frames that are taken so far, padding = found }
-- returns  whether these are a whole message
local function search(self, goal, at, register, needed)
  local frames, places = self.frames, goal.places
  local last = #frames
  while at <= last do
    local frame = frames[at]
    self.credit = self.credit - 1
    if self.credit < self.reserve then return false end
    -- What the capture cut proves nothing.
    local data, length = frame.data, frame.length
    local is_whole = #data == length
    if at == last then
      goal.padding = is_whole and can_id.padding(data, length, needed)
      places[#places + 1] = at
      return goal.padding and crc.update(register, data, 1, needed) == goal.crc
    end
    if is_whole and length < needed and not frame.is_end and not frame.is_taken then
      local count = #places
      places[count + 1] = at
      local next_register = crc.update(register, data)
      if search(self, goal, at + 1, next_register, needed - length) then return true end
      for i = #places, count + 1, -1 do places[i] = nil end
    end
    at = at + 1
  end
  return false
end

-- Whether all that came since the newest Start makes up its message; where bytes were not captured,
-- by their number.
local function all_since_start(self, message, seed)
  local frames = self.frames
  local last = frames[#frames]
  local padding = can_id.padding(last.data, last.length, message.size - self.since + last.length)
  if not padding then return nil end
  local _, places = leftovers(self, message)
  local register = seed
  for _, at in ipairs(places) do
    local frame = frames[at]
    if frame.is_end and frame ~= last then return nil end
    if #frame.data < frame.length then return places, padding end
    local count = frame == last and #frame.data - padding or #frame.data
    register = crc.update(register, frame.data, 1, count)
  end
  if register == message.crc then return places, padding end
end

local function seed_of(message)
  return can_id.seed(message.address, message.size, message.reserved)
end

-- Which message an End completes, and with which frames: the newest with all that came since its
-- Start, else, oldest first, whatever fits.
-- returns  its place among the open ones, places of frames, bytes of padding; nothing when it
--          completes none
local function find_whole(self)
  local messages, newest = self.messages, self:newest()
  local places, padding = all_since_start(self, newest, seed_of(newest))
  if places then return #messages, places, padding end
  for i, message in ipairs(messages) do
    -- The oldest is broken as a rule, and searched among most frames: each may use its share.
    self.reserve = self.credit * (1 - 1 / (#messages - i + 1))
    local goal = { crc = message.crc, places = {} }
    if search(self, goal, message.from, seed_of(message), message.size) then
      return i, goal.places, goal.padding
    end
  end
end

-- Gives frames to a message; returns its bytes, as far as they were captured, and whether they were
-- not.
local function give(self, message, places)
  local reassembly, chunks, is_cut = self.reassembly, {}, false
  for i = #message, 2, -1 do message[i] = nil end
  for i, at in ipairs(places) do
    local frame = self.frames[at]
    message[i + 1] = frame.look
    if not is_cut then chunks[i] = frame.data end
    is_cut = is_cut or #frame.data < frame.length
    if reassembly.entries[frame.look] then reassembly.entries[frame.look] = message end
    reassembly:take_back(frame.look, function(fault) return fault.expert == "fragment.orphan" end)
  end
  return concat(chunks), is_cut
end

-- Gives frames to a message and ends it: with a status when it is known, else the CRC decides.
-- returns  the message
local function award(self, message, places, padding, status)
  local reassembly, frames = self.reassembly, self.frames
  local payload, is_cut = give(self, message, places)
  if not status then payload = payload:sub(1, message.size) end
  if is_cut then status = status or "unverified" end
  message.padding = padding and padding > 0 and padding or nil
  reassembly:finish(message, payload, frames[#frames].look, status)
  if message.status ~= "good" then return message end -- its frames may still be another's
  for _, at in ipairs(places) do
    frames[at].is_taken = true
    self.bytes = self.bytes - frames[at].length
  end
  for _, look in ipairs(message.blamed or {}) do
    reassembly:take_back(look, function(fault) return fault.message == message end)
  end
  message.blamed = nil
  self.since = self.messages[1] and leftovers(self, self:newest()) or 0
  return message
end

-- An End that completes nothing ends the newest message, as far as anyone can see.  But it may be
-- another bus's, so where others are open that message stays for what may come.
-- returns  what ended
local function end_newest(self, look)
  local message = self:newest()
  local length, places = leftovers(self, message)
  local last, ended = self.frames[#self.frames], message
  if #self.messages == 1 then
    self.messages = {}
  else
    ended = {}
    for key, value in pairs(message) do ended[key] = value end
    message.overtaken = message.overtaken or 0
  end
  local padding = can_id.padding(last.data, last.length, message.size - length + last.length)
  local status = not padding and self.reassembly:misfit(ended, length, look) or nil
  return award(self, ended, places, padding, status)
end

-- More bytes than all open messages can use: none of them will come out good.
local function is_full(self)
  local limit = MAX_WASTE
  for _, message in ipairs(self.messages) do limit = limit + message.size end
  return self.bytes > limit
end

--- Takes a Middle or End.
-- returns  its entry
function Pool:frame(frame, look)
  local newest, reassembly = self:newest(), self.reassembly
  local is_end, is_over = frame.address.ctrl == can_id.END, newest.overtaken
  self.credit = math.min(math.max(self.credit, 0) + CREDIT_PER_FRAME, MAX_CREDIT)
  self.frames[#self.frames + 1] = { look = look, data = frame.data, length = frame.reported,
    is_end = is_end }
  self.bytes, self.since = self.bytes + frame.reported, self.since + frame.reported
  if is_end then
    local place, places, padding = find_whole(self)
    if place then
      return award(self, table.remove(self.messages, place), places, padding)
    end
  end
  local is_last = is_end and not is_over
  if not is_over then newest[#newest + 1] = look end -- as far as anyone can see
  local ended = is_last and end_newest(self, look)
  if is_full(self) then
    if not is_over and not is_last then reassembly:misfit(newest, self.bytes, look) end
    for _, message in ipairs(self.messages) do message.status = message.status or "overrun" end
    self.messages = {}
  end
  if is_over then return reassembly:orphan(frame.address, newest.source, look) end
  return ended or newest
end

return M
