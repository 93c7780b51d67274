-- SPDX-License-Identifier: GPL-2.0-or-later
-- What a finished message means: which message of the catalogue it is, its values, its source and what changed there.
-- Pure Lua, 5.2 and 5.4.  Carriers bring messages; the tree and the observers get them from here.

local M = {}

local band = require("yapp.base.bits").band

local Reader = {}
Reader.__index = Reader

--- decode    the module message.decode
-- catalogue  compiled
-- stat      { wanted = whether anyone wants to be told of messages }
function M.new(decode, catalogue, stat)
  return setmetatable({ decode = decode, messages = catalogue.messages, stat = stat, is_by_id = true,
    by_id = catalogue.by_id, -- until init: readers of files are asked before
    hinted = {} }, Reader)
end

--- Tells someone of what is read, of what is lost, and of parts, while stat wants it.
-- tell  a stat.tell
function Reader:tell_to(tell)
  self.tell = tell
end

--- Forgets the capture file.
function Reader:reset()
  self.hinted = {} -- [id of an unknown message]: frame where it was said what it may be
end

--- Takes the user's choice of IDs and names; nothing is known before that.
-- by_id    { [id] = compiled message }
-- sources  a message.sources
function Reader:use(by_id, sources)
  self.by_id, self.sources, self.is_by_id, self.source_texts = {}, sources, true, {}
  for id, message in pairs(by_id) do self.by_id[id] = message end
  for _, row in ipairs(sources:list()) do
    if row.message and row.bus then self.is_by_id = false end
    if row.message and not row.bus then self.by_id[row.id] = row.message end
  end
  sources:use_ids(self.by_id)
end

--- The message of the catalogue that an ID carries on a bus, nil for none.
-- bus  name, nil where the capture has none
function Reader:message_of(id, bus)
  if self.is_by_id then return self.by_id[id] end
  return self.sources:message(bus, id) or self.by_id[id]
end

--- The payload size of that message, nil for none.
function Reader:size_of(id, bus)
  local message = self:message_of(id, bus)
  return message and message.size
end

--- The name that the user gave to a source, nil where there is none.
function Reader:name_of(id, bus)
  return self.sources:name(bus, id)
end

--- What a message is called, and where that does not tell, its source (see Sources:label).
function Reader:label(id, bus)
  return self.sources:label(bus, id, self:message_of(id, bus))
end

--- What the column Source has: the name that the user gave, or the ID.
function Reader:source_text(id, bus)
  local of_bus = self.source_texts[bus or false]
  if not of_bus then
    of_bus = {}
    self.source_texts[bus or false] = of_bus
  end
  local text = of_bus[id]
  if not text then
    text = self.sources:name(bus, id) or ("0x%x"):format(id)
    of_bus[id] = text
  end
  return text
end

-- What there is to say of a message that is not in the catalogue: its size may be that of one that is.
-- returns  a text for the packet, and what the Info column adds or nil
function Reader:hint(m)
  local same
  for _, message in ipairs(m.status == "good" and self.messages or {}) do
    if message.size == m.size then same = same or message end
  end
  local text = ("Message ID 0x%x is not in the catalogue"):format(m.id)
  if not same then return text end
  local size = ("the size of %s"):format(same.title)
  text = ('%s; %d bytes, %s: see the preference "%s message IDs"'):format(text, m.size, size, same.title)
  if self.hinted[m.id] and self.hinted[m.id] ~= m.frame then return text, ", " .. size end
  self.hinted[m.id] = m.frame
  return text, (', %s: see the preference "%s message IDs"'):format(size, same.title)
end

-- Whether a flag is set that makes an alarm.
local function has_alarm(message, raws)
  for _, field in ipairs(message.alarms) do
    local raw = raws[message.index[field]]
    if raw and raw ~= 0 and band(raw, field.watched) ~= 0 then return true end
  end
  return false
end

--- Reads a finished message.  The record is what message.history, show.tree and stat.tell take it as.
-- m        { id, seq, ctl, size, payload, status, good = whether it is proved whole, is_whole = whether the payload has
--          all its bytes; source = key of bus or stream and ID, bus = key of the bus or stream, or nil, bus_name = or
--          nil, frame = number, time = seconds since the first packet, ... }: gets
--          message = of the catalogue, where the ID is known; raws and look = from decode.read, where the size fits
--          too; has_fault = whether a fault flag is set; change = what is new since the source's previous one
-- memory   whose change(memory, m, ...) tells that (can.memory, serial.memory); ...: what it takes besides
function Reader:read(m, memory, ...)
  local message, raws, look = self:message_of(m.id, m.bus_name), nil, nil
  if message and m.size == message.size and m.is_whole then raws, look = self.decode.read(message, m.payload) end
  m.message, m.raws, m.look, m.has_fault = message, raws, look, look and has_alarm(message, raws)
  m.change = memory:change(m, ...)
  if self.stat.wanted then self.tell:message(m) end
end

return M
