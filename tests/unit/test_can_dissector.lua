-- SPDX-License-Identifier: GPL-2.0-or-later
-- CAN frames between Wireshark and the reading: what the header in front of them says, which wait for a tap, and
-- what the reading and the view are handed.  Wireshark's API, the reading and the view are stand-ins here; tests/e2e
-- has the real ones.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local frame_key = require("yapp.base.frame_key")
local unpack_all = table.unpack or unpack -- luacheck: ignore

local T = {}

local GLOBALS = { "Tvb", "wtap", "DissectorTable", "all_field_infos", "get_preference" }
local MODULES = { "yapp.host.wrapper", "yapp.host.header", "yapp.host.can" }
local EXTENDED, REMOTE, ERROR = 0x80000000, 0x40000000, 0x20000000
local MOTOR = 0x08404000 -- ID 0x210, Start, Seq No 0

local seen, said
local headers

-- Bytes of a packet.
local Range, Buffer = {}, {}
Range.__index, Buffer.__index = Range, Buffer
function Buffer.__call(self, offset, length)
  length = length or #self.bytes - offset
  assert(offset >= 0 and offset + length <= #self.bytes, "Range is out of bounds")
  return setmetatable({ bytes = self.bytes:sub(offset + 1, offset + length), start = self.start + offset }, Range)
end
local function buffer(bytes, reported, start)
  return setmetatable({ bytes = bytes, reported = reported or #bytes, start = start or 0 }, Buffer)
end
function Buffer.len(self) return #self.bytes end
function Buffer.reported_len(self) return self.reported end
function Buffer.offset(self) return self.start end
function Buffer.raw(self, offset, length)
  offset = offset or 0
  return self.bytes:sub(offset + 1, length and offset + length or nil)
end
function Range.tvb(self) return buffer(self.bytes, nil, self.start) end
function Range.uint(self)
  local number = 0
  for i = 1, #self.bytes do number = number * 256 + self.bytes:byte(i) end
  return number
end
function Range.le_uint(self) return Range.uint { bytes = self.bytes:reverse() } end

local function big_endian(word)
  local bytes = {}
  for i = 4, 1, -1 do
    bytes[i] = string.char(word % 256)
    word = math.floor(word / 256)
  end
  return table.concat(bytes)
end

-- A SocketCAN record: the id, the length, three bytes, the data.
local function record(word, data, is_little)
  local id = big_endian(word)
  return (is_little and id:reverse() or id) .. string.char(#data, 0, 0, 0) .. data
end

-- A table of dissectors; those of SocketCAN note what they get.
local function new_table(name)
  local own = seen.tables[name] or {}
  seen.tables[name] = own
  return {
    get_dissector = function(_, key) return own[key] end,
    add = function(_, key, dissector) own[key] = dissector end,
  }
end

local function inner(name)
  return { name = name, call = function(_, tvb, pinfo, tree)
    seen.inner = { name, tvb, pinfo, tree }
    if said.never_returns then coroutine.yield() end
    if said.throws then error("ReportedBoundsError") end
    return said.taken
  end }
end

function T.setUp()
  seen = { proto = {}, calls = {}, tables = {
    wtap_encap = { [125] = inner("pcap") },
    ["sll.ltype"] = { [0x0C] = inner("sll"), [0x0D] = inner("sll fd") },
  } }
  said = { fields = {}, preferences = {}, taken = 16 }
  _G.Tvb, _G.wtap = Buffer, { SOCKETCAN = 125 }
  _G.DissectorTable = { get = new_table }
  function _G.all_field_infos()
    if said.fields == "throws" then error("throws") end
    return unpack_all(said.fields)
  end
  function _G.get_preference(name) return said.preferences[name] end
  for _, name in ipairs(MODULES) do package.loaded[name] = nil end
  headers = require("yapp.host.header").new(seen.proto)
end

function T.tearDown()
  for _, name in ipairs(GLOBALS) do _G[name] = nil end
  for _, name in ipairs(MODULES) do package.loaded[name] = nil end
end

local function packet(number, with)
  local pinfo = { number = number, visited = false, len = 16, rel_ts = number / 10, match_uint = 125,
    cols = { info = "(info)", protocol = "CAN" } }
  for name, value in pairs(with or {}) do pinfo[name] = value end
  return pinfo
end

-- The header in front -------------------------------------------------------------------------------------------------

-- Let SocketCAN's wrapper see a record; return what it says of the frame: its id, and whether it is remote.
local function read(bytes, with)
  local pinfo, proto = packet(3, with), seen.proto
  headers:start()
  local taken = proto.dissector(buffer(bytes, with and with.reported), pinfo, "tree")
  return { headers:find_id(pinfo) or false, headers:is_remote(pinfo), taken }
end

function T.test_headers_are_read()
  local data = "\1\2\3\4\5\6\7\8"
  lu.assertEquals(read(record(EXTENDED + MOTOR, data)), { MOTOR, false, 16 })
  lu.assertEquals(read(record(EXTENDED, data)), { 0, false, 16 })
  lu.assertEquals(read(record(MOTOR % 0x800, data)), { false, true, 16 })
  lu.assertEquals(read(record(EXTENDED + REMOTE + MOTOR, data)), { false, true, 16 })
  lu.assertEquals(read(record(EXTENDED + ERROR + MOTOR, data)), { false, true, 16 })
  lu.assertEquals(read(record(EXTENDED + ERROR, data)), { false, true, 16 })
  lu.assertEquals(read(record(EXTENDED + MOTOR, data, true), { match_uint = 0x0C })[1], MOTOR)
  lu.assertEquals(read(record(EXTENDED + MOTOR, data, true), { match_uint = 0x0D })[1], MOTOR)
  lu.assertEquals({ seen.inner[1], seen.inner[4] }, { "sll fd", "tree" })
  said.preferences["can.byte_swap"] = true
  lu.assertEquals(read(record(EXTENDED + MOTOR, data, true))[1], MOTOR)
  lu.assertEquals(read(record(EXTENDED + MOTOR, data, true), { match_uint = 0x0C })[1], MOTOR)
  lu.assertEquals(read("\0\0\0\0\0\0\0")[1], false, "shorter than a header")
  lu.assertEquals(read(record(EXTENDED + MOTOR, data), { match_uint = 9 })[3], 0, "of no table of ours")
end

-- Fields and columns, where no header was read ------------------------------------------------------------------------

function T.test_ids_of_fields_and_columns()
  local function find(fields, info)
    said.fields = fields
    local id, is_unknown = headers:find_id(packet(1, { cols = { info = info or "(info)" } }))
    return { id or false, is_unknown or false }
  end
  local function fields(extended)
    return { { name = "can.id", value = EXTENDED + MOTOR }, { name = "can.flags.xtd", value = extended } }
  end
  lu.assertEquals(find(fields(true)), { MOTOR, false })
  lu.assertEquals(find(fields(1)), { MOTOR, false })
  lu.assertEquals(find(fields(false)), { false, false })
  lu.assertEquals(find({ { name = "can.id", value = MOTOR } }), { false, true }, "nothing says that it is extended")
  lu.assertEquals(find({}, "Ext. ID: 138428416 (0x8404000), Length: 8"), { MOTOR, false })
  lu.assertEquals(find({}, "ID: 291 (0x123), Length: 8"), { false, false })
  lu.assertEquals(find({}, "anything"), { false, true })
  lu.assertEquals(find("throws", "anything"), { false, true })
end

function T.test_remote_frames_of_fields()
  for value, wanted in pairs { [true] = true, [1] = true, [0] = false, [false] = false } do
    said.fields = { { name = "can.flags.rtr", value = value } }
    lu.assertEquals(headers:is_remote(packet(1)), wanted)
  end
  said.fields = {}
  lu.assertNil(headers:is_remote(packet(1)), "nothing says it")
end

-- The header in front of the data of a packet -------------------------------------------------------------------------

-- The id that a tap reads in front of a frame that waits, false if the frame is none of extended data.
local function id_before(bytes, offset, length, known_id)
  local id = false
  headers:use(function(_, _, _, found) id = found end)
  headers:open()
  headers:use_taps {}
  headers.waiting =
    { number = 7, offset = offset, captured = 0, length = length, is_ours = true, id = known_id }
  headers:on_packet(packet(7), buffer(bytes .. ("\0"):rep(30 - #bytes)))
  lu.assertEquals(headers:is_remote(packet(7)), not id)
  return id
end

function T.test_ids_before_the_data()
  local data = "\0\0\0"
  for front, is_big in pairs { [0] = true, [20] = false } do
    for _, is_little in ipairs { true, false } do
      local bytes = ("\0"):rep(front) .. record(EXTENDED + MOTOR, data, is_little)
      lu.assertEquals(id_before(bytes, front + 8, 3), is_big ~= is_little and MOTOR, front)
    end
  end
  said.preferences["can.byte_swap"] = true
  lu.assertEquals(id_before(record(EXTENDED + MOTOR, data, true), 8, 3), MOTOR)
  said.preferences["can.byte_swap"] = false
  lu.assertEquals(id_before(record(EXTENDED + MOTOR, data), 8, 3, MOTOR), MOTOR)
  lu.assertFalse(id_before(record(EXTENDED + REMOTE + MOTOR, data), 8, 3, MOTOR))
  lu.assertEquals(id_before(record(EXTENDED + 5, data), 8, 3, MOTOR), MOTOR, "no header")
  lu.assertEquals(id_before(record(EXTENDED + MOTOR, data), 8, 4, 5), 5, "another length")
  lu.assertFalse(id_before(record(EXTENDED + MOTOR, data), 8, 4))
  lu.assertEquals(id_before("\0\0\0", 3, 3, 5), 5, "no room for a header")
  lu.assertEquals(id_before(record(EXTENDED + MOTOR, ""), 8, 0), MOTOR)
end

-- Frames that wait for a tap ------------------------------------------------------------------------------------------

-- The dissector of a bus, with a reading that accepts what said.accepts has.
local function new_frames()
  local function noted(name, answer)
    return function(_, ...)
      seen.calls[#seen.calls + 1] = { name, ... }
      if type(answer) == "function" then return answer(...) end
      return answer
    end
  end
  local function copy(frame)
    local one = {}
    for key, value in pairs(frame) do one[key] = value end
    seen.frame = one
    return one
  end
  local reading = { read = function(_, frame)
    copy(frame)
    return said.result
  end, recall = function(_, frame)
    copy(frame)
    return said.recalled
  end, report_undissected = function(_, frame) seen.undissected = frame end }
  local wants = { shows = false, tree = false, columns = false, state = "state", is_only_pass = "only" }
  local asker = { first_pass = wants, ask = function(_, _, _, visited)
    seen.asked = visited
    return wants
  end }
  local buses = { bus_is_per_packet = false,
    bus_of = function(number) return ("bus %d"):format(number), "is known" end }
  local view = { show = noted "show", show_without_id = noted "show_without_id" }
  local settings = { accepts_all = false }
  local frames = require("yapp.host.can").new(reading, view, asker, buses, settings, headers)
  frames:reset()
  local function reset() frames:reset() end
  return frames, { reset = reset, reading = reading, wants = wants, buses = buses, settings = settings }
end

local DATA = "\1\2\3\4\5\6\7\8"

function T.test_a_frame_is_read()
  local frames = new_frames()
  said.result, said.message = { is_usual = true }, {}
  lu.assertEquals(frames:dissect(buffer(DATA, nil, 8), packet(3), nil, MOTOR + 5, false), 8)
  local fields = require("yapp.wire.can_id").fields[MOTOR + 5]
  lu.assertEquals({ fields.id, fields.ctrl, fields.seq }, { 0x210, 1, 5 })
  lu.assertEquals({ seen.frame.key, seen.frame.number, seen.frame.time, seen.frame.data, seen.frame.reported },
    { 3 * frame_key.PACKET + 8, 3, 0.3, DATA, 8 })
  lu.assertEquals({ seen.frame.visited, seen.frame.bus, seen.frame.is_bus_known, seen.frame.accepts_all },
    { false, false, true, false })
  lu.assertEquals({ seen.frame.wants_state, seen.frame.is_only_pass }, { "state", "only" })
  lu.assertIs(seen.frame.can_id, fields)
  lu.assertEquals(seen.calls, {}, "nothing is to be shown")
  seen.frame = nil
  lu.assertEquals({ frames:dissect(buffer("", 0), packet(4), nil, MOTOR, false), seen.frame }, { 0 }, "it has no data")
  lu.assertEquals(frames:dissect(buffer("", 1), packet(4), nil, MOTOR, false), 1)
  lu.assertEquals({ frames:dissect(buffer("\9"), packet(4), nil, MOTOR, false), seen.frame.data }, { 1, "\9" })
  lu.assertEquals(frames:dissect(buffer("", 8), packet(4), nil, MOTOR, false), 8)
  lu.assertEquals({ seen.frame.data, seen.frame.reported }, { "", 8 })
end

function T.test_what_the_capture_says_of_a_frame()
  local frames, parts = new_frames()
  parts.buses.bus_is_per_packet = true
  frames:reset()
  said.result, said.message = { is_usual = true }, {}
  frames:dissect(buffer(DATA, nil, 8), packet(3), nil, MOTOR, true)
  lu.assertEquals({ seen.frame.key, seen.frame.bus, seen.frame.is_bus_known, seen.frame.time, seen.frame.accepts_all },
    { 3 * frame_key.PACKET + 8, "bus 3", "is known", 0.3, true })
  parts.buses.bus_of = function() return nil, true end
  frames:dissect(buffer(DATA, nil, 8), packet(4), nil, MOTOR, true)
  lu.assertFalse(seen.frame.bus)
end

function T.test_what_is_shown()
  local frames, parts = new_frames()
  said.result, said.message = { is_usual = true }, {}
  parts.wants.shows = true
  local tvb, pinfo = buffer(DATA), packet(3)
  frames:dissect(tvb, pinfo, "tree", MOTOR, false)
  lu.assertEquals(#seen.calls, 1)
  lu.assertIs(seen.calls[1][2], said.result)
  lu.assertEquals({ seen.calls[1][1], seen.calls[1][6] }, { "show", "tree" })
  parts.wants.shows, said.result = false, { is_usual = false }
  frames:dissect(tvb, packet(4), "tree", MOTOR, false)
  lu.assertEquals(#seen.calls, 2, "what is not usual")
end

function T.test_a_frame_that_is_visited()
  local frames, parts = new_frames()
  said.result, said.recalled, said.message = { is_usual = true }, { is_usual = true }, {}
  frames:dissect(buffer(DATA), packet(3), nil, MOTOR, false)
  seen.asked = nil
  frames:dissect(buffer(DATA), packet(4), nil, MOTOR, false)
  lu.assertNil(seen.asked, "what is wanted is known")
  parts.wants.shows = true
  frames:dissect(buffer(DATA), packet(3, { visited = true }), nil, MOTOR, false)
  lu.assertEquals({ seen.frame.visited, seen.asked }, { true, true })
  lu.assertIs(seen.calls[1][2], said.recalled)
  lu.assertTrue(frames:is_second_pass(3))
  lu.assertFalse(frames:is_second_pass(4))
  seen.asked = nil
  frames:dissect(buffer(DATA), packet(5), nil, MOTOR, false)
  lu.assertEquals({ seen.frame.visited, seen.asked }, { false, false }, "asked again behind a revisit")
  frames:dissect(buffer(DATA), packet(5, { visited = true }), nil, MOTOR, false)
  lu.assertTrue(seen.frame.visited, "the newest one")
end

function T.test_a_frame_of_others()
  local frames = new_frames()
  said.result = nil
  lu.assertEquals(frames:dissect(buffer(DATA, nil, 8), packet(3), nil, MOTOR, false), 0)
  lu.assertFalse(headers.waiting, "no statistic runs")
  headers:open()
  frames:dissect(buffer(DATA, nil, 8), packet(4), nil, MOTOR, false)
  lu.assertEquals(headers.waiting.number, 4)
  headers:close()
  lu.assertFalse(headers.waiting)
  lu.assertFalse(headers:remember(buffer(DATA, nil, 8), packet(5)))
end

-- A frame of zeros may be remote: a header or a field says it.
function T.test_frames_of_zeros()
  said.result, said.message = { is_usual = true }, {}
  for length = 1, 8 do
    local frames = new_frames()
    local function dissect(is_remote)
      said.fields = { { name = "can.flags.rtr", value = is_remote } }
      return frames:dissect(buffer(("\0"):rep(length), nil, 8), packet(3), nil, MOTOR, false)
    end
    lu.assertEquals({ dissect(true), dissect(false), dissect(nil) }, { 0, length, length })
  end
  local frames = new_frames()
  said.recalled, said.fields = { is_usual = true }, { { name = "can.flags.rtr", value = true } }
  local pinfo = packet(3, { visited = true })
  frames:dissect(buffer(DATA), packet(9), nil, MOTOR, false)
  lu.assertEquals(frames:dissect(buffer("\0\0"), pinfo, nil, MOTOR, false), 2, "it was taken for a fragment")
  lu.assertEquals(frames:dissect(buffer("\0\0"), pinfo, nil, 0x210 * 0x40000, false), 0)
end

-- In the only pass, if nothing is shown, frames wait for a tap that reads their headers.
local function waiting()
  local frames, parts = new_frames()
  headers:start()
  headers:open()
  headers:use_taps(parts.wants)
  return frames, parts
end

function T.test_frames_that_wait()
  said.result, said.message = { is_usual = true }, {}
  local before = seen.tables.wtap_encap[125]
  local frames = waiting()
  local zeros = ("\0"):rep(8)
  lu.assertIs(seen.tables.wtap_encap[125], before, "no wrapper any more")
  lu.assertEquals(frames:dissect(buffer(zeros, nil, 8), packet(3), nil, MOTOR, false), 8)
  lu.assertNil(seen.frame)
  frames:dissect(buffer(DATA, nil, 40), packet(3), nil, MOTOR, false) -- a later one of the packet
  headers:on_packet(packet(3, { visited = true }), buffer(record(EXTENDED + MOTOR, zeros))) -- as in every tap
  lu.assertEquals({ seen.frame.data, seen.frame.visited, seen.frame.number }, { zeros, false, 3 })
  lu.assertEquals({ headers.can, headers.extended, headers.waiting }, { 1, 1, false })
  seen.frame = nil
  frames:dissect(buffer(zeros, nil, 8), packet(4), nil, MOTOR, false)
  headers:on_packet(packet(4), buffer(record(EXTENDED + REMOTE + MOTOR, zeros)))
  lu.assertEquals({ seen.frame, headers.can, headers.extended }, { nil, 2, 1 }, "it is remote")
  frames:dissect(buffer(zeros, nil, 8), packet(5), nil, MOTOR, false)
  headers:on_packet(packet(6), buffer(record(EXTENDED + MOTOR, zeros)))
  lu.assertEquals({ seen.frame, headers.can, headers.waiting }, { nil, 2, false }, "of another packet")
  lu.assertEquals(frames:dissect_any(buffer(DATA, nil, 8), packet(7)), 8)
  headers:on_packet(packet(7), buffer(record(EXTENDED + MOTOR, DATA)))
  lu.assertEquals({ seen.frame.data, seen.frame.accepts_all, seen.calls }, { DATA, true, {} })
  lu.assertEquals(frames:dissect_any(buffer("", 8), packet(8)), 8)
  lu.assertEquals(seen.calls[1][1], "show_without_id")
  headers:open()
  lu.assertEquals({ headers.can, headers.extended }, { 0, 0 }, "of another statistic")
end

function T.test_frames_that_are_shown_do_not_wait()
  said.result, said.message = { is_usual = true }, {}
  for _, what in ipairs { "tree", "columns" } do
    local frames, parts = new_frames()
    parts.wants[what] = true
    headers:start()
    headers:open()
    headers:use_taps(parts.wants)
    lu.assertIs(seen.tables.wtap_encap[125], seen.proto)
    lu.assertEquals(frames:dissect(buffer("\0\0", nil, 8), packet(3), nil, MOTOR, false), 2)
    lu.assertEquals({ seen.frame.number, headers.waiting }, { 3, false }, what)
  end
  local frames = waiting()
  headers:reset()
  frames:dissect(buffer("\0\0", nil, 8), packet(3), nil, MOTOR, false)
  lu.assertFalse(headers.waiting, "another file")
end

-- A frame that nobody accepted may be a message that is not dissected.
function T.test_frames_that_nobody_accepted()
  local _, parts = new_frames()
  parts.buses.bus_is_per_packet = true
  parts.reset()
  headers:open()
  local function remember(number, word)
    lu.assertTrue(headers:remember(buffer(DATA, nil, 8), packet(number)))
    headers:on_packet(packet(number), buffer(record(word, DATA)))
  end
  remember(3, EXTENDED + MOTOR + 5)
  local frame = seen.undissected
  lu.assertEquals({ frame.key, frame.number, frame.time, frame.seq, frame.data, frame.reported, frame.bus },
    { 3 * frame_key.PACKET + 8, 3, 0.3, 5, DATA, 8, "bus 3" })
  lu.assertEquals(frame.can_id.id, 0x210)
  seen.undissected = nil
  remember(4, MOTOR % 0x800)
  lu.assertTrue(headers:remember(buffer(DATA, nil, 8), packet(5)))
  headers:forget()
  lu.assertEquals({ headers.waiting, seen.undissected }, { false, nil }, "Decode As accepted it")
  headers:remember(buffer("", 8, 8), packet(6, { len = 8 }))
  headers:on_packet(packet(6), buffer(record(EXTENDED + MOTOR, "")))
  lu.assertEquals({ headers.can, seen.undissected }, { 3, nil }, "nothing was captured")
  local function fills(len, offset, reported)
    return headers:remember(buffer("\1", reported, offset), packet(8, { len = len }))
  end
  lu.assertEquals({ fills(16, 8, 8), fills(72, 8, 64), fills(28, 8, 20), fills(28, 8, 12), fills(7, 8, 3),
    fills(17, 8, 5) }, { true, true, true, false, false, false }, "whether it is a record of SocketCAN")
end

-- By Decode As every extended data frame is YAPP's, once its id is known.
function T.test_decode_as()
  local frames = new_frames()
  said.result, said.message = { is_usual = true }, {}
  local function dissect(info, reported)
    local pinfo = packet(3, { cols = { info = info } })
    return frames:dissect_any(buffer(DATA, reported, 8), pinfo, "tree")
  end
  lu.assertEquals(dissect("Ext. ID: 138428416 (0x8404000), Length: 8"), 8)
  lu.assertEquals({ seen.frame.accepts_all, seen.frame.can_id.id, #seen.calls }, { true, 0x210, 0 })
  lu.assertIs(seen.tables.wtap_encap[125], seen.proto, "headers are read from now on")
  lu.assertEquals({ dissect("ID: 291 (0x123), Length: 8"), #seen.calls }, { 0, 0 })
  lu.assertEquals({ dissect("anything"), seen.calls[1][1], dissect("anything", 0) }, { 8, "show_without_id", 0 })
end

function T.test_the_dissector_of_the_table()
  local frames, parts = new_frames()
  said.result, said.message = { is_usual = true }, {}
  local calls = { begun = 4, ended = 3 }
  parts.settings.accepts_all = true
  lu.assertEquals(frames:new_table_dissector(calls)(buffer(DATA), packet(3, { match_uint = MOTOR }), "tree"), 8)
  lu.assertEquals({ calls, seen.frame.accepts_all, seen.frame.can_id.id }, { { begun = 5, ended = 4 }, true, 0x210 })
end

return T
