-- SPDX-License-Identifier: GPL-2.0-or-later
-- From the payload of a message to its values, by the compiled catalogue.  Pure Lua, 5.2 and 5.4.
-- What it needs to know of a message or a field, beyond what the catalogue says, it keeps here.

local bits = require("yapp.base.bits")
local numbers = require("yapp.message.numbers")
local reader = require("yapp.message.raws")
local utf8 = require("yapp.base.utf8")

local M = {}

-- The reserved counts of compressed floats, from the top down ("YAPP Float Compression"): the index is what
-- <field>.special says.
local SPECIALS = {
  [0] = "Not a Number", "Positive Infinity", "Negative Infinity", "Out of Range High", "Out of Range Low",
}
M.SPECIALS = SPECIALS

local format, concat, band = string.format, table.concat, bits.band
local WEAK = { __mode = "k" }

-- Reading -----------------------------------------------------------------------------------------------------------

local kept_of = setmetatable({}, WEAK) -- by message: { read, raws, payload and look of the latest }

-- Reads a payload that a capture cut.
local function read_short(kept, message, payload)
  local raws = kept.raws
  kept.look = kept.read(payload .. ("\0"):rep(message.size - #payload), raws)
  for i, field in ipairs(message.fields) do
    if field.offset + field.size > #payload then raws[i] = nil end
  end
end

--- The raw values of a payload.
-- message  compiled
-- payload  string; may be shorter than the message where a capture cut it: only fields that are whole are read
-- returns  { [index of field] = raw }, without times (see M.time), missing fields and cases that are not chosen: the
--          same table for every payload of a message, to be read only.  And whether M.remarks has something to say.
-- A raw is the integer or the count as sent, but for ieee the number, for a 64 bit integer beyond 2^53 its decimal
-- digits, for strings and bytes the bytes; of a compressed float of seven or eight bytes -1 - n is the reserved count
-- n.
function M.read(message, payload)
  local kept = kept_of[message]
  if not kept then
    kept = { read = reader.make(message), raws = {} }
    kept_of[message] = kept
  end
  if kept.payload == payload then return kept.raws, kept.look end -- a statistic comes after the tree
  if #payload >= message.size then
    kept.look = kept.read(payload, kept.raws)
  else
    read_short(kept, message, payload)
  end
  kept.payload = payload
  return kept.raws, kept.look
end

--- A signed 64 bit count of nanoseconds ("Time"): seconds, nanoseconds, see message.numbers.
M.time = numbers.time

--- A time in seconds with nine digits behind the point.
function M.seconds(seconds, nanoseconds)
  local sign = (seconds < 0 or nanoseconds < 0) and "-" or ""
  return format("%s%d.%09d", sign, seconds < 0 and -seconds or seconds, nanoseconds < 0 and -nanoseconds or nanoseconds)
end

-- Values ------------------------------------------------------------------------------------------------------------

-- Compressed floats: floatN <min; max> has counts 0 .. top, top = 2^N - 1.  The five highest are reserved; the others
-- map linearly:  value = min + count * (max - min) / (top - 5).  The document's worked examples divide by top - 4;
-- its mapping table and the 0 A of the captured example prove top - 5.
M.MAPPING = 5
M.WORKED_EXAMPLES = 4

local divisor = M.MAPPING
local version = 0

--- Makes every compressed float divide by top - divisor.
-- new  M.MAPPING, or M.WORKED_EXAMPLES to reproduce the printed figures
function M.use_divisor(new)
  if new ~= divisor then divisor, version = new, version + 1 end
end

--- What compressed floats divide by, as top - divisor, and a number that changes with it.
function M.divisor() return divisor, version end

-- A number as source; COMPAT 5.4: as a float.
local function literal(number)
  local text = format("%.17g", number)
  return text:find("[.e]") and text or text .. ".0"
end

--- The value of a compressed float as Lua source: "(-8387840.0 + a * 256.0) / 65530.0".  It is that of the divisor of
-- now: what is made of it is good as long as the second of M.divisor() is the same.
-- a  what has the count, as source
function M.float_source(field, a)
  local steps = field.top - divisor
  return format("(%s + %s * %s) / %s", literal(field.min * steps), a, literal(field.max - field.min), literal(steps))
end

-- Which reserved count a count of a compressed float is (0 .. 4), nil for an ordinary one.
local function reserved(field, raw)
  if raw > field.ordinary then return field.top - raw end
  if raw < 0 then return -1 - raw end
end

-- One division at the end, so that the middle of a symmetric range is 0 and not nearly 0.
local function float(field, raw)
  local steps = field.top - divisor
  return (field.min * steps + raw * (field.max - field.min)) / steps
end

--- The value of a compressed float, unrounded; nil and which special (0 .. 4) for a reserved count.
function M.float(field, raw)
  local special = reserved(field, raw)
  if special then return nil, special end
  return float(field, raw)
end

local function ieee(raw)
  if raw ~= raw then return nil, 0 end
  if raw - raw ~= 0 then return nil, raw > 0 and 1 or 2 end
  return raw
end

--- The text of a string field: up to its first NUL; where that is no UTF-8, or has control characters, what is not
-- printable ASCII is written \xNN.
function M.text(raw)
  local text = raw:match("^%Z*")
  if not text:find("[%c\128-\255]") then return text end
  if not text:find("%c") and not utf8.ascii(text):find("[\128-\255]") then return text end
  return (text:gsub("[%c\128-\255]", function(char) return format("\\x%02x", char:byte()) end))
end

--- Bytes as hexadecimal digits.
function M.hex(raw)
  return (raw:gsub(".", function(char) return format("%02x", char:byte()) end))
end

--- The value of a field in its unit, unrounded.
-- raw      from M.read
-- returns  a number; a string for strings, bytes (hexadecimal) and integers beyond 2^53; nil where there is none, and
--          then which special (0 .. 4, as <field>.special has it) for a float that is no number
function M.value(field, raw)
  if not raw then return nil end
  local kind = field.kind
  if kind == "float" then return M.float(field, raw) end
  if kind == "ieee" then return ieee(raw) end
  if field.scale then return raw * field.scale + field.zero end
  if kind == "string" then return M.text(raw) end
  if kind == "bytes" then return M.hex(raw) end
  return raw
end

-- The digits that a compressed float of so many bytes can carry.
local DIGITS = { 7, 7, 10, 10, 15, 15, 15, 15 }

--- The format of a value with as many digits as its count can carry: "%.7g"; nil for ieee and what is no fraction.
function M.format_of(field)
  if field.kind == "float" then return "%." .. DIGITS[field.size] .. "g" end
  return field.scale and "%.15g" or nil
end

local formats = setmetatable({}, WEAK) -- by field

--- A value with the digits that its count can carry, so that a filter with == 1.1 matches.
function M.rounded(field, value)
  local shape = formats[field]
  if not shape then
    shape = M.format_of(field) or "ieee"
    formats[field] = shape
  end
  if shape == "ieee" then return numbers.shortest(value, field.size) end
  return tonumber(format(shape, value))
end

--- The value of a difference of a message, at seven digits; nil where one of its two fields has none.
function M.difference(message, difference, raws)
  local a, b = message.fields[difference.a], message.fields[difference.b]
  local first, second = M.value(a, raws[difference.a]), M.value(b, raws[difference.b])
  if not first or not second then return nil end
  return tonumber(format("%.7g", first - second))
end

-- Flags -------------------------------------------------------------------------------------------------------------

--- The bits that two numbers of 32 bits have in common.
M.band = band

--- The bits that are set and that no flag of the field defines, as a number.
function M.undefined(field, raw)
  return band(raw, field.undefined)
end

local MOST_NAMES = 256
local names_of = setmetatable({}, WEAK) -- by field: { [raw] = text, count = number of texts }

local function make_names(field, raw)
  local names = {}
  for _, flag in ipairs(field.flags) do
    if band(raw, flag.mask) ~= 0 then names[#names + 1] = flag.name end
  end
  local undefined = M.undefined(field, raw)
  if undefined ~= 0 then names[#names + 1] = format("undefined 0x%x", undefined) end
  return concat(names, ", ")
end

--- The filter names of the flags that are set, undefined bits as one number: "motor_overcurrent, hall_timeout".
function M.flag_names(field, raw)
  local known = names_of[field]
  if not known or known.count >= MOST_NAMES then
    known = { count = 0 }
    names_of[field] = known
  end
  local text = known[raw]
  if not text then
    text = make_names(field, raw)
    known[raw], known.count = text, known.count + 1
  end
  return text
end

-- Remarks -----------------------------------------------------------------------------------------------------------

-- Adds { i, expert } for what is remarkable in a value, by kind.
local remarks_of = {}

function remarks_of.float(field, raw, i, add)
  if reserved(field, raw) then add(i, "value.special") end
end

function remarks_of.ieee(_, raw, i, add)
  if raw - raw ~= 0 then add(i, "value.special") end
end

function remarks_of.flags(field, raw, i, add)
  if field.alarm and band(raw, field.watched) ~= 0 then add(i, "fault.active") end
  if M.undefined(field, raw) ~= 0 then add(i, "flags.undefined") end
end

function remarks_of.uint(field, raw, i, add)
  if field.values and not field.values[raw] or field.cases and not field.cases[raw] then add(i, field.invalid) end
end

remarks_of.int = remarks_of.uint

function remarks_of.bool(field, raw, i, add)
  if raw > 1 or field.cases and not field.cases[raw] then add(i, field.invalid) end
end

--- What is remarkable in the values: one entry an expert item.
-- message  compiled
-- raws     from M.read
-- returns  a list of { index of field, expert }, nil when there is nothing
function M.remarks(message, raws)
  local remarks
  local function add(i, expert)
    remarks = remarks or {}
    remarks[#remarks + 1] = { i, expert }
  end
  for i, field in ipairs(message.fields) do
    local raw, look = raws[i], remarks_of[field.kind]
    if raw and look then look(field, raw, i, add) end
  end
  return remarks
end

return M
