-- SPDX-License-Identifier: GPL-2.0-or-later
-- The catalogue compiler: reads the files that describe messages, checks them once, at load, and
-- prepares decoding.  docs/catalogue.md names all options and types.  Pure Lua.
--
-- A compiled message type has
--   name, title, id, filter ("taurus.motor"); section of a document, every (period in seconds) and
--   answers (a message's name), or nil
--   enables (its field that turns a motor on and off) and speed (its field with a motor's), or nil
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
--   read (see message.decode), info and, beside columns, info_rest (see message.text)
-- A field has name, title, filter, filters (a list of it and those below it), index (in fields),
-- offset, size in bytes, type, unit and section or nil, shape (a format with as many digits as its
-- count can carry; nil for ieee and integers), and kind, with the values that its kind needs:
--   uint, int  bottom, top (lowest and highest count); values, invalid (its expert item)
--   scaled     the same, and scale, zero: value = count * scale + zero
--   flags      flags { name, mask, title, filter, help or nil }, group, undefined (mask: bits that
--              nothing defines), alarm_bits (mask: bits that are faults), fault_word (in Info,
--              before their names)
--   float      compressed: min, max, top, ordinary (the highest count that is not reserved), number
--              (function(raw) -> value)
--   ieee, bool, string, bytes, time

local band = require "yapp.base.bits".band
local decode = require "yapp.message.decode"
local field_kinds = require "yapp.message.field_kinds"
local filters = require "yapp.message.filters"
local input = require "yapp.base.input"
local text_of = require "yapp.message.text"

local demand, shown, set = input.demand, input.shown, input.set
local is_text = input.is_text

local M = {}

local MAX_SIZE = 65535 -- bytes of a payload
local MAX_TITLE = 200 -- bytes: Wireshark aborts at a preference with a longer one
local DENIED = 13 -- EACCES; the number of "no such file" is another one in the browser
local INVALID = set "value.invalid command.key.invalid" -- the expert items for values

-- Types of fields and options --------------------------------------------------------------------

-- [name] = { kind, size in bytes (nil: the row's length), bottom, top, options }
local TYPES = {
  bool = { kind = "bool", size = 1, bottom = 0, top = 1, options = set "section" },
  int64_ns = { kind = "time", size = 8, options = set "section" },
  string = { kind = "string", options = set "section length" },
  bytes = { kind = "bytes", options = set "section length" },
  padding = { kind = "padding", options = set "length" },
  float64 = { kind = "ieee", size = 8, options = set "section unit" },
}

local function add_type(kind, size, bottom, top, options)
  TYPES[kind .. 8 * size] = {
    kind = kind,
    size = size,
    -- COMPAT 5.4: powers are floats there, which are printed with a ".0".
    bottom = math.floor(bottom),
    top = math.floor(top),
    options = set(options),
  }
end

for size = 1, 8 do
  local span, options = 2 ^ (8 * size), "section unit scale offset"
  local code = size <= 4 and " values invalid" or "" -- COMPAT 5.2: bits are those of four bytes
  local flags = size <= 4 and " flags group alarm" or ""
  add_type("int", size, -span / 2, span / 2 - 1, options .. code)
  add_type("uint", size, 0, span - 1, options .. code .. flags)
end
for _, size in ipairs { 1, 2, 4 } do
  add_type("float", size, 0, 2 ^ (8 * size) - 1, "section unit min max")
end

local MESSAGE_OPTIONS = set("name title section id size min_size info info_rest every answers " ..
  "enables speed differences derived")
local FIELD_NAMES = { "enables", "speed" } -- options that name a field of numbers
local FLAG_OPTIONS, DERIVED_OPTIONS = set "help alarm", set "unit"

-- The lists and maps of a message type, see above.
local LISTS = set "fields by_name flag_fields alarms generated derived rounded states filters"

-- Lua's types of options; those of the others are texts.
local OPTION_TYPES = {
  id = "number", size = "number", min_size = "number", length = "number", every = "number",
  scale = "number", offset = "number", min = "number", max = "number",
  values = "table", flags = "table", differences = "table", derived = "table",
  alarm = "string or boolean",
}

-- Raise errors in the options of a message or a row.
-- what     the owner of the options: "flag stopped", "type uint8"
-- options  { [name] = true } of the options that are allowed
-- count    how many values without a name it has
local function check_options(row, what, options, count)
  for key, value in pairs(row) do
    if options[key] then
      local types = OPTION_TYPES[key] or "string"
      demand(types:find(type(value), 1, true), "%s must be a %s, not %s", key, types, shown(value))
      demand(type(value) ~= "string" or is_text(value), "%s has a sign that cannot be shown", key)
      demand(type(value) ~= "number" or value - value == 0, "%s is not finite", key)
    else
      demand(input.is_integer(key) and key >= 1 and key <= count, "unknown option %s; %s has %s",
        shown(key), what, input.names(options))
    end
  end
end

-- Raise errors in a row { name, ..., title, options }.
-- what   it is: "flag 2", "type uint8"
-- count  how many values without a name it has; the last one is its title
local function check_row(row, what, options, count)
  demand(input.is_name(row[1]), "%s: %s is not a filter name (a-z, 0-9, _)", what, shown(row[1]))
  demand(is_text(row[count]), "%s: %s has no title", what, row[1])
  check_options(row, what, options, count)
end

-- Fields -----------------------------------------------------------------------------------------

local function add_flags(message_type, field, row)
  demand(input.is_name(row.group), "flags need a group, a name for their filters")
  field.kind, field.flags = "flags", {}
  field.group = message_type.filter .. "." .. row.group
  field.undefined, field.alarm_bits = field.top, row.alarm and field.top or 0
  for i, flag in ipairs(row.flags) do
    check_row(flag, "flag " .. i, FLAG_OPTIONS, 3)
    local name, mask = flag[1], flag[2]
    input.within(name .. ": mask", mask, 1, field.top)
    local taken = mask - band(mask, field.undefined)
    demand(taken == 0, "%s: bit 0x%X is already another's", name, taken)
    field.undefined = field.undefined - mask
    if flag.alarm and not row.alarm then field.alarm_bits = field.alarm_bits + mask end
    field.flags[i] = {
      name = name,
      mask = mask,
      title = flag[3],
      help = flag.help,
      filter = field.group .. "." .. name,
    }
  end
  table.insert(message_type.flag_fields, field)
  if field.alarm_bits == 0 then return end
  field.fault_word = row.alarm or "FAULT"
  table.insert(message_type.alarms, field)
  if row.alarm then message_type.fault_field = message_type.fault_field or field end
end

-- min and max make a compressed float of the bytes; without them float32 is IEEE 754's.
local function add_range(field, row)
  if field.size == 4 and not (row.min or row.max) then
    field.kind, field.bottom = "ieee", nil
    return
  end
  local is_range = row.min and row.max and row.min < row.max
  demand(is_range, "%s needs min and max, min below max", field.type)
  field.min, field.max = row.min + 0.0, row.max + 0.0 -- COMPAT 5.4: see add_scale
  field.shape = field.size == 4 and "%.10g" or "%.7g" -- the digits that its count can carry
  field.ordinary = field.top - 5
  field.number = field_kinds.new_float(field)
end

-- A linear scale: value = count * scale + offset.
local function add_scale(field, row)
  field.kind, field.shape = "scaled", "%.15g"
  -- COMPAT 5.4: products of integers wrap around
  field.scale, field.zero = (row.scale or 1) + 0.0, (row.offset or 0) + 0.0
end

local function add_values(field, row)
  field.values, field.invalid = row.values, row.invalid or "value.invalid"
  demand(INVALID[field.invalid], "invalid is value.invalid or command.key.invalid")
  for value, meaning in pairs(row.values) do
    input.within("value", value, field.bottom, field.top)
    demand(is_text(meaning), "value %s has no meaning in words", shown(value))
  end
end

-- Let the options of a row make its field one of codes, of flags, or of scaled integers.
local function add_meaning(message_type, field, row)
  local has_scale = row.scale or row.offset
  local is_clear = not (row.values and row.flags) and not (has_scale and (row.values or row.flags))
  demand(is_clear, "a field has one of values, flags and scale")
  demand(row.flags or not (row.group or row.alarm), "group and alarm are for a field with flags")
  if row.values then add_values(field, row) end
  if row.flags then add_flags(message_type, field, row) end
  if has_scale then add_scale(field, row) end
end

-- Make the field of a row and add it to its message type.
local function add_field(message_type, row, definition, offset, size)
  local field = {
    name = row[1],
    title = row[3],
    type = row[2],
    kind = definition.kind,
    filter = message_type.filter .. "." .. row[1],
    offset = offset,
    size = size,
    top = definition.top,
    bottom = definition.bottom,
    unit = row.unit,
    section = row.section or message_type.section,
    index = #message_type.fields + 1,
  }
  if field.kind == "float" then add_range(field, row) end
  if field.kind == "ieee" or field.min then field.special = field.filter .. ".special" end
  if field.kind == "bool" then field.invalid = "value.invalid" end
  if field.kind == "time" then message_type.time = message_type.time or field end
  add_meaning(message_type, field, row)
  message_type.fields[field.index], message_type.by_name[field.name] = field, field
end

-- Compile the rows of a message; return the sum of their sizes in bytes.
local function compile_fields(message_type, rows, context)
  local offset = 0
  for i, row in ipairs(rows) do
    context.field = i
    context.field = row[1] or i
    local definition = TYPES[row[2] or false]
    demand(definition, "unknown type %s; the types are %s", shown(row[2]), input.names(TYPES))
    local what, is_padding = "type " .. row[2], definition.kind == "padding"
    local check = is_padding and check_options or check_row
    check(row, what, definition.options, 3)
    local size = definition.size or row.length
    input.within(what .. ": length", size, 1, MAX_SIZE)
    if not is_padding then add_field(message_type, row, definition, offset, size) end
    offset = offset + size
  end
  context.field = nil
  return offset
end

-- Generated values -------------------------------------------------------------------------------

-- Add a value that is worked out from two fields.
-- text     "field * field"
-- returns  the item of message_type.generated
local function add_generated(message_type, name, text, title)
  local a, operator, b = tostring(text):match("^ *([%w_]+) *([*+-]) *([%w_]+) *$")
  demand(a, '%s: %s is not two fields with *, + or - between them: "voltage * current"', name,
    shown(text))
  local function number_field(field_name)
    local field = message_type.by_name[field_name]
    demand(field and field_kinds.is_number(field), "%s: %q is no field of numbers", name,
      field_name)
    return field
  end
  local item = {
    name = name,
    title = title,
    filter = message_type.filter .. "." .. name,
    kind = "derived",
    shape = "%.7g",
    operator = operator,
    a = number_field(a),
    b = number_field(b),
  }
  table.insert(message_type.generated, item)
  return item
end

-- differences: { name, field, field, title }; derived: { name, "field * field", title, unit = }
local function add_all_generated(message_type, entry)
  for i, row in ipairs(entry.differences or {}) do
    check_row(row, "difference " .. i, {}, 4)
    local item = add_generated(message_type, row[1], row[2] .. "-" .. row[3], row[4])
    item.unit, item.is_difference = item.a.unit, true
  end
  for i, row in ipairs(entry.derived or {}) do
    check_row(row, "derived " .. i, DERIVED_OPTIONS, 3)
    local item = add_generated(message_type, row[1], row[2], row[3])
    item.unit, message_type.derived[i] = row.unit, item
  end
end

-- Messages ---------------------------------------------------------------------------------------

-- context  the subject of errors: context.field is set to the name of the current field, or nil
local function compile_message(entry, reserved, context)
  local title, message_type = entry.title, {}
  demand(is_text(title) and #title <= MAX_TITLE, "the title is missing or too long")
  check_options(entry, "a message", MESSAGE_OPTIONS, math.huge)
  input.within("id", entry.id, 0, input.MAX_ID)
  for key in pairs(MESSAGE_OPTIONS) do message_type[key] = entry[key] end
  for key in pairs(LISTS) do message_type[key] = {} end
  message_type.filter = "taurus." .. entry.name
  message_type.min_size = entry.min_size or entry.size
  local size = compile_fields(message_type, entry, context)
  demand(size == entry.size and size <= MAX_SIZE, "size is %s, but the fields add up to %d bytes",
    shown(entry.size), size)
  input.within("min_size", message_type.min_size, 1, size)
  for _, key in ipairs(FIELD_NAMES) do
    local field = message_type.by_name[entry[key]]
    demand(not entry[key] or field, "%s: there is no field %q", key, entry[key])
    message_type[key] = field
  end
  message_type.info = text_of.compile_info(message_type, entry.info or "")
  message_type.info_rest = text_of.compile_info(message_type, entry.info_rest or entry.info or "")
  add_all_generated(message_type, entry)
  filters.add(message_type, reserved, context)
  function message_type.read(payload)
    message_type.read = decode.new_reader(message_type) -- now: most captures have no YAPP
    return message_type.read(payload)
  end
  return message_type
end

-- Compile an entry and add it to the catalogue.
local function add_message(catalogue, entry, reserved, context)
  demand(input.is_name(entry.name), "name %s is not a filter name (a-z, 0-9, _)", shown(entry.name))
  context.message = entry.name
  demand(not input.find(catalogue.messages, entry.name), "the name is there twice")
  local message_type = compile_message(entry, reserved, context)
  local other = catalogue.by_id[message_type.id]
  demand(not other, "id 0x%X is that of message %s", message_type.id, other and other.name)
  table.insert(catalogue.messages, message_type)
  catalogue.by_id[message_type.id] = message_type
end

--- Check a catalogue and compile it.
-- entries   the list of messages in taurus_fields.lua, described there
-- reserved  optional { [filter name] = true } that no message may use
-- files     optional: the file of each entry, for errors
-- returns   { messages = list of message types, by_id = { [id] = message type } } of the messages
--           without a mistake, and a list of texts, one for each other message: which field is
--           wrong and why
function M.compile(entries, reserved, files)
  local catalogue, problems = { messages = {}, by_id = {} }, {}
  for i, entry in ipairs(entries) do
    local context = { message = i }
    local ok, problem = pcall(add_message, catalogue, entry, reserved or {}, context)
    if not ok then
      local file = files and files[i] .. ": " or ""
      local field = context.field and ", field " .. tostring(context.field) or ""
      local text = "%smessage %s%s: %s; this message is not decoded"
      problems[#problems + 1] = text:format(file, context.message, field, problem)
    end
  end
  return catalogue, problems
end

-- Files ------------------------------------------------------------------------------------------

local NOT_READ = "%s: the entry %s is not read: the file must return a list of messages, " ..
  "{ { name = ... }, { name = ... } }, without a key in front and without a nil between"

local function name_of(entry)
  return type(entry) == "table" and tostring(entry.name)
end

-- Run a file.
-- returns  its list of messages; nil and why there is none
local function read_file(path, is_optional)
  local file, why, code = io.open(path)
  if not file and is_optional and code ~= DENIED then return {} end
  if not file then return nil, "cannot be read: " .. why end
  file:close()
  local ok, entries = pcall(dofile, path)
  if not ok then return nil, "cannot be read: " .. tostring(entries) end
  if type(entries) == "table" then return entries end
  return nil, "the file must return a list of messages, not " .. shown(entries)
end

-- Add the entries of a file.  One with the name of an entry of an earlier file takes its index.
-- all  { entries, files = lists }
local function add_entries(all, entries, path, problems)
  local index_by_name, count = {}, 0
  for i, entry in ipairs(all.entries) do index_by_name[name_of(entry)] = i end
  for i, entry in ipairs(entries) do
    local index = index_by_name[name_of(entry)] or #all.entries + 1
    all.entries[index], all.files[index], count = entry, path, i
  end
  for key in pairs(entries) do
    if not (input.is_integer(key) and key >= 1 and key <= count) then
      problems[#problems + 1] = NOT_READ:format(path, shown(key))
    end
  end
end

--- Read the files of the catalogue and compile them as one.
-- files     list of { path =, optional = true if the file may be missing }, in order: a message of
--           a later file replaces one of the same name
-- reserved  see M.compile
-- returns   as M.compile
function M.load(files, reserved)
  local all, problems = { entries = {}, files = {} }, {}
  for _, file in ipairs(files) do
    local entries, why = read_file(file.path, file.optional)
    if entries then
      add_entries(all, entries, file.path, problems)
    else
      problems[#problems + 1] = ("%s: %s; its messages are not decoded"):format(file.path, why)
    end
  end
  local catalogue, mistakes = M.compile(all.entries, reserved, all.files)
  for _, text in ipairs(mistakes) do problems[#problems + 1] = text end
  return catalogue, problems
end

-- Sizes and IDs ----------------------------------------------------------------------------------

--- Return those of a list of message types that may have a payload of this size, in bytes.
function M.of_size(message_types, size)
  local list = {}
  for _, message_type in ipairs(message_types) do
    if size >= message_type.min_size and size <= message_type.size then
      list[#list + 1] = message_type
    end
  end
  return list
end

--- Assign a message type to each ID.
-- catalogue  compiled
-- ids        { [message name] = list of IDs }, the user's choice
-- returns    { [id] = message type }, and a list of texts for IDs that two messages claim: the
--            first keeps it
function M.assign(catalogue, ids)
  local by_id, problems = {}, {}
  for _, message_type in ipairs(catalogue.messages) do
    for _, id in ipairs(ids[message_type.name] or { message_type.id }) do
      local other = by_id[id] or message_type
      by_id[id] = other
      if other ~= message_type then
        problems[#problems + 1] = ("ID 0x%X is given to %s and to %s: it stays with %s")
          :format(id, other.title, message_type.title, other.title)
      end
    end
  end
  return by_id, problems
end

return M
