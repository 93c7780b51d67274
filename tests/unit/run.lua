-- Runs the pure tests: lua5.2 tests/unit/run.lua tests/unit/test_*.lua, from the top of the repository.
package.path = "./yapp/?.lua;./?.lua;./tests/unit/?.lua;" .. package.path
local lu = require("luaunit")

-- LuaUnit collects what is global; each file gives back a table of tests instead.
local tests = {}
for _, path in ipairs(arg) do
  local suite = path:match("([%w_]+)%.lua$")
  for name, run in pairs(require(suite)) do
    if name:match("^test") then tests[#tests + 1] = { suite .. "." .. name, run } end
  end
end
table.sort(tests, function(a, b) return a[1] < b[1] end)

local runner = lu.LuaUnit.new()
runner:setOutputType("text")
os.exit(runner:runSuiteByInstances(tests))
