-- SPDX-License-Identifier: GPL-2.0-or-later
-- What a capture file says of its packets: buses and their names, whether YAPP may be in it; of
-- files that are made here, whole, cut, damaged, and through a pipe.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local capture = require("yapp.host.capture")
local stream_generator = require("stream_generator")
local le = stream_generator.little_endian

local T = {}

-- Files -------------------------------------------------------------------------------------------

local function be(value, size) return le(value, size):reverse() end

local SECTION, INTERFACE, SIMPLE, ENHANCED = 0x0A0D0D0A, 1, 3, 6
local CAN, ETHERNET, RTAC, SLL, SLL2, EXPORTED = 227, 1, 250, 113, 276, 252

local function pcap(linktype, packets, number, magic)
  local text = { magic or number(0xA1B2C3D4, 4), number(2, 2), number(4, 2), ("\0"):rep(8),
    number(65535, 4), number(linktype, 4) }
  for i, packet in ipairs(packets) do
    local length = number(#packet, 4)
    text[#text + 1] = number(i, 4) .. number(250000, 4) .. length .. length .. packet
  end
  return table.concat(text)
end

local function block(kind, body, number)
  body = body .. ("\0"):rep(-#body % 4)
  return number(kind, 4) .. number(#body + 12, 4) .. body .. number(#body + 12, 4)
end

local function option(kind, value, number)
  return number(kind, 2) .. number(#value, 2) .. value .. ("\0"):rep(-#value % 4)
end

local function section(number)
  return block(SECTION, number(0x1A2B3C4D, 4) .. number(1, 2) .. number(0, 2) .. ("\255"):rep(8),
    number)
end

local function interface(linktype, number, options)
  return block(INTERFACE, number(linktype, 2) .. number(0, 2) .. number(0, 4) .. (options or ""),
    number)
end

-- A packet; when it was captured is in the units of its interface.
local function packet(of, bytes, number, stamp)
  stamp = stamp or 0
  local low = stamp % 2 ^ 32
  return block(ENHANCED, number(of, 4) .. number((stamp - low) / 2 ^ 32, 4) .. number(low, 4) ..
    number(#bytes, 4) .. number(#bytes, 4) .. bytes, number)
end

-- A section with interfaces of these link types, packets { interface, bytes }.
local function pcapng(linktypes, packets, number)
  local text = { section(number) }
  for _, linktype in ipairs(linktypes) do text[#text + 1] = interface(linktype, number) end
  for _, one in ipairs(packets) do text[#text + 1] = packet(one[1], one[2], number) end
  return table.concat(text)
end

local function can_over_sll2(index) return "\0\12\0\0" .. be(index, 4) .. ("\0"):rep(12 + 16) end
local function rtac(event) return ("\0"):rep(8) .. string.char(event) .. "\0\0\0bytes" end
local CAN_OVER_SLL = ("\0"):rep(15) .. "\12" .. ("\0"):rep(16)
local FD_OVER_SLL = ("\0"):rep(15) .. "\13" .. ("\0"):rep(16)
local IP_OVER_SLL2 = "\8\0\0\0" .. ("\0"):rep(60)
local FRAME = "YP\0\0\16\2\0\0\32\0\0\0" .. ("x"):rep(36)

local function none() return nil end

-- Reads a file of which so many bytes are the head; the rest comes in pieces of the same length.
local function read(file, length)
  length = length or capture.OF_A_PIPE
  local at = length
  return capture.read(file:sub(1, length), function(count)
    local piece = file:sub(at + 1, at + math.min(count, length))
    at = at + #piece
    return piece
  end)
end

-- The buses of a file's packets, "1 2 1"; "0" of one that cannot carry YAPP; "" of a file without
-- several.
local function buses(found)
  local list = {}
  for number = 1, found.has_several and found.count or 0 do
    local bus = found:bus(number)
    list[number] = bus and ("%d"):format(bus) -- of one that is cut nothing is told
  end
  return table.concat(list, " ")
end

-- Buses -------------------------------------------------------------------------------------------

function T.test_buses()
  for _, number in ipairs { le, be } do
    local rows = {
      { pcap(CAN, { "x" }, number), "" }, { pcap(ETHERNET, { "x" }, number), "" },
      { pcap(SLL2, { can_over_sll2(3), can_over_sll2(3) }, number), "" },
      { pcap(SLL2, { can_over_sll2(3), IP_OVER_SLL2, can_over_sll2(7), can_over_sll2(3) }, number),
        "1 0 2 1" },
      { pcap(SLL2, { can_over_sll2(3), can_over_sll2(2 ^ 31 + 3) }, number), "1 2" },
      { pcap(SLL2 + 0x10000000, { can_over_sll2(3), can_over_sll2(4) }, number), "1 2" },
      { pcap(RTAC, { rtac(1), rtac(2), rtac(3), rtac(4), rtac(9), "x" }, number), "1 2 1 2 1 1" },
      { pcap(RTAC, { rtac(2), rtac(4) }, number), "" },
      { pcap(SLL, { CAN_OVER_SLL, FD_OVER_SLL }, number), "" },
      { pcapng({ CAN }, { { 0, "x" } }, number), "" },
      { pcapng({ CAN, CAN }, { { 1, "x" }, { 0, "x" }, { 1, "x" } }, number), "2 1 2" },
      { pcapng({ ETHERNET, ETHERNET, CAN }, { { 0, "x" }, { 2, "x" } }, number), "" },
      { pcapng({ ETHERNET, CAN, 162 }, { { 0, "x" }, { 2, "x" }, { 1, "x" } }, number), "0 2 1" },
      { pcapng({ EXPORTED, 147 }, { { 0, "x" } }, number), "1" },
      { pcapng({ SLL2, CAN }, { { 0, can_over_sll2(5) }, { 0, can_over_sll2(6) }, { 1, "x" } },
        number), "2 3 1" },
      { pcapng({ SLL2, SLL2 }, { { 0, can_over_sll2(5) }, { 1, can_over_sll2(5) } }, number),
        "1 2" },
      { pcapng({ SLL }, { { 0, CAN_OVER_SLL }, { 0, FD_OVER_SLL } }, number), "" },
      { pcapng({ SLL, SLL }, { { 0, CAN_OVER_SLL }, { 1, FD_OVER_SLL } }, number), "1 2" },
      -- no such interface
      { pcapng({ CAN, CAN }, { { 0, "x" }, { 7, "x" }, { 1, "x" } }, number), "1 0 2" },
    }
    for i, row in ipairs(rows) do
      for _, length in ipairs { 100000, 64, 7 } do
        local found = read(row[1], length)
        lu.assertEquals({ buses(found), found.has_several }, { row[2], row[2] ~= "" },
          ("row %d, %d"):format(i, length))
        lu.assertTrue(found.is_told)
      end
    end
  end
end

-- Each section has its own order of bytes, and numbers its interfaces from 0; some come behind
-- packets.
function T.test_sections_and_interfaces_that_come_late()
  local first = section(le) .. interface(CAN, le, option(2, "can0", le)) .. packet(0, "x", le)
  local found = read(first .. interface(CAN, le, option(2, "can1", le)) .. packet(1, "x", le) ..
    packet(0, "x", le) ..
    section(be) .. interface(ETHERNET, be) .. interface(CAN, be, option(2, "can2", be)) ..
    packet(0, "x", be) .. packet(1, "x", be) .. section(le) .. packet(0, "x", le))
  lu.assertEquals({ buses(found), found.names }, { "1 2 1 0 3 0", { "can0", "can1", "can2" } })
  found = read(first .. first) -- as when two files are put one behind the other
  lu.assertEquals(buses(found), "1 2")
end

-- Packets of other kinds count; other blocks do not.
function T.test_other_blocks()
  for kind, is_packet in pairs { [SIMPLE] = true, [4] = false, [5] = false, [0x0BAD] = false, [0x80000000] = false } do
    local found = read(section(be) .. interface(CAN, be) .. interface(CAN, be) ..
      packet(1, "x", be) ..
      block(kind, ("\0"):rep(60), be) .. packet(0, "x", be))
    lu.assertEquals(buses(found), is_packet and "2 0 1" or "2 1", kind)
  end
end

-- A read filter shifts the numbers: Wireshark's time of a packet is another than the file's.
function T.test_the_time_tells_whether_a_number_is_still_this_packets()
  local seconds = 1700000000.25
  for exponent, per_second in pairs { ["\6"] = 1e6, ["\3"] = 1e3, ["\138"] = 2 ^ 10, ["\0"] = 1,
    ["\9"] = 1e9 } do
    for _, number in ipairs { le, be } do
      local options = option(9, exponent, number)
      local function at(time) return math.floor(time * per_second + 0.5) end
      local found = read(section(number) .. interface(CAN, number, options) ..
        interface(CAN, number, options) ..
        packet(1, "x", number, at(seconds)) .. packet(0, "x", number, at(seconds + 5)))
      local captured = at(seconds) / per_second
      lu.assertEquals({ found:bus(1, captured), found:bus(1, captured + 1e-6), found:bus(1) },
        { 2, 2, 2 })
      lu.assertNil(found:bus(2, captured))
      lu.assertNil(found:bus(1, captured + 5))
      lu.assertEquals(found:bus(2, captured + 5), 1)
      lu.assertNil(found:bus(3))
    end
  end
  for magic, per_second in pairs { ["\212\195\178\161"] = 1e6, ["\77\60\178\161"] = 1e9 } do
    local found = read(pcap(SLL2, { can_over_sll2(1), can_over_sll2(2) }, le, magic))
    lu.assertEquals({ found:bus(1, 1 + 250000 / per_second),
      found:bus(2, 2 + 250000 / per_second) }, { 1, 2 })
    lu.assertNil(found:bus(2, 1 + 250000 / per_second))
  end
end

function T.test_nanosecond_pcap()
  for magic, number in pairs { ["\77\60\178\161"] = le, ["\161\178\60\77"] = be } do
    lu.assertEquals(buses(read(pcap(SLL2, { can_over_sll2(1), can_over_sll2(2) }, number, magic))),
      "1 2")
  end
end

-- Names -------------------------------------------------------------------------------------------

function T.test_names_of_interfaces()
  for _, number in ipairs { le, be } do
    local comment, ended = option(1, "a comment", number), option(0, "", number)
    local function named(name) return option(2, name, number) end
    local file = section(number)
    for _, options in ipairs { named("can0") .. ended, "", comment .. named("vcan12"),
      named("m\195\188") .. ended,
      named("\255"), named("a\1b"), named(""), ended .. named("behind the end"), named("end\0\0\0"),
      comment .. number(2, 2) .. number(60000, 2) .. "cut", named("can9") } do
      file = file .. interface(CAN, number, options)
    end
    local names = { "can0", nil, "vcan12", "m\195\188", nil, nil, nil, nil, "end", nil, "can9" }
    lu.assertEquals(read(file).names, names)
    for length = 0, #file do lu.assertTable(read(file:sub(1, length)).names) end
  end
end

function T.test_the_name_of_the_only_interface()
  local function names_of(...)
    local file = section(le)
    for i, linktype in ipairs { ... } do
      file = file .. interface(linktype, le, option(2, "n" .. i, le))
    end
    local found = read(file)
    return { found.own_name or "-", found.only_name or "-" }
  end
  lu.assertEquals(names_of(ETHERNET, CAN), { "n2", "-" })
  lu.assertEquals(names_of(CAN, ETHERNET), { "n1", "-" })
  lu.assertEquals(names_of(CAN, CAN), { "-", "-" })
  lu.assertEquals(names_of(ETHERNET), { "-", "n1" })
  lu.assertEquals(names_of(CAN), { "n1", "n1" })
  lu.assertEquals(names_of(ETHERNET, SLL), { "n2", "-" }) -- may carry CAN
end

-- Other people's files, and damaged ones ----------------------------------------------------------

function T.test_whether_frames_may_be_in_tcp_and_udp()
  local rows = {
    { "", true }, { "some other file", true },                                  -- nothing known
    { pcap(ETHERNET, {}, le), true }, { pcapng({ ETHERNET }, {}, le), true },   -- a live capture
    { pcap(ETHERNET, { ("x"):rep(60) }, le), false },
    { pcap(ETHERNET, { "noise" .. FRAME }, le), true },
    -- no plausible header
    { pcap(ETHERNET, { "YP" .. ("x"):rep(60) }, le), false },
    { pcap(ETHERNET, { "YP YPYP" .. FRAME }, le), true },
    { pcap(ETHERNET, { "YP\0\0\16\8\0\0\32\0\0\0" .. ("x"):rep(36) }, le), false }, -- ID above 2047
    { pcapng({ ETHERNET }, { { 0, ("x"):rep(60) } }, be), false },
    { pcapng({ ETHERNET }, { { 0, FRAME } }, be), true },
  }
  for i, row in ipairs(rows) do
    lu.assertEquals(read(row[1]).may_have_frames, row[2], "row " .. i)
  end
end

-- Whether a live capture of ours may have just begun: its interfaces may come later.
function T.test_captures_that_begin()
  local rows = {
    { pcapng({}, {}, le), true }, { pcapng({ CAN }, {}, le), true },
    { pcapng({ ETHERNET, 252 }, {}, be), true },
    { pcapng({ CAN }, { { 0, "x" } }, le), false }, { pcapng({ SLL2 }, {}, be), true },
    { pcapng({ SLL }, {}, be), true }, { pcapng({ SLL2 }, { { 0, IP_OVER_SLL2 } }, be), false },
    { pcapng({ ETHERNET }, {}, le), false }, { pcap(CAN, {}, le), false }, { "", false },
  }
  for at, row in ipairs(rows) do lu.assertEquals(read(row[1]).begins, row[2], "row " .. at) end
end

-- Of somebody else's file no more is read than its first packet.
function T.test_other_peoples_files_are_left_alone()
  local long = ("x"):rep(100000)
  for _, file in ipairs { pcapng({ ETHERNET }, { { 0, long }, { 0, long } }, le),
    pcap(ETHERNET, { long }, le),
    pcap(CAN, { long, long }, le), "LOGG" .. long, long } do
    local asked = 0
    local found = capture.read(file:sub(1, capture.OF_A_PIPE), function()
      asked = asked + 1
      return nil
    end)
    lu.assertEquals({ asked, found.has_several, buses(found) }, { 0, false, "" })
  end
  local blf, plain = read("LOGG" .. long), read(pcap(CAN, { "x" }, le))
  lu.assertEquals({ blf.is_told, plain.is_told, plain.place }, { false, true, 8 })
  lu.assertNil(read(pcap(SLL2, { can_over_sll2(1) }, le)).place)
  lu.assertEquals(read(pcap(CAN, {}, le)).place, 8) -- before its first packet
end

-- It must not raise, nor run for ever, and what it says of the packets in front stays right.
function T.test_every_cut()
  local files = { pcapng({ CAN, CAN }, { { 1, FRAME }, { 0, "x" } }, le),
    pcap(SLL2, { can_over_sll2(1), can_over_sll2(2) }, be), pcap(RTAC, { rtac(1), rtac(2) }, le),
    "\10\13\13\10" .. ("\0"):rep(40) }
  for _, file in ipairs(files) do
    local whole = buses(read(file))
    for length = 0, #file do
      for _, head in ipairs { 100000, 8 } do
        local found = buses(read(file:sub(1, length), head))
        lu.assertTrue(found == "" or found == whole:sub(1, #found), found)
      end
    end
  end
end

function T.test_lengths_that_are_nonsense()
  local random, two = stream_generator.random(11),
    pcapng({ CAN, CAN }, { { 1, "x" }, { 0, "x" } }, le)
  for _, length in ipairs { 0, 4, 8, 11, 13, 2 ^ 31, 2 ^ 32 - 1, 2 ^ 32 - 4 } do
    lu.assertEquals(buses(read(two .. le(6, 4) .. le(length, 4) .. ("\0"):rep(40))):sub(1, 3),
      "2 1")
    lu.assertEquals(buses(read(two .. le(6, 4) .. le(48, 4) .. le(0, 4) .. ("\0"):rep(8) ..
      le(length, 4) ..
      le(length, 4) .. ("\0"):rep(20))), "2 1 1")
    local cooked = pcap(SLL2, { can_over_sll2(1), can_over_sll2(2) }, le)
    local record = ("\0"):rep(8) .. le(length, 4) .. ("\0"):rep(24)
    lu.assertEquals(buses(read(cooked .. record)):sub(1, 3), "1 2")
  end
  for _ = 1, 2000 do -- whatever is damaged: an answer
    local bytes = {}
    for at = 1, #two do
      bytes[at] = random(30) == 1 and string.char(random(256) - 1) or two:sub(at, at)
    end
    lu.assertBoolean(read(table.concat(bytes), 50).has_several)
  end
end

-- Nothing behind the first bytes of a pipe is read: what they say of their packets is told.
function T.test_a_pipe()
  local packets = {}
  for i = 1, 5000 do packets[i] = { i % 2, ("x"):rep(16) } end
  local file = pcapng({ CAN, CAN }, packets, le)
  local found = capture.read(file:sub(1, capture.OF_A_PIPE), none)
  lu.assertTrue(found.has_several)
  lu.assertTrue(found.count > 1000 and found.count < 5000, found.count)
  lu.assertEquals({ found:bus(1), found:bus(2), found:bus(found.count) },
    { 2, 1, found.count % 2 + 1 })
  lu.assertNil(found:bus(found.count + 1))
  lu.assertEquals(read(file).count, 5000)
end

return T
