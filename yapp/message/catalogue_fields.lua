-- SPDX-License-Identifier: GPL-2.0-or-later
-- From the rows of a message to its fields: types and options checked, offsets worked out.
-- Pure Lua.  A mistake in a row is raised as a text; message.catalogue adds the message and the
-- field.

local band = require "yapp.base.bits".band
local field_kinds = require "yapp.message.field_kinds"
local input = require "yapp.base.input"

local demand, shown, set = input.demand, input.shown, input.set
local is_name, is_text = input.is_name, input.is_text
local is_finite = input.is_finite

local M = {}

--- The largest payload, in bytes.
M.MAX_SIZE = 65535
-- The expert items for values.
local INVALID = set("value.invalid command.key.invalid")

-- Types ------------------------------------------------------------------------------------------

local SCALED = "section unit scale offset count"
local SIGNED = SCALED .. " values invalid"
local UNSIGNED = SIGNED .. " flags group alarm bits"
local FLOAT = "section min max unit count"
local PART_OPTIONS = set("section values invalid unit scale offset")
local FLAG_OPTIONS = set("alarm help")

-- [name] = { size in bytes (nil: from the row), kind, options, top and bottom (highest and lowest
-- count) }
local TYPES = {
  int64_ns = { kind = "time", size = 8, options = set("section") },
  bool = { kind = "bool", size = 1, bottom = 0, top = 1, options = set("section count") },
  string = { kind = "string", options = set("section length count") },
  bytes = { kind = "bytes", options = set("section length count") },
  padding = { kind = "padding", options = set("length") },
  variants = { kind = "variants", options = set("by cases") },
}

local function add_numbers(kind, size, bottom, top, options)
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
  local span = 2 ^ (8 * size)
  add_numbers("float", size, 0, span - 1, FLOAT)
  if size <= 4 then
    add_numbers("uint", size, 0, span - 1, UNSIGNED)
    add_numbers("int", size, -span / 2, span / 2 - 1, SIGNED)
  end
end
add_numbers("uint", 8, 0, 2 ^ 64 - 1, SCALED)
add_numbers("int", 8, -2 ^ 63, 2 ^ 63 - 1, SCALED)

--- The names of all types, for a message.
M.TYPE_NAMES = input.names(TYPES)

-- Options ----------------------------------------------------------------------------------------

-- Raise that a number has no room in a field.
local function check_fits(field, what, number, lowest)
  local fits = input.is_integer(number) and number >= lowest and number <= field.top
  demand(fits, "%s %s does not fit the type %s", what, shown(number), field.type)
end

-- A linear scale: value = count * scale + offset.
local function add_scale(field, row)
  local scale, zero = row.scale or 1, row.offset or 0
  demand(is_finite(scale) and scale ~= 0, "scale %s is not a number but 0", shown(scale))
  demand(is_finite(zero), "offset %s is not a number", shown(zero))
  demand(not (row.values or row.flags or row.bits),
    "a field has a scale, or values, flags and bits, not both")
  demand(is_finite(field.top * scale + zero), "scale %s is too large", shown(scale))
  field.kind, field.shape = "scaled", "%.15g"
  field.scale, field.zero = scale + 0.0, zero + 0.0 -- COMPAT 5.4: products of integers wrap around
end

-- The digits that a compressed float of so many bytes can carry.
local DIGITS = { 7, 7, 10, 10, 15, 15, 15, 15 }

-- min and max make a compressed float of the bytes; without them float32 and float64 are IEEE
-- 754's.
local function add_range(field, row)
  local min, max, size = row.min, row.max, field.size
  field.special = field.filter .. ".special"
  if min == nil and max == nil and (size == 4 or size == 8) then
    field.kind = "ieee"
    return
  end
  local is_range = is_finite(min) and is_finite(max) and min < max
  demand(is_range, "%s needs min and max, min below max", field.type)
  local largest = math.max(math.abs(min), math.abs(max)) * field.top
  demand(is_finite(2 * largest), "the range from %s to %s is too large", min, max)
  field.min, field.max = min + 0.0, max + 0.0 -- COMPAT 5.4: products of integers wrap around
  field.shape = "%." .. DIGITS[size] .. "g"
  -- A double holds counts of six bytes.  Of longer ones, reserved values are read as negative
  -- numbers.
  field.ordinary = size > 6 and field.top or field.top - 5
