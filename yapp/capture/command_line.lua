-- SPDX-License-Identifier: GPL-2.0-or-later
-- The command line of tshark.  Where the system does not tell it nothing else changes: packets are
-- decoded alike.  Linux does.  Pure Lua but for the options of this process.

local M = {}

local HAS_VALUE = {} -- the letters of tshark 4.0 to 4.6 that a value follows
for letter in ("aAbBcCdeEfFHijJkKmMNoOrRsStTuUwWXyYz"):gmatch(".") do HAS_VALUE[letter] = true end

-- Parse the letters of a word such as -qYyapp.
-- returns  the letter whose value is the next word; nil if the word is complete
local function parse_letters(found, letters)
  for i = 1, #letters do
    local letter = letters:sub(i, i)
    local rest = letters:sub(i + 1)
    found[letter] = HAS_VALUE[letter] and rest or ""
    if HAS_VALUE[letter] then return rest == "" and letter or nil end
  end
end

--- Return the options of a command line: their values by letter or long name, "" for none.
-- text  the words, each with a zero byte behind it, as /proc/self/cmdline has them; the first is
--       the program
function M.parse(text)
  local found, open, is_program = {}, nil, true
  for word in text:gmatch("([^\0]*)\0") do
    local name, value = word:match("^%-%-([%w-]+)=?(.*)$")
    if is_program then
      is_program = false
    elseif open then
      found[open], open = word, nil
    elseif name then
      found[name] = value
    elseif word:find("^%-.") then
      open = parse_letters(found, word:sub(2))
    end
  end
  return found
end

--- Return the options of the command line, see M.parse; none in Wireshark, and where the
-- system does not tell them.  Linux does.
function M.options()
  local file = not gui_enabled() and io.open("/proc/self/cmdline", "rb")
  if not file then return {} end
  local text = file:read("*a")
  file:close()
  return M.parse(text)
end

-- Return the number and the time of a file of a ring by the tail of its name,
-- 00002_20261125230028.pcapng or 20261125230028_00002.pcapng; number 0 for another file.
local function file_of(tail)
  local number, stamp = tail:match("^(%d%d%d%d%d)_(%d+)")
  if not number then stamp, number = tail:match("^(%d+)_(%d%d%d%d%d)") end
  return tonumber(number) or 0, stamp
end

--- Count the files in which a live capture with -b went on behind its first one, which is all that
-- tshark analyses.
-- options  of the command line
-- since    os.time() before the capture began
-- returns  their number, 0 without -b; nil if it cannot be known
function M.count_later_files(options, since)
  if not (options.b or options["ring-buffer"]) then return 0 end
  local path = options.w or ""
  local folder, name = path:match("^(.*[/\\])([^/\\]*)$")
  name = name or path
  local base, count = (name:match("^(.*)%.[^.]*$") or name) .. "_", 0
  local first_stamp = os.date("%Y%m%d%H%M%S", since)
  local is_open, files = pcall(Dir.open, folder or ".")
  if not is_open then return nil end
  for file in files do
    local number, stamp = file_of(file:sub(1, #base) == base and file:sub(#base + 1) or "")
    if number > 1 and stamp >= first_stamp then count = count + 1 end
  end
  files:close()
  return count
end

return M
