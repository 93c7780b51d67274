-- SPDX-License-Identifier: GPL-2.0-or-later
-- Checks of catalogues, preferences and options.  Pure Lua.

local utf8 = require "yapp.base.utf8"

local M = {}

--- The highest message ID that a catalogue or a preference may name.
M.MAX_ID = 2047

--- If a condition does not hold, raise a text, made as by string.format.  Return the condition.
function M.demand(condition, format, ...)
  if condition then return condition end
  error(format:format(...), 0)
end

--- Return a value as errors show it: a text in quotes, at most 40 bytes of it.
function M.shown(v)
  return type(v) == "string" and ("%q"):format(v:sub(1, 40)) or tostring(v)
end

--- Return whether it is a text, UTF-8 without control characters: Wireshark aborts at some others.
function M.is_text(v)
  return type(v) == "string" and v ~= "" and utf8.is_printable(v)
end

--- Return a text without blanks around it.  The time grows with its length alone.
function M.trim(text)
  local first = text:find("%S")
  return first and text:match(".*%S", first) or ""
end

--- Return the number that a decimal text has; nil for hexadecimal, nan, inf and other texts.
function M.decimal(text)
  local value = text:find("^[+-]?[%d.]+[eE]?[+-]?%d*$") and tonumber(text)
  return value and value - value == 0 and value or nil
end

--- Return the row of a list that has a name; nil, and the names that there are, if none has it.
function M.find(list, name)
  local names = {}
  for i, row in ipairs(list) do
    if row.name == name then return row end
    names[i] = row.name
  end
  return nil, table.concat(names, ", ")
end

--- Return a list of the words of a text.
function M.words(text)
  local list = {}
  for word in text:gmatch("%S+") do list[#list + 1] = word end
  return list
end

--- Name the first values of rows, and return these: rows("name help", { { "x", "is x" } }) gives
-- { { "x", "is x", name = "x", help = "is x" } }.
function M.rows(names, rows)
  local keys = M.words(names)
  for _, row in ipairs(rows) do
    for i, key in ipairs(keys) do row[key] = row[i] end
  end
  return rows
end

--- Return the row of a list that has a name.  If none has it, raise which names there are.
-- what  the rows are, in errors
function M.choose(list, name, what)
  local row, names = M.find(list, name)
  return M.demand(row, "no %s %q; known: %s", what, name, names)
end

--- The names in a text as a set: { [name] = true }.
function M.set(text)
  local names = {}
  for _, name in ipairs(M.words(text)) do names[name] = true end
  return names
end

--- The keys of a table, sorted, as a text for a message.
function M.names(t)
  local names = {}
  for name in pairs(t) do names[#names + 1] = name end
  table.sort(names)
  return table.concat(names, ", ")
end

return M
