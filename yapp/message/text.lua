-- SPDX-License-Identifier: GPL-2.0-or-later
-- A message as a text: its values in the Info column, and a row of CSV.  Pure Lua.
--
-- In CSV an enum is its number and, in NAME_text, its meaning; flags are the integer and, in
-- GROUP_FLAG, 0 or 1; a float with a reserved value is an empty cell, and NAME_special names the
-- value.

local band = require "yapp.base.bits".band
local field_kinds = require "yapp.message.field_kinds"
local input = require "yapp.base.input"
local memo = require "yapp.base.memo"

local M = {}

local format, concat = string.format, table.concat
local KINDS = field_kinds.BY_NAME

-- Writers ----------------------------------------------------------------------------------------

-- A message is written in pieces: texts, and tables {
--   index   of a field; nil for a value that is worked out from all raws
--   field
--   write   function(raw) -> text; where index is nil, it takes all raws
--   absent  the text of a missing field
--   shape   a format for the value of a compressed float, or of two, see value_source; else false }

local MAX_PIECES = 100 -- of a usual message: a function has up to 200 local variables
local SOURCE = [[
local WRITE, SHAPE, format, write_slowly = ...
return function(raws)
%s
return format(%s)
end]]

-- Return the value of a compressed float as source, see field_kinds.value; also of a value that is
-- worked out from two of them.  Nil for others.
-- raws  [field] = the name of its raw value
local function value_source(field, raws)
  if field.kind == "derived" then
    local a, b = value_source(field.a, raws), value_source(field.b, raws)
    return a and b and format("%s %s %s", a, field.operator, b)
  end
  if field.kind ~= "float" or not raws[field] then return nil end
  local steps, span = field.top - field_kinds.below_top, field.max - field.min
  return format("((%.17e + %s * %.17e) / %.17e)", field.min * steps, raws[field], span, steps)
end

-- Write the pieces one by one.
local function write_each(pieces, raws)
  local texts = {}
  for i, piece in ipairs(pieces) do
    local text = piece
    if type(piece) == "table" then
      local raw = raws
      if piece.index then raw = raws[piece.index] end
      text = raw and piece.write(raw) or piece.absent
    end
    texts[i] = text
  end
  return concat(texts)
end

-- Return a piece as source: a line that has its raw value, and the value to format.
-- index  of the piece
-- raws   [field] = the name of its raw value, of the pieces before it
local function piece_source(piece, index, raws)
  local field, name = piece.field, "a" .. index
  local raw = piece.index and format("raws[%d]", piece.index) or "raws"
  local condition, value = "not " .. name, format("WRITE[%d](%s)", index, name)
  if piece.index then raws[field] = name end
  local source = piece.shape and value_source(field, raws)
  if source and piece.index then
    condition = format("%s or %s < 0 or %s > %.0f", condition, name, name, field.ordinary)
    value = source
  elseif source then -- the value may be too large
    raw, condition, value = source, format("%s - %s ~= 0", name, name), name
  end
  local line = "local %s = %s if %s then return write_slowly(raws) end"
  return format(line, name, raw, condition), value, source and piece.shape or "%s"
end

