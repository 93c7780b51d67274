-- SPDX-License-Identifier: GPL-2.0-or-later
-- The frame of a serial stream and of Ethernet: its header and the CRC behind the payload.  Pure Lua, 5.2 and 5.4.
--
--   "YP", seq (1), ctl (1), id (4), size (2), reserved (2), payload (size), CRC (4), little endian
--   (vendor document, "UART Stream Framing").

local M = {}

local byte, char, find = string.byte, string.char, string.find

--- What a frame begins with; the bytes before and behind the payload; the length of the largest frame.
M.SYNC = "YP"
M.HEADER, M.CRC_SIZE = 12, 4
M.LARGEST = M.HEADER + 65535 + M.CRC_SIZE

local HIGHEST_ID_BYTE = 7 -- the second one of an id: they go from 0 to 2047

--- The fields of a header.
-- bytes    string; at: 1-based, where its "YP" is, which is not looked at
-- returns  id, size, reserved, seq, ctl: as they stand there, plausible or not; nil where fewer than 12 bytes are left
function M.parse(bytes, at)
  local seq, ctl, id0, id1, id2, id3, size0, size1, reserved0, reserved1 = byte(bytes, at + 2, at + 11)
  if not reserved1 then return nil end
  return id0 + id1 * 0x100 + id2 * 0x10000 + id3 * 0x1000000, size0 + size1 * 0x100, reserved0 + reserved1 * 0x100,
    seq, ctl
end

--- The CRC of a frame, as sent.
-- bytes    string; to: 1-based, the last byte of the frame
function M.crc(bytes, to)
  local a, b, c, d = byte(bytes, to - 3, to)
  return a + b * 0x100 + c * 0x10000 + d * 0x1000000
end

--- Whether a header may be one.  This runs for each "YP" in a stream, most of them in noise, so it stops early.
-- bytes    string; at: 1-based, where its "YP" is
-- accepts  function(id, size) -> boolean
-- returns  the payload size; nil when it is ruled out, by what is there; false when its end is yet to come
function M.judge(bytes, at, accepts)
  if (byte(bytes, at + 5) or 0) > HIGHEST_ID_BYTE then return nil end
  local id0, id1, id2, id3, size0, size1, reserved0, reserved1 = byte(bytes, at + 4, at + 11)
  if (id2 or 0) + (id3 or 0) + (reserved0 or 0) + (reserved1 or 0) > 0 then return nil end
  if not size1 then return false end
  local size = size0 + size1 * 0x100
  if not accepts(id0 + id1 * 0x100, size) then return nil end
  return reserved1 and size or false
end

--- Where the next "YP" is, from a 1-based place on; nil without one.
function M.find(bytes, from)
  return find(bytes, "YP", from, true)
end

local function split(value)
  local low = value % 0x100
  return low, (value - low) / 0x100
end

--- The 12 bytes of a header.
-- header   { id = 0 .. 2047, size =, seq =, ctl =, reserved = }: without the last three, 0
function M.build(header)
  local id0, id1 = split(header.id)
  local size0, size1 = split(header.size)
  local reserved0, reserved1 = split(header.reserved or 0)
  return char(0x59, 0x50, header.seq or 0, header.ctl or 0, id0, id1, 0, 0, size0, size1, reserved0, reserved1)
end

return M
