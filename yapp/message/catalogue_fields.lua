-- SPDX-License-Identifier: GPL-2.0-or-later
-- From the rows of a message to its fields: types and options checked, offsets worked out.
-- Pure Lua.  What is wrong with a row is raised as a text; who compiles the message says which
-- message and field it is about.

local band = require("yapp.base.bits").band
local check = require("yapp.message.check")

local demand = check.demand
local shown = check.shown
local is_integer = check.is_integer
local is_finite = check.is_finite
local is_name = check.is_name
local is_text = check.is_text
local set = check.set

local M = {}

local MAX_SIZE = 65535
-- The expert items for values.
local INVALID = set("value.invalid command.key.invalid")

-- COMPAT 5.4: powers and quotients are floats there, and "%d" wants integers.
local tointeger = rawget(math, "tointeger") or function() end
local function whole(n) return tointeger(n) or n end

-- Types ------------------------------------------------------------------------------------------

local SCALED = "section unit scale offset count "
local OPTIONS = {
  uint = set(SCALED .. "values invalid flags group alarm bits"),
  int = set(SCALED .. "values invalid"),
  wide = set(SCALED),
  float = set("section min max unit count"),
  time = set("section"),
  bool = set("section count"),
  text = set("section length count"),
  padding = set("length"),
  variants = set("by cases"),
}
local PART_OPTIONS = set("section values invalid unit scale offset")
local FLAG_OPTIONS = set("alarm help")

-- [name] = { size (bytes; nil: the row says it), kind, options, top, bottom (highest and lowest
-- count) }
local TYPES = {
  int64_ns = { size = 8, kind = "time", options = OPTIONS.time },
  bool = { size = 1, kind = "bool", top = 1, bottom = 0, options = OPTIONS.bool },
  string = { kind = "string", options = OPTIONS.text },
  bytes = { kind = "bytes", options = OPTIONS.text },
  padding = { kind = "padding", options = OPTIONS.padding },
  variants = { kind = "variants", options = OPTIONS.variants },
}
for size = 1, 8 do
  local bits, span = size * 8, 2 ^ (size * 8)
  TYPES["float" .. bits] = {
    size = size,
    kind = "float",
    top = whole(span - 1),
    options = OPTIONS.float,
  }
  if size <= 4 or size == 8 then
    TYPES["uint" .. bits] = {
      size = size,
      kind = "uint",
      top = whole(span - 1),
      bottom = 0,
      options = size > 4 and OPTIONS.wide or OPTIONS.uint,
    }
    TYPES["int" .. bits] = {
      size = size,
      kind = "int",
      top = whole(span / 2 - 1),
      bottom = whole(-span / 2),
      options = size > 4 and OPTIONS.wide or OPTIONS.int,
    }
  end
end

