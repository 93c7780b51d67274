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

local M = {}

local concat = table.concat

local MAX_SUPERSEDED = 3 -- a message that more Starts than this superseded is given up
local MAX_WASTE = 4096   -- bytes in the pool beyond what its messages can use
local CREDIT_PER_FRAME, MAX_CREDIT = 32, 4096 -- steps of the search

local Pool = {}
Pool.__index = Pool

--- Make the pool of a message that is open.
-- reassembly  of can.reassembly, which notes what is wrong
-- fields      of the CAN ids (wire.can_id)
function M.new(reassembly, message, fields)
  local chunks = message.chunks
  local self = setmetatable({
    reassembly = reassembly,
    can_id = fields,
    open = {}, -- see Pool:add; oldest Start first
    frames = {}, -- see Pool:add_frame
    credit = MAX_CREDIT,
    reserve = 0, -- credit that the search must leave for other messages
  }, Pool)
  self:add(message)
  for i, data in ipairs(chunks) do self:add_frame(message[i + 1], data, #data, false) end
  self.bytes, self.since = chunks.received, chunks.received
  return self
end

--- Add a Middle or End.
-- length   on the bus
-- returns  the record of the frame
function Pool:add_frame(key, data, length, is_end)
  local frame = {
    key = key,
    data = data,
    length = length,
    is_end = is_end,
    is_taken = false, -- by a good message
    orphan = nil, -- its anomaly
  }
  table.insert(self.frames, frame)
  return frame
end

--- Open the message of a Start.
function Pool:add(message)
  message.chunks, self.since = nil, 0
  table.insert(self.open, {
    message = message,
    from = #self.frames + 1, -- index of its first frame
    age = 0, -- Starts that superseded it
    anomalies = {}, -- to be withdrawn if it turns out good
    is_retry = false, -- whether it was shown as broken already
  })
end

--- Return the open messages, oldest Start first.
function Pool:messages()
  local list = {}
  for i, candidate in ipairs(self.open) do list[i] = candidate.message end
  return list
end

-- Return how many bytes, from a frame on, no good message has taken; and the indexes of their
-- frames.
local function leftovers(self, from)
  local indexes, length = {}, 0
  for i = from, #self.frames do
    local frame = self.frames[i]
    if not frame.is_taken then
      indexes[#indexes + 1] = i
      length = length + frame.length
    end
  end
  return length, indexes
end

-- Drops the first frames, which no open message can use.
local function drop_frames(self, count)
  local rest = {}
  for i, frame in ipairs(self.frames) do
    if i > count then
      rest[i - count] = frame
    elseif frame.orphan then
      frame.orphan.is_open = false
    end
  end
  self.frames = rest
end

local function give_up(self, candidate)
  for _, anomaly in ipairs(candidate.anomalies) do anomaly.is_open = false end
  if not candidate.is_retry then self.reassembly:give_up(candidate.message) end
end

--- Note a Start: it supersedes the open messages; give up those that are too old.
-- anomaly  the one that notes this of the newest message, or nil
-- returns  whether any is left
function Pool:supersede(anomaly)
  local rest = {}
  if anomaly then
    anomaly.is_open = true
    table.insert(self.open[#self.open].anomalies, anomaly)
  end
  for _, candidate in ipairs(self.open) do
    candidate.age, candidate.message.status = candidate.age + 1, "superseded"
    if candidate.age > MAX_SUPERSEDED then
      give_up(self, candidate)
    else
      rest[#rest + 1] = candidate
    end
  end
  self.open = rest
  local before = rest[1] and rest[1].from - 1 or #self.frames
  drop_frames(self, before)
  if not rest[1] then return false end
  for _, candidate in ipairs(rest) do candidate.from = candidate.from - before end
  self.bytes = leftovers(self, 1)
  return true
end

-- Searches depth first over the frames from `at` on; the newest frame has to be the last taken.
-- goal     { crc = as sent, indexes = of the frames that are taken so far, padding = found }
-- returns  whether these are a complete message
local function search(self, goal, at, register, needed)
  local frames, indexes = self.frames, goal.indexes
  local last = #frames
  while at <= last do
    local frame = frames[at]
    self.credit = self.credit - 1
    if self.credit < self.reserve then return false end
    -- What is truncated proves nothing.
    local data, length = frame.data, frame.length
    local is_complete = #data == length
    if at == last then
      goal.padding = is_complete and can_id.padding(data, length, needed)
      indexes[#indexes + 1] = at
      return goal.padding and crc.update(register, data, 1, needed) == goal.crc
    end
    if is_complete and length < needed and not frame.is_end and not frame.is_taken then
      local count = #indexes
      indexes[count + 1] = at
      local next_register = crc.update(register, data)
      if search(self, goal, at + 1, next_register, needed - length) then return true end
      for i = #indexes, count + 1, -1 do indexes[i] = nil end
    end
    at = at + 1
  end
  return false
end

-- The padding of the newest frame if all that came since the newest Start is its message; nil if
-- not.
local function padding_since_start(self, message)
  local last = self.frames[#self.frames]
  return can_id.padding(last.data, last.length, message.size - self.since + last.length)
end

-- Return the frames since the newest Start if together they are its message.  The CRC decides;
-- where bytes are truncated, their number does.
-- returns  indexes of the frames, padding; nil where it does not
local function all_since_start(self, candidate, register)
  local padding = padding_since_start(self, candidate.message)
  if not padding then return nil end
  local _, indexes = leftovers(self, candidate.from)
  for _, index in ipairs(indexes) do
    local frame, is_last = self.frames[index], index == #self.frames
    if frame.is_end and not is_last then return nil end
    if #frame.data < frame.length then return indexes, padding end
    register = crc.update(register, frame.data, 1, #frame.data - (is_last and padding or 0))
  end
  if register == candidate.message.crc then return indexes, padding end
end

-- Which message an End completes, and with which frames: the newest with all that came since its
-- Start, else, oldest first, whatever fits.
-- returns  the index of its candidate, indexes of frames, bytes of padding; nil if it completes
-- none
local function find_complete(self)
  local open = self.open
  local function seed_of(candidate)
    return can_id.seed(self.can_id, candidate.message.size, candidate.message.reserved)
  end
  local newest = open[#open]
  local indexes, padding = all_since_start(self, newest, seed_of(newest))
  if indexes then return #open, indexes, padding end
  for i, candidate in ipairs(open) do
    -- Let each message use its share of the credit: the oldest is usually broken, and searches most
    -- frames.
    self.reserve = self.credit * (1 - 1 / (#open - i + 1))
    local goal = { crc = candidate.message.crc, indexes = {}, padding = false }
    if search(self, goal, candidate.from, seed_of(candidate), candidate.message.size) then
      return i, goal.indexes, goal.padding
    end
  end
end

-- Give frames to a message.  Return its payload, which ends with the first truncated frame, and
-- whether there is such a frame.
local function assign_frames(self, message, indexes)
  local chunks, is_truncated = {}, false
  for i = #message, 2, -1 do message[i] = nil end
  for i, index in ipairs(indexes) do
    local frame = self.frames[index]
    message[i + 1] = frame.key
    if not is_truncated then chunks[i] = frame.data end
    is_truncated = is_truncated or #frame.data < frame.length
    if frame.orphan then self.reassembly:withdraw(frame.orphan) end
  end
  return concat(chunks), is_truncated
end

-- End the message of a candidate with these frames: with a status if it is known, else the CRC
-- decides.
local function award(self, candidate, indexes, padding, status)
  local message = candidate.message
  local payload, is_truncated = assign_frames(self, message, indexes)
  if not status then payload = payload:sub(1, message.size) end
  if is_truncated then status = status or "truncated" end
  message.padding = padding ~= 0 and padding or nil
  self.reassembly:finish(message, self.can_id, payload, status)
  if message.status ~= "good" then return end -- its frames may still be another's
  for _, index in ipairs(indexes) do
    self.frames[index].is_taken = true
    self.bytes = self.bytes - self.frames[index].length
  end
  for _, anomaly in ipairs(candidate.anomalies) do self.reassembly:withdraw(anomaly) end
  local newest = self.open[#self.open]
  self.since = newest and leftovers(self, newest.from) or 0
end

-- An End that completes no message seems to end the newest.  But the End may be of another bus.  So
-- if other messages are open, a copy of the newest stays open for later frames.
local function end_newest(self)
  local candidate = table.remove(self.open)
  local message, status = candidate.message, nil
  if self.open[1] then
    local copy, since = { status = "superseded" }, self.since
    for name, value in pairs(message) do copy[name] = value end
    self:add(copy)
    self.since, self.open[#self.open].from = since, candidate.from
    self.open[#self.open].is_retry = true
  end
  local padding = padding_since_start(self, message)
  if not padding then status = self.reassembly:misfit(message, self.since) end
  local _, indexes = leftovers(self, candidate.from)
  award(self, candidate, indexes, padding, status)
end

-- Whether the pool has more bytes than all open messages can use: then none of them will be good.
local function is_full(self)
  local limit = MAX_WASTE
  for _, candidate in ipairs(self.open) do limit = limit + candidate.message.size end
  return self.bytes > limit
end

--- Take a Middle or End.
-- returns  as can.reassembly's take
function Pool:take(frame)
  local ctrl, newest, kind = frame.can_id.ctrl, self.open[#self.open].message, "fragment"
  local is_end = ctrl == can_id.END
  local pooled = self:add_frame(frame.key, frame.data, frame.reported, is_end)
  self.credit = math.min(math.max(self.credit, 0) + CREDIT_PER_FRAME, MAX_CREDIT)
  self.bytes, self.since = self.bytes + frame.reported, self.since + frame.reported
  if is_end then
    local at, indexes, padding = find_complete(self)
    if at then
      local candidate = table.remove(self.open, at)
      award(self, candidate, indexes, padding)
      return "last", candidate.message
    end
  end
  if newest.status then
    kind, pooled.orphan = "other", self.reassembly:orphan(ctrl)
    pooled.orphan.is_open = true
  else
    newest[#newest + 1] = frame.key -- as it seems
    if is_end then
      end_newest(self)
      kind = "last"
    end
  end
  if is_full(self) then
    if kind == "fragment" then self.reassembly:misfit(newest, self.bytes) end
    for _, candidate in ipairs(self.open) do give_up(self, candidate) end
    self.open = {}
    drop_frames(self, #self.frames)
  end
  return kind, kind ~= "other" and newest or nil
end

return M
