-- SPDX-License-Identifier: GPL-2.0-or-later
-- What statistics print and write: JSON lines, tables for people, files, whole or not there.
-- Pure Lua, 5.2 to 5.5.

local utf8 = require("yapp.base.utf8")

local M = {}

local format = string.format

-- JSON ----------------------------------------------------------------------------------------

local ESCAPES = {
  ['"'] = '\\"', ["\\"] = "\\\\", ["\n"] = "\\n", ["\r"] = "\\r", ["\t"] = "\\t",
}

--- A text that is UTF-8: what is not would make a whole line or report unreadable.
function M.readable(text)
  local ascii = utf8.ascii(text)
  if not ascii:find("[\128-\255]") then return text end
  return (ascii:gsub("[\128-\255]", "?"))
end

local function text_value(text)
  local escaped = M.readable(text):gsub('[%c"\\]', function(c)
    return ESCAPES[c] or format("\\u%04x", c:byte())
  end)
  return '"' .. escaped .. '"'
end

-- The shortest text that reads back as the same number; null for what JSON has no number for.
local function number_value(value)
  if value ~= value or value == math.huge or value == -math.huge then return "null" end
  if value % 1 == 0 and value > -2 ^ 53 and value < 2 ^ 53 then return format("%d", value) end
  local shown = format("%.15g", value)
  return tonumber(shown) == value and shown or format("%.17g", value)
end

--- A value: string, number, boolean, nil (null), or { json = text } for what is JSON already.
function M.value(value)
  local kind = type(value)
  if kind == "number" then return number_value(value) end
  if kind == "string" then return text_value(value) end
  if kind == "table" then return value.json end
  return value == nil and "null" or tostring(value)
end

--- An object of these keys, in this order, with the values that a table has under them; what it
-- has not is null.
function M.object(keys, values)
  local parts = {}
  for i, key in ipairs(keys) do parts[i] = text_value(key) .. ":" .. M.value(values[key]) end
  return "{" .. table.concat(parts, ",") .. "}"
end

--- A line with an object of these keys: of what says which source, of `values`, and of `more`.
function M.line(keys, source, values, more)
  local all = {}
  for _, key in ipairs(keys) do
    all[key] = values[key]
    if all[key] == nil then all[key] = more[key] end
  end
  all.bus, all.id, all.source = source.bus, source.id, source.name or values.source
  all.message = source.message and source.message.name
  return M.object(keys, all) .. "\n"
end

--- A list of values.
function M.list(values)
  local parts = {}
  for i, value in ipairs(values) do parts[i] = M.value(value) end
  return "[" .. table.concat(parts, ",") .. "]"
end

--- What is JSON already, as a value.
function M.raw(json)
  return { json = json }
end

--- A time of the capture with nine digits, as text.
-- seconds, nanoseconds  integers, nanoseconds 0 .. 999,999,999
function M.time_text(seconds, nanoseconds)
  if seconds < 0 and nanoseconds > 0 then -- -1 s and 9e8 ns are -0.1 s
    return format("-%d.%09d", -seconds - 1, 1000000000 - nanoseconds)
  end
  return format("%d.%09d", seconds, nanoseconds)
end

--- A span in seconds with nine digits as a value, nil for nil.
function M.seconds(value)
  return value and M.raw((format("%.9f", value):gsub("^%-(0%.0+)$", "%1")))
end

-- Tables --------------------------------------------------------------------------------------

-- How many places a text takes: characters, not bytes.
local function width_of(text)
  return select(2, text:gsub("[^\128-\191]", ""))
end

local function new_column(title, index, rows)
  local column = { title = title:gsub("^>", ""), is_right = title:sub(1, 1) == ">", width = 0 }
  function column.cell(row) return tostring(row[index] or "") end
  for _, row in ipairs(rows) do
    column.width = math.max(column.width, width_of(column.cell(row)))
  end
  if column.width == 0 then return nil end
  column.width = math.max(column.width, width_of(column.title))
  return column
end

