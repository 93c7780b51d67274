-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,faults: when each fault flag rose and fell, on which source, for how long.  Pure Lua, 5.2 and 5.4.

local band = require("yapp.base.bits").band
local json, text = require("yapp.stat.json"), require("yapp.stat.text")

local M = {}

local KEYS = { "time", "frame", "bus", "id", "source", "message", "field", "flag", "event", "active" }

-- Tracker: from the changes of messages to the faults' begins and ends -----------------------------------------------

local Tracker = {}
Tracker.__index = Tracker

--- What follows the alarms of all sources.
function M.tracker()
  return setmetatable({ sources = {}, list = {}, flags_of = {} }, Tracker)
end

local function bits_of(mask)
  local bits, bit = {}, 1
  while mask > 0 do
    if mask % 2 == 1 then bits[#bits + 1] = bit end
    mask, bit = (mask - mask % 2) / 2, bit * 2
  end
  return bits
end

local function any(value, bits)
  for i = 1, #bits do
    local bit = bits[i]
    if value % (2 * bit) >= bit then return true end
  end
  return false
end

-- The flags of a field, those that no table defines too: { name =, bits = } in the order of the catalogue.
function Tracker:flags(field)
  local flags = self.flags_of[field]
  if not flags then
    flags = {}
    for _, flag in ipairs(field.flags) do
      local alarms = band(flag.mask, field.alarm_bits)
      if alarms ~= 0 then flags[#flags + 1] = { name = flag.name, bits = bits_of(alarms) } end
    end
    for _, bit in ipairs(bits_of(band(field.undefined, field.alarm_bits))) do
      flags[#flags + 1] = { name = ("undefined_0x%x"):format(bit), bits = { bit } }
    end
    self.flags_of[field] = flags
  end
  return flags
end

local function entry(record, field, flag, event, active)
  return { kind = "fault", rel = record.rel, frame = record.frame, source = record.source, field = field.name,
    flag = flag, event = event, active = active }
end

-- The begins and ends in one field.  add is nil where the message does not count: then what has risen or is gone waits
-- for the next message that counts.
function Tracker:compare(source, record, change, add)
  local field, now = change.field, change.value
  local before = now - change.raised + change.cleared
  for _, flag in ipairs(self:flags(field)) do
    local was, is = any(before, flag.bits), any(now, flag.bits)
    local key = field.name .. "." .. flag.name
    if is and not was then
      source.raised = source.raised + 1
      local place = add and source.set or source.risen
      place[key] = { field = field, flag = flag.name, since = record.rel, order = source.raised }
      if add then add(entry(record, field, flag.name, "raised")) end
    elseif was and not is then
      local set = source.set[key]
      if add then
        source.set[key] = nil
        add(entry(record, field, flag.name, "cleared", set and record.rel - set.since))
      else
        source.risen[key], source.gone[key] = nil, set
      end
    end
  end
end

-- A message of a source that counts.
local function count(source, record)
  source.last = record
  for key in pairs(source.gone) do source.gone[key], source.set[key] = nil, nil end
  for key, set in pairs(source.risen) do source.risen[key], source.set[key] = nil, set end
end

--- Takes a good message; calls add(entry) for each flag of an alarm that rose or fell:
-- { kind = "fault", rel =, frame =, source =, field = name, flag = name, event = "raised", "cleared" or "active",
--   active = seconds since it was raised, nil where that was not seen }
-- add  nil for a message that does not count
function Tracker:message(record, add)
  local source = self.sources[record.source.key]
  if source and add then count(source, record) end
  for _, change in ipairs(record.change and record.change.flags or {}) do
    if change.field.alarm_bits ~= 0 then
      if not source then
        source = { set = {}, gone = {}, risen = {}, raised = 0, last = add and record, order = #self.list + 1 }
        self.sources[record.source.key], self.list[source.order] = source, source
      end
      self:compare(source, record, change, add)
    end
  end
end

--- At the end of the capture: add(entry) for each flag that is still set, at its source's last good message.
function Tracker:finish(add)
  local list = {}
  for _, source in ipairs(self.list) do
    if source.last then list[#list + 1] = source end
  end
  table.sort(list, function(a, b) return a.last.frame < b.last.frame or
    a.last.frame == b.last.frame and a.order < b.order end)
  for _, source in ipairs(list) do
    local sets = {}
    for _, set in pairs(source.set) do sets[#sets + 1] = set end
    table.sort(sets, function(a, b) return a.order < b.order end)
    for _, set in ipairs(sets) do
      add(entry(source.last, set.field, set.flag, "active", source.last.rel - set.since))
    end
  end
end

-- What is printed -----------------------------------------------------------------------------------------------

--- What a JSON line has of an entry; clock = that of the context.
function M.values(one, clock)
  local source = one.source
  return { kind = one.kind, time = json.time(clock(one.rel)), frame = one.frame, bus = source.bus, id = source.id,
    source = source.name, message = source.message and source.message.name, field = one.field, flag = one.flag,
    event = one.event, active = json.seconds(one.active) }
end

local Faults = {}
Faults.__index = Faults

--- options  { json = boolean }
-- context  { out = function(text), clock = function(rel) -> seconds since 1970, nanoseconds }
function M.new(options, context)
  local self = setmetatable({ options = options, out = context.out, clock = context.clock, tracker = M.tracker(),
    rows = {}, count = 0, sees_all = true, tells_changes = true }, Faults)
  function self.adder(one) self:add(one) end
  return self
end

function Faults:add(one)
  self.count = self.count + 1
  if self.options.json then return self.out(json.object(KEYS, M.values(one, self.clock)) .. "\n") end
  local source = one.source
  self.rows[self.count] = { text.date(self.clock(one.rel)), text.span(one.rel), one.frame, source.bus,
    text.id(source.id), source.name, source.message.title, one.flag, one.event, text.span(one.active) }
end

function Faults:message(record, counts)
  if record.good then self.tracker:message(record, counts and self.adder or nil) end
end

function Faults:finish()
  self.tracker:finish(self.adder)
  if self.options.json then return end
  if self.count == 0 then return self.out("YAPP faults: none\n") end
  self.out(("YAPP faults: %s\n\n"):format(text.count(self.count, "change")) .. text.table({ "time (UTC)",
    ">since start/s", ">frame", "bus", "ID", "source", "message", "flag", "event", ">active/s" }, self.rows))
end

return M
