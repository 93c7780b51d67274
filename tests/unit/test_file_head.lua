-- SPDX-License-Identifier: GPL-2.0-or-later
-- What the first bytes of a capture file say: several sources or one, YAPP frames or none.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local head = require("yapp.host.file_head")

local function le(value, size)
  local bytes = {}
  for i = 1, size do bytes[i], value = string.char(value % 256), (value - value % 256) / 256 end
  return table.concat(bytes)
end

local function be(value, size) return le(value, size):reverse() end

local function pcap(linktype, packets, number, magic)
  local text = { magic or number(0xA1B2C3D4, 4), number(2, 2), number(4, 2), ("\0"):rep(8), number(65535, 4),
    number(linktype, 4) }
  for _, packet in ipairs(packets) do
    text[#text + 1] = ("\0"):rep(8) .. number(#packet, 4) .. number(#packet, 4) .. packet
  end
  return table.concat(text)
end

local function block(kind, body, number)
  body = body .. ("\0"):rep(-#body % 4)
  return number(kind, 4) .. number(#body + 12, 4) .. body .. number(#body + 12, 4)
end

-- interfaces: link types; packets: { interface, bytes }
local function pcapng(interfaces, packets, number)
  local text = { block(0x0A0D0D0A, number(0x1A2B3C4D, 4) .. number(1, 2) .. number(0, 2) .. ("\255"):rep(8), number) }
  for _, linktype in ipairs(interfaces) do
    text[#text + 1] = block(1, number(linktype, 2) .. number(0, 2) .. number(0, 4), number)
  end
  for _, packet in ipairs(packets) do
    text[#text + 1] = block(6, number(packet[1], 4) .. ("\0"):rep(8) .. number(#packet[2], 4) ..
      number(#packet[2], 4) .. packet[2], number)
  end
  return table.concat(text)
end

local CAN_OVER_SLL2 = "\0\12\0\0" .. ("\0"):rep(16) .. ("\0"):rep(16)
local CAN_OVER_SLL = ("\0"):rep(15) .. "\12" .. ("\0"):rep(16)
local IP_OVER_SLL2 = "\8\0\0\0" .. ("\0"):rep(60)
local FRAME = "YP\0\0\16\2\0\0\32\0\0\0" .. ("x"):rep(36)

local T = {}

-- file, whether it has several sources
function T.test_sources()
  for _, number in ipairs { le, be } do
    local rows = {
      { pcap(227, { "x" }, number), false },
      { pcap(1, { "x" }, number), false },
      { pcap(276, { CAN_OVER_SLL2 }, number), true },
      { pcap(276, { IP_OVER_SLL2 }, number), false },
      { pcap(250, { "x" }, number), true },
      { pcapng({ 227 }, { { 0, "x" } }, number), false },
      { pcapng({ 227, 227 }, { { 0, "x" } }, number), true },
      { pcapng({ 1, 1, 227 }, { { 0, "x" } }, number), false },
      { pcapng({ 147, 162 }, {}, number), true },
      { pcapng({ 1, 276 }, { { 0, "x" }, { 1, CAN_OVER_SLL2 } }, number), true },
      { pcapng({ 276 }, { { 0, IP_OVER_SLL2 } }, number), false },
      { pcap(276, { IP_OVER_SLL2, IP_OVER_SLL2, CAN_OVER_SLL2 }, number), true },
      { pcapng({ 113 }, { { 0, CAN_OVER_SLL } }, number), false },
      { pcapng({ 113, 113 }, { { 0, CAN_OVER_SLL }, { 0, CAN_OVER_SLL } }, number), false },
      { pcapng({ 113, 113 }, { { 0, CAN_OVER_SLL }, { 1, CAN_OVER_SLL } }, number), true },
      { pcapng({ 227, 113 }, { { 0, "x" }, { 1, CAN_OVER_SLL } }, number), true },
    }
    for i, row in ipairs(rows) do lu.assertEquals(head.read(row[1]).sources, row[2], "row " .. i) end
  end
  lu.assertTrue(head.read("LOGG....").sources)
  lu.assertEquals(head.read(pcap(227, {}, le)).place, 8)
  lu.assertNil(head.read(pcap(276, {}, le)).place)
end

function T.test_nanosecond_pcap()
  lu.assertTrue(head.read(pcap(276, { CAN_OVER_SLL2 }, le, "\77\60\178\161")).sources)
  lu.assertTrue(head.read(pcap(276, { CAN_OVER_SLL2 }, be, "\161\178\60\77")).sources)
end

-- file, whether YAPP frames may be in it
function T.test_frames()
  local rows = {
    { "", true }, -- nothing known
    { "some other file", true },
    { pcap(1, {}, le), true }, -- no packet yet: a live capture
    { pcapng({ 1 }, {}, le), true },
    { pcap(1, { ("x"):rep(60) }, le), false },
    { pcap(1, { "noise" .. FRAME }, le), true },
    { pcap(1, { "YP" .. ("x"):rep(60) }, le), false }, -- no plausible header
    { pcap(1, { "YP YPYP" .. FRAME }, le), true },
    { pcap(1, { "YP\0\0\16\8\0\0\32\0\0\0" .. ("x"):rep(36) }, le), false }, -- ID above 2047
    { pcap(1, { "YP\0\0\16\2\0\0\32\0\0\1" .. ("x"):rep(36) }, le), false }, -- reserved bytes
    { pcapng({ 1 }, { { 0, ("x"):rep(60) } }, be), false },
    { pcapng({ 1 }, { { 0, FRAME } }, be), true },
  }
  for i, row in ipairs(rows) do lu.assertEquals(head.read(row[1]).frames, row[2], "row " .. i) end
end

-- A damaged or cut file must not raise, nor run for ever.
function T.test_every_cut()
  local files = { pcapng({ 227, 227 }, { { 0, FRAME } }, le), pcap(276, { CAN_OVER_SLL2 }, be),
    "\10\13\13\10" .. ("\0"):rep(40) }
  for _, file in ipairs(files) do
    for length = 0, #file do lu.assertNotNil(head.read(file:sub(1, length))) end
  end
end

-- Whether several sources may show later: where the file goes on, and its kind can tell them apart.
function T.test_sources_that_show_later()
  local long = ("x"):rep(head.LENGTH)
  local rows = {
    { pcapng({ 227 }, { { 0, "x" } }, le), false }, { pcapng({ 227 }, { { 0, long } }, le), true },
    { pcapng({ 227 }, {}, le), true }, -- a live capture
    { pcap(227, { long }, le), false }, { pcap(1, { long }, be), false },
    { pcap(276, { IP_OVER_SLL2, long }, be), true },
    { pcap(276, { IP_OVER_SLL2 }, le), false }, { "", true },
  }
  for at, row in ipairs(rows) do
    lu.assertEquals(head.read(row[1]:sub(1, head.LENGTH)).later, row[2], "row " .. at)
  end
end

-- Whether a live capture of ours may have just begun: its interfaces may come later.
function T.test_captures_that_begin()
  local rows = {
    { pcapng({}, {}, le), true }, { pcapng({ 227 }, {}, le), true }, { pcapng({ 1, 252 }, {}, be), true },
    { pcapng({ 227 }, { { 0, "x" } }, le), false },
    { pcapng({ 276 }, {}, be), true }, { pcapng({ 113 }, {}, be), true }, -- tshark -i any
    { pcapng({ 276 }, { { 0, IP_OVER_SLL2 } }, be), false },
    { pcapng({ 1 }, {}, le), false }, -- no need for a tree
    { pcap(227, {}, le), false }, { "", false },
  }
  for at, row in ipairs(rows) do lu.assertEquals(head.read(row[1]).begins, row[2], "row " .. at) end
end

local function option(kind, value, number)
  return number(kind, 2) .. number(#value, 2) .. value .. ("\0"):rep(-#value % 4)
end

-- The section, and interfaces with these options, before packets.
-- linktypes  of those that are no SocketCAN
local function with_options(options, number, linktypes)
  local text = { pcapng({}, {}, number) }
  for i, one in ipairs(options) do
    local linktype = linktypes and linktypes[i] or 227
    text[#text + 1] = block(1, number(linktype, 2) .. number(0, 2) .. number(0, 4) .. one, number)
  end
  return table.concat(text)
end

function T.test_names_of_interfaces()
  for _, number in ipairs { le, be } do
    local comment, ended = option(1, "a comment", number), option(0, "", number)
    local function named(name) return option(2, name, number) end
    local file = with_options({
      named("can0") .. ended, "", comment .. named("vcan12"), named("m\195\188") .. ended, named("\255"),
      named("a\1b"), named(""), ended .. named("behind the end"), named("end\0\0\0"),
      comment .. number(2, 2) .. number(60000, 2) .. "cut", named("can9"),
    }, number)
    local found = head.read(file)
    lu.assertEquals(found.names, { [0] = "can0", [2] = "vcan12", [3] = "m\195\188", [8] = "end", [10] = "can9" })
    for id = 0, 10 do lu.assertEquals(found.interfaces[id], 227) end
    lu.assertNil(found.interfaces[11])
    lu.assertEquals(head.read(file .. file).names, found.names) -- in a second section the numbers begin again
    for length = 0, #file do lu.assertNotNil(head.read(file:sub(1, length)).names) end
  end
  lu.assertEquals(head.read("").names, {})
  lu.assertEquals(head.read(pcap(227, { "x" }, le)).interfaces, {})
end

function T.test_the_name_of_the_only_interface()
  local function names_of(...)
    local found = head.read(with_options({ option(2, "one", le), option(2, "two", le) }, le, { ... }))
    lu.assertNil(found.name)
    return found.own_name
  end
  lu.assertEquals(names_of(1, 227), "two") -- Ethernet and CAN
  lu.assertEquals(names_of(227, 1), "one")
  lu.assertNil(names_of(227, 227))
  lu.assertNil(names_of(1, 1))
  local alone = head.read(with_options({ option(2, "one", le) }, le, { 1 }))
  lu.assertEquals({ alone.name, alone.own_name }, { "one" })
end

-- Lines, and whether they have several buses.
function T.test_buses_of_candump_text()
  local rows = {
    { "(1.000000) can0 123#11\n(1.000000) can1 123#11\n", true },
    { "(1.000000) can0 123#11\n(1.000000) can0 123#11\n", false },
    { "cut#11\n\n# (remark)\n(1.000000) can0 123#11\r\n(1.000000) can1 123#11", true },
    { "  can0  123   [1]  11\n  vcan0  123   [1]  11\n", true }, { "  can0  123   [1]  11\n", false },
    { " (2023-11-14 22:13:20.000001)  can0  RX - -  123  [08]  11\n (000.1)  can1  TX B E  123  [08]  11\n", true },
    { "some text\n(and more) of it\n", false }, { "", false },
    { ("(1.000000) can0 123#11\n"):rep(2000) .. "(1.000000) can1 123#11\n", true },
    { "(1.000000) can0 123#11\n(1.000000) can1 123#11\n\0", false },
    { pcap(227, { "(1.000000) can0 123#11\n(1.000000) can1 123#11\n" }, le), false },
  }
  for i, row in ipairs(rows) do
    lu.assertEquals(head.read(row[1]).several_buses, row[2], "row " .. i)
  end
end

return T
