-- SPDX-License-Identifier: GPL-2.0-or-later
-- The header of a serial frame.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local frame = require("yapp.wire.frame")

local MOTOR = "YP\0\0\16\2\0\0\32\0\0\0"

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

-- A header has an ID up to 2047 and reserved bytes 0; a part of one may become it.
function T.test_may_be_header()
  for header, expected in pairs {
    [MOTOR] = true, ["YP\0\0\255\7\0\0\255\255\0\0"] = true,
    ["YP\9\9\16\2\0\0\33\0\0\0"] = true, ["YP\0\0\0\8\0\0\32\0\0\0"] = false,
    ["YP\0\0\0\7\1\0\1\0\0\0"] = false, ["YP\0\0\0\7\0\1\1\0\0\0"] = false,
    ["YP\0\0\0\7\0\0\1\0\1\0"] = false, ["YP\0\0\0\7\0\0\1\0\0\1"] = false,
  } do
    lu.assertEquals(frame.may_be_header("x" .. header, 2), expected, header)
    lu.assertTrue(frame.may_be_header(header:sub(1, 5), 1))
  end
  for length = 2, 12 do lu.assertTrue(frame.may_be_header(MOTOR:sub(1, length), 1)) end
end

function T.test_find_header()
  local zeros, bad = "YP" .. ("\0"):rep(10), "YP\0\0\0\8\0\0\32\0\0\0"
  lu.assertEquals(frame.find_header("xx" .. zeros .. bad .. MOTOR, 1), 27)
  lu.assertNil(frame.find_header(zeros .. bad .. MOTOR:sub(1, 11), 1))
end

return T
