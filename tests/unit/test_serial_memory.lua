-- SPDX-License-Identifier: GPL-2.0-or-later
-- The memory of byte streams: situations as tables of packets, and what each look at them has to say.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local crc = require("yapp.wire.crc")
local generator = require("stream_generator")
local history = require("yapp.message.history")
local serial_memory = require("yapp.serial.memory")
local levels = require("levels")
local serial_stream = require("yapp.serial.stream")

local A, B = generator.frame(5, "message A"), generator.frame(6, "B")
local BAD = generator.frame(7, "bad"):sub(1, -2) .. "\255"

local function unknown() return nil end

local function new()
  return serial_memory.new { new_framer = function() return serial_stream.new(unknown) end,
    new_history = function() return history.new { late = 2.5, catalogue = { messages = {} } } end }
end

-- "good 5 @0", "bad 7 in 1,2", "skipped 4 @25", "cut 5 @0 -9"
local function in_words(packet, deltas)
  if not packet then return "nothing" end
  local list = {}
  for i, event in ipairs(packet.events) do
    local what = event.status == "skipped" and event.length or event.id
    local where = event.parts and "in " .. table.concat(event.parts, ",") or event.at and "@" .. event.at or "before"
    local delta = deltas and deltas[i] and (" +%g"):format(deltas[i]) or ""
    list[i] = ("%s %s %s%s%s"):format(event.status, what, where, event.missing and " -" .. event.missing or "", delta)
  end
  if packet.pending > 0 then
    list[#list + 1] = ("%d wait%s%s"):format(packet.pending, packet.missing and " for " .. packet.missing or "",
      packet.leads_to and ", to " .. packet.leads_to or "")
  end
  return table.concat(list, ", ")
end

-- A packet { number, bytes, place =, source = } as facts; the number is its time too.
local function facts(packet, other)
  local fact = { number = packet[1], bytes = packet[2], place = packet.place or 0, transport = packet.transport or
    other.transport or "stream", truncated = packet.truncated, visited = other.visited or false,
    knows_all = packet.source == nil or other.knows_all or false }
  fact.stream = (fact.knows_all and packet.source or "") .. (packet.stream or "")
  return fact
end

-- The time since the previous good frame with its ID, by index of the frame.
local function deltas_of(memory, packet, fact)
  local deltas = {}
  for i, event in ipairs(packet and packet.events or {}) do
    if event.status == "good" then
      local message = { source = fact.stream .. event.id, id = event.id, good = true,
        time = fact.number, seq = 0 }
      memory:change(message, packet, i, fact)
      deltas[i] = message.delta or nil
    end
  end
  return deltas
end

-- Looks at packets, in an order; each has to say its `says`, or the text at the same place of another list.
local function looks(memory, packets, other, expected)
  for i, packet in ipairs(packets) do
    local fact = facts(packet, other)
    local found = memory:look(fact)
    lu.assertEquals(in_words(found, deltas_of(memory, found, fact)), expected[i], "packet " .. i)
  end
end

local function one_pass(packets, expected, transport)
  local memory = new()
  looks(memory, packets, { transport = transport }, expected)
  return memory
end

local T = {}

function T.test_what_is_said_of_a_frame()
  local payload = "12345"
  local bytes = "YP\9\3\16\2\0\0\5\0\0\0" .. payload
  bytes = bytes .. generator.little_endian(crc.of(bytes), 4)
  local event = new():look(facts({ 1, bytes }, {})).events[1]
  lu.assertEquals(event, { status = "good", id = 0x210, seq = 9, ctl = 3, size = 5, reserved = 0, payload = payload,
    length = 21, at = 0 })
  event = new():look(facts({ 1, "xy" .. bytes:sub(1, -2) .. "?" }, {})).events[2]
  lu.assertEquals({ event.status, event.at, event.crc % 0x1000000 == event.calculated % 0x1000000, event.calculated },
    { "bad", 2, true, crc.of(bytes:sub(1, -5)) })
end

