-- SPDX-License-Identifier: GPL-2.0-or-later
-- The reassembly of CAN frames: random frames against an oracle; visited frames, packets of several
-- frames, read filters, in the words of can_words.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local can_id = require("yapp.wire.can_id")
local crc = require("yapp.wire.crc")
local kilobytes = require("support").kilobytes
local levels = require("levels")
local oracle = require("can_oracle")
local random_can = require("can_random")
local search = require("yapp.can.search")
local stream_generator = require("stream_generator")
local words = require("can_words")

local T = {}

-- The rules ---------------------------------------------------------------------------------------

local HEALTH, MOTOR = { [""] = { 0x200, 0, 0 } }, { [""] = { 0x210, 0, 0 } }

-- A catalogue may allow a range of sizes: those are as good as the full one.
function T.test_sizes_from_min_size_on()
  for text, expected in pairs {
    ["L32"] = "single", ["L24"] = "single", ["L20"] = "single", ["L16"] = "-", ["L48"] = "-",
    ["L33"] = "-", ["L32p48"] = "-", ["S24 M8 M8 E8"] = ". . . good",
    ["S20 M8 M8 E4"] = ". . . good",
    ["S16 M8 E8"] = ".+size.mismatch . good",
    ["S33 M8 M8 M8 M8 E1"] = ".+size.mismatch . . . . good",
  } do
    lu.assertEquals((words.send(text, { ids = MOTOR, min_size = 20 })), expected, text)
  end
  for text, expected in pairs { ["L17p20"] = "single", ["L12"] = "single", ["L10p12"] = "single",
    ["L17p24"] = "-", ["L8"] = "-" } do
    lu.assertEquals((words.send(text, { ids = HEALTH, min_size = 10 })), expected, text)
  end
end

-- Random frames -----------------------------------------------------------------------------------

local function shuffled(list, random)
  local copy = {}
  for i, one in ipairs(list) do table.insert(copy, random(i), one) end
  return copy
end

-- Every frame is what the oracle says; a visited one is what it was, in any order; every fragment of
-- a message leads to the frame that shows it, and from there back.
local function compare_random(seed, change)
  local random, sure, all = stream_generator.random(seed), 0, 0
  for round = 1, levels.size(300, 3000) do
    local frames, known = random_can.frames(random), words.new()
    local time = 0
    for _, frame in ipairs(frames) do
      time = time + (random(20) == 1 and 0.05 or 1e-3)
      frame.time = time
      change(frame)
    end
    local verdicts, first, is_sure = oracle.verdicts(frames), {}, true
    for _, verdict in ipairs(verdicts) do is_sure = is_sure and not verdict.is_unsure end
    all = all + #frames
    for i, frame in ipairs(frames) do
      local text, found = words.visit(known, frame)
      first[i] = { text:match("^[^+]*"), found.payload }
    end
    for _, frame in ipairs(shuffled(frames, random)) do
      local at = frame.number
      local text, found = words.visit(known, frame, true)
      local verdict = verdicts[at]
      if is_sure then
        lu.assertEquals(text, verdict.text, ("round %d, frame %d"):format(round, at))
        lu.assertEquals({ text:match("^[^+]*"), found.payload }, first[at])
        lu.assertEquals(found.in_number, verdict.in_number)
        sure = sure + 1
      end
      if is_sure and found.payload then
        local message = found.message
        lu.assertEquals(message.has_fault or false, words.has_fault(message.payload))
        if verdict.members then
          lu.assertEquals({ words.numbers(message), message.padding or 0 },
            { verdict.members, verdict.padding })
        end
      end
    end
  end
  lu.assertTrue(sure > 0.75 * all, ("%d of %d"):format(sure, all))
end

function T.test_random_frames()
  compare_random(3, function() end)
end

-- The same where nothing tells the buses apart.
function T.test_random_frames_of_merged_buses()
  compare_random(4, function(frame) frame.bus = nil end)
end

