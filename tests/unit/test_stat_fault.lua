-- SPDX-License-Identifier: GPL-2.0-or-later
-- The card of a fault, from events: which fault it is about, what changed before it, and what else it shows.
-- tests/e2e/test_fault.py has what departed first in random flights.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local catalogue_of = require("yapp.message.catalogue")
local dates_of = require("yapp.stat.dates")
local fault_of = require("yapp.stat.fault")
local kinds = require("yapp.stat.kinds")
local output = require("yapp.stat.output")

local T = {}

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
  local one = { printed = printed }
  function one.send(source, time, ...)
    frame = frame + 1
    local raws = { ... }
    local event = kinds.new_event("message", frame, time, source, nil, { seq = 0, raws = raws })
    statistic:add_event(event)
    return event
  end
  function one.flag(cause, what, name, incident)
    local values = { field = "flags", flag = name, event = what, incident = incident, help = "why" }
    statistic:add_event(kinds.new_follower("fault", cause, values))
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

-- A sensor fails; the bus's latest Command is shown where the controller has none of its own, with its change.
function T.test_a_reserved_value_and_the_command_of_the_bus()
  local one = flight { }
  for i = 1, 4 do
    one.send(REAR, i, i < 4 and 1 or 0)
    if i == 2 then one.send(FRONT, i, 0) end
  end
  fly(one, LEFT, 10, 255, 255)
  one.flag(one.send(LEFT, 10, 255, 1, 0), "raised", "hot", {})
  local text = one.finish()
  has(text, "-6.000      5  command  enabled     1    0\n" ..
    "-0.110    104  motor    volts    10.50  inf  V", "-6.000      5  can0 0x5  Disabled\n")
end

function T.test_which_fault()
  local function titles(options)
    local one = flight(options)
    for number = 1, 3 do
      local cause, incident = one.send(number == 2 and RIGHT or LEFT, number, 10, 1, 0), {} -- frames 1, 4, 7
      one.flag(cause, "raised", number == 2 and "stall" or "hot", incident)
      one.send(number == 2 and RIGHT or LEFT, number + 0.1, 10, 1, 0)
      one.flag(one.send(cause.source, number + 0.2, 10, 0, 0), "cleared", "hot", incident)
    end
    local text, code, problem = one.finish()
    return text:match("YAPP fault[^\n]*"), code, problem
  end
  for number, title in ipairs { "1 of 3", "2 of 3", "3 of 3" } do
    lu.assertEquals(titles { number = number }, "YAPP fault: " .. title)
    for behind = 0, 2 do lu.assertEquals(titles { frame = 3 * number - 2 + behind }, "YAPP fault: " .. title) end
  end
  lu.assertEquals({ titles { number = 4 } }, { "YAPP fault: 3", 21, "there is no such fault: the capture has 3" })
  lu.assertEquals({ titles { frame = 10 } }, { "YAPP fault: 3", 21, "there is no such fault: the capture has 3" })
  lu.assertEquals({ flight({ }).finish() }, { "YAPP fault: 0\na note\n" })
end

function T.test_json()
  lu.assertStrContains(flight({ }, true).finish(), '"incidents":0')
  local one = flight({ }, true)
  one.flag(one.send(LEFT, 1, 255, 1, 0), "raised", "hot", {})
  local who = '"bus":"can0","id":528,"source":"left","message":"motor",'
  has(one.finish(), '{"incident":1,"incidents":1,"time":1.000000000,"frame":1,' .. who,
    '"flags":[{"since":0.000000000,"field":"flags","flag":"hot","help":"why"}],' ..
    '"changes":[],"command":[],"others":[],"events":[],"messages":[{"since":0.000000000,"frame":1,' ..
    who .. '"values":{"volts":null,"flags":1,"state":0}}]}')
end

return T
