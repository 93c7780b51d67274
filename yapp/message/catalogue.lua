-- SPDX-License-Identifier: GPL-2.0-or-later
-- The catalogue compiler: checks the lists of messages once, at load, and works out what decoding
-- needs.  Pure Lua.

local check = require("yapp.message.check")
local fields = require("yapp.message.catalogue_fields")
local decode = require("yapp.message.decode")
local info = require("yapp.message.info")

local demand, shown = check.demand, check.shown
local is_name, is_text = check.is_name, check.is_text

-- Bytes of a message's title: over a preference with a longer one Wireshark ends at once.
local MOST_OF_TITLE = 200

local M = {}

M.MAX_ID = 2047
local MAX_SIZE = 65535
local DERIVED_OPTIONS = check.set("unit")
local OPTIONS =
  check.set("name title section id size min_size info every answers differences derived")

-- The filter names of expert items.
local EXPERTS = {
  "fault.active",
  "fault.raised",
  "fault.cleared",
  "command.key.invalid",
  "value.special",
  "value.invalid",
  "flags.undefined",
  "reboot",
  "stale",
}

-- Filter names -----------------------------------------------------------------------------------

-- What a flags field has below its group.
local BELOW = {
  "undefined",
  "raised",
  "cleared",
  "active_time",
  "previous_change",
  "next_change",
}

