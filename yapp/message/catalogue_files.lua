-- SPDX-License-Identifier: GPL-2.0-or-later
-- The files of the catalogue: the plugin's own messages, and those of the user, which come after
-- and may replace them.  Pure Lua.

local compiler = require "yapp.message.catalogue"
local input = require "yapp.base.input"

local M = {}

local DENIED = 13 -- EACCES
local MAX_ERROR = 500 -- of an error of the file's own
local KEYED = "%s: the entry %s is not read: a message has its name inside, " ..
  "{ { name = ... }, { name = ... } }, and no key in front"
local GAP = "%s: message %d of the list is nil: a variable that is not defined, or misspelt?"

local function run(path)
  return assert(loadfile(path))()
end

-- Return the value of a file, or nil and an error.
local function read_file(path)
  local file, problem, code = io.open(path)
  if not file then
    -- The system's message begins with the path and is in the user's language, so "not found" is
    -- ours.
    return nil, code == DENIED and "cannot be read: " .. problem or "not found"
  end
  file:close()
  local ok, entries = pcall(run, path)
  if not ok then
    return nil, "the catalogue cannot be read: " .. tostring(entries):sub(1, MAX_ERROR)
  end
  if type(entries) ~= "table" then
    return nil, "the file must return a list of messages, not " .. input.shown(entries)
  end
  if type(entries.name) == "string" then
    return nil, "the file must return a list of messages, { { name = ... } }, not one"
  end
  return entries
end

local function name_of(entry)
  return type(entry) == "table" and entry.name or nil
end

-- Add the messages of a file in their order; one with the name of a message of an earlier file
-- takes its index.
-- all       { entries = list, origins = list of { file, number } }
-- problems  gets a text for each entry that has a name instead of a number, and for the first gap
local function add_entries(all, entries, path, problems)
  local numbers, index_of = {}, {}
  for i, entry in ipairs(all.entries) do
    local name = name_of(entry)
    if name then index_of[name] = i end
  end
  for key in next, entries do
    if input.is_integer(key) and key >= 1 then
      numbers[#numbers + 1] = key
    else
      problems[#problems + 1] = KEYED:format(path, input.shown(key))
    end
  end
  table.sort(numbers)
  for i, number in ipairs(numbers) do
    if number ~= i and (numbers[i - 1] or 0) == i - 1 then
      problems[#problems + 1] = GAP:format(path, i)
    end
    local entry = entries[number]
    local index = index_of[name_of(entry)] or #all.entries + 1
    all.entries[index], all.origins[index] = entry, { file = path, number = number }
  end
end

--- Read the files of the catalogue and compile them as one.
-- files    list of { path =, optional = true if the file may be missing }, in order: a message of a
--          later file replaces one of the same name
-- reserved  optional { [filter name] = true } that no message may use
-- returns  the compiled catalogue and a list of texts, each with the file, the message and the
--          field that is wrong, see message.catalogue.compile
function M.load(files, reserved)
  local all, problems = { entries = {}, origins = {} }, {}
  for _, file in ipairs(files) do
    local entries, problem = read_file(file.path)
    if entries then
      add_entries(all, entries, file.path, problems)
    elseif not (file.optional and problem == "not found") then
      problem = problem .. "; its messages are not decoded"
      problems[#problems + 1] = file.path .. ": " .. problem
    end
  end
  local compiled, found = compiler.compile(all.entries, all.origins, reserved)
  for _, text in ipairs(found) do
    problems[#problems + 1] = text .. "; this message is not decoded"
  end
  return compiled, input.first_of(problems)
end

--- The value of a preference in a file of Wireshark's preferences, nil where it has none.
-- While a plugin loads, the API tells no preference; but only then can fields be registered.
function M.read_preference(path, name)
  local file = io.open(path)
  if not file then return nil end
  local text = "\n" .. (file:read("*a") or "") .. "\n"
  file:close()
  local _, colon = text:find(("\n%s:"):format(name), 1, true)
  local value = colon and text:match("^[ \t]*([^\r\n]-)[ \t\r]*\n", colon + 1)
  return value ~= "" and value or nil
end

return M
