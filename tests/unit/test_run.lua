-- SPDX-License-Identifier: GPL-2.0-or-later
-- A run over a capture: passes, filters, times, the end.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local answers = require("answers")
local stamps_of = require("yapp.capture.stamps")
local kinds = require("yapp.stat.kinds")
local run_of = require("yapp.stat.run")

local T = { setUp = answers.setUp, tearDown = answers.tearDown }

local SOURCE = { key = 1, id = 1, type = { alarms = {} } }
local SETTINGS = { late = 2.5, ids = {}, catalogue = { messages = {} },
  sources = { rows = {} } }

local function new_queue()
  return run_of.new(SETTINGS, stamps_of.new())
end

local function add(queue, statistic, matched)
  queue:add(statistic, { matched = matched, row = {}, rules = {} })
end

local function result_of(event, visited)
  return { kind = event.kind, frame = { number = event.frame, visited = visited or false }, event = event }
end

local function finish(queue, unfinished, unread)
  local results = {}
  for i, event in ipairs(unfinished or {}) do results[i] = result_of(event) end
  return { queue:finish { results = results, unread = unread, drops = {}, problems = {}, extended = 0 } }
end

-- A statistic that notes the raw values of what it gets, which are names here.
local function notes(code, text)
  local self = { got = {} }
  function self.add_event(_, event)
    if event.kind ~= "clock" and event.kind ~= "silence" then self.got[#self.got + 1] = event.raws end
  end
  function self.finish(_, ending)
    self.last, self.begin = ending.last, ending.begin
    return code, text
  end
  return self
end

-- A run with such a statistic.
local function new_noted()
  local queue, one = new_queue(), notes()
  add(queue, one)
  return queue, one
end

local function event_of(frame, name, kind, values)
  local m = { seq = 0, raws = name, remarks = {} }
  for key, value in pairs(values or {}) do m[key] = value end
  return kinds.new_event(kind or "message", frame, frame, SOURCE, m, m)
end

local function offer(queue, frame, name, values, visited)
  queue:report(result_of(event_of(frame, name, "message", values), visited))
end

-- A packet comes with an event.
local function come(queue, frame, name, values, visited)
  offer(queue, frame, name, values, visited)
  queue:packet(frame, frame)
end

-- A live capture went on in another file: its packets are none of this one, and nothing is lost at the end.
function T.test_packets_of_another_file()
  local queue, one = new_noted()
  come(queue, 1, "first")
  queue:stop()
  come(queue, 1, "of another")
  finish(queue, { event_of(2, "cut", "unfinished") }, "not all")
  lu.assertEquals({ one.got, queue.packets }, { { "first" }, 1 })
end

-- Packets of a conversation that was unknown when they came.
function T.test_events_of_earlier_packets()
  local queue, one = new_noted()
  queue:packet(1, 1)
  queue:packet(2, 2)
  come(queue, 3, "b")
  offer(queue, 2, "c")
  offer(queue, 3, "of the latest packet")
  come(queue, 4, "d")
  finish(queue)
  lu.assertEquals(one.got, { "b", "c", "of the latest packet", "d" })
end

function T.test_messages_in_the_order_of_the_capture()
  local queue, one = new_noted()
  queue:packet(1, 1)
  offer(queue, 2, "a")
  come(queue, 2, "b")
  come(queue, 3, "c")
  queue:packet(4, 8)
  queue:packet(5, 9)
  lu.assertEquals(finish(queue, { event_of(3, "d", "unfinished") }), { 0, {} })
  lu.assertEquals({ one.got, one.last }, { { "a", "b", "c", "d" }, 9 })
end

function T.test_an_unreliable_history()
  for follows, code in pairs { [true] = 21, [false] = 0 } do
    local queue, one = new_queue(), notes()
    one.follows_changes = follows
    add(queue, one)
    come(queue, 1, "a", { is_unreliable = true })
    local found = finish(queue)
    lu.assertEquals({ found[1], #found[2], one.got }, { code, follows and 1 or 0, { "a" } })
  end
end

-- tshark -2 dissects all packets before the first tap runs; a capture may have a single one.
function T.test_the_first_of_two_passes_does_not_count()
  for count = 1, 3 do
    local queue, one, expected = new_queue(), notes(), {}
    add(queue, one)
    for frame = 1, count do offer(queue, frame, "first", {}, false) end
    for frame = 1, count do
      come(queue, frame, "second", {}, true)
      expected[frame] = "second"
    end
    finish(queue)
    lu.assertEquals(one.got, expected)
  end
end

-- A message that a read filter rejects, or that is looked at between two passes over the file.
function T.test_packets_that_no_tap_sees()
  local queue, one = new_noted()
  offer(queue, 5, "rejected")
  come(queue, 6, "a")
  offer(queue, 7, "rejected")
  queue:packet(8, 8)
  offer(queue, 9, "rejected by -2 -R: its number is another's in the second pass")
  queue:packet(9, 9.5)
  finish(queue)
  lu.assertEquals(one.got, { "a" })
end

function T.test_all_packets_come_again()
  local queue, one = new_noted()
  offer(queue, 1, "clicked on", {}, true)
  queue:reset()
  come(queue, 1, "a", {}, true)
  finish(queue)
  lu.assertEquals(one.got, { "a" })
end

-- The taps of a packet run in any order.
function T.test_filters()
  local queue, all, some, both = new_queue(), notes(), notes(), notes()
  add(queue, all)
  local entry, another = {}, {}
  add(queue, some, entry)
  add(queue, both, another)
  for frame = 30, 70 do
    offer(queue, frame, tostring(frame))
    if frame % 2 == 0 then entry[frame] = true end
    queue:packet(frame, frame)
    if frame % 3 == 0 then
      entry[frame] = true
    end
    if frame == 64 then another[frame] = true end
  end
  finish(queue, { event_of(33, "33 too", "unfinished"), event_of(31, "31 too", "unfinished") })
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
  local dates = new_queue().dates
  local function time(rel) return { dates:exact(rel) } end
  lu.assertEquals(time(2.5), { 2, 500000000 }) -- packets may have no time: then it is that since the first one
  dates:set_first(1700000000, 999999999)
  lu.assertEquals(time(0), { 1700000000, 999999999 })
  lu.assertEquals(time(0.000000001), { 1700000001, 0 })
  lu.assertEquals(time(86400.123456789), { 1700086401, 123456788 })
  lu.assertEquals(time(4194302.999999998), { 1704194303, 999999997 }) -- 48 days
  lu.assertEquals(time(-2), { 1699999998, 999999999 }) -- an earlier packet behind a later one
  dates:set_first(-3, 366198000) -- before a trigger
  lu.assertEquals({ dates:text(0), dates:text(2), dates:text(2.633802), dates:text(3) },
    { "-2.633802000", "-0.633802000", "0.000000000", "0.366198000" })
end

function T.test_a_failure_comes_before_what_is_undecided()
  local function end_of(...)
    local queue = new_queue()
    for _, code in ipairs { ... } do add(queue, notes(code ~= 0 and code or nil, "text " .. code)) end
    return finish(queue)
  end
  lu.assertEquals(end_of(0, 21), { 21, { "text 0", "text 21" } })
  lu.assertEquals(end_of(21, 20, 0)[1], 20)
  lu.assertEquals(end_of(20, 21)[1], 20)
  lu.assertEquals(end_of(21, 21)[1], 21)
end

return T
