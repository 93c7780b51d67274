-- SPDX-License-Identifier: GPL-2.0-or-later
-- Makes the reader of a message: a straight function, as Lua source.  Pure Lua, 5.2 and 5.4.
--
-- It runs for every packet, and is three times as fast as a loop over the fields.  It fills raws and says whether any
-- count needs a second look.
--   local b9, b10, b11, ... = byte(payload, 9, 82)
--   a = b9 + b10 * 0x100
--   raws[5] = a
--   if a > 65530 then look = true end

local bits = require("yapp.base.bits")
local numbers = require("yapp.message.numbers")

local M = {}

local format = string.format
local native = load("return 1 & 1") ~= nil -- a syntax error in Lua 5.2

-- The little endian count of up to six bytes, in a.
local function count_source(field)
  local sum = {}
  for i = 1, field.size do
    local weight = i > 1 and " * 0x1" .. ("00"):rep(i - 1) or ""
    sum[i] = format("b%d%s", field.offset + i, weight)
  end
  return "a = " .. table.concat(sum, " + ")
end

local MOST_BYTES = 100 -- a function has up to 200 local variables

local function is_counted(field)
  return field.kind ~= "time" and field.kind ~= "ieee" and field.kind ~= "string" and field.kind ~= "bytes" and
    not field.mask and field.size <= 6
end

-- Runs of fields whose bytes are asked for in one call, which costs more than a field: by index of its first field
-- { last = index of the last, from, to = bytes }.
local function runs_of(fields)
  local runs, run = {}, nil
  for i, field in ipairs(fields) do
    local to = field.offset + field.size
    if run and (field.when ~= fields[run.last].when or to <= run.to or to - run.from >= MOST_BYTES) then run = nil end
    if is_counted(field) then
      if not run then
        run = { from = field.offset + 1 }
        runs[i] = run
      end
      run.last, run.to = i, to
    end
  end
  return runs
end

local function run_source(run)
  local names = {}
  for at = run.from, run.to do names[#names + 1] = "b" .. at end
  return format("do local %s = byte(payload, %d, %d)", table.concat(names, ", "), run.from, run.to)
end

-- Lines that set a to the raw value of a field, by kind.
local sources = {}

-- A part of the bits of a field that is already read.
local function part_source(field, message)
  local inside = message.index[field.inside]
  if native then return format("a = raws[%d] // %d & %d", inside, field.low, field.top) end
  return format("a = raws[%d] a = (a - a %% %d) / %d %% %d", inside, field.low, field.low, field.top + 1)
end

function sources.uint(field, message)
  if field.mask then return part_source(field, message) end
  if field.size == 8 then return format("a = integer64(payload, %d, false)", field.offset + 1) end
  return count_source(field)
end

function sources.int(field)
  if field.size == 8 then return format("a = integer64(payload, %d, true)", field.offset + 1) end
  return count_source(field) .. format("\nif a > %d then a = a - %d end", field.top, (field.top + 1) * 2)
end

function sources.float(field)
  if field.size <= 6 then return count_source(field) end
  return format("a = count(payload, %d, %d)", field.offset + 1, field.size)
end

function sources.ieee(field)
  local at = field.offset + 1
  if field.size == 8 then return format("a = float64(payload, %d)", at) end
  return format("a = float32(byte(payload, %d, %d))", at, at + 3)
end

function sources.string(field)
  return format("a = sub(payload, %d, %d)", field.offset + 1, field.offset + field.size)
end

sources.bytes, sources.flags, sources.bool = sources.string, count_source, count_source

-- What of a is worth a second look, as a condition; nil: nothing is.
local function look_source(field, i)
  if field.kind == "float" then
    return field.size > 6 and "a < 0" or format("a > %d", field.ordinary)
  elseif field.kind == "ieee" then
    return "a - a ~= 0"
  elseif field.kind == "bool" then
    return "a > 1"
  elseif field.kind == "flags" then
    local mask = field.alarm and field.watched or field.undefined
    if mask == field.top then return "a ~= 0" end
    return mask ~= 0 and format("band(a, %d) ~= 0", mask) or nil
  elseif field.values and field.cases then
    return format("not VALUES[%d][a] or not CASES[%d][a]", i, i)
  elseif field.values or field.cases then
    return format("not %s[%d][a]", field.values and "VALUES" or "CASES", i)
  end
end

-- The beginning or the end of the fields of one case.
local function case_source(before, after, first, last)
  local lines = {}
  if before then
    local absent = {}
    for i = first, last do absent[#absent + 1] = format("raws[%d] = nil", i) end
    lines[1] = "else " .. table.concat(absent, " ") .. " end"
  end
  if after then lines[#lines + 1] = format("if raws[%d] == %d then", after.index, after.value) end
  return table.concat(lines, "\n")
end

local function reader_source(message)
  local lines, when, first = { "return function(payload, raws) local look, a = false" }, nil, 1
  local runs, run = runs_of(message.fields), nil
  for i, field in ipairs(message.fields) do
    if field.when ~= when then
      lines[#lines + 1] = case_source(when, field.when, first, i - 1)
      when, first = field.when, i
    end
    if runs[i] then
      run = runs[i]
      lines[#lines + 1] = run_source(run)
    end
    local source = sources[field.kind]
    if source then -- a time has no raw value
      lines[#lines + 1] = source(field, message)
      lines[#lines + 1] = format("raws[%d] = a", i)
      local condition = look_source(field, i)
      if condition then lines[#lines + 1] = format("if %s then look = true end", condition) end
    end
    if run and run.last == i then lines[#lines + 1] = "end" end
  end
  if when then lines[#lines + 1] = case_source(when, nil, first, #message.fields) end
  lines[#lines + 1] = "return look end"
  return table.concat(lines, "\n")
end

local HEAD = [[local byte, sub, band, VALUES, CASES, numbers = ...
local float32, float64, integer64, count = numbers.float32, numbers.float64, numbers.integer64, numbers.count
]]

--- Makes the reader of a compiled message.
-- returns  function(payload, raws): payload a string as long as the message, raws the table that gets the raw value of
--          each field by its index; returns whether any of them needs a second look
function M.make(message)
  local values, cases = {}, {}
  for i, field in ipairs(message.fields) do values[i], cases[i] = field.values, field.cases end
  local chunk = assert(load(HEAD .. reader_source(message), "=reader of " .. message.name))
  return chunk(string.byte, string.sub, bits.band, values, cases, numbers)
end

return M
