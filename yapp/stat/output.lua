-- SPDX-License-Identifier: GPL-2.0-or-later
-- The output of statistics: JSON lines, tables for people, and files, which exist only if
-- they are complete; and the exit codes.  Pure Lua, 5.2 to 5.5.

local input = require "yapp.base.input"
local joined = require "yapp.base.joined"
local mapped = require "yapp.base.mapped"
local utf8 = require "yapp.base.utf8"

local M = {}

M.EXIT_OK = 0
M.EXIT_FAILED = 20 -- a rule does not hold
M.EXIT_UNDECIDED = 21 -- something could not be judged, said or written

local format = string.format

-- JSON ----------------------------------------------------------------------------------------

-- Write characters that are not printable as \xNN: JSON must be UTF-8.
local function text_value(text)
  return '"' .. utf8.printable(text):gsub('["\\]', "\\%0") .. '"'
end

local function is_integer(value)
  return value % 1 == 0 and math.abs(value) < 2 ^ 53
end

-- Return the shortest text that reads back as the same number; null for NaN and infinity.
local function number_value(value)
  if value - value ~= 0 then return "null" end
  if is_integer(value) then return format("%d", value) end
  local shown = format("%.15g", value)
  return tonumber(shown) == value and shown or format("%.17g", value)
end

--- The JSON of a value, see below: string, number, true, nil or false (null), or that of a table.
function M.value(value)
  local kind = type(value)
  if kind == "number" then return number_value(value) end
  if value == true then return "true" end
  if kind == "table" then return value.json or M.value(value.value) end
  return value and text_value(value) or "null"
end

--- An object of these keys, in this order, with the values that a table has under them; a missing
-- value is null.
-- keys  a list, or a text: "time frame bus"
function M.object(keys, values)
  local list = type(keys) == "string" and input.words(keys) or keys
  local texts = mapped(list, function(key)
    return text_value(key) .. ":" .. M.value(values[key])
  end)
  return { json = "{" .. table.concat(texts, ",") .. "}" }
end

--- A list of values.
function M.list(values)
  return { json = "[" .. table.concat(mapped(values, M.value), ",") .. "]" }
end

--- A list of an object for each row; its keys are those given, or its own.
function M.objects(keys, rows)
  return M.list(mapped(rows, function(row) return M.object(keys or row.keys, row) end))
end

-- Values ----------------------------------------------------------------------------------------
--
-- A value of a row: a text, a number, nil, or where people read something else than JSON has, or
-- nothing, a table:
--   value  a text or a number for JSON, or nil for null; or json = JSON already
--   text   for people, nil for nothing; short = the same for a window, if that is shorter

--- Return a span of seconds; nil for nil.
function M.seconds(value)
  if not value then return nil end
  return {
    json = format("%.9f", value),
    text = format("%.6f", value),
    short = format("%.3f", value),
  }
end

--- Return the text of a value for people: of a fraction six digits, in a window five.
-- is_short  true if in a window
function M.text(value, is_short)
  if type(value) == "table" then value = is_short and value.short or value.text end
  if type(value) == "number" then
    return format(is_integer(value) and "%d" or is_short and "%.5g" or "%.6g", value)
  end
  return value or ""
end

--- Return a count of things: "1 message", "2 messages".
function M.count(number, thing)
  return format("%d %s%s", number, thing, number == 1 and "" or "s")
end

--- Return the beginning of a sentence: "1 message was", "2 messages were".
function M.were(number, thing)
  return M.count(number, thing) .. (number == 1 and " was" or " were")
end

--- Return where a source is: its bus and ID, "can0 0x210".
function M.bus_and_id(source)
  local id = source.id and format("0x%x", source.id)
  return source.bus and id and source.bus .. " " .. id or source.bus or id or ""
end

