-- SPDX-License-Identifier: GPL-2.0-or-later
-- Messages of one key that interleave where the capture does not tell its buses, in the words of test_can_reassembly.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local bus = require("test_can_reassembly").bus

local T = {}

local function check(rows, options)
  for _, row in ipairs(rows) do
    lu.assertEquals((bus.send(row[1], row[3] or options)), row[2], row[1])
  end
end

function T.test_two_buses_in_every_order()
  check {
    { "aS32 bS32 aM8 bM8 aM8 bM8 aM8 bM8 aE8 bE8", "part part part part part part part part good good" },
    { "aS32 aM8 bS32 bM8 bM8 bM8 bE8 aM8 aM8 aE8",
      "part part part part part part good orphan orphan good" },
    { "aS32 aM8 bS32 bM8 aM8 aM8 aE8 bM8 bM8 bE8", "part part part part part part good part part good" },
    { "aS17 bS32 bM8 aM8 aM8 bM8 bM8 aE1 bE8", "part part part part part part part good good" },
    { "aS9 bS9 cS9 dS9 aM8 bM8 cM8 dM8 dE1 cE1 bE1 aE1",
      "part part part part part part part part good good good good" },
    { "aS41 bS41 aM16 bM16 aM16 bM16 aE9p12 bE9p12", "part part part part part part good good" },
  }
end

-- As on one bus: what a new Start cut off stays cut off.
function T.test_one_bus_that_loses_frames()
  check {
    { "S32 M8 S32 M8 M8 M8 E8", "part part part+fragment.incomplete part part part good" },
    { "S32 M8 S32 M8 M8 M8 E8 E8", "part part part+fragment.incomplete part part part good orphan+fragment.orphan" },
    { "S32 S32! M8 M8 M8 E8", "part part+fragment.incomplete part part part bad" },
    { "S32 S32 M8 M8 E8", "part part+fragment.incomplete part part short+fragment.incomplete" },
    { "S32 M8 S32 M8 M8 M8 M8 E8",
      "part part part+fragment.incomplete part part part part overrun+fragment.overrun" },
  }
end

function T.test_what_was_said_is_taken_back()
  local shown, state = bus.send("aS32 aM8 bS32 aM8 aM8 aE8 bM8 bM8 bM8 bE8")
  lu.assertEquals(shown, "part part part part part good part part part good")
  for _, faults in pairs(state.kept.faults) do lu.assertEquals(faults, {}) end
  for _, number in ipairs { 1, 2, 4, 5, 6 } do lu.assertEquals(state.kept:entry(number).last, 6) end
  for _, number in ipairs { 3, 7, 8, 9, 10 } do lu.assertEquals(state.kept:entry(number).last, 10) end
end

function T.test_both_are_kept_for_a_later_look()
  local _, state = bus.send("aS32 bS32 aM8 bM8 aM8 bM8 aM8 bM8 aE8 bE8")
  lu.assertEquals({ state.kept:entry(1)[1], state.kept:entry(9)[5], state.kept:entry(9).count }, { 1, 9, 5 })
  lu.assertEquals({ state.kept:entry(2)[1], state.kept:entry(10)[5], state.kept:entry(10).count }, { 2, 10, 5 })
  lu.assertNotEquals(state.kept:entry(9).payload, state.kept:entry(10).payload)
end

-- The table of a message that came out good serves the next one: of a longer message before nothing is left in it.
function T.test_frames_change_hands_behind_a_longer_message()
  local state, look = bus.reassembler(), 0
  local function send(ctrl, data)
    look = look + 1
    bus.frame(state, { bus.can_id(0x123, ctrl, 0, 0), look = look, data = data })
  end
  local function start(payload) send(1, bus.start(0x123, 0, 0, payload)) end
  local function frames_of(number)
    local message, looks = state.kept:entry(number), {}
    for i = 1, message.count do looks[i] = message[i] end
    return looks
  end
  local long, same = ("longlong"):rep(8), "theirsss"
  start(long)
  for _ = 1, 7 do send(2, "longlong") end
  send(3, "longlong") -- 9
  start(same .. "of one  " .. "its end ")
  start(same .. "of two  " .. "the end ")
  for _, data in ipairs { same, "of two  ", same, "of one  " } do send(2, data) end
  send(3, "its end ") -- with the first of the same frames, which only the other can have
  send(3, "the end ")
  lu.assertEquals({ frames_of(10), frames_of(11) }, { { 10, 14, 15, 16 }, { 11, 12, 13, 17 } })
