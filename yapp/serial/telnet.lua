-- SPDX-License-Identifier: GPL-2.0-or-later
-- Telnet (RFC 854, RFC 2217), as serial servers speak it: takes out what it adds to the bytes of
-- the line.  Pure Lua.

local M = {}

local byte, find, sub = string.byte, string.find, string.sub

local IAC = "\255" -- begins a command
local SUBNEGOTIATION, SUBNEGOTIATION_END = 250, IAC .. "\240" -- commands; others above have 3 bytes

--- A byte 0xFF of the line.
M.TWICE = IAC .. IAC

-- Return the index behind the command at an index, nil if its end has not come.
local function find_end(bytes, index)
  local command = byte(bytes, index + 1)
  if not command then return nil end
  if command == SUBNEGOTIATION then
    local _, last = find(bytes, SUBNEGOTIATION_END, index + 2, true)
    return last and last + 1
  end
  local stop = index + (command > SUBNEGOTIATION and command < 255 and 3 or 2)
  return stop <= #bytes + 1 and stop or nil
end

--- Return the bytes of the line: 0xFF once, and no commands; and the rest, which may go on with
-- later bytes.
function M.decode(bytes)
  local parts, index = {}, 1
  local mark = find(bytes, IAC, index, true)
  while mark do
    parts[#parts + 1] = sub(bytes, index, mark - 1)
    local stop = find_end(bytes, mark)
    if not stop then return table.concat(parts), sub(bytes, mark) end
    if byte(bytes, mark + 1) == 255 then parts[#parts + 1] = IAC end
    index = stop
    mark = find(bytes, IAC, index, true)
  end
  return table.concat(parts) .. sub(bytes, index), ""
end

return M
