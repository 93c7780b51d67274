-- SPDX-License-Identifier: GPL-2.0-or-later
-- luacheck: globals arg debug.sethook os.exit
-- Which lines of the pure modules the unit tests run; from the top of the repository: make coverage.
-- (LuaCov does that too, but Debian has no package of it.)  Prints each module with the lines that no test runs, and
-- how much of all is run; ends with 1 below 98 %.
if not arg then return end -- run by Wireshark, see run.lua

local MIN = 98 -- percent
local hits = {} -- [path][line] = true

-- [function] = the hits of its file, or false if it is no module's: to ask for a function alone takes half the time.
local hits_of = setmetatable({}, { __mode = "k", __index = function(known, run)
  local path = debug.getinfo(run, "S").source:match("^@%./(yapp/.*)")
  if path then hits[path] = hits[path] or {} end
  known[run] = path and hits[path] or false
  return known[run]
end })

local function note(_, line)
  local lines = hits_of[debug.getinfo(2, "f").func]
  if lines then lines[line] = true end
end

local set_hook = debug.sethook
function debug.sethook(hook, ...) -- cpu.lua has a hook of its own, for a while
  if hook then set_hook(hook, ...) else set_hook(note, "l") end
end
debug.sethook()

-- The hook takes most of the time: what a call costs is not judged here.
package.loaded.cpu = {
  is_quadratic = function(call) call() return false end,
  is_linear = function(call, size) call(size) return true end,
}

-- The lines with code.  Of those with nothing but the return at the end of a function nobody knows whether they ran.
local function lines_of(path)
  local lines, listing = {}, io.popen("luac5.4 -l -p " .. path)
  for number, code in listing:read("a"):gmatch("%[(%d+)%]%s+(%u+)") do
    if not (code:find("^RETURN") or code == "VARARGPREP" or code == "JMP") then lines[tonumber(number)] = true end
  end
  listing:close()
  return lines
end

local function report()
  local paths, all, run = {}, 0, 0
  for path in pairs(hits) do paths[#paths + 1] = path end
  table.sort(paths)
  for _, path in ipairs(paths) do
    local missed = {}
    for line in pairs(lines_of(path)) do
      all = all + 1
      if hits[path][line] then run = run + 1 else missed[#missed + 1] = line end
    end
    table.sort(missed)
    print(path, table.concat(missed, " "))
  end
  local percent = 100 * run / all
  print(("%.1f %% of %d lines in %d modules"):format(percent, all, #paths))
  return percent
end

local tests = io.popen("ls tests/unit/test_*.lua")
for path in tests:lines() do arg[#arg + 1] = path end
tests:close()

local exit = os.exit
function os.exit(failed) -- run.lua ends with it
  set_hook()
  local percent = report()
  exit(failed == 0 and percent >= MIN)
end
dofile("tests/unit/run.lua")
