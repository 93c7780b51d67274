-- SPDX-License-Identifier: GPL-2.0-or-later
-- The CAN ids in SocketCAN's table: it calls YAPP for these alone, so other frames cost nothing.
-- Wireshark's API.

local can_id = require "yapp.wire.can_id"

local M = {}

local MAX_ID = 2047
local ID, CTRL = 2 ^ 18, 2 ^ 14 -- one more of these in a CAN id

local Ids = {}
Ids.__index = Ids

--- Make the ids.  The Starts with Seq No 0 of all IDs are registered: so begin unknown messages
-- that are not numbered.
-- proto  Proto that SocketCAN calls
function M.new(proto)
  local dissectors = DissectorTable.get("can.extended_id")
  for id = 0, MAX_ID do dissectors:add(id * ID + can_id.START * CTRL, proto) end
  return setmetatable({
    proto = proto,
    dissectors = dissectors,
    registered = {}, -- [ID] = the lowest CAN CTRL that is registered
  }, Ids)
end

--- Register the CAN ids of an ID, from a CAN CTRL on, with all Seq Nos and YAPP CTL 0.
-- first  0, a single frame, for an ID that carries a message type; START for an unknown one, of
--        which a Start came: nothing tells its single frames from those of others
function Ids:register(id, first)
  local before = self.registered[id] or can_id.END + 1
  for ctrl = first, before - 1 do
    local low = id * ID + ctrl * CTRL
    self.dissectors:add(("%d-%d"):format(low, low + 0xFF), self.proto)
  end
  self.registered[id] = math.min(first, before)
end

return M
