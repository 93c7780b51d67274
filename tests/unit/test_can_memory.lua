-- SPDX-License-Identifier: GPL-2.0-or-later
-- The memory of CAN frames: each rule by itself, in the words of can_words; random frames against
-- an oracle; later looks, packets of several frames, read filters, second passes.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local crc = require("yapp.wire.crc")
local can_id = require("yapp.wire.can_id")
local levels = require("levels")
local oracle = require("can_oracle")
local stream_generator = require("stream_generator")
local words = require("can_words")

local T = {}

-- The rules ---------------------------------------------------------------------------------------

local COMMAND, HEALTH = { [""] = { 0, 0, 0 } }, { [""] = { 0x200, 0, 0 } }
local MOTOR = { [""] = { 0x210, 0, 0 } }

local function check(rows, options)
  for _, row in ipairs(rows) do
    local all = { buses = true }
    for _, more in ipairs { options or {}, row[3] or {} } do
      for k, v in pairs(more) do all[k] = v end
    end
    local text, _, frames = words.send(row[1], all)
    lu.assertEquals(text, row[2], row[1])
    lu.assertEquals(table.concat(oracle.verdicts(frames), " "), row[2], row[1])
  end
end

function T.test_whole_messages()
  check {
    { "S32 M8 M8 M8 E8", "part part part part good" },
    { "S9 M8 E1", "part part good" },
    { "S9 E8 E1", "part short+fragment.incomplete -" },
    { "S32 M8 M8 M8 E8 S32 M8 M8 M8 E8", "part part part part good part part part part good" },
    { "S32 M4 M8 M8 M8 E4", "part part part part part good" }, -- any lengths that add up
    { "S32! M8 M8 M8 E8", "part part part part bad" },
    { "S65 M64 E1", "part part good" },
    { "S73 M64 E9p12", "part part good" },
    { "S40 E40p48", "part good" },
    { "S40 E40p64", "part overrun+fragment.overrun" }, -- 48 would have done
    { "S16 M8 E8/12", "part part overrun+fragment.overrun" },
  }
end

function T.test_what_breaks_is_named()
  check({
    { "S32 M8 M8 M8 E8 E8", "part part part part good orphan+fragment.orphan" },
    { "S32 S32 M8 M8 M8 E8", "part part+fragment.incomplete part part part good" },
    { "S32 M8 S32 M8 M8 E8",
      "part part part+fragment.incomplete part part short+fragment.incomplete" },
    { "S32 M8 M8 E8", "part part part short+fragment.incomplete" },
    { "S32 M8 M8 M8 M8 E8", "part part part part part overrun+fragment.overrun" },
    { "S32 M8 M8 M8 M8 M8 E8",
      "part part part part part part+fragment.overrun overrun+fragment.overrun" },
    { "S32 M8 M8 M8 M8 M8 S32 M8 M8 M8 E8",
      "part part part part part part+fragment.overrun part part part part good" },
    { "M8 E8 S32 M8 M8 M8 E8",
      "orphan+fragment.orphan orphan+fragment.orphan part part part part good" },
    { "S32 M8 M8? M8 E8", "part part part part bad" },
  }, { ids = MOTOR })
end

function T.test_malformed_starts()
  check({
    { "S32/7 M8", "start+fragment.incomplete orphan+fragment.orphan" },
    { "S32/1 E8", "start+fragment.incomplete orphan+fragment.orphan" },
    { "S32 M8 S32/7 M8",
      "part part start+fragment.incomplete+fragment.incomplete orphan+fragment.orphan" },
    { "S0 E8", "start+size.mismatch orphan+fragment.orphan" },
    { "S32r M8 M8 M8 E8", "part+reserved.nonzero part part part good" },
    { "S32/12 M8 M8 M8 E8", "part+size.mismatch part part part good" },
    { "S32/12~4 M8", "start+size.mismatch orphan+fragment.orphan" },
    { "S5 E5", "part good" },
    { "X8", "invalid+can.ctrl.invalid" },
    { "S32 X8? M8 M8 M8 E8", "part invalid+can.ctrl.invalid part part part good" },
  }, { is_wide = true })
