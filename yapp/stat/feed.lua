-- SPDX-License-Identifier: GPL-2.0-or-later
-- From the dissection to the statistics: records in the order of the capture, each statistic those
-- that its filter lets count; and exact times.  Pure Lua, 5.2 to 5.5.
--
-- A packet is dissected, and its records are offered; then the taps run: a filter's says that the
-- packet matches, and the one that sees all packets says that it is there.  In which order they run
-- nothing promises, so a packet's records are handed on when the next packet comes.
--
-- A statistic has what it needs of
--   message(record)  a record of stat.tell that counts
--   event(event)     an event of stat.tell
--   finish(last)     { rel = time } of the last packet, nil where there was none; returns the exit
--                    code, nil for 0, and a text to say, nil for none
--   tells_changes    whether what it says rests on what came before a message

local tell = require("yapp.stat.tell")

local M = {}

local UNTOLD = 21 -- the exit code where something could not be told
local NOT_KNOWN = "what came before a message is not known (nothing tells several buses apart): " ..
  "faults that rose or fell, reboots and gaps are missing"

local NOTHING = {}
local floor = math.floor

local Feed = {}
Feed.__index = Feed

--- plugin  of stat.taps
function M.new(plugin)
  local self = setmetatable({ statistics = {}, plugin = plugin }, Feed)
  self:reset()
  return self
end

--- Forgets what was offered and seen: all packets will come again.
function Feed:reset()
  self.queue, self.number, self.visited = {}, nil, nil -- of the packet that is dissected
  self.waiting, self.last = NOTHING, nil
  self:begins(0, 0, 0) -- packets may have no time
  self.doubtful, self.is_unsure, self.is_direct = {}, false, false
  for _, entry in ipairs(self.statistics) do
    entry.matched = {}
  end
end

--- Adds a statistic.
-- returns  what Feed.matched is told of, where it has a filter
function Feed:add(statistic, has_filter)
  local entry = { statistic = statistic, has_filter = has_filter, matched = {} }
  if statistic.event then
    entry.kinds = tell.kinds(self.plugin, statistic)
  end
  self.statistics[#self.statistics + 1] = entry
  return entry
end

local function hand_on(self, record)
  for _, entry in ipairs(self.statistics) do
    local statistic = entry.statistic
    local is_counted = not entry.has_filter or entry.matched[record.frame] == true
    if entry.kinds then
      entry.kinds:record(record, is_counted)
    end
    if is_counted then
      if record.is_unsure and statistic.tells_changes then
        self.is_unsure = true
      end
      if statistic.message then
        statistic:message(record)
      end
    end
  end
end

local function take(self, record)
  if record.fault then
    self.doubtful[#self.doubtful + 1] = record -- what comes may still show that nothing was lost
  else
    hand_on(self, record)
  end
end

local function flush(self)
  local waiting = self.waiting
  self.waiting = NOTHING
  for i = 1, #waiting do
    take(self, waiting[i])
  end
end

--- A record of the packet that is dissected.
-- visited  of the packet: tshark -2 dissects all packets before the first tap runs
function Feed:offer(record, visited)
  if self.is_direct then
    flush(self)
    return take(self, record)
  end
  if record.frame ~= self.number or visited ~= self.visited then
    self.number, self.visited, self.queue = record.frame, visited, {}
  end
  self.queue[#self.queue + 1] = record
end

--- The filter of a statistic lets a packet count.  Kept for all packets: that a message is not
-- finished shows at the end.
function Feed.matched(_, entry, number)
  entry.matched[number] = true
end

--- When the first packet was captured.
-- seconds, nanoseconds  integers
-- rel                   what the packet's time since the first one is: not 0 where a filter
--                       rejected the first one
function Feed:begins(seconds, nanoseconds, rel)
  self.first = { seconds = seconds, nanoseconds = nanoseconds, rel = rel }
end

--- The time of a packet from the seconds since the first one.
-- returns  seconds since 1970, nanoseconds; exact for captures of up to 48 days: 2^22 s is what a
--          double has to half a nanosecond
function Feed:time(rel)
  local first = self.first
  local since = rel - first.rel
  local nanoseconds = first.nanoseconds + floor(since % 1 * 1e9 + 0.5)
  local seconds = first.seconds + floor(since) + floor(nanoseconds / 1e9)
  return seconds, nanoseconds % 1e9
end

--- Records no longer wait for their packets' taps where none is needed: a tenth of csv's time.
-- To be called from a tap, once all packets that come have their taps, in order.
-- returns  whether it is so
function Feed:go_direct()
  for _, entry in ipairs(self.statistics) do
    if entry.has_filter or entry.kinds then
      return false
    end
  end
  self.is_direct = true
  return true
end

--- A packet of any kind has been dissected.
-- number, rel  of the packet; rel = seconds since the first one.  With tshark -2 -R the number of a
--              packet that the first pass rejected is another's in the second, with another time
function Feed:packet(number, rel)
  flush(self)
  self.last = rel
  if number == self.number and self.queue[#self.queue].rel == rel then
    self.waiting, self.number = self.queue, nil
  end
end

-- Losses that were not taken back; each message once, at the first frame that shows it.
local function hand_on_losses(self)
  local is_told = {}
  for _, record in ipairs(self.doubtful) do
    if not (record.fault.void or is_told[record.lost or false]) then
      if record.lost then is_told[record.lost] = true end
      hand_on(self, record)
    end
  end
end

--- All packets have come.
-- unfinished  records of messages that the capture ends before
-- returns     the exit code (0, 20 or 21: what did not hold before what could not be told), and a
--             list of texts
function Feed:finish(unfinished)
  flush(self)
  hand_on_losses(self)
  for _, record in ipairs(unfinished) do
    hand_on(self, record)
  end
  local code, texts = 0, {}
  if self.is_unsure then
    code, texts[1] = UNTOLD, NOT_KNOWN
  end
  local last = self.last and { rel = self.last }
  for _, entry in ipairs(self.statistics) do
    if entry.kinds then entry.kinds:finish(last) end
    local this, text = entry.statistic:finish(last)
    if this and (code == 0 or this < code) then
      code = this
    end
    texts[#texts + 1] = text
  end
  return code, texts
end

return M
