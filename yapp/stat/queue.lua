-- SPDX-License-Identifier: GPL-2.0-or-later
-- From the dissectors to the statistics: hands on events in the order of the capture, to each
-- statistic those that its filter lets count.  Pure Lua, 5.2 to 5.5.
--
-- A packet is dissected, and its events are offered.  Then the taps run: a filter's says that the
-- packet matches, and the one that sees all packets says that it is there.  Nothing promises their
-- order, so the events of a packet are handed on when the next packet comes.

local dates = require "yapp.stat.dates"
local derive = require "yapp.stat.derive"
local joined = require "yapp.base.joined"
local kinds = require "yapp.stat.kinds"
local output = require "yapp.stat.output"

local M = {}

local SEARCH_PREFERENCES = "yapp.user_dlt, tcp.try_heuristic_first, udp.try_heuristic_first, " ..
  "-d tcp.port==PORT,yapp_serial, in Wireshark also yapp.search_all" -- tshark searches all
local MAX_STEP = 0.001 -- seconds; several interfaces make the clock go back by up to this
-- Clocks that begin anew at 0: of 2^32 microseconds, of a day.  The rest to
-- their end is the time from one packet to the next.
local WRAPS, MAX_REST = { 2 ^ 32 / 1e6, 86400 }, 10 -- seconds
local MAX_APART = 0.2 -- seconds between the packets of recorders whose stamps alternate
local MAX_RECORDERS = 5
local NO_TIMES = "packets of this capture have no time stamps"
-- As candump -H writes them for an adapter that has no clock.
local EQUAL_TIMES = "all packets of this capture have the same time stamp"

local abs, huge, max = math.abs, math.huge, math.max

local Queue = {}
Queue.__index = Queue

--- Make a queue for a run over the capture.
-- settings  see stat.taps
-- hint      a text for statistics without a filter, or nil
function M.new(settings, hint)
  local self = setmetatable({ settings = settings, hint = hint, derivers = {} }, Queue)
  self.dates = dates.new()
  self:reset()
  return self
end

--- Forget all events and packets, as all packets will be revisited.
function Queue:reset()
  self.offered, self.number, self.visited = {}, nil, nil -- of the packet that is dissected
  self.waiting = {}
  self.last = nil -- time of the latest packet
  self.now = 0 -- the same without the steps back of the capture's clock
  self.sure = 0 -- the same of the latest message, if there are several recorders, see update_time
  self.offsets = { 0 } -- seconds that recorders are behind, that of the latest packet first
  self.guessed = 0 -- of these that of the latest packet of no message
  self.latest = 0 -- its number
  self.has_progress = false -- true if it differs from the packet's before
  self.packets = 0
  self.clocks = {} -- by source, see time_of
  self.dates:set_first(0, 0, 0) -- until a time is known, if ever
  self.undissected = {} -- events, see Queue:add_undissected: they count if messages are dissected
  self.has_messages = false
  self.is_direct = false
end

