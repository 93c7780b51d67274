-- SPDX-License-Identifier: GPL-2.0-or-later
-- A test report in JUnit's XML, as CI systems read it.  Pure Lua, 5.2 and 5.4.

local files = require("yapp.stat.file")

local M = {}

local ENTITIES = { ["<"] = "&lt;", [">"] = "&gt;", ["&"] = "&amp;", ['"'] = "&quot;" }

-- XML has no control characters, not even as entities, and no bytes that are not UTF-8.
local function escape(value)
  local ascii = require("yapp.base.utf8").ascii(value)
  if ascii:find("[\128-\255]") then value = ascii:gsub("[\128-\255]", "?") end
  return (value:gsub("%c", " "):gsub('[<>&"]', ENTITIES))
end

--- The report of some cases: { name =, status = "ok", "failed" or "error", text = what is said of it }.
function M.report(cases)
  local counts = { ok = 0, failed = 0, error = 0 }
  local lines = {}
  for i, case in ipairs(cases) do
    counts[case.status] = counts[case.status] + 1
    local start = ('  <testcase classname="yapp.check" name="%s"'):format(escape(case.name))
    local kind = case.status == "failed" and "failure" or "error"
    lines[i] = case.status == "ok" and start .. "/>" or
      ('%s><%s message="%s"/></testcase>'):format(start, kind, escape(case.text))
  end
  return ('<?xml version="1.0" encoding="UTF-8"?>\n<testsuite name="%s" tests="%d" failures="%d" errors="%d">\n%s\n%s')
    :format("yapp.check", #cases, counts.failed, counts.error, table.concat(lines, "\n"), "</testsuite>\n")
end

--- Writes the report.
-- returns  true; nil and what went wrong
function M.write(path, cases)
  local file, problem = files.create(path)
  if not file then return nil, problem end
  file:write(M.report(cases))
  return files.finish { file }
end

return M
