-- SPDX-License-Identifier: GPL-2.0-or-later
-- The page of a flight, which the program yapp-tables of tools/ makes, where it is installed.  Pure Lua, 5.2 and 5.4.

local M = {}

local IS_WINDOWS = package.config:sub(1, 1) == "\\"
local PROGRAM = "yapp-tables"
local HOW = [[
The page of a flight is made by yapp-tables, a Python package in the folder tools of this plugin's files, and it is not
there, or not where programs are looked for (PATH).  In the folder of this plugin's files:

    pip install "./tools[report]"

Then this menu opens the page; and on the command line:

    yapp-tables report flight.pcapng -o flight.html
]]

-- A word of a command line.
local function quoted(text)
  if IS_WINDOWS then return '"' .. text:gsub('"', "") .. '"' end
  return "'" .. text:gsub("'", "'\\''") .. "'"
end

-- Runs a command.
-- returns  what it prints, on standard error too; and whether it succeeded
local function run(command)
  local pipe = io.popen(command .. " 2>&1", "r")
  local said = pipe:read("*a")
  return said, pipe:close() == true
end

local function is_there()
  return select(2, run((IS_WINDOWS and "where " or "command -v ") .. PROGRAM))
end

--- The capture that Wireshark has open, which Lua is not told: Linux tells it, as the file that was opened last.
-- returns  its path, "" where nothing tells
function M.capture()
  if IS_WINDOWS then return "" end
  local highest, found = 2, ""
  for number, path in run('for f in /proc/$PPID/fd/*; do [ -f "$f" ] && echo "${f##*/} $(readlink "$f")"; done')
    :gmatch("(%d+) (/[^\n]*)") do
    number = tonumber(number)
    if number > highest and not path:find("^/usr/") then highest, found = number, path end
  end
  return found
end

--- Makes the page of a capture, beside it.
-- capture      its path
-- preferences  a list of "name:value", for tshark
-- returns      the page's path, or nil; and what was said
function M.make(capture, preferences)
  if not is_there() then return nil, HOW end
  local page = capture:gsub("%.[^./\\]*$", "") .. ".html"
  local words = { PROGRAM, "report", quoted(capture), "-o", quoted(page) }
  for _, preference in ipairs(preferences) do words[#words + 1] = "-o " .. quoted(preference) end
  local said, is_whole = run(table.concat(words, " "))
  if not is_whole and not said:find("read in part", 1, true) then return nil, said end
  return page, said
end

--- The address of a file, for a browser.
-- path  whole
function M.address(path)
  path = path:gsub("\\", "/"):gsub("[^%w/._~:-]", function(c) return ("%%%02X"):format(c:byte()) end)
  return "file://" .. (path:sub(1, 1) == "/" and "" or "/") .. path
end

return M
