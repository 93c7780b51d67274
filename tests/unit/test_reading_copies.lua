-- SPDX-License-Identifier: GPL-2.0-or-later
-- Messages that the recorder holds twice.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local copies_of = require("yapp.reading.copies")

local T = {}

local MOTOR = { id = 0x210, type = { every = 0.1 } }

local function new(lacks_clock, stamps_differ)
  return copies_of.new {
    has_times = function() return true, not lacks_clock end,
    stamps_differ = function() return stamps_differ or false end,
  }
end

-- Find what rows { seconds, payload, source, seq } are copies of: their keys are 1, 2, ...; "-" for none.  The first
-- packet of the capture came a second earlier.
local function found(rows, lacks_clock)
  local copies, list = new(lacks_clock), {}
  for key, row in ipairs(rows) do
    local message = { key = key, time = row[1] + 1, payload = row[2], source = row[3] or MOTOR, seq = row[4] or 0 }
    list[key] = copies:find(message, false, false) or "-"
    lu.assertEquals(copies:find(message, true, false) or "-", list[key]) -- a revisit finds the same
  end
  return list
end

function T.test_a_message_twice_and_three_times()
  lu.assertEquals(found { { 0, "a" }, { 0.0003, "a" }, { 0.1, "b" }, { 0.1, "b" }, { 0.1199, "b" } },
    { "-", 1, "-", 3, 3 })
end

-- Another message of the source may come in between, and a recorder may stamp the copy earlier.
function T.test_in_any_order()
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
  local other_bus = { id = 0x210, type = MOTOR.type }
  lu.assertEquals(found { { 0, "a" }, { 0.001, "a", other_bus } }, { "-", "-" })
end

-- A damaged message is no copy of the good one, nor is one with other damage.
function T.test_damaged_messages()
  local copies, list = new(), {}
  for key, crc in ipairs { 0, 7, 7, 8, 0 } do -- the first message comes after the first packet
    local message = { key = key, time = key / 1000, payload = "a", source = MOTOR, seq = 0,
      status = crc > 0 and "bad" or "good", transfer = { crc = crc } }
    list[key] = copies:find(message, false, true) or "-"
  end
  lu.assertEquals(list, { "-", "-", 2, "-", 1 })
  lu.assertNil(next(copies.originals)) -- nobody asks again
end

-- A read filter (-R) drops a copy; the next packet has its number, and is none.
function T.test_a_number_that_is_used_again()
  local copies = new()
  local function look(key, time, payload, visited)
    return copies:find({ key = key, time = time, payload = payload, source = MOTOR, seq = 0 }, visited, false)
  end
  look(1, 0.0005, "a", false)
  lu.assertEquals(look(2, 0.001, "a", false), 1)
  lu.assertNil(look(2, 0.1, "b", false))
  lu.assertNil(look(2, 0.1, "b", true))
end

-- The fragments of the first message take time: it is not the first packet.
function T.test_the_first_message()
  local copies = new()
  local function find(key)
    return copies:find({ key = key, time = 0.0005, payload = "a", source = MOTOR, seq = 0 }, false, true)
  end
  lu.assertNil(find(9))
  lu.assertEquals(find(10), 9)
end

-- Half the period of a fast message is less than 20 ms; a message of no known type has 20 ms.
function T.test_how_far_a_copy_may_be()
  local fast, unknown = { type = { every = 0.01 } }, {}
  lu.assertEquals(found { { 0, "a", fast }, { 0.0049, "a", fast }, { 0.0051, "a", fast } }, { "-", 1, "-" })
  lu.assertEquals(found { { 0, "a", unknown }, { 0.0199, "a", unknown }, { 0.0201, "a", unknown } }, { "-", 1, "-" })
end

