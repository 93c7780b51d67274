-- SPDX-License-Identifier: GPL-2.0-or-later
-- From the payload of a message to its raw values, by the compiled catalogue, and which of them are
-- remarkable.  Pure Lua.

local band = require "yapp.base.bits".band
local field_kinds = require "yapp.message.field_kinds"

local M = {}

local concat, format = table.concat, string.format

local MAX_KEPT = 100 -- bytes of a payload in local variables: a function has up to 200

-- The reader of a message is made from Lua source: a loop over the fields takes 5 % more of a
-- packet list.  The first bytes of a payload are in b1, b2, ...; a missing one is nil.
local READER = [[
local FIELDS, KINDS, byte, band, add = ...
return function(payload)
local %s = byte(payload, 1, %d)
local raws, remarks, a = { %s }, false
%s
return raws, remarks
end]]
local REMARK = "if a and %s then remarks = add(remarks, %d, %q, %s) end"

-- Return the raw value of the i-th field, a, as source: nil if the payload ends before it.
local function raw_source(field, i)
  local last, value = field.offset + field.size, {}
  if last > MAX_KEPT or field.size > 6 or field.bottom ~= 0 then
    return format("#payload >= %d and KINDS[%d].read(FIELDS[%d], payload) or nil", last, i, i)
  end
  for j = 1, field.size do
    value[j] = format("b%d * %.0f", field.offset + j, 0x100 ^ (j - 1))
  end
  return format("b%d and %s", last, concat(value, " + "))
end

local function add_remark(remarks, index, expert, is_undefined)
  remarks = remarks or {}
  remarks[#remarks + 1] = { index, expert, is_undefined }
  if expert == "fault.active" then remarks.has_fault = true end
  return remarks
end

-- Add the lines that add the remarks of the i-th field.
local function add_remark_lines(lines, field, i)
  local function add(condition, expert, is_undefined)
    lines[#lines + 1] = format(REMARK, condition, i, expert, is_undefined)
  end
  lines[#lines + 1] = format("a = raws[%d]", i)
  if field.values then add(format("not FIELDS[%d].values[a]", i), field.invalid, true) end
  if field.kind == "bool" then add("a > 1", field.invalid, true) end
  if field.kind == "float" then add(format("a > %.0f", field.ordinary), "value.special", false) end
  if field.kind == "ieee" then add("a - a ~= 0", "value.special", false) end
  local function add_bits(mask, expert, is_undefined)
    if mask > 0 then add(format("a > 0 and band(a, %.0f) ~= 0", mask), expert, is_undefined) end
  end
  if not field.flags then return end
  add_bits(field.alarm_bits, "fault.active", false)
  add_bits(field.undefined, "flags.undefined", true)
end

--- Make the reader of a message type.
-- returns  function(payload).  It leaves out the fields of which a shorter payload has not all
--          bytes, and does not read the bytes behind the message.  It returns
--            { [index of field] = raw }, see message.field_kinds
--            the remarkable values, false for none: a list of { index of field, expert, whether the
--            catalogue does not define the value }, with has_fault = true if a fault flag is set
function M.new_reader(message_type)
  local kinds, names, raws, lines = {}, {}, {}, {}
  for i, field in ipairs(message_type.fields) do
    kinds[i], raws[i] = field_kinds.BY_NAME[field.kind], raw_source(field, i)
    add_remark_lines(lines, field, i)
  end
  for i = 1, math.min(message_type.size, MAX_KEPT) do names[i] = "b" .. i end
  local source =
    format(READER, concat(names, ", "), #names, concat(raws, ",\n"), concat(lines, "\n"))
  local make = load(source, "=reader of " .. message_type.name)
  return make(message_type.fields, kinds, string.byte, band, add_remark)
end

--- Return whether bytes look like a message: all its values are defined, and at least two of its
-- fields have values that are not.  Random bytes of Command's size do in one of two million cases.
-- Zeros look like anything, so they do not count.
function M.is_plausible(message_type, payload)
  if not payload:find("[^%z]") then return false end
  local _, remarks = message_type.read(payload)
  for _, remark in ipairs(remarks or {}) do
    if remark[3] then return false end
  end
  local checked = 0
  for _, field in ipairs(message_type.fields) do
    if field.invalid or field.undefined and field.undefined > 0 then checked = checked + 1 end
  end
  return checked >= 2
end

return M
