-- SPDX-License-Identifier: GPL-2.0-or-later
-- What fields of other protocols say of the current packet, if there is a tree.  Wireshark's
-- API.

local M = {}

-- On 4.0 the value of an item without bytes, such as a packet comment, throws past Lua: only what
-- is wanted is asked for its value.
local function by_name(names, ok, ...)
  local found = {}
  for _, info in ipairs(ok and { ... } or {}) do
    if names[info.name] then found[info.name] = info.value end
  end
  return found
end

--- The fields that are there so far; none on a pass that builds no tree.
-- names    { [filter name] = true } of those that are wanted
-- returns  { [filter name] = value }
function M.of(names)
  return by_name(names, pcall(all_field_infos))
end

return M
