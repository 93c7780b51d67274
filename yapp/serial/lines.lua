-- SPDX-License-Identifier: GPL-2.0-or-later
-- The lines of a capture: a line is one direction of a conversation, of a UART or of a USB adapter.
-- And their sources: a controller in UDP or TCP is its address, with any partner.  Pure Lua.

local memo = require "yapp.base.memo"

local Lines = {}
Lines.__index = Lines

-- pinfo.port_type; in a raw dump UDP and, for bytes of no frame, IPX, which carries no YAPP.
Lines.TCP, Lines.UDP, Lines.SKIPPED = 2, 3, 5
-- Addresses of packets without one: of a serial line, or of a raw dump, whose packets are like UDP.
local NO_ADDRESS = { [""] = true, NONE = true }

--- Make the lines of a capture.
-- types  a message.types, capture = a capture.capture
function Lines.new(types, capture)
  local commands = {}
  for _, message_type in ipairs(types.messages) do commands[message_type.answers or 0] = true end
  return setmetatable({
    types = types,
    capture = capture,
    by_key = {}, -- the lines, by key_of; of USB by name
    by_bus = memo(), -- [bus of UDP and TCP][ID] = a source
    commands = commands, -- [name of a message type] = true if controllers receive it
    has_serial = false, -- true if a line is neither of UDP or TCP nor of an adapter
  }, Lines)
end

--- Return whether packets of a kind (pinfo.port_type) from an address are of UDP or TCP.
function Lines.is_ip(kind, address)
  return (kind == Lines.UDP or kind == Lines.TCP) and not NO_ADDRESS[address]
end

-- Make a line.
-- bus  its name or nil
local function new_line(bus)
  return {
    bus = bus,
    bus_key = "serial", -- of a Command and its answers
    label = bus, -- text that tells its sources apart, nil if nothing does
    receiver = nil, -- of UDP and TCP: the bus of the Commands
    has_address = false, -- true if its packets have a sender
    is_tcp = false,
    is_datagram = false, -- of UDP
    is_complete = false, -- true if each packet is complete in itself: of a raw dump
    conversation = {}, -- one table for both directions
    sources = {}, -- [ID] = a source; [false] = that of bytes of no frame
  }
end

-- Return the bus of an address in UDP or TCP: with its port if the user names that.
local function bus_of(self, address, port)
  local shape = address:find(":", 1, true) and "[%s]:%d" or "%s:%d"
  local with_port = shape:format(address, port)
  return self.types.sources:names_bus(with_port) and with_port or address
end

-- Return a text for one direction of a conversation on a bus.
local function key_of(kind, from, port, to, to_port, bus)
  return ("%d %s %d %s %d %s"):format(kind, from, port, to, to_port, bus)
end

--- Return the line of a packet.
-- kind           pinfo.port_type
-- from, port     address and port of the sender
-- to, to_port    of the receiver
-- bus            number, nil for none
function Lines:of(kind, from, port, to, to_port, bus)
  local key = key_of(kind, from, port, to, to_port, bus)
  local line = self.by_key[key]
  if line then return line end
  local is_ip = Lines.is_ip(kind, from)
  line = new_line(is_ip and bus_of(self, from, port) or self.capture:name(bus))
  self.by_key[key] = line
  if is_ip then
    line.receiver, line.has_address = bus_of(self, to, to_port), true
    line.is_tcp, line.is_datagram = kind == Lines.TCP, kind == Lines.UDP
    local opposite = self.by_key[key_of(kind, to, to_port, from, port, bus)]
    if opposite then line.conversation = opposite.conversation end
  else
    line.label = bus and line.bus
    line.is_complete, self.has_serial = kind == Lines.UDP, true
  end
  return line
end

--- Return the line of an endpoint of a USB adapter.
-- name, device  of serial.usb
function Lines:of_adapter(name, device)
  local line = self.by_key[name]
  if not line then
    line = new_line(name)
    line.bus_key, line.has_address = device, true
    self.by_key[name] = line
  end
  return line
end

--- Return the source of the messages of a line with an ID, see message.types.  In UDP and TCP all
-- lines of a controller share it: a controller receives the Commands, and sends all else.
-- id  nil for the source of bytes of no frame: { bus, bus_key }, which the others have as `skipped`
function Lines:source(line, id)
  local key = id or false
  local source = line.sources[key]
  if source then return source end
  local bus, bus_key, sources = line.bus, line.bus_key, line.sources
  if line.receiver then
    local of_type = id and self.types:type_of(id, line.receiver)
    if of_type and self.commands[of_type.name] then bus = line.receiver end
    bus_key, sources = bus, self.by_bus[bus]
  end
  source = sources[key]
  if not source and id then
    source = self.types:new_source(id, bus_key, bus, line)
    source.skipped = self:source(line)
  end
  source = source or { bus = bus, bus_key = bus_key }
  sources[key], line.sources[key] = source, source
  return source
end

return Lines
