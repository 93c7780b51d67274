-- Numbers for looks at CAN frames: a frame's number does not always tell it from others.  Pure Lua, 5.2 and 5.4.
--
-- A packet may have several CAN frames, and on a first pass a frame that a read filter rejects has the number of the
-- next one.  So each look has a serial.  It is the frame's number until one comes twice; from then on it runs ahead.

local M = {}

local Serials = {}
Serials.__index = Serials

--- The serials of one capture file.  To be read:
-- shift     how far they run ahead of the numbers; 0 until a number comes twice
-- highest   the highest number so far
-- filtered  whether a read filter was seen at work
function M.new()
  return setmetatable({
    shift = 0, highest = 0, filtered = false,
    serials = {}, -- [number]: of the look that counts, since shift is not 0
    numbers = {}, -- [serial]: since then
    places = {},  -- [number][place]: the serials of frames behind a packet's first
  }, Serials)
end

--- The serial of a look on the first pass, where numbers come in order.
-- number  of the frame
-- place   where it is in its packet, any value.  But for the first look it may be left out where the number is not a
--         repetition and shift is 0
-- frames  what is known by serial: a look that left nothing there makes room for the next one at the same frame
function Serials:next(number, place, frames)
  local repeated = number <= self.highest
  if not repeated and self.shift == 0 then
    self.highest, self.latest, self.place = number, number, self.place or place
    return number
  end
  local is_elsewhere = repeated and place ~= self.place
  self.place = place
  if repeated and not is_elsewhere then
    if not frames[self.latest] then return self.latest end
    self.filtered = true
  end
  if repeated then
    self.shift, self.first = self.shift + 1, self.first or number
  end
  local serial = number + self.shift
  self.highest, self.latest, self.numbers[serial] = math.max(number, self.highest), serial, number
  if is_elsewhere then
    self.places[number] = self.places[number] or {}
    self.places[number][place] = serial
  else
    self.serials[number] = serial
  end
  return serial
end

--- The serial of a frame on a later pass; nil for one that the first pass was not asked about.
-- place  needed when has_places(number)
function Serials:find(number, place)
  if self.shift == 0 then return number end
  local places = self.places[number]
  return places and places[place] or self.serials[number] or number <= self.first and number or nil
end

--- Whether a packet has several CAN frames.
function Serials:has_places(number)
  return self.places[number] ~= nil
end

--- The number of the frame that a look was at; nil for one that a read filter rejected.
function Serials:number_of(serial)
  if self.shift == 0 then return serial end
  local number = self.numbers[serial] or serial
  return (self.places[number] or (self.serials[number] or number) == serial) and number or nil
end

return M
