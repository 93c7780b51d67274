-- SPDX-License-Identifier: GPL-2.0-or-later
-- A message as a row of CSV: its columns, and the cells of its values.  Pure Lua.
--
-- An enum is its number and, in NAME_text, its meaning; flags are the integer and, in GROUP_FLAG, 0
-- or 1; a float with a reserved value is an empty cell, and NAME_special names the value.

local common = require("yapp.base.bits").common
local decode = require("yapp.message.decode")
local writer = require("yapp.message.writer")

local M = {}

local format = string.format

-- Columns in front of those of a message, see stat.csv; crc_good only with its option all.
local TAKEN = { "time", "frame", "bus", "source", "id", "seq", "crc_good" }
-- The cells of a reserved value: no number, and its name.
local SPECIALS = { [0] = ",nan", ",inf", ",-inf", ",above", ",below" }

--- Return a text as a cell of CSV: in quotes where it must be.
function M.quoted(text)
  if text:find('[,"\r\n]') then return '"' .. text:gsub('"', '""') .. '"' end
  return text
end

-- Kinds of fields --------------------------------------------------------------------------------

-- function(field) -> its columns, { name, type, flag or nil } each, and function(raw) -> their
-- cells as a text
local KINDS = {}

local function of_float(field)
  local function write(raw)
    local value, special = decode.value(field, raw)
    return SPECIALS[special] or decode.number_text(field, value) .. ","
  end
  return { { field.name, "float" }, { field.name .. "_special", "string" } }, write
end

local function of_integer(field)
  local name, values = field.name, field.values
  if not values then return { { name, "integer" } }, decode.digits end
  return { { name, "integer" }, { name .. "_text", "string" } }, function(raw)
    return decode.digits(raw) .. "," .. M.quoted(values[raw] or "")
  end
end

local function of_text(field)
  return { { field.name, "string" } }, function(raw) return M.quoted(decode.value(field, raw)) end
end

KINDS.float, KINDS.ieee = of_float, of_float
KINDS.uint, KINDS.int = of_integer, of_integer
KINDS.string, KINDS.bytes = of_text, of_text

function KINDS.scaled(field)
  return { { field.name, "float" } }, function(raw)
    return decode.number_text(field, decode.value(field, raw))
  end
end

function KINDS.bool(field)
  return { { field.name, "bool" } }, function(raw) return raw == 0 and "0" or "1" end
end

function KINDS.time(field)
  return { { field.name, "time" } }, function(raw) return decode.seconds(decode.time(raw, 0)) end
end

function KINDS.flags(field)
  local columns, group = { { field.name, "integer" } }, field.group:match("[^.]+$")
  for _, flag in ipairs(field.flags) do
    columns[#columns + 1] = { group .. "_" .. flag.name, "bool", flag }
  end
  return columns, function(raw)
    local texts = { decode.digits(raw) }
    for i, flag in ipairs(field.flags) do
      texts[i + 1] = common(raw, flag.mask) ~= 0 and "1" or "0"
    end
    return table.concat(texts, ",")
  end
end

-- Of a generated value, which is worked out from all raws.
function KINDS.derived(item, message)
  return { { item.name, "float" } }, function(raws)
    local value = decode.derived(message, item, raws)
    return value and format("%.7g", value) or ""
  end
end

-- Columns and rows -------------------------------------------------------------------------------

-- Call visit(field, its columns, what writes it) for the fields and derived values of a message.
local function each(message, visit)
  for _, list in ipairs { message.fields, message.derived } do
    for _, field in ipairs(list) do visit(field, KINDS[field.kind](field, message)) end
  end
end

--- List the columns of a message, in order.
-- returns  a list of { name =, unit = or nil, type = "float", "integer", "bool", "string" or "time"
--          (seconds), field = or item of message.derived, flag = for the column of a flag }; a name
--          that another column has already ("time", "id") gets "_2" behind it
function M.columns(message)
  local columns, taken = {}, {}
  for _, name in ipairs(TAKEN) do taken[name] = true end
  each(message, function(field, list)
    for i, column in ipairs(list) do
      local name, count = column[1], 1
      while taken[name] do
        count = count + 1
        name = column[1] .. "_" .. count
      end
      taken[name] = true
      columns[#columns + 1] = {
        name = name,
        unit = i == 1 and (field.kind == "time" and "s" or field.unit) or nil,
        type = column[2],
        field = field,
        flag = column[3],
      }
    end
  end)
  return columns
end

-- Keep the latest text of a write: flags and the like seldom change.
local function kept(write)
  local latest, text
  return function(raw)
    if raw ~= latest then latest, text = raw, write(raw) end
    return text
  end
end

local function new_row(message)
  local pieces = {}
  each(message, function(field, columns, write)
    if pieces[1] then pieces[#pieces + 1] = "," end
    pieces[#pieces + 1] = {
      field = field,
      index = field.index,
      shape = writer.takes_shape(field) and field.shape .. "," or nil,
      write = field.index and kept(write) or write,
      absent = (","):rep(#columns - 1),
    }
  end)
  return writer.new(pieces)
end

local rows = setmetatable({}, { __mode = "k" }) -- by message

--- Return the cells of a message, joined by commas, in the order of its columns; quoted where they
-- must be, empty for fields that are absent.
-- raws  from decode.read
function M.row(message, raws)
  local write = rows[message]
  if not write then
    write = new_row(message)
    rows[message] = write
  end
  return write(raws)
end

return M
