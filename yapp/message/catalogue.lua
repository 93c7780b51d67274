-- SPDX-License-Identifier: GPL-2.0-or-later
-- The catalogue compiler: checks the lists of messages once, at load, and prepares decoding.
-- Pure Lua.

local input = require "yapp.base.input"
local field_kinds = require "yapp.message.field_kinds"
local fields = require "yapp.message.catalogue_fields"
local later = require "yapp.base.later"
local text_of = require "yapp.message.text"
local decode = later "yapp.message.decode"

local demand, shown = input.demand, input.shown

-- Bytes of a message's title: Wireshark aborts at a preference with a longer one.
local MAX_TITLE = 200

local M = {}

local DERIVED_OPTIONS = input.set("unit")
local OPTIONS = input.set("name title section id size min_size info info_rest every answers " ..
  "differences derived")

-- Filters ----------------------------------------------------------------------------------------

-- Return the description of a field, a flag or a generated value.
local function describe(of_type, one)
  local text = one.title
  if one.unit then text = text .. " in " .. one.unit end
  if one.min then text = ("%s, %.10g to %.10g"):format(text, one.min, one.max) end
  text = text .. ", of " .. of_type.title
  if one.section then text = ('%s (section "%s")'):format(text, one.section) end
  return text
end

-- Digits behind the point in a column, by unit.
local DIGITS = { RPM = 0, V = 2, A = 2, W = 0, ["°C"] = 0, ["%"] = 0 }

-- Add the filters of a field's flags.
local function add_flags(of_type, field, add, about)
  local title, group = field.title, field.group
  add(group .. ".undefined", "UINT32", "Undefined bits", "Bits that nothing defines: " .. about,
    "HEX")
  for _, flag in ipairs(field.flags) do
    local one = { title = flag.title .. ", one of " .. title, section = field.section }
    local text = describe(of_type, one)
    if flag.help then text = text .. ". " .. flag.help end
    add(flag.filter, "BOOLEAN", flag.title, text, field.size * 8, nil, flag.mask)
  end
  if #field.flags == 0 then return end
  add(field.filter .. ".names", "STRING", title, "Names of the bits that are set: " .. about)
  for way, verb in pairs { raised = "rose", cleared = "fell" } do
    add(group .. "." .. way, "UINT" .. 8 * field.size, title .. " " .. way,
      ("Bits that %s since the source's previous good message: %s"):format(verb, about), "HEX")
  end
end

-- Add the filters of a field.
local function add_field(of_type, field, add)
  local title, about = field.title, describe(of_type, field)
  local kind, base = field_kinds.BY_NAME[field.kind].filter(field)
  if field.kind == "flags" then
    add_flags(of_type, field, add, about)
  elseif field.special then
    local why = "Why there is no number, a reserved count, NaN or infinity: " .. about
    add(field.special, "UINT8", title, why, nil, field_kinds.SPECIALS)
  end
  local mask = kind:find("^UINT") and field.mask or nil
  add(field.filter, kind, title, about, base, field.values, mask)
end

-- Add the filters of a message's state, by the names of message.history.
local function add_state(of_type, add)
  -- Prefer a field of nothing but faults: so filters keep their names if a flag of another field
  -- becomes a fault.
  local fault, states = of_type.fault_field or of_type.alarms[1], of_type.states
  if of_type.time then
    states.drift = add(of_type.filter .. ".clock_drift", "RELATIVE_TIME", "Clock drift",
      "Controller's clock less the capture's since the source's first message or reboot")
  end
  if of_type.answers then
    local command = of_type.answers:gsub("^%l", string.upper):gsub("_", " ")
    states.command_in = add(("%s.%s_in"):format(of_type.filter, of_type.answers), "FRAMENUM",
      ("Latest %s in"):format(command),
      ("The latest %s on this bus before the message"):format(command), nil, "REQUEST")
  end
  if not fault then return end
  of_type.fault_names = add(fault.group .. ".active_names", "STRING", "Faults",
    "Names of all fault flags that are set in a message")
  states.active_time = add(fault.group .. ".active_time", "RELATIVE_TIME",
    "Time since the oldest fault was raised",
    "Since the oldest fault that is still set was raised")
  for _, way in ipairs { "raised", "cleared" } do
    states[way .. "_in"] = add(("%s.%s_in"):format(fault.group, way), "FRAMENUM",
      ("%s: %s in"):format(fault.title, way),
      ("The message in which %s"):format(way == "raised" and
        "the first of the faults was raised" or "the last of the faults was cleared"))
  end
  for _, way in ipairs { "previous", "next" } do
    states[way .. "_change"] = add(("%s.%s_change"):format(fault.group, way), "FRAMENUM",
      ("%s: %s change in"):format(fault.title, way),
      ("The source's %s message that changes a fault"):format(way))
  end
end

