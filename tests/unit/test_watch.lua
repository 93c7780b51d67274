-- SPDX-License-Identifier: GPL-2.0-or-later
-- The live watch: what it shows of random packets, one a second of the wall clock, beside a model.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local answers = require("answers")
local catalogue_of = require("yapp.message.catalogue")

local EPOCH = 1700000000 -- of the first packet
local CATALOGUE = catalogue_of.compile { { name = "motor", title = "Motor Data", id = 0x210, size = 2, every = 0.1,
  info = "{volts}°",
  { "volts", "float8", "Volts", min = 0, max = 250, unit = "V" },
  { "flags", "uint8", "Flags", group = "fault", alarm = true, flags = { { "hot", 1, "Hot" } } } } }
local MOTOR, SOURCES = CATALOGUE.messages[1], {}
for i, name in ipairs { "aft", "left" } do
  SOURCES[i] = { bus_key = 1, bus = "can0", name = name, id = 0x20f + i, type = MOTOR }
end

local T, time_of, path = {}, os.time, os.tmpname()

T.setUp = answers.setUp
function T.tearDown()
  answers.tearDown()
  rawset(os, "time", time_of)
  os.remove(path)
end

-- What a run prints, its code, and how often it was stopped.
-- with  pause = seconds of the wall clock between packets; width, height, has_list = of the terminal; is_closed, rules
local function watch(records, options, with)
  local file, now, stops = assert(io.open(path, "w")), 0, 0
  file:write(with.rules or "motor.volts=10..20\n")
  file:close()
  rawset(os, "time", function() now = now + (with.pause or 1) return now end)
  function with.flush() return not with.is_closed end
  function with.terminal() return with.width or 200, with.height or 99, with.has_list end
  function with.stop() stops = stops + 1 end
  with.catalogue = CATALOGUE
  local text, code = answers.run({ ("watch,rules=%s%s"):format(path, options) }, records, with)
  return text, code, stops
end

