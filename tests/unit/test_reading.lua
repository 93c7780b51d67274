-- SPDX-License-Identifier: GPL-2.0-or-later
-- The whole reading of a capture: frames and packets in; results, and the events of statistics, out.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local stamps_of = require("yapp.capture.stamps")
local can_id = require("yapp.wire.can_id")
local catalogue_of = require("yapp.message.catalogue")
local events_of = require("yapp.stat.events")
local frame_key = require("yapp.base.frame_key")
local generator = require("stream_generator")
local lines = require("yapp.serial.lines")
local reading_of = require("yapp.reading.reading")
local records = require("yapp.reading.records")
local sources = require("yapp.message.sources")
local types_of = require("yapp.message.types")
local words = require("can_words")

local T = {}

local TAURUS = catalogue_of.compile(dofile("taurus_fields.lua"))
local MOTOR, HEALTH, COMMAND = 0x210, 0x200, 0
local LENGTHS = { [MOTOR] = 32, [HEALTH] = 17, [COMMAND] = 7 } -- of payloads, as the document has them

local function events_in_words(results)
  local list, texts = {}, {}
  for _, result in ipairs(results) do events_of.append(list, result) end
  for i, event in ipairs(list) do
    local source = event.source
    texts[i] = ("%s %s @%d"):format(event.kind, source.id and source.label or "line", event.frame)
  end
  return texts
end