end

-- A firmware that grew a field: what follows belongs to its Start.
function T.test_sizes_that_are_not_the_catalogues()
  check({
    { "S34 M8 M8 M8 M8 E2", "part+size.mismatch part part part part good" },
    { "S32 M8 S34 M8 M8 M8 M8 E2",
      "part part part+fragment.incomplete+size.mismatch part part part part good" },
    { "S30 M8 M8 M8 E6", "part+size.mismatch part part part good" },
    { "S8 E8", "- orphan+fragment.orphan" }, -- would fit one frame
    { "L32", "single" }, { "L34", "-" }, { "L34", "single", { is_wide = true } },
  }, { ids = MOTOR })
end

-- A catalogue may allow a range of sizes: those are as good as the full one.
function T.test_sizes_from_min_size_on()
  for text, expected in pairs {
    ["L32"] = "single", ["L24"] = "single", ["L20"] = "single", ["L16"] = "-", ["L48"] = "-",
    ["L33"] = "-", ["L32p48"] = "-", ["S24 M8 M8 E8"] = "part part part good",
    ["S20 M8 M8 E4"] = "part part part good",
    ["S16 M8 E8"] = "part+size.mismatch part good",
    ["S33 M8 M8 M8 M8 E1"] = "part+size.mismatch part part part part good",
  } do
    lu.assertEquals((words.send(text, { ids = MOTOR, min_size = 20 })), expected, text)
  end
  for text, expected in pairs { ["L17p20"] = "single", ["L12"] = "single", ["L10p12"] = "single",
    ["L17p24"] = "-", ["L8"] = "-" } do
    lu.assertEquals((words.send(text, { ids = HEALTH, min_size = 10 })), expected, text)
  end
end

function T.test_cut_by_the_snap_length()
  check({
    { "S32 M8~3 M8 M8 E8", "part part part part unverified" },
    { "S32 M8 M8 M8 E8~0", "part part part part unverified" },
    { "S32~4 M8", "start orphan+fragment.orphan" },
    { "S32 M8 S32~4 M8", "part part start+fragment.incomplete orphan+fragment.orphan" },
    { "S32 M8~3 M8 E8", "part part part short+fragment.incomplete" },
    { "S32 M8~3 M8 M8 M8 M8", "part part part part part part+fragment.overrun" },
  }, { ids = MOTOR })
end

function T.test_only_what_is_surely_yapp_is_claimed()
  check {
    { "L8", "-" }, { "X8", "-" }, { "M8", "-" }, { "E8", "-" }, { "S8 E8", "- -" }, { "S9/7", "-" },
    { "S9/12", "-" }, { "S9~7", "-" }, { "S9r", "-" }, { "S0", "-" }, { "S65535", "part" },
    { "S9 M8 E1 E1", "part part good -" },
    { "L7", "single", { ids = COMMAND } }, { "L8", "-", { ids = COMMAND } },
    { "L6", "-", { ids = COMMAND } },
    { "L8", "-", { ids = MOTOR } }, { "L17p20", "single", { ids = HEALTH } },
    { "L17p24", "-", { ids = HEALTH } },
    { "L7", "-", { ids = { [""] = { 0, 1, 0 } } } },
    { "L7", "single", { ids = { [""] = { 0, 0, 255 } } } },
    { "M8 E1", "orphan+fragment.orphan orphan+fragment.orphan", { ids = MOTOR } },
    { "M8 E1", "- -", { ids = { [""] = { 0x210, 1, 0 } } } },
    { "S9", "-", { ids = { [""] = { 0x123, 1, 0 } } } },
    -- once the ID is known as YAPP's
    { "aS9 aM8 aE1 bS9 bM8 bE1 aS9 aM8 aE1", "- - - part part good part part good",
      { ids = { a = { 0x123, 0, 9 }, b = { 0x123, 0, 0 } }, buses = false } },
    { "S32 M8", "part part", { ids = { [""] = { 0x210, 0, 9 } } } }, { "X8", "-", { ids = MOTOR } },
  }
  check({ -- the user says that all is YAPP
    { "L8", "single" }, { "M8", "orphan+fragment.orphan" }, { "S9 M8 E1", "part part good" },
    { "S9 M8 E1", "part part good", { ids = { [""] = { 0x123, 63, 255 } } } },
  }, { is_wide = true })
