-- SPDX-License-Identifier: GPL-2.0-or-later
-- The history of each source: the changes from one good message to the next.  Pure Lua.
--
-- A source is a bus or stream, and an ID.  Changes are found once, in the order of the capture.
-- They are kept by the frame key of the message, so that a revisit gets the same.  In an only pass,
-- memory grows with changes, Commands and reboots, not with messages.

local band = require "yapp.base.bits".band
local binary = require "yapp.message.binary"
local field_kinds = require "yapp.message.field_kinds"
local frame_key = require "yapp.base.frame_key"
local faults_of = require "yapp.message.faults"
local mapped = require "yapp.base.mapped"
local memo = require "yapp.base.memo"

local History = {}
History.__index = History

local huge, insert = math.huge, table.insert
local last_until, number_of = frame_key.last_until, frame_key.number

local TURNING = 0.1 -- share of the highest speed so far; a faster motor turns
local HALF_NANOSECOND = 5e-10 -- rounding error of a difference of two times
local MAX_JUMP = 1 + HALF_NANOSECOND -- seconds; the capture's clock may jitter by less
-- A Seq up to 8 behind came late, if it came within a second; it does not mean 248 missing.
local MAX_BEHIND, MAX_LATE = 8, 1

-- Evidence that several controllers share a source, see is_shared.  tests/unit/test_shared.lua has
-- the traces that the numbers tell apart: shared sources, reboots, late messages, stopped clocks.
local LARGE_FALL = 2 -- seconds; a message that came late makes the clock fall by less
local LARGE_RETURN = 50 -- evidence of a return from a large fall; from a small one it is 1
local FADE = 0.85 -- per message: evidence of 50 stays above ENOUGH for 22 messages
local ENOUGH = 1.3 -- two small returns a few messages apart, or a large one

local NO_TYPE = { flag_fields = {} }
local UNRELIABLE = { unreliable = true } -- of many messages: to be read only

--- Make the history of one pass over one capture.
-- messages  the message types
-- capture   a capture.capture, asked whether the capture has times and a clock; and its stamps, a
--           capture.stamps
-- late      periods of a message that a gap must exceed to be late
function History.new(messages, capture, late)
  local self = setmetatable({
    capture = capture,
    stamps = capture.stamps,
    late = late,
    by_source = {}, -- [source] = see new_source
    commands = {}, -- [name of a message that others answer][bus or false] = frame keys, ascending
    motors = {}, -- the same: the states of the sources that answer and have a speed, see new_source
    -- For revisits, by the frame key of a message:
    changes = {}, -- its change, or nil
    deltas = {}, -- seconds since the source's previous good message, or false
  }, History)
  for _, message_type in ipairs(messages) do
    local answered = message_type.answers
    if answered then
      self.commands[answered] = memo()
      self.motors[answered] = memo()
    end
  end
  return self
end

local function new_source(self, message)
  local message_type, bus = message.source.type or NO_TYPE, message.source.bus_key or false
  local answered = self.commands[message_type.answers]
  local has_times, has_clock = self.capture:has_times()
  local answering, motors = self.commands[message_type.name], self.motors[message_type.name]
  local source = {
    source = message.source,
    -- Its message type:
    flag_fields = message_type.flag_fields,
    period = message_type.every or 0,
    longest = has_times and self.late * (message_type.every or huge) + HALF_NANOSECOND or huge,
    has_times = has_times,
    has_clock = has_clock,
    stamps = self.stamps,
    -- The previous good message:
    time = nil, -- seconds of the capture, as all times here: see Stamps:even
    seq = nil, -- the newest
    flags = {}, -- [index of a flags field] = raw value
    -- The previous good message with a clock:
    clock = nil, -- the controller's, nanoseconds
    clock_time = nil, -- seconds of the capture
    -- Since then:
    faults = faults_of.new(),
    -- See is_shared.  The controller's clock falls when it goes back.  Later it may return to the
    -- lead over the capture's clock that it had before the fall.
    lead = 0, -- seconds that it gained on the capture's clock since its first fall
    falls = {}, -- { lead before it, size }, the latest first; none from which the clock returned
    evidence = 0,
    shared_key = huge, -- frame key of the message that proves that controllers share the source
    base_keys = {}, -- ascending, frame keys: the first clock, and reboots
    bases = {}, -- of each: seconds of the controller's clock less the capture's
    commands = answered and answered[bus], -- ascending: the messages that they answer
    own = answering and answering[bus], -- ascending: if others answer them
    -- Of a motor, in the unit of its speed: the latest, and the highest so far.
    read_speed = message_type.speed and field_kinds.reader[message_type.speed],
    speed = 0,
    highest = 0,
    -- Of a Command:
    enables = message_type.enables,
    enabled = nil, -- the latest value of this field
    motors = motors and motors[bus],
  }
  if answered and source.read_speed then insert(self.motors[message_type.answers][bus], source) end
  return source
