-- SPDX-License-Identifier: GPL-2.0-or-later
-- The submenu YAPP of a packet: the display filter of each item, and the preferences that two of them set.
-- Wireshark's windows are stand-ins; tests/e2e/test_packet_menu.py has what needs a capture.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")

local T = {}

local FAULTS = "yapp.source in {\"left\"} && (taurus.fault.raised || taurus.fault.cleared)"
local ALARMS = "taurus.motor.fault_flags taurus.pump.alarms" -- of each message one
-- Title, the field that the packet must have, the filter of frame 7 of the source left whose message ends in frame 9.
local FILTERS = {
  { "Only this controller", "yapp.source", "yapp.source in {\"left\"}" },
  { "Faults of this controller", ALARMS, FAULTS },
  { "Previous fault of this controller", ALARMS, FAULTS .. " && frame.number < 7" },
  { "Next fault of this controller", ALARMS, FAULTS .. " && frame.number > 7" },
  { "Whole message", "yapp.reassembled.in", "yapp.reassembled.in in {9}" },
}
local VALUES = { { name = "frame.number", value = 7 }, { name = "yapp.source", value = "left" },
  { name = "yapp.reassembled.in", value = 9 }, { name = "yapp.id", value = 0x210 },
  { name = "yapp.like.motor", value = 0x215 }, { name = "can.id", value = 1 } }

local seen
local function menu(prefs)
  seen = { items = {}, fields = {}, done = {} }
  local function note(name) return function(...) table.insert(seen.done, table.concat({ name, ... }, " ")) end end
  function _G.register_packet_menu(title, act, field)
    seen.items[title] = act
    seen.fields[title] = (seen.fields[title] and seen.fields[title] .. " " or "") .. field
  end
  function _G.register_menu(title, act, group) seen.tools, seen.by_size = title .. " " .. group, act end
  _G.MENU_TOOLS_UNSORTED = "tools"
  for _, name in ipairs { "set_filter", "apply_filter", "set_preference", "apply_preferences", "redissect_packets" } do
    _G[name] = note(name)
  end
  function _G.new_dialog(title, act, row) seen.dialog = { title = title, act = act, row = row } end
  package.loaded["yapp.show.packet_menu"] = nil
  local state, flags = { filter = "taurus.motor.motor_state" }, { filter = "taurus.motor.fault_flags" }
  local motor = { name = "motor", title = "Motor Data", fault_field = flags, alarms = { state, flags } }
  local pump = { name = "pump", title = "Pump", alarms = { { filter = "taurus.pump.alarms" } } } -- has other alarms
  local health = { name = "health", title = "Health", alarms = {} } -- without a fault flag
  require("yapp.show.packet_menu").register(prefs, { messages = { motor, pump, health }, by_name = {} })
end

local function choose(title)
  local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
  seen.items["YAPP/" .. title](unpack(VALUES))
  return seen.done
end

function T.test_filters()
  for _, row in ipairs(FILTERS) do
    menu({ sources = "" })
    lu.assertEquals(seen.fields["YAPP/" .. row[1]], row[2])
    lu.assertEquals(choose(row[1]), { "set_filter " .. row[3], "apply_filter" })
  end
end

-- In 4.0, which has no menu of a packet, too.
function T.test_the_entry_in_tools()
  menu({ sources = "" })
  lu.assertEquals(seen.tools, "YAPP/Decode unknown IDs by size tools")
end

-- Choose Decode unknown IDs by size.  A tap that stays would build trees for ever.
-- packets  how many the taps get
local function decode_by_size(packets)
  local taps, filters = {}, {}
  menu({ sources = "" })
  _G.Listener = { new = function(_, filter)
    local tap = { filter = filter }
    function tap.remove() taps[tap] = nil end
    taps[tap], filters[#filters + 1] = true, filter
    return tap
  end }
  function _G.retap_packets()
    for _ = 1, packets do for tap in pairs(taps) do if not tap.filter then tap.packet() end end end
  end
  function _G.report_failure(text) seen.failure = text end
  seen.by_size()
  lu.assertEquals(filters, { "yapp.like.motor || yapp.like.pump || yapp.like.health" })
  lu.assertEquals({ next(taps), seen.done }, { nil, {} })
end

function T.test_no_message_has_the_size_of_one()
  decode_by_size(3)
  lu.assertStrContains(seen.failure, "YAPP: no message of an unknown ID has the size")
end

-- Another window reads, or the entry was chosen twice: that is no answer.
function T.test_the_packets_could_not_be_read()
  decode_by_size(0)
  lu.assertStrContains(seen.failure, "YAPP: no packet was read")
end

function T.test_decode_this_id_as()
  menu({ sources = "", motor_ids = "0x210" })
  lu.assertEquals(seen.fields["YAPP/Decode this ID as Motor Data"], "yapp.like.motor")
  lu.assertEquals(choose("Decode this ID as Motor Data"),
    { "set_preference yapp.motor_ids 0x210,533", "apply_preferences", "redissect_packets" })
end

function T.test_name_this_controller()
  menu({ sources = "" })
  lu.assertEquals(seen.fields["YAPP/Name this controller ..."], "yapp.id")
  choose("Name this controller ...")
  lu.assertEquals(seen.dialog.row.value, "0x210=")
  seen.dialog.act("0x210=")
  lu.assertEquals(seen.done, {}) -- no name was given
  seen.dialog.act("0x210=nose")
  lu.assertEquals(seen.done, { "set_preference yapp.sources 0x210=nose", "apply_preferences", "redissect_packets" })
end

return T
