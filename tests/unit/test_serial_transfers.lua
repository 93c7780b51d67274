-- SPDX-License-Identifier: GPL-2.0-or-later
-- From a finding to a transfer.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local generator = require("stream_generator")
local transfers = require("yapp.serial.transfers")

local T = {}

local little_endian = generator.little_endian
local PAYLOAD = "abcdefgh"
local HEAD = "YP\7\0" .. little_endian(0x210, 4) .. little_endian(#PAYLOAD, 2)
local FRAME = generator.sealed(HEAD .. "\0\0" .. PAYLOAD)
local RESERVED = generator.sealed(HEAD .. "\1\2" .. PAYLOAD)
local BAD = FRAME:sub(1, -5) .. little_endian(0x01020304, 4)

-- The transfer of the bytes behind three others, and what is wrong with it.
local function transfer_of(bytes, status, missing)
  local finding = { status = status, offset = 3, from = 100, to = 100 + #bytes, missing = missing }
  local transfer, id, seq, anomalies = transfers.new(finding, "..." .. bytes .. "behind it")
  local list = {}
  for i, one in ipairs(anomalies or {}) do list[i] = one.expert .. ": " .. one.text end
  lu.assertEquals({ id, seq, transfer.status, transfer.size, transfer.offset, transfer.length, transfer.missing },
    { 0x210, 7, status, 8, 3, #bytes, missing })
  return transfer, anomalies and table.concat(list, "; ")
end

function T.test_of_a_frame()
  local transfer, wrong = transfer_of(FRAME, "good")
  lu.assertEquals({ transfer.payload, transfer.reserved, transfer.crc, wrong }, { PAYLOAD, 0, nil, false })
  transfer, wrong = transfer_of(BAD, "bad")
  lu.assertEquals({ transfer.payload, transfer.crc, little_endian(transfer.calculated, 4), wrong },
    { PAYLOAD, 0x01020304, FRAME:sub(-4), false })
  transfer, wrong = transfer_of(RESERVED, "good")
  lu.assertEquals({ transfer.payload, transfer.reserved, wrong },
    { PAYLOAD, 0x0201, "reserved.nonzero: The reserved bytes are 0x0201, not 0" })
end

function T.test_of_a_frame_that_lacks_bytes()
  local transfer, wrong = transfer_of(FRAME:sub(1, 15), "incomplete", 9)
  lu.assertEquals({ transfer.payload, wrong }, { "abc", "fragment.incomplete: 9 of the frame's 24 bytes are missing" })
  transfer, wrong = transfer_of(RESERVED:sub(1, 21), "truncated", 3)
  lu.assertEquals({ transfer.payload, wrong }, { PAYLOAD, "truncated: 3 of the frame's 24 bytes are missing; " ..
    "reserved.nonzero: The reserved bytes are 0x0201, not 0" })
end

-- Telnet doubles bytes: what the packet has of the frame is longer.  Then it lies in bytes of its own.
function T.test_of_a_frame_in_telnet()
  local transfer, id = transfers.new({ status = "bad", is_telnet = true, bytes = BAD, from = 0, to = #BAD + 5 }, BAD)
  lu.assertEquals({ id, transfer.offset, transfer.length, transfer.payload, transfer.crc, transfer.bytes },
    { 0x210, 0, #BAD, PAYLOAD, 0x01020304, BAD })
end

return T
