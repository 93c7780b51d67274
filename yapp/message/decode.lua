-- SPDX-License-Identifier: GPL-2.0-or-later
-- From the payload of a message to its values, by the compiled catalogue: raw values, little endian
-- ("YAPP Data Types", "YAPP Float Compression", "Time"), their meaning, and which of them are
-- remarkable.  Pure Lua.

local bits = require "yapp.base.bits"
local field_kinds = require "yapp.message.field_kinds"

local M = {}

local concat = table.concat
local byte, find, format = string.byte, string.find, string.format
local band, fast_band = bits.band, bits.fast_band
local KINDS = field_kinds.BY_NAME

local MAX_KEPT = 100 -- bytes of a payload in local variables: a function has up to 200

-- Generated values -------------------------------------------------------------------------------

local OPERATORS = {
  ["*"] = function(a, b) return a * b end,
  ["-"] = function(a, b) return a - b end,
  ["+"] = function(a, b) return a + b end,
}

--- Work out a generated value from its two fields.
-- item     of message.generated
-- returns  a number, unrounded; nil where one of the two fields has no value
function M.derived(message, item, raws)
  local a = field_kinds.value(message.fields[item.a], raws[item.a])
  local b = field_kinds.value(message.fields[item.b], raws[item.b])
  if not (a and b) then return nil end
  -- COMPAT 5.4: products of integers wrap around
  local value = OPERATORS[item.operator](a + 0.0, b + 0.0)
  return value - value == 0 and value or nil -- it may be too large
end

-- Reading ----------------------------------------------------------------------------------------

-- The reader of a message is made from Lua source: a loop over the fields takes 5 % more of a
-- packet list.  The first bytes of a payload are in b1, b2, ...; a missing one is nil.
local READER = [[
local FIELDS, byte, kinds = ...
local fast_band, value_of, is_undefined = kinds.fast_band, kinds.value_of, kinds.is_undefined
return function(payload)
local raws, is_remarkable, a = { %s }, false
local %s = byte(payload, 1, %d)
%s
return raws, is_remarkable
end]]

-- Return the lines that read the i-th field of a message.
local function field_source(field, i)
  local last, when, value = field.offset + field.size, field.when, {}
  local is_there = last <= MAX_KEPT and "b" .. last or "#payload >= " .. last
  if when then is_there = format("%s and raws[%d] == %d", is_there, when.index, when.value) end
  for j = 1, field.size do
    value[j] = format("b%d * %.0f", field.offset + j, 0x100 ^ (j - 1))
  end
  value = concat(value, " + ")
  if field.read ~= field_kinds.read_count or last > MAX_KEPT then
    value = format("FIELDS[%d]:read(payload)", i)
  end
  -- M.remarks finds the same: tests/unit/test_types.lua holds that the two agree.
  local source = KINDS[field.kind].source
  local line = "if %s then a = %s raws[%d] = a if %s then is_remarkable = true end end"
  return format(line, is_there, value, i, source and source(field, i) or "false")
end

--- Make the reader of a message.
-- message  compiled, but for this
-- returns  function(payload).  Of a payload that is shorter than the message, it reads the fields
--          that are whole.  It does not read the bytes behind the message.  It returns
--            { [index of field] = raw }, see message.field_kinds, without missing fields and cases
--            that are not chosen
--            whether M.remarks has any
function M.new_reader(message)
  local nils, names, lines = {}, {}, {}
  for i, field in ipairs(message.fields) do
    field.read = KINDS[field.kind].choose(field)
    nils[i], lines[i] = "nil", field_source(field, i) -- a table that grows by itself takes longer
  end
  for i = 1, math.min(message.size, MAX_KEPT) do names[i] = "b" .. i end
  local source =
    format(READER, concat(nils, ", "), concat(names, ", "), #names, concat(lines, "\n"))
  local read = load(source, "=reader of " .. message.name)
  return read(message.fields, byte, field_kinds.ENVIRONMENT)
end

-- Flags ------------------------------------------------------------------------------------------

--- Return the filter names of the flags that are set, undefined bits as one number:
-- "motor_overcurrent, hall_timeout, undefined 0x80000".
function M.flag_names(field, raw)
  if raw == field.named then return field.names end -- cached: they seldom change
  local names = {}
  for _, flag in ipairs(field.flags) do
    if fast_band(raw, flag.mask) ~= 0 then names[#names + 1] = flag.name end
  end
  local undefined = band(raw, field.undefined)
  if undefined ~= 0 then names[#names + 1] = format("undefined 0x%x", undefined) end
  field.named, field.names = raw, concat(names, ", ")
  return field.names
end

--- Return the fault flags of a field that are set, as a number.
-- raw  nil where the payload does not have the field
function M.faults(field, raw)
  return raw and band(raw, field.alarm_bits) or 0
end

--- Return whether a fault flag is set in a message.
function M.has_alarm(message, raws)
  for _, field in ipairs(message.alarms) do
    if M.faults(field, raws[field.index]) ~= 0 then return true end
  end
  return false
end

--- List the remarkable values: an entry for each expert item.
-- message  compiled
-- raws     of its reader
-- returns  a list of { index of field, expert, whether the catalogue does not define the value }
function M.remarks(message, raws)
  local remarks, index = {}, nil
  local function add(...) remarks[#remarks + 1] = { index, ... } end
  for i, field in ipairs(message.fields) do
    local raw, remark = raws[i], KINDS[field.kind].remark
    index = i
    if raw and remark then remark(field, raw, add) end
  end
  return remarks
end

--- Return whether bytes look like a message: all its values are defined, and at least two of its
-- fields have values that are not.  Random bytes of Command's size do in one of two million cases.
-- Zeros look like anything, so they do not count.
function M.is_plausible(message, payload)
  if not find(payload, "[^%z]") then return false end
  for _, remark in ipairs(M.remarks(message, (message.read(payload)))) do
    if remark[3] then return false end
  end
  local checked = 0
  for _, field in ipairs(message.fields) do
    if field.invalid or field.undefined and field.undefined ~= 0 then checked = checked + 1 end
  end
  return checked >= 2
end

return M
