-- candump text: every form of line, which files are taken, times, buses, what is told of broken lines.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local candump = require("yapp_candump")

local function bytes(hex)
  return (hex:gsub("%s", ""):gsub("%x%x", function(h) return string.char(tonumber(h, 16)) end))
end

-- A file in memory as Wireshark gives it: reads in order, goes back to its start unless it is a pipe.
local function memory_file(text, is_pipe, buffer)
  local file = { pos = 0, largest = 0 }
  function file:read(count)
    local part = text:sub(self.pos + 1, self.pos + count)
    self.pos = self.pos + #part
    return part ~= "" and part or nil
  end
  function file:seek(_, offset)
    if is_pipe and self.pos > buffer then return nil, "Illegal seek" end
    self.pos = offset
    return offset
  end
  return file
end

local function opened(text, all, by_value)
  local told = {}
  local file = memory_file(text)
  local log = candump.open(file, all, function(message) told[#told + 1] = message end, by_value)
  return log, file, told
end

-- All frames of a text, with their offsets in `offset`.
local function frames_of(text, all)
  local log, file, told = opened(text, all)
  local frames = {}
  if not log then return nil, told end
  local record, offset = candump.read(log, file)
  while record do
    record.offset = offset
    frames[#frames + 1] = record
    record, offset = candump.read(log, file)
  end
  return frames, told, log
end

local function column(frames, name)
  local values = {}
  for i, frame in ipairs(frames) do values[i] = frame[name] end
  return values
end

local T = {}

-- Line, then what it must give: bus, id with SocketCAN's flags, data in hex, and fields that are not the usual ones.
local LINES = {
  { "(1700000000.000001) can0 08404000#BBBE6FC720000000", "can0", 0x88404000, "BBBE6FC720000000",
    { seconds = 1700000000, nanoseconds = 1000, relative = false } },
  { "(1700000000.000000001) vcan12 123#", "vcan12", 0x123, "", { seconds = 1700000000, nanoseconds = 1 } },
  { "(12.5) can0 7ff#aBcD", "can0", 0x7FF, "ABCD", { seconds = 12, nanoseconds = 500000000 } },
  { "(1.000000)  can0 123#11.22.33", "can0", 0x123, "112233" },
  { "(1.000000) can0 123#11 R", "can0", 0x123, "11", { sent = false } },
  { "(1.000000) can0 123#11 T\r", "can0", 0x123, "11", { sent = true } },
  { "(1.000000) can0 123#R", "can0", 0x40000123, "", { length = 0 } },
  { "(1.000000) can0 08404000#R8 T", "can0", 0xC8404000, "0000000000000000", { length = 8, sent = true } },
  { "(1.000000) can0 123#R8_F", "can0", 0x40000123, "0000000000000000", { raw_dlc = 15 } },
  { "(1.000000) can0 123#1122334455667788_E", "can0", 0x123, "1122334455667788", { raw_dlc = 14 } },
  { "(1.000000) can0 123##5112233445566778899AABBCC R", "can0", 0x123, "112233445566778899AABBCC",
    { fd = true, flags = 5 } },
  { "(1.000000) can0 123##0", "can0", 0x123, "", { fd = true } },
  { "(1.000000) can0 20000004#0008000000000000", "can0", 0x20000004, "0008000000000000" },
  { "  can0  08404000   [8]  BB BE 6F C7 20 00 00 00", "can0", 0x88404000, "BBBE6FC720000000" },
  { "can0\t08404000\t[8]\tBB\tBE\t6F\tC7\t20\t00\t00\t00\t", "can0", 0x88404000, "BBBE6FC720000000" },
  { "  can0       7FF   [0] ", "can0", 0x7FF, "" },
  { "  can0  08404000  [08]  BB BE 6F C7 20 00 00 00", "can0", 0x88404000, "BBBE6FC720000000", { fd = true } },
  { "  can0  123   [2]  remote request", "can0", 0x40000123, "0000", { length = 2 } },
  { "  can0  20000004   [8]  00 08 00 00 00 00 00 00   ERRORFRAME", "can0", 0x20000004, "0008000000000000" },
  { "  can0  123   [3]  41 42 43                  'ABC'", "can0", 0x123, "414243" },
  { "  can0  123   [3]  27 20 27                  '' ''", "can0", 0x123, "272027" },
  { "  can0  123   [1]  23                        '#'", "can0", 0x123, "23" },
  { "  can0  123   [3]  43`42`41                  `CBA`", "can0", 0x123, "414243" },
  { "  can0  123   [2]  00000001 11111110", "can0", 0x123, "01FE" },
  { "  can0  123   [2]  00000001`11111110", "can0", 0x123, "FE01" },
  { "  can0  123   [1]  10101010", "can0", 0x123, "AA" },
  { "  can0  123   {E}  01 02 03 04 05 06 07 08", "can0", 0x123, "0102030405060708", { raw_dlc = 14, length = 8 } },
  { "  can0  123   {2}  01 02", "can0", 0x123, "0102", { raw_dlc = 0, length = 2 } },
  { " (000.000499)  can0  TX B E       123  [12]  00 01 02 03 04 05 06 07 08 09 0A 0B", "can0", 0x123,
    "000102030405060708090A0B", { fd = true, flags = 3, sent = true, nanoseconds = 499000, relative = true } },
  { " (0000000007.000001)  can0  RX - -  123   [1]  01", "can0", 0x123, "01", { seconds = 7, relative = false } },
  { "  \27[1m\27[34mcan0\27[0m  123   [1]  01", "can0", 0x123, "01" },
  { " \27[1m\27[34m(1700000000.000001)  can0  123   [1]  01\27[0m", "can0", 0x123, "01" },
}

function T.test_every_form_of_line()
  for _, row in ipairs(LINES) do
    local record, why = candump.parse(row[1])
    lu.assertNotNil(record, row[1] .. ": " .. tostring(why))
    lu.assertEquals({ record.bus, record.id, record.data, record.note }, { row[2], row[3], bytes(row[4]) }, row[1])
    local usual = { fd = false, flags = 0, raw_dlc = 0, sent = false, length = #record.data }
    for name, value in pairs(row[5] or {}) do usual[name] = value end
    for name, value in pairs(usual) do lu.assertEquals(record[name], value, row[1] .. ": " .. name) end
  end
end

-- Line, and a word of the reason, nil for lines that belong to the one above.
local OTHERS = {
  { "", "empty" }, { " \t\r", "empty" }, { "# remark", "comment" }, { "; remark", "comment" }, { "// r", "comment" },
  { "DROPCOUNT: dropped 3 CAN frames on 'can0' socket (total drops 3)", "lost frames" },
  { "\tcontroller-problem{tx-error-warning}" }, { "\tbus-error\27[0m" }, { "\terror-counter-tx-rx{{96}{127}}" },
  { "\tsomething else", "not a candump line" },
  { "(1.000000) can0 84", "not a candump line" },
  { "(1.000000) can0 1234#11", "CAN id" }, { "(1.000000) can0 800#11", "CAN id" },
  { "(1.000000) can0 40000000#11", "CAN id" }, { " (1.000000)  can0  FFF   [1]  11", "CAN id" },
  { "(1.000000) can0 123#1", "data bytes" }, { "(1.000000) can0 123#1G", "data bytes" },
  { "(1.000000) can0 123#112233445566778899", "data bytes" }, { "(1.000000) can0 123#R9", "data bytes" },
  { "(1.000000) can0 123##", "data bytes" }, { "(1.000000) can0 123##0" .. ("11"):rep(65), "data bytes" },
  { "(1.000000) can0 00123#81:00:12345678#112233", "CAN XL" },
  { "(1234567890123.000000) can0 123#11", "time" }, { " (2023-13-01 00:00:00.000000)  can0  123   [1]  11", "time" },
  { " (soon)  can0  123   [1]  11", "time" },
  { " (1.000000)  can0  123   [2]  11", "data bytes" }, { " (1.000000)  can0  123   [2]  11 22 33", "data bytes" },
  { " (1.000000)  can0  123   [9]  11 22 33 44 55 66 77 88 99", "data bytes" },
  { "  can0  123   [2]  11 22 and more", "not a candump line" },
  { "see 123 [1] for more", "data bytes" },
  { ("x"):rep(5000), "longer" },
}

function T.test_lines_without_a_frame()
  for _, row in ipairs(OTHERS) do
    local record, why = candump.parse(row[1])
    lu.assertNil(record, row[1])
    if row[2] then
      lu.assertStrContains(tostring(why), row[2], false, false, row[1])
    else
      lu.assertNil(why, row[1])
    end
  end
end

function T.test_local_time_with_date()
  local record = candump.parse(" (2023-11-14 22:13:20.000001)  can0  123   [1]  11")
  lu.assertEquals(os.date("%Y-%m-%d %H:%M:%S", record.seconds), "2023-11-14 22:13:20")
  lu.assertEquals({ record.nanoseconds, record.relative }, { 1000, false })
end

function T.test_letters_that_look_like_digits()
  local record = candump.parse("can0\t0840C000\t[8]\tD2\t\208\151C\t\206\149O\t4E\t$\\odot \\odot$\t00\t05\tFF\t")
  lu.assertEquals(record.data, bytes("D23CE04E000005FF"))
  lu.assertStrContains(record.note, "look like hex digits")
end

function T.test_text_behind_a_frame_is_told()
  local record = candump.parse("(1.000000) can0 123#11 at the gate")
  lu.assertEquals({ record.data, record.note }, { "\17", "text behind the frame, ignored" })
end

local HEAD = "(1700000000.000001) can0 123#11\n"

function T.test_plain_logs_are_left_to_the_builtin_reader()
  for _, text in ipairs { HEAD, HEAD .. "(1700000000.000002) can0 00000123#", HEAD:gsub("\n", "\r\n"),
    HEAD .. "(1.000000) can0 123#R4\n(1.000000) can0 123##3112233445566778899AABBCC\n", HEAD:rep(100000) } do
    lu.assertNil((opened(text)), text:sub(1, 200))
    lu.assertNotNil((opened(text, true)), text:sub(1, 200))
  end
end

-- One line each that the built-in reader of some version gets wrong.
local DEVIATIONS = {
  "", " ", "# remark", "(1.000000) can1 123#11", "(1.000000)  can0 123#11", "(1.000000) can0 123#11 ",
  "(1.000000) can0 123#11 R", "(1.000000) can0 123#1", "(1.000000) can0 123#11.22", "(1.000001000) can0 123#11",
  "(1.5) can0 123#11", "(1.000000) can0 123##011223344556677889", "(1.000000) can0 123#112233445566778899", "text",
  "(1.000000) can0 1234#11", "(1.000000) can0 1122334455667788_E", " (1.000000) can0 123#11", ("x"):rep(3000000),
}

function T.test_a_deviation_anywhere_is_seen()
  for _, line in ipairs(DEVIATIONS) do
    local name = line:sub(1, 60)
    lu.assertNotNil((opened(HEAD .. line .. "\n" .. HEAD)), name)
    lu.assertNotNil((opened(HEAD:rep(1000) .. line .. "\n" .. HEAD)), name)
  end
  lu.assertNotNil((opened(HEAD:rep(600000) .. DEVIATIONS[4] .. "\n" .. HEAD)))
end

-- The reader of Wireshark 4.6 takes an id up to 7FF for a standard one and an error frame for an extended one.
function T.test_ids_that_a_reader_by_value_gets_wrong()
  for _, id in ipairs { "00000000", "000007FF", "000007ff", "20000004", "20000088" } do
    local text = HEAD .. "(1700000000.000002) can0 " .. id .. "#11\n"
    lu.assertNil((opened(text)), id)
    lu.assertNotNil((opened(text, false, true)), id)
  end
  for _, id in ipairs { "000", "7FF", "00000800", "1FFFFFFF", "08404000" } do
    lu.assertNil((opened(HEAD .. "(1700000000.000002) can0 " .. id .. "#11\n", false, true)), id)
  end
end

function T.test_no_frame_is_lost_after_looking_ahead()
  local text = HEAD:rep(3000) .. "(1.000000) can1 124#22"
  local frames = frames_of(text)
  lu.assertEquals(#frames, 3001)
  lu.assertEquals({ frames[3001].id, frames[3001].offset }, { 0x124, 3000 * #HEAD })
end

function T.test_a_pipe_that_cannot_be_rewound_is_taken()
  for _, lines in ipairs { 3000, 20000 } do
    local file = memory_file(HEAD:rep(lines), true, 65536)
    local log, count = candump.open(file, false), 0
    while candump.read(log, file) do count = count + 1 end
    lu.assertEquals(count, lines)
  end
  lu.assertNil(candump.open(memory_file(HEAD:rep(1000), true, 65536), false))
end

-- Texts of other programs, none of which may be taken.
local FOREIGN = {
  "", "\n\n\n", "hello\n", "\0\1\2\3", HEAD .. "\0", ("\255"):rep(5000), ("x"):rep(100000),
  "time,id,dlc,data\n0.1,123,8,11 22 33 44 55 66 77 88\n",
  "timestamp,arbitration_id,extended,remote,error,dlc,data\n1.2,0x123,0,0,0,2,ESI=\n",
  "date Tue Nov 14 10:13:20 pm 2023\nbase hex  timestamps absolute\nno internal events logged\n" ..
    "   0.000130 1  8404000x        Rx   d 8 BB BE 6F C7 20 00 00 00\n",
  ";$FILEVERSION=1.1\n;$STARTTIME=45244.9\n     1)       1.9  Rx         0123  2  11 22\n",
  ";$FILEVERSION=2.1\n      1     0.130 DT 1      0123 Rx -  2    11 22\n",
  "Timestamp: 1700000000.000001    ID: 123    S Rx                DL:  2    11 22\n",
  "Nov 14 22:13:20 host kernel: can0: bus-off\n", "t12321122\r", "123#1122\n",
  " (1700000000.000001)  can0  123  [2]  [SF] ln: 1    data: 11\n", "0x123 [2] 11 22\n", "can0: 123 [1]\n",
  "# Notes\n\nOn the bus we saw\n\n  can0  123   [1]  11\n\nwhich is odd. Then nothing\nhappened for a while.\n",
  "OTHER LOGGER 1.0\n" .. HEAD:rep(5), "<0x123> [2] 11 22\n", "No.     Time\n      1 0.000000 CAN 16 ID: 291\n",
}

function T.test_other_text_is_never_taken()
  for _, text in ipairs(FOREIGN) do
    lu.assertNil((opened(text)), text:sub(1, 80))
    lu.assertNil((opened(text, true)), text:sub(1, 80))
  end
end

function T.test_a_log_cut_at_its_start()
  for _, first in ipairs { "00.000001) can0 123#1122334455667788", "3#11 R", "#", "788", "3   [2]  11 22", "11 22 33",
    "2 33 ", "o. ...'", "[8]  remote request" } do
    lu.assertEquals(#(frames_of(first .. "\n" .. HEAD:rep(3)) or {}), 3, first)
  end
end

-- Cut anywhere in the first line of every capture: the rest of that line is no frame, or one without its time.
function T.test_every_form_cut_at_its_start()
  local names = assert(io.popen("ls test_captures/candump_*"))
  for name in names:lines() do
    local file = assert(io.open(name, "rb"))
    local text = file:read("*a")
    file:close()
    local all, first = #frames_of(text, true), text:find("\n", 1, true)
    if name:find("broken") or name:find("document") then first = 0 end -- two such lines; letters for digits
    for at = 2, first - 1 do
      local count = #(frames_of(text:sub(at), true) or {})
      lu.assertTrue(count == all or count == all - 1, ("%s: %d of %d frames of %q"):format(name, count, all,
        text:sub(at, first)))
    end
  end
  names:close()
end

function T.test_a_shell_in_front_of_the_frames()
  for _, lines in ipairs { "$ candump -ta can0", "$ sudo ip link set can0 up\n$ candump can0",
    "Script started on 2026-11-14 22:13:20+00:00\npi@drone:~$ ls\nrun.log\npi@drone:~$ candump -L any",
    "Enabling Logfile 'candump-2026-11-14_221320.log'", "Disabled standard output while logging.",
    "\nWarning: Console output active while logging!\nEnabling Logfile 'candump-2026-11-14_221320.log'\n" } do
    lu.assertEquals(#(frames_of(lines .. "\n" .. HEAD:rep(8)) or {}), 8, lines)
  end
end

function T.test_only_the_start_of_other_text_is_read()
  local file = memory_file(("some text\n"):rep(10000))
  lu.assertNil(candump.open(file, false))
  lu.assertEquals(file.pos, 4096)
end

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
function T.test_equal_times_since_the_first_stay()
  local stamps = {}
  for i = 0, 39 do stamps[i + 1] = ("000.%06d"):format(i - i % 2) end
  lu.assertEquals(times(frames_of(screen(stamps)))[40], "0.000038000")
end

function T.test_equal_deltas_are_added_up()
  local frames = frames_of(screen({ "000.000000", "000.010000", "000.010000", "000.010000" }))
  lu.assertEquals(times(frames)[4], "0.030000000")
end

-- Reading again at any offset gives the same record, in any order of reading.
local function assert_same_again(text)
  local frames, _, log = frames_of(text)
  local file = memory_file(text)
  local order = {}
  for i = 1, #frames do order[i] = i end
  for i = #frames, 1, -1 do order[#order + 1] = i end
  for i = 1, #frames do order[#order + 1] = i * 7919 % #frames + 1 end
  for _, i in ipairs(order) do
    local record = candump.seek_read(log, file, frames[i].offset)
    record.offset = frames[i].offset
    lu.assertEquals(record, frames[i])
  end
end

function T.test_reading_again()
  local stamps, buses = {}, {}
  for i = 1, 500 do stamps[i], buses[i] = string.format("000.%06d", i * 7919 % 1000), "can" .. i % 3 end
  assert_same_again(screen(stamps, buses))
  assert_same_again((screen(stamps, buses):gsub("can1[^\n]*\n", "%0\nbroken\n", 100)))
  assert_same_again((screen(stamps):gsub("000%.", "1700000000.")))
end

function T.test_numbers_of_buses()
  local stamps = { "000.000000", "000.000001", "000.000002", "000.000003", "000.000004", "000.000005" }
  local frames = frames_of(screen(stamps, { "can1", "any", "can0", "vcan1", "can1", "can12345" }))
  lu.assertEquals(column(frames, "number"), { 1, 0, 2, 3, 1, 4 })
  lu.assertStrContains(frames[1].comment, "Interface index 1 is can1")
  lu.assertNil(frames[5].comment)
end

function T.test_more_buses_than_any_file_has()
  local lines = {}
  for i = 1, 70000 do lines[i] = string.format("(1.000000) b%dx 123#11\n", i) end
  local frames = frames_of(table.concat(lines))
  lu.assertEquals(#frames, 70000)
  lu.assertEquals(#candump.packet(frames[70000]), 20 + 8 + 1)
end

function T.test_broken_lines_are_told_and_skipped()
  local text = HEAD .. "\n" .. HEAD .. "oh no\n" .. "(1.000000) can0 123#1\n" .. HEAD .. "# remark\n" .. HEAD
  local frames, told = frames_of(text)
  lu.assertEquals(#frames, 4)
  lu.assertEquals(told, { "line 2: an empty line, skipped", 'line 4: not a candump line, skipped: "oh no"',
    'line 5: the data bytes do not fit, line skipped: "(1.000000) can0 123#1"',
    'line 7: a comment, skipped: "# remark"' })
  lu.assertNil(frames[2].comment)
  lu.assertStrContains(frames[3].comment, "line 4: not a candump line")
  lu.assertStrContains(frames[3].comment, "line 5: the data bytes do not fit")
end

function T.test_many_broken_lines_do_not_flood()
  local frames, told = frames_of(HEAD:rep(1000) .. ("oh no\n\n"):rep(500) .. HEAD)
  lu.assertEquals(#frames, 1001)
  lu.assertEquals(#told, 8)
  lu.assertEquals(told[7], "500 times: an empty line, skipped")
  lu.assertEquals(told[8], "500 times: not a candump line, skipped")
end

function T.test_a_line_without_end_costs_its_length_only()
  local long = ("x"):rep(3000000)
  local frames, told = frames_of(HEAD .. HEAD .. long .. "\n" .. HEAD:gsub("can0", "can1") .. long)
  lu.assertEquals(column(frames, "offset"), { 0, #HEAD, 2 * #HEAD + #long + 1 })
  lu.assertEquals(#told, 2)
  lu.assertStrContains(told[1], "line 3: longer than any candump line")
  lu.assertStrContains(told[2], "line 5: longer than any candump line")
end

function T.test_a_byte_order_mark_is_passed_over()
  local frames = frames_of("\239\187\191" .. HEAD .. HEAD:gsub("can0", "can1"))
  lu.assertEquals(column(frames, "offset"), { 3, 3 + #HEAD })
  lu.assertEquals(#frames_of("\239\187\191" .. HEAD), 1)
end

function T.test_decimals()
  lu.assertEquals(opened(HEAD, true).decimals, 6)
  lu.assertEquals(opened("(1700000000.000001001) can0 123#11\n").decimals, 9)
end

-- LINUX_SLL2: protocol, reserved, ifindex, ARPHRD_CAN 280, packet type, address length and address; then SocketCAN.
function T.test_packet()
  local record = candump.parse("(1.000000) can0 08404000#BBBE6FC720000000 T")
  record.number = 258
  lu.assertEquals(candump.packet(record), bytes("000C 0000 00000102 0118 04 00 0000000000000000" ..
    "00404088 08 00 00 00 BBBE6FC720000000"))
  record.number = 0
  lu.assertEquals(candump.packet(record, true), bytes("000C 0000 00000000 0118 04 00 0000000000000000" ..
    "88404000 08 00 00 00 BBBE6FC720000000"))
end

function T.test_packet_of_can_fd_and_raw_dlc()
  local record = candump.parse("(1.000000) can3 123##5AABB R")
  record.number = 3
  lu.assertEquals(candump.packet(record), bytes("000D 0000 00000003 0118 00 00 0000000000000000" ..
    "23010000 02 05 00 00 AABB"))
  record = candump.parse("(1.000000) can3 123#1122334455667788_E")
  record.number = 3
  lu.assertEquals(candump.packet(record):sub(21, 28), bytes("23010000 08 00 00 0E"))
end

-- A seeded generator, the same in every Lua.
local function random_source(seed)
  return function(limit)
    seed = seed * 16807 % 2147483647
    return seed % limit + 1
  end
end

-- Lines with characters changed, dropped and doubled: never an error, and what is a frame makes a packet.
function T.test_damaged_lines_never_fail()
  local random, letters = random_source(42), "0 1F#[]{}()R.T`'\t\27\\x$\194\208\206\160"
  for _, row in ipairs(LINES) do
    for _ = 1, 300 do
      local line = row[1]
      for _ = 1, random(4) do
        local at, letter = random(#line), letters:sub(random(#letters))
        line = line:sub(1, at - 1) .. letter:sub(1, random(3) - 1) .. line:sub(at + random(3) - 1)
      end
      local record = candump.parse(line)
      if record then
        record.number = 0
        lu.assertEquals(#candump.packet(record), 28 + record.length, line)
      end
    end
  end
end

-- Frames of every form come back with their bytes, written as candump's lib.c writes them.
function T.test_written_frames_come_back()
  local random = random_source(7)
  for _ = 1, 500 do
    local fd, hex, log = random(2) == 1, {}, {}
    local sizes = fd and { 0, 1, 8, 12, 16, 20, 24, 32, 48, 64 } or { 0, 1, 2, 3, 4, 5, 6, 7, 8 }
    local size, id = sizes[random(#sizes)], random(0x20000000) - 1
    for i = 1, size do
      hex[i] = string.format("%02X", random(256) - 1)
      log[i] = hex[i]
    end
    local data = bytes(table.concat(hex))
    local line = string.format("(1700000000.000001) can0 %08X#%s%s", id, fd and "#1" or "", table.concat(log))
    local shown = string.format(" (1700000000.000001)  can0  %08X %s  %s", id,
      fd and string.format(" [%02d]", size) or string.format("  [%d]", size), table.concat(hex, " "))
    for _, text in ipairs { line, shown } do
      local record = candump.parse(text)
      lu.assertEquals({ record.id, record.data, record.fd }, { id + 0x80000000, data, fd }, text)
    end
  end
end

return T
