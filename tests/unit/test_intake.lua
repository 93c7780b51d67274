-- SPDX-License-Identifier: GPL-2.0-or-later
-- What statistics hear of the results of the reading: events of messages and of losses, and their kinds.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local catalogue_of = require("yapp.message.catalogue")
local frame_key = require("yapp.base.frame_key")
local intake_of = require("yapp.stat.intake")
local kinds = require("yapp.stat.kinds")
local records = require("yapp.reading.records")

local T = {}

local CATALOGUE = catalogue_of.compile {
  { name = "m", title = "M", id = 1, size = 3, every = 0.1,
    { "mode", "uint8", "Mode", values = { [0] = "off" } },
    { "bits", "uint8", "Bits", group = "b", flags = { { "one", 1, "One" } } },
    { "low", "float8", "Low", min = 0, max = 250 } } }
local MESSAGE = CATALOGUE.messages[1]
local SOURCE = { id = 1, bus = "can0", type = MESSAGE }

-- An intake, and the list of what it offers: { event, visited }.
local function new_intake()
  local offered, intake = {}, intake_of.new(CATALOGUE)
  local queue = { offer = function(_, event, visited) offered[#offered + 1] = { event, visited } end,
    add_undissected = function(_, event) offered[#offered + 1] = { event } end }
  intake:open(queue)
  return intake, offered, queue
end

-- A message, as reading.messages reads it; with.frame: the number of its packet; with.of: its message type.
local function message(with)
  local m = { seq = 0, source = SOURCE, time = 0.5, visited = false, status = "good", payload = "\0\0\0",
    change = false, undecoded = false, is_unreliable = false }
  for key, value in pairs(with or {}) do m[key] = value end
  m.number = m.frame or 1
  m.key = m.number * frame_key.PACKET + 16
  local of_type = m.of or MESSAGE
  m.raws, m.remarks = of_type.read(m.payload)
  m.remarks = m.remarks or {}
  return m
end

-- The result of a frame; with: of message(), and length.
local function result(kind, with)
  local one = records.new_result(kind, message(with))
  one.length = with and with.length or 0
  return one
end

local function report_message(intake, m)
  local frame = {} -- it does not have what a message has
  for key, value in pairs(m) do frame[key] = value end
  frame.raws, frame.payload, frame.change = nil, nil, nil
  local one = records.new_result("single", frame)
  one.message = m
  intake:report(one)
end

local function report_anomalies(intake, with, anomalies)
  local one = result("other", with)
  one.frame.can_id = { ctrl = with and with.is_end and 3 or 2 }
  one.anomalies = anomalies
  intake:report(one)
end

function T.test_kinds_of_finished_messages()
  local intake, offered = new_intake()
  for _, status in ipairs { "good", "bad", "truncated", "incomplete", "overrun" } do
    report_message(intake, message { status = status })
  end
  local found = {}
  for i, one in ipairs(offered) do
    local what = one[1].values.what
    found[i] = one[1].kind .. (what and " " .. what or "")
  end
  lu.assertEquals(found, { "message", "crc", "incomplete incomplete" })
end

function T.test_frames_that_may_be_messages()
  local intake, offered = new_intake()
  local function reported(source, seq, size)
    local count = #offered
    intake:report(result("undissected", { source = source, seq = seq, length = size }))
    return #offered > count
  end
  local other = { id = 7, bus = "can0" }
  lu.assertTrue(reported(SOURCE, 0, 9), "a known ID")
  lu.assertTrue(reported(other, 0, 3), "the size of a message")
  lu.assertFalse(reported(other, 5, 9), "another Seq No")
  lu.assertTrue(reported(other, 6, 9), "the next Seq No")
  lu.assertFalse(reported(other, 255, 9))
  lu.assertTrue(reported(other, 0, 9), "they count modulo 256")
  lu.assertEquals(offered[1][1].values, { size = 9 })
end

-- Wireshark's windows read a capture again and again, and other captures.
function T.test_what_an_earlier_reading_left_behind()
  local intake, offered, queue = new_intake()
  local other = { id = 7, bus = "can0" }
  local function report(seq)
    intake:report(result("undissected", { source = other, seq = seq, length = 9 }))
    return #offered
  end
  lu.assertEquals({ report(5), report(6) }, { 0, 1 })
  intake:close()
  intake:open(queue)
  lu.assertEquals({ report(7), report(8) }, { 1, 2 }, "7 follows none")
end

function T.test_a_tap_leaves_with_the_next_message()
  local intake, removed = new_intake(), 0
  intake:remove_later { remove = function() removed = removed + 1 end }
  lu.assertEquals(removed, 0)
  report_message(intake, message())
  report_message(intake, message())
  lu.assertEquals(removed, 1)
end

function T.test_a_message()
  local intake, offered = new_intake()
  local change = { missing = 1 }
  report_message(intake, message { visited = true, change = change, is_unreliable = true })
  local event = offered[1][1]
  lu.assertEquals({ event.frame, event.time, event.seq, event.raws ~= nil, offered[1][2] },
    { 1, 0.5, 0, true, true })
  lu.assertEquals(event.values, { change = change, is_unreliable = true })
  report_message(intake, message())
  lu.assertIs(table.remove(offered)[1].values, kinds.NOTHING) -- as of most messages
  lu.assertIs(event.values.change, change)
  lu.assertIs(event.source, SOURCE)
  for i, with in ipairs { { is_unreliable = true }, { undecoded = 2, size = 3 }, { change = change } } do
    report_message(intake, message(with))
    lu.assertEquals(offered[i + 1][1].values, with)
  end
end

function T.test_a_copy_is_no_message()
  local intake, offered = new_intake()
  report_message(intake, message { copy_of = 7 * frame_key.PACKET, change = { missing = 1 } })
  local event = offered[1][1]
  lu.assertEquals({ #offered, event.kind, event.values }, { 1, "copies", { of = 7 * frame_key.PACKET } })
end

function T.test_what_the_catalogue_does_not_define()
  local intake, offered = new_intake()
  for _, payload in ipairs { "\0\1\0", "\5\1\0", "\0\3\0", "\9\255\255" } do
    report_message(intake, message { payload = payload })
  end
  local fields = {}
  for i, one in ipairs(offered) do
    fields[i] = {}
    for j, remark in ipairs(one[1].values.invalid or {}) do fields[i][j] = remark.field end
  end
  lu.assertEquals(fields, { {}, { "mode" }, { "bits" }, { "mode", "bits" } }) -- a reserved count is defined
end

function T.test_values_that_are_not_defined()
  local own = catalogue_of.compile { { name = "own", title = "Own", id = 1, size = 7,
    { "key", "uint8", "Key", values = { [0] = "off" }, invalid = "command.key.invalid" },
    { "mode", "uint8", "Mode", values = { [0] = "off" } },
    { "gear", "int8", "Gear", values = { [-1] = "back", [0] = "none" } },
    { "deep", "int32", "Deep", values = { [0] = "none" } } } }
  local intake, offered = new_intake()
  local source, payload = { id = 1, type = own.messages[1] }, "\10\255\254\0\0\0\128"
  report_message(intake, message { source = source, of = own.messages[1], payload = payload })
  lu.assertEquals(offered[1][1].values.invalid, {
    { field = "key", value = 10, code = "0x0a", effect = " (the controller ignores this command)" },
    { field = "mode", value = 255, code = "0xff", effect = false },
    { field = "gear", value = -2, code = "-2", effect = false }, -- in Lua 5.2 "%x" takes no negative number
    { field = "deep", value = -2 ^ 31, code = "-2147483648", effect = false } })
end

-- A message without its Start is lost once, however many frames it has.
function T.test_losses()
  local intake, offered = new_intake()
  local function count(expert, with)
    local before = #offered
    report_anomalies(intake, with, { { expert = expert }, { expert = "size.mismatch" } })
    return #offered - before
  end
  local function orphan(with) return count("fragment.orphan", with) end
  lu.assertEquals(count("fragment.overrun"), 1)
  lu.assertEquals(offered[1][1].values, { what = "overrun" })
  lu.assertEquals({ orphan(), orphan(), orphan { source = {} }, orphan { is_end = true }, orphan() },
    { 1, 0, 1, 0, 1 })
  report_message(intake, message())
  lu.assertEquals({ orphan { is_end = true }, orphan { is_end = true }, orphan { seq = 7 },
    orphan { seq = 8 }, orphan { seq = 8, is_end = true }, orphan { seq = 8 } }, { 1, 1, 1, 1, 0, 1 })
  orphan()
  lu.assertEquals(count("fragment.incomplete"), 1) -- of another message
  lu.assertEquals({ orphan(), orphan() }, { 1, 0 })
end

function T.test_bytes_of_no_frame()
  local intake, offered = new_intake()
  local line = { bus_key = "serial", bus = "ttyA" }
  intake:report(result("skipped", { frame = 3, time = 2, source = line, length = 9 }))
  local event = offered[1][1]
  lu.assertEquals({ event.kind, event.values.length, event.frame, event.time }, { "skipped", 9, 3, 2 })
  lu.assertIs(event.source, line)
end

-- Text over several packets of one stream is one stretch, until a frame comes; a new run begins anew.
function T.test_bytes_of_several_packets()
  local intake, offered = new_intake()
  local stream, other = {}, {}
  local function skipped(line, frame)
    intake:report(result("skipped", { frame = frame, time = frame, visited = true, source = line, length = 9 }))
  end
  for run = 1, 2 do
    skipped(stream, 3)
    skipped(other, 4)
    skipped(stream, 5)
    report_message(intake, message { source = { line = other, type = MESSAGE }, frame = 6 })
    skipped(stream, 7)
    report_anomalies(intake, { source = { line = stream }, frame = 8 }, { { expert = "fragment.incomplete" } })
    skipped(stream, 9)
    lu.assertEquals(#offered, run * 5)
  end
  local first, last = offered[1][1], offered[5][1]
  lu.assertEquals({ first.frame, first.values.length, last.frame, last.values.length }, { 3, 27, 9, 9 })
  skipped(stream, 11)
  skipped(stream, 11) -- a run from which a filter keeps the earlier packets
  lu.assertEquals({ #offered, offered[10][1].values.length, offered[11][1].frame }, { 11, 18, 11 })
end

function T.test_what_waits_when_the_capture_ends()
  local intake, offered = new_intake()
  local whole = result("single", { frame = 6 })
  whole.message = whole.frame
  local later, earlier = result("unfinished", { frame = 7 }), result("unfinished", { frame = 4, seq = 3 })
  local events = intake:finish { later, whole, earlier }
  lu.assertEquals({ #events, events[1].frame, events[2].frame, events[2].kind }, { 2, 4, 7, "unfinished" })
  lu.assertEquals({ #offered, offered[1][1].kind, offered[1][1].frame }, { 1, "message", 6 })
end

return T
