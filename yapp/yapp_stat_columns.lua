-- The columns of a table of messages, until decode brings its own.
local decode = require("yapp_decode")

local M = {}

--- The columns of a message: { name =, unit =, type =, field = }.
function M.columns(message)
  local list = {}
  for _, field in ipairs(message.fields) do
    list[#list + 1] = { name = field.name, unit = field.unit, type = field.kind, field = field }
    local more = field.kind == "float" and "_special" or field.values and "_text"
    if more then list[#list + 1] = { name = field.name .. more, type = "text", field = field } end
    for _, flag in ipairs(field.flags or {}) do
      local group = flag.filter:match("([^.]+)%.[^.]+$")
      list[#list + 1] = { name = group .. "_" .. flag.name, type = "boolean", field = field }
    end
  end
  return list
end

local SPECIALS = { [0] = "nan", "inf", "-inf", "above", "below" }

--- The cells of a payload, joined by commas.
function M.row(message, payload)
  local raws = decode.read(message, payload)
  local cells = {}
  for i, field in ipairs(message.fields) do
    local raw = raws[i]
    if field.kind == "time" then
      cells[#cells + 1] = ("%d.%09d"):format(decode.time(payload, field.offset))
    elseif field.kind == "float" then
      local value, special = decode.float(field, raw)
      cells[#cells + 1] = value and ("%.7g"):format(value) or ""
      cells[#cells + 1] = SPECIALS[special] or ""
    else
      cells[#cells + 1] = ("%d"):format(raw)
      if field.values then cells[#cells + 1] = field.values[raw] or "" end
      for _, flag in ipairs(field.flags or {}) do
        cells[#cells + 1] = raw % (2 * flag.mask) >= flag.mask and "1" or "0"
      end
    end
  end
  return table.concat(cells, ",")
end

return M
