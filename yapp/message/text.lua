-- SPDX-License-Identifier: GPL-2.0-or-later
-- A message as a text: its values in the Info column, and a row of CSV.  Pure Lua.
--
-- In CSV an enum is its number and, in NAME_text, its meaning; flags are the integer and, in
-- GROUP_FLAG, 0 or 1; a float with a reserved value is an empty cell, and NAME_special names the
-- value.

local band = require "yapp.base.bits".band
local field_kinds = require "yapp.message.field_kinds"
local input = require "yapp.base.input"
local joined = require "yapp.base.joined"
local mapped = require "yapp.base.mapped"
local memo = require "yapp.base.memo"

local M = {}

local format, concat, unpack = string.format, table.concat, rawget(table, "unpack")
local KINDS = field_kinds.BY_NAME

-- Writers ----------------------------------------------------------------------------------------

-- A text is written in pieces, each {
--   before  text before the value
--   index   of the field; nil for a derived value
--   write   function(raw) -> text; of a derived value, function(raws)
--   absent  the text of a missing field
--   number, shape  of a compressed float: function(raw) -> its value, nil for a reserved one; of a
--           derived value, function(raws) -> it, NaN for none; and its format }
-- and end with the text `after`.

-- Write the pieces one by one: a message that lacks a field, or has a reserved value.
local function write_each(pieces, raws)
  local texts = {}
  for i, piece in ipairs(pieces) do
    local raw = raws
    if piece.index then raw = raws[piece.index] end
    texts[i] = piece.before .. (raw and piece.write(raw) or piece.absent)
  end
  return concat(texts) .. pieces.after
end

-- Make a function(raws) -> text.  A usual message is formatted at once: piece by piece, a table of
-- CSV takes 10 % longer.
local function new_writer(pieces)
  local shapes, indexes, readers, values, count = {}, {}, {}, {}, #pieces
  for i, piece in ipairs(pieces) do
    shapes[i] = piece.before:gsub("%%", "%%%%") .. (piece.shape or "%s")
    indexes[i], readers[i] = piece.index or false, piece.number or piece.write
  end
  local shape = concat(shapes) .. pieces.after:gsub("%%", "%%%%")
  return function(raws)
    for i = 1, count do
      local index, raw = indexes[i], raws
      if index then raw = raws[index] end
      local value = raw and readers[i](raw)
      if not value or value ~= value then return write_each(pieces, raws) end
      values[i] = value
    end
    return format(shape, unpack(values, 1, count))
  end
end

-- The Info column --------------------------------------------------------------------------------

local SPECIAL_WORDS = { [0] = "NaN", "+inf", "-inf", "above range", "below range" }

-- Return a function(raw) -> the text of a field.
-- shape  a format for a number with a fraction, or nil
local function info_writer(field, shape)
  local kind = KINDS[field.kind]
  local words, unit = field.values, kind.unit and " " .. kind.unit or ""
  local invalid = "invalid " .. (kind.code or "0x%x")
  return function(raw)
    if words then return words[raw] or format(invalid, raw) end
    local value, special = field_kinds.value(field, raw)
    if special then return SPECIAL_WORDS[special] end
    return shape and format(shape, value) or field_kinds.text(field, raw) .. unit
  end
end

--- Compile the text of a message's values in Info.
-- text     "{name:%.1f unit}" is "47.3 V"; "{name}" is without the unit, and with as many digits as
--          make sense
-- returns  function(raws) -> text.  It raises errors.
function M.compile_info(message_type, text)
  local pieces = {}
  local function find(name)
    return input.demand(message_type.by_name[name], "info names a field %q that is not there", name)
  end
  text = text:gsub("{([%w_]+)(%S*) unit}", function(name, shape)
    return ("{%s%s} %s"):format(name, shape, find(name).unit)
  end)
  for before, name, given in text:gmatch("([^{]*){([%w_]+):?([^}]*)}") do
    local field, shape = find(name), given == "" and "%.4g" or given
    pieces[#pieces + 1] = {
      before = before,
      index = field.index,
      number = field.number,
      shape = field.number and shape,
      write = info_writer(field, field.shape and shape),
      absent = "-",
    }
  end
  pieces.after = text:match("[^}]*$")
  return new_writer(pieces)
end

local latest_names = memo() -- [field] = { raw, names }: they seldom change