-- Buses with messages of the same key: two with one, and nothing lost; or three with more, and frames
-- that are lost, twice, or damaged.
local function mixed(random)
  local streams, truth, is_whole = {}, {}, random(3) == 1
  for bus = 1, is_whole and 2 or 1 + random(2) do
    local stream = {}
    for _ = 1, is_whole and 1 or random(5) do
      local size, bytes = 8 + random(32), {}
      for i = 1, size do bytes[i] = string.char(random(256) - 1) end
      local payload = table.concat(bytes)
      truth[payload] = true
      stream[#stream + 1] = { 1, words.start(0x210, payload) }
      for at = 1, size, 8 do
        stream[#stream + 1] = { at + 8 > size and 3 or 2, payload:sub(at, at + 7) }
      end
    end
    streams[bus] = stream
  end
  local frames = {}
  while #streams > 0 do
    local at = random(#streams)
    local frame, fate = table.remove(streams[at], 1), is_whole and 99 or random(20)
    if fate == 2 then frame[2] = frame[2]:sub(1, -2) .. "?" end
    for _ = 1, fate == 1 and 0 or fate == 3 and 2 or 1 do
      frames[#frames + 1] = { can_id = words.can_id(0x210, frame[1]), data = frame[2],
        number = #frames + 1 }
    end
    if #streams[at] == 0 then table.remove(streams, at) end
  end
  return frames, truth, is_whole
end

-- Whatever is lost: a good message was sent like that, and no frame is in two of them.  Where
-- nothing is lost, all come out.
function T.test_mixed_at_random()
  local random, good, sent = stream_generator.random(5), 0, 0
  for _ = 1, levels.size(400, 4000) do
    local frames, truth, is_whole = mixed(random)
    local known, taken = words.new(), {}
    words.visits(known, frames)
    for _, frame in ipairs(frames) do
      local text, found = words.visit(known, frame, true)
      if text == "good" then
        lu.assertTrue(truth[found.payload])
        local data = {}
        for i, number in ipairs(words.numbers(found.message)) do
          lu.assertNil(taken[number])
          taken[number], data[i] = true, frames[number].data
        end
        lu.assertEquals(table.concat(data, "", 2), found.payload)
        if is_whole then good = good + 1 end
      end
    end
    if is_whole then
      for _ in pairs(truth) do sent = sent + 1 end
    end
  end
  lu.assertEquals(good, sent)
end

-- The search takes 500 steps, one for each frame that it looks at, and no more.
function T.test_the_effort_is_bounded()
  local fields = can_id.fields[words.can_id(0x123, 3)]
  for size, expected in pairs { [501] = 500, [502] = 0 } do
    local chunks = { received = size }
    for i = 1, size do chunks[i] = string.char(i % 256) end
    local whole = crc.of(can_id.header(fields, size) .. table.concat(chunks))
    local taken = search({ chunks = chunks, size = size, crc = whole }, fields, true)
    lu.assertEquals(taken and #taken - 1 or 0, expected)
  end
end

-- Numbers and packets -----------------------------------------------------------------------------

local WHOLE = words.frames("S32 M8 M8 M8 E8", { ids = MOTOR })

-- The frames of WHOLE, or a Command ("C"), with numbers and offsets: { number, which, offset }.
local function visits(known, rows, visited)
  local list = {}
  for i, row in ipairs(rows) do
    local frame = row[2] == "C" and { can_id = 0, data = "1234567" } or WHOLE[row[2]]
    local text, found = words.visit(known, { can_id = frame.can_id, data = frame.data,
      number = row[1], offset = row[3] }, visited)
    if text == "good" then
      text = text .. ":" .. table.concat(words.numbers(found.message), ",")
    elseif found.in_number then
      text = text .. ">" .. found.in_number
    end
    list[i] = text
  end
  return table.concat(list, " ")
end

-- A packet of IEEE 1722 has several CAN frames.
function T.test_several_frames_in_a_packet()
  local known = words.new()
  local rows = { { 1, 1, 30 }, { 1, 2, 60 }, { 1, 3, 90 }, { 2, 4, 30 }, { 2, 5, 60 },
    { 2, "C", 90 } }
  lu.assertEquals(visits(known, rows), ". . . . good:1,1,1,2,2 single")
  lu.assertEquals(visits(known, rows, true), ".>2 .>2 .>2 .>2 good:1,1,1,2,2 single")
  lu.assertEquals(visits(known, { rows[2], { 1, 1, 200 } }, true), ".>2 -")
end

-- With -2 -R, packet 3 is dropped, and the next one gets its number: the later one wins.
function T.test_a_read_filter()
  local known = words.new()
  visits(known, { { 1, 1 }, { 2, 2 }, { 3, 3 }, { 3, 4 }, { 4, 5 } })
  lu.assertEquals(visits(known, { { 1, 1 }, { 3, 4 }, { 4, 5 } }, true), ".>4 .>4 good:1,2,3,3,4")
  known = words.new() -- an orphan is dropped
  visits(known, { { 1, 2 }, { 1, 1 }, { 2, 2 } })
  lu.assertEquals(visits(known, { { 1, 1 }, { 2, 2 } }, true), ". .")
end

-- The bus is known at one visit and not at another.
function T.test_a_bus_that_is_known_here_and_there()
  for _, buses in ipairs { { 7, nil }, { nil, 7 } } do
    local known, frames = words.new(), words.frames("S32 M8 M8 M8 E8", { ids = MOTOR })
    for _, frame in ipairs(frames) do frame.bus = buses[1] end
    words.visits(known, frames)
    for _, frame in ipairs(frames) do frame.bus = buses[2] end
    lu.assertEquals(words.visits(known, frames, true), ". . . . good")
    local _, found = words.visit(known, frames[5], true)
    lu.assertEquals(found.message.source.bus, buses[1] or false)
  end
end

-- What is kept ------------------------------------------------------------------------------------

local function unfinished(text, options)
  local known, list = words.new(), {}
  words.visits(known, words.frames(text, options or {}))
  for i, open in ipairs(known.reassembly:unfinished()) do
    list[i] = words.numbers(open.transfer)[1]
  end
  return table.concat(list, ", ")
end

-- The capture ends before the newest message of a slot does, and those that it overtook.
function T.test_unfinished()
  lu.assertEquals(unfinished("S32 M8 L7"), "1")
  lu.assertEquals(unfinished("aS32 bS32 aM8 bM8", { buses = true }), "1, 2")
  lu.assertEquals(unfinished("S32 M8 S32 M8"), "1, 3")
  lu.assertEquals(unfinished("S32 M8 S32 M8 M8 M8 E8"), "1")
  lu.assertEquals(unfinished("S32 M8 S32 M8 E8"), "1, 3")
  lu.assertEquals(unfinished("S32 S32= M8 M8 M8 E8"), "")
end

-- Bytes that are kept of each of so many rounds of frames, in the second half of them.
-- number  of the frame before them, 0 when left out
local function kept_bytes(known, rounds, frames, number)
  local before
  number = number or 0
  for round = 1, rounds do
    for _, frame in ipairs(frames) do
      number = number + 1
      frame.number = number
      words.visit(known, frame)
    end
    if round == rounds / 2 then before = kilobytes() end
  end
  return (kilobytes() - before) * 1024 / (number / 2)
end

function T.test_messages_cost_little()
  for text, most in pairs { ["S32 M8 M8 M8 E8"] = 200, ["S32 S32"] = 900 } do
    local bytes = kept_bytes(words.new(), levels.size(6000, 20000), words.frames(text, { ids = MOTOR }))
    lu.assertTrue(bytes < most, ("%s: %.0f bytes a frame"):format(text, bytes))
  end
end

-- Where no frame is dissected again nothing is kept; what is open is reassembled as ever, and of what
-- is not good is said what is wrong.
function T.test_the_only_pass_keeps_nothing()
  local function frames(text)
    local list = words.frames(text, { ids = MOTOR })
    for _, frame in ipairs(list) do frame.is_only_pass = true end
    return list
  end
  for _, text in ipairs { "S32 M8 M8 M8 E8", "S32 S32 M8 M8 M8 E8 E8", "S32/7 M8 E8" } do
    local bytes = kept_bytes(words.new(), levels.size(3000, 20000), frames(text))
    lu.assertTrue(bytes < 40, ("%s: %.0f bytes a frame"):format(text, bytes))
  end
  local text = "S32 M8 M8 M8 E8 S32 M8 M8 E8 S32 M8 M8 M8 E8"
  local known, some = words.new(), frames(text)
  lu.assertEquals(words.visits(known, some),
    words.visits(words.new(), words.frames(text, { ids = MOTOR })))
  for at = 1, #some do lu.assertEquals(words.visit(known, some[at], true), "-") end
end

-- The Starts of IDs without a message type are told, so that Wireshark calls YAPP for the frames behind them.
function T.test_starts_of_unknown_ids()
  local told = {}
  local known = require("yapp.can.reassembly").new(nil, function(id, seq) told[#told + 1] = { id, seq } end)
  local function add(id, ctrl, seq, size)
    local fields = require("yapp.wire.can_id").fields[id * 0x40000 + ctrl * 0x4000 + seq]
    known:add { key = #told + 1, can_id = fields, time = 0, slot = fields.message_key, bus = false,
      source = { size = size, min_size = size }, data = "\0\0\0\0\16\0\0\0", reported = 8, is_only_pass = true }
  end
  add(0x123, 1, 0)
  add(0x123, 2, 0)
  add(0x123, 1, 9)
  add(0x124, 1, 9) -- no Seq No 0 came
  add(0x210, 1, 0, 16)
  lu.assertEquals(told, { { 0x123, 0 }, { 0x123, 9 } })
end

return T