end

-- Fields -----------------------------------------------------------------------------------------

local function length_of(row)
  input.within(row[2] .. " needs a length, and", row.length, 1, M.MAX_SIZE)
  return row.length
end

-- Make the field of a row, or of a part of bits, without its offset.
-- def  of TYPES; for a part of bits also `type`: the name of the field's type
local function new_field(of_type, row, def)
  local field = {
    name = row[1],
    title = row[3],
    type = def.type or row[2],
    kind = def.kind,
    filter = of_type.filter .. "." .. row[1],
    size = def.size or length_of(row),
    top = def.top,
    bottom = def.bottom,
    unit = row.unit,
    section = row.section or of_type.section,
    values = row.values,
  }
  local invalid = row.invalid or "value.invalid"
  demand(INVALID[invalid], "invalid is value.invalid or command.key.invalid")
  if row.values or field.kind == "bool" then field.invalid = invalid end
  if field.kind == "float" then add_range(field, row) end
  if row.scale or row.offset then add_scale(field, row) end
  for value, meaning in pairs(row.values or {}) do
    check_fits(field, "value", value, field.bottom)
    demand(is_text(meaning), "value %s has no meaning in words", shown(value))
  end
  return field
end

-- Put a field at its offset in the message.
local function add_field(build, field)
  local of_type, offset = build.type, build.offset
  local min_size, name = of_type.min_size, field.name
  demand(not of_type.by_name[name], "the name is there twice")
  demand(min_size <= offset or min_size >= offset + field.size, "min_size %d ends inside it",
    min_size)
  field.offset, field.when = offset, build.when
  table.insert(of_type.fields, field)
  field.index = #of_type.fields
  of_type.by_name[name] = field
  if field.kind == "time" and not build.when then of_type.time = of_type.time or field end
end

-- Flags and parts of bits ------------------------------------------------------------------------

-- Check the i-th flag, or part, { name, mask, title }, and mark its bits as defined.
-- returns  its name in errors: "flag stopped"
local function define_bits(field, row, what, i, options)
  what = input.row(row, what, i, 3, options)
  local mask = row[2]
  check_fits(field, what .. ": mask", mask, 1)
  local taken = mask - band(mask, field.undefined)
  demand(taken == 0, "%s: bit 0x%X is already another's", what, taken)
  field.undefined = field.undefined - mask
  return what
end

local function add_flag(field, row, i)
  local what = define_bits(field, row, "flag", i, FLAG_OPTIONS)
  local name, mask = row[1], row[2]
  demand(row.alarm == nil or row.alarm == true, "%s: alarm is true, or is not there", what)
  if row.alarm then field.alarm_bits = field.alarm_bits + mask end
  field.flags[i] = {
    name = name,
    mask = mask,
    title = row[3],
    help = row.help,
    filter = field.group .. "." .. name,
  }
end

-- Make a part of a field: a field with a mask, whose counts begin at the mask's lowest bit.
local function new_part(of_type, field, row, i)
  local what = define_bits(field, row, "bits", i, PART_OPTIONS)
  local mask, low = row[2], 1
  while mask % (2 * low) == 0 do low = low * 2 end
  local top = mask / low
  demand(band(top, top + 1) == 0, "%s: the bits of mask 0x%X are not side by side", what, mask)
  field.watched = field.watched - mask
  local part = new_field(of_type, row,
    { kind = "uint", type = field.type, size = field.size, bottom = 0, top = top })
  part.inside, part.mask, part.low = field, mask, low
  return part
end

