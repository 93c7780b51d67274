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
local SEARCH_PREFERENCES = "yapp.user_dlt, tcp.try_heuristic_first, udp.try_heuristic_first, " ..
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
    live = nil, -- a statistic that is shown while packets come, see stat.watch
    second = os.time(), -- of the wall clock, when it was shown
  }, Run)
  self.dates = dates.new() -- until a time is known, if ever, of 1970
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
  self.waiting = {}
  self.unread = 0 -- number of packets that came behind Run:stop
  self.packets, self.latest = 0, 0 -- how many packets came, and the number of the latest
  self.last = nil -- its time
  self.has_progress = false -- true if it differs from the packet's before
  -- How often the capture's clock went back, and the latest packet behind that:
  self.steps, self.step = 0, { number = 0, time = 0 }
end

--- Add a statistic, see stat.answer.
-- options  of stat.options
-- returns  its answer, with the table `matched` if it has a filter
function Run:add(statistic, options)
  local one = answer.new(self.settings, statistic, options)
  table.insert(self.answers, one)
  if statistic.tick then self.live = statistic end
  return one
end

-- Hand on the events that wait, unless nothing tells yet whether the capture's clock was set.
-- is_end  true if nothing will
local function deliver_waiting(self, is_end)
  local waiting, stamps = self.waiting, self.stamps
  if stamps.gap and not is_end then return end
  for i = 1, #waiting do
    local event = waiting[i]
    if stamps.sets[1] then event.at = stamps:even(event.time) end
    self.events:add(event)
    waiting[i] = nil
  end
end

--- Take a result of the packet that is dissected, or of an earlier one.
-- result  see reading.records
function Run:report(result)
  local number, visited = result.frame.number, result.frame.visited
  if number <= self.latest then -- its taps have run
    events.append(self.waiting, result)
    return deliver_waiting(self)
  end
  -- tshark -2 dissects all packets before the first tap runs.
  if number ~= self.number or visited ~= self.visited then
    self.number, self.visited, self.offered = number, visited, {}
  end
  events.append(self.offered, result)
end