-- Many messages of a source within 20 ms: the oldest are forgotten, none is found twice.
function T.test_a_fast_source()
  local rows, expected, source = {}, {}, {}
  for i = 1, 40 do
    rows[2 * i - 1], rows[2 * i] = { i / 10000, "m" .. i, source }, { i / 10000, "m" .. i, source }
    expected[2 * i - 1], expected[2 * i] = "-", 2 * i - 1
  end
  lu.assertEquals(found(rows), expected)
end

-- Of 17 the first one is forgotten, of 18 the second one, too.
function T.test_the_oldest_is_forgotten()
  for count, expected in pairs { [16] = { 1, 2, 3, 16 }, [17] = { "-", 2, 3, 17 }, [18] = { "-", "-", 3, 18 } } do
    local rows = {}
    for i = 1, count do rows[i] = { i / 10000, "m" .. i } end
    for i, name in ipairs { "m1", "m2", "m3", "m" .. count } do
      rows[count + 1] = { 0.002, name }
      lu.assertEquals(found(rows)[count + 1], expected[i], count .. name)
    end
  end
end

-- Without times of packets, all messages come at once; so do they until the time advances.
function T.test_captures_without_times()
  lu.assertEquals(found({ { 0, "a" }, { 0, "a" } }, true), { "-", "-" })
  local copies, list = new(), {}
  for key, time in ipairs { 0, 0, 0, 5, 5 } do
    list[key] = copies:find({ key = key, time = time, payload = "a", source = MOTOR, seq = 0 }, false, true) or "-"
  end
  lu.assertEquals(list, { "-", "-", "-", "-", 4 })
end

-- If the file has another stamp, the first packet's stamp means something, too.
function T.test_the_first_message_of_a_capture_twice()
  for stamps_differ, expected in pairs { [true] = { "-", 1, 1 }, [false] = { "-", "-", "-" } } do
    local copies, list = new(false, stamps_differ), {}
    for key = 1, 3 do
      list[key] = copies:find({ key = key, time = 0, payload = "a", source = MOTOR, seq = 0 }, false, true) or "-"
    end
    lu.assertEquals(list, expected)
  end
end

-- Some programs give one stamp to all that they send: equal Commands are no copies of the first one, once another
-- source shows that time goes on.  A source whose stamps go on later is a usual one.
function T.test_a_source_whose_stamps_stand_still()
  local sent, other = { id = 0, type = { every = 0.2 } }, {}
  local rows = {}
  for i = 0, 5 do
    rows[#rows + 1] = { 0, "command", sent }
    rows[#rows + 1] = { 5 + i / 10, "m" .. i }
  end
  lu.assertEquals(found(rows), { "-", "-", 1, "-", "-", "-", "-", "-", "-", "-", "-", "-" })
  lu.assertEquals(found { { 0, "a", sent }, { 0, "a", sent }, { 0.05, "m", other }, { 0.1, "n", other },
    { 0.2, "a", sent }, { 0.2, "a", sent } }, { "-", 1, "-", "-", "-", 5 })
end

-- What another source sent before shows nothing, nor does the first message of one that comes later.
function T.test_other_sources_that_do_not_advance()
  local sent, other, third = { id = 0, type = { every = 0.2 } }, {}, {}
  lu.assertEquals(found { { 0, "m", other }, { 0.5, "n", other }, { 0.6, "a", sent }, { 0.6, "a", sent },
    { 0.6, "a", sent } }, { "-", "-", "-", 3, 3 })
  lu.assertEquals(found { { 0, "a", sent }, { 0, "a", sent }, { 0.01, "m", third }, { 0, "a", sent } },
    { "-", 1, "-", 1 })
  local copies, times = new(false, true), { 0, 0, 0.02, 0 } -- of 20 ms, which is an advance
  for i, source in ipairs { sent, third, third, sent } do
    local message = { key = i, time = times[i], payload = source == sent and "a" or i, source = source, seq = 0 }
    lu.assertNil(copies:find(message, false, true))
    message.key, message.payload, message.source = 9, "a", sent
    if i == 2 then lu.assertEquals(copies:find(message, false, true), 1) end
  end
end

return T