-- By the letters, then the number: int8 before int16.
local names, numbered = {}, {}
for name in pairs(TYPES) do
  names[#names + 1] = name
  numbered[name] = name:gsub("%d+", function(digits) return ("%03d"):format(digits) end)
end
table.sort(names, function(a, b) return numbered[a] < numbered[b] end)

--- The names of all types, for a message.
M.TYPE_NAMES = table.concat(names, ", ")

-- Options ----------------------------------------------------------------------------------------

local function check_value(field, value)
  local fits = is_integer(value) and value >= field.bottom and value <= field.top
  demand(fits, "value %s does not fit the type %s", shown(value), field.type)
end

local function add_values(field, row)
  if row.values == nil then return end
  demand(type(row.values) == "table", "values must be a table, not %s", shown(row.values))
  demand(not (row.flags or row.bits), "a field has values or flags, not both")
  for value, meaning in pairs(row.values) do
    check_value(field, value)
    demand(is_text(meaning), "value %s has no meaning in words", shown(value))
  end
  field.values = row.values
end

-- A linear scale: value = count * scale + offset.
local function add_scale(field, row)
  if row.scale == nil and row.offset == nil then return end
  local scale, zero = row.scale or 1, row.offset or 0
  demand(is_finite(scale) and scale ~= 0, "scale %s is not a number but 0", shown(scale))
  demand(is_finite(zero), "offset %s is not a number", shown(zero))
  local is_alone = not (row.values or row.flags or row.bits)
  demand(is_alone, "a field has a scale, or values, flags and bits, not both")
  -- COMPAT 5.4: products of integers wrap around
  field.scale, field.zero = scale + 0.0, zero + 0.0
end

-- min and max make a compressed float of the bytes; without them float32 and float64 are IEEE
-- 754's.
local function add_range(field, row)
  field.special = field.filter .. ".special"
  if row.min == nil and row.max == nil and (field.size == 4 or field.size == 8) then
    field.kind = "ieee"
    return
  end
  local is_range = is_finite(row.min) and is_finite(row.max) and row.min < row.max
  demand(is_range, "%s needs min and max, min below max", field.type)
  -- COMPAT 5.4: products of integers wrap around
  field.min, field.max = row.min + 0.0, row.max + 0.0
  -- A double holds the counts of six bytes; those of more are read with the reserved ones set
  -- apart.
  field.ordinary = field.size > 6 and field.top or field.top - 5
end

-- What a person reads of a field or a flag beyond its title.
local function describe(title, unit, message, section)
  local text = ("%s%s, of %s"):format(title, unit and " in " .. unit or "", message.title)
  return section and ('%s (section "%s")'):format(text, section) or text
end

-- The options that fields and parts of bits share.
local function add_options(field, row, message)
  field.unit = check.text(row, "unit")
  field.section = check.text(row, "section") or message.section
  add_values(field, row)
  local is_right = row.invalid == nil or INVALID[row.invalid] and row.values
  demand(is_right, "invalid is value.invalid or command.key.invalid, for a field with values")
  field.invalid = row.invalid
  if row.values or field.kind == "bool" then field.invalid = row.invalid or "value.invalid" end
  add_scale(field, row)
  field.description = describe(field.title, field.unit, message, field.section)
end

-- Flags and parts of bits ------------------------------------------------------------------------

-- Checks a flag, or a part, { name, mask, title }, and takes its bits of the field; returns what it
-- is called.
local function take_bits(field, row, what, i)
  demand(type(row) == "table", "%s %d: %s is not { name, mask, title }", what, i, shown(row))
  local name, mask, title = row[1], row[2], row[3]
  demand(is_name(name), "%s %d: %s is not a filter name (a-z, 0-9, _)", what, i, shown(name))
  what = what .. " " .. name
  local fits = is_integer(mask) and mask >= 1 and mask <= field.top
  demand(fits, "%s: mask %s does not fit the type %s", what, shown(mask), field.type)
  demand(is_text(title), "%s has no title", what)
  local taken = mask - band(mask, field.undefined)
  demand(taken == 0, "%s: bit 0x%X is already another's", what, taken)
  field.undefined = field.undefined - mask
  return what
end

local function add_flag(field, row, i, message)
  local what = take_bits(field, row, "flag", i)
  check.check_options(row, what, FLAG_OPTIONS, 3)
  demand(row.alarm == nil or row.alarm == true, "%s: alarm is true, or is not there", what)
  if row.alarm then field.alarm_bits = field.alarm_bits + row[2] end
  local help = check.text(row, "help", what .. ": ")
  local description = describe(row[3] .. ", one of " .. field.title, nil, message, field.section)
  field.flags[i] = {
    name = row[1],
    mask = row[2],
    title = row[3],
    help = help,
    filter = field.group .. "." .. row[1],
    description = help and description .. ". " .. help or description,
  }
end

-- A part of a field, as a row of its own: a field with a mask, whose counts begin at the mask's
-- lowest bit.
local function new_part(field, row, i, message)
  local what = take_bits(field, row, "bits", i)
  local mask, low = row[2], 1
  while mask % (2 * low) == 0 do low = low * 2 end
  local top = whole(mask / low)
  demand(band(top, top + 1) == 0, "%s: the bits of mask 0x%X are not side by side", what, mask)
  check.check_options(row, what, PART_OPTIONS, 3)
  field.watched = field.watched - mask
  local part = {
    name = row[1],
    title = row[3],
    type = field.type,
    kind = "uint",
    filter = message.filter .. "." .. row[1],
    size = field.size,
    inside = field,
    mask = mask,
    low = low,
    top = top,
    bottom = 0,
  }
  add_options(part, row, message)
  return part
end

-- Makes a field one of flags, parts, or both; returns a list of the parts.
local function add_bits(field, row, message)
  demand(row.flags == nil or is_name(row.group), "flags need a group, a name for their filters")
  demand(row.group == nil or is_name(row.group), "group %s is not a filter name", shown(row.group))
  demand(row.count == nil, "flags and bits are not for an array")
  local flags, rows, parts = row.flags or {}, row.bits or {}, {}
  demand(type(flags) == "table", "flags must be a list, not %s", shown(flags))
  demand(type(rows) == "table", "bits must be a list, not %s", shown(rows))
  field.kind, field.flags, field.alarm_bits = "flags", {}, 0
  field.group = message.filter .. "." .. (row.group or field.name)
  field.undefined, field.watched = field.top, field.top
  for i, flag in ipairs(flags) do add_flag(field, flag, i, message) end
  for i, part in ipairs(rows) do parts[i] = new_part(field, part, i, message) end
  if row.alarm then field.alarm_bits = field.watched end
  field.alarm = row.alarm or (field.alarm_bits ~= 0 and "FAULT") or nil
  return parts
end

-- Rows -------------------------------------------------------------------------------------------

local function length_of(row)
  return check.within(row[2] .. " needs a length, and", row.length, 1, MAX_SIZE)
end

-- One field of a row, without its place; and the parts in its bits.
local function new_field(message, row, def)
  demand(is_text(row[3]), "the title is missing")
  local field = {
    name = row[1],
    title = row[3],
    type = row[2],
    kind = def.kind,
    filter = message.filter .. "." .. row[1],
    size = def.size or length_of(row),
    top = def.top,
    bottom = def.bottom,
  }
  if field.kind == "float" then add_range(field, row) end
  local is_alarm = row.alarm == nil or is_text(row.alarm) and row.flags
  demand(is_alarm, "alarm is a word, for a field with flags")
  add_options(field, row, message)
  if row.flags ~= nil or row.bits ~= nil then return field, add_bits(field, row, message) end
  demand(row.group == nil, "group is for a field with flags")
  return field, {}
end

-- Puts a field at its place in the message.
local function add_field(build, field)
  local message = build.message
  demand(not message.by_name[field.name], "the name is there twice")
  field.offset, field.when = build.offset, build.when
  message.fields[#message.fields + 1] = field
  message.by_name[field.name], message.index[field] = field, #message.fields
  if field.kind == "time" and not build.when then message.time = message.time or field end
  if field.alarm then message.alarms[#message.alarms + 1] = field end
end

-- An array is its elements: fields of their own with one filter name.
local function add_elements(build, field, count)
  for i = 1, check.within("count", count, 1, MAX_SIZE) do
    local element = {}
    for name, value in pairs(field) do element[name] = value end
    element.name = ("%s_%d"):format(field.name, i)
    element.title = ("%s %d"):format(field.title, i)
    element.element, element.array_title = i, field.title
    add_field(build, element)
    build.offset = build.offset + element.size
  end
end

local add_rows

-- The cases lie over one another, as in a union of C: the longest says where the message goes on.
local function add_variants(build, row)
  local message, start, longest, keys = build.message, build.offset, build.offset, {}
  local by = message.by_name[row.by or false]
  local is_integer_type = by and by.bottom and by.size <= 4 and by.kind ~= "flags"
  demand(not build.when, "variants are not for a case of others")
  demand(is_integer_type and not by.cases,
    "by %s is not an earlier integer of the message, one for each row of variants", shown(row.by))
  demand(type(row.cases) == "table", "cases must be a table, not %s", shown(row.cases))
  for value, rows in pairs(row.cases) do
    check_value(by, value)
    demand(type(rows) == "table", "case %s is not a list of rows", shown(value))
    keys[#keys + 1] = value
  end
  table.sort(keys)
  by.cases, by.invalid = {}, by.invalid or "value.invalid"
  for _, value in ipairs(keys) do
    by.cases[value] = true
    build.offset, build.when = start, { index = message.index[by], value = value }
    add_rows(build, row.cases[value])
    longest = math.max(longest, build.offset)
  end
  build.offset, build.when = longest, nil
end

local function add_row(build, row)
  demand(type(row) == "table", "a field is a row { name, type, title }, not %s", shown(row))
  demand(is_name(row[1]), "%s is not a filter name (a-z, 0-9, _)", shown(row[1]))
  local def = TYPES[row[2] or false]
  demand(def, "unknown type %s; the types are %s", shown(row[2]), M.TYPE_NAMES)
  check.check_options(row, "type " .. row[2], def.options, 3)
  if def.kind == "variants" then return add_variants(build, row) end
  if def.kind == "padding" then
    build.offset = build.offset + length_of(row)
    return
  end
  local field, parts = new_field(build.message, row, def)
  if row.count ~= nil then return add_elements(build, field, row.count) end
  add_field(build, field)
  for _, part in ipairs(parts) do add_field(build, part) end
  build.offset = build.offset + field.size
end

-- Fields in the order of the rows; build.offset is then behind the last.
function add_rows(build, rows)
  for i, row in ipairs(rows) do
    build.place.field = type(row) == "table" and is_name(row[1]) and row[1] or i
    add_row(build, row)
  end
end

--- Compiles the rows of a message into its fields, by_name, index, time and alarms.
-- message  compiled as far as its head, with these tables, empty
-- place    gets field = the name, or else the number, of the row that is looked at: what an error
--          is about
-- returns  the sum of the sizes in bytes.  Raises what is wrong.
function M.compile(message, rows, place)
  local build = { message = message, place = place, offset = 0, when = nil }
  add_rows(build, rows)
  place.field = nil
  return build.offset
end

return M
