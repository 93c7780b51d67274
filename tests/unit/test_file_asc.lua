-- SPDX-License-Identifier: GPL-2.0-or-later
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local asc = require("yapp.file.asc")
local cpu = require("cpu")

local T = {}

local HEAD = "date Tue Nov 14 22:13:20.001 2023\r\nbase hex  timestamps absolute\r\ninternal events logged\r\n"

local function shown(line, base)
  local r, stamp = asc.parse(line, base or 16)
  if not r then return nil end
  local kind = (r.fd and "fd " or "") .. (r.sent and "tx " or "")
  return ("%d %d %08X %s%d %d %s"):format(stamp, r.bus, r.id, kind, r.length, r.flags,
    r.data:gsub(".", function(byte) return ("%02X"):format(byte:byte()) end))
end

function T.test_lines()
  for line, expected in pairs {
    [" 0.001000 1  8404000x        Rx   d 8 BB BE 6F C7 20 00 00 00"] = "1000 1 88404000 8 0 BBBE6FC720000000",
    ["12.5 2 123 Tx d 2 01 ff  Length = 100 BitCount = 60 ID = 291"] = "12500000 2 00000123 tx 2 0 01FF",
    ["0.1 1 0x Rx d 0"] = "100000 1 80000000 0 0 ",
    ["0.1 1 123 Rx r"] = "100000 1 40000123 0 0 ",
    ["0.1 1 8404000x Rx r 4 Length = 0"] = "100000 1 C8404000 4 0 ",
    ["0.1 1 8404000x Rx d f 1 2 3 4 5 6 7 8"] = "100000 1 88404000 8 0 0102030405060708",
    ["0.1 3 ErrorFrame"] = "100000 3 20000080 8 0 0000000000000000",
    ["0.1 3  ErrorFrame Flags = 0xe CodeExt = 0x20a2"] = "100000 3 20000080 8 0 0000000000000000",
    ["0.1 CANFD 1 Rx 8404000x  1 0 8  8 BB BE 6F C7 20 0 0 0  0 0 3000 0 0 0 0 0"] =
      "100000 1 88404000 fd 8 5 BBBE6FC720000000",
    ["0.1 CANFD 1 Tx 123 Name_1 0 1 9 12 1 2 3 4 5 6 7 8 9 A B C 0 0 1000 0"] =
      "100000 1 00000123 fd tx 12 6 0102030405060708090A0B0C",
    ["0.1 CANFD 1 Rx 123 1 1 2 2 1 2 130000 130 203000 0 0 0 0 0"] = "100000 1 00000123 fd 2 7 0102",
    ["0.1 CANFD 1 Rx 123 0 0 2 2 1 2"] = "100000 1 00000123 fd 2 4 0102",
    ["0.1 CANFD 1 Rx 123 0 0 2 2 1 2 130000 130 0 0 0 0 0 0"] = "100000 1 00000123 2 0 0102",
    ["0.1 CANFD 1 Rx 123 0 0 2 2 1 2 130000 130 202000 0 0 0 0 0"] = "100000 1 00000123 2 0 0102",
    ["-1.000000 1  8404000x        Rx   d 1 A2"] = "-1000000 1 88404000 1 0 A2",
    ["-0.25 1 123 rx d 1 a2"] = "-250000 1 00000123 1 0 A2",
    ["0,125 1 8404000x TX D 1 a2"] = "125000 1 88404000 tx 1 0 A2",
    ["0.0118\t2\t208X\trX\td\t1 18"] = "11800 2 80000208 1 0 18",
    ["0.1 1 123 tx R 2"] = "100000 1 40000123 tx 2 0 ",
    ["0.1 CanFd 1 tx 123 1 0 8 1 12"] = "100000 1 00000123 fd tx 1 5 12",
    ["0.1 1 rx errorframe"] = "100000 1 20000080 8 0 0000000000000000",
    ["0.311250987 1  C0           Rx   d   2 38 FF "] = "311250 1 000000C0 2 0 38FF",
    ["594680.670895  5  1af    Rx    d 1 d3"] = "594680670895 5 000001AF 1 0 D3",
    ["1700000000.670895 1 1af Rx d 0"] = "1700000000670895 1 000001AF 0 0 ",
    ["4999999.999999 1 1 Rx d 0"] = "4999999999999 1 00000001 0 0 ",
    ["0.1 1 0000000123 Rx d 0"] = "100000 1 00000123 0 0 ",
    ["0.1 CANFD 1 Rx 123 0 0 f 64" .. (" 1"):rep(64)] = "100000 1 00000123 fd 64 4 " .. ("01"):rep(64),
  } do
    lu.assertEquals(shown(line), expected, line)
  end
