-- SPDX-License-Identifier: GPL-2.0-or-later
-- Which files are candump text, and which of them Wireshark's own reader gets right.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local candump = require("yapp.file.candump")
local candump_text = require("candump_text")
local levels = require("levels")

local frames_of, opened, text_file = candump_text.frames_of, candump_text.opened, candump_text.file

local T = {}

local HEAD = "(1700000000.000001) can0 123#11\n"

function T.test_plain_logs_are_left_to_the_builtin_reader()
  for _, text in ipairs { HEAD, HEAD .. "(1700000000.000002) can0 00000800#",
    HEAD:gsub("\n", "\r\n"), HEAD:rep(100000) } do
    lu.assertNil((opened(text, true)), text:sub(1, 200))
    lu.assertNotNil((opened(text)), text:sub(1, 200))
  end
end

function T.test_a_log_whose_first_line_lost_its_start_opens()
  for _, rest in ipairs { "00.000001) can0 08404000#BBBE6FC720000000\n", "6FC7 R\n" } do
    lu.assertNotNil((opened(rest .. HEAD .. HEAD)), rest)
  end
end

-- One line each that the built-in reader of some version gets wrong.
local DEVIATIONS = {
  "", " ", "# remark", "(1.000000) can1 123#11", "(1.000000)  can0 123#11", "(1.000000) can0 123#11 ",
  "(1.000000) can0 123#11 R", "(1.000000) can0 123#1", "(1.000000) can0 123#11.22", "(1.000001000) can0 123#11",
  "(1.5) can0 123#11", "(1.000000) can0 123##011223344556677889", "(1.000000) can0 123#112233445566778899", "text",
  "(1.000000) can0 1234#11", "(1.000000) can0 1122334455667788_E", " (1.000000) can0 123#11",
  "(1.000000) can0 123#R4", "(1.000000) can0 123##3112233445566778899AABBCC", "(1.000000) can0 00000000#11",
  "(1.000000) can0 20000004#11", ("x"):rep(3000000),
}

function T.test_a_deviation_anywhere_is_seen()
  for _, line in ipairs(DEVIATIONS) do
    local name = line:sub(1, 60)
    lu.assertNotNil((opened(HEAD .. line .. "\n" .. HEAD, true)), name)
    lu.assertNotNil((opened(HEAD:rep(1000) .. line .. "\n" .. HEAD, true)), name)
    lu.assertEquals(opened(HEAD .. line, true) == nil, line == "", name) -- at the end, its own end is not there
  end
  lu.assertNotNil((opened(HEAD:rep(levels.size(100000, 600000)) .. DEVIATIONS[4] .. "\n" .. HEAD, true)))
end

function T.test_no_frame_is_lost_after_looking_ahead()
  local text = HEAD:rep(3000) .. "(1.000000) can1 124#22"
  local frames = frames_of(text)
  lu.assertEquals(#frames, 3001)
  lu.assertEquals({ frames[3001].offset, frames[3001].bytes:byte(21, 22) }, { 3000 * #HEAD, 0x24, 1 })
end

function T.test_a_pipe_that_cannot_be_rewound_is_taken()
  for _, lines in ipairs { 3000, 20000 } do
    local file = text_file(HEAD:rep(lines), true, 65536)
    local log, count = candump.open(file, print), 0
    while log:read(file) do count = count + 1 end
    lu.assertEquals(count, lines)
  end
  lu.assertNil(candump.open(text_file(HEAD:rep(1000), true, 65536), print))
end

-- Texts of other programs, none of which may be taken.
local FOREIGN = {
  "\255\254" .. HEAD:rep(3):gsub(".", "%0\0"),
  "", "\n\n\n", "hello\n", "\0\1\2\3", "\0003#11\n" .. HEAD:rep(3), ("\255"):rep(5000), ("x"):rep(100000),
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
  "OTHER LOGGER 1.0\n" .. HEAD:rep(5), "No.     Time\n      1 0.000000 CAN 16 ID: 291\n",
}

-- Half of its lines are damaged.
function T.test_a_damaged_log_is_taken()
  local line = "(1700000000.000001) can0 123#11"
  lu.assertNotNil((opened(line .. "\n" .. line .. "\n(17000000\n(1700000000.0000")))
  lu.assertNil((opened(line .. "\n(17000000\n(1700000000.0000")))
end

function T.test_other_text_is_never_taken()
  for _, text in ipairs(FOREIGN) do
    lu.assertNil((opened(text)), text:sub(1, 80))
    lu.assertNil((opened(text, true)), text:sub(1, 80))
  end
end

function T.test_a_shell_in_front_of_the_frames()
  for _, lines in ipairs { "candump can0", "$ candump -ta can0", "$ sudo ip link set can0 up\n$ candump can0",
    "Script started on 2026-11-14 22:13:20+00:00\npi@drone:~$ ls\nrun.log\npi@drone:~$ candump -L any",
    "Enabling Logfile 'candump-2026-11-14_221320.log'", "Disabled standard output while logging.",
    "\nWarning: Console output active while logging!\nEnabling Logfile 'candump-2026-11-14_221320.log'\n" } do
    lu.assertEquals(#(frames_of(lines .. "\n" .. HEAD:rep(8)) or {}), 8, lines)
  end
end

return T
