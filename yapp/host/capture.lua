-- SPDX-License-Identifier: GPL-2.0-or-later
-- What a capture file says of its packets: on which bus each was captured, and whether YAPP may be
-- in it.  Pure Lua.
--
-- A dissector is not told on which interface a packet came, and the fields that say it need a tree.
--  The file says it: of a pcapng file and of pcap files of Linux cooked v2 and RTAC the headers of
--  blocks and records are read to the end.
--
-- A source is an interface, an index in it (Linux cooked v2), or a direction (RTAC); of a capture
-- with several that may carry YAPP each has a number, its bus: 1, 2, 3 in the order in which they
-- show.

local frame = require "yapp.wire.frame"
local utf8 = require "yapp.base.utf8"

local M = {}

local byte, floor, sub = string.byte, math.floor, string.sub

--- How many bytes of a pipe may be read: Wireshark 4.0 can rewind no more.
M.OF_A_PIPE = 65536
local CHUNK = 1048576

-- Link types: SocketCAN, exported PDUs, RTAC serial, DLT_USER 0 .. 15; and Linux cooked captures.
local SOCKETCAN, EXPORTED, RTAC, COOKED, COOKED_2 = 227, 252, 250, 113, 276
local OURS = { [SOCKETCAN] = true, [EXPORTED] = true, [RTAC] = true }
for linktype = 147, 162 do OURS[linktype] = true end

-- Of Linux cooked captures: where the protocol is in a packet; which are ours, CAN and CAN FD;
-- where the interface's index is in version 2.
local PROTOCOL_AT = { [COOKED] = 14, [COOKED_2] = 0 }
local PROTOCOLS = { ["\0\12"] = true, ["\0\13"] = true }
local INDEX_AT = 4

local EVENT_AT = 8 -- in a packet of RTAC
local SOCKETCAN_HEADER = 8 -- bytes in front of a CAN frame's data

--- The direction of an RTAC packet by its event: data sent, data received, and so on.
M.DIRECTION = { 0, 1, 0, 1 }

-- Blocks of pcapng, and options of an interface.
local SECTION, INTERFACE, ENHANCED, SIMPLE = 0x0A0D0D0A, 1, 6, 3
local IF_NAME, IF_TSRESOL = 2, 9

local STAMPS = 2 ^ 30 -- microseconds that are told apart, see Capture:bus

-- The bytes of a file, read as they are needed.
local Window = {}
Window.__index = Window