end

function T.test_decimal()
  lu.assertEquals(shown("0.1 1 138428416x Rx d 2 255 16", 10), "100000 1 88404000 2 0 FF10")
  lu.assertNil(shown("0.1 1 8404000x Rx d 2 256 16", 10))
  -- 2^64 + 1 would be 1 in Lua 5.4, and 2^63 less than 0
  for _, byte in ipairs { "18446744073709551617", "9223372036854775808", "1000" } do
    lu.assertNil(shown("0.1 1 8404000x Rx d 1 " .. byte, 10))
  end
end

function T.test_lines_without_a_frame()
  for _, line in ipairs { "", " ", "// comment", "0.000000 Start of measurement", "End TriggerBlock",
    "1.0 1 Statistic: D 1 R 0 XD 0 XR 0 E 0 O 0 B 0.01%", "0.1 1 EngineData Rx d 1 00", "0.1 1 8404000x Rx d 8 BB BE",
    "0.1 1 800 Rx d 0", "0.1 1 20000000x Rx d 0", "0.1 1 123 Rx d 1 100", "0.1 1 123 Rx x 1 00",
    "12345678901 1 123 Rx d 0", "0.1 CANFD 1 Rx 123 0 0 f 65" .. (" 1"):rep(65),
    "0.1 1 00000000123 Rx d 0", "0.1 CANFD 1 Rx 123 0 0 9 12 1 2 3", "x 1 123 Rx d 0",
    "0.1 1 123456789ABx Rx d 0", "0.1 1", "0.1", "5", ".5 1 123 Rx d 0",
    "0.1 " .. ("9"):rep(400) .. " 123 Rx d 0", "0.1 " .. ("9"):rep(400) .. " ErrorFrame" } do
    lu.assertNil(shown(line), line)
  end
end

-- A line that was not understood may have been a frame.
function T.test_lines_that_may_have_been_frames()
  for _, rest in ipairs { "1 8404000x Rx d 8 BB BE", "1 8404000x Rx d 2 BB G", "1 123 Rx d", "1 123 Rx x 1 00",
    "CANFD 1 Rx 123 0 0 9 12 1 2 3", "CANFD 1 Rx 123 1 0" } do
    local record, stamp, why = asc.parse("0.1 " .. rest, 16)
    lu.assertEquals({ record, stamp, why }, { nil, 100000, "the data bytes do not fit, line skipped" }, rest)
  end
  for _, line in ipairs { "0.1 1 EngineData Rx d 1", "0.1 1 800 Rx d 0", "0.1 1 20000000x Rx d 0" } do
    lu.assertEquals((select(3, asc.parse(line, 16))), "no such CAN id, line skipped", line)
  end
  for _, line in ipairs { "0.1 1 8404000x", "0.1 1", "0.1 1 8404000x Xx d 8 BB", "8404000x Rx d 8 BB BE", "0.1 CANFD",
    "x", "0.1 Timestamp: 17.0 ID: 18ff3127 X Rx DL: 1 12", "0.1 CANFD 1 8404000x Rx 1 0 8 8", "0x" } do
    lu.assertEquals((select(3, asc.parse(line, 16))), "not an ASC line, skipped", line)
  end
end

