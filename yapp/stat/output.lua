-- SPDX-License-Identifier: GPL-2.0-or-later
-- What statistics print and write: JSON lines, tables for people, files, whole or not there.
-- Pure Lua, 5.2 to 5.5.

local utf8 = require("yapp.base.utf8")

local M = {}

local format = string.format

-- JSON ----------------------------------------------------------------------------------------

-- What cannot be printed is written \xNN: bytes that are no UTF-8 would make a line unreadable.
local function text_value(text)
  return '"' .. utf8.printable(text):gsub('["\\]', "\\%0") .. '"'
end

local function is_whole(value)
  return value % 1 == 0 and math.abs(value) < 2 ^ 53
end

-- The shortest text that reads back as the same number; null for what JSON has no number for.
local function number_value(value)
  if value - value ~= 0 then return "null" end
  if is_whole(value) then return format("%d", value) end
  local shown = format("%.15g", value)
  return tonumber(shown) == value and shown or format("%.17g", value)
end

--- The JSON of a value: string, number, nil (null), or { json = what is JSON already }.
function M.value(value)
  local kind = type(value)
  if kind == "number" then return number_value(value) end
  if kind == "table" then return value.json end
  return value and text_value(value) or "null"
end

--- An object of these keys, in this order, with the values that a table has under them; what it
-- has not is null.
function M.object(keys, values)
  local parts = {}
  for i, key in ipairs(keys) do
    parts[i] = text_value(key) .. ":" .. M.value(values[key])
  end
  return { json = "{" .. table.concat(parts, ",") .. "}" }
end

--- A list of objects.
function M.list(objects)
  local parts = {}
  for i, object in ipairs(objects) do
    parts[i] = object.json
  end
  return { json = "[" .. table.concat(parts, ",") .. "]" }
end

--- A time of the capture with nine digits, as text.
-- seconds, nanoseconds  integers, nanoseconds 0 .. 999,999,999
function M.time_text(seconds, nanoseconds)
  if seconds < 0 and nanoseconds > 0 then -- -1 s and 9e8 ns are -0.1 s
    return format("-%d.%09d", -seconds - 1, 1000000000 - nanoseconds)
  end
  return format("%d.%09d", seconds, nanoseconds)
end

-- Values ----------------------------------------------------------------------------------------
--
-- A value of a row: a text, a number, nil, or { json, text } where people read something else, or
-- nothing.

--- A time of the capture; people read it in UTC, to the microsecond.
-- seconds, nanoseconds  since 1970
function M.time(seconds, nanoseconds)
  local ok, date = pcall(os.date, "!%Y-%m-%d %H:%M:%S", seconds) -- on Windows from 1970 to 3000
  local shown = ok and date or format("%d", seconds)
  return {
    json = M.time_text(seconds, nanoseconds),
    text = format("%s.%06d", shown, math.floor(nanoseconds / 1000)),
  }
end

--- A span in seconds; nil for nil.
function M.seconds(value)
  return value and { json = format("%.9f", value), text = format("%.6f", value) } or nil
end

--- What people read of a value: of a fraction six digits.
function M.text(value)
  if type(value) == "table" then value = value.text end
  if type(value) == "number" then
    return format(is_whole(value) and "%d" or "%.6g", value)
  end
  return value or ""
end

--- A count of things: "1 message", "2 messages".
function M.count(number, thing)
  return format("%d %s%s", number, thing, number == 1 and "" or "s")
end

--- What a source is called where a column has room for one text: its name, or its bus and ID.
function M.who(source)
  if source.name then return source.name end
  local bus = source.bus and source.bus .. " " or ""
  return bus .. format("0x%x", source.id)
end

--- A row of what says which source, which goes into a table of its other values.
function M.row(source, row)
  row.bus, row.source = source.bus, source.name
  if not source.id then return row end
  local message = source.message or { title = "unknown" }
  row.id = { json = format("%d", source.id), text = format("0x%x", source.id) }
  row.message = { json = M.value(message.name), text = message.title }
  return row
end

-- Rows ------------------------------------------------------------------------------------------

local TITLES = {
  time = "time (UTC)", rel = "since start/s", id = "ID", active = "active/s", rate = "rate/Hz",
  gap_min = "gap/s min", gap_mean = "mean", gap_max = "max", gap_max_frame = "in frame",
  crc_bad = "bad CRC", ok = "check", kind = "event",
}
local FOR_PEOPLE = { rel = true, note = true } -- in no JSON

