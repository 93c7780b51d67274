-- SPDX-License-Identifier: GPL-2.0-or-later
-- Sources that several controllers share: their clocks alternate.  The history finds that, says it
-- once and is silent from there on.  It never says it of a source with one controller.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local stamps_of = require("yapp.capture.stamps")
local catalogue = require("yapp.message.catalogue")
local history = require("yapp.message.history")
local generator = require("stream_generator")
local levels = require("levels")

local T = {}

local TAURUS = catalogue.compile(dofile("taurus_fields.lua"))
local MOTOR, HEALTH = TAURUS.by_id[0x210], TAURUS.by_id[0x200]
local FAULTS = MOTOR.by_name.fault_flags.index

-- The same source for the same name and message.
local sources = {}
local function source_of(name, message)
  local key = ("%s of %s"):format(name, message.name)
  sources[key] = sources[key] or { name = name, type = message }
  return sources[key]
end

-- A message at a time of the capture, clock in seconds.
-- with  { kind, rest = of its payload, source, seq, fault }
local function message(number, time, clock, with)
  with = with or {}
  local kind = with.kind or MOTOR
  local nanoseconds = generator.little_endian(math.floor(clock * 1e9 + 0.5), 8)
  return {
    source = source_of(with.source or kind.id, kind),
    seq = with.seq or 0,
    key = number,
    time = time,
    status = "good",
    payload = nanoseconds .. (with.rest or number),
    raws = { [FAULTS] = with.fault or 0, [kind.time.index] = nanoseconds },
  }
end

local function new(options)
  options = options or {}
  local capture = {}
  capture.stamps = stamps_of.new()
  function capture.has_times() return not options.lacks_times, not (options.lacks_times or options.lacks_clock) end
  return history.new(TAURUS.messages, capture, 2.5)
end

-- The number of the message at which it shows that these are of several controllers, nil for never.
local function shared_at(messages, options)
  local h = new(options)
  for i, m in ipairs(messages) do
    local change = h:add(m)
    if change and change.shared then
      lu.assertEquals({ change.unreliable, h:state(m) }, { true, nil })
      return i
    end
  end
end

-- Messages with these clocks, so many seconds after each other.
local function clocks(step, list, with)
  local messages = {}
  for i, clock in ipairs(list) do messages[i] = message(i, i * step, clock, with) end
  return messages
end

function T.test_when_it_shows()
  local equal = {} -- two clocks that were set alike
  for i, time in ipairs { 0, 0.03, 0.1, 0.13 } do equal[i] = message(i, time, 100 + math.floor(time * 10) / 10) end
  local late = { 0.1, 0.3, 0.2, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.3, 1.2, 1.4, 1.5 }
  for _, row in ipairs {
    { 4, clocks(0.05, { 100.0, 7.2, 100.1, 7.3, 100.2 }) }, { 4, equal },
    { 5, clocks(0.05, { 7.2, 100.0, 7.3, 100.1, 7.4, 100.2 }) },
    { 6, clocks(0.05, { 100.0, 99.8, 100.1, 99.9, 100.2, 100.0 }) }, -- by 0.25 s
    { 5, clocks(0.033, { 100.0, 50.0, 7.0, 100.1, 50.1, 7.1 }), "three" },
    { 9, clocks(0.025, { 0.0, 30.0, 60.0, 90.0, 0.1, 30.1, 60.1, 90.1, 0.2 }), "four" },
    { nil, clocks(0.1, { 100.0, 100.1, 0.1, 0.2, 0.3 }), "a reboot" },
    { nil, clocks(0.1, { 0.1, 0.2, 0.1, 0.2, 0.1, 0.2, 0.1, 0.2 }), "reboots all the time" },
    { nil, clocks(0.1, { 0.1, 0.2, 3600.1, 3600.2, 0.5, 0.6 }), "one took over, then another" },
    { nil, clocks(0.1, late), "late messages" },
    { nil, clocks(0.1, { 5.0, 5.0, 5.0, 5.0, 5.1, 5.1, 5.2, 5.2 }), "a clock that stands still" },
    { nil, clocks(0.05, { 5.0, 5.0, 5.1, 5.1, 5.2, 5.2, 5.3, 5.3 }), "a coarse clock" },
    { nil, clocks(0.01, { 5.0, 5.0, 5.1, 5.2, 5.3, 5.4, 5.5 }, { rest = "same" }), "once more" },
  } do
    lu.assertEquals(shared_at(row[2]) or "never", row[1] or "never", row[3])
  end
end

-- In a raw dump the time of a message is its controller's clock.
function T.test_dumps()
  local function looped(uptime, step, count)
    local list = {}
    for i = 0, count do list[i + 1] = i * step % uptime end
    return list
  end
  for _, row in ipairs {
    { 5, { 5.0, 800.0, 5.1, 800.1, 5.2, 800.2 } },
    { 4, { 800.0, 5.0, 800.1, 5.1, 800.2 } },
    { 7, { 5.0, 60.0, 800.0, 5.1, 60.1, 800.1, 5.2 } },
    { nil, { 800.0, 800.1, 0.1, 0.2, 0.3, 0.4 }, "a reboot" },
    { nil, { 5.0, 5.1, 800.0, 800.1, 800.2 }, "silence" },
    { nil, { 5.0, 5.1, 0.1, 0.2, 900.0, 900.1 }, "a reboot, then silence" },
    { nil, looped(4, 0.1, 400), "reboots all the time" },
    { nil, looped(4, 1, 400), "the same, and few messages" },
  } do
    local messages = {}
    for i, clock in ipairs(row[2]) do messages[i] = message(i, clock, clock) end
    local found = shared_at(messages, { lacks_clock = true })
    lu.assertEquals(found or "never", row[1] or "never", row[3])
  end
