-- SPDX-License-Identifier: GPL-2.0-or-later
-- Runs the pure tests: lua5.2 tests/unit/run.lua tests/unit/test_*.lua, from the top of the repository.
-- Wireshark runs every .lua file below its plugin folder, so also these, of a clone of the repository there: without a
-- command line (arg) they do nothing, and yapp.lua says that the clone does not belong there.
if not arg then return end

-- Some releases package LuaUnit, one file for every Lua, for later Luas only.
package.path = "./?.lua;./tests/unit/?.lua;" .. package.path .. ";/usr/share/lua/5.4/?.lua"
local lu = require("luaunit")

-- LuaUnit collects what is global; each file gives back a table of tests instead.
local suites = {}
for _, path in ipairs(arg) do
  local suite = path:match("([%w_]+)%.lua$")
  suites[#suites + 1] = { suite, require(suite) }
end

while arg[1] do table.remove(arg) end -- LuaUnit 3.5 would take the paths for names of tests
local runner = lu.LuaUnit.new()
runner:setOutputType("text")
local is_one_enough = os.getenv("YAPP_FIRST_FAILURE") ~= nil -- tests/mutate.py
runner.quitOnError, runner.quitOnFailure = is_one_enough, is_one_enough
runner:runSuiteByInstances(suites)
os.exit(runner.result.notSuccessCount)
