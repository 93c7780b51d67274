-- SPDX-License-Identifier: GPL-2.0-or-later
-- The history of each source: what changed between a good message and the good one before it.  Pure Lua, 5.2 and 5.4.
--
-- A source is a bus or stream, and an ID.  What changed is worked out once, in the order of the capture, and kept as
-- events, so that a later look at any message gets the same: memory grows with events, Commands and reboots, not with
-- messages.

local M = {}

local byte = string.byte
local unpack = rawget(table, "unpack")

local NANOSECOND = 1e-9 -- what a capture's times have; a difference of two of them has a little more or less
local NOTHING = {} -- how things stand before a source's first event

local History = {}
History.__index = History

--- The history of one pass over one capture.
-- options  { late = how many periods of its message a gap must exceed to be one (2.5),
--            catalogue = compiled: which messages others answer (without it, the one that is called command) }
function M.new(options)
  options = options or {}
  local answered = { command = not options.catalogue or nil }
  for _, message in ipairs(options.catalogue and options.catalogue.messages or {}) do
    if message.answers then answered[message.answers] = true end
  end
  return setmetatable({ late = options.late or 2.5, answered = answered, by_key = {}, list = {}, commands = {},
    kinds = {} }, History)
end

-- The place of the last of these ascending numbers that is not above `most`, 0 where none is.
local function last_until(numbers, most)
  local low, high = 0, #numbers
  if high == 0 or numbers[high] <= most then return high end
  while low < high do
    local middle = (low + high + 1 - (low + high + 1) % 2) / 2
    if numbers[middle] <= most then low = middle else high = middle - 1 end
  end
  return low
end

