-- SPDX-License-Identifier: GPL-2.0-or-later
-- What stands between the plugin and Wireshark: preferences, ports, and the watches of TCP and USB.
-- Wireshark's API is a stand-in of tables; the real one is in tests/e2e.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")

local T = {}

local NAMES = { "gui_enabled", "report_failure", "DissectorTable", "Dissector", "Struct", "wtap", "Pref" }
local MODULES = { "preferences", "ports", "tcp", "usb" }
local tables -- of dissectors, by name: { [key] = dissector }
local said

local function big_endian(bytes, from, to)
  local number = 0
  for i = from, to do number = number * 256 + bytes:byte(i) end
  return number
end

function T.setUp()
  tables, said = {}, {}
  function _G.gui_enabled() return true end
  function _G.report_failure(text) said[#said + 1] = text end
  _G.DissectorTable = { get = function(name)
    local own = tables[name] or {}
    tables[name] = own
    return {
      get_dissector = function(_, key) return own[key] end,
      add = function(_, key, dissector) own[key] = dissector end,
      remove = function(_, key, dissector) if own[key] == dissector then own[key] = nil end end,
    }
  end }
  _G.Dissector = { get = function(name) return { name = name, call = function() return 7 end } end }
  _G.Struct = { unpack = function(_, bytes)
    return big_endian(bytes, 1, 4), big_endian(bytes, 5, 8), bytes:byte(9), bytes:byte(10)
  end }
  _G.wtap = { USER0 = 45, USB_LINUX = 95, USB_LINUX_MMAPPED = 115, USBPCAP = 152 }
  for _, name in ipairs(MODULES) do package.loaded["yapp.host." .. name] = nil end
end

function T.tearDown()
  for _, name in ipairs(NAMES) do _G[name] = nil end
  for _, name in ipairs(MODULES) do package.loaded["yapp.host." .. name] = nil end
end

-- Preferences -------------------------------------------------------------------------------------

function T.test_ranges()
  local range = require("yapp.host.preferences").parse_range
  lu.assertEquals(range(""), {})
  lu.assertEquals(range("528"), { 528 })
  lu.assertEquals(range("528,768-771,769,5"), { 528, 768, 769, 770, 771, 5 })
end

function T.test_late()
  local late = require("yapp.host.preferences").parse_late
  local function read(text)
    local number, problems = late(text)
    return { number, #problems }
  end
  lu.assertEquals(read("4"), { 4, 0 })
  lu.assertEquals(read(" 0.5 "), { 0.5, 0 })
  for _, text in ipairs { "", "soon", "0", "-1", "0x10", "1e999", "2,5" } do
    lu.assertEquals(read(text), { 2.5, 1 }, text)
  end
  lu.assertEquals(select(2, late("0")), { 'yapp.late: no number above 0 in "0"; it is 2.5 until you change it' })
end

function T.test_a_problem_is_said_once()
  local preferences, stderr = require("yapp.host.preferences"), io.stderr
  io.stderr = { write = function() said[#said + 1] = "in a terminal, too" end } -- luacheck: ignore
  preferences.complain_once { "a", "b", "a" }
  preferences.complain_once { "b", "c" }
  preferences.complain_once {}
  preferences.complain {}
  io.stderr = stderr -- luacheck: ignore
  lu.assertEquals(said, { "YAPP: preferences: a\npreferences: b", "YAPP: preferences: c" })
end

function T.test_a_problem_is_said_in_tshark()
  local stderr, lines = io.stderr, {}
  io.stderr = { write = function(_, text) lines[#lines + 1] = text end } -- luacheck: ignore
  for _, is_gui in ipairs { false, true } do
    function _G.gui_enabled() return is_gui end
    require("yapp.host.preferences").complain { "a", "b" }
    _G.report_failure = nil
  end
  io.stderr = stderr -- luacheck: ignore
  lu.assertEquals({ lines, said }, { { "yapp: a\n", "yapp: b\n", "yapp: a\n", "yapp: b\n" }, {} })
end

function T.test_link_types()
  local take = require("yapp.host.preferences").register_link_types
  local links = tables.wtap_encap or {}
  tables.wtap_encap = links
  links[46] = "the user's table"
  lu.assertEquals(take("147-148,162", "serial"), {})
  lu.assertEquals({ links[45], links[46], links[60], links[47] }, { "serial", "serial", "serial" })
  take("147", "serial")
  lu.assertEquals({ links[45], links[46], links[60] == nil }, { "serial", "the user's table", true })
  take("147-148", "serial")
  lu.assertEquals(take("1,146", "serial"), { "yapp.user_dlt: link type 1 is no DLT_USER; those are 147 to 162" })
  lu.assertEquals({ links[45] == nil, links[46] }, { true, "the user's table" })
end

-- The preferences as they are defined: { name, constructor, default }.
function T.test_definitions()
  local constructor = function(kind)
    return function(title, default, about, more) return { kind, title, default, about, more } end
  end
  _G.Pref = {}
  for _, kind in ipairs { "enum", "range", "string", "bool" } do _G.Pref[kind] = constructor(kind) end
  local proto = { prefs = {} }
  local motor = { name = "motor", title = "Motor Data", id = 0x210, every = 0.1 }
  local odd = { name = "odd", title = "Odd", id = 5 }
  local kinds = { MAPPING = 6, WORKED_EXAMPLES = 5 }
  require("yapp.host.preferences").define(proto, { messages = { motor, odd } }, kinds, 2047)
  local found = {}
  for name, pref in pairs(proto.prefs) do
    lu.assertTrue(#pref[2] > 5 and #pref[4] > 20, name)
    found[name] = { pref[1], pref[3] }
  end
  local titles = {}
  for name, pref in pairs(proto.prefs) do titles[name] = pref[2] end
  lu.assertEquals(titles, {
    divisor = "Compressed floats divide by", motor_ids = "Motor Data message IDs (0x210 = 528)",
    odd_ids = "Odd message IDs (0x5 = 5)", messages = "File with your own messages", sources = "Names of sources",
    hide_source = "Leave the source out of Info", hide_values = "Leave values out of Info that have columns",
    late = "Report a gap longer than ... periods", all_extended = "All extended CAN frames are YAPP",
    search_all = "Look for YAPP in all TCP, UDP and USB traffic", user_dlt = "Link types that carry a serial stream",
  })
  lu.assertEquals(found, {
    divisor = { "enum", 6 }, motor_ids = { "range", "0x210" }, odd_ids = { "range", "0x5" },
    messages = { "string", "" }, sources = { "string", "" }, hide_source = { "bool", false },
    hide_values = { "bool", false }, late = { "string", "2.5" }, all_extended = { "bool", false },
    search_all = { "bool", false }, user_dlt = { "range", "" },
  })
  local prefs = proto.prefs
  lu.assertEquals({ prefs.motor_ids[5], prefs.user_dlt[5] }, { 2047, 162 })
  lu.assertEquals(prefs.divisor[5], { { 1, "2^N - 6 (mapping)", 6 }, { 2, "2^N - 5 (worked examples)", 5 } })
  lu.assertStrContains(prefs.motor_ids[4], "several controllers share a bus: 0x210-0x213.")
  lu.assertStrContains(prefs.late[4], "Periods: Motor Data 0.1 s.")
  lu.assertStrContains(prefs.motor_ids[4], "0x210 by default, which Wireshark shows as 528.")
end

-- Ports -------------------------------------------------------------------------------------------

function T.test_ports()
  local ports = require("yapp.host.ports")
  local own, other = setmetatable({ name = "yapp_port" }, { __tostring = function() return "yapp_port" end }), "another"
  ports.use(own, "dissector")
  tables["tcp.port"][80] = other
  ports.register(true, 80)
  lu.assertNil(own.dissector, "most captures need none")
  ports.register(true, 14550)
  ports.register(false, 14550)
  ports.register(false, 9)
  lu.assertEquals({ tables["tcp.port"][80], tables["tcp.port"][14550], tables["udp.port"][14550] }, { other, own, own })
  lu.assertEquals(own.dissector, "dissector")
  local function is_of_others(kind, from, to)
    return ports.is_of_others { port_type = kind, src_port = from, dst_port = to }
  end
  tables["udp.port"][44818] = other
  lu.assertEquals({ is_of_others(3, 44818, 14550), is_of_others(3, 14550, 44818), is_of_others(2, 14550, 44818) },
    { true, true, false })
  lu.assertEquals({ is_of_others(3, 44818, 50000), is_of_others(2, 80, 50000), is_of_others(2, 80, 79) }, { false,
    false, true })
  local function has_other(kind, from, to)
    return ports.has_other { port_type = kind, src_port = from, dst_port = to }
  end
  lu.assertEquals({ has_other(3, 44818, 50000), has_other(3, 50000, 44818), has_other(2, 44818, 50000),
    has_other(2, 14550, 50000), has_other(2, 50000, 80) }, { true, true, false, false, true })
  tables["udp.port"][44818] = nil
  tables["udp.port"][9] = other -- the user's Decode As
  ports.unregister_all()
  lu.assertEquals({ tables["tcp.port"], tables["udp.port"] }, { { [80] = other }, { [9] = other } })
  tables["tcp.port"][14550] = own
  ports.unregister_all() -- of what it took before nothing is left
  lu.assertEquals(tables["tcp.port"][14550], own)
end

-- TCP ---------------------------------------------------------------------------------------------

-- A segment as Wireshark's TCP gets it: the flags, the header's length in bytes, what follows, how
-- much was sent, and how much captured.
local function segment(flags, header, data, sent, captured, reserved)
  local ports, seq, ack = "\18\52\0\80", "\255\255\255\255", "\0\0\0\9"
  local bytes = ports .. seq .. ack .. string.char(header * 4 + (reserved or 0),
    flags) .. ("\0"):rep(header - 14) .. data
  bytes = bytes:sub(1, captured)
  return {
    len = function() return #bytes end,
    reported_len = function() return sent or #bytes end,
    offset = function() return 34 end,
    raw = function(_, from, count) return bytes:sub(from + 1, from + count) end,
  }
end

local function watched()
  local tcp, proto, seen = require("yapp.host.tcp"), {}, {}
  tcp.watch(proto, function(one) seen[#seen + 1] = one end)
  local function dissect(tvb, number, in_error)
    return proto.dissector(tvb, { number = number, abs_ts = 5, in_error_pkt = in_error }, {})
  end
  return tcp, proto, seen, dissect
end

function T.test_headers_of_segments()
  local _, proto, seen, dissect = watched()
  lu.assertEquals(tables["ip.proto"][6], proto)
  lu.assertEquals(dissect(segment(16, 20, "abc"), 1), 7)
  dissect(segment(2, 24, "", nil), 2) -- SYN: its number counts
  dissect(segment(20, 20, "abc"), 3) -- RST: what it carries is no data
  dissect(segment(16, 20, "abc", 30), 4) -- cut by the capture
  lu.assertEquals(seen[1], { offset = 54, start = 20, length = 3, seq = 0xFFFFFFFF, ack = 9, is_syn = false,
    is_end = false, number = 1, epoch = 5, is_ours = false })
  lu.assertEquals({ seen[2].seq, seen[2].ack, seen[2].is_syn, seen[2].start, seen[2].length, seen[2].offset },
    { 0, nil, true, 24, 0, 58 })
  lu.assertEquals({ seen[3].length, seen[3].ack, seen[4].length, #seen }, { 0, 9, 10, 4 })
  lu.assertEquals({ seen[2].is_end, seen[3].is_end }, { false, true })
  dissect(segment(1, 20, "abc", nil, nil, 1), 9) -- FIN; a reserved bit
  lu.assertEquals({ seen[5].is_syn, seen[5].is_end, seen[5].ack, seen[5].start }, { false, true, nil, 20 })
  seen[5] = nil
  dissect(segment(16, 20, "abc"), 5, true) -- an ICMP error quotes it
  dissect(segment(16, 20, "", 40, 19), 6)
  dissect(segment(16, 16, "abcdefgh"), 7)
  dissect(segment(16, 24, "", nil, 22), 8)
  lu.assertEquals(#seen, 4)
  dissect(segment(17, 20, ""), 10) -- an end without data
  lu.assertEquals({ #seen, seen[5].is_end, seen[5].length }, { 5, true, 0 })
end

-- When Wireshark reloads its Lua plugins, the watch that was there takes TCP away with it.
function T.test_tcp_comes_back()
  tables["ip.proto"] = {}
  require("yapp.host.tcp")
  lu.assertEquals(tables["ip.proto"][6].name, "tcp")
  tables["ip.proto"][6], package.loaded["yapp.host.tcp"] = "what is there", nil
  require("yapp.host.tcp")
  lu.assertEquals(tables["ip.proto"][6], "what is there")
end

function T.test_the_current_segment()
  local tcp, _, seen = watched()
  lu.assertNil(tcp.current(1))
  local inside
  tcp.stop()
  lu.assertEquals(tables["ip.proto"][6].name, "tcp")
  tables["ip.proto"][6].call = function()
    inside = { tcp.current(1), tcp.current(2) }
    return 3
  end
  local proto = {}
  tcp.watch(proto, function(one) seen[#seen + 1] = one end)
  tcp.watch({}, function() error("one watch is enough") end)
  proto.dissector(segment(16, 20, "abc"), { number = 1, abs_ts = 5 }, {})
  lu.assertEquals({ inside[1] == seen[1], inside[2], tcp.current(1) }, { true, nil, nil })
end

-- A tunnel has TCP in TCP: behind the inner segment the outer one is current again.
function T.test_a_segment_in_a_segment()
  local tcp, _, seen = watched()
  tcp.stop()
  local proto, depth, current = {}, 0, nil
  tables["ip.proto"][6].call = function()
    depth = depth + 1
    if depth == 1 then
      proto.dissector(segment(16, 20, "inner"), { number = 1, abs_ts = 5 }, {})
      current = tcp.current(1)
    end
    return 3
  end
  tcp.watch(proto, function(one) seen[#seen + 1] = one end)
  proto.dissector(segment(16, 20, "outer one"), { number = 1, abs_ts = 5 }, {})
  lu.assertEquals({ seen[1].length, seen[2].length, current == seen[2] }, { 5, 9, true })
end

-- TCP's dissector throws past Lua: its call never returns, so that the next packet finds it inside.
function T.test_a_watch_that_is_thrown_past_ends()
  local tcp, proto, _, dissect = watched()
  tcp.stop()
  tables["ip.proto"][6].call = function() error(nil) end
  local own_pcall, count = pcall, 0
  tcp.watch(proto, function() end)
  function _G.pcall() own_pcall(error) error("past Lua") end
  for number = 1, 40 do
    if tables["ip.proto"][6] == proto then count = number end
    own_pcall(dissect, segment(16, 20, "abc"), number)
  end
  _G.pcall = own_pcall
  lu.assertEquals(count, 25)
  tcp.watch({}, function() end)
  lu.assertEquals(tables["ip.proto"][6].name, "tcp")
end

-- USB ---------------------------------------------------------------------------------------------

function T.test_packets_of_usb()
  local shown = {}
  local function inner(name)
    return { call = function() shown[#shown + 1] = name return 5 end }
  end
  tables.wtap_encap = { [95] = inner("usbmon"), [115] = inner("mapped"), [152] = inner("pcap") }
  local usb, proto, seen = require("yapp.host.usb"), {}, {}
  local mapped = tables.wtap_encap[115]
  usb.watch(proto, function(kind) seen[#seen + 1] = kind end)
  usb.watch({}, function() end)
  lu.assertEquals({ tables.wtap_encap[95], tables.wtap_encap[115] }, { proto, proto })
  local tvb = { len = function() return 9 end }
  lu.assertEquals({ proto.dissector(tvb, { match_uint = 115 }), proto.dissector(tvb, { match_uint = 95 }) }, { 5, 5 })
  lu.assertEquals({ shown, seen, usb.notes() }, { { "mapped", "usbmon" }, { "usbmon_mapped", "usbmon" }, {} })
  lu.assertEquals({ proto.dissector(tvb, { match_uint = 152 }), shown[3], seen[3] }, { 5, "pcap", "usbpcap" })
  for _ = 1, 30 do proto.dissector(tvb, { match_uint = 95 }) end
  mapped.call = function() error("damaged") end
  lu.assertEquals(proto.dissector(tvb, { match_uint = 115 }), 9)
  local own_pcall, count = pcall, 0
  function _G.pcall() error("past Lua") end
  for number = 1, 30 do
    if tables.wtap_encap[95] == proto then count = number end
    own_pcall(proto.dissector, tvb, { match_uint = 95 })
  end
  _G.pcall = own_pcall
  lu.assertEquals(count, 24)
  lu.assertEquals(tables.wtap_encap[115], mapped)
  lu.assertEquals(usb.notes(), { "Wireshark failed at 24 USB packets: those behind them were not searched" })
end

return T
