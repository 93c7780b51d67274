-- SPDX-License-Identifier: GPL-2.0-or-later
-- The reader: which message an ID carries, what its source is called, what a finished message gets.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local catalogue = require("yapp.message.catalogue")
local frame_key = require("yapp.base.frame_key")
local reader = require("yapp.message.reader")
local sources = require("yapp.message.sources")

local T = {}

local TAURUS = catalogue.compile(dofile("taurus_fields.lua"))
local COMMAND, MOTOR, HEALTH = TAURUS.by_id[0], TAURUS.by_id[0x210], TAURUS.by_id[0x200]

local function ignore() end

-- A reader with these sources, IDs of messages and, or not, several buses.
local function new(text, ids, has_several)
  local parsed, problems = sources.parse(text or "", TAURUS)
  lu.assertEquals(problems, {})
  local r = reader.new(TAURUS, { wanted = false })
  r:reset(has_several or false)
  r:use(catalogue.assign(TAURUS, ids or {}), parsed, false, ignore)
  return r
end

local function name(message) return message and message.name or "none" end

function T.test_before_the_preferences_are_known()
  local r = reader.new(TAURUS, { wanted = false })
  lu.assertEquals({ name(r:message_of(0x210)), r:size_of(0x210), name(r:message_of(0x211)) }, { "motor", 32, "none" })
  r:use(catalogue.assign(TAURUS, {}), (sources.parse("", TAURUS)), false, ignore)
  local source = r:new_source(0x123, false, "can0") -- before a capture file is known
  lu.assertEquals(source.text, "0x123")
  lu.assertStrContains(r:hint { source = source, size = 32, status = "good", key = 1 }, "the size of Motor Data")
end

function T.test_which_message_an_id_carries()
  local r = new("0x300=motor:, can1/0x301=health:, can1/0x210=health:, can0/0x200=left", { motor = { 0x210, 0x211 } })
  local found = {}
  for i, one in ipairs { { 0x210 }, { 0x211, "can1" }, { 0x300, "can0" }, { 0x301, "can0" }, { 0x301, "can1" },
    { 0x210, "can1" }, { 0x200, "can0" }, { 0 } } do
    found[i] = name(r:message_of(one[1], one[2]))
  end
  lu.assertEquals(found, { "motor", "motor", "motor", "none", "health", "health", "health", "command" })
end

function T.test_every_id_that_carries_a_message_is_visited()
  local r, ids = new("can1/0x300=health:, 0x301=tail"), {}
  r:use(catalogue.assign(TAURUS, { motor = { 0x210, 0x211 } }), r.sources, false, function(id) ids[id] = true end)
  local expected = { [0x211] = true, [0x300] = true }
  for _, message in ipairs(TAURUS.messages) do expected[message.id] = true end
  lu.assertEquals(ids, expected)
end

function T.test_which_sizes_fit()
  local r = new("can1/0x210=health:")
  lu.assertEquals({ r:size_of(0x210) }, { 32, 32 })
  lu.assertEquals(r:new_source(0x210, 1, "can1").size, 17)
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
    { "can1/0x211=motor:", false, 0x211, "can1", "0x211", "Motor Data 0x211 (can1)" },
    { "can1/0x211=motor:", false, 0x210, "can0", "0x210", "Motor Data 0x210 (can0)" }, -- two IDs carry it
    { "can1/0x211=motor:", false, 0x210, nil, "0x210", "Motor Data 0x210" },
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
  r:use(r.by_id, r.sources, true, ignore)
  local names = { [0x210] = "Motor Data", [0x211] = "Motor Data", [0x200] = "Health", [0x300] = "ID 0x300" }
  for id, said in pairs(names) do
    lu.assertEquals(r:new_source(id, false, "can1").label, said)
  end
end

-- A serial line is told apart by port or conversation, unless the user gave a name.
function T.test_what_a_source_of_a_stream_is_called()
  local line = { label = "10.0.0.1:14550" }
  local function text(r, id) return r:new_source(id, false, nil, line).text end
  lu.assertEquals(text(new("0x200=left", nil, true), 0x210), "10.0.0.1:14550 0x210")
  lu.assertEquals(text(new("0x200=left", nil, true), 0x200), "left")
end

function T.test_the_id_is_told_where_it_is_not_the_default()
  local r = new("", { health = { 0x205 }, motor = { 0x210, 0x211 } })
  local function label(id, bus) return r:new_source(id, false, bus).label end
  lu.assertEquals({ label(0x205), label(0x205, "can0"), label(0x210), label(0) },
    { "Health 0x205", "Health 0x205 (can0)", "Motor Data 0x210", "Command" })
