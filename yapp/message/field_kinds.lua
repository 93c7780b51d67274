-- SPDX-License-Identifier: GPL-2.0-or-later
-- The kinds of field, a record each: the reading of its bytes, its values, its remarkable values,
-- and its forms in filters, Info and CSV.  Pure Lua.
--
-- A new kind is a record here, and the types that have it in message.catalogue_fields.
--
-- A raw value is the integer or the count as sent.  Exceptions: the number of ieee; the decimal
-- digits of a 64 bit integer beyond 2^53; the bytes of times, strings and bytes; -1 - n for special
-- n of a compressed float of seven or eight bytes.

local binary = require "yapp.message.binary"
local bits = require "yapp.base.bits"
local utf8 = require "yapp.base.utf8"

local M = {}

local floor = math.floor
local byte, find, format, sub = string.byte, string.find, string.format, string.sub

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
M.MAPPING = 5
M.WORKED_EXAMPLES = 4

--- Compressed floats divide by top - below_top.
M.below_top = M.MAPPING

--- Choose the divisor of all compressed floats.
-- below_top  M.MAPPING, or M.WORKED_EXAMPLES to reproduce the printed figures
function M.choose_divisor(below_top)
  M.below_top = below_top
end

-- Reading ----------------------------------------------------------------------------------------
--
-- function(field, payload) -> raw

--- Read a count of fewer than seven bytes and without a sign.
function M.read_count(field, payload)
  return binary.count(payload, field.offset + 1, field.size)
end

local function read_signed(field, payload)
  local count = M.read_count(field, payload)
  return count > field.top and count - 2 * (field.top + 1) or count
end

local function read_part(field, payload)
  return floor(M.read_count(field, payload) / field.low) % (field.top + 1)
end

local function read_integer64(field, payload)
  return binary.integer64(payload, field.offset + 1, field.bottom < 0)
end

local function read_bytes(field, payload)
  return sub(payload, field.offset + 1, field.offset + field.size)
end

local function read_long_float(field, payload)
  local lowest, others = byte(payload, field.offset + 1), sub(read_bytes(field, payload), 2)
  if lowest >= 0xFB and not find(others, "[^\255]") then return lowest - 0x100 end
  return M.read_count(field, payload)
end

local function read_ieee(field, payload)
  return binary.ieee(payload, field.offset + 1, field.size, field.size == 4 and 23 or 52)
end

local function choose_integer(field)
  if field.size > 6 then return read_integer64 end
  if field.mask then return read_part end
  return field.bottom < 0 and read_signed or M.read_count
end

local function choose_float(field)
  return field.size > 6 and read_long_float or M.read_count
end

-- Texts ------------------------------------------------------------------------------------------

--- Return the value of a field in its unit, unrounded.
-- raw      see above
-- returns  a number; a string for strings, bytes (hexadecimal) and integers beyond 2^53; nil where
--          there is none, and then which special (0 .. 4, as <field>.special has it) for a float
--          that is no number
function M.value(field, raw)
  if not raw then return nil end
  local value_of = M.BY_NAME[field.kind].value
  if value_of then return value_of(field, raw) end
  return raw
end

--- Return a number as a text with as many digits as its count can carry: "1.1" for
-- 11 * 0.1 = 1.1000000000000001, so that a filter `== 1.1` matches it.
-- field  or an item of message.generated
-- value  of M.value
function M.number_text(field, value)
  if field.shape then return format(field.shape, value) end
  if type(value) == "string" then return value end -- an integer beyond 2^53
  -- COMPAT 5.2: tostring has 14 digits
  if field.kind ~= "ieee" then return format("%.0f", value) end
  if field.size == 4 then value = binary.shortest(value) end
  local text = format("%.15g", value)
  return tonumber(text) == value and text or format("%.17g", value)
end

--- Return a function(raw) -> the text of a number, nil where there is none, and then which special.
function M.new_number_text(field)
  local value_of, shape = M.BY_NAME[field.kind].value, field.shape
  return function(raw)
    local value, special = raw, nil
    if value_of then value, special = value_of(field, raw) end
    if not value then return nil, special end
    return shape and format(shape, value) or M.number_text(field, value)
  end
end

--- Return a text as a cell of CSV: in quotes where it must be.
function M.quoted(text)
  if text:find('[,"\r\n]') then return '"' .. text:gsub('"', '""') .. '"' end
  return text
end

local SPECIAL_WORDS = { [0] = "NaN", "+inf", "-inf", "above range", "below range" }
-- The cells of a reserved value: no number, and its name.
local SPECIAL_CELLS = { [0] = ",nan", ",inf", ",-inf", ",above", ",below" }
local BOOLS = { [0] = "false", "true" }

-- Functions that make a function(raw) -> the text of a field in Info, or its cells in CSV:

local function number_info(field, shape)
  return function(raw)
    local value, special = M.value(field, raw)
    return special and SPECIAL_WORDS[special] or format(shape, value)
  end
end

local function number_cells(field)
  local write = M.new_number_text(field)
  return function(raw)
    local text, special = write(raw)
    return text and text .. "," or SPECIAL_CELLS[special]
  end