--- Add the columns of a source to a row of values; return the row.
function M.row(source, row)
  row.bus, row.source = source.bus, source.name
  row.who = source.name or M.bus_and_id(source) -- bus, ID and name in one column
  if not source.id then return row end
  local message = source.type or { title = "unknown" }
  row.id = { value = source.id, text = format("0x%x", source.id) }
  row.message = { value = message.name, text = message.title }
  return row
end

-- Rows ------------------------------------------------------------------------------------------

-- Columns of several statistics, by name; those without a type are for people alone.
local COMMON = {}
for _, column in ipairs(input.rows("name type help", {
  { "time", "time", "when it happened, UTC; null where nothing came", title = "time (UTC)" },
  { "rel", title = "since start/s", short = "at/s" },
  { "frame", "integer", "the packet that shows it" },
  { "who", title = "source" }, -- bus, ID and name in one column
  { "bus", "string", "the bus or line; null where the capture names none" },
  {
    "id",
    "id",
    "the message ID; null where the event is of the whole capture",
    title = "ID",
  },
  {
    "source",
    "string",
    "the name that `yapp.sources` gives to the ID; null without a name",
  },
  {
    "message",
    "string",
    "the message's name in the catalogue; null if the catalogue has none",
  },
  { "field", "string", "the flags or the enum concerned" },
  { "flag", "string", "of a fault: the flag" },
  { "event", "string", "of a fault: `raised`, `cleared`, or `active` at the end" },
  {
    "active",
    "seconds",
    "of a fault: how long it was there; null for `raised`",
    unit = "s",
  },
})) do
  COMMON[column.name] = column
end

-- Return the columns that people read, a list of { name, title }.
-- names    a text
-- by_name  the columns that have a title
local function list_columns(names, by_name, is_window)
  return mapped(input.words(names), function(name)
    local column = by_name[name] or COMMON[name] or {}
    return { name = name, title = is_window and column.short or column.title or name }
  end)
end

