-- SPDX-License-Identifier: GPL-2.0-or-later
-- A table that makes its missing values.  Pure Lua.

--- Make a table whose value for a key is make(key), called when the key is first asked for.
-- list  gets the values in the order in which they are made; nil for none
return function(make, list)
  return setmetatable({}, { __index = function(values, key)
    local value = make(key)
    values[key] = value
    if list then list[#list + 1] = value end
    return value
  end })
end
