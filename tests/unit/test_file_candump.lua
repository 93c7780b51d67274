-- SPDX-License-Identifier: GPL-2.0-or-later
-- A file of candump text: times, buses, offsets, what is told of broken lines.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local candump = require("yapp.file.candump")
local cpu = require("cpu")
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

function T.test_times_since_the_first_stay()
  local frames = frames_of(screen({ "000.000000", "000.500000", "001.700000" }))
  lu.assertEquals(times(frames), { "0.000000000", "0.500000000", "1.700000000" })
end

function T.test_times_of_two_buses_may_change_places()
  local stamps = { "000.000000", "000.000300", "000.000290", "000.000600", "000.000590" }
  local frames = frames_of(screen(stamps, { "can0", "can0", "can1", "can0", "can1" }))
  lu.assertEquals(times(frames)[5], "0.000590000")
end

function T.test_deltas_are_added_up()
  local frames = frames_of(screen({ "000.000000", "000.900000", "000.200000", "000.000100", "002.000000" }))
  lu.assertEquals(times(frames),
    { "0.000000000", "0.900000000", "1.100000000", "1.100100000", "3.100100000" })
end

-- As an adapter stamps that fetches several frames at once.
-- The same in the format of logs: candump -L -t d, also where Wireshark's own reader would take it (no `all`).
function T.test_deltas_of_a_log()
  local text = ""
  for i = 1, 20 do text = text .. ("(000.%06d) can0 08404000#A2\n"):format(i % 2 == 0 and 99000 or 1000) end
  local log = candump.open(text_file(text), { report = function() end })
  lu.assertNotNil(log)
  local file, sum = text_file(text), 0
  log = candump.open(file, { all = true, report = function() end })
  for i = 1, 20 do
    local _, _, seconds, nanoseconds = log:read(file)
    sum = sum + (i % 2 == 0 and 99000 or 1000)
    lu.assertEquals({ seconds, nanoseconds }, { math.floor(sum / 1000000), sum % 1000000 * 1000 })
  end
  -- Since the first one (-t z), and other programs' short times, which may be those of two recorders:
  for _, shape in ipairs { "(%03d.%06d)", "(%d.%06d)" } do
    text = ""
    for i = 1, 20 do
      local ahead = shape == "(%d.%06d)" and i % 2 * 3 or 0
      text = text .. shape:format(i + ahead, i) .. " can0 08404000#A2\n"
    end
    file = text_file(text)
    log = candump.open(file, { all = true, report = function() end })
    for i = 1, 20 do
      local ahead = shape == "(%d.%06d)" and i % 2 * 3 or 0
      lu.assertEquals((select(3, log:read(file))), i + ahead)
    end
  end
end

function T.test_equal_times_since_the_first_stay()
  local stamps = {}
  for i = 0, 39 do stamps[i + 1] = ("000.%06d"):format(i - i % 2) end
  lu.assertEquals(times(frames_of(screen(stamps)))[40], "0.000038000")
end

function T.test_equal_deltas_are_added_up()
  local frames = frames_of(screen({ "000.000000", "000.010000", "000.010000", "000.010000" }))
  lu.assertEquals(times(frames)[4], "0.030000000")
end

