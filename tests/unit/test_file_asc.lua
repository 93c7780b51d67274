-- SPDX-License-Identifier: GPL-2.0-or-later
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local asc = require("yapp.file.asc")
local cpu = require("cpu")
local file_of = require("support").file
local text_of = require("yapp.file.text")

local T = {}

local HEAD = "date Tue Nov 14 22:13:20.001 2023\r\nbase hex  timestamps absolute\r\ninternal events logged\r\n"

local LOG = text_of.new("", true, asc.FORMAT, { base = 16 })

local function shown(line)
  local r = LOG:parse(line)
  if not r then return nil end
  local kind = (r.fd and "fd " or "") .. (r.sent and "tx " or "")
  return ("%d %s %08X %s%d %d %s"):format(r.stamp / 1000, r.bus:match("^CAN%-(%d+)$"), r.id, kind,
    r.length or #r.data, r.flags or 0,
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
    ["0.015991 CAN 1 Status:chip status error passive - TxErr: 132 RxErr: 0"] = "15991 1 20000004 8 0 0030000000000000",
    ["0.1 CAN 2 Status:chip status busoff"] = "100000 2 20000040 8 0 0000000000000000",
    ["0.1 CAN 2 Status:chip status warning level"] = "100000 2 20000004 8 0 000C000000000000",
    ["0.1 CAN 2 Status:rx queue overrun"] = "100000 2 20000004 8 0 0001000000000000",
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
    ["0.311250000 1  C0           Rx   d   2 38 FF "] = "311250 1 000000C0 2 0 38FF",
    ["594680.670895  5  1af    Rx    d 1 d3"] = "594680670895 5 000001AF 1 0 D3",
    ["999999999.999999 1 1 Rx d 0"] = "999999999999999 1 00000001 0 0 ",
    ["0.1 1 0000000123 Rx d 0"] = "100000 1 00000123 0 0 ",
    ["0.1 CANFD 1 Rx 123 0 0 f 64" .. (" 1"):rep(64)] = "100000 1 00000123 fd 64 4 " .. ("01"):rep(64),
  } do
    lu.assertEquals(shown(line), expected, line)
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
    lu.assertEquals({ LOG:parse(line) }, { nil, "known" }, line)
  end
end

