-- SPDX-License-Identifier: GPL-2.0-or-later
-- Checks of catalogues, preferences and options: conditions on values, and the texts of errors.
-- Pure Lua.

local utf8 = require "yapp.base.utf8"

local M = {}

--- The highest message ID that a catalogue or a preference may name.
M.MAX_ID = 2047

local MAX_PROBLEMS = 20 -- of a list
local MAX_TEXT = 1000 -- of a text
local MAX_NAME = 64 -- bytes

--- If a condition does not hold, raise a text, made as by string.format.  Return the condition.
function M.demand(condition, format, ...)
  if condition then return condition end
  error(format:format(...), 0)
end

local demand = M.demand

--- Return a value as errors show it: a text in quotes, at most 40 bytes of it.
function M.shown(v)
  local kind = type(v)
  if kind == "string" then return ("%q"):format(v:sub(1, 40)) end
  return (kind == "table" or kind == "function") and "a " .. kind or tostring(v)
end

-- Conditions on values --------------------------------------------------------------------------

function M.is_integer(v)
  return type(v) == "number" and v % 1 == 0
end

--- Return whether it is a number that is neither NaN nor infinite.
function M.is_finite(v)
  return type(v) == "number" and v - v == 0
end

--- Return whether it is a filter name, or a part of one.
function M.is_name(v)
  if type(v) ~= "string" or #v > MAX_NAME then return false end
  return v:find("^[a-z][a-z0-9_]*$") ~= nil
end

--- Return whether it is a text, UTF-8 without control characters: Wireshark aborts at some others.
function M.is_text(v)
  if type(v) ~= "string" or v == "" or #v > MAX_TEXT then return false end
  return utf8.is_printable(v)
end

--- Raise that a number is not an integer from low to high.
-- what  its name in errors
function M.within(what, v, low, high)
  local is_within = M.is_integer(v) and v >= low and v <= high
  demand(is_within, "%s %s is not one of %d .. %d", what, M.shown(v), low, high)
end

-- Texts and lists -------------------------------------------------------------------------------

--- Return a text without blanks around it.  The time grows with its length alone: a pattern that
-- tries each blank as the last one needs 400,000 steps for each of 400,000 blanks.
function M.trim(text)
  local first = text:find("%S")
  return first and text:match(".*%S", first) or ""
end

--- Return the number that a decimal text has; nil for hexadecimal, nan, inf and other texts.
function M.decimal(text)
  local value = text:find("^[+-]?[%d.]+[eE]?[+-]?%d*$") and tonumber(text)
  return M.is_finite(value) and value or nil
end

--- Return the row of a list that has a name; nil, and the names that there are, if none has it.
function M.find(list, name)
  local names = {}
  for i, one in ipairs(list) do
    if one.name == name then return one end
    names[i] = one.name
  end
  return nil, table.concat(names, ", ")
end

-- Sets, rows and their options -------------------------------------------------------------------

--- The names in a text as a set: { [name] = true }.
function M.set(text)
  local names = {}
  for name in text:gmatch("%S+") do names[name] = true end
  return names
end

--- The keys of a table, sorted, as a text for a message.
function M.names(t)
  local names = {}
  for name in pairs(t) do names[#names + 1] = name end
  table.sort(names)
  return table.concat(names, ", ")
end

-- Options that are texts or tables wherever they stand.  The code that uses the others checks them.
local TEXTS = M.set("section unit help info")
local TABLES = M.set("values flags bits cases differences derived")

--- Raise errors in the options of a row, or of a message.
-- what        the owner of the options: "flag stopped", "type uint8"
-- options     { [name] = true } of the options that are allowed
-- positional  how many values without a name it has
function M.options(t, what, options, positional)
  for key, value in pairs(t) do
    if options[key] then
      demand(not TEXTS[key] or M.is_text(value), "%s must be a text", key)
      demand(not TABLES[key] or type(value) == "table", "%s must be a table", key)
    elseif not (M.is_integer(key) and key >= 1 and key <= positional) then
      demand(false, "unknown option %s; %s has %s", M.shown(key), what, M.names(options))
    end
  end
end

--- Raise errors in the name, title or options of a row { name, ..., title }.
-- what      the kind of its list: "flag"; i = its index in that
-- title_index  the index of its title
-- options   see M.options
-- returns   its name in errors: "flag stopped"
function M.row(row, what, i, title_index, options)
  local number = what .. " " .. i
  demand(type(row) == "table", "%s: %s is not { name, ..., title }", number, M.shown(row))
  local name = row[1]
  demand(M.is_name(name), "%s: %s is not a filter name (a-z, 0-9, _)", number, M.shown(name))
  what = what .. " " .. name
  demand(M.is_text(row[title_index]), "%s has no title", what)
  M.options(row, what, options, title_index)
  return what
end

--- Return the first of many problems, and how many there are.
function M.first_of(problems)
  local few = {}
  for i = 1, math.min(#problems, MAX_PROBLEMS) do
    few[i] = problems[i]
  end
  if #problems > #few then
    few[#few] = ("and so on: %d problems in all"):format(#problems)
  end
  return few
end

return M
