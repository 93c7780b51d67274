-- SPDX-License-Identifier: GPL-2.0-or-later
-- The preference that names sources, and what they are called.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local catalogue = require("yapp.message.catalogue")
local sources = require("yapp.message.sources")

local T = {}

-- The name of the message that a source was said to carry.
local function message_name(s, bus, id)
  local message = s:find(bus, id)
  return message and message.name
end

-- The name that the user gave a source.
local function name_of(s, ...)
  return (select(2, s:find(...)))
end

local CATALOGUE = catalogue.compile(dofile("taurus_fields.lua"))
local NAMES = {}
for i, message in ipairs(CATALOGUE.messages) do NAMES[i] = message.name end

local function parse(text)
  return sources.parse(text, CATALOGUE)
end

function T.test_the_example()
  local s, problems = parse("0x210=motor:left_fore, 0x211=motor:left_aft, can1/0x210=motor:right_fore,528 = x ," ..
    "0x212=left_tail")
  lu.assertEquals(problems,
    { 'yapp.sources: a bus and ID once more in "528 = x"; the first part that names them holds' })
  lu.assertEquals({ name_of(s, "can0", 0x210), name_of(s, nil, 0x210), name_of(s, "can1", 0x210) },
    { "left_fore", "left_fore", "right_fore" })
  lu.assertEquals({ name_of(s, "can1", 0x211), name_of(s, "can1", 0x212) }, { "left_aft", "left_tail" })
  lu.assertEquals({ message_name(s, "can1", 0x210), message_name(s, "can9", 0x211) }, { "motor", "motor" })
  lu.assertNil(message_name(s, nil, 0x212))
  lu.assertEquals(#s.rows, 4)
end

-- Names of people, of interfaces, and those that a capture gives a bus that has none, or one with others.
function T.test_odd_names()
  local s, problems = parse([[0x300= motor :, 0x301=health:left:aft 2, 0x302=ÄÖ rotor 3, if1/0x210=a, ]] ..
    [[any#3 / 0x210 = b, a\xE2\x80\x8Bb/0x210=d, vcan/0/0x210=e, \Device\NPF_{1-2}/0x210=f, left bus / 1=g]])
  lu.assertEquals(problems, {})
  lu.assertNil(name_of(s, nil, 0x300))
  lu.assertEquals({ message_name(s, nil, 0x300), name_of(s, nil, 0x301), name_of(s, nil, 0x302),
    name_of(s, "if1", 0x210), name_of(s, "any#3", 0x210), name_of(s, [[a\xE2\x80\x8Bb]], 0x210),
    name_of(s, "vcan/0", 0x210), name_of(s, [[\Device\NPF_{1-2}]], 0x210), name_of(s, "left bus", 1) },
    { "motor", "left:aft 2", "ÄÖ rotor 3", "a", "b", "d", "e", "f", "g" })
end

function T.test_what_is_wrong_is_said_part_by_part_and_the_rest_holds()
  local s, problems = parse("0x210, 0x800=a, left/x=b, 0x210=moter:c, 5=, 1.5=r, 0x215=good, =left, 1=d;2=e, 3=f 4=g")
  lu.assertEquals(name_of(s, nil, 0x215), "good")
  lu.assertEquals(#s.rows, 1)
  local shape = 'yapp.sources: a part that is not understood in "%s"; write [BUS/]ID=[MESSAGE:]NAME or BUS=NAME'
  lu.assertEquals(problems, {
    shape:format("0x210"),
    'yapp.sources: no ID "0x800" in "0x800=a"; IDs are 0 to 0x7FF',
    'yapp.sources: no ID "x" in "left/x=b"; IDs are 0 to 0x7FF',
    'yapp.sources: no message "moter" in "0x210=moter:c"; known messages: ' .. table.concat(NAMES, ", "),
    shape:format("5="),
    'yapp.sources: no ID "1.5" in "1.5=r"; IDs are 0 to 0x7FF',
    shape:format("=left"), shape:format("1=d;2=e"), shape:format("3=f 4=g"),
  })
end

function T.test_ranges_have_a_name_for_each_id()
  local s, problems = parse("can0/0x210-0x213=motor:M1..M4, 0x200 - 0x203+ 0x000-0x003=M08..M11, " ..
    "0x300-0x302=tail, 5-5=x1..x1")
  lu.assertEquals(problems, {})
  lu.assertEquals({ name_of(s, "can0", 0x210), name_of(s, "can0", 0x213), message_name(s, "can0", 0x212) },
    { "M1", "M4", "motor" })
  lu.assertEquals({ name_of(s, nil, 0x200), name_of(s, nil, 0x203), name_of(s, nil, 0), name_of(s, nil, 3) },
    { "M08", "M11", "M08", "M11" })
  lu.assertEquals({ name_of(s, nil, 0x300), name_of(s, nil, 0x302), name_of(s, nil, 5) }, { "tail", "tail", "x1" })
  lu.assertEquals(#s.rows, 4 + 8 + 3 + 1)
end

function T.test_ranges_that_do_not_fit()
  local names = "write one name for each ID: 0x210-0x213=M1..M4"
  local s, problems = parse("0x210-0x213=M1..M3, 0x213-0x210=a, 0x100=M1..M2, 0x7FE-0x800=b, 0x5-0x6=M2..M1")
  lu.assertEquals(problems, {
    'yapp.sources: 3 names for 4 IDs in "0x210-0x213=M1..M3"; ' .. names,
    'yapp.sources: no ID in "0x213-0x210" in "0x213-0x210=a"; write the lower ID first',
    'yapp.sources: 2 names for 1 IDs in "0x100=M1..M2"; ' .. names,
    'yapp.sources: no ID "0x800" in "0x7FE-0x800=b"; IDs are 0 to 0x7FF',
    'yapp.sources: 0 names for 2 IDs in "0x5-0x6=M2..M1"; ' .. names,
  })
  lu.assertEquals(s.rows, {})
  s, problems = parse("0x1=M1..N2, 0x2=..3, 0x3=a..b") -- names as they are
  lu.assertEquals({ problems, name_of(s, nil, 1), name_of(s, nil, 2), name_of(s, nil, 3) },
    { {}, "M1..N2", "..3", "a..b" })
end

function T.test_a_bus_alone_names_every_id()
  local s, problems = parse("can0=left, can0/0x200=other, 0x210=motor:x, 0x300=health:, 10.0.0.1=y, 10.0.0.2:4001=z")
  lu.assertEquals({ name_of(s, "10.0.0.1:7", 1), name_of(s, "10.0.0.2:4001", 1) }, { "y", "z" })
  lu.assertEquals(problems, {})
  lu.assertEquals({ name_of(s, "can0", 0x7FF), name_of(s, "can0", 0x200), name_of(s, "can0", 0x210),
    name_of(s, "can1", 0x210) }, { "left", "other", "left", "x" })
  lu.assertEquals({ message_name(s, "can0", 0x210), message_name(s, "can0", 0x300) }, { "motor", "health" })
  lu.assertNil(name_of(s, "can1", 0x7FF))
  lu.assertNil(name_of(s, nil, 0x7FF))
  local row = s.rows[1]
  lu.assertEquals({ row.bus, row.id or "none", row.name }, { "can0", "none", "left" })
end

function T.test_several_ids_of_which_one_is_known_or_wrong()
  local s, problems = parse("0x210=a, 0x210+0x211=b, 0x212+0x999=c, 0x213+=d, can0=motor:e, can1=f, can1=g")
  lu.assertEquals(problems, {
    'yapp.sources: a bus and ID once more in "0x210+0x211=b"; the first part that names them holds',
    'yapp.sources: no ID "0x999" in "0x212+0x999=c"; IDs are 0 to 0x7FF',
    'yapp.sources: no ID "" in "0x213+=d"; IDs are 0 to 0x7FF',
    'yapp.sources: a message for a whole bus in "can0=motor:e"; name its ID, too',
    'yapp.sources: a bus and ID once more in "can1=g"; the first part that names them holds',
  })
  lu.assertEquals({ name_of(s, nil, 0x210), name_of(s, "can1", 5) }, { "a", "f" })
end

-- Senders, and lines with two directions.
function T.test_names_that_a_bus_has_with_others()
  local found, problems = sources.parse("192.168.1.12/0x210=motor:right, 192.168.1.13:40000/0x210=left, " ..
    "[fe80::1]/0x210=six, fe80::2/0x210=seven, [fe80::3]:14550/0x210=eight, uart0/0x210=both, " ..
    "uart1#rx/0x210=one, usb1.6/0x210=adapter, usb1.7.1/0x210=endpoint, " ..
    "0x210=health:any", CATALOGUE)
  lu.assertEquals(problems, {})
  for _, row in ipairs {
    { "192.168.1.12:40000", "right", "motor" }, { "192.168.1.12", "right", "motor" }, { "192.168.1.13:40000", "left" },
    { "192.168.1.13:40001", "any", "health" }, { "192.168.1.1", "any", "health" }, { "[fe80::1]:14550", "six" },
    { "[fe80::2]:1", "seven" }, { "[fe80::3]:14550", "eight" }, { "[fe80::3]:14551", "any", "health" },
    { "uart0#rx", "both" }, { "uart0#tx", "both" }, { "uart0", "both" }, { "uart1#rx", "one" },
    { "uart1#tx", "any", "health" }, { "usb1.6.1#rx", "adapter" }, { "usb1.6.2#tx", "adapter" },
    { "usb1.7.1#rx", "endpoint" }, { "usb1.7.2#tx", "any", "health" }, { "usb1.60.1#rx", "any", "health" },
    { "fe80::1", "six" },
  } do
    local message, name, part = found:find(row[1], 0x210)
    lu.assertEquals({ name, message and message.name, part.name }, { row[2], row[3], row[2] }, row[1])
  end
  lu.assertTrue(found:names_bus("192.168.1.13:40000"))
  lu.assertFalse(found:names_bus("192.168.1.12:40000")) -- its port has no part
end

return T
