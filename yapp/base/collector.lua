-- SPDX-License-Identifier: GPL-2.0-or-later
-- The pace of Lua's garbage collector in a long capture.  Pure Lua, 5.2 and 5.4.
--
-- Left to itself Lua lets garbage grow as large as what is in use, before it looks for it.  Each item of a tree leaves
-- objects with a finalizer, and Lua goes over such several times until they are free: once they are more than the
-- processor's cache holds, that takes longer than to make them.  So, while a capture of ours is read, it starts early
-- and does not dawdle: a tree takes a third less time.  Earlier still, and to go over what is in use costs more than is
-- saved.  Where other scripts keep much, and for captures without YAPP, Lua has its own pace.

local M = {}

local PAUSE = 150 -- percent of what is in use, to start at
local STEP = 1000 -- percent of the speed at which new objects come
local OTHERS = 16 * 1024 -- KiB that may be in use besides what is packed, and as much again as that is

local ours = 0 -- bytes that are packed
local before -- { pause, step } of others, while ours are set

-- COMPAT: a later Lua may know neither; then nothing is set.
local function set(pause, step)
  local is_known, old_pause = pcall(collectgarbage, "setpause", pause)
  local _, old_step = pcall(collectgarbage, "setstepmul", step)
  return is_known and { old_pause, old_step } or nil
end

local function take(is_ours)
  if is_ours and not before then
    before = set(PAUSE, STEP)
  elseif before and not is_ours then
    set(before[1], before[2])
    before = nil
  end
end

--- To be called before each file: Lua's own pace again, nothing is packed.
function M.reset()
  take(false)
  ours = 0
end

--- To be called with the bytes of each text that is kept to the end of the capture.
function M.packed(bytes)
  ours = ours + bytes
  take(collectgarbage("count") - 2 * ours / 1024 <= OTHERS)
end

return M
