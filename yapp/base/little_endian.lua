-- SPDX-License-Identifier: GPL-2.0-or-later
-- Numbers in bytes.  Pure Lua.

--- Return the number of some bytes, the lowest first; exact up to six bytes.
-- index  of the first one, 1-based
return function(bytes, index, count)
  local number = 0
  for i = index + count - 1, index, -1 do number = number * 0x100 + bytes:byte(i) end
  return number
end
