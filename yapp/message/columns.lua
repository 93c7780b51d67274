-- SPDX-License-Identifier: GPL-2.0-or-later
-- A message as a row of CSV: its columns, and the cells of a payload.  Pure Lua, 5.2 and 5.4.
--
-- An enum is its number and, in NAME_text, its meaning; flags are the integer and, in GROUP_FLAG, 0 or 1; a float that
-- is no ordinary number is an empty cell and what it is in NAME_special.  The row of a message is made by a function
-- that is generated for it: out[1] = format("%.7g,", (-8387840 + raws[1] * 256) / 65530) and so on.

local bits = require("yapp.base.bits")
local decode = require("yapp.message.decode")
local numbers = require("yapp.message.numbers")

local M = {}

local format, concat = string.format, table.concat

-- What the rows of every message begin with, and a name that a reader may add.
local TAKEN = { "time", "frame", "bus", "source", "id", "seq", "crc_good" }
local SPECIALS = { [0] = ",nan", ",inf", ",-inf", ",above", ",below" } -- an empty cell, and the one beside it
local MOST_CELLS = 1024

--- A text as a cell of CSV: in quotes where it must be.
function M.quoted(text)
  if text:find('[,"\r\n]') then return '"' .. text:gsub('"', '""') .. '"' end
  return text
end

-- Columns -----------------------------------------------------------------------------------------------------------

local INTEGERS = { uint = true, int = true, flags = true }

