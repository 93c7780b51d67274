-- SPDX-License-Identifier: GPL-2.0-or-later
-- Makes straight functions for a message, as Lua source: one that reads it, and ones that write its
-- values.  Pure Lua.
--
-- They run for every packet; loops over the fields take 7 % of a packet list and 13 % of a table
-- more.

local bits = require("yapp.base.bits")
local numbers = require("yapp.message.decode")

local M = {}

local format, concat = string.format, table.concat
local unpack = rawget(table, "unpack")

local DIVIDE = load("return 1 // 1") and "//" or "/" -- COMPAT 5.2: "//" is a syntax error there
local MOST_KEPT = 100 -- bytes in local variables: a function has up to 200
local MOST_BYTES = 6 -- whose count a double holds with room to calculate
local MOST_PARTS = 100 -- of a text: a function has up to 200 local variables

-- Reading ----------------------------------------------------------------------------------------

-- Lines that set a to the raw value of a field, by kind.
local sources = {}

-- A little endian count.  The first bytes of the payload are in b1, b2, ...: a call takes longer
-- than a field.
local function count_source(field)
  local offset, size = field.offset, field.size
  if offset + size > MOST_KEPT then
    return format("a = count(payload, %d, %d)", offset + 1, size)
  end
  local sum = { "a = b" .. offset + 1 }
  for i = 2, size do
    sum[i] = format("b%d * %.0f", offset + i, 0x100 ^ (i - 1))
  end
  return concat(sum, " + ")
end

function sources.uint(field, message)
  if field.mask then -- a part of the bits of a field that is already read
    local inside, low = message.index[field.inside], field.low
    local shape = "a = raws[%d] a = (a - a %% %d) " .. DIVIDE .. " %d %% %d"
    return format(shape, inside, low, low, field.top + 1)
  end
  if field.size > MOST_BYTES then
    return format("a = integer64(payload, %d, false)", field.offset + 1)
  end
  return count_source(field)
end

function sources.int(field)
  if field.size > MOST_BYTES then
    return format("a = integer64(payload, %d, true)", field.offset + 1)
  end
  local span = (field.top + 1) * 2
  return format("%s if a > %d then a = a - %d end", count_source(field), field.top, span)
end

function sources.float(field)
  if field.size <= MOST_BYTES then return count_source(field) end
  return format("a = long_count(payload, %d, %d)", field.offset + 1, field.size)
end

function sources.ieee(field)
  return format("a = float%d(payload, %d)", field.size * 8, field.offset + 1)
end

function sources.string(field)
  return format("a = sub(payload, %d, %d)", field.offset + 1, field.offset + field.size)
end

sources.bytes = sources.string
sources.time = sources.string
sources.flags = count_source
sources.bool = count_source

-- What of a is remarkable, as a condition; nil where nothing is.
local function look_source(field, i)
  local kind = field.kind
  if kind == "float" then
    return field.size > MOST_BYTES and "a < 0" or format("a > %d", field.ordinary)
  end
  if kind == "ieee" then return "a - a ~= 0" end
  if kind == "flags" then
    -- The alarms' bits and those that nobody defines, each once.
    local both = field.alarm_bits + field.undefined - bits.band(field.alarm_bits, field.undefined)
    if both == field.top then return "a ~= 0" end
    return both ~= 0 and format("band(a, %d) ~= 0", both) or nil
  end
  if field.values then return format("not FIELDS[%d].values[a]", i) end
  return kind == "bool" and "a > 1" or nil
end

local function field_source(message, field, i)
  local source = sources[field.kind]
  local look = look_source(field, i)
  local line = format("%s raws[%d] = a", source(field, message), i)
  if look then line = format("%s if %s then look = true end", line, look) end
  if field.cases then
    line = format("%s if not FIELDS[%d].cases[a] then look = true end", line, i)
  end
  if not field.when then return line end
  return format("if raws[%d] == %d then %s end", field.when.index, field.when.value, line)
end

local READER = [[
local FIELDS, byte, sub, band, numbers = ...
local float32, float64 = numbers.float32, numbers.float64
local integer64, count, long_count = numbers.integer64, numbers.count, numbers.long_count
return function(payload)
local raws, look, a = { %s }, false
local %s = byte(payload, 1, %d)
%s
return raws, look
end]]

--- Makes the reader of a compiled message.
-- returns  function(payload): payload a string as long as the message; returns { [index of field] =
--          raw } and whether any of them is remarkable
function M.reader(message)
  local room, lines = {}, {}
  for i, field in ipairs(message.fields) do
    room[i] = "nil" -- a table that grows by itself takes longer
    lines[i] = field_source(message, field, i)
  end
  local kept = math.max(math.min(message.size, MOST_KEPT), 1)
  local bytes = {}
  for i = 1, kept do bytes[i] = "b" .. i end
  local source = format(READER, concat(room, ", "), concat(bytes, ", "), kept, concat(lines, "\n"))
  local chunk = assert(load(source, "=reader of " .. message.name))
  return chunk(message.fields, string.byte, string.sub, bits.common, numbers)
end

-- Texts ------------------------------------------------------------------------------------------

-- A number as source; COMPAT 5.4: as a float.
local function literal(number)
  local text = format("%.17g", number)
  return text:find("[.e]") and text or text .. ".0"
end

--- The value of a compressed float, with the divisor of now, as Lua source: "(-8387840.0 + a *
-- 256.0) / 65530.0".
-- a  what has the count, as source
function M.float_source(field, a)
  local steps, span = field.top - numbers.divisor(), field.max - field.min
  return format("(%s + %s * %s) / %s", literal(field.min * steps), a, literal(span), literal(steps))
end

local WRITER = [[
local WRITE, SHAPE, format = ...
return function(raws)
%s
return format(%s)
end]]

local function writer_source(parts)
  local lines, values = {}, {}
  for i, part in ipairs(parts) do
    local field, a, raw = part.field, "a" .. i, part.index and format("raws[%d]", part.index)
    if part.write then
      lines[i] = format("local %s = WRITE[%d](%s)", a, i, raw or "raws")
      values[i] = a
    else
      lines[i] = format("local %s = %s if %s and %s > %d then return nil end", a, raw, a, a,
        field.ordinary)
      values[i] = M.float_source(field, a)
    end
    lines[i] = format("%s if not %s then return nil end", lines[i], a)
  end
  return format(WRITER, concat(lines, "\n"), concat({ "SHAPE", unpack(values) }, ", "))
end

--- Whether the writer of M.writer works out the value of a field by itself: then its part needs no
-- write.
function M.is_plain(field)
  return field.kind == "float" and field.size <= MOST_BYTES
end

--- Makes a function that writes values of a message, one that has nothing special about it, by one
-- format.
-- parts    list of { field, index = of it, write = function(raw) -> what the format takes, nil
--          where the value is special; no write where M.is_plain(field); where index is nil, write
--          takes all raws }
-- shape    as for string.format
-- returns  function(raws) -> text, nil where a value is missing or special, or parts are too many
function M.writer(parts, shape)
  if #parts > MOST_PARTS then return function() end end
  local writes, divisor, write = {}, nil, nil
  for i, part in ipairs(parts) do writes[i] = part.write or false end
  return function(raws)
    if divisor ~= numbers.divisor() then
      divisor = numbers.divisor()
      write = load(writer_source(parts), "=writer")(writes, shape, format)
    end
    return write(raws)
  end
end

return M
