-- SPDX-License-Identifier: GPL-2.0-or-later
-- Finds the message type that an ID carries on a bus, and the name of its source, by the user's
-- preferences.  Pure Lua.

local M = {}

local NONE = {}

local Types = {}
Types.__index = Types

--- Make the types of a catalogue, before preferences are known.
-- catalogue  compiled
function M.new(catalogue)
  return setmetatable({
    messages = catalogue.messages, -- the message types
    by_id = catalogue.by_id, -- [id] = message type, see Types:use; file readers may ask before
    sources = nil, -- the names that the user gave, see Types:use
    several_ids = nil, -- [message type] = true if more than one ID carries it
    hidden = {}, -- see Types:use
    has_several = false, -- see Types:reset
  }, Types)
end

--- Forget the capture file.
-- has_several  true if the next one has several buses: then the name of a source includes its bus
function Types:reset(has_several)
  self.has_several = has_several
end

--- Use the user's choice of IDs and names.
-- by_id         { [id] = message type }
-- sources       a message.sources
-- hidden        parts that columns show instead of Info: { source, values = booleans }
-- visit         function(id), called for each ID that carries a message type
function Types:use(by_id, sources, hidden, visit)
  self.by_id, self.sources, self.hidden = by_id, sources, hidden
  local first, several = {}, {}
  local function count(message_type, id)
    visit(id)
    first[message_type] = first[message_type] or id
    if first[message_type] ~= id then several[message_type] = true end
  end
  for _, row in ipairs(sources:list()) do
    if row.type then count(row.type, row.id) end
  end
  for id in pairs(by_id) do count(self:type_of(id), id) end
  self.several_ids = several
end

--- Return the message type that an ID carries on a bus, nil for none.
-- bus        name, nil where the capture has none
-- interface  of a sender in UDP or TCP, or nil
function Types:type_of(id, bus, interface)
  return self.sources and (self.sources:find(bus, id, interface)) or self.by_id[id]
end

--- Return whether the user names a source of a bus.
-- bus  name, of UDP or TCP with the port
function Types:names_bus(bus)
  return self.sources ~= nil and self.sources:names_bus(bus)
end

--- Return the payload size of that type and the smallest that it may have, nil for none.
function Types:size_of(id)
  local message_type = self:type_of(id)
  if message_type then return message_type.size, message_type.min_size end
end

-- Return the title of an ID's message type: "Motor Data", or "ID 0x123".
local function title_of(message_type, id)
  return message_type and message_type.title or ("ID 0x%x"):format(id)
end

-- Return the label of a message: its title and the name of its source.  Without a name, the ID or
-- bus follows if it tells the source from others: "Motor Data left", "Motor Data 0x212 (can1)",
-- "Motor Data", "ID 0x123".
local function label_of(self, message_type, name, id, bus)
  local title = title_of(message_type, id)
  local is_usual = not message_type or id == message_type.id and not self.several_ids[message_type]
  if name then return title .. " " .. name end
  local needs_bus = bus and self.has_several
  if is_usual and not needs_bus then return title end
  if message_type then title = ("%s 0x%x"):format(title, id) end
  return bus and ("%s (%s)"):format(title, bus) or title
end

-- Return the text of the column Source without a name: "can1 0x210", "10.0.0.1:14550 0x210",
-- "0x210".
local function column_text(self, id, bus, line)
  local before = line and line.label or not line and self.has_several and bus
  return (before and before .. " " or "") .. ("0x%x"):format(id)
end

--- Make a source, which is a bus or stream, and an ID.
-- bus_key  of the bus or stream, or false
-- bus      its name, nil if the capture names none
-- line     of a stream, see serial.lines; nil on CAN
-- returns  {
--   id, bus, bus_key, line
--   name      that the user gave it, or nil; row = of message.sources, which is about it, or nil
--   type      the message type that it carries, or nil; size, min_size = of its payload, or nil
--   label     the name of its messages
--   short     the same without the source, if a column shows that
--   write     function(raws) -> the values in Info, nil without a message type
--   text      for the column Source: the name, else bus and ID, where they differ from others' }
function Types:new_source(id, bus_key, bus, line)
  local interface = line and line.interface or nil
  local message_type, name, row = self.sources:find(bus, id, interface)
  message_type = message_type or self.by_id[id]
  local label = label_of(self, message_type, name, id, bus)
  return {
    id = id,
    bus = bus,
    bus_key = bus_key,
    line = line,
    name = name,
    row = row,
    type = message_type,
    size = (message_type or NONE).size,
    min_size = (message_type or NONE).min_size,
    label = label,
    short = self.hidden.source and title_of(message_type, id) or label,
    write = (message_type or NONE)[self.hidden.values and "info_rest" or "info"],
    text = name or column_text(self, id, bus, line),
  }
end

return M