-- The columns of a field: { name, type, the flag that it is } each.
local function columns_of(field)
  local kind, name = field.kind, field.name
  if kind == "float" or kind == "ieee" then return { { name, "float" }, { name .. "_special", "string" } } end
  if kind == "time" or kind == "bool" then return { { name, kind } } end
  if not INTEGERS[kind] then return { { name, "string" } } end
  if field.values then return { { name, "integer" }, { name .. "_text", "string" } } end
  local columns = { { name, field.scale and "float" or "integer" } }
  local group = field.group and field.group:match("[^.]+$")
  for _, flag in ipairs(field.flags or {}) do columns[#columns + 1] = { group .. "_" .. flag.name, "bool", flag } end
  return columns
end

local columns_by_message = setmetatable({}, { __mode = "k" })

local function make_columns(message)
  local columns, taken = {}, {}
  for _, name in ipairs(TAKEN) do taken[name] = true end
  for _, field in ipairs(message.fields) do
    for i, column in ipairs(columns_of(field)) do
      local name, count = column[1], 1
      while taken[name] do
        count = count + 1
        name = column[1] .. "_" .. count
      end
      taken[name] = true
      local unit = i == 1 and (field.kind == "time" and "s" or field.unit) or nil
      columns[#columns + 1] = { name = name, unit = unit, type = column[2], field = field, flag = column[3] }
    end
  end
  return columns
end

--- The columns of a message, in order.
-- returns  a list of { name =, unit = or nil, type = "float", "integer", "bool", "string" or "time" (seconds),
--          field =, flag = of one of flags }; a name that another column has already ("time", "id") gets "_2" behind it
function M.columns(message)
  local columns = columns_by_message[message]
  if not columns then
    columns = make_columns(message)
    columns_by_message[message] = columns
  end
  return columns
end

-- Cells -------------------------------------------------------------------------------------------------------------

-- The cells of a field as a text, from its raw value, by kind; of few values each is made once.
local cells = {}

function cells.float(field, raw)
  local value, special = decode.float(field, raw)
  return special and SPECIALS[special] or format(decode.format_of(field) .. ",", value)
end

function cells.ieee(field, raw)
  local value, special = decode.value(field, raw)
  if special then return SPECIALS[special] end
  if field.size == 4 then return format("%.9g,", numbers.shortest(value, 4)) end
  local text = format("%.15g,", value)
  return tonumber(text:sub(1, -2)) == value and text or format("%.17g,", value)
end

function cells.uint(field, raw)
  if field.scale then return format("%.15g", decode.value(field, raw)) end
  local text = type(raw) == "number" and format("%.0f", raw) or raw
  return field.values and text .. "," .. M.quoted(field.values[raw] or "") or text
end

function cells.flags(field, raw)
  local texts = { format("%.0f", raw) }
  for i, flag in ipairs(field.flags) do texts[i + 1] = bits.band(raw, flag.mask) ~= 0 and "1" or "0" end
  return concat(texts, ",")
end

function cells.string(field, raw) return M.quoted(decode.value(field, raw)) end

cells.int, cells.bytes = cells.uint, cells.string
function cells.bool(_, raw) return raw == 0 and "0" or "1" end

-- A function of the raw value that keeps what it made in a table, as long as that is not too much.
local function remembering(field, known)
  local count, make = 0, cells[field.kind]
  return function(raw)
    if count >= MOST_CELLS then
      for key in pairs(known) do known[key] = nil end
      count = 0
    end
    local text = make(field, raw)
    known[raw], count = text, count + 1
    return text
  end
end

-- Which kinds have few values: they repeat from message to message.
local function has_few(field)
  return field.size == 1 or field.kind == "flags" or field.values ~= nil
end

-- Rows --------------------------------------------------------------------------------------------------------------

local MOST_CALLS = 50 -- of a row in one format: a function has up to 200 local variables, a call 250 arguments

-- Whether a field is a compressed float that one format writes, if it has no special value.
local function is_formatted(field)
  return field.kind == "float" and not has_few(field) and field.size <= 6
end

-- What a field's cells are, as an expression.
local function cell_source(field, i)
  if field.kind == "time" then return format("seconds(time(payload, %d))", field.offset) end
  if not has_few(field) then return format("CELLS[%d](raws[%d])", i, i) end
  return format("KNOWN[%d][raws[%d]] or CELLS[%d](raws[%d])", i, i, i, i)
end

-- The usual row: one format.  A message with fields that are there in some cases only has none, nor one of many fields
-- or of padding only.
local function usual_source(message)
  local lines, formats, values = {}, {}, {}
  if not message.fields[1] then return "" end
  for i, field in ipairs(message.fields) do
    if field.when or i > MOST_CALLS then return "" end
    if is_formatted(field) then
      lines[#lines + 1] = format("local a%d = raws[%d]\nif a%d > %d then return nil end", i, i, i, field.ordinary)
      formats[i], values[i] = decode.format_of(field) .. ",", decode.float_source(field, "a" .. i)
    else
      formats[i], values[i] = "%s", cell_source(field, i)
    end
  end
  return format('%s\nreturn format("%s", %s)', concat(lines, "\n"), concat(formats, ","), concat(values, ", "))
end

-- Any row: cell by cell.
local function line_source(field, i)
  if not is_formatted(field) then return format("out[%d] = %s", i, cell_source(field, i)) end
  return format('a = raws[%d]\nif a > %d then out[%d] = SPECIALS[%d - a] else out[%d] = format("%s,", %s) end', i,
    field.ordinary, i, field.top, i, decode.format_of(field), decode.float_source(field, "a"))
end

local function row_source(message)
  local lines = { "local KNOWN, CELLS, SPECIALS, EMPTY, out, format, concat, time, seconds = ...",
    "local function usual(payload, raws)", usual_source(message), "end", "return function(payload, raws)",
    "local a = usual(payload, raws) if a then return a end" }
  for i, field in ipairs(message.fields) do
    local line, when = line_source(field, i), field.when
    if when then
      line = format("if raws[%d] == %d then %s else out[%d] = EMPTY[%d] end", when.index, when.value, line, i, i)
    end
    lines[#lines + 1] = line
  end
  lines[#lines + 1] = format('return concat(out, ",", 1, %d) end', #message.fields)
  return concat(lines, "\n")
end

-- The writer of a message: { row, version of the divisor }.
local function make_writer(message)
  local known, made, empty = {}, {}, {}
  for i, field in ipairs(message.fields) do
    local make = cells[field.kind]
    known[i] = {}
    made[i] = has_few(field) and remembering(field, known[i]) or make and function(raw) return make(field, raw) end
    empty[i] = (","):rep(#columns_of(field) - 1)
  end
  local chunk = assert(load(row_source(message), "=row of " .. message.name))
  local row = chunk(known, made, SPECIALS, empty, {}, format, concat, decode.time, decode.seconds)
  return { row = row, version = select(2, decode.divisor()) }
end

local writers = setmetatable({}, { __mode = "k" })

--- The cells of a message, joined by commas, in the order of its columns; quoted where they must be.
-- payload  string; nil is returned where it is shorter than the message
function M.row(message, payload)
  if #payload < message.size then return nil end
  local writer = writers[message]
  local _, version = decode.divisor()
  if not writer or writer.version ~= version then
    writer = make_writer(message)
    writers[message] = writer
  end
  return writer.row(payload, (decode.read(message, payload)))
end

return M
