-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,events: what happened, in the order of time; and -z yapp,faults: of this the faults, when
-- each flag rose and fell, on which source, for how long.  Pure Lua, 5.2 to 5.5.

local kinds = require("yapp.stat.kinds")
local output = require("yapp.stat.output")

local M = {}

local words = output.words
local KEYS = {
  faults = {
    json = words("time frame bus id source message field flag event active help"),
    text = words("time rel frame bus id source message field flag event active help"),
    window = words("rel who flag event active"),
  },
  events = {
    text = words("time rel frame bus id source message kind details times"),
    window = words("rel who message details times"),
  },
}
-- Of a line of events in JSON, by kind.
local KEYS_OF_KIND = {}
for _, row in ipairs(kinds.LIST) do
  KEYS_OF_KIND[row.name] = words("kind time frame bus id source message " .. (row.keys or ""))
end

local Events = { follows_changes = true }
Events.__index = Events

--- Make the statistic.
-- options  { what = "events" or "faults" }
-- context  { clock = function(rel) -> seconds since 1970, nanoseconds; and what output.print
--          takes }
function M.new(options, context)
  return setmetatable({ what = options.what, context = context, list = {} }, Events)
end

--- Take an event, see stat.queue.  Of messages that were not decoded the first one of a source and
-- size stands for all.
function Events:event(event)
  local is_wanted = self.what == "events" and kinds.BY_NAME[event.kind] or event.kind == "fault"
  local is_repeated = event.kind == "unknown" and event.values.count > 1
  if is_wanted and not is_repeated then
    self.list[#self.list + 1] = event
  end
end

-- The text of an event: its kind's, with the values of a row; an optional part without one is left
-- out.
local function details_of(row)
  local is_filled
  local function fill(key)
    local text = output.text(row[key], true)
    is_filled = is_filled and text ~= ""
    return text
  end
  local function fill_part(part)
    is_filled = true
    local text = part:sub(2, -2):gsub("{(%w+)}", fill)
    return is_filled and text or ""
  end
  local text = kinds.BY_NAME[row.kind].text:gsub("%b[]", fill_part):gsub("{(%w+)}", fill)
  return text
end

-- order  among all events
local function row_of(self, event, order)
  local row = { kind = event.kind, frame = event.frame, of = event, order = order }
  for key, value in pairs(event.values) do
    row[key] = value
  end
  output.row(event.source, row)
  row.time = event.time and output.time(self.context.clock(event.time))
  row.rel = output.seconds(event.time)
  row.details = details_of(row)
  row.keys = self.what == "events" and KEYS_OF_KIND[event.kind] or nil
  return row
end

-- In time; at one time by frame; without one behind all others.
local function is_before(a, b)
  local one, other = a.of.time or math.huge, b.of.time or math.huge
  if one ~= other then return one < other end
  one, other = a.frame or math.huge, b.frame or math.huge
  if one ~= other then return one < other end
  return a.order < b.order
end

-- The rows for people: equal ones of a source, of a kind that repeats, are one line.
local function merge(rows)
  local lines, by_name = {}, {}
  for _, row in ipairs(rows) do
    local key = row.of.source.key
    local name = kinds.BY_NAME[row.kind].repeats and ("%s|%s"):format(key, row.details)
    local line = by_name[name]
    if line then
      line.times = (line.times or 1) + 1
    else
      lines[#lines + 1] = row
      if name then by_name[name] = row end
    end
  end
  return lines
end

--- End, see stat.queue.  It always ends well.
function Events:finish(ending)
  local context, what, rows = self.context, self.what, {}
  for _, event in ipairs(self.list) do
    local needs_time = kinds.BY_NAME[event.kind].needs_time
    if not (needs_time and ending.lacks_times) then
      rows[#rows + 1] = row_of(self, event, #rows)
    end
  end
  if what == "events" then table.sort(rows, is_before) end
  local title = ("YAPP %s: %d"):format(what, #rows)
  output.print(context, title, KEYS[what], context.json and rows or merge(rows), ending.notes)
end

return M