end

function T.test_the_capture_says_the_bus()
  check({
    { "aS32 aM8 aS32 aM8 aM8 aE8 aM8 aM8 aM8 aE8",
      "part part part+fragment.incomplete part part short+fragment.incomplete - - - -" },
  }, { buses = true })
end

-- One interface may stand for several buses.
function T.test_all_on_one_interface()
  check({
    { "aS32 bS32 aM8 bM8 aM8 bM8 aM8 bM8 aE8 bE8", "part part part part part part part part good good" },
  }, { interface = true })
end

-- A message that is overtaken more than three times is given up.
function T.test_four_open_messages()
  check {
    { "aS9 bS9 bM8 bE1 cS9 cM8 cE1 dS9 dM8 dE1 aM8 aE1",
      "part part part good part part good part part good orphan good" },
    { "aS9 bS9 bM8 bE1 cS9 cM8 cE1 dS9 dM8 dE1 eS9 eM8 eE1 aM8 aE1",
      "part part+fragment.incomplete part good part part good part part good part part good - -" },
  }
end

-- After that every frame counts again.
function T.test_strict_again_when_the_last_is_given_up()
  local before = "aS9 bS9 bM8 bE1 cS9 cM8 cE1 dS9 dM8 dE1 "
  local shown = "part part+fragment.incomplete part good part part good part part good "
  check {
    { before .. "eS32 eM8 eM8? eM8 eM8 eE8", shown .. "part part part part part overrun+fragment.overrun" },
    { before .. "eS32 eM8 eM8 eE8? eM8 eE8", shown .. "part part part short+fragment.incomplete - -" },
  }
end

-- Two senders whose messages have the same zeros, at the same place or not.  { frame, CAN CTRL, bytes }
local ZEROS = "0000000000000000"
local SAME_BYTES = {
  { -- the older message takes the other's first zeros, which then needs what comes before its third frame
    { 1, 1, "5d71ada220000000" }, { 2, 2, ZEROS }, { 3, 1, "ea34792220000000" }, { 4, 2, ZEROS }, { 5, 2, ZEROS },
    { 6, 2, "0140000000005ccd" }, { 7, 2, ZEROS }, { 8, 2, "8e7700000000c0cc" }, { 9, 3, "34704c0000002abe" },
    { 10, 3, "1b8d490000000c78" }, id = 0x309, good = { [9] = { 1, 2, 7, 8, 9 }, [10] = { 3, 4, 5, 6, 10 } } },
  { -- the younger one ends first, with zeros of the older one
    { 1, 1, "7c30d7b220000000" }, { 2, 2, ZEROS }, { 3, 1, "85b8909620000000" }, { 4, 2, ZEROS },
    { 5, 2, "27c30000000050a0" }, { 6, 2, ZEROS }, { 7, 2, ZEROS }, { 8, 2, "014000000000d023" },
    { 9, 3, "4334370000003704" }, { 10, 3, "52393400000028d9" },
    id = 0x307, good = { [9] = { 3, 6, 7, 8, 9 }, [10] = { 1, 2, 4, 5, 10 } } },
}

function T.test_frames_with_the_same_bytes_change_hands()
  for _, rows in ipairs(SAME_BYTES) do
    local state, shown = bus.reassembler(), {}
    for i, row in ipairs(rows) do
      local data = row[3]:gsub("%x%x", function(digits) return string.char(tonumber(digits, 16)) end)
      local entry = bus.frame(state, { bus.can_id(rows.id, row[2], 0, 0), look = row[1], data = data, wide = true })
      shown[i] = entry.last == row[1] and entry.status or "part"
    end
    lu.assertEquals(table.concat(shown, " "), "part part part part part part part part good good")
    for last, members in pairs(rows.good) do
      for _, number in ipairs(members) do
        local entry, numbers = state.kept:entry(number), {}
        for i = 1, entry.count do numbers[i] = entry[i] end
        lu.assertEquals({ entry.last, numbers }, { last, members }, number)
      end
    end
    for _, faults in pairs(state.kept.faults) do lu.assertEquals(faults, {}) end
  end
