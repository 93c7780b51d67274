-- SPDX-License-Identifier: GPL-2.0-or-later
-- What the Info column says of a message.  Pure Lua, 5.2 and 5.4.
--
-- A list has it for every message: the text of one with nothing special to show is made by a function that is generated
-- for each message of the catalogue:
--   local a1 = raws[3]
--   if not a1 or a1 > 65530 then return end
--   ...
--   return format("%.1f RPM  %.2f V", (-3931800000.0 + a1 * 120000.0) / 65530.0, ...)

local decode = require("yapp.message.decode")
local info = require("yapp.message.catalogue_info")

local M = {}

local format, concat, band = string.format, table.concat, decode.band

local SPECIALS = { [0] = "NaN", "+inf", "-inf", "above range", "below range" }
local MOST_FIELDS = 100 -- of one text: a function has up to 200 local variables

-- What a field shows when there is nothing special about it, nil where there is.
local function usual(field, raw)
  if not raw then return nil end
  if info.is_real(field) then return (decode.value(field, raw)) end
  if field.values then return field.values[raw] end
  if field.kind == "bool" then return raw == 0 and "false" or raw == 1 and "true" or nil end
  if field.kind == "string" or field.kind == "bytes" then return decode.value(field, raw) end
  return type(raw) == "number" and format("%.0f", raw) or raw -- tostring has 14 digits in Lua 5.2
end

local function usual_source(message)
  local lines, values, parts = {}, { "FORMAT" }, message.info_fields
  if #parts > MOST_FIELDS then return "return nil" end
  for i, part in ipairs(parts) do
    local field = part.field
    if field.kind == "float" and field.size <= 6 then
      lines[i] = format("local a%d = raws[%d] if not a%d or a%d > %d then return nil end", i, part.index, i, i,
        field.ordinary)
      values[i + 1] = decode.float_source(field, "a" .. i)
    else
      lines[i] = format("local a%d = usual(PARTS[%d].field, raws[%d]) if not a%d then return nil end", i, i, part.index,
        i)
      values[i + 1] = "a" .. i
    end
  end
  return concat(lines, "\n") .. "\nreturn format(" .. concat(values, ", ") .. ")"
end

local HEAD = "local format, usual, FORMAT, PARTS = ... return function(raws)\n"

local made, version = setmetatable({}, { __mode = "k" }), nil -- by message; of which divisor

-- The function of a message: from raws to the text, nil where there is something special to show.
local function usual_of(message)
  local _, now = decode.divisor()
  if now ~= version then made, version = setmetatable({}, { __mode = "k" }), now end
  local text_of = made[message]
  if not text_of then
    local chunk = assert(load(HEAD .. usual_source(message) .. "\nend", "=info of " .. message.name))
    text_of = chunk(format, usual, message.info_format, message.info_fields)
    made[message] = text_of
  end
  return text_of
end

local function shown(part, raw, payload)
  local field = part.field
  if field.kind == "time" and payload and #payload >= field.offset + 8 then
    return decode.seconds(decode.time(payload, field.offset)) .. " s"
  end
  if not raw then return "?" end
  if info.is_real(field) then
    local value, special = decode.value(field, raw)
    return special and SPECIALS[special] or format(part.format, value)
  end
  return usual(field, raw) or format(field.kind == "int" and "invalid %d" or "invalid 0x%x", raw)
end

-- The parts of the text one by one, for values that the usual format cannot show.
local function in_parts(message, raws, payload)
  local texts = {}
  for i, part in ipairs(message.info) do
    texts[i] = part.field and shown(part, raws[part.index], payload) or part
  end
  return concat(texts)
end

--- What the Info column says of a message.
-- raws     from decode.read; payload: the string that they are from, for times
-- name     what the message is called; its title when left out
function M.text(message, raws, payload, name)
  local text = (name or message.title) .. "  " .. (usual_of(message)(raws) or in_parts(message, raws, payload))
  local alarms = message.alarms
  for i = 1, #alarms do
    local field = alarms[i]
    local raw = raws[message.index[field]]
    if raw and raw ~= 0 and band(raw, field.watched) ~= 0 then
      text = text .. "  " .. field.alarm .. " " .. decode.flag_names(field, raw)
    end
  end
  return text
end

return M