end

function T.test_keys()
  for _, ids in ipairs {
    { a = { 0x210, 0, 0 }, b = { 0x210, 0, 1 } },   -- Seq
    { a = { 0x210, 0, 255 }, b = { 0x210, 1, 255 } }, -- YAPP CTL
    { a = { 0x210, 0, 0 }, b = { 0x211, 0, 0 } },   -- Msg ID
  } do
    check({ { "aS32 bS32 aM8 bM8 aM8 bM8 bM8 bE8 aM8 aE8",
      "part part part part part part part good part good" } },
      { ids = ids, is_wide = true, buses = false })
  end
  check { { "aS32 bM8 aM8 bE8 aM8 aM8 aE8", "part - part - part part good" } } -- two buses
end

-- CAN delivers a frame twice: proved by the CRC, on a bus that is told and on one that is not.
function T.test_a_frame_delivered_twice()
  for _, is_told in ipairs { true, false } do
    check({
      { "S32 M8 M8 M8= M8 E8", "part part part part+fragment.duplicate part good" },
      -- of several runs
      { "S32 M8 M8= M8 M8= M8 M8= E8",
        "part part part part part part part overrun+fragment.overrun" },
      { "S32 M8 M8= M8= M8 M8 E8",
        "part part part+fragment.duplicate part+fragment.duplicate part part good" },
      -- the CRC proves nothing
      { "S32! M8 M8= M8 M8 E8", "part part part part part overrun+fragment.overrun" },
      { "S32 M8 M8= M8? M8 E8", "part part part part part overrun+fragment.overrun" },
      -- one lost, one twice: as long as it should be
      { "S32 M8 M8 M8= E8", "part part part part bad" },
    }, { ids = MOTOR, buses = is_told })
    check({ -- CAN FD, whose last frame has padding
      { "S41 M16 M16 M16= E9p12", "part part part part+fragment.duplicate good" },
      { "S57 M16 M16= M16= M16 M16 E9p12",
        "part part part+fragment.duplicate part+fragment.duplicate part part good" },
      { "S37 M12 M12= M12 E13p16", "part part part+fragment.duplicate part good" },
      { "S37 M12 M12= M12 E13p20", "part part part part overrun+fragment.overrun" },
    }, { buses = is_told })
    for text, padding in pairs { ["S41 M16 M16 M16= E9p12"] = 3, ["S32 M8 M8= M8 M8 E8"] = 0 } do
      local _, known, frames = words.send(text, { buses = is_told })
      lu.assertEquals(select(2, words.look(known, frames[#frames], true)).entry.padding or 0, padding)
    end
  end
end

function T.test_faults_say_which_frames()
  local _, known, frames = words.send("S32 M8 M8 E8 S32 M8 S32", { buses = true })
  local function text(number)
    return select(2, words.look(known, frames[number], true)).faults[1].text
  end
  lu.assertStrContains(text(4), "started in frame 1 ends with 24 of 32 bytes")
  lu.assertStrContains(text(7), "8 of 32 bytes")
  _, known, frames = words.send("M8 E8", { ids = MOTOR })
  lu.assertEquals({ text(1), text(2) }, { "Middle of a message whose Start is not here",
    "End of a message whose Start is not here" })
end

-- Payloads may have frames alike by themselves: which of them came twice is looked for in eight of
-- such runs, from the start of the message.
function T.test_a_frame_delivered_twice_behind_others_alike()
  for runs, expected in pairs { [7] = "good", [8] = "overrun+fragment.overrun" } do
    local chunks = {}
    for run = 1, runs do
      local chunk = ("%d"):rep(8):format(run, run, run, run, run, run, run, run)
      chunks[2 * run - 1], chunks[2 * run] = chunk, chunk
    end
    local twice = #chunks + 1
    chunks[twice], chunks[twice + 1] = "twice...", "the end."
    local sent = { { 1, words.start(0x123, table.concat(chunks)) } }
    table.insert(chunks, twice, "twice...")
    for i, chunk in ipairs(chunks) do sent[i + 1] = { i < #chunks and 2 or 3, chunk } end
    local known, said = words.new(), nil
    for i, one in ipairs(sent) do
      said = words.look(known, { can_id = words.can_id(0x123, one[1]), data = one[2], number = i,
        bus = 1 })
    end
    lu.assertEquals(said, expected, runs)
  end
end

-- Random frames -----------------------------------------------------------------------------------

local function shuffled(list, random)
  local copy = {}
  for i, one in ipairs(list) do table.insert(copy, random(i), one) end
  return copy
end

-- Every frame is what the oracle says; later looks say what the first ones said, in any order;
-- every part of a message leads to the frame that shows it, and from there back.
function T.test_random_frames()
  local random = stream_generator.random(3)
  for round = 1, levels.size(300, 3000) do
    local frames, known = oracle.random_frames(random), words.new()
    local verdicts, first = oracle.verdicts(frames), {}
    for i, frame in ipairs(frames) do
      local text, record = words.look(known, frame)
      first[i] = { text:match("^[^+]*"), record.delta,
        record.entry and record.entry.payload }
    end
    for _, frame in ipairs(shuffled(frames, random)) do
      local at = frame.number
      local text, record = words.look(known, frame, true)
      lu.assertEquals(text, verdicts[at], ("round %d, frame %d"):format(round, at))
      lu.assertEquals(text:match("^[^+]*"), first[at][1])
      local delta = record.delta -- kept to the nanosecond
      lu.assertEquals(delta ~= nil, first[at][2] ~= nil)
      if delta then lu.assertAlmostEquals(delta, first[at][2], 1e-9) end
      local entry = record.entry
      if entry and entry.last == record.look then
        lu.assertEquals(entry.payload, first[at][3])
        for _, number in ipairs(record.pass:numbers(record.entry)) do
          lu.assertEquals((known:outcome(select(2, words.look(known, frames[number], true)))), at)
        end
      end
    end
  end
end

-- A first pass that did not know the buses (-2 on BLF) leaves nothing behind in the second, which
-- knows them: that says what it would say alone.  Who asks here and there before it is told what
-- the first knew.
function T.test_a_second_pass()
  local random = stream_generator.random(7)
  for round = 1, levels.size(100, 1000) do
    local frames, known, alone = oracle.random_frames(random), words.new(), words.new()
    for _, frame in ipairs(frames) do
      local bus = frame.bus
      frame.bus, frame.knows_bus = nil, false
      local _, record = words.look(known, frame)
      lu.assertNil(record.change)
      frame.bus, frame.knows_bus = bus, true
    end
    local at = #frames > 9 and random(#frames - 1) + 1
    if at then words.look(known, frames[at], true) end
    for i, frame in ipairs(frames) do
      local text, record = words.look(known, frame, true)
      local expected, other = words.look(alone, frame)
      lu.assertEquals(text, expected, ("round %d, frame %d"):format(round, i))
      lu.assertEquals({ record.change, record.delta }, { other.change, other.delta })
    end
    lu.assertEquals(words.looks(known, frames, true), table.concat(oracle.verdicts(frames), " "))
    lu.assertEquals(#known:unfinished(), #alone:unfinished())
  end
end

function T.test_here_and_there_the_first_pass_is_asked()
  local known = words.new()
  local frames = words.frames("aS32 bS32 aM8 bM8 aM8 bM8 aM8 bM8 aE8 bE8", { buses = true })
  for _, frame in ipairs(frames) do
    words.look(known, { can_id = frame.can_id, data = frame.data, number = frame.number,
      knows_bus = false })
  end
  for _, number in ipairs { 9, 4, 10 } do
    local text, record = words.look(known, frames[number], true)
    lu.assertEquals({ text, (known:outcome(record)) },
      number == 4 and { "part", 10 } or { "good", number })
    -- what nobody knew is not told as history
    lu.assertTrue(text == "part" or record.entry.is_unsure)
  end
  lu.assertNil(known.passes.second)
end

-- Numbers and packets -----------------------------------------------------------------------------

local WHOLE = words.frames("S32 M8 M8 M8 E8", { ids = MOTOR })

-- The frames of WHOLE, or a Command ("C"), with numbers and places: { number, which, place }.
local function looks(known, rows, is_again)
  local list = {}
  for i, row in ipairs(rows) do
    local frame = row[2] == "C" and { can_id = 0, data = "1234567" } or WHOLE[row[2]]
    local text, record = words.look(known, { can_id = frame.can_id, data = frame.data,
      number = row[1], place = row[3] }, is_again)
    local leads_to = record.entry and text == "part" and known:outcome(record)
    list[i] = leads_to and text .. ">" .. leads_to or
      text == "good" and text .. ":" .. table.concat(record.pass:numbers(record.entry), ",") or text
  end
  return table.concat(list, " ")
end

-- A packet of IEEE 1722 has several CAN frames.
function T.test_several_frames_in_a_packet()
  local known = words.new()
  local rows = { { 1, 1, 30 }, { 1, 2, 60 }, { 1, 3, 90 }, { 2, 4, 30 }, { 2, 5, 60 },
    { 2, "C", 90 } }
  lu.assertEquals(looks(known, rows), "part part part part good:1,1,1,2,2 single")
  lu.assertEquals(looks(known, rows, true), "part>2 part>2 part>2 part>2 good:1,1,1,2,2 single")
  lu.assertEquals(looks(known, { rows[6], rows[2], { 2, "C", 60 }, { 1, 1, 200 } }, true),
    "single part>2 - -")
end

-- With -2 -R a frame that is rejected has the number of the next one: frame 3 of the first pass is
-- frame 2 of the second.
function T.test_a_read_filter()
  local known = words.new()
  lu.assertEquals(looks(known, { { 1, 1 }, { 2, 2 }, { 2, 3 }, { 2, 4 }, { 2, 5 }, { 3, "C" },
    { 3, 1 } }),
    "part part part part good:1,2 single part") -- the Middles' number is another's
  lu.assertEquals(looks(known, { { 1, 1 }, { 2, 5 } }, true), "part>2 good:1,2")
  lu.assertEquals(looks(known, { { 2, "C" }, { 3, "C" } }, true), "- -")
  known = words.new() -- the last frame was rejected
  looks(known, { { 1, 1 }, { 2, 2 }, { 3, 3 }, { 4, 4 }, { 5, 5 }, { 5, "C" } })
  lu.assertEquals(looks(known, { { 1, 1 }, { 4, 4 }, { 5, "C" } }, true), "part part single")
end

function T.test_a_frame_that_never_came()
  local known = words.new()
  looks(known, { { 1, 1 }, { 2, 2 }, { 3, 3 }, { 4, 4 }, { 5, 5 } })
  lu.assertEquals(looks(known, { { 6, 2 }, { 3, "C" }, { 5, 5, 60 } }, true), "- - -")
end

-- The first time the table of ids asks, the second time Decode As: it is one look.
function T.test_asked_twice()
  local known, frame = words.new(), { can_id = words.can_id(0x123, 2), data = "12345678",
    number = 1 }
  lu.assertEquals(words.look(known, frame), "-")
  frame.is_wide = true
  lu.assertEquals(words.look(known, frame), "orphan+fragment.orphan")
  lu.assertEquals(words.look(known, { can_id = 0, data = "1234567", number = 2 }), "single")
  lu.assertFalse(known.passes.first.is_filtered)
end

-- What is kept ------------------------------------------------------------------------------------

-- All that was known of a good message is known at a later look, also where it is kept small.
function T.test_a_message_that_is_recalled()
  for text, id in pairs { ["S32 M8 M8 M8 E8"] = 0x210, ["S9 M8 E1"] = 0x7FF,
    ["S73 M64 E9p12"] = 0x210,
    ["S1000 " .. ("M8 "):rep(124) .. "E8"] = 5, ["S9 M8 L7? E1"] = 0x210, ["S9r M8 E1"] = 0x210 } do
    -- The second of two: it has a fault.
    local known, all, frames = words.new(), words.frames(text .. " " .. text,
      { ids = { [""] = { id, 0, 9 } }, is_wide = true }), {}
    words.looks(known, all)
    for i = #all / 2 + 1, #all do frames[#frames + 1] = all[i] end
    local _, record = words.look(known, frames[#frames], true)
    local message, fragments = record.entry, {}
    for i, number in ipairs(record.pass:numbers(record.entry)) do fragments[i] = all[number].data end
    lu.assertEquals(table.concat(fragments, "", 2):sub(1, message.size), message.payload)
    lu.assertEquals({ message.address.id, message.address.seq, #message.payload, message.status },
      { id, 9, message.size, "good" })
    local header = can_id.header(message.address, message.size, message.reserved)
    lu.assertEquals(message.crc, crc.of(header .. message.payload))
    lu.assertEquals(message.payload:byte() % 2, 1)
    for _, frame in ipairs { frames[1], frames[2], frames[#frames] } do
      local _, part = words.look(known, frame, true)
      lu.assertTrue(part.entry.has_fault)
      _, part = words.look(known, all[frame.number - #frames], true)
      lu.assertFalse(part.entry.has_fault or false)
    end
  end
end

function T.test_unfinished()
  local function unfinished(text, options)
    local known, frames, list = words.new(), words.frames(text, options or {}), {}
    words.looks(known, frames)
    for _, frame in ipairs(frames) do
      local _, record = words.look(known, frame, true)
      if record.entry and record.entry.size and select(2, known:outcome(record)) then
        list[#list + 1] = frame.number
      end
    end
    lu.assertEquals(#known:unfinished(), #list)
    return table.concat(list, " ")
  end
  lu.assertEquals(unfinished("S32 M8 L7"), "2")
  lu.assertEquals(unfinished("S32 M8 S32 M8 M8 M8 E8"), "")
  lu.assertEquals(unfinished("aS32 bS32 aM8 bM8", { buses = true }), "3 4")
  -- a Start cut the first off: that is said there
  lu.assertEquals(unfinished("S32 M8 S32 M8", { buses = true }), "4")
  lu.assertEquals(unfinished("S32 M8 S32 M8"), "4")
  lu.assertEquals(unfinished("S32 M8 M8 M8 M8 M8"), "") -- it has too many bytes: that is said too
end

local function kilobytes()
  collectgarbage()
  collectgarbage()
  return collectgarbage("count")
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
      words.look(known, frame)
    end
    if round == rounds / 2 then before = kilobytes() end
  end
  return (kilobytes() - before) * 1024 / (number / 2)
end

function T.test_good_messages_cost_little()
  local bytes = kept_bytes(words.new(), levels.size(6000, 20000),
    words.frames("S32 M8 M8 M8 E8", { ids = MOTOR }))
  lu.assertTrue(bytes < 100, ("%.0f bytes a frame"):format(bytes))
end

-- Where no frame is looked at again nothing is kept; what is open is put together as ever, and of
-- what is not good is said what is wrong.
function T.test_the_only_pass_keeps_nothing()
  local function frames(text)
    local list = words.frames(text, { ids = MOTOR })
    for _, frame in ipairs(list) do frame.is_only_pass = true end
    return list
  end
  local bytes = kept_bytes(words.new(), levels.size(6000, 20000), frames("S32 M8 M8 M8 E8"))
  lu.assertTrue(bytes < 40, ("%.0f bytes a frame"):format(bytes))
  local known, some = words.new(), frames("S32 M8 M8 M8 E8 S32 M8 M8 E8 S32 M8 M8 M8 E8")
  local said = words.looks(known, some)
  lu.assertEquals(said, words.looks(words.new(), words.frames(
    "S32 M8 M8 M8 E8 S32 M8 M8 E8 S32 M8 M8 M8 E8", { ids = MOTOR })))
  for at = 1, #some do lu.assertEquals(words.look(known, some[at], true), "-") end
end

-- A later look at another frame of the message that was looked at last; one of another key at its
-- number, as a read filter shifts them, is none; and one whose bus is known by then has that source.
function T.test_later_looks_in_a_row()
  local known, frames = words.new(), words.frames("S32 M8 M8 M8 E8", { ids = MOTOR })
  words.looks(known, frames)
  local _, last = words.look(known, frames[5], true)
  for at = 1, 5 do
    local _, record = words.look(known, frames[at], true)
    lu.assertEquals({ record.entry.payload, known:outcome(record) }, { last.entry.payload, 5 })
  end
  local other = { can_id = frames[5].can_id + 1, data = frames[5].data, number = 5 } -- its Seq
  lu.assertEquals(words.look(known, other, true), "-")
  for bus = 1, 2 do
    frames[4].bus = bus
    local _, record = words.look(known, frames[4], true)
    lu.assertEquals(record.entry.source.bus, bus)
  end
end

-- Nor are two frames of a packet taken for one, though nobody tells their places in it apart.
function T.test_the_only_pass_tells_frames_of_a_packet_apart()
  for _, is_only_pass in ipairs { true, false } do
    local known = words.new()
    for _ = 1, 2 do
      local text = words.look(known, { can_id = words.can_id(0x210, 2), data = "12345678", number = 1,
        is_only_pass = is_only_pass })
      lu.assertEquals(text, "orphan+fragment.orphan")
    end
  end
end

function T.test_a_message_that_never_ends()
  for bus = 0, 1 do
    local known = words.new()
    local start = words.start(0x123, "", { size = 65535 })
    for number = 1, 3 do
      words.look(known, { can_id = words.can_id(0x123, 1), data = start, number = number,
        bus = bus > 0 and bus or nil })
    end
    local middle = { can_id = words.can_id(0x123, 2), data = "12345678",
      bus = bus > 0 and bus or nil }
    local bytes = kept_bytes(known, levels.size(30000, 120000), { middle }, 3)
    -- each frame says that it is one too many
    lu.assertTrue(bytes < 600, ("%.0f bytes a frame"):format(bytes))
  end
end

function T.test_a_flood_of_starts_leaves_few_open_and_the_newest()
  local known, data, payload = words.new(), words.start(0x123, ("x"):rep(2000)), ("y"):rep(16)
  local function send(id, ctrl, bytes, number)
    return (words.look(known, { can_id = words.can_id(id, ctrl), data = bytes, number = number,
      bus = 1, is_wide = true }))
  end
  local said = {}
  for bus = 1, levels.size(5, 25) do
    for id = 0, 2046 do
      local _, record = words.look(known, { can_id = words.can_id(id, 1), data = data,
        number = bus * 2047 + id, bus = bus, is_wide = true })
      for _, fault in ipairs(record.faults or {}) do said[fault.text] = fault.expert end
    end
    lu.assertTrue(#known:unfinished() <= 1024)
  end
  local given_up = "1024 messages are open: the oldest 512 are given up"
  lu.assertEquals(said[given_up], "fragment.incomplete")
  send(0x7FF, 1, words.start(0x7FF, payload), 1e6)
  for id = 1, 400 do send(id, 1, data, 1e6 + id) end
  send(0x7FF, 2, payload:sub(1, 8), 1e6 + 401)
  lu.assertEquals(send(0x7FF, 3, payload:sub(9), 1e6 + 402), "good")
end

return T
