-- SPDX-License-Identifier: GPL-2.0-or-later
-- The passes over a capture, which the memories of CAN and of streams share: which frame a look is
-- at, what was kept of it, and what changed there.  Pure Lua.
--
-- A pass is frames in order.  A frame is known by its look: its number as a rule; where a number
-- comes again, because a packet has several frames or because a read filter rejected the packet
-- before, a fraction tells them apart. ("Frames 7 and 8 come, -R drops 7: then 8 is called 7 again.
--  Their looks are 7 and 7 + STEP; the number 7 is then the second's.")
--
-- There is a second pass only where the first could not know what tells buses apart or which id a
-- frame has: it begins anew, in order, with nothing taken from the first.  Who asks for a frame
-- here and there gets what the first knows.

local M = {}

local floor, max = math.floor, math.max

local STEP = 2 ^ -21 -- two million looks of one number, of two thousand million numbers

local FRAMES = { "command_in", "previous_change", "next_change" } -- of how things stand

local Pass = {}
Pass.__index = Pass

-- It has, to be read and written: entries, by look, what is kept of each frame of ours; history, of
-- message.history; and, set by who makes a frame of it, is_partial: true where it was not told all
-- that tells frames apart; left: the latest look at a frame that is not ours.
local function new_pass(new_history)
  return setmetatable({
    entries = {},
    history = new_history(),
    is_partial = false,
    highest = 0, -- number of the newest frame
    usual = nil, -- the place of the first frame, which most others have too
    latest = 0,  -- the look at it, where that is not its number
    place = 0,   -- of it in its packet, where that is not the usual one
    -- [number] = { [place] = look }, where the look is not the number or the place not usual
    looks = {},
    is_filtered = false, -- whether a read filter rejected a packet: numbers have shifted
  }, Pass)
end

--- The look at a frame that comes in order.
-- number  of the frame; place: of its bytes in the packet
function Pass:next(number, place)
  if number > self.highest then
    self.highest = number
    if place == self.usual then return number end
    self.usual = self.usual or place
    if place ~= self.usual then self.looks[number] = { [place] = number } end
    self.place = place
    return number
  end
  local places = self.looks[number]
  local newest = places and self.place or self.usual
  -- It was left to others, and comes again by Decode As.
  local look = self:newest()
  if place == newest and self.left == look then
    self.left = nil
    return look
  end
  places = places or { [newest] = number }
  if place <= newest then self.is_filtered, places = true, {} end
  self.place = place
  places[place] = self:another()
  self.looks[number] = places
  return self.latest
end

--- The look at the newest frame.
function Pass:newest()
  return max(self.latest, self.highest)
end

--- A further look at the newest frame: for each message of a packet its own.
function Pass:another()
  self.latest = self:newest() + STEP
  return self.latest
end

--- The look that the pass had at a frame, nil for none.
function Pass:find(number, place)
  local places = self.looks[number]
  if places then return places[place] end
  return place == self.usual and number <= self.highest and number or nil
end

--- Whether any of these looks is not the number of its frame.
function Pass:has_fractions(looks)
  if not next(self.looks) then return false end
  for _, look in ipairs(looks) do
    if look % 1 ~= 0 then return true end
  end
  return false
end

--- The number of the frame of a look; nil for one that a read filter rejected.
function Pass:number(look)
  local number = floor(look)
  local places = self.looks[number]
  if not places or not self.is_filtered then return number end
  for _, other in pairs(places) do
    if look >= other then return number end
  end
end

--- The numbers of the frames of these looks, without those that a read filter rejected: a list, or
-- the looks themselves, so read only.
function Pass:numbers(looks)
  if not next(self.looks) then return looks end
  local numbers = {}
  for _, look in ipairs(looks) do numbers[#numbers + 1] = self:number(look) end
  return numbers
end

--- Takes a message into the history, in order.
-- look     of the frame that ends it
-- message  as History:note takes it; gets number, its look
-- returns  what is new in it, or nil; and the seconds since the source's previous good message, for
--          Pass:change at a later look
function Pass:note(look, message)
  message.number = look
  return self.history:note(message)
end

--- What was new there, at a later look.
-- message  as for Pass:note, and delta = what that returned
function Pass:change(look, message)
  message.number = look
  return self.history:change(message)
end

--- How things stand there (History:standing), with numbers of frames.
-- message  which note, or change, has had
function Pass:standing(message)
  local standing = self.history:standing(message)
  for _, name in ipairs(standing and FRAMES or {}) do
    standing[name] = standing[name] and self:number(standing[name])
  end
  return standing
end

local Passes = {}
Passes.__index = Passes

--- No pass has begun.
-- new_history  function() -> a message.history
-- It has first, a pass; second, another or nil; is_again: whether any frame was looked at a second
-- time.
function M.new(new_history)
  return setmetatable({
    new_history = new_history,
    first = new_pass(new_history),
    is_again = false,
  }, Passes)
end

-- Whether a second pass goes on at a frame: nothing of the first lies between.
local function follows(self, number)
  local entries = self.first.entries
  for before = (self.second and self.second.highest or 0) + 1, number - 1 do
    if entries[before] ~= nil or self.first.looks[before] then return false end
  end
  return true
end

--- Which pass a look at a frame belongs to.
-- number, place  of the frame
-- is_again       whether Wireshark has shown it before
-- knows_all      whether this time all is known that tells frames apart
-- returns        a pass, and the look; whether the look is made now, in order.  Nil where no pass
--                had the frame.
function Passes:look(number, place, is_again, knows_all)
  local first, second = self.first, self.second
  if not is_again then return first, first:next(number, place), true end
  self.is_again = true
  if first.is_partial and knows_all and not first.is_filtered then
    local look = second and second:find(number, place)
    if look then return second, look, false end
    if number >= (second and second.highest or 0) and follows(self, number) then
      self.second = second or new_pass(self.new_history)
      return self.second, self.second:next(number, place), true
    end
  end
  local look = first:find(number, place)
  if look then return first, look, false end
end

--- The pass that was made last: what it has left open, the capture ends before.
function Passes:last()
  return self.second or self.first
end

return M
