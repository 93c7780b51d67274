-- SPDX-License-Identifier: GPL-2.0-or-later
-- What the Info column says of a message, as the catalogue writes it: "{name:%.1f} V".  Pure Lua, 5.2 and 5.4.

local check = require("yapp.message.catalogue_check")

local M = {}

--- Whether the value of a field is a number with a fraction.
function M.is_real(field)
  return field.kind == "float" or field.kind == "ieee" or field.scale ~= nil
end

local function compile_part(message, name, format, complain)
  local field = message.by_name[name]
  if not field then return complain("info names a field %s that is not there", check.shown(name)) end
  if format ~= "" and not (M.is_real(field) and format:find("^%%%.?%d?[fg]$")) then
    return complain("info: the format %s is not one for %s", check.shown(format), name)
  end
  return { field = field, index = message.index[field], format = format ~= "" and format or "%.4g" }
end

--- Compiles the text of a message: sets its
--   info         parts { { field = f, index = i, format = "%.1f" }, " V" }
--   info_fields  those parts that are fields, and info_format: the same as one format that takes their values, for the
--                usual message that has nothing special to show
function M.compile(message, text, complain)
  if not check.is_utf8(text, 1000) then
    complain("info must be a text, not %s", check.shown(text))
    text = ""
  end
  local parts, fields, formats, at = {}, {}, {}, 1
  while at do
    local from, to, name, format = text:find("{([%w_]+):?([^}]*)}", at)
    local literal = text:sub(at, (from or 0) - 1)
    if literal ~= "" then
      parts[#parts + 1] = literal
      formats[#formats + 1] = literal:gsub("%%", "%%%%")
    end
    local part = from and compile_part(message, name, format, complain)
    if part then
      parts[#parts + 1], fields[#fields + 1] = part, part
      formats[#formats + 1] = M.is_real(part.field) and part.format or "%s"
    end
    at = to and to + 1
  end
  message.info, message.info_fields, message.info_format = parts, fields, table.concat(formats)
end

return M
