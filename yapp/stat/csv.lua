-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,csv: a table for each message of the catalogue, in a folder or printed.  Pure Lua, 5.2 and 5.4.
--
-- FOLDER/motor.csv ...  time, frame, bus, source, id, seq, then the columns of the message
-- FOLDER/fields.json    what each column is

local json, text = require("yapp.stat.json"), require("yapp.stat.text")
local fields, files = require("yapp.stat.fields"), require("yapp.stat.file")

local M = {}

local COMMON = {
  { name = "time", unit = "s", type = "time" }, { name = "frame", type = "integer" }, { name = "bus", type = "string" },
  { name = "source", type = "string" }, { name = "id", type = "integer" }, { name = "seq", type = "integer" },
}
local CRC_GOOD = { name = "crc_good", type = "bool" }
local FIELDS = "fields.json"

local Csv = { is_of_whole_messages = true }
Csv.__index = Csv

--- A cell: in quotes where it must be.
function M.cell(value)
  if value == nil then return "" end
  if not value:find('[,"\r\n]') then return value end
  return '"' .. value:gsub('"', '""') .. '"'
end

local function path_of(folder, name)
  return folder:find("[/\\]$") and folder .. name or folder .. "/" .. name
end

-- All columns of a message.
local function columns_of(self, message)
  local columns = {}
  for i, column in ipairs(COMMON) do columns[i] = column end
  if self.options.all then columns[#columns + 1] = CRC_GOOD end
  for _, column in ipairs(self.context.columns.columns(message)) do columns[#columns + 1] = column end
  return columns
end

local function header(self, message)
  local names = {}
  for i, column in ipairs(columns_of(self, message)) do names[i] = M.cell(column.name) end
  return table.concat(names, ",") .. "\n"
end

-- Whether the folder takes the files: made where it is not there, and no file in it is overwritten unasked.
local function prepare(self)
  local options, context = self.options, self.context
  local ok, problem = context.make_folder(options.folder)
  if not ok then return nil, ("the folder %s cannot be made: %s"):format(options.folder, problem) end
  for _, message in ipairs(context.catalogue.messages) do self.paths[message] = message.name .. ".csv" end
  for _, name in pairs(self.paths) do
    if not options.replace and files.exists(path_of(options.folder, name)) then
      return nil, ("%s is there; add the option replace to write it anew"):format(path_of(options.folder, name))
    end
  end
  self.fields, problem = files.create(path_of(options.folder, FIELDS))
  return self.fields ~= nil, problem
end

--- options  { folder = path or "-", chosen = compiled message where it is printed, replace =, all = booleans, json = }
-- context  { out = function(text), clock = function(rel) -> seconds since 1970, nanoseconds, catalogue =,
--          columns = module, version = the plugin's, make_folder = function(path) -> true or nil, why }
-- returns  the statistic; nil and what is wrong
function M.new(options, context)
  local self = setmetatable({ options = options, context = context, files = {}, counts = {}, prefixes = {},
    paths = { [FIELDS] = FIELDS }, rows = {} }, Csv)
  if options.folder == "-" then
    context.out(header(self, options.chosen))
    return self
  end
  local ok, problem = prepare(self)
  if not ok then return nil, problem end
  return self
end

-- Where the rows of a message go; begun at its first one.
function Csv:writer(message)
  local file = self.files[message]
  if file ~= nil then return file end
  local problem
  file, problem = files.create(path_of(self.options.folder, self.paths[message]))
  if file then file:write(header(self, message)) else self.problem = self.problem or problem end
  self.files[message], self.counts[message] = file or false, 0
  return file
end

-- ",can0,left,528," of a source: the same in each of its rows.
local function prefix(self, source)
  local cells = (",%s,%s,%d,"):format(M.cell(source.bus), M.cell(source.name), source.id)
  self.prefixes[source.key] = cells
  return cells
end

function Csv:message(record)
  local options, source = self.options, record.source
  local message = source.message
  if not record.fits or not (record.good or options.all and record.is_bad) then return end
  if options.chosen and message ~= options.chosen then return end
  local seconds, nanoseconds = self.context.clock(record.rel)
  local row = ("%s,%d%s%d,%s%s\n"):format(json.time_text(seconds, nanoseconds), record.frame,
    self.prefixes[source.key] or prefix(self, source), record.seq,
    options.all and (record.good and "1," or "0,") or "", self.context.columns.row(message, record.payload))
  if options.chosen then return self.context.out(row) end
  local file = self:writer(message)
  if file then
    file:write(row)
    self.counts[message] = self.counts[message] + 1
  end
end

-- Ends all files; a message that never came has its header.
local function finish_files(self)
  local list = { self.fields }
  for _, message in ipairs(self.context.catalogue.messages) do list[#list + 1] = self:writer(message) or nil end
  if not self.problem then
    local _, problem = files.finish(list)
    return problem
  end
  for _, file in ipairs(list) do file:discard() end
  return self.problem
end

--- returns  the exit code: nil for 0, 21 where a file could not be written, and a text that says why
function Csv:finish()
  if self.options.chosen then return end
  local catalogue, version = self.context.catalogue, self.context.version
  self.fields:write(fields.describe(catalogue, version, function(message) return columns_of(self, message) end) .. "\n")
  local problem = finish_files(self)
  if problem then return 21, "csv: " .. problem end
  local rows, out = {}, self.context.out
  for i, message in ipairs(self.context.catalogue.messages) do
    local path, count = path_of(self.options.folder, self.paths[message]), self.counts[message]
    rows[i] = { path, text.count(count, "message") }
    if self.options.json then out(json.object({ "file", "rows" }, { file = path, rows = count }) .. "\n") end
  end
  if not self.options.json then out(text.table({ "file", ">rows" }, rows)) end
end

return M
