-- SPDX-License-Identifier: GPL-2.0-or-later
-- What Wireshark's windows are made of: tables of a width, frames in a text.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local text = require("yapp.stat.output")

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

function T.test_a_table_of_a_width()
  local rows = { { "can0", 7, "left", "what it says at length" }, { "can1", 12, "ö", "" } }
  local function table_of(width)
    return text.table({ "bus", ">frame", "source", "what" }, rows, width, { "bus", "source" })
  end
  lu.assertEquals(table_of(nil),
    "bus   frame  source  what\ncan0      7  left    what it says at length\ncan1     12  ö\n")
  lu.assertEquals(table_of(43), table_of(nil))
  lu.assertEquals(table_of(37), "frame  source  what\n    7  left    what it says at length\n   12  ö\n")
  lu.assertEquals(table_of(36), "frame  what\n    7  what it says at length\n   12\n")
  lu.assertEquals(table_of(20), "frame  what\n    7  what it says~\n   12\n")
end

return T
