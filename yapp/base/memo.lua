-- SPDX-License-Identifier: GPL-2.0-or-later
-- A table that makes its missing values.  Pure Lua.

local function new_table() return {} end

--- Make a table whose value for a key is make(key), called when the key is first asked for.
-- make  nil for an empty table as the value of each key
-- list  gets the values in the order in which they are made; nil for none
return function(make, list)
  make = make or new_table
  return setmetatable({}, { __index = function(values, key)
    local value = make(key)
    values[key] = value
    if list then list[#list + 1] = value end
    return value
  end })
end