end

local function code_info(field)
  local values, invalid = field.values, "invalid " .. (M.BY_NAME[field.kind].code or "0x%x")
  return function(raw)
    if not values then return M.number_text(field, raw) end
    return values[raw] or format(invalid, raw)
  end
end

local function code_cells(field)
  local values = field.values
  return function(raw)
    local text = M.number_text(field, M.value(field, raw))
    if not values then return text end
    return text .. "," .. M.quoted(values[raw] or "")
  end
end

local function text_info(field)
  return function(raw) return M.value(field, raw) end
end

local function text_cells(field)
  return function(raw) return M.quoted(M.value(field, raw)) end
end

local function time_text(raw)
  return binary.seconds(binary.time(raw, 0))
end

local function flags_cells(field)
  return function(raw)
    local texts = { M.number_text(field, raw) }
    for i, flag in ipairs(field.flags) do
      texts[i + 1] = bits.band(raw, flag.mask) ~= 0 and "1" or "0"
    end
    return table.concat(texts, ",")
  end
end

-- The cell of a generated value.
local function derived_cells(item)
  local write = M.new_number_text(item)
  return function(raws) return write(raws) or "" end
end

-- Remarkable values ------------------------------------------------------------------------------

-- Return whether nothing defines a code.
local function is_undefined(field, raw)
  local values, cases = field.values, field.cases
  return values and not values[raw] or cases and not cases[raw] or field.kind == "bool" and raw > 1
end

