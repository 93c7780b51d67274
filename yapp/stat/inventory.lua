-- SPDX-License-Identifier: GPL-2.0-or-later
-- The inventory, fields.json: all that the plugin publishes, from the rows that make it.  Pages,
-- tests and yapp-tables follow it.  Pure Lua, 5.2 to 5.5.

local input = require "yapp.base.input"
local kinds = require "yapp.stat.kinds"
local mapped = require "yapp.base.mapped"
local output = require "yapp.stat.output"
local rules = require "yapp.stat.rules"

local M = {}

local object = output.object

-- Return a list of an object for each row, whose values, which become texts, stand in the order of
-- the keys.
local function list_in_order(rows, keys)
  return output.objects(keys, mapped(rows, function(row)
    local values = {}
    for i, key in ipairs(input.words(keys)) do values[key] = tostring(row[i]) end
    return values
  end))
end

-- Return an object with the name of each row, and what a function makes of it.
local function by_name(rows, value_of)
  local names, values = {}, {}
  for i, row in ipairs(rows) do names[i], values[row.name] = row.name, value_of(row) end
  return object(names, values)
end

-- The meanings of an enum's numbers, in their order: {"0":"Torque Mode","1":"Speed Mode"}.
local function meanings(values)
  local keys, texts = {}, {}
  for value, text in pairs(values) do
    local key = ("%.0f"):format(value)
    keys[#keys + 1], texts[key] = key, text
  end
  table.sort(keys, function(a, b) return tonumber(a) < tonumber(b) end)
  return object(keys, texts)
end

-- low and high are the bounds of a compressed float.  kind, bits and values are for integers only:
-- the type, and the meaning of its numbers.  learnable: good flights show limits of the column.
-- They show none of a percentage, nor of an integer without a unit: it may count.
local COLUMN_KEYS = "name unit type filter title low high learnable kind bits values"

local function column_values(column)
  local field = column.field or {} -- common columns have none
  local about, is_integer = column.flag or field, column.type == "integer"
  local is_float, kind = column.type == "float", is_integer and field.kind
  local is_measured = is_float or is_integer and column.unit ~= nil
  return {
    name = column.name,
    unit = column.unit,
    type = column.type,
    filter = about.filter,
    title = about.title,
    low = is_float and field.min,
    high = is_float and field.max,
    learnable = is_measured and column.unit ~= "%",
    kind = kind,
    bits = kind and field.size * 8,
    values = is_integer and field.values and meanings(field.values),
  }
end

-- Of a value that is worked out from two fields.
local FORMULA_KEYS = "name of operator less unit title"

local function formula_values(item)
  return setmetatable({ of = item.a.name, less = item.b.name }, { __index = item })
end

local function describe_message(message_type, columns)
  return object("title every columns formulas", {
    title = message_type.title,
    every = message_type.every,
    columns = output.objects(COLUMN_KEYS, mapped(columns, column_values)),
    formulas = output.objects(FORMULA_KEYS, mapped(message_type.generated, formula_values)),
  })
end

local function describe_statistic(row)
  return object("title options help ask columns",
    setmetatable({ columns = output.describe(row.columns) }, { __index = row }))
end

--- Describe all that is published.
-- settings   see stat.taps
-- columns_of function(message type) -> its columns: the common ones, then message.text's
-- statistics list of rows, see stat.options
-- returns    JSON: { version = 1, plugin =, messages and statistics = objects by name; kinds,
--            rules, fields, experts, preferences = lists }; an absent value is null
function M.describe(settings, columns_of, statistics)
  local published = settings.published
  return object("version plugin messages statistics kinds rules fields experts preferences", {
    version = 1,
    plugin = settings.version,
    messages = by_name(settings.catalogue.messages, function(message_type)
      return describe_message(message_type, columns_of(message_type))
    end),
    statistics = by_name(statistics, describe_statistic),
    kinds = output.objects("name text keys counts_as scope hides needs_time is_optional " ..
      "is_counted_only", kinds.LIST),
    rules = output.objects("name text help needs_time", rules.LIST),
    fields = list_in_order(published.fields, "name type title help"),
    experts = list_in_order(published.experts, "name title group severity"),
    preferences = list_in_order(published.preferences, "name type title default help"),
  }).json
end

return M