--- Add a statistic, see stat.derive.
-- options  of stat.options
-- returns  its deriver, with the table `matched` if it has a filter
function Queue:add(statistic, options)
  local deriver = derive.new(self.settings, statistic, options)
  self.derivers[#self.derivers + 1] = deriver
  return deriver
end

-- Return the seconds to add for a step back of a clock: if it began anew, the time went on.
--   4294.900, 0.010   4294.967296: 0.077 s went by
--   10.0, 3.8         6.2
local function fall_of(step)
  for _, wrap in ipairs(WRAPS) do
    if wrap >= step and wrap - step < MAX_REST then return wrap end
  end
  return step
end

-- Return the time of an event without the steps back of its source's own stamps: the stamps of
-- other sources may be those of another recorder.
local function time_of(self, event)
  local clock = self.clocks[event.source]
  if not clock then
    clock = {
      fallen = self.offsets[1], -- seconds that its own stamps went back
      latest = nil, -- its latest time
      offset = self.offsets[1], -- seconds that its recorder is behind
    }
    self.clocks[event.source] = clock
  end
  local now = event.time + clock.fallen
  if event.kind ~= "message" and event.kind ~= "crc" then return now end -- a loss may come late
  local is_back = clock.latest and now < clock.latest
  local step = is_back and kinds.span(now, clock.latest) or 0
  if step > MAX_STEP then
    local fall = fall_of(step)
    clock.fallen, now = clock.fallen + fall, now + fall
  end
  clock.latest = now
  return now
end

-- Return how far the recorder of a packet is behind, if its source does not tell: a known recorder,
-- the one by whose clock the least time went by, or a new one, or one whose clock was set back.
-- step  seconds since the packet before
local function guess_offset(self, rel, step)
  local offsets, found, least = self.offsets, nil, huge
  for i, offset in ipairs(offsets) do
    local distance = abs(rel + offset - self.now)
    local limit = max(MAX_APART, abs(offset - offsets[1]) / 4)
    if i == 1 then limit = step < -MAX_STEP and -1 or huge end
    if distance <= limit and distance < least then found, least = offset, distance end
  end
  return found or offsets[1] + fall_of(-step)
end

-- Put the offset of a recorder first.
local function put_offset_first(self, offset)
  local offsets = self.offsets
  for i, other in ipairs(offsets) do
    if abs(offset - other) <= MAX_APART then
      table.remove(offsets, i)
      break
    end
  end
  table.insert(offsets, 1, offset)
  offsets[MAX_RECORDERS + 1] = nil
end

-- Work out the time of a packet.  The stamps of several recorders may alternate: the clock of each
-- is some seconds behind the time that went by:
--   stamps     10.0  3.8   10.1  3.9   10.2    the second recorder is 6.2 s behind
--   went by    10.0  10.0  10.1  10.1  10.2
-- Each source has one recorder.  A packet of no source may be of any recorder, also of an unknown
-- one: the next message shows by how much the guess was wrong.
-- event  of the packet, nil for none
local function update_time(self, rel, step, event)
  local clock = event and self.clocks[event.source]
  if not self.offsets[2] then self.sure = self.now end
  if clock then clock.offset = clock.offset + fall_of(max(0, self.sure - rel - clock.offset)) end
  local offset = clock and clock.offset or guess_offset(self, rel, step)
  if event then
    self.sure = max(self.sure, rel + offset)
    local excess = self.now - self.sure
    if excess > MAX_APART then put_offset_first(self, self.guessed - excess) end
    self.now = self.sure
  else
    self.now, self.guessed = max(self.now, rel + offset), offset
  end
  put_offset_first(self, offset)
end

local function deliver(self, event)
  local now = time_of(self, event)
  event.rel = now
  if event.source.id then self.has_messages = true end
  for _, deriver in ipairs(self.derivers) do
    deriver:derive(event, now, self.now)
  end
end

local function deliver_waiting(self)
  local waiting = self.waiting
  if not waiting[1] then return end
  for i, event in ipairs(waiting) do
    waiting[i] = nil
    deliver(self, event)
  end
end

--- Offer an event of the packet that is dissected, or of an earlier one.
-- visited  of the packet: tshark -2 dissects all packets before the first tap runs
function Queue:offer(event, visited)
  -- An event of an earlier packet is of a conversation that was unknown when that came.
  if self.is_direct or event.frame <= self.latest then
    deliver_waiting(self)
    return deliver(self, event)
  end
  if event.frame ~= self.number or visited ~= self.visited then
    self.number, self.visited, self.offered = event.frame, visited, {}
  end
  self.offered[#self.offered + 1] = event
end

--- Keep an `undissected` event until the end.
function Queue:add_undissected(event)
  self.undissected[#self.undissected + 1] = event
end

--- Hand on events at once from now on, if all statistics are tables: no other can do without the
-- taps of packets.  This saves a tenth of csv's time.  Call it from a tap, when no other packet
-- still waits for its taps.
-- returns  true if events are handed on at once
function Queue:begin_direct()
  for _, deriver in ipairs(self.derivers) do
    if deriver.matched or not deriver.options.row.table_only then
      return false
    end
  end
  self.is_direct = true
  return true
end

-- Report a packet whose time goes back, or one of several recorders.
local function emit_step(self, number, rel, step, event)
  update_time(self, rel, step, event)
  if step >= -MAX_STEP then return end
  local values = { length = output.seconds(step), back = output.seconds(-step) }
  local clock = kinds.new_event("clock", number, rel, {}, values)
  clock.rel = self.now
  for _, deriver in ipairs(self.derivers) do deriver:add(clock) end
end

--- Go on to a packet of any kind, which has been dissected.
-- number, rel  of the packet; rel = seconds since the first one.  With tshark -2 -R the number of a
--              packet that the first pass rejected is another's in the second, with another time
-- lacks_clock  function() -> whether rel is the time of a controller: to go back is no event then
function Queue:packet(number, rel, lacks_clock)
  if self.waiting[1] then deliver_waiting(self) end
  local last = self.last or rel
  self.last, self.latest, self.packets = rel, number, self.packets + 1
  if rel ~= last then self.has_progress = true end
  local event = number == self.number and self.offered[#self.offered]
  if event and event.time ~= rel then event = nil end
  if rel >= last and not self.offsets[2] or lacks_clock() then
    self.now = rel + self.offsets[1]
  else
    emit_step(self, number, rel, kinds.span(last, rel), event)
  end
  if event then self.waiting, self.number = self.offered, nil end
end

local function ignore() end

--- Take no more packets: they are of another file.
function Queue:stop()
  deliver_waiting(self)
  self.offer, self.add_undissected, self.packet = ignore, ignore, ignore
end

-- The end -----------------------------------------------------------------------------------------

-- Return why a capture has no message; nil if it has one.
local function explain_nothing_found(self, capture)
  local extended = capture.extended
  if self.has_messages then return nil end
  if extended > 0 then
    local text = "no YAPP message found; %s not dissected: see yapp.motor_ids, yapp.all_extended"
    local frames = output.count(extended, "extended CAN frame")
    return text:format(frames .. (extended == 1 and " was" or " were"))
  end
  if self.packets == 0 then
    return "no YAPP message found: the capture has no packets, or -R removed all of them"
  end
  local packets = output.count(self.packets, "packet")
  if capture.can > 0 and capture.can == self.packets then
    return ("no YAPP message found in %s: no CAN data frame has a 29-bit id"):format(packets)
  end
  local options = table.concat(capture.options or {}, " or ")
  local advice = options ~= "" and "try " .. options or "see " .. SEARCH_PREFERENCES
  return ("no YAPP message found in %s: %s"):format(packets, advice)
end

-- Return the traces of YAPP in other packets: a list of texts.
local function list_undecoded(self, capture)
  if not (capture.certain and capture.certain[1]) then return {} end
  if not self.has_messages then return { "the capture has YAPP that was not decoded" } end
  return { "YAPP in other packets was not decoded: try " .. table.concat(capture.certain, " ") }
end

-- Return why times of packets mean nothing; nil if they mean something.
local function explain_times(self, capture)
  if capture.lacks_times then return NO_TIMES end
  return self.packets > 1 and not self.has_progress and EQUAL_TIMES or nil
end

--- End the packets: events are handed on at once.
function Queue:end_packets()
  deliver_waiting(self)
  self.is_direct = true
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

--- End: all packets have come.
-- capture  { unfinished = events of the messages that it ends before, drops = of capture.capture,
--          options = list of tshark's options that may decode other packets, or nil; certain =
--          those of them that certainly decode YAPP; notes = list of texts to say besides, or nil;
--          lacks_times = true if packets have no time stamps, extended = number of extended CAN
--          frames that were not dissected, can = number of all such CAN frames, problems = list of
--          texts: why not all was read, unread = the same in short if
--          packets were left out, nil if none }
-- returns  the exit code, and a list of texts to say
function Queue:finish(capture)
  deliver_waiting(self)
  for _, event in ipairs(capture.unread and {} or capture.unfinished) do
    deliver(self, event)
  end
  local seconds, nanoseconds = self.dates:exact(0)
  local ending = {
    rel = self.last, -- of the last packet of any kind, nil where there was none
    now = self.last and self.now,
    begin = seconds + nanoseconds / 1e9, -- of the first packet
    reason = explain_nothing_found(self, capture), -- why no message was found, nil if one was
    lacks_times = explain_times(self, capture),
    -- Wishes of the user that were not met, and why not all was read: texts.
    problems = joined(self.settings.problems, capture.problems, list_undecoded(self, capture)),
    unread = capture.unread, -- the same in short if packets were left out
    drops = capture.drops,
    undissected = self.undissected,
    hint = self.hint,
  }
  local code, texts = output.EXIT_OK, {}
  for _, deriver in ipairs(self.derivers) do
    local worse, text, notes = deriver:finish(ending)
    if worse and (code == output.EXIT_OK or worse < code) then code = worse end
    texts = joined(texts, { text }, notes)
  end
  return code, without_repeats(joined(texts, capture.notes))
end

return M
