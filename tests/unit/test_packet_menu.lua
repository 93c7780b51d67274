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

-- Names as a display filter writes them.
function T.test_names_with_quotes()
  menu({ sources = "" })
  seen.items["YAPP/Only this controller"]({ name = "yapp.source", value = 'a "b" \\c' }, { name = "yapp.source",
    value = "d" })
  lu.assertEquals(seen.done[1], [[set_filter yapp.source in {"a \"b\" \\c","d"}]])
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
