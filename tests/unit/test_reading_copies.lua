-- SPDX-License-Identifier: GPL-2.0-or-later
-- Messages that the recorder holds twice.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local copies_of = require("yapp.reading.copies")

local T = {}

local PACKET = require("yapp.base.frame_key").PACKET
local MOTOR = { bus_key = 1, type = { every = 0.1, time = {} } }
local UNPROVED = { bus_key = 2, type = { every = 0.2 } } -- no message with a clock is on its bus
local SOURCES = { MOTOR, { bus_key = 1, type = { every = 0.2 } }, UNPROVED, { bus_key = 3 }, { line = {} },
  { bus_key = 3, type = { every = 0.02, time = {} } }, { bus_key = 2, line = {}, type = { time = {} } } }
local STEPS = { 0, 0, 0, 0, 0, 0, 0, 0.0003, 0.0099, 0.0101, 0.0199, 0.02, 0.1 }

-- The original of a message by the definition, nil if it is no copy: the oldest of the latest 16 of its source that are
-- none.
-- before  the messages that came, with `of` and `copied_in`
local function original_of(message, before, doubled)
  local source, kept = message.source, {}
  local message_type = source.type or {}
  for i = #before, 1, -1 do
    if before[i].source == source and not before[i].of and #kept < 16 then table.insert(kept, 1, before[i]) end
  end
  for _, one in ipairs(kept) do
    local is_near = math.abs(message.time - one.time) < math.min(0.02, (message_type.every or 1) / 2) - 1e-9
    local is_same = one.payload == message.payload and one.seq == message.seq and one.status == message.status
    if is_near and is_same and one.packet ~= message.packet and one.copied_in ~= message.packet then
      local bus = source.line and "line" or source.bus_key
      if message.time < 1 then return nil end -- where stamps tell nothing
      if message_type.time then doubled[bus] = true end
      if not doubled[bus] then return nil end
      one.copied_in = message.packet
      return one
    end
  end
end

-- Also of datagrams with several equal messages, which are recorded twice, and of messages that are sent again.
function T.test_random_messages()
  local counts = {}
  for seed = 1, 150 do
    math.randomseed(seed)
    local copies = copies_of.new { is_time_real = function(_, time) return time >= 1 end }
    local before, doubled, time, packet = {}, {}, 0.99, 1
    for i = 1, 150 do
      local source = SOURCES[seed % 2 == 0 and seed % 7 + 1 or math.random(7)]
      local old = before[i - math.random(seed % 2 == 0 and 60 or 6)]
      time = time + (seed % 2 == 0 and math.random(0, 1) / 2000 or STEPS[math.random(#STEPS)])
      if math.random(3) > 1 then packet = packet + 1 end
      local message = { key = packet * PACKET + i, time = time, packet = packet, source = source,
        payload = string.char(math.random(96, 255)), seq = math.random(0, 1),
        status = math.random(9) > 1 and "good" or "bad" }
      if old and math.random(2) == 1 then
        for _, name in ipairs { "source", "payload", "seq", "status" } do message[name] = old[name] end
      end
      message.of = original_of(message, before, doubled)
      before[i] = message
      for _, visited in ipairs { false, true } do
        lu.assertEquals(copies:find(message, visited, false), message.of and message.of.key, seed)
      end
      if message.of then counts[message.source] = (counts[message.source] or 0) + 1 end
    end
  end
  for _, source in ipairs(SOURCES) do lu.assertEquals((counts[source] or 0) > 50, source ~= UNPROVED) end
end

-- A read filter (-R) drops a copy; the next packet has its number, and is none.
function T.test_a_number_that_is_used_again()
  local copies = copies_of.new { is_time_real = function() return true end }
  local function look(key, time, payload, visited)
    return copies:find({ key = key, time = time, payload = payload, source = MOTOR, seq = 0, status = "good" },
      visited, false)
  end
  look(PACKET, 0.0005, "a", false)
  lu.assertEquals(look(2 * PACKET, 0.001, "a", false), PACKET)
  lu.assertNil(look(2 * PACKET, 0.1, "b", false))
  lu.assertNil(look(2 * PACKET, 0.1, "b", true))
end

return T
