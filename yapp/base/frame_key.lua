-- SPDX-License-Identifier: GPL-2.0-or-later
-- The frame key: one number for a frame, by which it is known when Wireshark dissects it again.
-- Pure
-- Lua.
--
-- It is the packet's number and, in the lowest 17 bits, the offset of the frame's bytes in the
-- packet,
-- as a packet may have several frames.  Keys ascend in the order of the capture.

local M = {}

local floor, huge = math.floor, math.huge

--- What the number of a packet is multiplied by.
M.PACKET = 0x20000

--- Return the number of the packet of a frame key.
function M.number(key)
  return floor(key / 0x20000)
end

--- Return the index of the last of ascending numbers that is not above a limit, 0 for none.
-- guess  an index that it may be, or nil
function M.last_until(numbers, limit, guess)
  local low, high, guessed = 0, #numbers, numbers[guess or 0]
  if guessed and guessed <= limit and limit < (numbers[guess + 1] or huge) then return guess end
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