end

-- Flights ----------------------------------------------------------------------------------------

-- Numbers from 0 to 1, the same in every Lua.
local function new_random(seed)
  local state = seed * 7919 % 2147483647
  local function random()
    state = state * 16807 % 2147483647
    return state / 2147483647
  end
  for _ = 1, 5 do random() end
  return random
end

-- What one controller sends: messages { at, clock, rest }.
-- with  { duration, period, uptime = at the beginning, loss, late = probabilities,
--         reboots = how many, life = seconds until a watchdog restarts it, again and again,
--         tick = of its clock }
local function controller(random, with)
  local period, sent, at = with.period or 0.1, {}, random() * 0.1
  local boot, reboots = -(with.uptime or 5), {}
  for i = 1, with.reboots or 0 do reboots[i] = random() * with.duration end
  for i = 1, with.life and with.duration / with.life or 0 do
    reboots[i] = i * with.life + random() * 0.05
  end
  table.sort(reboots)
  while at < with.duration do
    while reboots[1] and reboots[1] <= at do boot = table.remove(reboots, 1) end
    local clock = at - boot
    if with.tick then clock = math.floor(clock / with.tick) * with.tick end
    local one = { at = at, clock = clock, rest = #sent }
    if random() >= (with.loss or 0) then sent[#sent + 1] = one end
    if random() < (with.late or 0) then one.at = at + 1.02 * period end
    at = at + period * (0.975 + random() * 0.05)
  end
  return sent
end

-- What a capture has of it.
-- with  { jitter = of its times, burst = seconds of which it gets all messages at once,
--         step = { when, by how much } its clock is set }
local function captured(random, sent, with)
  for _, one in ipairs(sent) do one.order = one.at end
  table.sort(sent, function(a, b) return a.order < b.order end)
  local messages = {}
  for i, one in ipairs(sent) do
    local at = one.at + random() * (with.jitter or 0)
    if with.burst then at = math.ceil(at / with.burst) * with.burst end
    if with.step and at > with.step[1] then at = at + with.step[2] end
    messages[i] = message(i, at, one.clock, { kind = with.kind, rest = one.rest })
  end
  return messages
end

-- Whether it shows in a flight of controllers, and how often what was said before:
-- { reboot =, jump =, stale = }.
local function fly(seed, controllers, with)
  local random, sent = new_random(seed), {}
  for i, one in ipairs(controllers) do
    for _, each in ipairs(controller(random, one)) do
      each.rest = ("%d %d"):format(i, each.rest)
      sent[#sent + 1] = each
    end
  end
  local h, said = new(with.options), { reboot = 0, jump = 0, stale = 0 }
  for _, m in ipairs(captured(random, sent, with)) do
    local change = h:add(m) or {}
    if change.shared then return true, said end
    for name, count in pairs(said) do said[name] = count + (change[name] and 1 or 0) end
  end
  return false, said
end

local CAPTURES = { {}, { jitter = 0.01 }, { burst = 0.1 }, { burst = 0.25 } }

function T.test_one_controller_is_never_several()
  for _, row in ipairs {
    {}, { reboots = 3 }, { reboots = 10 }, { life = 0.35 }, { life = 1 }, { life = 3 },
    { late = 0.003 }, { tick = 1 }, { tick = 0.1, period = 0.05 },
    { period = 0.05, reboots = 3 },
  } do
    row.duration = 30
    for _, loss in ipairs { 0, 0.5 } do
      row.loss = loss
      for place, capture in ipairs(CAPTURES) do
        local is_paired = row.tick and capture.burst -- nothing tells these from two controllers
        for seed = 1, is_paired and 0 or levels.size(1, 20) do
          local is_found = fly(seed * 10 + place, { row }, capture)
          lu.assertFalse(is_found, lu.prettystr { row, capture, seed })
        end
      end
    end
  end
  for _, step in ipairs { -5, -0.5, 5, 3600 } do
    for seed = 1, levels.size(2, 20) do
      lu.assertFalse(fly(seed, { { duration = 30, reboots = 3 } }, { step = { 15, step } }))
    end
  end
  for seed = 1, levels.size(2, 20) do
    local health = { duration = 60, period = 0.5, reboots = 3 }
    lu.assertFalse(fly(seed, { health }, { kind = HEALTH }))
    local untimed = { options = { lacks_times = true } }
    lu.assertFalse(fly(seed, { { duration = 30, reboots = 3 } }, untimed))
    lu.assertFalse(fly(seed, { { duration = 30, life = 3 } }, untimed))
  end
end

function T.test_several_controllers_always_show()
  for _, row in ipairs { -- uptimes of controllers; how many reboots, jumps may be said before
    { { 100, 7.2 }, 1, 2 }, { { 7.2, 100 }, 1, 2 }, { { 3700, 100 }, 1, 2 },
    { { 10, 9 }, 3, 3 }, { { 10, 9.7 }, 3, 0 }, { { 10, 9.85 }, 3, 0 },
    { { 500, 100, 7 }, 2, 4 }, { { 10, 9.7, 9.3 }, 6, 0 }, { { 500, 300, 100, 7 }, 4, 6 },
  } do
    for place, capture in ipairs(CAPTURES) do
      for seed = 1, levels.size(2, 20) do
        local controllers = {}
        for i, uptime in ipairs(row[1]) do controllers[i] = { duration = 20, uptime = uptime } end
        local is_found, said = fly(seed * 10 + place, controllers, capture)
        local what = lu.prettystr { row, capture, seed, said }
        lu.assertTrue(is_found, what)
        if not capture.burst then
          lu.assertTrue(said.reboot <= row[2] and said.jump <= row[3] and said.stale == 0, what)
        end
      end
    end
  end
end

return T
