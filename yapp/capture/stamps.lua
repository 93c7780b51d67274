-- SPDX-License-Identifier: GPL-2.0-or-later
-- The time stamps of a capture, beside the clocks of its controllers.  Stamps are coarse if one
-- source has several messages with the same: they are those of packets, or of whole seconds.  And
-- the capture's clock may be set forward while it records.  Pure Lua.
--
--   stamps      2.0  2.1  |  102.2  102.3       a stamp without what the clock was set forward is
--   a source   52.0 52.1  |   52.2   52.3       even: 2.0, 2.1, 2.2, 2.3
--
-- Behind a gap of over 10 s, the first message with a clock tells whether the clock was set.

local Stamps = {}
Stamps.__index = Stamps

local MIN_SET = 10 -- seconds
local MAX_WAIT = 2 -- seconds behind a gap, for a message with a clock
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
  self.sets = {} -- when the clock was set forward: a list of { from, to, length, key }
  self.gap = nil -- the same without a length: the latest gap, while nothing tells about it
  self.latest = nil -- stamp of the latest message
  self.equal, self.count = 0, 0 -- messages with the stamp of the one before, and all
end

--- Return whether stamps are coarse, by the messages so far.
function Stamps:are_coarse()
  return self.equal * MIN_SHARE > self.count
end

--- Return a time without what the clock was set forward before it.
-- time  seconds since the first packet, as stamped
function Stamps:even(time)
  local even, sets = time, self.sets
  for i = 1, #sets do
    if time >= sets[i].to then even = even - sets[i].length end
  end
  return even
end

-- Judge the latest gap by a message behind it.
-- elapsed, advance  seconds of the stamps, and of the clock of its source
local function judge_gap(self, elapsed, advance)
  local gap, length = self.gap, elapsed - advance
  self.gap = nil
  if length <= MIN_SET then return end
  gap.length = math.min(length, gap.to - gap.from)
  table.insert(self.sets, gap)
end

--- Add the next message.
-- time     its stamp
-- key      its frame key
-- before   even time of the previous message of its source that has a clock, nil for none
-- advance  seconds of this clock since then
-- returns  its even time, nil while nothing tells about a gap before it
function Stamps:add(time, key, before, advance)
  local latest, gap, even = self.latest, self.gap, self:even(time)
  self.latest = time
  if latest and time - latest > MIN_SET then
    gap = { from = latest, to = time, length = nil, key = key }
    self.gap = gap
  elseif gap and math.abs(time - gap.to) > MAX_WAIT then
    gap, self.gap = nil, nil
  end
  if before then
    self.count = self.count + 1
    if even == before and advance > 0 and advance <= MAX_ADVANCE then
      self.equal = self.equal + 1
    end
    if gap and advance > 0 then
      judge_gap(self, even - before, advance)
      return self:even(time)
    end
  end
  return not gap and even or nil
end

return Stamps
