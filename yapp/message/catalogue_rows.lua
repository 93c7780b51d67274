-- SPDX-License-Identifier: GPL-2.0-or-later
-- From the rows of a message to its fields: types and options checked, offsets worked out.  Pure Lua, 5.2 and 5.4.

local check = require("yapp.message.catalogue_check")
local flags = require("yapp.message.catalogue_flags")
local types = require("yapp.message.catalogue_types")

local shown, is_integer, is_name, is_text = check.shown, check.is_integer, check.is_name, check.is_text

local M = {}

M.MAX_ROWS = 1024 -- fields of one message, values of one field
local MAX_SIZE = 65535

-- The expert items for a value that is not one of those listed.
local INVALID = { ["value.invalid"] = true, ["command.key.invalid"] = true }

local function check_values(field, values, complain)
  if type(values) ~= "table" then return complain("values must be a table, not %s", shown(values)) end
  local count, value, meaning = 0, next(values)
  while value ~= nil do
    count = count + 1
    if count > M.MAX_ROWS then return complain("more than %d values", M.MAX_ROWS) end
    if not is_integer(value) or value < field.bottom or value > field.top then
      return complain("value %s does not fit the type %s", shown(value), field.type)
    elseif not is_text(meaning) then
      return complain("value %s has no meaning in words", shown(value))
    end
    value, meaning = next(values, value)
  end
end

-- A linear scale: value = count * scale + offset.
local function add_scale(field, row, complain)
  if row.scale == nil and row.offset == nil then return end
  local scale, zero = row.scale == nil and 1 or row.scale, row.offset == nil and 0 or row.offset
  if not check.is_finite(scale) or scale == 0 then return complain("scale %s is not a number but 0", shown(scale)) end
  if not check.is_finite(zero) then return complain("offset %s is not a number", shown(zero)) end
  if row.values ~= nil or row.flags ~= nil or row.bits ~= nil then
    return complain("a field has a scale, or values, flags and bits, not both")
  end
  field.scale, field.zero = scale + 0.0, zero + 0.0 -- COMPAT 5.4: products of integers wrap around
end

-- min and max make a compressed float of the bytes; without them float32 and float64 are IEEE 754's.
local function add_range(field, row, complain)
  if row.min == nil and row.max == nil and (field.size == 4 or field.size == 8) then
    field.kind = "ieee"
    return
  end
  if not (check.is_finite(row.min) and check.is_finite(row.max) and row.min < row.max) then
    return complain("%s needs min and max, min below max", field.type)
  end
  field.min, field.max = row.min + 0.0, row.max + 0.0 -- COMPAT 5.4: products of integers wrap around
  if not check.is_finite((math.abs(field.min) + math.abs(field.max)) * field.top) then
    return complain("%s: a range from %s to %s is too wide to calculate with", field.type, shown(row.min),
      shown(row.max))
  end
  -- A double holds the counts of six bytes; those of more are read with the reserved ones set apart.
  field.ordinary = field.size > 6 and field.top or field.top - 5
end

-- The options that every kind of field shares; where it has none of them they are not there.
local function add_options(field, row, complain)
  if row.unit ~= nil and not is_text(row.unit) then complain("unit must be a text") end
  field.unit = row.unit
  if row.values ~= nil then
    check_values(field, row.values, complain)
    field.values = row.values
  end
  if row.invalid ~= nil and not (INVALID[row.invalid] and row.values) then
    complain("invalid is value.invalid or command.key.invalid, for a field with values")
  end
  field.invalid = row.invalid or ((row.values or field.kind == "bool") and "value.invalid") or nil
  add_scale(field, row, complain)
end

local function check_flag_options(row, complain)
  if row.alarm ~= nil and not (is_text(row.alarm) and row.flags) then
    return complain("alarm is a word, for a field with flags")
  end
  if row.values ~= nil and (row.flags ~= nil or row.bits ~= nil) then
    return complain("a field has values or flags, not both")
  end
  if row.count ~= nil and (row.flags ~= nil or row.bits ~= nil) then
    return complain("flags and bits are not for an array")
  end
  if row.group ~= nil and row.flags == nil and row.bits == nil then
    return complain("group is for a field with flags")
  end
  return true
end

-- The width of a row's type; says what is wrong with `length` and returns nothing.
local function size_of(row, def, complain)
  if def.size then return def.size end
  if is_integer(row.length) and row.length >= 1 and row.length <= MAX_SIZE then return row.length end
  complain("%s needs a length in bytes", row[2])
end

-- One field of a row, without its place; and { part, row } of the parts in its bits.
local function compile_field(message, row, complain)
  local def = types.TYPES[row[2]]
  local size = size_of(row, def, complain)
  if not size then return end
  local field = { name = row[1], title = row[3], type = row[2], kind = def.kind, size = size, top = def.top,
    bottom = def.bottom, filter = message.filter .. "." .. row[1] }
  if field.kind == "float" then add_range(field, row, complain) end
  if not check_flag_options(row, complain) then return end
  add_options(field, row, complain)
  local parts = {}
  if row.flags ~= nil or row.bits ~= nil then parts = flags.add(field, row, message.filter, complain) end
  for _, part in ipairs(parts) do
    part[1].filter = message.filter .. "." .. part[1].name
    add_options(part[1], part[2], complain)
  end
  return field, parts
