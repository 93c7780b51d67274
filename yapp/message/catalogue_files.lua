-- SPDX-License-Identifier: GPL-2.0-or-later
-- The files of the catalogue: the plugin's own messages, and those of the user, which come after
-- and may replace
-- them.  Pure Lua.

local catalogue = require("yapp.message.catalogue")
local check = require("yapp.message.check")

local M = {}

local DENIED = 13 -- EACCES
local MOST_BYTES = 500 -- of an error of the file's own

local function run(path)
  return assert(loadfile(path))()
end

-- The list of a file; nil and why there is none.
local function read(path)
  local file, problem, code = io.open(path)
  if not file then
    -- The system's own words have the path in front, and are the user's language; "not found" is
    -- ours.
    return nil, code == DENIED and "cannot be read: " .. problem or "not found"
  end
  file:close()
  local ok, entries = pcall(run, path)
  if not ok then
    return nil, "the catalogue cannot be read: " .. tostring(entries):sub(1, MOST_BYTES)
  end
  if type(entries) ~= "table" then
    return nil, "the file must return a list of messages, not " .. check.shown(entries)
  end
  if entries.name ~= nil then
    return nil, "the file must return a list of messages, { { name = ... } }, not one"
  end
  return entries
end

local function name_of(entry)
  return type(entry) == "table" and entry.name or nil
end

-- Appends the entries of a file, each with its number there; one with the name of an entry of an
-- earlier file takes its place.
local function merge(all, entries, path)
  local places = {}
  for i, entry in ipairs(all.entries) do
    places[name_of(entry) or false] = i
  end
  places[false] = nil
  for i, entry in ipairs(entries) do
    local place = places[name_of(entry) or false] or #all.entries + 1
    all.entries[place] = entry
    all.files[place] = path
    all.numbers[place] = i
  end
end

--- Reads the files of the catalogue and compiles them as one.
-- files    list of { path =, optional = whether it is no error that it is not there }, in order: a
--          message of a later file with the name of one of an earlier takes its place
-- returns  the compiled catalogue and a list of texts, each with the file, the message and the
--          field that is wrong, see message.catalogue.compile
function M.load(files)
  local all, problems = { entries = {}, files = {}, numbers = {} }, {}
  for _, file in ipairs(files) do
    local entries, problem = read(file.path)
    if entries then
      merge(all, entries, file.path)
    elseif not (file.optional and problem == "not found") then
      problem = problem .. "; its messages are shown as bytes"
      problems[#problems + 1] = file.path .. ": " .. problem
    end
  end
  local compiled, found = catalogue.compile(all.entries, all.files, all.numbers)
  for _, text in ipairs(found) do
    problems[#problems + 1] = text .. "; this message is shown as bytes"
  end
  return compiled, check.few(problems)
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