-- Append a remark.
-- lacks_meaning  true if the catalogue does not define the value
local function add_remark(remarks, field, expert, lacks_meaning)
  remarks[#remarks + 1] = { field.index, expert, lacks_meaning }
end

local function remark_code(field, _, remarks)
  add_remark(remarks, field, field.invalid, true)
end

local function remark_special(field, _, remarks)
  add_remark(remarks, field, "value.special", false)
end

local function remark_flags(field, raw, remarks)
  if bits.band(raw, field.alarm_bits) ~= 0 then
    add_remark(remarks, field, "fault.active", false)
    remarks.has_fault = true
  end
  if bits.band(raw, field.undefined) ~= 0 then
    add_remark(remarks, field, "flags.undefined", true)
  end
end

-- The condition of each as source of the reader that message.decode makes.  It may use a, the raw
-- value; FIELDS[i], the field; raws, those of the fields before it; and the functions of ENV.

--- The functions of the conditions: ENV.band in source is M.ENV.band here.
M.ENV = { band = bits.band, value_of = M.value, is_undefined = is_undefined }

local function code_source(field, i)
  return field.invalid and format("ENV.is_undefined(FIELDS[%d], a)", i)
end

local function special_source(_, i)
  return format("not ENV.value_of(FIELDS[%d], a)", i)
end

local function float_source(field, i)
  if field.size > 6 then return special_source(field, i) end
  return format("a > %.0f", field.ordinary)
end

local function flags_source(field)
  return format("a ~= 0 and ENV.band(a, %d) ~= 0", bits.bor(field.alarm_bits, field.undefined))
end

-- The kinds ---------------------------------------------------------------------------------------

-- Return the kind of a filter of a field's width.
local function type_of_width(prefix, base_of)
  return function(field) return prefix .. field.size * 8, base_of(field) end
end

-- Return a function that always returns this.
local function constant(result)
  return function() return result end
end

local function hexadecimal_if_enum(field)
  return field.values and "HEX"
end

local function hex_digits(char)
  return format("%02x", byte(char))
end

local function float_value(field, raw)
  if raw > field.ordinary then return nil, field.top - raw end
  if raw < 0 then return nil, -1 - raw end -- of seven or eight bytes
  -- One division at the end, so that the middle of a symmetric range is 0 and not nearly 0.
  local steps = field.top - M.below_top
  return (field.min * steps + raw * (field.max - field.min)) / steps
end

local function ieee_value(_, raw)
  if raw ~= raw then return nil, 0 end
  if raw - raw ~= 0 then return nil, raw > 0 and 1 or 2 end
  return raw
end

local function time_number(_, raw)
  local seconds, nanoseconds = binary.time(raw, 0)
  return seconds + nanoseconds / 1e9
end

local OPERATORS = {
  ["*"] = function(a, b) return a * b end,
  ["-"] = function(a, b) return a - b end,
  ["+"] = function(a, b) return a + b end,
}

-- Work out a generated value from its two fields; nil where one of them has no value.
local function derived_value(item, raws)
  local a, b = M.value(item.a, raws[item.a.index]), M.value(item.b, raws[item.b.index])
  if not (a and b) then return nil end
  -- COMPAT 5.4: products of integers wrap around
  local value = OPERATORS[item.operator](a + 0.0, b + 0.0)
  return value - value == 0 and value or nil -- it may be too large
end

-- Return a kind with the parts of another, and its own.
local function extend(base, own)
  local kind = {}
  for _, parts in ipairs { base, own } do
    for name, part in pairs(parts) do kind[name] = part end
  end
  return kind
end

-- Integers, which may be codes; numbers with a fraction or a special; texts.
local CODE = {
  shown = "plain",
  choose = choose_integer,
  info = code_info,
  column = "integer",
  cells = code_cells,
  remark = remark_code,
  source = code_source,
  is_number = true,
  is_integer = true,
}
local NUMBER = {
  filter = constant("DOUBLE"),
  shown = "number",
  info = number_info,
  column = "float",
  cells = number_cells,
  remark = remark_special,
  is_number = true,
}
local TEXT = {
  choose = constant(read_bytes),
  info = text_info,
  column = "string",
  cells = text_cells,
  is_text = true,
}

--- By the name of the kind:
--   filter   function(field) -> Wireshark's type of its filter, and the base or nil
--   shown    how show.taurus adds it to a tree: "plain" (Wireshark reads the bytes), "number",
--            "text", "time" or "flags"
--   choose   function(field) -> function(field, payload), which reads the raw value
--   value    function(field, raw) -> see M.value; nil where the raw is the value
--   number   function(field, raw) -> the value as a number, nil where M.value is one
--   info     function(field, shape) -> a function(raw) -> a text for Info; shape = for a fraction
--   column   type of its column in CSV and fields.json; unit = of a column without one of its own
--   cells    function(field) -> a function(raw) -> its cells in CSV
--   remark   function(field, raw, remarks), which appends to the list that decode.new_reader
--            describes, for a remarkable value; nil if no value can be one
--   source   its condition as source, see above: function(field, i)
--   code     format of a code in texts; nil: hexadecimal
--   is_number, is_integer, is_text
M.BY_NAME = {
  uint = extend(CODE, { filter = type_of_width("UINT", hexadecimal_if_enum) }),
  int = extend(CODE, {
    filter = type_of_width("INT", constant(nil)),
    code = "%d", -- COMPAT 5.2: a negative number has no hexadecimal text
  }),
  -- value = count * scale + zero
  scaled = extend(CODE, {
    filter = constant("DOUBLE"),
    shown = "number",
    value = function(field, raw) return raw * field.scale + field.zero end,
    info = number_info,
    column = "float",
  }),
  bool = extend(CODE, {
    filter = constant("BOOLEAN"),
    info = constant(function(raw) return BOOLS[raw] or format("invalid 0x%x", raw) end),
    column = "bool",
    cells = constant(function(raw) return raw == 0 and "0" or "1" end),
    is_number = false,
  }),
  -- A compressed float.
  float = extend(NUMBER, { choose = choose_float, value = float_value, source = float_source }),
  ieee = extend(NUMBER, {
    choose = constant(read_ieee),
    value = ieee_value,
    source = special_source,
  }),
  flags = {
    filter = type_of_width("UINT", constant("HEX")),
    shown = "flags",
    choose = choose_integer,
    info = code_info,
    column = "integer",
    cells = flags_cells,
    remark = remark_flags,
    source = flags_source,
  },
  time = {
    filter = constant("RELATIVE_TIME"),
    shown = "time",
    choose = constant(read_bytes),
    number = time_number,
    info = constant(function(raw) return time_text(raw) .. " s" end),
    column = "time",
    unit = "s",
    cells = constant(time_text),
  },
  -- A text ends at its first NUL.  A character that cannot be shown is \xnn.
  string = extend(TEXT, {
    filter = constant("STRING"),
    shown = "text",
    value = function(_, raw) return utf8.value(raw:match("^%Z*")) end,
  }),
  bytes = extend(TEXT, {
    filter = constant("BYTES"),
    shown = "plain",
    value = function(_, raw) return (raw:gsub(".", hex_digits)) end,
  }),
  -- Worked out from two fields; its raw value is the list of all.
  derived = { column = "float", value = derived_value, cells = derived_cells, is_number = true },
}

--- Return a function(raw) -> the cells of a field in CSV.  It keeps the latest text: flags and the
-- like seldom change.
function M.cells_of(field)
  local write, latest, text = M.BY_NAME[field.kind].cells(field), nil, nil
  return function(raw)
    if raw ~= latest then latest, text = raw, write(raw) end
    return text
  end
end

--- Return whether a field, or an item of message.generated, has numbers that are no codes.
function M.is_number(field)
  return M.BY_NAME[field.kind].is_number and not field.values
end

--- Return the value of a field as a number: NaN where that is none, such as a reserved value.
function M.number(field, raw)
  local number = M.BY_NAME[field.kind].number
  if number then return number(field, raw) end
  return tonumber((M.value(field, raw))) or 0 / 0 -- of 64 bits a text, where a double is not exact
end

--- Return the highest raw value that is a number, of a field whose raw values are counts and whose
-- numbers grow in proportion to them: so that a mean of raw values gives the mean.  Nil for others.
function M.linear_top(field)
  local kind = field.kind
  local is_linear = kind == "float" or kind == "uint" or kind == "int" or
    kind == "scaled" and field.scale > 0
  if not is_linear or field.size > 6 then return nil end
  return field.ordinary or field.top
end

return M
