-- SPDX-License-Identifier: GPL-2.0-or-later
-- The kinds of field, a record each: the reading of its bytes, its values, its remarkable values,
-- and its forms in filters, Info and CSV.  Pure Lua.
--
-- A new kind is a record here, and the types that have it in message.catalogue.
--
-- A raw value is the integer or the count as sent.  Exceptions: the number of ieee; the decimal
-- digits of an integer beyond 2^53; the bytes of times, strings and bytes.

local binary = require "yapp.message.binary"
local bits = require "yapp.base.bits"
local utf8 = require "yapp.base.utf8"

local M = {}

local band = bits.band
local format, sub = string.format, string.sub

--- The reserved values of compressed floats, from the highest count down ("YAPP Float
-- Compression").  The index is the value of <field>.special.
M.SPECIALS = {
  [0] = "Not a Number",
  "Positive Infinity",
  "Negative Infinity",
  "Out of Range High",
  "Out of Range Low",
}
local SPECIAL_WORDS = { [0] = "NaN", "+inf", "-inf", "above range", "below range" } -- in Info
local SPECIAL_CELLS = { [0] = ",nan", ",inf", ",-inf", ",above", ",below" } -- in CSV

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

-- Values -----------------------------------------------------------------------------------------

--- Return the value of a field in its unit, unrounded.
-- raw      see above; of a generated value, the list of all raw values
-- returns  a number; a string for strings, bytes (hexadecimal) and integers beyond 2^53; nil where
--          there is none, and then which special (0 .. 4, as <field>.special has it) for a float
--          that is no number
function M.value(field, raw)
  if not raw then return nil end
  return M.BY_NAME[field.kind].value(field, raw)
end

--- Return the value of a compressed float whose count is not reserved.
function M.ordinary_value(field, raw)
  -- One division at the end, so that the middle of a symmetric range is 0 and not nearly 0.
  local steps = field.top - M.below_top
  return (field.min * steps + raw * (field.max - field.min)) / steps
end

--- Return a number as a text with as many digits as its count can carry: "1.1" for
-- 11 * 0.1 = 1.1000000000000001, so that a filter `== 1.1` matches it.
-- field  or an item of a message type's generated values
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
  local value_of = M.BY_NAME[field.kind].value
  return function(raw)
    local value, special = value_of(field, raw)
    if not value then return nil, special end
    return M.number_text(field, value)
  end
end

--- Return a text as a cell of CSV: in quotes where it must be.
function M.quoted(text)
  if text:find('[,"\r\n]') then return '"' .. text:gsub('"', '""') .. '"' end
  return text
end

-- Integers, which may be codes -------------------------------------------------------------------

-- Append a remark, see message.decode.
local function add_remark(remarks, field, expert, is_undefined)
  remarks[#remarks + 1] = { field.index, expert, is_undefined }
end

-- Return the kind of a filter of a field's width.
local function integer_type(prefix, field)
  return prefix .. (field.size > 4 and 64 or field.size * 8)
end

local function return_raw(_, raw)
  return raw
end

local CODE = {
  shown = "plain",
  column = "integer",
  is_number = true,
  is_linear = true,
  read = function(field, payload)
    local index, size = field.offset + 1, field.size
    if size > 6 then return binary.integer64(payload, index, size, field.bottom < 0) end
    local count = binary.count(payload, index, size)
    return count > field.top and count - 2 * (field.top + 1) or count
  end,
  value = return_raw,
  info = function(field)
    local values, invalid = field.values, "invalid " .. (M.BY_NAME[field.kind].code or "0x%x")
    return function(raw)
      if not values then return M.number_text(field, raw) end
      return values[raw] or format(invalid, raw)
    end
  end,
  cells = function(field)
    local values = field.values
    return function(raw)
      local text = M.number_text(field, M.value(field, raw))
      return values and text .. "," .. M.quoted(values[raw] or "") or text
    end
  end,
  source = function(field, i)
    return field.values and format("not FIELDS[%d].values[a]", i)
  end,
  remark = function(field, _, remarks)
    add_remark(remarks, field, field.invalid, true)
  end,
}

-- Numbers with a fraction or a special -----------------------------------------------------------

local function number_info(field, shape)
  return function(raw)
    local value, special = M.value(field, raw)
    return special and SPECIAL_WORDS[special] or format(shape, value)
  end
end

local NUMBER = {
  filter = function() return "DOUBLE" end,
  shown = "number",
  info = number_info,
  column = "float",
  is_number = true,
  cells = function(field)
    local write = M.new_number_text(field)
    return function(raw)
      local text, special = write(raw)
      return text and text .. "," or SPECIAL_CELLS[special]
    end
  end,
  remark = function(field, _, remarks)
    add_remark(remarks, field, "value.special", false)
  end,
}

-- Bytes ------------------------------------------------------------------------------------------

local function time_text(raw)
  return binary.seconds(binary.time(raw, 0))
end

local TEXT = {
  column = "string",
  read = function(field, payload)
    return sub(payload, field.offset + 1, field.offset + field.size)
  end,
  info = function(field)
    return function(raw) return M.value(field, raw) end
  end,
  cells = function(field)
    return function(raw) return M.quoted(M.value(field, raw)) end
  end,
  is_text = true,
}

-- The kinds --------------------------------------------------------------------------------------

-- Return a kind with the parts of another, and its own.
local function extend(base, own)
  for name, part in pairs(base) do
    if own[name] == nil then own[name] = part end
  end
  return own
end

local OPERATORS = {
  ["*"] = function(a, b) return a * b end,
  ["-"] = function(a, b) return a - b end,
  ["+"] = function(a, b) return a + b end,
}

--- By the name of the kind:
--   filter   function(field) -> Wireshark's type of its filter, and the base or nil
--   shown    how show.taurus adds it to a tree: "plain" (Wireshark reads the bytes), "number",
--            "text", "time" or "flags"
--   read     function(field, payload) -> raw
--   value    function(field, raw) -> see M.value
--   info     function(field, shape) -> a function(raw) -> a text for Info; shape = for a fraction
--   column   type of its column in CSV and fields.json; unit = of a column without one of its own
--   cells    function(field) -> a function(raw) -> its cells in CSV
--   source   function(field, i) -> when a raw value is remarkable, as Lua source for
--            message.decode: a is the raw value, FIELDS[i] the field
--   remark   function(field, raw, remarks), which appends to the remarks, see message.decode
--   code     format of a code in texts; nil: hexadecimal
--   is_number, is_text
--   is_linear  true if its raw values are counts to which its numbers grow in proportion
M.BY_NAME = {
  uint = extend(CODE, {
    filter = function(field) return integer_type("UINT", field), field.values and "HEX" end,
  }),
  int = extend(CODE, {
    filter = function(field) return integer_type("INT", field) end,
    code = "%d", -- COMPAT 5.2: a negative number has no hexadecimal text
  }),
  -- value = count * scale + zero
  scaled = extend(CODE, {
    filter = NUMBER.filter,
    shown = "number",
    value = function(field, raw) return raw * field.scale + field.zero end,
    info = number_info,
    column = "float",
  }),
  bool = extend(CODE, {
    filter = function() return "BOOLEAN" end,
    info = function()
      local words = { [0] = "false", "true" }
      return function(raw) return words[raw] or format("invalid 0x%x", raw) end
    end,
    column = "bool",
    cells = function()
      return function(raw) return raw == 0 and "0" or "1" end
    end,
    source = function() return "a > 1" end,
    is_number = false,
  }),
  -- A compressed float.
  float = extend(NUMBER, {
    read = CODE.read,
    value = function(field, raw)
      if raw > field.ordinary then return nil, field.top - raw end
      return M.ordinary_value(field, raw)
    end,
    source = function(field) return format("a > %d", field.ordinary) end,
    is_linear = true,
  }),
  ieee = extend(NUMBER, {
    read = function(field, payload)
      return binary.ieee(payload, field.offset + 1, field.size)
    end,
    value = function(_, raw)
      if raw - raw == 0 then return raw end
      return nil, raw ~= raw and 0 or raw > 0 and 1 or 2
    end,
    source = function() return "a - a ~= 0" end,
  }),
  flags = extend(CODE, {
    filter = function(field) return integer_type("UINT", field), "HEX" end,
    shown = "flags",
    cells = function(field)
      return function(raw)
        local texts = { M.number_text(field, raw) }
        for i, flag in ipairs(field.flags) do
          texts[i + 1] = band(raw, flag.mask) ~= 0 and "1" or "0"
        end
        return table.concat(texts, ",")
      end
    end,
    source = function(field)
      local mask = bits.bor(field.alarm_bits, field.undefined)
      return format("a > 0 and band(a, %d) ~= 0", mask)
    end,
    remark = function(field, raw, remarks)
      if band(raw, field.alarm_bits) ~= 0 then
        add_remark(remarks, field, "fault.active", false)
        remarks.has_fault = true
      end
      if band(raw, field.undefined) ~= 0 then
        add_remark(remarks, field, "flags.undefined", true)
      end
    end,
    is_number = false,
    is_linear = false,
  }),
  time = extend(TEXT, {
    filter = function() return "RELATIVE_TIME" end,
    shown = "time",
    value = return_raw,
    info = function()
      return function(raw) return time_text(raw) .. " s" end
    end,
    column = "time",
    unit = "s",
    cells = function() return time_text end,
    is_text = false,
  }),
  -- A text ends at its first NUL.  A character that cannot be shown is \xnn.
  string = extend(TEXT, {
    filter = function() return "STRING" end,
    shown = "text",
    value = function(_, raw) return utf8.printable(raw:match("^%Z*"), "\\x%02x") end,
  }),
  bytes = extend(TEXT, {
    filter = function() return "BYTES" end,
    shown = "plain",
    value = function(_, raw)
      return (raw:gsub(".", function(char) return format("%02x", char:byte()) end))
    end,
  }),
  -- Worked out from two fields; nil where one of them has no value.
  derived = {
    column = "float",
    is_number = true,
    value = function(item, raws)
      local a, b = M.value(item.a, raws[item.a.index]), M.value(item.b, raws[item.b.index])
      if not (a and b) then return nil end
      -- COMPAT 5.4: products of integers wrap around
      local value = OPERATORS[item.operator](a + 0.0, b + 0.0)
      return value - value == 0 and value or nil -- it may be too large
    end,
    cells = function(item)
      local write = M.new_number_text(item)
      return function(raws) return write(raws) or "" end
    end,
  },
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

--- Return whether a field, or a generated value, has numbers that are no codes.
function M.is_number(field)
  return M.BY_NAME[field.kind].is_number and not field.values
end

--- Return the value of a field as a number: NaN where that is none, such as a reserved value.
function M.number(field, raw)
  if field.kind == "time" then
    local seconds, nanoseconds = binary.time(raw, 0)
    return seconds + nanoseconds / 1e9
  end
  return tonumber((M.value(field, raw))) or 0 / 0 -- of 64 bits a text, where a double is not exact
end

--- Return the highest raw value that is a number, of a field whose raw values are counts and whose
-- numbers grow in proportion to them: so that a mean of raw values gives the mean.  Nil for others.
function M.linear_top(field)
  local is_linear = M.BY_NAME[field.kind].is_linear and (field.scale or 1) > 0
  return is_linear and field.size <= 6 and (field.ordinary or field.top) or nil
end

return M
