-- SPDX-License-Identifier: GPL-2.0-or-later
-- A result of the reading becomes events: of messages and of losses, and their kinds.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local catalogue_of = require("yapp.message.catalogue")
local frame_key = require("yapp.base.frame_key")
local events_of = require("yapp.stat.events")
local records = require("yapp.reading.records")

local T = {}

local CATALOGUE = catalogue_of.compile {
  { name = "m", title = "M", id = 1, size = 3, every = 0.1,
    { "mode", "uint8", "Mode", values = { [0] = "off" } },
    { "bits", "uint8", "Bits", group = "b", flags = { { "one", 1, "One" } } },
    { "low", "float8", "Low", min = 0, max = 250 } } }
local MESSAGE = CATALOGUE.messages[1]
local SOURCE = { id = 1, bus = "can0", type = MESSAGE }

-- The events of a run, and the list of those that it hands on.
local function new_events()
  local list = {}
  local events = events_of.new({ catalogue = CATALOGUE, late = 2.5 }, function(event) list[#list + 1] = event end)
  function events.report(self, result)
    local appended = {}
    events_of.append(appended, result)
    for _, event in ipairs(appended) do self:add(event) end
  end
  return events, list
end

-- A message, as reading.reading reads it; with.frame: the number of its packet; with.of: its message type.
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

-- The result of a frame; with: of message(), and the values of its event.
local function result(kind, with)
  return records.new_result(kind, message(with), with and with.values)
end

local function report_message(events, m)
  local frame = {} -- it does not have what a message has
  for key, value in pairs(m) do frame[key] = value end
  frame.raws, frame.payload, frame.change = nil, nil, nil
  local one = records.new_result("single", frame)
  one.message = m
  events:report(one)
end

local function report_anomalies(events, with, anomalies)
  local one = result("other", with)
  one.frame.can_id = { ctrl = with and with.is_end and 3 or 2 }
  one.anomalies = anomalies
  events:report(one)
end

function T.test_kinds_of_finished_messages()
  local events, list = new_events()
  for _, status in ipairs { "good", "bad", "truncated", "incomplete", "overrun" } do
    report_message(events, message { status = status })
  end
  local found = {}
  for i, one in ipairs(list) do
    local what = one.values.what
    found[i] = one.kind .. (what and " " .. what or "")
  end
  lu.assertEquals(found, { "message", "crc", "incomplete incomplete" })
end

function T.test_a_copy_is_no_message()
  local events, list = new_events()
  report_message(events, message { copy_of = 7 * frame_key.PACKET, change = { missing = 1 } })
  local event = list[1]
  lu.assertEquals({ #list, event.kind, event.values }, { 1, "copies", { of = 7 * frame_key.PACKET } })
end

function T.test_frames_that_may_be_messages()
  local events = new_events()
  local function reported(source, seq, size)
    local count = #events.undissected
    events:report(result("undissected", { source = source, seq = seq, values = { size = size } }))
    return #events.undissected > count
  end
  local other = { id = 7, bus = "can0" }
  lu.assertTrue(reported(SOURCE, 0, 9), "a known ID")
  lu.assertTrue(reported(other, 0, 3), "the size of a message")
  lu.assertFalse(reported(other, 5, 9), "another Seq No")
  lu.assertTrue(reported(other, 6, 9), "the next Seq No")
  lu.assertFalse(reported(other, 255, 9))
  lu.assertTrue(reported(other, 0, 9), "they count modulo 256")
  lu.assertFalse(events.has_messages)
end

-- What follows from a message comes behind it; a silence in front of it.
function T.test_what_follows_from_a_message()
  local events, list = new_events()
  local fault = { field = "bits", flag = { name = "one" }, incident = {}, time = 1, key = frame_key.PACKET }
  report_message(events, message { frame = 1, time = 1,
    change = { faults = { { fault = fault, is_raised = true }, set = { fault } } } })
  report_message(events, message { frame = 2, time = 1.5, change = { late = 0.5, reboot = 3, missing = 2 } })
  report_message(events, message { frame = 3, time = 2,
    change = { faults = { { fault = fault, is_raised = false }, set = {} } } })
  events:finish(function() return 9 end, true)
  local texts = {}
  for i, event in ipairs(list) do
    texts[i] = ("%d %s %s"):format(event.frame, event.kind, event.values.event or event.values.count or "")
  end
  lu.assertEquals(texts, { "1 message ", "1 fault raised", "1 silence ", "2 message ", "2 missing 2", "2 reboot ",
    "3 message ", "3 fault cleared", "3 silence " })
  lu.assertIs(list[1].source, SOURCE)
  lu.assertEquals({ list[8].values.active.text, list[1].faults, list[7].faults }, { "1.000000", { fault } })
  lu.assertEquals({ events.states[1].room, events.states[1].room_at_end }, { 8, 89 })
  lu.assertIs(list[2].cause, list[1])
  for frame = 1, 2 do -- equal stamps of two packets tell nothing
    local values = events_of.fault_event({ frame = frame, at = 1, source = SOURCE }, fault, "cleared").values
    lu.assertEquals(values.active and values.active.text, frame == 1 and "0.000000" or nil)
  end
end

function T.test_values_that_are_not_defined()
  local own = catalogue_of.compile { { name = "own", title = "Own", id = 1, size = 8,
    { "key", "uint8", "Key", values = { [0] = "off" }, invalid = "command.key.invalid" },
    { "bits", "uint8", "Bits", group = "b", flags = { { "one", 1, "One" } } },
    { "gear", "int8", "Gear", values = { [-1] = "back", [0] = "none" } },
    { "deep", "int32", "Deep", values = { [0] = "none" } },
    { "low", "float8", "Low", min = 0, max = 250 } } } -- a reserved value is defined
  local events, list = new_events()
  local source, payload = { id = 1, type = own.messages[1] }, "\10\3\254\0\0\0\128\255"
  report_message(events, message { source = source, of = own.messages[1], payload = payload })
  local found = {}
  for i = 2, #list do found[i - 1] = list[i].values end
  lu.assertEquals(found, {
    { field = "key", value = 10, code = "0x0a", effect = ", so it was ignored" },
    { field = "bits", value = 3, code = "0x03", effect = false },
    { field = "gear", value = -2, code = "-2", effect = false }, -- in Lua 5.2 "%x" takes no negative number
    { field = "deep", value = -2 ^ 31, code = "-2147483648", effect = false } })
  lu.assertEquals({ #list, list[2].kind }, { 5, "invalid" })
end

-- The orphans of a message are one loss, however many they are.
function T.test_losses()
  local events, list = new_events()
  local function count(expert, with)
    local before = #list
    report_anomalies(events, with, { { expert = expert }, { expert = "size.mismatch" } })
    return #list - before
  end
  local function orphan(with) return count("fragment.orphan", with) end
  lu.assertEquals(count("fragment.overrun"), 1)
  lu.assertEquals(list[1].values.what, "overrun")
  lu.assertEquals({ orphan(), orphan(), orphan { source = {} }, orphan { is_end = true }, orphan() },
    { 1, 0, 1, 0, 1 })
  report_message(events, message())
  lu.assertEquals({ orphan { is_end = true }, orphan { is_end = true }, orphan { seq = 7 },
    orphan { seq = 8 }, orphan { seq = 8, is_end = true }, orphan { seq = 8 } }, { 1, 1, 1, 1, 0, 1 })
  orphan()
  lu.assertEquals(count("fragment.incomplete"), 1) -- of another message
  lu.assertEquals({ orphan(), orphan() }, { 1, 0 })
end

-- Text over several packets of one stream is one stretch, until a frame comes.
function T.test_bytes_of_no_frame()
  local events, list = new_events()
  local stream, other = { bus = "ttyA" }, {}
  local function skipped(line, frame)
    events:report(result("skipped", { frame = frame, time = frame, source = line, values = { length = 9 } }))
  end
  skipped(stream, 3)
  skipped(other, 4)
  skipped(stream, 5)
  report_message(events, message { source = { skipped = other, type = MESSAGE }, frame = 6 })
  skipped(stream, 7)
  report_anomalies(events, { source = { skipped = stream }, frame = 8 }, { { expert = "fragment.incomplete" } })
  skipped(stream, 9)
  local texts = {}
  for i, event in ipairs(list) do texts[i] = ("%s %d %s"):format(event.kind, event.frame, event.values.length or "") end
  lu.assertEquals(texts, { "skipped 3 27", "skipped 4 9", "message 6 ", "incomplete 8 ", "skipped 9 9" })
  lu.assertIs(list[1].source, stream)
end

return T
