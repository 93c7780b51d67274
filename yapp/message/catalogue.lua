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
--   flag_fields (its fields of flags), alarms (those with a fault flag)
--   generated: a list of the values that are worked out from two fields: { name, title, filter,
--   unit, kind = "derived", shape, operator ("*", "-", "+"), a and b (the fields), is_difference }
--   rounded: a list of the values for columns, { filter, field (or one of generated) }
--   filters: a list of { filter, type, title, description, base, values, mask }, see show.fields
--   states: the filters of its state, { [its name in message.history] = filter }
--   read (see message.decode), info and, beside columns, info_rest (see message.text)
-- A field has name, title, filter, filters (a list of it and those below it), index (in fields),
-- offset, size in bytes, type, unit or nil, shape (a format with as many digits as its
-- count can carry; nil for integers), rounded (a format with as many as people read, or nil), and
-- kind, with the values that its kind needs:
--   uint, int  top (the highest count), is_unsigned; values, invalid (its expert item)
--   scaled     the same, and scale, zero: value = count * scale + zero
--   flags      flags { name, mask, title, filter, help or nil }, group, undefined (mask: bits that
--              nothing defines), alarm_bits (mask: bits that are faults)
--   float      compressed: min, max, top, ordinary (the highest count that is not reserved), number
--              (function(raw) -> value)
--   ieee, string, bytes, time

local band = require "yapp.base.bits".band
local decode = require "yapp.message.decode"
local field_kinds = require "yapp.message.field_kinds"
local filters = require "yapp.message.filters"
local input = require "yapp.base.input"
local joined = require "yapp.base.joined"
local mapped = require "yapp.base.mapped"
local text_of = require "yapp.message.text"

local demand = input.demand

local M = {}

-- Types of fields and options --------------------------------------------------------------------

