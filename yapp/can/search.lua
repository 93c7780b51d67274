-- SPDX-License-Identifier: GPL-2.0-or-later
-- The frames of a message among others of its slot: the CRC decides.  Pure Lua.
--
--   a1 b1 a2 b2 a3 b3 bE   Starts a1 and b1: a1 with any of a2 b2 a3 b3 and bE is not good,
--                          b1 with b2 b3 bE is

local can_id = require "yapp.wire.can_id"
local crc = require "yapp.wire.crc"

local MAX_STEPS = 500

-- Take the newest frame; return the bytes of padding, nil if it is not the rest.
-- taken, register, needed  see take
local function take_last(transfer, taken, register, needed)
  local chunks = transfer.chunks
  local data = chunks[#chunks]
  local padding = can_id.padding(data, #data, needed)
  if not padding or crc.update(register, data, 1, needed) ~= transfer.crc then return nil end
  taken[#taken + 1] = #chunks
  return padding
end

--- Search depth first for the frames that, with the newest one, an End, are the rest of a message.
-- transfer  that is open, see can.reassembly; the End is its last frame
-- fields    of the CAN ids (wire.can_id)
-- may_skip  false if frames may be left out only where they came twice: each equals the one before
-- returns   a list of their indexes in transfer.chunks, and the bytes of padding; nil for none
return function(transfer, fields, may_skip)
  local chunks, taken, steps = transfer.chunks, {}, MAX_STEPS
  local ends = chunks.ends or {}

  -- Take frames from the index `first` on.
  -- register  of the CRC behind those that are taken
  -- needed    bytes of the message behind them; left: bytes of the frames that may be taken
  local function take(first, register, needed, left)
    local depth, failed = #taken + 1, nil
    for i = first, #chunks - 1 do
      local data, may_take = chunks[i], not ends[transfer[i + 1]]
      steps = steps - 1
      if steps < 0 or left < needed then return nil end
      if may_take and #data < needed and data ~= failed then
        taken[depth] = i
        local padding = take(i + 1, crc.update(register, data), needed - #data, left - #data)
        if padding then return padding end
        taken[depth], failed = nil, data
      end
      if not (may_skip or data == chunks[i - 1]) then return nil end
      left = left - #data
    end
    return take_last(transfer, taken, register, needed)
  end

  local padding = take(1, can_id.seed(fields, transfer.size, transfer.reserved), transfer.size,
    chunks.received)
  if padding then return taken, padding end
end