end

function T.test_cut_by_the_snap_length()
  check {
    { "S32 S32 M8~3 M8 M8 E8", "part part+fragment.incomplete part part part unverified" },
    { "S32 S32 M8 M8 M8 E8~0", "part part+fragment.incomplete part part part unverified" },
  }
end

function T.test_padding_of_a_bad_message()
  check { { "S17 S17! E17p20", "part part+fragment.incomplete bad" } }
end

-- A message has one End.
function T.test_an_end_is_no_middle()
  for _, text in ipairs { "S32 M8 M8 E8 E8", "S32 S32 M8 M8 E8 E8", "aS32 bS32 bM8 bM8 bE8 bE8" } do
    lu.assertNotStrContains(bus.send(text), "good", text)
  end
end

-- An End of a broken message on the other bus says nothing about this one.
function T.test_strangers()
  for _, text in ipairs {
    "aS32 bS32 bM8 aM8 bE8? aM8 aM8 aE8", -- b lost two frames
    "bS32 aS32 aM8 bE8? aM8 aM8 aE8",
    "bS17! aS32 bM8 bM8 bE1 aM8 aM8 aM8 aE8",
  } do
    lu.assertStrMatches(bus.send(text), ".* good", nil, nil, text)
  end
end

-- One message mirrored on both buses: its frames are there twice, and each makes up one message only.
function T.test_a_frame_belongs_to_one_message()
  local payload = ("\1"):rep(9)
  local sent = { S = { 1, bus.start(0x123, 0, 0, payload) }, M = { 2, payload:sub(1, 8) }, E = { 3, payload:sub(9) } }
  for text, expected in pairs {
    SSMMEE = "false false false false good good", SSMEE = "false false false good orphan",
    SMSEE = "false false false good short", SSMMEEE = "false false false false good good false",
  } do
    local state, list, number = bus.reassembler(), {}, 0
    for kind in text:gmatch(".") do
      number = number + 1
      local ctrl, data = sent[kind][1], sent[kind][2]
      local entry = bus.frame(state, { bus.can_id(0x123, ctrl, 0, 0), look = number, data = data })
      local is_alone = not entry and select(2, state.kept:entry(number))
      list[number] = tostring(is_alone and "orphan" or entry and entry.status or false)
    end
    lu.assertEquals(table.concat(list, " "), expected, text)
  end
end

-- The effort --------------------------------------------------------------------------------------------------------

-- Two messages of many small frames, mixed, that fit nothing: the worst that the search can meet.
local function hopeless(state, number)
  local start = bus.start(0x123, 0, 0, "", { size = 40 })
  for _ = 1, 2 do
    number = number + 1
    bus.frame(state, { bus.can_id(0x123, 1, 0, 0), look = number, data = start })
  end
  for i = 1, 60 do
    number = number + 1
    bus.frame(state, { bus.can_id(0x123, i % 2 == 0 and 3 or 2, 0, 0), look = number, data = string.char(i) })
  end
  return number
end

function T.test_the_effort_is_bounded()
  local state, number = bus.reassembler(), 0
  while number < 5000 do number = hopeless(state, number) end
  -- 32 steps a frame, what was saved up at first, and the checks of whole messages
  lu.assertTrue(state.steps < 40 * number + 4096, ("%d steps for %d frames"):format(state.steps, number))
end

function T.test_credit_comes_back()
  local state, number = bus.reassembler(), 0
  while number < 5000 do number = hopeless(state, number) end
  for _ = 1, 200 do
    number = number + 1
    bus.frame(state, { bus.can_id(0, 0, 0, 0), look = number, data = ("x"):rep(7) })
  end
  lu.assertEquals(state.credit, 4096)
end

return T