--- A list of the words of a text.
function M.words(text)
  local list = {}
  for word in text:gmatch("%S+") do
    list[#list + 1] = word
  end
  return list
end

-- The columns that a line has no room for, in the order in which they go.
local SPARE = M.words("time help gap_min gap_mean late skipped gap_max_frame unit rel rate " ..
  "crc_bad invalid reboots count message field id bus")

-- How many places a text takes: characters, not bytes.
local function width_of(text)
  return select(2, text:gsub("[^\128-\191]", ""))
end

-- nil where no row has anything.
local function new_column(key, rows, title)
  local width, is_number = 0, true
  for _, row in ipairs(rows) do
    local text = M.text(row[key])
    width = math.max(width, width_of(text))
    is_number = is_number and not text:find("[^%d.e+-]")
  end
  if width == 0 then return nil end
  return {
    key = key,
    width = math.max(width, #title),
    is_number = is_number,
  }
end

-- Takes columns away until a line has room for them.
local function fit(columns, width)
  local total = -2
  for _, column in ipairs(columns) do
    total = total + column.width + 2
  end
  for _, key in ipairs(SPARE) do
    for i = #columns, 1, -1 do
      if total > width and columns[i].key == key then
        total = total - table.remove(columns, i).width - 2
      end
    end
  end
end

local function table_line(columns, row, width)
  local cells = {}
  for i, column in ipairs(columns) do
    local text = M.text(row[column.key])
    local blanks = (" "):rep(column.width - width_of(text))
    cells[i] = column.is_number and blanks .. text or text .. blanks
  end
  local line = table.concat(cells, "  "):gsub("%s+$", "")
  if not width or width_of(line) <= width then
    return line .. "\n"
  end
  return line:match("^" .. ("[^\128-\191][\128-\191]*"):rep(width - 1)) .. "~\n"
end

--- A table with aligned columns, numbers to the right, a line a row; a column in which no row has
-- anything is left out.
-- keys   a column each
-- rows   tables by key
-- width  characters that a line has room for, nil for any number: then columns that one can spare
--        go until it fits, and what is still beyond is cut
function M.table(keys, rows, width)
  local columns, titles = {}, {}
  for _, key in ipairs(keys) do
    titles[key] = TITLES[key] or key
    columns[#columns + 1] = new_column(key, rows, titles[key])
  end
  if width then fit(columns, width) end
  local lines = { table_line(columns, titles, width) }
  for _, row in ipairs(rows) do
    lines[#lines + 1] = table_line(columns, row, width)
  end
  return table.concat(lines)
end

local function print_json(context, keys, rows)
  local in_json = {}
  for _, key in ipairs(keys) do
    if not FOR_PEOPLE[key] then
      in_json[#in_json + 1] = key
    end
  end
  for _, row in ipairs(rows) do
    context.out(M.object(row.keys or in_json, row).json .. "\n")
  end
end

--- Prints rows: for people under a title, or as a JSON object a line.
-- context  { out = function(text), json = whether so, width = see M.table, frames = a list that
--          gets the frames which stand in the table, or nil }
-- rows     tables by key; keys = those of its JSON, where these are others
function M.print(context, title, keys, rows)
  local frames = context.frames or {}
  for _, row in ipairs(rows) do
    frames[#frames + 1] = row.frame or row.gap_max_frame
  end
  if context.json then
    return print_json(context, keys, rows)
  end
  context.out(title .. "\n")
  if rows[1] then
    context.out("\n" .. M.table(keys, rows, context.width))
  end
end

-- Files ---------------------------------------------------------------------------------------

local File = {}
File.__index = File

--- Begins a file: written aside, so that nobody ever reads half of it.  A device is written as it
-- is: a file in its place would be the end of it.
-- advice   what to do where the file is there already, which is not overwritten then; nil for
--          nothing: it is
-- returns  the file, with File:write(text); nil and why not
function M.create(path, advice)
  local there = advice and io.open(path, "rb")
  if there then
    there:close()
    return nil, ("%s is there; %s"):format(path, advice)
  end
  local aside = path:find("^/dev/") and path or path .. ".part"
  local handle, problem = io.open(aside, "wb")
  if not handle then return nil, problem end
  handle:setvbuf("full", 65536)
  return setmetatable({ path = path, aside = aside, handle = handle }, File)
end

function File:write(text)
  local ok, problem = self.handle:write(text)
  if not ok then self.problem = problem end
end

--- Ends files and gives them their names, all or, where one could not be written, none.
-- problem  what went wrong before, nil for nothing
-- returns  what went wrong, nil for nothing
function M.finish(list, problem)
  local function note(file, ok, why)
    if not ok then
      problem = problem or file.path .. ": " .. why
    end
  end
  for _, file in ipairs(list) do
    note(file, not file.problem, file.problem)
    note(file, file.handle:close())
  end
  for _, file in ipairs(list) do
    local aside, path = file.aside, file.path
    if problem and aside ~= path then
      os.remove(aside)
    elseif aside ~= path and not os.rename(aside, path) then
      os.remove(path) -- Windows puts no file in the place of another
      note(file, os.rename(aside, path))
    end
  end
  return problem
end

--- Writes a file that holds a text.
-- advice   as for M.create
-- returns  what went wrong, nil for nothing
function M.save(path, text, advice)
  local file, problem = M.create(path, advice)
  if not file then return problem end
  file:write(text)
  return M.finish { file }
end

return M
