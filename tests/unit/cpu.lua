-- SPDX-License-Identifier: GPL-2.0-or-later
-- What a call costs beside quadratic work on the same machine at the same moment: a loaded machine slows both.
if not arg then return end -- run by Wireshark, see run.lua

local M = {}

local function cpu_seconds(call)
  local start = os.clock()
  call()
  return os.clock() - start
end

local function cpu_seconds_without_garbage(call)
  collectgarbage() -- what was made before is not collected in this call
  return cpu_seconds(call)
end

local SPACES = (" "):rep(2000)
local function search() return SPACES:find(" *x") end
local least = cpu_seconds(search) -- what it took at best: a slower moment gives a call no less time

--- Return whether a call costs half of a pattern's search that is tried from each of 2,000 characters to the last.
-- Three attempts, as a collection of garbage may fall into one.
function M.is_quadratic(call)
  if cpu_seconds(call) < math.max(0.001, least / 2) then return false end
  for _ = 1, 3 do
    local seconds = cpu_seconds_without_garbage(call)
    local of_search = cpu_seconds(search)
    least = math.min(least, of_search)
    if seconds < math.max(0.001, of_search / 2) then return false end
  end
  return true
end
assert(M.is_quadratic(search), "cpu: the search itself is not seen as quadratic")

return M