end

-- Clocks -----------------------------------------------------------------------------------------

--- Return the controller's clock in nanoseconds, exact up to 104 days (2^53 ns); nil for a message
-- without one.
-- message  or its event
function History.clock_of(message)
  local field = message.raws and message.source.type.time
  local raw = field and message.raws[field.index]
  if not raw then return nil end
  local seconds, nanoseconds = binary.time(raw)
  return seconds * 1e9 + nanoseconds
end
local clock_of = History.clock_of

-- Return whether a message proves that several controllers share its source.  Their clocks
-- alternate:
--   100.0, 7.2, 100.1, 7.3      it falls by 92.8, returns to where it would be, falls: proved
--   100.0, 99.8, 100.1, 99.9    small falls: a late message makes one, so a third one proves it
--   100.0, 100.0, 100.1, 100.1  the same clock again within a third of a period is a large fall
-- After a reboot, the clock does not return.
-- advance, elapsed  seconds of the controller's and of the capture's clock since source.clock
local function is_shared(source, advance, elapsed)
  local before, falls = source.lead, source.falls
  local lead = before + advance - elapsed
  source.lead, source.evidence = lead, source.evidence * FADE
  local is_equal = advance == 0 and elapsed < source.period / 3
  if advance < 0 or is_equal then
    insert(falls, 1, { lead = before, size = is_equal and LARGE_FALL or before - lead })
    falls[5] = nil -- up to four controllers fall from one to the next before they return
    return source.evidence > ENOUGH
  end
  for i, fall in ipairs(falls) do
    if math.abs(lead - fall.lead) <= math.min(fall.size, LARGE_FALL) / 4 then
      source.evidence = source.evidence + (fall.size < LARGE_FALL and 1 or LARGE_RETURN)
      table.remove(falls, i)
      return false
    end
  end
end

-- Return the seconds of the capture's clock since source.clock.  If it has none, trust the
-- controller's clock unless that jumps: then take the message to come after a period.
local function elapsed_since(source, time, advance)
  if source.has_clock then return time - source.clock_time end
  return advance > 0 and advance <= MAX_JUMP and advance or source.period
end

-- Return the change of the controller's clock: its name and its value; nil for nothing.
local function clock_change(source, time, clock)
  local advance = (clock - source.clock) / 1e9
  local elapsed = elapsed_since(source, time, advance)
  -- If both go back alike, the packets are not in the order of time.  If the capture's alone does,
  -- the message may be a copy.
  if advance <= 0 and advance > 1.25 * elapsed then return nil end
  local may_be_shared = advance <= 0 or source.lead ~= 0
  if may_be_shared and is_shared(source, advance, math.max(elapsed, 0)) then
    return "shared", true
  end
  if advance < 0 then return "reboot", -advance end
  -- Behind a gap, one without an advance may be a copy: the capture's clock was set between both.
  if advance == 0 then return not source.stamps.gap and "stale", true end
  local jump = advance - elapsed
  if jump > MAX_JUMP and elapsed >= 0 and source.has_clock then return "jump", jump end
end

