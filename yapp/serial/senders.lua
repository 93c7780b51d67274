-- SPDX-License-Identifier: GPL-2.0-or-later
-- Who sends in UDP and TCP: names of senders, and which of them take a new port for each datagram.
-- Pure Lua.
--
--   192.168.1.12:40000   [fe80::1]:14550   192.168.1.10, with a new port for each datagram

local frame = require "yapp.wire.frame"
local memo = require "yapp.base.memo"

local M = {}

local byte, sub = string.byte, string.sub

local UDP, UDP_HEADER, TCP = 17, 8, 6
local TO_ID = 8 -- bytes of a header, up to its ID
local MAX_LENGTH = 0x2400 -- of an IPv6 payload: 9,216 bytes
-- A sender changes its port if it has so many ports, each with few datagrams in a row, and hardly
-- one comes back.  While a capture goes on, more of them are needed, and more time: several
-- controllers behind one address may send for the first time, and all do so again within a second.
-- A port that is picked by chance comes back now and then: of 23, one in 1 % of captures.
local MIN_PORTS, MIN_PORTS_LIVE, MAX_RUN, MAX_BACK = 4, 16, 4, 1 / 16
local MIN_TIME = 1 -- seconds from its first port to one that is new

local Senders = {}
Senders.__index = Senders

local function new_sender()
  return {
    begin = nil,  -- when its first datagram came
    latest = nil, -- its latest port
    run = 0,      -- how many datagrams came from that in a row
    ports = {},   -- [port] = true
    count = 0,    -- how many ports
    back = 0,     -- how often a port came back, or had sent many datagrams
  }
end

-- Return whether a sender takes new ports.
local function takes_new_ports(sender, count)
  return sender.count >= count and sender.back <= sender.count * MAX_BACK
end

--- Make the list of a capture's senders.
function M.new()
  return setmetatable({
    by_address = memo(new_sender),
    is_changing = {}, -- [address] = true: those that are known to do so
    short_names = {}, -- by name
    is_taken = {},    -- by short name
  }, Senders)
end

--- Return the name of a sender.
-- port  nil for any
function M.name(address, port)
  if not port then return address end
  local shape = address:find(":", 1, true) and "[%s]:%d" or "%s:%d"
  return shape:format(address, port)
end

--- Return a name that begins with the part that differs from others: "…12:40000".
-- name  of M.name
function Senders:shorten(name)
  local short = self.short_names[name]
  if short then return short end
  short = name
  local address = name:match("^%[.*%]") or name:match("^[^:]*") -- the port stays
  for at = #address - 1, 2, -1 do
    local shorter = "…" .. sub(name, at + 1)
    local is_border = sub(name, at, at):find("[.:]")
    if is_border and not self.is_taken[shorter] then
      short = shorter
      break
    end
  end
  self.short_names[name], self.is_taken[short] = short, true
  return short
end

--- Count a datagram of YAPP.
-- address, port  of its sender
-- time           in seconds; 0 if it is not known
function Senders:count_datagram(address, port, time)
  local sender = self.by_address[address]
  if sender.latest == port then
    sender.run = sender.run + 1
    return
  end
  sender.begin = sender.begin or time
  if sender.ports[port] or sender.run > MAX_RUN then
    sender.back = sender.back + 1
  else
    sender.ports[port], sender.count = true, sender.count + 1
    local is_late = time - sender.begin >= MIN_TIME
    if is_late and takes_new_ports(sender, MIN_PORTS_LIVE) then self.is_changing[address] = true end
  end
  sender.latest, sender.run = port, 1
end

--- Return the name of the sender of a datagram: its address alone if it takes new ports.
function Senders:name_of(address, port)
  return M.name(address, not self.is_changing[address] and port)
end

-- Datagrams in the bytes of a file ----------------------------------------------------------------

local function ipv4_text(bytes)
  return ("%d.%d.%d.%d"):format(byte(bytes, 1, 4))
end

