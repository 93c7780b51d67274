-- SPDX-License-Identifier: GPL-2.0-or-later
-- A run of statistics over a capture: the events of a packet wait until the filters have seen it.
-- Pure Lua, 5.2 to 5.5.
--
-- A packet is dissected, and its results are reported.  Then the taps run: a filter's says that the
-- packet matches, and the one that sees all packets says that it is there.  Nothing promises their
-- order, so the events of a packet are handed on when the next packet comes.

local answer = require "yapp.stat.answer"
local dates = require "yapp.stat.dates"
local events = require "yapp.stat.events"
local joined = require "yapp.base.joined"
local kinds = require "yapp.stat.kinds"
local output = require "yapp.stat.output"

local M = {}

local MAX_STEP = 0.001 -- seconds; several interfaces make the clock go back by up to this
local MAX_TURN = 1 -- the same of the stamps of recorders in turns, if the end is to be judged
local UNDISSECTED = "no YAPP message found; %s not dissected: see yapp.motor_ids, yapp.all_extended"
local NO_PACKETS = "no YAPP message found: the capture has no packets, or -R removed all of them"
local NOTHING_FOUND = "no YAPP message found in %s: see yapp.user_dlt, " ..
  "tcp.try_heuristic_first, udp.try_heuristic_first, " ..
  "-d tcp.port==PORT,yapp_serial, -d rtacser.data,yapp_serial, " ..
  "in Wireshark also yapp.search_all, and docs/streams.md, docs/files.md" -- tshark searches all
local NO_TIMES = "packets of this capture have no time stamps"
-- As candump -H writes them for an adapter that has no clock.
local EQUAL_TIMES = "all packets of this capture have the same time stamp"
local COARSE_TIMES = "time stamps are those of packets, or too coarse"

local Run = {}
Run.__index = Run

--- Make a run.
-- settings  see stat.taps
-- stamps    a capture.stamps
-- hint      a text for statistics without a filter, or nil
function M.new(settings, stamps, hint)
  local self = setmetatable({
    settings = settings,
    stamps = stamps,
    hint = hint,
    answers = {},
    live = false, -- a statistic that is shown while packets come, see stat.watch
    second = os.time(), -- of the wall clock, when it was shown
    dates = dates.new(), -- until a time is known, if ever, of 1970
  }, Run)
  self:reset()
  return self
end

--- Forget all events and packets, as all packets will be revisited.
function Run:reset()
  local answers = self.answers
  self.events = events.new(self.settings, function(event)
    for i = 1, #answers do answers[i]:add(event) end
  end)
  self.offered, self.number, self.visited = {}, nil, nil -- of the packet that is dissected
  self.waiting = {} -- events of packets whose taps have run
  self.unread = 0 -- number of packets that came behind Run:stop
  self.packets = 0 -- how many packets came
  self.last = nil -- its time
  self.has_progress = false -- true if it differs from the packet's before
  -- How often the capture's clock went back, and the latest packet behind that:
  self.steps, self.step = 0, { number = 0, time = 0 }
  self.turn = 0 -- the largest of these steps; 0 for the clocks of controllers
end

--- Add a statistic, see stat.answer.
-- options  of stat.options; matched = a set of the numbers of packets that its filter lets count,
--          which a tap fills, or nil
function Run:add(statistic, options)
  table.insert(self.answers, answer.new(self, statistic, options))
  if statistic.tick then self.live = statistic end
end

-- Hand on the events that wait, unless nothing tells yet whether the capture's clock was set.
-- is_end  true if nothing will
local function deliver_waiting(self, is_end)
  local waiting, stamps = self.waiting, self.stamps
  if stamps.gap and not is_end then return end
  for i = 1, #waiting do
    local event = waiting[i]
    if stamps.sets[1] then event.at = stamps:even(event.time, event.frame) end
    self.events:add(event)
    waiting[i] = nil
  end
end

--- Take a result of the packet that is dissected, or of one whose taps have run.
-- result  see reading.records
function Run:report(result)
  local number, visited = result.frame.number, result.frame.visited
  if number <= self.packets then return events.append(self.waiting, result) end
  -- tshark -2 dissects all packets before the first tap runs.
  if number ~= self.number or visited ~= self.visited then
    self.number, self.visited, self.offered = number, visited, {}
  end
  events.append(self.offered, result)
end

-- Count an event of the whole capture, whatever the filters say.
local function count_event(self, kind, frame, time, bus, values)
  local event = kinds.new_event(kind, frame, time, { bus = bus }, values)
  event.at = time and self.stamps:even(time, frame)
  for _, one in ipairs(self.answers) do one:count(event) end
end

-- The capture's clock goes back, or was set forward.
-- length  in seconds, negative if it goes back
local function count_step(self, frame, time, length)
  count_event(self, "clock", frame, time, nil, {
    length = output.seconds(length),
    step = length < 0 and "went back" or "was set forward",
    size = output.seconds(math.abs(length)),
  })
end

