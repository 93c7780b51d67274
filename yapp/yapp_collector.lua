-- SPDX-License-Identifier: GPL-2.0-or-later
-- The pace of Lua's garbage collector in a long capture.  Pure Lua, 5.2 and 5.4.
--
-- Left to itself Lua lets garbage grow as large as what is in use, before it looks for it.  Each item of a tree leaves
-- objects with a finalizer, and Lua goes over such several times until they are free: once they are more than the
-- processor's cache holds, that takes longer than to make them.  So, while a capture of ours is read, it starts early
-- and does not dawdle: a tree takes a third less time.
-- To go over what is in use more often costs next to nothing while that is little; after a million frames it starts
-- less early.  Where other scripts keep much, and for captures without YAPP, Lua has its own pace.

local M = {}

local EARLY, LATER = 110, 150 -- start when so many percent of what is in use are reached
local SMALL = 16 * 1024 -- KiB in use, for early
local STEP = 1000 -- percent of the speed at which new objects come
local OTHERS = 16 * 1024 -- KiB that may be in use besides what is packed, and as much again as that is

local ours = 0 -- bytes that are packed
local before -- { pause, step } of others, while ours are set
local current -- our pause, nil while there is none

-- COMPAT: a later Lua may know neither; then nothing is set.
local function set(pause, step)
  local is_known, old_pause = pcall(collectgarbage, "setpause", pause)
  local _, old_step = pcall(collectgarbage, "setstepmul", step)
  return is_known and { old_pause, old_step } or nil
end

local function take(pause)
  if pause == current then return end
  if pause then
    local found = set(pause, STEP)
    before = before or found
  elseif before then
    set(before[1], before[2])
    before = nil
  end
  current = pause
end

--- To be called before each file: Lua's own pace again, nothing is packed.
function M.reset()
  take(nil)
  ours = 0
end

--- To be called with the bytes of each text that is kept to the end of the capture.
function M.packed(bytes)
  ours = ours + bytes
  local in_use = collectgarbage("count")
  take(in_use - 2 * ours / 1024 <= OTHERS and (in_use <= SMALL and EARLY or LATER) or nil)
end

return M
