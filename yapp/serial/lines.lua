-- SPDX-License-Identifier: GPL-2.0-or-later
-- The lines of a capture: a line is one direction of a conversation, of a UART or of a USB adapter.
-- And their sources: who receives a sender's messages does not matter.  Pure Lua.

local memo = require "yapp.base.memo"
local senders = require "yapp.serial.senders"

local M = {}

M.TCP, M.UDP = 2, 3 -- pinfo.port_type
-- Addresses of packets without one: of a serial line, or of a raw dump, whose packets are like UDP.
local NO_ADDRESS = { [""] = true, NONE = true }

local Lines = {}
Lines.__index = Lines

--- Make the lines of a capture.
-- types  a message.types, buses = a host.buses
function M.new(types, buses)
  return setmetatable({
    types = types,
    buses = buses,
    senders = senders.new(),
    by_key = {},
    has_serial = false, -- whether a line is neither of UDP or TCP nor of an adapter
    sources = memo(function() return {} end), -- [sender in UDP or TCP][ID]
  }, Lines)
end

--- Whether packets of a kind (pinfo.port_type) from an address are of UDP or TCP.
function M.is_ip(kind, address)
  return (kind == M.UDP or kind == M.TCP) and not NO_ADDRESS[address]
end

-- Make a line: {
--   key          of its stream
--   opposite     key of the other direction
--   bus_key      what a Command and its answers have in common: one key for both directions of a
--                conversation or adapter, one for all of a UART
--   trial_key    what is found by content: a conversation, one direction of an adapter
--   bus          name or nil
--   label        text that tells its sources apart, nil if nothing does
--   has_address  whether its packets have a sender
--   interface    of UDP or TCP: the name of its interface, or nil
--   is_tcp, is_datagram  whether it is of TCP, of UDP
--   is_complete  whether each of its packets is complete in itself: of a raw dump
--   is_direct    whether TCP hands its bytes to YAPP; false where TLS does
--   sources      [ID] = a source, see Lines:source; all lines of a sender share them }
local function new_line(key, opposite, bus_key, bus)
  return {
    key = key,
    opposite = opposite,
    bus_key = bus_key,
    trial_key = key,
    bus = bus,
    label = bus,
    has_address = false,
    interface = nil,
    is_ip = false,
    is_tcp = false,
    is_datagram = false,
    is_complete = false,
    is_direct = false,
    sources = {},
  }
end

-- Make a line of UDP or TCP.
local function new_ip_line(self, kind, key, address, port, to)
  local here = address .. ":" .. port
  local opposite = "|" .. kind .. "|" .. to .. "|" .. here
  local is_udp = kind == M.UDP
  local bus = is_udp and self.senders:name_of(address, port) or senders.name(address, port)
  local line = new_line(key, opposite, here < to and here .. to or to .. here, bus)
  line.trial_key = kind .. line.bus_key -- UDP and TCP may have the same ports
  line.has_address, line.is_ip = true, true
  line.is_tcp, line.is_datagram = not is_udp, is_udp
  line.interface = self.buses:name(nil, true)
  line.sources = self.sources[kind .. bus]
  return line
end

--- Return the line of a packet.
-- kind           pinfo.port_type
-- bus            number, nil for none
-- address, port  of the sender
-- to             "address:port" of the receiver
-- is_new         whether the packet comes for the first time
function Lines:of(kind, bus, address, port, to, is_new)
  local is_ip, here = M.is_ip(kind, address), address .. ":" .. port
  if is_new and is_ip and kind == M.UDP then self.senders:note(address, port) end
  local key = (bus or "") .. "|" .. kind .. "|" .. here .. "|" .. to
  local line = self.by_key[key]
  if line then return line end
  if is_ip then
    line = new_ip_line(self, kind, key, address, port, to)
  else
    local opposite = (bus or "") .. "|" .. kind .. "|" .. to .. "|" .. here
    line = new_line(key, opposite, "serial", self.buses:name(bus, false))
    line.label = bus and line.bus
    self.has_serial = true
    line.is_complete = kind == M.UDP
  end
  self.by_key[key] = line
  return line
end

--- Return those of a list of conversations that no message was read of.
-- conversations  of serial.senders
function Lines:unread(conversations)
  local list = {}
  for _, one in ipairs(conversations) do
    local kind = one.is_tcp and M.TCP or M.UDP
    local line = self.by_key["|" .. kind .. "|" .. one.from .. "|" .. one.to]
    if not (line and next(line.sources)) then list[#list + 1] = one end
  end
  return list
end

--- Return the line of a USB adapter.
-- part  of serial.usb
function Lines:of_adapter(part)
  local line = self.by_key[part.name]
  if not line then
    line = new_line(part.name, part.opposite, part.device, part.name)
    line.has_address = true
    self.by_key[part.name] = line
  end
  return line
end

--- Return the source of the messages of a line with an ID, see message.types.
function Lines:source(line, id)
  local source = line.sources[id]
  if not source then
    if line.is_ip then line.label = self.senders:short(line.bus) end
    source = self.types:new_source(id, line.bus_key, line.bus, line)
    line.sources[id] = source
  end
  return source
end

return M