-- Make a function(raws) -> text that writes a usual message, which has all fields and no reserved
-- value, at once.  It is made from Lua source: a loop over the pieces would make a packet list 6 %
-- slower, and a table 13 %.
local function new_writer(pieces)
  local function write_slowly(raws) return write_each(pieces, raws) end
  if #pieces > MAX_PIECES then return write_slowly end
  local lines, writes, values, shapes, raws = {}, {}, { "SHAPE" }, {}, {}
  for i, piece in ipairs(pieces) do
    if type(piece) == "string" then
      shapes[i] = piece:gsub("%%", "%%%%")
    else
      writes[i] = piece.write
      lines[#lines + 1], values[#values + 1], shapes[i] = piece_source(piece, i, raws)
    end
  end
  local source = format(SOURCE, concat(lines, "\n"), concat(values, ", "))
  return load(source, "=writer")(writes, concat(shapes), format, write_slowly)
end

--- Return the function(raws) -> text that writes pieces: of M.compile_info, or of a row.
function M.writer_of(pieces)
  if pieces.below_top ~= field_kinds.below_top then -- the user may choose another divisor
    pieces.below_top, pieces.write = field_kinds.below_top, new_writer(pieces)
  end
  return pieces.write
end

-- The Info column --------------------------------------------------------------------------------

-- Return the piece of a field, and " V" if its unit follows, else nil.
-- rest  the text behind its name: ":%.1f unit"
local function info_piece(of_type, name, rest)
  local field = of_type.by_name[name]
  input.demand(field, "info names a field %s that is not there", input.shown(name))
  local before = rest:match("^(.-) unit$")
  local shape = (before or rest):gsub("^:", "")
  input.demand(not before or field.unit, "info: %s has no unit", name)
  local is_real = field.special or field.scale
  input.demand(shape == "" or is_real and shape:find("^%%%.?%d?[fg]$"),
    "info: the format %s is not one for %s", input.shown(shape), name)
  if shape == "" then shape = is_real and "%.4g" end
  return {
    field = field,
    index = field.index,
    shape = field.kind == "float" and shape,
    write = KINDS[field.kind].info(field, shape),
    absent = "-",
  }, before and " " .. field.unit
end

--- Compile the text of a message's values in Info.
-- text     "{name:%.1f unit}" is "47.3 V"; "{name}" is without the unit, and with as many digits as
--          make sense
-- returns  pieces for M.writer_of.  It raises errors.
function M.compile_info(of_type, text)
  local pieces, index = {}, 1
  while index do
    local from, to, name, rest = text:find("{([%w_]+)([^}]*)}", index)
    local unit = nil
    pieces[#pieces + 1] = text:sub(index, (from or 0) - 1)
    if from then pieces[#pieces + 1], unit = info_piece(of_type, name, rest) end
    pieces[#pieces + 1] = unit or nil
    index = to and to + 1
  end
  return pieces
end

--- Return the filter names of the flags that are set, undefined bits as one number:
-- "motor_overcurrent, hall_timeout, undefined 0x80000".
function M.flag_names(field, raw)
  if raw == 0 then return "" end
  if raw == field.named then return field.names end -- cached: they seldom change
  local names = {}
  for _, flag in ipairs(field.flags) do
    if band(raw, flag.mask) ~= 0 then names[#names + 1] = flag.name end
  end
  local undefined = band(raw, field.undefined)
  if undefined ~= 0 then names[#names + 1] = format("undefined 0x%x", undefined) end
  field.named, field.names = raw, concat(names, ", ")
  return field.names
end

--- Return the names of the fault flags that are set, "" for none.
-- raw  nil where the payload does not have the field
function M.fault_names(field, raw)
  return M.flag_names(field, band(raw or 0, field.alarm_bits))
end

--- Return the text of the Info column about the faults that are set:
-- "FAULT motor_overcurrent, faulted", "" for none.
-- raws  of the message's reader
function M.faults(of_type, raws)
  local text, word = "", nil
  for _, field in ipairs(of_type.alarms) do
    local names = M.fault_names(field, raws[field.index])
    if names ~= "" then
      local before = ", "
      if field.fault_word ~= word then before = (word and "  " or "") .. field.fault_word .. " " end
      text = text .. before .. names
      word = field.fault_word
    end
  end
  return text
end

-- CSV --------------------------------------------------------------------------------------------

-- Names of columns that stat.csv puts in front of a message's own.
local TAKEN = { "time", "frame", "bus", "source", "id", "seq", "crc_good" }

-- Return the columns of a field or derived value, { name, type, flag or nil } each.
local function columns_of(field)
  local columns = { { field.name, KINDS[field.kind].column } }
  if field.special then columns[2] = { field.name .. "_special", "string" } end
  if field.values then columns[2] = { field.name .. "_text", "string" } end
  for i, flag in ipairs(field.flags or {}) do
    columns[i + 1] = { field.group:match("[^.]+$") .. "_" .. flag.name, "bool", flag }
  end
  return columns
end

-- Call visit(field, its columns) for the fields and derived values of a message.
local function each(of_type, visit)
  for _, list in ipairs { of_type.fields, of_type.derived } do
    for _, field in ipairs(list) do visit(field, columns_of(field)) end
  end
end

--- List the columns of a message, in order.
-- returns  a list of { name =, unit = or nil, type = "float", "integer", "bool", "string" or "time"
--          (seconds), field = or item of message.derived, flag = for the column of a flag }; a name
--          that another column has already ("time", "id") gets "_2" behind it
function M.columns(of_type)
  local columns, taken = {}, {}
  for _, name in ipairs(TAKEN) do taken[name] = true end
  each(of_type, function(field, list)
    for i, column in ipairs(list) do
      local name, count = column[1], 1
      while taken[name] do
        count = count + 1
        name = column[1] .. "_" .. count
      end
      taken[name] = true
      columns[#columns + 1] = {
        name = name,
        unit = i == 1 and (field.unit or KINDS[field.kind].unit) or nil,
        type = column[2],
        field = field,
        flag = column[3],
      }
    end
  end)
  return columns
end

-- [message] = the pieces of its cells
local rows = memo(function(of_type)
  local pieces = {}
  each(of_type, function(field, columns)
    if pieces[1] then pieces[#pieces + 1] = "," end
    pieces[#pieces + 1] = {
      field = field,
      index = field.index,
      shape = field.kind == "float" and field.shape .. "," or
        field.kind == "derived" and field.shape,
      write = field_kinds.cells_of(field),
      absent = (","):rep(#columns - 1),
    }
  end)
  return pieces
end)

--- Return the function(raws) -> the cells of a message, joined by commas, in the order of its
-- columns; quoted where they must be, empty for fields that are absent.
function M.row_writer(of_type)
  return M.writer_of(rows[of_type])
end

return M
