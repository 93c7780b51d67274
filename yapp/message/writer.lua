-- SPDX-License-Identifier: GPL-2.0-or-later
-- Writes the values of a message as one text: the Info column, a row of CSV.  Pure Lua.
--
-- A usual message, all fields present and no value reserved, is written by a function made from Lua
-- source: a loop over the pieces would make a packet list 6 % slower, and a table 13 %.

local decode = require("yapp.message.decode")

local M = {}

local format, concat = string.format, table.concat

local MAX_PIECES = 100 -- of a usual message: a function has up to 200 local variables

-- Return a number as source; COMPAT 5.4: as a float.
local function literal(number)
  local text = format("%.17g", number)
  return text:find("[.e]") and text or text .. ".0"
end

-- Return the value of a compressed float as source: "(-8387840.0 + a2 * 256.0) / 65530.0".
local function value_source(field, a)
  local steps, span = field.top - decode.divisor, field.max - field.min
  return format("(%s + %s * %s) / %s", literal(field.min * steps), a, literal(span), literal(steps))
end

local SOURCE = [[
local WRITE, SHAPE, format = ...
return function(raws)
%s
return format(%s)
end]]

-- Return the source of the function for usual messages, the functions that it calls and its format.
local function source_of(pieces)
  local lines, values, writes, shapes = {}, { "SHAPE" }, {}, {}
  for i, piece in ipairs(pieces) do
    local field, a = piece.field, "a" .. i
    if type(piece) == "string" then
      shapes[i] = piece:gsub("%%", "%%%%")
    elseif piece.shape then
      lines[#lines + 1] = format("local %s = raws[%d] if not %s or %s > %d then return nil end",
        a, piece.index, a, a, field.ordinary)
      shapes[i], values[#values + 1] = piece.shape, value_source(field, a)
    else
      local raw = piece.index and format("raws[%d]", piece.index) or "raws"
      lines[#lines + 1] = format("local %s = %s if not %s then return nil end", a, raw, a)
      shapes[i], values[#values + 1] = "%s", format("WRITE[%d](%s)", i, a)
      writes[i] = piece.write
    end
  end
  return format(SOURCE, concat(lines, "\n"), concat(values, ", ")), writes, concat(shapes)
end

-- Write the pieces one by one.
local function write_each(pieces, raws)
  local texts = {}
  for i, piece in ipairs(pieces) do
    local raw = piece
    if piece.write then
      raw = raws
      if piece.index then raw = raws[piece.index] end
      raw = raw and piece.write(raw) or piece.absent
    end
    texts[i] = raw
  end
  return concat(texts)
end

--- Make a function that writes a message.
-- pieces   list of texts, and of { index = of a field, or nil; field =; write = function(raw) ->
--          text, which takes all raws where index is nil; absent = the text of a missing field;
--          shape = a format for the value of a compressed float of up to six bytes, or nil }
-- returns  function(raws) -> text
function M.new(pieces)
  local divisor, write_usual
  return function(raws)
    if divisor ~= decode.divisor then
      divisor, write_usual = decode.divisor, function() end
      if #pieces <= MAX_PIECES then
        local source, writes, shape = source_of(pieces)
        write_usual = load(source, "=writer")(writes, shape, format)
      end
    end
    return write_usual(raws) or write_each(pieces, raws)
  end
end

--- Return whether the value of a field can be written by a shape.
function M.takes_shape(field)
  return field.kind == "float" and field.size <= 6
end

return M
