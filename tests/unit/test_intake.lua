-- SPDX-License-Identifier: GPL-2.0-or-later
-- What dissectors report to the statistics: events of messages and of losses, and their kinds.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local catalogue_of = require("yapp.message.catalogue")
local decode = require("yapp.message.decode")
local intake_of = require("yapp.stat.intake")

local T = {}

local CATALOGUE = catalogue_of.compile {
  { name = "m", title = "M", id = 1, size = 3, every = 0.1,
    { "mode", "uint8", "Mode", values = { [0] = "off" } },
    { "bits", "uint8", "Bits", group = "b", flags = { { "one", 1, "One" } } },
    { "low", "float8", "Low", min = 0, max = 250 } } }
local MESSAGE = CATALOGUE.messages[1]
local READER = {
  name_of = function(_, id, bus) return bus == "can0" and "name " .. id or nil end,
  message_of = function(_, id) return CATALOGUE.by_id[id] end,
}

-- An intake, and the list of what it offers: { event, visited }.
local function new_intake()
  local offered, intake = {}, intake_of.new()
  intake:open({ offer = function(_, event, visited) offered[#offered + 1] = { event, visited } end }, READER)
  return intake, offered
end

-- A finished message, as the reader reads it.
local function message(with)
  local m = { id = 1, seq = 0, source = "a", bus = 1, bus_name = "can0", frame = 1, time = 0.5, visited = false,
    status = "good", good = true, payload = "\0\0\0", message = MESSAGE }
  for key, value in pairs(with or {}) do m[key] = value end
  if m.payload then m.raws, m.is_remarkable = decode.read(MESSAGE, m.payload) end
  return m
end

function T.test_kinds_of_finished_messages()
  local intake, offered = new_intake()
  for _, row in ipairs { { "good", true }, { "bad" }, { "unverified" }, { "single", true }, { "single" }, { "short" },
    { "overrun" } } do
    intake:message(message { status = row[1], good = row[2] or false })
  end
  local kinds = {}
  for i, one in ipairs(offered) do
    local what = one[1].values.what
    kinds[i] = one[1].kind .. (what and " " .. what or "")
  end
  lu.assertEquals(kinds, { "message", "crc", "incomplete incomplete", "message", "incomplete incomplete" })
end

function T.test_a_message()
  local intake, offered = new_intake()
  local change = { missing = 1 }
  intake:message(message { visited = true, change = change, is_unreliable = true })
  intake:message(message { source = "b", id = 7, bus_name = "can1", frame = 2 })
  local event = offered[1][1]
  lu.assertEquals({ event.frame, event.time, event.seq, event.payload, event.raws ~= nil, offered[1][2] },
    { 1, 0.5, 0, "\0\0\0", true, true })
  lu.assertEquals(event.values, { change = change, is_unreliable = true })
  lu.assertIs(event.values.change, change)
  local source = event.source
  lu.assertEquals({ source.key, source.bus_key, source.bus, source.name, source.id },
    { "a", 1, "can0", "name 1", 1 })
  lu.assertIs(source.message, MESSAGE)
  lu.assertEquals({ offered[2][1].source.name, offered[2][1].source.message }, {})
end

function T.test_what_the_catalogue_does_not_define()
  local intake, offered = new_intake()
  for _, payload in ipairs { "\0\1\0", "\5\1\0", "\0\3\0", "\9\255\255" } do
    intake:message(message { payload = payload })
  end
  local fields = {}
  for i, one in ipairs(offered) do
    fields[i] = {}
    for j, remark in ipairs(one[1].values.invalid or {}) do fields[i][j] = remark.field end
  end
  lu.assertEquals(fields, { {}, { "mode" }, { "bits" }, { "mode", "bits" } }) -- a reserved count is defined
end

local function part(with)
  local m = message(with)
  m.status, m.good, m.payload, m.raws, m.is_remarkable = nil, nil, nil, nil, nil
  return m
end

-- A message with too many bytes has a fault at each further frame; all of them are of that message.
function T.test_losses_carry_their_message()
  local intake, offered = new_intake()
  local lost = {}
  for frame = 1, 3 do
    intake:faults(part { frame = frame },
      { { expert = "fragment.overrun", lost = lost }, { expert = "size.mismatch" } })
  end
  intake:faults(part { frame = 4 }, { { expert = "fragment.incomplete", lost = {} }, { expert = "truncated" } })
  local whats = {}
  for i, one in ipairs(offered) do
    lu.assertEquals(one[1].kind, "incomplete")
    whats[i] = one[1].values.what .. (one[1].values.lost == lost and " of one" or "")
  end
  lu.assertEquals(whats, { "overrun of one", "overrun of one", "overrun of one", "incomplete", "incomplete" })
  lu.assertNil(offered[5][1].values.lost)
end

-- A message without its Start is lost once, however many frames it has.
function T.test_orphans_of_one_message()
  local intake, offered = new_intake()
  local names = {} -- [what is lost] = the first frame that shows it
  local function orphan(name, with)
    local m = part(with)
    m.is_end = with and with.is_end
    intake:faults(m, { { expert = "fragment.orphan" } })
    local lost = offered[#offered][1].values.lost
    names[lost] = names[lost] or name
    return names[lost]
  end
  lu.assertEquals({ orphan "a1", orphan "a2", orphan("other's", { source = "z" }), orphan("a3", { is_end = true }),
    orphan "b1" }, { "a1", "a1", "other's", "a1", "b1" })
  intake:message(message())
  lu.assertEquals({ orphan("d1", { is_end = true }), orphan("e1", { is_end = true }), orphan("f1", { seq = 7 }),
    orphan("g1", { seq = 8 }), orphan("g2", { seq = 8, is_end = true }), orphan("h1", { seq = 8 }) },
    { "d1", "e1", "f1", "g1", "g1", "h1" })
  orphan "i1"
  intake:faults(part(), { { expert = "fragment.incomplete", lost = {} } }) -- of another message
  lu.assertEquals({ orphan "j1", orphan "j2" }, { "j1", "j1" })
end

function T.test_bytes_of_no_frame()
  local intake, offered = new_intake()
  intake:skipped { frame = 3, time = 2, visited = false, bus = "serial", bus_name = "ttyA", source = "stream",
    length = 9 }
  local event = offered[1][1]
  lu.assertEquals({ event.kind, event.values.length, event.frame, event.time, event.source.key, event.source.bus },
    { "skipped", 9, 3, 2, "stream", "ttyA" })
  lu.assertNil(event.source.id)
end

-- Text over several packets of one stream is one stretch, until a frame comes; a new run begins anew.
function T.test_bytes_of_several_packets()
  local intake, offered = new_intake()
  local function skipped(stream, frame)
    intake:skipped { frame = frame, time = frame, visited = true, bus = "serial", source = stream, length = 9 }
  end
  for run = 1, 2 do
    skipped("stream", 3)
    skipped("other", 4)
    skipped("stream", 5)
    intake:message(message { stream = "other", source = "other|1", frame = 6 })
    skipped("stream", 7)
    intake:faults(part { stream = "stream", source = "stream|1", frame = 8 }, { { expert = "fragment.incomplete" } })
    skipped("stream", 9)
    lu.assertEquals(#offered, run * 5)
  end
  local first, last = offered[1][1], offered[5][1]
  lu.assertEquals({ first.frame, first.values.length, last.frame, last.values.length }, { 3, 27, 9, 9 })
end

function T.test_messages_that_the_capture_ends_before()
  local intake = new_intake()
  local one, other = part { frame = 5 }, part { frame = 4, seq = 3 }
  intake:part(one)
  intake:part(other)
  one.frame = 7 -- its next part
  local records = intake:unfinished { { source = "a", seq = 0, frame = 7 }, { source = "a", seq = 3, frame = 4 },
    { source = "a", seq = 9, frame = 4 }, { source = "b", seq = 0, frame = 7 }, { source = "a", seq = 0, frame = 5 } }
  lu.assertEquals({ #records, records[1].frame, records[2].frame, records[2].kind }, { 2, 4, 7, "unfinished" })
end

return T