--- Return the filter names of the flags that are set, faults first, undefined bits as one number:
-- "faulted, running, undefined 0x80".
function M.flag_names(field, raw)
  local latest = latest_names[field]
  if latest.raw == raw then return latest.names end
  local function names_of(bits)
    return mapped(field.flags, function(flag) return band(bits, flag.mask) ~= 0 and flag.name end)
  end
  local faults, undefined = band(raw, field.alarm_bits), band(raw, field.undefined)
  local rest = undefined ~= 0 and format("undefined 0x%x", undefined) or nil
  latest.raw = raw
  latest.names = concat(joined(names_of(faults), names_of(raw - faults), { rest }), ", ")
  return latest.names
end

--- Return the names of the fault flags that are set, "" for none.
-- raw  nil where the payload does not have the field
function M.fault_names(field, raw)
  return M.flag_names(field, band(raw or 0, field.alarm_bits))
end

--- Return the names of all faults that are set in a message: "motor_overcurrent, faulted", "" for
-- none.
-- raws  of the message's reader
function M.faults(message_type, raws)
  return concat(mapped(message_type.alarms, function(field)
    local names = M.fault_names(field, raws[field.index])
    return names ~= "" and names
  end), ", ")
end

-- CSV --------------------------------------------------------------------------------------------

-- The cells of a reserved value: no number, and its name.
local SPECIAL_CELLS = { [0] = ",nan", ",inf", ",-inf", ",above", ",below" }

-- Return the fields and derived values of a message.
local function fields_of(message_type)
  return joined(message_type.fields, mapped(message_type.generated, function(item)
    return not item.is_difference and item
  end))
end

--- List the columns of a message, in order.
-- common   list of those in front of its own
-- returns  a list of these and its own: { name =, unit = or nil, type = "float", "integer", "bool",
--          "string" or "time" (seconds), field = or item of derived values, flag = for the column
--          of a flag }; a name that another column has already ("time", "id") gets "_2" behind it
function M.columns(message_type, common)
  local columns, taken = joined(common), {}
  for _, column in ipairs(common) do taken[column.name] = true end
  local function add(field, name, column_type, unit, flag)
    local own_name, count = name, 1
    while taken[own_name] do
      count = count + 1
      own_name = name .. "_" .. count
    end
    taken[own_name] = true
    columns[#columns + 1] =
      { name = own_name, unit = unit, type = column_type, field = field, flag = flag }
  end
  for _, field in ipairs(fields_of(message_type)) do
    local kind = KINDS[field.kind]
    add(field, field.name, kind.column, field.unit or kind.unit)
    if field.special then add(field, field.name .. "_special", "string") end
    if field.values then add(field, field.name .. "_text", "string") end
    for _, flag in ipairs(field.flags or {}) do
      add(field, field.group:match("[^.]+$") .. "_" .. flag.name, "bool", nil, flag)
    end
  end
  return columns
end

--- Return a text as a cell of CSV: in quotes where it must be.
function M.quoted(text)
  if text:find('[,"\r\n]') then return '"' .. text:gsub('"', '""') .. '"' end
  return text
end

-- Return the cells of a field, or of a derived value.
-- raw  nil where it is absent
local function cells_of(field, raw)
  local value, special = field_kinds.text(field, raw)
  local text = value or ""
  if field.special then return SPECIAL_CELLS[special] or text .. "," end
  if field.values then return text .. "," .. M.quoted(field.values[raw] or "") end
  if not field.flags then return M.quoted(text) end
  if not raw then return (","):rep(#field.flags) end
  for _, flag in ipairs(field.flags) do
    text = text .. (band(raw, flag.mask) ~= 0 and ",1" or ",0")
  end
  return text
end

-- Return a function(raw) -> cells.  It keeps the latest: flags and the like seldom change.
local function cells_writer(field)
  local latest, cells = nil, nil
  return function(raw)
    if raw ~= latest then latest, cells = raw, cells_of(field, raw) end
    return cells
  end
end

--- Return a function(raws) -> the cells of a message, joined by commas, in the order of its
-- columns; quoted where they must be, empty for fields that are absent.
function M.row_writer(message_type)
  local pieces = { after = "" }
  for i, field in ipairs(fields_of(message_type)) do
    local number = field.number or field.operator and field_kinds.reader[field]
    pieces[i] = {
      before = i > 1 and "," or "",
      index = field.index,
      number = number,
      shape = number and field.shape .. (field.special and "," or ""),
      write = cells_writer(field),
      absent = cells_of(field, nil),
    }
  end
  return new_writer(pieces)
end

return M
