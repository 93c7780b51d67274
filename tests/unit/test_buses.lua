-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,buses: the bits of frames, counted by hand, and the load of a bus.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local buses_of = require("yapp.stat.buses")

local T = {}

local SOURCE = { bus = "can0" }

-- A SocketCAN record: top is the highest byte of its id.
local function record(top, length, flags)
  return string.char(top, 0, 0, 1, length, flags or 0, 0, 0) .. ("\0"):rep(length)
end

-- The JSON line of a bus with frames, each { time, packet }.
local function line_of(frames, ending)
  local said = {}
  local statistic = buses_of.new({ bitrate = 100000 }, { json = true, out = function(text) said[#said + 1] = text end })
  for _, one in ipairs(frames) do statistic:add_frame(SOURCE, one[1], one[2]) end
  statistic:finish(ending or {}, {})
  return table.concat(said)
end

-- The bits of two equal frames that come a second apart are the load of this second.
local function bits_of(packet)
  return tonumber(line_of({ { 0, packet }, { 1, packet } }):match('"load":([%d.]+)')) * 100000 / 2
end

function T.test_bits_of_frames()
  local cooked = ("\0\0\1\24\0\0\0\0\0\0\0\0\0\0\0\12")
  local cases = { -- record, bits without stuffing, bits that it lengthens
    { record(0, 0), 47, 34 }, { record(0, 8), 111, 98 }, { record(0x80, 0), 67, 54 }, { record(0x80, 8), 131, 118 },
    { record(0xC0, 8), 67, 54 }, -- remote
    { record(0x80, 64, 4), 579, 566 }, -- CAN FD
    { cooked .. "\1\0\0\128\8\0\0\0" .. ("\0"):rep(8), 131, 118 },
    { "\0\12\0\0\0\0\0\3\1\24" .. ("\0"):rep(10) .. "\1\0\0\0\4\0\0\0abcd", 79, 66 },
    { "\128\0\0", 0, 0 }, -- cut by the snap length
  }
  for i, case in ipairs(cases) do lu.assertAlmostEquals(bits_of(case[1]), case[2] + case[3] / 30, 0.01, i) end
end

function T.test_the_highest_load_lies_in_any_second()
  local frames, one = {}, record(0x80, 0) -- 68.8 bits
  for i = 0, 9 do frames[#frames + 1] = { 0.5 + i / 10, one } end -- 0.5 .. 1.4
  frames[#frames + 1] = { 1.5, one } -- the first one is a second old
  frames[#frames + 1] = { 9, one }
  lu.assertAlmostEquals(tonumber(line_of(frames):match('"load_max":([%d.]+)')), 0.00688, 1e-9)
end

function T.test_a_load_needs_time()
  lu.assertStrContains(line_of({ { 0, record(0, 8) } }), '"rate":null')
  lu.assertStrContains(line_of({ { 0, record(0, 8) }, { 1, record(0, 8) } }, { lacks_times = "none" }), '"load":null')
end

return T