end

-- Puts a field at its place in the message: returns whether it fits there.
local function add_field(build, field, complain)
  local message = build.message
  if message.by_name[field.name] then return complain("the name is there twice") end
  if #message.fields >= M.MAX_ROWS then return complain("with it the message has more than %d fields", M.MAX_ROWS) end
  field.offset, field.when = build.offset, build.when
  message.fields[#message.fields + 1] = field
  message.by_name[field.name], message.index[field] = field, #message.fields
  if field.kind == "time" and not build.when then message.time = message.time or field end
  if field.alarm then message.alarms[#message.alarms + 1] = field end
  return true
end

-- An array is its elements: fields of their own with one filter name.
local function add_elements(build, field, count, complain)
  if not is_integer(count) or count < 1 or count > M.MAX_ROWS then
    return complain("count %s is not one of 1 .. %d", shown(count), M.MAX_ROWS)
  end
  for i = 1, count do
    local element = {}
    for key, value in pairs(field) do element[key] = value end
    element.name, element.title = ("%s_%d"):format(field.name, i), ("%s %d"):format(field.title, i)
    element.element, element.array_title = i, field.title
    if not add_field(build, element, complain) then return end
    build.offset = build.offset + element.size
  end
end

local add_rows

local function sorted_cases(row, field, complain)
  if type(row.cases) ~= "table" then return complain("cases must be a table, not %s", shown(row.cases)) end
  local keys, key = {}, next(row.cases)
  while key ~= nil do
    if not is_integer(key) or key < field.bottom or key > field.top then
      return complain("case %s does not fit %s", shown(key), field.name)
    end
    if #keys >= M.MAX_ROWS then return complain("more than %d cases", M.MAX_ROWS) end
    if type(row.cases[key]) ~= "table" then return complain("case %s is not a list of rows", shown(key)) end
    keys[#keys + 1] = key
    key = next(row.cases, key)
  end
  table.sort(keys)
  return keys
end

-- The cases lie over one another, as in a union of C: the longest says where the message goes on.
local function add_variants(build, row, complain)
  local message, start, longest = build.message, build.offset, build.offset
  local by = type(row.by) == "string" and message.by_name[row.by]
  if build.when then return complain("variants are not for a case of others") end
  if row.by and build.failed[row.by] then return end -- that is said already
  if not by or not (by.kind == "uint" or by.kind == "int" or by.kind == "bool") or by.size > 4 or by.cases then
    return complain("by %s is not an earlier integer of the message, one for each row of variants", shown(row.by))
  end
  local keys = sorted_cases(row, by, complain)
  if not keys then return end
  by.cases, by.invalid = {}, by.invalid or "value.invalid"
  for _, key in ipairs(keys) do
    by.cases[key], build.offset, build.when = true, start, { index = message.index[by], value = key }
    add_rows(build, row.cases[key])
    longest = math.max(longest, build.offset)
  end
  build.offset, build.when = longest, nil
end

local function add_row(build, row, complain)
  local name, def = row[1], types.TYPES[row[2]]
  if not is_name(name) then return complain("%s is not a filter name (a-z, 0-9, _)", shown(name)) end
  if not def then build.failed[name] = true end
  if not def then return complain("unknown type %s; the types are %s", shown(row[2]), types.NAMES) end
  build.failed[name] = not check.check_options(row, "type " .. row[2], def.options, complain, 3) or nil
  if build.failed[name] then return end
  if def.kind == "variants" then return add_variants(build, row, complain) end
  if def.kind == "padding" then
    build.offset = build.offset + (size_of(row, def, complain) or 0)
    return
  end
  if not is_text(row[3]) then return complain("the title is missing") end
  local field, parts = compile_field(build.message, row, complain)
  if not field then
    build.failed[name] = true
    return
  end
  if row.count ~= nil then return add_elements(build, field, row.count, complain) end
  if not add_field(build, field, complain) then return end
  for _, part in ipairs(parts) do add_field(build, part[1], complain) end
  build.offset = build.offset + field.size
end

-- Fields in the order of the rows; build.offset is then behind the last.
function add_rows(build, rows)
  if #rows > M.MAX_ROWS then
    return check.complainer(build.where, build.problems)("more than %d fields", M.MAX_ROWS)
  end
  for i = 1, #rows do
    local row = rows[i]
    local label = type(row) == "table" and is_name(row[1]) and row[1] or tostring(i)
    local complain = check.complainer(build.where .. ", field " .. label, build.problems)
    if type(row) == "table" then
      add_row(build, row, complain)
    else
      complain("a field is a row { name, type, title }, not %s", shown(row))
    end
  end
end

--- Compiles the rows of a message into its fields, by_name, index, time and alarms.
-- message   compiled as far as its name; where: what an error begins with; problems: gets the errors
-- returns   the sum of the sizes in bytes
function M.compile(message, rows, where, problems)
  local build = { message = message, where = where, problems = problems, offset = 0, when = nil, failed = {} }
  add_rows(build, rows)
  return build.offset
end

return M
