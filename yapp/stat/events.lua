-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,events: what happened, in the order of time; and -z yapp,faults: of this the faults, when
-- each flag rose and fell, on which source, for how long.  Pure Lua, 5.2 to 5.5.

local output, tell = require("yapp.stat.output"), require("yapp.stat.tell")

local M = {}

local COLUMNS = {
  faults = output.words("time rel frame bus id source message field flag event active help"),
  events = output.words("time rel frame bus id source message kind details times"),
}
-- Of a line of events in JSON, by kind.
local KEYS = {}
for name, kind in pairs(tell.KINDS) do
  KEYS[name] = output.words("kind time frame bus id source message " .. (kind.keys or ""))
end

local Events = { tells_changes = true }
Events.__index = Events

--- options  { what = "events" or "faults" }
-- context   { clock = function(rel) -> seconds since 1970, nanoseconds, and what output.print
--           takes }
function M.new(options, context)
  return setmetatable({ what = options.what, context = context, list = {} }, Events)
end

function Events:event(event)
  local is_wanted = self.what == "events" or event.kind == "fault"
  if is_wanted and tell.KINDS[event.kind].text then
    self.list[#self.list + 1] = event
  end
end

-- of = the event, place = among all; a row of faults has no keys of its own.
local function row_of(self, event, place)
  local row = { kind = event.kind, frame = event.frame, of = event, place = place }
  for key, value in pairs(event.values) do
    row[key] = value
  end
  output.row(event.source, row)
  row.time = event.rel and output.time(self.context.clock(event.rel))
  row.rel = output.seconds(event.rel)
  row.details = tell.KINDS[event.kind].text:gsub("{(%w+)}", function(key)
    return output.text(row[key])
  end)
  return row
end

-- In time; what has no frame is behind all others.
local function is_before(a, b)
  local one, other = a.of, b.of
  if one.rel ~= other.rel then
    return one.rel < other.rel
  end
  if one.frame ~= other.frame then
    return (one.frame or math.huge) < (other.frame or math.huge)
  end
  return a.place < b.place
end

-- By what a person's line is found that an event may go into: messages of a source with the same
-- undefined value are one; so are reboots that several messages of a controller tell, which have
-- its name, or its number counted from their default IDs.
local function names_of(event)
  local source, values = event.source, event.values
  if event.kind == "invalid" then
    return { source.key .. values.field .. values.value }
  end
  if event.kind ~= "reboot" then return {} end
  local bus = tostring(source.bus_key)
  return { bus .. "+" .. source.id - source.message.id, source.name and bus .. "=" .. source.name }
end

-- Puts an event into the line of another one; returns whether it belongs there.  A reboot does not
-- where its message has told of one already, or has come before.
local function join(line, row)
  local event = row.of
  local message = event.source.message
  if event.kind == "invalid" then
    line.times = (line.times or 1) + 1
    return true
  end
  if line.messages[message] or event.rel - line.of.rel > (message.every or 0) then
    return false
  end
  line.messages[message] = true
  line.id = { text = line.id.text .. ", " .. row.id.text }
  line.message = { text = line.message.text .. ", " .. row.message.text }
  return true
end

-- The rows for people: what several of them tell is one line.
local function joined(rows)
  local lines, by_name = {}, {}
  for _, row in ipairs(rows) do
    local names = names_of(row.of)
    local line = by_name[names[1]] or by_name[names[2]]
    if not line or not join(line, row) then
      line, lines[#lines + 1] = row, row
      row.messages = { [row.of.source.message or false] = true }
    end
    for _, name in ipairs(names) do
      by_name[name] = line
    end
  end
  return lines
end

--- returns  nothing: it always ends well
function Events:finish()
  local context, what, rows = self.context, self.what, {}
  for i, event in ipairs(self.list) do
    rows[i] = row_of(self, event, i)
    rows[i].keys = what == "events" and KEYS[event.kind] or nil
  end
  if what == "events" then table.sort(rows, is_before) end
  local title = ("YAPP %s: %d"):format(what, #rows)
  output.print(context, title, COLUMNS[what], context.json and rows or joined(rows))
end

return M