-- The names under a field that follow from it.
local function filters_of(field)
  local names = { field.filter, field.special }
  if not field.flags then return names end
  names[2] = field.filter .. ".names"
  for _, name in ipairs(BELOW) do names[#names + 1] = field.group .. "." .. name end
  for _, flag in ipairs(field.flags) do names[#names + 1] = flag.filter end
  return names
end

local function claim(taken, name)
  demand(not taken[name], "the filter name %s is taken", name)
  taken[name] = true
end

-- Raises which filter name of a message is there twice, or an expert item's.
local function claim_filters(message, place)
  local taken = {}
  for _, name in ipairs(EXPERTS) do taken["taurus." .. name] = true end
  claim(taken, message.filter)
  if message.time then claim(taken, message.filter .. ".clock_drift") end
  if message.answers then claim(taken, ("%s.%s_in"):format(message.filter, message.answers)) end
  for _, item in ipairs(message.generated) do claim(taken, item.filter) end
  for _, field in ipairs(message.fields) do
    place.field = field.name
    if not field.element or field.element == 1 then
      for _, name in ipairs(filters_of(field)) do claim(taken, name) end
    end
  end
end

-- A message --------------------------------------------------------------------------------------

-- Generated values -------------------------------------------------------------------------------

-- The index of a field of numbers in its message.
-- what  the item that needs it: "derived dc_power"
local function number_index(message, what, name)
  local field = message.by_name[name]
  local is_number = field and (field.special or
    (field.kind == "uint" or field.kind == "int") and not field.values)
  demand(is_number, "%s: %s is no field of numbers", what, shown(name))
  return message.index[field]
end

-- A value that is worked out from two fields: a, operator, b.
local function add_generated(message, what, item, a, b)
  item.kind = "derived"
  item.filter = message.filter .. "." .. item.name
  item.a, item.b = number_index(message, what, a), number_index(message, what, b)
  item.description = fields.describe(item.title, item.unit, message)
  message.generated[#message.generated + 1] = item
end

-- { name, field, field, title }: the first field less the second.
local function add_difference(message, row, i)
  local what = check.row(row, "difference", i, 4, {})
  local item = { name = row[1], title = row[4], operator = "-" }
  local first = message.by_name[row[2] or false]
  item.unit = first and first.unit
  add_generated(message, what, item, row[2], row[3])
end

-- { name, "field * field", title, unit = }
local function add_derived(message, row, i)
  local what = check.row(row, "derived", i, 3, DERIVED_OPTIONS)
  local a, operator, b = tostring(row[2]):match("^ *([%w_]+) *([*+-]) *([%w_]+) *$")
  demand(a, '%s: %s is not two fields with *, + or - between them: "voltage * current"', what,
    shown(row[2]))
  local item = { name = row[1], title = row[3], unit = row.unit, operator = operator }
  add_generated(message, what, item, a, b)
  message.derived[i] = item
end

local function check_head(entry)
  local every, answers = entry.every, entry.answers
  demand(is_text(entry.title), "the title is missing")
  check.options(entry, "a message", OPTIONS, math.huge)
  demand(#entry.title <= MOST_OF_TITLE, "the title has more than %d bytes", MOST_OF_TITLE)
  check.within("id", entry.id, 0, M.MAX_ID)
  check.within("size", entry.size, 1, MAX_SIZE)
  check.within("min_size", entry.min_size or entry.size, 1, entry.size)
  local is_period = not every or check.is_finite(every) and every > 0
  demand(is_period, "every %s is not a period in seconds", shown(every))
  local is_message = not answers or is_name(answers)
  demand(is_message, "answers %s is not the name of a message", shown(answers))
  demand(#entry > 0, "it has no fields")
end

-- place  gets field = the name of the one that is looked at, nil for none: what an error is about
local function compile_message(entry, place)
  check_head(entry)
  local message = {
    name = entry.name,
    title = entry.title,
    section = entry.section,
    id = entry.id,
    size = entry.size,
    min_size = entry.min_size or entry.size,
    every = entry.every,
    answers = entry.answers,
    filter = "taurus." .. entry.name,
    fields = {},
    by_name = {},
    index = {},
    alarms = {},
    generated = {},
    derived = {},
  }
  local size = fields.compile(message, entry, place)
  demand(size == entry.size, "size is %d, but the fields add up to %d bytes", entry.size, size)
  for _, field in ipairs(message.fields) do
    local is_whole = message.min_size <= field.offset or
      message.min_size >= field.offset + field.size
    demand(is_whole, "min_size %d lies inside the field %s", message.min_size, field.name)
  end
  message.read = decode.new_reader(message)
  message.write_info = info.compile(message, entry.info or "")
  for i, row in ipairs(entry.differences or {}) do add_difference(message, row, i) end
  for i, row in ipairs(entry.derived or {}) do add_derived(message, row, i) end
  claim_filters(message, place)
  return message
end

-- All messages -----------------------------------------------------------------------------------

local function add_message(catalogue, entry, place)
  demand(type(entry) == "table", "a message is a table, not %s", shown(entry))
  demand(is_name(entry.name), "name %s is not a filter name (a-z, 0-9, _)", shown(entry.name))
  place.message = entry.name
  demand(not catalogue.names[entry.name], "the name is there twice")
  catalogue.names[entry.name] = true
  local message = compile_message(entry, place)
  place.field = nil
  local other = catalogue.by_id[message.id]
  demand(not other, "id 0x%X is that of message %s", message.id, other and other.name)
  catalogue.messages[#catalogue.messages + 1] = message
  catalogue.by_id[message.id] = message
end

--- Checks a catalogue and compiles it.
-- entries  what taurus_fields.lua returns: a list of messages, described there
-- files    optional list: the file that each entry is from; a text about it begins with that
-- numbers  optional list: the number of each entry in its file
-- returns  { messages = list, by_id = { [id] = message } } of the messages without a fault, and a
--          list of texts, each saying which message and field is wrong and why, one for a message;
--          empty when all is well
-- A compiled message has
--   name, title, id, size, filter ("taurus.motor"), section of a document, every (period in
--   seconds) and answers (a message's name), or nil
--   fields, by_name, index ([field] = its place in fields), alarms (its fields with alarm bits),
--   alarm (the first of them that has nothing else), time (its first field of kind time), or nil
--   min_size (bytes: a shorter payload is not this message; size where the entry has none)
--   generated { name, title, filter, unit, description, kind = "derived", operator ("*", "-" or
--   "+"), a, b (indexes of fields) }: values worked out from two fields, see decode.derived
--   derived: those of them that tables and statistics have, too
--   read (message.straight), info and usual (message.info)
-- A field has name, title, filter, offset, size in bytes, type, unit and section or nil,
-- description (what a person reads of it beyond its title), and kind, with what its kind needs:
--   uint, int  bottom, top; values, invalid, cases (a set); scale and zero: value = count * scale +
--              zero; mask, low, inside: a part of the bits of another field
--   flags      flags { name, mask, title, filter, help or nil, description }, group, undefined and
--              watched (masks: bits that nobody defines; bits of no part, which rise and fall),
--              alarm_bits (mask: bits that are faults), alarm (the word before their names, nil
--              where none is one)
--   float      compressed: min, max, top, ordinary (the highest count that is no reserved one)
--   ieee, bool, string, bytes, time
-- and, where it is one of an array, element (1 ..) and array_title; in a case of variants, when = {
-- index, value }.
function M.compile(entries, files, numbers)
  local catalogue, problems = { messages = {}, by_id = {}, names = {} }, {}
  for i = 1, #entries do
    local place = { message = numbers and numbers[i] or i }
    local ok, problem = pcall(add_message, catalogue, entries[i], place)
    if not ok then
      local file = files and files[i] .. ": " or ""
      local field = place.field and ", field " .. place.field or ""
      problem = tostring(problem)
      problems[#problems + 1] = ("%smessage %s%s: %s"):format(file, place.message, field, problem)
    end
  end
  return catalogue, problems
end

--- Which message each ID carries.
-- catalogue  compiled
-- ids        { [message name] = list of IDs }, the user's choice
-- returns    { [id] = message }, and a list of texts for IDs that two messages claim: the first
--            keeps it
function M.assign(catalogue, ids)
  local by_id, problems = {}, {}
  for _, message in ipairs(catalogue.messages) do
    for _, id in ipairs(ids[message.name] or { message.id }) do
      local other = by_id[id] or message
      by_id[id] = other
      if other ~= message then
        problems[#problems + 1] = ("ID 0x%X is given to %s and to %s: it stays with %s")
          :format(id, other.title, message.title, other.title)
      end
    end
  end
  return by_id, check.few(problems)
end

return M
