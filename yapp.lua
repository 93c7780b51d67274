-- YAPP for Wireshark: the packet protocol of Taurus motor controllers on CAN, UART, TCP and UDP.
-- The way in: protocols, preferences, registration.  README.md says how to use it.

local VERSION = "1.0.0"
local here = debug.getinfo(1, "S").source:match("^@(.*[/\\])") or "./"

-- Installed in the plugin folder and given by -X, or installed twice: the first one loads.
local loaded = package.loaded["yapp.plugin"]
if loaded then
  io.stderr:write(("yapp: %syapp.lua (%s) is not loaded: %s (%s) is already there\n")
    :format(here, VERSION, loaded.path, loaded.version))
  return loaded
end

package.path = here .. "?.lua;" .. here .. "yapp/?.lua;" .. package.path
local parts = {}
for _, name in ipairs {
  "bus", "can", "can_carrier", "can_id", "catalogue", "crc", "decode", "file_candump", "file_candump_reader",
  "file_dump", "file_dump_reader", "file_head", "frame", "interleave", "reassembly", "serial_carrier", "serial_memory",
  "serial_stream", "serials", "tree", "utf8",
} do
  parts[name] = require("yapp_" .. name)
end
local decode = parts.decode

-- Says what is wrong where the user sees it: one dialog in Wireshark, stderr in tshark.
local function complain(texts)
  if #texts == 0 then return end
  if gui_enabled() and report_failure then return report_failure("YAPP: " .. table.concat(texts, "\n")) end
  for _, text in ipairs(texts) do io.stderr:write("yapp: " .. text .. "\n") end
end

