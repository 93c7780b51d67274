-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,csv: a table for each message of the catalogue, in a folder or printed.
-- Pure Lua, 5.2 to 5.5.
--
-- FOLDER/motor.csv ...  time, frame, bus, source, id, seq, then the columns of the message
-- FOLDER/fields.json    what each column is

local columns, output = require("yapp.message.columns"), require("yapp.stat.output")

local unpack = rawget(table, "unpack")

local M = {}

local UNTOLD = 21
local COMMON = {
  { name = "time", unit = "s", type = "time" }, { name = "frame", type = "integer" },
  { name = "bus", type = "string" }, { name = "source", type = "string" },
  { name = "id", type = "integer" }, { name = "seq", type = "integer" },
}
local CRC_GOOD = { name = "crc_good", type = "bool" }
local FIELDS = "fields.json"

local Csv = {}
Csv.__index = Csv

local function path_of(self, name)
  local folder = self.options.folder
  return folder:find("[/\\]$") and folder .. name or folder .. "/" .. name
end

local function all_columns(self, message)
  local list = { unpack(COMMON) }
  if self.options.all then list[#list + 1] = CRC_GOOD end
  for _, column in ipairs(columns.columns(message)) do list[#list + 1] = column end
  return list
end

local function header(self, message)
  local names = {}
  for i, column in ipairs(all_columns(self, message)) do names[i] = columns.quoted(column.name) end
  return table.concat(names, ",") .. "\n"
end

-- Whether the folder takes the files: it is made where it is not there, and no file in it is
-- overwritten unasked.
local function prepare(self)
  local options, context = self.options, self.context
  local ok, problem = context.make_folder(options.folder)
  if not ok then
    return nil, ("the folder %s cannot be made: %s"):format(options.folder, problem)
  end
  local names = { FIELDS }
  for i, message in ipairs(context.catalogue.messages) do names[i + 1] = message.name .. ".csv" end
  for _, name in ipairs(names) do
    local there = not options.replace and io.open(path_of(self, name), "rb")
    if there then
      there:close()
      return nil, path_of(self, name) .. " is there; add the option replace to write it anew"
    end
  end
  self.fields, problem = output.create(path_of(self, FIELDS))
  return self.fields ~= nil, problem
end

--- options  { folder = path or "-", chosen = compiled message where it is printed, replace =,
--          all = booleans, json = }
-- context  { out = function(text), clock = function(rel) -> seconds since 1970, nanoseconds,
--          catalogue =, version = the plugin's, make_folder = function(path) -> true or nil, why }
-- returns  the statistic; nil and what is wrong
function M.new(options, context)
  local self = setmetatable({ options = options, context = context, files = {}, counts = {},
    prefixes = {}, fields = nil, problem = nil }, Csv)
  if options.chosen then
    context.out(header(self, options.chosen))
    return self
  end
  local ok, problem = prepare(self)
  if not ok then return nil, problem end
  return self
end

-- Where the rows of a message go, begun at its first one; false where it cannot be written.
local function file_of(self, message)
  local file = self.files[message]
  if file ~= nil then return file end
  local problem
  file, problem = output.create(path_of(self, message.name .. ".csv"))
  if file then file:write(header(self, message)) else self.problem = self.problem or problem end
  self.files[message], self.counts[message] = file or false, 0
  return self.files[message]
end

-- ",can0,left,528," of a source: the same in each of its rows.
local function prefix(self, source)
  local cells = self.prefixes[source]
  if not cells then
    local bus, name = columns.quoted(source.bus or ""), columns.quoted(source.name or "")
    cells = (",%s,%s,%d,"):format(bus, name, source.id)
    self.prefixes[source] = cells
  end
  return cells
end

function Csv:message(record)
  local options, source = self.options, record.source
  local message, is_good = source.message, record.kind == "message"
  if not record.fits or not (is_good or options.all and record.kind == "crc") then return end
  if options.chosen and message ~= options.chosen then return end
  local row = ("%s,%d%s%d,%s%s\n"):format(output.time_text(self.context.clock(record.rel)),
    record.frame, prefix(self, source), record.seq,
    options.all and (is_good and "1," or "0,") or "", columns.row(message, record.payload))
  if options.chosen then return self.context.out(row) end
  local file = file_of(self, message)
  if file then
    file:write(row)
    self.counts[message] = self.counts[message] + 1
  end
end

-- The meanings of an enum's numbers, in their order: {"0":"Torque Mode","1":"Speed Mode"}.
local function meanings(values)
  local keys, texts = {}, {}
  for value, text in pairs(values or {}) do
    local key = type(value) == "number" and ("%.0f"):format(value) or value
    keys[#keys + 1], texts[key] = key, text
  end
  table.sort(keys, function(a, b) return tonumber(a) < tonumber(b) end)
  return values and output.raw(output.object(keys, texts))
end

local MESSAGE_KEYS = { "title", "every", "columns" }
-- The last three are an integer's: what it fits in and what its numbers mean.
local COLUMN_KEYS = { "name", "unit", "type", "filter", "title", "kind", "bits", "values" }

--- What the columns of all messages are.
-- catalogue   compiled; version: the plugin's own, a text
-- columns_of  function(message) -> its columns: message.columns' and what comes before them
-- returns     JSON: { version = 1, plugin =, messages = { NAME = { title =, every = in seconds or
--             null, columns = list of { those of COLUMN_KEYS } } } }
function M.describe(catalogue, version, columns_of)
  local names, messages = {}, {}
  for i, message in ipairs(catalogue.messages) do
    local list = {}
    for j, column in ipairs(columns_of(message)) do
      local about, field = column.flag or column.field or {}, column.field
      local values = { name = column.name, unit = column.unit, type = column.type,
        filter = about.filter, title = about.title }
      if field and column.type == "integer" then
        values.kind, values.bits, values.values = field.kind, field.size * 8, meanings(field.values)
      end
      list[j] = output.raw(output.object(COLUMN_KEYS, values))
    end
    names[i] = message.name
    messages[message.name] = output.raw(output.object(MESSAGE_KEYS, { title = message.title,
      every = message.every, columns = output.raw(output.list(list)) }))
  end
  return output.object({ "version", "plugin", "messages" }, { version = 1, plugin = version,
    messages = output.raw(output.object(names, messages)) })
end

--- returns  the exit code, nil for 0, 21 where a file could not be written; and why
function Csv:finish()
  if self.options.chosen then return end
  local files, rows, out = { self.fields }, {}, self.context.out
  local described = M.describe(self.context.catalogue, self.context.version, function(message)
    return all_columns(self, message)
  end)
  self.fields:write(described .. "\n")
  for _, message in ipairs(self.context.catalogue.messages) do
    files[#files + 1] = file_of(self, message) or nil -- one that never came has its header
  end
  local problem = output.finish(files, self.problem)
  if problem then return UNTOLD, "csv: " .. problem end
  for i, message in ipairs(self.context.catalogue.messages) do
    local path, count = path_of(self, message.name .. ".csv"), self.counts[message]
    rows[i] = { path, output.count(count, "message") }
    if self.options.json then
      out(output.object({ "file", "rows" }, { file = path, rows = count }) .. "\n")
    end
  end
  if not self.options.json then out(output.table({ "file", ">rows" }, rows)) end
end

return M
