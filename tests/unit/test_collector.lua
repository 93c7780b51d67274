-- SPDX-License-Identifier: GPL-2.0-or-later
-- The collector's pace is ours in a long capture only, and gives way to other scripts that keep much.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")

local T = {}

-- The module as it is loaded, with a collector that notes its pace, { pause, step, count in KiB }, or knows none.
local function loaded(pace, is_strange)
  local function collect(what, value)
    if what == "count" then return pace.count end
    if is_strange then error("invalid option '" .. what .. "'") end
    local key = what == "setpause" and "pause" or what == "setstepmul" and "step" or error(what)
    local old = pace[key]
    pace[key] = value
    return old
  end
  local chunk = assert(loadfile("yapp/base/collector.lua", "t", setmetatable({ collectgarbage = collect },
    { __index = _G })))
  return chunk()
end

function T.test_a_capture_without_yapp_leaves_the_pace_alone()
  local pace = { pause = 200, step = 100, count = 3000 }
  loaded(pace).reset()
  lu.assertEquals(pace, { pause = 200, step = 100, count = 3000 })
end

function T.test_early_in_a_long_capture_and_as_before_in_the_next()
  local pace = { pause = 170, step = 250, count = 3000 }
  local collector = loaded(pace)
  collector.packed(3000)
  collector.packed(3000)
  lu.assertTrue(pace.pause <= 150 and pace.step > 500)
  collector.reset()
  lu.assertEquals(pace, { pause = 170, step = 250, count = 3000 })
end

function T.test_what_is_packed_does_not_count()
  local pace = { pause = 200, step = 100, count = 3000 }
  local collector = loaded(pace)
  for _ = 1, 100 do
    pace.count = pace.count + 1024
    collector.packed(2 ^ 20)
  end
  lu.assertTrue(pace.pause <= 150 and pace.step > 500)
  collector.reset()
  lu.assertEquals({ pace.pause, pace.step }, { 200, 100 })
end

function T.test_it_gives_way_to_scripts_that_keep_much_and_comes_back()
  local pace = { pause = 200, step = 100, count = 3000 }
  local collector = loaded(pace)
  collector.packed(3000)
  pace.count = 100 * 1024
  collector.packed(3000)
  lu.assertEquals({ pace.pause, pace.step }, { 200, 100 })
  pace.count = 3000
  collector.packed(3000)
  lu.assertTrue(pace.pause <= 150)
  collector.reset()
  lu.assertEquals({ pace.pause, pace.step }, { 200, 100 })
end

function T.test_a_new_file_forgets_what_the_one_before_had_packed()
  local pace = { pause = 200, step = 100, count = 3000 }
  local collector = loaded(pace)
  collector.packed(50 * 2 ^ 20)
  collector.reset()
  pace.count = 60 * 1024
  collector.packed(3000)
  lu.assertEquals(pace.pause, 200)
end

function T.test_a_lua_that_knows_no_such_options_keeps_its_pace()
  local pace = { count = 3000 }
  local collector = loaded(pace, true)
  collector.packed(3000)
  collector.reset()
  lu.assertEquals(pace, { count = 3000 })
end

return T
