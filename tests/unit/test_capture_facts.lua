-- SPDX-License-Identifier: GPL-2.0-or-later
-- The bus, the times and the losses of a capture, and tshark's command line.  Wireshark's API, the file and its reader
-- are stand-ins here; tests/e2e has the real ones.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local unpack_all = table.unpack or unpack -- luacheck: ignore

local T = {}

local GLOBALS = { "FileHandler", "register_filehandler", "gui_enabled", "Listener" }
local MODULES = { "yapp.capture.capture", "yapp.capture.file", "yapp.capture.fields", "yapp.capture.command_line",
  "yapp.file.readers" }
local real = { open = io.open, loaded = {} }
local HEAD = "12345678" -- the first bytes of a file that is longer
local seen, said

function T.setUp()
  seen, said = { taps = {}, removed = 0 }, {}
  for _, name in ipairs(MODULES) do
    real.loaded[name] = package.loaded[name]
    package.loaded[name] = nil
  end
  _G.FileHandler = { new = function(_, name, _, kind) return { name = name, kind = kind } end }
  function _G.register_filehandler(handler) seen.handler = handler end
  function _G.gui_enabled() return said.is_gui or false end
  _G.Listener = { new = function(...)
    local tap = { ... }
    function tap.remove() seen.removed = seen.removed + 1 end
    table.insert(seen.taps, tap)
    return tap
  end }
end

function T.tearDown()
  for _, name in ipairs(GLOBALS) do _G[name] = nil end
  for _, name in ipairs(MODULES) do package.loaded[name] = real.loaded[name] end
  io.open = real.open -- luacheck: ignore
end

-- tshark's command line -----------------------------------------------------------------------------------------------

-- Let tshark have a command line: its words.
local function set_command_line(...)
  local text = table.concat({ "tshark", ... }, "\0") .. "\0"
  function io.open(path) -- luacheck: ignore
    return path == "/proc/self/cmdline" and { read = function() return text end, close = function() end } or nil
  end
end

function T.test_options_of_the_command_line()
  set_command_line("-w", "out.pcapng")
  local command = require("yapp.capture.command_line")
  lu.assertEquals(command.options(), { w = "out.pcapng" })
  said.is_gui = true
  lu.assertEquals(command.options(), {})
  said.is_gui = false
  function io.open() end -- luacheck: ignore
  lu.assertEquals(command.options(), {})
end

-- Captures ------------------------------------------------------------------------------------------------------------

-- The capture of a file.
-- found  what capture.file says of it
-- with   { words = of the command line, head, has_two_passes, why = it is damaged,
--        is_missed = it was opened before the plugin was loaded }
local function capture_of(found, with)
  with = with or {}
  found.names, found.drops, found.count = found.names or {}, found.drops or {}, found.count or 0
  function found.bus_finder(_, compares_times, later)
    seen.compares_times, seen.later = compares_times, later
    return function(number) return "in file " .. number, "known" end
  end
  function found.bus_by_fields(_, ...)
    seen.by_fields = { ... }
    return said.bus_by_fields
  end
  set_command_line(unpack_all(with.words or { "-r", "flight.pcapng" }))
  package.loaded["yapp.capture.capture"] = nil
  package.loaded["yapp.capture.file"] = { HEAD = #HEAD, read = function(head, more)
    if head == "" then return { names = {}, drops = {}, count = 0, bus_finder = found.bus_finder } end
    seen.head, seen.more = head, more
    return found
  end }
  package.loaded["yapp.capture.fields"] = function() return said.fields or {} end
  package.loaded["yapp.file.readers"] = { forget = function() seen.forgotten = true end,
    log = function() return said.log or {} end, current = function() return unpack_all(said.current or {}) end }
  local capture = require("yapp.capture.capture").watch()
  local file = {}
  function file.read() return with.head or HEAD, with.why end
  function file.seek(_, how, offset)
    if offset > 2 ^ 40 then return not with.has_two_passes and offset or nil end
    seen.sought = { how, offset }
    return offset
  end
  if not with.is_missed then lu.assertFalse(seen.handler.read_open(file, {})) end
  capture:init()
  return capture
end