-- Times that fall now and then are of several adapters; where they repeat too, they are deltas.
function T.test_times_that_fall_now_and_then()
  local function last(microseconds)
    local stamps = {}
    for i, time in ipairs(microseconds) do stamps[i] = ("000.%06d"):format(time) end
    return times(frames_of(screen(stamps)))[#stamps]
  end
  local twice, once = {}, {}
  for i = 1, 20 do twice[i], once[i] = i, i end
  twice[8], twice[15] = 5, 12 -- two of twenty
  lu.assertEquals(last(twice), "0.000020000")
  once[5], once[6], once[7], once[12] = 4, 4, 4, 10
  local sum = 0
  for i = 1, 20 do sum = sum + once[i] end
  lu.assertEquals(last(once), ("0.%06d000"):format(sum))
  lu.assertEquals(times(frames_of(screen({ "000.000000000", "000.000000001", "000.000000001" })))[3], "0.000000002")
end

-- Reading again at any offset gives the same record, in any order of reading.
local function assert_same_again(text)
  local frames, _, log = frames_of(text)
  local file = text_file(text)
  local order = {}
  for i = 1, #frames do order[i] = i end
  for i = #frames, 1, -1 do order[#order + 1] = i end
  for i = 1, #frames do order[#order + 1] = i * 7919 % #frames + 1 end
  for _, i in ipairs(order) do
    lu.assertEquals(text_of.frame(log:seek_read(file, frames[i].offset)), frames[i])
  end
end

-- Local times go back by an hour when summer time ends: here on a day when the reader's do not.
function T.test_the_hour_that_summer_time_repeats()
  local function seconds(...)
    local text, list = screen({ ... }), {}
    assert_same_again(text)
    for i, found in ipairs(frames_of(text)) do list[i] = found.seconds end
    for i = #list, 1, -1 do list[i] = list[i] - list[1] end
    return list
  end
  local first, back = "2026-01-15 02:59:59.000000", "2026-01-15 02:00:00.000000"
  local half, later = "2026-01-15 02:30:00.000000", "2026-01-15 03:59:59.000000"
  lu.assertEquals(seconds(first, back, half, "2026-01-15 03:29:59.000000"), { 0, 1, 1801, 5400 })
  lu.assertEquals(seconds(first, back, first, later), { 0, 1, 3600, 3600 }) -- the reader's own hour, or a pause
  lu.assertEquals(seconds(later, first, back), { 0, 0, 1 }) -- just an hour, and another one
  lu.assertEquals(seconds(later, "2026-01-15 02:59:58.000000", back), { 0, -3601, -7199 + 3600 }) -- no summer time's
  lu.assertEquals(seconds(first, half), { 0, -1799 }) -- nor is half an hour
end

function T.test_reading_again()
  local stamps, buses = {}, {}
  for i = 1, levels.size(200, 500) do
    stamps[i], buses[i] = string.format("000.%06d", i * 7919 % 1000), "can" .. i % 3
  end
  assert_same_again(screen(stamps, buses))
  assert_same_again((screen(stamps, buses):gsub("can1[^\n]*\n", "%0\nbroken\n", 100)))
  assert_same_again((screen(stamps):gsub("000%.", "1700000000.")))
end

-- What is read again, as a click in the packet list does, changes nothing of what comes.
function T.test_reading_again_between_others()
  local stamps = { "000.000000", "000.900000", "000.200000", "000.100000" }
  local text = screen(stamps) .. "broken\n" .. screen { "000.100000" }
  local log, file = opened(text)
  local again, last = text_file(text), nil
  for _ = 1, 5 do
    last = text_of.frame(log:read(file))
    for _ = 1, 2 do lu.assertEquals(text_of.frame(log:seek_read(again, last.offset)), last) end
  end
  lu.assertEquals(times { last }, { "1.300000000" })
  lu.assertEquals(log.drops, { { count = 1, frame = 5, time = 1.3 } })
end

function T.test_numbers_of_buses()
  local stamps = { "000.000000", "000.000001", "000.000002", "000.000003", "000.000004", "000.000005" }
  local frames = frames_of(screen(stamps, { "can1", "any", "can0", "vcan1", "can1", "can12345" }))
  lu.assertEquals(column(frames, "bus"), { 1, 0, 2, 3, 1, 4 })
  lu.assertStrContains(frames[1].comment, "Interface index 1 is can1")
  lu.assertNil(frames[5].comment)
end

function T.test_more_buses_than_any_file_has()
  local lines = {}
  for i = 1, 1000 do lines[i] = string.format("(1.000000) b%dx 123#11\n", i) end
  local frames = frames_of(table.concat(lines))
  lu.assertEquals(#frames, 1000)
  lu.assertEquals({ #frames[1000].bytes, frames[1000].bus }, { 20 + 8 + 1, 999 })
  for i = 1, 10000 do lines[i] = string.format("(1.000000) b%dx 123#11\n", i) end
  lu.assertTrue(cpu.is_linear(function(count)
    lu.assertEquals(frames_of(table.concat(lines, "", 1, count))[count].bus, count - 1)
  end, 2500))
end

function T.test_broken_lines_are_told_and_skipped()
  local text = HEAD .. "\n" .. HEAD .. "oh no\n" .. "(1.000000) can0 123#1\n" .. HEAD .. "# remark\n" .. HEAD
  local frames, told = frames_of(text)
  lu.assertEquals(#frames, 4)
  lu.assertEquals(told, { 'line 2: an empty line, skipped: ""', 'line 4: not a candump line, skipped: "oh no"',
    'line 5: the data bytes do not fit, line skipped: "(1.000000) can0 123#1"',
    'line 7: a comment, skipped: "# remark"' })
  lu.assertNil(frames[2].comment)
  lu.assertStrContains(frames[3].comment, "line 4: not a candump line")
  lu.assertStrContains(frames[3].comment, "line 5: the data bytes do not fit")
end

-- A byte order mark, also that of a second file behind the first.
function T.test_a_byte_order_mark()
  local mark = "\239\187\191"
  for _, head in ipairs { HEAD, "(000.000000)  can0  123   [1]  11\n" } do
    local text = mark .. head .. mark .. head
    local frames, told = frames_of(text)
    lu.assertEquals({ column(frames, "offset"), told }, { { #mark, 3 + #head }, {} })
    assert_same_again(text)
  end
end

function T.test_one_broken_line_stands_at_the_next_frame()
  local frames = frames_of(HEAD .. "oh no\n" .. HEAD .. HEAD)
  lu.assertNil(frames[3].comment)
  lu.assertEquals(frames[2].comment, 'line 2: not a candump line, skipped: "oh no"')
end

function T.test_several_buses_in_the_first_lines()
  lu.assertFalse(opened(HEAD .. HEAD, true).has_several)
  lu.assertTrue(opened(HEAD .. HEAD:gsub("can0", "can1") .. HEAD, true).has_several)
end

-- candump -d says in its output, and in a log, how many frames the kernel dropped.
function T.test_drops()
  local drop = "DROPCOUNT: dropped %s on '%s' socket (total drops 12)\n"
  lu.assertNil((opened(drop:format("9 CAN frames", "can1"):rep(3)))) -- no frame: another file
  local text = HEAD .. HEAD .. drop:format("3 CAN frames", "can0") .. "# remark\n" .. ("x"):rep(5000) .. "\n" ..
    drop:format("1 CAN frame", "any") .. " (1700000000.500000)  can0  123   [1]  11\n" .. HEAD ..
    drop:format("99999999999999999999 CAN frames", "can1,123:7FF") .. HEAD:gsub("01%)", "02)") ..
    "DROPCOUNT: dropped 7\n" .. drop:format("4294967295 CAN frames", "v\255")
  local log, file = opened(text)
  while log:read(file) do end
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

-- A logger that lost its power leaves bytes of zeros.
function T.test_bytes_of_zeros()
  for _, text in ipairs { HEAD .. ("\0"):rep(600) .. "\n" .. HEAD .. HEAD, HEAD .. HEAD .. "\0\0\0" .. HEAD .. HEAD } do
    local log, file = opened(text)
    local count = 0
    while log:read(file) do count = count + 1 end
    lu.assertEquals({ count, log.drops[1].count, log.drops[2] }, { 3, 1 })
  end
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

function T.test_many_broken_lines_do_not_flood()
  local frames, told = frames_of(HEAD:rep(1000) .. ("oh no\n\n"):rep(500) .. HEAD)
  lu.assertEquals(#frames, 1001)
  lu.assertEquals(#told, 6)
  lu.assertEquals(told[5], 'line 1005: not a candump line, skipped: "oh no"; further ones are not reported')
  lu.assertEquals(told[6], 'line 1006: an empty line, skipped: ""; further ones are not reported')
end

function T.test_a_line_without_end_costs_its_length_only()
  local long = ("x"):rep(levels.size(300000, 3000000))
  local frames, told = frames_of(HEAD .. HEAD .. long .. "\n" .. HEAD:gsub("can0", "can1") .. long)
  lu.assertEquals(column(frames, "offset"), { 0, #HEAD, 2 * #HEAD + #long + 1 })
  lu.assertEquals(#told, 2)
  lu.assertStrContains(told[1], "line 3: a line longer than 4096 bytes, skipped")
  lu.assertStrContains(told[2], "line 5: a line longer than 4096 bytes, skipped")
end

function T.test_decimals()
  lu.assertEquals(opened(HEAD, true).decimals, 6)
  lu.assertEquals(opened("(1700000000.000001001) can0 123#11\n").decimals, 9)
  lu.assertEquals(opened("can0  123   [1]  11\n").decimals, 6) -- no times
end

-- LINUX_SLL2: protocol, reserved, ifindex, ARPHRD_CAN 280, packet type, address length and address; then SocketCAN.

-- The short way for lines of the usual form says what the long way says.
function T.test_usual_lines_between_others()
  local lines, expected = {}, {}
  local forms = { "(%d.000001) can0 08404000#BBBE6FC720000000", "(%d.000001) can1 123#", "(%d.000001) can0 123#1122 R",
    "(%d.000001) can0 123#11\r", "(%d.000001) can0 08404000#bbbe6fC7 T", "(%d.000001) can1 08404000#R2",
    "(%d.000001) can0 08404000##1AABB", "(%d.000001)  can0  123   [1]  11", "(%d.000001) can0 00000123#11",
    "(%d.000001) can0 123#1", "(%d.000001000) can1 123#", "(%d.000001) can2 08404000#", "(%d.000001) can2 1#" }
  for i = 1, 300 do
    lines[i] = forms[i * 7919 % #forms + 1]:format(1700000000 + i)
    local record = candump.parse(lines[i])
    if record then expected[#expected + 1] = packet(tonumber(record.bus:sub(-1)), record) end
  end
  local text = table.concat(lines, "\n")
  local frames, _, log = frames_of(text)
  lu.assertEquals(column(frames, "bytes"), expected)
  local file = text_file(text)
  for _, frame in ipairs(frames) do
    lu.assertEquals(text_of.frame(log:seek_read(file, frame.offset)), frame)
  end
end

-- They are half of the work: only the first one of a bus, and that behind a piece that is read, goes the long way.
function T.test_usual_lines_go_the_short_way()
  local log, file = opened(HEAD:rep(1000), true)
  local parse, count = candump.parse, 0
  function candump.parse(...)
    count = count + 1
    return parse(...)
  end
  while log:read(file) do end
  candump.parse = parse
  lu.assertTrue(count < 10, count)
end

function T.test_more_ids_than_are_remembered()
  local lines = {}
  for i = 1, 10000 do lines[i] = ("(1700000000.%06d) can0 %08X#11"):format(i, i * 7919 % 5000 * 0x10000) end
  local frames = frames_of(table.concat(lines, "\n"), true)
  lu.assertEquals(#frames, 10000)
  for i = 1, #frames, 97 do
    lu.assertEquals(frames[i].bytes, packet(0, candump.parse(lines[i])), "frame " .. i)
  end
end

-- What a bus is called, fit to be printed; the frames keep their numbers apart.
function T.test_names_of_buses_are_fit_to_be_printed()
  local frames = frames_of("(1.000000) can\255 123#11\n(1.000001) can\254 123#11\n(1.000002) \195\188can 123#\n" ..
    "(1.000003) \1\127can9 123#\n(1.000004) can\255 123#11\n")
  lu.assertEquals(column(frames, "bus_name"), { "can\\xFF", "can\\xFE", "\195\188can", "\\x01\\x7Fcan9", "can\\xFF" })
  lu.assertEquals(column(frames, "bus"), { 0, 1, 2, 9, 0 })
  lu.assertEquals(frames[1].comment, "Interface index 0 is can\\xFF")
  frames = frames_of("(1.000000) can\255 123#11\n(1.000001) can\\xFF 123#11\n") -- names stay apart
  lu.assertEquals(column(frames, "bus_name"), { "can\\xFF", "can\\x5CxFF" })
end

-- The bus of a log that is left to Wireshark's own reader.
function T.test_the_bus_of_a_plain_log()
  local function plain_bus(text)
    local log, known = candump.open(text_file(text), {})
    lu.assertNil(log)
    if not known then return nil end
    lu.assertFalse(known.stamps_differ) -- all lines are one
    return known.plain_bus
  end
  for _, more in ipairs { "", "1", "11" } do -- wherever in a line the pieces end that are read
    local line = HEAD:gsub("0 123#", "0 00000123#" .. more .. more)
    for _, count in ipairs { 5000, 100000 } do lu.assertEquals(plain_bus(line:rep(count)), "can0") end
  end
  lu.assertEquals(plain_bus((HEAD:gsub("can0", "v\255n"))), "v\\xFFn")
  lu.assertNil(plain_bus("some text\n"))
end

return T
