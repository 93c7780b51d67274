-- SPDX-License-Identifier: GPL-2.0-or-later
-- Readers of files between Wireshark and the formats.  Wireshark's API and the formats are stand-ins here; tests/e2e
-- has the real ones.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local unpack_all = table.unpack or unpack -- luacheck: ignore

local T = {}

local GLOBALS = { "FileHandler", "register_filehandler", "get_version", "gui_enabled", "NSTime", "Dir", "Listener",
  "wtap_encaps", "wtap_rec_types", "wtap_presence_flags", "wtap_tsprecs" }
local MODULES = { "yapp.file.readers", "yapp.file.asc", "yapp.file.candump", "yapp.file.dump" }
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

return T
