-- SPDX-License-Identifier: GPL-2.0-or-later
-- What a capture file says of its packets: buses and their names, drops, whether YAPP may be in it;
-- of files that are made here, whole, cut, damaged, and through a pipe.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local capture = require("yapp.capture.file")
local stream_generator = require("stream_generator")
local le = stream_generator.little_endian

local T = {}

-- Files -------------------------------------------------------------------------------------------

local function be(value, size) return le(value, size):reverse() end

local SECTION, INTERFACE, SIMPLE, STATISTICS, ENHANCED = 0x0A0D0D0A, 1, 3, 5, 6
local CAN, ETHERNET, RTAC, SLL, SLL2, EXPORTED = 227, 1, 250, 113, 276, 252
local WLAN = 105

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

-- What comes behind the interface's number in a block with a packet: when it was captured, in the
-- units of its interface, and its data.
local function packet_body(bytes, number, stamp)
  stamp = stamp or 0
  local low = stamp % 2 ^ 32
  return number((stamp - low) / 2 ^ 32, 4) .. number(low, 4) .. number(#bytes, 4) ..
    number(#bytes, 4) .. bytes .. ("\0"):rep(-#bytes % 4)
end

local function packet(of, bytes, number, stamp, options)
  local body = number(of, 4) .. packet_body(bytes, number, stamp) .. (options or "")
  return block(ENHANCED, body, number)
end

local function simple_packet(bytes, number)
  return block(SIMPLE, number(#bytes, 4) .. bytes, number)
end

local function statistics(of, number, options)
  return block(STATISTICS, number(of, 4) .. ("\0"):rep(8) .. options, number)
end

-- A section with interfaces of these link types, packets { interface, bytes }.
local function pcapng(linktypes, packets, number)
  local text = { section(number) }
  for _, linktype in ipairs(linktypes) do text[#text + 1] = interface(linktype, number) end
  for _, one in ipairs(packets) do text[#text + 1] = packet(one[1], one[2], number) end
  return table.concat(text)
end

local function can_over_sll2(index, protocol) -- 12 is CAN, 13 CAN FD
  return "\0" .. string.char(protocol or 12) .. "\0\0" .. be(index, 4) .. ("\0"):rep(12 + 16)
end
local function rtac(event) return ("\0"):rep(8) .. string.char(event) .. "\0\0\0bytes" end
local CAN_OVER_SLL = ("\0"):rep(15) .. "\12" .. ("\0"):rep(16)
local FD_OVER_SLL = ("\0"):rep(15) .. "\13" .. ("\0"):rep(16)
local IP_OVER_SLL2 = "\8\0\0\0" .. ("\0"):rep(60)
local FRAME = "YP\0\0\16\2\0\0\32\0\0\0" .. ("x"):rep(36)

local function none() return nil end

-- Reads a file of which so many bytes are the head; the rest comes in pieces of the same length, or
-- of what is asked for at least.
local function read(file, length)
  length = length or capture.HEAD
  local at = length
  return capture.read(file:sub(1, length), function(skip, count)
    at = at + skip
    local piece = file:sub(at + 1, at + math.min(count, math.max(length, 65536)))
    at = at + #piece
    return piece ~= "" and piece or nil
  end)
end

-- The buses of a file's packets, "1 2 1"; "-" of one whose interface
-- carries no YAPP; "" of a file without several.
local function buses(found)
  local list, find = {}, found:bus_finder(false)
  for number = 1, found.has_several and found.count or 0 do
    local bus = find(number)
    list[number] = bus and ("%d"):format(bus) or "-"
  end
  return table.concat(list, " ")
end

-- The names of all buses.
local function list_names(found)
  local names = {}
  for bus = 1, #found.buses do names[bus] = found:name(bus) end
  return names
end

-- Buses -------------------------------------------------------------------------------------------

-- A read filter drops packet 2 of 4, so that packets 3 and 4 are called 2 and 3.
function T.test_finder_stops_where_numbers_shift()
  local found = read(section(le) .. interface(CAN, le) .. interface(CAN, le) .. packet(0, "x", le, 1000000) ..
    packet(1, "x", le, 2000000) .. packet(0, "x", le, 3000000) .. packet(1, "x", le, 4000000))
  local function later(number) return "later " .. number, true end
  local function ask(find, number, seconds) return { find(number, { abs_ts = seconds }) } end
  local find, finds_all = found:bus_finder(true, later), found:bus_finder(false, later)
  lu.assertEquals({ ask(find, 1, 1), ask(find, 2, 3), ask(find, 3, 3), ask(find, 5, 5) },
    { { 1, true }, { nil, false }, { nil, false }, { "later 5", true } })
  -- In Wireshark the user may shift times.
  lu.assertEquals({ ask(finds_all, 1, 1), ask(finds_all, 2, 3) }, { { 1, true }, { 2, true } })
end

function T.test_buses()
  for _, number in ipairs { le, be } do
    local rows = {
      { pcap(CAN, { "x" }, number), "" }, { pcap(ETHERNET, { "x" }, number), "" },
      { pcap(SLL2, { can_over_sll2(3), can_over_sll2(3) }, number), "" },
      { pcap(SLL2, { can_over_sll2(3), IP_OVER_SLL2, can_over_sll2(7), can_over_sll2(3) }, number),
        "1 - 2 1" },
      { pcap(SLL2, { can_over_sll2(3), can_over_sll2(2 ^ 31 + 3, 13) }, number), "1 2" },
      { pcap(RTAC, { rtac(1), rtac(2), rtac(3), rtac(4), rtac(9), "x" }, number), "1 2 1 2 1 1" },
      { pcap(RTAC, { rtac(2), rtac(4) }, number), "" },
      { pcap(SLL, { CAN_OVER_SLL, FD_OVER_SLL }, number), "" },
      { pcapng({ CAN }, { { 0, "x" } }, number), "" },
      { pcapng({ CAN, CAN }, { { 1, "x" }, { 0, "x" }, { 1, "x" } }, number), "2 1 2" },
      { pcapng({ ETHERNET, CAN, ETHERNET }, { { 0, "x" }, { 1, "x" } }, number), "2 1" },
      { pcapng({ ETHERNET, CAN, 162 }, { { 0, "x" }, { 2, "x" }, { 1, "x" } }, number), "2 3 1" },
      { pcapng({ WLAN, CAN, 162 }, { { 0, "x" }, { 2, "x" }, { 1, "x" } }, number), "2 3 1" },
      { pcapng({ EXPORTED, 147 }, { { 0, "x" }, { 1, "x" } }, number), "1 2" },
      { pcapng({ SLL2, CAN }, { { 0, can_over_sll2(5) }, { 0, can_over_sll2(6) }, { 1, "x" } },
        number), "2 3 1" },
      { pcapng({ SLL2, SLL2 }, { { 0, can_over_sll2(5) }, { 1, can_over_sll2(5) } }, number),
        "1 2" },
      { pcapng({ SLL }, { { 0, CAN_OVER_SLL }, { 0, FD_OVER_SLL } }, number), "" },
      { pcapng({ SLL, SLL }, { { 0, CAN_OVER_SLL }, { 1, FD_OVER_SLL } }, number), "1 2" },
      { section(number) .. interface(SLL2, number) .. simple_packet(can_over_sll2(5), number) ..
        simple_packet(can_over_sll2(6), number), "1 2" },
      -- no such interface
      { pcapng({ CAN, CAN }, { { 0, "x" }, { 7, "x" }, { 1, "x" } }, number), "1 -" },
    }
    for i, row in ipairs(rows) do
      for _, length in ipairs { 100000, 100, 68 } do
        local found = read(row[1], length)
        lu.assertEquals({ buses(found), found.has_several }, { row[2], row[2] ~= "" },
          ("row %d, %d"):format(i, length))
      end
    end
  end
end

function T.test_options_of_serial_lines()
  for wanted, linktypes in pairs {
    [""] = { CAN, ETHERNET, EXPORTED, SLL2 },
    ["-o yapp.user_dlt:147"] = { 147, CAN },
    ["-d rtacser.data,yapp_serial"] = { RTAC },
    ["-o yapp.user_dlt:162"] = { ETHERNET, 162, RTAC },
  } do
    local is_serial = linktypes[1] == 147 or linktypes[1] == RTAC
    for bytes, has_frame in pairs { x = false, [FRAME] = is_serial } do
      local found = read(pcapng(linktypes, { { 0, bytes } }, le))
      lu.assertEquals({ found:serial_option() or "", found.has_serial_frames }, { wanted, has_frame })
    end
  end
end

-- The names of the buses of a file's packets.
local function bus_names(blocks)
  local found, names = read(table.concat(blocks)), {}
  local find = found:bus_finder(false)
  for number = 1, found.count do
    local bus = found.has_several and find(number) or nil
    names[number] = found:name(bus)
  end
  return names
end

-- The flags of packets, of serial lines alone, tell the direction: 1 inbound, 2 outbound.
function T.test_directions()
  for _, number in ipairs { le, be } do
    local function sent(of, flags)
      return packet(of, "bytes", number, 0, flags and option(2, number(flags, 4), number) .. option(0, "", number))
    end
    local tty, other = option(2, "ttyS0", number), option(2, "ttyS1", number)
    for _, linktype in ipairs { 147, 162, EXPORTED } do
      local head = { section(number), interface(linktype, number, tty) }
      local function names(...) return bus_names { table.concat(head), ... } end
      lu.assertEquals(names(sent(0, 1), sent(0, 2), sent(0, 1)), { "ttyS0#rx", "ttyS0#tx", "ttyS0#rx" })
      lu.assertEquals(names(sent(0, 2), sent(0, 2), sent(0, 0x21)), { "ttyS0#tx", "ttyS0#tx", "ttyS0#rx" })
      lu.assertEquals(names(sent(0, 1), sent(0, 1)), { "ttyS0", "ttyS0" })
      lu.assertEquals(names(sent(0), sent(0, 0)), { "ttyS0", "ttyS0" })
      lu.assertEquals(names(sent(0), sent(0, 1)), { "ttyS0#0", "ttyS0#rx" })
      head[3] = interface(linktype, number, other)
      lu.assertEquals(names(sent(1, 1), sent(0, 1), sent(0, 2)), { "ttyS1", "ttyS0#rx", "ttyS0#tx" })
    end
    local can = { section(number), interface(CAN, number, tty), sent(0, 1), sent(0, 2) }
    lu.assertEquals(bus_names(can), { "ttyS0", "ttyS0" })
  end
end

-- A live capture: fields tell the direction of a packet.  The first one has the interface's name.
function T.test_directions_by_fields()
  local number = le
  local tty = option(2, "ttyS0", number)
  for _, row in ipairs {
    { 147, { "ttyS0", "ttyS0#rx" } }, { CAN, { "ttyS0", "ttyS0" } },
  } do
    local found = read(section(number) .. interface(row[1], number, tty))
    for i, direction in ipairs { 2, 1 } do
      local bus = found:bus_by_fields { ["frame.interface_id"] = 0, ["frame.interface_name"] = "ttyS0",
        ["frame.packet_flags_direction"] = direction }
      lu.assertEquals(found:name(bus), row[2][i])
    end
  end
end

function T.test_sections_and_interfaces_that_come_late()
  local first = section(le) .. interface(CAN, le, option(2, "can0", le)) .. packet(0, "x", le)
  local found = read(first .. interface(CAN, le, option(2, "can1", le)) .. packet(1, "x", le) ..
    block(0xBAD, "\0\0\1\0custom", le) .. block(0x777, "", le) .. packet(0, "x", le) ..
    section(be) .. interface(ETHERNET, be) .. interface(CAN, be, option(2, "can2", be)) ..
    packet(0, "x", be) .. packet(1, "x", be) .. section(le) .. packet(0, "x", le))
  lu.assertEquals({ buses(found), list_names(found) }, { "1 2 - 1 4 3 -", { "can0", "can1", "can2", "if2" } })
  found = read(first .. first) -- as when two files are put one behind the other
  lu.assertEquals({ buses(found), list_names(found) }, { "1 2", { "can0#0", "can0#1" } })
end

local function do_stamps_differ(head)
  return capture.read(head, function() end).stamps_differ
end

-- Two stamps differ, in the part of the file that is there.
function T.test_whether_stamps_differ()
  for _, number in ipairs { le, be } do
    local head = section(number) .. interface(CAN, number) .. interface(CAN, number)
    local function of(...) return do_stamps_differ(head .. table.concat { ... }) end
    local first, later = packet(0, "a", number, 2 ^ 33), packet(0, "bc", number, 2 ^ 33 + 1)
    lu.assertEquals({ of(first, later), of(first, first, later) }, { true, true })
    lu.assertEquals({ of(), of(first), of(first, first) }, { false, false, false })
    lu.assertTrue(of(first, packet(1, "a", number, 7), later))
    lu.assertTrue(of(packet(0, ("a"):rep(70000 + 2 ^ 17), number, 2 ^ 33), later))
  end
  for magic, number in pairs { ["\212\195\178\161"] = le, ["\77\60\178\161"] = le, ["\161\178\195\212"] = be,
    ["\161\178\60\77"] = be } do
    local file = pcap(CAN, { "abc", "d" }, number, magic) -- at 1.25 and 2.25 s
    lu.assertTrue(do_stamps_differ(file))
    lu.assertTrue(do_stamps_differ(pcap(CAN, { ("abc"):rep(70000), "d" }, number, magic)))
    lu.assertFalse(do_stamps_differ(pcap(CAN, { "abc" }, number, magic)))
  end
  lu.assertEquals({ do_stamps_differ(""), do_stamps_differ("(1.0) can0 123#11\n") }, { false, false })
end

-- Wireshark rounds up a block's length, as some programs leave out the padding.
function T.test_a_length_without_the_padding()
  local whole = packet(1, "xy", le)
  local file = section(le) .. interface(CAN, le) .. interface(CAN, le) .. whole:sub(1, 4) ..
    le(#whole - 2, 4) .. whole:sub(9) .. packet(0, "x", le)
  lu.assertEquals(buses(read(file)), "2 1")
end

-- The bus of the packet that Wireshark says has a number and a time.
local function bus_at(found, number, seconds)
  return (found:bus_finder(true)(number, { abs_ts = seconds }))
end

-- A read filter shifts the numbers: Wireshark's time of a packet is another than the file's.
function T.test_the_time_tells_whether_a_number_is_still_this_packets()
  local seconds = 1700000000.25
  for exponent, per_second in pairs { ["\6"] = 1e6, ["\3"] = 1e3, ["\0"] = 1, ["\9"] = 1e9, ["\128"] = 1,
    ["\133"] = 32 } do
    for _, number in ipairs { le, be } do
      local options = option(9, exponent, number)
      local function at(time) return math.floor(time * per_second + 0.5) end
      local found = read(section(number) .. interface(CAN, number, options) ..
        interface(CAN, number, options) ..
        packet(1, "x", number, at(seconds)) .. packet(0, "x", number, at(seconds + 5)))
      local captured = at(seconds) / per_second
      lu.assertEquals({ bus_at(found, 1, captured), bus_at(found, 1, captured + 1e-6), bus_at(found, 2, captured + 5) },
        { 2, 2, 1 })
      lu.assertEquals({ bus_at(found, 2, captured), bus_at(found, 1, captured + 5) }, {})
    end
  end
  for magic, per_second in pairs { ["\212\195\178\161"] = 1e6, ["\77\60\178\161"] = 1e9,
    ["\161\178\195\212"] = 1e6, ["\161\178\60\77"] = 1e9 } do
    local number = magic:byte() == 161 and be or le
    local found = read(pcap(SLL2, { can_over_sll2(1), can_over_sll2(2) }, number, magic))
    local captured = 2 + 250000 / per_second
    lu.assertEquals(bus_at(found, 1, captured - 1), 1)
    -- Two microseconds are let pass, as either time may be rounded.
    for _, near in ipairs { 0, -1.5e-6, 1.5e-6 } do
      lu.assertEquals(bus_at(found, 2, captured + near), 2)
    end
    for _, other in ipairs { -1, -2.5e-6, 2.5e-6 } do lu.assertNil(bus_at(found, 2, captured + other)) end
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
    local names = { "can0", "if1", "vcan12", "m\195\188", "\\xFF", "a\\x01b", "if6", "if7", "end",
      "if9", "can9" }
    lu.assertEquals(list_names(read(file)), names)
    for length = 0, #file do lu.assertTable(list_names(read(file:sub(1, length)))) end
  end
end

-- The names of the buses of interfaces { link type, name }, each with packets.
local function names_of(interfaces, packets)
  local file = { section(le) }
  for _, row in ipairs(interfaces) do
    file[#file + 1] = interface(row[1], le, row[2] and option(2, row[2], le))
  end
  for _, row in ipairs(packets or {}) do file[#file + 1] = packet(row[1], row[2], le) end
  return list_names(read(table.concat(file)))
end

function T.test_no_two_buses_have_one_name()
  local three, four = can_over_sll2(3), can_over_sll2(4)
  lu.assertEquals(names_of { { CAN }, { ETHERNET }, { CAN } }, { "if0", "if2" })
  lu.assertEquals(names_of { { CAN, "can0" }, { CAN, "x" }, { CAN, "can0" } },
    { "can0#0", "x", "can0#2" })
  lu.assertEquals(names_of { { CAN }, { CAN, "if0" } }, { "if0#0", "if0#1" })
  local any = { { SLL2, "any" } }
  lu.assertEquals(names_of(any, { { 0, three }, { 0, three } }), { "any" })
  lu.assertEquals(names_of(any, { { 0, three }, { 0, four } }), { "any#3", "any#4" })
  lu.assertEquals(names_of({ { SLL, "any" }, { SLL, "any" } }, { { 0, CAN_OVER_SLL }, { 1, FD_OVER_SLL } }),
    { "any#0", "any#1" })
  lu.assertEquals(list_names(read(pcap(SLL2, { three, four }, le))), { "if0#3", "if0#4" })
  lu.assertEquals(list_names(read(pcap(RTAC, { rtac(2), rtac(1) }, le))), { "if0#rx", "if0#tx" })
  lu.assertEquals(names_of({ { RTAC, "COM1" } }, { { 0, rtac(1) }, { 0, rtac(2) } }),
    { "COM1#tx", "COM1#rx" })
end

-- What a packet without a bus of its own is called.
function T.test_the_name_of_the_only_interface()
  local function only_name(...)
    local file = section(le)
    for i, linktype in ipairs { ... } do
      file = file .. interface(linktype, le, option(2, "n" .. i, le))
    end
    return read(file):name(nil)
  end
  lu.assertEquals({ only_name(ETHERNET, CAN), only_name(CAN, ETHERNET), only_name(CAN) }, { "n2", "n1", "n1" })
  lu.assertNil(only_name(CAN, CAN))
  lu.assertNil(only_name(ETHERNET))
  lu.assertNil(read(section(le) .. interface(CAN, le)):name(nil)) -- no name: none is made up
  lu.assertNil(read(pcap(CAN, { "x" }, le)):name(nil))
end

-- Of a file without YAPP at its head the rest is not read.  It may describe CAN interfaces later.
function T.test_interfaces_behind_the_head()
  local name = option(2, "eth0", le)
  local function found(packets)
    local file = section(le) .. interface(ETHERNET, le, name) .. (packet(0, ("x"):rep(1000), le)):rep(packets) ..
      interface(CAN, le, option(2, "can0", le))
    local one = read(file)
    return { one.is_unknown, one.is_told, one:name(nil) }
  end
  lu.assertEquals(found(70), { true, true })
  lu.assertEquals(found(10), { false, true }) -- two buses
end

-- Behind what was read, as in a live capture, fields tell the bus.
function T.test_buses_by_fields()
  local found = read(section(le) .. interface(CAN, le, option(2, "can0", le)))
  local function bus(id, index, event, name)
    return found:bus_by_fields { ["frame.interface_id"] = id, ["sll.ifindex"] = index, ["rtacser.eventtype"] = event,
      ["frame.interface_name"] = name }
  end
  lu.assertEquals({ bus(0, 0), bus(1, 0, nil, "can1"), bus(0, 0), bus(2, 0, nil, "can1"), bus(3, 0) },
    { 1, 2, 1, 3, 4 })
  lu.assertEquals({ found:name(1), found:name(2), found:name(3), found:name(4) },
    { "can0", "can1#1", "can1#2", "if3" })
  found = read("")
  lu.assertEquals({ bus(0, 3, nil, "any"), bus(0, 4, nil, "any"), bus(0, 3, nil, "any") }, { 1, 2, 1 })
  lu.assertEquals({ found:name(1), found:name(2) }, { "any#3", "any#4" })
  -- In a live capture the first name may stand for several, too.
  found = read(section(le) .. interface(SLL2, le, option(2, "any", le)))
  lu.assertEquals({ found.has_several, bus(0, 3), bus(0, 4) }, { true, 1, 2 })
  lu.assertEquals({ found:name(1), found:name(2) }, { "any#3", "any#4" })
  found = read(pcap(SLL2, { can_over_sll2(3), can_over_sll2(4) }, le)) -- as the head of a pipe
  lu.assertEquals({ bus(0, 4), bus(0, 5), found:name(3) }, { 2, 3, "if0#5" })
  found = read("")
  lu.assertEquals({ bus(0, 0, 1), bus(0, 0, 2), bus(0, 0, 3) }, { 1, 2, 1 })
  lu.assertNil(found:bus_by_fields { ["frame.interface_id"] = 0, ["frame.section_number"] = 2 })
end

-- Drops -------------------------------------------------------------------------------------------

local function drop_option(count, number) return option(4, number(count, 8), number) end

-- "time frame bus count" of each loss.
local function drops(found)
  local list = {}
  for i, drop in ipairs(found.drops) do
    list[i] = ("%s %s %s %d"):format(drop.time and ("%.1f"):format(drop.time) or "-",
      drop.frame or "-", drop.bus or "-", drop.count)
  end
  return list
end

function T.test_packets_that_were_dropped()
  for _, number in ipairs { le, be } do
    local name, comment = option(2, "can0", number), option(1, "why", number)
    local one = section(number) .. interface(CAN, number, name)
    local two = one .. interface(ETHERNET, number) .. interface(CAN, number)
    local counted = option(4, number(2, 8), number) .. option(5, number(7, 8), number)
    local rows = {
      { one .. packet(0, "x", number), {} },
      { one .. packet(0, "x", number, 2500000, comment .. drop_option(3, number)),
        { "2.5 1 can0 3" } },
      { one .. packet(0, "x", number, 0, drop_option(0, number)), {} },
      { two .. packet(2, "x", number) .. packet(2, "yy", number, 1e6, drop_option(1, number)) ..
        packet(1, "z", number, 0, drop_option(2 ^ 33, number)),
        { "1.0 2 - 1", "0.0 3 - 8589934592" } },
      { one .. packet(0, "x", number) .. statistics(0, number, counted), { "- - can0 7" } },
      -- the numbers grow from one block to the next; what packets account for is there already
      { one .. packet(0, "x", number, 0, drop_option(4, number)) .. statistics(0, number, counted) ..
        statistics(0, number, option(5, number(9, 8), number)),
        { "0.0 1 can0 4", "- - can0 3", "- - can0 2" } },
      { one .. statistics(3, number, counted), {} }, -- no such interface
    }
    for i, row in ipairs(rows) do
      for _, length in ipairs { 100000, 64 } do
        lu.assertEquals(drops(read(row[1], length)), row[2], ("row %d, %d"):format(i, length))
      end
    end
  end
end

-- The time of the first packet, to the nanosecond: 1,700,000,000,123,456,789 ns do not fit into a double.
function T.test_the_first_time()
  for _, number in ipairs { le, be } do
    local function first(resolution, units_high, units_low, shift)
      local options = option(9, string.char(resolution), number)
      if shift then options = options .. option(14, number(shift, 8), number) end
      local stamp, size = number(units_high, 4) .. number(units_low, 4), number(1, 4)
      local body = number(0, 4) .. stamp .. size .. size .. "x\0\0\0"
      return read(section(number) .. interface(CAN, number, options) .. block(ENHANCED, body, number) ..
        packet(0, "x", number, 1)).first
    end
    lu.assertEquals(first(9, 395812094, 1032178965), { 1700000000, 123456789 })
    for _, shift in ipairs { 3600, -3600 } do
      lu.assertEquals(first(6, 395812, 404759104, shift), { 1700000000 + shift, 123456000 })
    end
    lu.assertEquals(first(0, 0, 1700000000), { 1700000000, 0 })
    lu.assertEquals(first(12, 0, 1500), { 0, 1 })
  end
  lu.assertEquals(read(pcap(CAN, { "x", "y" }, be)).first, { 1, 250000000 })
  lu.assertEquals(read(pcap(CAN, { "x" }, le, "\77\60\178\161")).first, { 1, 250000 })
  lu.assertNil(read("(1.0) can0 123#11\n").first)
end

-- A custom block has a frame number and no time.  If it is the first one, Wireshark's times mean nothing.
function T.test_packets_without_times()
  local head = section(le) .. interface(CAN, le)
  local custom = block(0xBAD, "\0\0\1\0custom", le)
  lu.assertTrue(read(head .. custom .. packet(0, "x", le)).lacks_times)
  lu.assertFalse(read(head .. packet(0, "x", le) .. custom).lacks_times)
  lu.assertTrue(read(head .. packet(0, "x", le) .. simple_packet("x", le)).lacks_times)
  lu.assertFalse(read(head .. packet(0, "x", le)).lacks_times)
  lu.assertFalse(read(pcap(CAN, { "x" }, le)).lacks_times)
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

-- Whether a live capture of ours may have just begun, which may get more interfaces; whether there may be several
-- buses; whether packets that were not read may be of another one.  What dumpcap writes begins with all interfaces.
function T.test_captures_that_begin()
  local version = le(0x1A2B3C4D, 4) .. le(1, 2) .. le(0, 2)
  local by_dumpcap = block(SECTION, version .. ("\255"):rep(8) .. option(4, "Dumpcap", le), le)
  for at, row in ipairs {
    { pcapng({}, {}, le), true, true, false }, { pcapng({ CAN }, {}, le), true, true, true },
    { pcapng({ ETHERNET, 252 }, {}, be), true, true, true },
    { pcapng({ CAN }, { { 0, "x" } }, le), false, false, true },
    { pcapng({ CAN, CAN }, { { 0, "x" } }, le), false, true, true }, { pcapng({ SLL2 }, {}, be), true, true, true },
    { pcapng({ SLL }, {}, be), true, true, true },
    { pcapng({ SLL2 }, { { 0, IP_OVER_SLL2 } }, be), false, false, true },
    { pcapng({ ETHERNET }, {}, le), false, false, false },
    { pcapng({ ETHERNET, ETHERNET }, {}, le), false, true, false }, { pcap(CAN, {}, le), false, false, false },
    { pcap(SLL2, { can_over_sll2(3) }, le), false, false, true }, { "", false, false, false },
    { by_dumpcap .. interface(CAN, le), true, false, false },
    { by_dumpcap .. interface(CAN, le) .. interface(CAN, le), true, true, true },
    { by_dumpcap .. interface(SLL2, le), true, true, true },
  } do
    local found = read(row[1])
    lu.assertEquals({ found.is_live, found.may_be_several, found.may_add_buses }, { row[2], row[3], row[4] }, at)
  end
end

-- Where an error frame may be among the packets.
function T.test_which_interfaces_carry_can()
  for linktype, is_can in pairs { [CAN] = true, [SLL] = true, [SLL2] = true, [ETHERNET] = false, [RTAC] = false,
    [EXPORTED] = false, [147] = false } do
    lu.assertEquals(read(pcapng({ linktype }, {}, le)).interfaces[1].is_can, is_can, linktype)
  end
end

-- Of somebody else's file no more is read than its head.
function T.test_other_peoples_files_are_left_alone()
  local long = ("x"):rep(100000)
  for _, file in ipairs { pcapng({ ETHERNET }, { { 0, long }, { 0, long } }, le),
    pcap(ETHERNET, { long }, le),
    pcap(CAN, { long, long }, le), "LOGG" .. long, long } do
    local asked = 0
    local found = capture.read(file:sub(1, capture.HEAD), function()
      asked = asked + 1
      return nil
    end)
    lu.assertEquals({ asked, found.has_several, buses(found) }, { 0, false, "" })
  end
  for text, expected in pairs { ["LOGG" .. long] = { false, true }, [pcap(CAN, { "x" }, le)] = { true, false },
    [pcapng({ ETHERNET, ETHERNET }, {}, le)] = { true, true } } do
    local found = read(text)
    lu.assertEquals({ found.is_told, found.is_unknown }, expected)
  end
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
  local found = capture.read(file:sub(1, capture.HEAD), none)
  lu.assertEquals(capture.HEAD, 2 ^ 16) -- what Wireshark can rewind
  lu.assertTrue(found.has_several)
  lu.assertTrue(found.count > 1000 and found.count < 5000, found.count)
  local find = found:bus_finder(false, none)
  lu.assertEquals({ (find(1)), (find(2)), (find(found.count)) },
    { 2, 1, found.count % 2 + 1 })
  lu.assertNil(find(found.count + 1))
  lu.assertEquals(read(file).count, 5000)
end

return T