-- Detectors --------------------------------------------------------------------------------------
--
-- A detector is a function(source, message, delta, change, time, clock).  It returns the name of a
-- change and its value, nil for nothing:
--   delta   seconds since the source's previous good message, false for the first
--   change  of the detectors before it, nil for nothing
--   time    of the message; clock = of its controller, nanoseconds, or nil

-- "shared", "reboot", "stale" or "jump": the controller's clock.
local function detect_clock(source, message, _, _, time, clock)
  if not clock then return nil end
  local name, value = nil, nil
  if source.clock then name, value = clock_change(source, time, clock) end
  if source.has_times and (name == "reboot" or not source.clock) then
    insert(source.base_keys, message.key)
    insert(source.bases, clock / 1e9 - time)
  end
  source.clock, source.clock_time = clock, time
  return name, value
end

-- "flags": the fields whose flags change.  In a source's first message, faults that are set count
-- as raised.
local function detect_flags(source, message)
  local raws, flags, fields, changes = message.raws, source.flags, source.flag_fields, nil
  if not raws then return nil end
  for i = 1, #fields do
    local field = fields[i]
    local index = field.index
    local now, before = raws[index], flags[index]
    if now and now ~= before then
      flags[index] = now
      before = before or now - band(now, field.alarm_bits)
      if now ~= before then
        local both = band(before, now)
        changes = changes or {}
        local raised, cleared = now - both, before - both
        insert(changes, { field = field, value = now, raised = raised, cleared = cleared })
      end
    end
  end
  return changes and "flags", changes
end

-- "faults": those among these flags that rise or fall.
local function detect_faults(source, message, _, change, time)
  local flags = change and change.flags
  local steps = flags and source.faults:update(flags, message.key, time)
  if steps then return "faults", steps end
end

-- "missing": how many messages Seq No says are missing: 7, 9 is one.  A source that does not number
-- its messages repeats its Seq.  7, 9, 8, 10 is one, at 9: 8 came late.  After a reboot, numbers
-- begin anew.
local function detect_missing(source, message, delta, change)
  local seq, fall = message.seq, change and change.reboot or 0
  local ahead = (seq - (source.seq or seq)) % 256
  local is_late = ahead >= 256 - MAX_BEHIND and fall < LARGE_FALL and (delta or 0) <= MAX_LATE
  if is_late then return nil end
  source.seq = seq
  if ahead > 1 and fall == 0 then return "missing", ahead - 1 end
end

-- "late": the length of a gap that is longer than it may be; "may_be_late" while nothing tells
-- whether the capture's clock was set in it.
local function detect_late(source, _, delta)
  local stamps = source.stamps
  if not delta or delta <= source.longest or stamps:are_coarse() then return nil end
  return stamps.gap and "may_be_late" or "late", delta
end

-- Return whether the controller ignores a Command: its key is not defined.
local function is_ignored(message)
  for _, remark in ipairs(message.remarks) do
    if remark[2] == "command.key.invalid" then return true end
  end
  return false
end

-- Return the change from one Command to the next.
local function command_change(source, before, enabled)
  if before and before ~= 1 and enabled == 1 then return "enabled", true end
  if before ~= 1 or enabled ~= 0 then return nil end
  local turning = mapped(source.motors or {}, function(motor)
    return motor.speed > TURNING * motor.highest and motor.source
  end)
  return turning[1] and "disabled", turning
end

-- "disabled": the sources of the motors that turn and that a Command turns off; "enabled" if it
-- turns motors on.
local function detect_command(source, message)
  local raws = message.raws
  if raws and source.read_speed then
    local speed = math.abs(source.read_speed(raws))
    if speed == speed then -- no reserved value
      source.speed, source.highest = speed, math.max(speed, source.highest)
    end
  end
  if not (raws and source.enables) or is_ignored(message) then return nil end
  local before, enabled = source.enabled, raws[source.enables.index]
  source.enabled = enabled
  return command_change(source, before, enabled)
end

-- The detectors, in the order in which they need each other.  A new change is one of them, a row of
-- stat.kinds (its event) and a row of show.fields (its expert item).
local DETECTORS =
  { detect_clock, detect_flags, detect_faults, detect_missing, detect_late, detect_command }

