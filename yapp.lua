-- SPDX-License-Identifier: GPL-2.0-or-later
-- YAPP for Wireshark: the packet protocol of Taurus motor controllers on CAN, UART, TCP and UDP.
-- The entry point: makes the protocols, preferences and dissectors and registers them.  README.md
-- says how to use the plugin.

local VERSION = "3.0.0"
local here = debug.getinfo(1, "S").source:match("^@(.*[/\\])") or "./"
local this = ("%syapp.lua (%s)"):format(here, VERSION)

-- If there are two copies, in the plugin folder and by -X, only the first one loads.
local loaded = package.loaded["yapp.plugin"]
if loaded then
  io.stderr:write("yapp: ", this, " is not loaded: ", loaded, " is already there; remove or ",
    "update one of the two\n")
  return
end
set_plugin_info { version = VERSION, author = "the YAPP for Wireshark project",
  description = "YAPP, the packet protocol of Taurus motor controllers, on CAN, UART, TCP and UDP" }

-- Set the decimal point, as in Wireshark's own times and filters, whatever the user's locale has.
-- With a decimal comma "%.1f" writes text that no program reads, Lua 5.2 cannot read "2.5", and Lua
-- source made from numbers does not compile.
os.setlocale("C", "numeric")

-- Find modules beside this file, also when Wireshark has set package.path anew.
table.insert(rawget(package, "searchers"), 2, function(name)
  if not name:find("^yapp%.") then return nil end
  return assert(loadfile(here .. name:gsub("%.", "/") .. ".lua"))
end)

local captures = require "yapp.capture.capture"
local can_ids = require "yapp.host.can_ids"
local compiler = require "yapp.message.catalogue"
local field_kinds = require "yapp.message.field_kinds"
local file_readers = require "yapp.file.readers"
local frame = require "yapp.wire.frame"
local header_reader = require "yapp.host.header"
local joined = require "yapp.base.joined"
local mapped = require "yapp.base.mapped"
local message_types = require "yapp.message.types"
local preferences = require "yapp.host.preferences"
local show_fields = require "yapp.show.fields"
local source_names = require "yapp.message.sources"
local stat_names = require "yapp.stat.names"

-- The user's own messages follow the plugin's.  They come from yapp_messages.lua in Wireshark's
-- personal configuration folder, and from the files that a preference and the environment name.
-- Fields can be registered only while a plugin loads, and then the API tells no preference.  So the
-- default profile's preference is read from its file.
local function read_chosen_file()
  local file = io.open(Dir.personal_config_path("preferences"))
  local text = file and "\n" .. file:read("*a") or ""
  return text:match("\nyapp%.messages:[ \t]*([^%s][^\r\n]*)") or ""
end
local own_file = Dir.personal_config_path("yapp_messages.lua")
local chosen_file, named_file = read_chosen_file(), os.getenv("YAPP_MESSAGES") or ""

local catalogue, mistakes = compiler.load {
  here .. "taurus_fields.lua", io.open(own_file) and own_file or "", chosen_file, named_file,
}
preferences.complain(mistakes)

-- Protocols and preferences -----------------------------------------------------------------------

local yapp = Proto("yapp", "Yet Another Packet Protocol")
local all = Proto("yapp_all", "YAPP (all extended frames)")
local serial = Proto("yapp_serial", "YAPP serial stream")
local taurus = Proto("taurus", "Taurus motor controller")
local headers = header_reader.new(Proto("yapp_socketcan", "YAPP reads CAN headers"))
local tcp_header = Proto("yapp_tcp", "YAPP reads TCP headers")
local usb_header = Proto("yapp_usb", "YAPP reads USB headers")
local preference_rows = preferences.define(yapp, catalogue.messages)

local capture = captures.watch()
local types = message_types.new(catalogue)
local default_names = {} -- titles by ID
for id, message in pairs(catalogue.by_id) do default_names[id] = message.title end
local field_rows = show_fields.rows(default_names, catalogue.messages)
local yapp_fields = show_fields.define(yapp, "yapp.", field_rows)
local taurus_fields = show_fields.define(taurus, "taurus.", field_rows)

