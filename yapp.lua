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
for _, name in ipairs { "can", "can_carrier", "catalogue", "crc", "decode", "interleave", "reassembly", "tree" } do
  parts[name] = require("yapp_" .. name)
end
local decode = parts.decode

-- Says what is wrong where the user sees it: a dialog in Wireshark, stderr in tshark.
local function complain(text)
  if gui_enabled() and report_failure then return report_failure("YAPP: " .. text) end
  io.stderr:write("yapp: " .. text .. "\n")
end

local function load_catalogue()
  local path = here .. "taurus_fields.lua"
  local chunk, problem = loadfile(path)
  local ok, entries = false, problem
  if chunk then ok, entries = pcall(chunk) end
  if not ok then
    complain("the catalogue cannot be read, messages are shown as bytes: " .. tostring(entries))
    entries = {}
  end
  local catalogue, problems = parts.catalogue.compile(entries)
  for _, text in ipairs(problems) do complain(path .. ": " .. text .. "; this message is shown as bytes") end
  return catalogue
end

local catalogue = load_catalogue()
local yapp = Proto("yapp", "Yet Another Packet Protocol")
local taurus = Proto("taurus", "Taurus motor controller")
local tree = parts.tree.new(yapp, taurus, catalogue, decode)

-- Preferences ---------------------------------------------------------------------------------------------------

yapp.prefs.divisor = Pref.enum("Compressed floats divide by", decode.MAPPING,
  "2^N - 6 is what the devices send. Choose 2^N - 5 only to reproduce the figures printed in the worked examples " ..
  "of the vendor's document (0.4975 A, 749.26 RPM).",
  { { 1, "2^N - 6 (mapping)", decode.MAPPING }, { 2, "2^N - 5 (worked examples)", decode.WORKED_EXAMPLES } })
for _, message in ipairs(catalogue.messages) do
  yapp.prefs[message.name .. "_ids"] = Pref.range(message.title .. " message IDs", ("0x%x"):format(message.id),
    ("The IDs that carry Taurus %s. Change it when a controller is configured to other IDs than the default, or when " ..
     "several controllers share a bus: 0x210,0x211,0x300-0x303."):format(message.title), parts.catalogue.MAX_ID)
end
yapp.prefs.all_extended = Pref.bool("All extended CAN frames are YAPP", false,
  "Switch it on for a bus that carries nothing but YAPP, to see unknown IDs, other YAPP CTL values and malformed " ..
  "frames too. By default only what is surely YAPP is taken.")

-- "0x210,0x300-0x303" as Wireshark gives it back
local function parse_ids(text)
  local ids = {}
  for part in tostring(text):gmatch("[^,%s]+") do
    local first, last = part:match("^(%w+)-(%w+)$")
    first, last = tonumber(first or part), tonumber(last or part)
    for id = first or 1, first and math.min(last or -1, parts.catalogue.MAX_ID) or 0 do ids[#ids + 1] = id end
  end
  return ids
end

local frames = parts.can_carrier.new(parts, tree, function() end)

function yapp.dissector(tvb, pinfo, root)
  return frames:dissect(tvb, pinfo, root, pinfo.match_uint, false)
end

-- Taurus messages arrive through YAPP alone; the handle is what "is this protocol wanted" is asked by.
function taurus.dissector() return 0 end

local by_can_id = DissectorTable.get("can.extended_id")
local registered = {}

local function register_ids(by_id)
  for id in pairs(by_id) do
    if not registered[id] then
      registered[id] = true
      for ctrl = 0, 3 do
        local first = id * 0x40000 + ctrl * 0x4000
        by_can_id:add(("%d-%d"):format(first, first + 0xFF), yapp)
      end
    end
  end
end

local said = {}
local function read_preferences()
  decode.use_divisor(catalogue, yapp.prefs.divisor)
  local ids = {}
  for _, message in ipairs(catalogue.messages) do ids[message.name] = parse_ids(yapp.prefs[message.name .. "_ids"]) end
  local by_id, problems = parts.catalogue.assign(catalogue, ids)
  for _, text in ipairs(problems) do
    if not said[text] then complain("preferences: " .. text) end
    said[text] = true
  end
  tree.by_id = by_id
  register_ids(by_id)
end

function yapp.init()
  read_preferences()
  frames:reset()
end
yapp.prefs_changed = read_preferences

package.loaded["yapp.plugin"] = { version = VERSION, path = here .. "yapp.lua" }
