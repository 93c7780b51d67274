-- SPDX-License-Identifier: GPL-2.0-or-later
-- The CAN ids in SocketCAN's table: it calls YAPP for these alone, so other frames cost nothing.
-- Wireshark's API.

local can_id = require "yapp.wire.can_id"
local input = require "yapp.base.input"

local Ids = {}
Ids.__index = Ids

-- Behind so many unknown IDs, the next ones whose first messages are more than AHEAD apart wait for
-- Seq No 0.
local MANY, AHEAD = 64, 15
local ID, CTRL = 2 ^ 18, 2 ^ 14 -- one more of these in a CAN id

--- Make the ids.  The Starts with Seq No 0 of all IDs are registered: so begin unknown messages
-- that are not numbered.
-- proto  Proto that SocketCAN calls
function Ids.new(proto)
  local dissectors = DissectorTable.get("can.extended_id")
  for id = 0, input.MAX_ID do dissectors:add(id * ID + can_id.START * CTRL, proto) end
  return setmetatable({
    proto = proto,
    dissectors = dissectors,
    registered = {}, -- [ID] = true for all of it, or a set of the Seq Nos of an unknown one, with
    -- has_all = true if all its Starts are registered
    unknown = 0, -- number of these
  }, Ids)
end

-- Register the CAN ids of a CAN CTRL of an ID, from a Seq No to another, with YAPP CTL 0.
local function register(self, id, ctrl, first, last)
  local low = id * ID + ctrl * CTRL
  self.dissectors:add(("%d-%d"):format(low + first, low + last), self.proto)
end

--- Register the CAN ids of an ID that carries a message type.
function Ids:register_id(id)
  if self.registered[id] == true then return end
  self.registered[id] = true
  for ctrl = 0, can_id.END do register(self, id, ctrl, 0, 0xFF) end
end

--- Register those of an unknown ID, of which a Start with a Seq No came: its Starts, and the other
-- fragments with this Seq No.  All of them of each of 2,000 IDs take longer than the rest of a run.
-- Nothing tells its single frames from those of others.
function Ids:register_start(id, seq)
  local seqs = self.registered[id]
  if seqs == true or seqs and seqs[seq] then return end
  if not seqs then
    self.unknown = self.unknown + 1
    seqs = { has_all = self.unknown <= MANY }
    self.registered[id] = seqs
    register(self, id, can_id.START, 0, seqs.has_all and 0xFF or AHEAD)
  elseif not seqs.has_all then
    seqs.has_all = true
    register(self, id, can_id.START, 0, 0xFF)
  end
  seqs[seq] = true
  for ctrl = can_id.MIDDLE, can_id.END do register(self, id, ctrl, seq, seq) end
end

return Ids
