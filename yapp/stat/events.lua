-- SPDX-License-Identifier: GPL-2.0-or-later
-- A result of the reading becomes events; and what follows from the events of a source: faults,
-- reboots, silences and other changes.  Pure Lua, 5.2 to 5.5.
--
-- The values of a good message's event are the message, see Reading:read_message.

local END = require("yapp.wire.can_id").END
local buses = require "yapp.stat.buses"
local clock_of = require("yapp.message.history").clock_of
local compiler = require "yapp.message.catalogue"
local field_kinds = require "yapp.message.field_kinds"
local kinds = require "yapp.stat.kinds"
local mapped = require "yapp.base.mapped"
local memo = require "yapp.base.memo"
local number_of = require("yapp.base.frame_key").number
local output = require "yapp.stat.output"
local records = require "yapp.reading.records"

local Events = {}
Events.__index = Events

local new_event, new_follower = kinds.new_event, kinds.new_follower
local span, NOTHING = kinds.span, kinds.NOTHING
local MAX_GAP = 1.5 -- periods; a longer gap has room for another message

-- What an anomaly loses, by its expert item.
local LOSSES = {
  ["fragment.incomplete"] = "incomplete",
  ["fragment.orphan"] = "orphan",
  ["fragment.overrun"] = "overrun",
}

-- From a result to events ------------------------------------------------------------------------

