-- SPDX-License-Identifier: GPL-2.0-or-later
-- The history of sources: what changes from one good message to the next, in order and on revisits.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local band = require("yapp.base.bits").band
local catalogue = require("yapp.message.catalogue")
local history = require("yapp.message.history")
local levels = require("levels")
local generator = require("stream_generator")
local little_endian = generator.little_endian
local stamps_of = require("yapp.capture.stamps")

local T = {}

local TAURUS = catalogue.compile(dofile("taurus_fields.lua"))
local MOTOR, COMMAND = TAURUS.by_id[0x210], TAURUS.by_id[0]
local STATUS, FAULT, STATE = MOTOR.by_name.status_flags, MOTOR.by_name.fault_flags, MOTOR.by_name.motor_state

-- The same source for the same name, message and bus.
local sources = {}
local function source_of(name, message, bus)
  local key = ("%s of %s on %s"):format(name, message.name, tostring(bus))
  sources[key] = sources[key] or { type = message, bus_key = bus }
  return sources[key]
end

-- A Motor Data message at a time; clock in seconds.
local function motor(number, time, with)
  with = with or {}
  local clock = with.clock or time
  return { source = source_of(with.source or 0x210, MOTOR, with.bus), seq = with.seq or 0,
    key = number, time = time, status = with.ends or "good",
    payload = tostring(clock),
    raws = { [MOTOR.time.index] = little_endian(math.floor(clock * 1e9 + 0.5), 8),
      [STATUS.index] = with.status or 0, [FAULT.index] = with.fault or 0,
      [STATE.index] = with.state or 0 } }
end

local function command(number, time, bus, seq)
  return { source = source_of("command" .. tostring(bus), COMMAND, bus), seq = seq or 0, key = number,
    time = time, status = "good", raws = {}, remarks = {}, payload = "" }
end

local function new(options)
  options = options or {}
  local function has_times() return not options.lacks_times, not options.lacks_times end
  return history.new((options.catalogue or TAURUS).messages, { has_times = has_times, stamps = stamps_of.new() },
    options.late or 2.5)
end

-- What a list of messages gives in order, what is new and how things stand in one table, delta with it;
-- or one key of these.
local function run(messages, key, options)
  local h, found = new(options), {}
  for i, m in ipairs(messages) do
    local change, delta = h:add(m)
    local all = { delta = delta }
    for name, value in pairs(change or {}) do all[name] = value end
    for name, value in pairs(h:state(m) or {}) do all[name] = value end
    found[i] = all
    if key then found[i] = all[key] or "-" end
  end
  return found, h
end

function T.test_the_first_message_has_nothing_but_its_clock()
  local h = new()
  lu.assertNil(h:add(motor(1, 0)))
  lu.assertEquals(h:state(motor(1, 0)), { drift = 0 })
  lu.assertNil(h:add { source = {}, seq = 0, key = 2, time = 1, status = "good", payload = "" })
  lu.assertNil(h:add { source = {}, seq = 0, key = 3, time = 1, status = "bad", payload = "" })
end

function T.test_a_clock_that_is_set_between_a_message_and_its_copy()
  local messages = { motor(1, 0), motor(2, 0.1), motor(3, 100.1, { clock = 0.1 }), motor(4, 100.2, { clock = 0.2 }) }
  lu.assertEquals(run(messages, "stale"), { "-", "-", "-", "-" })
  messages[4] = motor(4, 102.2, { clock = 0.1 }) -- it stands still
  lu.assertEquals(run(messages, "stale"), { "-", "-", "-", true })
  messages = { motor(1, 5), motor(2, 3, { clock = 5 }), motor(3, 4, { clock = 5 }) }
  lu.assertEquals(run(messages, "stale"), { "-", "-", true })
end

-- Two logs one behind the other, the later one first: the capture goes back by what the clock does.
function T.test_a_capture_out_of_order_is_no_reboot()
  local function reboots(...)
    local messages = {}
    for i, row in ipairs { ... } do messages[i] = motor(i, row[1], { clock = row[2] }) end
    return run(messages, "reboot")
  end
  lu.assertEquals(reboots({ 90, 1090 }, { 90.1, 1090.1 }, { 50, 1050 }, { 50.1, 1050.1 }), { "-", "-", "-", "-" })
  lu.assertEquals(reboots({ 90, 90 }, { 89.9, 89.9 }, { 90.1, 90.1 }), { "-", "-", "-" }) -- a message came late
  lu.assertEquals(reboots({ 90, 0.6 }, { 89.999, 0.1 }), { "-", 0.5 }) -- and it rebooted
  lu.assertEquals(reboots({ 90, 90 }, { 88, 86.5 }), { "-", 3.5 })
