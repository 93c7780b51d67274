-- SPDX-License-Identifier: GPL-2.0-or-later
-- Statistics between Wireshark and their run: taps, what the end is told, exit codes.  Wireshark's API,
-- the queue and the dissectors are stand-ins here; tests/e2e and tests/gui have the real ones.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")

local T = {}

local NAMES = { "gui_enabled", "get_version", "wtap", "Listener", "Dir", "retap_packets", "all_field_infos" }
local MODULES = { "yapp.stat.taps", "yapp.stat.windows", "yapp.stat.run", "yapp.capture.command_line" }
local PACKETS = 4
local ERROR_FRAMES = "can.flags.err == 1" -- no packet is one
local real = { exit = os.exit, stdout = io.stdout, stderr = io.stderr }

local seen -- what happened, in tables by subject
local wireshark -- what it answers

-- A tap that is in seen.taps as long as it is there.
local function new_tap(name, filter)
  if filter == "nonsense" then error('taps.lua:1: filter "nonsense" is invalid - no such field') end
  local tap = { name = name, filter = filter }
  function tap.remove() seen.taps[tap] = nil end
  seen.taps[tap], seen.order[#seen.order + 1] = true, tap
  return tap
end

local function new_queue(settings, _, hint)
  local queue = { settings = settings, hint = hint, packets = 0, unread = 0 }
  seen.queue = queue
  function queue.packet(self, number, rel, has_clock)
    self.packets = self.packets + 1
    table.insert(seen.packets, { number, rel, has_clock() })
  end
  queue.dates = { set_first = function(_, ...) seen.begins = { ... } end }
  function queue.reset() seen.resets = seen.resets + 1 end
  function queue.add(_, statistic, options)
    seen.added = { statistic, options }
    seen.matched = {}
    return { matched = seen.matched }
  end
  function queue.stop() seen.has_stopped = true end
  function queue.finish(_, capture)
    seen.capture = capture
    if wireshark.fails then error("finish failed", 0) end
    return wireshark.code, wireshark.texts
  end
  return queue
end

-- What a part of the plugin is asked, in seen[name]: methods that return nothing, and those of a table.
local function stand_in(name, methods)
  return setmetatable(methods, { __index = function(_, method)
    return function(_, ...) table.insert(seen[name], { method, ... }) end
  end })
end

-- Packets come to all taps; each has the fields of a packet.
local function read_packets()
  for number = 1, wireshark.packets do
    for _, tap in ipairs(seen.order) do
      local is_called = tap.packet and tap.filter ~= ERROR_FRAMES
      if seen.taps[tap] and is_called then tap.packet({ number = number, rel_ts = number / 10 }, {}) end
    end
  end
  if wireshark.on_read then wireshark.on_read() end
end

local function new_stat(is_gui)
  local buses = stand_in("buses", { found = { count = 0 } })
  function buses.drops() return { "of the buses" } end
  function buses.has_times() return not wireshark.lacks_times, wireshark.has_clock end
  function buses.begin(_, pinfo) return 17, math.floor(pinfo.rel_ts * 50) end
  function buses.missed_file() return wireshark.is_reloaded end
  local reading = stand_in("reading", {})
  function reading.drops() return { "of streams" } end
  function reading.finish(_, may_go_on)
    seen.may_go_on = may_go_on
    return { "results" }
  end
  local headers = stand_in("headers", { waiting = false, extended = 7, can = 9 })
  local parts = {
    settings = { catalogue = { messages = {}, by_name = {} }, version = "1" },
    buses = buses, reading = reading, headers = headers,
    wants = stand_in("wants", { first_pass = "wanted" }),
    calls = { begun = 0, ended = 0 },
    frames = { is_second_pass = function() return wireshark.is_second_pass end },
    find_options = function() return wireshark.undecoded or {}, 5 end,
    watch = function() seen.watched = seen.watched + 1 end,
    unwatch = function() seen.watched = seen.watched - 1 end,
    counted = function(call) return call end,
  }
  function _G.gui_enabled() return is_gui end
  package.loaded["yapp.stat.taps"] = nil
  package.loaded["yapp.stat.run"] = { new = new_queue }
  package.loaded["yapp.capture.command_line"] = {
    options = function() return wireshark.options end,
  }
  package.loaded["yapp.stat.windows"] = { register = function(stat)
    seen.menu = stat
    local function show(text) seen.shown = text end
    return show, function() seen.drawn = true end
  end }
  return require("yapp.stat.taps").new(parts), parts
end

function T.setUp()
  seen = { taps = {}, order = {}, packets = {}, resets = 0, watched = 0, stderr = {}, stdout = {}, folders = {},
    buses = {}, reading = {}, headers = {}, wants = {} }
  wireshark = { packets = PACKETS, code = 0, texts = {}, options = {} }
  _G.Listener = { new = new_tap }
  _G.Dir = { make = function(path) table.insert(seen.folders, path) end, exists = function() return false end }
  _G.retap_packets = read_packets
  _G.wtap = { SOCKETCAN = 125 }
  function _G.get_version() return "4.0.17 (of nobody)" end
  function _G.all_field_infos()
    return { name = "frame.number" }, { name = "frame.time_epoch", value = { secs = 17, nsecs = 5 } }
  end
  function os.exit(code) error({ code = code }, 0) end -- luacheck: ignore
  -- luacheck: push ignore
  io.stderr = { write = function(_, ...) seen.stderr[#seen.stderr + 1] = table.concat({ ... }) end }
  io.stdout = {
    write = function(_, text)
      seen.stdout[#seen.stdout + 1] = text
      return not wireshark.is_full, "disk full"
    end,
    flush = function() return not wireshark.is_full_at_end, wireshark.is_full_at_end and "disk full" or nil end,
  }
  -- luacheck: pop
end

function T.tearDown()
  for _, name in ipairs(NAMES) do _G[name] = nil end
  for _, name in ipairs(MODULES) do package.loaded[name] = nil end
  os.exit, io.stdout, io.stderr = real.exit, real.stdout, real.stderr -- luacheck: ignore
end

-- Wireshark -----------------------------------------------------------------------------------------------------------

-- A statistic in a window of a capture that has so many packets.
local function window(total)
  local stat, parts = new_stat(true)
  stat.total = total or PACKETS
  return stat, parts
end

function T.test_what_the_end_is_told()
  wireshark.lacks_times, wireshark.has_clock = true, false
  local stat = window()
  lu.assertEquals({ stat:run("yapp,faults") }, { "", {} })
  lu.assertEquals(seen.capture, {
    results = { "results" },
    drops = { "of the buses", "of streams" },
    lacks_times = true,
    extended = 7,
    problems = {},
  })
  lu.assertEquals(seen.may_go_on, true) -- packets may be revisited
  lu.assertEquals(seen.packets[3], { 3, 0.3, false })
  lu.assertEquals(seen.added[2].what, "faults")
end

function T.test_headers_that_were_not_decoded()
  wireshark.undecoded = { "-d a", "-d b" }
  window():run("yapp,faults")
  lu.assertEquals(seen.capture.problems, { "5 YAPP headers in this file were not decoded; try -d a -d b" })
end

function T.test_the_exact_time_is_that_of_the_first_packet()
  window():run("yapp,faults")
  lu.assertEquals(seen.begins, { 17, 5 })
  lu.assertEquals(seen.wants, {}, "Wireshark may revisit all packets")
end

function T.test_why_an_answer_is_incomplete()
  local stat, parts = window(PACKETS + 1)
  wireshark.is_reloaded = true
  wireshark.on_read = function() parts.calls.begun = parts.calls.begun + 2 end
  stat:run("yapp,faults")
  lu.assertEquals(#seen.capture.problems, 3)
  lu.assertStrContains(seen.capture.problems[1], "incomplete: 2 Lua errors, see")
  lu.assertStrContains(seen.capture.problems[2], "only 4 of 5 packets were read")
  lu.assertStrContains(seen.capture.problems[3], "Lua plugins were reloaded while the capture was open")
  lu.assertEquals(seen.capture.unread, "not all packets were read")
  wireshark.on_read = function() parts.calls.begun = parts.calls.ended + 1 end
  stat:run("yapp,faults")
  lu.assertStrContains(seen.capture.problems[1], "incomplete: 1 Lua error, see")
  stat.total, parts.calls.begun = 0, parts.calls.ended
  wireshark.on_read = nil
  stat:run("yapp,faults")
  lu.assertEquals(seen.capture.problems, {}, "there is no capture")
end

function T.test_a_reading_ends_whole()
  local stat = window()
  for run = 1, 2 do
    seen.begins = nil
    stat:run("yapp,faults")
    lu.assertEquals({ next(seen.taps) or seen.begins, seen.watched }, { { 17, 5 }, 0 }, run)
    lu.assertEquals(seen.reading[#seen.reading], { "listen", false })
    lu.assertEquals(seen.headers[#seen.headers], { "close" })
    lu.assertEquals(seen.queue.packets, PACKETS)
  end
  lu.assertEquals(seen.reading[1][1], "listen")
  lu.assertIs(seen.reading[#seen.reading - 1][2], stat.current)
end

function T.test_a_window_while_another_one_reads()
  local stat, answer, frames = window(), nil, nil
  wireshark.on_read = function() answer, frames = stat:run("yapp,summary") end
  stat:run("yapp,faults")
  lu.assertStrContains(answer, "another window is still reading")
  lu.assertEquals({ frames, seen.added[2].what }, { {}, "faults" })
end

-- Of a live capture: Wireshark dissects a new packet, and revisits it when its turn comes.
function T.test_packets_that_come_while_it_reads()
  local stat = window()
  function _G.retap_packets()
    for _, number in ipairs { 1, 2, 5, 3, 4, 5 } do
      for tap in pairs(seen.taps) do
        if tap.packet and tap.filter ~= ERROR_FRAMES then
          tap.packet({ number = number, rel_ts = number / 10 }, {})
        end
      end
    end
  end
  stat:run("yapp,faults")
  lu.assertEquals(seen.queue.packets, 5)
end

-- Another one that reads resets all taps, although Wireshark goes on with this reading.
local function count_of(list, method)
  local count = 0
  for _, call in ipairs(list) do if call[1] == method then count = count + 1 end end
  return count
end

function T.test_taps_that_are_reset()
  local stat, parts = window()
  wireshark.on_read = function()
    for tap in pairs(seen.taps) do if tap.reset then tap.reset() end end
  end
  stat:run("yapp,faults")
  lu.assertEquals(seen.resets, 0)
  wireshark.packets = 0
  stat:run("yapp,faults")
  lu.assertEquals({ seen.resets, parts.headers.can }, { 1, 9 })
  lu.assertEquals(count_of(seen.headers, "open"), 3, "counted anew")
end

function T.test_problems_are_said_once()
  local stat = window()
  wireshark.texts = { "one (of", "two" }
  lu.assertEquals(stat:run("yapp,faults"), "one (of\ntwo\n")
  wireshark.on_read = function() seen.added[1].context.out("one (of\n") end
  lu.assertEquals(stat:run("yapp,events"), "one (of\ntwo\n")
  wireshark.on_read = nil
  lu.assertStrMatches(stat:run("yapp,summary,nonsense"), "nonsense: the options of summary .*")
  lu.assertNil(next(seen.taps))
  lu.assertStrContains(stat:run("yapp,check,nonsense"), "nonsense")
end

function T.test_a_filter()
  local stat = window()
  wireshark.on_read = function()
    for tap in pairs(seen.taps) do if tap.filter == "yapp.seq == 1" then tap.packet { number = 3 } end end
  end
  stat:run("yapp,faults,filter=yapp.seq == 1")
  lu.assertEquals(seen.matched, { true, true, true, true })
  lu.assertEquals(stat:run("yapp,faults,filter=nonsense"), "the filter nonsense is not one: no such field\n")
end

function T.test_folders_are_made()
  window():run("yapp,csv,/nowhere/above/here")
  lu.assertEquals(seen.folders, { "", "/nowhere", "/nowhere/above", "/nowhere/above/here" })
end

function T.test_packets_are_counted()
  local stat = new_stat(true)
  stat:register_menus()
  lu.assertIs(seen.menu, stat)
  lu.assertEquals(stat.total, 0)
  read_packets()
  for _, tap in ipairs(seen.order) do tap.draw() end
  lu.assertEquals({ stat.total, seen.drawn }, { PACKETS, true })
  wireshark.packets = 2
  read_packets()
  lu.assertEquals(stat.total, PACKETS, "the user stopped the reading")
  stat:reset()
  lu.assertEquals(stat.total, 0)
  stat:begin("yapp,events")
  lu.assertEquals(seen.shown, "yapp,events")
end

-- As long as a window waits.
function T.test_a_window_is_told_how_far_the_reading_is()
  local stat, numbers = new_stat(true), {}
  stat:register_menus()
  local function note(number) numbers[#numbers + 1] = number end
  wireshark.packets = 25000
  stat:run("yapp,faults", note)
  lu.assertEquals(numbers, { 10000, 20000 })
  read_packets()
  lu.assertEquals(#numbers, 2)
end

-- tshark --------------------------------------------------------------------------------------------------------------

-- Return the exit code of a run with these arguments, nil if it goes on.
local function tshark(...)
  local stat, parts = new_stat(false)
  for _, text in ipairs { ... } do stat:begin(text) end
  read_packets()
  for _, tap in ipairs(seen.order) do
    if tap.draw then
      local ok, problem = pcall(tap.draw)
      if not ok then return problem.code or error(problem, 0), parts end
    end
  end
  return nil, parts
end

-- What was said of a preference when it was read is not said again.
function T.test_a_problem_is_said_once()
  local preferences = require("yapp.host.preferences")
  wireshark.code, wireshark.texts = 21, { "preferences: late", "check: preferences: late\ncheck: other" }
  wireshark.on_read = function() preferences.complain_once { "late" } end
  tshark("yapp,faults")
  lu.assertEquals(seen.stderr, { "yapp: preferences: late\n", "yapp: check: other\n" })
end

-- A live capture with -b goes on in another file.
function T.test_another_file()
  local stat = new_stat(false)
  stat:reset()
  stat:begin("yapp,faults")
  stat:reset()
  lu.assertNil(seen.has_stopped)
  read_packets()
  stat:reset()
  lu.assertTrue(seen.has_stopped)
end

function T.test_exit_codes()
  lu.assertNil(tshark("yapp,faults"))
  lu.assertEquals({ seen.stderr, seen.may_go_on }, { {}, false })
  wireshark.code, wireshark.texts = 20, { "one\ntwo", "three" }
  lu.assertEquals(tshark("yapp,faults"), 20)
  lu.assertEquals(seen.stderr, { "yapp: one\n", "yapp: two\n", "yapp: three\n" })
  wireshark.fails = true
  lu.assertEquals(tshark("yapp,faults"), 21)
  lu.assertEquals(seen.stderr[#seen.stderr], "yapp: finish failed\n")
end

function T.test_arguments_that_are_wrong()
  for _, text in ipairs { "yapp,nonsense", "yapp,faults,nonsense", "yapp,faults,filter=nonsense" } do
    local ok, problem = pcall(tshark, text)
    lu.assertEquals({ ok, problem.code }, { false, 21 }, text)
    lu.assertStrContains(seen.stderr[#seen.stderr], "nonsense")
    lu.assertEquals(seen.stderr[#seen.stderr]:sub(1, 6), "yapp: ")
  end
  lu.assertNil(tshark("yapp,check,nonsense"), "the report of a check has its errors")
end

function T.test_a_full_disk()
  wireshark.is_full_at_end = true
  lu.assertEquals(tshark("yapp,faults"), 21)
  lu.assertEquals(seen.stderr, { "yapp: standard output: disk full\n" })
  wireshark.code = 20
  lu.assertEquals(tshark("yapp,faults"), 20, "a fault that was found matters more")
  wireshark.is_full_at_end, wireshark.is_full, wireshark.code = false, true, 0
  wireshark.on_read = function() seen.added[1].context.out("text") end
  lu.assertEquals(tshark("yapp,events"), 21)
  lu.assertEquals(seen.stdout, { "text" })
end

function T.test_several_statistics_have_one_reading()
  tshark("yapp,faults", "yapp,summary")
  lu.assertEquals({ count_of(seen.reading, "listen"), seen.watched, seen.queue.packets }, { 1, 1, PACKETS })
end

-- The first tap in tshark's only pass.
function T.test_the_only_pass()
  local _, parts = new_stat(false)
  parts.headers.waiting = true
  parts:begin("yapp,faults")
  read_packets()
  lu.assertEquals({ count_of(seen.wants, "set_only_pass"), count_of(seen.headers, "on_packet") }, { 1, PACKETS })
  lu.assertEquals({ count_of(seen.headers, "use_taps"), parts.calls.begun, parts.calls.ended }, { 1, PACKETS, PACKETS })
  T.setUp()
  wireshark.is_second_pass = true
  tshark("yapp,faults")
  lu.assertEquals({ count_of(seen.wants, "set_only_pass"), count_of(seen.headers, "use_taps") }, { 0, 0 })
end

function T.test_a_ring_of_files()
  for _, name in ipairs { "b", "ring-buffer" } do
    wireshark.options = { [name] = "files:2" }
    tshark("yapp,faults")
    lu.assertStrContains(seen.capture.problems[1], "only 4 packets were read: of a live capture with -b")
    lu.assertEquals(seen.capture.unread, "not all packets were read")
  end
end

function T.test_a_display_filter_is_named()
  for option, is_said in pairs { Y = true, ["display-filter"] = true, R = false } do
    wireshark.options = { [option] = "yapp" }
    tshark("yapp,faults")
    local hint = seen.queue.hint
    lu.assertEquals(hint and hint:find("filter=EXPRESSION", 1, true) ~= nil or false, is_said, option)
  end
end

return T
