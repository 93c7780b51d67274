-- SPDX-License-Identifier: GPL-2.0-or-later
-- A message as a row of CSV: its columns, and the cells of a payload.  Pure Lua.
--
-- An enum is its number and, in NAME_text, its meaning; flags are the integer and, in GROUP_FLAG, 0
-- or 1; a float that is no ordinary number is an empty cell and what it is in NAME_special.

local common = require("yapp.base.bits").common
local decode = require("yapp.message.decode")
local straight = require("yapp.message.straight")

local M = {}

local format, concat = string.format, table.concat

-- What the rows of every message begin with, and a name that a reader may add.
local TAKEN = { "time", "frame", "bus", "source", "id", "seq", "crc_good" }
-- An empty cell, and the one beside it.
local SPECIALS = { [0] = ",nan", ",inf", ",-inf", ",above", ",below" }

--- A text as a cell of CSV: in quotes where it must be.
function M.quoted(text)
  if text:find('[,"\r\n]') then return '"' .. text:gsub('"', '""') .. '"' end
  return text
end

-- Columns ----------------------------------------------------------------------------------------

local INTEGERS = { uint = true, int = true, flags = true }

-- The columns of a field: { name, type, the flag that it is } each.
local function columns_of(field)
  local kind, name = field.kind, field.name
  if kind == "derived" then return { { name, "float" } } end
  if field.special then
    return { { name, "float" }, { name .. "_special", "string" } }
  end
  if kind == "time" or kind == "bool" then
    return { { name, kind } }
  end
  if not INTEGERS[kind] then
    return { { name, "string" } }
  end
  if field.values then
    return { { name, "integer" }, { name .. "_text", "string" } }
  end
  local columns = { { name, field.scale and "float" or "integer" } }
  local group = field.group and field.group:match("[^.]+$")
  for _, flag in ipairs(field.flags or {}) do
    columns[#columns + 1] = { group .. "_" .. flag.name, "bool", flag }
  end
  return columns
end

-- The fields of a message, and behind them its derived values.
local function fields_of(message)
  local list = {}
  for _, field in ipairs(message.fields) do list[#list + 1] = field end
  for _, item in ipairs(message.derived) do list[#list + 1] = item end
  return list
end

--- The columns of a message, in order.
-- returns  a list of { name =, unit = or nil, type = "float", "integer", "bool", "string" or "time"
--          (seconds), field = or item of message.derived, flag = of one of flags }; a name that
--          another column has already ("time", "id") gets "_2" behind it
function M.columns(message)
  local columns, taken = {}, {}
  for _, name in ipairs(TAKEN) do taken[name] = true end
  for _, field in ipairs(fields_of(message)) do
    for i, column in ipairs(columns_of(field)) do
      local name, count = column[1], 1
      while taken[name] do
        count = count + 1
        name = column[1] .. "_" .. count
      end
      taken[name] = true
      local unit = i == 1 and (field.kind == "time" and "s" or field.unit) or nil
      columns[#columns + 1] = {
        name = name,
        unit = unit,
        type = column[2],
        field = field,
        flag = column[3],
      }
    end
  end
  return columns
end

-- Cells ------------------------------------------------------------------------------------------

-- The cells of a field as a text, from its raw value and the payload, by kind.
local cells = {}

function cells.float(field, raw)
  local value, special = decode.value(field, raw)
  if special then return SPECIALS[special] end
  return format(decode.format_of(field) .. ",", value)
end

function cells.ieee(field, raw)
  local value, special = decode.value(field, raw)
  if special then return SPECIALS[special] end
  value = decode.rounded(field, value)
  local text = format("%.15g", value)
  if tonumber(text) ~= value then text = format("%.17g", value) end
  return text .. ","
end

function cells.uint(field, raw)
  if field.scale then return format("%.15g", decode.value(field, raw)) end
  local text, values = decode.digits(raw), field.values
  if not values then return text end
  return text .. "," .. M.quoted(values[raw] or "")
end

function cells.flags(field, raw)
  local texts = { decode.digits(raw) }
  for i, flag in ipairs(field.flags) do
    texts[i + 1] = common(raw, flag.mask) ~= 0 and "1" or "0"
  end
  return concat(texts, ",")
end

function cells.string(field, raw)
  return M.quoted(decode.value(field, raw))
end

function cells.bool(_, raw)
  return raw == 0 and "0" or "1"
end

cells.int = cells.uint
cells.bytes = cells.string

function cells.time(_, raw)
  return decode.seconds(decode.time(raw, 0))
end

-- A function that writes the cells of a field; the latest ones are kept: flags seldom change.
-- Of a derived value it takes all raws; nil where it has none.
local function new_write(message, field)
  if field.kind == "derived" then
    return function(raws)
      local value = decode.derived(message, field, raws)
      return value and format("%.7g", value)
    end
  end
  local make, last, text = cells[field.kind], nil, nil
  return function(raw)
    if raw ~= last then
      last = raw
      text = make(field, raw)
    end
    return text
  end
end

-- Rows -------------------------------------------------------------------------------------------

-- How the row of a message is written: { parts = list of { field, index = of the field, nil for a
-- derived value, write, empty = cells of nothing }, usual = function(raws) -> the row, nil for one
-- with absent or special values }.
local function new_row(message)
  local parts, plain, shapes = {}, {}, {}
  local is_usual = #message.fields > 0
  for i, field in ipairs(fields_of(message)) do
    local is_plain = straight.is_plain(field)
    parts[i] = {
      field = field,
      index = message.index[field],
      write = new_write(message, field),
      empty = (","):rep(#columns_of(field) - 1),
    }
    plain[i] = is_plain and { field = field, index = i } or parts[i]
    shapes[i] = is_plain and decode.format_of(field) .. "," or "%s"
    is_usual = is_usual and not field.when
  end
  local usual = is_usual and straight.writer(plain, concat(shapes, ",")) or function() end
  return { parts = parts, usual = usual }
end

local rows = setmetatable({}, { __mode = "k" }) -- by message

--- The cells of a message, joined by commas, in the order of its columns; quoted where they must
-- be.
-- payload  string; fields that are not wholly in it are empty cells
function M.row(message, payload)
  local row = rows[message]
  if not row then
    row = new_row(message)
    rows[message] = row
  end
  local raws = decode.read(message, payload)
  local usual = row.usual(raws)
  if usual then return usual end
  local texts = {}
  for i, part in ipairs(row.parts) do
    local raw = not part.index and raws or raws[part.index]
    texts[i] = raw and part.write(raw) or part.empty
  end
  return concat(texts, ",")
end

return M
