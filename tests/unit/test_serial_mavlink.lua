-- SPDX-License-Identifier: GPL-2.0-or-later
-- Which datagrams are of MAVLink: whole packets and nothing else.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local mavlink = require("yapp.serial.mavlink")

local V1 = "\254\9\1\1\1\0" .. ("p"):rep(9) .. "cc"
local V2 = "\253\9\0\0\1\1\1\0\0\0" .. ("p"):rep(9) .. "cc"
local SIGNED = "\253\3\1\0\1\1\1\0\0\0" .. "ppp" .. "cc" .. ("s"):rep(13)
local NO_PAYLOAD = "\254\0\1\1\1\0cc"

local T = {}

function T.test_whole_packets()
  for _, bytes in ipairs { V1, V2, SIGNED, NO_PAYLOAD, V1 .. V1, V2 .. SIGNED .. V1,
    -- what pymavlink sends if nobody chose a component: 0
    V1:sub(1, 4) .. "\0" .. V1:sub(6), V2:sub(1, 6) .. "\0" .. V2:sub(8) } do
    lu.assertTrue(mavlink.is_whole(bytes))
  end
end

function T.test_other_bytes()
  local zero_volts = "\253\127\253\127" -- two float16 of Motor Data
  for _, bytes in ipairs { "", "\254", "\253\9\0", V1:sub(1, -2), V1 .. "x", V2 .. V1:sub(1, 3), "x" .. V1,
    zero_volts .. ("p"):rep(127 + 12 - 4), "\253\9\2\0" .. V2:sub(5), "\253\9\0\1" .. V2:sub(5),
    "\253\9\2\0" .. V2:sub(5) .. ("s"):rep(26), "\1\9\0\0" .. V2:sub(5),
    "\254\1" .. ("\0"):rep(7), V1:sub(1, 3) .. "\0" .. V1:sub(5), V2:sub(1, 5) .. "\0" .. V2:sub(7) } do
    lu.assertFalse(mavlink.is_whole(bytes))
  end
end

return T
