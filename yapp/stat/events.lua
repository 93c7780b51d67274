-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,events: what happened, in the order of time; and -z yapp,faults: of this the faults, when
-- each flag rose and fell, on which source, for how long.  Pure Lua, 5.2 to 5.5.

local output = require("yapp.stat.output")

local unpack = rawget(table, "unpack")

local M = {}

local FAULT_KEYS = {
  "time", "frame", "bus", "id", "source", "message", "field", "flag", "event", "active", "help",
}
-- The keys of a kind of event behind those that all have.
local KEYS = {
  fault = { "field", "flag", "event", "active" }, silence = { "length" }, incomplete = { "what" },
  invalid = { "field", "value" }, skipped = { "length" },
  reboot = {}, stale = {}, crc = {}, unfinished = {}, absent = {},
}
local COMMON = { "kind", "time", "frame", "bus", "id", "source", "message" }
for kind, more in pairs(KEYS) do
  local keys = { unpack(COMMON) }
  for _, key in ipairs(more) do keys[#keys + 1] = key end
  KEYS[kind] = keys
end

local Events = { tells_changes = true }
Events.__index = Events

--- options  { what = "events" or "faults", json = boolean }
-- context  { out = function(text), clock = function(rel) -> seconds since 1970, nanoseconds,
--          width = of a line or nil }
function M.new(options, context)
  return setmetatable({ options = options, context = context, list = {} }, Events)
end

function Events:event(event)
  if self.options.what == "faults" and event.kind ~= "fault" or not KEYS[event.kind] then return end
  event.order = #self.list + 1
  self.list[event.order] = event
end

-- In time; what has no frame is behind all others.
local function earlier(a, b)
  if a.rel ~= b.rel then return a.rel < b.rel end
  if a.frame ~= b.frame then return (a.frame or math.huge) < (b.frame or math.huge) end
  if a.source.id ~= b.source.id then return (a.source.id or -1) < (b.source.id or -1) end
  return a.order < b.order
end

local TITLES = {
  "time (UTC)", ">since start/s", ">frame", "bus", "ID", "source", "message", "event", "what",
}
local FAULT_TITLES = {
  "time (UTC)", ">since start/s", ">frame", "bus", "ID", "source", "message", "flag", "event",
  ">active/s", "help",
}
local SPARE = { "time (UTC)", "help", "bus", "message", "ID" }

local function line(event, keys, clock)
  local values = { active = output.seconds(event.active),
    time = event.rel and output.raw(output.time_text(clock(event.rel))) }
  if event.kind == "silence" then values.length = output.seconds(event.length) end
  return output.line(keys, event.source, values, event)
end

local WHAT = {
  incomplete = "bytes are missing", orphan = "the Start is missing",
  overrun = "more bytes than its size",
}
local DETAILS = {
  reboot = "the controller's time went back", stale = "the controller's time stood still",
  crc = "bad CRC", unfinished = "the capture ends before it", absent = "no message of it came",
}

function DETAILS.fault(event)
  local after = event.active and (" after %.6f s"):format(event.active) or ""
  return ("%s %s%s"):format(event.flag, event.event, after)
end

function DETAILS.silence(event)
  return ("nothing for %.6f s%s"):format(event.length, event.is_last and ", to the end" or "")
end

function DETAILS.incomplete(event) return WHAT[event.what] end

function DETAILS.invalid(event)
  local value = type(event.value) == "number" and ("%.0f"):format(event.value) or event.value
  return ("%s has %s, which is not defined"):format(event.field, value)
end

function DETAILS.skipped(event)
  return output.count(event.length, "byte") .. " of no frame"
end

-- The row of a reboot of the same controller as this event's, where it has one: of another message
-- of its number on its bus, or of its name, as soon after it as a message may come.
local function row_of_reboot(rows, event)
  local source = event.source
  local message = source.message
  for _, row in ipairs(rows) do
    local other = row.event.source
    local period = math.max(other.message.every or 0, message.every or 0)
    if other.bus_key == source.bus_key and not row.messages[message] and
      event.rel - row.event.rel <= period and (source.name and source.name == other.name or
      source.id - message.id == other.id - other.message.id) then return row end
  end
end

local function row_of(event, clock)
  local detail = DETAILS[event.kind]
  if type(detail) == "function" then detail = detail(event) end
  return { event.rel and output.date(clock(event.rel)), output.span(event.rel), event.frame,
    output.source_cells(event.source, event.kind, detail) }
end

-- The rows of a table.  A reboot that several messages of a controller tell is one, and so are
-- messages with the same undefined value.
local function event_rows(list, clock)
  local rows, reboots, undefined = {}, {}, {}
  for _, event in ipairs(list) do
    local source, row = event.source, nil
    if event.kind == "reboot" then
      row = row_of_reboot(reboots, event)
    elseif event.kind == "invalid" then
      row = undefined[source.key .. event.field .. event.value]
    end
    if not row then
      row = row_of(event, clock)
      row.event, row.messages, row.times, rows[#rows + 1] = event, {}, 0, row
    end
    if event.kind == "reboot" then
      local _, id, _, title = output.source_cells(source)
      if row.event == event then
        reboots[#reboots + 1] = row
      else
        row[5], row[7] = row[5] .. ", " .. id, row[7] .. ", " .. title
      end
      row.messages[source.message] = true
    elseif event.kind == "invalid" then
      undefined[source.key .. event.field .. event.value], row.times = row, row.times + 1
      row[9] = DETAILS.invalid(event)
      if row.times > 1 then row[9] = ("%s, in %d messages"):format(row[9], row.times) end
    end
  end
  return rows
end

local function fault_rows(list, clock)
  local rows = {}
  for i, event in ipairs(list) do
    rows[i] = { output.date(clock(event.rel)), output.span(event.rel), event.frame,
      output.source_cells(event.source, event.flag, event.event, output.span(event.active),
        event.help) }
  end
  return rows
end

--- returns  nothing: it always ends well
function Events:finish()
  local what, list, context = self.options.what, self.list, self.context
  local is_faults, out, clock = what == "faults", context.out, context.clock
  if not is_faults then table.sort(list, earlier) end
  if self.options.json then
    for _, event in ipairs(list) do
      out(line(event, is_faults and FAULT_KEYS or KEYS[event.kind], clock))
    end
  elseif not list[1] then
    out(("YAPP %s: none\n"):format(what))
  elseif is_faults then
    out(("YAPP faults: %s\n\n"):format(output.count(#list, "change")) ..
      output.table(FAULT_TITLES, fault_rows(list, clock), context.width, SPARE))
  else
    out(("YAPP events: %d\n\n"):format(#list) ..
      output.table(TITLES, event_rows(list, clock), context.width, SPARE))
  end
end

return M
