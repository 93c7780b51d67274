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
  package.loaded["yapp.show.menu"] = nil
  local state, flags = { filter = "taurus.motor.motor_state" }, { filter = "taurus.motor.fault_flags" }
  local motor = { name = "motor", title = "Motor Data", fault_field = flags, alarms = { state, flags } }
  local pump = { name = "pump", title = "Pump", alarms = { { filter = "taurus.pump.alarms" } } } -- has other alarms
  local health = { name = "health", title = "Health", alarms = {} } -- without a fault flag
  local catalogue = { messages = { motor, pump, health }, by_name = {} }
  require("yapp.show.menu").register(prefs, catalogue, function(text) seen.shown = text end)
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

-- From any frame of a message with a fault: its card is found by the last one.
function T.test_the_card_of_a_fault()
  menu({ sources = "" })
  lu.assertEquals(seen.fields["YAPP/Fault"], "yapp.message.fault")
  choose("Fault")
  lu.assertEquals(seen.shown, "yapp,fault,frame=9")
  seen.items["YAPP/Fault"]({ name = "frame.number", value = 7 })
  lu.assertEquals(seen.shown, "yapp,fault,frame=7")
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
    for _ = 1, packets do for tap in pairs(taps) do tap.packet() end end
  end
  function _G.all_field_infos() end
  function _G.report_failure(text) seen.failure = text end
  seen.by_size()
  lu.assertEquals(filters, { "frame || yapp.like.motor || yapp.like.pump || yapp.like.health" })
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

-- Names as a display filter writes them.
function T.test_names_with_quotes()
  menu({ sources = "" })
  seen.items["YAPP/Only this controller"]({ name = "yapp.source", value = 'a "b" \\c' }, { name = "yapp.source",
    value = "d" })
  lu.assertEquals(seen.done[1], [[set_filter yapp.source in {"a \"b\" \\c","d"}]])
end

function T.test_decode_all_ids_of_this_size()
  menu({ sources = "", motor_ids = "0x210", pump_ids = "" })
  local taps, fields = {}, nil
  _G.Listener = { new = function(_, filter)
    local tap = { filter = filter }
    function tap.remove() taps[tap] = nil end
    taps[tap] = true
    return tap
  end }
  function _G.all_field_infos() return { name = "ip.src", value = 9 }, fields end
  function _G.retap_packets()
    for _, one in ipairs { { "motor", 0x300 }, { "motor", 0x215 }, { "motor", 0x300 }, { "pump", 7 } } do
      fields = { name = "yapp.like." .. one[1], value = one[2] }
      for tap in pairs(taps) do
        if tap.filter:find(fields.name, 1, true) then tap.packet() end
      end
    end
  end
  seen.by_size()
  lu.assertNil(next(taps))
  table.sort(seen.done)
  lu.assertEquals(seen.done, { "apply_preferences", "redissect_packets", "set_preference yapp.motor_ids 0x210,768,533",
    "set_preference yapp.pump_ids ,7" })
end

-- A record of SocketCAN at offset 2: id and flags, length, flags of CAN FD, two bytes, data.
local function record(word, length, flags, data)
  local bytes = "\0\0" .. word .. string.char(length, flags, 0, 0) .. data
  return function(offset, count)
    local part = bytes:sub(offset + 1, offset + count)
    local function number(text)
      local sum = 0
      for i = 1, #text do sum = sum * 256 + text:byte(i) end
      return sum
    end
    return {
      uint = function() return number(part) end,
      bytes = function() return (part:gsub(".", function(one) return ("%02X"):format(one:byte()) end)) end,
    }
  end
end

function T.test_copy_as_candump()
  local rows = {
    { record("\136\64\64\0", 2, 0, "\1\2"), 0x08404000, "08404000#0102" },
    { record("\0\64\64\136", 8, 0, ("\2"):rep(8)), 0x08404000, "08404000#" .. ("02"):rep(8) }, -- in the host's order
    { record("\128\0\0\0", 1, 0, "\7"), 0, "00000000#07" },
    { record("\136\64\64\0", 9, 0, ("\1"):rep(9)), 0x08404000, "08404000##0" .. ("01"):rep(9) },
    { record("\136\64\64\0", 9, 5, ("\1"):rep(9)), 0x08404000, "08404000##1" .. ("01"):rep(9) },
    { record("\136\64\64\0", 1, 6, "\1"), 0x08404000, "08404000##201" },
    { record("\136\64\64\0", 1, 3, "\1"), 0x08404000, "08404000#01" },
  }
  for _, bus in ipairs { "", "can1", [[a"b\c]] } do
    menu({ sources = "" })
    lu.assertEquals(seen.fields["YAPP/Copy message as candump"], "yapp.can.ctrl")
    local tap
    _G.Listener = { new = function(_, filter)
      tap = { filter = filter, remove = function() tap = nil end }
      return tap
    end }
    local lines = {}
    function _G.retap_packets()
      lu.assertEquals(tap.filter, "can.id && yapp.can.ctrl && (frame.number == 7 || yapp.reassembled.in == 9)")
      for i, row in ipairs(rows) do
        function _G.all_field_infos() return { name = "can.len" }, { name = "can.id", offset = 2, value = row[2] } end
        tap.packet({ abs_ts = 1700000000 + i / 4 }, row[1])
        lines[i] = ("(%d.%s) %s %s\n"):format(1700000000 + math.floor(i / 4), ({ [0] = "000000", "250000", "500000",
          "750000" })[i % 4],
          bus == "" and "can0" or bus, row[3])
      end
    end
    function _G.copy_to_clipboard(text) seen.copied = text end
    local values = { VALUES[1], VALUES[3], bus ~= "" and { name = "yapp.bus", value = bus } or nil }
    seen.items["YAPP/Copy message as candump"]((table.unpack or unpack)(values)) -- luacheck: ignore
    lu.assertEquals(#lines, #rows)
    lu.assertEquals({ seen.copied, tap }, { table.concat(lines), nil })
  end
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