local function append(list, kind, frame, values, message)
  list[#list + 1] = new_event(kind, frame.number, frame.time, frame.source, values, message)
end

local function append_message(list, frame, message)
  local kind = records.STATUSES[message.status].kind
  if message.copy_of then
    append(list, "copies", frame, { of = message.copy_of }, message)
  elseif kind == "message" then
    append(list, kind, frame, message, message)
  elseif kind then
    append(list, kind, frame, kind == "incomplete" and { what = kind } or nil, message)
  end
end

--- Append the events of a result to a list.
-- result  see reading.records
function Events.append(list, result)
  local kind, frame = result.kind, result.frame
  if result.message then
    append_message(list, frame, result.message)
  elseif kind == "bus_errors" then
    append(list, kind, frame, { reports = result.reports })
  elseif result.values then
    append(list, kind, frame, result.values, frame)
  end
  for _, anomaly in ipairs(result.anomalies or NOTHING) do
    local what = LOSSES[anomaly.expert]
    if what then
      local is_end = frame.can_id and frame.can_id.ctrl == END
      append(list, "incomplete", frame, { what = what, is_end = is_end }, frame)
    end
  end
end

-- The events of a source -------------------------------------------------------------------------

-- The state of a source, or of a line.
local function new_state(source)
  return {
    source = source,
    every = source.type and source.type.every,
    last = nil, -- event of its latest good message
    faults = NOTHING, -- list of those that are set, as they rose, see message.faults
    is_numbered = false, -- true if Seq No numbers its messages: it changed
    room = 0, -- number of messages that have room in the gaps between its messages
    room_at_end = 0, -- the same behind the last one
    room_silent = 0, -- how many of both are in silences
    orphan_seq = nil, -- of a message whose Start is lost, while its frames come
    unknown_seq = nil, -- the latest, see add_undissected
    disabled = nil, -- of a Command: the latest such event, until motors are enabled again
    stretch = nil, -- of a line: values of its skipped bytes, while nothing else comes
  }
end

--- Make the events of one run over a capture.
-- settings  see stat.taps
-- hand_on   function(event), called for each event in the order of the capture
function Events.new(settings, hand_on)
  local states = {}
  return setmetatable({
    settings = settings,
    hand_on = hand_on,
    add_bus_error = buses.new_errors(hand_on),
    states = states, -- in the order in which they came
    by_source = memo(new_state, states),
    has_messages = false, -- true if an event of an ID came
    undissected = {}, -- events of frames that are messages if other messages came
  }, Events)
end

-- Hand on what follows from a message, its cause.
local function emit(self, kind, cause, values)
  self.hand_on(new_follower(kind, cause, values))
end

-- Return how many messages have room in a gap, in seconds, between two that come every so often.
local function room_in(length, every)
  local periods = length / every
  return periods > MAX_GAP and math.floor(periods - 0.5) or 0
end

--- Return the event of a fault.
-- event  of the message; what: "raised", "cleared" or "active"
function Events.fault_event(event, fault, what)
  local flag, active = fault.flag, nil
  if what ~= "raised" then
    local length = span(fault.time, event.at)
    -- Equal stamps of two packets tell nothing.
    local is_known = length > 0 or number_of(fault.key) == event.frame
    active = is_known and output.seconds(length) or nil
  end
  return new_follower("fault", event, {
    field = fault.field,
    flag = flag.name,
    help = flag.help,
    event = what,
    incident = fault.incident,
    active = active,
    after = active and (" after %s s"):format(active.short),
  })
end

local function add_changes(self, event, change)
  for _, row in ipairs(kinds.CHANGES) do
    local key, value = row.change, change[row.name]
    if value then
      value = key == "length" and output.seconds(value) or value
      emit(self, row.name, event, { [key] = value })
    end
  end
  for _, step in ipairs(change.faults or NOTHING) do
    self.hand_on(Events.fault_event(event, step.fault, step.is_raised and "raised" or "cleared"))
  end
end

-- Commands ----------------------------------------------------------------------------------------

-- The event `disabled` is handed on at once; its values change when motors are enabled again.
local function add_command(self, state, event, change)
  local disabled, turning = state.disabled, change.disabled
  if change.enabled and disabled then
    local length = span(disabled.at, event.at)
    -- Equal stamps tell nothing.
    local seconds = length > 0 and output.seconds(length) or nil
    disabled.values.length = seconds
    disabled.values.rest = seconds and ("enabled again after %s s"):format(seconds.short) or ""
    state.disabled = nil
  end
  if not turning then return end
  local names = mapped(turning, function(source) return output.row(source, {}).who end)
  output.sort(names, output.sortable)
  local values = { motors = table.concat(names, ", "), rest = "never enabled again" }
  state.disabled = new_follower("disabled", event, values)
  self.hand_on(state.disabled)
end

-- Add the values that the catalogue does not define.
local function add_invalid(self, event)
  for _, remark in ipairs(event.values.remarks) do
    local index, expert, is_undefined = remark[1], remark[2], remark[3]
    if is_undefined then
      local field, raw = event.source.type.fields[index], event.raws[index]
      local shape = field_kinds.BY_NAME[field.kind].code or "0x%02x" -- as the document has it
      emit(self, "invalid", event, {
        field = field.name,
        value = raw,
        code = shape:format(raw),
        effect = expert == "command.key.invalid" and ", so it was ignored",
      })
    end
  end
end

-- Account for the time between two messages of a source: has it room for others, is it a silence?
local function add_span(self, state, last, event, change)
  local every, length = state.every, span(last.at, event.at)
  local room, late = 0, change.late
  if change.may_be_late and length > self.settings.late * every then late = length end
  if length == 0 or length > MAX_GAP * every then
    -- The controller's clock has the gap, unless that was set.
    local before, now = clock_of(last), clock_of(event)
    local is_even = before and now and now > before and not change.jump
    room = room_in(is_even and (now - before) / 1e9 or length, every)
  end
  state.room = state.room + room
  if not late then return end
  state.room_silent = state.room_silent + room
  emit(self, "silence", last, { length = output.seconds(late) })
end

local function add_message(self, state, event)
  local last, values = state.last, event.values
  local change = values.change or NOTHING
  state.last = event
  if change.faults then state.faults = change.faults.set end
  if state.faults[1] then event.faults = state.faults end
  if last then
    if event.seq ~= last.seq then state.is_numbered = true end
    if state.every and not values.is_unreliable then add_span(self, state, last, event, change) end
  end
  self.hand_on(event)
  if event.raws then add_invalid(self, event) end
  add_command(self, state, event, change)
  if change ~= NOTHING then add_changes(self, event, change) end
end

-- Losses ------------------------------------------------------------------------------------------

-- The orphans in a row with one Seq No, up to an End, are one lost message.
local function add_loss(self, state, event)
  local seq, values = state.orphan_seq, event.values
  local is_orphan = values.what == "orphan"
  state.orphan_seq = is_orphan and not values.is_end and event.seq or nil
  if not (is_orphan and seq == event.seq) then self.hand_on(event) end
end

-- Bytes of a stream that belong to no frame.  Over several packets in a row they are one stretch,
-- and one event, whose length grows.
local function add_skipped(self, state, event)
  local stretch = state.stretch
  if stretch then
    stretch.length = stretch.length + event.values.length
    return
  end
  state.stretch = event.values
  self.hand_on(event)
end

-- A frame that may be a message that is not dissected, or the Start of one.  It counts as one if
-- its ID is known, if a message of the catalogue has its size, or if its Seq No follows that of the
-- source's previous such frame.
local function add_undissected(self, state, event)
  local seq, messages = state.unknown_seq, self.settings.catalogue.messages
  state.unknown_seq = event.seq
  local is_next = seq and (seq + 1) % 256 == event.seq
  if is_next or event.source.type or compiler.of_size(messages, event.values.size)[1] then
    table.insert(self.undissected, event)
  end
end

--- Add an event of Events.append, in the order of the capture.
function Events:add(event)
  local source, kind = event.source, event.kind
  if kind == "bus_errors" then return self.add_bus_error(event) end
  local state = self.by_source[source]
  if kind == "skipped" then return add_skipped(self, state, event) end
  if kind == "undissected" then return add_undissected(self, state, event) end
  if source.id then self.has_messages = true end
  if source.skipped then self.by_source[source.skipped].stretch = nil end
  if kind == "incomplete" then return add_loss(self, state, event) end
  state.orphan_seq = nil
  if kind == "message" then return add_message(self, state, event) end
  self.hand_on(event)
end

-- The end -----------------------------------------------------------------------------------------

-- Account for the time from the last message of a source to the end of the capture.
local function finish_source(self, state, last, length)
  state.room_at_end = room_in(length, state.every)
  if length <= self.settings.late * state.every then return end
  state.room_silent = state.room_silent + state.room_at_end
  emit(self, "silence", last, { length = output.seconds(length), is_last = true })
end

--- End: hand on what only the end shows.
-- length_since  function(event) -> seconds from a message to the capture's end
-- has_times     true if lengths mean something
function Events:finish(length_since, has_times)
  for _, state in ipairs(self.states) do
    local last = state.last
    if not (has_times or last and clock_of(last)) then state.room = 0 end
    if last and state.every and not last.values.is_unreliable then
      finish_source(self, state, last, length_since(last))
    end
  end
end

return Events