-- Return the change of a good message, nil for none.
local function update(source, message, delta, time, clock)
  local change = nil
  for i = 1, #DETECTORS do
    local name, value = DETECTORS[i](source, message, delta, change, time, clock)
    if name then
      change = change or {}
      change[name] = value
    end
  end
  if not (change and change.shared) then return change end
  source.shared_key = message.key
  return { shared = true, unreliable = true }
end

-- Return the even time of a good message, nil while nothing tells whether the capture's clock was
-- set before it; and its controller's clock, or nil.
local function read_times(source, message)
  local clock, time = clock_of(message), message.time
  if not source.has_clock then return time, clock end
  local before = clock and source.clock_time
  local advance = before and (clock - source.clock) / 1e9
  return source.stamps:add(time, message.key, before, advance), clock
end

--- Add the next message, in the order of the capture.
-- is_only_pass  true if it is sure that it is not revisited
-- message  { source = of message.types; raws = by index of field, nil if the payload does not fit;
--          remarks, payload, seq, status; key = frame key: never falls; an equal one replaces a
--          message; time = seconds of the capture }
-- returns  its change, nil if the message is not good or changes nothing: {
--   missing  how many messages are missing before it by Seq
--   late     seconds since the previous one, if that is more than `late` periods
--   may_be_late  true if that is so unless the capture's clock was set
--   reboot   seconds by which the controller's clock went back
--   jump     seconds by which it advanced more than the capture's, if more than one
--   stale    true if it did not advance
--   flags    list of { field, value, raised = mask, cleared = mask } of the fields whose flags
--            changed
--   faults   of these flags the faults that rise or fall, see message.faults
--   disabled  list of the sources whose motors turn and are turned off
--   enabled  true if a Command turns motors on
--   shared   true at the message that proves that several controllers share the source
--   unreliable  true at the messages behind that one, which get nothing else }
--          and the seconds since the source's previous good message, false for the first, and
--          where nothing tells them
function History:add(message, is_only_pass)
  local source, key, change = self.by_source[message.source], message.key, nil
  if not source then
    source = new_source(self, message)
    self.by_source[message.source] = source
  end
  local delta
  if message.status == "good" then
    local time, clock = read_times(source, message)
    local stamp = time or message.time
    delta = source.time and stamp - source.time or false
    source.time = time
    if source.own then insert(source.own, key) end
    change = key > source.shared_key and UNRELIABLE or update(source, message, delta, stamp, clock)
    if not time then delta = false end
  else
    delta = source.time and self.stamps:even(message.time, huge) - source.time or false
  end
  if not is_only_pass then self.changes[key], self.deltas[key] = change, delta end
  return change, delta
end

--- Return the results of History:add, at any later time and in any order; nil and nil for a
-- message that was not added.
-- message  as it was added
function History:change(message)
  return self.changes[message.key], self.deltas[message.key]
end

--- Return the state at a message, whether the message changes it or not.
-- message        as it was added
-- returns  nil if message is not good, or its source is not known or unreliable, else {
--   drift         seconds: controller's clock less the capture's, since the source's first message
--                 or reboot
--   command_in    frame key of the latest good message on the bus that it answers: a Command
--   active_time   seconds since the oldest fault that is still set was raised; nil if the capture's
--                 clock went back behind that
--   previous_change, next_change  frame keys of the messages before and behind it that changed a
--                 fault, if one is set or changes }
function History:state(message)
  local source, key = self.by_source[message.source], message.key
  if not source or message.status ~= "good" or key >= source.shared_key then return nil end
  local base = source.bases[last_until(source.base_keys, key)]
  local clock, commands = base and clock_of(message), source.commands
  local time = self.stamps:even(message.time, number_of(message.key))
  local active_time, previous_change, next_change = source.faults:state(key, time)
  return {
    drift = clock and clock / 1e9 - time - base,
    command_in = commands and commands[last_until(commands, key - 1)],
    active_time = active_time,
    previous_change = previous_change,
    next_change = next_change,
  }
end

return History