--- Go on to a packet of any kind, which has been dissected.
-- number, rel  of the packet; rel = seconds since the first one.  With tshark -2 -R the number of a
--              packet that the first pass rejected is another's in the second, with another time
-- has_clock    function() -> false if rel is the time of a controller: to go back is no event then
function Run:packet(number, rel, has_clock)
  if self.waiting[1] then deliver_waiting(self) end
  local last = self.last or rel
  self.last, self.packets = rel, number
  if rel ~= last then
    self.has_progress = true
    if last - rel > MAX_STEP then
      self.steps, self.step = self.steps + 1, { number = number, time = rel }
      if has_clock() then
        self.turn = math.max(self.turn, last - rel)
        count_step(self, number, rel, -kinds.span(rel, last))
      end
    end
  end
  local event = number == self.number and self.offered[1]
  if event and event.time == rel then
    local waiting = self.waiting
    self.waiting, self.number = waiting[1] and joined(waiting, self.offered) or self.offered, nil
  end
  if self.live then self:tick() end
end

local function ignore() end

--- Take no more packets, but count them: they are of another file, or numbered anew.
function Run:stop()
  deliver_waiting(self, true)
  self.report, self.packet = ignore, function() self.unread = self.unread + 1 end
end

-- The end -----------------------------------------------------------------------------------------

-- Return why a capture has no message; nil if it has one.
local function explain_nothing_found(self, extended)
  if self.events.has_messages then return nil end
  if extended > 0 then return UNDISSECTED:format(output.were(extended, "extended CAN frame")) end
  if self.packets == 0 then return NO_PACKETS end
  return NOTHING_FOUND:format(output.count(self.packets, "packet"))
end

-- Return why times of packets mean nothing; nil if they mean something.
local function explain_times(self, ending)
  if ending.lacks_times then return NO_TIMES end
  if self.packets > 1 and not self.has_progress then return EQUAL_TIMES end
  return self.stamps:are_coarse() and COARSE_TIMES
end

-- Add to a record how things stand, for statistics; return it.
-- ending  see Run:finish
local function describe(self, ending)
  local stamps, step, last = self.stamps, self.step, self.last or 0
  local lacks_times = explain_times(self, ending)
  ending.run, ending.events = self, self.events
  ending.last = self.last -- stamp of the last packet, nil for none
  ending.length = stamps:even(last, self.packets) -- seconds from the first packet to it
  ending.lacks_times = lacks_times -- why times mean nothing, or nil
  ending.are_coarse = lacks_times == COARSE_TIMES -- then messages recorded twice are still found
  ending.hides_end = self.steps > 1 and self.turn > MAX_TURN -- see length_since
  -- Why no message was found, nil if one was:
  ending.reason = explain_nothing_found(self, ending.extended)
  -- Return how many seconds from a message to the end.  Behind a step back of the clock, a lower
  -- bound: from there on.  Behind several, the stamps of recorders may alternate.
  function ending.length_since(event)
    local are_several, from = self.steps > 1, event.at
    if lacks_times or are_several and self.turn == 0 then return 0 end
    if are_several then
      from = from + self.turn
    elseif event.frame < step.number then
      from = stamps:even(step.time, step.number)
    end
    return kinds.span(from, ending.length)
  end
  return ending
end

--- Show a live statistic once a second, and when it wants to end the run.
function Run:tick()
  local live, now = self.live, os.time()
  local pause = now - self.second
  if pause == 0 and not live.must_stop then return end
  self.second = now
  live:tick(describe(self, { extended = 0 }), pause)
end

-- Hand on the results that waited until all packets had come: at last the messages that the end of
-- the capture cuts off, in the order of their frames.
local function deliver_rest(self, ending)
  deliver_waiting(self, true)
  local waiting = self.waiting
  for _, result in ipairs(ending.results) do
    if result.kind ~= "unfinished" or not ending.unread then events.append(waiting, result) end
  end
  output.sort(waiting, function(event) return event.kind == "unfinished" and event.frame or 0 end)
  deliver_waiting(self, true)
end

-- Count what the capture lost, and when its clock was set.
local function count_losses(self, ending)
  local begin = self.dates.seconds + self.dates.nanoseconds / 1e9
  for _, drop in ipairs(ending.drops) do
    local time = drop.time and math.floor((drop.time - begin) * 1e6 + 0.5) / 1e6
    count_event(self, "dropped", drop.frame, time, drop.bus, { count = drop.count })
  end
  for _, set in ipairs(self.stamps.sets) do
    count_step(self, set.number, set.to, set.length)
  end
end

--- End: all packets have come.
-- ending  {
--   results      of Reading:finish
--   drops        of capture.capture
--   lacks_times  true if packets have no time stamps
--   extended     number of extended CAN frames that were not dissected
--   problems     list of texts: wishes of the user that were not met, and why not all was read
--   unread       in short why packets were left out, nil if none were
--   is_partial   true if packets were read and not decoded }
-- returns  the exit code, and a list of texts to say
function Run:finish(ending)
  deliver_rest(self, ending)
  describe(self, ending)
  self.events:finish(ending.length_since, not ending.lacks_times)
  count_losses(self, ending)
  local code, texts = output.EXIT_OK, {}
  for _, one in ipairs(self.answers) do
    local worse, text, notes = one:finish(ending)
    -- A rule that failed is worse than one that was not judged.
    if worse and worse ~= output.EXIT_OK and (code == output.EXIT_OK or worse < code) then
      code = worse
    end
    texts = joined(texts, { text }, notes)
  end
  return code, texts
end

return M
