-- Numbers for looks at CAN frames: a frame's number does not always tell it from others.  Pure Lua, 5.2 and 5.4.
--
-- A packet may have several CAN frames, and on a first pass a frame that a read filter rejects has the number of the
-- next one.  So each look has a serial.  It is the frame's number until one comes twice; with each that does, serials
-- run one further ahead.

local M = {}

local Serials = {}
Serials.__index = Serials

--- The serials of one capture file.  To be read:
-- highest   the highest number so far
-- filtered  whether a read filter was seen at work
function M.new()
  return setmetatable({
    highest = 0, filtered = false,
    steps = {}, shift = 0, -- the numbers that came again, in order; how many
    places = {},           -- [number][place]: the serials of the frames of a packet that has several
    odd = {},              -- [number]: the place of a packet's only frame, where it is not the usual one
  }, Serials)
end

--- The serial of a look on the first pass, where numbers come in order.
-- number  of the frame
-- place   where it is in its packet, any value
-- frames  what is known by serial: a look that left nothing there makes room for the next one at the same frame
function Serials:next(number, place, frames)
  local before, latest = self.place, self.latest
  self.place = place
  if number <= self.highest then
    local is_same = place == before
    if is_same and not frames[latest] then return latest end
    self.shift = self.shift + 1
    self.steps[self.shift] = number
    local serial, places = number + self.shift, self.places[number]
    if not is_same then
      places = places or { [before] = latest }
    elseif places then
      places = {} -- another packet: a read filter rejected the one before
    end
    if places then places[place] = serial end
    self.places[number], self.filtered = places, self.filtered or is_same
    self.latest = serial
    return serial
  end
  self.usual = self.usual or place
  if place ~= self.usual then self.odd[number] = place end
  self.highest, self.latest = number, number + self.shift
  return self.latest
end

-- How many numbers up to this one came again; behind: how much the i-th one counts more than its number.
local function steps_to(self, number, behind)
  local steps, low, high = self.steps, 1, self.shift
  while low <= high do
    local middle = (low + high - (low + high) % 2) / 2
    if steps[middle] + behind * middle <= number then low = middle + 1 else high = middle - 1 end
  end
  return high
end

--- The serial of a frame on a later pass.  One that the first pass was not asked about has one of its own, but in a
-- packet with others that it was asked about: there it has none.
-- number, place, frames  as for next
-- returns  the serial, or nil
function Serials:find(number, place, frames)
  local places = self.places[number]
  if places then return places[place] end
  local serial, known = number + steps_to(self, number, 0), self.odd[number]
  if not known and frames[serial] then known = self.usual end
  if not known then
    known = place
    self.odd[number] = place
  end
  return place == known and serial or nil
end

--- The number that a frame had when it was looked at.
function Serials:number(serial)
  return serial - steps_to(self, serial, 1)
end

--- The number of a frame; nil for one that a read filter rejected.
function Serials:number_of(serial)
  if self.shift == 0 then return serial end
  local number = self:number(serial)
  for _, other in pairs(self.places[number] or { number + steps_to(self, number, 0) }) do
    if other == serial then return number end
  end
end

return M
