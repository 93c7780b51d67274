-- SPDX-License-Identifier: GPL-2.0-or-later
-- The CAN ids in SocketCAN's table: it calls YAPP for these alone, so other frames cost nothing.
-- Wireshark's API.

local can_id = require "yapp.wire.can_id"

local M = {}

local START, MIDDLE, END = can_id.START, can_id.MIDDLE, can_id.END
local MAX_ID = 2047
-- All 1,024 CAN ids of each of 2,000 unknown IDs take three times as long as 40,000 frames.  So of
-- the first MAX_WHOLE IDs a Start registers all Starts, of more IDs the next AHEAD ones: if the
-- capture lacks more than MIN_AHEAD messages in a row, the rest of the 256 is not decoded, and
-- counts as missing.
local MAX_WHOLE, MIN_AHEAD, AHEAD = 64, 16, 32

local Ids = {}
Ids.__index = Ids

--- Make the ids.  The Starts with Seq No 0 of all IDs are registered: so begin unknown messages
-- that are not numbered.
-- proto  Proto that SocketCAN calls
function M.new(proto)
  local dissectors = DissectorTable.get("can.extended_id")
  for id = 0, MAX_ID do dissectors:add(id * 0x40000 + START * 0x4000, proto) end
  return setmetatable({
    proto = proto,
    dissectors = dissectors,
    known = {}, -- [ID that carries a message type] = true
    starts = {}, -- [unknown ID] = { last = Seq No of its last Start, [Seq No that came] = true }
    unknown_count = 0,
  }, Ids)
end

-- Register the CAN ids of a CAN CTRL with some Seq Nos, and YAPP CTL 0.
local function register(self, id, ctrl, first_seq, last_seq)
  local first = id * 0x40000 + ctrl * 0x4000
  self.dissectors:add(("%d-%d"):format(first + first_seq, first + last_seq), self.proto)
end

--- Register the CAN ids of an ID that carries a message type.
function Ids:register_id(id)
  if self.known[id] then return end
  self.known[id] = true
  for ctrl = 0, 3 do register(self, id, ctrl, 0, 0xFF) end
end

--- Register those of an unknown ID, of which a Start with a Seq No came.
function Ids:register_start(id, seq)
  local starts = self.starts[id]
  if self.known[id] or starts and starts[seq] then return end
  if not starts then
    starts = { last = 0 }
    self.starts[id], self.unknown_count = starts, self.unknown_count + 1
  end
  starts[seq] = true
  for ctrl = MIDDLE, END do register(self, id, ctrl, seq, seq) end -- it has no single frames
  if starts.last >= math.min(seq + MIN_AHEAD, 0xFF) then return end
  local first = starts.last + 1
  starts.last = self.unknown_count <= MAX_WHOLE and 0xFF or math.min(seq + AHEAD, 0xFF)
  register(self, id, START, first, starts.last)
end

return M
