-- SPDX-License-Identifier: GPL-2.0-or-later
-- Readers of files between Wireshark and the formats, the bus and the losses of a capture, and tshark's command line.
-- Wireshark's API and the formats are stand-ins here; tests/e2e has the real ones.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local unpack_all = table.unpack or unpack -- luacheck: ignore

local T = {}

local GLOBALS = { "FileHandler", "register_filehandler", "get_version", "gui_enabled", "NSTime", "Dir", "Listener",
  "wtap_encaps", "wtap_rec_types", "wtap_presence_flags", "wtap_tsprecs" }
local MODULES = { "yapp.file.readers", "yapp.file.asc", "yapp.file.candump", "yapp.file.dump", "yapp.host.buses",
  "yapp.host.capture", "yapp.host.command", "yapp.host.socketcan", "yapp.base.later" }
local real = { open = io.open, stderr = io.stderr, loaded = {} }

local seen, said

function T.setUp()
  seen = { handlers = {}, opened = {}, said = {}, taps = {}, removed = 0 }
  said = { version = "4.0.17", logs = {} }
  for _, name in ipairs(MODULES) do
    real.loaded[name] = package.loaded[name]
    package.loaded[name] = nil
  end
  _G.FileHandler = { new = function(title, name, about, kind)
    return { title = title, name = name, about = about, kind = kind }
  end }
  function _G.register_filehandler(handler) seen.handlers[handler.name] = handler end
  function _G.get_version() return said.version end
  function _G.gui_enabled() return said.is_gui or false end
  _G.NSTime = { new = function(...) return { ... } end }
  _G.Listener = { new = function(...)
    local tap = { ... }
    function tap.remove() seen.removed = seen.removed + 1 end
    table.insert(seen.taps, tap)
    return tap
  end }
  _G.wtap_encaps = { SLL2 = "SLL2", WIRESHARK_UPPER_PDU = "PDU" }
  _G.wtap_rec_types, _G.wtap_presence_flags = { PACKET = "packet" }, { TS = "has time" }
  _G.wtap_tsprecs = { NSEC = "ns", USEC = "us" }
  local function format(name)
    return { open = function(_, ...)
      seen.opened[#seen.opened + 1] = { name, ... }
      return said.logs[name], said.plain_log
    end }
  end
  for _, name in ipairs { "asc", "candump", "dump" } do package.loaded["yapp.file." .. name] = format(name) end
  io.stderr = { write = function(_, ...) table.insert(seen.said, table.concat({ ... })) end } -- luacheck: ignore
end

function T.tearDown()
  for _, name in ipairs(GLOBALS) do _G[name] = nil end
  for _, name in ipairs(MODULES) do package.loaded[name] = real.loaded[name] end
  io.open, io.stderr = real.open, real.stderr -- luacheck: ignore
end

local function readers()
  local module = require("yapp.file.readers")
  module.register { new_framer = "framer" }
  return module, seen.handlers
end

-- A log whose next record is said.record.
local function log_of(with)
  local log = with or {}
  function log.read() return unpack_all(said.record) end
  function log.seek_read(_, _, offset)
    seen.offset = offset
    return unpack_all(said.record)
  end
  return log
end

local function file_of(head)
  return { read = function(_, count) return head:sub(1, count) end, seek = function() return 0 end }
end

-- Readers -------------------------------------------------------------------------------------------------------------

function T.test_what_is_registered()
  local _, handlers = readers()
  local found = {}
  for name, handler in pairs(handlers) do
    found[name] = { handler.kind, handler.extensions or false }
    lu.assertEquals(handler.about, handler.title)
  end
  lu.assertEquals(found, { yapp_candump = { "rs", false }, yapp_asc = { "r", "asc" }, yapp_dump = { "r", "yapp" } })
end

-- The reader, and the link type of its packets.
function T.test_each_format_opens_its_files()
  local module, handlers = readers()
  for name, row in pairs { yapp_candump = { "candump", "SLL2" }, yapp_asc = { "asc", "SLL2" },
    yapp_dump = { "dump", "PDU" } } do
    local capture, format = {}, row[1]
    local file = file_of("head")
    module.forget()
    lu.assertFalse(handlers[name].read_open(file, capture))
    lu.assertEquals({ seen.opened[#seen.opened][1], capture }, { format, {} })
    said.logs[format] = log_of { decimals = 9 }
    lu.assertTrue(handlers[name].read_open(file, capture))
    lu.assertEquals({ capture.encap, capture.time_precision }, { row[2], "ns" })
    lu.assertIs(capture.private_table, said.logs[format])
    said.logs[format].decimals = 6
    handlers[name].read_open(file, capture)
    lu.assertEquals(capture.time_precision, "us")
    said.logs = {}
  end
end

function T.test_reports_name_their_reader()
  local _, handlers = readers()
  local file = file_of("")
  handlers.yapp_candump.read_open(file, {})
  seen.opened[1][2]("line 1")
  handlers.yapp_asc.read_open(file, {})
  seen.opened[2][2]("line 2")
  lu.assertEquals(seen.said, { "candump reader: line 1\n", "ASC reader: line 2\n" })
end

function T.test_records()
  local module, handlers = readers()
  local log, capture, frame = log_of(), {}, {}
  said.logs.candump = log
  handlers.yapp_candump.read_open(file_of(""), capture)
  said.record = { 40, "bytes", 17, 5, { number = 2, name = "can1" }, "a comment" }
  lu.assertEquals(handlers.yapp_candump.read({}, capture, frame), 40)
  lu.assertEquals(frame, { rec_type = "packet", flags = "has time", time = { 17, 5 }, comment = "a comment",
    data = "bytes" })
  lu.assertEquals({ module.current() }, { 2, "can1" })
  module.forget()
  handlers.yapp_candump.read({}, capture, frame)
  lu.assertIs(module.log(), log)
  lu.assertNil(log.lacks_times)
  said.record, frame = { 0, "more", nil, nil, nil, nil }, {}
  lu.assertTrue(handlers.yapp_candump.seek_read({}, capture, frame, 80))
  lu.assertEquals({ frame, seen.offset, log.lacks_times }, { { rec_type = "packet", flags = 0, data = "more" }, 80,
    true })
  lu.assertEquals({ module.current() }, {})
  said.record, frame = { nil }, {}
  lu.assertFalse(handlers.yapp_candump.read({}, capture, frame))
  lu.assertFalse(handlers.yapp_candump.seek_read({}, capture, frame, 80))
  lu.assertEquals(frame, {})
end

function T.test_a_bus_is_forgotten()
  local module, handlers = readers()
  local capture = {}
  said.logs.candump, said.record = log_of(), { 40, "bytes", 17, 5, { number = 2, name = "can1" } }
  for _, forget in ipairs { function() handlers.yapp_candump.read_close() end, module.forget,
    function() handlers.yapp_candump.read_open(file_of(""), {}) end } do
    handlers.yapp_candump.read_open(file_of(""), capture)
    handlers.yapp_candump.read({}, capture, {})
    lu.assertEquals(module.current(), 2)
    forget()
    lu.assertNil(module.current())
  end
end

function T.test_a_log_that_is_left_to_wireshark()
  local module, handlers = readers()
  lu.assertEquals({ module.log(), module.current() }, { {} })
  said.plain_log = { plain_bus = "can0" }
  lu.assertFalse(handlers.yapp_candump.read_open(file_of(""), {}))
  lu.assertIs(module.log(), said.plain_log)
  said.plain_log = nil
  handlers.yapp_candump.read_open(file_of(""), {})
  lu.assertEquals(module.log().plain_bus, "can0", "another file that was only looked at")
  module.forget()
  lu.assertEquals(module.log(), {})
end

-- A file is a dump only if its name ends with .yapp: those of other names are shown to yapp_candump before.
function T.test_dumps_go_by_their_name()
  local module, handlers = readers()
  local file = file_of(("a"):rep(256))
  said.logs.dump = log_of()
  lu.assertFalse(handlers.yapp_candump.read_open(file, {}))
  lu.assertFalse(handlers.yapp_dump.read_open(file, {}))
  lu.assertEquals({ #seen.opened, seen.said }, { 1, {} })
  lu.assertTrue(handlers.yapp_dump.read_open(file, {}), "once")
  lu.assertEquals({ seen.opened[2][2].new_framer, seen.opened[2][3] }, { "framer", ("a"):rep(256) })
  said.logs.dump = nil
  lu.assertFalse(handlers.yapp_dump.read_open(file_of("b"), {}))
  lu.assertStrContains(seen.said[1], "yapp: not opened as a raw serial dump: no YAPP frame with a good CRC")
  handlers.yapp_candump.read_open(file_of("b"), {})
  module.forget()
  handlers.yapp_dump.read_open(file_of("b"), {})
  lu.assertEquals(#seen.said, 2, "it was refused, and is .yapp")
  handlers.yapp_dump.read_open({ read = function() end }, {})
  lu.assertEquals(seen.said[3], "yapp: not opened as a raw serial dump: the file is empty\n")
end

-- tshark's command line -----------------------------------------------------------------------------------------------

local function files(list)
  _G.Dir = { open = function(folder)
    if not list then error("no folder") end
    seen.folder = folder
    local i = 0
    return setmetatable({ close = function() seen.is_closed = true end }, { __call = function()
      i = i + 1
      return list[i]
    end })
  end }
end

function T.test_options_of_the_command_line()
  function io.open(path) -- luacheck: ignore
    return path == "/proc/self/cmdline" and { read = function() return "tshark\0-w\0out.pcapng\0" end,
      close = function() seen.is_closed = true end }
  end
  local command = require("yapp.host.command")
  lu.assertEquals({ command.options().w, seen.is_closed }, { "out.pcapng", true })
  said.is_gui = true
  lu.assertEquals(command.options(), {})
  said.is_gui = false
  function io.open() end -- luacheck: ignore
  lu.assertEquals(command.options(), {})
end

function T.test_files_that_a_capture_went_on_in()
  local count = require("yapp.host.command").count_later_files
  local since = os.time { year = 2026, month = 11, day = 26, hour = 10, min = 0, sec = 0 }
  files { "run_00001_20261126100000.pcapng", "run_00002_20261126100000.pcapng", "run_00003_20261126100001.pcapng",
    "run_00004_20261126095959.pcapng", "run_20261126100100_00005.pcapng", "run_20261126100000_00001.pcapng",
    "other_00002_20261126100100.pcapng", "run.pcapng", "run_2_20261126100000.pcapng",
      "run_00000_20261126100500.pcapng" }
  lu.assertEquals(count({ b = "filesize:1", w = "/tmp/here/run.pcapng" }, since), 3)
  lu.assertEquals({ seen.folder, seen.is_closed }, { "/tmp/here/", true })
  lu.assertEquals(count({ ["ring-buffer"] = "files:2", w = "run" }, since), 3)
  lu.assertEquals(seen.folder, ".")
  lu.assertEquals(count({ w = "run" }, since), 0)
  files(nil)
  lu.assertNil(count({ b = "filesize:1", w = "run" }, since))
end

-- Buses ---------------------------------------------------------------------------------------------------------------

-- The buses of a capture that its head says: found, a stand-in of host.capture.
local function buses_of(found, with)
  with = with or {}
  found.names = found.names or {}
  found.drops = found.drops or {}
  function found.bus_finder(_, compares_times, later)
    seen.compares_times, seen.later = compares_times, later
    return function(number) return "in file " .. number, "known" end
  end
  function found.bus_by_fields(_, ...)
    seen.by_fields = { ... }
    return said.bus_by_fields
  end
  local empty = { names = {}, drops = {}, count = 0, bus_finder = found.bus_finder,
    bus_by_fields = found.bus_by_fields }
  package.loaded["yapp.host.capture"] = { HEAD = 8, read = function(head, more)
    if head == "" then return empty end
    seen.head, seen.more = head, more
    if with.reads_on then more(0, 8) end
    return found
  end }
  package.loaded["yapp.host.socketcan"] = { fields_of = function(names)
    seen.names = names
    return said.fields or {}
  end }
  package.loaded["yapp.file.readers"] = { forget = function() seen.forgotten = true end,
    log = function() return said.log or {} end, current = function() return unpack_all(said.current or {}) end }
  local position = 0
  function io.open(path) -- luacheck: ignore
    if path ~= "/proc/self/fdinfo/7" then return nil end
    return { read = function() return "pos: " .. position end, close = function() end }
  end
  local buses = require("yapp.host.buses").watch()
  local file = { seek = function(_, ...) seen.sought = { ... } end }
  function file.read(_, count)
    seen.count = count
    if not with.is_pipe then position = position + 1 end
    return with.head or "12345678", with.why or position > 1 and with.reads_on or nil
  end
  if not with.is_missed then lu.assertFalse(seen.handlers.yapp_head.read_open(file, {})) end
  buses:init()
  return buses
end

function T.test_the_head_of_a_file()
  buses_of { is_told = true }
  lu.assertEquals({ seen.count, seen.head, seen.forgotten, seen.handlers.yapp_head.kind }, { 8, "12345678", true,
    "rms" })
  lu.assertEquals(seen.more(5, 3), "12345678")
  lu.assertEquals({ seen.sought, seen.count }, { { "cur", 5 }, 3 })
  seen.sought = nil
  seen.more(0, 3)
  lu.assertNil(seen.sought)
  lu.assertEquals({ seen.handlers.yapp_head.read(), seen.handlers.yapp_head.seek_read() }, { false, false })
  lu.assertTrue(seen.compares_times)
end

function T.test_a_pipe_is_not_read_further()
  buses_of({ is_told = true, yapp_interfaces = 0 }, { is_pipe = true })
  lu.assertNil(seen.more(5, 3))
  said.is_gui = true
  package.loaded["yapp.host.buses"] = nil
  buses_of({ is_told = true, yapp_interfaces = 0 }, { is_pipe = true })
  lu.assertEquals(seen.more(5, 3), "12345678", "Wireshark's windows open files alone")
  lu.assertFalse(seen.compares_times)
end

-- When fields tell the bus: of a live capture, behind what was read of a pipe, of a damaged file.
function T.test_when_fields_are_needed()
  local rows = {
    { {}, {}, 0 }, { { is_live = true }, {}, 1 }, { { has_several = true }, { head = "short" }, 1 },
    { { has_several = true }, {}, 0 }, { { yapp_interfaces = 1 }, { is_pipe = true }, 1 },
    { { yapp_interfaces = 0 }, { is_pipe = true }, 0 }, { { yapp_interfaces = 1 }, { is_pipe = true, head = "short" },
      0 },
    { {}, { why = "damaged" }, 1 }, { {}, { reads_on = "damaged" }, 1 }, { {}, { is_missed = true }, 0 },
  }
  for i, row in ipairs(rows) do
    seen.taps, package.loaded["yapp.host.buses"] = {}, nil
    row[1].is_told, row[1].count = true, 5
    row[1].yapp_interfaces = row[1].yapp_interfaces or 0
    buses_of(row[1], row[2])
    lu.assertEquals(#seen.taps, row[3], i)
  end
  lu.assertEquals(seen.removed, 0)
end

function T.test_the_tap_goes_with_its_file()
  local found = { is_told = true, is_live = true, count = 5, yapp_interfaces = 0 }
  local buses = buses_of(found)
  buses:init()
  lu.assertEquals({ #seen.taps, seen.removed, seen.taps[1][1] }, { 1, 0, "frame" })
  lu.assertStrContains(seen.taps[1][2], "frame.interface_id")
  found.is_live = false
  buses:init()
  lu.assertEquals({ seen.removed, buses.tap }, { 1, nil })
end

function T.test_plugins_that_were_reloaded()
  said.is_gui = true
  local buses = buses_of({}, { is_missed = true })
  lu.assertTrue(buses:missed_file())
  package.loaded["yapp.host.buses"] = nil
  lu.assertFalse(buses_of({ is_told = true, yapp_interfaces = 0 }):missed_file())
end

function T.test_the_bus_of_a_packet()
  local buses = buses_of { is_told = true, has_several = true, yapp_interfaces = 0 }
  lu.assertTrue(buses.bus_is_per_packet)
  lu.assertEquals({ buses.of(3, 0, {}) }, { "in file 3", "known" })
  package.loaded["yapp.host.buses"] = nil
  buses = buses_of { is_told = true, yapp_interfaces = 0, count = 5 }
  lu.assertFalse(buses.bus_is_per_packet)
  lu.assertEquals({ buses.of(3, 0, {}) }, { nil, true })
  package.loaded["yapp.host.buses"] = nil
  buses = buses_of { is_told = true, is_unknown = true, carriers = 1, yapp_interfaces = 0, count = 5 }
  lu.assertEquals({ { buses.of(3, 41, {}) }, { buses.of(3, 42, {}) } }, { { nil, false }, { nil, true } })
  buses.found.carriers = 2
  lu.assertEquals({ buses.of(3, 42, {}) }, { nil, false })
end

function T.test_the_bus_of_a_record_of_ours()
  said.current = { 2, "can1" }
  local buses = buses_of { is_told = false, yapp_interfaces = 0, count = 0 }
  lu.assertTrue(buses.bus_is_per_packet)
  lu.assertEquals({ buses.of(3, 0, {}) }, { 2, true })
  lu.assertEquals(buses.found.names[2], "can1")
  said.log = { plain_bus = "can0" }
  buses:init()
  lu.assertFalse(buses.bus_is_per_packet)
end

-- Packets behind those that were read when the file was opened.
function T.test_the_bus_by_fields()
  local found = { is_told = true, is_live = true, count = 5, yapp_interfaces = 0 }
  local buses = buses_of(found)
  local function of(number, fields, bus)
    said.fields, said.bus_by_fields = fields, bus
    return { buses.of(number, 0, {}) }
  end
  lu.assertEquals(of(5, { ["frame.interface_id"] = 7 }, 2), { nil, true }, "the file told it")
  lu.assertEquals(of(6, { ["frame.interface_id"] = 7, ["frame.interface_name"] = "can1",
    ["frame.section_number"] = 3 }, 2),
    { 2, true })
  lu.assertEquals(seen.by_fields, { 3, 7, 0, nil, "can1", nil })
  lu.assertEquals(of(6, {}, nil), { 2, true }, "it is kept: later there may be no tree")
  lu.assertEquals(of(7, { ["sll.ifindex"] = 4, ["frame.interface_name"] = "unknown" }, 1), { nil, true })
  lu.assertEquals(seen.by_fields, { 1, 0, 4, nil, nil, nil })
  lu.assertEquals(of(8, { ["rtacser.eventtype"] = 2, ["frame.packet_flags_direction"] = 1 }, 3), { 3, true })
  lu.assertEquals(seen.by_fields, { 1, 0, 0, 2, nil, 1 })
  lu.assertEquals(of(9, { ["frame.section_number"] = 1 }, 3), { nil, true }, "they do not tell it")
  lu.assertTrue(seen.names["sll.ifindex"])
  found.has_several = true
  lu.assertEquals({ seen.later(6) }, { 2, true })
  lu.assertEquals({ seen.later(10) }, { nil, false })
  buses:init()
  said.fields = {}
  lu.assertEquals({ seen.later(6) }, { nil, false }, "another file")
end

function T.test_what_the_file_or_its_reader_says()
  said.log = { has_several = true, drops = { "of the log" }, lacks_times = true, lacks_clock = true,
    stamps_differ = true }
  local buses = buses_of({ is_told = true, lacks_times = false, yapp_interfaces = 0, drops = { "of the file" } })
  lu.assertEquals({ buses:drops(), buses:stamps_differ(), buses:are_several(), buses:has_times() },
    { { "of the file" }, true, true, true, true })
  package.loaded["yapp.host.buses"] = nil
  buses = buses_of({ is_told = false, yapp_interfaces = 0 })
  lu.assertEquals({ buses:drops(), buses:has_times() }, { { "of the log" }, false, false })
  said.log = { lacks_clock = true }
  lu.assertEquals({ buses:drops(), buses:stamps_differ(), buses:has_times() }, { {}, false, true, false })
  package.loaded["yapp.host.buses"] = nil
  buses = buses_of({ is_told = true, lacks_times = true, yapp_interfaces = 0, start = 100, has_several = true,
    stamps_differ = true })
  lu.assertEquals({ buses:stamps_differ(), buses:are_several(), buses:has_times() }, { true, true, false, false })
  lu.assertEquals(buses:time { abs_ts = 102.5, rel_ts = 7 }, 2.5)
  buses.seen.start = nil
  buses:init()
  lu.assertEquals(buses:time { abs_ts = 102.5, rel_ts = 7 }, 7)
  function buses.found.name(_, ...)
    seen.asked = { ... }
    return said.name
  end
  buses.plain_bus = "can0"
  lu.assertEquals({ buses:name(2, true), seen.asked, buses:name(nil) }, { nil, { 2, true }, "can0" })
  said.name = "can7"
  lu.assertEquals({ buses:name(2), buses:name(nil) }, { "can7", "can7" })
end

return T
