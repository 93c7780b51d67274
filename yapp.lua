-- SPDX-License-Identifier: GPL-2.0-or-later
-- YAPP for Wireshark: the packet protocol of Taurus motor controllers on CAN, UART, TCP and UDP.
-- The way in: protocols, preferences, dissectors, registration.  README.md says how to use it.

local VERSION = "2.1.0"
local here = debug.getinfo(1, "S").source:match("^@(.*[/\\])") or "./"

-- Installed in the plugin folder and given by -X, or given twice: the first one loads.  Installed twice: host.copies.
local loaded = package.loaded["yapp.plugin"]
if loaded then
  io.stderr:write(("yapp: %syapp.lua (%s) is not loaded: %s (%s) is already there\n")
    :format(here, VERSION, loaded.path, loaded.version))
  return loaded
end
local plugin = { version = VERSION, path = here .. "yapp.lua" }
-- Installed, all modules are in this file.
if not package.preload["yapp.wire.crc"] and here:find(Dir.personal_plugins_path(), 1, true) then
  local text = "yapp: %s is a clone in a plugin folder, where Wireshark runs every file: " ..
    "move it elsewhere, and run make install or tools/install.py there\n"
  io.stderr:write(text:format(here))
end
set_plugin_info { version = VERSION, author = "the YAPP for Wireshark project",
  description = "YAPP, the packet protocol of Taurus motor controllers, on CAN, UART, TCP and UDP" }

-- A number has a point, as in Wireshark's own times and filters, whatever the user's locale has: with a comma "%.1f"
-- writes text that no program reads, Lua 5.2 reads no "2.5", and Lua that is made from numbers is none.
os.setlocale("C", "numeric")

package.path = here .. "?.lua;" .. package.path
local parts = {
  can_carrier = require "yapp.can.carrier",
  can_frames = require "yapp.can.frames",
  can_id = require "yapp.wire.can_id",
  can_interleave = require "yapp.can.interleave",
  can_memory = require "yapp.can.memory",
  can_repeated = require "yapp.can.repeated",
  can_wrapper = require "yapp.can.wrapper",
  catalogue = require "yapp.message.catalogue",
  catalogue_files = require "yapp.message.catalogue_files",
  collector = require "yapp.base.collector",
  crc = require "yapp.wire.crc",
  decode = require "yapp.message.decode",
  decode_columns = require "yapp.message.columns",
  facts = require "yapp.host.facts",
  file_asc = require "yapp.file.asc",
  file_asc_reader = require "yapp.file.asc_reader",
  file_candump = require "yapp.file.candump",
  file_candump_line = require "yapp.file.candump_line",
  file_candump_reader = require "yapp.file.candump_reader",
  file_dump = require "yapp.file.dump",
  file_dump_reader = require "yapp.file.dump_reader",
  file_head = require "yapp.host.file_head",
  frame = require "yapp.wire.frame",
  history = require "yapp.message.history",
  preferences = require "yapp.host.preferences",
  reader = require "yapp.message.reader",
  serial_carrier = require "yapp.serial.carrier",
  serial_memory = require "yapp.serial.memory",
  serial_stream = require "yapp.serial.stream",
  sources = require "yapp.message.sources",
  stat = require "yapp.stat.taps",
  stat_tell = require "yapp.stat.tell",
  tree = require "yapp.show.tree",
  utf8 = require "yapp.base.utf8",
}
local decode, preferences, candump = parts.decode, parts.preferences, parts.file_candump_reader

-- The user's own messages come behind ours: from Wireshark's personal configuration folder, and from where a preference
-- or the environment says.  Fields can be registered only while a plugin loads, when no preference is known: that of
-- the default profile is read from its file.
local chosen_file = parts.catalogue_files.preference(Dir.personal_config_path("preferences"), "yapp.messages")

