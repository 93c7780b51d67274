-- From the payload of a message to its values, by the compiled catalogue.  Pure Lua, 5.2 and 5.4.

local M = {}

-- The reserved counts of compressed floats, from the top down ("YAPP Float Compression"): the index is what
-- <field>.special says.
local SPECIALS = {
  [0] = "Not a Number", "Positive Infinity", "Negative Infinity", "Out of Range High", "Out of Range Low",
}
local SPECIALS_SHORT = { [0] = "NaN", "+inf", "-inf", "above range", "below range" }
M.SPECIALS = SPECIALS

local byte, format, concat = string.byte, string.format, table.concat
local unpack = rawget(table, "unpack")

-- COMPAT 5.4: a quotient is a float there, and NSTime takes integers only.
local integer = rawget(math, "tointeger") or function(n) return n end

-- Native operators are syntax errors in Lua 5.2; Wireshark's has BitOp (signed results), plain Lua 5.2 has bit32.
local native = load("return function(a, b) return a & b end")
local library = not native and (rawget(_G, "bit") or require("bit32"))
local band = native and native() or function(a, b) return library.band(a, b) % 0x100000000 end

-- The reader of a message as Lua source: this runs for every packet, and one straight function is three times as fast
-- as a loop over the fields.  It fills raws and says whether any count needs a second look.
--   raws[5] = p9 + p10 * 0x100    if raws[5] > 65530 then look = true end
local function reader_source(message)
  local lines = { "local byte, band, VALUES = ... return function(payload, raws) local look = false local a, b, c, d" }
  for i, field in ipairs(message.fields) do
    local size = field.size
    if size <= 4 then
      lines[#lines + 1] = format("a, b, c, d = byte(payload, %d, %d)", field.offset + 1, field.offset + size)
      lines[#lines + 1] = "a = a" .. (" + b * 0x100 + c * 0x10000 + d * 0x1000000"):sub(1, ({ 0, 12, 0, 42 })[size])
      lines[#lines + 1] = format("raws[%d] = a", i)
      if field.values then lines[#lines + 1] = format("if not VALUES[%d][a] then look = true end", i) end
      if field.undefined and not field.alarm then
        lines[#lines + 1] = format("if a ~= 0 and band(a, %d) ~= 0 then look = true end", field.undefined)
      end
      if field.ordinary then lines[#lines + 1] = format("if a > %d then look = true end", field.ordinary) end
    end
  end
  lines[#lines + 1] = "return look end"
  return concat(lines, "\n")
end

local function make_reader(message)
  local values = {}
  for i, field in ipairs(message.fields) do values[i] = field.values end
  return load(reader_source(message), "=reader of " .. message.name)(byte, band, values)
end

--- The raw counts of a payload.
-- message  compiled
-- payload  string; may be shorter than the message where a capture cut it: only fields that are whole are read
-- returns  { [index of field] = unsigned number }, without times (see M.time) and without missing fields; the same
--          table for every payload of a message.  And whether M.remarks has something to say.
function M.read(message, payload)
  local raws = message.raws
  local reader = message.reader
  if not reader then
    reader = make_reader(message)
    message.reader = reader
  end
  local missing = message.size - #payload
  local look = reader(missing > 0 and payload .. ("\0"):rep(missing) or payload, raws)
  if missing > 0 then
    for i, field in ipairs(message.fields) do
      if field.offset + field.size > #payload then raws[i] = nil end
    end
  end
  return raws, look
end

--- A signed 64 bit count of nanoseconds, little endian ("Time"), split exactly.
-- payload  string; offset: 0-based
-- returns  seconds, nanoseconds; both negative, or zero, for a negative time
function M.time(payload, offset)
  local bytes = { byte(payload, offset + 1, offset + 8) }
  local negative = bytes[8] >= 0x80
  if negative then -- two's complement: invert, add one
    local carry = 1
    for i = 1, 8 do
      local b = 0xFF - bytes[i] + carry
      carry = b > 0xFF and 1 or 0
      bytes[i] = b % 0x100
    end
  end
  -- Long division by 10^9, a byte a step: no intermediate leaves the exact range of a double.
  local seconds, rest = 0, 0
  for i = 8, 1, -1 do
    rest = rest * 0x100 + bytes[i]
    local nanoseconds = rest % 1000000000
    seconds = seconds * 0x100 + (rest - nanoseconds) / 1000000000
    rest = nanoseconds
  end
  seconds = integer(seconds)
  if negative then return -seconds, -rest end
  return seconds, rest
end

-- Compressed floats: floatN <min; max> has counts 0 .. top, top = 2^N - 1.  The five highest are reserved; the others
-- map linearly:  value = min + count * (max - min) / (top - 5).  The document's worked examples divide by top - 4;
-- its mapping table and the 0 A of the captured example prove top - 5.
M.MAPPING = 5
M.WORKED_EXAMPLES = 4

--- Makes every compressed float of a catalogue divide by top - divisor.
-- divisor  M.MAPPING, or M.WORKED_EXAMPLES to reproduce the printed figures
function M.use_divisor(catalogue, divisor)
  for _, message in ipairs(catalogue.messages) do
    for _, field in ipairs(message.fields) do
      if field.kind == "float" then field.steps = field.top - divisor end
    end
  end
end

-- One division at the end, so that the middle of a symmetric range is 0 and not nearly 0.
local function float(field, raw)
  return (field.min * field.steps + raw * (field.max - field.min)) / field.steps
end

--- The value of a compressed float, unrounded; nil and which special (0 .. 4) for a reserved count.
function M.float(field, raw)
  if raw > field.top - 5 then return nil, field.top - raw end
  return float(field, raw)
end

function M.rounded(_, value) return M.round(value) end

function M.value(field, raw) -- until the catalogue brings its own
  if field.kind == "float" then return M.float(field, raw) end
  return raw
end

--- A value at the seven digits that a count can carry, so that a filter with == 1.1 matches.
function M.round(value)
  return tonumber(format("%.7g", value))
end

-- What is remarkable in a value of each kind: calls add(expert, text).
local remarks_of = {}

function remarks_of.float(field, raw, add)
  if raw > field.top - 5 then
    add("value.special", format("%s: %s (0x%0" .. field.size * 2 .. "x)", field.title, SPECIALS[field.top - raw], raw))
  end
end

function remarks_of.flags(field, raw, add)
  if raw == 0 then return end
  if field.alarm then add("fault.active", field.title .. ": " .. M.flag_names(field, raw)) end
  local undefined = band(raw, field.undefined)
  if undefined ~= 0 then add("flags.undefined", format("%s: undefined bits 0x%x", field.title, undefined)) end
end

function remarks_of.uint(field, raw, add)
  if field.values and not field.values[raw] then
    add(field.invalid, format("%s: 0x%02x is not a value that the document defines", field.title, raw))
  end
end

--- What is remarkable in the values: one entry an expert item.
-- message  compiled
-- raws     from M.read
-- returns  a list of { index of field, expert, text }, nil when there is nothing
function M.remarks(message, raws)
  local remarks
  local fields = message.fields
  for i = 1, #fields do
    local field, raw = fields[i], raws[i]
    local values = field.values
    if raw and (field.flags or field.ordinary and raw > field.ordinary or values and not values[raw]) then
      remarks = remarks or {}
      remarks_of[field.kind](field, raw, function(expert, text) remarks[#remarks + 1] = { i, expert, text } end)
    end
  end
  return remarks and remarks[1] and remarks
end

--- The bits that are set and that no flag of the field defines, as a number.
function M.undefined(field, raw)
  return band(raw, field.undefined)
end

--- The filter names of the flags that are set, undefined bits as one number: "motor_overcurrent, hall_timeout".
function M.flag_names(field, raw)
  local names = {}
  for _, flag in ipairs(field.flags) do
    if band(raw, flag.mask) ~= 0 then names[#names + 1] = flag.name end
  end
  local undefined = M.undefined(field, raw)
  if undefined ~= 0 then names[#names + 1] = format("undefined 0x%x", undefined) end
  return concat(names, ", ")
end

local function shown(part, raw)
  local field = part.field
  if not raw then return "?" end
  if field.kind == "float" then
    if raw > field.top - 5 then return SPECIALS_SHORT[field.top - raw] end
    return format(part.format, float(field, raw))
  end
  return field.values and (field.values[raw] or format("invalid 0x%x", raw)) or format("%d", raw)
end

-- The parts of an Info text one by one, for values that the usual format cannot show.
local function info_in_parts(message, raws)
  local texts = { message.title, "  " }
  for i, part in ipairs(message.info) do
    texts[i + 2] = part.field and shown(part, raws[part.index]) or part
  end
  return concat(texts)
end

local values = {} -- of one Info text at a time

--- What the Info column says of a message.
function M.info(message, raws)
  local fields, text = message.info_fields, nil
  for i = 1, #fields do
    local part = fields[i]
    local field, raw = part.field, raws[part.index]
    local value
    if not raw then break end
    if field.kind ~= "float" then
      value = field.values and field.values[raw]
    elseif raw <= field.top - 5 then
      value = float(field, raw)
    end
    if not value then break end
    values[i] = value
    if i == #fields then text = format(message.info_format, unpack(values, 1, i)) end
  end
  text = text or info_in_parts(message, raws)
  for _, field in ipairs(message.alarms) do
    local raw = raws[message.index[field]]
    if raw and raw ~= 0 then text = text .. "  " .. field.alarm .. " " .. M.flag_names(field, raw) end
  end
  return text
end

return M