--- Describe the columns of a table.
-- rows     a text, the names of columns of COMMON, or { name, type, help,
--            type   in JSON: "integer", "id", "number", "seconds", "time" (seconds since 1970),
--                   "boolean", "string" (one of a few), "text", "values" (an object by field) or
--                   "list"; nil for a column that JSON does not have
--            help   its meaning: for fields.json and the pages that follow it
--            unit   of a number, or nil
--            title  above it, nil for the name and the unit; short = the same in a window } each
-- text     the names of the columns that people read, in their order
-- window   the same in a window, which is narrow; nil for the same columns
-- returns  { json = list of names, text, window = lists of { name, title }, all = all rows }
function M.columns(rows, text, window)
  local all, by_name = {}, {}
  local function add(column)
    local name, unit = column.name, column.unit
    column.title = column.title or unit and name .. "/" .. unit or name
    all[#all + 1], by_name[name] = column, column
  end
  for _, row in ipairs(rows) do
    if type(row) == "table" then
      add(input.rows("name type help", { row })[1])
    else
      for _, name in ipairs(input.words(row)) do add(COMMON[name]) end
    end
  end
  return {
    all = all,
    json = mapped(all, function(column) return column.type and column.name end),
    text = list_columns(text, by_name),
    window = list_columns(window or text, by_name, true),
  }
end

--- Return the columns of JSON as fields.json has them.
-- columns  of M.columns
function M.describe(columns)
  return M.objects("name type unit title help",
    mapped(columns.all, function(column) return column.type and column end))
end

-- Return the width of a text: in characters, not bytes.
local function width_of(text)
  return select(2, text:gsub("[^\128-\191]", ""))
end

--- Sort a list.  Entries with equal values keep their order.
-- order_of  function(one) -> the values to sort by
function M.sort(list, order_of)
  local orders = {}
  for i, one in ipairs(list) do
    local order = { order_of(one) }
    table.insert(order, i)
    orders[one] = order
  end
  table.sort(list, function(a, b)
    local right = orders[b]
    for i, value in ipairs(orders[a]) do
      if value ~= right[i] then return value < right[i] end
    end
    return false
  end)
end

--- Return a name with numbers that sort as numbers: M2 before M10.
function M.sortable(name)
  return (name:gsub("%d+", function(digits) return format("%012d", digits) end))
end

-- Return the title of a column and its texts, of one width, numbers to the right; nil if no row has
-- anything there.
local function cells_of(column, rows, is_window)
  local texts = mapped(rows, function(row) return M.text(row[column.name], is_window) end)
  local all, width = table.concat(texts), 0
  if all == "" then return nil end
  local is_number = not all:find("[^%d.e+-]")
  table.insert(texts, 1, column.title)
  for _, text in ipairs(texts) do width = math.max(width, width_of(text)) end
  return mapped(texts, function(text)
    local blanks = (" "):rep(width - width_of(text))
    return is_number and blanks .. text or text .. blanks
  end)
end

--- Print a table with aligned columns, a line a row.
-- context, columns, rows  see M.print
function M.table(context, columns, rows)
  local frames = context.frames
  local list = mapped(frames and columns.window or columns.text, function(column)
    return cells_of(column, rows, frames)
  end)
  for line = 1, #rows + 1 do
    local texts = mapped(list, function(cells) return cells[line] end)
    -- gsub("%s*$") would try each blank as the first of the last ones.
    context.out((table.concat(texts, "  "):match(".*%S") or "") .. "\n")
  end
  for _, row in ipairs(frames and rows or {}) do
    table.insert(frames, row.frame or row.gap_max_frame)
  end
end

--- Print rows: for people under a title and the notes, or as a JSON object a line; in a window
-- under the title, too.
-- context  { out = function(text), json = true if so, frames = in a window a list that gets the
--          frames of the rows, else nil }
-- columns  of M.columns; a row may have keys of its own for its line of JSON, row.keys
-- rows     tables by key
-- notes    a list of texts
function M.print(context, title, columns, rows, notes)
  local out = context.out
  if not context.json then
    out(table.concat(joined({ title }, notes), "\n") .. "\n")
    if not rows[1] then return end
    out("\n")
    return M.table(context, columns, rows)
  end
  if context.frames then out(title .. "\n") end
  for _, row in ipairs(rows) do
    out(M.object(row.keys or columns.json, row).json .. "\n")
  end
end

-- Files ---------------------------------------------------------------------------------------

local File = {}
File.__index = File

--- Begin a file, under another name until it is complete.  A device is written directly, as a
-- rename would replace the device by a file.
-- advice   the error if the file exists, which ends with the remedy; nil to overwrite it
-- returns  the file, with File:write(text); nil and why not
function M.create(path, advice)
  local there = advice and io.open(path, "rb")
  if there then
    there:close()
    return nil, path .. " is there; " .. advice
  end
  local aside = path:find("^/dev/") and path or path .. ".part"
  local handle, problem = io.open(aside, "wb")
  if not handle then return nil, problem end
  return setmetatable({ path = path, aside = aside, handle = handle }, File)
end

function File:write(text)
  local ok, problem = self.handle:write(text)
  if not ok then self.problem = problem end
end

--- Close files and give them their names.  If one could not be written, remove all of them.
-- problem  an error of before, nil for none
-- returns  an error, nil for none
function M.close_files(list, problem)
  for _, file in ipairs(list) do
    local _, why = file.handle:close()
    why = file.problem or why
    problem = problem or why and file.path .. ": " .. why
  end
  for _, file in ipairs(list) do
    local path, aside = file.path, file.aside
    if problem and path ~= aside then
      os.remove(aside)
    elseif path ~= aside and not os.rename(aside, path) then
      os.remove(path) -- on Windows a rename does not replace a file
      local _, why = os.rename(aside, path)
      problem = why and path .. ": " .. why
    end
  end
  return problem
end

return M
