-- SPDX-License-Identifier: GPL-2.0-or-later
-- CAN buses: what random error frames are, and the answer of -z yapp,buses, against plain models of both.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local buses_of = require("yapp.stat.buses")
local kinds = require("yapp.stat.kinds")

local T = {}

-- A SocketCAN record: top is the highest byte of its id.
local function record(top, length, flags)
  return string.char(top, 0, 0, 1, length, flags or 0, 0, 0) .. ("\0"):rep(length)
end

local COOKED = "\0\0\1\24\0\0\0\0\0\0\0\0\0\0\0\12"
local FRAMES = { -- packet, bits without stuffing, bits that it lengthens: counted by hand
  { record(0, 0), 47, 34 }, { record(0, 8), 111, 98 }, { record(0x80, 0), 67, 54 }, { record(0x80, 8), 131, 118 },
  { record(0xC0, 8), 67, 54 }, -- remote
  { record(0x80, 64, 4), 579, 566 }, -- CAN FD
  { COOKED .. "\1\0\0\128\8\0\0\0" .. ("\0"):rep(8), 131, 118 },
  { "\0\12\0\0\0\0\0\3\1\24" .. ("\0"):rep(10) .. "\1\0\0\0\4\0\0\0abcd", 79, 66 },
  { "\128\0\0", 0, 0 }, -- cut by the snap length
}
-- What an error frame reports, the gravest first: bits of its class, bits of the controller's state.
local REPORTS = {
  { "off", 0x40, 0 }, { "passive", 4, 0x10, 0x20 }, { "restarted", 0x100, 0 }, { "no_ack", 0x20, 0 },
  { "tx_timeout", 1, 0 }, { "overflow", 4, 1, 2 }, { "warning", 4, 4, 8, 0x40 }, { "protocol", 8, 0 },
  { "arbitration", 2, 0 }, { "bus", 0x10, 0 }, { "bus", 0x80, 0 }, { "bus", 0x200, 0 }, {},
}
local STATES = { off = true, passive = true, restarted = true, warning = true }

