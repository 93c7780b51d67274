-- SPDX-License-Identifier: GPL-2.0-or-later
-- Modules that load when they are first used: most captures have no YAPP, and to compile all
-- modules takes longer than all else that the plugin adds to a start of Wireshark.  Pure Lua.
--
--   local later = require "yapp.base.later"
--   local reading_of = later "yapp.reading.reading"     loads nothing
--   reading_of.new(types, buses)                        loads it

local is_waiting = {} -- [name of a module] = true until it is loaded
local is_reported = {} -- [name of a module] = true once stderr has why it does not load

-- Load a module; return whether that worked, and the module, or why not.
local function load_module(name)
  local ok, loaded = pcall(require, name)
  if ok then
    is_waiting[name] = nil
    return true, loaded
  end
  local text = "cannot load %s: %s; install the plugin again"
  local why = text:format(name, (tostring(loaded):gsub("%s*\n%s*", " ")))
  if not is_reported[name] then io.stderr:write("yapp: ", why, "\n") end
  is_reported[name] = true
  return false, why
end

local M = {}

--- Load all modules that still wait.
-- returns  true if all of them could be loaded; stderr has why not
function M.load_all()
  local is_whole, names = true, {}
  for name in pairs(is_waiting) do names[#names + 1] = name end
  for _, name in ipairs(names) do is_whole = load_module(name) and is_whole end
  if is_whole and next(is_waiting) then return M.load_all() end -- a module may name others
  return is_whole
end

-- Return a stand-in of a module: its first use loads the module.
local function stand_in(_, name)
  local methods, module = {}, nil
  function methods.__index(_, key)
    if not module then
      local ok, loaded = load_module(name)
      if not ok then error(loaded, 0) end
      module, methods.__index = loaded, loaded
    end
    return module[key]
  end
  is_waiting[name] = true
  return setmetatable({}, methods)
end

return setmetatable(M, { __call = stand_in })
