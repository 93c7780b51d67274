-- SPDX-License-Identifier: GPL-2.0-or-later
-- What Wireshark's menus are made of: frames in a text, the page of a flight.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local text, page = require("yapp.stat.text"), require("yapp.stat.page")

local T = {}

function T.test_frames_of_a_table()
  local rows = { { "can0", 7, "frame 9 of it" }, { "kanäle", 12, "" }, { "", 7, "twice" }, { "", false, "none" } }
  local table_ = text.table({ "bus", ">frame", "what" }, rows)
  lu.assertEquals(text.frames("YAPP events: 4 of frame 3\n\n" .. table_), { 7, 12 })
  lu.assertEquals(text.frames(table_ .. "\nYAPP check: FAILED\n"), { 7, 12 })
end

function T.test_frames_of_several_tables()
  local first = text.table({ "ID", ">in frame", ">bad CRC" }, { { "0x210", 165, 3 } })
  local second = text.table({ "ID", "unit", ">max" }, { { "0x210", "°C", 4088 } })
  lu.assertEquals(text.frames("YAPP summary\n\n" .. first .. "\n" .. second), { 165 })
  lu.assertEquals(text.frames(second), {})
  lu.assertEquals(text.frames(""), {})
end

function T.test_address_of_a_file()
  lu.assertEquals(page.address("/home/a b/100%/flug-ü.html"), "file:///home/a%20b/100%25/flug-%C3%BC.html")
  lu.assertEquals(page.address([[C:\Users\me\flight.html]]), "file:///C:/Users/me/flight.html")
end

return T