-- A line that was not understood may have been a frame.
function T.test_lines_that_are_not_understood()
  for _, line in ipairs { "0.1 1 8404000x Rx d 8 BB BE", "0.1 1 8404000x Rx d 2 BB G", "0.1 1 123 Rx d",
    "0.1 1 123 Rx x 1 00",
    "0.1 1 123 Rx d 1 100", "0.1 CANFD 1 Rx 123 0 0 9 12 1 2 3", "0.1 CANFD 1 Rx 123 1 0", "0.1 1 EngineData Rx d 1",
    "0.1 CANFD 1 Rx 123 0 0 f 65" .. (" 1"):rep(65), "0.1 1 800 Rx d 0", "0.1 1 20000000x Rx d 0",
    "0.1 1 8404000x", "0.1 1", "0.1 1 8404000x Xx d 8 BB",
    "8404000x Rx d 8 BB BE", "0.1 CANFD", "x", "0x", "0.1 CANFD 1 8404000x Rx 1 0 8 8",
    "0.1 1 123456789ABx Rx d 0", "1234567890.1 1 123 Rx d 0",
    "0.1 " .. ("9"):rep(400) .. " 123 Rx d 0", "x 1 123 Rx d 0",
    "1 123 Rx d 0", "CANFD 1 Rx 123 0 0 2 2 1 2", "1 ErrorFrame" } do
    local record, kind = LOG:parse(line)
    lu.assertNil(record, line)
    lu.assertNotEquals(kind, "known", line)
  end
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
    found[#found + 1] = { bytes = record[2], seconds = record[3], nanoseconds = record[4], bus = record[5] }
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

-- The base that the head says makes a file ASC.
function T.test_what_is_asc()
  local frame = "0.1 1 123 Rx d 0"
  lu.assertEquals({ frames(HEAD), select(3, frames(HEAD)).decimals }, { {}, 6 })
  lu.assertEquals(frames(HEAD .. "0.1 1 1F Rx d 1 1A")[1].bytes:sub(-9), "\31\0\0\0\1\0\0\0\26")
  lu.assertEquals(frames(HEAD:gsub("hex", "dec") .. "0.1 1 31 Rx d 1 26")[1].bytes:sub(-9), "\31\0\0\0\1\0\0\0\26")
  for _, head in ipairs { HEAD, HEAD:gsub("hex", "dec"), "base hex timestamps absolute\n", "// remark\nbase dec\n",
    "date Mon Dec 6 11:21:13 am 2021\nbase hex  no internal events logged\n// version 7.1.0\n" } do
    lu.assertEquals(#frames(head .. frame), 1, head)
  end
  for _, text in ipairs { "", "date", "date Tue Nov 14 22:13:20 2023\n", "baseball\n", frame,
    "database hex x\n" .. frame,
    "date 2023\nbase oct timestamps absolute\n" .. frame, "(0.1) can0 123#00\n" } do
    lu.assertNil(frames(text), text)
  end
end

function T.test_times()
  local frame = "0.5 1 123 Rx d 0\n"
  lu.assertEquals(times(HEAD .. frame .. "1.25 1 123 Rx d 0\n"), "0.501000000 1.251000000")
  lu.assertEquals(times(HEAD .. "-1.5 1 123 Rx d 0\n-0.000001 1 123 Rx d 0\n"), "-2.501000000 0.000999000")
  local relative = HEAD:gsub("absolute", "relative")
  lu.assertEquals(times(relative .. "0.25 Start of measurement\n" .. frame .. frame), "0.751000000 1.251000000")
  -- Nanoseconds add up.
  lu.assertStrContains(times(relative .. ("0.001000600 1 123 Rx d 0\n"):rep(1000)), " 1.001600000")
  for month, name in ipairs { "Jan", "feb", "MAR", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec" } do
    local hour = month * 7 % 24
    local date = ("Sun %s 3 %d:05:09.004 %s 2024"):format(name, (hour + 11) % 12 + 1, hour < 12 and "am" or "pm")
    local seconds = os.time { year = 2024, month = month, day = 3, hour = hour, min = 5, sec = 9 }
    lu.assertEquals(frames("date " .. date .. "\nbase hex  timestamps absolute\n" .. frame)[1].seconds, seconds, date)
  end
  -- python-can's: the date is when the file was made.
  local block = "Begin Triggerblock Tue Nov 14 22:13:20.1 2023\n"
  lu.assertEquals(times(HEAD:gsub("2023", "2026") .. block .. frame), "0.501000000")
  -- CANoe's: a block that began 100 s later, with times since the date.
  block = "Begin Triggerblock Tue Nov 14 10:15:00.500 pm 2023\n"
  lu.assertEquals(times(HEAD .. frame .. block .. frame), "0.501000000 0.501000000") -- behind a frame times go on
  lu.assertEquals(times(HEAD .. block .. "100.5 1 123 Rx d 0\n" .. frame), "100.501000000 0.501000000")
  -- A block that begins less than 2 s from the time since the date has times since the date.
  for began, expected in pairs { ["22.500"] = "0.501000000", ["22.501"] = "3.001000000" } do
    lu.assertEquals(times(HEAD .. ("Begin Triggerblock Tue Nov 14 22:13:%s 2023\n"):format(began) .. frame), expected)
  end
end

-- A date in another language, or none: times count from the date before, or from 0, and the line is named.
function T.test_dates_that_are_not_understood()
  local good, frame = "Tue Nov 14 22:13:20.001 2023", "0.5 1 123 Rx d 0\n"
  for _, date in ipairs { "Die Okt 14 22:13:20.001 2023",
    "Tue Nov 99999999999 22:13:20.001 2023", "2023-11-14 22:13:20",
    "x" } do
    local found, said = frames(HEAD:gsub(good:gsub("%.", "%%."), date) .. frame)
    lu.assertEquals({ found[1].seconds, found[1].nanoseconds, #said }, { 0, 500000000, 1 }, date)
    lu.assertStrContains(said[1], "line 1: no such date: times count from the date before, or from 0.")
    found, said = frames(HEAD .. "Begin Triggerblock " .. date .. "\n" .. frame)
    lu.assertEquals({ found[1].nanoseconds, #said }, { 501000000, 1 }, date)
  end
end

-- They are lost packets, wherever they stand.
function T.test_damaged_lines_are_lost_packets()
  local frame, cut = "0.5 1 123 Rx d 0\n", "0.6 1 8404000x Rx d 8 BB B\n"
  local found, said, log = frames(HEAD .. cut .. frame .. cut .. "// remark\n" .. cut .. frame:rep(2) .. cut)
  local text = 'not understood, counts as a lost packet: "0.6 1 8404000x Rx d 8 BB B"'
  lu.assertEquals(said, { "line 4: " .. text, "line 6: " .. text, "line 8: " .. text ..
    "; further ones are not reported" })
  lu.assertEquals(log.drops, { { count = 1, frame = 1, time = found[1].seconds + 0.501 },
    { count = 2, frame = 2, time = found[2].seconds + 0.501 }, { count = 1 } })
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

return T