-- Which fields of a message are flags: worked out once a message.
local function kind_of(self, message)
  local kind = { flags = {}, known = {}, clock_at = message.time and message.time.offset + 1 }
  for i, field in ipairs(message.fields) do
    if field.kind == "flags" then kind.flags[#kind.flags + 1] = i end
  end
  self.kinds[message] = kind
  return kind
end

-- The controller's clock in nanoseconds: an int64, little endian; exact up to 104 days (2^53 ns).
local function clock_of(payload, at)
  local a, b, c, d, e, f, g, h = byte(payload, at, at + 7)
  if not h then return nil end
  if h >= 0x80 then h = h - 0x100 end
  return a + b * 0x100 + c * 0x10000 + d * 0x1000000 +
    (e + f * 0x100 + g * 0x10000 + h * 0x1000000) * 0x100000000
end

-- The bits that rose and that fell between two values.
local function difference(before, now)
  local raised, cleared, bit = 0, 0, 1
  while before > 0 or now > 0 do
    local b, n = before % 2, now % 2
    if n > b then raised = raised + bit elseif b > n then cleared = cleared + bit end
    before, now, bit = (before - b) / 2, (now - n) / 2, bit * 2
  end
  return raised, cleared
end

local function new_source(look)
  return { key = look.source, id = look.id, bus = look.bus, message = look.message,
    values = {},     -- of the flags of the previous good message, by index of field
    raised_at = {},  -- [index of an alarm field] = { [bit] = when it was raised }
    state = NOTHING, -- after the latest event: { active_since, clock, time (where drift is 0), stale }
    numbers = {}, events = {}, -- what happened: events[i] at the message numbers[i]
    changes = {},    -- numbers of the messages that changed an alarm
  }
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

-- Keeps when each bit was raised.
local function note_bits(times, value, time)
  local bit, rest = 1, value
  while rest > 0 do
    local is_set = rest % 2 == 1
    if is_set and not times[bit] then times[bit] = time end
    rest, bit = (rest - rest % 2) / 2, bit * 2
  end
  for raised in pairs(times) do
    if value % (2 * raised) < raised then times[raised] = nil end
  end
end

-- A change of a flags field, as a list of its own.  Flags go to and fro between a few values: the same change is kept
-- once, not once an event; nobody writes into it.
local function change_of(kind, field, before, now)
  local known = kind.known[field] or {}
  kind.known[field] = known
  local by_value = known[before] or {}
  known[before] = by_value
  local list = by_value[now]
  if not list then
    local raised, cleared = difference(before, now)
    list = { { field = field, value = now, raised = raised, cleared = cleared } }
    by_value[now] = list
  end
  return list
end

-- What changed in one flags field, as a list; nil for nothing.  Of a source's first message the alarms count as raised.
local function flag_change(source, kind, index, look)
  local field, now = look.message.fields[index], look.raws[index]
  local before = source.values[index] or field.alarm and 0
  source.values[index] = now
  if not before or before == now then return nil end
  if field.alarm then
    local times = source.raised_at[index] or {}
    source.raised_at[index] = times
    note_bits(times, now, look.time)
  end
  return change_of(kind, field, before, now)
end

-- A new list: either may be one that is kept.
local function both(list, change)
  list = { unpack(list) }
  list[#list + 1] = change[1]
  return list
end

-- What changed in the flags of a good message; nil for nothing.
local function flag_changes(source, kind, look)
  local changes
  local raws, values = look.raws, source.values
  for i = 1, #kind.flags do
    local index = kind.flags[i]
    local raw = raws[index]
    if raw and raw ~= values[index] then
      local change = flag_change(source, kind, index, look)
      changes = changes and change and both(changes, change) or changes or change
    end
  end
  return changes
end

local function has_alarm(changes)
  for i = 1, changes and #changes or 0 do
    if changes[i].field.alarm then return true end
  end
  return false
end

-- Keeps what happened at a message, and how things stand after it.
local function keep(source, look, event)
  if event.is_alarm then source.changes[#source.changes + 1] = look.number end
  local count = #source.numbers + 1
  source.numbers[count], source.events[count], source.state = look.number, event, event
end

-- A good message: keeps what it changes; returns the controller's clock, and whether there is anything new.
local function follow(self, source, look)
  local message, state = look.message, source.state
  local flags, clock, is_new_clock, reboot, stale
  if message and look.raws then
    local kind = self.kinds[message] or kind_of(self, message)
    flags = flag_changes(source, kind, look)
    clock = kind.clock_at and clock_of(look.payload, kind.clock_at)
    if clock then
      local before = source.clock
      reboot, stale = before and clock < before or nil, before == clock or nil
      is_new_clock, source.clock = reboot or not before, clock
    end
  end
  local seq, previous, missing = look.seq, source.seq, nil
  source.seq, source.last_time = seq, look.time
  -- A Seq that stands still numbers nothing; a controller that reboots begins anew.
  if seq and previous and seq ~= previous and not reboot then
    missing = (seq - previous - 1) % 256
    if missing == 0 then missing = nil end
  end
  local is_new = flags or missing or is_new_clock or stale ~= state.stale
  if is_new then
    keep(source, look, { flags = flags, missing = missing, reboot = reboot, stale = stale,
      clock = is_new_clock and clock or state.clock, time = is_new_clock and look.time or state.time,
      active_since = oldest(source.raised_at), is_alarm = has_alarm(flags) or nil })
  end
  return clock, is_new or stale
end

-- The numbers of a bus's messages of one kind that others answer.
local function commands_of(self, bus, name)
  local by_name = self.commands[bus or false]
  if not by_name then
    by_name = {}
    self.commands[bus or false] = by_name
  end
  local numbers = by_name[name]
  if not numbers then
    numbers = {}
    by_name[name] = numbers
  end
  return numbers
end

local function is_late(self, message, delta)
  local every = message and message.every
  return every and delta and delta > self.late * every + NANOSECOND / 2
end

-- The change of a good message from what is kept.
local function tell(self, source, look, delta, clock)
  local place = last_until(source.numbers, look.number)
  local state = source.events[place] or NOTHING
  local event = source.numbers[place] == look.number and state or NOTHING
  local message, active_since, late, drift, command_in, previous = look.message, state.active_since, nil, nil, nil, nil
  if message then
    if is_late(self, message, delta) then late = delta end
    if state.clock and look.raws then
      clock = clock or clock_of(look.payload, message.time.offset + 1)
      drift = clock and (clock - state.clock) / 1e9 - (look.time - state.time)
    end
    if message.answers then
      local numbers = commands_of(self, look.bus, message.answers)
      command_in = numbers[last_until(numbers, look.number - 1)]
    end
    if active_since or event.is_alarm then
      previous = source.changes[last_until(source.changes, look.number - 1)]
    end
  end
  -- A table of four: most changes are no more, and one with room for all keys costs 640 bytes of garbage.
  local change = { delta = delta, drift = drift, command_in = command_in, active_since = active_since }
  if late then change.late = late end
  if state.stale then change.stale = true end
  if previous then change.previous_change = previous end
  if event ~= NOTHING then change.missing, change.reboot, change.flags = event.missing, event.reboot, event.flags end
  if event.is_alarm then change.is_alarm = true end
  return next(change) and change
end

local function only_delta(delta)
  return delta and { delta = delta }
end

--- Takes the next message, in the order of the capture.
-- look     { source = key of bus or stream and ID, bus = key of the bus or nil, message = compiled or nil,
--          raws = by index of field, nil where the payload does not fit, payload =, id =, seq =,
--          number = of the message: it grows, and no other has it; time = seconds of the capture,
--          good = whether the CRC, or the lack of one, says that it is whole,
--          is_brief = whether nobody asks for more than what is new: then there is no change where nothing is };
--          it is not kept: one table may serve all
-- returns  what changed, nil where nothing is known, and delta by itself: {
--   delta         seconds since the source's previous good message
--   missing       messages missing before it by their Seq
--   late          seconds, where delta is more than a lost message or two
--   reboot, stale true where the controller's clock went back, stood still
--   drift         seconds: controller's clock less the capture's, since the source's first message or reboot
--   command_in    number of the latest good message on the bus before it of those that it answers: a Command
--   flags         { { field =, value =, raised = bits, cleared = bits } ... } of every flags field that changed; in a
--                 source's first message all alarms that are set are raised, other flags are not told
--   is_alarm      true where an alarm is among these
--   active_since  time at which the oldest alarm bit that is still set was raised
--   previous_change  number of the message before it that changed an alarm, where one is set or changed }
-- A message that is not good changes nothing and has its delta only.
function History:note(look)
  local source = self.by_key[look.source]
  if not source then
    source = new_source(look)
    self.by_key[look.source], self.list[#self.list + 1] = source, source
  end
  local delta = source.last_time and look.time - source.last_time
  if not look.good then return only_delta(delta), delta end
  local clock, is_new = follow(self, source, look)
  local message = look.message
  if message and self.answered[message.name] then
    local numbers = commands_of(self, look.bus, message.name)
    numbers[#numbers + 1] = look.number
  end
  if look.is_brief and not is_new and not is_late(self, message, delta) then return nil, delta end
  return tell(self, source, look, delta, clock), delta
end

--- What History:note said of a message, at any later time and in any order.
-- look     as it was given to note, and delta = what note said, which only the caller keeps
function History:change(look)
  local source = self.by_key[look.source]
  if not source or not look.good then return only_delta(look.delta) end
  return tell(self, source, look, look.delta)
end

--- The number of the next message of a source that changes an alarm, nil where none does.
-- number   of a message
-- source   its key; without it the number must be that of a message that changes an alarm
function History:next_change(number, source)
  for _, one in ipairs(source and { self.by_key[source] } or self.list) do
    local changes = one.changes
    local place = last_until(changes, number)
    if source or changes[place] == number then return changes[place + 1] end
  end
end

--- The sources in the order in which they showed: a list of { key =, id =, bus =, message = }.
function History:sources()
  return self.list
end

return M