local said = {}
local function complain_once(texts)
  local new = {}
  for _, text in ipairs(texts) do
    if not said[text] then new[#new + 1] = "preferences: " .. text end
    said[text] = true
  end
  complain(new)
end

local wide_open = false -- the preference "all extended CAN frames are YAPP"

local function load_catalogue()
  local path = here .. "taurus_fields.lua"
  local ok, entries, problem = pcall(loadfile, path) -- raises in 4.0 where plain Lua returns nil
  if ok and entries then
    ok, entries = pcall(entries)
  elseif ok then
    ok, entries = false, problem
  end
  local compiled, problems
  if ok then ok, compiled, problems = pcall(parts.catalogue.compile, entries) end -- metatables may raise
  if not ok then
    complain { ("%s: the catalogue cannot be read, messages are shown as bytes: %s"):format(path,
      tostring(compiled or entries):sub(1, 500)) }
    return parts.catalogue.compile {}
  end
  for i, text in ipairs(problems) do problems[i] = path .. ": " .. text .. "; this message is shown as bytes" end
  complain(problems)
  return compiled
end

local catalogue = load_catalogue()
local yapp = Proto("yapp", "Yet Another Packet Protocol")
local serial = Proto("yapp_serial", "YAPP serial stream")
local skipped = Proto("yapp_skipped", "YAPP, bytes between the frames of a serial dump")
local taurus = Proto("taurus", "Taurus motor controller")
local tree = parts.tree.new(yapp, taurus, catalogue, decode)

-- Preferences ---------------------------------------------------------------------------------------------------

yapp.prefs.divisor = Pref.enum("Compressed floats divide by", decode.MAPPING,
  "2^N - 6 is what the devices send. Choose 2^N - 5 only to reproduce the figures printed in the worked examples " ..
  "of the vendor's document (0.4975 A, 749.26 RPM).",
  { { 1, "2^N - 6 (mapping)", decode.MAPPING }, { 2, "2^N - 5 (worked examples)", decode.WORKED_EXAMPLES } })
for _, message in ipairs(catalogue.messages) do
  yapp.prefs[message.name .. "_ids"] = Pref.range(message.title .. " message IDs", ("0x%x"):format(message.id),
    ("The IDs that carry Taurus %s. Change it when a controller has other IDs than the default, or when several " ..
     "controllers share a bus: 0x210,0x211,0x300-0x303."):format(message.title), parts.catalogue.MAX_ID)
end
yapp.prefs.all_extended = Pref.bool("All extended CAN frames are YAPP", false,
  "Switch it on for a bus that carries nothing but YAPP, to see unknown IDs, other YAPP CTL values and malformed " ..
  "frames too. By default only what is surely YAPP is taken.")

yapp.prefs.search_all = Pref.bool("Look for YAPP in all TCP and UDP traffic", false,
  "YAPP in TCP and UDP is found by itself where a frame is among the first 64 KB of a file, and in live captures. " ..
  "Switch it on when YAPP comes later in your files; it costs about 1 µs for each packet that no other protocol takes.")
yapp.prefs.user_dlt = Pref.range("Link types that carry a serial stream", "",
  "147 to 162, the numbers of DLT_USER0 to DLT_USER15: set it for serial captures with such a link type, where the " ..
  "protocol's own DLT_USER table is not convenient. It takes the link type over from that table. Usually empty.", 162)

-- "0x210,0x300-0x303" as a list of numbers, each once
local function parse_range(text, max)
  local numbers, there = {}, {}
  for part in tostring(text):gmatch("[^,%s]+") do
    local first, last = part:match("^(%w+)-(%w+)$")
    first, last = tonumber(first or part), tonumber(last or part)
    for n = first or 1, first and math.min(last or -1, max) or 0 do
      if not there[n] then numbers[#numbers + 1] = n end
      there[n] = true
    end
  end
  return numbers
end

-- Carriers ------------------------------------------------------------------------------------------------------

local buses = parts.bus.watch(parts.file_head)
local candump = parts.file_candump_reader
local ids = parts.can_id.new(function(number) return buses:can_fields(number) end)

local function bus_of(pinfo)
  return candump.current_bus or buses:current(pinfo)
end

-- A stream goes on in a first pass as it began: sources that show later do not count.
local streams = parts.serial_carrier.new(parts, tree, function(pinfo)
  return buses:are_several() and bus_of(pinfo) or nil
end)

-- The ids of a message are found by SocketCAN's table of ids: no other frame costs anything.
local by_can_id = DissectorTable.get("can.extended_id")
local registered = {}
-- CAN id 0 by way of a Proto of its own: any other call with match_uint 0 is from Decode As.
local zero = Proto("yapp_zero", "YAPP, CAN id 0")
local from_zero = false

local function register_range(first, last)
  if first == 0 then
    by_can_id:add(0, zero)
    first = 1
  end
  by_can_id:add(("%d-%d"):format(first, last), yapp)
end

-- Every CAN CTRL and Seq No of a message ID, with YAPP CTL 0.
local function register_id(id)
  if registered[id] then return end
  registered[id] = true
  for ctrl = 0, 3 do
    local first = id * 0x40000 + ctrl * 0x4000
    register_range(first, first + 0xFF)
  end
end

local frames = parts.can_carrier.new(parts, tree, bus_of, function(pinfo) return ids:is_remote(pinfo) end, register_id)

-- Starts of unknown messages: those that do not number their messages at once; the rest takes half a second and waits
-- until a frame that may be one has been seen.
local function register_starts(last_seq)
  for id = 0, parts.catalogue.MAX_ID do
    local first = id * 0x40000 + 0x4000
    if not registered[id] then by_can_id:add(("%d-%d"):format(first, first + last_seq), yapp) end
  end
end
local all_starts = false

local function register_all_starts()
  if all_starts then return end
  all_starts = true
  register_starts(0xFF)
end

local wrapper = Proto("yapp_socketcan", "YAPP's look at CAN headers")

-- At the first frame that comes to us: the fields that a later one may need are asked for.
local asked = false

local function ask(pinfo)
  asked = true
  buses:can_fields(pinfo.number)
end

local function dissect_id(tvb, pinfo, root, id, wide)
  if not asked then ask(pinfo) end
  local length = frames:dissect(tvb, pinfo, root, id, wide)
  if length == 0 then ids:note(pinfo.number, id) end
  return length
end

local yapp_handle -- there is none yet while this file loads

function zero.dissector(tvb, pinfo, root)
  if not frames:takes_single(tvb, pinfo, 0, wide_open) then
    ids:note(pinfo.number, 0)
    return 0
  end
  yapp_handle = yapp_handle or Dissector.get("yapp")
  from_zero = true
  local length = yapp_handle:call(tvb, pinfo, root)
  from_zero = false
  return length
end

-- Decode As on CAN: every extended data frame is YAPP's.
local function dissect_all(tvb, pinfo, root)
  local id, unknown = ids:find(pinfo)
  ids:wrap(wrapper) -- from the next frame on the id is known
  ids:forget()
  if id then return frames:dissect(tvb, pinfo, root, id, true) end
  if unknown and tvb:reported_len() > 0 then return frames:without_id(tvb, pinfo, root) end
  return 0
end

function yapp.dissector(tvb, pinfo, root)
  local id = pinfo.match_uint
  if id > 0xFFFF then return dissect_id(tvb, pinfo, root, id, wide_open) end
  if not from_zero and pinfo.port_type ~= 0 then return streams:dissect(tvb, pinfo, root) end
  if from_zero then
    from_zero = false
    return dissect_id(tvb, pinfo, root, 0, wide_open)
  end
  if id == 0 then return dissect_all(tvb, pinfo, root) end
  return dissect_id(tvb, pinfo, root, id, wide_open)
end

-- What may be a Start of a message that is not in the catalogue.
local function is_like_start(tvb)
  if tvb:reported_len() ~= 8 or tvb:len() ~= 8 then return false end
  local data = tvb:raw()
  return data:byte(7) == 0 and data:byte(8) == 0 and (data:byte(5) > 8 or data:byte(6) > 0)
end

-- Frames that nobody claimed: all of them where the preference says so, and Starts of unknown messages.
local function unclaimed(tvb, pinfo, root)
  if not asked then ask(pinfo) end
  if not wide_open and not is_like_start(tvb) then
    ids:forget()
    return false
  end
  local id, unknown = ids:find(pinfo)
  ids:forget()
  if id then return frames:dissect(tvb, pinfo, root, id, wide_open) > 0 end
  if unknown then
    frames:guess()
    register_all_starts()
  end
  return false
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
local searching = false

local function search_streams()
  if searching or not (yapp.prefs.search_all or buses:may_have_frames()) then return end
  searching = true
  serial:register_heuristic("tcp", found_by_content)
  serial:register_heuristic("udp", found_by_content)
end

-- The controller's own time of a frame in a raw dump, "Nanoseconds since boot".
local function controller_time(frame)
  local header = parts.frame.HEADER
  local message = tree.by_id[parts.frame.parse(frame, 1)]
  if not message or not message.time or #frame < header + message.size then return nil end
  local seconds, nanoseconds = decode.time(frame, header + message.time.offset)
  if seconds >= 0 and nanoseconds >= 0 then return seconds, nanoseconds end
end

-- Preferences and files -----------------------------------------------------------------------------------------

local taken_dlts = {}

local function take_dlts()
  local encapsulations, wanted, others = DissectorTable.get("wtap_encap"), {}, {}
  for _, dlt in ipairs(parse_range(yapp.prefs.user_dlt, 162)) do
    if dlt < 147 then
      others[#others + 1] = dlt
    else
      wanted[wtap.USER0 + dlt - 147] = true
    end
  end
  if #others > 0 then
    complain_once { ("link type %d is not a DLT_USER (147 to 162)%s"):format(others[1],
      #others > 1 and (", nor are %d others"):format(#others - 1) or "") }
  end
  for encapsulation in pairs(wanted) do
    if not taken_dlts[encapsulation] then
      taken_dlts[encapsulation] = encapsulations:get_dissector(encapsulation) or true
      encapsulations:add(encapsulation, serial)
    end
  end
  for encapsulation, before in pairs(taken_dlts) do
    if not wanted[encapsulation] then
      encapsulations:remove(encapsulation, serial)
      if before ~= true then encapsulations:add(encapsulation, before) end
      taken_dlts[encapsulation] = nil
    end
  end
end

local function read_preferences()
  decode.use_divisor(catalogue, yapp.prefs.divisor)
  local chosen = {}
  for _, message in ipairs(catalogue.messages) do
    chosen[message.name] = parse_range(yapp.prefs[message.name .. "_ids"], parts.catalogue.MAX_ID)
  end
  local by_id, problems = parts.catalogue.assign(catalogue, chosen)
  complain_once(problems)
  tree.by_id = by_id
  for id in pairs(by_id) do register_id(id) end
  wide_open = yapp.prefs.all_extended
  if wide_open then ids:wrap(wrapper) end
  take_dlts()
end

function yapp.init()
  read_preferences()
  buses:init()
  search_streams()
  asked = false
  ids:reset()
  candump.current_bus = nil -- sharkd opens the next file without closing the first
  frames:reset(buses:are_several())
  streams:reset()
end
yapp.prefs_changed = read_preferences

register_starts(0)
DissectorTable.get("can.subdissector"):add_for_decode_as(yapp)
for _, name in ipairs { "tcp.port", "udp.port", "rtacser.data" } do
  DissectorTable.get(name):add_for_decode_as(serial)
end
for _, name in ipairs { "tcp.port", "udp.port" } do DissectorTable.get(name):add_for_decode_as(yapp) end
yapp:register_heuristic("can", unclaimed)
candump.register(parts.file_candump)
parts.file_dump_reader.register(parts.file_dump, function() return streams:framer() end, controller_time)

local plugin = { version = VERSION, path = here .. "yapp.lua" }
package.loaded["yapp.plugin"] = plugin
