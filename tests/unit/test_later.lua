-- SPDX-License-Identifier: GPL-2.0-or-later
-- Modules that load when they are first used.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")

local T = {}

-- Call a function with a base.later of its own and these modules: { [name] = function that makes it }.
-- returns  what stderr got
local function with_modules(modules, call)
  local said, stderr = {}, io.stderr
  for name, make in pairs(modules) do package.preload[name] = make end
  package.loaded["yapp.base.later"] = nil
  io.stderr = { write = function(_, ...) said[#said + 1] = table.concat { ... } end } -- luacheck: ignore 122
  local ok, why = pcall(call, require("yapp.base.later"))
  io.stderr = stderr -- luacheck: ignore 122
  for name in pairs(modules) do package.preload[name], package.loaded[name] = nil, nil end
  lu.assertTrue(ok, why)
  return table.concat(said)
end

local function broken() error("x.lua:3: '=' expected\nnear here", 0) end

function T.test_a_module_loads_when_it_is_used()
  local count = 0
  local said = with_modules({ ["yapptest.a"] = function()
    count = count + 1
    return { value = 1 }
  end }, function(later)
    local module = later "yapptest.a"
    lu.assertEquals(count, 0)
    lu.assertEquals({ module.value, module.other, count }, { 1, nil, 1 })
    require("yapptest.a").value = 2
    lu.assertEquals({ module.value, count }, { 2, 1 })
    lu.assertTrue(later.load_all())
  end)
  lu.assertEquals(said, "")
end

function T.test_a_module_that_does_not_load()
  local said = with_modules({ ["yapptest.a"] = broken }, function(later)
    local module = later "yapptest.a"
    for _ = 1, 2 do
      local ok, why = pcall(function() return module.value end)
      lu.assertFalse(ok)
      lu.assertEquals(why, "cannot load yapptest.a: x.lua:3: '=' expected near here; install the plugin again")
    end
    lu.assertFalse(later.load_all())
  end)
  lu.assertEquals(said, "yapp: cannot load yapptest.a: x.lua:3: '=' expected near here; install the plugin again\n")
end

-- A module that is loaded may name others.
function T.test_all_modules()
  local loaded = {}
  local function all(broken_one)
    local modules = { ["yapptest.b"] = broken_one or function()
      loaded[#loaded + 1] = "b"
      return {}
    end }
    modules["yapptest.a"] = function()
      loaded[#loaded + 1] = "a"
      require("yapp.base.later")("yapptest.b")
      return {}
    end
    return with_modules(modules, function(later)
      lu.assertTrue(later.load_all())
      later("yapptest.a")
      lu.assertEquals(later.load_all(), not broken_one)
    end)
  end
  lu.assertEquals(all(), "")
  lu.assertEquals(loaded, { "a", "b" })
  lu.assertStrContains(all(broken), "cannot load yapptest.b")
end

return T
