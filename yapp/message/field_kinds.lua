-- SPDX-License-Identifier: GPL-2.0-or-later
-- The kinds of field, a record each: how a raw value is read, what it means, and how it is shown.
-- Pure Lua.
--
-- A new kind is a record here, and the types that have it in message.catalogue.
--
-- A raw value is the integer or the count as sent.  Exceptions: the number of ieee; the decimal
-- digits of an integer beyond 2^53; the bytes of times, strings and bytes.

local binary = require "yapp.message.binary"
local input = require "yapp.base.input"
local memo = require "yapp.base.memo"
local utf8 = require "yapp.base.utf8"

local M = {}

local format = string.format
local NO_NUMBER = 0 / 0

--- The reserved values of compressed floats, from the highest count down ("YAPP Float
-- Compression").  The index is the value of <field>.special.
M.SPECIALS = {
  [0] = "Not a Number",
  "Positive Infinity",
  "Negative Infinity",
  "Out of Range High",
  "Out of Range Low",
}

-- Compressed floats: floatN <min; max> has counts 0 .. top, top = 2^N - 1.  The five highest counts
-- are reserved values; the others map linearly:  value = min + count * (max - min) / (top - 5).
-- The document's worked examples divide by top - 4; its mapping table and the 0 A of the captured
-- example prove top - 5.
local below_top = 5

--- Choose the divisor of all compressed floats.
-- number  5, or 4 to reproduce the printed figures
function M.choose_divisor(number)
  below_top = number
end

-- Values -----------------------------------------------------------------------------------------

--- Return the value of a field in its unit, unrounded.
-- raw      see above; of a generated value, the list of all raw values
-- returns  a number; a string for strings, bytes (hexadecimal), times and integers beyond 2^53; nil
--          where there is none, and then which special (0 .. 4, as <field>.special has it) for a
--          float that is no number
function M.value(field, raw)
  if not raw then return nil end
  local value_of = M.BY_NAME[field.kind].value
  if value_of then return value_of(field, raw) end
  return raw
end

--- Return a function(raw) -> the value of a compressed float, nil for a reserved count.
function M.new_float(field)
  local min, span, top, ordinary = field.min, field.max - field.min, field.top, field.ordinary
  return function(raw)
    if raw > ordinary then return nil end
    -- One division at the end, so that the middle of a symmetric range is 0 and not nearly 0.
    local steps = top - below_top
    return (min * steps + raw * span) / steps
  end
end

--- Return the value of a field as a text, a number with as many digits as its count can carry:
-- "1.1" for 11 * 0.1 = 1.1000000000000001, so that a filter `== 1.1` matches it.
-- returns  nil where there is none, and then which special
function M.text(field, raw)
  local value, special = M.value(field, raw)
  if type(value) ~= "number" then return value, special end
  return format(field.shape or "%.0f", value) -- COMPAT 5.2: tostring has 14 digits
end

local OPERATORS = {
  ["*"] = function(a, b) return a * b end,
  ["-"] = function(a, b) return a - b end,
  ["+"] = function(a, b) return a + b end,
}

--- By field or generated value: function(raws) -> its value as a number: in its unit, a time in
-- seconds, flags and codes as they are sent; NaN where that is none, such as a reserved value.
M.reader = memo(function(field)
  local index, number, operate = field.index, field.number, OPERATORS[field.operator]
  if number then -- of a compressed float, the usual one
    return function(raws) return raws[index] and number(raws[index]) or NO_NUMBER end
  elseif operate then
    local a, b = M.reader[field.a], M.reader[field.b]
    return function(raws)
      local value = operate(a(raws) + 0.0, b(raws) + 0.0) -- COMPAT 5.4: integers wrap around
      return value - value == 0 and value or NO_NUMBER
    end
  end
  -- Of 64 bits the value is a text, where a double is not exact.
  return function(raws) return tonumber((M.value(field, raws[index]))) or NO_NUMBER end
end)

--- Return whether a field, or a generated value, has numbers that are no codes.
function M.is_number(field)
  return M.BY_NAME[field.kind].is_number and not field.values
end

-- The kinds --------------------------------------------------------------------------------------

local function read_integer(field, payload)
  return binary.integer(payload, field.offset + 1, field.size, not field.is_unsigned)
end

local function read_bytes(field, payload)
  return payload:sub(field.offset + 1, field.offset + field.size)
end

-- name     of the kind
-- column   type of its column in CSV and fields.json
-- filter   Wireshark's type of its filter; UINT and INT without the width
-- shown    how show.taurus adds it to a tree: "plain" (Wireshark reads the bytes), "number",
--          "text", "time" or "flags"
-- read     function(field, payload) -> raw
-- value    function(field, raw) -> see M.value; nil where the raw value is the value
-- unit     of a column without one of its own
-- code     format of a code in texts; nil: hexadecimal
-- is_number, is_text
local KINDS = input.rows("name column filter shown read", {
  { "uint", "integer", "UINT", "plain", read_integer, is_number = true },
  -- COMPAT 5.2: a negative number has no hexadecimal text
  { "int", "integer", "INT", "plain", read_integer, code = "%d", is_number = true },
  {
    "scaled", "float", "DOUBLE", "number", read_integer,
    value = function(field, raw) return raw * field.scale + field.zero end,
    is_number = true,
  },
  { -- a compressed float
    "float", "float", "DOUBLE", "number", read_integer,
    value = function(field, raw)
      if raw > field.ordinary then return nil, field.top - raw end
      return field.number(raw)
    end,
    is_number = true,
  },
  {
    "ieee", "float", "DOUBLE", "number",
    function(field, payload)
      return binary.ieee(payload, field.offset + 1, field.size)
    end,
    value = function(_, raw)
      if raw - raw == 0 then return raw end
      return nil, raw ~= raw and 0 or raw > 0 and 1 or 2
    end,
    is_number = true,
  },
  { "flags", "integer", "UINT", "flags", read_integer },
  {
    "time", "time", "RELATIVE_TIME", "time", read_bytes,
    value = function(_, raw) return binary.seconds(binary.time(raw)) end,
    unit = "s",
  },
  { -- a text ends at its first NUL; a character that cannot be shown is \xnn
    "string", "string", "STRING", "text", read_bytes,
    value = function(_, raw) return utf8.printable(raw:match("^%Z*"), "\\x%02x") end,
    is_text = true,
  },
  {
    "bytes", "string", "BYTES", "plain", read_bytes,
    value = function(_, raw)
      return (raw:gsub(".", function(char) return format("%02x", char:byte()) end))
    end,
    is_text = true,
  },
  { -- worked out from two fields; nil where one of them has no value, or where it is too large
    "derived", "float",
    value = function(item, raws)
      local value = M.reader[item](raws)
      return value == value and value or nil
    end,
    is_number = true,
  },
})

--- The kinds by name.
M.BY_NAME = {}
for _, kind in ipairs(KINDS) do M.BY_NAME[kind.name] = kind end

return M
