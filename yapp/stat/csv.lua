-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,csv: a table for each message of the catalogue, in a folder or printed.
-- Pure Lua, 5.2 to 5.5.
--
-- FOLDER/motor.csv ...  time, frame, bus, source, id, seq, then the columns of the message
-- FOLDER/fields.json    what each column is

local columns, output = require("yapp.message.columns"), require("yapp.stat.output")

local M = {}

local UNTOLD = 21
-- In front of a message's own: name, type, unit.
local COMMON = {
  { "time", "time", "s" }, { "frame", "integer" }, { "bus", "string" }, { "source", "string" },
  { "id", "integer" }, { "seq", "integer" },
}
local FIELDS = "fields.json"

local Csv = {}
Csv.__index = Csv

local function path_of(self, name)
  return self.options.folder .. "/" .. name
end

-- All columns of a message, as message.columns has them.
local function columns_of(self, message)
  local list = {}
  for i, row in ipairs(COMMON) do list[i] = {
    name = row[1],
    type = row[2],
    unit = row[3],
  } end
  if self.options.all then
    list[#list + 1] = { name = "crc_good", type = "bool" }
  end
  for _, column in ipairs(columns.columns(message)) do
    list[#list + 1] = column
  end
  return list
end

local function header(self, message)
  local names = {}
  for i, column in ipairs(columns_of(self, message)) do
    names[i] = columns.quoted(column.name)
  end
  return table.concat(names, ",") .. "\n"
end

-- A new file of the folder; no file in it is overwritten unasked.
local function create(self, name)
  local advice = not self.options.replace and "add the option replace to write it anew"
  local file, problem = output.create(path_of(self, name), advice)
  self.files[#self.files + 1] = file
  return file, problem
end

-- Makes the folder and begins its files.
local function prepare(self)
  local folder, context = self.options.folder, self.context
  if not context.make_folder(folder) then
    return ("the folder %s cannot be made"):format(folder)
  end
  local problem
  self.fields, problem = create(self, FIELDS)
  for _, message in ipairs(context.catalogue.messages) do
    local file
    if not problem then
      file, problem = create(self, message.name .. ".csv")
    end
    if file then
      file:write(header(self, message))
    end
    self.of_message[message], self.counts[message] = file, 0
  end
  return problem and output.finish(self.files, problem)
end

--- options  { folder = path or "-", chosen = compiled message where it is printed, replace =,
--          all = booleans }
-- context  { clock = function(rel) -> seconds since 1970, nanoseconds, catalogue =, version = the
--          plugin's, make_folder = function(path) -> whether it is there; and what output.print
--          takes }
-- returns  the statistic; nil and what is wrong
function M.new(options, context)
  local self = setmetatable({
    options = options,
    context = context,
    files = {},
    of_message = {},
    counts = {},
    cells = {},
    fields = nil,
  }, Csv)
  if not options.chosen then
    local problem = prepare(self)
    return not problem and self or nil, problem
  end
  self.counts[options.chosen] = 0
  context.out(header(self, options.chosen))
  return self
end

-- "can0,left,528": the same in each row of a source, and a twentieth of the time.
local function cells_of(self, source)
  local cells = self.cells[source]
  if not cells then
    cells = ("%s,%s,%d"):format(
      columns.quoted(source.bus or ""),
      columns.quoted(source.name or ""),
      source.id)
    self.cells[source] = cells
  end
  return cells
end

function Csv:message(record)
  local options, source = self.options, record.source
  local message, is_good = source.message, record.kind == "message"
  if not (record.fits and self.counts[message]) then
    return
  end
  if not (is_good or options.all and record.kind == "crc") then
    return
  end
  local crc_good = options.all and (is_good and "1," or "0,") or ""
  local row = ("%s,%d,%s,%d,%s%s\n"):format(output.time_text(self.context.clock(record.rel)),
    record.frame, cells_of(self, source), record.seq, crc_good,
    columns.row(message, record.payload))
  if options.chosen then
    return self.context.out(row)
  end
  self.of_message[message]:write(row)
  self.counts[message] = self.counts[message] + 1
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

-- The last three are an integer's: what it fits in and what its numbers mean.
local COLUMN_KEYS = output.words("name unit type filter title kind bits values")

local function describe_column(column)
  local field, about = column.field, column.flag or column.field
  local row = {
    name = column.name,
    unit = column.unit,
    type = column.type,
    filter = about and about.filter,
    title = about and about.title,
  }
  if field and column.type == "integer" then
    row.kind, row.bits = field.kind, field.size * 8
    row.values = field.values and meanings(field.values)
  end
  return output.object(COLUMN_KEYS, row)
end

--- What the columns of all messages are.
-- catalogue   compiled; version: the plugin's own, a text
-- columns_of  function(message) -> its columns: message.columns' and what comes before them
-- returns     JSON: { version = 1, plugin =, messages = { NAME = { title =, every = in seconds or
--             null, columns = list of { those of COLUMN_KEYS } } } }
function M.describe(catalogue, version, columns_of_)
  local names, messages = {}, {}
  for i, message in ipairs(catalogue.messages) do
    local list = {}
    for j, column in ipairs(columns_of_(message)) do
      list[j] = describe_column(column)
    end
    names[i] = message.name
    messages[message.name] = output.object({ "title", "every", "columns" }, {
      title = message.title,
      every = message.every,
      columns = output.list(list),
    })
  end
  return output.object({ "version", "plugin", "messages" }, {
    version = 1,
    plugin = version,
    messages = output.object(names, messages),
  }).json
end

--- returns  the exit code, nil for 0, 21 where a file could not be written; and why
function Csv:finish()
  local context, rows = self.context, {}
  if self.options.chosen then return end
  self.fields:write(M.describe(context.catalogue, context.version, function(message)
    return columns_of(self, message)
  end) .. "\n")
  local problem = output.finish(self.files)
  if problem then return UNTOLD, "csv: " .. problem end
  for i, message in ipairs(context.catalogue.messages) do
    rows[i] = { file = path_of(self, message.name .. ".csv"), rows = self.counts[message] }
  end
  output.print(context, "YAPP csv: " .. output.count(#rows, "table"), { "file", "rows" }, rows)
end

return M
