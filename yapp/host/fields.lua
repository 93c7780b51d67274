-- SPDX-License-Identifier: GPL-2.0-or-later
-- The values of other protocols' fields in the current packet, if it has a tree.  Wireshark's API.

local M = {}

-- Read the values of the wanted fields alone: on 4.0 the value of an item without bytes, such as a
-- packet comment, throws past Lua.
local function by_name(names, ok, ...)
  local found = {}
  for _, info in ipairs(ok and { ... } or {}) do
    if names[info.name] then found[info.name] = info.value end
  end
  return found
end

--- Return the wanted fields that the tree has so far; none if no tree is built.
-- names    { [filter name] = true } of the wanted fields
-- returns  { [filter name] = value }
function M.of(names)
  return by_name(names, pcall(all_field_infos))
end

return M
