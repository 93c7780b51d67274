-- SPDX-License-Identifier: GPL-2.0-or-later
-- The passes over a capture: which look a frame is, which pass has it, what changed there.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local passes = require("yapp.memory.passes")

local T = {}
local STEP = 2 ^ -21

-- A history that says what it was told: the message's number, and links to the first one's.
local function new_history()
  local first
  return {
    note = function(_, m)
      first = first or m.number
      return { noted = m.number }, 0.5
    end,
    change = function(_, m) return m.number ~= 99 and { noted = m.number } or nil end,
    standing = function(_, m)
      return m.number ~= 99 and { command_in = first, next_change = m.number } or nil
    end,
  }
end

local function new() return passes.new(new_history) end

-- Looks at { number, place }; all that it finds is ours.  Returns the looks, with "now" where the
-- look is made now, "second" where another pass has it.
local function looks(all, rows, is_again, knows_all)
  local list = {}
  for i, row in ipairs(rows) do
    local pass, look, is_now = all:look(row[1], row[2] or 8, is_again or false, knows_all ~= false)
    if is_now then pass.entries[look] = true end
    local place = look and math.floor(look)
    list[i] = not pass and "-" or (pass == all.second and "second " or "") ..
      (is_now and "now " or "") ..
      ("%d"):format(place) .. (look > place and ("+%d"):format((look - place) / STEP) or "")
  end
  return table.concat(list, ", ")
end

function T.test_a_frame_a_packet()
  local all = new()
  lu.assertEquals(looks(all, { { 1 }, { 2 }, { 5 } }), "now 1, now 2, now 5")
  lu.assertFalse(all.is_again)
  lu.assertEquals(looks(all, { { 5 }, { 1 }, { 6 }, { 1, 9 } }, true), "5, 1, -, -")
  lu.assertTrue(all.is_again)
  lu.assertIs(all:last(), all.first)
end

function T.test_several_frames_a_packet()
  local all, rows = new(), { { 1, 30 }, { 1, 60 }, { 2, 8 }, { 3, 30 }, { 3, 60 }, { 3, 90 } }
  lu.assertEquals(looks(all, rows), "now 1, now 1+1, now 2, now 3, now 3+1, now 3+2")
  lu.assertEquals(looks(all, { rows[6], rows[2], rows[3], rows[1], { 2, 30 }, { 3, 8 } }, true),
    "3+2, 1+1, 2, 1, -, -")
  lu.assertFalse(all.first.is_filtered)
  lu.assertEquals(all.first:number(3 + 2 * STEP), 3)
end

function T.test_looks_with_fractions()
  local all = new()
  looks(all, { { 1, 30 }, { 1, 60 }, { 2, 30 } })
  local pass = all.first
  lu.assertEquals({ pass:has_fractions { 1, 2 }, pass:has_fractions { 1, 1 + STEP }, pass:has_fractions {} },
    { false, true, false })
end

-- A frame at another place than most, left to others, comes again by Decode As: it is one look.
function T.test_asked_twice_at_another_place()
  local pass = new().first
  lu.assertEquals({ pass:next(1, 30), pass:next(2, 60) }, { 1, 2 })
  pass.left = 2
  lu.assertEquals({ pass:next(2, 60), pass.is_filtered }, { 2, false })
  pass = new().first -- the second frame of a packet
  lu.assertEquals({ pass:next(1, 30), pass:next(1, 60) }, { 1, 1 + STEP })
  pass.left = 1 + STEP
  lu.assertEquals({ pass:next(1, 60), pass.is_filtered }, { 1 + STEP, false })
end

-- Frames 7, 8 come, -R drops 7: then 8 is called 7 again.
function T.test_a_read_filter()
  local all = new()
  lu.assertEquals(looks(all, { { 7 }, { 7 }, { 7 }, { 8 } }), "now 7, now 7+1, now 7+2, now 8")
  lu.assertEquals(looks(all, { { 7 }, { 8 } }, true), "7+2, 8") -- the number is the last one's
  local first = all.first
  lu.assertEquals({ first:number(7 + 2 * STEP), first:number(8) }, { 7, 8 })
  lu.assertNil(first:number(7)) -- one that was rejected
  lu.assertNil(first:number(7 + STEP))
end

function T.test_a_frame_that_was_left_to_others_comes_again()
  local all = new()
  local _, look = all:look(1, 8, false, true)
  all.first.left = look
  lu.assertEquals({ look, (select(2, all:look(1, 8, false, true))) }, { 1, 1 })
  lu.assertEquals(looks(all, { { 2 }, { 1 } }, false), "now 2, now 2+1") -- numbers that go back
end

function T.test_another_look_at_the_same_frame()
  local all = new()
  looks(all, { { 4 } })
  lu.assertEquals({ all.first:another(), all.first:another() }, { 4 + STEP, 4 + 2 * STEP })
end

-- There is a second pass where the first did not know all, if this time all is known, and it comes
-- in order.
function T.test_a_second_pass()
  local rows = { { 1 }, { 3 }, { 4 } }
  local all = new()
  looks(all, rows, false, false)
  all.first.is_partial = true
  lu.assertEquals(looks(all, rows, true, true), "second now 1, second now 3, second now 4")
  lu.assertEquals(looks(all, { { 3 }, { 1 } }, true, true), "second 3, second 1")
  lu.assertEquals(looks(all, { { 3 } }, true, false), "3")
  lu.assertIs(all:last(), all.second)
  lu.assertNotIs(all.first.history, all.second.history)
end

function T.test_no_second_pass()
  local rows = { { 1 }, { 3 }, { 4 } }
  for _, case in ipairs {
    { "nothing is missing", rows, function() end, true },
    { "nothing is known now", rows, function(pass) pass.is_partial = true end, false },
    { "not in order", { { 3 }, { 4 }, { 3 } }, function(pass) pass.is_partial = true end, true },
    { "numbers have shifted", rows, function(pass)
      pass.is_partial, pass.is_filtered = true, true
    end, true },
  } do
    local all = new()
    looks(all, rows, false, false)
    case[3](all.first)
    lu.assertNotStrContains(looks(all, case[2], true, case[4]), "second", case[1])
    lu.assertNil(all.second, case[1])
  end
end

-- It goes on behind the place that it has come to, wherever the looks between were.
function T.test_a_second_pass_goes_on()
  local all = new()
  looks(all, { { 1 }, { 2 }, { 3 } }, false, false)
  all.first.is_partial = true
  lu.assertEquals(looks(all, { { 1 }, { 3 }, { 2 }, { 3 } }, true, true),
    "second now 1, 3, second now 2, second now 3")
end

-- Links are numbers of frames; the rejected ones have none.
function T.test_what_changed()
  local all = new()
  looks(all, { { 7 }, { 7 }, { 8 } })
  local pass = all.first
  local message = {}
  local change, delta = pass:note(7, message)
  lu.assertEquals({ change, delta }, { { noted = 7 }, 0.5 })
  lu.assertEquals(pass:standing(message), {}) -- 7 is now another frame's number
  pass:note(8, message)
  lu.assertEquals(pass:standing(message), { next_change = 8 })
  lu.assertEquals(pass:change(8, message), { noted = 8 })
  lu.assertNil(pass:change(99, message))
  lu.assertNil(pass:standing(message))
end

return T
