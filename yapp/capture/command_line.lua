-- SPDX-License-Identifier: GPL-2.0-or-later
-- The command line of tshark.  Where the system does not tell it nothing else changes: packets are
-- decoded alike.  Linux does.  Pure Lua but for the options of this process.

local M = {}

-- The letters of tshark 4.0 to 4.6 that a value follows.
local HAVE_VALUES = "[aAbBcCdeEfFHijJkKmMNoOrRsStTuUwWXyYz]"
-- The letters of long names.
local LETTERS = {
  autostop = "a", ["ring-buffer"] = "b", ["read-file"] = "r", ["read-filter"] = "R",
  ["display-filter"] = "Y",
}

-- Parse the letters of a word such as -qYyapp.
-- returns  the letter whose value is the next word; nil if the word is complete
local function parse_letters(found, letters)
  for i = 1, #letters do
    local letter = letters:sub(i, i)
    local rest, has_value = letters:sub(i + 1), letter:find(HAVE_VALUES)
    found[letter] = has_value and rest or ""
    if has_value then return rest == "" and letter or nil end
  end
end

--- Return the options of a command line: their values by letter, or by a long name that has no
-- letter here; "" for none.
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
      local letter = LETTERS[name]
      found[letter or name] = value
      open = value == "" and letter or nil
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

return M
