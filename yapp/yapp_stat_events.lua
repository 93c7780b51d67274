-- -z yapp,events: what happened, in the order of time: faults, reboots, clocks that stand still, silences, bad CRCs,
-- messages that are not whole.  Pure Lua, 5.2 and 5.4.

local json, text = require("yapp_stat_json"), require("yapp_stat_text")
local faults = require("yapp_stat_faults")

local M = {}

-- The keys of a kind after those that all have.
local COMMON = { "kind", "time", "frame", "bus", "id", "source", "message" }
local MORE = { fault = { "field", "flag", "event", "active" }, silence = { "length" }, incomplete = { "what" } }

local KEYS = {}
for _, kind in ipairs { "fault", "reboot", "stale", "silence", "crc", "incomplete", "unfinished" } do
  KEYS[kind] = {}
  for _, key in ipairs(COMMON) do table.insert(KEYS[kind], key) end
  for _, key in ipairs(MORE[kind] or {}) do table.insert(KEYS[kind], key) end
end

local Events = {}
Events.__index = Events

--- options  { json = boolean }
-- context  { out = function(text), late = function() -> how many periods of a message make a silence }
function M.new(options, context)
  local self = setmetatable({ options = options, context = context, tracker = faults.tracker(), list = {},
    before = {}, sees_all = true }, Events)
  function self.keeper(event) self:keep(event) end
  return self
end

function Events:add(kind, record, more)
  local event = more or {}
  event.kind, event.record = kind, record
  self:keep(event)
end

-- Faults come as they are, others with the record that they are about.
function Events:keep(event)
  local record = event.record
  if record then
    event.seconds, event.nanoseconds, event.rel = record.seconds, record.nanoseconds, record.rel
    event.frame, event.bus, event.id, event.source = record.frame, record.bus, record.id, record.source
    event.message, event.record = record.message, nil
  end
  event.order = #self.list + 1
  self.list[event.order] = event
end

-- A good message.
function Events:good(record, counts)
  local change, before = record.change, self.before[record.key]
  if change and change.late and before and before.counts then
    self:add("silence", before.record, { length = change.late })
  end
  if not before then
    before = {}
    self.before[record.key] = before
  end
  before.record, before.counts = record, counts
  if not counts then return end
  if change and change.reboot then self:add("reboot", record) end
  if change and change.stale then self:add("stale", record) end
  self.tracker:message(record, self.keeper)
end

function Events:message(record, counts)
  if record.good then return self:good(record, counts) end
  if not counts then return end
  if record.lost == "unfinished" then
    self:add("unfinished", record)
  elseif record.lost then
    self:add("incomplete", record, { what = record.lost })
  elseif record.is_bad then
    self:add("crc", record)
  end
end

-- Silences that last to the end of the capture.
function Events:silent(last)
  for _, before in pairs(self.before) do
    local record = before.record
    local every = record.message and record.message.every
    local length = every and last and last.rel - record.rel
    if length and before.counts and length > self.context.late() * every then
      self:add("silence", record, { length = length, is_last = true })
    end
  end
end

local function earlier(a, b)
  if a.seconds ~= b.seconds then return a.seconds < b.seconds end
  if a.nanoseconds ~= b.nanoseconds then return a.nanoseconds < b.nanoseconds end
  if a.frame ~= b.frame then return a.frame < b.frame end
  if a.id ~= b.id then return a.id < b.id end
  return a.order < b.order
end

local function line(event)
  local values = faults.values(event)
  values.length, values.what = json.seconds(event.length), event.what
  return json.object(KEYS[event.kind], values) .. "\n"
end

local DETAILS = {
  fault = function(event)
    return event.flag .. " " .. event.event .. (event.active and (" after %.6f s"):format(event.active) or "")
  end,
  reboot = function() return "the controller's time went back" end,
  stale = function() return "the controller's time stood still" end,
  silence = function(event)
    return ("nothing for %.6f s%s"):format(event.length, event.is_last and ", to the end of the capture" or "")
  end,
  crc = function() return "bad CRC" end,
  incomplete = function(event)
    return event.what == "orphan" and "the Start is missing" or
      event.what == "overrun" and "more bytes than its size" or "bytes are missing"
  end,
  unfinished = function() return "the capture ends before the message" end,
}

local function row(event)
  return { text.date(event.seconds, event.nanoseconds), text.span(event.rel), event.frame, event.bus,
    text.id(event.id), event.source, event.message and event.message.title or "unknown", event.kind,
    DETAILS[event.kind](event) }
end

--- last  { seconds =, nanoseconds =, rel = } of the last packet of any kind; nil where there was none
function Events:finish(last)
  self:silent(last)
  self.tracker:finish(self.keeper)
  table.sort(self.list, earlier)
  local out = self.context.out
  if self.options.json then
    for _, event in ipairs(self.list) do out(line(event)) end
    return
  end
  if #self.list == 0 then return out("YAPP events: none\n") end
  local rows = {}
  for i, event in ipairs(self.list) do rows[i] = row(event) end
  out(("YAPP events: %d\n\n"):format(#rows) .. text.table({ "time (UTC)", ">since start/s", ">frame", "bus", "ID",
    "source", "message", "event", "what" }, rows))
end

return M