--- Take an error frame of a CAN bus, which a tap has read.
-- event  of kinds.new_event
function Run:add_bus_error(event)
  if event.frame <= self.latest then
    self.waiting[#self.waiting + 1] = event -- the tap that calls Run:packet came first
  else
    self.number, self.visited, self.offered = event.frame, nil, { event }
  end
end

-- The capture's clock goes back.
local function add_step(self, number, rel, step)
  local values = {
    length = output.seconds(-step),
    step = "went back",
    size = output.seconds(step),
  }
  local clock = kinds.new_event("clock", number, rel, {}, values)
  for _, one in ipairs(self.answers) do one:count(clock) end
end

--- Go on to a packet of any kind, which has been dissected.
-- number, rel  of the packet; rel = seconds since the first one.  With tshark -2 -R the number of a
--              packet that the first pass rejected is another's in the second, with another time
-- has_clock    function() -> false if rel is the time of a controller: to go back is no event then
function Run:packet(number, rel, has_clock)
  if self.waiting[1] then deliver_waiting(self) end
  local last = self.last or rel
  self.last, self.latest, self.packets = rel, number, self.packets + 1
  if rel ~= last then self.has_progress = true end
  if last - rel > MAX_STEP then
    self.steps, self.step = self.steps + 1, { number = number, time = rel }
    if has_clock() then add_step(self, number, rel, kinds.span(rel, last)) end
  end
  local event = number == self.number and self.offered[1]
  if event and event.time == rel then
    if self.waiting[1] then self.offered = joined(self.waiting, self.offered) end
    self.waiting, self.number = self.offered, nil
  end
  if self.live then self:tick() end
end

local function ignore() end

local function count_unread(self) self.unread = self.unread + 1 end

--- Take no more packets, but count them: they are of another file, or numbered anew.
function Run:stop()
  deliver_waiting(self, true)
  self.report, self.add_bus_error, self.packet = ignore, ignore, count_unread
end

-- The end -----------------------------------------------------------------------------------------

-- Return why a capture has no message; nil if it has one.
local function explain_nothing_found(self, extended)
  if self.events.has_messages then return nil end
  if extended > 0 then
    local text = "no YAPP message found; %s not dissected: see yapp.motor_ids, yapp.all_extended"
    return text:format(output.were(extended, "extended CAN frame"))
  end
  if self.packets == 0 then
    return "no YAPP message found: the capture has no packets, or -R removed all of them"
  end
  local packets = output.count(self.packets, "packet")
  return ("no YAPP message found in %s: see %s"):format(packets, SEARCH_PREFERENCES)
end

-- Return why times of packets mean nothing; nil if they mean something.
local function explain_times(self, capture)
  if capture.lacks_times then return NO_TIMES end
  if self.packets > 1 and not self.has_progress then return EQUAL_TIMES end
  return self.stamps:are_coarse() and COARSE_TIMES or nil
end

-- Return the texts of a list, each once.
local function without_repeats(texts)
  local list, said = {}, {}
  for _, text in ipairs(texts) do
    if not said[text] then list[#list + 1] = text end
    said[text] = true
  end
  return list
end

-- Hand on the results that waited until all packets had come: at last the messages that the end of
-- the capture cuts off, in the order of their frames.
local function deliver_rest(self, capture)
  local waiting = self.waiting
  for _, result in ipairs(capture.results) do
    local is_cut = result.kind == "unfinished"
    if not (is_cut and capture.unread) then events.append(waiting, result) end
  end
  output.sort(waiting, function(event) return event.kind == "unfinished" and event.frame or 0 end)
  deliver_waiting(self, true)
end

-- Return how things stand, for statistics.
-- capture  see Run:finish
local function new_ending(self, capture)
  local stamps, step, last = self.stamps, self.step, self.last or 0
  local lacks_times = explain_times(self, capture)
  -- Behind a step back of the clock, a lower bound: from there on.  Behind several, the stamps of
  -- recorders may alternate: then nothing tells.
  local function length_since(event)
    if lacks_times or self.steps > 1 then return 0 end
    local from = event.frame < step.number and step.time or event.time
    return kinds.span(stamps:even(from), stamps:even(last))
  end
  return {
    last = self.last, -- seconds from the first packet to the last one, nil for none
    length_since = length_since, -- function(event) -> seconds from a message to the end
    events = self.events,
    begin = self.dates.seconds + self.dates.nanoseconds / 1e9, -- of the first packet
    -- Why no message was found, nil if one was:
    reason = explain_nothing_found(self, capture.extended),
    lacks_times = lacks_times,
    are_coarse = lacks_times == COARSE_TIMES, -- then messages recorded twice are still found
    sets = stamps.sets, -- when the capture's clock was set forward
    steps = self.steps, -- how often its stamps went back
    -- Wishes of the user that were not met, and why not all was read: texts.
    problems = joined(self.settings.problems, capture.problems),
    unread = capture.unread, -- the same in short if packets were left out
    drops = capture.drops,
    hint = self.hint,
  }
end

local NOTHING_KNOWN = { extended = 0, problems = {}, drops = {} } -- before the end

--- Show a live statistic once a second, and when it wants to end the run.
function Run:tick()
  local live, now = self.live, os.time()
  local pause = now - self.second
  if pause == 0 and not live.must_stop then return end
  self.second = now
  live:tick(new_ending(self, NOTHING_KNOWN), pause)
end

--- End: all packets have come.
-- capture  {
--   results      of Reading:finish
--   drops        of capture.capture
--   lacks_times  true if packets have no time stamps
--   extended     number of extended CAN frames that were not dissected
--   problems     list of texts: why not all was read
--   unread       the same in short if packets were left out, nil if none }
-- returns  the exit code, and a list of texts to say
function Run:finish(capture)
  deliver_waiting(self, true)
  deliver_rest(self, capture)
  local ending = new_ending(self, capture)
  self.events:finish(ending.length_since, not ending.lacks_times)
  local code, texts = output.EXIT_OK, {}
  for _, one in ipairs(self.answers) do
    local worse, text, notes = one:finish(ending)
    -- A rule that failed is worse than one that was not judged.
    local is_worse = worse and worse ~= output.EXIT_OK
    if is_worse and (code == output.EXIT_OK or worse < code) then code = worse end
    texts = joined(texts, { text }, notes)
  end
  return code, without_repeats(texts)
end

return M
