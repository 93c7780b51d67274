-- SPDX-License-Identifier: GPL-2.0-or-later
-- The texts of preferences, and what is said of them in Wireshark; tests/e2e/test_preferences.py has tshark.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")

local T = {}

local said

function T.setUp()
  said = {}
  function _G.gui_enabled() return true end
  function _G.report_failure(text) said[#said + 1] = text end
  _G.wtap = { USER0 = 45 }
end

function T.tearDown()
  for _, name in ipairs { "gui_enabled", "report_failure", "wtap" } do _G[name] = nil end
  package.loaded["yapp.host.preferences"] = nil
end

function T.test_ranges()
  local range = require("yapp.host.preferences").parse_range
  lu.assertEquals(range(""), {})
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
  preferences.complain { "a", "b", "a" }
  preferences.complain { "b", "c" }
  preferences.complain {}
  io.stderr = stderr -- luacheck: ignore
  lu.assertEquals(said, { "YAPP: a\nb", "YAPP: c" })
end

return T
