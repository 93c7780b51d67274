-- SPDX-License-Identifier: GPL-2.0-or-later
-- Derives events from messages: faults, reboots, silences and other changes, and messages that were
-- not decoded.  At the end: faults that are still active, and sources that never came.  Pure Lua,
-- 5.2 to 5.5.

local band = require("yapp.base.bits").band
local kinds = require("yapp.stat.kinds")
local output = require("yapp.stat.output")
local undecoded = require("yapp.stat.undecoded")

local M = {}

local new_event, span, NOTHING = kinds.event, kinds.span, kinds.NOTHING
-- The kinds of events that are changes of message.history.
local CHANGES = {}
for _, row in ipairs(kinds.LIST) do
  if row.change then CHANGES[#CHANGES + 1] = row end
end
-- The kinds of events that may hide a fault: damaged and lost messages.
local HIDING = {
  { "crc", "with a bad CRC" },
  { "incomplete", "incomplete" },
  { "unfinished", "cut off by the end of the capture" },
  { "missing", "missing by Seq No" },
}
local LEFT_OUT = "changes of faults, reboots and gaps are unreliable and left out"
local UNRELIABLE = "nothing tells the buses of %s apart: " .. LEFT_OUT
local SHARED = "two controllers appear to send %s: from frame %d on " .. LEFT_OUT

local Deriver = {}
Deriver.__index = Deriver

--- Make what derives events for one statistic.
-- settings   see stat.taps
-- statistic  see stat.queue
function M.new(settings, statistic)
  return setmetatable({
    settings = settings,
    statistic = statistic,
    undecoded = undecoded.new(settings),
    states = {}, -- of sources with good messages, in their order, and by source
    by_source = {},
    came = {}, -- sources with an event that counts
    counts = {}, -- of events, by kind, of sources that can report faults
    doubts = {}, -- texts: why the history of a source is unreliable; and by source
  }, Deriver)
end

--- Hand an event to the statistic.
-- now    seconds of the capture, see stat.queue
-- cause  the event of the message that shows it
function Deriver:add(event, now, cause)
  if self.statistic.wants_messages_only and event.kind ~= "message" and event.kind ~= "crc" then
    return
  end
  local message, counts = event.source.message, self.counts
  if message and message.alarms[1] then
    counts[event.kind] = (counts[event.kind] or 0) + (event.values.count or 1)
  end
  self.statistic:event(event, now, cause or event)
end

--- Return a text: how many damaged or lost messages may have had a fault; nil for none.
function Deriver:hiding()
  local texts = {}
  for _, row in ipairs(HIDING) do
    local count = self.counts[row[1]]
    if count then texts[#texts + 1] = ("%d %s"):format(count, row[2]) end
  end
  local text = "damaged or lost messages may hide faults: %s"
  return texts[1] and text:format(table.concat(texts, ", "))
end

local function emit(self, kind, cause, now, values)
  self:add(new_event(kind, cause.frame, cause.time, cause.source, values), now, cause)
end

-- Faults ------------------------------------------------------------------------------------------

local function emit_fault(self, cause, now, fault, name)
  local active = output.seconds(name ~= "raised" and span(fault.since, now))
  emit(self, "fault", cause, now, {
    field = fault.field,
    flag = fault.flag,
    help = fault.help,
    event = name,
    active = active,
    after = active and (" after %s s"):format(active.short),
  })
end

-- Return the flags of a field that are faults, with those that no table defines.
local function faults_of(field)
  local list = {}
  for _, flag in ipairs(field.flags) do
    if band(flag.mask, field.alarm_bits) ~= 0 then list[#list + 1] = flag end
  end
  local undefined = band(field.undefined, field.alarm_bits)
  for bit = 0, 31 do
    local mask = 2 ^ bit
    if band(undefined, mask) ~= 0 then
      list[#list + 1] = { name = ("undefined_0x%x"):format(mask), mask = mask }
    end
  end
  return list
end

-- Keeps that a fault rose or fell.  Make a new list: state.counted_faults may be the old one.
local function note_fault(self, state, cause, now, fault, is_set)
  local faults = {}
  for _, one in ipairs(state.faults) do
    if one.field == fault.field and one.flag == fault.flag then
      fault.since = one.since
    else
      faults[#faults + 1] = one
    end
  end
  if is_set then
    fault.since, faults[#faults + 1] = now, fault
  end
  state.faults = faults
  if state.counts then
    emit_fault(self, cause, now, fault, is_set and "raised" or "cleared")
  end
end

-- Note the faults that rise or fall with a change of a flags field.
local function note_faults(self, state, cause, now, change)
  local before = change.value - change.raised + change.cleared
  for _, flag in ipairs(faults_of(change.field)) do
    local is_set = band(change.value, flag.mask) ~= 0
    if is_set ~= (band(before, flag.mask) ~= 0) then
      local fault = { field = change.field.name, flag = flag.name, help = flag.help }
      note_fault(self, state, cause, now, fault, is_set)
    end
  end
end

-- Messages ----------------------------------------------------------------------------------------

local function values_of(row, value)
  if row.change == true then return NOTHING end
  return { [row.change] = row.change == "length" and output.seconds(value) or value }
end

-- Emit the events of a message that counts, but for its faults.
local function note_events(self, event, now, change)
  for _, row in ipairs(CHANGES) do
    local value = change[row.name]
    if value then emit(self, row.name, event, now, values_of(row, value)) end
  end
  for _, values in ipairs(event.values.invalid or NOTHING) do
    emit(self, "invalid", event, now, values)
  end
  local source, doubts = event.source, self.doubts
  if event.values.is_unreliable and not doubts[source] then
    local shape = change.shared and SHARED or UNRELIABLE
    doubts[source], doubts[#doubts + 1] = true, shape:format(output.place(source), event.frame)
  end
end

-- The state of a source: last = its latest message, at = its time, counts = whether it counts;
-- faults = those that are set, in the order in which they rose, { field, flag, help, since } each;
-- counted_faults = those that were set at counted, the latest reliable message that counts, at
-- counted_at.
local function state_of(self, source)
  local state = self.by_source[source]
  if not state then
    state = {
      last = nil,
      at = nil,
      counts = false,
      faults = NOTHING,
      counted_faults = NOTHING,
      counted = { frame = 0 },
      counted_at = nil,
    }
    self.by_source[source], self.states[#self.states + 1] = state, state
  end
  return state
end

local function note_message(self, event, now, counts)
  local state, values = state_of(self, event.source), event.values
  local change = values.change or NOTHING
  if change.late and state.counts then
    emit(self, "silence", state.last, state.at, { length = output.seconds(change.late) })
  end
  state.last, state.at, state.counts = event, now, counts
  if counts and values ~= NOTHING then note_events(self, event, now, change) end
  for _, flags in ipairs(change.flags or NOTHING) do
    note_faults(self, state, event, now, flags)
  end
  if counts and not values.is_unreliable then
    state.counted, state.counted_at, state.counted_faults = event, now, state.faults
  end
end

--- Take an event, in the order of the capture.
-- now     seconds of the capture, see stat.queue
-- counts  whether the filter of the statistic lets it count; other events still update the states
function Deriver:take(event, now, counts)
  local is_message = event.kind == "message"
  if counts then
    self.came[event.source] = true
    local rest = event.values.undecoded
    if is_message and (rest or not event.raws) then
      local values = self.undecoded:note(event.source, #event.payload, rest)
      emit(self, "unknown", event, now, values)
    end
  end
  if is_message and not self.statistic.wants_messages_only then
    note_message(self, event, now, counts)
  end
  if counts then self:add(event, now) end
end

--- Take what may be a message that is not dissected.
-- is_sure  whether other messages came: then it is an `unknown` event
function Deriver:take_undissected(event, is_sure)
  local values = self.undecoded:note(event.source, event.values.size)
  if is_sure then emit(self, "unknown", event, event.time, values) end
end

-- The end -----------------------------------------------------------------------------------------

-- Silences that last to the end of the capture.
local function end_silences(self, ending)
  for _, state in ipairs(self.states) do
    local event = state.last
    local message = event.source.message
    local length = span(state.at, ending.now)
    local is_silent = message and message.every and length > self.settings.late * message.every
    if is_silent and state.counts and not event.values.is_unreliable then
      local values = { length = output.seconds(length), is_last = true }
      emit(self, "silence", event, state.at, values)
    end
  end
end

-- The faults that are still set at the last message of their source that counts.
local function end_faults(self)
  output.sort(self.states, function(state) return state.counted.frame, 0 end)
  for _, state in ipairs(self.states) do
    for _, fault in ipairs(state.counted_faults) do
      emit_fault(self, state.counted, state.counted_at, fault, "active")
    end
  end
end

local function has_come(self, row)
  for source in pairs(self.came) do
    local is_there = not row.bus or row.bus == source.bus
    if is_there and source.id == row.id and source.name == row.name then
      return true
    end
  end
  return false
end

local function end_absences(self, ending)
  for _, row in ipairs(self.settings.sources:list()) do
    if row.message and not has_come(self, row) then
      self:add(new_event("absent", nil, ending.rel, row))
    end
  end
end

-- The packets that were lost while capturing.
local function end_drops(self, ending)
  local first = ending.first
  local begin = first.seconds + first.nanoseconds / 1e9 - first.rel
  for _, drop in ipairs(ending.drops) do
    local microseconds = drop.time and math.floor((drop.time - begin) * 1e6 + 0.5)
    local time, values = microseconds and microseconds / 1e6, { count = drop.count }
    self:add(new_event("dropped", drop.frame, time, { bus = drop.bus }, values))
  end
end

--- End: all events have come.
-- ending  see stat.queue
function Deriver:finish(ending)
  if ending.now then end_silences(self, ending) end
  end_faults(self)
  end_absences(self, ending)
  end_drops(self, ending)
end

return M