-- [name] = { kind, size in bytes (nil: the row's length), top, is_unsigned }
local TYPES = {
  int64_ns = { kind = "time", size = 8 },
  string = { kind = "string" },
  bytes = { kind = "bytes" },
  padding = { kind = "padding" },
  float64 = { kind = "ieee", size = 8 },
}

-- min and max make a compressed float of the bytes; without them float32 is IEEE 754's.
local FLOAT32 = { kind = "ieee", size = 4 }

-- COMPAT 5.4: powers are floats there, which are printed with a ".0".
local function add_type(kind, size, top)
  TYPES[kind .. 8 * size] =
    { kind = kind, size = size, top = math.floor(top), is_unsigned = kind ~= "int" }
end

for size = 1, 8 do
  local span = 2 ^ (8 * size)
  add_type("int", size, span / 2 - 1)
  add_type("uint", size, span - 1)
end
for _, size in ipairs { 1, 2, 4 } do add_type("float", size, 2 ^ (8 * size) - 1) end

-- Return { [name of an option] = its type in Lua }.
-- names  { [type] = names }
local function types_of(names)
  local types = {}
  for kind, words in pairs(names) do
    for _, name in ipairs(input.words(words)) do types[name] = kind end
  end
  return types
end

local MESSAGE_OPTIONS = types_of {
  string = "name title section info info_rest answers enables speed",
  number = "id size min_size every",
  table = "differences derived",
}
local FIELD_OPTIONS = types_of {
  string = "unit group invalid",
  number = "scale offset min max length",
  table = "values flags",
  boolean = "alarm",
}
local FLAG_OPTIONS = types_of { string = "help", boolean = "alarm" }

-- Raise that an option is not known, of another type, or cannot be shown.
-- what     the owner of the options: "a flag"
-- options  of types_of
-- count    how many values without a name it has
local function check(row, what, options, count)
  for key, value in pairs(row) do
    local kind = options[key] or type(key) == "number" and key <= count and type(value)
    demand(kind, "unknown option %s; %s has %s", input.shown(key), what,
      kind or input.names(options))
    demand(kind == type(value), "%s is %s, not a %s", key, input.shown(value), kind)
    local is_shown = type(value) ~= "string" or input.is_text(value)
    demand(is_shown, "%s has a sign that cannot be shown", key)
  end
end

-- Fields -----------------------------------------------------------------------------------------

local function add_flags(message_type, field, row)
  field.kind, field.flags = "flags", {}
  field.group = message_type.filter .. "." .. row.group
  field.undefined, field.alarm_bits = field.top, row.alarm and field.top or 0
  for i, flag in ipairs(row.flags) do
    check(flag, "a flag", FLAG_OPTIONS, 3)
    local name, mask = flag[1], flag[2]
    local taken = mask - band(mask, field.undefined)
    demand(mask > 0 and taken == 0, "%s: bit 0x%X is another's, or not in the field", name, taken)
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
  if field.alarm_bits > 0 then table.insert(message_type.alarms, field) end
end

-- Set the range of a compressed float.
local function add_range(field, row)
  demand(row.min and row.max and row.min < row.max, "min and max are missing, or no range")
  field.min, field.max = row.min + 0.0, row.max + 0.0 -- COMPAT 5.4: see add_meaning
  field.shape = field.size == 4 and "%.10g" or "%.7g"
  field.ordinary = field.top - 5
  field.number = field_kinds.new_float(field)
end

-- Raise that the options of a row give its field two meanings, or one that its type cannot have.
local function check_meaning(field, row)
  local is_coded, is_scaled = row.values or row.flags, row.scale or row.offset
  local has_two = is_coded and is_scaled or row.values and row.flags
  demand(not has_two and (field.kind:find "int" or not is_coded and not is_scaled),
    "an integer has one of values, flags and scale; other types have none")
end

-- Let the options of a row make its field one of codes, of flags, or of scaled integers.
local function add_meaning(message_type, field, row)
  check_meaning(field, row)
  for code, text in pairs(row.values or {}) do
    demand(type(code) == "number" and input.is_text(text), "values are { [number] = text }")
  end
  if row.values then field.values, field.invalid = row.values, row.invalid or "value.invalid" end
  if row.flags then add_flags(message_type, field, row) end
  demand(row.scale ~= 0, "scale is 0")
  if row.scale or row.offset then
    field.kind, field.shape = "scaled", "%.15g"
    -- COMPAT 5.4: products of integers wrap around
    field.scale, field.zero = (row.scale or 1) + 0.0, (row.offset or 0) + 0.0
  end
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
    is_unsigned = definition.is_unsigned,
    unit = row.unit,
    index = #message_type.fields + 1,
  }
  if field.kind == "float" then add_range(field, row) end
  if field.kind == "ieee" then field.shape = size == 4 and "%.7g" or "%.15g" end
  if field.shape then field.special = field.filter .. ".special" end
  if field.kind == "time" then message_type.time = message_type.time or field end
  add_meaning(message_type, field, row)
  message_type.fields[field.index], message_type.by_name[field.name] = field, field
end

-- Compile the rows of a message; return the sum of their sizes in bytes.
local function compile_fields(message_type, rows, context)
  local offset = 0
  for i, row in ipairs(rows) do
    context.field = ", field " .. i
    context.field = ", field " .. (row[1] or i)
    local definition = TYPES[row[2]]
    demand(definition, "unknown type %s; the types are %s", input.shown(row[2]), input.names(TYPES))
    if definition == TYPES.float32 and not row.min then definition = FLOAT32 end
    check(row, "a row", FIELD_OPTIONS, 3)
    local size = definition.size or row.length
    if definition.kind ~= "padding" then add_field(message_type, row, definition, offset, size) end
    offset = offset + size
  end
  context.field = ""
  return offset
end

-- Messages ---------------------------------------------------------------------------------------

-- Add a value that is worked out from two fields; return it.
-- text  "field * field"
local function add_generated(message_type, name, text, title, unit)
  local a, operator, b = text:match("^ *([%w_]+) *([*+-]) *([%w_]+) *$")
  local function number_field(field_name)
    local field = message_type.by_name[field_name]
    demand(field and field_kinds.is_number(field),
      "%s: %s is not two fields of numbers with *, + or - between them", name, input.shown(text))
    return field
  end
  local item = {
    name = name,
    title = title,
    filter = message_type.filter .. "." .. name,
    kind = "derived",
    shape = "%.7g",
    unit = unit,
    operator = operator,
    a = number_field(a),
    b = number_field(b),
  }
  table.insert(message_type.generated, item)
  return item
end

-- Return an ID; raise that it is none.
local function check_id(id)
  local is_id = type(id) == "number" and id % 1 == 0 and id >= 0 and id <= input.MAX_ID
  return demand(is_id and id, "id %s is not one of 0 .. %d", input.shown(id), input.MAX_ID)
end

-- Compile an entry and add it to the catalogue.
-- context  the subject of errors: message, and field = ", field dc_voltage"
local function add_message(catalogue, entry, context)
  context.message = entry.name or context.message
  demand(not input.find(catalogue.messages, entry.name), "the name is there twice")
  check(entry, "a message", MESSAGE_OPTIONS, math.huge)
  local id = check_id(entry.id)
  local message_type = {
    filter = "taurus." .. entry.name,
    fields = {},
    by_name = {},
    flag_fields = {},
    alarms = {},
    generated = {},
    rounded = {},
    states = {},
    filters = {},
  }
  for key in pairs(MESSAGE_OPTIONS) do message_type[key] = entry[key] end
  message_type.min_size = entry.min_size or entry.size
  local size, fields = compile_fields(message_type, entry, context), message_type.by_name
  demand(size == entry.size, "size is %s, but the fields add up to %d bytes", entry.size, size)
  message_type.enables, message_type.speed = fields[entry.enables], fields[entry.speed]
  message_type.info = text_of.compile_info(message_type, entry.info or "")
  message_type.info_rest = text_of.compile_info(message_type, entry.info_rest or entry.info or "")
  for _, row in ipairs(entry.differences or {}) do
    local text, unit = row[2] .. "-" .. row[3], fields[row[2]].unit
    add_generated(message_type, row[1], text, row[4], unit).is_difference = true
  end
  for _, row in ipairs(entry.derived or {}) do
    add_generated(message_type, row[1], row[2], row[3], row.unit)
  end
  filters.add(message_type, context)
  function message_type.read(payload)
    message_type.read = decode.new_reader(message_type) -- now: most captures have no YAPP
    return message_type.read(payload)
  end
  local other = catalogue.by_id[id]
  demand(not other, "id 0x%X is that of message %s", id, other and other.name)
  table.insert(catalogue.messages, message_type)
  catalogue.by_id[id] = message_type
end

--- Check a catalogue and compile it.
-- entries  the list of messages in taurus_fields.lua, described there
-- files    optional: the file of each entry, for errors
-- returns  { messages = list of message types, by_id = { [id] = message type } } of the messages
--          without a mistake, and a list of texts, one for each other message: which field is
--          wrong and why
function M.compile(entries, files)
  local catalogue, problems = { messages = {}, by_id = {} }, {}
  for i, entry in ipairs(entries) do
    local context = { message = i, field = "" }
    local ok, problem = pcall(add_message, catalogue, entry, context)
    if not ok then
      local file = files and files[i] .. ": " or ""
      problems[#problems + 1] = ("%smessage %s%s: %s; this message is not decoded"):format(
        file, context.message, context.field, problem)
    end
  end
  return catalogue, problems
end

-- Files ------------------------------------------------------------------------------------------

-- Run a file and add its messages.  One with the name of a message of an earlier file replaces it.
-- all  { entries, paths = lists, indexes = [name of a message] = its index in them }
local function add_file(all, path)
  local entries, count = dofile(path), 0
  for _ in pairs(entries or {}) do count = count + 1 end
  demand(entries and count == #entries, "the file must return a list of messages, " ..
    "{ { name = ... }, { name = ... } }, without a key in front and without a nil between")
  for _, entry in ipairs(entries) do
    local name = entry.name or ""
    local index = all.indexes[name]
    if not index or all.paths[index] == path then index = #all.entries + 1 end
    all.entries[index], all.paths[index], all.indexes[name] = entry, path, index
  end
end

--- Read the files of the catalogue and compile them as one.
-- paths    of the files in their order, "" for none: a message of a later file replaces one of the
--          same name
-- returns  as M.compile
function M.load(paths)
  local all = { entries = {}, paths = {}, indexes = {} }
  local problems = mapped(paths, function(path)
    if path == "" then return nil end
    local ok, why = pcall(add_file, all, path)
    return not ok and ("%s: cannot be read: %s; its messages are not decoded"):format(path, why)
  end)
  local catalogue, mistakes = M.compile(all.entries, all.paths)
  return catalogue, joined(problems, mistakes)
end

-- Sizes and IDs ----------------------------------------------------------------------------------

--- Return those of a list of message types that may have a payload of this size, in bytes.
function M.of_size(message_types, size)
  return mapped(message_types, function(message_type)
    local fits = size >= message_type.min_size and size <= message_type.size
    return fits and message_type
  end)
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
