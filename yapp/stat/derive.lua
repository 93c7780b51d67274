-- SPDX-License-Identifier: GPL-2.0-or-later
-- Feeds one statistic with the events that its filter lets count.  Derives events from messages:
-- faults, reboots, silences and other changes, and messages that were not decoded.  At the end:
-- faults that are still active, and sources that never came.  Pure Lua, 5.2 to 5.5.
--
-- A statistic has
--   add_event(event, now, cause)  of each event that counts: now = seconds without the steps back
--                        of the capture's clock; cause = the event of the message that shows it
--   finish(ending, notes, states)  returns the exit code and a text, each nil for none: ending =
--                        see Queue:finish; notes = texts on all that its answer leaves out;
--                        states = by source, see new_state
--   follows_changes      true if it shows changes since the message before
--   lists_problems       true if it lists ending.problems itself
--   wants_messages_only  true if it needs no events but good messages and those with a bad CRC

local frame_key = require "yapp.base.frame_key"
local joined = require "yapp.base.joined"
local kinds = require "yapp.stat.kinds"
local memo = require "yapp.base.memo"
local output = require "yapp.stat.output"
local undecoded = require "yapp.stat.undecoded"

local M = {}

local new_event, span, NOTHING = kinds.new_event, kinds.span, kinds.NOTHING
local MAX_HELD = 64 -- events of a source, more than there are until it shows that it is shared
local MAX_GAP = 1.5 -- periods; a longer gap has room for another message
local NO_SPANS = "how long faults, gaps and silences lasted is not known, " ..
  "and a message that was recorded twice counts twice"
local EQUAL_STAMPS = "time stamps of %s stand still: " .. NO_SPANS
local LEFT_OUT = "changes of faults, reboots and gaps are unreliable and left out"
local UNRELIABLE = "nothing tells the buses of %s apart: " .. LEFT_OUT
local SHARED = "two controllers appear to send %s: from frame %d on " .. LEFT_OUT
local SHARED_BEFORE = "; its reboots, jumps and silences are left out from frame %d on"

local Deriver = {}
Deriver.__index = Deriver

-- The state of a source with good messages.
local function new_state()
  return {
    last = nil, -- its latest message
    last_at = nil, -- when that came, by the stamps of its source
    ahead = 0, -- seconds that the capture's clock was ahead then
    is_counted = false, -- true if that counts
    faults = NOTHING, -- list of those that are set, as they rose, see message.faults
    counted = { frame = 0 }, -- the latest reliable message that counts
    counted_at = nil,
    counted_faults = NOTHING, -- the faults that were set then
    held = nil, -- list of events that a `shared` may explain, see hold
    is_numbered = false, -- true if Seq No numbers its messages: it changed
    missing_by_period = 0, -- number of messages that fit into the gaps between them: if counted
  }
end

--- Make the deriver of a statistic.
-- settings  see stat.taps
-- options   of stat.options
function M.new(settings, statistic, options)
  local states = {}
  return setmetatable({
    statistic = statistic,
    -- A set of the numbers of packets that the filter lets count, nil without one: a tap fills it.
    -- It keeps all packets, as only the end shows which messages are unfinished.
    matched = options.filter and {},
    settings = settings,
    options = options,
    undecoded = undecoded.new(settings),
    states = states, -- of sources with good messages, in their order, and by source
    by_source = memo(new_state, states),
    -- By fault, until the message counts that clears it:
    raised_at = {}, -- when it rose, see above
    raised_in = {}, -- number of the packet
    equal_stamps = {}, -- texts: the sources whose stamps stand still; and by source
    came = {}, -- sources with an event that counts
    copies = 0, -- number of messages that were recorded once more, or several times
    originals = {}, -- [source] = frame key of the latest of them
    -- By kind of event, where a fault may be hidden; false if the statistic needs no note on that.
    counts = (options.looks_for_faults or options.row.looks_for_faults) and {} or false,
    unreliable_notes = {}, -- texts: why the history of a source is unreliable; and by source
    now = nil, -- seconds of the capture, see above
  }, Deriver)
