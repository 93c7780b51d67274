-- SPDX-License-Identifier: GPL-2.0-or-later
-- From the payload of a message to its raw values, by the compiled catalogue, and which of them are
-- remarkable.  Pure Lua.

local bits = require "yapp.base.bits"
local field_kinds = require "yapp.message.field_kinds"

local M = {}

local band, concat, format = bits.band, table.concat, string.format

local MAX_KEPT = 100 -- bytes of a payload in local variables: a function has up to 200

-- The reader of a message is made from Lua source: a loop over the fields takes 15 % more of a
-- packet list.  The first bytes of a payload are in b1, b2, ...; a missing one is nil.
local READER = [[
local FIELDS, KINDS, byte, band, add_remarks = ...
return function(payload)
local %s = byte(payload, 1, %d)
local raws, remarks, a = { %s }, false
%s
return raws, remarks
end]]
local REMARK = "a = raws[%d] if a and %s then remarks = add_remarks(remarks, FIELDS[%d], a) end"

-- Return the raw value of the i-th field as source: nil if the payload ends before it.
local function raw_source(field, i)
  local last, value = field.offset + field.size, {}
  if last > MAX_KEPT or field.size > 6 or not field.is_unsigned then
    return format("#payload >= %d and KINDS.%s.read(FIELDS[%d], payload) or nil",
      last, field.kind, i)
  end
  for j = 1, field.size do
    value[j] = format("b%d * %.0f", field.offset + j, 0x100 ^ (j - 1))
  end
  return format("b%d and %s", last, concat(value, " + "))
end

-- Return the condition under which a, the raw value of the i-th field, is remarkable, as source.
local function remark_source(field, i)
  if field.flags then
    return format("a > 0 and band(a, %.0f) ~= 0", bits.bor(field.alarm_bits, field.undefined))
  end
  if field.values then return format("not FIELDS[%d].values[a]", i) end
  if field.ordinary then return format("a > %.0f", field.ordinary) end
  return field.special and "a - a ~= 0"
end

local function add_remark(remarks, field, expert, is_undefined)
  remarks = remarks or {}
  remarks[#remarks + 1] = { field.index, expert, is_undefined }
  return remarks
end

-- Add the remarks about a raw value; return all.
local function add_remarks(remarks, field, raw)
  if field.values then return add_remark(remarks, field, field.invalid, true) end
  if not field.flags then return add_remark(remarks, field, "value.special", false) end
  if band(raw, field.alarm_bits) ~= 0 then
    remarks = add_remark(remarks, field, "fault.active", false)
    remarks.has_fault = true
  end
  if band(raw, field.undefined) == 0 then return remarks end
  return add_remark(remarks, field, "flags.undefined", true)
end

--- Make the reader of a message type.
-- returns  function(payload).  It leaves out the fields of which a shorter payload has not all
--          bytes, and does not read the bytes behind the message.  It returns
--            { [index of field] = raw }, see message.field_kinds
--            the remarkable values, false for none: a list of { index of field, expert, whether the
--            catalogue does not define the value }, with has_fault = true if a fault flag is set
function M.new_reader(message_type)
  local names, raws, lines = {}, {}, {}
  for i, field in ipairs(message_type.fields) do
    local condition = remark_source(field, i)
    raws[i] = raw_source(field, i)
    if condition then lines[#lines + 1] = format(REMARK, i, condition, i) end
  end
  for i = 1, math.min(message_type.size, MAX_KEPT) do names[i] = "b" .. i end
  local source =
    format(READER, concat(names, ", "), #names, concat(raws, ",\n"), concat(lines, "\n"))
  local make = load(source, "=reader of " .. message_type.name)
  return make(message_type.fields, field_kinds.BY_NAME, string.byte, band, add_remarks)
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
    if field.values or field.undefined and field.undefined > 0 then checked = checked + 1 end
  end
  return checked >= 2
end

return M
