-- SPDX-License-Identifier: GPL-2.0-or-later
-- fields.json, beside the tables of -z yapp,csv: what each of their columns is.  Pure Lua, 5.2 and 5.4.

local json = require("yapp.stat.json")

local M = {}

local FILE_KEYS = { "version", "plugin", "messages" }
local MESSAGE_KEYS = { "title", "every", "columns" }
-- The last three are an integer's, so that a reader knows what it fits in and what its numbers mean.
local COLUMN_KEYS = { "name", "unit", "type", "filter", "title", "kind", "bits", "values" }

-- The meanings of an enum's numbers, in their order: {"0":"Torque Mode","1":"Speed Mode"}.
local function meanings(values)
  local keys, texts = {}, {}
  for value, text in pairs(values) do
    local key = type(value) == "number" and ("%.0f"):format(value) or value
    keys[#keys + 1], texts[key] = key, text
  end
  table.sort(keys, function(a, b) return tonumber(a) < tonumber(b) end)
  return json.raw(json.object(keys, texts))
end

local function column_object(column)
  local field, about = column.field, column.flag or column.field or {}
  local values = { name = column.name, unit = column.unit, type = column.type }
  values.filter, values.title = about.filter, about.title
  if field and column.type == "integer" then
    values.kind, values.bits, values.values = field.kind, field.size * 8, field.values and meanings(field.values)
  end
  return json.raw(json.object(COLUMN_KEYS, values))
end

--- What the columns of all messages are.
-- catalogue   compiled
-- version     the plugin's own, a text
-- columns_of  function(message) -> its columns: message.columns' and what comes before them
-- returns     JSON, one line: { version = 1, plugin =, messages = { NAME = { title =, every = in seconds or null,
--             columns = list of { name =, unit =, type =, filter =, title =, and of an integer field, else null, kind =
--             "uint", "int" or "flags", bits =, values = { NUMBER = meaning } or null } } } }
function M.describe(catalogue, version, columns_of)
  local names, messages = {}, {}
  for i, message in ipairs(catalogue.messages) do
    local columns = {}
    for j, column in ipairs(columns_of(message)) do columns[j] = column_object(column) end
    names[i] = message.name
    messages[message.name] = json.raw(json.object(MESSAGE_KEYS, { title = message.title, every = message.every,
      columns = json.raw(json.list(columns)) }))
  end
  return json.object(FILE_KEYS, { version = 1, plugin = version, messages = json.raw(json.object(names, messages)) })
end

return M
