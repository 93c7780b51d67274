-- SPDX-License-Identifier: GPL-2.0-or-later
-- The card of a fault, from events: which fault it is about, what changed before it, and what else it shows.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local answers = require("answers")
local catalogue_of = require("yapp.message.catalogue")
local dates_of = require("yapp.stat.dates")
local fault_of = require("yapp.stat.fault")
local kinds = require("yapp.stat.kinds")
local levels = require("levels")
local output = require("yapp.stat.output")

local T = { setUp = answers.setUp, tearDown = answers.tearDown }

local CATALOGUE, PROBLEMS = catalogue_of.compile {
  { name = "command", title = "Command", id = 0, size = 1, info = "{enabled}",
    { "enabled", "uint8", "Enabled", values = { [0] = "Disabled", [1] = "Enabled" } } },
  { name = "motor", title = "Motor Data", id = 0x210, size = 3, every = 0.1, answers = "command",
    info = "{volts:%.0f unit}",
    { "volts", "float8", "Volts", min = 0, max = 250, unit = "V" },
    { "flags", "uint8", "Flags", group = "fault", alarm = true,
      flags = { { "hot", 1, "Hot" }, { "stall", 2, "Stall" } } },
    { "state", "uint8", "State", group = "state", flags = { { "slow", 1, "Slow" } } } },
}
lu.assertEquals(PROBLEMS, {})
local COMMAND, MOTOR = CATALOGUE.messages[1], CATALOGUE.messages[2]
local LEFT = { bus_key = 1, bus = "can0", id = 0x210, name = "left", type = MOTOR }
local RIGHT = { bus_key = 1, bus = "can0", id = 0x211, type = MOTOR }
local FRONT = { bus_key = 1, bus = "can0", id = 0x001, type = COMMAND } -- RIGHT's own, by its last digit
local REAR = { bus_key = 1, bus = "can0", id = 0x005, type = COMMAND }