function T.test_the_head_of_a_file()
  capture_of { is_told = true }
  lu.assertEquals({ seen.head, seen.forgotten, seen.handler.name, seen.handler.kind, seen.sought },
    { HEAD, true, "yapp_head", "rms", { "set", 0 } })
  lu.assertEquals({ seen.more(5, 3), seen.sought }, { HEAD, { "cur", 5 } })
  lu.assertEquals({ seen.handler.read(), seen.handler.seek_read(), seen.compares_times }, { false, false, true })
end

-- Of a pipe Wireshark rewinds the first bytes alone.
function T.test_what_is_a_file()
  local function is_read_on(with)
    capture_of({ is_told = true }, with)
    return seen.more(0, 3) ~= nil
  end
  lu.assertFalse(is_read_on { words = { "-r", "-" } })
  lu.assertFalse(is_read_on { words = { "-r", "/dev/fd/63" } })
  lu.assertFalse(is_read_on { words = {} }, "the system tells no command line")
  lu.assertFalse(is_read_on { head = "short" }, "it has no more")
  lu.assertTrue(is_read_on { words = { "--read-file=a.gz" } })
  lu.assertTrue(is_read_on { words = {}, has_two_passes = true })
  said.is_gui = true
  lu.assertTrue(is_read_on { words = {} }, "Wireshark's windows open files alone")
  lu.assertFalse(seen.compares_times, "a user may shift the times there")
end

