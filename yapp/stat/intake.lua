-- SPDX-License-Identifier: GPL-2.0-or-later
-- What dissectors report to the statistics, made into events.  Pure Lua, 5.2 to 5.5.
--
-- The values of a message's event are nil for most messages, else {
--   change         of message.history, or nil
--   invalid        list of values of `invalid` events, or nil
--   undecoded      number of bytes behind those that the catalogue has, or nil
--   is_unreliable  whether what came before the message is not known }
-- The values of a loss are {
--   what  "incomplete", "orphan" or "overrun"
--   lost  what all losses of the message have in common, or nil
--   loss  { is_withdrawn = whether nothing is lost after all }, or nil where that is sure }

local decode = require("yapp.message.decode")
local kinds = require("yapp.stat.kinds")

local M = {}

local new_event, NOTHING = kinds.event, kinds.NOTHING

local LOSSES = {
  ["fragment.incomplete"] = "incomplete",
  ["fragment.orphan"] = "orphan",
  ["fragment.overrun"] = "overrun",
  truncated = "incomplete", -- by the capture: what was not decoded was not checked
}
-- The kind of a message without a good CRC, by its status; the others are no events.
local KIND_OF = { bad = "crc", unverified = "incomplete", single = "incomplete" }
local INCOMPLETE = { what = "incomplete" }
local DEFINED = { ["value.special"] = true, ["fault.active"] = true } -- remarks on defined values
local EFFECTS = { ["command.key.invalid"] = " (the controller ignores this command)" }

local Intake = {}
Intake.__index = Intake

--- Make an intake, which is closed.  `wanted` says whether anyone wants events: ask it before
-- reporting.  `wants_parts` is the same for parts of messages.
function M.new()
  return setmetatable({
    wanted = false,
    wants_parts = false,
    queue = nil, -- a stat.queue, while it is open
    reader = nil, -- a message.reader, while it is open
    leaving = {}, -- taps, see Intake:remove_later
    sources = {}, -- by key
    stretches = {}, -- by stream: skipped bytes, while nothing else comes
  }, Intake)
end

--- Begin to take reports.
function Intake:open(queue, reader)
  self.queue, self.reader, self.wanted = queue, reader, true
end

--- Take no more reports.
function Intake:close()
  self.queue, self.reader, self.wanted, self.wants_parts = nil, nil, false, false
end

--- Forget the capture file.
function Intake:reset()
  self.sources, self.stretches = {}, {}
end

--- Remove a tap when the next event of a message comes: a tap cannot go while it is called.
function Intake:remove_later(tap)
  table.insert(self.leaving, tap)
end

local function source_of(self, m)
  local source = self.sources[m.source]
  if not source then
    local id, bus = m.id, m.bus_name
    source = {
      key = m.source,
      bus_key = m.bus,
      bus = bus,
      id = id,
      name = id and self.reader:name_of(id, bus),
      message = id and self.reader:message_of(id, bus),
      parts = {}, -- by Seq: see Intake:part
      orphan = false, -- or { seq }: the message that lost its Start, while its frames come
      start_seq = nil, -- see Intake:start
    }
    self.sources[m.source] = source
  end
  return source
end

local function offer(self, event, m)
  local stream, leaving = m.stream or false, self.leaving
  if self.stretches[stream] then self.stretches[stream] = nil end -- in Lua 5.2 costly if it is nil
  if leaving[1] then
    self.leaving = {}
    for _, tap in ipairs(leaving) do tap:remove() end
  end
  self.queue:offer(event, m.visited)
end

-- Messages ----------------------------------------------------------------------------------------

-- A value as the document writes a code.
local function code_of(raw)
  return type(raw) == "number" and ("0x%02x"):format(raw) or raw
end

-- The values of a message that the catalogue does not define; nil for none.
local function invalid_of(m)
  local list
  for _, remark in ipairs(decode.remarks(m.message, m.raws) or NOTHING) do
    local index, expert = remark[1], remark[2]
    if not DEFINED[expert] then
      local raw = m.raws[index]
      list = list or {}
      list[#list + 1] = {
        field = m.message.fields[index].name,
        value = raw,
        code = code_of(raw),
        effect = EFFECTS[expert],
      }
    end
  end
  return list