end

-- Return whether a message of a source may have a fault: an unknown message may.
local function may_have_faults(source)
  return not source.type or source.type.alarms[1] ~= nil
end

--- Hand an event to the statistic.
-- cause  the event of the message that shows it
function Deriver:add(event, cause)
  if self.statistic.wants_messages_only and event.kind ~= "message" and event.kind ~= "crc" then
    return
  end
  local counts = self.counts
  if counts and may_have_faults(event.source) then
    counts[event.kind] = (counts[event.kind] or 0) + (event.values.count or 1)
  end
  self.statistic:add_event(event, self.now, cause or event)
end

local function emit(self, kind, cause, values)
  local event = new_event(kind, cause.frame, cause.time, cause.source, values)
  event.rel = cause.rel
  self:add(event, cause)
end

-- Return whether the filter lets an event count.
local function is_matched(self, event)
  return not self.matched or self.matched[event.frame]
end

-- Faults ------------------------------------------------------------------------------------------

-- Return how long a fault was set; nil if the stamps of its messages are equal.
-- cause  the event of the latest message
local function active_time(self, cause, fault, till)
  -- A step back of less than a millisecond is none, see stat.queue.
  local active = math.max(0, span(self.raised_at[fault] or till, till))
  local source, notes = cause.source, self.equal_stamps
  if active > 0 or self.raised_in[fault] == cause.frame then return output.seconds(active) end
  if not notes[source] then
    notes[source] = true
    notes[#notes + 1] = EQUAL_STAMPS:format(output.bus_and_id(source))
  end
end

-- event  "raised", "cleared", or "active" at the end
local function emit_fault(self, cause, fault, event)
  local flag, active = fault.flag, nil
  if event ~= "raised" then
    local till = event == "cleared" and self.now or self.by_source[cause.source].counted_at
    active = active_time(self, cause, fault, till)
  end
  emit(self, "fault", cause, {
    field = fault.field,
    flag = flag.name,
    help = flag.help,
    event = event,
    incident = fault.incident,
    active = active,
    after = active and (" after %s s"):format(active.short),
  })
end

-- Emit the faults that rise or fall with a message.
local function emit_faults(self, state, cause, faults)
  state.faults = faults.set
  for _, step in ipairs(faults) do
    local fault, is_raised = step.fault, step.is_raised
    if is_raised then self.raised_at[fault], self.raised_in[fault] = self.now, cause.frame end
    if state.is_counted then
      emit_fault(self, cause, fault, is_raised and "raised" or "cleared")
      if not is_raised then self.raised_at[fault], self.raised_in[fault] = nil, nil end
    end
  end
end

-- Messages ----------------------------------------------------------------------------------------

-- Emit an event, or hold it until it shows that no `shared` explains it.
-- event  of the message that shows it
-- cause  of the message to name
local function emit_or_hold(self, state, event, kind, cause, values)
  if not kinds.BY_NAME[kind].is_doubtful then return emit(self, kind, cause, values) end
  local held = state.held or {}
  state.held = held
  held[#held + 1] = { kind = kind, frame = event.frame, cause = cause, values = values }
  if #held <= MAX_HELD then return end
  local oldest = table.remove(held, 1)
  emit(self, oldest.kind, oldest.cause, oldest.values)
end

-- Emit the events that are held, unless a `shared` explains them.
-- since  number of the first packet that it explains, nil for none
local function emit_held(self, state, since)
  for _, one in ipairs(state.held or NOTHING) do
    if one.frame < (since or math.huge) then emit(self, one.kind, one.cause, one.values) end
  end
  state.held = nil
end

-- Add the note on an unreliable history, once for a source.
-- shared  of its change, see message.history
local function add_unreliable_note(self, event, shared)
  local source, notes = event.source, self.unreliable_notes
  if notes[source] then return end
  local text = (shared and SHARED or UNRELIABLE):format(output.bus_and_id(source), event.frame)
  local since = shared and frame_key.number(shared) or event.frame
  if since < event.frame then text = text .. SHARED_BEFORE:format(since) end
  notes[source] = true
  notes[#notes + 1] = text
end

-- Emit the events of a message that counts, but for its faults.
local function emit_changes(self, state, event, change)
  for _, row in ipairs(kinds.LIST) do
    local key, value = row.change, change[row.name]
    if key and value then
      value = key == "length" and output.seconds(value) or value
      emit_or_hold(self, state, event, row.name, event, { [key] = value })
    end
  end
  for _, values in ipairs(event.values.invalid or NOTHING) do
    emit(self, "invalid", event, values)
  end
  if event.values.is_unreliable then add_unreliable_note(self, event, change.shared) end
end

-- Return how many messages of a source fit between two times.
local function count_missing(state, from, to)
  local of_type = state.last.source.type
  if not (of_type and of_type.every) then return 0 end
  local periods = span(from, to) / of_type.every
  return periods > MAX_GAP and math.floor(periods - 0.5) or 0
end

-- Emit the events before a message that it shows: a silence, or a source that two controllers
-- share.
local function emit_earlier(self, state, event, change)
  if change.shared then emit_held(self, state, frame_key.number(change.shared)) end
  if change.late and state.is_counted then
    local values = { length = output.seconds(change.late) }
    emit_or_hold(self, state, event, "silence", state.last, values)
  end
end

local function update_state(self, event, is_counted, capture_now)
  local state, values = self.by_source[event.source], event.values
  local change = values.change or NOTHING
  if self.counts and state.is_counted and not values.is_unreliable then
    local missing = count_missing(state, state.last_at, self.now)
    state.missing_by_period = state.missing_by_period + missing
  end
  if change ~= NOTHING then emit_earlier(self, state, event, change) end
  state.last, state.last_at, state.is_counted = event, self.now, is_counted
  state.ahead = capture_now - self.now
  if is_counted and values ~= NOTHING then emit_changes(self, state, event, change) end
  if change.faults then emit_faults(self, state, event, change.faults) end
  if is_counted and not values.is_unreliable then
    state.is_numbered = state.is_numbered or event.seq ~= (state.counted.seq or event.seq)
    state.counted, state.counted_at, state.counted_faults = event, self.now, state.faults
  end
end

-- Count a message that has copies, once for all of them.
local function count_copy(self, event)
  local source, original = event.source, event.values.of
  if self.originals[source] ~= original then self.copies = self.copies + 1 end
  self.originals[source] = original
end

--- Derive events from one, in the order of the capture.  If the filter does not let it count, it
-- still updates the states.
-- now          seconds of the capture, see above
-- capture_now  the same by the stamps of all sources, which may be those of another recorder
function Deriver:derive(event, now, capture_now)
  local is_counted, is_message = is_matched(self, event), event.kind == "message"
  self.now = now
  if is_counted then
    self.came[event.source] = true
    if event.kind == "copies" then count_copy(self, event) end
    local size = is_message and event.values.size
    if size then
      local rest = event.values.undecoded
      emit(self, "unknown", event, self.undecoded:count(event.source, size, rest))
    end
  end
  if is_message and not self.statistic.wants_messages_only then
    update_state(self, event, is_counted, capture_now)
  end
  if is_counted then self:add(event) end
end

-- The end -----------------------------------------------------------------------------------------

-- Possible messages that are not dissected.  If other messages came, they are `unknown` events.
local function emit_undissected(self, ending)
  for _, event in ipairs(ending.undissected) do
    if is_matched(self, event) then
      local values = self.undecoded:count(event.source, event.values.size)
      if not ending.reason then emit(self, "unknown", event, values) end
    end
  end
end

-- Silences that last to the end of the capture.
local function emit_last_silences(self, ending)
  for _, state in ipairs(self.states) do
    local event = state.last
    local of_type = event.source.type
    local length = span(state.last_at + state.ahead, ending.now)
    local is_silent = of_type and of_type.every and length > self.settings.late * of_type.every
    if is_silent and state.is_counted and not event.values.is_unreliable then
      local values = { length = output.seconds(length), is_last = true }
      emit(self, "silence", event, values)
    end
  end
end

-- The faults that are still set at the last message of their source that counts.
local function emit_active_faults(self)
  output.sort(self.states, function(state) return state.counted.frame end)
  for _, state in ipairs(self.states) do
    for _, fault in ipairs(state.counted_faults) do
      emit_fault(self, state.counted, fault, "active")
    end
  end
end

local function emit_absences(self, ending)
  for _, row in ipairs(self.settings.sources:list()) do
    local is_absent = row.type
    for source in pairs(self.came) do
      local is_there = not row.bus or row.bus == source.bus
      if is_there and source.id == row.id and source.name == (row.name or source.name) then
        is_absent = false
      end
    end
    if is_absent then
      local event = new_event("absent", nil, ending.rel, row)
      event.rel = ending.now
      self:add(event)
    end
  end
end

-- The packets that were lost while capturing.
local function emit_drops(self, ending)
  for _, drop in ipairs(ending.drops) do
    local time = drop.time and math.floor((drop.time - ending.begin) * 1e6 + 0.5) / 1e6
    local values = { count = drop.count }
    self:add(new_event("dropped", drop.frame, time, { bus = drop.bus }, values))
  end
end

-- Return a text: how many damaged or lost messages may have had a fault; nil for none.
local function hidden_faults_text(self, now)
  local texts, missing = {}, 0
  for _, state in ipairs(self.states) do
    if may_have_faults(state.last.source) then
      if not state.is_numbered then missing = missing + state.missing_by_period end
      local has_end = state.is_counted and not state.last.values.is_unreliable
      local last_at = state.last_at + state.ahead
      if has_end then missing = missing + count_missing(state, last_at, now) end
    end
  end
  for _, row in ipairs(kinds.LIST) do
    local count = row.hides and self.counts[row.name]
    if count then texts[#texts + 1] = ("%d %s"):format(count, row.hides) end
  end
  if missing > 0 then texts[#texts + 1] = ("%d missing by their period"):format(missing) end
  return texts[1] and "damaged or lost messages may hide faults: " .. table.concat(texts, ", ")
end

-- Return how many messages were recorded twice, a text; nil for none.
local function copies_text(count)
  local shape = count == 1 and "%s was recorded twice; it counts once" or
    "%s were recorded twice; each counts once"
  return count > 0 and shape:format(output.count(count, "message")) or nil
end

-- Return the texts on all that the answer leaves out, and whether they make it undecided.
local function list_notes(self, ending)
  local reason, matched = ending.reason, self.matched
  if matched and not next(self.came) then reason = reason or "no message matches the filter" end
  local unreliable = self.statistic.follows_changes and self.unreliable_notes or NOTHING
  local problems = self.statistic.lists_problems and NOTHING or ending.problems
  local no_times = ending.lacks_times and ending.lacks_times .. ": " .. NO_SPANS
  local notes = joined(problems, { reason }, { no_times }, self.undecoded:texts(), unreliable)
  notes[#notes + 1] = copies_text(self.copies)
  if not no_times then notes = joined(notes, self.equal_stamps) end
  if self.counts then notes[#notes + 1] = hidden_faults_text(self, ending.now) end
  if not matched then notes[#notes + 1] = ending.hint end
  return notes, ending.problems[1] ~= nil or unreliable[1] ~= nil
end

--- End: all events have come.
-- ending   see Queue:finish
-- returns  the exit code, nil for 0; a text to say, or nil; and a list of texts to say
function Deriver:finish(ending)
  for _, state in ipairs(self.states) do emit_held(self, state) end
  emit_undissected(self, ending)
  emit_last_silences(self, ending)
  emit_active_faults(self)
  emit_absences(self, ending)
  emit_drops(self, ending)
  local notes, is_undecided = list_notes(self, ending)
  local code, text = self.statistic:finish(ending, notes, self.by_source)
  if is_undecided then return code or output.EXIT_UNDECIDED, text, notes end
  local has_no_notes = self.options.json or self.options.row.table_only
  return code, text, has_no_notes and notes or NOTHING
end

return M
