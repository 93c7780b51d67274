-- SPDX-License-Identifier: GPL-2.0-or-later
-- The inventory, fields.json: all that the plugin publishes, from the rows that make it.  Pages,
-- tests and yapp-tables follow it.  Pure Lua, 5.2 to 5.5.

local kinds = require "yapp.stat.kinds"
local output = require "yapp.stat.output"
local rules = require "yapp.stat.rules"

local M = {}

local words = output.words

-- The keys of the first values of a row, in their order; see settings.published of stat.taps.
local FIELD_KEYS = words("name type title help")
local EXPERT_KEYS = words("name title group severity")
local PREFERENCE_KEYS = words("name type title default help")
-- The keys that rows have already.
local KIND_KEYS = words("name text keys counts_as scope hides needs_time is_optional " ..
  "is_counted_only")
local RULE_KEYS = words("name text help needs_time")
local MESSAGE_KEYS = words("title every columns differences formulas")
local STATISTIC_KEYS = words("title options help ask columns")

-- Return a list of objects with these keys.
-- is_positional  true if the values stand in the rows in the order of the keys
local function list_rows(rows, keys, is_positional)
  local list = {}
  for i, row in ipairs(rows) do
    local values = {}
    for j, key in ipairs(keys) do
      local value = row[key]
      if is_positional then value = row[j] end
      if type(value) == "boolean" then value = { json = tostring(value) } end
      values[key] = value
    end
    list[i] = output.object(keys, values)
  end
  return output.list(list)
end

-- The meanings of an enum's numbers, in their order: {"0":"Torque Mode","1":"Speed Mode"}.
local function meanings(values)
  local keys, texts = {}, {}
  for value, text in pairs(values) do
    local key = type(value) == "number" and ("%.0f"):format(value) or value
    keys[#keys + 1], texts[key] = key, text
  end
  table.sort(keys, function(a, b) return tonumber(a) < tonumber(b) end)
  return output.object(keys, texts)
end

-- low and high are the bounds of a compressed float.  kind, bits and values are for integers only:
-- the type, and the meaning of its numbers.
local COLUMN_KEYS = words("name unit type filter title low high kind bits values")

local function describe_column(column)
  local field = column.field or {} -- common columns have none
  local about = column.flag or field
  local row = {
    name = column.name,
    unit = column.unit,
    type = column.type,
    filter = about.filter,
    title = about.title,
  }
  if column.type == "float" then row.low, row.high = field.min, field.max end
  if field.kind and column.type == "integer" then
    row.kind, row.bits = field.kind, field.size * 8
    row.values = field.values and meanings(field.values)
  end
  return output.object(COLUMN_KEYS, row)
end

-- The values that are worked out from two fields and are no columns: "name" = "of" - "less".
local DIFFERENCE_KEYS = words("name of less unit title")

local function describe_differences(message_type)
  local list = {}
  for _, item in ipairs(message_type.generated) do
    if item.is_difference then
      list[#list + 1] = output.object(DIFFERENCE_KEYS, {
        name = item.name,
        of = item.a.name,
        less = item.b.name,
        unit = item.unit,
        title = item.title,
      })
    end
  end
  return output.list(list)
end

local FORMULA_KEYS = words("name left operator right unit title")

local function describe_formula(item)
  return output.object(FORMULA_KEYS, {
    name = item.name,
    left = item.a.name,
    operator = item.operator,
    right = item.b.name,
    unit = item.unit,
    title = item.title,
  })
end

--- Describe all that is published.
-- settings   see stat.taps
-- list_of    function(message) -> its columns: the common ones, then message.text's
-- statistics list of rows, see stat.options
-- returns    JSON: { version = 1, plugin =, messages = { NAME = { title =, every = in seconds or
--            null, columns = list of { those of COLUMN_KEYS }, differences = list of { those of
--            DIFFERENCE_KEYS }, formulas = list of { those of FORMULA_KEYS } } },
--            statistics = { NAME = { those of STATISTIC_KEYS } },
--            kinds, rules, fields, experts, preferences = lists of { those of their keys } }
function M.describe(settings, list_of, statistics)
  local names, messages = {}, {}
  for i, message_type in ipairs(settings.catalogue.messages) do
    local list = list_of(message_type)
    for j, column in ipairs(list) do
      list[j] = describe_column(column)
    end
    names[i] = message_type.name
    local formulas = {}
    for j, item in ipairs(message_type.generated) do formulas[j] = describe_formula(item) end
    messages[message_type.name] = output.object(MESSAGE_KEYS, {
      title = message_type.title,
      every = message_type.every,
      columns = output.list(list),
      differences = describe_differences(message_type),
      formulas = output.list(formulas),
    })
  end
  local whats, described, published = {}, {}, settings.published
  for i, row in ipairs(statistics) do
    whats[i] = row.name
    described[row.name] = output.object(STATISTIC_KEYS, {
      title = row.title,
      options = row.options,
      help = row.help,
      ask = row.ask,
      columns = output.describe(row.columns),
    })
  end
  local keys = "version plugin messages statistics kinds rules fields experts preferences"
  return output.object(words(keys), {
    version = 1,
    plugin = settings.version,
    messages = output.object(names, messages),
    statistics = output.object(whats, described),
    kinds = list_rows(kinds.LIST, KIND_KEYS),
    rules = list_rows(rules.LIST, RULE_KEYS),
    fields = list_rows(published.fields, FIELD_KEYS, true),
    experts = list_rows(published.experts, EXPERT_KEYS, true),
    preferences = list_rows(published.preferences, PREFERENCE_KEYS, true),
  }).json
end

return M
