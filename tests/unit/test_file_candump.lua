-- SPDX-License-Identifier: GPL-2.0-or-later
-- A file of candump text: times, buses, offsets, what is told of broken lines.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local candump = require("yapp.file.candump")
local levels = require("levels")
local packet = require("yapp.file.text").packet
local text_of = require("candump_text")

local frames_of, opened, text_file = text_of.frames_of, text_of.opened, text_of.file

local function column(frames, name)
  local values = {}
  for i, frame in ipairs(frames) do values[i] = frame[name] end
  return values
end

local T = {}

local HEAD = "(1700000000.000001) can0 123#11\n"

local function screen(stamps, buses)
  local lines = {}
  for i, stamp in ipairs(stamps) do
    lines[i] = string.format(" (%s)  %s  123   [1]  11\n", stamp, buses and buses[i] or "can0")
  end
  return table.concat(lines)
end

local function times(frames)
  local list = {}
  for i, frame in ipairs(frames) do list[i] = string.format("%d.%09d", frame.seconds, frame.nanoseconds) end
  return list
end

-- Logs of random frames, most of them in the usual form: id, data, time and bus of each.  A line that lost its last
-- digit is no frame.
function T.test_random_logs()
  math.randomseed(7)
  for _ = 1, 50 do
    local lines, expected, buses = {}, {}, {}
    for i = 1, math.random(2, 20) do
      local id = ({ math.random(0, 0x7ff), 0x80000000 + math.random(0, 0x1fffffff), 0x80000000 })[math.random(3)]
      local digits = id < 0x800 and ("%03X"):format(id) or ("%08X"):format(id - 0x80000000)
      local seconds, micros, bus = 1700000000 + i, math.random(0, 999999), "vcan" .. math.random(0, 2)
      local bytes, hex = "", ""
      for at = 1, math.random(0, 8) do
        bytes = bytes .. string.char(math.random(0, 255))
        hex = hex .. ("%02X"):format(bytes:byte(at))
      end
      local form = #hex > 0 and math.random(7) or 2
      if form == 1 then
        local stamp = os.date("%Y-%m-%d %H:%M:%S", seconds)
        lines[i] = ("(%s.%06d)  %s  %s  [%d] %s"):format(stamp, micros, bus, digits, #bytes, hex:gsub("..", " %0"))
      else
        local shape = form == 2 and "(%d.%06d000) %s %s#%s R" or "(%d.%06d) %s %s#%s"
        lines[i] = shape:format(seconds, micros, bus, digits, hex)
      end
      if form == 7 then lines[i] = lines[i] .. "\n" .. lines[i]:sub(1, -2) end
      if not buses[bus] then buses[bus], buses[#buses + 1] = #buses, bus end
      expected[i] = { seconds = seconds, nanoseconds = micros * 1000, bus = buses[bus], bus_name = bus,
        bytes = packet(buses[bus], { id = id, data = bytes }) }
    end
    local frames = frames_of(table.concat(lines, "\n") .. "\n")
    for _, frame in ipairs(frames) do frame.offset = nil end
    lu.assertEquals(frames, expected)
  end
end

function T.test_deltas_are_added_up()
  local text = screen({ "000.000000", "000.900000", "000.200000", "000.000100", "002.000000" })
  for _, form in ipairs { text, (text:gsub(" (%(.-%) ) (%w+)  123   %[1%]  ", "%1%2 123#")) } do
    lu.assertEquals(times(frames_of(form)),
      { "0.000000000", "0.900000000", "1.100000000", "1.100100000", "3.100100000" })
  end
  -- Since the first frame they climb, if a recorder gives several frames one stamp, too.
  lu.assertEquals(times(frames_of(screen({ "000.000000", "000.000000", "000.900000", "000.900000" }))),
    { "0.000000000", "0.000000000", "0.900000000", "0.900000000" })
  -- One of ten may fall.
  local stamps = { "000.900000" }
  for i = 2, 10 do stamps[i] = ("000.%d00000"):format(i - 2) end
  lu.assertEquals(times(frames_of(screen(stamps)))[10], "0.800000000")
  table.remove(stamps)
  lu.assertEquals(times(frames_of(screen(stamps)))[9], "3.700000000")
end

-- candump -d says in its output, and in a log, how many frames the kernel dropped.
function T.test_drops()
  local drop = "DROPCOUNT: dropped %s on '%s' socket (total drops 12)\n"
  lu.assertNil((opened(drop:format("9 CAN frames", "can1"):rep(3)))) -- no frame: another file
  local text = HEAD .. HEAD .. drop:format("3 CAN frames", "can0") .. "# remark\n" .. ("x"):rep(5000) .. "\n" ..
    drop:format("1 CAN frame", "any") .. " (1700000000.500000)  can0  123   [1]  11\n" .. HEAD ..
    drop:format("4294967295 CAN frames", "can1,123:7FF") .. HEAD:gsub("01%)", "02)") ..
    "DROPCOUNT: dropped 7\n" .. drop:format("4294967295 CAN frames", "v\255")
  local log, file, told = opened(text)
  while log:read(file) do end
  lu.assertStrContains(told[1], "line 3: candump lost frames: ")
  lu.assertEquals(log.drops, {
    { count = 3, bus = "can0", frame = 3, time = 1700000000.5 }, { count = 1, frame = 3, time = 1700000000.5 },
    { count = 1, frame = 3, time = 1700000000.5 }, -- a line that is too long
    { count = 4294967295, bus = "can1", frame = 5, time = 1700000000 + 2 / 1000000 },
    { count = 7 }, { count = 4294967295, bus = "v\\xFF" },
  })
  for _ = 1, 2 do log:seek_read(file, 0) end
  lu.assertEquals(#log.drops, 6)
end

-- A line between two frames that cannot be read may have been a frame.
function T.test_lines_that_may_have_been_frames()
  local shell = "$ candump can0\n"
  local log, file = opened(shell .. HEAD .. HEAD .. "garbage\n# remark\ngar\n" .. HEAD .. HEAD:rep(3) .. "\n$ exit\n")
  while log:read(file) do end
  lu.assertEquals(log.drops, { { count = 2, frame = 3, time = 1700000000 + 1 / 1000000 } })
end

-- The frame behind has the time that is shown of it, or none.
function T.test_times_of_drops()
  local drop = "DROPCOUNT: dropped 2 CAN frames\n"
  local log, file = opened(screen({ "000.000000", "000.900000" }) .. drop .. screen({ "000.200000", "000.100000" }))
  while log:read(file) do end
  lu.assertEquals(log.drops, { { count = 2, frame = 3, time = 1.1 } }) -- deltas
  log, file = opened("can0  123   [1]  11\n" .. drop .. "can0  123   [1]  11\n")
  while log:read(file) do end
  lu.assertEquals(log.drops, { { count = 2, frame = 2 } })
end

function T.test_lines_that_were_not_understood()
  local bad = "(1.000000) can0 123#1\n"
  local text = HEAD .. "\n" .. HEAD .. "oh no\n" .. bad .. HEAD .. "# remark\n" .. HEAD:rep(100)
  local zeros = ("\0"):rep(9) -- where the recorder lost power
  local frames, told, log = frames_of(text .. bad:rep(500) .. HEAD .. zeros)
  lu.assertEquals(#frames, 104)
  local words = "not understood, counts as a lost packet"
  lu.assertEquals(told, { "line 4: " .. words .. ': "oh no"', "line 5: " .. words .. ': "(1.000000) can0 123#1"',
    "line 108: " .. words .. ': "(1.000000) can0 123#1"; further ones are not reported' })
  lu.assertEquals(column(log.drops, "count"), { 2, 500, 1 })
  lu.assertEquals(column(log.drops, "frame"), { 3, 104 }) -- none behind the last
end

function T.test_a_line_without_end_costs_its_length_only()
  local long = ("x"):rep(levels.size(300000, 3000000))
  local frames, told = frames_of(HEAD .. HEAD .. long .. "\n" .. HEAD:gsub("can0", "can1") .. long)
  lu.assertEquals(column(frames, "offset"), { 0, #HEAD, 2 * #HEAD + #long + 1 })
  lu.assertEquals(#told, 2)
  lu.assertStrContains(told[2], "line 5: not understood")
end

-- What a log says of its first lines.
function T.test_facts_of_a_log()
  local other = "(1700000000.000001001) can1 123#11\n"
  for text, expected in pairs { [HEAD .. HEAD] = { false, false, 6 }, [HEAD .. other] = { true, true, 9 },
    ["can0  123   [1]  11\n"] = { false, false, 6 } } do
    local log = opened(text)
    lu.assertEquals({ log.has_several, log.stamps_differ, log.decimals }, expected, text)
  end
end

-- The bus of a log that is left to Wireshark's own reader.
function T.test_the_bus_of_a_plain_log()
  local function plain_bus(text)
    local log, known = candump.open(text_file(text))
    lu.assertNil(log)
    if not known then return nil end
    lu.assertFalse(known.stamps_differ) -- all lines are one
    return known.plain_bus
  end
  for _, more in ipairs { "", "11" } do -- wherever in a line the pieces end that are read
    local line = HEAD:gsub("0 123#", "0 00000823#" .. more)
    for _, count in ipairs { 5000, 100000 } do lu.assertEquals(plain_bus(line:rep(count)), "can0") end
    lu.assertNotNil(candump.open(text_file(line .. line:sub(1, -2) .. line))) -- a line lost its end
  end
  lu.assertEquals(plain_bus((HEAD:gsub("can0", "v\255n"))), "v\\xFFn")
  lu.assertNil(plain_bus("some text\n"))
end

return T