local function load_catalogue()
  local files = { { path = here .. "taurus_fields.lua" },
    { path = Dir.personal_config_path("yapp_messages.lua"), optional = true } }
  for _, path in ipairs { chosen_file or "", os.getenv("YAPP_MESSAGES") or "" } do
    if path ~= "" then files[#files + 1] = { path = path } end
  end
  local compiled, problems = parts.catalogue_files.load(files)
  preferences.complain(problems)
  return compiled, #problems == 0
end

-- Protocols and preferences -----------------------------------------------------------------------------------------

local catalogue, is_whole = load_catalogue()
local MAX_ID = parts.catalogue.MAX_ID
local yapp = Proto("yapp", "Yet Another Packet Protocol")
local all = Proto("yapp_all", "YAPP (all extended frames)")
local serial = Proto("yapp_serial", "YAPP serial stream")
local skipped = Proto("yapp_skipped", "YAPP, bytes between the frames of a serial dump")
local taurus = Proto("taurus", "Taurus motor controller")
local socketcan = Proto("yapp_socketcan", "YAPP's look at CAN headers")
preferences.define(yapp, catalogue, decode, MAX_ID)

local facts = parts.facts.watch(parts.file_head, candump)
local stat = parts.stat.new { version = VERSION, catalogue = catalogue, is_whole = is_whole, decode = decode,
  columns = parts.decode_columns, wants_records = function(is_wanted) facts:want_buses(is_wanted) end }
local reader = parts.reader.new(decode, catalogue, stat)
local tree = parts.tree.new { yapp = yapp, taurus = taurus, catalogue = catalogue, reader = reader }

-- SocketCAN's table of ids finds the frames of a message: no other frame costs anything.
local by_can_id, is_registered = DissectorTable.get("can.extended_id"), {}

-- Every CAN CTRL and Seq No of a message ID, with YAPP CTL 0.
local function claim_id(id)
  if is_registered[id] then return end
  is_registered[id] = true
  for ctrl = 0, 3 do
    local first = id * 0x40000 + ctrl * 0x4000
    by_can_id:add(("%d-%d"):format(first, first + 0xFF), yapp)
  end
end

-- Starts of unknown messages, of those that do not number themselves.
local function claim_starts()
  for id = 0, MAX_ID do
    if not is_registered[id] then by_can_id:add(id * 0x40000 + 0x4000, yapp) end
  end
end

local frames = parts.can_carrier.new(parts, tree, reader, facts, claim_id)
local dissect_can = frames.dissect -- as Lua finds it faster
local streams = parts.serial_carrier.new(parts, tree, reader, facts)
local tell = parts.stat_tell.new(stat, reader)
reader:tell_to(tell)
function stat.plugin.tapped(number)
  frames:tapped(number)
  streams:tapped(number)
end
function stat.plugin.late() return (preferences.late(yapp.prefs.late)) end
function stat.plugin.has_source(name) return reader.sources:has_name(name) end
function stat.plugin.unfinished()
  local messages = frames:unfinished()
  for _, message in ipairs(streams:unfinished()) do messages[#messages + 1] = message end
  return tell:unfinished(messages)
end

-- Dissectors --------------------------------------------------------------------------------------------------------

-- Decode As on CAN: every extended data frame is YAPP's.
function all.dissector(tvb, pinfo, root)
  local can_id, is_unknown = facts:find_id(tvb, pinfo)
  parts.can_wrapper.wrap(socketcan, facts) -- from the next frame on the id is known
  if can_id then return frames:dissect(tvb, pinfo, root, can_id, true) end
  return is_unknown and tvb:reported_len() > 0 and frames:without_id(tvb, pinfo, root) or 0
end

-- With the preference "all extended": what no table claims.  A heuristic is called for every CAN frame of every capture
-- that nobody else takes, so there is none before somebody wants it.
local is_wide, is_heuristic = false, false -- is_wide: the preference

local function unclaimed(tvb, pinfo, root)
  return is_wide and all.dissector(tvb, pinfo, root) > 0
end

local function take_all()
  parts.can_wrapper.wrap(socketcan, facts)
  if is_heuristic then return end
  is_heuristic = true
  all:register_heuristic("can", unclaimed)
end

-- Called from the table of ids, where match_uint is the CAN id; and by Decode As under the name that version 1 had for
-- it, where match_uint is 0.
function yapp.dissector(tvb, pinfo, root)
  local can_id = pinfo.match_uint
  if can_id <= 0xFFFF then
    if pinfo.port_type ~= 0 then return streams:dissect(tvb, pinfo, root) end
    if can_id == 0 and facts:is_decode_as(tvb, pinfo) then
      frames:guess() -- a first pass without fields took all ids for 0
      return all.dissector(tvb, pinfo, root)
    end
  end
  local length = dissect_can(frames, tvb, pinfo, root, can_id, is_wide)
  if length == 0 then facts:note_refused(pinfo, can_id) end -- for Decode As, which is asked next
  return length
end

function serial.dissector(tvb, pinfo, root)
  return streams:dissect(tvb, pinfo, root)
end

function skipped.dissector(tvb, pinfo, root)
  return streams:skipped(tvb, pinfo, root)
end

-- Taurus messages arrive through YAPP alone; the handle is what "is this protocol wanted" is asked by.
function taurus.dissector() return 0 end

-- A conversation is YAPP's when one whole frame with a good CRC has been seen in it.
local function found_by_content(tvb, pinfo, root)
  if pinfo.in_error_pkt then return false end
  local raw = tvb:len() > 0 and tvb:raw() or ""
  if not raw:find("YP", 1, true) or not streams:has_frame(raw) then return false end
  pinfo.conversation = serial
  streams:dissect(tvb, pinfo, root)
  return true
end

-- Every call from a heuristic costs, and TCP and UDP are most of other people's captures: so the search begins where
-- the first bytes of a file have what may be a frame, or nothing yet, as in a live capture.
local is_searching = false

local function search_streams()
  if is_searching or not (yapp.prefs.search_all or facts:may_have_frames()) then return end
  is_searching = true
  serial:register_heuristic("tcp", found_by_content)
  serial:register_heuristic("udp", found_by_content)
end

-- The controller's own time of a frame in a raw dump, "Nanoseconds since boot".
local function controller_time(frame)
  local header = parts.frame.HEADER
  local message = reader:message_of(parts.frame.parse(frame, 1))
  if not message or not message.time or #frame < header + message.size then return nil end
  local seconds, nanoseconds = decode.time(frame, header + message.time.offset)
  if seconds >= 0 and nanoseconds >= 0 then return seconds, nanoseconds end
end

-- Preferences and files ---------------------------------------------------------------------------------------------

local function read_preferences()
  local prefs, chosen = yapp.prefs, {}
  decode.use_divisor(prefs.divisor)
  for _, message in ipairs(catalogue.messages) do
    chosen[message.name] = preferences.range(prefs[message.name .. "_ids"], MAX_ID)
  end
  local by_id, clashes = parts.catalogue.assign(catalogue, chosen)
  local sources, problems = parts.sources.parse(prefs.sources, catalogue)
  preferences.complain_once(clashes)
  preferences.complain_once(problems)
  preferences.check_messages_file(prefs.messages, chosen_file)
  reader:use(by_id, sources)
  for id in pairs(by_id) do claim_id(id) end
  for _, row in ipairs(sources:list()) do
    if row.message then claim_id(row.id) end
  end
  is_wide = prefs.all_extended
  if is_wide then take_all() end
  preferences.take_link_types(prefs.user_dlt, serial)
end
yapp.prefs_changed = read_preferences

function yapp.init()
  read_preferences()
  candump.current_bus = nil -- sharkd opens the next file without closing the first
  facts:init()
  search_streams()
  local late, problems = preferences.late(yapp.prefs.late)
  preferences.complain_once(problems)
  local options = {
    size_of = function(id, bus) return reader:size_of(id, facts:bus_name(bus)) end,
    new_history = function() return parts.history.new { late = late, catalogue = catalogue } end,
    has_buses = facts:are_several(),
  }
  parts.collector.reset()
  reader:reset()
  tell:reset()
  tree:reset()
  frames:reset(options)
  streams:reset(options)
end

-- Registration ------------------------------------------------------------------------------------------------------

claim_starts()
stat:register()
for _, proto in ipairs { all, yapp } do DissectorTable.get("can.subdissector"):add_for_decode_as(proto) end
for _, name in ipairs { "tcp.port", "udp.port" } do
  for _, proto in ipairs { serial, yapp } do DissectorTable.get(name):add_for_decode_as(proto) end
end
DissectorTable.get("rtacser.data"):add_for_decode_as(serial)
candump.register(parts.file_candump)
parts.file_asc_reader.register { asc = parts.file_asc, packet = parts.file_candump_line.packet, told = candump }
parts.file_dump_reader.register(parts.file_dump, function() return streams:framer() end, controller_time)

package.loaded["yapp.plugin"] = plugin