end

-- Looks at messages with these times of the capture and of the controller, in turns.
local function clocks(...)
  local messages, given = {}, { ... }
  for i = 1, #given, 2 do messages[#messages + 1] = motor(#messages + 1, given[i], { clock = given[i + 1] }) end
  return messages
end

-- Where the capture's clock goes back by 5 s, the controller's does not jump.
function T.test_jumps()
  lu.assertEquals(run(clocks(5, 5, 0.1, 5.1, 0.2, 5.2), "jump"), { "-", "-", "-" })
  lu.assertEquals(run(clocks(5, 5, 5, 7), "jump"), { "-", 2 })
  lu.assertEquals(run(clocks(0.3, 5, 0.4, 6.1), "jump"), { "-", "-" }) -- of doubles the difference is more than 1 s
end

function T.test_without_time_stamps_there_is_nothing_of_time()
  local messages = clocks(0, 5, 0, 3605, 0, 3607, 0, 100, 50, 200) -- one packet of them has a time
  for key, expected in pairs { jump = { "-", "-", "-", "-", "-" }, drift = { "-", "-", "-", "-", "-" },
    late = { "-", "-", "-", "-", "-" }, reboot = { "-", "-", "-", 3507, "-" }, delta = { "-", 0, 0, 0, 50 } } do
    lu.assertEquals(run(messages, key, { lacks_times = true }), expected, key)
  end
  lu.assertEquals(run(messages, "late")[5], 50) -- with times it is
end

