-- SPDX-License-Identifier: GPL-2.0-or-later
-- Recognises datagrams of MAVLink, which often share a UDP conversation with YAPP.  They may come
-- between the datagrams that a bridge cuts a frame over.  Pure Lua.
--
--   FE length seq system component message payload CRC                      version 1
--   FD length flags 0 seq system component message (3) payload CRC          version 2
--   flags: 1 = a signature of 13 bytes behind the CRC; no system has the number 0

local M = {}

local byte = string.byte

local V1, V2 = 0xFE, 0xFD
local V1_LENGTH, V2_LENGTH, SIGNATURE = 8, 12, 13 -- without the payload

-- Return the length of the MAVLink packet at an index; nil if there is none.
local function length_at(bytes, index)
  local magic, length, flags, fourth, _, system = byte(bytes, index, index + 5)
  if not system then return nil end
  if magic == V1 and fourth > 0 then return V1_LENGTH + length end -- it is the system
  local is_v2 = magic == V2 and flags <= 1 and fourth == 0 and system > 0
  return is_v2 and V2_LENGTH + length + flags * SIGNATURE or nil
end

--- Return whether bytes are whole MAVLink packets.
function M.is_whole(bytes)
  local index = 1
  while index <= #bytes do
    local length = length_at(bytes, index)
    if not length then return false end
    index = index + length
  end
  return index == #bytes + 1 and index > 1
end

return M