end

function T.test_the_name_that_the_user_gave()
  local r = new("can0=left")
  lu.assertEquals(r:new_source(5, 1, "can0").name, "left")
  lu.assertNil(r:new_source(5, 2, "can1").name)
end

function T.test_the_hint_of_an_unknown_id()
  local r = new()
  local advice = ': see the preference "Motor Data message IDs"'
  local m = { source = r:new_source(0x123, false), size = 32, status = "good", key = 7 }
  local text = "Message ID 0x123 is not in the catalogue; 32 bytes, the size of Motor Data" .. advice
  lu.assertEquals({ r:hint(m) }, { text, ", the size of Motor Data" .. advice, "motor" })
  lu.assertEquals({ r:hint(m) }, { text, ", the size of Motor Data" .. advice, "motor" }) -- a later look
  m.key = 8
  lu.assertEquals({ r:hint(m) }, { text, ", the size of Motor Data", "motor" })
  r:reset(false)
  lu.assertEquals({ r:hint(m) }, { text, ", the size of Motor Data" .. advice, "motor" })
  local unknown = { "Message ID 0x124 is not in the catalogue" }
  local source = r:new_source(0x124, false)
  lu.assertEquals({ r:hint { source = source, size = 5, status = "good", key = 1 } }, unknown)
  lu.assertEquals({ r:hint { source = source, size = 32, status = "bad", key = 1 } }, unknown)
end

-- A message that is read, of a payload of zeros with some bytes changed.
local function read(r, message, bytes, with)
  local payload = ("\0"):rep(message.size)
  for offset, byte in pairs(bytes) do
    payload = payload:sub(1, offset) .. string.char(byte) .. payload:sub(offset + 2)
  end
  with = with or {}
  local m = { source = r:new_source(with.id or message.id, false), size = message.size, payload = payload,
    status = "good" }
  for key, value in pairs(with) do m[key] = value end
  r:read(m, { note = function() return { missing = 1 }, 1 end }, {})
  return m
end

local function at(message, field) return message.by_name[field].offset end

function T.test_what_a_message_gets()
  local r = new()
  local m = read(r, HEALTH, { [at(HEALTH, "board_revision")] = 9 })
  local revision = m.raws[HEALTH.by_name.board_revision.index]
  lu.assertEquals({ m.source.message, revision, m.is_remarkable, m.has_fault, m.change },
    { HEALTH, 9, false, false, { missing = 1 } })
  for _, with in ipairs { { id = 0x123 }, { size = 16 }, { status = "incomplete" },
    { status = "overrun" }, { size = 18, status = "bad" } } do
    m = read(r, HEALTH, {}, with)
    lu.assertEquals({ m.raws or "none", m.is_remarkable or "none", m.has_fault or "none", m.undecoded or "none" },
      { "none", "none", "none", "none" })
  end
end

function T.test_whether_captured_bytes_are_at_their_offsets()
  local r, found = new(), {}
  local history = { note = function() return nil, false end }
  for i, status in ipairs { "good", "bad", "truncated", "incomplete", "overrun" } do
    found[i] = r:read({ source = r:new_source(0x200, false), size = 17, payload = "", status = status }, history, {})
  end
  lu.assertEquals(found, { true, true, true, false, false })
end

-- A firmware that appended something: what the catalogue knows counts, the record of the next message is clean.
function T.test_a_longer_payload()
  local r, fault = new(), at(MOTOR, "fault_flags")
  local m = read(r, MOTOR, { [fault] = 1 }, { size = 36 })
  lu.assertEquals({ m.raws[MOTOR.by_name.fault_flags.index], m.has_fault, m.undecoded }, { 1, true, 4 })
  m = read(r, MOTOR, {}, { undecoded = 4 })
  lu.assertNil(m.undecoded)
end

