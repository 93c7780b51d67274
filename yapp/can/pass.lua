-- SPDX-License-Identifier: GPL-2.0-or-later
-- One pass over a file's CAN frames: its looks at them, by number, and what it has of them.  Pure Lua, 5.2 and 5.4.
--
-- A look is the frame's number; where the same number comes again, because the packet has several CAN frames or because
-- a read filter rejected the frame that had it, a fraction tells them apart.
-- ("Frames 7 and 8 come, -R drops 7: then 8 is called 7 again.  The looks are 7 and 7 + STEP; the second stays 7's.")

local M = {}

local can_reassembly = require("yapp.can.reassembly")

local floor = math.floor

local STEP = 2 ^ -21 -- two million frames of one number, of two thousand million numbers

--- Nothing has come yet.
-- memory   a can.memory
-- returns  { reassembly, kept = a can.frames, archive and faults = the kept's, history = a message.history, highest,
--          usual = where the first frame was in its packet, is_filtered = whether a read filter rejected a frame, ... }
function M.new(memory)
  local reassembly = can_reassembly.new(memory.parts, memory.size_of)
  return {
    reassembly = reassembly, kept = reassembly.kept, archive = reassembly.kept.archive,
    faults = reassembly.kept.faults, history = memory.new_history(),
    highest = 0, latest = 0, -- number, and look, of the newest frame
    is_taken = false,        -- whether that is YAPP's
    repeats = {},            -- [number] = { [place] = look }, where a number came more than once
    odd = {},                -- [number] = place, where it is not the usual one
  }
end

--- The look at a frame that comes in order.
function M.next_look(pass, number, place)
  if number > pass.highest then
    if place ~= pass.usual then
      pass.usual = pass.usual or place
      if place ~= pass.usual then pass.odd[number] = place end
    end
    pass.highest, pass.latest, pass.place = number, number, place
    return number
  end
  if place == pass.place and not pass.is_taken then return pass.latest end -- it was left to others
  local places = pass.repeats[number] or { [pass.place] = pass.latest }
  if place <= pass.place then -- another packet: a read filter rejected the one before
    pass.is_filtered, places = true, {}
  end
  pass.latest, pass.place, pass.kept.has_fractions = pass.latest + STEP, place, true
  places[place] = pass.latest
  pass.repeats[number] = places
  return pass.latest
end

--- The look that a pass had at a frame, nil if none: the key of its id tells it from one that a read filter rejected.
-- returns  the look, and the frame's message where it belongs to one
function M.find_look(pass, number, place, key)
  local places, look = pass.repeats[number], number
  if places then
    look = places[place]
    if not look then return nil end
  elseif (pass.odd[number] or pass.usual) ~= place then
    return nil
  end
  local message, alone = pass.kept:entry(look)
  if message and message.address.key == key then return look, message end
  if alone and pass.kept.can_id.address(alone).key == key then return look end
end

--- Where the frame of a look was in its packet.
function M.place_of(pass, look)
  local number = floor(look)
  for place, other in pairs(pass.repeats[number] or {}) do
    if other == look then return place end
  end
  return pass.odd[number] or pass.usual
end

--- The number of the frame of a look; nil for one that a read filter rejected.
function M.number_of(pass, look)
  local number = floor(look)
  local places = pass.repeats[number]
  if not places then return number end
  for _, other in pairs(places) do
    if other == look then return number end
  end
end

return M