-- The preferences that others need, see stat.taps; read_preferences fills it.
local settings = {
  version = VERSION,
  catalogue = catalogue,
  accepts_all = false,
  published = {
    fields = field_rows,
    experts = show_fields.EXPERTS,
    preferences = preference_rows,
  },
}

-- The objects that read and show YAPP; nil until something needs them, see make_reading.
local reading, wants, frames, streams
local ids -- of CAN, see Registration
local stat -- the same of statistics, see make_statistics

local function reset_reading()
  reading:reset(settings.late)
  wants:reset()
  frames:reset()
  streams:reset()
end

local make_reading

-- A call that began and did not end failed: with a Lua error, which Wireshark shows in the packet
-- alone.
local begun, ended = 0, 0

local function counted(call)
  return function(...)
    begun = begun + 1
    if not streams then make_reading() end
    local result = call(...)
    ended = ended + 1
    return result
  end
end

-- Make the objects that read and show YAPP: a frame, a packet or a statistic needs them.  Captures
-- without YAPP do not need their modules.
function make_reading()
  if streams then return end
  local can_dissector = require "yapp.host.can"
  local reading_of = require "yapp.reading.reading"
  local show_taurus = require "yapp.show.taurus"
  local show_view = require "yapp.show.view"
  local show_wants = require "yapp.show.wants"
  local stream_dissector = require "yapp.host.stream"
  -- Nothing calls this dissector, as YAPP shows the Taurus messages.  It must exist, because the
  -- API asks by dissector whether a protocol is wanted (see show.wants).
  function taurus.dissector() return 0 end
  reading = reading_of.new(types, capture, function(...) ids:register_start(...) end)
  wants = show_wants.new(catalogue.messages, taurus_fields)
  local view = show_view.new {
    yapp = yapp,
    fields = yapp_fields,
    taurus = show_taurus.new(taurus, taurus_fields),
    messages = catalogue.messages,
    names = default_names,
  }
  frames = can_dissector.new {
    reading = reading,
    view = view,
    wants = wants,
    capture = capture,
    settings = settings,
    headers = headers,
  }
  streams = stream_dissector.new {
    reading = reading,
    view = view,
    wants = wants,
    capture = capture,
    tcp_header = tcp_header,
    usb_header = usb_header,
    counted = counted,
  }
  reset_reading()
end

-- Dissectors --------------------------------------------------------------------------------------

local registered = {} -- [list of heuristics] = true

-- A heuristic costs time for each packet that no other dissector accepts, in every capture.  So
-- each is registered when something needs it.
local function register_heuristic(list, proto, dissect)
  if not registered[list] then proto:register_heuristic(list, counted(dissect)) end
  registered[list] = true
end

-- Decode As on CAN: every extended data frame is YAPP's.
all.dissector = counted(function(...) return frames:dissect_any(...) end)

-- See the CAN frames that no other dissector accepts: with the preference yapp.all_extended they
-- are YAPP's; a statistic counts them.
local function watch_unclaimed()
  register_heuristic("can", all, function(tvb, pinfo, root)
    if settings.accepts_all then return frames:dissect_any(tvb, pinfo, root) > 0 end
    frames:remember(tvb, pinfo)
    return false
  end)
end

-- In SocketCAN's table of ids match_uint is the CAN id.
yapp.dissector = counted(function(tvb, pinfo, root)
  return frames:dissect(tvb, pinfo, root, pinfo.match_uint, settings.accepts_all)
end)

serial.dissector = counted(function(tvb, pinfo, root)
  return streams:dissect(tvb, pinfo, root)
end)

-- A conversation becomes YAPP's with its first packet that is YAPP.
local function find_by_content(tvb, pinfo, root)
  if not streams:accepts(tvb, pinfo) then return false end
  pinfo.conversation = serial
  streams:dissect(tvb, pinfo, root)
  return true
end

-- Search TCP, UDP and USB.  Most captures are full of others: so only if the first bytes of a file
-- may have a YAPP frame, if there are no packets yet (a live capture), or for a statistic.
local function search_streams()
  make_reading()
  streams:watch()
  register_heuristic("tcp", serial, find_by_content)
  register_heuristic("udp", serial, find_by_content)
end