-- When fields tell the bus: of a live capture, behind what was read of a pipe, of a damaged file.
function T.test_when_fields_are_needed()
  local pipe = { words = { "-r", "-" } }
  for i, row in ipairs {
    { {}, {}, 0 }, { { is_live = true }, {}, 1 }, { { has_several = true }, { head = "short" }, 1 },
    { { has_several = true }, {}, 0 }, { { may_add_buses = true }, pipe, 1 }, { {}, pipe, 0 },
    { { may_add_buses = true }, { words = pipe.words, head = "short" }, 0 },
    { {}, { why = "damaged" }, 1 }, { {}, { is_missed = true }, 0 },
  } do
    seen.taps, row[1].is_told = {}, true
    capture_of(row[1], row[2])
    lu.assertEquals(#seen.taps, row[3], i)
  end
end

function T.test_the_tap_goes_with_its_file()
  local found = { is_told = true, is_live = true }
  local capture = capture_of(found)
  capture:init()
  lu.assertEquals({ #seen.taps, seen.removed, seen.taps[1][1] }, { 1, 0, "frame" })
  lu.assertStrContains(seen.taps[1][2], "frame.interface_id")
  found.is_live = false
  capture:init()
  lu.assertEquals({ seen.removed, capture.tap }, { 1, nil })
end

function T.test_plugins_that_were_reloaded()
  said.is_gui = true
  lu.assertTrue(capture_of({}, { is_missed = true }):missed_file())
  lu.assertFalse(capture_of({ is_told = true }):missed_file())
end

function T.test_the_bus_of_a_packet()
  local capture = capture_of { is_told = true, has_several = true }
  lu.assertTrue(capture.bus_is_per_packet)
  lu.assertEquals({ capture.bus_of(3, {}) }, { "in file 3", "known" })
  capture = capture_of { is_told = true, count = 5 }
  lu.assertFalse(capture.bus_is_per_packet)
  lu.assertEquals({ capture.bus_of(3, {}) }, { nil, true })
  lu.assertEquals({ capture_of({ is_told = false, is_unknown = true, count = 5 }).bus_of(3, {}) }, { nil, false })
end

function T.test_the_bus_of_a_record_of_ours()
  said.current = { 2, "can1" }
  local capture = capture_of { is_told = false }
  lu.assertTrue(capture.bus_is_per_packet)
  lu.assertEquals({ capture.bus_of(3, {}) }, { 2, true })
  lu.assertEquals(capture:name(2), "can1")
  said.log = { plain_bus = "can0" }
  capture:init()
  lu.assertFalse(capture.bus_is_per_packet)
end

-- Packets behind those that were read when the file was opened.
function T.test_the_bus_by_fields()
  local found = { is_told = true, is_live = true, count = 5 }
  local capture = capture_of(found)
  local function of(number, fields, bus)
    said.fields, said.bus_by_fields = fields, bus
    return { capture.bus_of(number, {}) }
  end
  lu.assertEquals(of(5, { ["frame.interface_id"] = 7 }, 2), { nil, true }, "the file told it")
  lu.assertEquals(of(6, { ["frame.interface_id"] = 7, ["frame.interface_name"] = "can1" }, 2), { 2, true })
  lu.assertEquals(seen.by_fields, { 7, 0, nil, "can1", nil })
  lu.assertEquals(of(6, {}, nil), { 2, true }, "it is kept: later there may be no tree")
  lu.assertEquals(of(7, { ["sll.ifindex"] = 4, ["frame.interface_name"] = "unknown" }, 1), { nil, true })
  lu.assertEquals(seen.by_fields, { 0, 4, nil, nil, nil })
  lu.assertEquals(of(8, { ["rtacser.eventtype"] = 2, ["frame.packet_flags_direction"] = 1 }, 3), { 3, true })
  lu.assertEquals(seen.by_fields, { 0, 0, 2, nil, 1 })
  lu.assertEquals(of(9, {}, 3), { nil, true }, "they do not tell it")
  found.has_several = true
  lu.assertEquals({ seen.later(6) }, { 2, true })
  lu.assertEquals({ seen.later(10) }, { nil, false })
  said.fields = { ["frame.interface_id"] = 0, ["frame.section_number"] = 2 }
  lu.assertEquals({ seen.later(11) }, { nil, false }, "a later section")
  capture:init()
  lu.assertEquals({ seen.later(6) }, { nil, false }, "another file")
end

function T.test_what_the_file_or_its_reader_says()
  said.log = { has_several = true, drops = { "of the log" }, lacks_times = true, lacks_clock = true,
    stamps_differ = true }
  local capture = capture_of { is_told = true, drops = { "of the file" } }
  lu.assertEquals({ capture:drops(), capture:is_time_real(0), capture:are_several(), capture:has_times() },
    { { "of the file" }, true, true, true, true })
  capture = capture_of { is_told = false }
  lu.assertEquals({ capture:drops(), capture:has_times() }, { { "of the log" }, false, false })
  said.log = { lacks_clock = true }
  lu.assertEquals({ capture:drops(), capture:is_time_real(1), capture:has_times() }, { {}, false, true, false })
  capture = capture_of { is_told = true, lacks_times = true, has_several = true, stamps_differ = true }
  lu.assertEquals({ capture:is_time_real(0), capture:are_several(), capture:has_times() },
    { false, true, false, false })
  capture = capture_of { is_told = true }
  lu.assertEquals({ capture:is_time_real(0), capture:is_time_real(1) }, { false, true })
end

-- The times of packets count from that of the first one.
function T.test_when_times_begin()
  local capture = capture_of { is_told = true, first = { 1700000000, 123456789 } }
  local begin = { capture:begin { abs_ts = 1700000007.1234567, rel_ts = 7 } }
  lu.assertEquals(begin, { 1700000000, 123456789 })
  begin = { capture:begin { abs_ts = 1700000007.25, rel_ts = 2.5 } }
  lu.assertEquals(begin, { 1700000004, 750000000 }, "a read filter dropped the first packet")
  capture = capture_of { is_told = false }
  lu.assertEquals({ capture:begin { abs_ts = 5.5, rel_ts = 5.25 } }, { 0, 250000000 })
  said.log = { first = { 0, 250000001 } }
  lu.assertEquals({ capture:begin { abs_ts = 5.5, rel_ts = 5.25 } }, { 0, 250000001 }, "a reader of ours tells it")
end

function T.test_names()
  local capture = capture_of { is_told = true }
  function capture.found.name(_, ...)
    seen.asked = { ... }
    return said.name
  end
  capture.plain_bus = "can0"
  lu.assertEquals({ capture:name(2, true), seen.asked, capture:name(nil) }, { nil, { 2, true }, "can0" })
  said.name = "can7"
  lu.assertEquals({ capture:name(2), capture:name(nil) }, { "can7", "can7" })
end

return T