-- The screens of a run: lists of lines, in which "!" is red.
local function screens(...)
  local list, marks = {}, { ["\27[H\27[J"] = "\1", ["\27[31m"] = "!", ["\27[m"] = "!" }
  local text = watch(...):gsub("\27%[[H31]*\27?%[?[Jm]", marks):gsub("\n\n.*", "\n")
  for screen in text:gmatch("\1([^\1]*)") do list[#list + 1] = answers.lines(screen) end
  return list
end

local function message(number, time, source, volts, hot, before)
  local flags = { field = MOTOR.by_name.flags, value = hot, raised = hot * (1 - before), cleared = before * (1 - hot) }
  local one = answers.record(number, time, { source = source, payload = string.char(volts, hot),
    change = hot ~= before and { flags = { flags } } or nil })
  one.volts, one.hot, one.rises = volts, hot == 1, flags.raised == 1
  return one
end

local function random_flight(seed)
  math.randomseed(seed)
  local records, hots, time = {}, {}, 1
  for i = 1, 30 do
    local source, hot = SOURCES[math.random(i < 15 and 2 or 1)], math.random(0, 1)
    time = time + math.random(0, 12) / 64
    records[i] = message(i, time, source, ({ 9, 10, 15, 20, 21, 255 })[math.random(6)], hot, hots[source] or 0)
    hots[source] = hot
  end
  return records
end

-- The line of a source without blanks in a row, and keys of its JSON; "!" is red.
local function line_of(state, now)
  local last, raised, latest = state.last, state.raised, "null"
  local age, length = now - last.time, last.time - state.before[2]
  if length > 0 then state.hz = (state.count - state.before[1]) / length end
  state.before = { state.count, last.time }
  local hz, is_out = age * state.hz < 2 and state.hz or 0, last.volts < 10 or last.volts > 20 and last.volts <= 250
  local line = ("%s Motor Data %d %.1f %.3f"):format(last.source.name, state.count, hz, age)
  if age > 0.25 then line = line .. " SILENT" end
  if last.hot then line = line .. " hot" elseif raised then line = line .. os.date("! (hot at %X)", EPOCH + raised) end
  if last.volts <= 250 then line = ("%s volts %d %s 10..20"):format(line, last.volts, is_out and "OUTSIDE" or "in") end
  line = line .. " " .. MOTOR.info(last.raws)
  if age > 0.25 or last.hot or is_out then line = "!" .. line .. "!" end
  if raised then latest = ('"hot","latest_fault_time":%d.%09d'):format(EPOCH + raised, state.rest * 1e9 + 5) end
  local faults = last.hot and '"hot"' or ""
  return line, ('"hz":%.4g,"age":%.9f,"faults":[%s],"latest_fault":%s'):format(hz, age, faults, latest)
end

function T.test_random_flights()
  for seed = 1, 30 do
    local records, states = random_flight(seed), {}
    local shown, json = screens(records, "", {}), answers.lines((watch(records, ",json", {})))
    lu.assertEquals(#shown, #records + 1)
    for i = 0, #records do
      local one, now, expected, found = records[i], records[math.min(i + 1, #records)].time, {}, {}
      if one then
        local state = states[one.source] or { count = 0, before = { 1, one.time }, hz = 0, first = one.time }
        states[one.source], state.count, state.last = state, state.count + 1, one
        if one.rises then state.raised, state.rest = math.floor(one.time), one.time % 1 end
      end
      for _, source in ipairs(SOURCES) do
        local line, keys = nil, nil
        if states[source] then line, keys = line_of(states[source], now) end
        expected[#expected + 1] = line
        lu.assertStrContains(json[i + 1], keys or "")
      end
      local count = #expected == 1 and "1 source" or #expected .. " sources"
      lu.assertEquals(shown[i + 1][1], ("YAPP watch: %s in %.1f s"):format(count, now))
      lu.assertEquals(json[i + 1]:match('^{"time":(%d+)'), tostring(EPOCH + math.floor(now)))
      for _, line in ipairs(shown[i + 1]) do
        if line:find(" Motor Data ") and not line:find("FAILED") then found[#found + 1] = line:gsub(" +", " ") end
      end
      lu.assertEquals(found, expected, seed)
    end
    -- Read within a second: as all of it was.
    local at_once = table.concat(screens(records, "", { pause = 0 })[1], "\n"):gsub(" +", " ")
    for _, state in pairs(states) do
      state.before, state.hz = { 1, state.first }, 0
      lu.assertStrContains(at_once, (line_of(state, records[#records].time)))
    end
  end
end

function T.test_what_does_not_fit()
  local records = random_flight(1)
  local whole = screens(records, "", {})
  for i, screen in ipairs(screens(records, "", { height = 5, pause = 9 })) do
    if i <= #records then whole[i][1] = whole[i][1] .. ", no packet for 9 s before that" end
    local more = #whole[i] - 3
    if more > 1 then whole[i][4] = ("... %d more lines: make the window higher"):format(more) end
    lu.assertEquals(screen, { whole[i][1], whole[i][2], whole[i][3], whole[i][4] })
  end
  for width = 50, 120 do -- a narrow one shows the values before the limit
    local last = screens({ message(1, 1, SOURCES[1], 15, 0, 0) }, "", { width = width })[2]
    lu.assertEquals((last[2]:find("limit") or 999) < last[2]:find("values"), width == 120)
    for _, line in ipairs(last) do lu.assertTrue(#line <= width + 2 and not line:find("[\192-\255]!?$"), line) end
  end
  lu.assertNil(watch(records, "", { has_list = true }):find("\27[H", 1, true))
end

function T.test_what_ends_a_run()
  local records = {}
  for i = 1, 9 do
    records[i] = message(i, i, SOURCES[1], i < 7 and 15 or 25, i < 4 and 0 or 1, i < 5 and 0 or 1)
  end
  for options, expected in pairs { [""] = { 10, 0, 0 }, [",stop=fault"] = { 6, 20, 1 }, [",stop=rule"] = { 9, 20, 1 },
    [" "] = { 2, 0, 1 } } do
    local text, code, stops = watch(records, ",json" .. options, { rules = "motor.volts=10..20\nmotor.count=50\n",
      is_closed = options == " " })
    lu.assertEquals({ select(2, text:gsub('"sources"', "")), code, stops }, expected)
  end
end

return T
