-- SPDX-License-Identifier: GPL-2.0-or-later
-- What the Info column says of a message, as the catalogue writes it: "{name:%.1f} V".  Pure Lua.

local check = require("yapp.message.check")
local decode = require("yapp.message.decode")
local writer = require("yapp.message.writer")

local M = {}

local SPECIALS = { [0] = "NaN", "+inf", "-inf", "above range", "below range" }
local BOOLS = { [0] = "false", "true" }

-- Return what a field shows.
-- shape  of a number with a fraction
local function text_of(field, shape, raw)
  if field.kind == "time" then return decode.seconds(decode.time(raw, 0)) .. " s" end
  local value, special = decode.value(field, raw)
  if special then return SPECIALS[special] end
  if field.special or field.scale then return shape:format(value) end
  local meanings = field.kind == "bool" and BOOLS or field.values
  if not meanings then return decode.digits(value) end
  local invalid = field.kind == "int" and "invalid %d" or "invalid 0x%x"
  return meanings[raw] or invalid:format(raw)
end

-- Return the piece of a field, for the writer.
local function new_piece(message, name, shape)
  local field = message.by_name[name]
  check.demand(field, "info names a field %s that is not there", check.shown(name))
  local is_real = field.special or field.scale
  check.demand(shape == "" or is_real and shape:find("^%%%.?%d?[fg]$"),
    "info: the format %s is not one for %s", check.shown(shape), name)
  if shape == "" then shape = "%.4g" end
  return {
    field = field,
    index = field.index,
    shape = writer.takes_shape(field) and shape or nil,
    write = function(raw) return text_of(field, shape, raw) end,
    absent = "-",
  }
end

--- Compile the text of a message.
-- text     "{name:%.1f} V": the format of a number with a fraction may be left out
-- returns  function(raws) -> what Info says of its values.  Raises what is wrong.
function M.compile(message, text)
  local pieces, index = {}, 1
  while index do
    local from, to, name, shape = text:find("{([%w_]+):?([^}]*)}", index)
    pieces[#pieces + 1] = text:sub(index, (from or 0) - 1)
    pieces[#pieces + 1] = from and new_piece(message, name, shape)
    index = to and to + 1
  end
  return writer.new(pieces)
end

--- Return what the Info column says of a message.
-- raws           of decode.read
-- name           what the message is called; its title when left out
-- is_remarkable  false if no value is remarkable: then no fault is set
function M.text(message, raws, name, is_remarkable)
  local text = (name or message.title) .. "  " .. message.write_info(raws)
  if is_remarkable == false then return text end
  local word
  for _, field in ipairs(message.alarms) do
    local faults = decode.faults(field, raws[field.index])
    if faults ~= 0 then
      local before = ", "
      if field.fault_word ~= word then before = "  " .. field.fault_word .. " " end
      text = text .. before .. decode.flag_names(field, faults)
      word = field.fault_word
    end
  end
  return text
end

return M
