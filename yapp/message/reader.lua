-- SPDX-License-Identifier: GPL-2.0-or-later
-- What a finished message means: which message of the catalogue it is, its values, its source and
-- what changed there. Pure Lua.  Carriers bring messages; the tree and the statistics get them from
-- here.

local decode = require("yapp.message.decode")
local frame_key = require("yapp.base.frame_key")

local M = {}

local FRAMES = { "command_in", "previous_change", "next_change" } -- of how things stand

local Reader = {}
Reader.__index = Reader

--- catalogue  compiled
-- stat         { wanted = whether anyone wants to be told of messages }
function M.new(catalogue, stat)
  return setmetatable({
    messages = catalogue.messages,
    stat = stat,
    by_id = catalogue.by_id, -- the user's choice, see Reader:use; before, readers of files ask
    is_by_id = true, -- whether no bus has messages of its own
    has_several = false, -- whether the capture has several buses
    hinted = {}, -- [id of an unknown message]: frame where it was said what it may be
  }, Reader)
end

--- Tells someone of what is read, of what is lost, and of parts, while stat wants it.
-- tell  a stat.tell
function Reader:tell_to(tell)
  self.tell = tell
end

--- Forgets the capture file.
function Reader:reset()
  self.hinted = {}
end

--- Whether the capture has several buses: then the bus belongs to what a source is called.
function Reader:use_buses(has_several)
  self.has_several = has_several
end

--- Takes the user's choice of IDs and names; nothing is known before that.
-- by_id    { [id] = compiled message }; several_ids says which more than one ID carries
-- sources  a message.sources
function Reader:use(by_id, sources)
  self.by_id, self.sources, self.is_by_id, self.several_ids = {}, sources, true, {}
  for id, message in pairs(by_id) do self.by_id[id] = message end
  for _, row in ipairs(sources:list()) do
    if row.message and row.bus then
      self.is_by_id = false
    elseif row.message then
      self.by_id[row.id] = row.message
    end
  end
  local first = {}
  local function count(message, id)
    first[message] = first[message] or id
    self.several_ids[message] = self.several_ids[message] or first[message] ~= id
  end
  for id, message in pairs(self.by_id) do count(message, id) end
  for _, row in ipairs(sources:list()) do
    if row.message then count(row.message, row.id) end
  end
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

--- Whether a payload of so many bytes is the message that an ID carries; nil for an unknown ID.
function Reader:fits(id, size, bus)
  local known = self:size_of(id, bus)
  return known and known == size
end

--- The name that the user gave to a source, nil where there is none.
function Reader:name_of(id, bus)
  return self.sources:name(bus, id)
end

--- What a message is called where rows stand for themselves: its title; and where that does not
-- tell its source, the source's name, or ID and bus: "Motor Data left", "Motor Data 0x212 (can1)",
-- "Motor Data", "ID 0x123".
function Reader:label(id, bus)
  local message, name = self:message_of(id, bus), self:name_of(id, bus)
  local number, is_told_bus = ("0x%x"):format(id), self.has_several and bus
  if not message then
    local label = "ID " .. number
    if name then return label .. " " .. name end
    return is_told_bus and ("%s (%s)"):format(label, bus) or label
  end
  if name then return message.title .. " " .. name end
  local is_usual = id == message.id and not self.several_ids[message]
  if is_usual and not is_told_bus then return message.title end
  local label = message.title .. " " .. number
  return bus and ("%s (%s)"):format(label, bus) or label
end

--- A source, a bus or a stream and an ID, and what is worked out of it once.
-- key       of the source; id: message ID; bus: key of the bus or stream, or false
-- bus_name  or nil where the capture names none
-- line      what tells the source apart besides its ID, where nothing else does; nil for the bus
--           in a capture of several
-- returns   { key, bus, bus_name, size = of its messages or nil, name = of them in the Info column
--           (see Reader:label), text = what the source is called, the column Source: the name that
--           the user gave, or line and ID; texts = of the parts of its messages, of can.carrier;
--           message = a record for Reader:read: nobody keeps one, so the next one is told in the
--           same table, as a new one took a tenth of a packet list }
function Reader:new_source(key, id, bus, bus_name, line)
  local name, text = self:label(id, bus_name), self:name_of(id, bus_name)
  line = line or self.has_several and bus_name
  text = text or (line and line .. " " or "") .. ("0x%x"):format(id)
  return {
    key = key,
    bus = bus,
    bus_name = bus_name,
    size = self:size_of(id, bus_name),
    name = name,
    text = text,
    texts = {},
    message = { id = id, name = name, source = key, bus = bus, bus_name = bus_name, at = 0 },
  }
end

--- What there is to say of a message that is not in the catalogue: its size may be that of one that
-- is.
-- m        a message, as for Reader:read
-- returns  a text for the packet, and what the Info column adds or nil
function Reader:hint(m)
  local text, same = ("Message ID 0x%x is not in the catalogue"):format(m.id), nil
  for _, message in ipairs(m.status == "good" and self.messages or {}) do
    if message.size == m.size then same = same or message.title end
  end
  if not same then return text end
  local size = ("the size of %s"):format(same)
  local advice = (': see the preference "%s message IDs"'):format(same)
  text = ("%s; %d bytes, %s%s"):format(text, m.size, size, advice)
  if self.hinted[m.id] and self.hinted[m.id] ~= m.frame then return text, ", " .. size end
  self.hinted[m.id] = m.frame
  return text, ", " .. size .. advice
end

-- Asks the history what is new in a message, and how things stand there.
local function ask(m, history)
  m.change, m.standing = false, false
  if m.is_unsure then return end
  if m.visited then
    m.change = history:change(m) or false
  else
    local change, delta = history:note(m)
    m.change, m.delta = change or false, delta or false
  end
  local standing = m.wants.standing and history:standing(m)
  if not standing then return end
  for _, name in ipairs(FRAMES) do
    standing[name] = standing[name] and frame_key.number(standing[name])
  end
  m.standing = standing
end

--- Reads a finished message.  The record is what message.history, show.tree and stat.tell take it
-- as.
-- m        { id, seq, ctl, size, payload, status, good = whether it is proved whole, is_whole =
--          whether the payload has all its bytes; source = key of bus or stream and ID, bus = key
--          of the bus or stream, or nil, bus_name = or nil, frame = number, time = seconds since
--          the first packet, ... }: gets
--          message = of the catalogue, where the ID is known
--          raws and look = from decode.read, where the size fits too
--          has_fault = whether a fault flag is set
--          change = what is new in it, or false; delta = seconds since the source's previous good
--          one; standing = how things stand, where wants.standing (see message.history)
-- history  a message.history, which is asked by m.number, the frame key.  It is asked for nothing
--          where m.is_unsure; of a visited message (m.visited) m.delta is known already.
--          Or, of streams, what has change(m, ...) and standing(m, ...), with what they take besides
function Reader:read(m, history, ...)
  local message, raws, look = self:message_of(m.id, m.bus_name), nil, nil
  if message and m.size == message.size and m.is_whole then
    raws, look = decode.read(message, m.payload)
  end
  m.message, m.raws, m.look = message, raws, look
  m.has_fault = look and decode.has_alarm(message, raws)
  if history.note then
    ask(m, history)
  else
    m.change = history:change(m, ...) or false
    m.standing = m.wants.standing and history:standing(m, ...) or false
  end
  if self.stat.wanted then self.tell:message(m) end
end

return M