-- A flight: a statistic, and the number of the latest frame.
local function flight(options, is_json)
  local printed = {}
  local function out(text) printed[#printed + 1] = text end
  local context = { dates = dates_of.new(), json = is_json, out = out }
  local statistic, frame = fault_of.new(options, context), 0
  local one = { faults = {} } -- by source: those that are set
  function one.send(source, time, ...)
    frame = frame + 1
    local raws = { ... }
    local event = kinds.new_event("message", frame, time, source, nil, { seq = 0, raws = raws })
    event.faults = one.faults[source]
    statistic:add_event(event)
    return event
  end
  function one.flag(cause, what, name, incident)
    local values = { field = "flags", flag = name, event = what, incident = incident, help = "why" }
    local event = kinds.new_follower("fault", cause, values)
    statistic:add_event(event)
    return event
  end
  function one.add(event) statistic:add_event(event) end
  function one.finish(unknown)
    local code, text = statistic:finish({ unknown = unknown or 0, sources = 3 }, { "a note" })
    return table.concat(printed), code, text
  end
  return one
end

-- Messages of ten seconds, every 0.1 s, with 10 or 11 V; the last ones are those given.
local function fly(one, source, until_time, ...)
  local last = { ... }
  for i = 1, 100 do
    local volts = last[i - 100 + #last] or 10 + i % 2
    one.send(source, until_time - 10 + i / 10 - 0.01, volts, 0, 0)
  end
end

-- Whatever the width of its columns.
local function has(text, ...)
  text = text:gsub(" +", " ")
  for _, part in ipairs { ... } do lu.assertStrContains(text, (part:gsub(" +", " "))) end
end

function T.test_a_card()
  local one, incident = flight { }, {}
  one.send(REAR, 0.5, 1)
  one.send(FRONT, 0.6, 1)
  fly(one, RIGHT, 10, 40, 40, 40)
  one.add(kinds.new_event("missing", 500, 9.5, LEFT, { count = 2 }))
  one.add(kinds.new_event("missing", 500, 2, LEFT, { count = 3 }))
  one.send(LEFT, 9.9, 255, 2, 0)
  local cause = one.send(RIGHT, 10, 12, 1, 1)
  one.flag(cause, "raised", "hot", incident)
  local last = nil
  for i = 1, 7 do last = one.send(RIGHT, 10 + i / 10, 12, 3, 1) end
  one.flag(last, "raised", "stall", incident)
  one.flag(one.send(RIGHT, 11, 10, 0, 1), "cleared", "hot", incident)
  one.flag(last, "cleared", "stall", incident)
  one.add(kinds.new_event("silence", 1, 4, LEFT, { length = output.seconds(5.5) }))
  one.add(kinds.new_event("silence", 1, 3, LEFT, { length = output.seconds(5.5) }))
  local text, code = one.finish()
  lu.assertNil(code)
  lu.assertStrMatches(text, "YAPP fault: 1 of 1\na note\n\n.* 104  can0  0x211 .* 0.700\n.*")
  has(text, "0.000  hot    why\n", "0.700  stall  why\n",
    "-0.210 100 motor volts 10.50 40.00 V 3.81\n",
    "motor state slow 0 1\n", "unchanged  Enabled\n", "-9.400      2  can0 0x1  unchanged",
    "-0.100    103  left    FAULT stall  NaN V\n",
    "-0.500    500  left    missing  messages missing by Seq No: 2\n",
    "left    silence  silent for 5.500 s\n", "0.500    109  can0 0x211  FAULT hot, stall  12 V\n")
  for _, part in ipairs { "No: 3", "-7.000", "  0.600", "  104  motor  volts" } do
    lu.assertNotStrContains(text, part)
  end
end

function T.test_a_card_of_a_controller_that_has_no_other_and_no_command()
  local one = flight { }
  one.flag(one.send(LEFT, 1, 254, 1, 0), "raised", "hot", {})
  local text, code = one.finish(1)
  lu.assertEquals(code, output.EXIT_UNDECIDED)
  has(text, "YAPP fault: 1 of UNKNOWN, 1 of 3 sources not decoded, 1 in what was decoded\n",
    "seconds before: none\n", "The latest Command: none\n", "The other controllers: none\n")
end

function T.test_there_is_no_such_fault()
  for _, options in ipairs { { number = 2 }, { frame = 2 } } do
    local one = flight(options)
    one.flag(one.send(LEFT, 1, 10, 1, 0), "raised", "hot", {})
    lu.assertEquals({ one.finish() }, { "YAPP fault: 1\na note\n", 21, "there is no such fault: the capture has 1" })
  end
  lu.assertEquals({ flight({ }).finish() }, { "YAPP fault: 0\na note\n" })
  lu.assertEquals(select(2, flight({ }).finish(1)), output.EXIT_UNDECIDED)
end

-- The first value that left the usual range, and the usual value.  A volt is a count, so the range is at least four
-- volts wide; the last value alone must be half as far again.
function T.test_which_value_left_its_range()
  local function repeated(value, count) return (value .. " "):rep(count) end
  local steady, restless = repeated(100, 20), repeated("100 102", 15)
  local ramp = {}
  for i = 1, 30 do ramp[i] = 99 + i end
  ramp = table.concat(ramp, " ")
  for values, expected in pairs {
    [steady .. "104 104"] = "", [steady .. "105 105"] = "21 100.00 105.00",
    [steady .. "95 95 90"] = "21 100.00 95.00",
    [steady .. "106"] = "", [steady .. "107"] = "21 100.00 107.00", [steady .. "107 100 100"] = "",
    [steady .. "255 255"] = "21 100.00 inf",
    -- The largest, and what came before only if it is nearly as large.
    [steady .. "123 123 100 100 130 130"] = "25 100.00 130.00",
    [steady .. "124 124 100 100 130 130"] = "21 100.00 124.00",
    [steady .. "107 107 130 130"] = "21 100.00 107.00", [steady .. "123 123 100 100 100 230"] = "21 100.00 123.00",
    -- The median of ten values before it, of at least five.
    [ramp .. " 250 250"] = "31 124.50 250.00", [repeated(100, 4) .. "150 150 150 " .. steady] = "6 100.00 150.00",
    -- A third of 27 distances is 1 V, which is 0.43 of the usual noise; 27 values are few: 4 * 1 / 0.43 * 32 / 27 is
    -- 11.03 V.  The second value of a step is a volt nearer to the median than the first one.
    [restless .. "113 113"] = "", [restless .. "114 114"] = "31 101.00 114.00",
  } do
    local one, frame = flight({ }, true), 0
    local cause = nil
    for value in values:gmatch("%d+") do
      frame = frame + 1
      cause = one.send(LEFT, frame / 100, tonumber(value), 1, 0)
    end
    one.flag(cause, "raised", "hot", {})
    local row = one.finish():match('"changes":(%b[])')
    local at, from, to = row:match('"frame":(%d+),.-"from":([^,]*),"to":([^,]*)')
    to = to == "null" and "inf" or to and ("%.2f"):format(to)
    lu.assertEquals(at and ("%s %.2f %s"):format(at, from, to) or "", expected, values)
  end
end

-- Random flights: which messages, Commands, controllers, events and switches the card of a fault shows.
local HIDDEN = { bus_off = true, bus_passive = true, bus_errors = true, unknown = true }

local function is_same(a, b)
  if a.name and b.name then return a.name == b.name end
  return a.bus_key == b.bus_key and a.id % 16 == b.id % 16
end

-- The frames that each section of an incident's card shows.
local function expected_sections(log, cause, incident)
  local found, before, order = { messages = {}, command = {}, others = {}, events = {}, changes = {} }, {}, {}
  local behind, command = 0, nil
  for _, event in ipairs(log) do
    local source = event.source
    if event.kind == "message" then
      if event.frame > cause.frame then behind = behind + (source == cause.source and 1 or 0) end
      if source == cause.source and behind <= 5 then table.insert(found.messages, event.frame) end
      if event.frame <= cause.frame and cause.time - event.time <= 10 then
        if not before[source] then before[source], order[#order + 1] = {}, source end
        table.insert(before[source], event)
      end
    elseif not HIDDEN[event.kind] and event.values.incident ~= incident then
      local length = event.kind == "silence" and event.values.length.json or 0
      local is_near = cause.time >= event.time - 1 and cause.time <= event.time + length + 1
      if is_near then table.insert(found.events, event.frame) end
    end
  end
  while #found.messages > 11 + math.min(behind, 5) do table.remove(found.messages, 1) end
  for _, source in ipairs(order) do
    local latest = before[source][#before[source]]
    if source.type == COMMAND and source.bus_key == cause.source.bus_key then
      local is_own, is_latest = is_same(source, cause.source), not command or latest.frame > command.frame
      local has_own = command and is_same(command.source, cause.source)
      if is_own and not has_own or is_own == (has_own or false) and is_latest then command = latest end
    elseif source.type == MOTOR and not is_same(source, cause.source) then
      table.insert(found.others, latest.frame)
    end
  end
  found.command[1] = command and command.frame
  for source, messages in pairs(before) do
    local index = source == cause.source and 3 or command and source == command.source and 1
    for i = index and #messages or 1, 2, -1 do
      if messages[i].raws[index] ~= messages[i - 1].raws[index] then
        table.insert(found.changes, messages[i].frame)
        break
      end
    end
  end
  for _, list in pairs(found) do table.sort(list) end
  return found
end

function T.test_random_cards()
  local sources = { LEFT, RIGHT, FRONT, REAR, { bus_key = 1, bus = "can0", id = 0x00a, name = "left", type = COMMAND },
    { bus_key = 2, bus = "can1", id = 0x210, type = MOTOR }, { bus_key = 2, bus = "can1", id = 0x000, type = COMMAND } }
  for seed = 1, levels.size(60, 1500) do
    math.randomseed(seed)
    local options = math.random(2) == 1 and { number = math.random(4) } or { frame = math.random(700) }
    local one, time, log, states, incidents, chosen = flight(options, true), 0, {}, {}, {}, nil
    local quiet = sources[math.random(0, #sources)] -- sends nothing from some time on
    for i, source in ipairs(sources) do states[source] = { value = i % 2 } end
    for step = 1, 700 do
      time = time + 1 / 16
      local source, row = sources[math.random(#sources)], math.random(12) == 1 and kinds.LIST[math.random(#kinds.LIST)]
      local state = states[source]
      if row and row.name ~= "fault" then
        local length = output.seconds(math.random(0, 20) / 4)
        local at = row.name == "silence" and time - length.json or time
        log[#log + 1] = kinds.new_event(row.name, 1000 + step, at, source, { length = length })
        one.add(log[#log])
      elseif source ~= quiet or step < 250 then
        local what = source.type == MOTOR and math.random(25) == 1 and (state.incident and "cleared" or "raised")
        if math.random(20) == 1 then state.value = 1 - state.value end
        if what == "raised" then state.incident = {} end
        one.faults[source] = what ~= "cleared" and state.incident and { { incident = state.incident } } or nil
        local event = source.type == MOTOR and one.send(source, time, 100, 0, state.value) or
          one.send(source, time, state.value)
        log[#log + 1] = event
        if what == "raised" then incidents[#incidents + 1], state.incident.cause = state.incident, event end
        if what then log[#log + 1] = one.flag(event, what, "hot", state.incident) end
        if event.frame >= (options.frame or 9999) then chosen = chosen or state.incident end
        if what == "cleared" then state.incident = nil end
      end
    end
    chosen = chosen or incidents[options.number]
    local text, found, expected = one.finish(), {}, chosen and expected_sections(log, chosen.cause, chosen) or {}
    for name in pairs(expected) do
      found[name] = {}
      local section = text:match('"' .. name .. '":(%b[])')
      for frame in section:gmatch('"frame":(%d+)') do table.insert(found[name], tonumber(frame)) end
      table.sort(found[name])
    end
    lu.assertEquals(found, expected, seed)
    lu.assertEquals(tonumber(text:match('"time":[%d.]+,"frame":(%d+)')), chosen and chosen.cause.frame)
  end
end

-- A planted cause before the fault, in noise: it departs at its first message, and next to nothing else is accused.
function T.test_what_departed_first()
  local usual = { a = { 100, 1 }, b = { 3300, 8 }, c = { 45, 0.05 }, d = { 20, 0.2 } }
  local catalogue = catalogue_of.compile { { name = "m", title = "M", id = 0x210, size = 9, every = 0.1,
    { "a", "float16", "A", min = 0, max = 250 }, { "b", "float16", "B", min = -60000, max = 60000 },
    { "c", "float16", "C", min = -128, max = 128 }, { "d", "float16", "D", min = -128, max = 128 },
    { "bits", "uint8", "Bits", group = "fault", alarm = true, flags = { { "hot", 1, "Hot" } } } } }
  local message_type = catalogue.messages[1]
  local source = { bus_key = 1, bus = "can0", id = 0x210, type = message_type }
  local function noise() -- of a standard deviation of 1
    local sum = -6
    for _ = 1, 12 do sum = sum + math.random() end
    return sum
  end
  local others = 0
  for seed = 1, levels.size(40, 1000) do
    math.randomseed(seed)
    local records, lead, shape = {}, math.random(30), math.random(3)
    if lead <= 4 then shape = 1 end -- a step; else a ramp or a pulse
    local planted = message_type.fields[math.random(4)]
    local step = (planted.max - planted.min) / planted.ordinary
    local size = (math.random(2) * 2 - 3) * (15 + 10 * math.random()) * math.max(usual[planted.name][2], step)
    for frame = 1, 150 do
      local payload, behind = "", frame - 120 + lead
      for i = 1, 4 do
        local field = message_type.fields[i]
        local middle, width = usual[field.name][1], usual[field.name][2]
        local value = middle + width * noise()
        local is_changed = field == planted and behind >= 0 and (shape < 3 or behind < 3)
        if is_changed then value = value + size * (shape == 2 and behind + 1 or 1) end
        local count = math.floor((value - field.min) / (field.max - field.min) * field.ordinary + 0.5)
        count = math.max(0, math.min(field.ordinary, count))
        payload = payload .. string.char(count % 256, math.floor(count / 256))
      end
      local bits = frame >= 120 and 1 or 0
      local flags = { { field = message_type.fields[5], value = 1, raised = 1, cleared = 0 } }
      records[frame] = answers.record(frame, frame / 10, { source = source, payload = payload .. string.char(bits),
        change = frame == 120 and { flags = flags } or nil })
    end
    local what = math.random(2) == 1 and "fault,json" or "fault,frame=120,json"
    local found = answers.run({ what }, records, { catalogue = catalogue }):match('"changes":(%b[])')
    lu.assertStrContains(found, ('{"since":-%.9f,"frame":%d,"message":"m","field":"%s"'):format(lead / 10, 120 - lead,
      planted.name))
    others = others + select(2, found:gsub('"frame"', "")) - 1
  end
  lu.assertTrue(others <= levels.size(1, 20), others) -- noise, 330 values of it in each flight
end

return T
