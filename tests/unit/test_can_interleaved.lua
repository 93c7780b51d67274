-- SPDX-License-Identifier: GPL-2.0-or-later
-- Messages of one key that interleave where nothing tells the buses: in the words of can_words, and
-- mixed at random.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local levels = require("levels")
local stream_generator = require("stream_generator")
local words = require("can_words")

local T = {}

local function check(rows, options)
  for _, row in ipairs(rows) do
    lu.assertEquals((words.send(row[1], row[3] or options)), row[2], row[1])
  end
end

function T.test_two_buses_in_every_order()
  check {
    { "aS32 bS32 aM8 bM8 aM8 bM8 aM8 bM8 aE8 bE8",
      ". . . . . . . . good good" },
    { "aS32 aM8 bS32 bM8 bM8 bM8 bE8 aM8 aM8 aE8",
      ". . . . . . good . . good" },
    { "aS32 aM8 bS32 bM8 aM8 aM8 aE8 bM8 bM8 bE8",
      ". . . . . . good . . good" },
    { "aS17 bS32 bM8 aM8 aM8 bM8 bM8 aE1 bE8", ". . . . . . . good good" },
    { "aS9 bS9 cS9 dS9 aM8 bM8 cM8 dM8 dE1 cE1 bE1 aE1",
      ". . . . . . . . good good good good" },
    { "aS41 bS41 aM16 bM16 aM16 bM16 aE9p12 bE9p12", ". . . . . . good good" },
  }
end

-- As on one bus: what a new Start cut off stays cut off.
function T.test_one_bus_that_loses_frames()
  check {
    { "S32 M8 S32 M8 M8 M8 E8", ". . .+fragment.incomplete . . . good" },
    { "S32 M8 S32 M8 M8 M8 E8 E8",
      ". . .+fragment.incomplete . . . good orphan+fragment.orphan" },
    { "S32 S32! M8 M8 M8 E8", ". .+fragment.incomplete . . . bad" },
    { "S32 S32 M8 M8 E8", ". .+fragment.incomplete . . incomplete+fragment.incomplete" },
    { "S32 M8 S32 M8 M8 M8 M8 E8",
      ". . .+fragment.incomplete . . . . overrun+fragment.overrun" },
    { "S32 S32 M8~3 M8 M8 E8", ". .+fragment.incomplete . . . truncated" },
    { "S32 S32 M8 M8 M8 E8~0", ". .+fragment.incomplete . . . truncated" },
    { "S17 S17! E17p20", ". .+fragment.incomplete bad" },
  }
end

