-- SPDX-License-Identifier: GPL-2.0-or-later
-- Which message type an ID carries, and what its source is called.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local catalogue = require("yapp.message.catalogue")
local sources = require("yapp.message.sources")
local types_of = require("yapp.message.types")

local T = {}

local TAURUS = catalogue.compile(dofile("taurus_fields.lua"))

local function ignore() end

-- The types with these sources, IDs of messages and, or not, several buses.
local function new(text, ids, has_several)
  local parsed, problems = sources.parse(text or "", TAURUS)
  lu.assertEquals(problems, {})
  local r = types_of.new(TAURUS)
  r:use(catalogue.assign(TAURUS, ids or {}), parsed, { several_buses = has_several }, ignore)
  return r
end

local function name(message) return message and message.name or "none" end

function T.test_before_the_preferences_are_known()
  local r, size = types_of.new(TAURUS), TAURUS.by_id[0x210].size
  lu.assertEquals({ name(r:type_of(0x210)), r:size_of(0x210), name(r:type_of(0x211)) }, { "motor", size, "none" })
  r:use(catalogue.assign(TAURUS, {}), (sources.parse("", TAURUS)), {}, ignore)
  local source = r:new_source(0x123, false, "can0") -- before a capture file is known
  lu.assertEquals(source.text, "0x123")
end

function T.test_which_message_an_id_carries()
  local r = new("0x300=motor:, can1/0x301=health:, can1/0x210=health:, can0/0x200=left", { motor = { 0x210, 0x211 } })
  local found = {}
  for i, one in ipairs { { 0x210 }, { 0x211, "can1" }, { 0x300, "can0" }, { 0x301, "can0" }, { 0x301, "can1" },
    { 0x210, "can1" }, { 0x200, "can0" }, { 0 } } do
    found[i] = name(r:type_of(one[1], one[2]))
  end
  lu.assertEquals(found, { "motor", "motor", "motor", "none", "health", "health", "health", "command" })
end

function T.test_every_id_that_carries_a_message_is_visited()
  local r, ids = new("can1/0x300=health:, 0x301=tail"), {}
  r:use(catalogue.assign(TAURUS, { motor = { 0x210, 0x211 } }), r.sources, {}, function(id) ids[id] = true end)
  local expected = { [0x211] = true, [0x300] = true }
  for _, message in ipairs(TAURUS.messages) do expected[message.id] = true end
  lu.assertEquals(ids, expected)
end

function T.test_which_sizes_fit()
  local r, motor, health = new("can1/0x210=health:"), TAURUS.by_id[0x210], TAURUS.by_id[0x200]
  lu.assertEquals({ r:size_of(0x210) }, { motor.size, motor.min_size })
  lu.assertEquals(r:new_source(0x210, 1, "can1").size, health.size)
  lu.assertEquals(r:new_source(0x211, 2, "can1").text, "can1 0x211") -- of a bus that shows later
  lu.assertNil(r:size_of(0x123))
end

function T.test_what_a_source_is_called()
  for _, row in ipairs { -- sources, several buses, ID, bus, source, label
    { "", false, 0x210, nil, "0x210", "Motor Data" }, { "", false, 0x210, "can0", "0x210", "Motor Data" },
    { "", true, 0x210, "can0", "can0 0x210", "Motor Data 0x210 (can0)" },
    { "", true, 0x210, nil, "0x210", "Motor Data" }, { "", false, 0x123, "can0", "0x123", "ID 0x123" },
    { "", true, 0x123, "can0", "can0 0x123", "ID 0x123 (can0)" }, { "", true, 0x123, nil, "0x123", "ID 0x123" },
    { "0x210=left", true, 0x210, "can0", "left", "Motor Data left" },
    { "can0=left", true, 0x210, "can0", "left", "Motor Data left" },
    { "can0=left", true, 0x210, "can1", "can1 0x210", "Motor Data 0x210 (can1)" },
    { "can0/0x210+0x200=left", true, 0x200, "can0", "left", "Health left" },
    { "0x300=tail", false, 0x300, "can0", "tail", "ID 0x300 tail" },
    { "can1/0x211=motor:", false, 0x211, "can1", "0x211", "Motor Data 0x211" },
    { "can1/0x211=motor:", false, 0x210, "can0", "0x210", "Motor Data" },
    { "0x211=motor:", false, 0x200, "can0", "0x200", "Health" },
  } do
    local r = new(row[1], nil, row[2])
    local source = r:new_source(row[3], false, row[4])
    lu.assertEquals({ source.text, source.label }, { row[5], row[6] },
      ("%s, 0x%x on %s"):format(row[1], row[3], tostring(row[4])))
  end
end

function T.test_info_leaves_out_what_a_column_says()
  local r = new("0x210=left, 0x300=tail", { motor = { 0x210, 0x211 } }, true)
  r:use(r.by_id, r.sources, { hides_source = true, several_buses = true }, ignore)
  local names = { [0x210] = "Motor Data", [0x211] = "Motor Data", [0x200] = "Health", [0x300] = "ID 0x300" }
  for id, said in pairs(names) do
    local source = r:new_source(id, false, "can1")
    lu.assertEquals(source.short, said)
    lu.assertStrContains(source.label, source.name or "can1")
    lu.assertTrue(source.write == (source.type and source.type.info))
  end
  r:use(r.by_id, r.sources, { hides_values = true }, ignore)
  for _, message in ipairs(TAURUS.messages) do
    lu.assertTrue(r:new_source(message.id, false).write == message.info_rest)
  end
end

-- A serial line is told apart by port or conversation, unless the user gave a name.
function T.test_what_a_source_of_a_stream_is_called()
  local line = { label = "10.0.0.1:14550" }
  local function text(r, id) return r:new_source(id, false, nil, line).text end
  lu.assertEquals(text(new("0x200=left", nil, true), 0x210), "10.0.0.1:14550 0x210")
  lu.assertEquals(text(new("0x200=left", nil, true), 0x200), "left")
  lu.assertEquals(new("0x200=left"):new_source(0x210, false, "10.0.0.1", line).label, "Motor Data")
end

function T.test_the_id_is_told_where_it_is_not_the_default()
  local r = new("", { health = { 0x205 }, motor = { 0x210, 0x211 } })
  local function label(id, bus) return r:new_source(id, false, bus).label end
  lu.assertEquals({ label(0x205), label(0x205, "can0"), label(0x210), label(0) },
    { "Health 0x205", "Health 0x205", "Motor Data", "Command" })
end

-- The time of a message in a raw dump is its controller's.
function T.test_the_time_of_a_message()
  local r, second = new(), "\0\202\154\59\0\0\0\0"
  local function time(id, payload) return { r:time_of(id, payload) } end
  lu.assertEquals(time(0x200, second .. ("\0"):rep(9)), { 1, 0 })
  lu.assertEquals(time(0x200, ("\255"):rep(17)), {}) -- before its boot
  lu.assertEquals({ time(0x200, second:sub(1, 7)), time(0, second), time(0x123, second) }, { {}, {}, {} })
end

return T
