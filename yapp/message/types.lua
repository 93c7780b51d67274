-- SPDX-License-Identifier: GPL-2.0-or-later
-- Finds the message type that an ID carries on a bus, and the name of its source, by the user's
-- preferences.  Pure Lua.

local binary = require "yapp.message.binary"
local source_names = require "yapp.message.sources"

local Types = {}
Types.__index = Types

local NONE = {}

--- Make the types of a catalogue, before preferences are known: file readers may ask then.
-- catalogue  compiled
function Types.new(catalogue)
  return setmetatable({
    messages = catalogue.messages, -- the message types
    -- See Types:use:
    by_id = catalogue.by_id,
    sources = source_names.parse("", catalogue),
    options = NONE,
  }, Types)
end

--- Use the user's choice of IDs and names.
-- by_id    { [id] = message type }
-- sources  a message.sources
-- options  { several_buses = true if the capture has: then the name of a source includes its bus;
--          hides_source, hides_values = true if columns show them instead of Info }
-- visit    function(id), called for each ID that carries a message type
function Types:use(by_id, sources, options, visit)
  self.by_id, self.sources, self.options = by_id, sources, options
  for _, row in ipairs(sources.rows) do
    if row.type then visit(row.id) end
  end
  for id in pairs(by_id) do visit(id) end
end

--- Return the message type that an ID carries on a bus, nil for none.
-- bus  name, nil where the capture has none
function Types:type_of(id, bus)
  return (self.sources:find(bus, id)) or self.by_id[id]
end

--- Return the payload size of that type and the smallest that it may have, nil for none.
function Types:size_of(id)
  local message_type = self:type_of(id) or NONE
  return message_type.size, message_type.min_size
end

--- Return the controller's own time of a message ("Nanoseconds since boot"), nil for none.
-- returns  seconds, nanoseconds
function Types:time_of(id, payload)
  local message_type = self:type_of(id)
  local raw = message_type and message_type.time and
    message_type.read(payload)[message_type.time.index]
  if not raw then return nil end
  local seconds, nanoseconds = binary.time(raw)
  if seconds >= 0 and nanoseconds >= 0 then return seconds, nanoseconds end
end

-- Return the label of a message: its title and the name of its source.  Without a name, the ID or
-- bus follows if it tells the source from others: "Motor Data left", "Motor Data 0x212 (can1)",
-- "Motor Data", "ID 0x123".
local function label_of(message_type, title, name, id, bus)
  if name then return title .. " " .. name end
  if message_type and (bus or id ~= message_type.id) then title = ("%s 0x%x"):format(title, id) end
  return bus and ("%s (%s)"):format(title, bus) or title
end

-- Return the name of a bus of several: also of one that shows when the capture is open.
local function bus_of_several(self, bus_key, bus, line)
  return (self.options.several_buses or not line and (bus_key or 1) > 1) and bus
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
--   text      for the column Source: the name, else bus and ID, where they differ from others':
--             "can1 0x210", "10.0.0.1:14550 0x210", "0x210" }
function Types:new_source(id, bus_key, bus, line)
  local options, message_type, name, row = self.options, self.sources:find(bus, id)
  message_type = message_type or self.by_id[id]
  local known, several_bus = message_type or NONE, bus_of_several(self, bus_key, bus, line)
  local title, before = known.title or ("ID 0x%x"):format(id), several_bus
  if line then before = line.label end
  local label = label_of(message_type, title, name, id, several_bus)
  return {
    id = id,
    bus = bus,
    bus_key = bus_key,
    line = line,
    name = name,
    row = row,
    type = message_type,
    size = known.size,
    min_size = known.min_size,
    label = label,
    short = options.hides_source and title or label,
    write = known[options.hides_values and "info_rest" or "info"],
    text = name or (before and before .. " " or "") .. ("0x%x"):format(id),
  }
end

return Types