-- Lines of known kinds that are no data frames, and events of the recorder.
function T.test_lines_that_are_known()
  for _, line in ipairs { "", " \t", "// 0.1 1 123 Rx d 1", "// version 7.1.0", "; remark", "date Tue Nov 14 2023",
    "Date", "base hex  no internal events logged", "internal events logged", "no internal events logged",
    "Begin Triggerblock", "Begin TriggerBlock Tue", "End TriggerBlock", "0.000000 Start of measurement",
    "0.000000 Start der Messung", "-0.5 Log Trigger Event (type=0x2)", "0.1 Log Trigger Event",
    "1.0 1 Statistic: D 1 R 0 XD 0 XR 0 E 0 O 0 B 0.01%", "1.0 1  Statistic: D 0", "0.1 1 123 TxRq d 1",
    "0.1 CANFD 1 TxRq 123 1 0 8 8", "0.1 CAN 1 Status:chip status error active", "0.1 1 OverloadFrame",
    "59.1 CANXL   2 Rx   XLFF   984438 4656 432 name", "0.1 1 J1939TP FEE3p 6 0 0 - Rx d 39", "0.1 L1 3C Rx 8 01 02",
    "0.1 Li 3C Tx 8", "0.1 ETH 1 Rx 60:01", "0.1 SV: 3 0 1 ::x = 1", "0.1 Fr RMSG 0 0 1 Rx" } do
    local record, _, why = asc.parse(line, 16)
    lu.assertEquals({ record, why }, {}, line)
  end
end

-- A file in memory, read as Wireshark's.
local function file_of(text)
  local at = 1
  return {
    read = function(_, count)
      local part = text:sub(at, at + count - 1)
      at = at + #part
      return part ~= "" and part or nil
    end,
    seek = function(_, _, offset) at = offset + 1 end,
  }
end