-- Add the filters of values with as many digits as a column needs.
local function add_rounded(of_type, add)
  for _, list in ipairs { of_type.fields, of_type.generated } do
    for _, one in ipairs(list) do
      local digits = DIGITS[one.unit]
      if digits and one.shape and not one.array then
        table.insert(of_type.rounded, {
          filter = add(one.filter .. ".rounded", "DOUBLE", one.title,
            ("%s of %s, rounded for a column: not among a packet's details")
              :format(one.title, of_type.title)),
          field = one,
          shape = ("%%.%df"):format(digits),
        })
      end
    end
  end
end

-- Add all filters of a message.  Raise that a filter is there twice or is reserved.
local function add_filters(of_type, reserved, context)
  local taken, filters = {}, {}
  local function add(filter, ...)
    demand(not (taken[filter] or reserved[filter]), "the filter name %s is taken", filter)
    taken[filter] = true
    table.insert(of_type.filters, { filter, ... })
    filters[#filters + 1] = filter
    return filter
  end
  add(of_type.filter, "NONE", of_type.title, "A whole message: " .. of_type.title)
  add_state(of_type, add)
  for _, item in ipairs(of_type.generated) do
    add(item.filter, "DOUBLE", item.title, describe(of_type, item))
  end
  for _, field in ipairs(of_type.fields) do
    local array = field.array or field -- its elements share the filters
    context.field, filters = field.name, {}
    if not array.filters then
      add_field(of_type, array, add)
      array.filters = filters
    end
    field.filters = array.filters
  end
  context.field = nil
  add_rounded(of_type, add)
end

-- Generated values -------------------------------------------------------------------------------

-- Return a field of numbers of a message.
-- what  the item that needs it: "derived dc_power"
local function number_field(of_type, what, name)
  local field = of_type.by_name[name]
  demand(field and field_kinds.is_number(field), "%s: %s is no field of numbers", what, shown(name))
  return field
end

-- Add a value that is worked out from two fields.
-- text     "field * field"
-- returns  the item of message.generated
local function add_generated(of_type, what, name, text, title, unit)
  local a, operator, b = tostring(text):match("^ *([%w_]+) *([*+-]) *([%w_]+) *$")
  demand(a, '%s: %s is not two fields with *, + or - between them: "voltage * current"', what,
    shown(text))
  local item = {
    name = name,
    title = title,
    unit = unit,
    filter = of_type.filter .. "." .. name,
    kind = "derived",
    shape = "%.7g",
    operator = operator,
    a = number_field(of_type, what, a),
    b = number_field(of_type, what, b),
  }
  table.insert(of_type.generated, item)
  return item
end

-- differences: { name, field, field, title }; derived: { name, "field * field", title, unit = }
local function add_all_generated(of_type, entry)
  for i, row in ipairs(entry.differences or {}) do
    local what, first = input.row(row, "difference", i, 4, {}), of_type.by_name[row[2] or false]
    local text = ("%s - %s"):format(row[2], row[3])
    local item = add_generated(of_type, what, row[1], text, row[4], first and first.unit)
    item.is_difference = true
  end
  for i, row in ipairs(entry.derived or {}) do
    local what = input.row(row, "derived", i, 3, DERIVED_OPTIONS)
    of_type.derived[i] = add_generated(of_type, what, row[1], row[2], row[3], row.unit)
  end
end

-- A message --------------------------------------------------------------------------------------

local function check_head(entry)
  local every, answers = entry.every, entry.answers
  demand(input.is_text(entry.title), "the title is missing")
  input.options(entry, "a message", OPTIONS, math.huge)
  demand(#entry.title <= MAX_TITLE, "the title has more than %d bytes", MAX_TITLE)
  input.within("id", entry.id, 0, input.MAX_ID)
  input.within("size", entry.size, 1, fields.MAX_SIZE)
  input.within("min_size", entry.min_size or entry.size, 1, entry.size)
  demand(not every or input.is_finite(every) and every > 0,
    "every %s is not a period in seconds", shown(every))
  demand(not answers or input.is_name(answers), "answers %s is not the name of a message",
    shown(answers))
end

-- context  the subject of errors: context.field is set to the name of the current field, or nil
local function compile_message(entry, reserved, context)
  check_head(entry)
  local of_type = {
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
    flag_fields = {},
    alarms = {},
    generated = {},
    derived = {},
    rounded = {},
    states = {},
    filters = {},
  }
  local size = fields.compile(of_type, entry, context)
  demand(size == entry.size, "size is %d, but the fields add up to %d bytes", entry.size, size)
  function of_type.read(payload)
    of_type.read = decode.new_reader(of_type) -- now: most captures have no YAPP
    return of_type.read(payload)
  end
  of_type.info = text_of.compile_info(of_type, entry.info or "")
  of_type.info_rest = text_of.compile_info(of_type, entry.info_rest or entry.info or "")
  add_all_generated(of_type, entry)
  add_filters(of_type, reserved, context)
  return of_type
end

-- All messages -----------------------------------------------------------------------------------

local function add_message(catalogue, entry, reserved, context)
  demand(type(entry) == "table", "a message is a table, not %s", shown(entry))
  local name = entry.name
  demand(input.is_name(name), "name %s is not a filter name (a-z, 0-9, _)", shown(name))
  context.message = name
  demand(not catalogue.names[name], "the name is there twice")
  catalogue.names[name] = true
  local of_type = compile_message(entry, reserved, context)
  local other = catalogue.by_id[of_type.id]
  demand(not other, "id 0x%X is that of message %s", of_type.id, other and other.name)
  catalogue.messages[#catalogue.messages + 1] = of_type
  catalogue.by_id[of_type.id] = of_type
end

--- Check a catalogue and compile it.
-- entries   the list of messages in taurus_fields.lua, described there
-- origins   optional list: { file, number in it } of each entry; a text about it begins with that
-- reserved  optional { [filter name] = true } that no message may use
-- returns   { messages = list, by_id = { [id] = message } } of the messages without a mistake, and
--           a list of texts, one for each other message: which field is wrong and why
-- A compiled message has
--   name, title, id, filter ("taurus.motor"); section of a document, every (period in seconds) and
--   answers (a message's name), or nil
--   size, min_size (bytes: a shorter payload is not this message)
--   fields, by_name, time (its first field of kind time)
--   flag_fields (its fields of flags), alarms (those with a fault flag), fault_field (the first one
--   whose flags are all faults)
--   generated: a list of the values that are worked out from two fields: { name, title, filter,
--   unit, kind = "derived", shape, operator ("*", "-", "+"), a and b (the fields), is_difference }
--   derived: those of them that are columns of CSV, too
--   rounded: a list of the values for columns, { filter, field (or one of generated), shape }
--   filters: a list of { filter, type, title, description, base, values, mask }, see show.fields
--   states: the filters of its state, { [its name in message.history] = filter }
--   fault_names: the filter of the names of all faults that are set, nil without fault flags
--   read (see decode.new_reader), info and, beside columns, info_rest (see text.compile_info)
-- A field has name, title, filter, filters (a list of it and those below it), index (in fields),
-- offset, size in bytes, type, unit and section or nil, shape (a format with as many digits as its
-- count can carry; nil for ieee and integers), and kind, with the values that its kind needs:
--   uint, int  bottom, top; values, invalid, cases (a set); mask, low, inside: a part of the bits
--              of another field
--   scaled     the same, and scale, zero: value = count * scale + zero
--   flags      flags { name, mask, title, filter, help or nil }, group, undefined and watched
--              (masks: bits that nothing defines; bits outside of parts, whose changes are
--              reported), alarm_bits (mask: bits that are faults), fault_word (in Info, before
--              their names)
--   float      compressed: min, max, top, ordinary (the highest count that is not reserved)
--   ieee, bool, string, bytes, time
-- An element of an array has array, the common part of the elements; a field in a case of
-- variants has when = { index, value }.
function M.compile(entries, origins, reserved)
  local catalogue, problems = { messages = {}, by_id = {}, names = {} }, {}
  for i = 1, #entries do
    local origin = origins and origins[i] or {}
    local context = { message = origin.number or i }
    local ok, problem = pcall(add_message, catalogue, entries[i], reserved or {}, context)
    if not ok then
      local file = origin.file and origin.file .. ": " or ""
      local field = context.field and ", field " .. context.field or ""
      problems[#problems + 1] =
        ("%smessage %s%s: %s"):format(file, context.message, field, tostring(problem))
    end
  end
  return catalogue, problems
end

--- Return those of a list of messages that may have a payload of this size, in bytes.
function M.of_size(messages, size)
  local list = {}
  for _, of_type in ipairs(messages) do
    if size >= of_type.min_size and size <= of_type.size then list[#list + 1] = of_type end
  end
  return list
end

--- Assign a message to each ID.
-- catalogue  compiled
-- ids        { [message name] = list of IDs }, the user's choice
-- returns    { [id] = message }, and a list of texts for IDs that two messages claim: the first
--            keeps it
function M.assign(catalogue, ids)
  local by_id, problems = {}, {}
  for _, of_type in ipairs(catalogue.messages) do
    for _, id in ipairs(ids[of_type.name] or { of_type.id }) do
      local other = by_id[id] or of_type
      by_id[id] = other
      if other ~= of_type then
        problems[#problems + 1] = ("ID 0x%X is given to %s and to %s: it stays with %s")
          :format(id, other.title, of_type.title, other.title)
      end
    end
  end
  return by_id, input.first_of(problems)
end

return M
