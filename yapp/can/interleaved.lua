-- SPDX-License-Identifier: GPL-2.0-or-later
-- Messages of one slot that are open at the same time.  Pure Lua.
--
-- A Start may come while a message is open: the message lost its End, the recorder holds the Start
-- twice, or the frames are of two buses that nothing tells apart.  A message may also have more
-- bytes than its size, as frames of it came twice.  In each case the CRC decides which Middles
-- belong to an End:
--
--   a1 b1 a2 b2 a3 b3 bE   Starts a1 and b1: a1 with any of a2 b2 a3 b3 and bE is not good,
--                          b1 with b2 b3 bE is

local can_id = require "yapp.wire.can_id"
local crc = require "yapp.wire.crc"

local M = {}

local MAX_STEPS = 500 -- of the search of one message at one End
local MAX_WASTE = 4096 -- bytes beyond those that the open messages can use

local Group = {}
Group.__index = Group

--- Make the group of a message that is open.
-- fields      of the CAN ids (wire.can_id)
-- message     with chunks, see can.reassembly
-- has_others  true if another Start came: else each frame is of the message, or came twice
function M.new(fields, message, has_others)
  local self = setmetatable({
    fields = fields,
    has_others = has_others,
    messages = { message }, -- open ones, oldest Start first
    frames = {}, -- { key, data, is_end, is_repeated, from = number of bytes before it }
    bytes = 0, -- of the frames
    end_count = 0, -- of the frames: how many are Ends
    steps = 0, -- that the search may still take; may_skip, see find_frames
    may_skip = false,
  }, Group)
  for i, data in ipairs(message.chunks) do self:add_frame(message[i + 1], data, false) end
  message.chunks = nil
  return self
end

--- Add a Middle or End.
function Group:add_frame(key, data, is_end)
  local frames = self.frames
  local before = frames[#frames]
  frames[#frames + 1] = {
    key = key,
    data = data,
    is_end = is_end,
    is_repeated = before ~= nil and before.data == data, -- it equals the frame before it
    from = self.bytes,
  }
  self.bytes = self.bytes + #data
  if is_end then self.end_count = self.end_count + 1 end
end

--- Return whether there are more bytes than the open messages can use.
function Group:is_full()
  local limit = MAX_WASTE
  for _, message in ipairs(self.messages) do limit = limit + message.size end
  return self.bytes > limit
end

-- Keep these frames alone.
local function set_frames(self, frames)
  self.frames, self.bytes, self.end_count = frames, 0, 0
  for _, frame in ipairs(frames) do
    frame.from, self.bytes = self.bytes, self.bytes + #frame.data
    if frame.is_end then self.end_count = self.end_count + 1 end
  end
end

--- Remove the oldest message.
-- returns  the message, the frames between its Start and the next one that is open, and the number
--          of their bytes
function Group:remove_oldest()
  local message, own, rest, bytes = table.remove(self.messages, 1), {}, {}, self.bytes
  local next_key = self.messages[1] and self.messages[1][1] or math.huge
  for _, frame in ipairs(self.frames) do
    local list = frame.key < next_key and own or rest
    list[#list + 1] = frame
  end
  set_frames(self, rest)
  return message, own, bytes - self.bytes
end

-- Search depth first for frames that, with the newest one, are the rest of a message.
-- taken     the frames that are taken so far
-- first     index of the first frame that may be the next
-- register  of the CRC behind those that are taken
-- needed    bytes of the message behind them
-- returns   number of bytes of padding; nil if no frames fit
local function search(self, message, taken, first, register, needed)
  local frames, depth, failed = self.frames, #taken + 1, nil
  for i = first, #frames do
    local frame = frames[i]
    local data = frame.data
    self.steps = self.steps - 1
    if self.steps < 0 or self.bytes - frame.from < needed then return nil end
    local padding = nil
    taken[depth] = frame
    if i == #frames then
      padding = can_id.padding(data, #data, needed)
      if padding and crc.update(register, data, 1, needed) ~= message.crc then padding = nil end
    elseif #data < needed and not frame.is_end and data ~= failed then
      local next_register = crc.update(register, data)
      padding = search(self, message, taken, i + 1, next_register, needed - #data)
      failed = data
    end
    if padding then return padding end
    taken[depth] = nil
    if not (self.may_skip or frame.is_repeated) then return nil end
  end
end

-- Remove a good message and its frames.
-- returns  the frames in front of all Starts that are still open
local function remove_good(self, index, taken)
  local is_taken, front, rest = {}, {}, {}
  table.remove(self.messages, index)
  local oldest = self.messages[1]
  for _, frame in ipairs(taken) do is_taken[frame] = true end
  for _, frame in ipairs(self.frames) do
    if not is_taken[frame] then
      local list = oldest and frame.key >= oldest[1] and rest or front
      list[#list + 1] = frame
    end
  end
  set_frames(self, rest)
  return front
end

-- Search for the frames of a message.
-- may_skip  false if frames may be left out only where they came twice
-- returns   the frames and the bytes of padding; nil if no frames fit
local function find_frames(self, message, may_skip)
  local taken, first = {}, 1
  while self.frames[first].key < message[1] do first = first + 1 end
  self.steps, self.may_skip = MAX_STEPS, may_skip
  local seed = can_id.seed(self.fields, message.size, message.reserved)
  local padding = search(self, message, taken, first, seed, message.size)
  if padding then return taken, padding end
end

--- Find the message that the newest frame, an End, completes: the newest one with all frames since
-- its Start, else the oldest one that has a good CRC.  It overtakes those with an earlier Start.
-- returns  the message, its frames, the bytes of padding, and the frames that no message can have
--          any more; nil if the End completes none
function Group:complete()
  local messages = self.messages
  local index = #messages
  local taken, padding = find_frames(self, messages[index], false)
  for i = 1, self.has_others and not taken and #messages or 0 do
    if not taken then index, taken, padding = i, find_frames(self, messages[i], true) end
  end
  if not taken then return nil end
  local message = messages[index]
  for i = 1, index - 1 do messages[i].is_overtaken = true end
  return message, taken, padding, remove_good(self, index, taken)
end

return M
