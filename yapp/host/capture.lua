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

local byte, sub, floor = string.byte, string.sub, math.floor

--- How many bytes of a pipe may be read: Wireshark 4.0 can rewind no more.
M.OF_A_PIPE = 65536
local CHUNK = 1048576

-- Link types: SocketCAN, exported PDUs, RTAC serial, DLT_USER 0 .. 15; and Linux cooked captures,
-- whose packets have the protocol at this offset: 0x000C for CAN, 0x000D for CAN FD.
local SOCKETCAN, EXPORTED, RTAC, COOKED, COOKED_2 = 227, 252, 250, 113, 276
local OURS = { [SOCKETCAN] = true, [EXPORTED] = true, [RTAC] = true }
for linktype = 147, 162 do OURS[linktype] = true end
local PROTOCOL_AT = { [COOKED] = 14, [COOKED_2] = 0 }
local INDEX_AT, EVENT_AT = 4, 8         -- of Linux cooked v2, of RTAC
local DIRECTION = { 0, 1, 0, 1 }        -- of RTAC's events: data sent, data received, ...
local SOCKETCAN_HEADER = 8              -- bytes in front of a CAN frame's data

-- Blocks of pcapng; those that are packets, or count as such, but for the first of which nothing is
-- said here.
local SECTION, INTERFACE, ENHANCED, SIMPLE, OLD = 0x0A0D0D0A, 1, 6, 3, 2
local JOURNAL, SYSDIG, SYSDIG_END = 9, 0x204, 0x221
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

-- Four bytes as a number, in the order of this place of the file.
function Window:uint32(at)
  local a, b, c, d = byte(self.text, at - self.from + 1, at - self.from + 4)
  if self.is_little then a, b, c, d = d, c, b, a end
  return ((a * 256 + b) * 256 + c) * 256 + d
end

function Window:uint16(at)
  local a, b = byte(self.text, at - self.from + 1, at - self.from + 2)
  return self.is_little and b * 256 + a or a * 256 + b
end

function Window:bytes(at, count)
  return sub(self.text, at - self.from + 1, at - self.from + count)
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

-- The source of a packet whose data is at an offset; 0 for one that cannot be YAPP's.
local function source_of(self, window, interface, linktype, at, length)
  local protocol_at = PROTOCOL_AT[linktype]
  if protocol_at then
    if length < 16 or not window:has(at, 16) then return 0 end
    local low = byte(window.text, at + protocol_at - window.from + 2)
    if byte(window.text, at + protocol_at - window.from + 1) ~= 0 or low ~= 0x0C and low ~= 0x0D then return 0 end
    if linktype == COOKED then return self:source(interface, 0, 0) end
    local a, b, c, d = byte(window.text, at + INDEX_AT - window.from + 1, at + INDEX_AT - window.from + 4)
    return self:source(interface, ((a * 256 + b) * 256 + c) * 256 + d, 0)
  end
  if not OURS[linktype] then return 0 end
  local direction = 0
  if linktype == RTAC and length > EVENT_AT and window:has(at, EVENT_AT + 1) then
    direction = DIRECTION[byte(window.text, at + EVENT_AT - window.from + 1)] or 0
  end
  return self:source(interface, 0, direction)
end

-- The next packet of the file; stamp: when it was captured, microseconds.
local function note_packet(self, source, stamp)
  self.count = self.count + 1
  self.told[self.count] = source * STAMPS + floor(stamp) % STAMPS
end

-- pcapng ------------------------------------------------------------------------------------------

-- The name and the time's unit from an interface's options.
local function read_options(window, at, stop)
  local name, per_second = nil, 1e6
  while at + 4 <= stop do
    local option, length = window:uint16(at), window:uint16(at + 2)
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

local function read_interface(self, window, at, length)
  if length < 20 or not window:has(at, length) then return end
  local number, linktype = #self.interfaces, window:uint16(at + 8)
  local name, per_second = read_options(window, at + 16, at + length - 4)
  if name and name ~= "" and utf8.is_printable(name) then self.interface_names[number] = name end
  local is_ours, is_cooked = OURS[linktype], PROTOCOL_AT[linktype] ~= nil
  local interface = {
    number = number,
    linktype = linktype,
    per_microsecond = per_second / 1e6,
    source = 0, -- of its packets; nil where each says it
  }
  self.interfaces[number + 1] = interface
  if linktype == RTAC or is_cooked then
    interface.source = nil
  elseif is_ours then
    interface.source = self:source(number, 0, 0)
  end
  if not is_ours and not is_cooked then return end
  -- What its packets say is read where there may be several sources.
  local is_several = self.may_be_ours or linktype == RTAC or linktype == COOKED_2
  self.may_be_ours = true
  if not is_several or self.is_detailed then return end
  self.is_detailed, self.early = true, self.count
  for _, other in ipairs(self.interfaces) do
    if self.early > 0 and not other.source then self:source(other.number, 0, 0) end
  end
