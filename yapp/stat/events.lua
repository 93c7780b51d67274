-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,events: what happened, in the order of time; and -z yapp,faults: the faults among these,
-- when each flag rose and fell, on which source, for how long.  Pure Lua, 5.2 to 5.5.

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
    text = words("time rel frame bus id source message kind details"),
    window = words("rel who message details"),
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

--- Take an event, see stat.queue.  Of messages that were not decoded, keep the first event of each
-- source and size alone.
function Events:event(event)
  local is_wanted = self.what == "events" and kinds.BY_NAME[event.kind] or event.kind == "fault"
  local is_repeated = event.kind == "unknown" and event.values.count > 1
  if is_wanted and not is_repeated then
    self.list[#self.list + 1] = event
  end
end

-- The text of an event's kind, with the values of a row.
local function details_of(row)
  local function fill(key) return output.text(row[key], true) end
  return (kinds.BY_NAME[row.kind].text:gsub("{(%w+)}", fill))
end

local function row_of(self, event)
  local row = { kind = event.kind, frame = event.frame }
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

-- By time, then by frame; events without a time come last.
local function order_of(event)
  return event.time or math.huge, event.frame or math.huge
end

--- End, see stat.queue.  It always ends well.
function Events:finish(ending)
  local what, list = self.what, ending.lacks_times and {} or self.list
  for _, event in ipairs(ending.lacks_times and self.list or {}) do
    if not kinds.BY_NAME[event.kind].needs_time then list[#list + 1] = event end
  end
  if what == "events" then output.sort(list, order_of) end
  local title = ("YAPP %s: %d"):format(what, #list)
  output.print(self.context, title, KEYS[what], list, ending.notes, function(event)
    return row_of(self, event)
  end)
end

return M
