-- SPDX-License-Identifier: GPL-2.0-or-later
-- Several lists as one.  Pure Lua.

--- Return a new list of the items of all these lists, but for those that are false.
return function(...)
  local joint = {}
  for _, list in ipairs { ... } do
    for _, item in ipairs(list) do joint[#joint + 1] = item or nil end
  end
  return joint
end
