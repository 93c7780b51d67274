-- SPDX-License-Identifier: GPL-2.0-or-later
-- Fields of other dissectors in the current packet.  Wireshark's API.

local input = require "yapp.base.input"

-- Read the values of the wanted fields alone: on 4.0 the value of an item without bytes, such as a
-- packet comment, throws past Lua.
local function pick_fields(names, ok, ...)
  local found = {}
  for _, info in ipairs(ok and { ... } or {}) do
    if names[info.name] then found[info.name] = info.value end
  end
  return found
end

--- Make a reader of fields.
-- text     their filter names
-- returns  function() -> { [filter name] = value } of those that the tree has so far; none if no
--          tree is built
return function(text)
  local names = input.set(text)
  return function() return pick_fields(names, pcall(all_field_infos)) end
end
