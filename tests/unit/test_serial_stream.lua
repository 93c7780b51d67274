-- SPDX-License-Identifier: GPL-2.0-or-later
-- The packets of byte streams, datagrams and TCP connections: what each holds when it comes, and when it is asked for
-- again.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local framer = require("yapp.serial.framer")
local generator = require("stream_generator")
local kilobytes = require("support").kilobytes
local levels = require("levels")
local streams = require("yapp.serial.stream")

local A, B = generator.frame(5, "message A"), generator.frame(6, "B")

local function unknown() return nil end
local function new_framer() return framer.new(unknown) end
local function new() return streams.new(new_framer) end

-- "good 5 @0", "bad 7 in 1,2", "skipped 4 @25", "incomplete 5 @0 -9"
local function in_words(contents, bytes)
  if not contents then return "nothing" end
  local list = {}
  for i, finding in ipairs(contents.findings) do
    local text = finding.bytes or bytes:sub(finding.offset + 1, finding.offset + finding.to - finding.from)
    lu.assertEquals(#text, finding.to - finding.from)
    local what = finding.status == "skipped" and #text or text:byte(5)
    local parts = finding.packet_keys
    local where = parts and "in " .. table.concat(parts, ",") or finding.bytes and "before" or "@" .. finding.offset
    local missing = finding.missing and " -" .. finding.missing or ""
    list[i] = ("%s %s %s%s"):format(finding.status, what, where, missing)
  end
  if contents.pending > 0 then
    list[#list + 1] = ("%d wait%s"):format(contents.pending, contents.leads_to and ", to " .. contents.leads_to or "")
  end
  return table.concat(list, ", ")
end

-- A row as a packet: key, bytes, what it holds, what it holds when all have come (the same if left out), other fields.
local lines = {} -- by their fields, which rows have, too

local function line_of(packet)
  local key = ("%s %s %s %s %s"):format(packet.stream, packet.is_datagram, packet.is_complete, packet.is_tcp,
    packet.is_found)
  lines[key] = lines[key] or { bus = packet.bus, is_datagram = packet.is_datagram, is_complete = packet.is_complete,
    is_tcp = packet.is_tcp }
  return lines[key]
end

local function packet_of(row, other)
  local packet = { key = row[1], number = row[1], bytes = row[2], length = #row[2], epoch = 0, stream = "" }
  for _, fields in ipairs { other or {}, row } do
    for name, value in pairs(fields) do
      if type(name) == "string" then packet[name] = value end
    end
  end
  packet.line = packet.line or line_of(packet)
  return packet
end

local function take(self, rows, other)
  for i, row in ipairs(rows) do
    local packet = packet_of(row, other)
    lu.assertEquals(in_words(self:add(packet, true), row[2]), row[3], "packet " .. i)
  end
end

local function find(self, rows, other)
  for i, row in ipairs(rows) do
    lu.assertEquals(in_words(self:find(packet_of(row, other)), row[2]), row[4] or row[3], "packet " .. i)
  end
end

-- Takes packets, then asks for them in another order.
local function holds(rows, other)
  local self = new()
  take(self, rows, other)
  find(self, rows, other)
  local reversed = {}
  for i, row in ipairs(rows) do reversed[#rows + 1 - i] = row end
  find(self, reversed, other)
  return self
end

local T = {}

function T.test_what_the_capture_cut()
  holds { { 1, A:sub(1, 20), "truncated 5 @0 -5", truncated = true }, { 2, A, "good 5 @0" } }
  local bytes = "ok" .. A:sub(1, 20)
  local finding = new():add(packet_of { 1, bytes, truncated = true }, true).findings[2]
  lu.assertEquals(streams.new_transfer(finding, bytes).anomalies, { { expert = "truncated" } })
end

-- "a incomplete 5 of 3": stream, status, ID and last packet of each frame that waits when the capture ends.
local function unfinished(self, may_go_on)
  local list = {}
  for _, open in ipairs(self:unfinished(may_go_on)) do
    for _, finding in ipairs(open.findings) do
      local id = finding.status == "skipped" and #finding.bytes or finding.bytes:byte(5)
      list[#list + 1] = ("%s %s %d of %d"):format(open.packet.stream, finding.status, id, open.packet.number)
    end
  end
  table.sort(list)
  return table.concat(list, ", ")
end

function T.test_the_capture_ends_before_a_frame()
  local rows, found, self = { { 1, A:sub(1, 20), stream = "a" }, { 2, B, stream = "b" }, { 3, A:sub(21), stream = "a" },
    { 4, "x" .. A:sub(1, 14), stream = "a" }, { 5, A:sub(15, 17), stream = "a" }, { 6, B:sub(1, 11), stream = "c" } },
    {}, new()
  for i, row in ipairs(rows) do self:add(packet_of(row), true) rows[i].packet = packet_of(row) end
  lu.assertEquals(unfinished(self, true), "a incomplete 5 of 5, c skipped 11 of 6")
  for i, row in ipairs(rows) do found[i] = self:is_unfinished(self:find(row.packet), row.packet) end
  lu.assertEquals(found, { false, false, false, false, true, false })
  local again = { 2, A:sub(1, 20), "", seq = 0 }
  self = holds { { 1, A:sub(1, 20), "20 wait", seq = 0 }, again }
  lu.assertFalse(self:is_unfinished(self:find(packet_of(again)), packet_of(again)))
  self = holds({ { 1, A .. B:sub(1, 12), "good 5 @0, 12 wait" } }, { is_datagram = true })
  lu.assertEquals(unfinished(self), " incomplete 6 of 1")
end

-- Which of two that overlap it is nobody knows: the one that began first is shown when more comes.
function T.test_the_capture_ends_before_one_of_two_frames()
  local self = new()
  take(self, { { 1, generator.header(7, 20) .. generator.header(8, 90) .. "12345678", "32 wait" } })
  lu.assertEquals(unfinished(self, true), " incomplete 7 of 1")
  take(self, { { 2, "1234", "4 wait" } }) -- now that is a bad one, for which the other has to wait
  lu.assertEquals(unfinished(self), " bad 7 of 2")
end

-- The capture has a part of a packet: whole frames may be missing.
function T.test_the_end_of_a_packet_that_was_not_captured()
  for _, row in ipairs { { A, 1 }, { "text", 1 }, { A .. B:sub(1, 12), 0 }, { A .. B:sub(1, 11), 1 } } do
    local self = new()
    self:add(packet_of { 1, row[1], truncated = true, is_datagram = true, epoch = 1000, bus = "eth0" }, true)
    lu.assertEquals(#self:drops(), row[2])
  end
end

function T.test_datagrams()
  holds({
    { 1, A, "good 5 @0" },
    { 2, "x" .. B .. A:sub(1, 20), "skipped 1 @0, good 6 @1, 20 wait",
      "skipped 1 @0, good 6 @1, 20 wait, to 3" },
    { 3, A:sub(21), "good 5 in 2,3" },
    { 4, "YP", "2 wait" },
    { 5, A .. A, "skipped 2 before, good 5 @0, good 5 @25" },
    { 6, A:sub(1, 20), "truncated 5 @0 -5", truncated = true },
    { 7, generator.header(5, 60) .. A, "37 wait", "37 wait, to 9" },
    { 8, B, "17 wait", "17 wait, to 9" },
    { 9, A, "skipped 12 before, good 5 in 7, good 6 in 8, good 5 @0" }, -- they win over the bad one
  }, { is_datagram = true })
end

-- A bridge cuts frames over datagrams: of any length, and a lost one costs what it cut.
function T.test_datagrams_of_a_byte_stream()
  local all = A .. B .. A .. B .. A
  for length = 1, #all do
    local self, good = new(), 0
    for at = 1, #all, length do
      local bytes = all:sub(at, at + length - 1)
      local contents = self:add(packet_of { at, bytes, is_datagram = true, is_found = true }, true)
      for _, finding in ipairs(contents.findings) do
        lu.assertEquals(finding.status, "good", length)
        good = good + 1
      end
    end
    lu.assertEquals(good, 5, length)
  end
  holds({
    { 1, A .. A:sub(1, 10), "good 5 @0, 10 wait" }, -- the next one is lost
    { 3, B .. A:sub(1, 9), "skipped 10 before, good 6 @0, 9 wait", "skipped 10 before, good 6 @0, 9 wait, to 4" },
    { 4, A:sub(10), "good 5 in 3,4" },
  }, { is_datagram = true })
end

-- In a conversation that was found by content, datagrams without anything of YAPP are others'.
function T.test_datagrams_of_others()
  local self = new()
  local function is_others(key, bytes, words)
    local contents = self:add(packet_of { key, bytes, is_datagram = true, is_found = true }, true)
    lu.assertEquals(in_words(contents, bytes), words)
    lu.assertEquals(self:find(packet_of { key, bytes }) == nil, contents == nil)
    return contents == nil
  end
  lu.assertFalse(is_others(1, A, "good 5 @0"))
  lu.assertTrue(is_others(2, "MAVLink", "nothing"))
  lu.assertTrue(is_others(3, "MAVLINKY", "nothing")) -- ends in Y by chance
  lu.assertFalse(is_others(4, "text" .. A, "skipped 4 @0, good 5 @4"))
  lu.assertFalse(is_others(5, A:sub(1, 9), "9 wait"))
  lu.assertFalse(is_others(6, A:sub(10, 12), "3 wait"))
  lu.assertFalse(is_others(7, A:sub(13), "good 5 in 5,6,7"))
  lu.assertTrue(is_others(10, "text", "nothing"))
end

-- tshark -2 -R: a packet that was dropped has the number of the next one.
function T.test_a_key_that_comes_again()
  local self = new()
  take(self, { { 1, A, "good 5 @0" }, { 1, "x" .. A, "skipped 1 @0, good 5 @1" }, { 1, B, "good 6 @0" },
    { 2, "y", "skipped 1 @0" }, { 2, A, "good 5 @0" }, { 3, A:sub(1, 9), "9 wait" },
    { 3, A:sub(10), "good 5 in 3,3" } })
  find(self, { { 1, B, "good 6 @0" }, { 2, A, "good 5 @0" }, { 3, A:sub(10), "good 5 in 3,3" } })
end

-- Of a packet that is never asked for again nothing is kept; its stream goes on.
function T.test_packets_that_are_not_stored()
  local self = new()
  for _, row in ipairs { { 1, A, "good 5 @0" }, { 2, B:sub(1, 5), "5 wait" }, { 3, B:sub(6), "good 6 in 2,3" } } do
    lu.assertEquals(in_words(self:add(packet_of(row), false), row[2]), row[3])
    lu.assertNil(self:find(packet_of(row)))
  end
end

-- TCP --------------------------------------------------------------------------------------------------------------

-- Messages by their ID: 1 to 9, 17 bytes each.
local MESSAGE = {}
for id = 1, 9 do MESSAGE[id] = generator.frame(id, "x") end
local ALL = table.concat(MESSAGE)

-- A row { key, first byte, last byte, says } of ALL as a segment.
local LINE = { is_tcp = true, bus = "eth0" }
local function segments(rows, first_seq)
  local self = new()
  for i, row in ipairs(rows) do
    local bytes = ALL:sub(row[2], row[3])
    local packet = packet_of({ row[1], bytes, seq = (first_seq + row[2]) % 0x100000000, epoch = 1000 + row[1] / 100,
      is_start = row.is_start, is_end = row.is_end, line = LINE })
    lu.assertEquals(in_words(self:add(packet, true), bytes), row[4], "packet " .. i)
  end
  return self
end

-- "frame 3 at 1000.03 on eth0, 1" of each loss.
local function drops(self)
  local list = {}
  for i, drop in ipairs(self:drops()) do
    list[i] = ("frame %d at %.2f on %s, %d"):format(drop.frame, drop.time, drop.bus, drop.count)
  end
  return table.concat(list, "; ")
end

-- Each: its segments, and the losses; those in any order are random below.  Messages end at 17, 34, 51, 68 ...
local GAP = "frame 2 at 1000.02 on eth0, 1"
local CONNECTIONS = {
  -- late, from before the first one; and once more
  { { { 1, 18, 34, "good 2 @0" }, { 2, 1, 17, "good 1 @0" }, { 3, 1, 17, "" }, { 4, 35, 51, "good 3 @0" } }, "" },
  -- one that never comes: the connection ends, another one begins, the capture ends
  { { { 1, 1, 20, "good 1 @0, 3 wait" }, { 2, 35, 51, "skipped 3 before, good 3 @0", is_end = true } }, GAP },
  { { { 1, 1, 17, "good 1 @0" }, { 2, 35, 34, "", is_end = true } }, GAP },
  { { { 1, 1, 17, "good 1 @0" }, { 2, 35, 51, "17 wait" }, { 3, 1, 0, "good 3 in 2", is_start = true },
    { 4, 1, 17, "good 1 @0" } },
    GAP },
  { { { 1, 1, 17, "good 1 @0" }, { 2, 35, 51, "17 wait" } }, GAP },
  -- a connection with the same addresses and numbers
  { { { 1, 1, 34, "good 1 @0, good 2 @17" }, { 2, 1, 0, "", is_start = true },
    { 3, 1, 17, "good 1 @0" }, { 4, 18, 51, "good 2 @0, good 3 @17" } }, "" },
}

function T.test_segments()
  for i, row in ipairs(CONNECTIONS) do
    for _, first_seq in ipairs { 0, 999, 0x100000000 - 30, 0x80000000 - 40 } do
      lu.assertEquals(drops(segments(row[1], first_seq)), row[2], "row " .. i)
    end
  end
end

-- A segment that 16 others have come behind is lost.
function T.test_sixteen_segments_behind_a_lost_one()
  local self = new()
  take(self, { { 1, A, "good 5 @0", seq = 0 } })
  for i = 1, 15 do take(self, { { 1 + i, "x", "1 wait", seq = 100 + i } }) end
  take(self, { { 20, B, "good 6 @0, skipped 15 before", seq = 100 - #B + 1 } })
  lu.assertEquals(#self:drops(), 1)
end

-- Good messages behind a damaged size, and behind a gap of TCP whose segment never comes.
function T.test_what_waits_when_the_capture_ends()
  local self = new()
  take(self, { { 1, A .. A:sub(1, 8) .. "x" .. A:sub(10) .. B .. B, "good 5 @0, 59 wait" } })
  lu.assertEquals(unfinished(self), " good 6 of 1,  good 6 of 1,  skipped 25 of 1")
  self = segments({ { 1, 1, 20, "good 1 @0, 3 wait" }, { 2, 35, 60, "26 wait" }, { 3, 61, 68, "8 wait" },
    { 4, 61, 68, "8 wait" }, { 5, 86, 102, "17 wait" } }, 0)
  lu.assertEquals(unfinished(self), " good 3 of 5,  good 4 of 5,  good 6 of 5,  skipped 3 of 5")
end

-- What is more than 2^20 bytes from the next one, ahead or behind, is of another connection.
function T.test_a_segment_of_another_connection()
  for ahead, expected in pairs { [0x100000] = "17 wait", [0x100000 + 1] = "good 6 @0", [-0x100000] = "good 6 @0",
    [-0x100000 - 1] = "good 6 @0" } do
    local self = new()
    take(self, { { 1, A, "good 5 @0", seq = 0x80000000 }, { 2, B, expected, seq = 0x80000000 + #A + ahead } })
    lu.assertEquals(#self:drops(), ahead == 0x100000 and 1 or 0, ahead) -- bytes of this one are missing
  end
end

-- The bytes of a stream in pieces that overlap, come late and come again, show what they show in order.
function T.test_random_segments()
  for seed = 1, levels.size(60, 600) do
    local random = generator.random(seed)
    local bytes, at, pieces, order, self = generator.stream(random, random(16)), 0, {}, {}, new()
    while at < #bytes do
      local to = math.min(#bytes, at + random(60))
      pieces[#pieces + 1] = { math.max(0, at - (random(3) == 1 and random(70) or 0)), to }
      at = to
      if random(5) == 1 then
        local from = random(to) - 1
        pieces[#pieces + 1] = { from, math.min(to, from + random(90)) }
      end
    end
    for i = 1, #pieces do order[i] = { pieces[i], i + (random(4) == 1 and random(6) or 0) + i / 1000 } end
    table.sort(order, function(a, b) return a[2] < b[2] end)
    local first_seq, shown = 0x100000000 - random(2000), {}
    self:add(packet_of { 0, "", seq = first_seq }, true)
    for i, one in ipairs(order) do
      local from, to = one[1][1], one[1][2]
      local packet = packet_of { i, bytes:sub(from + 1, to), seq = (first_seq + from) % 0x100000000 }
      for _, finding in ipairs(self:add(packet, true).findings) do shown[#shown + 1] = finding end
    end
    local whole = new_framer()
    local wanted = whole:add(bytes)
    local function skips_joined(findings)
      local list = {}
      for _, finding in ipairs(findings) do
        local last = list[#list]
        if last and last[1] == "skipped" and finding.status == "skipped" then
          last[3] = finding.to
        else
          list[#list + 1] = { finding.status, finding.from, finding.to }
        end
      end
      return list
    end
    lu.assertEquals(skips_joined(shown), skips_joined(wanted), "seed " .. seed)
    lu.assertEquals(self:drops(), {}, "seed " .. seed)
  end
end

-- Work and memory --------------------------------------------------------------------------------------------------

-- A gap holds no more than what a sender may send ahead.
function T.test_a_gap_holds_little()
  local before, self, most = kilobytes(), new(), 0
  self:add(packet_of { 1, A, seq = 0 }, true)
  for i = 2, 2000 do
    self:add(packet_of { i, ("x"):rep(1000), seq = 2000 * i }, false)
    most = math.max(most, i % 50 == 0 and kilobytes() - before or 0)
  end
  lu.assertTrue(most < 200 + 2000 / 4) -- a gap is kept, to be told
end

return T
