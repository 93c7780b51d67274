-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,csv: a table for each message of the catalogue, in a folder or printed.
-- Pure Lua, 5.2 to 5.5.
--
-- FOLDER/motor.csv ...  time, frame, bus, source, id, seq, then the columns of the message
-- FOLDER/fields.json    the inventory, see stat.inventory

local input = require "yapp.base.input"
local inventory = require "yapp.stat.inventory"
local joined = require "yapp.base.joined"
local mapped = require "yapp.base.mapped"
local memo = require "yapp.base.memo"
local output = require "yapp.stat.output"
local text_of = require "yapp.message.text"

local Csv = {}
Csv.__index = Csv

--- The columns of its own output, see output.columns.
Csv.COLUMNS = output.columns({
  { "file", "text", "the path of a table" },
  { "rows", "integer", "how many rows it has" },
}, "file rows")
-- The columns in front of a message's own.
local COMMON = input.rows("name type unit", {
  { "time", "time", "s" },
  { "frame", "integer" },
  { "bus", "string" },
  { "source", "string" },
  { "id", "integer" },
  { "seq", "integer" },
})
local CRC_GOOD = { { name = "crc_good", type = "bool" } }

-- Return the parts of a source's rows.
local function parts_of(source)
  local bus, name = text_of.quoted(source.bus or ""), text_of.quoted(source.name or "")
  return {
    cells = ("%s,%s,%d"):format(bus, name, source.id), -- "can0,left,528"
    write = text_of.row_writer(source.type), -- function(raws) -> those of the message
  }
end

-- Return the common columns, then the message's.
local function columns_of(self, message_type)
  return text_of.columns(message_type, joined(COMMON, self.options.all and CRC_GOOD or {}))
end

-- Begin the table of a message.
local function begin(self, message_type, file)
  local row, columns = { file = file.path, rows = 0, to = file }, columns_of(self, message_type)
  file:write(table.concat(mapped(columns, function(column) return column.name end), ",") .. "\n")
  self.tables[message_type] = row
  table.insert(self.list, row)
end

-- Create a file in the folder.  Overwrite one only with the option replace.  Raise why it cannot be
-- written, without those before it.
local function create(self, name)
  local options = self.options
  local advice = not options.replace and "add the option replace to write it anew"
  local file, problem = output.create(options.folder .. "/" .. name, advice)
  if not file then error("csv: " .. output.close_files(self.files, problem), 0) end
  table.insert(self.files, file)
  return file
end

--- options  { folder = path or "-", chosen = compiled message where it is printed, replace =,
--          all = booleans, statistics = see stat.options }
-- context  { dates = a stat.dates; settings = see stat.taps;
--          make_folder = function(path) -> true if it is there; and the rest for output.print }
-- It raises why a file cannot be written.
function Csv.new(options, context)
  local self = setmetatable({
    options = options,
    context = context,
    files = {}, -- fields.json, then the tables
    list = {}, -- of tables, as rows of COLUMNS, to = the file; tables = the same by message
    tables = {},
    parts = memo(parts_of), -- by source: a twentieth of the time
  }, Csv)
  if options.chosen then
    begin(self, options.chosen, { write = function(_, text) context.out(text) end })
    return self
  end
  if not context.make_folder(options.folder) then
    error(("csv: the folder %s cannot be made"):format(options.folder), 0)
  end
  create(self, "fields.json")
  for _, message_type in ipairs(context.settings.catalogue.messages) do
    begin(self, message_type, create(self, message_type.name .. ".csv"))
  end
  return self
end

--- Add the row of an event, see stat.answer.
function Csv:add_event(event)
  local all, source, is_good = self.options.all, event.source, event.kind == "message"
  local row = event.raws and (is_good or all and event.kind == "crc") and self.tables[source.type]
  if not row then return end
  local time, parts = self.context.dates:text(event.time), self.parts[source]
  local crc_good = all and (is_good and "1," or "0,") or ""
  row.to:write(("%s,%d,%s,%d,%s%s\n"):format(
    time, event.frame, parts.cells, event.seq, crc_good, parts.write(event.raws)))
  row.rows = row.rows + 1
end

--- End, see stat.answer.  A file that could not be written is EXIT_UNDECIDED.
function Csv:finish(_, notes)
  local options, context, list = self.options, self.context, self.list
  if options.chosen then return end
  local function list_of(message_type) return columns_of(self, message_type) end
  self.files[1]:write(inventory.describe(context.settings, list_of, options.statistics) .. "\n")
  local problem = output.close_files(self.files)
  if problem then return output.EXIT_UNDECIDED, "csv: " .. problem end
  output.print(context, "YAPP csv: " .. output.count(#list, "table"), Csv.COLUMNS, list, notes)
end

return Csv