-- Turn a field that is at its offset already into one of flags, of parts, or of both.
local function add_bits(build, field, row)
  local of_type, word = build.type, row.alarm
  local group = row.group or not row.flags and field.name
  demand(is_name(group), "flags need a group, a name for their filters")
  demand(word == nil or is_text(word), "alarm is a word, for a field with flags")
  demand(not row.values, "a field has values or flags, not both")
  field.kind = "flags"
  field.group = of_type.filter .. "." .. group
  field.flags = {}
  field.alarm_bits = 0
  field.undefined = field.top
  field.watched = field.top
  for i, flag in ipairs(row.flags or {}) do add_flag(field, flag, i) end
  for i, part in ipairs(row.bits or {}) do
    add_field(build, new_part(of_type, field, part, i))
  end
  table.insert(of_type.flag_fields, field)
  if word then
    field.alarm_bits = field.watched
    of_type.fault_field = of_type.fault_field or field
  end
  if field.alarm_bits == 0 then return end
  field.fault_word = word or "FAULT"
  table.insert(of_type.alarms, field)
end

-- Rows -------------------------------------------------------------------------------------------

-- An array is its elements: fields of their own with one filter name.
local function add_elements(build, field, count)
  input.within("count", count, 1, M.MAX_SIZE)
  for i = 1, count do
    local element = {}
    for name, value in pairs(field) do element[name] = value end
    element.name = field.name .. "_" .. i
    element.title = field.title .. " " .. i
    element.array = field
    add_field(build, element)
    build.offset = build.offset + element.size
  end
end

local add_rows

-- The cases lie over one another, as in a union of C: the longest says where the message goes on.
local function add_variants(build, row)
  local by = build.type.by_name[row.by or false]
  demand(by and field_kinds.BY_NAME[by.kind].is_integer and by.size <= 4 and not by.cases,
    "by %s is not an earlier integer of the message, one for each row of variants", shown(row.by))
  demand(not build.when, "variants are not for a case of others")
  demand(row.cases, "cases is missing")
  local values = {}
  for value in pairs(row.cases) do
    check_fits(by, "value", value, by.bottom)
    values[#values + 1] = value
  end
  table.sort(values)
  by.cases, by.invalid = {}, by.invalid or "value.invalid"
  local start, longest = build.offset, build.offset
  for _, value in ipairs(values) do
    by.cases[value] = true
    build.offset = start
    build.when = { index = by.index, value = value }
    add_rows(build, row.cases[value])
    longest = math.max(longest, build.offset)
  end
  build.offset, build.when = longest, nil
end

local function add_row(build, row)
  local name, kind = row[1], row[2]
  demand(is_name(name), "%s is not a filter name (a-z, 0-9, _)", shown(name))
  local def = TYPES[kind or false]
  demand(def, "unknown type %s; the types are %s", shown(kind), M.TYPE_NAMES)
  input.options(row, "type " .. kind, def.options, 3)
  if def.kind == "variants" then return add_variants(build, row) end
  if def.kind == "padding" then
    build.offset = build.offset + length_of(row)
    return
  end
  demand(is_text(row[3]), "the title is missing")
  local field = new_field(build.type, row, def)
  local has_bits = row.flags or row.bits
  demand(has_bits or not (row.group or row.alarm),
    "group and alarm are for a field with flags")
  demand(not (has_bits and row.count), "flags and bits are not for an array")
  if row.count then return add_elements(build, field, row.count) end
  add_field(build, field)
  if has_bits then add_bits(build, field, row) end
  build.offset = build.offset + field.size
end

-- Fields in the order of the rows; build.offset is then behind the last.
function add_rows(build, rows)
  for i, row in ipairs(rows) do
    build.context.field = i
    demand(type(row) == "table", "a field is a row { name, type, title }, not %s", shown(row))
    if is_name(row[1]) then build.context.field = row[1] end
    add_row(build, row)
  end
end

--- Compile the rows of a message into its fields, by_name, time, flag_fields and alarms.
-- of_type  its compiled head, with these tables, empty
-- context  the subject of errors: context.field is set to the name or number of the current row
-- returns  the sum of the sizes in bytes.  It raises errors.
function M.compile(of_type, rows, context)
  local build = { type = of_type, context = context, offset = 0, when = nil }
  add_rows(build, rows)
  context.field = nil
  return build.offset
end

return M
