-- SPDX-License-Identifier: GPL-2.0-or-later
-- What is known of a file's CAN frames over its passes, as tables: which frames come, and what each look at them says.
--
-- A look is { number, what, more }: what is "S", "M1" .. "M3", "E" (the parts of a message of 32 bytes), "C" (a
-- Command), or "?" (a Middle of an ID that nobody knows); more = { place =, bus =, together = whether all buses have
-- this number, again =, uninformed =, id =, seq =, wide =, doubtful = }. What it says is written "part>5" (leads to
-- frame 5), "good:1,2,3,4,5" (with its frames), "single", "orphan", "-".
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local can_id = require("yapp.wire.can_id")
local crc = require("yapp.wire.crc")
local history = require("yapp.message.history")
local memory = require("yapp.can.memory")
local little_endian = require("stream_generator").little_endian

local T = {}

local parts = { can_id = can_id, crc = crc, can_frames = require "yapp.can.frames",
  can_interleave = require "yapp.can.interleave", can_repeated = require "yapp.can.repeated" }

local SIZES = { [0] = 7, [0x210] = 32, [0x211] = 32 }
local PAYLOADS = { [1] = ("a"):rep(8) .. ("b"):rep(8) .. ("c"):rep(8) .. ("d"):rep(8),
  [2] = ("e"):rep(8) .. ("f"):rep(8) .. ("g"):rep(8) .. ("h"):rep(8) }

local function new(options)
  options = options or {}
  return memory.new(parts, { size_of = function(id) return SIZES[id] end, has_buses = options.has_buses,
    new_history = function() return history.new() end })
end

local function id_of(id, ctrl, seq) return id * 0x40000 + ctrl * 0x4000 + (seq or 0) end

-- The CAN id and data of a frame in words.
local function frame_of(what, more)
  local id, payload = more.id or 0x210, PAYLOADS[more.payload or more.bus or 1]
  if what == "C" then return id_of(0, 0), "1234567" end
  if what == "?" then return id_of(0x123, 2), "12345678" end
  if what == "S" then
    local header = can_id.header({ id = id, seq = more.seq or 0, ctl = 0 }, 32, more.reserved)
    return id_of(id, 1, more.seq),
      little_endian(crc.of(header .. payload), 4) .. little_endian(32, 2) .. little_endian(more.reserved or 0, 2)
  end
  if what == "E" then return id_of(id, 3, more.seq), payload:sub(25) end
  local index = tonumber(what:sub(2))
  return id_of(id, 2, more.seq), payload:sub(8 * index - 7, 8 * index)
end

local function said(known, record)
  if not record then return "-" end
  local text
  if record.alone then
    text = can_id.address(record.alone).ctrl == 0 and "single" or record.is_late and "late" or "orphan"
  elseif record.is_last then
    text = record.message.status .. ":" .. table.concat(known:frames_of(record), ",")
  else
    text = "part" .. (record.leads_to and (">%d"):format(record.leads_to) or "")
  end
  return text .. (record.is_unfinished and " unfinished" or "") .. (record.has_fault and " fault" or "")
end

local function look(known, row)
  local more = row[3] or {}
  local id, data = frame_of(row[2], more)
  local number = row[1]
  return known:look(can_id.address(id), { number = number, place = more.place or 8, is_again = more.again or false,
    data = data, reported = #data, bus = not more.uninformed and more.bus or nil,
    is_apart = more.bus ~= nil and not more.together, informed = not more.uninformed,
    doubtful = more.doubtful or false, wide = more.wide or false }, {})
end

-- Makes looks; returns what each said, in one text.
local function looks(known, rows, common)
  local texts = {}
  for i, row in ipairs(rows) do
    local more = {}
    for key, value in pairs(row[3] or {}) do more[key] = value end
    for key, value in pairs(common or {}) do more[key] = value end
    texts[i] = said(known, look(known, { row[1], row[2], more }))
  end
  return table.concat(texts, " ")
end

local AGAIN = { again = true }
local WHOLE = { { 1, "S" }, { 2, "M1" }, { 3, "M2" }, { 4, "M3" }, { 5, "E" } }
local WHOLE_AGAIN = "part>5 part>5 part>5 part>5 good:1,2,3,4,5"

function T.test_one_pass_and_later_looks()
  local known = new()
  lu.assertEquals(looks(known, WHOLE), "part part part part good:1,2,3,4,5")
  lu.assertEquals(looks(known, WHOLE, AGAIN), WHOLE_AGAIN)
  lu.assertEquals(looks(known, { WHOLE[5], WHOLE[2], WHOLE[2], WHOLE[1] }, AGAIN),
    "good:1,2,3,4,5 part>5 part>5 part>5")
