-- SPDX-License-Identifier: GPL-2.0-or-later
-- What stands between the plugin and Wireshark: preferences, ports, and the watches of TCP and USB.
-- Wireshark's API is a stand-in of tables; the real one is in tests/e2e.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local unpack = rawget(table, "unpack")

local T = {}

local NAMES = { "gui_enabled", "report_failure", "DissectorTable", "Dissector", "Struct", "wtap", "Pref" }
local MODULES = { "preferences", "ports", "tcp", "usb" }
local tables -- of dissectors, by name: { [key] = dissector }
local said

local function big_endian(bytes, from, to)
  local number = 0
  for i = from, to do number = number * 256 + bytes:byte(i) end
  return number
end

function T.setUp()
  tables, said = {}, {}
  function _G.gui_enabled() return true end
  function _G.report_failure(text) said[#said + 1] = text end
  _G.DissectorTable = { get = function(name)
    local own = tables[name] or {}
    tables[name] = own
    return {
      get_dissector = function(_, key) return own[key] end,
      add = function(_, key, dissector) own[key] = dissector end,
      remove = function(_, key, dissector) if own[key] == dissector then own[key] = nil end end,
    }
  end }
  _G.Dissector = { get = function(name) return { name = name, call = function() return 7 end } end }
  _G.Struct = { unpack = function(_, bytes)
    return big_endian(bytes, 1, 4), big_endian(bytes, 5, 8), bytes:byte(9), bytes:byte(10)
  end }
  _G.wtap = { USER0 = 45, USB_LINUX = 95, USB_LINUX_MMAPPED = 115, USBPCAP = 152 }
  for _, name in ipairs(MODULES) do package.loaded["yapp.host." .. name] = nil end
end

function T.tearDown()
  for _, name in ipairs(NAMES) do _G[name] = nil end
  for _, name in ipairs(MODULES) do package.loaded["yapp.host." .. name] = nil end
end

-- Preferences -------------------------------------------------------------------------------------

function T.test_ranges()
  local range = require("yapp.host.preferences").parse_range
  lu.assertEquals(range(""), {})
  lu.assertEquals(range("528"), { 528 })
  lu.assertEquals(range("528,768-771,5"), { 528, 768, 769, 770, 771, 5 })
end

function T.test_late()
  local late = require("yapp.host.preferences").parse_late
  local function read(text)
    local number, problems = late(text)
    return { number, #problems }
  end
  lu.assertEquals(read("4"), { 4, 0 })
  lu.assertEquals(read(" 0.5 "), { 0.5, 0 })
  for _, text in ipairs { "", "soon", "0", "-1", "0x10", "1e999", "2,5" } do
    lu.assertEquals(read(text), { 2.5, 1 }, text)
  end
  lu.assertEquals(select(2, late("0")), { 'yapp.late: no number above 0 in "0"; it is 2.5 until you change it' })
end

function T.test_a_problem_is_said_once()
  local preferences, stderr = require("yapp.host.preferences"), io.stderr
  io.stderr = { write = function() said[#said + 1] = "in a terminal, too" end } -- luacheck: ignore
  preferences.complain_once { "a", "b", "a" }
  preferences.complain_once { "b", "c" }
  preferences.complain_once {}
  preferences.complain {}
  io.stderr = stderr -- luacheck: ignore
  lu.assertEquals(said, { "YAPP: preferences: a\npreferences: b", "YAPP: preferences: c" })
end

function T.test_a_problem_is_said_in_tshark()
  local stderr, lines = io.stderr, {}
  io.stderr = { write = function(_, text) lines[#lines + 1] = text end } -- luacheck: ignore
  for _, is_gui in ipairs { false, true } do
    function _G.gui_enabled() return is_gui end
    require("yapp.host.preferences").complain { "a", "b" }
    _G.report_failure = nil
  end
  io.stderr = stderr -- luacheck: ignore
  lu.assertEquals({ lines, said }, { { "yapp: a\n", "yapp: b\n", "yapp: a\n", "yapp: b\n" }, {} })
end

function T.test_link_types()
  local take = require("yapp.host.preferences").register_link_types
  local links = tables.wtap_encap or {}
  tables.wtap_encap = links
  links[46] = "the user's table"
  lu.assertEquals(take("147-148,162", "serial"), {})
  lu.assertEquals({ links[45], links[46], links[60], links[47] }, { "serial", "serial", "serial" })
  take("147", "serial")
  lu.assertEquals({ links[45], links[46], links[60] == nil }, { "serial", "the user's table", true })
  take("147-148", "serial")
  lu.assertEquals(take("1", "serial"), { "yapp.user_dlt: link type 1 is no DLT_USER; those are 147 to 162" })
  lu.assertEquals({ links[45] == nil, links[46] }, { true, "the user's table" })
end

-- The rows of tests/published.txt have the others.
function T.test_definitions()
  _G.Pref = setmetatable({}, { __index = function(_, kind) return function(...) return { kind, ... } end end })
  local prefs, motor = {}, { name = "motor", title = "Motor Data", id = 0x210, every = 0.1 }
  local rows = require("yapp.host.preferences").define({ prefs = prefs }, { motor })
  for _, row in ipairs(rows) do lu.assertEquals({ unpack(prefs[row[1]], 1, 4) }, { unpack(row, 2, 5) }) end
  lu.assertEquals({ unpack(prefs.motor_ids, 1, 3) }, { "range", "Motor Data message IDs (0x210 = 528)", "0x210" })
  lu.assertEquals({ prefs.motor_ids[5], prefs.user_dlt[5] }, { 2047, 162 })
  lu.assertEquals(prefs.divisor[5], { { 1, "2^N - 6 (mapping)", 5 }, { 2, "2^N - 5 (worked examples)", 4 } })
  lu.assertStrContains(prefs.motor_ids[4], "several controllers share a bus: 0x210-0x213.")
  lu.assertStrContains(prefs.motor_ids[4], "0x210 by default, which Wireshark shows as 528.")
  lu.assertStrContains(prefs.late[4], "Periods: Motor Data 0.1 s.")
end

return T
