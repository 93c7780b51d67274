-- SPDX-License-Identifier: GPL-2.0-or-later
-- The catalogue compiler: checks the lists of messages once, at load, and works out what decoding needs.
-- Pure Lua, 5.2 and 5.4.

local check = require("yapp.message.catalogue_check")
local info = require("yapp.message.catalogue_info")
local rows = require("yapp.message.catalogue_rows")
local types = require("yapp.message.catalogue_types")

local shown, is_integer, is_name, is_text = check.shown, check.is_integer, check.is_name, check.is_text

local M = {}

M.MAX_ID = 2047
local MAX_SIZE = 65535
local MAX_ITEMS = 50000 -- fields, values and flags of all messages; each costs Wireshark time and memory
local MAX_PERIOD = 1e6

-- The filter names of expert items.
local EXPERTS = {
  ["taurus.fault.active"] = true, ["taurus.command.key.invalid"] = true, ["taurus.value.special"] = true,
  ["taurus.value.invalid"] = true, ["taurus.flags.undefined"] = true, ["taurus.fault.raised"] = true,
  ["taurus.fault.cleared"] = true, ["taurus.reboot"] = true, ["taurus.stale"] = true,
}

-- Filter names ------------------------------------------------------------------------------------------------------

-- The names under a field that follow from it.
local function filters_of(field)
  local names = { field.filter }
  if field.kind == "float" or field.kind == "ieee" then names[2] = field.filter .. ".special" end
  if field.kind ~= "flags" then return names end
  names[#names + 1], names[#names + 2] = field.group .. ".undefined", field.filter .. ".names"
  if #field.flags == 0 then return names end
  names[#names + 1], names[#names + 2] = field.group .. ".raised", field.group .. ".cleared"
  for _, flag in ipairs(field.flags) do names[#names + 1] = flag.filter end
  if field.alarm then
    for _, name in ipairs { "active_time", "previous_change", "next_change" } do
      names[#names + 1] = field.group .. "." .. name
    end
  end
  return names
end

-- The first name that another has; else all of them are taken.
local function claim(taken, names, complain)
  for _, name in ipairs(names) do
    if EXPERTS[name] or taken[name] then return complain("the filter name %s is taken", name) end
  end
  for _, name in ipairs(names) do taken[name] = true end
end

local function claim_filters(message, where, problems)
  local taken = {}
  local own = { message.filter }
  if message.time then own[#own + 1] = message.filter .. ".clock_drift" end
  if message.answers then own[#own + 1] = ("%s.%s_in"):format(message.filter, message.answers) end
  for _, difference in ipairs(message.differences) do own[#own + 1] = difference.filter end
  claim(taken, own, check.complainer(where, problems))
  for _, field in ipairs(message.fields) do
    if not field.element or field.element == 1 then
      claim(taken, filters_of(field), check.complainer(where .. ", field " .. field.name, problems))
    end
  end
end

-- A message ---------------------------------------------------------------------------------------------------------

local function is_number(field)
  return field and (info.is_real(field) or (field.kind == "uint" or field.kind == "int") and not field.values)
end

local function compile_difference(message, row, complain)
  if type(row) ~= "table" then return complain("a difference is { name, a, b, title }, not %s", shown(row)) end
  if not is_name(row[1]) then return complain("difference %s is not a filter name (a-z, 0-9, _)", shown(row[1])) end
  for i = 2, 3 do
    local field = type(row[i]) == "string" and message.by_name[row[i]]
    if not is_number(field) then return complain("difference %s: %s is no field of numbers", row[1], shown(row[i])) end
  end
  if not is_text(row[4]) then return complain("difference %s has no title", row[1]) end
  check.check_options(row, "difference " .. row[1], {}, complain, 4)
  local a, b = message.by_name[row[2]], message.by_name[row[3]]
  return { name = row[1], title = row[4], filter = message.filter .. "." .. row[1], unit = a.unit,
    a = message.index[a], b = message.index[b] }
end

local function compile_differences(message, list, complain)
  if list == nil then return end
  if type(list) ~= "table" or #list > rows.MAX_ROWS then return complain("differences must be a list") end
  for i = 1, #list do
    message.differences[#message.differences + 1] = compile_difference(message, list[i], complain)
  end
end

local function is_size(v) return is_integer(v) and v >= 1 and v <= MAX_SIZE end

local function check_head(entry, complain)
  check.check_options(entry, "a message", types.MESSAGE_OPTIONS, complain)
  if not is_text(entry.title) then complain("the title is missing") end
  if not is_integer(entry.id) or entry.id < 0 or entry.id > M.MAX_ID then
    complain("id %s is not one of 0 .. %d", shown(entry.id), M.MAX_ID)
  end
  if not is_size(entry.size) then
    complain("size %s is not one of 1 .. %d", shown(entry.size), MAX_SIZE)
  end
  if entry.every ~= nil and not (check.is_finite(entry.every) and entry.every > 0 and entry.every <= MAX_PERIOD) then
    complain("every %s is not a period in seconds", shown(entry.every))
  end
  if entry.answers ~= nil and not is_name(entry.answers) then
    complain("answers %s is not the name of a message", shown(entry.answers))
  end
  if #entry == 0 then complain("it has no fields") end
end

-- What depends on the fields is looked at when nothing is wrong with them: one mistake, one message.
local function compile_message(entry, where, problems)
  local complain = check.complainer(where, problems)
  local message = { name = entry.name, title = entry.title, id = entry.id, size = entry.size, every = entry.every,
    answers = entry.answers, filter = "taurus." .. entry.name, fields = {}, by_name = {}, index = {}, alarms = {},
    differences = {} }
  check_head(entry, complain)
  local before = #problems
  local size = rows.compile(message, entry, where, problems)
  if #problems > before then return end
  if is_size(entry.size) and size ~= entry.size and #entry > 0 then
    complain("size is %d, but the fields add up to %d byte%s", entry.size, size, size == 1 and "" or "s")
  end
  if is_text(message.title) then info.compile(message, entry.info == nil and "" or entry.info, complain) end
  compile_differences(message, entry.differences, complain)
  claim_filters(message, where, problems)
  return message
end

-- Compiles a message into the catalogue; found gets what is wrong with it, and then it stays out.
local function add_message(catalogue, entry, names, found)
  local where = "message " .. entry.name
  local complain = check.complainer(where, found)
  if names[entry.name] then return complain("the name is there twice") end
  names[entry.name] = true
  local message = compile_message(entry, where, found)
  local other = message and catalogue.by_id[message.id]
  if other then complain("id 0x%X is that of message %s", message.id, other.name) end
  if #found > 0 then return end
  catalogue.messages[#catalogue.messages + 1] = message
  catalogue.by_id[message.id] = message
end

-- All messages ------------------------------------------------------------------------------------------------------

local function count_keys(t, most)
  local count, key = 0, nil
  if type(t) == "table" then key = next(t) end
  while key ~= nil and count <= most do count, key = count + 1, next(t, key) end
  return count
end

-- The number of fields, values and flags of rows; counts no further than it must to know that it is above most.
local function items(list, most, depth)
  local count = 0
  for i = 1, type(list) == "table" and math.min(#list, rows.MAX_ROWS) or 0 do
    local row = list[i]
    count = count + 1
    if type(row) == "table" then
      count = count + math.min(count_keys(row.flags, 32), 32) + count_keys(row.values, rows.MAX_ROWS)
      if is_integer(row.count) then count = count + math.min(math.max(row.count, 0), rows.MAX_ROWS) end
      if depth > 0 then count = count + items(row.bits, most - count, depth - 1) end
      local key, case = nil, nil
      if depth > 0 and type(row.cases) == "table" then key, case = next(row.cases) end
      while key ~= nil and count <= most do
        count = count + 1 + items(case, most - count, depth - 1)
        key, case = next(row.cases, key)
      end
    end
    if count > most then break end
  end
  return count
end

-- One entry of the list, number i of its file: found gets what is wrong with it, and it is added if nothing is.
local function add_entry(catalogue, entry, i, state)
  local complain = check.complainer("message " .. i, state.found)
  if type(entry) ~= "table" then return complain("a message is a table, not %s", shown(entry)) end
  if not is_name(entry.name) then return complain("name %s is not a filter name (a-z, 0-9, _)", shown(entry.name)) end
  state.left = state.left - items(entry, state.left, 2)
  if state.left < 0 then
    return check.complainer("message " .. entry.name, state.found)(
      "with it the catalogue has more than %d fields, values and flags: it ends here", MAX_ITEMS)
  end
  add_message(catalogue, entry, state.names, state.found)
end

--- A list of messages itself; nil and what is wrong with it as a whole.  The messages are not looked at.
function M.check_list(entries)
  if type(entries) ~= "table" then return nil, "the file must return a list of messages, not " .. shown(entries) end
  if entries.name ~= nil then return nil, "the file must return a list of messages, { { name = ... } }, not one" end
  if #entries > M.MAX_ID + 1 then
    return nil, string.format("%d messages, but there are only %d IDs", #entries, M.MAX_ID + 1)
  end
  return entries
end

--- Checks a catalogue and compiles it.
-- entries  what taurus_fields.lua returns: a list of messages, described there
-- files    optional list: the file that each entry is from; texts about it begin with that
-- numbers  optional list: the number of each entry in its file
-- returns  { messages = list, by_id = { [id] = message } } of the messages without a fault, and a list of texts,
--          each saying which message and field is wrong and why; empty when all is well.  Raises only what the entries'
--          own metatables raise.
-- A compiled message has
--   name, title, id, size, filter ("taurus.motor"), every (period in seconds) and answers (a message's name), or nil
--   fields, by_name, index ([field] = its place in fields), alarms, time (its first field of kind time, or nil)
--   info, info_fields, info_format (message.catalogue_info), differences { name, title, filter, unit, a, b (places) }
-- A field has name, title, filter, offset, size in bytes, type, unit or nil, and kind, with what its kind needs:
--   uint, int  bottom, top; values, invalid, cases (a set); scale and zero: value = count * scale + zero;
--              mask, low, inside: a part of the bits of another field
--   flags      flags { name, mask, title, filter }, group, alarm, undefined and watched (masks)
--   float      compressed: min, max, top, ordinary (the highest count that is no reserved one)
--   ieee, bool, string, bytes, time
-- and, where it is one of an array, element (1 ..) and array_title; in a case of variants, when = { index, value }.
function M.compile(entries, files, numbers)
  local catalogue, problems = { messages = {}, by_id = {} }, {}
  local list, problem = M.check_list(entries)
  if not list then return catalogue, { problem } end
  local state = { names = {}, left = MAX_ITEMS, found = {} }
  for i = 1, #entries do
    state.found = {}
    add_entry(catalogue, entries[i], numbers and numbers[i] or i, state)
    check.append(problems, state.found, files and files[i] .. ": ")
    if state.left < 0 then break end
  end
  return catalogue, problems
end

--- Which message each ID carries.
-- catalogue  compiled
-- ids        { [message name] = list of IDs }, the user's choice
-- returns    { [id] = message }, and a list of texts for IDs that two messages claim: the first keeps it
function M.assign(catalogue, ids)
  local by_id, claims = {}, {}
  for _, message in ipairs(catalogue.messages) do
    for _, id in ipairs(ids[message.name] or { message.id }) do
      local other = by_id[id]
      if other and other ~= message then
        claims[#claims + 1] = string.format("ID 0x%X is given to %s and to %s: it stays with %s", id, other.title,
          message.title, other.title)
      else
        by_id[id] = message
      end
    end
  end
  local problems = {}
  check.append(problems, claims)
  if #claims > #problems then problems[#problems + 1] = ("and so on: %d IDs in all"):format(#claims) end
  return by_id, problems
end

return M
