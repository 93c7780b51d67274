-- SPDX-License-Identifier: GPL-2.0-or-later
-- The history of each source: what changed between a good message and the good one before it.  Pure
-- Lua.
--
-- A source is a bus or stream, and an ID.  What changed is worked out once, in the order of the
-- capture, and kept as events, so that a later look at any message gets the same: memory grows with
-- events, Commands and reboots, not with messages.

local band = require("yapp.base.bits").band

local M = {}

local byte, floor = string.byte, math.floor

-- What a capture's times have; a difference of two of them has a little more or less.
local NANOSECOND = 1e-9
local NOTHING = {} -- how things stand before a source's first event

local History = {}
History.__index = History

--- The history of one pass over one capture.
-- options  { late = how many periods of its message a gap must exceed to be one (2.5),
--            catalogue = compiled: which messages others answer (without it, the one that is called
--            command) }
function M.new(options)
  options = options or {}
  local self = setmetatable({ late = options.late or 2.5, by_key = {} }, History)
  self.answered = { command = not options.catalogue or nil } -- [message name] = true
  self.commands = {} -- [bus or false][message name] = numbers of messages that others answer
  for _, message in ipairs(options.catalogue and options.catalogue.messages or {}) do
    if message.answers then self.answered[message.answers] = true end
  end
  return self
end

