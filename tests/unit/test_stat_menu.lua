-- SPDX-License-Identifier: GPL-2.0-or-later
-- What Wireshark's windows are made of: tables of a width, frames in a text.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local output = require("yapp.stat.output")

local T = {}

-- What print takes: { out, frames }, and what it has said.
local function new_context(frames)
  local said = {}
  return { frames = frames, out = function(part) said[#said + 1] = part end }, said
end

function T.test_frames_that_stand_in_a_window()
  local context = new_context({})
  local columns = output.columns({}, "frame kind")
  output.print(context, "YAPP events: 3", columns,
    { { frame = 7 }, { kind = "absent" }, { frame = 9 } }, {})
  columns = output.columns({}, "gap_max_frame")
  output.print(context, "YAPP summary", columns, { { gap_max_frame = 165 } }, {})
  lu.assertEquals(context.frames, { 7, 9, 165 })
end

-- A window has columns of its own, times of three digits and numbers of five.
function T.test_a_table_of_a_window()
  lu.assertEquals({ output.text(-0.1015723, true), output.text(5200.671, true) }, { "-0.10157", "5200.7" })
  lu.assertEquals(output.text(-0.1015723), "-0.101572")
  local columns = output.columns({ "bus", { "kind", title = "event" } }, "bus frame source kind help", "rel who kind")
  local rows = { { bus = "can0", frame = 7, source = "left", who = "left", kind = "what it says at length", help = "",
    rel = output.seconds(0.5) }, { bus = "can1", frame = 12, source = "ö", who = "ö", id = { json = "1", text = "" },
    rel = output.seconds(1) } }
  local function table_of(frames)
    local context, said = new_context(frames)
    output.table(context, columns, rows)
    return table.concat(said)
  end
  lu.assertEquals(table_of(),
    "bus   frame  source  event\ncan0      7  left    what it says at length\ncan1     12  ö\n")
  lu.assertEquals(table_of({}),
    " at/s  source  event\n0.500  left    what it says at length\n1.000  ö\n")
end

function T.test_rows_are_printed()
  local context, said = new_context()
  local columns = output.columns({ "id", "frame" }, "rel id frame")
  local rows = { { rel = output.seconds(0.5), frame = 3, id = { json = "9", text = "0x9" } } }
  output.print(context, "YAPP", columns, rows, { "what is left out" })
  context.json = true
  output.print(context, "YAPP", columns, rows, { "what is left out" })
  context.frames = {} -- of a window
  output.print(context, "YAPP faults: 1", columns, rows, { "what is left out" })
  lu.assertEquals(table.concat(said), "YAPP\nwhat is left out\n\n" ..
    "since start/s  ID   frame\n     0.500000  0x9      3\n" ..
    '{"id":9,"frame":3}\nYAPP faults: 1\n{"id":9,"frame":3}\n')
end

return T
