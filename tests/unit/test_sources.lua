-- SPDX-License-Identifier: GPL-2.0-or-later
-- The preference that names sources, and what they are called.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local sources = require("yapp.message.sources")

local T = {}

local MOTOR = { name = "motor", title = "Motor Data", id = 0x210 }
local HEALTH = { name = "health", title = "Health", id = 0x200 }
local CATALOGUE = { messages = { MOTOR, HEALTH }, by_id = { [0x210] = MOTOR, [0x200] = HEALTH } }

local function parse(text)
  return sources.parse(text, CATALOGUE)
end

function T.test_nothing()
  for _, text in ipairs { "", "  ", ",", " , ," } do
    local s, problems = parse(text)
    lu.assertEquals({ problems, s:list() }, { {}, {} })
    lu.assertNil(s:name("can0", 0x210))
    lu.assertNil(s:message_name(nil, 0x210))
  end
end

function T.test_the_example()
  local s, problems = parse("0x210=motor:left_fore, 0x211=motor:left_aft, can1/0x210=motor:right_fore,528 = x ," ..
    "0x212=left_tail")
  lu.assertEquals(problems, { "sources: 528 = x: this bus and ID stand there before: the first one holds" })
  lu.assertEquals({ s:name("can0", 0x210), s:name(nil, 0x210), s:name("can1", 0x210) },
    { "left_fore", "left_fore", "right_fore" })
  lu.assertEquals({ s:name("can1", 0x211), s:name("can1", 0x212) }, { "left_aft", "left_tail" })
  lu.assertEquals({ s:message_name("can1", 0x210), s:message_name("can9", 0x211) }, { "motor", "motor" })
  lu.assertNil(s:message_name(nil, 0x212))
  lu.assertTrue(s:has_name("left_tail"))
  lu.assertFalse(s:has_name("tail"))
  lu.assertEquals(#s:list(), 4)
end

function T.test_a_message_without_a_name_and_names_with_signs()
  local s, problems = parse("0x300=motor:, 0x301=health:left:aft=2, 0x302=ÄÖ rotor 3")
  lu.assertEquals(problems, {})
  lu.assertNil(s:name(nil, 0x300))
  lu.assertEquals({ s:message_name(nil, 0x300), s:name(nil, 0x301), s:name(nil, 0x302) },
    { "motor", "left:aft=2", "ÄÖ rotor 3" })
end

function T.test_another_sign_between_sources()
  local s, problems = parse("0x210=motor:left;can1/0x210=right, 0x211=a;b")
  lu.assertEquals(problems, { "sources: 0x210=motor:left;can1/0x210=right: sources are parted by commas" })
  lu.assertEquals(s:name(nil, 0x211), "a;b")
end

function T.test_buses_with_odd_names()
  local s, problems = parse([["USB, ""left"" = 1"/0x210=motor:a, vcan/0/0x210=b, \Device\NPF_{1-2}/0x210=c, "x" / 1=d]])
  lu.assertEquals(problems, {})
  lu.assertEquals({ s:name([[USB, "left" = 1]], 0x210), s:name("vcan/0", 0x210), s:name([[\Device\NPF_{1-2}]], 0x210),
    s:name("x", 1) }, { "a", "b", "c", "d" })
end

function T.test_what_is_wrong_is_said_part_by_part_and_the_rest_holds()
  local s, problems = parse('0x210, 0x800=a, left=b, 0x210=moter:c, 0x211=, "x"0x1=d, 0x212=' .. ("n"):rep(65) ..
    ', 0x213=\1, 0x214=\255, -1=q, 1.5=r, 0x215=good, "open/1=e')
  lu.assertEquals(s:name(nil, 0x215), "good")
  lu.assertEquals(#s:list(), 1)
  lu.assertEquals(problems, {
    "sources: 0x210: a source is [BUS/]ID=[MESSAGE:]NAME",
    'sources: 0x800=a: the ID "0x800" is not one of 0 .. 0x7FF',
    'sources: left=b: the ID "left" is not one of 0 .. 0x7FF',
    'sources: 0x210=moter:c: there is no message "moter", but motor, health',
    "sources: 0x211=: the name is missing",
    'sources: "x"0x1=d: a bus in quotes is followed by /',
    "sources: 0x212=" .. ("n"):rep(65) .. ": the name has more than 64 bytes",
    "sources: 0x213=\1: the name is not a text",
    "sources: 0x214=\255: the name is not a text",
    'sources: -1=q: the ID "-1" is not one of 0 .. 0x7FF',
    'sources: 1.5=r: the ID "1.5" is not one of 0 .. 0x7FF',
    'sources: "open/1=e: the quote is not closed',
  })
  local _, many = parse(("x,"):rep(1000))
  lu.assertEquals(#many, 20)
end

function T.test_labels()
  local s = parse("0x210=motor:left, can1/0x211=motor:, 0x300=tail")
  s:use_ids(CATALOGUE.by_id)
  lu.assertEquals(s:label("can0", 0x210, MOTOR), "Motor Data left")
  lu.assertEquals(s:label("can1", 0x211, MOTOR), "Motor Data 0x211 (can1)")
  lu.assertEquals(s:label(nil, 0x211, MOTOR), "Motor Data 0x211")
  lu.assertEquals(s:label("can0", 0x200, HEALTH), "Health")
  lu.assertEquals(s:label("can0", 0x300, nil), "ID 0x300 tail")
  lu.assertEquals(s:label("can0", 0x301, nil), "ID 0x301")
end

function T.test_the_id_is_shown_where_several_carry_a_message_or_it_is_not_the_default()
  local s = parse("")
  s:use_ids { [0x210] = MOTOR, [0x211] = MOTOR, [0x205] = HEALTH }
  lu.assertEquals(s:label("can0", 0x210, MOTOR), "Motor Data 0x210 (can0)")
  lu.assertEquals(s:label(nil, 0x205, HEALTH), "Health 0x205")
  s:use_ids(CATALOGUE.by_id)
  lu.assertEquals(s:label("can0", 0x210, MOTOR), "Motor Data")
end

return T