end

-- 300 frames of which some get lost, come twice, are cut short or all zeros, interleave, share a packet, or lie in
-- another place of it than those before; where the user says that all are YAPP's, some have reserved bytes.
local function odd_frames(random)
  local frames, number, place, buses, more, bus = {}, 0, 8, random(0, 2), nil, nil
  local is_wide = random(2) == 1
  for i = 1, 300 do
    local what = ({ "S", "M1", "M2", "M3", "E" })[random(24) > 1 and (i - 1) % 5 + 1 or random(5)]
    if i % 5 == 1 or random(24) == 1 then
      more = { id = 0x210 + random(0, 1) * random(0, 1), payload = random(2),
        reserved = is_wide and random(5) == 1 and 5 or nil }
      bus = buses > 0 and random(buses) or nil
    end
    local id, data = frame_of(what, more)
    local reported, is_second = #data, random(20) == 1 and i > 1
    if random(30) == 1 then data = ("\0"):rep(8) elseif random(40) == 1 then data = data:sub(1, 5) end
    local is_zeros = not data:find("%Z")
    if random(30) == 1 then place = 24 - place end
    for _ = 1, random(25) == 1 and 2 or 1 do
      if not is_second then number = number + random(2) end
      frames[#frames + 1] = { address = can_id.address(id), data = data, reported = reported, number = number,
        place = is_second and 40 or place, bus = bus, wide = is_wide, informed = true,
        is_plain = #data == reported and not is_zeros, doubtful = is_zeros and buses == 0 and random(2) == 1 }
      is_second = false
    end
  end
  return frames
end

-- What is said of a frame, and how long after the message before it a good one came.
local function told(known, record, frame)
  local message = record and record.is_last and record.message
  if not (message and message.status == "good") then return said(known, record) end
  local id = frame.address.id
  local change = known:change({ source = (frame.bus or -1) * 0x800 + id, blind_source = id - 0x800, id = id,
    seq = frame.address.seq, good = true, time = frame.number, payload = message.payload }, record)
  return ("%s %s"):format(said(known, record), change and change.delta)
end

-- What is said of a frame on the short way, where that takes it; and whether it does.
local function see_short(known, frame)
  local taker, message, is_last = known.short[frame.address.ctrl], nil, nil
  if taker and frame.is_plain and frame.number > known.highest and frame.place == known.usual then
    message, is_last = known:plain(taker, frame.address, frame.number, frame.data, frame.bus)
  end
  local record = message and known:plain_record(frame.number, message, is_last) or known:look(frame.address, frame, {})
  return told(known, record, frame), message ~= nil
end

-- Frames on the short way, where that takes them, are what they are on the long way, and messages have the same
-- history: at their own looks and at all later ones.  And at their own looks where there are no later ones.
function T.test_the_short_way_says_the_same()
  math.randomseed(23)
  local taken = { 0, 0, 0 } -- by CAN CTRL
  for _ = 1, 60 do
    local long, short, only, frames = new(), new(), new(), odd_frames(math.random)
    only:only_pass()
    for pass = 1, 3 do
      for i, frame in ipairs(frames) do
        frame.is_again, frame.is_apart = pass > 1, frame.bus ~= nil
        local expected, text, is_short = told(long, long:look(frame.address, frame, {}), frame), see_short(short, frame)
        lu.assertEquals(text, expected, i)
        if is_short then taken[frame.address.ctrl] = taken[frame.address.ctrl] + 1 end
        if pass == 1 then lu.assertEquals(see_short(only, frame), expected, i) end
      end
    end
  end
  for ctrl = 1, 3 do lu.assertTrue(taken[ctrl] > 500, taken[ctrl]) end
end

-- The frames of so many messages one behind the other, each with a fault, on the short way.
local function see_messages(known, count)
  for i = 1, count do
    for part, what in ipairs { "S", "M1", "M2", "M3", "E" } do
      local id, data = frame_of(what, {})
      local text = see_short(known, { address = can_id.address(id), data = data, reported = 8, place = 8,
        number = 5 * (i - 1) + part, informed = true, is_plain = true })
      if part == 5 then lu.assertStrContains(text, "good:") end
      if part == 5 and i > 1 then known:note_fault(known.of_plain) end
    end
  end
end

local function size_of(...)
  local count = 0
  for _, one in ipairs { ... } do
    for _ in pairs(one) do count = count + 1 end
  end
  return count
end

function T.test_the_only_pass_keeps_nothing()
  for _, is_only in ipairs { true, false } do
    local known = new()
    if is_only then known:only_pass() end
    see_messages(known, 1000)
    local kept = known.first.kept
    local archive = kept.archive
    lu.assertEquals(size_of(kept.entries, archive.extras, archive.deltas, archive.faulty, archive.blocks) < 10, is_only)
  end
end

-- It cannot be, but if it were, nothing would be lost that can be told.
function T.test_a_pass_behind_the_only_one()
  local known = new()
  known:only_pass()
  see_messages(known, 3)
  lu.assertEquals(looks(known, WHOLE, AGAIN), "part part part part good:1,2,3,4,5")
end

-- A tap that sees a packet ahead of which nothing was looked at is one of the only pass.
function T.test_what_a_tap_tells()
  local known, again = new(), new()
  looks(known, { WHOLE[1] })
  known:tapped(1)
  lu.assertTrue(known.first.kept.is_only_pass)
  looks(again, WHOLE)
  again:tapped(1)
  lu.assertNil(again.first.kept.is_only_pass)
end

-- More than an archive's text has room for; and frames behind it, so that it would be packed.
function T.test_a_message_of_65530_bytes()
  local known, record, payload = new(), {}, ("x"):rep(65530)
  local function see(number, ctrl, data, again)
    record = known:look(can_id.address(id_of(0x123, ctrl)), { number = number, place = 8, is_again = again or false,
      data = data, reported = #data, informed = true, wide = true, bus = 0 }, record)
    return record
  end
  local header = can_id.header({ id = 0x123, seq = 0, ctl = 0 }, #payload)
  see(1, 1, little_endian(crc.of(header .. payload), 4) .. little_endian(#payload, 2) .. "\0\0")
  for number = 2, 33 do see(number, 2, payload:sub(1, 2000)) end
  lu.assertEquals(see(34, 3, payload:sub(1, 1530)).message.status, "good")
  for number = 35, 1000 do see(number, 0, "1234567") end
  lu.assertEquals(see(1, 1, "", true).leads_to, 34)
  lu.assertTrue(see(34, 3, "", true).is_last)
  lu.assertEquals(record.message.payload, payload)
end

function T.test_a_frame_that_never_came()
  local known = new()
  looks(known, WHOLE)
  lu.assertEquals(looks(known, { { 6, "M1" }, { 3, "?" }, { 3, "C" }, { 5, "E", { place = 60 } } }, AGAIN), "- - - -")
  lu.assertEquals(looks(known, { { 6, "M1", { wide = true } } }, AGAIN), "late")
end

-- A packet of IEEE 1722 has several CAN frames.
-- It may be a whole message of a source that has a history: it changes nothing there.
function T.test_a_message_that_no_pass_had()
  local known, record = new(), {}
  local function change(number, seq, again)
    local id, data = frame_of("C", {})
    record = known:look(can_id.address(id), { number = number, place = 8, is_again = again, data = data,
      reported = #data, informed = true, wide = true }, record)
    return known:change({ source = 1, id = 0, seq = seq, good = true, time = number, payload = data }, record)
  end
  change(2, 1, false)
  lu.assertEquals(change(3, 5, false), { delta = 1, missing = 3 })
  lu.assertNil(change(1, 0, true))
  lu.assertTrue(record.is_late)
  known:note_fault(record)
  lu.assertEquals(change(3, 5, true), { delta = 1, missing = 3 })
end

function T.test_several_frames_in_a_packet()
  local rows = {}
  for i, row in ipairs(WHOLE) do rows[i] = { i < 4 and 1 or 2, row[2], { place = 30 * i } } end
  rows[6] = { 2, "C", { place = 200 } }
  local known = new()
  lu.assertEquals(looks(known, rows), "part part part part good:1,1,1,2,2 single")
  lu.assertEquals(looks(known, rows, AGAIN), "part>2 part>2 part>2 part>2 good:1,1,1,2,2 single")
  lu.assertEquals(looks(known, { { 2, "C", { place = 30 } }, { 1, "S", { place = 60 } } }, AGAIN), "- part>2")
end

-- With -2 -R a frame that is rejected has the number of the next one: frame 3 of the first pass is frame 2 of the
-- second.
function T.test_a_read_filter()
  local known = new()
  local rows = { { 1, "S" }, { 2, "M1" }, { 2, "M2" }, { 2, "M3" }, { 2, "E" }, { 3, "C" }, { 3, "S" } }
  lu.assertEquals(looks(known, rows), "part part part part good:1,2 single part") -- the Middles' number is another's
  lu.assertEquals(looks(known, { { 1, "S" }, { 2, "E" } }, AGAIN), "part>2 good:1,2")
  lu.assertEquals(looks(known, { { 2, "C" }, { 3, "C" } }, AGAIN), "- -")
end

function T.test_the_last_frame_was_rejected()
  local known = new()
  looks(known, { { 1, "S" }, { 2, "M1" }, { 3, "M2" }, { 4, "M3" }, { 5, "E" }, { 5, "C" } })
  lu.assertEquals(looks(known, { { 1, "S" }, { 4, "M3" }, { 5, "C" } }, AGAIN), "part part single")
end

-- The first time the table of ids asks, the second time Decode As: it is one look.
function T.test_asked_twice()
  local known = new()
  lu.assertEquals(looks(known, { { 1, "?" }, { 1, "?", { wide = true } }, { 2, "C" } }), "- orphan single")
  lu.assertEquals(known.first.is_filtered, nil)
end

-- Two buses send in turns; a first pass without fields (tshark -2) cannot tell them apart.
local function two_buses()
  local rows = {}
  for _, what in ipairs { "S", "M1", "M2", "M3", "E" } do
    for bus = 1, 2 do rows[#rows + 1] = { #rows + 1, what, { bus = bus } } end
  end
  return rows
end

local APART = "part>9 part>10 part>9 part>10 part>9 part>10 part>9 part>10 good:1,3,5,7,9 good:2,4,6,8,10"

function T.test_a_second_pass_refines_the_first()
  local known = new { has_buses = true }
  lu.assertEquals(looks(known, two_buses(), { uninformed = true }),
    "part part part part part part part part good:1,3,5,7,9 good:2,4,6,8,10")
  lu.assertEquals(looks(known, two_buses(), AGAIN), APART)
  lu.assertEquals(looks(known, two_buses(), AGAIN), APART) -- a third look
end

function T.test_at_random_the_first_pass_is_asked()
  local known, rows = new { has_buses = true }, two_buses()
  looks(known, rows, { uninformed = true })
  lu.assertEquals(looks(known, { rows[9], rows[1], rows[2], rows[10] }, AGAIN),
    "good:1,3,5,7,9 part>9 part>10 good:2,4,6,8,10")
  lu.assertEquals(known.second and known.reached or 0, 2) -- rows 1 and 2 came in order
end

-- An ID may be known by the name of its bus only, which a first pass without fields did not have.
function T.test_what_only_the_second_pass_took()
  local known = memory.new(parts, { size_of = function(_, bus) return bus and 32 end,
    new_history = function() return history.new() end })
  local rows = {}
  for i, what in ipairs { "S", "M1", "M2", "M3", "E" } do rows[i] = { i, what, { id = 0x321, seq = 9, bus = 1 } } end
  lu.assertEquals(looks(known, rows, { uninformed = true }), "- - - - -")
  lu.assertEquals(looks(known, rows, { again = true, together = true }), "part part part part good:1,2,3,4,5")
end

-- The second pass knows better where the first had frames of two buses for one message.
function T.test_what_the_first_pass_mixed()
  local rows = { { 1, "S", { bus = 1 } }, { 2, "M1", { bus = 1 } }, { 3, "M2", { bus = 1 } }, { 4, "M3", { bus = 1 } },
    { 5, "E", { bus = 2, payload = 1 } } }
  local known = new { has_buses = true }
  lu.assertEquals(looks(known, rows, { uninformed = true }), "part part part part good:1,2,3,4,5")
  lu.assertEquals(looks(known, rows, AGAIN), "part>5 part>5 part>5 part>5 orphan") -- the links are by CRC
end

function T.test_an_uninformed_look_between()
  local known, rows = new { has_buses = true }, two_buses()
  looks(known, rows, { uninformed = true })
  looks(known, { rows[1], rows[2] }, AGAIN)
  lu.assertEquals(looks(known, { rows[3] }, { again = true, uninformed = true }), "part>9")
  lu.assertEquals(looks(known, { rows[3], rows[4] }, AGAIN), "part>9 part>10")
end

-- What a first pass took for a Middle is a remote frame: the second is told, and goes on.
function T.test_a_remote_frame_that_the_first_pass_took()
  local known = new()
  local rows = { { 1, "S" }, { 2, "M1" }, { 3, "?", { wide = true, doubtful = true } }, { 4, "M2" }, { 5, "M3" },
    { 6, "E" } }
  looks(known, rows)
  lu.assertEquals(looks(known, { rows[1], rows[2] }, AGAIN), "part>6 part>6")
  known:pass_over { number = 3, place = 8, is_again = true, informed = true }
  lu.assertEquals(looks(known, { rows[4], rows[5], rows[6] }, AGAIN), "part>6 part>6 good:1,2,4,5,6")
  lu.assertEquals(known.reached, 6)
end

function T.test_unfinished()
  local known = new()
  local rows = { { 1, "S" }, { 2, "M1" }, { 4, "C" } }
  lu.assertEquals(looks(known, rows), "part part single")
  lu.assertEquals(looks(known, rows, AGAIN), "part part unfinished single")
  lu.assertEquals(#known:unfinished(), 1)
  known = new { has_buses = true } -- nothing that may belong to it comes behind it on any bus
  looks(known, rows, { uninformed = true })
  lu.assertEquals(looks(known, rows, { again = true, bus = 1 }), "part part unfinished single")
  known = new { has_buses = true } -- what the first pass mixed says nothing: the second has to end first
  rows = { { 1, "S", { bus = 1 } }, { 2, "M1", { bus = 1 } }, { 3, "S", { bus = 2 } }, { 4, "M1", { bus = 2 } },
    { 5, "C", { bus = 1 } } }
  looks(known, rows, { uninformed = true })
  lu.assertEquals(looks(known, rows, AGAIN), "part part part part single")
  lu.assertEquals(looks(known, rows, AGAIN), "part part unfinished part part unfinished single")
  known = new() -- a Start cut it off: that is said there, and the capture ends behind it
  rows = { { 1, "S" }, { 2, "M1" }, { 3, "S" }, { 4, "M1" }, { 5, "M2" }, { 6, "M3" }, { 7, "E" } }
  looks(known, rows)
  lu.assertEquals(looks(known, rows, AGAIN), "part part part>7 part>7 part>7 part>7 good:3,4,5,6,7")
  lu.assertEquals(#known:unfinished(), 0)
end

function T.test_a_fault_is_known_in_every_frame()
  local known = new()
  local record
  for _, row in ipairs(WHOLE) do record = look(known, row) end
  known:note_fault(record)
  lu.assertEquals(looks(known, { WHOLE[1], WHOLE[3] }, AGAIN), "part>5 fault part>5 fault")
end

-- A bad CRC proves nothing about the rest of a message, but its frames are kept with the fault rather than lost.
function T.test_a_fault_in_a_bad_message_where_buses_mix()
  local function spoiled(rows)
    for i, row in ipairs(rows) do
      if row[2] == "M3" and row[3].bus == 2 then rows[i] = { row[1], "M3", { bus = 2, payload = 1 } } end
    end
    return rows
  end
  for _, apart in ipairs { false, true } do
    local rows = spoiled(two_buses())
    if apart then table.sort(rows, function(a, b) return a[3].bus * 99 + a[1] < b[3].bus * 99 + b[1] end) end
    for i, row in ipairs(rows) do row[1] = i end
    local known = new { has_buses = true }
    for _, row in ipairs(rows) do
      local record = look(known, { row[1], row[2], { bus = row[3].bus, payload = row[3].payload, uninformed = true } })
      if record.is_last and record.message.status == "bad" then known:note_fault(record) end
    end
    local second = looks(known, rows, AGAIN)
    lu.assertEquals(select(2, second:gsub("part fault", "")), 4, second)
    lu.assertEquals(select(2, second:gsub("fault", "")), 4, second)
  end
end

function T.test_the_time_since_the_previous_message_is_kept()
  local known = new()
  for round = 0, 1 do
    for i, row in ipairs(WHOLE) do
      local record = look(known, { 5 * round + i, row[2] })
      if i == 5 then
        local change = known:change({ source = 1, id = 0x210, seq = 0, time = round * 0.25, good = true }, record)
        lu.assertEquals(change and change.delta, round == 1 and 0.25 or nil)
      end
    end
  end
  local record = look(known, { 10, "E", { again = true } })
  lu.assertEquals(known:change({ source = 1, id = 0x210, seq = 0, time = 0.25, good = true }, record).delta, 0.25)
end

return T