local function make_statistics()
  if stat then return end
  make_reading()
  local stat_taps = require "yapp.stat.taps"
  stat = stat_taps.new {
    settings = settings,
    wants = wants,
    capture = capture,
    reading = reading,
    find_options = function() return streams:undecoded_options() end,
    frames = frames,
    headers = headers,
    counted = counted,
    count_failures = function() return begun - ended end,
    watch = function()
      watch_unclaimed()
      if gui_enabled() then return end
      search_streams()
      for _, name in ipairs { "tcp", "udp" } do
        local tap = Listener.new(name)
        tap.packet = counted(function(pinfo, tvb) streams:count_headers(pinfo, tvb) end)
      end
    end,
  }
end

-- Begin the statistic of an argument of -z.  Wireshark swallows an error here and ends with 0.
local function begin_statistic(text)
  local ok, why = pcall(make_statistics)
  if not ok then
    io.stderr:write("yapp: cannot load the plugin: ", why, "; install it again\n")
    os.exit(21) -- as stat.output, which may not load
  end
  stat:begin(text)
end

-- Preferences and files ---------------------------------------------------------------------------

-- Return an error if the file with the user's own messages was not read.
local function check_chosen_file(path)
  if path == "" or path == chosen_file or path == named_file then return {} end
  return { path .. " is read at the next start, if the default profile names it; for one run " ..
    "set the environment variable YAPP_MESSAGES to it" }
end

local function read_preferences()
  local prefs, chosen = yapp.prefs, {}
  field_kinds.choose_divisor(prefs.divisor)
  for _, message in ipairs(catalogue.messages) do
    chosen[message.name] = preferences.parse_range(prefs[message.name .. "_ids"])
  end
  local by_id, clashes = compiler.assign(catalogue, chosen)
  local sources, unread = source_names.parse(prefs.sources, catalogue)
  local late, no_number = preferences.parse_late(prefs.late)
  local texts = joined(clashes, unread, no_number, check_chosen_file(prefs.messages),
    preferences.register_link_types(prefs.user_dlt, serial))
  local problems = mapped(texts, function(text) return "preferences: " .. text end)
  preferences.complain(problems)
  if mistakes[1] then table.insert(problems, "the catalogue did not load whole") end
  types:use(by_id, sources, {
    several_buses = capture:are_several(),
    hides_source = prefs.hide_source,
    hides_values = prefs.hide_values,
  }, function(id) ids:register_id(id) end)
  settings.accepts_all = prefs.all_extended
  if settings.accepts_all then
    headers:start()
    watch_unclaimed()
  end
  settings.late, settings.ids, settings.problems = late, chosen, problems
  settings.sources = sources
end
yapp.prefs_changed = read_preferences

function yapp.init()
  begun, ended = 1, 0
  capture:init()
  read_preferences()
  if stat then stat:reset() end
  if streams then reset_reading() end
  if yapp.prefs.search_all or capture.found.may_have_frames then search_streams() end
  ended = 1
end

-- Registration ------------------------------------------------------------------------------------

ids = can_ids.new(yapp)
for _, name in ipairs(stat_names) do register_stat_cmd_arg("yapp," .. name, begin_statistic) end
register_stat_cmd_arg("yapp", begin_statistic) -- the longest name that fits is called
if gui_enabled() then
  make_statistics()
  stat:register_menus()
  local show_menu = require "yapp.show.menu"
  -- COMPAT 4.0: no register_packet_menu.
  if register_packet_menu then show_menu.register(yapp.prefs, catalogue, stat.show) end
end
for name, proto in pairs {
  ["can.subdissector"] = all,
  ["tcp.port"] = serial,
  ["udp.port"] = serial,
  ["rtacser.data"] = serial,
} do
  DissectorTable.get(name):add_for_decode_as(proto)
end
file_readers.register {
  new_framer = function()
    make_reading()
    return reading:new_framer()
  end,
  time_of = function(bytes)
    local id, size = frame.parse(bytes, 1)
    return types:time_of(id, bytes:sub(frame.HEADER + 1, frame.HEADER + size))
  end,
}

-- Collect garbage earlier and faster than Lua does by default: a long capture takes less memory and
-- no more time.  The start is faster without.  (COMPAT 5.5: these options have other names there,
-- hence pcall.)
pcall(collectgarbage, "setpause", 150)
pcall(collectgarbage, "setstepmul", 1000)

package.loaded["yapp.plugin"] = this
