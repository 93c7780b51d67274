-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,events: what happened, in the order of time: faults, reboots, clocks that stand still, silences, bad CRCs,
-- messages that are not whole.  Pure Lua, 5.2 and 5.4.

local json, text = require("yapp.stat.json"), require("yapp.stat.text")
local faults, groups = require("yapp.stat.faults"), require("yapp.stat.groups")

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
-- context  { out = function(text), clock = function(rel) -> seconds since 1970, nanoseconds,
--          late = function() -> how many periods of a message make a silence }
function M.new(options, context)
  local self = setmetatable({ options = options, context = context, tracker = faults.tracker(), list = {},
    before = {}, sees_all = true, tells_changes = true }, Events)
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
    event.rel, event.frame, event.source, event.record = record.rel, record.frame, record.source, nil
  end
  event.order = #self.list + 1
  self.list[event.order] = event
end

-- A good message.
function Events:good(record, counts)
  local change, before = record.change, self.before[record.source.key]
  if change and change.late and before and before.counts then
    self:add("silence", before.record, { length = change.late })
  end
  if not before then
    before = {}
    self.before[record.source.key] = before
  end
  before.record, before.counts = record, counts
  if counts and change and change.reboot then self:add("reboot", record) end
  if counts and change and change.stale then self:add("stale", record) end
  self.tracker:message(record, counts and self.keeper or nil)
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
    local every = record.source.message and record.source.message.every
    local length = every and last and groups.span(record.rel, last.rel)
    if length and before.counts and length > self.context.late() * every then
      self:add("silence", record, { length = length, is_last = true })
    end
  end
end

local function earlier(a, b)
  if a.rel ~= b.rel then return a.rel < b.rel end
  if a.frame ~= b.frame then return a.frame < b.frame end
  if a.source.id ~= b.source.id then return a.source.id < b.source.id end
  return a.order < b.order
end

local function line(event, clock)
  local values = faults.values(event, clock)
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
    return ("nothing for %.6f s%s"):format(event.length, event.is_last and ", to the end" or "")
  end,
  crc = function() return "bad CRC" end,
  incomplete = function(event)
    return event.what == "orphan" and "the Start is missing" or
      event.what == "overrun" and "more bytes than its size" or "bytes are missing"
  end,
  unfinished = function() return "the capture ends before it" end,
}

local function row(event, clock)
  local source = event.source
  return { text.date(clock(event.rel)), text.span(event.rel), event.frame, source.bus, text.id(source.id),
    source.name, source.message and source.message.title or "unknown", event.kind, DETAILS[event.kind](event) }
end

--- last  { rel = } of the last packet of any kind; nil where there was none
function Events:finish(last)
  self:silent(last)
  self.tracker:finish(self.keeper)
  table.sort(self.list, earlier)
  local out, clock = self.context.out, self.context.clock
  if self.options.json then
    for _, event in ipairs(self.list) do out(line(event, clock)) end
    return
  end
  if #self.list == 0 then return out("YAPP events: none\n") end
  local rows = {}
  for i, event in ipairs(self.list) do rows[i] = row(event, clock) end
  out(("YAPP events: %d\n\n"):format(#rows) .. text.table({ "time (UTC)", ">since start/s", ">frame", "bus", "ID",
    "source", "message", "event", "what" }, rows))
end

return M
