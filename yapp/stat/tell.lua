-- SPDX-License-Identifier: GPL-2.0-or-later
-- What carriers tell the statistics: finished messages, and parts of messages that are lost, as records (see
-- stat.groups).  Pure Lua, 5.2 and 5.4.

local M = {}

local LOST = {
  ["fragment.incomplete"] = "incomplete", ["fragment.orphan"] = "orphan", ["fragment.overrun"] = "overrun",
  truncated = "incomplete", -- by the capture: what was not decoded was not checked
}

local Tell = {}
Tell.__index = Tell

--- stat    a stat.taps
-- reader  a message.reader
function M.new(stat, reader)
  local self = setmetatable({ stat = stat, reader = reader }, Tell)
  self:reset()
  return self
end

--- Forgets the capture file.
function Tell:reset()
  self.sources = {}
end

-- The source of a message: one table for all its records.
local function source_of(self, m)
  local source = self.sources[m.source]
  if not source then
    source = { key = m.source, bus_key = m.bus, bus = m.bus_name, name = self.reader:name_of(m.id, m.bus_name),
      id = m.id, message = self.reader:message_of(m.id, m.bus_name) }
    self.sources[m.source] = source
  end
  return source
end

local function record_of(source, m)
  return { frame = m.frame, rel = m.time, source = source, seq = m.seq, payload = m.payload or "", good = false,
    fits = false, change = false }
end

--- A finished message, read.
-- m  of message.reader, as read
function Tell:message(m)
  local is_truncated = m.status == "unverified" or m.status == "single" and not m.good
  if not (m.good or is_truncated or m.status == "bad") then return end
  -- All eight names at once: Lua's table of eight is half of one that grows to nine.
  local record = { frame = m.frame, rel = m.time, source = source_of(self, m), seq = m.seq, payload = m.payload,
    good = m.good, fits = m.raws ~= nil, change = m.change }
  if is_truncated then record.lost = LOST.truncated end
  if m.status == "bad" then record.is_bad = true end
  if m.is_unsure then record.is_unsure = true end
  self.stat:offer(record, m.visited)
end

--- Faults of a frame: those that say that a message, or a part of one, is lost.
-- m       { id, seq, source, bus, bus_name, frame, time, visited, is_end = whether the frame is an End }
-- faults  list of { expert, void = whether it has been taken back since }
function Tell:faults(m, faults)
  for _, fault in ipairs(faults) do
    if LOST[fault.expert] then
      local record = record_of(source_of(self, m), m)
      record.lost, record.is_end, record.fault = LOST[fault.expert], m.is_end, fault
      self.stat:offer(record, m.visited)
    end
  end
end

--- A frame of a message that has not ended: when it came, should the capture end before the message does.  Its frame,
-- time and visited may change later: they are those of the latest.
function Tell:part(m)
  local source = source_of(self, m)
  source.last = source.last or {}
  source.last[m.seq] = m
end

--- The messages that the capture ends before.
-- messages  list of { source, seq, frame = number of their last frame }
-- returns   records, in the order of their frames
function Tell:unfinished(messages)
  local records = {}
  for _, message in ipairs(messages) do
    local source = self.sources[message.source]
    local part = source and source.last and source.last[message.seq]
    if part and part.frame == message.frame then
      local record = record_of(source, part)
      record.lost, records[#records + 1] = "unfinished", record
    end
  end
  table.sort(records, function(a, b) return a.frame < b.frame end)
  return records
end

return M
