-- SPDX-License-Identifier: GPL-2.0-or-later
-- What a call costs, for tests that tell linear work from quadratic: a factor of a hundred at these sizes.
if not arg then return end -- run by Wireshark, see run.lua

local M = {}

--- Return the CPU seconds of a call, the least of several: a collection of garbage may fall into one.
function M.seconds(call)
  local least = math.huge
  for _ = 1, 4 do
    local start = os.clock()
    call()
    least = math.min(least, os.clock() - start)
    if least < 0.001 then break end
  end
  return least
end

return M
