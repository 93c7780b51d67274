-- SPDX-License-Identifier: GPL-2.0-or-later
-- The entry point: what yapp.lua registers, when it looks for YAPP, and what it does with a file, a frame and a
-- preference.  Wireshark's API and the modules that call it are stand-ins here; tests/e2e has the real ones.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local field_kinds = require("yapp.message.field_kinds")

local T = {}
local searchers = rawget(package, "searchers")

local GLOBALS = { "Proto", "DissectorTable", "Dissector", "Dir", "gui_enabled", "register_stat_cmd_arg",
  "set_plugin_info", "Listener" }
local TITLES = {} -- of the statistics, typed once more
for _, name in ipairs { "faults", "fault", "events", "summary", "compare", "buses", "csv", "check" } do
  TITLES["yapp," .. name] = true
end

local DEFAULTS = { command_ids = "0", motor_ids = "528", health_ids = "512", sources = "", messages = "", late = "2.5",
  hide_source = false, hide_values = false, all_extended = false, search_all = false, user_dlt = "",
  divisor = field_kinds.MAPPING }

local seen -- what happened, by subject
local said -- what the stand-ins answer
local real = { exit = os.exit, getenv = os.getenv, stderr = io.stderr, loaded = {}, searchers = {} }

-- A stand-in of an object: each method notes its call in seen.calls as "name.method", and returns what `said` has of
-- that.
local function stand_in(name, fields)
  return setmetatable(fields or {}, { __index = function(_, method)
    return function(_, ...)
      local call = name .. "." .. method
      seen.calls[#seen.calls + 1] = call
      seen.arguments[call] = { ... }
      local answer = said[call]
      if type(answer) == "function" then return answer(...) end
      return answer
    end
  end })
end

-- The same of a module, whose functions get no self.
local function module(name, fields)
  local object = stand_in(name:match("[%w_]+$"), fields)
  return setmetatable({}, { __index = function(_, key)
    local field = rawget(object, key)
    if field ~= nil then return field end
    return function(...) return object[key](object, ...) end
  end })
end

-- A module whose `new` makes one object.
local function maker(name, object)
  return { new = function(...)
    lu.assertNil(seen.made[name], name .. " is made once")
    seen.made[name] = { ... }
    return object
  end }
end

local function new_proto(name)
  local proto = { name = name, prefs = {}, heuristics = {} }
  function proto.register_heuristic(self, list, f) self.heuristics[#self.heuristics + 1] = { list, f } end
  seen.protos[name] = proto
  return proto
end

local function new_table(name)
  local own = seen.tables[name] or { added = {}, decode_as = {} }
  seen.tables[name] = own
  return {
    add = function(_, key, proto)
      lu.assertNil(own.added[tostring(key)], "each is registered once")
      own.added[tostring(key)] = proto.name
    end,
    add_for_decode_as = function(_, proto) own.decode_as[#own.decode_as + 1] = proto.name end,
  }
end

local function calls_of(pattern)
  local found = {}
  for _, call in ipairs(seen.calls) do
    if call:find(pattern) then found[#found + 1] = call end
  end
  return found
end

local function set_globals(is_gui)
  _G.Proto = new_proto
  _G.DissectorTable = { get = new_table }
  _G.Listener = { new = function() return {} end }
  _G.Dissector = { get = function(name) return stand_in("dissector " .. name) end }
  _G.Listener = { new = function() return {} end }
  _G.Dir = { personal_config_path = function(name) return (said.config or "/nowhere/") .. name end }
  function _G.gui_enabled() return is_gui end
  function _G.register_stat_cmd_arg(name, f) seen.statistics[name] = f end
  function _G.set_plugin_info(info) seen.info = info end
end

local function set_modules()
  local found = { head = false, may_have_frames = false, has_serial_frames = false }
  function found.serial_options() return { "-d serial" } end
  local stands = {
    ["yapp.capture.capture"] = { watch = function() return stand_in("buses", { found = found }) end },
    ["yapp.host.preferences"] = module("preferences"),
    ["yapp.host.can_ids"] = { new = function() return stand_in("ids") end },
    ["yapp.host.header"] = { new = function() return stand_in("headers") end },
    ["yapp.host.can"] = maker("can", stand_in("frames")),
    ["yapp.host.stream"] = maker("stream", stand_in("streams")),
    ["yapp.file.readers"] = module("readers"),
    ["yapp.reading.reading"] = maker("reading", stand_in("reading")),
    ["yapp.show.fields"] = module("fields", { EXPERT_NAMES = { ["command.key.invalid"] = true } }),
    ["yapp.show.frame"] = maker("frame view", {}),
    ["yapp.show.packet"] = maker("packet view", {}),
    ["yapp.show.taurus"] = maker("taurus view", {}),
    ["yapp.show.wants"] = maker("wants", stand_in("wants")),
    ["yapp.show.menu"] = module("show_menu"),
    ["yapp.stat.taps"] = maker("taps", stand_in("stat")),
  }
  for name, stand in pairs(stands) do package.loaded[name] = stand end
  return found
end

function T.setUp()
  seen = { calls = {}, arguments = {}, made = {}, protos = {}, tables = {}, statistics = {}, stderr = {} }
  said = {
    ["preferences.parse_range"] = function(text) return text and { tonumber(text) } or {} end,
    ["preferences.parse_late"] = function(text) return tonumber(text), {} end,
    ["preferences.register_link_types"] = function() return {} end,
    ["preferences.define"] = function(proto, catalogue)
      seen.catalogue = catalogue
      for name, value in pairs(DEFAULTS) do proto.prefs[name] = value end
    end,
    ["streams.undecoded_options"] = {},
    ["fields.of_yapp"] = {}, ["fields.of_taurus"] = {}, ["fields.rows"] = {},
  }
  for name in pairs(package.loaded) do if name:find("^yapp%.") then real.loaded[name] = package.loaded[name] end end
  for i, searcher in ipairs(searchers) do real.searchers[i] = searcher end
  package.loaded["yapp.plugin"] = nil
  function os.exit(code) error({ code = code }, 0) end -- luacheck: ignore
  function os.getenv(name) return said[name] end -- luacheck: ignore
  io.stderr = { write = function(_, ...) table.insert(seen.stderr, table.concat({ ... })) end } -- luacheck: ignore
end

function T.tearDown()
  for _, name in ipairs(GLOBALS) do _G[name] = nil end
  for name in pairs(package.loaded) do if name:find("^yapp%.") then package.loaded[name] = real.loaded[name] end end
  while searchers[1] do table.remove(searchers) end
  for i, searcher in ipairs(real.searchers) do searchers[i] = searcher end
  package.loaded["yapp.plugin"] = nil
  os.exit, os.getenv, io.stderr = real.exit, real.getenv, real.stderr -- luacheck: ignore
end

-- Load the plugin; return its protocols by name, what is found in the file, and what the module returns.
local function load(is_gui)
  set_globals(is_gui or false)
  local found = set_modules()
  local returned = dofile("yapp.lua")
  return seen.protos, found, returned
end

-- Load it, and open a file.
local function open(is_gui, change)
  local protos, found = load(is_gui)
  if change then change(protos.yapp.prefs, found) end
  seen.calls = {}
  protos.yapp.init()
  return protos, found
end

-- Registration --------------------------------------------------------------------------------------------------------

function T.test_what_is_registered()
  load()
  TITLES.yapp = true
  for name in pairs(seen.statistics) do lu.assertTrue(TITLES[name], name) end
  for name in pairs(TITLES) do lu.assertNotNil(seen.statistics[name], name) end
  local decode_as = {}
  for name, own in pairs(seen.tables) do decode_as[name] = own.decode_as[1] end
  lu.assertEquals(decode_as, { ["can.subdissector"] = "yapp_all", ["tcp.port"] = "yapp_serial",
    ["tls.port"] = "yapp_serial", ["udp.port"] = "yapp_serial", ["rtacser.data"] = "yapp_serial" })
  lu.assertStrMatches(seen.info.version, "%d+%.%d+%.%d+")
  lu.assertEquals(calls_of("^stat"), {}, "statistics are made when one begins")
  lu.assertEquals(package.loaded["yapp.plugin"], { version = seen.info.version, path = "./yapp.lua" })
end

function T.test_a_second_copy()
  load()
  local first = package.loaded["yapp.plugin"]
  lu.assertIs(dofile("yapp.lua"), first)
  local text = "yapp: ./yapp.lua (%s) is not loaded: ./yapp.lua (%s) is already there; remove or " ..
    "update one of the two\n"
  lu.assertEquals(seen.stderr, { text:format(first.version, first.version) })
  first.version = "0.1"
  dofile("yapp.lua")
  lu.assertStrContains(seen.stderr[2], "(0.1) is already there; remove or update one of the two\n")
end

function T.test_modules_are_found_beside_the_plugin()
  load()
  lu.assertNil(searchers[2]("other.module"))
  local ok, problem = pcall(searchers[2], "yapp.nowhere.at_all")
  lu.assertEquals({ ok, problem:match("^[^:]*") }, { false, "cannot open ./yapp/nowhere/at_all.lua" })
  lu.assertEquals(searchers[2]("yapp.stat.names")()[1], require("yapp.stat.names")[1])
end

local OWN = 'return { { name = "own%d", title = "Own", id = 0x30%d, size = 1, { "value", "uint8", "Value" } } }'

-- The user's own messages: of the personal folder, of the default profile's preference, of the environment.
function T.test_own_messages()
  local folder = os.tmpname()
  os.remove(folder)
  said.config, said.YAPP_MESSAGES = folder, folder .. "3.lua"
  local files = { ["yapp_messages.lua"] = OWN:format(1, 1), ["preferences"] = "yapp.messages: " .. folder .. "2.lua\n",
    ["2.lua"] = OWN:format(2, 2), ["3.lua"] = OWN:format(3, 3) }
  for name, text in pairs(files) do
    local file = assert(io.open(folder .. name, "w"))
    file:write(text)
    file:close()
  end
  local protos = load()
  for name in pairs(files) do os.remove(folder .. name) end
  local names = {}
  for i, message in ipairs(seen.catalogue.messages) do names[i] = message.name end
  lu.assertEquals(names, { "command", "motor", "health", "own1", "own2", "own3" })
  seen.statistics["yapp,faults"]("yapp,faults")
  for _, path in ipairs { folder .. "2.lua", folder .. "3.lua", "" } do
    protos.yapp.prefs.messages = path
    protos.yapp.prefs_changed()
    lu.assertEquals(seen.made.taps[1].settings.problems, {}, path)
  end
end

function T.test_a_catalogue_that_does_not_load()
  said.YAPP_MESSAGES = "/nowhere/own.lua"
  load(true)
  seen.protos.yapp.init()
  lu.assertEquals(seen.made.taps[1].settings.problems, { "the catalogue did not load whole" })
  lu.assertStrContains(calls_of("^preferences")[1], "complain")
end

-- A file -------------------------------------------------------------------------------------------------------------

function T.test_a_file_without_yapp()
  local protos = open()
  lu.assertEquals(calls_of("^buses%.init"), { "buses.init" })
  lu.assertEquals(calls_of("^headers"), { "headers.reset" })
  lu.assertEquals({ calls_of("^streams"), calls_of("^reading"), calls_of("^stat") }, { {}, {}, {} })
  lu.assertEquals(protos.yapp_serial.heuristics, {})
  lu.assertEquals(protos.yapp_all.heuristics, {})
end

local function heuristics_of(proto)
  local names = {}
  for i, row in ipairs(proto.heuristics) do names[i] = row[1] end
  return names
end

function T.test_a_file_whose_beginning_may_have_yapp()
  local protos = open(false, function(_, found) found.head, found.may_have_frames = "bytes", true end)
  lu.assertEquals(heuristics_of(protos.yapp_serial), { "tcp", "udp" })
  lu.assertEquals(#calls_of("streams.watch"), 1)
  protos.yapp.init()
  lu.assertEquals(heuristics_of(protos.yapp_serial), { "tcp", "udp" })
end

function T.test_all_traffic_is_searched()
  local protos = open(false, function(prefs) prefs.search_all = true end)
  lu.assertEquals(heuristics_of(protos.yapp_serial), { "tcp", "udp" })
end

function T.test_another_file()
  said["buses.are_several"] = true
  local protos = open(true)
  local types = seen.made.reading[1]
  lu.assertTrue(types.has_several)
  lu.assertEquals(calls_of("reset$"),
    { "headers.reset", "stat.reset", "reading.reset", "wants.reset", "frames.reset", "streams.reset" })
  local options = seen.arguments["reading.reset"][1]
  lu.assertEquals({ options.late, options.catalogue == seen.catalogue, options.buses ~= nil }, { 2.5, true, true })
  said["buses.are_several"] = false
  protos.yapp.init()
  lu.assertFalse(types.has_several)
end

-- Preferences --------------------------------------------------------------------------------------------------------

function T.test_what_is_read_of_preferences()
  open(true, function(prefs)
    prefs.hide_values, prefs.late, prefs.sources = true, "3", "0x210=motor:left"
  end)
  local settings, types = seen.made.taps[1].settings, seen.made.reading[1]
  lu.assertEquals(types.hidden, { source = false, values = true })
  lu.assertEquals({ settings.late, settings.sources_text, settings.accepts_all }, { 3, "0x210=motor:left", false })
  lu.assertEquals(settings.ids, { command = { 0 }, motor = { 528 }, health = { 512 } })
  lu.assertEquals((select(2, settings.sources:find("can0", 0x210))), "left")
  lu.assertEquals(settings.problems, {})
  lu.assertIs(seen.made.can[5], settings)
end

function T.test_all_extended_frames()
  local protos = open(false, function(prefs) prefs.all_extended = true end)
  lu.assertEquals(heuristics_of(protos.yapp_all), { "can" })
  lu.assertEquals(calls_of("headers.start"), { "headers.start" })
  protos.yapp.init()
  lu.assertEquals(#protos.yapp_all.heuristics, 1)
  said["frames.dissect_any"] = 1
  lu.assertTrue(protos.yapp_all.heuristics[1][2]("tvb", "pinfo", "root"))
  lu.assertEquals(seen.arguments["frames.dissect_any"], { "tvb", "pinfo", "root" })
  lu.assertEquals(protos.yapp_all.dissector("tvb", "pinfo", "root"), 1)
  said["frames.dissect_any"] = 0
  lu.assertFalse(protos.yapp_all.heuristics[1][2]("tvb", "pinfo", "root"))
end

function T.test_wishes_that_were_not_met()
  said["preferences.parse_late"] = function() return 2.5, { "late" } end
  said["preferences.register_link_types"] = function() return { "link types" } end
  open(true, function(prefs) prefs.messages, prefs.motor_ids, prefs.sources = "/own.lua", "0", "x" end)
  local problems = seen.made.taps[1].settings.problems
  lu.assertEquals(#problems, 5)
  lu.assertEquals(problems[1], "/own.lua, the file with your own messages, was not read")
  lu.assertStrContains(problems[2], "preferences: ID 0x0 is given to")
  lu.assertStrContains(problems[3], "preferences: yapp.sources:")
  lu.assertEquals({ problems[4], problems[5] }, { "preferences: late", "preferences: link types" })
  lu.assertEquals(#calls_of("complain_once"), 2)
end

-- Statistics ---------------------------------------------------------------------------------------------------------

function T.test_a_statistic_begins()
  local protos = load()
  seen.statistics["yapp,faults"]("yapp,faults")
  lu.assertEquals(seen.arguments["stat.begin"], { "yapp,faults" })
  local parts = seen.made.taps[1]
  parts.watch()
  lu.assertEquals(heuristics_of(protos.yapp_all), { "can" })
  lu.assertEquals(heuristics_of(protos.yapp_serial), { "tcp", "udp" })
  parts.unwatch()
  lu.assertEquals(#calls_of("headers.stop"), 1)
  parts.buses.found.is_live = true
  parts.unwatch()
  lu.assertEquals(#calls_of("headers.stop"), 1)
  local tvb, pinfo = {}, {}
  parts.settings.accepts_all = false
  lu.assertFalse(protos.yapp_all.heuristics[1][2](tvb, pinfo))
  lu.assertEquals(seen.arguments["headers.remember"], { tvb, pinfo })
end

function T.test_in_windows()
  local protos = load(true)
  lu.assertEquals(#calls_of("stat.register_menus"), 1)
  lu.assertIs(seen.arguments["show_menu.register"][1], protos.yapp.prefs)
  lu.assertIs(seen.arguments["show_menu.register"][2], seen.catalogue)
  seen.made.taps[1].watch()
  lu.assertEquals(protos.yapp_serial.heuristics, {}, "only the preference and the file decide")
end

function T.test_a_module_is_missing()
  load()
  package.loaded["yapp.stat.taps"] = nil
  package.preload["yapp.stat.taps"] = function() error("broken", 0) end
  local ok, problem = pcall(seen.statistics["yapp,faults"], "yapp,faults")
  package.preload["yapp.stat.taps"] = nil
  lu.assertEquals({ ok, problem.code }, { false, 21 })
end

function T.test_options_that_may_decode_more()
  said["streams.undecoded_options"] = { "-d tcp" }
  local _, found = open(true)
  local parts = seen.made.taps[1]
  lu.assertEquals(parts.find_options(), { "-d tcp" })
  found.has_serial_frames = true
  lu.assertEquals(parts.find_options(), { "-d serial", "-d tcp" })
  said["streams.has_serial"] = true
  lu.assertEquals(parts.find_options(), { "-d tcp" })
  found.may_have_frames = true
end

-- Dissectors ---------------------------------------------------------------------------------------------------------

function T.test_calls_are_counted()
  local protos = open(true)
  local calls = seen.made.taps[1].calls
  lu.assertEquals(calls, { begun = 1, ended = 1 })
  said["streams.dissect"] = 40
  lu.assertEquals(protos.yapp_serial.dissector("tvb", "pinfo", "root"), 40)
  lu.assertEquals(seen.arguments["streams.dissect"], { "tvb", "pinfo", "root" })
  lu.assertEquals(calls, { begun = 2, ended = 2 })
  said["streams.dissect_skipped"] = function() error("broken") end
  lu.assertFalse(pcall(protos.yapp_skipped.dissector, "tvb", "pinfo", "root"))
  lu.assertEquals(calls, { begun = 3, ended = 2 })
  protos.yapp.init()
  lu.assertEquals(calls, { begun = 1, ended = 1 })
  said["buses.init"] = function() error("broken") end
  lu.assertFalse(pcall(protos.yapp.init))
  lu.assertEquals(calls, { begun = 1, ended = 0 })
end

-- The first frame gives the table of ids the dissector of the others.
function T.test_the_dissector_of_the_table()
  local protos = open()
  said["frames.new_table_dissector"] = function()
    return function(...)
      seen.dissected = { ... }
      return 8
    end
  end
  local first = protos.yapp.dissector
  lu.assertEquals(first("tvb", "pinfo", "root"), 8)
  lu.assertEquals(seen.dissected, { "tvb", "pinfo", "root" })
  lu.assertFalse(protos.yapp.dissector == first)
  lu.assertEquals(protos.yapp.dissector("again", "pinfo", "root"), 8)
  lu.assertEquals(#calls_of("frames.new_table_dissector"), 1)
  lu.assertEquals(protos.taurus.dissector(), 0)
end

function T.test_a_conversation_is_found_by_content()
  local protos = open(false, function(prefs) prefs.search_all = true end)
  local find, pinfo = protos.yapp_serial.heuristics[1][2], {}
  said["streams.accepts"] = false
  lu.assertFalse(find("tvb", pinfo, "root"))
  lu.assertEquals({ pinfo.conversation, #calls_of("streams.dissect") }, { nil, 0 })
  said["streams.accepts"] = true
  lu.assertTrue(find("tvb", pinfo, "root"))
  lu.assertIs(pinfo.conversation, protos.yapp_serial)
  lu.assertEquals(#calls_of("streams.dissect"), 1)
end

-- Of Motor Data, whose clock begins at byte 22 of its payload.
function T.test_the_time_of_a_frame_in_a_dump()
  load()
  local parts = seen.arguments["readers.register"][1]
  local function frame(id, size, clock)
    return "YP\0\0" .. string.char(id % 256, math.floor(id / 256), 0, 0, size, 0, 0, 0) .. ("\0"):rep(22) .. clock ..
      ("\0"):rep(size - 30) .. "CRC."
  end
  local second = "\1\202\154\59\0\0\0\0" -- 1,000,000,001 ns
  lu.assertEquals({ parts.time_of(frame(0x210, 32, second)) }, { 1, 1 })
  lu.assertEquals({ parts.time_of(frame(0x210, 32, second):sub(1, 12 + 32)) }, { 1, 1 }, "its CRC is missing")
  lu.assertEquals({ parts.time_of(frame(0x210, 32, "\9" .. ("\0"):rep(7))) }, { 0, 9 })
  lu.assertEquals({ parts.time_of(frame(0x210, 31, second)) }, {}, "shorter than Motor Data")
  lu.assertEquals({ parts.time_of(frame(0x300, 32, second)) }, {}, "an unknown ID")
  lu.assertEquals({ parts.time_of(frame(0, 32, second)) }, {}, "Command has no clock")
  lu.assertEquals({ parts.time_of(frame(0x210, 32, second):sub(1, 40)) }, {}, "cut")
  lu.assertEquals({ parts.time_of(frame(0x210, 32, ("\255"):rep(8))) }, {}, "before 0")
  said["reading.new_framer"] = "framer"
  lu.assertEquals(parts.new_framer(), "framer")
  lu.assertEquals(seen.arguments["reading.new_framer"], { { is_patient = true } })
end

return T
