-- SPDX-License-Identifier: GPL-2.0-or-later
-- Tables and times as a person reads them.  Pure Lua, 5.2 and 5.4.

local M = {}

-- How many places a text takes: characters, not bytes.
local function width(text)
  return select(2, text:gsub("[^\128-\191]", ""))
end

local function pad(text, places, right)
  local blanks = (" "):rep(places - width(text))
  return right and blanks .. text or text .. blanks
end

--- A table with aligned columns, a line a row; a column in which no row has anything is left out.
-- columns  a list of titles; ">" in front of one aligns it to the right
-- rows     lists of texts or numbers, false for an empty cell
function M.table(columns, rows)
  local kept = {}
  for i, title in ipairs(columns) do
    local column = { index = i, right = title:sub(1, 1) == ">", title = title:gsub("^>", ""), width = 0 }
    for _, row in ipairs(rows) do column.width = math.max(column.width, width(tostring(row[i] or ""))) end
    if column.width > 0 then
      column.width = math.max(column.width, width(column.title))
      kept[#kept + 1] = column
    end
  end
  local lines = {}
  local function add(cell)
    local cells = {}
    for i, column in ipairs(kept) do cells[i] = pad(cell(column), column.width, column.right) end
    lines[#lines + 1] = (table.concat(cells, "  "):gsub("%s+$", ""))
  end
  add(function(column) return column.title end)
  for _, row in ipairs(rows) do
    add(function(column) return tostring(row[column.index] or "") end)
  end
  return table.concat(lines, "\n") .. "\n"
end

--- Date and time in UTC, to the microsecond.
-- seconds, nanoseconds  since 1970
function M.date(seconds, nanoseconds)
  local ok, date = pcall(os.date, "!%Y-%m-%d %H:%M:%S", seconds)
  return ("%s.%06d"):format(ok and date or ("%d"):format(seconds), (nanoseconds - nanoseconds % 1000) / 1000)
end

--- A span: "12.345678", false for nil.
function M.span(seconds)
  return seconds and ("%.6f"):format(seconds) or false
end

--- A number at six digits, false for nil.
function M.number(value)
  return value and ("%.6g"):format(value) or false
end

--- A count of things: "1 message", "2 messages".
function M.count(number, thing)
  return ("%d %s%s"):format(number, thing, number == 1 and "" or "s")
end

--- The frames that tables name, in a text of several tables, parted by empty lines: numbers in the columns "frame" and
-- "in frame", each once, in order.
function M.frames(text)
  local frames, is_known, stop, is_head = {}, {}, nil, true
  for line in text:gmatch("([^\n]*)\n") do
    line = line:gsub("[\194-\244][\128-\191]*", "?") -- a place a character
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

--- An ID as it is shown: "0x210".
function M.id(id)
  return ("0x%x"):format(id)
end

return M