-- One entry for two firmwares.
function T.test_a_shorter_payload()
  local entries = dofile("taurus_fields.lua")
  for _, entry in ipairs(entries) do
    if entry.name == "motor" then entry.min_size = 30 end
  end
  local compiled = catalogue.compile(entries)
  local r = reader.new(compiled, { wanted = false })
  r:use(catalogue.assign(compiled, {}), (sources.parse("", compiled)), false, ignore)
  local found = {}
  for size = 29, 33 do
    local m = { source = r:new_source(0x210, false), size = size, payload = ("\1"):rep(size),
      status = size == 31 and "bad" or "good" }
    r:read(m, { note = function() return nil, false end }, {})
    found[#found + 1] = ("%d %s %s"):format(size, m.raws and "read" or "bytes", m.undecoded or "-")
  end
  lu.assertEquals(found, { "29 bytes -", "30 read -", "31 read -", "32 read -", "33 read 1" })
  lu.assertEquals({ r:size_of(0x210) }, { 32, 30 })
  local source = r:new_source(0x210, false)
  lu.assertEquals({ source.size, source.min_size }, { 32, 30 })
end

function T.test_nothing_new()
  local r = new()
  local m = { source = r:new_source(0x200, false), size = 17, payload = ("\0"):rep(17), status = "good" }
  r:read(m, { note = function() return nil, false end }, {})
  lu.assertFalse(m.change)
end

-- Reads Health in order, or once more, with a history that answers this; returns the message and what the history was
-- asked.
local function read_with(answer, with, without_state)
  local r = new()
  local m = { source = r:new_source(0x200, false), size = 17, payload = ("\0"):rep(17), status = "good",
    is_unreliable = false, key = frame_key.PACKET * 7, visited = false }
  for key, value in pairs(with or {}) do m[key] = value end
  local asked, h = {}, {}
  for _, method in ipairs { "note", "change", "state" } do
    h[method] = function(_, one)
      lu.assertEquals(one, m)
      asked[#asked + 1] = method
      return answer[method], answer.delta
    end
  end
  r:read(m, h, { state = not without_state })
  return m, table.concat(asked, " ")
end

function T.test_what_the_history_is_asked()
  local m, asked = read_with { note = { reboot = 3 }, delta = 0.5 }
  lu.assertEquals({ m.change, m.delta, m.state, asked }, { { reboot = 3 }, 0.5, false, "note state" })
  m, asked = read_with({ delta = false }, {}, true)
  lu.assertEquals({ m.change, m.delta, m.state, m.is_unreliable, asked }, { false, false, false, false, "note" })
  m, asked = read_with({ change = { late = 1 }, delta = 0.5 }, { visited = true })
  lu.assertEquals({ m.change, m.delta, m.state, m.is_unreliable, asked },
    { { late = 1 }, 0.5, false, false, "change state" })
  m = read_with({}, { visited = true }) -- the first pass did not ask the history
  lu.assertEquals({ m.delta, m.is_unreliable }, { false, true })
  m, asked = read_with({ note = { late = 1 } }, { is_unreliable = true }) -- nothing tells its bus
  lu.assertEquals({ m.change, m.delta, m.state, m.is_unreliable, asked }, { false, false, false, true, "" })
end

function T.test_the_state_is_the_history_s()
  lu.assertEquals(read_with({ delta = 1, state = { drift = 1, command_in = 5 } }).state, { drift = 1, command_in = 5 })
end

-- Several controllers share its source: the history says so, in order and on a revisit.
function T.test_an_unreliable_source()
  for _, visited in ipairs { false, true } do
    local function is_unreliable(change)
      return read_with({ note = change, change = change, delta = 1 }, { visited = visited }).is_unreliable
    end
    lu.assertTrue(is_unreliable { shared = true, unreliable = true })
    lu.assertTrue(is_unreliable { unreliable = true })
    lu.assertFalse(is_unreliable { reboot = 3 })
    lu.assertFalse(is_unreliable(nil))
  end
end

function T.test_what_is_a_fault()
  local r = new()
  local fault, status, state = at(MOTOR, "fault_flags"), at(MOTOR, "status_flags"), at(MOTOR, "motor_state")
  for _, row in ipairs { { {}, false }, { { [fault] = 1 }, true }, { { [fault + 2] = 0x08 }, true }, -- undefined
    { { [status] = 2 }, false }, { { [state] = 0x1F }, false }, { { [state] = 0x20 }, true } } do
    lu.assertEquals(read(r, MOTOR, row[1]).has_fault, row[2])
  end
  lu.assertFalse(read(r, COMMAND, {}).has_fault) -- a key that is none
end

function T.test_statistics_are_told_while_they_want_it()
  local told, stat = {}, { wanted = false }
  function stat.message(_, m) told[#told + 1] = m.source.id end
  local r = reader.new(TAURUS, stat)
  r:use(catalogue.assign(TAURUS, {}), (sources.parse("", TAURUS)), false, ignore)
  read(r, MOTOR, {})
  stat.wanted = true
  read(r, HEALTH, {})
  lu.assertEquals(told, { 0x200 })
end

return T