function T.test_frames_and_text_in_a_packet()
  one_pass({ { 1, A }, { 2, "ok> " .. A .. B .. "\r\n" }, { 3, B }, { 4, BAD } }, {
    "good 5 @0", "skipped 4 @0, good 5 @4 +1, good 6 @29, skipped 2 @46", "good 6 @0 +1", "bad 7 @0" })
end

-- Numbers, bytes; then what a first pass says, and what each later look says, in any order.
function T.test_a_frame_in_several_packets()
  local packets = { { 1, A:sub(1, 5) }, { 3, A:sub(6, 20) }, { 4, A:sub(21) .. B .. B:sub(1, 13) }, { 9, B:sub(14) } }
  local memory = one_pass(packets, {
    "5 wait", "15 wait for 5", "good 5 in 1,3,4, good 6 @5, 13 wait for 4", "good 6 in 4,9 +5" })
  local later = {
    "5 wait, to 4", "15 wait for 5, to 4", "good 5 in 1,3,4, good 6 @5, 13 wait for 4, to 9", "good 6 in 4,9 +5" }
  looks(memory, packets, { visited = true }, later)
  for _, i in ipairs { 4, 1, 3, 1, 2 } do looks(memory, { packets[i] }, { visited = true }, { later[i] }) end
  local event = memory:look(facts(packets[4], { visited = true })).events[1]
  lu.assertEquals({ event.bytes, event.at, event.length }, { B, nil, 17 })
end

function T.test_skipped_bytes_that_came_before()
  local memory = one_pass({ { 1, "textY" }, { 2, "more" } }, { "skipped 4 @0, 1 wait", "skipped 5 before" })
  local event = memory:look(facts({ 2, "more" }, { visited = true })).events[1]
  lu.assertEquals({ event.bytes, event.parts }, { "Ymore" })
end

-- A bad frame is shown when a frame that overlaps it and was open proves good: all packets lead there.
function T.test_a_bad_frame_that_had_to_wait()
  local claim = generator.header(5, 60)
  local packets = { { 1, claim .. BAD }, { 2, ("x"):rep(30) }, { 3, A .. "rest" } }
  local memory = one_pass(packets, { "31 wait for 45", "30 wait for 15", "skipped 12 before, bad 7 in 1, " ..
    "skipped 30 before, good 5 @0, skipped 4 @25" })
  looks(memory, packets, { visited = true }, { "31 wait for 45, to 3", "30 wait for 15", "skipped 12 before, " ..
    "bad 7 in 1, skipped 30 before, good 5 @0, skipped 4 @25" })
end

function T.test_what_the_capture_cut()
  one_pass({ { 1, A:sub(1, 20), truncated = true }, { 2, A } }, { "cut 5 @0 -5", "good 5 @0" })
  local packet = new():look(facts({ 1, A:sub(1, 20), truncated = true }, {}))
  lu.assertEquals({ packet.events[1].truncated, packet.events[1].payload, packet.events[1].crc }, { true, "message " })
end

-- "a 5 of 3": stream, ID and last packet of each frame that the capture ends before.
local function unfinished(memory)
  local list = {}
  for i, open in ipairs(memory:unfinished()) do
    list[i] = ("%s %d of %d"):format(open.fact.stream, open.header:byte(5), open.fact.number)
  end
  table.sort(list)
  return table.concat(list, ", ")
end