-- Return an IPv6 address as Wireshark writes it.
local function ipv6_text(bytes)
  local groups, best, length = {}, nil, 1
  for i = 1, 8 do groups[i] = ("%x"):format(byte(bytes, 2 * i - 1) * 256 + byte(bytes, 2 * i)) end
  for i = 1, 8 do
    local stop = i
    while groups[stop] == "0" do stop = stop + 1 end
    if stop - i > length then best, length = i, stop - i end
  end
  if not best then return table.concat(groups, ":") end
  return table.concat(groups, ":", 1, best - 1) .. "::" ..
    table.concat(groups, ":", best + length)
end

local function u16(bytes, index)
  local a, b = byte(bytes, index, index + 1)
  return a * 256 + b
end

-- Return the addresses of the IP header in front of an UDP or TCP header: the bytes of the sender's
-- and of the receiver's; and the index behind the packet.  Return nil if there is none.
-- index  of the UDP or TCP header
local function addresses_before(bytes, index, protocol)
  local v4, v6 = index - 20, index - 40
  if v4 > 0 and byte(bytes, v4) == 0x45 and byte(bytes, v4 + 9) == protocol then
    return sub(bytes, v4 + 12, v4 + 19), v4 + u16(bytes, v4 + 2)
  end
  local version = v6 > 0 and byte(bytes, v6) or 0
  local is_v6 = version - version % 16 == 0x60 and byte(bytes, v6 + 6) == protocol
  -- Bytes of another packet may look like that: of 4,000 packets one does.
  local length = is_v6 and u16(bytes, v6 + 4) or 0
  local is_equal = protocol ~= UDP or u16(bytes, index + 4) == length -- as UDP says
  if is_v6 and length <= MAX_LENGTH and is_equal then
    return sub(bytes, v6 + 8, v6 + 39), index + length
  end
end

-- Return the addresses of the sender and of the receiver as Wireshark writes them.
-- addresses  of addresses_before
local function texts_of(addresses)
  local half = #addresses / 2
  local text = half == 4 and ipv4_text or ipv6_text
  return text(sub(addresses, 1, half)), text(sub(addresses, half + 1))
end

-- Return an iterator over the starts of possible frames.
-- is_header  function(bytes, start)
-- count      how many at most, nil for all
local function frames_in(bytes, is_header, count)
  local start, rest = 0, count or #bytes
  return function()
    rest = rest - 1
    if rest < 0 then return nil end
    repeat
      start = frame.find(bytes, start + 1)
    until not start or is_header(bytes, start)
    return start
  end
end

--- Count the datagrams in the first bytes of a file that begin with a frame, whatever carries them.
-- So a sender has its name from its first message on.
function Senders:scan(bytes)
  local senders = memo(texts_of) -- [addresses] = that of the sender
  for start in frames_in(bytes, frame.is_plausible) do
    local index = start - UDP_HEADER
    local addresses = addresses_before(bytes, index, UDP)
    if addresses then self:count_datagram(senders[addresses], u16(bytes, index), 0) end
  end
  for address, sender in pairs(self.by_address) do
    self.is_changing[address] = takes_new_ports(sender, MIN_PORTS) or nil
    self.by_address[address] = nil
  end
end

-- Headers in front of a frame: without and with TCP's usual option.
local BEFORE = { { UDP, UDP_HEADER }, { TCP, 20 }, { TCP, 32 } }

-- Return whether a header of TCP is as in front of data: its size in words of four bytes, and of
-- its flags ACK is set, SYN and RST are not.
local function is_before_data(bytes, index, row)
  if row[1] ~= TCP then return true end
  local size, flags = byte(bytes, index + 12, index + 13)
  return size * 4 / 16 == row[2] and flags % 32 >= 16 and flags % 8 < 2
end

-- Return whether a packet begins with a header, or with one up to its ID and ends before the header
-- does.
-- stop  index behind the packet
local function is_header_of(bytes, start, stop)
  local length = stop - start
  return frame.is_plausible(bytes, start) or length >= TO_ID and length < frame.HEADER
end

