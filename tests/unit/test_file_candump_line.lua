-- SPDX-License-Identifier: GPL-2.0-or-later
-- A line of candump text: every form, what is no frame, the packet made of it.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local candump = require("yapp.file.candump")
local cpu = require("cpu")
local bytes = require("support").bytes
local levels = require("levels")
local text = require("yapp.file.text")

local LOG = text.new("", true, candump.FORMAT, {})

local T = {}

-- Line, then what it must give: bus, id with SocketCAN's flags, data in hex, and fields that are not the usual ones.
local LINES = {
  { "(1700000000.000001) can0 08404000#BBBE6FC720000000", "can0", 0x88404000, "BBBE6FC720000000",
    { seconds = 1700000000, nanoseconds = 1000 } },
  { "(1700000000.000000001) vcan12 123#", "vcan12", 0x123, "", { seconds = 1700000000, nanoseconds = 1 } },
  { "(12.5) can0 7ff#aBcD", "can0", 0x7FF, "ABCD", { seconds = 12, nanoseconds = 500000000 } },
  { "(1.000000) can0 123#11 R", "can0", 0x123, "11", { sent = false } },
  { "(1.000000) can0 123#11 T\r", "can0", 0x123, "11", { sent = true } },
  { "(1.000000) can0 123#R", "can0", 0x40000123, "", { length = 0 } },
  { "(1.000000) can0 08404000#R8 T", "can0", 0xC8404000, "", { length = 8, sent = true } },
  { "(1.000000) can0 123##5112233445566778899AABBCC R", "can0", 0x123, "112233445566778899AABBCC",
    { fd = true, flags = 5 } },
  { "(1.000000) can0 123##0", "can0", 0x123, "", { fd = true } },
  { "(1.000000) can0 123#112233445566778899AABBCC", "can0", 0x123, "112233445566778899AABBCC", { fd = true } },
  { "(1.000000) can0 08400000#" .. ("1F"):rep(64) .. " T", "can0", 0x88400000, ("1F"):rep(64),
    { fd = true, sent = true } },
  { "(1.000000) can0 20000004#0008000000000000", "can0", 0x20000004, "0008000000000000" },
  { "  can0  08404000   [8]  BB BE 6F C7 20 00 00 00", "can0", 0x88404000, "BBBE6FC720000000" },
  { "can0\t08404000\t[8]\tBB\tBE\t6F\tC7\t20\t00\t00\t00\t", "can0", 0x88404000, "BBBE6FC720000000" },
  { "  can0       7FF   [0] ", "can0", 0x7FF, "" },
  { "  can0  08404000  [08]  BB BE 6F C7 20 00 00 00", "can0", 0x88404000, "BBBE6FC720000000", { fd = true } },
  { "  can0  123   [2]  remote request", "can0", 0x40000123, "", { length = 2 } },
  { "  can0  20000004   [8]  00 08 00 00 00 00 00 00   ERRORFRAME", "can0", 0x20000004, "0008000000000000" },
  { "  can0  123   [3]  41 42 43                  'ABC'", "can0", 0x123, "414243" },
  { "  can0  123   [3]  27 20 27                  '' ''", "can0", 0x123, "272027" },
  { "  can0  123   [1]  23                        '#'", "can0", 0x123, "23" },
  { "<0x123> [3] 41 42 43 ", nil, 0x123, "414243" },
  { "<0x08404000> [8] bb be 6f c7 20 00 00 00 ", nil, 0x88404000, "BBBE6FC720000000" },
  { " (000.000499)  can0  TX B E       123  [12]  00 01 02 03 04 05 06 07 08 09 0A 0B", "can0", 0x123,
    "000102030405060708090A0B", { fd = true, flags = 3, sent = true, nanoseconds = 499000 } },
  { " (0000000007.000001)  can0  RX - -  123   [1]  01", "can0", 0x123, "01", { seconds = 7 } },
  { "  \27[1m\27[34mcan0\27[0m  123   [1]  01", "can0", 0x123, "01" },
  { " \27[1m\27[34m(1700000000.000001)  can0  123   [1]  01\27[0m", "can0", 0x123, "01" },
}

