-- SPDX-License-Identifier: GPL-2.0-or-later
-- The header of a serial frame: read, judged.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local frame = require("yapp.wire.frame")

local MOTOR = "YP\0\0\16\2\0\0\32\0\0\0"

local function all(_, _) return true end
local function is_motor(id, size) return id == 0x210 and size == 32 end

local T = {}

function T.test_parse()
  lu.assertEquals({ frame.parse(MOTOR, 1) }, { 0x210, 32, 0, 0, 0 })
  lu.assertEquals({ frame.parse("xx" .. "YP\255\6\1\2\3\4\5\6\7\8" .. "payload", 3) },
    { 0x04030201, 0x0605, 0x0807, 255, 6 })
  for length = 0, 11 do lu.assertNil(frame.parse(MOTOR:sub(1, length), 1)) end
end

-- The size has two bytes ("YAPP Framing").
function T.test_the_largest()
  lu.assertEquals(frame.LARGEST, 12 + 0xFFFF + 4)
end

function T.test_crc()
  lu.assertEquals(frame.crc("..\187\190\111\199", 6), 0xC76FBEBB)
end

-- header, accepts, what judge says
function T.test_judge()
  local rows = {
    { MOTOR, all, 32 }, { MOTOR, is_motor, 32 }, { "YP\9\9\16\2\0\0\33\0\0\0", is_motor, nil },
    { "YP\0\0\255\7\0\0\255\255\0\0", all, 65535 }, { "YP\0\0\0\8\0\0\32\0\0\0", all, nil },
    { "YP\0\0\0\7\1\0", all, nil }, { "YP\0\0\0\7\0\1", all, nil }, { "YP\0\0\0\7\0\0\1\0\1", all, nil },
    { "YP\0\0\0\7\0\0\1\0\0\1", all, nil }, { "YP\0\0\0\8", all, nil },
  }
  for i, row in ipairs(rows) do lu.assertEquals(frame.judge("x" .. row[1], 2, row[2]), row[3], "row " .. i) end
  for length = 2, 11 do lu.assertFalse(frame.judge(MOTOR:sub(1, length), 1, is_motor)) end
  lu.assertNil(frame.judge("YP\0\0\16\2\0\0\33\0", 1, is_motor)) -- before its end has come
end

return T
