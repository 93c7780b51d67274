-- SPDX-License-Identifier: GPL-2.0-or-later
-- What a transfer means: its values, and what the history knows.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local catalogue = require("yapp.message.catalogue")
local frame_key = require("yapp.base.frame_key")
local reading_of = require("yapp.reading.reading")
local sources = require("yapp.message.sources")
local types_of = require("yapp.message.types")

local T = {}

local TAURUS = catalogue.compile(dofile("taurus_fields.lua"))
local MOTOR, HEALTH = TAURUS.by_id[0x210], TAURUS.by_id[0x200]

local function new_types(compiled)
  local types = types_of.new(compiled or TAURUS)
  types:use(catalogue.assign(compiled or TAURUS, {}), (sources.parse("", compiled or TAURUS)), {}, function() end)
  return types
end

-- A history that answers this, and writes what it was asked into a list.
local function history_of(answer, asked)
  local history = {}
  for _, method in ipairs { "add", "change", "state" } do
    history[method] = function()
      asked[#asked + 1] = method
      return answer[method], answer.delta
    end
  end
  return history
end

-- A reading with this history, to which each message is a copy of this one, or of none.
local function reading_with(types, history, key)
  local reading = reading_of.new(types, {}, nil)
  reading.history, reading.copies = history, { find = function() return key end }
  return reading
end

-- Read a message of a payload of zeros with some bytes changed.
-- bytes   { [offset] = value }
-- with    of the transfer: status, size; of the frame: id, line, key, visited, is_bus_known, wants_state; answer = of
--         the history
-- returns the message, what the history was asked, and whether the message is usual
local function read(of_type, bytes, with)
  with = with or {}
  local payload, asked, types = ("\0"):rep(of_type.size), {}, new_types()
  for offset, byte in pairs(bytes or {}) do
    payload = payload:sub(1, offset) .. string.char(byte) .. payload:sub(offset + 2)
  end
  local reading = reading_with(types, history_of(with.answer or { delta = 1 }, asked), with.copy_of)
  local frame = { source = types:new_source(with.id or of_type.id, false, nil, with.line), seq = 0,
    key = with.key or 7 * frame_key.PACKET, time = 1, visited = with.visited or false,
    is_bus_known = with.is_bus_known ~= false, is_only_pass = false, wants_state = with.wants_state or false }
  local transfer = { status = with.status or "good", size = with.size or of_type.size, payload = payload }
  local message, is_usual = reading:read_message(frame, transfer)
  return message, table.concat(asked, " "), is_usual
end

local function at(message, field) return message.by_name[field].offset end

function T.test_what_a_message_gets()
  local m = read(HEALTH, { [at(HEALTH, "board_revision")] = 9 }, { answer = { add = { missing = 1 }, delta = 1 } })
  local revision = m.raws[HEALTH.by_name.board_revision.index]
  lu.assertEquals({ m.source.type, revision, m.remarks[1] or false, m.change, m.delta },
    { HEALTH, 9, false, { missing = 1 }, 1 })
  for _, with in ipairs { { id = 0x123 }, { size = HEALTH.min_size - 1 }, { size = HEALTH.size + 1, status = "bad" },
    { status = "incomplete" }, { status = "overrun" } } do
    m = read(HEALTH, {}, with)
    lu.assertEquals({ m.raws, m.remarks[1] or false, m.undecoded }, { false, false, false })
  end
end

-- A firmware that appended something: what the catalogue knows counts, the next message is clean.
function T.test_a_longer_payload()
  local m = read(MOTOR, { [at(MOTOR, "fault_flags")] = 1 }, { size = MOTOR.size + 4 })
  lu.assertEquals({ m.raws[MOTOR.by_name.fault_flags.index], m.has_fault, m.undecoded }, { 1, true, 4 })
  lu.assertFalse(read(MOTOR).undecoded)
end

-- One entry for two firmwares.
function T.test_a_shorter_payload()
  local entries, found = dofile("taurus_fields.lua"), {}
  for _, entry in ipairs(entries) do
    if entry.name == "motor" then entry.min_size = entry.size - 2 end
  end
  local types = new_types(catalogue.compile(entries))
  for more = -3, 1 do
    local size = MOTOR.size + more
    local reading = reading_with(types, history_of({ delta = 1 }, {}))
    local m = reading:read_message(
      { source = types:new_source(0x210, false), key = 1, visited = false, is_bus_known = true },
      { size = size, payload = ("\1"):rep(size), status = more == -1 and "bad" or "good" })
    found[#found + 1] = ("%d %s %s"):format(more, m.raws and "read" or "bytes", m.undecoded or "-")
  end
  lu.assertEquals(found, { "-3 bytes -", "-2 read -", "-1 read -", "0 read -", "1 read 1" })
end

-- A usual message needs no expert item.
function T.test_what_is_usual()
  for _, row in ipairs { { true, HEALTH }, { false, MOTOR, { [at(MOTOR, "fault_flags")] = 1 } },
    { false, MOTOR, {}, { size = MOTOR.size + 4 } }, { false, HEALTH, {}, { status = "bad" } },
    { false, HEALTH, {}, { id = 0x123 } },
    { false, HEALTH, {}, { copy_of = 5 } }, { false, HEALTH, {}, { answer = { add = { late = 1 }, delta = 1 } } } } do
    lu.assertEquals(select(3, read(row[2], row[3], row[4])), row[1])
  end
end

function T.test_what_the_history_is_asked()
  local m, asked = read(HEALTH, {}, { answer = { add = { reboot = 3 }, delta = 0.5 }, wants_state = true })
  lu.assertEquals({ m.change, m.delta, m.state, asked }, { { reboot = 3 }, 0.5, false, "add state" })
  m, asked = read(HEALTH, {}, { answer = { delta = false } })
  lu.assertEquals({ m.change, m.delta, m.state, m.is_unreliable, asked }, { false, false, false, false, "add" })
  m, asked = read(HEALTH, {}, { answer = { change = { late = 1 }, delta = 0.5 }, visited = true, wants_state = true })
  lu.assertEquals({ m.change, m.delta, m.state, m.is_unreliable, asked },
    { { late = 1 }, 0.5, false, false, "change state" })
  m = read(HEALTH, {}, { answer = {}, visited = true }) -- the first pass did not ask the history
  lu.assertEquals({ m.delta, m.is_unreliable }, { false, true })
  m, asked = read(HEALTH, {}, { answer = { add = { late = 1 } }, is_bus_known = false }) -- nothing tells its bus
  lu.assertEquals({ m.change, m.delta, m.state, m.is_unreliable, asked }, { false, false, false, true, "" })
  m = read(HEALTH, {}, { answer = { delta = 1, state = { drift = 1, command_in = 5 } }, wants_state = true })
  lu.assertEquals(m.state, { drift = 1, command_in = 5 })
end

-- In a stream, the ID of a damaged frame may be damaged, too.
function T.test_the_time_since_the_message_before()
  for _, row in ipairs { { "good", nil, 1 }, { "bad", nil, 1 }, { "good", {}, 1 }, { "bad", {}, false } } do
    lu.assertEquals(read(HEALTH, {}, { status = row[1], line = row[2] }).delta, row[3])
  end
end

-- A copy changes no history.
function T.test_a_copy()
  local m, asked = read(MOTOR, { [at(MOTOR, "fault_flags")] = 1 }, { copy_of = 5, wants_state = true,
    answer = { add = { late = 1 }, delta = 1 } })
  lu.assertEquals({ m.copy_of, m.change, m.delta, m.state, asked }, { 5, false, false, false, "" })
  lu.assertTrue(m.remarks.has_fault) -- it is decoded
  m = read(MOTOR, {}, { copy_of = 5, status = "truncated" }) -- its bytes prove nothing
  lu.assertFalse(m.copy_of)
end

return T