end

-- A packet of a file that may have several sources.
local function read_enhanced(self, window, at, first)
  if not window:has(at, 28) then return end
  local from = at - window.from
  local a, b, c, d, e, f, g, h, i, j, k, l = byte(window.text, from + 9, from + 20)
  if not window.is_little then
    a, b, c, d, e, f, g, h, i, j, k, l = d, c, b, a, h, g, f, e, l, k, j, i
  end
  local interface = self.interfaces[first + a + b * 0x100 + c * 0x10000 + d * 0x1000000 + 1]
  local source, stamp = 0, 0
  if interface then
    local high = e + f * 0x100 + g * 0x10000 + h * 0x1000000
    local low = i + j * 0x100 + k * 0x10000 + l * 0x1000000
    stamp = floor((high * 2 ^ 32 + low) / interface.per_microsecond)
    source = interface.source
    if not source then
      local length = window:uint32(at + 20)
      source = source_of(self, window, interface.number, interface.linktype, at + 28, length)
    end
  end
  self.told[self.count] = source * STAMPS + stamp % STAMPS
end

local function counts_as_packet(kind)
  return kind == SIMPLE or kind == OLD or kind == JOURNAL or kind >= SYSDIG and kind <= SYSDIG_END
end

-- Any other block; returns its length, which a section's byte order tells.
local function read_block(self, window, at, length)
  local kind = window:uint32(at)
  if kind == SECTION then
    window.is_little = window:bytes(at + 8, 4) == "\77\60\43\26"
    self.first = #self.interfaces
    return window:uint32(at + 4)
  end
  if kind == INTERFACE then read_interface(self, window, at, length) end
  if counts_as_packet(kind) then
    self.count, self.has_packets = self.count + 1, true
    self.told[self.count] = 0
  end
  return length
end

-- Most blocks are packets: of each as little is read as goes.
local function read_pcapng(self, window)
  local at = 0
  while window.from + #window.text >= at + 12 or window:has(at, 12) do
    local from = at - window.from
    local a, b, c, d, e, f, g, h = byte(window.text, from + 1, from + 8)
    if not window.is_little then a, b, c, d, e, f, g, h = d, c, b, a, h, g, f, e end
    local length = e + f * 0x100 + g * 0x10000 + h * 0x1000000
    if a == ENHANCED and b + c + d == 0 then
      self.count, self.has_packets = self.count + 1, true
      if not self.may_be_ours then break end -- somebody else's file
      if self.is_detailed then read_enhanced(self, window, at, self.first) end
    else
      length = read_block(self, window, at, length)
    end
    if length < 12 then break end
    at = at + length
  end
end

-- pcap --------------------------------------------------------------------------------------------

local function read_pcap(self, window, is_little, per_microsecond)
  window.is_little = is_little
  if not window:has(0, 24) then return end
  local linktype = window:uint32(20) % 0x10000 -- above it, what is said of frame check sequences
  self.place = linktype == SOCKETCAN and SOCKETCAN_HEADER or nil
  self.has_packets = window:has(24, 16)
  if linktype ~= COOKED_2 and linktype ~= RTAC then return end
  local at = 24
  while window:has(at, 16) do
    local length = window:uint32(at + 8)
    local stamp = window:uint32(at) * 1e6 + window:uint32(at + 4) / per_microsecond
    note_packet(self, source_of(self, window, 0, linktype, at + 16, length), stamp)
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

-- The name of the only interface that may be ours, where its packets were not read: a cooked one.
local function cooked_name(self)
  for _, interface in ipairs(self.is_detailed and {} or self.interfaces) do
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
  local reader = READERS[sub(head, 1, 4)]
  if reader then reader(self, setmetatable({ text = head, from = 0, more = more, is_little = true }, Window)) end
  self.has_several = self.source_count > 1
  self.is_told = reader ~= nil
  self.begins = reader == read_pcapng and not self.has_packets and (self.may_be_ours or #self.interfaces == 0)
  self.only_name = #self.interfaces == 1 and self.interface_names[0] or nil
  self.own_name = self.source_count == 1 and self.names[1] or nil
  if self.source_count == 0 and reader == read_pcapng then self.own_name = cooked_name(self) end
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
  local difference = captured and (floor(captured * 1e6 + 0.5) - stamp) % STAMPS or 0
  if difference > 2 and difference < STAMPS - 2 then return nil end
  return (entry - stamp) / STAMPS
end

return M