-- The numbers of the packets of which a look says that the capture ends before their frame.
local function say_unfinished(memory, packets, other)
  local list = {}
  for _, packet in ipairs(packets) do
    if memory:look(facts(packet, other)).is_unfinished then list[#list + 1] = packet[1] end
  end
  return table.concat(list, ",")
end

function T.test_the_capture_ends_before_a_frame()
  local packets = { { 1, A:sub(1, 20), stream = "a" }, { 2, B, stream = "b" }, { 3, A:sub(21), stream = "a" },
    { 4, "x" .. A:sub(1, 14), stream = "a" }, { 5, A:sub(15, 17), stream = "a" }, { 6, B:sub(1, 11), stream = "c" } }
  local memory = new()
  lu.assertEquals(say_unfinished(memory, packets, {}), "")
  lu.assertEquals(unfinished(memory), "a 5 of 5")
  lu.assertEquals(say_unfinished(memory, packets, { visited = true }), "5")
  memory = one_pass({ { 1, A .. B:sub(1, 12) }, { 2, B:sub(1, 16) } }, { "good 5 @0", "" }, "segment")
  lu.assertEquals(unfinished(memory), " 6 of 2")
  one_pass({ { 1, A:sub(1, 20), truncated = true } }, { "cut 5 @0 -5" })
  lu.assertEquals(unfinished(one_pass({ { 1, A:sub(1, 20) } }, { "cut 5 @0 -5" }, "datagram")), "")
end

-- Which of two that overlap it is nobody knows: the one that began first is shown when more comes.
function T.test_the_capture_ends_before_one_of_two_frames()
  local memory = one_pass({ { 1, generator.header(7, 20) .. generator.header(8, 90) .. "12345678" } },
    { "32 wait for 4" })
  lu.assertEquals(unfinished(memory), " 7 of 1")
  memory:look(facts({ 2, "1234" }, {})) -- now that is a bad one, for which the other has to wait
  lu.assertEquals(unfinished(memory), " 7 of 2")
end

function T.test_a_second_pass_has_streams_of_its_own()
  local packets = { { 1, A:sub(1, 14), source = "<" }, { 2, B:sub(1, 14), source = ">" } }
  local memory = new()
  for _, packet in ipairs(packets) do memory:look(facts(packet, {})) end
  local knows = { visited = true, knows_all = true }
  lu.assertEquals(say_unfinished(memory, packets, knows), "2") -- the last: then the pass has come to its end
  lu.assertEquals(say_unfinished(memory, packets, knows), "1,2")
  lu.assertEquals(unfinished(memory), "< 5 of 1, > 6 of 2")
end

function T.test_streams_do_not_mix()
  one_pass({ { 1, A:sub(1, 9), stream = "a" }, { 2, B, stream = "b" }, { 3, A:sub(10), stream = "a" },
    { 5, A, stream = "b" } }, { "9 wait", "good 6 @0", "good 5 in 1,3", "good 5 @0" })
end

function T.test_datagrams()
  local packets = { { 1, A }, { 2, "x" .. B .. A:sub(1, 20) }, { 3, A:sub(21) }, { 4, "YP" }, { 5, A .. A },
    { 6, A:sub(1, 20), truncated = true } }
  local expected = { "good 5 @0", "skipped 1 @0, good 6 @1, cut 5 @18 -5", "skipped 5 @0", "skipped 2 @0",
    "good 5 @0 +4, good 5 @25 +0", "cut 5 @0 -5" }
  local memory = one_pass(packets, expected, "datagram")
  looks(memory, packets, { visited = true, transport = "datagram" }, expected)
  looks(memory, { packets[5], packets[1] }, { visited = true, transport = "datagram" }, { expected[5], expected[1] })
end

-- TCP hands over again what is not done.
function T.test_segments()
  local rest = A:sub(1, 20)
  local packets = { { 1, B .. rest }, { 2, rest .. A:sub(21) }, { 3, "> " .. B, place = 30 } }
  local expected = { "good 6 @0", "good 5 @0", "skipped 2 @0, good 6 @2 +2" }
  local memory = one_pass(packets, expected, "segment")
  looks(memory, packets, { visited = true, transport = "segment" }, expected)
  lu.assertEquals(memory:look(facts(packets[1], { visited = true })).done, #B)
end

-- As long as none of the new bytes are done, TCP keeps all of them: what is found waits too.
function T.test_segments_that_only_wait()
  local claim = generator.header(5, 40)
  local memory = new()
  local function done(number, bytes)
    local packet = memory:look(facts({ number, bytes }, { transport = "segment" }))
    return { in_words(packet), packet.done }
  end
  lu.assertEquals(done(1, claim), { "", 0 })
  lu.assertEquals(done(2, claim .. BAD), { "", 0 })
  lu.assertEquals(done(3, claim .. BAD .. A), { "skipped 12 @0, bad 7 @12, good 5 @31", 56 })
  lu.assertEquals(done(4, claim), { "", 0 })
  lu.assertEquals(done(5, "something else" .. A), { "skipped 14 @0, good 5 @14", 39 }) -- claim was lost on the way
end

function T.test_a_segment_that_waits_too_long()
  local memory = new()
  local claim = generator.header(5, 65535)
  local bytes = claim .. ("x"):rep(65539) .. claim
  local packet = memory:look(facts({ 1, bytes }, { transport = "segment" }))
  lu.assertEquals({ in_words(packet), packet.done }, { "bad 5 @0", 65551 })
end

-- A tunnel: several pieces in a packet.
function T.test_several_pieces_in_a_packet()
  for _, transport in ipairs { "datagram", "segment", "stream" } do
    local packets = { { 1, A, place = 42 }, { 1, B, place = 90 }, { 1, "x" .. A, place = 140 }, { 2, A, place = 42 } }
    local expected = { "good 5 @0", "good 6 @0", "skipped 1 @0, good 5 @1 +0", "good 5 @0 +1" }
    local memory = one_pass(packets, expected, transport)
    looks(memory, packets, { visited = true, transport = transport }, expected)
    looks(memory, { packets[2], { 1, A, place = 0 } }, { visited = true }, { expected[2], "nothing" })
  end
end

-- tshark -2 -R: what was rejected has the number of the next one.
function T.test_rejected_packets()
  local memory = new()
  looks(memory, { { 1, A }, { 1, "x" .. A }, { 1, B }, { 2, "y" }, { 2, A } }, {},
    { "good 5 @0", "skipped 1 @0, good 5 @1 +0", "good 6 @0", "skipped 1 @0", "good 5 @0 +1" })
  looks(memory, { { 1, B }, { 2, A } }, { visited = true }, { "good 6 @0", "good 5 @0 +1" })
  looks(memory, { { 3, A:sub(1, 9) }, { 3, A:sub(10) } }, {}, { "9 wait", "good 5 in 3 +1" })
  looks(memory, { { 3, A:sub(10) } }, { visited = true }, { "good 5 in 3 +1" })
  lu.assertEquals(memory:look(facts({ 3, A:sub(10) }, { visited = true })).events[1].count, 2)
end

function T.test_what_nobody_asked_about_is_not_ours_later()
  local memory = one_pass({ { 2, A } }, { "good 5 @0" })
  looks(memory, { { 1, A }, { 2, A } }, { visited = true }, { "nothing", "good 5 @0" })
end

-- Two directions, whose bytes are one stream to a first pass that cannot tell them apart.
local DUPLEX = { { 1, A:sub(1, 14), source = "<" }, { 2, B, source = ">" }, { 3, A:sub(15), source = "<" },
  { 4, B, source = "<" }, { 5, A, source = ">" } }
local APART = { "14 wait for 11", "good 6 @0", "good 5 in 1,3", "good 6 @0", "good 5 @0" }
local MIXED = { "14 wait for 11", "skipped 14 before, good 6 @0", "skipped 11 @0", "good 6 @0 +2", "good 5 @0" }

function T.test_a_first_pass_that_knows_all()
  local memory = new()
  looks(memory, DUPLEX, { knows_all = true }, APART)
  local later = { "14 wait for 11, to 3", APART[2], APART[3], APART[4], APART[5] }
  for _, knows_all in ipairs { true, false } do
    looks(memory, DUPLEX, { visited = true, knows_all = knows_all }, later)
  end
end

function T.test_a_second_pass_that_knows_better()
  local memory = new()
  looks(memory, DUPLEX, {}, MIXED)
  looks(memory, DUPLEX, { visited = true }, MIXED) -- and one that does not
  looks(memory, DUPLEX, { visited = true, knows_all = true }, APART)
  local later = { "14 wait for 11, to 3", APART[2], APART[3], APART[4], APART[5] }
  for _, i in ipairs { 3, 1, 5, 2, 4 } do
    looks(memory, { DUPLEX[i] }, { visited = true, knows_all = true }, { later[i] })
  end
end

-- Who asks here and there gets what the first pass knows; what changed there is not known, as it took several
-- sources for one.
function T.test_looks_here_and_there_at_what_was_mixed()
  local memory = new()
  looks(memory, DUPLEX, {}, MIXED)
  for _, i in ipairs { 2, 4, 3, 5 } do
    local fact = facts(DUPLEX[i], { visited = true, knows_all = true })
    local packet, message = memory:look(fact), { good = true, source = "s", time = 1 }
    lu.assertEquals(in_words(packet), (MIXED[i]:gsub(" %+2", "")))
    lu.assertNil(memory:change(message, packet, #packet.events, fact))
    lu.assertEquals({ message.is_unsure, message.delta }, { true, false })
  end
end

function T.test_pieces_of_a_packet_in_a_second_pass()
  local packets = { { 1, A, place = 10, source = "<" }, { 1, B:sub(1, 5), place = 60, source = ">" },
    { 1, B:sub(6), place = 90, source = ">" } }
  local memory = new()
  looks(memory, packets, {}, { "good 5 @0", "5 wait", "good 6 in 1,1" })
  for _ = 1, 2 do
    looks(memory, packets, { visited = true, knows_all = true }, { "good 5 @0", "5 wait", "good 6 in 1,1" })
  end
end

-- Nothing that was returned changes later, and the record of the facts may be used again.
function T.test_answers_stay()
  local memory = new()
  local fact = facts({ 1, A:sub(1, 9) }, {})
  local first = memory:look(fact)
  local words = in_words(first)
  fact.number, fact.bytes, fact.time = 2, A:sub(10), 2
  local second = memory:look(fact)
  local words_of_second = in_words(second)
  second.events[1].status, second.events[1].delta = "changed", 99
  lu.assertEquals(in_words(first), words)
  lu.assertEquals(in_words(memory:look(facts({ 2, A:sub(10) }, { visited = true }))), words_of_second)
end

-- Of a packet that nobody looks at again nothing is kept, nor invented; its stream goes on.
function T.test_a_packet_that_is_forgotten()
  local memory, packets = new(), { { 1, A }, { 2, B:sub(1, 5) }, { 3, B:sub(6) } }
  local said = { "good 5 @0", "5 wait", "good 6 in 2,3" }
  for i, packet in ipairs(packets) do
    local found = memory:look(facts(packet, {}))
    lu.assertEquals(in_words(found), said[i])
    memory:forget(found)
  end
  for _, packet in ipairs(packets) do
    lu.assertEquals(in_words(memory:look(facts(packet, { visited = true }))), "")
  end
end

function T.test_one_frame_a_packet_costs_little()
  collectgarbage()
  collectgarbage()
  local before = collectgarbage("count")
  local memory = new()
  for i = 1, 10000 do memory:look(facts({ i, A }, { transport = i % 2 == 0 and "stream" or "datagram" })) end
  collectgarbage()
  collectgarbage()
  lu.assertTrue(collectgarbage("count") - before < 600) -- KB: less than 60 bytes a packet
  lu.assertEquals(in_words(memory:look(facts({ 5000, A }, { visited = true }))), "good 5 @0")
end

-- Nor do packets with ends and beginnings of frames, when the stream has gone on: 40 frames of 48 bytes, 64 at a time.
function T.test_parts_of_frames_cost_little()
  local stream, packets = {}, {}
  for i = 1, 40 do stream[i] = generator.frame(5, ("%032d"):format(i)) end
  stream = table.concat(stream)
  for at = 1, #stream, 64 do packets[#packets + 1] = stream:sub(at, at + 63) end
  collectgarbage()
  collectgarbage()
  local before = collectgarbage("count")
  local memory = new()
  local function look(number, visited)
    return memory:look(facts({ number, packets[(number - 1) % #packets + 1] }, { visited = visited }))
  end
  for i = 1, 200 * #packets do look(i) end
  collectgarbage()
  collectgarbage()
  lu.assertTrue((collectgarbage("count") - before) * 1024 / (200 * #packets) < 1500) -- bytes a packet
  for _, number in ipairs { 2, 3002, 1502, 5999 } do
    local expected = ("good 5 in %d,%d"):format(number - 1, number)
    lu.assertEquals(in_words(look(number, true)):sub(1, #expected), expected)
  end
end

-- Whole frames, parts of frames and noise, in packets of any size, some of them two of a number.
local function odd_packets(random)
  local frames, packets, at = {}, {}, 1
  for i = 1, 2000 do frames[i] = random(4) > 1 and generator.frame(5, ("%032d"):format(i)) or ("n"):rep(i % 40) end
  local stream = table.concat(frames)
  while at <= #stream do
    local size, before = random(3) == 1 and 48 or random(90), packets[#packets]
    local is_second = before and random(10) == 1
    packets[#packets + 1] = { before and before[1] + (is_second and 0 or 1) or 1, stream:sub(at, at + size - 1),
      place = is_second and before.place + 1 or 0 }
    at = at + size
  end
  return packets
end

-- What each packet has to say, read plainly from what the framing says of its stream: its events in words, and where
-- the bytes that wait at its end lead.
local function expected_of(packets)
  local framer, at, said = serial_stream.new(unknown), 0, {}
  local ranges = {}
  for i, packet in ipairs(packets) do
    local from = at
    at = at + #packet[2]
    ranges[i] = { number = packet[1], from = from, to = at }
    local list = {}
    for n, event in ipairs(framer:feed(packet[2])) do
      local parts = {}
      for k, range in ipairs(ranges) do
        if range.from < event.to and range.to > event.from then
          parts[#parts + 1] = range.number
          if event.kind == "frame" and k < i and range.number ~= packet[1] and event.from < from then
            said[k].leads_to = packet[1]
          end
        end
      end
      local where = event.from >= from and "@" .. event.from - from or
        event.kind == "skipped" and "before" or "in " .. table.concat(parts, ",")
      local status = event.kind == "frame" and (event.good and "good" or "bad") or event.kind
      list[n] = ("%s %d %s"):format(status, event.kind == "skipped" and event.to - event.from or 5, where)
    end
    said[i] = { events = list, pending = at - math.max(framer:offset(), from) }
  end
  return said
end

local function told(packet)
  local list = {}
  for i, event in ipairs(packet.events) do
    local where = event.parts and "in " .. table.concat(event.parts, ",") or event.at and "@" .. event.at or "before"
    list[i] = ("%s %d %s"):format(event.status, event.status == "skipped" and event.length or event.id, where)
  end
  return { events = list, pending = packet.pending, leads_to = packet.leads_to }
end

function T.test_random_packets_in_any_order()
  for seed = 1, levels.size(4, 40) do
    local random = generator.random(seed)
    local packets, memory = odd_packets(random), new()
    local said = expected_of(packets)
    for i, packet in ipairs(packets) do
      local found = told(memory:look(facts(packet, {})))
      lu.assertEquals({ found.events, found.pending }, { said[i].events, said[i].pending }, "seed " .. seed .. " " .. i)
    end
    for _ = 1, 500 do
      local i = random(#packets)
      lu.assertEquals(told(memory:look(facts(packets[i], { visited = true }))), said[i], "seed " .. seed .. " " .. i)
    end
  end
end

-- A read filter (-R) that rejects many packets gives all of them one number: it is the last one's.
function T.test_one_number_for_many_packets()
  local memory = new()
  for _ = 1, 500 do memory:look(facts({ 7, "noise" }, {})) end
  memory:look(facts({ 7, "the last" }, {}))
  lu.assertEquals(in_words(memory:look(facts({ 7, "the last" }, { visited = true }))), "skipped 8 @0")
end

function T.test_a_frame_of_two_large_packets()
  local memory, large = new(), generator.frame(5, ("x"):rep(65000))
  memory:look(facts({ 300, large:sub(1, 1000) }, {}))
  memory:look(facts({ 301, large:sub(1001) }, {}))
  for number = 302, 1000 do memory:look(facts({ number, A }, {})) end
  lu.assertEquals(in_words(memory:look(facts({ 300, large:sub(1, 1000) }, { visited = true }))),
    "1000 wait for 64016, to 301")
  lu.assertEquals(in_words(memory:look(facts({ 301, large:sub(1001) }, { visited = true }))), "good 5 in 300,301")
end

return T
