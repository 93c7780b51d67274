-- SPDX-License-Identifier: GPL-2.0-or-later
-- Adding items to a tree, as functions: a method that Lua has to look up in an item costs a third
-- of what adding a
-- field does.  Wireshark's API.

local M = {}

local abs, floor = math.abs, math.floor
local add, set_generated = TreeItem.add, TreeItem.set_generated

-- As in Wireshark's API: the item first, or the Tvb.
M.add, M.add_le, M.set_generated = add, TreeItem.add_le, set_generated
M.append_text = TreeItem.append_text
M.set_hidden, M.set_text, M.range = TreeItem.set_hidden, TreeItem.set_text, Tvb.range
M.referenced = TreeItem.referenced

--- Adds what no bytes of the packet say.
-- pf       ProtoField, or a text
-- returns  the item
function M.add_generated(item, pf, value)
  return set_generated(add(item, pf, value))
end

--- Seconds, a double, as a time to the nanosecond.
function M.relative_time(seconds)
  local size = abs(seconds)
  local whole = floor(size)
  local rest = floor((size - whole) * 1e9 + 0.5)
  if rest == 1e9 then whole, rest = whole + 1, 0 end
  if seconds < 0 then whole, rest = -whole, -rest end
  return NSTime.new(whole, rest)
end

return M
