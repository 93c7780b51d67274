-- SPDX-License-Identifier: GPL-2.0-or-later
-- What the parts of a catalogue have to be, and how it is said that one is not.  Pure Lua, 5.2 and 5.4.

local utf8 = require("yapp.base.utf8")

local M = {}

local MAX_PROBLEMS, MAX_KEYS = 20, 3000

function M.is_integer(v) return type(v) == "number" and v % 1 == 0 end

--- Whether it is a filter name, or a part of one.
function M.is_name(v) return type(v) == "string" and #v <= 64 and v:find("^[a-z][a-z0-9_]*$") ~= nil end

--- Whether it is a number that is neither NaN nor infinite.
function M.is_finite(v) return type(v) == "number" and v - v == 0 end

--- Whether it is UTF-8 of at most so many bytes, without control characters: over some other texts Wireshark ends at
-- once.
function M.is_utf8(v, most)
  if type(v) ~= "string" or #v > most or v:find("%c") then return false end
  return not utf8.ascii(v):find("[\128-\255]")
end

function M.is_text(v) return M.is_utf8(v, 200) and #v > 0 end

--- A value in an error: a text in quotes and not too long.
function M.shown(v)
  return type(v) == "string" and string.format("%q", v:sub(1, 40)) or tostring(v)
end

--- A function like string.format that adds a text to problems, as long as there are not too many.
-- where  what the text begins with; problems: list of texts
function M.complainer(where, problems)
  return function(format, ...)
    if #problems < MAX_PROBLEMS then problems[#problems + 1] = where .. ": " .. string.format(format, ...) end
  end
end

--- Adds the texts of more to problems, as far as there is room.
function M.append(problems, more, before)
  for i = 1, math.min(#more, MAX_PROBLEMS - #problems) do problems[#problems + 1] = (before or "") .. more[i] end
end

--- Says which option of a table is not among those that there are; one complaint, and what they are.
-- what     "a flag", "type uint8": whose options they are
-- options  { [name] = true }; positional: how many values without a name it has, nil for any number
-- returns  true when there is nothing to say
function M.check_options(t, what, options, complain, positional)
  local unknown, seen, key = nil, 0, next(t)
  while key ~= nil and seen < MAX_KEYS do
    local text = M.shown(key)
    local known = options[key] or M.is_integer(key) and key >= 1 and key <= (positional or MAX_KEYS)
    if not known and (not unknown or text < unknown) then unknown = text end
    key, seen = next(t, key), seen + 1
  end
  if not unknown then return true end
  local names = {}
  for name in pairs(options) do names[#names + 1] = name end
  table.sort(names)
  complain("unknown option %s; %s has %s", unknown, what, #names > 0 and table.concat(names, ", ") or "none")
end

return M
