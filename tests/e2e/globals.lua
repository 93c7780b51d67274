-- SPDX-License-Identifier: GPL-2.0-or-later
-- Run before and after a plugin: the second run tells, on stderr, what changed among the globals and in the libraries.
local KEY = "yapptest.globals"
local LIBRARIES = { "string", "table", "math", "io", "os", "debug", "coroutine", "bit", "bit32", "utf8" }

local function snapshot()
  local seen = {}
  for name, value in pairs(_G) do seen[name] = value end
  for _, library in ipairs(LIBRARIES) do
    for name, value in pairs(_G[library] or {}) do seen[library .. "." .. name] = value end
  end
  return seen
end

local before = package.loaded[KEY]
if not before then
  package.loaded[KEY] = snapshot()
  return
end
local after = snapshot()
for name, value in pairs(after) do
  if before[name] ~= value then io.stderr:write("globals: ", name, "\n") end
end
for name in pairs(before) do
  if after[name] == nil then io.stderr:write("globals: ", name, " is gone\n") end
end
io.stderr:write("globals: compared\n")
