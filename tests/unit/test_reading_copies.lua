-- SPDX-License-Identifier: GPL-2.0-or-later
-- Messages that the recorder holds twice.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local copies_of = require("yapp.reading.copies")

local T = {}

local MOTOR = { id = 0x210, bus_key = 1, type = { every = 0.1, time = {} } }
local COMMAND = { id = 0, bus_key = 1, type = { every = 0.2 } }

local PACKET = require("yapp.base.frame_key").PACKET

-- Find what rows { seconds, payload, source, seq, is bad, packet } are copies of: they come in
-- packets 1, 2, ... unless they say another; "-" for none.
local function found(rows, is_time_real)
  local copies = copies_of.new { is_time_real = function(_, time) return not is_time_real or is_time_real(time) end }
  local list, rows_by_key = {}, {}
  for i, row in ipairs(rows) do
    local key = (row[6] or i) * PACKET + i
    rows_by_key[key] = i
    local message = { key = key, time = row[1], payload = row[2], source = row[3] or MOTOR, seq = row[4] or 0,
      status = row[5] and "bad" or "good" }
    list[i] = rows_by_key[copies:find(message, false, false)] or "-"
    lu.assertEquals(rows_by_key[copies:find(message, true, false)] or "-", list[i]) -- a revisit finds the same
  end
  return list
end

function T.test_a_message_twice_and_three_times()
  lu.assertEquals(found { { 0, "a" }, { 0.0003, "a" }, { 0.1, "b" }, { 0.1, "b" }, { 0.1199, "b" } },
    { "-", 1, "-", 3, 3 })
  -- Another message of the source may come in between, and a recorder may stamp the copy earlier.
  lu.assertEquals(found { { 0, "a" }, { 0.002, "b" }, { 0.004, "a" }, { 0.005, "b" } }, { "-", "-", 1, 2 })
  lu.assertEquals(found { { 0.010, "a" }, { 0.002, "a" } }, { "-", 1 })
end

-- A controller that hangs repeats its bytes after a period; two clocks are two messages.
function T.test_what_is_no_copy()
  lu.assertEquals(found { { 0, "a" }, { 0.1, "a" }, { 0.2, "a" } }, { "-", "-", "-" })
  lu.assertEquals(found { { 0, "a" }, { 0.02, "a" }, { 0.0401, "a" } }, { "-", "-", "-" })
  lu.assertEquals(found { { 0.0405, "a" }, { 0.0605, "a" } }, { "-", "-" }) -- 0.0605 - 0.0405 is below 0.02 in doubles
  lu.assertEquals(found { { 0, "a" }, { 0.001, "b" } }, { "-", "-" })
  lu.assertEquals(found { { 0, "a" }, { 0.001, "a", MOTOR, 1 } }, { "-", "-" })
  lu.assertEquals(found { { 0, "a" }, { 0.001, "a", { id = 0x210, type = MOTOR.type } } }, { "-", "-" }) -- another bus
  local fast = { id = 0x210, bus_key = 1, type = { every = 0.02, time = {} } } -- half of it is less than 20 ms
  lu.assertEquals(found { { 0, "a", fast }, { 0.0099, "a", fast }, { 0.0101, "a", fast } }, { "-", 1, "-" })
  -- Of a source's messages the latest 16 that are no copies.
  local rows = { { 0, "a" }, { 0, "b" } }
  for i = 3, 17 do rows[i] = { i / 1000, "c" .. i } end
  rows[18], rows[19] = { 0.018, "a" }, { 0.018, "c3" }
  lu.assertEquals({ found(rows)[18], found(rows)[19] }, { "-", 3 })
  -- A damaged message is no copy of the good one.
  lu.assertEquals(found { { 0, "a" }, { 0, "a", MOTOR, 0, true }, { 0, "a", MOTOR, 0, true } }, { "-", "-", 2 })
end

-- A sender may repeat a Command: a copy needs a message with a clock that was recorded twice on its bus.
function T.test_messages_without_a_clock()
  local command, other = { 0, "c", COMMAND }, { id = 0, bus_key = 2, type = COMMAND.type }
  lu.assertEquals(found { command, command, command }, { "-", "-", "-" })
  lu.assertEquals(found { { 0, "a" }, { 0, "a" }, command, command }, { "-", 1, "-", 3 })
  lu.assertEquals(found { { 0, "a" }, { 0, "a" }, { 0, "c", other }, { 0, "c", other } }, { "-", 1, "-", "-" })
end

-- A datagram may hold several equal messages.  If it is recorded twice, each of them is.
function T.test_messages_of_one_packet()
  local motor, command, rows = { "a", MOTOR }, { "c", COMMAND }, {}
  local function add_packet(number, ...)
    for _, row in ipairs { ... } do rows[#rows + 1] = { 0, row[1], row[2], 0, nil, number } end
  end
  add_packet(1, motor, motor)
  lu.assertEquals(found(rows), { "-", "-" })
  rows = {}
  add_packet(1, motor, command, command)
  add_packet(2, motor, command, command)
  lu.assertEquals(found(rows), { "-", "-", "-", 1, 2, 3 })
  add_packet(3, motor, command, command)
  lu.assertEquals(found(rows), { "-", "-", "-", 1, 2, 3, 1, 2, 3 })
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

-- Stamps that tell nothing tell no copies.
function T.test_captures_without_times()
  local rows = { { 0, "a" }, { 0, "a" }, { 5, "a" }, { 5, "a" } }
  lu.assertEquals(found(rows, function(time) return time ~= 0 end), { "-", "-", "-", 3 })
end

return T
