-- SPDX-License-Identifier: GPL-2.0-or-later
-- A list made from another one.  Pure Lua.

--- Return a new list of what a function makes of each item of a list; an item of which it makes nil
-- or false is left out.
-- make  function(item)
return function(list, make)
  local made = {}
  for _, item in ipairs(list) do made[#made + 1] = make(item) or nil end
  return made
end