-- A fault is one table from its rise to its fall.  A flag of two bits is one fault: it stays set from 1 to 2.
-- An incident goes on if one falls and another rises in one message.
function T.test_faults_from_rise_to_fall()
  local flags = { { "low", 3, "Low" }, { "hot", 4, "Hot" } }
  local message = catalogue.compile({ { name = "m", title = "M", id = 1, size = 1,
    { "f", "uint8", "F", group = "f", alarm = true, flags = flags } } }).messages[1]
  local of_m, messages = { type = message }, {}
  for i, raw in ipairs { 1, 2, 4, 0, 0x81 } do
    messages[i] = { source = of_m, seq = 0, key = i, time = i, status = "good", raws = { raw }, payload = "" }
  end
  local found = run(messages, "faults")
  local low, hot = found[1][1].fault, found[3][2].fault
  lu.assertEquals({ low.field, low.flag.name, low.time, found[1][1].is_raised }, { "f", "low", 1, true })
  lu.assertEquals({ low.key, hot.key }, { 1, 3 })
  lu.assertEquals(found[2], "-")
  lu.assertEquals({ #found[3], found[3][1].fault == low, found[3][1].is_raised }, { 2, true, false })
  lu.assertEquals({ hot.flag.name, hot.time, hot.incident == low.incident, #found[3].set }, { "hot", 3, true, 1 })
  lu.assertEquals({ found[4][1].fault == hot, found[4][1].is_raised, #found[4].set }, { true, false, 0 })
  lu.assertEquals({ #found[5], found[5][1].fault.time, found[5][2].fault.flag.name }, { 2, 5, "undefined_0x80" })
  lu.assertTrue(found[5][1].fault ~= low and found[5][1].fault.incident ~= low.incident)
  lu.assertEquals(run(messages, "active_time"), { 0, 1, 0, "-", 0 })
end

-- The capture's clock goes back behind the beginning of a fault: how long it lasts is not known then.
function T.test_a_fault_across_a_step_back()
  lu.assertEquals(run({ motor(1, 10, { fault = 1 }), motor(2, 10.1, { fault = 1 }), motor(3, 2, { fault = 1 }),
    motor(4, 10, { fault = 1 }) }, "active_time")[3], "-")
end

-- What a revisit of a message gets, with its delta.
local function looked_up(h, m)
  local old_change, delta = h:change(m)
  return { old_change or false, delta }
end

-- Random messages of motors and Commands against the definitions, on buses of which one has no name.
-- All times are whole milliseconds.  Revisits, in any order, get the same.
function T.test_random_messages()
  local buses = { 1, 2 }
  local seen = { late = 0, missing = 0, reboot = 0, jump = 0, stale = 0, drift = 0, raised = 0, cleared = 0 }
  local function compare(name, found, expected, where)
    local is_close = found and type(expected) == "number" and math.abs(found - expected) < 1e-9
    lu.assertTrue(found == expected or is_close, ("%s %s: %s, expected %s"):format(where, name, found, expected))
    if seen[name] and expected then seen[name] = seen[name] + 1 end
  end
  for seed = 1, levels.size(30, 300) do
    local random, h, states, latest, time, noted = generator.random(seed), new(), {}, {}, 0, {}
    for number = 1, 200 do
      local who, expected = random(6), {}
      local bus, is_motor, is_good = buses[who % 3], who > 3, random(8) > 1
      local m
      local known = states[who] or {}
      time = time + 50 * random(4)
      local elapsed = known.time and time - known.time
      local seq = ((known.seq or random(256)) + ({ 1, 1, 1, 0, 2, 9, -1, -8, -9, 130 })[random(10)]) % 256
      if is_motor then
        local kind, clock = random(12), known.clock
        if not clock then
          clock = 10000 + random(10000)
        elseif kind == 1 and not known.has_rebooted then
          clock = clock - ({ random(300), 1995 + random(10), 2000 + random(7000) })[random(3)]
        elseif kind == 2 and elapsed > 50 then
          clock = known.clock
        else
          clock = clock + (kind == 3 and elapsed + 998 + random(4) or math.max(1, elapsed + random(101) - 51))
        end
        local advance = clock - (known.clock or clock)
        local ends = is_good and "good" or "bad"
        m = motor(number, time / 1000,
          { source = who, bus = bus, clock = clock / 1000, seq = seq, fault = random(4) - 1, ends = ends })
        if is_good then
          if random(9) == 1 then m.raws[FAULT.index] = nil end -- a short payload
          local before = known.fault or 0
          local fault = m.raws[FAULT.index] or before
          expected.raised, expected.cleared = fault - band(fault, before), before - band(fault, before)
          if advance < 0 then expected.reboot = -advance / 1000 end
          if advance == 0 and known.clock then expected.stale = true end
          if elapsed and advance - elapsed > 1000 then expected.jump = (advance - elapsed) / 1000 end
          if not known.clock or advance < 0 then known.base = clock - time end
          expected.drift, expected.command_in = (clock - time - known.base) / 1000, latest[bus or 0]
          known.fault, known.clock, known.has_rebooted = fault, clock, known.has_rebooted or advance < 0
        end
      else
        m = command(number, time / 1000, bus, seq)
        m.status = is_good and "good" or "bad"
        if is_good then latest[bus or 0] = number end
      end
      expected.delta = elapsed and elapsed / 1000 or false
      if is_good then
        local ahead = (seq - (known.seq or seq)) % 256
        if elapsed and elapsed > (is_motor and 250 or 500) then expected.late = elapsed / 1000 end
        if ahead < 248 or (expected.reboot or 0) >= 2 or m.time - known.stamp > 1 then
          known.seq = seq
          if ahead > 1 and not expected.reboot then expected.missing = ahead - 1 end
        end
        known.time, known.stamp, states[who] = time, m.time, known
      end
      local where, change, delta = ("seed %d, message %d,"):format(seed, number), h:add(m)
      local state, flags = h:state(m) or {}, change and change.flags and change.flags[1] or {}
      compare("delta", delta, expected.delta, where)
      for _, name in ipairs { "late", "missing", "reboot", "jump", "stale" } do
        compare(name, (change or {})[name], expected[name], where)
      end
      for _, name in ipairs { "drift", "command_in" } do compare(name, state[name], expected[name], where) end
      for _, name in ipairs { "raised", "cleared" } do
        compare(name, flags[name] or 0, expected[name] or 0, where)
      end
      noted[number] = { m, { change or false, delta } }
      local before = noted[random(number)] -- some are asked for while the first pass goes on
      lu.assertEquals(looked_up(h, before[1]), before[2], where)
    end
    for number = #noted, 1, -1 do lu.assertEquals(looked_up(h, noted[number][1]), noted[number][2], number) end
  end
  for name, count in pairs(seen) do lu.assertTrue(count > 50, name) end
end

return T
