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
  self.flags = {} -- [message] = the places of its fields of flags
  for _, message in ipairs(options.catalogue and options.catalogue.messages or {}) do
    if message.answers then self.answered[message.answers] = true end
  end
  return self
end

local function new_source()
  return {
    values = {}, -- of the flags of the previous good message, by index of field
    raised_at = {}, -- [index of a field with alarms] = { [bit] = when it was raised }
    clock = nil, -- the controller's, in the previous good message
    seq = nil,
    last_time = nil,
    numbers = {}, -- of the messages at which something happened, ascending
    events = {}, -- what happened: events[i] at numbers[i], see keep
    changes = {}, -- numbers of the messages that changed an alarm
  }
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

-- The places of the fields of flags of a message.
local function flags_of(self, message)
  local places = {}
  for i, field in ipairs(message.fields) do
    if field.kind == "flags" then places[#places + 1] = i end
  end
  self.flags[message] = places
  return places
end

-- What changed in the flags of a good message, nil for nothing; and whether an alarm did.
local function flag_changes(self, source, look)
  local raws, values, changes, is_alarm = look.raws, source.values, nil, nil
  if not raws then return nil end
  local places = self.flags[look.message] or flags_of(self, look.message)
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
  if not seq or not previous or is_reboot then return nil end
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
local function follow(self, source, look, clock)
  local state, before = source.events[#source.events] or NOTHING, source.clock
  local flags, is_alarm = flag_changes(self, source, look)
  local reboot, stale -- true or nil
  if clock and before then
    reboot, stale = clock < before or nil, clock == before or nil
  end
  local missing
  if look.seq ~= source.seq then missing = missing_before(look.seq, source.seq, reboot) end
  local is_new_clock = clock and (reboot or not before)
  source.clock = clock or before
  source.seq = look.seq
  source.last_time = look.time
  if flags or missing or is_new_clock or stale ~= state.stale then
    local event = { flags = flags, is_alarm = is_alarm, missing = missing }
    event.reboot, event.stale = reboot, stale
    keep(source, look, event, is_new_clock)
  end
end

-- The numbers of a bus's messages of one name that others answer.
local function commands_of(self, bus, name)
  local by_name = self.commands[bus or false] or {}
  self.commands[bus or false] = by_name
  by_name[name] = by_name[name] or {}
  return by_name[name]
end

-- Telling ----------------------------------------------------------------------------------------

local function drift_of(look, state, clock)
  if not clock or not state.clock then return nil end
  return (clock - state.clock) / 1e9 - (look.time - state.time)
end

-- The latest good message before one on its bus of those that it answers.
local function command_of(self, look)
  local name = look.message and look.message.answers
  if not name then return nil end
  local numbers = commands_of(self, look.bus, name)
  return numbers[last_until(numbers, look.number - 1)]
end

local function is_late(self, look, delta)
  local every = look.message and look.message.every
  return every and delta and delta > self.late * every + NANOSECOND / 2
end

-- What is kept of a good message as its change.
local function tell(self, source, look, delta, clock)
  local place = last_until(source.numbers, look.number)
  local state = source.events[place] or NOTHING
  local event = source.numbers[place] == look.number and state or NOTHING
  -- A table of four: most changes are no more, and one with room for all keys costs 640 bytes of
  -- garbage.
  local change = {
    delta = delta,
    drift = drift_of(look, state, clock),
    command_in = command_of(self, look),
    active_since = state.active_since,
  }
  if is_late(self, look, delta) then change.late = delta end
  if state.stale then change.stale = true end
  if state.active_since or event.is_alarm then
    change.previous_change = source.changes[last_until(source.changes, look.number - 1)]
  end
  if event ~= NOTHING then
    change.missing, change.reboot = event.missing, event.reboot
    change.flags, change.is_alarm = event.flags, event.is_alarm
  end
  return next(change) and change
end

local function only_delta(delta)
  return delta and { delta = delta }
end

--- Takes the next message, in the order of the capture.
-- look     { source = key of bus or stream and ID, bus = key of the bus or nil, message = compiled
--          or nil, raws = by index of field, nil where the payload does not fit, payload =, seq =,
--          number = of the message: it grows, and no other has it; time = seconds of the capture,
--          good = whether the CRC, or the lack of one, says that it is whole }; it is not kept
-- returns  what changed, nil where nothing is known, and delta by itself: {
--   delta         seconds since the source's previous good message
--   missing       messages missing before it by their Seq
--   late          seconds, where delta is more than a lost message or two
--   reboot, stale true where the controller's clock went back, stood still
--   drift         seconds: controller's clock less the capture's, since the source's first message
--                 or reboot
--   command_in    number of the latest good message on the bus before it of those that it answers:
--                 a Command
--   flags         list of { field, value, raised, cleared, alarm_raised, alarm_cleared } of the
--                 fields whose flags changed: masks, alarm_* of the faults alone; in a source's
--                 first message all faults that are set are raised, other flags are not told
--   is_alarm      true where a fault rose or fell
--   active_since  time at which the oldest fault that is still set was raised
--   previous_change  number of the message before it that changed an alarm, where one is set or
--                    changed }
-- A message that is not good changes nothing and has its delta only.
function History:note(look)
  local source = self.by_key[look.source]
  if not source then
    source = new_source()
    self.by_key[look.source] = source
  end
  local delta = source.last_time and look.time - source.last_time
  if not look.good then return only_delta(delta), delta end
  local clock = clock_of(look)
  follow(self, source, look, clock)
  local name = look.message and look.message.name
  if name and self.answered[name] then
    local numbers = commands_of(self, look.bus, name)
    numbers[#numbers + 1] = look.number
  end
  return tell(self, source, look, delta, clock), delta
end

--- What History:note said of a message, at any later time and in any order.
-- look     as it was given to note, and delta = what note said, which only the caller keeps
function History:change(look)
  local source = self.by_key[look.source]
  if not source or not look.good then return only_delta(look.delta) end
  return tell(self, source, look, look.delta, clock_of(look))
end

--- The number of the next message of a source that changes an alarm, nil where none does.
-- number   of a message; source: its key
function History:next_change(number, source)
  local changes = self.by_key[source] and self.by_key[source].changes or NOTHING
  return changes[last_until(changes, number) + 1]
end

return M