-- The frames, and what was said of lines.
local function frames(text)
  local file, again, found, said = file_of(text), file_of(text), {}, {}
  local log = asc.open(file, function(message) said[#said + 1] = message end)
  if not log then return nil end
  while true do
    local record = { log:read(file) }
    if not record[1] then break end
    lu.assertEquals({ log:seek_read(again, record[1]) }, record)
    found[#found + 1] = { bytes = record[2], seconds = record[3], nanoseconds = record[4], bus = record[5],
      comment = record[6] }
  end
  return found, said, log
end

local function times(text)
  local found, start = {}, os.time { year = 2023, month = 11, day = 14, hour = 22, min = 13, sec = 20 }
  for i, record in ipairs(frames(text)) do
    found[i] = ("%d.%09d"):format(record.seconds - start, record.nanoseconds)
  end
  return table.concat(found, " ")
end

function T.test_what_is_asc()
  lu.assertEquals(frames(HEAD), {})
  lu.assertEquals(#frames(HEAD .. "0.1 1 123 Rx d 0"), 1)
  lu.assertEquals(#frames(HEAD:gsub("hex", "dec") .. "0.1 1 123 Rx d 0\n"), 1)
  for _, text in ipairs { "base hex timestamps absolute\n", "// remark\nbase dec\n",
    "date Mon Dec 6 11:21:13 am 2021\nbase hex  no internal events logged\n// version 7.1.0\n" } do
    lu.assertEquals(#frames(text .. "0.1 1 123 Rx d 0"), 1, text)
  end
  for _, text in ipairs { "0.1 1 123 Rx d 0",
    "\n// remark\n0.1 1 123 Rx d 0\n", "0.1 1 123 Rx d 0\nx\n0.2 1 1 Rx d 0\n",
    "0,1\t1\t123\trx\td\t0\n", "date today\n0.1 1 123 Rx d 0\n", "0.0 Start of measurement\n0.1 1 123 Rx d 0\n" } do
    lu.assertEquals(#frames(text), text:find("\nx") and 2 or 1, text)
  end
  for _, text in ipairs { "", "date", "date Tue Nov 14 22:13:20 2023\n", "baseball\n", "0.1\n", "0.1 1\n",
    "date 2023\nbase oct timestamps absolute\n", "(0.1) can0 123#00\n", "x\n0.1 1 123 Rx d 0\n0.2 1 1 Rx d 0\n",
    "0.1 1 123 Rx d 0\n0.2 1 5 6 7\n", "1 2 3\n4 5 6\n", "0.5,1,2\n", "0.0 Start of measurement\n" } do
    lu.assertNil(frames(text), text)
  end
end

function T.test_times()
  local frame = "0.5 1 123 Rx d 0\n"
  lu.assertEquals(times(HEAD .. frame .. "1.25 1 123 Rx d 0\n"), "0.501000000 1.251000000")
  lu.assertEquals(times(HEAD:gsub("absolute", "relative") .. frame .. frame), "0.501000000 1.001000000")
  -- python-can's: the date is when the file was made.
  local block = "Begin Triggerblock Tue Nov 14 22:13:20.1 2023\n"
  lu.assertEquals(times(HEAD:gsub("2023", "2026") .. block .. frame), "0.501000000")
  -- CANoe's: a block that began 100 s later, with times since the date.
  lu.assertEquals(times(HEAD .. frame .. "Begin Triggerblock Tue Nov 14 10:15:00.500 pm 2023\n100.5 1 123 Rx d 0\n" ..
    "110.5 1 123 Rx d 0\n"), "0.501000000 100.501000000 110.501000000")
  lu.assertEquals(times(HEAD:gsub("Tue Nov", "Die Nov") .. frame), "0.501000000")
end

function T.test_months()
  local names = "jan feb mar apr may jun jul aug sep oct nov dec"
  local german = "jan feb mär apr mai jun jul aug sep okt nov dez"
  for _, line in ipairs { names, german, "jän feb mrz" } do
    local month = 0
    for name in line:gmatch("%S+") do
      month = month + 1
      local start = os.time { year = 2023, month = month, day = 14, hour = 22, min = 13, sec = 20 }
      lu.assertEquals(frames(HEAD:gsub("Nov", name) .. "1.0 1 123 Rx d 0\n")[1].seconds, start + 1, name)
    end
  end
end

-- Times count from the date before, or from 0, and the line is named.
function T.test_dates_that_do_not_exist()
  local good, frame = "Tue Nov 14 22:13:20.001 2023", "0.5 1 123 Rx d 0\n"
  for _, date in ipairs { "Tue Nov 99999999999 22:13:20.001 2023", "Tue Nov 31 22:13:20 2023",
    "Tue Nov 0 22:13:20 2023", "Wed Feb 29 10:00:00 2023", "Tue Nov 14 24:13:20 2023", "Tue Nov 14 22:60:20 2023",
    "Tue Nov 14 22:13:61 2023",
    "Tue Nov 14 99:13:20 2023", "Tue Nov 14 22:13:20 22", "Tue Xyz 14 22:13:20 2023", "2023-11-14 22:13:20", "x" } do
    local found, said = frames(HEAD:gsub(good:gsub("%.", "%%."), date) .. frame)
    lu.assertEquals({ found[1].seconds, found[1].nanoseconds, #said }, { 0, 500000000, 1 }, date)
    lu.assertStrContains(said[1], "line 1: no such date: times count from the date before, or from 0.")
    lu.assertStrContains(said[1], ('"%s"'):format(("date " .. date):sub(1, 50)))
    found, said = frames(HEAD .. "Begin Triggerblock " .. date .. "\n" .. frame)
    lu.assertEquals({ found[1].nanoseconds, #said }, { 501000000, 1 }, date)
    lu.assertStrContains(said[1], "line 4: no such date")
  end
  for _, line in ipairs { "Begin Triggerblock", "Begin Triggerblock ", "Begin Triggerblock " .. good,
    "date " .. good } do
    local found, said = frames(HEAD .. line .. "\n" .. frame)
    lu.assertEquals({ #found, #said }, { 1, 0 }, line)
  end
  for length, count in pairs { [64] = 0, [65] = 1 } do -- characters of a date
    local spaces = (" "):rep(length - #good + 1)
    local _, said = frames(HEAD .. "Begin Triggerblock " .. good:gsub(" 2023", spaces .. "2023") .. "\n" .. frame)
    lu.assertEquals(#said, count, length)
  end
end

function T.test_several_channels_in_the_first_lines()
  local function has_several(...)
    local lines = HEAD
    for i, channel in ipairs { ... } do lines = lines .. ("%d.5 %d 8404000x Rx d 0\n"):format(i, channel) end
    return asc.open(file_of(lines), print).has_several
  end
  lu.assertEquals({ has_several(), has_several(2), has_several(2, 2), has_several(1, 2, 1), has_several(1, 1, 3) },
    { false, false, false, true, true })
  local fd = "   0.00%d CANFD   %d Rx   0x       1 0 7 7 01 A5 00 FD 7F FD 7F\n"
  lu.assertTrue(asc.open(file_of(HEAD .. fd:format(3, 1) .. fd:format(4, 2)), print).has_several)
  lu.assertFalse(asc.open(file_of(HEAD .. fd:format(3, 2) .. fd:format(4, 2)), print).has_several)
end

-- Negative stamps, in front of a trigger; without a date the first one must not be in front of 1970;
-- a stamp of ten digits is the time since 1970.
function T.test_stamps_without_a_date()
  local function whole(text)
    local list = {}
    for i, record in ipairs(frames(text)) do list[i] = ("%d.%09d"):format(record.seconds, record.nanoseconds) end
    return table.concat(list, " ")
  end
  local lines = "-1.5 1 123 Rx d 0\n-0.000001 1 123 Rx d 0\n0.25 1 123 Rx d 0\n"
  lu.assertEquals(whole(lines), "0.500000000 1.999999000 2.250000000")
  lu.assertEquals(times(HEAD .. lines), "-2.501000000 0.000999000 0.251000000")
  lu.assertEquals(whole("0.25 1 123 Rx d 0\n3 1 123 Rx d 0\n"), "0.250000000 3.000000000")
  for _, head in ipairs { "", HEAD } do
    lu.assertEquals(whole(head .. "1700000000.25 1 123 Rx d 0\n"), "1700000000.250000000")
  end
  lu.assertEquals(whole("base hex timestamps relative\n0.5 1 1 Rx d 0\n0.5 1 1 Rx d 0\n"), "0.500000000 1.000000000")
end

-- Nanoseconds of relative stamps add up: 1000 lines are 0.6 ms.
function T.test_relative_stamps_of_nanoseconds()
  local found = frames("base hex timestamps relative\n" .. ("0.001000600 1 123 Rx d 0\n"):rep(1000))
  lu.assertEquals({ #found, found[1].nanoseconds, found[5].nanoseconds }, { 1000, 1000000, 5003000 })
  lu.assertEquals({ found[1000].seconds, found[1000].nanoseconds }, { 1, 600000 })
  found = frames("base hex timestamps relative\n" .. ("0.001000 1 123 Rx d 0\n"):rep(1000))
  lu.assertEquals({ found[1000].seconds, found[1000].nanoseconds }, { 1, 0 })
end

-- Without a base, that in which more lines are frames.
-- Editors of Windows put it in front of UTF-8, whatever the head.
function T.test_a_byte_order_mark()
  local frame = "0.1 1 8404000x Rx d 1 A2\r\n"
  for _, head in ipairs { HEAD, "base hex  timestamps absolute\n", "", "// remark\n" } do
    local plain, marked = frames(head .. frame .. frame), frames("\239\187\191" .. head .. frame .. frame)
    lu.assertEquals(#plain, 2)
    lu.assertEquals(#marked, 2)
    for i, one in ipairs(plain) do
      lu.assertEquals({ marked[i].seconds, marked[i].bytes }, { one.seconds, one.bytes })
    end
  end
end

function T.test_base_without_a_head()
  for line, data in pairs { ["Rx d 2 10 11"] = "\16\17",
    ["Rx d 2 160 11"] = "\160\11", ["Rx d 2 a0 11"] = "\160\17" } do
    lu.assertEquals(frames("0.1 1 8404000x " .. line .. "\n")[1].bytes:sub(-2), data, line)
  end
end

-- The base of a file's ids and data; a clock of twelve hours, of which 12 am is the first.
function T.test_bases_and_halves_of_the_day()
  for base, line in pairs { hex = "0.5 1 8404000x Rx d 2 10 ff", dec = "0.5 1 138428416x Rx d 2 16 255" } do
    local bytes = frames((HEAD:gsub("hex", base)) .. line)[1].bytes
    lu.assertEquals({ bytes:byte(-10, -1) }, { 0, 0x40, 0x40, 0x88, 2, 0, 0, 0, 16, 255 }, base)
  end
  for text, hour in pairs { ["12:13:20.001 am"] = 0, ["1:13:20.001 am"] = 1, ["12:13:20.001 pm"] = 12,
    ["11:13:20.001 pm"] = 23 } do
    local start = os.time { year = 2023, month = 11, day = 14, hour = hour, min = 13, sec = 20 }
    local head = HEAD:gsub("22:13:20%.001", text)
    lu.assertEquals(frames(head .. "1.0 1 123 Rx d 0\n")[1].seconds, start + 1, text)
  end
end

-- They are lost packets, wherever they stand.
function T.test_damaged_lines_are_lost_packets()
  local frame, cut = "0.5 1 123 Rx d 0\n", "0.6 1 8404000x Rx d 8 BB B\n"
  local found, said, log = frames(HEAD .. cut .. frame .. cut .. "// remark\n" .. cut .. frame:rep(2) .. cut)
  local text = 'the data bytes do not fit, line skipped: "0.6 1 8404000x Rx d 8 BB B"'
  lu.assertEquals(said, { "line 4: " .. text, "line 6: " .. text, "line 8: " .. text ..
    "; further ones are not reported" })
  lu.assertEquals({ found[1].comment, found[2].comment, found[3].comment },
    { said[1], said[2] .. "\n" .. said[3], nil })
  lu.assertEquals(log.drops, { { count = 1, frame = 1, time = found[1].seconds + 0.501 },
    { count = 2, frame = 2, time = found[2].seconds + 0.501 }, { count = 1 } })
end

-- A line longer than 4096 bytes is skipped and named; no part of it is a frame.
function T.test_long_lines()
  for _, length in ipairs { 1000, 4096, 4097, 70000, 300000 } do
    local long = "//" .. ("x"):rep(length - 19) .. " 0.4 1 123 Rx d 0\n"
    local found, said = frames(HEAD .. long .. "0.5 1 123 Rx d 0\n" .. long)
    lu.assertEquals({ #found, #said }, { 1, length > 4096 and 2 or 0 }, length)
    if said[1] then
      lu.assertStrContains(said[1], 'line 4: a line longer than 4096 bytes, skipped: "//' .. ("x"):rep(48) .. '"')
      lu.assertStrContains(said[2], "line 6: ")
    end
  end
  local text = HEAD .. (("x"):rep(5000) .. "\n"):rep(1000) .. "0.5 1 123 Rx d 0\n"
  local found, said = frames(text)
  lu.assertEquals({ #found, #said }, { 1, 3 })
  lu.assertStrContains(said[3], "further ones are not reported")
end

function T.test_many_lines_and_blocks()
  local text = {}
  for i = 1, 5000 do text[i] = ("%d.000000 1 8404000x Rx d 8 BB BE 6F C7 20 00 00 00"):format(i) end
  lu.assertEquals(#frames(HEAD .. table.concat(text, "\r\n")), 5000)
  lu.assertTrue(#frames(HEAD .. ("Begin Triggerblock Tue Nov 14 22:13:20 2023\n0.1 1 123 Rx d 0\n"):rep(3000)) == 3000)
end

-- What a pattern might try again and again makes no line slow: at 4,000 characters one that is tried
-- from each of them, and to the end, takes a hundred times as long.
function T.test_no_line_is_slow()
  local fronts = { "", "0.1 1 ", "0.1 CANFD 1 Rx ", "0.1 CANFD 1 Rx 123 ", "0.1 1 123 Rx d 8 ",
    "0.1 CANFD 1 Rx 123 1 0 8 8 ", "Begin Triggerblock ", "Begin Triggerblock Tue Nov 14 22:13:20", "date Tue Nov 1" }
  for _, front in ipairs(fronts) do
    for _, unit in ipairs { " ", "0", "x", "a ", "1 ", "1  ", "Rx ", "CANFD ", ".", "0.1 " } do
      local text = HEAD .. front .. unit:rep(math.floor(4000 / #unit)) .. "!\n"
      lu.assertFalse(cpu.is_quadratic(function() frames(text) end), ("%s%s"):format(front, unit))
    end
  end
end

-- A file that is asked for may be anybody's.
function T.test_no_head_is_slow()
  for _, front in ipairs { "", "date ", "date x\nbase hex timestamps absolute" } do
    for _, unit in ipairs { "\n", " ", "\nbase", "\nbase hex ", "\n1 ", "\n1.1 1" } do
      local text = front .. unit:rep(4000)
      lu.assertFalse(cpu.is_quadratic(function() asc.open(file_of(text), print) end), ("%q%q"):format(front, unit))
    end
  end
end

return T