-- The statistics keep each loss that may be withdrawn.
function T.test_few_anomalies_may_be_withdrawn()
  for text, most in pairs {
    [("S32 "):rep(50)] = 3,
    [("S32 "):rep(4) .. ("M8? "):rep(9) .. ("E8? "):rep(9) .. ("S32 "):rep(5)] = 3,
    ["S32 S32 " .. ("E8? "):rep(600)] = 0,
  } do
    local known, noted, open = words.new(), {}, 0
    local reassembly = known.reassembly
    local add_anomaly = reassembly.add_anomaly
    function reassembly.add_anomaly(...)
      noted[#noted + 1] = add_anomaly(...)
      return noted[#noted]
    end
    words.visits(known, words.frames(text, {}))
    for _, anomaly in ipairs(noted) do open = open + (anomaly.is_open and 1 or 0) end
    lu.assertTrue(#noted > 10)
    lu.assertEquals(open, most, text)
  end
end

-- A message that more than three Starts overtook is given up; after that every frame counts again.
function T.test_four_open_messages()
  local before = "aS9 bS9 bM8 bE1 cS9 cM8 cE1 dS9 dM8 dE1 "
  local shown = ". .+fragment.incomplete . good . . good . . good "
  check {
    { before .. "aM8 aE1", ". . . good . . good . . good . good" },
    { before .. "eS9 eM8 eE1 aM8 aE1", shown .. ". . good - -" },
    { before .. "eS32 eM8 eM8? eM8 eM8 eE8", shown ..
      ". . . . . overrun+fragment.overrun" },
    { before .. "eS32 eM8 eM8 eE8? eM8 eE8", shown ..
      ". . . incomplete+fragment.incomplete - -" },
  }
end

-- One that an End seemed to break stays open in case the End was another's; once it is given up, it stays broken.
function T.test_a_broken_message_that_is_given_up()
  local text = words.send("aS32 bS32 bM8 bE8? cS9 dS9 eS9 fS9 gS9")
  lu.assertStrContains(text, ". .+fragment.incomplete . incomplete+fragment.incomplete . ")
end

-- What lies before the oldest message that is left is nobody's: of a message that was not captured
-- whole the bytes since its own Start count.
function T.test_frames_of_a_message_that_was_given_up()
  local text = words.send("aS32 aM8 bS32 cS9 dS9 eS9 cM8 cE1 dM8 dE1 eM8 eE1 bM8 bM8~3 bM8 bE8")
  lu.assertStrMatches(text, ".* %. good .* good %. %. %. truncated")
end

-- Frames of an older message that stay in the pool do not count for the newest.
function T.test_bytes_since_the_newest_start()
  for _, text in ipairs { "aS17 aM8 bS17 bM8 cS32 bM8 bE1 cM8 cM8 cM8 cE8~3",
    "aS17 aM8 bS17 bM8 cS32 cM8 bM8 bE1 cM8 cM8 cE8~3" } do
    lu.assertStrMatches(words.send(text), ".* good .* truncated", nil, nil, text)
  end
end

-- If the pool has more bytes than 4096 and those of its open messages, these are given up.
function T.test_the_bytes_of_a_pool()
  local known = words.new()
  local said = words.visits(known, words.frames("S32 S32 " .. ("M8? "):rep((4096 + 2 * 32) / 8), {}))
  lu.assertStrMatches(said, "%. %.%+fragment%.incomplete[ .]*")
  known = words.new()
  said = words.visits(known, words.frames("S32 S32 " .. ("M8? "):rep((4096 + 2 * 32) / 8 + 1), {}))
  lu.assertStrMatches(said, "%. %.%+fragment%.incomplete[ .]* %.%+fragment%.overrun")
end

-- A message has one End, and a frame one message; an End of a broken message on the other bus says
-- nothing of this one.
function T.test_who_gets_a_frame()
  for _, text in ipairs { "S32 M8 M8 E8 E8", "S32 S32 M8 M8 E8 E8", "aS32 bS32 bM8 bM8 bE8 bE8" } do
    lu.assertNotStrContains(words.send(text), "good", text)
  end
  for _, text in ipairs { "aS32 bS32 bM8 aM8 bE8? aM8 aM8 aE8", "bS32 aS32 aM8 bE8? aM8 aM8 aE8",
    "bS17! aS32 bM8 bM8 bE1 aM8 aM8 aM8 aE8" } do
    lu.assertStrMatches(words.send(text), ".* good", nil, nil, text)
  end
  local frames = words.frames("S9 M8 E1", {})
  for order, expected in pairs { ["112233"] = "good good",
    ["11233"] = "good orphan+fragment.orphan" } do
    local mirrored = {} -- one message on both buses
    for at in order:gmatch(".") do
      local frame = frames[tonumber(at)]
      mirrored[#mirrored + 1] = { can_id = frame.can_id, data = frame.data, number = #mirrored + 1 }
    end
    lu.assertStrMatches(words.visits(words.new(), mirrored), ".* " .. expected:gsub("%p", "%%%0"),
      nil, nil, order)
  end
end

-- What was said of a frame is withdrawn where its message turns up: a visited frame leads to it.
function T.test_visited_frames_know_their_message()
  local text, known, frames = words.send("aS32 aM8 bS32 aM8 aM8 aE8 bM8 bM8 bM8 bE8")
  lu.assertEquals(text, ". . . . . good . . . good")
  local members = { [6] = { 1, 2, 4, 5, 6 }, [10] = { 3, 7, 8, 9, 10 } }
  for last, numbers in pairs(members) do
    for i, number in ipairs(numbers) do
      local _, found = words.visit(known, frames[number], true)
      lu.assertEquals({ found.in_number, words.numbers(found.message), found.index },
        { last, numbers, i })
      lu.assertNil(found.message.padding)
    end
  end
end

-- A fragment that was shown as that of a broken message leads to the good one that has it in the end.
function T.test_a_fragment_of_a_broken_and_of_a_good_message()
  for _, starts in ipairs { "bS32 aS32", "aS32 bS32" } do
    local known, frames = words.new(), words.frames(starts .. " aM8 bE8? aM8 aM8 aE8", {})
    local statuses = {}
    for i, frame in ipairs(frames) do
      words.visit(known, frame)
      local _, found = words.visit(known, frames[math.min(i, 3)], true)
      statuses[i] = found.message and found.message.status or "-"
    end
    lu.assertEquals(statuses, { "-", "-", "-", "incomplete", "incomplete", "incomplete", "good" })
  end
end

-- A read filter drops the last frame of a message; the one that began and ended inside it stays.
function T.test_a_read_filter()
  local known, frames = words.new(), words.frames("aS9 bS9 bM8 bE1 aM8 aE1", {})
  words.visits(known, frames)
  known.reassembly:forget(6 * 2 ^ 17 + 8)
  lu.assertEquals(words.visits(known, { frames[2], frames[3], frames[4] }, true), ". . good")
end

-- It drops a frame of messages that interleave: the next packet has its number.
function T.test_a_read_filter_between_interleaved_messages()
  local sequence = "aS32 bS32 aM8 bM8 aM8 bM8 aM8 bM8 aE8 bE8"
  for dropped = 3, 8 do
    local known, frames = words.new(), words.frames(sequence, {})
    for i, frame in ipairs(frames) do
      if i == dropped + 1 then known.reassembly:forget(dropped * 2 ^ 17 + 8) end
      if i > dropped then frame.number = i - 1 end
      words.visit(known, frame)
    end
    for i = dropped + 1, #frames do
      local _, found = words.visit(known, frames[i], true)
      lu.assertEquals({ found.in_number, found.index }, { i % 2 == 1 and 8 or 9, math.floor((i + 1) / 2) },
        ("%d dropped, %d"):format(dropped, i))
    end
  end
end

-- Whoever was given an anomaly sees that it may be withdrawn, and that it is.
function T.test_what_is_withdrawn_is_void()
  for text, expected in pairs {
    ["aS32 aM8 bS32 aM8 aM8 aE8 bM8 bM8 bM8 bE8"] = "3 incomplete open: 1 withdrawn",
    ["aS32 bS32 aM8 aE8? bM8 bM8 bM8 bE8"] = "2 incomplete open, 4 incomplete, 5 orphan open, 6 orphan open, "
      .. "7 orphan open: 3 withdrawn",
  } do
    local known, given, said = words.new(), {}, {}
    for i, frame in ipairs(words.frames(text, {})) do
      local _, found = words.visit(known, frame)
      for _, anomaly in ipairs(found.anomalies) do
        given[#given + 1] = anomaly
        said[#said + 1] = i .. anomaly.expert:gsub("fragment%.", " ") .. (anomaly.is_open and " open" or "")
        lu.assertFalse(anomaly.is_withdrawn or false)
      end
    end
    local withdrawn = 0
    for _, anomaly in ipairs(given) do
      withdrawn = withdrawn + (anomaly.is_withdrawn and 1 or 0)
      lu.assertFalse(anomaly.is_withdrawn and anomaly.is_open or false) -- else statistics wait for it
    end
    lu.assertEquals(("%s: %d withdrawn"):format(table.concat(said, ", "), withdrawn), expected)
  end
end

-- A fragment that no message got in the end is still YAPP's.
function T.test_a_stray_fragment()
  local _, known, frames = words.send("S32 M8? S32 M8 M8 M8 E8")
  lu.assertEquals(words.visits(known, frames, true),
    ". . .+fragment.incomplete . . . good")
  _, known, frames = words.send("S32 S32 M8? M8 M8 M8 E8")
  lu.assertEquals(words.visits(known, frames, true), ". .+fragment.incomplete orphan . . . good")
  lu.assertEquals((words.send("aS32 M8? bS32 aM8 aM8 aM8 aE8")), ". orphan . . . . good")
end

-- Buses with messages of the same key: two with three at most and nothing lost, so that none is
-- overtaken more than three times; or three with more, and frames that are lost, twice, or damaged.
local function mixed(random)
  local streams, truth, is_whole = {}, {}, random(3) == 1
  for bus = 1, is_whole and 2 or 1 + random(2) do
    local stream = {}
    for _ = 1, random(is_whole and 3 or 5) do
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

-- Buses that overlap without a gap: what has gone does not fill the pool.
function T.test_it_goes_on_for_long()
  local text = "aS32 aM8 " .. ("bS32 aM8 aM8 aE8 bM8 aS32 bM8 bM8 bE8 aM8 "):rep(300) .. "aM8 aM8 aE8"
  local shown = words.send(text)
  lu.assertEquals(select(2, shown:gsub("good", "")), 601)
end

-- Frames that are lost on either bus do not cost what comes a dozen messages later.
function T.test_messages_are_found_again_after_broken_ones()
  local message = { "S32", "M8", "M8", "M8", "E8" }
  for seed = 1, 10 do
    local random, list, sent, whole = stream_generator.random(seed), {}, { 0, 0 }, nil
    while sent[1] + sent[2] < 1000 do
      local bus = math.abs(sent[1] - sent[2]) > 5 and (sent[1] > sent[2] and 2 or 1) or random(2)
      if sent[bus] >= 300 or random(10) > 1 then
        list[#list + 1] = ("_ab"):sub(bus + 1, bus + 1) .. message[sent[bus] % 5 + 1]
      end
      sent[bus] = sent[bus] + 1
      if sent[1] + sent[2] == 680 then whole = #list end
    end
    local _, known, frames = words.send(table.concat(list, " "))
    for i = whole, #frames do
      if list[i]:find("E") then lu.assertEquals(words.visit(known, frames[i], true), "good", seed) end
    end
  end
end

-- Two messages of many small frames, mixed, that fit nothing: the worst that the search can meet.
function T.test_the_effort_is_bounded()
  local crc = require("yapp.wire.crc")
  local update, steps = crc.update, 0
  function crc.update(...)
    steps = steps + 1
    return update(...)
  end
  local known, number, start = words.new(), 0, words.start(0x123, "", { size = 40 })
  local function send(ctrl, data)
    number = number + 1
    words.visit(known, { can_id = words.can_id(0x123, ctrl), data = data, number = number,
      accepts_all = true })
  end
  for _ = 1, 80 do
    send(1, start)
    send(1, start)
    for i = 1, 60 do send(i % 2 == 0 and 3 or 2, string.char(i)) end
  end
  crc.update = update
  lu.assertTrue(steps > 4096, steps)
  -- 32 steps a frame, what was saved up at first, and the checks of whole messages
  lu.assertTrue(steps < 40 * number + 4096, ("%d steps for %d frames"):format(steps, number))
end

-- Instructions that frames cost, in thousands.
local function thousands_of_instructions(text)
  local frames, count = words.frames(text, {}), 0
  debug.sethook(function() count = count + 1 end, "", 1000)
  words.visits(words.new(), frames)
  debug.sethook()
  return count
end

-- Two Starts of one key, then frames that complete nothing: each costs the same, however many there
-- are, whatever the size that the Starts announce.
function T.test_frames_behind_two_starts_cost_the_same_however_many()
  for _, size in ipairs { 4000, 60000 } do
    for _, rest in ipairs { "E8 ", "E8 M8 ", "E7 M8 M8 " } do
      for _, count in ipairs(levels.size({ 500, 2000 }, { 1000, 4000, 8000 })) do
        local cost = thousands_of_instructions(("S%d S%d "):format(size, size) .. rest:rep(count))
        local frames = count * #rest / 3
        lu.assertTrue(cost < 6 * frames, ("%s: %d for %d frames"):format(rest, cost, frames))
      end
    end
  end
end

-- Frames that no open message can use end all of them: the next message is put together again.
function T.test_too_many_ends_give_all_up()
  local text = words.send("S32 S32 " .. ("E8? "):rep(600) .. "S32 M8 M8 M8 E8")
  lu.assertEquals(text:sub(-18), "- - - . . . . good")
end

return T
