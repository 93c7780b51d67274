-- SPDX-License-Identifier: GPL-2.0-or-later
-- The 29-bit id, CAN FD padding, and the header that the CRC covers.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local can = require("yapp.wire.can_id")

local T = {}

function T.test_fields_of_an_id()
  local fields = can.fields[0x0840C2FF]
  lu.assertEquals({ fields.id, can.CTRL_NAMES[fields.ctrl], fields.ctl, fields.seq }, { 0x210, "End", 2, 255 })
  lu.assertEquals(can.CTRL_NAMES[can.fields[0].ctrl], "Single")
  lu.assertIs(can.fields[0x0840C2FF], fields)
end

function T.test_what_a_start_says()
  local data = "\1\2\3\4\5\6\7\8"
  lu.assertEquals({ can.start(data) }, { 0x04030201, 0x0605, 0x0807 })
  for length, count in pairs { [3] = 0, [4] = 1, [5] = 1, [6] = 2, [7] = 2 } do
    local sum, size, reserved = can.start(data:sub(1, length))
    lu.assertEquals({ sum ~= nil, size ~= nil, reserved ~= nil }, { count >= 1, count >= 2, false }, length)
  end
end

local function bytes(count, zeros) return ("x"):rep(count) .. ("\0"):rep(zeros or 0) end

function T.test_the_size_of_a_single_frame()
  for _, row in ipairs { -- data, reported, least, most, size
    { bytes(7), 7, 7, 7, 7 }, { bytes(8), 8, 7, 7, nil }, { bytes(6), 6, 7, 7, nil },
    { bytes(17, 3), 20, 17, 17, 17 }, { bytes(20), 20, 17, 17, nil },
    { bytes(9, 3), 12, 9, 16, 12 }, { bytes(16), 16, 9, 16, 16 },
    { bytes(8), 8, 9, 16, nil }, { bytes(14, 6), 20, 9, 17, 17 },
    { bytes(16, 4), 20, 9, 16, nil }, -- 16 bytes need no padding
  } do
    lu.assertEquals(can.single_size(row[1], row[2], row[3], row[4]), row[5],
      ("%d for %d to %d"):format(row[2], row[3], row[4]))
  end
end

function T.test_padding()
  for _, row in ipairs { -- data, reported, needed, padding
    { bytes(8, 0), 8, 8, 0 },
    { bytes(1, 0), 1, 1, 0 },
    { bytes(64, 0), 64, 64, 0 },
    { bytes(9, 3), 12, 9, 3 },
    { bytes(17, 3), 20, 17, 3 },
    { bytes(33, 15), 48, 33, 15 },
    { bytes(49, 15), 64, 49, 15 },
    { bytes(7, 1), 8, 7, nil },     -- 7 bytes need no padding
    { bytes(9, 7), 16, 9, nil },    -- 12 would have done
    { bytes(10, 0) .. "\0x", 12, 10, nil }, { bytes(10, 0) .. "x\0", 12, 10, nil }, -- not zeros
    { bytes(12, 0), 12, 13, nil },  -- too few
    { bytes(0, 12), 12, 0, nil },   -- nothing is missing
    { bytes(0, 12), 12, -4, nil },
    { bytes(64, 0), 64, 65, nil },
    { bytes(9, 1), 12, 9, 3 },      -- two of the zeros were not captured
    { bytes(4, 0), 12, 9, 3 },
  } do
    lu.assertEquals(can.padding(row[1], row[2], row[3]), row[4], ("%d for %d"):format(row[2], row[3]))
  end
end

return T
