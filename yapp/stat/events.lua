-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,events: what happened, in the order of time; and -z yapp,faults: of this the faults, when
-- each flag rose and fell, on which source, for how long.  Pure Lua, 5.2 to 5.5.

local output = require("yapp.stat.output")
local KINDS = require("yapp.stat.tell").KINDS

local M = {}

local FAULTS = output.words("time rel frame bus id source message field flag event active help")
local EVENTS = output.words("time rel frame bus id source message kind details times")
-- In JSON a kind's own keys stand behind those that all have.
local KEYS = {}
for _, kind in ipairs(KINDS) do
  local keys = output.words("kind time frame bus id source message")
  for _, key in ipairs(kind.keys or {}) do
    keys[#keys + 1] = key
  end
  KEYS[kind.name] = kind.keys and keys
end

local Events = { tells_changes = true }
Events.__index = Events

--- options  { what = "events" or "faults" }
-- context   { clock = function(rel) -> seconds since 1970, nanoseconds, and what output.print
--           takes }
function M.new(options, context)
  return setmetatable({
    what = options.what,
    context = context,
    list = {},
    places = {},
  }, Events)
end

function Events:event(event)
  if self.what == "faults" and event.kind ~= "fault" or not KEYS[event.kind] then
    return
  end
  self.list[#self.list + 1] = event
  self.places[event] = #self.list
end

-- In time; what has no frame is behind all others.
local function sort(self)
  table.sort(self.list, function(a, b)
    if a.rel ~= b.rel then
      return a.rel < b.rel
    end
    if a.frame ~= b.frame then
      return (a.frame or math.huge) < (b.frame or math.huge)
    end
    return self.places[a] < self.places[b]
  end)
end

local function row_of(self, event)
  local kind, row = KINDS[event.kind], {}
  for key, value in pairs(event) do
    row[key] = value
  end
  output.row(event.source, row)
  row.time = event.rel and output.time(self.context.clock(event.rel))
  row.rel = output.seconds(event.rel)
  row.details = kind.text:gsub("{(%w+)}", function(key) return output.text(row[key]) end)
  return row
end

-- By what a person's line is found that an event may go into: messages of a source with the same
-- undefined value are one; so are reboots that several messages of a controller tell, which have
-- its name, or its number counted from their default IDs.
local function keys_of(event)
  local source = event.source
  local bus = tostring(source.bus_key)
  if event.kind == "invalid" then
    return { source.key .. event.field .. event.value }
  end
  if event.kind ~= "reboot" then return {} end
  return { bus .. "+" .. source.id - source.message.id, source.name and bus .. "=" .. source.name }
end

-- Whether a reboot is another one than that of a row: of a message that has told of it already, or
-- later than the message's next one.
local function is_another(row, event)
  local message = event.source.message
  return row.messages[message] or event.rel - row.first.rel > (message.every or 0)
end

local function join(row, other)
  if row.kind == "invalid" then
    row.times = (row.times or 1) + 1
  else
    row.id = { text = row.id.text .. ", " .. other.id.text }
    row.message = { text = row.message.text .. ", " .. other.message.text }
  end
end

local function joined(list, rows)
  local kept, by_key = {}, {}
  for i, event in ipairs(list) do
    local keys, row = keys_of(event), rows[i]
    local same = by_key[keys[1] or false] or by_key[keys[2] or false]
    if same and event.kind == "reboot" and is_another(same, event) then
      same = nil
    end
    if same then
      join(same, row)
    else
      same, kept[#kept + 1] = row, row
      row.first, row.messages = event, {}
    end
    same.messages[event.source.message or false] = true
    for _, key in ipairs(keys) do
      by_key[key] = same
    end
  end
  return kept
end

--- returns  nothing: it always ends well
function Events:finish()
  local list, rows, context = self.list, {}, self.context
  if self.what == "events" then sort(self) end
  for i, event in ipairs(list) do
    rows[i] = row_of(self, event)
    rows[i].keys = self.what == "events" and KEYS[event.kind] or nil
  end
  if not context.json then
    rows = joined(list, rows)
  end
  output.print(context, ("YAPP %s: %d"):format(self.what, #list),
    self.what == "faults" and FAULTS or EVENTS, rows)
end

return M
