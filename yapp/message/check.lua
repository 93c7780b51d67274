-- SPDX-License-Identifier: GPL-2.0-or-later
-- What the parts of a catalogue, and of a preference, have to be, and how it is said that one is
-- not.  Pure Lua.

local utf8 = require("yapp.base.utf8")

local M = {}

local MOST_PROBLEMS = 20 -- of a list that somebody reads
local MOST_BYTES = 1000 -- of a text
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

--- Whether it is a text, UTF-8 without control characters: over some others Wireshark ends at once.
function M.is_text(v)
  return type(v) == "string" and #v > 0 and #v <= MOST_BYTES and utf8.is_printable(v)
end

--- Raises that an option is there and no text; returns it.
-- what  whose option it is, "flag hot: ", where that is not known
function M.text(t, option, what)
  local text = t[option]
  M.demand(text == nil or M.is_text(text), "%s%s must be a text", what or "", option)
  return text
end

--- Raises that a number is not an integer from low to high; returns it.
function M.within(what, v, low, high)
  local is_within = M.is_integer(v) and v >= low and v <= high
  return M.demand(is_within and v, "%s %s is not one of %d .. %d", what, M.shown(v), low, high)
end

--- The names in a text as a set: { [name] = true }.
function M.set(text)
  local names = {}
  for name in text:gmatch("%S+") do names[name] = true end
  return names
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
  local names = {}
  for name in pairs(options) do names[#names + 1] = name end
  table.sort(names)
  for key in pairs(t) do
    local is_positional = M.is_integer(key) and key >= 1 and key <= positional
    M.demand(options[key] or is_positional, "unknown option %s; %s has %s",
      M.shown(key), what, table.concat(names, ", "))
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