end

local function values_of(m)
  local invalid = m.is_remarkable and invalid_of(m)
  if not (m.change or invalid or m.undecoded or m.is_unreliable) then return NOTHING end
  return {
    change = m.change or nil,
    invalid = invalid or nil,
    undecoded = m.undecoded,
    is_unreliable = m.is_unreliable,
  }
end

--- Report a message that has ended.
-- m  of message.reader, as read; stream = key of its stream, nil on CAN
function Intake:message(m)
  local kind = m.good and "message" or KIND_OF[m.status]
  if not kind then return end
  local source, values = source_of(self, m), nil
  source.orphan = false
  if kind == "message" then
    values = values_of(m)
  elseif kind == "incomplete" then
    values = INCOMPLETE
  end
  offer(self, new_event(kind, m, source, values), m)
end

-- Losses ------------------------------------------------------------------------------------------

-- What the orphaned frames of one message have in common: those in a row of one Seq, to its End.
local function orphaned(source, m)
  local orphan = source.orphan
  if not orphan or orphan.seq ~= m.seq then
    orphan = { seq = m.seq }
  end
  source.orphan = not m.is_end and orphan
  return orphan
end

--- Report the anomalies of a frame.  Those that lose a message, or a part of one, are events.
-- m          { id, seq, source, bus, bus_name, stream, frame, time, visited, is_end = whether it is
--            an End }
-- anomalies  list of { expert, lost = frame key of the Start of the message that is lost or nil,
--            is_withdrawn = whether nothing is wrong after all }
function Intake:faults(m, anomalies)
  for _, anomaly in ipairs(anomalies) do
    local what = LOSSES[anomaly.expert]
    if what then
      local source, lost = source_of(self, m), anomaly.lost
      if what == "orphan" then
        lost = orphaned(source, m)
      else
        source.orphan = false
      end
      local values = { what = what, lost = lost, loss = anomaly }
      offer(self, new_event("incomplete", m, source, values), m)
    end
  end
end

--- Report bytes of a stream that belong to no frame.  Over several packets in a row they are one
-- stretch, and one event, whose length grows.
-- m  { id = nil, frame, time, visited, bus, bus_name, source = key of the stream, length = bytes }
function Intake:skipped(m)
  local stretch = self.stretches[m.source]
  if stretch and m.frame > stretch.last_frame then -- else the capture is read anew
    stretch.last_frame = m.frame
    stretch.values.length = stretch.values.length + m.length
    return
  end
  local values = { length = m.length }
  self.stretches[m.source] = { last_frame = m.frame, values = values }
  self.queue:offer(new_event("skipped", m, source_of(self, m), values), m.visited)
end

--- Report a frame of a message that has not ended, in case the capture ends before the message.
-- m  as for Intake:faults; its frame, time and visited may change later: those of the latest count
function Intake:part(m)
  source_of(self, m).parts[m.seq] = m
end

--- Report what may be the Start of a message that is not dissected: its ID is unknown, and it has a
-- Seq No.  It is one if a message of the catalogue has its size, or if its Seq No is the next one.
-- m  { id, seq, size, source, bus, bus_name, frame, time, visited }
function Intake:start(m)
  local source = source_of(self, m)
  local is_message = source.start_seq and (source.start_seq + 1) % 256 == m.seq
  for _, message in ipairs(self.reader.messages) do
    is_message = is_message or m.size == message.size
  end
  source.start_seq = m.seq
  if is_message then
    self.queue:offer(new_event("start", m, source, { size = m.size }), m.visited)
  end
end

--- Return the events of the messages that the capture ends before, in the order of their frames.
-- messages  list of { source = key, seq, frame = number of their last frame }
function Intake:unfinished(messages)
  local events = {}
  for _, message in ipairs(messages) do
    local source = self.sources[message.source]
    local part = source and source.parts[message.seq]
    if part and part.frame == message.frame then
      events[#events + 1] = new_event("unfinished", part, source)
    end
  end
  table.sort(events, function(a, b) return a.frame < b.frame end)
  return events
end

return M
