-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,events: all events, in the order of time; and -z yapp,faults: the faults among these,
-- when each flag rose and fell, on which source, for how long.  Pure Lua, 5.2 to 5.5.

local buses = require "yapp.stat.buses"
local input = require "yapp.base.input"
local kinds = require "yapp.stat.kinds"
local mapped = require "yapp.base.mapped"
local memo = require "yapp.base.memo"
local output = require "yapp.stat.output"

local Lists = { follows_changes = true }
Lists.__index = Lists

-- Kinds of events that may come often: in a window one line for each source and kind.
local MERGED = input.set("clock missing dropped stale crc incomplete unfinished skipped invalid")
local MORE = ", %d times up to %.3f s"
-- A controller's messages see these one after the other, so many seconds apart at most.
local OF_CONTROLLER, TOGETHER = input.set("silence reboot"), 2
-- Behind the other keys, where it is.
local NEAR = { "near", "string", "the bus events within a second of a fault, a silence or a loss" }
local EVENTS = output.columns({
  {
    "kind",
    "string",
    "what happened: `fault`, `reboot`, `silence` and others, see statistics.md",
    title = "event",
  },
  "time frame bus id source message",
  -- The values of the kinds:
  "field flag event active",
  {
    "length",
    "seconds",
    "of a silence, a jump, a step of the clock or `disabled`; of `skipped`: bytes",
    unit = "s",
  },
  { "what", "string", "of `incomplete`: what was wrong with it" },
  { "value", "text", "of `invalid`: what the field had" },
  { "size", "integer", "of `unknown`: bytes of each message" },
  { "count", "integer", "how many messages or packets; null for one" },
  { "like", "string", "of `unknown`: the message that has this size" },
  NEAR,
}, "time rel frame bus id source message kind details near",
  "rel frame bus id source details near")
local FAULTS = output.columns({
  "time frame bus id source message field flag event active",
  { "help", "string", "what the catalogue says of the flag" },
  NEAR,
}, "time rel frame bus id source message field flag event active near",
  "rel frame who flag event active near")
--- The columns of both, see output.columns.
Lists.COLUMNS = { events = EVENTS, faults = FAULTS }

local EVENT_KEYS = "kind time frame bus id source message " -- and those of its kind
local FAULT_KEYS = table.concat(FAULTS.json, " ", 1, #FAULTS.json - 1) -- all but NEAR

--- Make the statistic.
-- options  { what = "events" or "faults" }
-- context  { dates = a stat.dates; and the rest for output.print }
function Lists.new(options, context)
  return setmetatable({
    what = options.what,
    context = context,
    list = {},
    incidents = {}, -- set of the times in which a source had a fault, all flags together
    bus_events = {},
  }, Lists)
end

--- Add an event, see stat.answer.  Messages that were not decoded have one event for each source
-- and size.
function Lists:add_event(event)
  local kind = event.kind
  local row = kinds.BY_NAME[kind]
  if kind == "bus" then table.insert(self.bus_events, event) end
  if kind == "fault" then self.incidents[event.values.incident] = true end
  local is_listed = self.what == "events" and row and not row.is_counted_only
  if kind == "unknown" and event.values.count > 1 then return end
  if is_listed or kind == "fault" then self.list[#self.list + 1] = event end
end

--- Return the row of an event.
-- near  text of the bus events near it, nil for none
-- keys  of its line of JSON, nil for those of `events`
function Lists.event_row(context, event, ending, near, keys)
  local kind, time = kinds.BY_NAME[event.kind], event.time
  keys = keys or EVENT_KEYS .. (kind.keys or "")
  local row = {
    kind = kind.name,
    frame = event.frame,
    time = time and context.dates:value(time),
    rel = output.seconds(time),
    near = near,
    keys = near and keys .. " near" or keys,
  }
  for key, value in pairs(event.values) do
    row[key] = value
  end
  if ending.lacks_times then row.active, row.after = nil, nil end
  local function fill(key) return output.text(row[key], true) end
  row.details = kind.text:gsub("{(%w+)}", fill) .. (event.more or "")
  return output.row(event.source, row)
end

--- Return a number of faults as a text, and the exit code: where not all was read and decoded, none
-- is known.
function Lists.count_text(count, ending)
  local why = ending.unread or ending.reason and "no message found" or
    ending.is_partial and "not all packets were decoded" or
    ending.is_unreliable and "the history of sources is unreliable"
  if ending.unknown > 0 then
    why = ending.unknown .. " of " .. output.count(ending.sources, "source") .. " not decoded"
  end
  if not why then return count end
  return ("UNKNOWN, %s, %d in what was decoded"):format(why, count), output.EXIT_UNDECIDED
end

-- Add an event to the first one of its line.
local function add_to(first, event)
  local values = first.values
  if event.kind == "fault" then
    values.flag = values.flag .. ", " .. event.values.flag
    return
  end
  first.times = (first.times or 1) + 1
  first.more = MORE:format(first.times, event.time or 0)
  for key, value in pairs(event.values) do
    if type(value) == "number" then values[key] = values[key] + value end
  end
end

-- Return whose line of a window an event is on, and which: all flags that a message raises, or
-- clears; the silence or the reboot of a controller; all of a source that may come often.
local function line_of(event)
  local kind, source = event.kind, event.source
  if kind == "fault" then return source, event.values.event .. event.frame end
  if OF_CONTROLLER[kind] and source.type.time then
    return kind, ("%s %d"):format(source.bus_key, source.id % 16)
  end
  return source, MERGED[kind] and kind or event
end

-- Return a list with one event for each line: their sum, or of a controller that of its fastest
-- message.
local function merge(list)
  local merged, by_owner = {}, memo()
  for _, event in ipairs(list) do
    local owner, line = line_of(event)
    local lines, is_controller = by_owner[owner], owner == event.kind
    local index = lines[line]
    local first = merged[index]
    if not first or is_controller and event.time - first.time > TOGETHER then
      lines[line] = #merged + 1
      merged[#merged + 1] = event
    elseif not is_controller then
      add_to(first, event)
    elseif event.source.type.every < first.source.type.every then
      merged[index] = event
    end
  end
  return merged
end

--- End, see stat.answer.
function Lists:finish(ending, notes)
  local context, what, code = self.context, self.what, nil
  local list = mapped(self.list, function(event)
    return not (ending.lacks_times and kinds.BY_NAME[event.kind].needs_time) and event
  end)
  local count = 0
  if what == "events" then
    count = #list
    -- Events without a packet come last.
    output.sort(list, function(event) return event.frame or math.huge end)
    if context.frames and not context.json then list = merge(list) end
  else
    for _ in pairs(self.incidents) do count = count + 1 end
    count, code = Lists.count_text(count, ending)
  end
  local keys = what == "faults" and FAULT_KEYS
  local rows = mapped(list, function(event)
    return Lists.event_row(context, event, ending, buses.near(event, self.bus_events), keys)
  end)
  output.print(context, ("YAPP %s: %s"):format(what, count), Lists.COLUMNS[what], rows, notes)
  return code
end

return Lists