-- A capture and what comes of it: { reading, events = list of words, number = of the latest packet }.
-- with  { several = whether it has several buses }
local function new_capture(with)
  local types, capture = types_of.new(TAURUS), {
    name = function(_, bus) return bus and "can" .. bus - 1 or nil end,
    has_times = function() return true, true end,
    stamps = stamps_of.new(),
    is_time_real = function() return true end,
  }
  types:use(catalogue_of.assign(TAURUS, {}), (sources.parse("", TAURUS)),
    { several_buses = with and with.several }, function() end)
  local reading, events = reading_of.new(types, capture, function() end), {}
  reading:reset(3)
  reading:listen { report = function(_, result)
    for _, text in ipairs(events_in_words { result }) do events[#events + 1] = text end
  end }
  return { reading = reading, events = events, number = 0 }
end

-- A payload of a message: its bytes count up, but for Motor Data, whose flags are 0.
local function payload_of(id, first)
  if id == MOTOR then return string.char(first) .. ("\0"):rep(31) end
  local bytes = {}
  for i = 1, LENGTHS[id] or 20 do bytes[i] = string.char((first + i) % 16 + 1) end
  return table.concat(bytes)
end

-- The frames of a message on CAN: a list of { CAN id, data }.
-- with  { wrong = whether its CRC is }
local function frames_of(id, seq, payload, with)
  if #payload <= 8 then return { { words.can_id(id, 0, 0, seq), payload } } end
  local list = { { words.can_id(id, 1, 0, seq), words.start(id, payload, { seq = seq, wrong = with and with.wrong }) } }
  for from = 1, #payload, 8 do
    local is_last = from + 8 > #payload
    list[#list + 1] = { words.can_id(id, is_last and 3 or 2, 0, seq), payload:sub(from, from + 7) }
  end
  return list
end

-- What a result is, in words: "fragment", "last good Motor Data", "other", "-" of a frame that is not YAPP's; behind
-- "+" what is wrong; behind "(" what the reading knows of its message.
local function in_words(result)
  if not result then return "-" end
  local text, message = result.kind, result.message
  if message then text = ("%s %s %s"):format(text, message.status, message.source.label) end
  if result.kind == "skipped" then text = text .. " " .. result.values.length end
  for _, anomaly in ipairs(result.anomalies or {}) do text = text .. "+" .. anomaly.expert end
  local change = message and message.change
  for _, name in ipairs(change and { "missing", "reboot", "late" } or {}) do
    if change[name] then text = text .. " (" .. name .. ")" end
  end
  return text .. (message and message.copy_of and (" (copy of %d)"):format(frame_key.number(message.copy_of)) or "")
end

-- A record has no field that its constructor does not name: it would be of the record before.
local function assert_named(result)
  if not result then return end
  for record, new in pairs { [result] = records.new_result(), [result.frame] = records.new_can_frame() } do
    for key in pairs(record) do lu.assertTrue(new[key] ~= nil or key == "kind" or key == "frame", key) end
  end
end

function T.test_a_new_record_says_nothing()
  for _, record in ipairs { records.new_can_frame(), records.new_result() } do
    for key, value in pairs(record) do
      local nothing = key == "is_bus_known" and true or key == "status" and "good" or false
      lu.assertTrue(value == nothing or value == 0 or value == "", key)
    end
  end
end

-- Add a CAN frame, or recall it.
-- with  { number, time, visited, bus, is_bus_known, accepts_all, reported, is_only_pass }; by default it is the next
--       packet, 1 ms behind the one before
local function visit(capture, one, with)
  with = with or {}
  local frame, number = records.new_can_frame(), with.number or capture.number + 1
  capture.number = number
  frame.key, frame.time = number * frame_key.PACKET + 17, with.time or number / 1000
  frame.number = number
  frame.can_id = can_id.fields[one[1]]
  frame.data, frame.reported = one[2], with.reported or #one[2]
  for _, name in ipairs { "visited", "bus", "accepts_all", "is_only_pass", "wants_state" } do
    frame[name] = with[name] or false
  end
  frame.is_bus_known = with.is_bus_known ~= false
  local result = capture.reading:read(frame)
  assert_named(result)
  return result
end

-- Add frames; return what the last one is, in words.
local function add_all(capture, list, with)
  local text
  for _, one in ipairs(list) do text = in_words(visit(capture, one, with)) end
  return text
end

-- CAN ----------------------------------------------------------------------------------------------------------------

function T.test_messages_on_can()
  local capture = new_capture()
  local single = visit(capture, frames_of(COMMAND, 7, payload_of(COMMAND, 1))[1])
  lu.assertEquals(in_words(single), "single good Command")
  lu.assertEquals({ single.message.seq, single.transfer.size, single.message.key, single.transfer.status },
    { 7, 7, frame_key.PACKET + 17, "good" })
  lu.assertFalse(single.is_usual) -- its key is none
  local list, kinds = frames_of(MOTOR, 9, payload_of(MOTOR, 3)), {}
  for i, one in ipairs(list) do
    local result = visit(capture, one)
    kinds[i] = in_words(result)
    lu.assertTrue(result.is_usual)
  end
  lu.assertEquals(kinds, { "fragment", "fragment", "fragment", "fragment", "last good Motor Data" })
  lu.assertEquals(add_all(capture, frames_of(MOTOR, 10, payload_of(MOTOR, 4), { wrong = true })), "last bad Motor Data")
  lu.assertEquals(add_all(capture, frames_of(0x123, 0, payload_of(0x123, 1))), "last good ID 0x123")
  lu.assertEquals(capture.events, { "message Command @1", "message Motor Data @6", "crc Motor Data @11",
    "message ID 0x123 @15" })
end

-- A frame needs an expert item if its message does, if a part of it is missing, or if something is wrong with it.
function T.test_what_is_usual()
  local capture, list = new_capture(), frames_of(MOTOR, 1, payload_of(MOTOR, 1))
  lu.assertTrue(visit(capture, { words.can_id(COMMAND, 0, 0, 1), "\1\165\0\0\0\0\0" }).is_usual)
  lu.assertTrue(visit(capture, list[1]).is_usual)
  lu.assertFalse(visit(capture, { list[2][1], list[2][2]:sub(1, 5) }, { reported = 8 }).is_usual)
  lu.assertFalse(visit(capture, list[5]).is_usual) -- incomplete
  lu.assertFalse(visit(capture, list[3]).is_usual) -- an orphan
  list = frames_of(MOTOR, 2, payload_of(MOTOR, 1), { wrong = true })
  for i, one in ipairs(list) do lu.assertEquals(visit(capture, one).is_usual, i < 5) end
end

-- A revisit draws the same, and tells the fragments of their message; statistics hear of it again.
function T.test_a_revisit()
  local capture, list = new_capture(), frames_of(MOTOR, 9, payload_of(MOTOR, 3))
  add_all(capture, frames_of(MOTOR, 8, payload_of(MOTOR, 2)), { time = 1 })
  add_all(capture, list, { time = 1.1 })
  for index, one in ipairs(list) do
    local result = visit(capture, one, { number = 5 + index, time = 1.1, visited = true })
    lu.assertEquals(in_words(result), index < 5 and "fragment" or "last good Motor Data")
    lu.assertEquals({ #result.transfer, result.transfer.status }, { 5, "good" })
    if index == 5 then lu.assertAlmostEquals(result.message.delta, 0.1, 1e-9) end
  end
  lu.assertEquals(capture.events, { "message Motor Data @5", "message Motor Data @10", "message Motor Data @10" })
  lu.assertNil(visit(capture, { words.can_id(0x700, 2, 0, 1), "other" }, { number = 50, visited = true }))
end

-- Frames that are not dissected: a Start of an unknown ID, a known message with a YAPP CTL, one that is longer.
function T.test_undissected_frames()
  local capture = new_capture()
  local function report(id, data)
    local frame = records.new_can_frame()
    capture.number = capture.number + 1
    frame.key, frame.can_id = capture.number * frame_key.PACKET, can_id.fields[id]
    frame.number = capture.number
    frame.data, frame.reported = data, #data
    frame.seq = frame.can_id.seq
    capture.reading:report_undissected(frame)
  end
  report(words.can_id(0x321, 1, 0, 9), words.start(0x321, payload_of(MOTOR, 1)))
  report(words.can_id(COMMAND, 0, 3, 9), "\1\165" .. ("\0"):rep(5))
  report(words.can_id(0x322, 2, 0, 9), "12345678")
  report(words.can_id(0x323, 1, 0, 9), words.start(0x323, ("x"):rep(50))) -- no message of the catalogue has its size
  report(words.can_id(0x321, 0, 0, 9), ("x"):rep(8)) -- as long as no message
  report(words.can_id(0x321, 1, 0, 9), words.start(0x321, ("x"):rep(8))) -- it would be a single frame
  report(words.can_id(0x324, 1, 3, 9), words.start(0x324, payload_of(MOTOR, 1))) -- no ID that is known, and a YAPP CTL
  report(words.can_id(COMMAND, 1, 0, 9), words.start(COMMAND, ("x"):rep(8)))
  report(words.can_id(COMMAND, 1, 0, 9), words.start(COMMAND, ("x"):rep(9)))
  lu.assertEquals(capture.events,
    { "undissected ID 0x321 @1", "undissected Command @2", "undissected ID 0x323 @4", "undissected Command @9" })
  -- A byte behind the values of a single frame.
  report(words.can_id(COMMAND, 0, 0, 9), "\1\165" .. ("\0"):rep(5) .. "x")
  report(words.can_id(COMMAND, 0, 0, 9), "\165\1" .. ("\0"):rep(5) .. "x") -- no command
  report(words.can_id(COMMAND, 2, 0, 9), "\1\165" .. ("\0"):rep(5) .. "x") -- a Middle
  lu.assertEquals({ #capture.events, capture.events[5] }, { 5, "undissected Command @10" })
end

-- Streams ------------------------------------------------------------------------------------------------------------

-- Add a packet of a line, or recall it.
-- kind  of the line: lines.UDP, lines.TCP, 0 for a serial line
-- with  { number, visited, seq = of TCP, truncated }
local function visit_packet(capture, kind, bytes, with)
  with = with or {}
  local number = with.number or capture.number + 1
  capture.number = number
  local address = kind == 0 and "" or "10.0.0.1"
  local line = capture.reading.lines:of(kind, address, 5000, "10.0.0.2", 14550)
  local packet = { key = number * frame_key.PACKET + 42, number = number, time = number / 10,
    visited = with.visited or false, epoch = with.epoch or false, bytes = bytes,
    length = #bytes + (with.truncated or 0),
    truncated = with.truncated ~= nil, line = line,
    seq = with.seq, is_bus_known = true, is_only_pass = false, wants_state = false }
  return capture.reading:read_packet(packet)
end

local function results_in_words(contents)
  local list = {}
  for i, result in ipairs(contents and contents.results or {}) do
    list[i] = in_words(result)
    assert_named(result)
  end
  if contents and contents.pending > 0 then list[#list + 1] = ("%d pending"):format(contents.pending) end
  return table.concat(list, ", ")
end

local MOTOR_FRAME = generator.frame(MOTOR, payload_of(MOTOR, 1))
local HEALTH_FRAME = generator.frame(HEALTH, payload_of(HEALTH, 1))
local BAD_FRAME = MOTOR_FRAME:sub(1, -2) .. string.char((MOTOR_FRAME:byte(-1) + 1) % 256)

function T.test_a_serial_line()
  local capture = new_capture()
  lu.assertEquals(results_in_words(visit_packet(capture, 0, "noise" .. MOTOR_FRAME .. MOTOR_FRAME:sub(1, 20))),
    "skipped 5, single good Motor Data, 20 pending")
  local contents = visit_packet(capture, 0, MOTOR_FRAME:sub(21) .. BAD_FRAME)
  lu.assertEquals(results_in_words(contents), "single good Motor Data, single bad Motor Data")
  lu.assertEquals(contents.results[1].transfer.payload, payload_of(MOTOR, 1))
  local bad = contents.results[2].transfer
  lu.assertEquals((bad.crc - bad.calculated) % 2 ^ 32, 2 ^ 24) -- its last byte is one more
  for i, result in ipairs(contents.results) do -- no two findings have one key
    lu.assertEquals(result.message.key, 2 * frame_key.PACKET + 42 + i - 1)
  end
  lu.assertEquals(results_in_words(
    visit_packet(capture, 0, "noise" .. MOTOR_FRAME .. MOTOR_FRAME:sub(1, 20), { number = 1, visited = true })),
    "skipped 5, single good Motor Data, 20 pending")
  lu.assertEquals(results_in_words(visit_packet(capture, 0, HEALTH_FRAME .. "bytes" .. BAD_FRAME, { number = 3 })),
    "single good Health, skipped 5, single bad Motor Data")
  local odd = generator.sealed(MOTOR_FRAME:sub(1, 11) .. "\1" .. MOTOR_FRAME:sub(13, -5)) -- its reserved bytes
  local result = visit_packet(capture, 0, odd).results[1]
  lu.assertEquals(in_words(result), "single good Motor Data+reserved.nonzero")
  lu.assertEquals({ capture.events[1], capture.events[2], capture.events[4] },
    { "skipped line @1", "message Motor Data @1", "crc Motor Data @2" })
end

-- Of bytes at the end of a capture a revisit says so, the first visit cannot know.
function T.test_bytes_that_the_capture_ends_before()
  local capture = new_capture()
  local function is_unfinished(bytes, with)
    return visit_packet(capture, 0, bytes, with).is_unfinished
  end
  local first, last = MOTOR_FRAME .. MOTOR_FRAME:sub(1, 20), MOTOR_FRAME:sub(21) .. HEALTH_FRAME:sub(1, 20)
  lu.assertEquals({ is_unfinished(first), is_unfinished(last) }, { false, false })
  lu.assertEquals({ is_unfinished(first, { number = 1, visited = true }),
    is_unfinished(last, { number = 2, visited = true }) }, { false, true })
end

function T.test_skipped_bytes_of_a_dump()
  local capture = new_capture()
  local line = capture.reading.lines:of(lines.UDP, "", 0, "", 0)
  local packet = { key = 7 * frame_key.PACKET, number = 7, time = 0, visited = false, bytes = "?????", length = 5,
    line = line, is_bus_known = true, is_skipped = true }
  local contents = capture.reading:read_packet(packet)
  lu.assertEquals({ results_in_words(contents), contents.results[1].transfer.offset }, { "skipped 5", 0 })
  lu.assertEquals(capture.events, { "skipped line @7" })
end

-- The end ------------------------------------------------------------------------------------------------------------

local function finish(capture, may_go_on)
  return events_in_words(capture.reading:finish(may_go_on))
end

function T.test_the_end()
  local capture, list = new_capture(), frames_of(MOTOR, 9, payload_of(MOTOR, 1))
  add_all(capture, { list[1], list[2] }, { bus = 2 })
  visit_packet(capture, 0, MOTOR_FRAME:sub(1, 20))
  lu.assertEquals(capture.reading:finish(false)[1].frame.seq, 9)
  lu.assertEquals(finish(capture, false), { "unfinished Motor Data 0x210 (can1) @2", "unfinished Motor Data @3" })
  capture = new_capture()
  add_all(capture, list)
  lu.assertEquals(finish(capture, false), {})
end

-- Another file begins anew, also the answer of Reading:finish.
function T.test_the_end_of_another_file()
  local capture = new_capture()
  visit(capture, frames_of(MOTOR, 9, payload_of(MOTOR, 1))[1])
  lu.assertEquals(#capture.reading:finish(false), 1)
  capture.reading:reset(3)
  lu.assertEquals(capture.reading:finish(false), {})
end

-- A page asks for several statistics of a whole capture: what waits is no copy of itself.
function T.test_the_end_twice()
  local capture = new_capture()
  visit_packet(capture, lines.TCP, MOTOR_FRAME, { seq = 100, epoch = 1 })
  visit_packet(capture, lines.TCP, HEALTH_FRAME, { seq = 100 + #MOTOR_FRAME + 9, epoch = 1 }) -- behind a gap
  local function ending()
    local list = {}
    for i, result in ipairs(capture.reading:finish(false)) do
      list[i] = ("%s %s"):format(result.kind, result.message and result.message.copy_of)
    end
    return list
  end
  local first = ending()
  lu.assertTrue(#first > 0)
  lu.assertEquals(#capture.reading:drops(), 1)
  lu.assertEquals(ending(), first)
end

-- Bytes of no frame behind a gap: fewer than a header may be a part of one.
function T.test_the_end_in_bytes_of_no_frame()
  for length, kind in pairs { [1] = "none", [11] = "none", [12] = "skipped", [13] = "skipped" } do
    local capture = new_capture()
    visit_packet(capture, lines.TCP, MOTOR_FRAME, { seq = 100, epoch = 1 })
    visit_packet(capture, lines.TCP, ("x"):rep(length), { seq = 100 + #MOTOR_FRAME + 9, epoch = 1 })
    local list = capture.reading:finish(false)
    lu.assertEquals({ list[1] and list[1].kind or "none", list[2] }, { kind }, length)
  end
end

return T
