-- SPDX-License-Identifier: GPL-2.0-or-later
-- What Wireshark's windows are made of: tables of a width, frames in a text.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local text = require("yapp.stat.output")

local T = {}

-- What print takes: { out, width, frames }, and what it has said.
local function new_context(width)
  local said = {}
  return { width = width, frames = {}, out = function(part) said[#said + 1] = part end }, said
end

function T.test_frames_that_stand_in_a_window()
  local context = new_context()
  text.print(context, "YAPP events: 3", { "frame", "kind" }, { { frame = 7 }, { kind = "absent" }, { frame = 9 } })
  text.print(context, "YAPP summary", { "gap_max_frame" }, { { gap_max_frame = 165 } })
  lu.assertEquals(context.frames, { 7, 9, 165 })
end

function T.test_a_table_of_a_width()
  local rows = { { bus = "can0", frame = 7, source = "left", kind = "what it says at length", help = "" },
    { bus = "can1", frame = 12, source = "ö", id = { json = "1", text = "" } } }
  local function table_of(width)
    return text.table({ "bus", "id", "frame", "source", "kind", "help" }, rows, width)
  end
  lu.assertEquals(table_of(nil),
    "bus   frame  source  event\ncan0      7  left    what it says at length\ncan1     12  ö\n")
  lu.assertEquals(table_of(43), table_of(nil))
  lu.assertEquals(table_of(37), "frame  source  event\n    7  left    what it says at length\n   12  ö\n")
  lu.assertEquals(table_of(28), "frame  source  event\n    7  left    what it says~\n   12  ö\n")
end

function T.test_rows_are_printed()
  local context, said = new_context()
  local keys = { "rel", "id", "frame" }
  local rows = { { rel = text.seconds(0.5), frame = 3, id = { json = "9", text = "0x9" } } }
  text.print(context, "YAPP", keys, rows)
  context.json = true
  text.print(context, "YAPP", keys, rows)
  lu.assertEquals(table.concat(said), "YAPP\n\nsince start/s  ID   frame\n     0.500000  0x9      3\n" ..
    '{"id":9,"frame":3}\n')
end

return T
