-- SPDX-License-Identifier: GPL-2.0-or-later
-- The frame of a serial stream and of Ethernet: its header and the CRC behind the payload.  Pure
-- Lua.
--
--   "YP", seq (1), ctl (1), id (4), size (2), reserved (2), payload (size), CRC (4), little endian
--   (vendor document, "UART Stream Framing").

local M = {}

local byte = string.byte

--- The first bytes of a frame; the sizes of header, CRC and the largest frame.
M.SYNC = "YP"
M.HEADER, M.CRC_SIZE = 12, 4
M.LARGEST = M.HEADER + 65535 + M.CRC_SIZE

--- The fields of a header.
-- bytes    string
-- from     1-based index of its "YP", which is not checked
-- returns  id, size, reserved, seq, ctl: as they stand there, plausible or not; nil where fewer
--          than 12 bytes are left
function M.parse(bytes, from)
  local seq, ctl, id0, id1, id2, id3, size0, size1, rest0, rest1 = byte(bytes, from + 2, from + 11)
  if not rest1 then return nil end
  local id = id0 + id1 * 0x100 + id2 * 0x10000 + id3 * 0x1000000
  return id, size0 + size1 * 0x100, rest0 + rest1 * 0x100, seq, ctl
end

--- The CRC of a frame, as sent.
-- bytes    string; to: 1-based, the last byte of the frame
function M.crc(bytes, to)
  local a, b, c, d = byte(bytes, to - 3, to)
  return a + b * 0x100 + c * 0x10000 + d * 0x1000000
end

--- Return whether the bytes that came of the header at a "YP" are as the document has them.
-- bytes, from  as for M.parse
function M.may_be_header(bytes, from)
  local id1, id2, id3, _, _, rest0, rest1 = byte(bytes, from + 5, from + 11)
  return (id1 or 0) <= 7 and (id2 or 0) + (id3 or 0) + (rest0 or 0) + (rest1 or 0) == 0
end

--- Return the index of the next "YP" from a 1-based index on; nil without one.
function M.find(bytes, from)
  return bytes:find("YP", from, true)
end

--- Return the index of the next header from a 1-based index on that is as the document has it; nil
-- without one.  Zeros are none: Command, the message with the ID 0, has a size.
function M.find_header(bytes, from)
  local index = M.find(bytes, from)
  while index do
    local id, size = M.parse(bytes, index)
    if id and id + size > 0 and M.may_be_header(bytes, index) then return index end
    index = M.find(bytes, index + 1)
  end
end

return M