-- The columns that have something, without those of `spare` that a line has no room for.
local function kept_columns(titles, rows, width, spare)
  local kept, total = {}, 0
  for i, title in ipairs(titles) do
    local column = new_column(title, i, rows)
    kept[#kept + 1] = column
    if column then total = total + column.width + 2 end
  end
  for _, title in ipairs(width and spare or {}) do
    for i = #kept, 1, -1 do
      if total - 2 > width and kept[i].title == title then
        total = total - table.remove(kept, i).width - 2
      end
    end
  end
  return kept
end

local function table_line(columns, cell, width)
  local cells = {}
  for i, column in ipairs(columns) do
    local text = cell(column)
    local blanks = (" "):rep(column.width - width_of(text))
    cells[i] = column.is_right and blanks .. text or text .. blanks
  end
  local line = table.concat(cells, "  "):gsub("%s+$", "")
  if not width or width_of(line) <= width then return line end
  return line:match("^" .. ("[^\128-\191][\128-\191]*"):rep(width - 1)) .. "~"
end

--- A table with aligned columns, a line a row; a column in which no row has anything is left out.
-- titles  a list; ">" in front of one aligns its column to the right
-- rows    lists of texts or numbers, false for an empty cell
-- width   characters that a line has room for, nil for any number: then columns of `spare`, a list
--         of titles, go until it fits, and what is still beyond is cut
function M.table(titles, rows, width, spare)
  local columns = kept_columns(titles, rows, width, spare)
  local lines = { table_line(columns, function(column) return column.title end, width) }
  for i, row in ipairs(rows) do
    lines[i + 1] = table_line(columns, function(column) return column.cell(row) end, width)
  end
  return table.concat(lines, "\n") .. "\n"
end

--- Date and time in UTC, to the microsecond.
-- seconds, nanoseconds  since 1970
function M.date(seconds, nanoseconds)
  local ok, date = pcall(os.date, "!%Y-%m-%d %H:%M:%S", seconds)
  if not ok then date = format("%d", seconds) end
  return format("%s.%06d", date, (nanoseconds - nanoseconds % 1000) / 1000)
end

--- A span in seconds: "12.345678"; a number at six digits; false for nil.
function M.span(seconds) return seconds and format("%.6f", seconds) or false end
function M.number(value) return value and format("%.6g", value) or false end

--- A count of things: "1 message", "2 messages".
function M.count(number, thing)
  return format("%d %s%s", number, thing, number == 1 and "" or "s")
end

--- The cells that say which source, bus, ID, name, message, and those that follow them.
function M.source_cells(source, ...)
  local title = source.message and source.message.title or source.id and "unknown"
  return source.bus, source.id and format("0x%x", source.id), source.name, title, ...
end

--- The frames that tables name, in a text of several tables, parted by empty lines: numbers in the
-- columns "frame" and "in frame", each once, in order.
function M.frames(text)
  local frames, is_known, stop, is_head = {}, {}, nil, true
  for bytes in text:gmatch("([^\n]*)\n") do
    local line = bytes:gsub("[\194-\244][\128-\191]*", "?") -- a place a character
    if is_head then stop = select(2, line:find("%f[%w]frame%f[^%w]")) end
    local frame = not is_head and stop and tonumber(line:sub(1, stop):match("(%d+)$"))
    if frame and not is_known[frame] then
      frames[#frames + 1], is_known[frame] = frame, true
    end
    is_head = line == ""
  end
  table.sort(frames)
  return frames
end

-- Files ---------------------------------------------------------------------------------------

local File = {}
File.__index = File

--- Begins a file: written aside, so that nobody ever reads half of it.  A device is written as it
-- is: a file in its place would be the end of it.
-- returns  the file, with File:write(text); nil and why not
function M.create(path)
  local aside = path:find("^/dev/") and path or path .. ".part"
  local handle, problem = io.open(aside, "wb")
  if not handle then return nil, problem end
  handle:setvbuf("full", 65536)
  return setmetatable({ path = path, aside = aside, handle = handle, problem = nil }, File)
end

function File:write(text)
  local ok, problem = self.handle:write(text)
  if not ok then self.problem = self.problem or problem end
end

-- Gives a closed file its name, in place of one that is there.
local function publish(file)
  if file.aside == file.path then return true end
  local ok, problem = os.rename(file.aside, file.path)
  local other = not ok and io.open(file.path, "ab") -- a file, no folder
  if other then -- Windows puts no file in the place of another
    other:close()
    os.remove(file.path)
    ok, problem = os.rename(file.aside, file.path)
  end
  file.is_published = ok
  return ok, problem
end

local function discard(file)
  if file.aside ~= file.path then os.remove(file.is_published and file.path or file.aside) end
end

-- Notes the first thing that goes wrong with a file.
local function note(file, ok, problem)
  if not ok then file.problem = file.problem or problem end
end

--- Ends files and gives them their names, all or, where one fails, none.
-- problem  what went wrong before, nil for nothing
-- returns  what went wrong, nil for nothing
function M.finish(list, problem)
  for _, file in ipairs(list) do
    note(file, file.handle:flush())
    note(file, file.handle:close())
    if file.problem then problem = problem or file.path .. ": " .. file.problem end
  end
  for _, file in ipairs(list) do
    if not problem then note(file, publish(file)) end
    if file.problem then problem = problem or file.path .. ": " .. file.problem end
  end
  for _, file in ipairs(problem and list or {}) do discard(file) end
  return problem
end

return M
