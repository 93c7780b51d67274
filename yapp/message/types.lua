-- SPDX-License-Identifier: GPL-2.0-or-later
-- Which message type an ID carries on a bus, and what its source is called, as the user's
-- preferences have it.  Pure Lua.

local M = {}

local Types = {}
Types.__index = Types

--- Make the types of a catalogue, before preferences are known.
-- catalogue  compiled
function M.new(catalogue)
  return setmetatable({
    messages = catalogue.messages, -- the message types
    by_id = catalogue.by_id, -- [id] = message type, see Types:use; file readers may ask before
    sources = nil, -- the names that the user gave, see Types:use
    several_ids = nil, -- [message type] = whether more than one ID carries it
    hides_source = nil, -- see Types:use
    has_several = false, -- see Types:reset
  }, Types)
end

--- Forget the capture file.
-- has_several  whether the next one has several buses: then the name of a source includes its bus
function Types:reset(has_several)
  self.has_several = has_several
end

--- Use the user's choice of IDs and names.
-- by_id         { [id] = message type }
-- sources       a message.sources
-- hides_source  whether a label leaves out the source
-- visit         function(id), called for each ID that carries a message type
function Types:use(by_id, sources, hides_source, visit)
  self.by_id, self.sources, self.hides_source = by_id, sources, hides_source
  local first, several = {}, {}
  local function count(message, id)
    visit(id)
    first[message] = first[message] or id
    if first[message] ~= id then several[message] = true end
  end
  for _, row in ipairs(sources:list()) do
    if row.message then count(row.message, row.id) end
  end
  for id in pairs(by_id) do count(self:message_of(id), id) end
  self.several_ids = several
end

--- Return the message type that an ID carries on a bus, nil for none.
-- bus        name, nil where the capture has none
-- interface  of a sender in UDP or TCP, or nil
function Types:message_of(id, bus, interface)
  return self.sources and self.sources:message(bus, id, interface) or self.by_id[id]
end

--- Return the payload size of that type and the smallest that it may have, nil for none.
function Types:size_of(id)
  local message = self:message_of(id)
  if message then return message.size, message.min_size end
end

-- Return what a message is called: its title and the name of its source.  Without a name, the ID or
-- bus follows if it tells the source from others: "Motor Data left", "Motor Data 0x212 (can1)",
-- "Motor Data", "ID 0x123".  With hides_source it is the title.
local function label_of(self, message, name, id, bus)
  local number, needs_bus = ("0x%x"):format(id), self.has_several and bus
  local title, suffix = "ID " .. number, ""
  if message then title, suffix = message.title, " " .. number end
  local is_usual = not message or id == message.id and not self.several_ids[message]
  if self.hides_source or is_usual and not (name or needs_bus) then return title end
  if name then return title .. " " .. name end
  return title .. suffix .. (bus and (" (%s)"):format(bus) or "")
end

--- Make a source, which is a bus or stream, and an ID.
-- bus_key  of the bus or stream, or false
-- bus      its name, nil if the capture names none
-- line     of a stream, see serial.lines; nil on CAN
-- returns  {
--   id, bus, bus_key, line
--   name      that the user gave it, or nil
--   message   the message type that it carries, or nil; size, min_size = of its payload, or nil
--   label     what its messages are called in Info
--   text      for the column Source: the name, else what tells the source from others, and the ID
--   texts     of the fragments of its messages, see show.frame }
function Types:new_source(id, bus_key, bus, line)
  local interface = line and line.interface or nil
  local message = self:message_of(id, bus, interface)
  local name = self.sources:name(bus, id, interface)
  local before = line and line.label or not line and self.has_several and bus
  return {
    id = id,
    bus = bus,
    bus_key = bus_key,
    line = line,
    name = name,
    message = message,
    size = message and message.size,
    min_size = message and message.min_size,
    label = label_of(self, message, name, id, bus),
    text = name or (before and before .. " " or "") .. ("0x%x"):format(id),
    texts = {},
  }
end

return M
