-- SPDX-License-Identifier: GPL-2.0-or-later
-- What a call costs beside quadratic work on the same machine at the same moment: a loaded machine slows both.
if not arg then return end -- run by Wireshark, see run.lua

local M = {}

local function cpu_seconds(call)
  collectgarbage() -- what was made before is not collected in this call
  local start = os.clock()
  call()
  return os.clock() - start
end

--- Return whether a call costs an eighth of a pattern's search that is tried from each of 4,000 characters to the last.
-- Three attempts, as a collection of garbage may fall into one.
function M.is_quadratic(call)
  local spaces = (" "):rep(4000)
  for _ = 1, 3 do
    local seconds = cpu_seconds(call)
    if seconds < 0.001 or seconds < cpu_seconds(function() return spaces:find(" *x") end) / 8 then return false end
  end
  return true
end

--- Return whether a call costs less than 8 times as much at four times the size, where quadratic work costs 16 times.
-- Ten attempts, as a loaded machine can make a single one look quadratic; work that is fails them all.
-- call  function(size)
function M.is_linear(call, size)
  for _ = 1, 10 do
    local least = cpu_seconds(function() call(size) end)
    if cpu_seconds(function() call(4 * size) end) < 8 * least then return true end
  end
  return false
end

return M
