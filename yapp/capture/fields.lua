-- SPDX-License-Identifier: GPL-2.0-or-later
-- Fields of other dissectors in the current packet.  Wireshark's API.

-- Read the values of the wanted fields alone: on 4.0 the value of an item without bytes, such as a
-- packet comment, throws past Lua.
local function pick_fields(names, ok, ...)
  local found = {}
  for _, info in ipairs(ok and { ... } or {}) do
    if names[info.name] then found[info.name] = info.value end
  end
  return found
end

--- Return the wanted fields that the tree has so far; none if no tree is built.
-- names    { [filter name] = true } of the wanted fields
-- returns  { [filter name] = value }
return function(names)
  return pick_fields(names, pcall(all_field_infos))
end
