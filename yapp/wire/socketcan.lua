-- SPDX-License-Identifier: GPL-2.0-or-later
-- The header of a CAN frame in a packet, as SocketCAN has it (linux/can.h).  Pure Lua.
--
--   80 84 40 00   08       04       00 00   ...
--   flags, id     length   options          data

local M = {}

--- Flags, in the highest byte of the id.  A data frame has none or EXTENDED.
M.EXTENDED, M.REMOTE, M.ERROR = 0x80, 0x40, 0x20
local FDF = 4 -- option of a CAN FD frame
local MAX_CLASS = 0x10000 -- of errors: Linux has ten bits
local OLD_LENGTH = 72 -- of a packet that has room for all of a CAN FD frame

local is_little = false -- true if the id is, also without the header of a cooked capture

--- Choose the order of bytes in the ids, as Wireshark's preference can.byte_swap does.
function M.choose_order(is_swapped)
  is_little = is_swapped
end

--- Read the header, which is in a packet behind that of a cooked capture if it has one: its device
-- type is 280, CAN, and then the id is little endian.
-- packet   its bytes, from the beginning of the packet
-- returns  the flags, the id, the length of the data, the options, and the second byte of the data
--          or 0; nil if it is cut
function M.read(packet)
  local offset = packet:find("^\0[\12\13]......\1\24") and 20 or
    #packet > 16 and packet:find("^\0[\0-\4]\1\24") and 16 or 0
  local a, b, c, d, length, options, _, _, _, second = packet:byte(offset + 1, offset + 10)
  if not length then return nil end
  if offset > 0 or is_little then a, b, c, d = d, c, b, a end
  local flags = a - a % M.ERROR
  local id = (a - flags) * 0x1000000 + b * 0x10000 + c * 0x100 + d
  return flags, id, length, options or 0, second or 0
end

--- Find what a packet may be that Wireshark hands to no dissector: "error", an error frame; "long",
-- a CAN FD frame without its flag, which Wireshark 4.6 refuses; nil for nothing.
function M.find_unseen(packet)
  local flags, id, length, options = M.read(packet)
  if not flags or options % (2 * FDF) >= FDF then return nil end
  if flags % (2 * M.ERROR) == M.ERROR and id < MAX_CLASS then return "error" end
  local size = #packet
  return length > 8 and size == 8 + length and size ~= OLD_LENGTH and "long" or nil
end

return M