-- A random error frame: its packet, its reports by name, and the gravest.
local function random_error()
  local class, state, reports, has_bit = 0, 0, {}, {}
  for _ = 1, math.random(0, 3) do
    local row = REPORTS[math.random(#REPORTS - 1)]
    if not has_bit[row[2]] then class, has_bit[row[2]] = class + row[2], true end
    local bit = row[math.random(3, #row)]
    if not has_bit["state" .. bit] then state, has_bit["state" .. bit] = state + bit, true end
    reports[row[1]] = true
  end
  if not has_bit[4] then state = math.random(0, 255) end -- means nothing
  local packet, gravest = string.char(0x20, 0, math.floor(class / 256), class % 256), "bus"
  if math.random(2) == 1 then packet = COOKED .. packet:reverse() end
  for i = #REPORTS - 1, 1, -1 do gravest = reports[REPORTS[i][1]] and REPORTS[i][1] or gravest end
  return packet .. "\8\0\0\0\0" .. string.char(state) .. ("\0"):rep(6), reports, gravest
end

-- Append the events of an error frame, as texts.
-- known  of its bus: state, and the latest time of each report that is none
local function add_expected(list, known, name, time, reports)
  local function add(kind, value) list[#list + 1] = ("%s %s %s %s"):format(name, time, kind, value) end
  add("bus_errors", "")
  local has_state = false
  for _, row in ipairs(REPORTS) do
    local what = row[1]
    if reports[what] and STATES[what] then
      if not has_state and known.state ~= what then
        if what ~= "warning" then add("bus", what) end
        if what == "off" or what == "passive" then add("bus_" .. what, name) end
        if what ~= "passive" then known.no_ack, known.tx_timeout = nil, nil end
        known.state = what
      end
      has_state = true
    elseif reports[what] and (what == "no_ack" or what == "tx_timeout") then
      if not known[what] or time - known[what] > 1 then add("bus", what) end
      known[what] = time
    elseif reports[what] and what == "overflow" then
      add("dropped", "1")
    end
  end
end

-- The highest sum of bits within a second, of frames { time, bits }.
local function highest(frames)
  local most = 0
  for first = 1, #frames do
    local sum = 0
    for i = first, #frames do sum = sum + (frames[i][1] - frames[first][1] < 1 and frames[i][2] or 0) end
    most = math.max(most, sum)
  end
  return most
end

-- The row of a bus with frames { time, bits }, and errors { [gravest report] = count }.
local function row_of(bus, bitrate, lacks_times)
  local frames, bits, texts = bus.frames, 0, {}
  for _, frame in ipairs(frames) do bits = bits + frame[2] end
  for i, report in ipairs(REPORTS) do
    local name = report[1]
    if bus.errors[name] and name ~= REPORTS[i + 1][1] then texts[#texts + 1] = bus.errors[name] .. " " .. name end
  end
  local row = { frames = #frames, yapp = bus.yapp, others = #frames - bus.yapp, errors = table.concat(texts, ", ") }
  if not frames[1] then return row end
  local first, last = frames[1][1], frames[#frames][1]
  row.first, row.last = ("%.6f"):format(first), ("%.6f"):format(last)
  if lacks_times or first == last then return row end
  row.rate = (#frames - 1) / (last - first)
  if not bitrate then return row end
  local share, most = bits / (last - first) / bitrate, highest(frames) / math.min(1, last - first) / bitrate
  row.load, row.load_text = share, ("%.1f %%"):format(100 * share)
  row.load_max, row.max_text = most, ("%.1f %%"):format(100 * most)
  return row
end

function T.test_random_buses()
  for seed = 1, 200 do
    math.randomseed(seed)
    local bitrate, lacks_times = math.random(2) == 1 and 125000 or nil, math.random(4) == 1 and "none"
    local statistic, time, events, expected, list = buses_of.new { bitrate = bitrate }, 5, {}, {}, {}
    local add_error = buses_of.new_errors(function(event)
      local values = event.values
      local value = values.what or values.note or values.count or ""
      events[#events + 1] = ("%s %s %s %s"):format(event.source.bus, event.time, event.kind, value)
      statistic:add_event(event)
    end)
    local buses = {}
    for i = 0, 1 do buses[i] = { source = { bus = "can" .. i }, frames = {}, yapp = 0, errors = {}, known = {} } end
    for _ = 1, math.random(40) do
      time = time + math.random(0, 9) / 8
      local bus = buses[math.random(0, 1)]
      if not bus.is_known then bus.is_known, list[#list + 1] = true, bus end
      if math.random(3) == 1 then
        local frame, is_yapp = FRAMES[math.random(#FRAMES)], math.random(2) == 1
        bus.frames[#bus.frames + 1] = { time, frame[2] + frame[3] / 30 }
        bus.yapp = bus.yapp + (is_yapp and 1 or 0)
        statistic:add_frame(bus.source, time, frame[1], is_yapp)
      else
        local packet, reports, name = random_error()
        bus.errors[name] = (bus.errors[name] or 0) + 1
        add_expected(expected, bus.known, bus.source.bus, time, reports)
        local values = { reports = buses_of.read_error(packet) }
        add_error(kinds.new_event("bus_errors", 1, time, bus.source, values))
      end
    end
    lu.assertEquals(events, expected)
    local rows = statistic:rows { lacks_times = lacks_times }
    for i, row in ipairs(rows) do
      local load, most = row.load or {}, row.load_max or {}
      lu.assertEquals(row.bus, list[i].source.bus)
      lu.assertAlmostEquals({ frames = row.frames, yapp = row.yapp, others = row.others, errors = row.errors.text,
        rate = row.rate, first = row.first and row.first.text, last = row.last and row.last.text, load = load.value,
        load_text = load.text, load_max = most.value, max_text = most.text },
        row_of(list[i], bitrate, lacks_times), 1e-9, seed)
    end
    lu.assertEquals(#rows, #list)
  end
end

-- What stands near a silence, a loss or a fault, of random events.
function T.test_bus_events_near_another()
  local is_near = { silence = true, fault = true, crc = true, incomplete = true, unfinished = true, missing = true,
    dropped = true, skipped = true }
  for seed = 1, 100 do
    math.randomseed(seed)
    local row, bus_events, texts = kinds.LIST[math.random(#kinds.LIST)], {}, {}
    local length = row.name == "silence" and math.random(0, 20) / 4 or 0
    local at_10, values = seed % 9 > 0 and 10 or nil, { length = { json = length } }
    local event = kinds.new_event(row.name, 1, at_10, { bus = "can0" }, values)
    for at = 1, 20 do
      local time, what = at + math.random(0, 3) / 4, ({ "off", "no_ack" })[math.random(2)]
      local bus = math.random(3) == 1 and "can1" or "can0"
      bus_events[at] = kinds.new_event("bus", 1, time, { bus = bus }, { what = what })
      if bus == "can0" and event.time and is_near[row.name] and time >= 9 and time <= 11 + length then
        texts[#texts + 1] = ("%s at %.3f s"):format(what, time)
      end
    end
    lu.assertEquals(buses_of.near(event, bus_events), texts[1] and "bus " .. table.concat(texts, ", "))
  end
end

return T
