-- SPDX-License-Identifier: GPL-2.0-or-later
-- The frame key: one number that identifies a frame, also when Wireshark revisits it.  Pure Lua.
--
-- It is the packet's number times 2^17 plus the offset of the frame's bytes in the packet, as a
-- packet may have several frames.  Keys ascend in the order of the capture.

local M = {}

local floor = math.floor

--- The factor of the packet's number in a key.
M.PACKET = 0x20000

--- Return the number of the packet of a frame key.
function M.number(key)
  return floor(key / 0x20000)
end

--- Return the index of the last number <= limit in an ascending list, 0 for none: 2 for { 3, 5, 9 }
-- and 8.
function M.last_until(numbers, limit)
  local low, high = 0, #numbers
  while low < high do
    local middle = floor((low + high + 1) / 2)
    if numbers[middle] <= limit then
      low = middle
    else
      high = middle - 1
    end
  end
  return low
end

return M