-- Whether so many bytes from an offset on are there.
function Window:has(at, count)
  while at + count > self.from + #self.text do
    local more = self.more(CHUNK)
    if not more or more == "" then return false end
    local used = math.min(math.max(at - self.from, 0), #self.text)
    self.text, self.from = sub(self.text, used + 1) .. more, self.from + used
  end
  return true
end

function Window:bytes(at, count)
  return sub(self.text, at - self.from + 1, at - self.from + count)
end

-- Numbers in the order of this place of the file.
local function uint32(window, at)
  local from = at - window.from
  local a, b, c, d = byte(window.text, from + 1, from + 4)
  if window.is_little then return a + b * 0x100 + c * 0x10000 + d * 0x1000000 end
  return a * 0x1000000 + b * 0x10000 + c * 0x100 + d
end

-- Three of them, one behind the other, with one call: most of the time goes into these.
local function three_uint32(window, at)
  local from = at - window.from
  local a, b, c, d, e, f, g, h, i, j, k, l = byte(window.text, from + 1, from + 12)
  if not window.is_little then
    a, b, c, d, e, f, g, h, i, j, k, l = d, c, b, a, h, g, f, e, l, k, j, i
  end
  return a + b * 0x100 + c * 0x10000 + d * 0x1000000,
    e + f * 0x100 + g * 0x10000 + h * 0x1000000,
    i + j * 0x100 + k * 0x10000 + l * 0x1000000
end

local function uint16(window, at)
  local a, b = byte(window:bytes(at, 2), 1, 2)
  if window.is_little then return a + b * 0x100 end
  return a * 0x100 + b
end

-- Sources -----------------------------------------------------------------------------------------

local Capture = {}
Capture.__index = Capture

--- The number of a source.
-- interface, index, direction  numbers, 0 where a packet has none
function Capture:source(interface, index, direction)
  local key = interface * 2 ^ 33 + index * 2 + direction
  local number = self.sources[key]
  if not number then
    number = self.source_count + 1
    self.sources[key], self.source_count = number, number
    self.names[number] = self.interface_names[interface]
  end
  return number
end

-- The source of a cooked packet; 0 for one that is not CAN.
local function cooked_source(self, window, interface, linktype, at)
  local protocol = window:bytes(at + PROTOCOL_AT[linktype], 2)
  if not PROTOCOLS[protocol] then return 0 end
  if linktype == COOKED then return self:source(interface, 0, 0) end
  local a, b, c, d = byte(window:bytes(at + INDEX_AT, 4), 1, 4)
  local index = a * 0x1000000 + b * 0x10000 + c * 0x100 + d
  return self:source(interface, index, 0)
end

-- The source of a packet whose data is at an offset; 0 for one that cannot be YAPP's.
local function source_of(self, window, interface, linktype, at, length)
  if PROTOCOL_AT[linktype] then
    if length < 16 or not window:has(at, 16) then return 0 end
    return cooked_source(self, window, interface, linktype, at)
  end
  if not OURS[linktype] then return 0 end
  local direction
  if linktype == RTAC and length > EVENT_AT and window:has(at, EVENT_AT + 1) then
    direction = M.DIRECTION[byte(window:bytes(at + EVENT_AT, 1))]
  end
  return self:source(interface, 0, direction or 0)
end

-- pcapng ------------------------------------------------------------------------------------------

-- The name and the time's unit from an interface's options.
local function read_options(window, at, stop)
  local name, per_second = nil, 1e6
  while at + 4 <= stop do
    local option, length = uint16(window, at), uint16(window, at + 2)
    if option == 0 or at + 4 + length > stop then break end
    local value = window:bytes(at + 4, length)
    if option == IF_NAME then
      name = value:match("^[^\0]*")
    elseif option == IF_TSRESOL and length > 0 then
      local exponent = byte(value)
      per_second = exponent < 128 and 10 ^ exponent or 2 ^ (exponent - 128)
    end
    at = at + 4 + length + -length % 4
  end
  return name, per_second
end

-- From here on it is read what each packet says: there may be several sources.
local function begin_details(self)
  if self.is_detailed then return end
  self.is_detailed = true
  self.early = self.count
  if self.early == 0 then return end
  for _, interface in ipairs(self.interfaces) do
    if not interface.source then self:source(interface.number, 0, 0) end
  end
end

local function read_interface(self, window, at, length)
  if length < 20 or not window:has(at, length) then return end
  local number, linktype = #self.interfaces, uint16(window, at + 8)
  local name, per_second = read_options(window, at + 16, at + length - 4)
  if name and name ~= "" and utf8.is_printable(name) then
    self.interface_names[number] = name
  end
  local is_cooked = PROTOCOL_AT[linktype] ~= nil
  local is_ours = OURS[linktype] or is_cooked
  local interface = {
    number = number,
    linktype = linktype,
    per_microsecond = per_second / 1e6,
    source = 0, -- of its packets; nil where each says it
  }
  self.interfaces[number + 1] = interface
  if not is_ours then return end
  if is_cooked or linktype == RTAC then
    interface.source = nil
  else
    interface.source = self:source(number, 0, 0)
  end
  local is_several = self.may_be_ours or linktype == RTAC or linktype == COOKED_2
  self.may_be_ours = true
  if is_several then begin_details(self) end
end

-- A packet of a file that may have several sources.
local function read_enhanced(self, window, at)
  if not window:has(at, 28) then return end
  local number, high, low = three_uint32(window, at + 8)
  local interface = self.interfaces[self.first + number + 1]
  if not interface then
    self.told[self.count] = 0
    return
  end
  local units = high * 2 ^ 32 + low
  local stamp = floor(units / interface.per_microsecond)
  local source = interface.source
  if not source then
    local length = uint32(window, at + 20)
    source = source_of(self, window, interface.number, interface.linktype, at + 28, length)
  end
  self.told[self.count] = source * STAMPS + stamp % STAMPS
end

-- Any other block; returns its length, which a section's byte order tells.
local function read_block(self, window, at, kind, length)
  if kind == SECTION then
    window.is_little = window:bytes(at + 8, 4) == "\77\60\43\26"
    self.first = #self.interfaces
    return uint32(window, at + 4)
  end
  if kind == INTERFACE then
    read_interface(self, window, at, length)
  elseif kind == SIMPLE then
    self.count = self.count + 1
    self.told[self.count] = 0
    self.has_packets = true
  end
  return length
end

-- Most blocks are packets: of each as little is read as goes.
local function read_pcapng(self, window)
  local at = 0
  while window.from + #window.text >= at + 12 or window:has(at, 12) do
    local kind, length = three_uint32(window, at)
    if kind == ENHANCED then
      self.count = self.count + 1
      self.has_packets = true
      if not self.may_be_ours then break end -- somebody else's file
      if self.is_detailed then read_enhanced(self, window, at) end
    else
      length = read_block(self, window, at, kind, length)
    end
    if length < 12 then break end
    at = at + length
  end
end

-- pcap --------------------------------------------------------------------------------------------

local function read_pcap(self, window, is_little, per_microsecond)
  window.is_little = is_little
  if not window:has(0, 24) then return end
  local linktype = uint32(window, 20) % 0x10000 -- above it, what is said of frame check sequences
  self.place = linktype == SOCKETCAN and SOCKETCAN_HEADER or nil
  self.has_packets = window:has(24, 16)
  if linktype ~= COOKED_2 and linktype ~= RTAC then return end
  local at = 24
  while window:has(at, 16) do
    local length = uint32(window, at + 8)
    local stamp = uint32(window, at) * 1e6 + uint32(window, at + 4) / per_microsecond
    local source = source_of(self, window, 0, linktype, at + 16, length)
    self.count = self.count + 1
    self.told[self.count] = source * STAMPS + floor(stamp) % STAMPS
    at = at + 16 + length
  end
end

local READERS = {
  ["\212\195\178\161"] = function(self, window) read_pcap(self, window, true, 1) end,
  ["\161\178\195\212"] = function(self, window) read_pcap(self, window, false, 1) end,
  ["\77\60\178\161"] = function(self, window) read_pcap(self, window, true, 1000) end,
  ["\161\178\60\77"] = function(self, window) read_pcap(self, window, false, 1000) end,
  ["\10\13\13\10"] = read_pcapng,
}

-- Whether bytes have what may be the header of a YAPP frame.
local function has_header(bytes)
  local at = frame.find(bytes, 1)
  while at do
    if frame.judge(bytes, at, function() return true end) then return true end
    at = frame.find(bytes, at + 1)
  end
  return false
end

-- The name of the only interface that may be ours; nil where there are several.
local function own_name(self)
  if self.source_count > 1 then return nil end
  if self.source_count == 1 then return self.names[1] end
  if self.is_detailed then return nil end
  for _, interface in ipairs(self.interfaces) do
    -- Cooked, so its packets, which were not read, would say it.
    if not interface.source then return self.interface_names[interface.number] end
  end
end

--- Reads a file.
-- head     its first bytes, up to M.OF_A_PIPE
-- more     function(count) -> the next bytes, at most so many; nil or "" at the end, or where a
--          pipe must be left alone
-- returns  a capture: {
--   has_several   whether the file tells several sources apart that may carry YAPP
--   begins        whether it is a pcapng file without a packet yet, as a live capture
--   is_told       whether the packets' buses are read here; of another format, and behind `count`,
--                 fields say them
--   count, told   how many packets it told of, and of each source * STAMPS + when it was captured
--   early         how many of them came before there was a second source: all that may be YAPP's
--                 among them are of the first
--   names         [number of a source] = the name of its interface, fit to be printed
--   only_name     of the only interface, own_name of the only one that may carry YAPP; nil where
--                 there are several
--   place         where in each packet a CAN frame's data begins, nil where that is not the same
--                 for all
--   may_have_frames  whether YAPP frames may be in TCP or UDP: not where it has packets and none of
--                    the first has one }
function M.read(head, more)
  local self = setmetatable({
    count = 0,
    early = 0,
    told = {},
    names = {},
    interface_names = {},
    interfaces = {},
    first = 0, -- interfaces in the sections before
    sources = {},
    source_count = 0,
    place = nil,
    has_packets = false,
    may_be_ours = false,
    is_detailed = false, -- whether the packets of a pcapng file are told of one by one
  }, Capture)
  local window = setmetatable({ text = head, from = 0, more = more, is_little = true }, Window)
  local reader = READERS[sub(head, 1, 4)]
  if reader then reader(self, window) end
  local has_interfaces = #self.interfaces > 0
  local may_come = self.may_be_ours or not has_interfaces
  self.has_several = self.source_count > 1
  self.is_told = reader ~= nil
  self.begins = reader == read_pcapng and not self.has_packets and may_come
  self.only_name = #self.interfaces == 1 and self.interface_names[0] or nil
  self.own_name = own_name(self)
  self.may_have_frames = not self.has_packets or has_header(head)
  if not self.has_several then self.told = {} end
  return self
end

--- The bus of a packet.
-- number    of the packet
-- captured  seconds since 1970 at which Wireshark says that it was captured, nil not to compare
-- returns   its bus; 0 for a packet that cannot carry YAPP; nil where the file's packet of this
--           number is another: a read filter has shifted the numbers
function Capture:bus(number, captured)
  local entry = self.told[number]
  if number <= self.early then return 1 end
  if not entry then return nil end
  local stamp = entry % STAMPS
  local difference = captured and (captured * 1e6 - stamp) % STAMPS or 0
  if difference > 2 and difference < STAMPS - 2 then return nil end
  return (entry - stamp) / STAMPS
end

return M
