-- SPDX-License-Identifier: GPL-2.0-or-later
-- Bytes of serial lines, TCP, TLS, UDP and USB between Wireshark and the reading: which packets are ours, and what the
-- reading and the view are handed.  Wireshark's API, the reading and the view are stand-ins here.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local frame_key = require("yapp.base.frame_key")
local usb = require("yapp.serial.usb")

local T = {}

local PACKET = frame_key.PACKET
local TCP, UDP = 2, 3 -- pinfo.port_type
local GLOBALS = { "ByteArray", "Tvb" }
local MODULES = { "yapp.host.serial", "yapp.host.tcp", "yapp.host.ports" }
local real_usb = {}
for name, value in pairs(usb) do real_usb[name] = value end

local seen, said

local Buffer = {}
Buffer.__index = Buffer
local function buffer(bytes, reported, start)
  return setmetatable({ bytes = bytes, reported = reported or #bytes, start = start or 0 }, Buffer)
end
function Buffer.len(self) return #self.bytes end
function Buffer.reported_len(self) return self.reported end
function Buffer.offset(self) return self.start end
function Buffer.raw(self, offset)
  assert(#self.bytes > (offset or 0), "raw() of nothing throws past Lua")
  return self.bytes:sub((offset or 0) + 1)
end
function Buffer.__call(self, offset)
  assert(offset < #self.bytes)
  return { tvb = function() return buffer(self.bytes:sub(offset + 1), nil, self.start + offset) end }
end

local function packet(number, with)
  local pinfo = { number = number, visited = false, port_type = UDP, src = "10.0.0.1", dst = "10.0.0.2",
    src_port = 40000, dst_port = 14550, in_error_pkt = false, abs_ts = 1700000000 + number }
  for name, value in pairs(with or {}) do pinfo[name] = value end
  return pinfo
end

local LINE = { key = "line", opposite = "other line", trial_key = "trial", tag = "tag", bus = "eth0",
  is_datagram = true, is_tcp = false, is_complete = false }

local function new_reading()
  local streams = { trial_count = 0, may_begin = function(bytes) return bytes:find("^YP") ~= nil end }
  function streams.may_go_on(_, tag)
    seen.tags[#seen.tags + 1] = tag
    return said.goes_on
  end
  function streams.is_stored(_, key)
    seen.asked = key
    return said.is_stored
  end
  function streams.add_header(_, ...)
    seen.header = { ... }
    return said.has_order
  end
  local lines = { has_serial = "has serial" }
  function lines.scan(_, head)
    seen.scanned = head
    return said.conversations or {}
  end
  function lines.of(_, ...)
    seen.line_of = { ... }
    return said.line
  end
  function lines.of_adapter(_, line)
    seen.adapter = line
    return said.line
  end
  function lines.list_unread(_, conversations) return { conversations[2] } end
  function lines.await(_, conversations) seen.awaited = conversations end
  local reading = { streams = streams, found = {}, lines = lines }
  function reading.may_be_yapp() return said.may_be_yapp end
  function reading.is_yapp(_, head) return head == "YAPP" end
  local function taken(name)
    reading[name] = function(_, one)
      seen.packets[#seen.packets + 1] = one
      seen.ways[#seen.ways + 1] = name
      return said[name], said.is_in_pieces, said.has_failed
    end
  end
  for _, name in ipairs { "try_packet", "add_packet", "recall_packet", "add_skipped" } do taken(name) end
  return reading
end

local function new_streams()
  local wants = { state = "state", is_only_pass = "only", tree = said.tree or false }
  local builder = { wants = function(_, ...)
    seen.wants = { ... }
    return wants
  end }
  local buses = { time = function(_, pinfo) return pinfo.number / 10 end, bus_of = function(number)
    return ("bus %d 0"):format(number), "is known"
  end }
  local view = { show = function(_, ...) seen.shown[#seen.shown + 1] = { ... } end }
  local reading = new_reading()
  local streams = require("yapp.host.serial").new(reading, view, builder, buses, "tcp header")
  streams:reset()
  return streams, reading
end

function T.setUp()
  seen = { tags = {}, packets = {}, ways = {}, shown = {}, taken = {}, watches = 0, stops = 0, given_back = 0 }
  said = { line = {}, may_be_yapp = true, add_packet = "contents", recall_packet = "recalled", add_skipped = "skipped" }
  for name, value in pairs(LINE) do said.line[name] = value end
  package.loaded["yapp.host.serial"] = nil
  package.loaded["yapp.host.tcp"] = {
    current = function(number) return said.segment and number == said.segment.number and said.segment or nil end,
    watch = function(proto, hand_on)
      seen.watches, seen.watched, seen.hand_on = seen.watches + 1, proto, hand_on
    end,
    stop = function() seen.stops = seen.stops + 1 end,
  }
  package.loaded["yapp.host.ports"] = {
    register = function(...) seen.taken[#seen.taken + 1] = { ... } end,
    unregister_all = function() seen.given_back = seen.given_back + 1 end,
    has_other = function(pinfo) return said.has_other and pinfo.src_port == 40000 end,
  }
  _G.Tvb = Buffer
  _G.ByteArray = { new = function(bytes, is_binary)
    return { tvb = function(_, name) return { bytes, is_binary, name } end }
  end }
end

function T.tearDown()
  for _, name in ipairs(GLOBALS) do _G[name] = nil end
  for _, name in ipairs(MODULES) do package.loaded[name] = nil end
  for name, value in pairs(real_usb) do usb[name] = value end
end

local function last(list) return list[#list] end

-- Packets -------------------------------------------------------------------------------------------------------------

function T.test_a_datagram()
  local streams = new_streams()
  local tvb, pinfo = buffer("YP..", 4, 42), packet(7)
  lu.assertEquals(streams:dissect(tvb, pinfo, "tree"), 4)
  local one = seen.packets[1]
  lu.assertEquals(seen.ways, { "add_packet" })
  lu.assertEquals(seen.line_of, { UDP, "10.0.0.1", 40000, "10.0.0.2", 14550, nil, 0.7 })
  lu.assertEquals(one, { key = 7 * PACKET + 42, number = 7, time = 0.7, epoch = false, visited = false,
    bytes = "YP..", length = 4, truncated = false, line = said.line, stream = "line", is_bus_known = true,
    is_only_pass = "only", wants_state = "state" })
  lu.assertEquals({ seen.shown[1][2], seen.shown[1][6], seen.wants }, { "contents", "tree", { "tree", pinfo, false } })
  lu.assertIs(seen.shown[1][1], one)
  lu.assertIs(seen.shown[1][4], tvb)
end

function T.test_truncated_packets()
  local streams = new_streams()
  streams:dissect(buffer("YP..", 9), packet(7))
  lu.assertEquals({ seen.packets[1].truncated, seen.packets[1].length, seen.packets[1].epoch }, { true, 9, 1700000007 })
end

function T.test_a_serial_line()
  local streams, reading = new_streams()
  reading.found.trial = "found"
  streams:dissect(buffer("YP..", 4, 3), packet(7, { port_type = 0, src = "", dst = "" }))
  lu.assertEquals({ seen.line_of[6], seen.packets[1].is_bus_known, seen.packets[1].is_found },
    { "bus 7 0", "is known", "found" })
  lu.assertTrue(streams:has_serial() == "has serial")
end

function T.test_packets_that_are_visited()
  local streams = new_streams()
  lu.assertEquals(streams:dissect(buffer("YP.."), packet(7, { visited = true }), "tree"), 4)
  lu.assertEquals({ seen.ways, seen.shown[1][2], seen.packets[1].visited }, { { "recall_packet" }, "recalled", true })
  lu.assertEquals({ seen.line_of[7], seen.wants[3] }, { nil, true })
  said.recall_packet = nil
  lu.assertEquals(streams:dissect(buffer("YP.."), packet(8, { visited = true })), 0)
  lu.assertEquals(#seen.shown, 1)
end

function T.test_what_is_not_ours()
  local streams = new_streams()
  lu.assertEquals(streams:dissect(buffer("", 9), packet(7)), 0)
  lu.assertEquals(streams:dissect(buffer("YP.."), packet(7, { in_error_pkt = true })), 0)
  lu.assertEquals(#seen.packets, 0)
  lu.assertEquals(streams:dissect_skipped(buffer(""), packet(7)), 0)
  lu.assertEquals(#seen.packets, 0)
  lu.assertEquals(streams:dissect_skipped(buffer("login"), packet(7), "tree"), 5)
  lu.assertEquals({ seen.ways, seen.shown[1][2] }, { { "add_skipped" }, "skipped" })
  lu.assertEquals(streams:dissect_skipped(buffer("x"), packet(8)), 1)
  lu.assertEquals(#seen.shown, 2)
end

-- Unknown conversations -----------------------------------------------------------------------------------------------

function T.test_a_conversation_is_tried()
  local streams = new_streams()
  local function accepts(bytes, with) return streams:accepts(buffer(bytes, nil, 42), packet(7, with), "tree") end
  lu.assertFalse(accepts(""))
  lu.assertFalse(streams:accepts(buffer(""), packet(7, { visited = true })))
  lu.assertFalse(accepts("abc"))
  lu.assertFalse(accepts("YP..", { in_error_pkt = true }))
  lu.assertEquals({ seen.packets, seen.taken }, { {}, {} })
  said.try_packet = true
  lu.assertTrue(accepts("YP.."))
  lu.assertEquals({ seen.wants[1], seen.wants[3] }, { "tree", false })
  lu.assertEquals({ seen.ways, seen.packets[1].key, seen.taken },
    { { "try_packet" }, 7 * PACKET + 42, { { false, 14550 } } })
  said.try_packet, said.line.is_tcp, seen.taken = true, true, {}
  accepts("YP..", { src_port = 14550, dst_port = 40000 })
  lu.assertEquals(seen.taken, { { true, 14550 } })
  said.try_packet = false
  lu.assertFalse(accepts("YP.."))
  lu.assertEquals(#seen.taken, 1)
end

-- Few packets of others are asked further while a conversation is on trial.
function T.test_a_conversation_that_may_go_on()
  local streams, reading = new_streams()
  said.try_packet, said.goes_on, said.may_be_yapp = true, false, false
  local function accepts(bytes) return streams:accepts(buffer(bytes), packet(7), "tree") end
  lu.assertFalse(accepts("YP.."), "its bytes may be no YAPP")
  lu.assertFalse(accepts("rest"))
  reading.streams.trial_count = 1
  lu.assertFalse(accepts("rest"))
  lu.assertEquals(seen.packets, {})
  said.goes_on = true
  lu.assertTrue(accepts("r"))
  lu.assertTrue(accepts("rest"))
  lu.assertEquals(seen.wants[3], false)
  lu.assertEquals(last(seen.tags), require("yapp.serial.lines").tag(UDP, 40000, 14550))
end

function T.test_a_conversation_that_is_visited()
  local streams = new_streams()
  said.is_stored = "stored"
  lu.assertEquals(streams:accepts(buffer("rest", nil, 42), packet(7, { visited = true })), "stored")
  lu.assertEquals({ seen.asked, seen.packets }, { 7 * PACKET + 42, {} })
end

function T.test_notes_on_what_came_in_pieces()
  local streams = new_streams()
  lu.assertEquals(streams:notes(), {})
  said.is_in_pieces = true
  streams:accepts(buffer("YP.."), packet(7))
  lu.assertEquals(streams:notes(), { "YAPP came in pieces without a whole header: to list its packets, add " ..
    "-d udp.port==14550,yapp_serial" })
  streams:reset()
  lu.assertEquals(streams:notes(), {})
end

function T.test_options_for_what_was_read_late()
  local streams = new_streams()
  said.may_be_yapp, said.has_failed = true, true
  streams:accepts(buffer("YP.."), packet(7))
  lu.assertEquals(streams:options(), { "-d udp.port==14550,yapp_serial" })
  streams:reset()
  lu.assertEquals(streams:options(), {})
  said.has_failed, said.is_in_pieces = nil, true
  streams:accepts(buffer("YP.."), packet(8))
  lu.assertEquals(streams:options(), {})
  said.has_other = true -- another protocol, which may have taken a piece
  streams:accepts(buffer("YP.."), packet(9))
  lu.assertEquals(streams:options(), { "-d udp.port==14550,yapp_serial" })
end

function T.test_the_beginning_of_a_file()
  local streams, reading = new_streams()
  local both = { { is_tcp = true, port = 1, client_port = 9 }, { is_tcp = false, port = 2, client_port = 9 } }
  streams:scan("other")
  lu.assertEquals({ seen.scanned, seen.watches, seen.taken }, { "other", 0, {} })
  said.conversations = both
  streams:scan("YAPP")
  lu.assertIs(seen.awaited, both)
  lu.assertEquals({ seen.watches, seen.watched, seen.taken }, { 1, "tcp header", { { true, 1 }, { false, 2 } } })
  lu.assertEquals(streams:options(), { "-d udp.port==2,yapp_serial" })
  lu.assertEquals({ seen.stops, seen.given_back }, { 1, 1 })
  streams:reset()
  lu.assertEquals({ seen.stops, seen.given_back, reading.lines:list_unread(streams.conversations) }, { 2, 2, {} })
end

-- TCP and TLS ---------------------------------------------------------------------------------------------------------

local function in_tcp(streams, number, bytes, with)
  local fields = { port_type = TCP }
  for name, value in pairs(with or {}) do fields[name] = value end
  return streams:dissect(buffer(bytes, nil, with and with.offset or 54), packet(number, fields), "tree")
end

local function segment(number, with)
  local one = { number = number, offset = 54, start = 20, length = 4, seq = 99, epoch = 5, is_ours = false }
  for name, value in pairs(with or {}) do one[name] = value end
  return one
end

-- What TCP hands on is shown when TCP has shown the segment.
function T.test_segments()
  local streams = new_streams()
  streams:watch_tcp()
  said.segment, said.tree = segment(7), true
  lu.assertEquals(in_tcp(streams, 7, "YP.."), 4)
  lu.assertEquals({ said.segment.is_ours, seen.packets, seen.shown }, { true, {}, {} })
  local tvb = buffer(("h"):rep(20) .. "YP..", nil, 34)
  seen.hand_on(said.segment, tvb, packet(7, { port_type = TCP }), "tree")
  local one = seen.packets[1]
  lu.assertEquals({ one.bytes, one.length, one.key, one.seq, one.epoch }, { "YP..", 4, 7 * PACKET + 54, 99, 5 })
  lu.assertEquals({ seen.header[1], seen.header[2], said.line.is_direct, said.line.is_over },
    { "line", "other line", true, nil })
  lu.assertIs(seen.header[3], said.segment)
  lu.assertEquals(seen.shown[1][2], "contents")
end

local function hand_on(one, bytes, with)
  local streams = new_streams()
  streams:watch_tcp()
  local fields = { port_type = TCP }
  for name, value in pairs(with or {}) do fields[name] = value end
  seen.hand_on(one, buffer(("h"):rep(20) .. bytes, with and with.reported, 34), packet(7, fields), "tree")
end

function T.test_segments_that_tcp_kept()
  hand_on(segment(7), "YP..")
  lu.assertEquals(seen.packets, {}, "of another protocol")
  said.has_order = true
  hand_on(segment(7), "YP..")
  lu.assertEquals(#seen.packets, 1, "it fills a gap of ours")
  hand_on(segment(7, { length = 0, is_end = true }), "")
  lu.assertEquals({ #seen.packets, said.line.is_over }, { 1, true })
  hand_on(segment(7, { length = 9 }), "", { reported = 29 })
  lu.assertEquals({ last(seen.packets).bytes, last(seen.packets).length, said.line.is_over }, { "", 9, true })
  seen.header, said.has_order = nil, false
  hand_on(segment(7, { is_ours = true }), "YP..", { visited = true })
  lu.assertEquals({ seen.header, last(seen.ways) }, { nil, "recall_packet" })
end

function T.test_where_a_segment_is_shown()
  said.tree, said.has_order = true, true
  hand_on(segment(7), "YP..")
  lu.assertEquals({ last(seen.shown)[4].bytes, last(seen.shown)[4].start }, { "YP..", 54 })
  hand_on(segment(7, { length = 9 }), "", { reported = 29 })
  lu.assertEquals(last(seen.shown)[4].start, 34, "nothing was captured")
end

-- What TLS found in a segment is a stream of its own, behind the bytes of TCP.
function T.test_records_of_tls()
  local streams = new_streams()
  said.segment = segment(7)
  local function keys(...)
    local found = {}
    for i, one in ipairs { ... } do
      in_tcp(streams, one[1], one[2], { offset = 0, visited = one[3] })
      found[i] = last(seen.packets).key - one[1] * PACKET
    end
    return found
  end
  local half = PACKET / 2
  lu.assertEquals(keys({ 7, "ab" }, { 7, "cde" }, { 7, "ab" }, { 8, "fg" }), { half, half + 2, half + 5, half })
  lu.assertEquals(last(seen.packets).stream, "tls|line")
  lu.assertEquals(keys({ 7, "ab", true }, { 7, "cde", true }, { 7, "ab", true }), { half, half + 2, half },
    "each visit begins with the first one")
  lu.assertEquals(seen.watches, 0)
end

function T.test_tcp_that_is_not_watched_yet()
  local streams = new_streams()
  in_tcp(streams, 7, "YP..")
  lu.assertEquals({ last(seen.packets).stream, seen.watches }, { "line", 1 })
  in_tcp(streams, 8, "YP..", { offset = 0 })
  lu.assertEquals({ last(seen.packets).stream, seen.watches }, { "tls|line", 1 })
  said.line.is_direct = true -- TCP has joined segments
  in_tcp(streams, 9, "YP..", { offset = 0 })
  lu.assertEquals({ last(seen.packets).stream, seen.watches }, { "line", 2 })
  said.add_packet = nil
  lu.assertEquals(in_tcp(streams, 10, "YP.."), 0)
end

-- USB -----------------------------------------------------------------------------------------------------------------

local function of_usb(part, with)
  usb.is_of_others = function(kind, raw)
    seen.usb = { kind, raw }
    return said.is_of_others
  end
  usb.new = function() return { read_packet = function() return part end } end
  local streams, reading = new_streams()
  for name, value in pairs(with or {}) do reading[name] = value end
  streams:dissect_usb("usbmon", buffer("raw bytes"), packet(7), "tree")
  return reading
end

function T.test_adapters()
  said.try_packet = true
  local part = { line = "adapter", bytes = "YP..", offset = 64 }
  of_usb(part)
  lu.assertEquals({ seen.usb, seen.adapter, seen.ways },
    { { "usbmon", "raw bytes" }, "adapter", { "try_packet", "add_packet" } })
  local one = seen.packets[2]
  lu.assertEquals({ one.key, one.bytes, one.length, one.truncated, seen.shown[1][4] },
    { 7 * PACKET + 64, "YP..", 4, false, false })
  part.truncated = true
  of_usb(part)
  lu.assertEquals({ last(seen.packets).length, last(seen.packets).truncated }, { 5, true })
  said.try_packet, seen.shown = false, {}
  of_usb(part)
  lu.assertEquals({ last(seen.ways), seen.shown }, { "try_packet", {} })
  seen.ways = {}
  of_usb(part, { found = { trial = true } })
  lu.assertEquals(seen.ways, { "add_packet" })
end

function T.test_packets_of_usb_that_are_of_others()
  said.try_packet = true
  local part = { line = "adapter", bytes = "rest", offset = 64 }
  of_usb(part)
  of_usb(nil)
  of_usb({ line = "adapter", bytes = "", offset = 64 })
  lu.assertEquals(seen.packets, {})
  said.goes_on = true
  of_usb(part)
  lu.assertEquals({ #seen.packets, last(seen.tags) }, { 2, "tag" })
  said.is_of_others, seen.packets = true, {}
  of_usb(part)
  lu.assertEquals(seen.packets, {})
  of_usb(part, { found = { other = true } })
  lu.assertEquals(#seen.packets, 2, "an adapter with YAPP is there")
end

function T.test_where_bytes_of_an_adapter_are_shown()
  said.try_packet, said.tree = true, true
  of_usb({ line = "adapter", bytes = "YP..", offset = 4 })
  lu.assertEquals({ last(seen.shown)[4].bytes, last(seen.shown)[4].start }, { "bytes", 4 })
  of_usb({ line = "adapter", bytes = "YP..", offset = 4, has_status = true })
  lu.assertEquals(last(seen.shown)[4], { "YP..", true, "Serial line" })
end

return T
