-- SPDX-License-Identifier: GPL-2.0-or-later
-- From the dissection to the statistics: messages in the order of the capture, each statistic those that its filter
-- lets count; and exact times.  Pure Lua, 5.2 and 5.4.
--
-- A packet is dissected, and its messages are offered; then the taps run: a filter's says that the packet matches, and
-- the one that sees all packets says that it is there.  In which order they run nothing promises, so a packet's
-- messages are handed on when the next packet comes.

local M = {}

local UNTOLD = 21 -- the exit code where something could not be told
local NOT_KNOWN = "what came before a message is not known (-2 -R takes several buses for one): faults that rose or " ..
  "fell, reboots and gaps are missing"

local Feed = {}
Feed.__index = Feed

function M.new()
  local self = setmetatable({ statistics = {} }, Feed)
  self:reset()
  return self
end

--- Forgets what was offered and seen: all packets will come again.
function Feed:reset()
  self.queue, self.queued, self.number, self.visited = {}, 0, nil, nil
  self.waiting, self.waiting_count, self.last_rel, self.orphans, self.epoch = {}, 0, nil, {}, nil
  self.doubtful, self.is_unsure = {}, false
  for _, entry in ipairs(self.statistics) do entry.matched = {} end
end

--- Adds a statistic: with message(record, is_counted) and finish(last), { rel = time } of the last packet where that is
-- known; sees_all = whether it gets what does not count too, tells_changes = whether what it says rests on what came
-- before a message.
-- returns  what matched is told by, where it has a filter
function Feed:add(statistic, has_filter)
  local entry = { statistic = statistic, has_filter = has_filter, matched = {} }
  self.statistics[#self.statistics + 1] = entry
  return entry
end

--- A message, or a lost part of one, of the packet that is dissected: a record of stat.groups.
-- visited  of the packet: tshark -2 dissects all packets before the first tap runs
function Feed:offer(record, visited)
  if record.frame ~= self.number or visited ~= self.visited then
    self.number, self.visited, self.queued = record.frame, visited, 0
  end
  self.queued = self.queued + 1
  self.queue[self.queued] = record
end

--- The filter of a statistic lets a packet count.  Kept for all packets, 32 in a number: that a message is not
-- finished shows at the end.
function Feed.matched(_, entry, number)
  local bit = number % 32
  local place = (number - bit) / 32
  local word = entry.matched[place] or 0
  if word % 2 ^ (bit + 1) < 2 ^ bit then entry.matched[place] = word + 2 ^ bit end
end

local function counts(entry, number)
  if not entry.has_filter then return true end
  local bit = number % 32
  return (entry.matched[(number - bit) / 32] or 0) % 2 ^ (bit + 1) >= 2 ^ bit
end

local integer = rawget(math, "tointeger") or function(n) return n end

-- Seconds as whole seconds and nanoseconds: 2^22 s is what a double has to half a nanosecond.
local function split(rel)
  local fraction = rel % 1
  return rel - fraction, math.floor(fraction * 1e9 + 0.5)
end

--- When the first packet was captured.
-- seconds, nanoseconds  integers; rel = what the packet's time since the first one is (0, or where a filter rejected
--                       packets the first one that there is)
function Feed:begins(seconds, nanoseconds, rel)
  local whole, rest = split(rel)
  self.epoch = { seconds = seconds - whole, nanoseconds = nanoseconds - rest }
end

--- The time of a packet from the seconds since the first one.
-- returns  seconds since 1970, nanoseconds; exact for captures of up to 48 days
function Feed:time(rel)
  local epoch, whole, rest = self.epoch, split(rel)
  local nanoseconds = epoch.nanoseconds + rest
  rest = nanoseconds % 1000000000
  return integer(epoch.seconds + whole + (nanoseconds - rest) / 1000000000), integer(rest)
end

-- Whether an orphaned frame is another message than the orphans before it: only the first one of a message counts.
local function is_new(self, record)
  local orphans, key = self.orphans, record.source.key
  local before = orphans[key]
  if record.lost ~= "orphan" then
    orphans[key] = nil
    return true
  end
  orphans[key] = not record.is_end and record.seq or nil
  return before ~= record.seq
end

local function hand_on(self, record)
  for i = 1, #self.statistics do
    local entry = self.statistics[i]
    local statistic = entry.statistic
    local is_counted = counts(entry, record.frame)
    if is_counted and record.is_unsure and statistic.tells_changes then self.is_unsure = true end
    if is_counted or statistic.sees_all then statistic:message(record, is_counted) end
  end
end

--- Takes a message at once: for who knows that its packet counts, and that no other waits.
function Feed:take(record)
  if not is_new(self, record) then return end
  if record.fault then
    self.doubtful[#self.doubtful + 1] = record -- what comes may still show that nothing was lost
  else
    hand_on(self, record)
  end
end

local function flush(self)
  local waiting = self.waiting
  for i = 1, self.waiting_count do
    self:take(waiting[i])
    waiting[i] = nil
  end
  self.waiting_count = 0
end

--- Whether a message is taken, or not, for what is seen of its packet.
function Feed:has_filter()
  for _, entry in ipairs(self.statistics) do
    if entry.has_filter then return true end
  end
  return false
end

--- A packet of any kind has been dissected.
-- number, rel  of the packet; rel = seconds since the first one.  Where no message waits for it, where self.number is
--              nil, the number may be left out, and rel where no statistic wants the last packet.  With tshark -2 -R
--              the number of a packet that the first pass rejected is another packet's in the second, which has
--              another time
function Feed:packet(number, rel)
  if self.waiting_count > 0 then flush(self) end
  self.last_rel = rel
  if number and self.number == number and self.queue[self.queued].rel == rel then
    self.waiting, self.queue, self.waiting_count, self.queued = self.queue, self.waiting, self.queued, 0
    self.number = nil
  end
end

--- All packets have come.
-- unfinished  records of messages that the capture ends before
-- returns     the exit code (0, 20 or 21: what did not hold before what could not be told), and a list of texts
function Feed:finish(unfinished)
  flush(self)
  local last = self.last_rel and { rel = self.last_rel }
  for _, record in ipairs(self.doubtful) do
    if not record.fault.void then hand_on(self, record) end
  end
  for _, record in ipairs(unfinished) do hand_on(self, record) end
  local code, texts = self.is_unsure and UNTOLD or 0, { self.is_unsure and NOT_KNOWN or nil }
  for _, entry in ipairs(self.statistics) do
    local this, text = entry.statistic:finish(last)
    if this and (code == 0 or this < code) then code = this end
    texts[#texts + 1] = text
  end
  return code, texts
end

return M
