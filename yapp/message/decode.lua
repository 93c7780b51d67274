-- SPDX-License-Identifier: GPL-2.0-or-later
-- From the payload of a message to its values, by the compiled catalogue: raw values, little endian
-- ("YAPP Data Types", "YAPP Float Compression", "Time"), their meaning, and which of them are
-- remarkable.  Pure Lua.

local bits = require "yapp.base.bits"
local utf8 = require "yapp.base.utf8"

local M = {}

--- The reserved values of compressed floats, from the highest count down ("YAPP Float
-- Compression").  The index is the value of <field>.special.
M.SPECIALS = {
  [0] = "Not a Number",
  "Positive Infinity",
  "Negative Infinity",
  "Out of Range High",
  "Out of Range Low",
}

local abs, floor, concat = math.abs, math.floor, table.concat
local byte, find, format, sub = string.byte, string.find, string.format, string.sub
local band, fast_band = bits.band, bits.fast_band

local MAX_KEPT = 100 -- bytes of a payload in local variables: a function has up to 200

-- Numbers ----------------------------------------------------------------------------------------

-- Return the little endian number of so many bytes, rounded to a double.
-- index  in the payload, 1-based
local function count_of(payload, index, size)
  local count = size > 6 and 0.0 or 0 -- COMPAT 5.4: integers of eight bytes wrap around
  for i = index + size - 1, index, -1 do
    count = count * 0x100 + byte(payload, i)
  end
  return count
end

-- Return an IEEE 754 number.
-- digits  bits of its mantissa: 23 of four bytes, 52 of eight
local function ieee(payload, index, size, digits)
  local bits_of_exponent = 8 * size - 1 - digits
  local a, b = byte(payload, index + size - 2, index + size - 1)
  local high = 2 ^ (15 - bits_of_exponent) -- the two highest bytes: sign, exponent, digits
  local top = b % 0x80 * 0x100 + a
  local exponent = floor(top / high)
  local mantissa = top % high * 2 ^ (digits - 15 + bits_of_exponent) +
    count_of(payload, index, size - 2)
  local sign, highest = b >= 0x80 and -1 or 1, 2 ^ bits_of_exponent - 1
  if exponent == highest then return mantissa == 0 and sign * math.huge or 0 / 0 end
  local bias = (highest - 1) / 2 + digits
  if exponent == 0 then return sign * (mantissa * 2 ^ (1 - bias)) end
  return sign * (mantissa + 2 ^ digits) * 2 ^ (exponent - bias)
end

local BILLION = 1000000000

-- Divide an integer of eight bytes by 10^9.
-- returns  the quotient, and the rest, of the same sign
local function divide(payload, index, is_signed)
  local a, b, c, d, e, f, g, h = byte(payload, index, index + 7)
  if h == 0 and g < 0x20 then -- the usual one: a double holds it
    local high = e + f * 0x100 + g * 0x10000
    local number = high * 0x100000000 + d * 0x1000000 + c * 0x10000 + b * 0x100 + a
    local rest = number % BILLION
    return (number - rest) / BILLION, rest
  end
  -- Long division, a byte a step.  The highest byte of a negative number counts as negative.
  local quotient, rest = 0, is_signed and h >= 0x80 and h - 0x100 or h
  for i = index + 6, index, -1 do
    local dividend = rest * 0x100 + byte(payload, i)
    rest = dividend % BILLION
    quotient = quotient * 0x100 + (dividend - rest) / BILLION
  end
  if quotient < 0 and rest > 0 then return quotient + 1, rest - BILLION end
  return quotient, rest
end

-- Return an integer of eight bytes: a number up to 2^53, beyond that its decimal digits.
local function integer64(payload, index, is_signed)
  local billions, rest = divide(payload, index, is_signed)
  if abs(billions) < 9007199 then return billions * BILLION + rest end
  return format("%.0f%09.0f", billions, abs(rest))
end

--- Split a signed 64 bit count of nanoseconds exactly ("Time").
-- payload  string
-- offset   0-based
-- returns  seconds, nanoseconds; both negative, or zero, for a negative time
function M.time(payload, offset)
  return divide(payload, offset + 1, true)
end

-- Compressed floats: floatN <min; max> has counts 0 .. top, top = 2^N - 1.  The five highest counts
-- are reserved values; the others map linearly:  value = min + count * (max - min) / (top - 5).
-- The document's worked examples divide by top - 4; its mapping table and the 0 A of the captured
-- example prove top - 5.
M.MAPPING = 5
M.WORKED_EXAMPLES = 4

--- Compressed floats divide by top - below_top.
M.below_top = M.MAPPING

--- Choose what every compressed float divides by.
-- below_top  M.MAPPING, or M.WORKED_EXAMPLES to reproduce the printed figures
function M.use_below_top(below_top)
  M.below_top = below_top
end

-- Round to a number that four bytes can hold: adding and subtracting a large number rounds off what
-- is below.
local function to_float32(value)
  local large = 1.5 * 2 ^ -97
  if abs(value) >= 2 ^ -126 then large = value * (2 ^ 29 + 1) end
  return large - (large - value)
end

--- Return the number with the fewest digits that is equal as a float of four bytes: 0.1 for
-- 0.10000000149.
-- value  finite
function M.shortest(value)
  if value == 0 then return value end -- COMPAT 5.4: the text "-0" is an integer there
  for digits = 6, 8 do
    local short = tonumber(format("%." .. digits .. "g", value))
    if to_float32(short) == value then return short end
  end
  return tonumber(format("%.9g", value))
end

-- Values -----------------------------------------------------------------------------------------

local function hex_digits(char)
  return format("%02x", byte(char))
end

-- By kind: function(field, raw), which returns its value, or nil and which special.
local VALUES = {}

function VALUES.float(field, raw)
  if raw > field.ordinary then return nil, field.top - raw end
  if raw < 0 then return nil, -1 - raw end -- of seven or eight bytes
  -- One division at the end, so that the middle of a symmetric range is 0 and not nearly 0.
  local steps = field.top - M.below_top
  return (field.min * steps + raw * (field.max - field.min)) / steps
end

function VALUES.ieee(_, raw)
  if raw ~= raw then return nil, 0 end
  if raw - raw ~= 0 then return nil, raw > 0 and 1 or 2 end
  return raw
end

function VALUES.scaled(field, raw)
  return raw * field.scale + field.zero
end

function VALUES.bytes(_, raw)
  return (raw:gsub(".", hex_digits))
end

-- A text ends at its first NUL.  What cannot be shown in it is \xnn.
function VALUES.string(_, raw)
  return utf8.value(raw:match("^%Z*"))
end

--- Return the value of a field in its unit, unrounded.
-- raw      of M.new_reader
-- returns  a number; a string for strings, bytes (hexadecimal) and integers beyond 2^53; nil where
--          there is none, and then which special (0 .. 4, as <field>.special has it) for a float
--          that is no number
function M.value(field, raw)
  if not raw then return nil end
  local value_of = VALUES[field.kind]
  if value_of then return value_of(field, raw) end
  return raw
end

--- Return a number as a text with as many digits as its count can carry: "1.1" for
-- 11 * 0.1 = 1.1000000000000001, so that a filter `== 1.1` matches it.
-- field  or an item of message.generated
-- value  of M.value or M.derived
function M.number_text(field, value)
  if field.shape then return format(field.shape, value) end
  if type(value) == "string" then return value end -- an integer beyond 2^53
  -- COMPAT 5.2: tostring has 14 digits
  if field.kind ~= "ieee" then return format("%.0f", value) end
  if field.size == 4 then value = M.shortest(value) end
  local text = format("%.15g", value)
  return tonumber(text) == value and text or format("%.17g", value)
end

local OPERATORS = {
  ["*"] = function(a, b) return a * b end,
  ["-"] = function(a, b) return a - b end,
  ["+"] = function(a, b) return a + b end,
}

--- Work out a generated value from its two fields.
-- item     of message.generated
-- returns  a number, unrounded; nil where one of the two fields has no value
function M.derived(message, item, raws)
  local a = M.value(message.fields[item.a], raws[item.a])
  local b = M.value(message.fields[item.b], raws[item.b])
  if not (a and b) then return nil end
  -- COMPAT 5.4: products of integers wrap around
  local value = OPERATORS[item.operator](a + 0.0, b + 0.0)
  return value - value == 0 and value or nil -- it may be too large
end

--- Return a time in seconds as a text with nine digits behind the point.
function M.seconds(seconds, nanoseconds)
  if seconds < 0 or nanoseconds < 0 then
    return format("-%d.%09d", -seconds, -nanoseconds)
  end
  return format("%d.%09d", seconds, nanoseconds)
end

-- Reading ----------------------------------------------------------------------------------------

-- How the raw value of a field is read: function(field, payload) -> raw.

local function read_count(field, payload)
  return count_of(payload, field.offset + 1, field.size)
end

local function read_signed(field, payload)
  local count = read_count(field, payload)
  return count > field.top and count - 2 * (field.top + 1) or count
end

local function read_part(field, payload)
  return floor(read_count(field, payload) / field.low) % (field.top + 1)
end

local function read_integer64(field, payload)
  return integer64(payload, field.offset + 1, field.bottom < 0)
end

local function read_bytes(field, payload)
  return sub(payload, field.offset + 1, field.offset + field.size)
end

local function read_long_float(field, payload)
  local lowest, others = byte(payload, field.offset + 1), sub(read_bytes(field, payload), 2)
  if lowest >= 0xFB and not find(others, "[^\255]") then return lowest - 0x100 end
  return read_count(field, payload)
end

local function read_ieee(field, payload)
  return ieee(payload, field.offset + 1, field.size, field.size == 4 and 23 or 52)
end

local READ = { ieee = read_ieee, string = read_bytes, bytes = read_bytes, time = read_bytes }

local function choose_read(field)
  if READ[field.kind] then return READ[field.kind] end
  if field.size > 6 then return field.special and read_long_float or read_integer64 end
  if field.mask then return read_part end
  return field.bottom < 0 and read_signed or read_count
end

-- Return whether nothing defines a value of an enum, a bool or what chooses among variants.
local function is_invalid(field, raw)
  local values, cases = field.values, field.cases
  return values and not values[raw] or cases and not cases[raw] or field.kind == "bool" and raw > 1
end

-- The reader of a message is made from Lua source: a loop over the fields takes 5 % more of a
-- packet list.  The first bytes of a payload are in b1, b2, ...; a missing one is nil.
local READER = [[
local FIELDS, byte, fast_band, value_of, is_invalid = ...
return function(payload)
local raws, is_remarkable, a = { %s }, false
local %s = byte(payload, 1, %d)
%s
return raws, is_remarkable
end]]

-- Return the condition under which the i-th field of a message is remarkable, so that M.remarks has
-- something to say of it.  tests/unit/test_types.lua holds that the two agree.
local function remark_source(field, i)
  if field.kind == "float" and field.size <= 6 then return format("a > %.0f", field.ordinary) end
  if field.special then return format("not value_of(FIELDS[%d], a)", i) end
  if field.kind == "flags" then
    return format("a ~= 0 and fast_band(a, %d) ~= 0", bits.bor(field.alarm_bits, field.undefined))
  end
  return field.invalid and format("is_invalid(FIELDS[%d], a)", i) or "false"
end

-- Return the lines that read the i-th field of a message.
local function field_source(field, i)
  local last, when, value = field.offset + field.size, field.when, {}
  local is_there = last <= MAX_KEPT and "b" .. last or "#payload >= " .. last
  if when then is_there = format("%s and raws[%d] == %d", is_there, when.index, when.value) end
  for j = 1, field.size do
    value[j] = format("b%d * %.0f", field.offset + j, 0x100 ^ (j - 1))
  end
  value = concat(value, " + ")
  if field.read ~= read_count or last > MAX_KEPT then
    value = format("FIELDS[%d]:read(payload)", i)
  end
  local line = "if %s then a = %s raws[%d] = a if %s then is_remarkable = true end end"
  return format(line, is_there, value, i, remark_source(field, i))
end

--- Make the reader of a message.
-- message  compiled, but for this
-- returns  function(payload).  Of a payload that is shorter than the message, it reads the fields
--          that are whole; what is behind the message it does not read.  It returns
--            { [index of field] = raw }, without missing fields and cases that are not chosen
--            whether M.remarks has any
-- A raw is the integer or the count as sent.  Exceptions: the number of ieee; the decimal digits of
-- a 64 bit integer beyond 2^53; the bytes of times (see M.time), strings and bytes; -1 - n for
-- special n of a compressed float of seven or eight bytes.
function M.new_reader(message)
  local nils, names, lines = {}, {}, {}
  for i, field in ipairs(message.fields) do
    field.read = choose_read(field)
    nils[i], lines[i] = "nil", field_source(field, i) -- a table that grows by itself takes longer
  end
  for i = 1, math.min(message.size, MAX_KEPT) do names[i] = "b" .. i end
  local source =
    format(READER, concat(nils, ", "), concat(names, ", "), #names, concat(lines, "\n"))
  local read = load(source, "=reader of " .. message.name)
  return read(message.fields, byte, fast_band, M.value, is_invalid)
end

local NUMBERS = {
  uint = true, int = true, scaled = true, float = true, ieee = true, derived = true,
}

--- Return whether a field, or an item of message.generated, has numbers that are no codes.
function M.is_number(field)
  return NUMBERS[field.kind] and not field.values
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
  local remarks = {}
  local function add(...) remarks[#remarks + 1] = { ... } end
  for i, field in ipairs(message.fields) do
    local raw = raws[i]
    if raw and field.kind == "flags" then
      if fast_band(raw, field.alarm_bits) ~= 0 then add(i, "fault.active", false) end
      if fast_band(raw, field.undefined) ~= 0 then add(i, "flags.undefined", true) end
    elseif raw and field.special then
      if not M.value(field, raw) then add(i, "value.special", false) end
    elseif raw and is_invalid(field, raw) then
      add(i, field.invalid, true)
    end
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
