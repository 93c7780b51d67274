-- SPDX-License-Identifier: GPL-2.0-or-later
-- What the Info column says of a message, as the catalogue writes it: "{name:%.1f} V".  Pure Lua.

local check = require("yapp.message.check")
local decode = require("yapp.message.decode")
local straight = require("yapp.message.straight")

local M = {}

local format, concat = string.format, table.concat

local SPECIALS = { [0] = "NaN", "+inf", "-inf", "above range", "below range" }
local BOOLS = { [0] = "false", "true" }

-- Whether the value of a field is a number with a fraction.
local function is_real(field)
  return field.special or field.scale
end

-- What a field shows.
-- shape    of a number with a fraction
local function shown(field, shape, raw)
  if not raw then return "-" end
  if field.kind == "time" then return decode.seconds(decode.time(raw, 0)) .. " s" end
  local value, special = decode.value(field, raw)
  if special then return SPECIALS[special] end
  if is_real(field) then return format(shape, value) end
  local values = field.values
  if field.kind == "bool" then values = BOOLS end
  if not values then return decode.digits(value) end
  local invalid = field.kind == "int" and "invalid %d" or "invalid 0x%x"
  return values[raw] or format(invalid, raw)
end

-- Compiling --------------------------------------------------------------------------------------

local function compile_part(message, name, shape)
  local field = message.by_name[name]
  check.demand(field, "info names a field %s that is not there", check.shown(name))
  check.demand(shape == "" or is_real(field) and shape:find("^%%%.?%d?[fg]$"),
    "info: the format %s is not one for %s", check.shown(shape), name)
  if shape == "" then shape = "%.4g" end
  local part = {
    field = field,
    index = message.index[field],
    shape = shape,
  }
  if straight.is_plain(field) then return part, shape end
  function part.write(raw)
    return raw and shown(field, shape, raw)
  end
  return part, "%s"
end

--- Compiles the text of a message: sets its
--   info      parts { { field = f, index = i, shape = "%.1f" }, " V" }
--   usual     function(raws) -> the same as one text, nil where a value is absent or special
-- Raises what is wrong.
function M.compile(message, text)
  local parts, fields = {}, {}
  local shape, at = "", 1
  while at do
    local from, to, name, part_shape = text:find("{([%w_]+):?([^}]*)}", at)
    local literal = text:sub(at, (from or 0) - 1)
    if literal ~= "" then parts[#parts + 1] = literal end
    shape = shape .. literal:gsub("%%", "%%%%")
    if from then
      local part, of_part = compile_part(message, name, part_shape)
      parts[#parts + 1] = part
      fields[#fields + 1] = part
      shape = shape .. of_part
    end
    at = to and to + 1
  end
  message.info = parts
  message.usual = straight.writer(fields, shape)
end

-- The text ---------------------------------------------------------------------------------------

-- The parts of the text one by one, for values that the usual format cannot show.
local function in_parts(message, raws)
  local texts = {}
  for i, part in ipairs(message.info) do
    texts[i] = part
    if part.field then
      texts[i] = shown(part.field, part.shape, raws[part.index])
    end
  end
  return concat(texts)
end

--- What the Info column says of a message.
-- raws     from decode.read
-- name     what the message is called; its title when left out
-- look     false where nothing in the values is remarkable
function M.text(message, raws, name, look)
  local text = message.usual(raws) or in_parts(message, raws)
  text = (name or message.title) .. "  " .. text
  if look == false then return text end
  local word
  for _, field in ipairs(message.alarms) do
    local alarms = decode.alarms(field, raws[message.index[field]])
    if alarms ~= 0 then
      local before = ", "
      if field.alarm ~= word then before = "  " .. field.alarm .. " " end
      text = text .. before .. decode.flag_names(field, alarms)
      word = field.alarm
    end
  end
  return text
end

return M
