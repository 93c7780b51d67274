-- SPDX-License-Identifier: GPL-2.0-or-later
-- From the dissection to the statistics: passes, filters, parts of one message, times.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local feed_of = require("yapp.stat.feed")

local T = {}

local SOURCE = { key = 1, id = 1 }

local function new_feed()
  return feed_of.new { late = function() return 2.5 end, named = function() return {} end }
end

-- A statistic that notes what it gets.
local function notes(code, text)
  local self = { got = {} }
  function self.message(_, record) self.got[#self.got + 1] = record.name end
  function self.finish(_, last)
    self.last = last and last.rel
    return code, text
  end
  return self
end

local function offer(feed, frame, name, with, visited)
  local record = { frame = frame, rel = frame, source = SOURCE, seq = 0, name = name, kind = "message", fits = true }
  for key, value in pairs(with or {}) do record[key] = value end
  feed:offer(record, visited or false)
end

function T.test_messages_in_the_order_of_the_capture()
  local feed, one = new_feed(), notes()
  feed:add(one, false)
  feed:packet(1, 1)
  offer(feed, 2, "a")
  offer(feed, 2, "b")
  feed:packet(2, 2)
  offer(feed, 3, "c")
  feed:packet(3, 3)
  feed:packet(4, 8)
  feed:packet(5, 9)
  lu.assertEquals({ feed:finish { { frame = 3, source = SOURCE, name = "d", kind = "unfinished" } } }, { 0, {} })
  lu.assertEquals({ one.got, one.last }, { { "a", "b", "c", "d" }, 9 })
end

-- Where nothing has a filter or rests on what comes when, messages need not wait.
function T.test_messages_that_do_not_wait()
  local feed, one = new_feed(), notes()
  feed:add(one, false)
  offer(feed, 1, "a")
  lu.assertTrue(feed:go_direct())
  feed:packet(1, 1)
  offer(feed, 2, "b")
  offer(feed, 2, "c", { fault = {} })
  offer(feed, 3, "d", { fault = { void = true } })
  offer(feed, 3, "e")
  lu.assertEquals(one.got, { "a", "b", "e" })
  lu.assertEquals({ feed:finish {} }, { 0, {} })
  lu.assertEquals(one.got, { "a", "b", "e", "c" })
  feed:add(notes(), true)
  lu.assertFalse(feed:go_direct())
  feed = new_feed()
  feed:add({ event = function() end }, false)
  lu.assertFalse(feed:go_direct())
end

-- What is lost is sure at the end only; a lost message counts once, at the first frame that shows it.
function T.test_losses()
  local feed, one = new_feed(), notes()
  feed:add(one, false)
  local message, other = {}, {}
  local rows = { { "a" }, { "b", { void = true }, message }, { "c", {}, message }, { "d" }, { "e", {}, message },
    { "f", {}, other }, { "g", {} }, { "h", {} } }
  for frame, row in ipairs(rows) do
    offer(feed, frame, row[1], { kind = row[2] and "incomplete", fault = row[2], lost = row[3] })
    feed:packet(frame, frame)
  end
  lu.assertEquals({ feed:finish {} }, { 0, {} })
  lu.assertEquals(one.got, { "a", "d", "c", "f", "g", "h" })
end

function T.test_what_came_before_is_not_known()
  for tells, code in pairs { [true] = 21, [false] = 0 } do
    local feed, one = new_feed(), notes()
    one.tells_changes = tells
    feed:add(one, false)
    offer(feed, 1, "a", { is_unsure = true })
    feed:packet(1, 1)
    local got, texts = feed:finish {}
    lu.assertEquals({ got, #texts, one.got }, { code, tells and 1 or 0, { "a" } })
  end
end

function T.test_nothing()
  local feed, one = new_feed(), notes()
  feed:add(one, false)
  lu.assertEquals({ feed:finish {} }, { 0, {} })
  lu.assertEquals({ one.got, one.last }, { {} })
end

-- tshark -2 dissects all packets before the first tap runs; a capture may have a single one.
function T.test_the_first_of_two_passes_does_not_count()
  for count = 1, 3 do
    local feed, one, expected = new_feed(), notes(), {}
    feed:add(one, false)
    for frame = 1, count do offer(feed, frame, "first", {}, false) end
    for frame = 1, count do
      offer(feed, frame, "second", {}, true)
      feed:packet(frame, frame)
      expected[frame] = "second"
    end
    feed:finish {}
    lu.assertEquals(one.got, expected)
  end
end

-- A message that a read filter rejects, or that is looked at between two passes over the file.
function T.test_packets_that_no_tap_sees()
  local feed, one = new_feed(), notes()
  feed:add(one, false)
  offer(feed, 5, "rejected")
  offer(feed, 6, "a")
  feed:packet(6, 6)
  offer(feed, 7, "rejected")
  feed:packet(8, 8)
  feed:finish {}
  lu.assertEquals(one.got, { "a" })
end

-- tshark -2 -R: the number of a rejected packet is another's in the second pass.
function T.test_the_number_of_a_rejected_packet()
  local feed, one = new_feed(), notes()
  feed:add(one, false)
  offer(feed, 1, "rejected")
  feed:packet(1, 1.5)
  feed:finish {}
  lu.assertEquals(one.got, {})
end

function T.test_all_packets_come_again()
  local feed, one = new_feed(), notes()
  feed:add(one, false)
  offer(feed, 1, "clicked on", {}, true)
  feed:reset()
  offer(feed, 1, "a", {}, true)
  feed:packet(1, 1)
  feed:finish {}
  lu.assertEquals(one.got, { "a" })
end

-- The taps of a packet run in any order.
function T.test_filters()
  local feed, all, some, both = new_feed(), notes(), notes(), notes()
  feed:add(all, false)
  local entry, another = feed:add(some, true), feed:add(both, true)
  for frame = 30, 70 do
    offer(feed, frame, tostring(frame))
    if frame % 2 == 0 then feed:matched(entry, frame) end
    feed:packet(frame, frame)
    if frame % 3 == 0 then
      feed:matched(entry, frame)
      feed:matched(entry, frame)
    end
    if frame == 64 then feed:matched(another, frame) end
  end
  feed:finish { { frame = 33, source = SOURCE, name = "33 too" }, { frame = 31, source = SOURCE, name = "31 too" } }
  local expected = {}
  for frame = 30, 70 do
    if frame % 2 == 0 or frame % 3 == 0 then expected[#expected + 1] = tostring(frame) end
  end
  expected[#expected + 1] = "33 too"
  lu.assertEquals(some.got, expected)
  lu.assertEquals(#all.got, 43)
  lu.assertEquals(both.got, { "64" })
end

function T.test_exact_times()
  local feed = new_feed()
  local function time(rel) return { feed:time(rel) } end
  feed:begins(1700000000, 999999999, 0)
  lu.assertEquals(time(0), { 1700000000, 999999999 })
  lu.assertEquals(time(0.000000001), { 1700000001, 0 })
  lu.assertEquals(time(86400.123456789), { 1700086401, 123456788 })
  lu.assertEquals(time(4194302.999999998), { 1704194303, 999999997 }) -- 48 days
  lu.assertEquals(time(-2), { 1699999998, 999999999 }) -- an earlier packet behind a later one
  feed:begins(1700000000, 5, 2.000000001) -- the first packet that a read filter left
  lu.assertEquals(time(2.000000001), { 1700000000, 5 })
  lu.assertEquals(time(0), { 1699999998, 4 })
  feed:reset() -- packets may have no time: then it is that since the first one
  lu.assertEquals(time(2.5), { 2, 500000000 })
end

function T.test_what_did_not_hold_comes_before_what_could_not_be_told()
  local function finish(...)
    local feed = new_feed()
    for _, code in ipairs { ... } do feed:add(notes(code ~= 0 and code or nil, "text " .. code), false) end
    return { feed:finish {} }
  end
  lu.assertEquals(finish(0, 21), { 21, { "text 0", "text 21" } })
  lu.assertEquals(finish(21, 20, 0)[1], 20)
  lu.assertEquals(finish(20, 21)[1], 20)
end

return T
