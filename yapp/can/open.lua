-- SPDX-License-Identifier: GPL-2.0-or-later
-- The messages of one pass that have begun and not ended, by slot: the key of a message and its bus.  Pure Lua, 5.2 and
-- 5.4.
--
-- A slot holds a message or, where several of a key may be open, a pool of them (can.interleave).

local M = {}

local MAX_OPEN = 1024 -- an open message costs memory until something ends it: the oldest make room
local BUS = 0x20000000 -- keys of messages have 29 bits

local Open = {}
Open.__index = Open

--- The slot of a message.
-- address  wire.can_id.address of any of its frames; bus: number or nil
function M.slot(address, bus)
  return bus and address.key + (bus + 1) * BUS or address.key
end

--- Nothing is open.
-- It has slots, to read and to write another message, or pool, into a slot that is not empty.
function M.new()
  return setmetatable({ slots = {}, count = 0, queue = {}, queue_length = 0 }, Open)
end

--- Gives up a message, or a pool of them, that did not come out whole and that nobody will look into again.
function M.give_up(open)
  for _, message in ipairs(open.messages or { open }) do
    message.status = message.status or "cut"
    message.chunks = nil
  end
end

--- Empties a slot.
function Open:close(slot)
  self.slots[slot], self.count = nil, self.count - 1
end

-- Makes room: the queue has the slots, oldest first, and slots long closed.
local function make_room(self)
  local live, seen, queue = {}, {}, {}
  for i = self.queue_length, 1, -1 do -- a slot is as old as its newest Start
    local slot = self.queue[i]
    if self.slots[slot] and not seen[slot] then
      seen[slot] = true
      live[#live + 1] = slot
    end
  end
  local keep = math.min(#live, MAX_OPEN / 2)
  for i = #live, 1, -1 do
    local slot = live[i]
    if i <= keep then
      queue[#queue + 1] = slot
    else
      M.give_up(self.slots[slot])
      self:close(slot)
    end
  end
  self.queue, self.queue_length = queue, #queue
end

--- A message begins, in an empty slot.
function Open:enter(slot, message)
  if self.count >= MAX_OPEN or self.queue_length >= 4 * MAX_OPEN then make_room(self) end
  local length = self.queue_length + 1
  self.slots[slot], self.count = message, self.count + 1
  self.queue[length], self.queue_length = slot, length
end

--- The messages that have begun and not ended, in the order of their Starts.
function Open:unfinished()
  local list = {}
  for _, open in pairs(self.slots) do
    for _, message in ipairs(open.messages or { open }) do
      if not message.status and not message.overtaken then list[#list + 1] = message end
    end
  end
  table.sort(list, function(a, b) return a[1] < b[1] end)
  return list
end

return M