function T.test_every_form_of_line()
  for _, row in ipairs(LINES) do
    local record, why = LOG:parse(row[1])
    lu.assertNotNil(record, row[1] .. ": " .. tostring(why))
    lu.assertEquals({ record.bus, record.id, record.data }, { row[2], row[3], bytes(row[4]) }, row[1])
    local usual = { fd = false, flags = 0, sent = false, length = #record.data }
    local found = { fd = record.fd or false, flags = record.flags or 0, sent = record.sent or false,
      length = record.length or #record.data, seconds = record.seconds, nanoseconds = record.nanoseconds }
    for name, value in pairs(row[5] or {}) do usual[name] = value end
    for name, value in pairs(usual) do lu.assertEquals(found[name], value, row[1] .. ": " .. name) end
  end
end

-- Lines of known kinds without a frame.
local KNOWN = {
  "", " \t\r", "# remark", "; remark", "// r", "#123 [1] 11", "Enabling Logfile 'candump-2026-11-14_221320.log'",
  "DROPCOUNT: dropped 3 CAN frames on 'can0' socket (total drops 3)", "\tcontroller-problem{tx-error-warning}",
  "\tbus-error\27[0m", "\terror-counter-tx-rx{{96}{127}}", "(1.000000) can0 00123#81:00:12345678#112233",
  "(1.0) vcan12 00123#81:00:12345678# R", " (1.000000)  can0  00123   [0007] (00|81:00:12345678) 11 22",
}

-- Lines that are not understood: damaged ones, those of others, and those of candump -S, -i and -8.
local UNKNOWN = {
  "(1.000000) can0 123#1122334455667788_E", "  can0  123   {E}  01 02 03 04 05 06 07 08", "(1.000000) can0 123#R8_F",
  "  can0  123   [9]  remote request",
  "\tsomething else", "(1.000000) can0 84", "(1.000000) can0 1234#11", "(1.000000) can0 800#11",
  "(1.000000) can0 40000000#11", " (1.000000)  can0  FFF   [1]  11", "(1.000000) can0 123#1",
  "(1.000000) can0 123#1G", "(1.000000) can0 123#112233445566778899", "(1.000000) can0 123#R9",
  "(1.000000) can0 123##", "(1.000000) can0 123##0" .. ("11"):rep(65), "(1.0) can0 123#" .. ("11"):rep(13),
  "(1234567890123.000000) can0 123#11", " (soon)  can0  123   [1]  11", "(" .. ("9"):rep(400) .. ".0) can0 123#11",
  " (1.000000)  can0  123   [2]  11", " (1.000000)  can0  123   [2]  11 22 33",
  " (1.000000)  can0  123   [9]  11 22 33 44 55 66 77 88 99", "  can0  123   [2]  11 22 and more",
  "see 123 [1] for more", "(1.000000) can0 123#11.22", "(1.000000) can0 123#11 at the gate",
  " (-1.000000)  can0  123   [1]  11", "(1.000000)", "123#11", "can0 123", "can0 123#11", "  can0  123   [2]  41`42",
  "  can0  123   [1]  10101010", "can0 123 [2] \206\149\206\152 4E",
}

function T.test_lines_without_a_frame()
  for is_known, lines in pairs { [true] = KNOWN, [false] = UNKNOWN } do
    for _, line in ipairs(lines) do
      local record, kind = LOG:parse(line)
      lu.assertEquals({ record, kind == "known" }, { nil, is_known }, line)
    end
  end
end

-- What a pattern might try again and again makes no line slow: at 4,000 characters one that is tried
-- from each of them, and to the end, takes 10 ms and more, others at most 0.6 ms.
function T.test_no_line_is_slow()
  for i = 1, #LINES, levels.size(3, 1) do
    local line = LINES[i][1]
    for _, unit in ipairs { " ", "0", "x", "\t", "`", "a ", "0 ", "0  ", "(", "\27[1", "0O", "$\\odot" } do
      -- In front, behind the time, behind the id, at the end: a form may have no sign behind its id.
      for _, at in ipairs { 1, line:find(")", 1, true) or 2, (line:find("[#%[{]") or 2) + 1, #line + 1 } do
        local long = line:sub(1, at - 1) .. unit:rep(math.floor(4000 / #unit)) .. line:sub(at) .. " !"
        lu.assertFalse(cpu.is_quadratic(function() LOG:parse(long) end), ("%q at %d of %s"):format(unit, at, line))
      end
    end
  end
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
      local record = LOG:parse(line)
      if record then
        local is_remote = record.id % 0x80000000 >= text.REMOTE
        lu.assertEquals(#text.packet(0, record), 28 + (is_remote and 0 or #record.data), line)
      end
    end
  end
end

return T
