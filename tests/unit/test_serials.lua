-- Serials: what a later pass finds under a frame's number is what the first pass knew of that frame.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local serials = require("yapp_serials")

local T = {}

-- Looks of a first pass: { number, place, what is known after it or nil }.  Returns the serials, and what each got.
local function first_pass(looks)
  local s, frames, given = serials.new(), {}, {}
  for i, look in ipairs(looks) do
    given[i] = s:next(look[1], look[2], frames)
    if look[3] then frames[given[i]] = look[3] end
  end
  return s, frames, given
end

function T.test_the_number_itself()
  local s, _, given = first_pass { { 3, 8, "a" }, { 4, 8, "b" }, { 9, 8, "c" } }
  lu.assertEquals(given, { 3, 4, 9 })
  lu.assertEquals({ s:find(4, 8, {}), s:number_of(9), s.filtered, s.shift }, { 4, 9, false, 0 })
end

-- The table of ids is asked first, the heuristic or Decode As next.
function T.test_a_second_look_at_a_frame_that_was_left()
  local s, frames, given = first_pass { { 1, 8, "a" }, { 2, 8 }, { 2, 8, "b" }, { 3, 8, "c" } }
  lu.assertEquals(given, { 1, 2, 2, 3 })
  lu.assertEquals({ frames[s:find(2, 8, frames)], s.shift }, { "b", 0 })
end

function T.test_rejected_frames_have_the_next_number()
  local s, frames, given = first_pass { { 1, 8, "a" }, { 2, 8, "rejected" }, { 2, 8, "rejected too" }, { 2, 8, "b" },
    { 3, 8, "c" }, { 4, 8, "rejected at last" }, { 4, 8 } }
  lu.assertEquals(given, { 1, 2, 3, 4, 5, 6, 7 })
  lu.assertTrue(s.filtered)
  for number, known in ipairs { "a", "b", "c" } do lu.assertEquals(frames[s:find(number, 8, frames)], known) end
  lu.assertNil(frames[s:find(4, 8, frames)]) -- not ours
  lu.assertEquals(s:find(5, 8, frames), 8) -- not asked about: nobody else's
  local shown = {}
  for _, serial in ipairs(given) do shown[#shown + 1] = s:number_of(serial) or "-" end
  lu.assertEquals(shown, { 1, "-", "-", 2, 3, "-", 4 })
end

function T.test_several_frames_in_a_packet()
  local s, frames, given = first_pass { { 1, 30, "a" }, { 1, 60, "b" }, { 1, 90 }, { 1, 90, "c" }, { 2, 30, "d" },
    { 3, 30, "e" }, { 3, 60, "f" } }
  lu.assertFalse(s.filtered)
  local found = {}
  for _, row in ipairs { { 1, 30 }, { 1, 60 }, { 1, 90 }, { 2, 30 }, { 3, 30 }, { 3, 60 } } do
    found[#found + 1] = frames[s:find(row[1], row[2], frames)]
  end
  lu.assertEquals(table.concat(found), "abcdef")
  local shown = {}
  for i, serial in ipairs(given) do shown[i] = s:number_of(serial) end
  lu.assertEquals(shown, { 1, 1, 1, 1, 2, 3, 3 })
end

function T.test_rejected_packets_of_several_frames()
  local s, frames = first_pass { { 1, 30, "x" }, { 1, 60, "y" }, { 1, 90, "z" }, { 1, 30, "a" }, { 1, 60, "b" } }
  lu.assertEquals({ frames[s:find(1, 30, frames)], frames[s:find(1, 60, frames)] }, { "a", "b" })
  local given
  s, frames, given = first_pass { { 1, 30, "x" }, { 1, 60, "y" }, { 1, 60, "a" }, { 1, 90, "b" }, { 2, 30, "c" } }
  lu.assertTrue(s.filtered)
  local found = { frames[s:find(1, 60, frames)], frames[s:find(1, 90, frames)], frames[s:find(2, 30, frames)] }
  lu.assertEquals(found, { "a", "b", "c" })
  local shown = {}
  for _, serial in ipairs(given) do shown[#shown + 1] = s:number_of(serial) or "-" end
  lu.assertEquals(shown, { "-", "-", 1, 1, 2 })
end

function T.test_numbers_that_the_first_pass_was_not_asked_about()
  local s, frames, given = first_pass { { 2, 30, "a" }, { 2, 60, "b" }, { 5, 30, "c" }, { 5, 30, "d" }, { 9, 30, "e" } }
  local taken = {}
  for _, serial in ipairs(given) do taken[serial] = true end
  for _, number in ipairs { 1, 3, 4, 6, 7, 8, 10, 11 } do
    local serial = s:find(number, number, frames)
    lu.assertNil(s:find(number, number + 1, frames)) -- another frame of that packet
    lu.assertEquals(s:find(number, number, frames), serial)
    lu.assertNil(taken[serial], number)
    taken[serial] = true
    lu.assertEquals(s:number_of(serial), number)
  end
end

-- In a packet with others that the first pass was asked about.
function T.test_frames_that_the_first_pass_was_not_asked_about()
  local s, frames = first_pass { { 1, 30, "a" }, { 1, 60, "b" }, { 2, 30, "c" }, { 3, 60, "d" } }
  for number, place in ipairs { 90, 60, 30 } do lu.assertNil(s:find(number, place, frames)) end
  lu.assertEquals(frames[s:find(2, 30, frames)] .. frames[s:find(3, 60, frames)], "cd")
end

-- Random passes: no two frames have the same serial, it grows, and the last frame with a number is the one found.
function T.test_random_passes()
  local random = require("stream_generator").random(7)
  for _ = 1, 300 do
    local looks, last, number = {}, {}, 1
    for i = 1, 60 do
      looks[i] = { number, 8, i }
      last[number] = i
      number = number + random(3) - 1
    end
    local s, frames, given = first_pass(looks)
    for i = 2, #given do lu.assertTrue(given[i] > given[i - 1]) end
    for n, known in pairs(last) do lu.assertEquals(frames[s:find(n, 8, frames)], known) end
    for i, serial in ipairs(given) do
      lu.assertEquals(s:number(serial), looks[i][1])
      lu.assertEquals(s:number_of(serial), last[looks[i][1]] == i and looks[i][1] or nil)
    end
  end
end

return T
