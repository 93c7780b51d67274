-- SPDX-License-Identifier: GPL-2.0-or-later
-- The time stamps of a capture, beside the clocks of its controllers.  Stamps are coarse if one
-- source has several messages with the same: they are those of packets, or of whole seconds.  And
-- the capture's clock may be set forward while it records, and back again.  Pure Lua.
--
--   stamps      2.0  2.1  |  102.2  102.3       a stamp without what the clock was set forward is
--   a source   52.0 52.1  |   52.2   52.3       even: 2.0, 2.1, 2.2, 2.3
--
-- Behind a gap of over 10 s, the first message with a clock tells whether the clock was set.

local number_of = require("yapp.base.frame_key").number

local Stamps = {}
Stamps.__index = Stamps

local MIN_SET = 10 -- seconds
local MAX_WAIT = 2 -- seconds behind a gap or a step back, for a message
local MAX_ADVANCE = 1 -- seconds between messages with one stamp; other controllers may be further
-- Of so many messages behind each other one may have the stamp of the one before: TCP hands on
-- messages together if a segment came late.
local MIN_SHARE = 100

--- Make the stamps of captures.
function Stamps.new()
  local self = setmetatable({}, Stamps)
  self:reset()
  return self
end

--- Forget the capture.
function Stamps:reset()
  -- When the clock was set forward: a list of { to = the stamp behind that, number = of its packet,
  -- length, stop = number of the last packet before the clock was set back, or math.huge }.
  self.sets = {}
  self.gap = nil -- the same without a length: the latest gap, while nothing tells about it
  self.latest = nil -- stamp of the latest message
  self.equal, self.count = 0, 0 -- messages with the stamp of the one before, and all
end

--- Return whether stamps are coarse, by the messages so far.
function Stamps:are_coarse()
  return self.equal * MIN_SHARE > self.count
end

--- Return a time without what the clock was set forward before it.
-- time    seconds since the first packet, as stamped
-- number  of the packet; math.huge for the next one
function Stamps:even(time, number)
  local even, sets = time, self.sets
  for i = 1, #sets do
    local set = sets[i]
    if number >= set.number and number <= set.stop then even = even - set.length end
  end
  return even
end

-- Find a gap before the next stamp, and whether the clock was set back to what it was, not further
-- ahead.
local function add_stamp(self, time, number)
  local latest, gap = self.latest or time, self.gap
  self.latest = time
  if latest - time > MIN_SET then
    local is_undone = time - self:even(latest, number) < MAX_WAIT
    for _, set in ipairs(is_undone and self.sets or {}) do
      set.stop = math.min(set.stop, number - 1)
    end
  elseif time - latest > MIN_SET then
    self.gap = { to = time, number = number, stop = math.huge }
  elseif gap and math.abs(time - gap.to) > MAX_WAIT then
    self.gap = nil
  end
end

--- Add the next message.
-- time     its stamp
-- key      its frame key
-- before   even time of the previous message of its source that has a clock, nil for none
-- advance  seconds of this clock since then
-- returns  its even time, nil while nothing tells about a gap before it
function Stamps:add(time, key, before, advance)
  add_stamp(self, time, number_of(key))
  local gap, even = self.gap, self:even(time, math.huge)
  if before then
    self.count = self.count + 1
    if even == before and advance > 0 and advance <= MAX_ADVANCE then
      self.equal = self.equal + 1
    end
    if gap and advance > 0 then
      gap.length, self.gap = even - before - advance, nil
      if gap.length <= MIN_SET then return even end
      table.insert(self.sets, gap)
      return even - gap.length
    end
  end
  return not gap and even or nil
end

return Stamps
