-- SPDX-License-Identifier: GPL-2.0-or-later
-- The files of the catalogue: the plugin's own messages, and those of the user, which come after and may replace them.
-- Pure Lua, 5.2 and 5.4.

local catalogue = require("yapp.message.catalogue")
local check = require("yapp.message.catalogue_check")

local M = {}

local DENIED = 13 -- EACCES

-- What a file returns, and whether it ran; else why not.  It is a program: it may raise anything.
local function run(path)
  local ok, chunk, problem = pcall(loadfile, path) -- Wireshark's raises where plain Lua returns nil
  if ok and not chunk then return problem, false end
  local result = chunk
  if ok then ok, result = pcall(chunk) end
  return result, ok
end

-- The list of a file; nil and why there is none.
local function read(path)
  local file, problem, code = io.open(path)
  if not file then
    -- The system's own words have the path in front, and are the user's language; "not found" is ours.
    return nil, code == DENIED and "cannot be read: " .. problem or "not found"
  end
  file:close()
  local entries, ran = run(path)
  if not ran then return nil, "the catalogue cannot be read: " .. tostring(entries):sub(1, 500) end
  return catalogue.check_list(entries)
end

-- Appends the entries of a file, each with its number there; one with the name of an entry of an earlier file takes its
-- place.
local function merge(all, entries, path)
  local places = {}
  for i, entry in ipairs(all.entries) do
    if type(entry) == "table" and type(entry.name) == "string" then places[entry.name] = i end
  end
  for i = 1, #entries do
    local entry = entries[i]
    local place = type(entry) == "table" and places[entry.name]
    place = place or #all.entries + 1
    all.entries[place], all.files[place], all.numbers[place] = entry or false, path, i
  end
end

-- All lists as one, compiled.
local function compile(lists)
  local all = { entries = {}, files = {}, numbers = {} }
  for _, list in ipairs(lists) do merge(all, list.entries, list.path) end
  local compiled, problems = catalogue.compile(all.entries, all.files, all.numbers)
  for i, text in ipairs(problems) do problems[i] = text .. "; this message is shown as bytes" end
  return compiled, problems
end

-- The lists that can be compiled: metatables in them may raise, and one file must not take the others along.
local function harmless(lists, problems)
  local good = {}
  for _, list in ipairs(lists) do
    local ok, problem = pcall(compile, { list })
    if ok then
      good[#good + 1] = list
    else
      check.append(problems, { ("%s: the catalogue cannot be read: %s; its messages are shown as bytes")
        :format(list.path, tostring(problem):sub(1, 500)) })
    end
  end
  return good
end

--- Reads the files of the catalogue and compiles them as one.
-- files    list of { path =, optional = whether it is no error that it is not there }, in order: a message of a later
--          file with the name of one of an earlier takes its place
-- returns  the compiled catalogue and a list of texts, each with the file, the message and the field that is wrong, see
--          message.catalogue.compile.  Never raises.
function M.load(files)
  local lists, problems = {}, {}
  for _, file in ipairs(files) do
    local ok, entries, problem = pcall(read, file.path)
    if not ok then entries, problem = nil, "the catalogue cannot be read: " .. tostring(entries):sub(1, 500) end
    if entries then
      lists[#lists + 1] = { entries = entries, path = file.path }
    elseif not (file.optional and problem == "not found") then
      problems[#problems + 1] = ("%s: %s; its messages are shown as bytes"):format(file.path, problem)
    end
  end
  local ok, compiled, found = pcall(compile, lists)
  if not ok then ok, compiled, found = pcall(compile, harmless(lists, problems)) end
  if not ok then compiled, found = catalogue.compile {} end
  check.append(problems, found)
  return compiled, problems
end

--- The value of a preference in a file of Wireshark's preferences, nil where it has none.
-- The API tells no preference while a plugin loads, and fields can be registered at no other time.
function M.preference(path, name)
  local file = io.open(path)
  if not file then return nil end
  local text = "\n" .. (file:read("*a") or "") .. "\n"
  file:close()
  local _, at = text:find(("\n%s:"):format(name), 1, true)
  local value = at and text:match("^[ \t]*([^\r\n]-)[ \t\r]*\n", at + 1)
  return value ~= "" and value or nil
end

return M
