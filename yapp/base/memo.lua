-- SPDX-License-Identifier: GPL-2.0-or-later
-- A table that makes what it lacks.  Pure Lua.

--- Make a table whose value for a key is make(key), called when the key is first asked for.
return function(make)
  return setmetatable({}, { __index = function(values, key)
    local value = make(key)
    values[key] = value
    return value
  end })
end
