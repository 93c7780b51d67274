-- SPDX-License-Identifier: GPL-2.0-or-later
-- From the payload of a message to its values, by the compiled catalogue: raw values, little endian
-- ("YAPP Data Types", "YAPP Float Compression", "Time"), their meaning, and which of them are
-- remarkable.  Pure Lua.

local field_kinds = require "yapp.message.field_kinds"

local M = {}

local concat = table.concat
local byte, find, format = string.byte, string.find, string.format
local KINDS = field_kinds.BY_NAME

local MAX_KEPT = 100 -- bytes of a payload in local variables: a function has up to 200

-- Reading ----------------------------------------------------------------------------------------

-- The reader of a message is made from Lua source: a loop over the fields takes 5 % more of a
-- packet list.  The first bytes of a payload are in b1, b2, ...; a missing one is nil.
local READER = [[
local FIELDS, byte, ENV = ...
return function(payload)
local raws, remarks, a = { %s }, false
local %s = byte(payload, 1, %d)
%s
return raws, remarks
end]]
local REMARK = "if %s then remarks = remarks or {} FIELDS[%d]:remark(a, remarks) end"

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
  local source = KINDS[field.kind].source
  local condition = source and source(field, i)
  local remark = condition and format(REMARK, condition, i) or ""
  return format("if %s then a = %s raws[%d] = a %s end", is_there, value, i, remark)
end

--- Make the reader of a message.
-- message  compiled, but for this
-- returns  function(payload).  Of a payload that is shorter than the message, it reads the fields
--          that are whole.  It does not read the bytes behind the message.  It returns
--            { [index of field] = raw }, see message.field_kinds, without missing fields and cases
--            that are not chosen
--            the remarkable values, false for none: a list of { index of field, expert, whether the
--            catalogue does not define the value }, with has_fault = true if a fault flag is set
function M.new_reader(message)
  local nils, names, lines = {}, {}, {}
  for i, field in ipairs(message.fields) do
    field.read, field.remark = KINDS[field.kind].choose(field), KINDS[field.kind].remark
    nils[i], lines[i] = "nil", field_source(field, i) -- a table that grows by itself takes longer
  end
  for i = 1, math.min(message.size, MAX_KEPT) do names[i] = "b" .. i end
  local source =
    format(READER, concat(nils, ", "), concat(names, ", "), #names, concat(lines, "\n"))
  local read = load(source, "=reader of " .. message.name)
  return read(message.fields, byte, field_kinds.ENV)
end

--- Return whether bytes look like a message: all its values are defined, and at least two of its
-- fields have values that are not.  Random bytes of Command's size do in one of two million cases.
-- Zeros look like anything, so they do not count.
function M.is_plausible(message, payload)
  if not find(payload, "[^%z]") then return false end
  local _, remarks = message.read(payload)
  for _, remark in ipairs(remarks or {}) do
    if remark[3] then return false end
  end
  local checked = 0
  for _, field in ipairs(message.fields) do
    if field.invalid or field.undefined and field.undefined ~= 0 then checked = checked + 1 end
  end
  return checked >= 2
end

return M
