-- SPDX-License-Identifier: GPL-2.0-or-later
-- What the parts of a catalogue, and of a preference, have to be, and how it is said that one is
-- not.  Pure Lua.

local utf8 = require("yapp.base.utf8")

local M = {}

local MOST_PROBLEMS = 20 -- of a list that somebody reads
local MOST_BYTES = 200 -- of a text
local MOST_OF_NAME = 64 -- bytes

--- Raises a text like string.format's where a condition does not hold; returns the condition.
function M.demand(condition, format, ...)
  if not condition then error(format:format(...), 0) end
  return condition
end

function M.is_integer(v) return type(v) == "number" and v % 1 == 0 end

--- Whether it is a filter name, or a part of one.
function M.is_name(v)
  return type(v) == "string" and #v <= MOST_OF_NAME and v:find("^[a-z][a-z0-9_]*$") ~= nil
end

--- Whether it is a number that is neither NaN nor infinite.
function M.is_finite(v) return type(v) == "number" and v - v == 0 end

--- Whether it is a text of at most so many bytes, UTF-8 without control characters: over some other
-- texts Wireshark ends at once.
function M.is_text(v, most)
  return type(v) == "string" and #v > 0 and #v <= (most or MOST_BYTES) and utf8.is_printable(v)
end

--- A value in an error: a text in quotes and not too long.
function M.shown(v)
  return type(v) == "string" and ("%q"):format(v:sub(1, 40)) or tostring(v)
end

--- Raises which option of a table is not among those that there are.
-- what        "a flag", "type uint8": whose options they are
-- options     { [name] = true }
-- positional  how many values without a name it has
function M.check_options(t, what, options, positional)
  for key in pairs(t) do
    if not options[key] and not (M.is_integer(key) and key >= 1 and key <= positional) then
      local names = {}
      for name in pairs(options) do names[#names + 1] = name end
      table.sort(names)
      local known = #names > 0 and table.concat(names, ", ") or "none"
      M.demand(false, "unknown option %s; %s has %s", M.shown(key), what, known)
    end
  end
end

--- A list of problems as far as somebody reads it.
function M.few(problems)
  local few = {}
  for i = 1, math.min(#problems, MOST_PROBLEMS) do few[i] = problems[i] end
  if #problems > #few then few[#few] = ("and so on: %d problems in all"):format(#problems) end
  return few
end

return M
