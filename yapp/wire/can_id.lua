-- SPDX-License-Identifier: GPL-2.0-or-later
-- YAPP's use of a CAN frame: the 29-bit id, CAN FD padding, the header that the CRC covers ("CAN
-- Framing"). Pure Lua, 5.2 and 5.4.

local crc = require "yapp.wire.crc" -- its tables take half a millisecond

local M = {}

local char, floor = string.char, math.floor

--- A slot is a number for the message key of CAN ids and their bus: message_key + bus * M.BUS.
M.BUS = 0x20000000

-- CAN CTRL; 0 is a single frame.
M.START, M.MIDDLE, M.END = 1, 2, 3
M.CTRL_NAMES = { [0] = "Single", "Start", "Middle", "End" }

-- The lengths of CAN FD frames above 8 bytes: SHORTER[12] = 8 is the next shorter one.
local SHORTER, shorter = {}, 8
for _, length in ipairs { 12, 16, 20, 24, 32, 48, 64 } do
  SHORTER[length], shorter = shorter, length
end

local function split(fields_of, id)
  local ctrl = floor(id / 0x4000) % 0x10
  local fields = {
    id = floor(id / 0x40000),
    ctrl = ctrl,
    ctl = floor(id / 0x100) % 0x40,
    seq = floor(id % 0x100),
    message_key = id - ctrl * 0x4000,
  }
  fields_of[id] = fields
  return fields
end

--- The fields of a 29-bit CAN id ("CAN Message IDs"): fields[id], for 0 .. 0x1FFFFFFF, is
--   { id = Msg ID, ctrl = CAN CTRL, ctl = YAPP CTL, seq = Seq No, message_key = that of all frames
--   of a message share: the id without CAN CTRL }
-- The same id usually gets the same table, which only M.seed writes to.  The cache is weak: a bus
-- has few ids, but a hostile capture may have any number.
M.fields = setmetatable({}, { __mode = "v", __index = split })

--- Return how many bytes of CAN FD padding the last or only frame of a message has.
-- data    its captured bytes; reported: its length on the bus; needed: bytes that the message still
--         lacks
-- returns 0 if it fits exactly, the number of zero bytes if it is padded as CAN FD is, else nil
function M.padding(data, reported, needed)
  if reported == needed then return 0 end
  local least = SHORTER[reported]
  if least and needed > least and needed < reported and not data:find("[^%z]", needed + 1) then
    return reported - needed
  end
end

--- Return the payload size of a single frame whose message has `least` to `most` bytes: the largest
-- size that fits.  If 9 to 17 bytes are allowed, a frame of 12 bytes has a payload of 12, though it
-- may be 9 and padding; a frame of 20 bytes has 17 and padding.
-- data, reported  as for M.padding
-- returns         number; nil when it does not fit
function M.single_size(data, reported, least, most)
  if reported >= least and reported <= most then return reported end
  return M.padding(data, reported, most) and most
end

local function two_bytes(number)
  return char(number % 0x100, floor(number / 0x100))
end

--- The 12 bytes that the CRC covers before the payload ("Computing the UART and Ethernet Frame IDs
-- from the CAN ID").
-- fields    { id, seq, ctl }
-- size      of the payload; reserved: number, 0 when left out
function M.header(fields, size, reserved)
  return "YP" .. char(fields.seq, fields.ctl) .. two_bytes(fields.id) .. "\0\0" ..
    two_bytes(size) .. two_bytes(reserved or 0)
end

--- Return the CRC register behind that header.  The fields cache it, as seed and seed_size, for the
-- next message of the same id and size.
function M.seed(fields, size, reserved)
  if fields.seed_size == size and not reserved then return fields.seed end
  local seed = crc.of(M.header(fields, size, reserved))
  if not reserved then fields.seed, fields.seed_size = seed, size end
  return seed
end

--- Return the CRC of a message.
-- fields, reserved  as for M.header
function M.crc(fields, payload, reserved)
  return crc.update(M.seed(fields, #payload, reserved), payload, 1, #payload)
end

--- Read a Start ("Multi-Frame Start").
-- data     its captured bytes
-- returns  crc, size, reserved; each nil where its bytes are not there
function M.start(data)
  local a, b, c, d, e, f, g, h = data:byte(1, 8)
  return d and a + b * 0x100 + c * 0x10000 + d * 0x1000000, f and e + f * 0x100, h and g + h * 0x100
end

return M