-- The places of the fields of flags of a message.
local function flags_of(message)
  local places = {}
  for i, field in ipairs(message.fields) do
    if field.kind == "flags" then places[#places + 1] = i end
  end
  return places
end

-- The numbers of a bus's messages of one name that others answer.
local function commands_of(self, bus, name)
  local by_name = self.commands[bus or false] or {}
  self.commands[bus or false] = by_name
  by_name[name] = by_name[name] or {}
  return by_name[name]
end

local function new_source(self, look)
  local message, bus = look.message, look.bus
  local source = {
    values = {}, -- of the flags of the previous good message, by index of field
    raised_at = {}, -- [index of a field with alarms] = { [bit] = when it was raised }
    clock = nil, -- the controller's, in the previous good message
    seq = nil,
    last_time = nil,
    numbers = {}, -- of the messages at which something happened, ascending
    events = {}, -- what happened: events[i] at numbers[i], see keep
    changes = {}, -- numbers of the messages that changed an alarm
    -- Of its message, which stays the same:
    flags = message and flags_of(message) or NOTHING,
    longest = message and message.every and self.late * message.every + NANOSECOND / 2 or math.huge,
    answered = nil, -- numbers of its bus's messages that it answers
    own = nil, -- numbers of its own, where others answer them
  }
  if message and message.answers then source.answered = commands_of(self, bus, message.answers) end
  if message and self.answered[message.name] then
    source.own = commands_of(self, bus, message.name)
  end
  return source
end

-- The place of the last of these ascending numbers that is not above `most`, 0 where none is.
local function last_until(numbers, most)
  local low, high = 0, #numbers
  if high == 0 or numbers[high] <= most then return high end
  while low < high do
    local middle = floor((low + high + 1) / 2)
    if numbers[middle] <= most then
      low = middle
    else
      high = middle - 1
    end
  end
  return low
end

-- The controller's clock in nanoseconds: an int64, little endian; exact up to 104 days (2^53 ns).
-- Nil where the message has none.
local function clock_of(look)
  local field = look.raws and look.message and look.message.time
  if not field then return nil end
  local at = field.offset + 1
  local a, b, c, d, e, f, g, h = byte(look.payload, at, at + 7)
  if not h then return nil end
  if h >= 0x80 then h = h - 0x100 end
  return a + b * 0x100 + c * 0x10000 + d * 0x1000000 +
    (e + f * 0x100 + g * 0x10000 + h * 0x1000000) * 0x100000000
end

-- Flags ------------------------------------------------------------------------------------------

-- Keeps when the bits of a mask were raised, nil for those that fell.
local function mark(times, mask, time)
  local bit = 1
  while bit <= mask do
    if mask % (2 * bit) >= bit then times[bit] = time end
    bit = bit * 2
  end
end

-- Since when the oldest alarm bit that is still set has been set.
local function oldest(raised_at)
  local since
  for _, times in pairs(raised_at) do
    for _, time in pairs(times) do
      if not since or time < since then since = time end
    end
  end
  return since
end

-- What changed in one field of flags; nil for nothing.  Of a source's first message the alarms
-- count as raised.
local function flag_change(field, before, now)
  before = before or now - band(now, field.alarm_bits)
  local both = band(before, now)
  local raised, cleared = band(now - both, field.watched), band(before - both, field.watched)
  if raised == 0 and cleared == 0 then return nil end
  return {
    field = field,
    value = now,
    raised = raised,
    cleared = cleared,
    alarm_raised = band(raised, field.alarm_bits),
    alarm_cleared = band(cleared, field.alarm_bits),
  }
end

-- Keeps when alarms were raised; returns whether any was, or fell.
local function mark_alarms(source, index, change, time)
  if change.alarm_raised + change.alarm_cleared == 0 then return false end
  local times = source.raised_at[index] or {}
  source.raised_at[index] = times
  mark(times, change.alarm_raised, time)
  mark(times, change.alarm_cleared, nil)
  return true
end

-- What changed in the flags of a good message, nil for nothing; and whether an alarm did.
local function flag_changes(source, look)
  local raws, values, changes, is_alarm = look.raws, source.values, nil, nil
  if not raws then return nil end
  local places = source.flags
  for i = 1, #places do
    local index = places[i]
    local now, before = raws[index], values[index]
    if now and now ~= before then
      values[index] = now
      local change = flag_change(look.message.fields[index], before, now)
      changes = changes or change and {}
      if change then changes[#changes + 1] = change end
      if change and mark_alarms(source, index, change, look.time) then is_alarm = true end
    end
  end
  return changes, is_alarm
end

-- Following --------------------------------------------------------------------------------------

-- How many messages are missing before one by their Seq, which numbers nothing where it stands
-- still; a controller that reboots begins anew.
local function missing_before(seq, previous, is_reboot)
  if seq == previous or not seq or not previous or is_reboot then return nil end
  local missing = (seq - previous - 1) % 256
  return missing > 0 and missing or nil
end

-- Keeps what happened at a message, and how things stand after it.
local function keep(source, look, event, is_new_clock)
  local state = source.events[#source.events] or NOTHING
  event.active_since = state.active_since
  if event.is_alarm then
    event.active_since = oldest(source.raised_at)
    source.changes[#source.changes + 1] = look.number
  end
  event.clock, event.time = state.clock, state.time -- of the message where drift is 0
  if is_new_clock then event.clock, event.time = source.clock, look.time end
  source.numbers[#source.numbers + 1] = look.number
  source.events[#source.events + 1] = event
end

-- A good message: keeps what it changes.
-- clock  of the controller
local function follow(source, look, clock)
  local state, before = source.events[#source.events] or NOTHING, source.clock
  local flags, is_alarm = flag_changes(source, look)
  local reboot, stale -- true or nil
  if clock and before then
    reboot, stale = clock < before or nil, clock == before or nil
  end
  local missing = missing_before(look.seq, source.seq, reboot)
  local is_new_clock = clock and (reboot or not before)
  if clock then source.clock = clock end
  source.seq = look.seq
  source.last_time = look.time
  if flags or missing or is_new_clock or stale ~= state.stale then
    local event = { flags = flags, is_alarm = is_alarm, missing = missing }
    event.reboot, event.stale = reboot, stale
    keep(source, look, event, is_new_clock)
  end
end

-- Telling ----------------------------------------------------------------------------------------

-- How things stand behind a message, and what happened at it.
local function events_at(source, number)
  local place = last_until(source.numbers, number)
  local state = source.events[place] or NOTHING
  return state, source.numbers[place] == number and state or NOTHING
end

-- What is new in a good message.
local function change_of(source, number, delta)
  local state, event = events_at(source, number)
  local late = delta and delta > source.longest and delta or nil
  if not (event.flags or event.missing or event.reboot or state.stale or late) then return nil end
  return {
    missing = event.missing,
    late = late,
    reboot = event.reboot,
    stale = state.stale,
    flags = event.flags,
  }
end

--- Takes the next message, in the order of the capture.
-- look     { source = key of bus or stream and ID, bus = key of the bus or nil, message = compiled
--          or nil, the same for all of a source; raws = by index of field, nil where the payload
--          does not fit, payload =, seq =, number = of the message: it grows, and no other has it;
--          time = seconds of the capture, good = whether the CRC, or the lack of one, says that it
--          is whole }; it is not kept
-- returns  what is new in it, nil where it is not good and where nothing is: {
--   missing       messages missing before it by their Seq
--   late          seconds since the previous one, where they are more than a lost message or two
--   reboot, stale true where the controller's clock went back, stood still
--   flags         list of { field, value, raised, cleared, alarm_raised, alarm_cleared } of the
--                 fields whose flags changed: masks, alarm_* of the faults alone; in a source's
--                 first message all faults that are set are raised, other flags are not told }
--          and the seconds since the source's previous good message, nil in the first
function History:note(look)
  local source = self.by_key[look.source]
  if not source then
    source = new_source(self, look)
    self.by_key[look.source] = source
  end
  local delta = source.last_time and look.time - source.last_time
  if not look.good then return nil, delta end
  follow(source, look, clock_of(look))
  local own = source.own
  if own then own[#own + 1] = look.number end
  return change_of(source, look.number, delta), delta
end

--- What History:note said of a message, at any later time and in any order.
-- look     as it was given to note, and delta = what note said, which only the caller keeps
function History:change(look)
  local source = self.by_key[look.source]
  return source and look.good and change_of(source, look.number, look.delta)
end

--- How things stand at a message, whether it changes them or not.
-- look     as it was given to note
-- returns  nil where it is not good, else {
--   drift         seconds: controller's clock less the capture's, since the source's first message
--                 or reboot
--   command_in    number of the latest good message on the bus before it of those that it answers:
--                 a Command
--   active_since  time at which the oldest fault that is still set was raised
--   previous_change, next_change  numbers of the messages before and behind it that changed an
--                 alarm, where one is set or changed }
function History:standing(look)
  local source = self.by_key[look.source]
  if not source or not look.good then return nil end
  local number, commands, changes = look.number, source.answered, source.changes
  local state, event = events_at(source, number)
  local clock = clock_of(look)
  local standing = {
    drift = clock and state.clock and (clock - state.clock) / 1e9 - (look.time - state.time),
    command_in = commands and commands[last_until(commands, number - 1)],
    active_since = state.active_since,
  }
  if state.active_since or event.is_alarm then
    standing.previous_change = changes[last_until(changes, number - 1)]
    standing.next_change = changes[last_until(changes, number) + 1]
  end
  return standing
end

return M
