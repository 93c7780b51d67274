-- SPDX-License-Identifier: GPL-2.0-or-later
-- The header of a serial frame.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local frame = require("yapp.wire.frame")

local unpack = table.unpack or unpack -- luacheck: ignore

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

function T.test_crc()
  lu.assertEquals(frame.crc("..\187\190\111\199", 6), 0xC76FBEBB)
end

function T.test_is_plausible()
  for header, expected in pairs {
    [MOTOR] = true, ["YP\0\0\255\7\0\0\255\255\0\0"] = true,
    ["YP\9\9\16\2\0\0\33\0\0\0"] = true, ["YP\0\0\0\8\0\0\32\0\0\0"] = false,
    ["YP\0\0\0\7\1\0\1\0\0\0"] = false, ["YP\0\0\0\7\0\1\1\0\0\0"] = false,
    ["YP\0\0\0\7\0\0\1\0\1\0"] = false, ["YP\0\0\0\7\0\0\1\0\0\1"] = false,
  } do
    lu.assertEquals(frame.is_plausible("x" .. header, 2), expected, header)
  end
  for length = 2, 11 do lu.assertFalse(frame.is_plausible(MOTOR:sub(1, length), 1)) end
end

-- The bytes that came may become a plausible header if one follows them that has zeros there.
function T.test_the_begin_of_a_header()
  for index = 3, 12 do
    for other = index, 12 do
      for _, value in ipairs { 0, 1, 7, 8, 255 } do
        local bytes = { MOTOR:byte(1, 12) }
        bytes[index], bytes[other] = value, value
        local header = string.char(unpack(bytes))
        for length = 2, 12 do
          local begin, zeros = header:sub(1, length), ("\0"):rep(12 - length)
          local name = ("bytes %d and %d are %d, length %d"):format(index, other, value, length)
          lu.assertEquals(frame.may_be_header("x" .. begin, 2), frame.is_plausible(begin .. zeros, 1), name)
        end
        lu.assertEquals(frame.has_id("x" .. header, 2), frame.may_be_header(header:sub(1, 8), 1))
      end
    end
  end
end

return T