-- Return the payload of the frame that a datagram begins with, nil if the frame ends in another.
local function first_payload(bytes, start)
  local _, size = frame.parse(bytes, start)
  local length = u16(bytes, start - 4)
  local from, to = start + frame.HEADER, start + frame.HEADER + size - 1
  local is_inside = UDP_HEADER + frame.HEADER + size + frame.CRC_SIZE <= length
  return is_inside and to <= #bytes and sub(bytes, from, to) or nil
end

-- Return the bytes that all packets of one direction of a conversation have in front of a frame,
-- and the addresses in them; nil if no packet begins with the frame.
-- row  of BEFORE: which header the frame may have in front of it
local function key_before(bytes, start, row)
  local index = start - row[2]
  if index < 1 or not is_before_data(bytes, index, row) then return nil end
  local addresses, stop = addresses_before(bytes, index, row[1])
  if not addresses or not is_header_of(bytes, start, stop) then return nil end
  return row[1] .. addresses .. sub(bytes, index, index + 3), addresses
end

-- Make a conversation, see M.conversations, from the packet that begins with its first frame.
local function new_conversation(bytes, start, row, addresses)
  local is_tcp, index = row[1] == TCP, start - row[2]
  local address, to = texts_of(addresses)
  local port, to_port = u16(bytes, index), u16(bytes, index + 2)
  return {
    is_tcp = is_tcp,
    address = address,
    from = address .. ":" .. port,
    to = to .. ":" .. to_port,
    from_port = port,
    payload = not is_tcp and first_payload(bytes, start) or nil,
    port = math.min(port, to_port),
    client_port = math.max(port, to_port),
    ids = {},
  }
end

--- Return the conversations that have frames in bytes of a file.
-- count    how many frames are looked at, nil for all
-- returns  list of {
--   is_tcp
--   from, to  the sender and the receiver of the first frame, "address:port" each
--   address, from_port  of the sender
--   payload   of this frame, nil if it is not known
--   port      the lower one, which is usually the server's; client_port = the other one
--   ids       [ID] = true: of its frames }
function M.conversations(bytes, count)
  local list, by_key = {}, {}
  for start in frames_in(bytes, frame.has_id, count) do
    local id = frame.parse(bytes, start)
    for _, row in ipairs(BEFORE) do
      local key, addresses = key_before(bytes, start, row)
      if key and id then
        local one = by_key[key]
        if not one then
          one = new_conversation(bytes, start, row, addresses)
          list[#list + 1], by_key[key] = one, one
        end
        one.ids[id] = true
      end
    end
  end
  return list
end

--- Return the IDs that several senders have: [ID] = true.
-- conversations  of M.conversations
function Senders:shared_ids(conversations)
  local shared, name_by_id = {}, {}
  for _, one in ipairs(conversations) do
    local name = one.is_tcp and one.from or self:name_of(one.address, one.from_port)
    for id in pairs(one.ids) do
      name_by_id[id] = name_by_id[id] or name
      if name_by_id[id] ~= name then shared[id] = true end
    end
  end
  return shared
end

-- Count how many conversations have each port: [port] = number, for TCP and for UDP.
local function count_ports(conversations)
  local counts = { [true] = {}, [false] = {} }
  for _, one in ipairs(conversations) do
    local of_kind = counts[one.is_tcp]
    for _, port in ipairs { one.port, one.client_port } do
      of_kind[port] = (of_kind[port] or 0) + 1
    end
  end
  return counts
end

--- Return the options of tshark that decode conversations: a list of
-- "-d tcp.port==4001,yapp_serial".  A higher port that many conversations have is one option for
-- all, as of three controllers that send to one receiver.
-- conversations  list of { is_tcp, port = the lower one, client_port = the other one }
function M.options(conversations)
  local list, is_there, counts = {}, {}, count_ports(conversations)
  for _, one in ipairs(conversations) do
    local of_kind = counts[one.is_tcp]
    local has_many = of_kind[one.client_port] > of_kind[one.port] + 1
    local port = has_many and one.client_port or one.port
    local option = ("-d %s.port==%d,yapp_serial"):format(one.is_tcp and "tcp" or "udp", port)
    if not is_there[option] then list[#list + 1] = option end
    is_there[option] = true
  end
  return list
end

return M
