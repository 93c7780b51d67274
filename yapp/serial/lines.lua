-- SPDX-License-Identifier: GPL-2.0-or-later
-- The lines of a capture: a line is one direction of a conversation, of a UART or of a USB adapter.
-- And their sources: who receives a sender's messages does not matter.  Pure Lua.

local memo = require "yapp.base.memo"
local senders = require "yapp.serial.senders"

local M = {}

M.TCP, M.UDP = 2, 3 -- pinfo.port_type
local MAX_SILENCE = 3 -- seconds, of a connection that goes on
-- Addresses of packets without one: of a serial line, or of a raw dump, whose packets are like UDP.
local NO_ADDRESS = { [""] = true, NONE = true }

local Lines = {}
Lines.__index = Lines

--- Make the lines of a capture.
-- types  a message.types, buses = a capture.capture
function M.new(types, buses)
  return setmetatable({
    types = types,
    buses = buses,
    senders = senders.new(),
    by_address = memo(function() -- [from][to][tag, with the bus] = a line
      return memo(function() return {} end)
    end),
    by_key = {},
    clients = {}, -- [sender's address, receiver] = the latest line of TCP
    shared_ids = {}, -- [ID] = true: those that several senders in UDP or TCP have
    awaited = {}, -- by key of a line: the payload of the first frame that the file has of it
    has_serial = false, -- true if a line is neither of UDP or TCP nor of an adapter
    sources = memo(function() return {} end), -- [sender in UDP or TCP][ID]
  }, Lines)
end

--- Return whether packets of a kind (pinfo.port_type) from an address are of UDP or TCP.
function M.is_ip(kind, address)
  return (kind == M.UDP or kind == M.TCP) and not NO_ADDRESS[address]
end

-- Make a line: {
--   key          of its stream
--   opposite     key of the other direction
--   bus_key      of a Command and its answers: one key for both directions of a conversation or
--                adapter, one for all of a UART
--   trial_key    of what is found by content: a conversation, one direction of an adapter
--   tag          shared by few lines: the kind and ports of packets; the key of an adapter's
--   bus          name or nil
--   label        text that tells its sources apart, nil if nothing does
--   has_address  true if its packets have a sender
--   interface    of UDP or TCP: the name of its interface, or nil
--   is_ip        true if it is of UDP or TCP; is_tcp, is_datagram: of TCP, of UDP
--   is_complete  true if each of its packets is complete in itself: of a raw dump
--   latest       when its latest packet came, in seconds
--   is_over      true if a segment of it ends the connection
--   is_direct    true if TCP hands its bytes to YAPP; false where TLS does
--   awaited      the payload of the first frame that the file has of it; nil once it was read, or
--                if it is not known
--   sources      [ID] = a source, see Lines:source; all lines of a sender share them }
local function new_line(key, opposite, bus_key, bus)
  return {
    key = key,
    opposite = opposite,
    bus_key = bus_key,
    trial_key = key,
    tag = key,
    bus = bus,
    label = bus,
    has_address = false,
    interface = nil,
    is_ip = false,
    is_tcp = false,
    is_datagram = false,
    is_complete = false,
    latest = 0,
    is_over = false,
    is_direct = false,
    awaited = nil,
    sources = {},
  }
end

-- Return the sender's line to a receiver in the connection before, nil for none.  A client that
-- connects again has a new port, and is the same source.  But two connections may go on side by
-- side, of two clients behind one address.
-- time  seconds, when the new connection begins; nil if it is not known
local function find_line_before(self, address, to, time)
  local before = self.clients[address .. " " .. to]
  local is_over = before and (before.is_over or time and time - before.latest > MAX_SILENCE)
  return is_over and before or nil
end

-- Make a line of UDP or TCP.
local function new_ip_line(self, kind, key, address, port, to, time)
  local here = address .. ":" .. port
  local opposite = "|" .. kind .. "|" .. to .. "|" .. here
  local is_udp = kind == M.UDP
  local bus = is_udp and self.senders:name_of(address, port) or senders.name(address, port)
  local before = not is_udp and find_line_before(self, address, to, time)
  if before then bus = before.bus end
  local line = new_line(key, opposite, here < to and here .. to or to .. here, bus)
  line.trial_key = kind .. line.bus_key -- UDP and TCP may have the same ports
  line.has_address, line.is_ip = true, true
  line.is_tcp, line.is_datagram = not is_udp, is_udp
  line.interface = self.buses:name(nil, true)
  line.sources = self.sources[kind .. bus]
  if not is_udp then self.clients[address .. " " .. to] = line end
  return line
end

--- Return a number for each kind and each pair of ports.
-- kind  pinfo.port_type
function M.tag(kind, port, to_port)
  return (kind * 0x10000 + port) * 0x10000 + to_port
end

local function new_serial_line(self, bus, key, opposite, is_complete)
  local line = new_line(key, opposite, "serial", self.buses:name(bus, false))
  line.label, line.is_complete = bus and line.bus, is_complete
  self.has_serial = true
  return line
end

--- Return the line of a packet.
-- kind           pinfo.port_type
-- from, port     address and port of the sender
-- to, to_port    of the receiver
-- bus            number, nil for none
-- time           in seconds, of a packet of UDP or TCP that comes for the first time; or nil
function Lines:of(kind, from, port, to, to_port, bus, time)
  local lines, number = self.by_address[from][to], M.tag(kind, port, to_port)
  if bus then number = number + bus * 2 ^ 36 end
  local line = lines[number]
  if time and kind == M.UDP then self.senders:count_datagram(from, port, time) end
  if line then
    line.latest = time or line.latest
    return line
  end
  local here, there = from .. ":" .. port, to .. ":" .. to_port
  local key = (bus or "") .. "|" .. kind .. "|" .. here .. "|" .. there
  if M.is_ip(kind, from) then
    line = new_ip_line(self, kind, key, from, port, there, time)
    line.tag, line.latest, line.awaited = number, time or 0, self.awaited[key]
  else
    local opposite = (bus or "") .. "|" .. kind .. "|" .. there .. "|" .. here
    line = new_serial_line(self, bus, key, opposite, kind == M.UDP)
  end
  lines[number], self.by_key[key] = line, line
  return line
end

-- Return the key of the line of a conversation.
local function key_of(conversation)
  local kind = conversation.is_tcp and M.TCP or M.UDP
  return "|" .. kind .. "|" .. conversation.from .. "|" .. conversation.to
end

--- Await the first frames that the file has of conversations: another protocol may take them.
-- conversations  of serial.senders
function Lines:await(conversations)
  for _, one in ipairs(conversations) do
    local key = key_of(one)
    self.awaited[key] = self.awaited[key] or one.payload
  end
end

--- Mark that a frame of a line was read: the first one is awaited no more.
function M.mark_read(line, transfer)
  local is_first = transfer.payload == line.awaited or transfer.status == "truncated"
  if line.awaited and is_first then line.awaited = nil end
end

--- Return those of a list of conversations that no message was read of, or not the first one.
-- conversations  of serial.senders
function Lines:list_unread(conversations)
  local list = {}
  for _, one in ipairs(conversations) do
    local line = self.by_key[key_of(one)]
    local is_read = line and next(line.sources) and not line.awaited
    if not is_read then list[#list + 1] = one end
  end
  return list
end

--- Return the line of an endpoint of a USB adapter.
-- endpoint  the line of serial.usb
function Lines:of_adapter(endpoint)
  local line = self.by_key[endpoint.name]
  if not line then
    line = new_line(endpoint.name, endpoint.opposite, endpoint.device, endpoint.name)
    line.has_address = true
    self.by_key[endpoint.name] = line
  end
  return line
end

--- Search the first bytes of the file for conversations.
-- returns  the conversations in them, see serial.senders
function Lines:scan(head)
  local conversations = senders.conversations(head)
  self.senders:scan(head)
  self.shared_ids = self.senders:shared_ids(conversations)
  return conversations
end

--- Return the source of the messages of a line with an ID, see message.types.
function Lines:source(line, id)
  local source = line.sources[id]
  if not source then
    local is_shared = line.is_ip and self.shared_ids[id]
    if line.is_ip then line.label = self.senders:shorten(line.bus) end
    source = self.types:new_source(id, line.bus_key, line.bus, line, is_shared)
    line.sources[id] = source
  end
  return source
end

return M
