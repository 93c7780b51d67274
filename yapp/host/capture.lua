-- SPDX-License-Identifier: GPL-2.0-or-later
-- Reads a capture file for the bus of each packet, the names of buses, the number of packets that
-- were dropped while capturing, and bytes that may be YAPP.  Pure Lua.
--
-- Wireshark does not tell a dissector the interface of a packet.  The file does: this module reads
-- the headers of the blocks of pcapng and of the records of pcap.
--
-- A bus is an interface, an index in it (Linux cooked v2), or a direction in it (RTAC; packet flags
-- of serial lines).  An interface whose packets may have CAN frames inside (Ethernet, PPI) is a bus
-- once one of them has.  An interface of another section with the same name and link type is the
-- same.  Buses that may carry YAPP are numbered from 1 in the order in which they show.

local frame = require "yapp.wire.frame"
local utf8 = require "yapp.base.utf8"

local M = {}

local byte, find, floor, max, min, sub =
  string.byte, string.find, math.floor, math.max, math.min, string.sub

--- How many bytes of a pipe may be read: Wireshark can rewind so many.
M.HEAD = 65536
local CHUNK = 1048576 -- bytes that are read at once, and the most that are held of a block
local MAX_BLOCK = 2 ^ 28 -- bytes; Wireshark refuses longer ones
local MAX_OPTIONS = 64 -- of a block

-- Link types whose packets may carry YAPP: SocketCAN; of serial lines exported PDUs and DLT_USER
-- 0 .. 15, whose packets may have a direction.
local SOCKETCAN = 227
local IS_SERIAL = { [252] = true }
for linktype = 147, 162 do IS_SERIAL[linktype] = true end
local FLAG_DIRECTIONS = { [0] = 0, "rx", "tx" } -- by the lowest two bits of a packet's flags

-- Link types whose packets each tell their bus: RTAC serial, Linux cooked captures.
local RTAC, COOKED, COOKED_2 = 250, 113, 276
local IS_CAN = { ["\0\12"] = true, ["\0\13"] = true } -- protocols: CAN and CAN FD
local DIRECTIONS = { "tx", "rx", "tx", "rx" } -- of an RTAC packet by its event

-- Link types whose packets may have a CAN frame inside: Ethernet (IEEE 1722) and PPI.
local ETHERNET, PPI = 1, 192
local IS_CARRIER = { [ETHERNET] = true, [PPI] = true }
local IS_TAG = { ["\129\0"] = true, ["\136\168"] = true, ["\145\0"] = true } -- of a VLAN
local IS_ACF = { ["\34\240\130"] = true, ["\34\240\5"] = true } -- IEEE 1722: NTSCF, TSCF

-- By link type: function(head) -> a mark that tells a packet's bus from others of its interface;
-- nil for a packet that carries no YAPP.  head: the first HEADER bytes of the packet.
local HEADER = 24
local INDEX_OF = {
  [RTAC] = function(head) return DIRECTIONS[byte(head, 9)] or "tx" end,
  [COOKED] = function(head)
    if IS_CAN[sub(head, 15, 16)] then return 0 end
  end,
  [COOKED_2] = function(head)
    if not IS_CAN[sub(head, 1, 2)] or #head < 16 then return nil end
    local a, b, c, d = byte(head, 5, 8)
    return a * 0x1000000 + b * 0x10000 + c * 0x100 + d
  end,
  [ETHERNET] = function(head)
    local at = 13
    while IS_TAG[sub(head, at, at + 1)] do at = at + 4 end
    if IS_ACF[sub(head, at, at + 2)] then return 0 end
  end,
  [PPI] = function(head)
    if sub(head, 5, 8) == "\227\0\0\0" then return 0 end
  end,
}

local NEXT = -1 -- the time stamp of the next packet is wanted
local TIMES = 2 ^ 40 -- microseconds: times are kept modulo 12 days, see Capture:bus

-- The bytes of a file -----------------------------------------------------------------------------

local Window = {}
Window.__index = Window

function Window:bytes(offset, count)
  return sub(self.text, offset - self.start + 1, offset - self.start + count)
end

-- The number that bytes are, 0 for none; of 8 bytes it has a sign.
function Window:value(bytes)
  if self.is_little then bytes = bytes:reverse() end
  local number = #bytes == 8 and byte(bytes) > 127 and -1 or 0
  for i = 1, #bytes do number = number * 0x100 + byte(bytes, i) end
  return number
end

function Window:number(offset, count)
  return self:value(self:bytes(offset, count))
end

-- Three numbers of four bytes with one call: most of the time goes into these.
local function three_numbers(window, offset)
  local from = offset - window.start
  local a, b, c, d, e, f, g, h, i, j, k, l = byte(window.text, from + 1, from + 12)
  if not window.is_little then
    a, b, c, d, e, f, g, h, i, j, k, l = d, c, b, a, h, g, f, e, l, k, j, i
  end
  return a + b * 0x100 + c * 0x10000 + d * 0x1000000,
    e + f * 0x100 + g * 0x10000 + h * 0x1000000,
    i + j * 0x100 + k * 0x10000 + l * 0x1000000
end

-- Find out whether the option epb_dropcount, code 4 and 8 bytes, may be among the bytes at hand.
-- That costs less than to read the options of each block.
local function find_drop_option(window)
  local option = window.is_little and "\4\0\8\0" or "\0\4\0\8"
  window.may_have_drops = find(window.text, option, 1, true) ~= nil
end

-- Make `count` bytes, at most CHUNK, at an offset available; skip the bytes in front of them.
-- returns  true if they are there
function Window:has(offset, count)
  if offset + count <= self.stop then return true end
  local more = self.more(max(0, offset - self.stop), CHUNK)
  if not more then return false end
  self.text = self:bytes(offset, CHUNK) .. more
  self.start, self.stop = offset, offset + #self.text
  find_drop_option(self)
  return offset + count <= self.stop
end

-- Return whether bytes may have the header of a YAPP frame.
-- is_header  function(bytes, start); nil for a whole one
local function has_header(bytes, is_header)
  local start = frame.find(bytes, 1)
  while start do
    if (is_header or frame.is_plausible)(bytes, start) then return true end
    start = frame.find(bytes, start + 1)
  end
  return false
end

-- Buses -------------------------------------------------------------------------------------------

local Capture = {}
Capture.__index = Capture

-- Give a bus a name that no other has.  If several buses have the name of its interface, or may
-- have it in a live capture, append "#" and the mark that tells them apart.
local function name_bus(self, number)
  local bus = self.buses[number]
  local name, has_index = bus.name, bus.index ~= 0
  local suffix = "#" .. (has_index and bus.index or bus.interface.number)
  if self.uses[name] > 1 or has_index and self.is_live then name = name .. suffix end
  while self.is_taken[name] do name = name .. suffix end
  self.is_taken[name], self.names[number] = true, name
end

-- The number of a bus, which may be new.
-- index  the mark that tells it from other buses of its interface, 0 if it is the only one
local function bus_number(self, interface, index)
  local number = interface.buses[index]
  if not number then
    local name = interface.name or "if" .. interface.number
    number = #self.buses + 1
    interface.buses[index] = number
    self.buses[number] = { interface = interface, index = index, name = name }
    self.uses[name] = (self.uses[name] or 0) + 1
  end
  return number
end

-- Compare a time stamp with the first one.  A recorder without a clock gives all packets one stamp.
-- of  its interface, or file: others may begin at another time
local function compare_stamp(self, of, seconds)
  of.stamp = of.stamp or seconds
  if seconds ~= of.stamp then self.stamps_differ = true end
end

-- Keep the bus of the latest packet, and when it was captured.
-- offset   of its data
-- seconds  since 1970
-- bus      nil for that of its interface
local function keep_bus(self, window, interface, offset, seconds, bus)
  bus = bus or interface.bus
  if not bus then
    local index = INDEX_OF[interface.linktype](window:bytes(offset, HEADER))
    bus = index and bus_number(self, interface, index) or 0
  end
  self.entries[self.count] = bus * TIMES + floor(seconds * 1e6) % TIMES
end

-- pcapng ------------------------------------------------------------------------------------------

-- The options of a block: { [code] = bytes }.
-- offset, stop  of the first one, and behind the last one
local function read_options(window, offset, stop)
  local options = {}
  for _ = 1, MAX_OPTIONS do
    if offset + 4 > stop or not window:has(offset, 4) then break end
    local code, length = window:number(offset, 2), window:number(offset + 2, 2)
    if code == 0 or offset + 4 + length > stop or not window:has(offset, 4 + length) then break end
    options[code] = options[code] or window:bytes(offset + 4, length)
    offset = offset + 4 + length + -length % 4
  end
  return options
end

-- Time units in a second, by the option if_tsresol.
local function units_per_second(option)
  local exponent = option and byte(option) or 6
  return exponent < 128 and 10 ^ exponent or 2 ^ (exponent - 128)
end

local function interface_of(self, number)
  return self.interfaces[self.first + number + 1]
end

local function seconds_of(interface, high, low)
  return (high * 2 ^ 32 + low) / interface.per_second + interface.shift
end

-- Add an interface to those of the file.
-- name  nil for none
local function new_interface(self, linktype, name)
  local number = #self.interfaces
  local interface = {
    number = number, -- in the file
    section = #self.firsts,
    key = linktype .. (name and "/" .. name or "#" .. number), -- the same in another section
    linktype = linktype,
    name = name and utf8.name(name),
    per_second = 1e6, -- time units
    shift = 0, -- seconds to add to its times
    buses = {}, -- by index
    bus = nil, -- of its packets, 0 if they carry no YAPP; nil if each tells it
    direction = nil, -- of a serial line: the first one that came, which has `bus`
    stamp = nil, -- that of its first packet
    dropped = 0, -- packets, as the statistics say
    accounted = 0, -- dropped packets, as options of packets say
  }
  self.interfaces[#self.interfaces + 1], self.linktypes[linktype] = interface, true
  return interface
end

-- Add an interface that may carry YAPP to the buses.
local function add_bus_interface(self, interface)
  local linktype = interface.linktype
  local is_mixed, is_carrier = INDEX_OF[linktype] ~= nil, IS_CARRIER[linktype]
  local kind = is_carrier and "carriers" or "yapp_interfaces"
  self[kind] = self[kind] + 1
  interface.bus = not is_mixed and bus_number(self, interface, 0) or nil
  if not self.keeps then self.early = self.count end
  self.keeps = is_mixed and not is_carrier or self.carriers + self.yapp_interfaces > 1
  self.has_indexes = self.has_indexes or linktype == COOKED_2
  self.has_serial = self.has_serial or IS_SERIAL[linktype]
end

-- The functions in BLOCKS, below, read a block: its first CHUNK bytes are available.  They return
-- true to read no further.

local function read_interface(self, window, offset, length)
  if length < 20 then return true end
  local linktype = window:number(offset + 8, 2)
  local options = read_options(window, offset + 16, offset + length - 4)
  local interface = new_interface(self, linktype, (options[2] or ""):match("^[^\0]+"))
  interface.per_second = units_per_second(options[9])
  interface.shift = window:value(options[14] or "")
  if INDEX_OF[linktype] or linktype == SOCKETCAN or IS_SERIAL[linktype] then
    add_bus_interface(self, interface)
  else
    interface.bus = 0
  end
end

-- Return the bus of a packet of a serial line.
-- direction  "rx", "tx" or 0; that which comes first has the bus of the interface
local function bus_of_direction(self, interface, direction)
  interface.direction = interface.direction or direction
  if direction == interface.direction then return interface.bus end
  return bus_number(self, interface, direction)
end

-- Return the options of an enhanced block.
local function packet_options(window, offset, length)
  local captured = three_numbers(window, offset + 20)
  local start, stop = offset + 28 + captured + -captured % 4, offset + length - 4
  return start < stop and read_options(window, start, stop) or {}
end

-- Add the packets that were dropped in front of the latest one.
-- seconds  since 1970 at which that was captured
local function add_drops(self, window, interface, seconds, options)
  local count = window:value(options[4] or "")
  if count == 0 then return end
  interface.accounted = interface.accounted + count
  self.drops[#self.drops + 1] =
    { time = seconds, frame = self.count, interface = interface, count = count }
end

local OBSOLETE, ENHANCED = 2, 6

-- Return the bus of the latest packet, which is of a serial line, by its options.
local function bus_by_flags(self, window, interface, options)
  local flags = window:value(options[2] or "")
  local bus = bus_of_direction(self, interface, FLAG_DIRECTIONS[flags % 4] or 0)
  if bus ~= interface.bus and not self.keeps then
    self.keeps, self.early = true, self.count - 1
  end
  return bus
end

-- Read an enhanced block with a packet of an interface.
local function read_enhanced(self, window, offset, length, interface, seconds)
  local is_serial, options, bus = IS_SERIAL[interface.linktype], nil, nil
  if is_serial then
    self.has_serial_frames = self.has_serial_frames or has_header(window:bytes(offset + 28, length))
    options = packet_options(window, offset, length)
    bus = bus_by_flags(self, window, interface, options)
  end
  if self.keeps then keep_bus(self, window, interface, offset + 28, seconds, bus) end
  if not window.may_have_drops then return end
  options = options or packet_options(window, offset, length)
  add_drops(self, window, interface, seconds, options)
end

-- Read a block with a packet, of the enhanced or of the obsolete kind.
local function read_packet(self, window, offset, length, kind)
  self.count = self.count + 1
  local is_wanted = self.keeps or self.has_serial or window.may_have_drops or self.start == NEXT
  if not is_wanted and self.stamps_differ then return end -- the usual case
  if length < 32 then return true end
  local number, high, low = three_numbers(window, offset + 8)
  if kind == OBSOLETE then number = window:number(offset + 8, 2) end
  local interface = interface_of(self, number)
  if not interface then return self.keeps end
  local seconds = seconds_of(interface, high, low)
  if self.start == NEXT then self.start = seconds end
  compare_stamp(self, interface, seconds)
  if kind == ENHANCED then
    read_enhanced(self, window, offset, length, interface, seconds)
  elseif self.keeps then
    keep_bus(self, window, interface, offset + 28, seconds)
  end
end

-- A simple block has a packet of the section's first interface, without a time.
local function read_simple_packet(self, window, offset)
  self.count, self.lacks_times = self.count + 1, true
  local interface = interface_of(self, 0)
  if not interface then return true end
  if self.keeps then keep_bus(self, window, interface, offset + 12, 0) end
end

-- Read how many packets an interface, or its operating system, dropped so far.
local function read_statistics(self, window, offset, length)
  local interface = interface_of(self, window:number(offset + 8, 4))
  if not interface then return end
  local options = read_options(window, offset + 20, offset + length - 4)
  local own, by_system = window:value(options[5] or ""), window:value(options[7] or "")
  interface.dropped = max(interface.dropped, own, by_system)
end

local function count_packet(self)
  self.count = self.count + 1
end

-- A custom block is a packet without a time.
local function read_custom(self)
  count_packet(self)
  if self.count == 1 then self.start = NEXT end
end

local function stop_reading()
  return true
end

local BLOCKS = {
  [1] = read_interface,
  [OBSOLETE] = read_packet,
  [3] = read_simple_packet,
  [5] = read_statistics,
  [ENHANCED] = read_packet,
  [0xBAD] = read_custom,
  [0x40000BAD] = read_custom,
}
-- Wireshark gives these a frame number, too: of the systemd journal, events of sysdig.
for _, kind in ipairs { 9, 0x204, 0x216, 0x221 } do
  BLOCKS[kind] = count_packet
end
-- Wireshark 4.6 gives these a frame number, 4.4 does not: further events of sysdig.
for _, kind in ipairs { 0x208, 0x217, 0x222 } do BLOCKS[kind] = stop_reading end

local SECTION = 0x0A0D0D0A

-- Begin a section, which has its own byte order and numbers its interfaces from 0.
-- returns  the length of its block
local function read_section(self, window, offset)
  window.is_little = window:bytes(offset + 8, 4) == "\77\60\43\26"
  find_drop_option(window)
  self.first = #self.interfaces
  self.firsts[#self.firsts + 1] = self.first
  return window:number(offset + 4, 4)
end

local function read_pcapng(self, window)
  local offset = 0
  while offset + 12 <= window.stop or window:has(offset, 12) do
    local kind, length = three_numbers(window, offset)
    if kind == SECTION then length = read_section(self, window, offset) end
    length = length + -length % 4 -- as Wireshark does it
    local is_there = offset + length <= window.stop or window:has(offset, min(length, CHUNK))
    if length < 12 or length > MAX_BLOCK or not is_there then break end
    local read = BLOCKS[kind]
    if read and read(self, window, offset, length, kind) then break end
    offset = offset + length
  end
end

-- pcap --------------------------------------------------------------------------------------------

-- Return the interface of pcap, nil if no packet tells its bus.
local function pcap_interface(self, linktype)
  self.linktypes[linktype] = true
  if linktype ~= COOKED_2 and linktype ~= RTAC then return nil end
  self.yapp_interfaces = 1
  return new_interface(self, linktype)
end

local function read_pcap(self, window, is_little, fractions)
  window.is_little = is_little
  local linktype = window:number(20, 4) % 0x10000 -- above it: the length of check sequences
  local interface, offset = pcap_interface(self, linktype), 24
  self.offset = linktype == SOCKETCAN and 8 or nil
  self.has_packets = window:has(24, 16)
  while offset + 16 <= window.stop or interface and window:has(offset, 16) do
    local seconds, fraction, length = three_numbers(window, offset)
    local time = seconds + fraction / fractions
    compare_stamp(self, self, time)
    if length > MAX_BLOCK or self.stamps_differ and not interface then break end
    if interface then
      self.count = self.count + 1
      window:has(offset, 32)
      keep_bus(self, window, interface, offset + 16, time)
    end
    offset = offset + 16 + length
  end
end

-- By the first four bytes of a file: the function that reads it; of pcap, true if it is little
-- endian, and the fractions of a second in its times.
local FORMATS = {
  ["\212\195\178\161"] = { read_pcap, true, 1e6 },
  ["\161\178\195\212"] = { read_pcap, false, 1e6 },
  ["\77\60\178\161"] = { read_pcap, true, 1e9 },
  ["\161\178\60\77"] = { read_pcap, false, 1e9 },
  ["\10\13\13\10"] = { read_pcapng },
}

-- The facts of a capture --------------------------------------------------------------------------

-- Complete the list of drops: add drops that only statistics say, and set the names of buses.
local function complete_drops(self)
  local drops = self.drops
  for _, interface in ipairs(self.interfaces) do
    local rest = interface.dropped - interface.accounted
    if rest > 0 then drops[#drops + 1] = { interface = interface, count = rest } end
  end
  for _, drop in ipairs(drops) do
    local interface = drop.interface
    drop.bus = self.has_several and self.names[interface.bus] or interface.name
  end
end

-- Make one of an interface and that of an earlier section which is the same.
local function merge(self, interface, earlier)
  for index, number in pairs(interface.buses) do
    local same = earlier.buses[index] or number
    earlier.buses[index], self.merged[number] = same, same
    if same ~= number then self.uses[interface.name] = self.uses[interface.name] - 1 end
  end
  interface.bus, interface.buses = earlier.bus, earlier.buses
end

-- Make one of the interfaces of different sections that have one name and link type.  If a section
-- has two of them, nothing tells which is which.
local function merge_sections(self)
  local sections, is_unclear, first = {}, {}, {}
  for _, interface in ipairs(self.interfaces) do
    local key, section = interface.key, interface.section
    is_unclear[key] = is_unclear[key] or sections[key] == section
    sections[key] = section
  end
  for _, interface in ipairs(self.interfaces) do
    local key = interface.key
    if first[key] and not is_unclear[key] then merge(self, interface, first[key]) end
    first[key] = first[key] or interface
  end
end

-- Let the first direction of a serial line have its name, now that it is known.
local function name_directions(self)
  for _, interface in ipairs(self.interfaces) do
    local direction, bus = interface.direction or 0, interface.bus
    if direction ~= 0 then
      self.buses[bus].index = direction
      interface.buses[0], interface.buses[direction] = nil, bus
    end
  end
end

-- Set the facts that are known once all packets have been read.
local function conclude(self)
  name_directions(self)
  merge_sections(self)
  self.has_packets = self.has_packets or self.count > 0
  local may_have_more = self.yapp_interfaces > 0 or #self.interfaces == 0
  self.is_live = #self.firsts > 0 and not self.has_packets and may_have_more
  local count = 0
  for number = 1, #self.buses do
    if (self.merged[number] or number) == number then
      name_bus(self, number)
      count = count + 1
    end
  end
  self.has_several = count > 1 or self.is_live and self.has_indexes
  complete_drops(self)
  if not self.has_several then self.entries = {} end
end

local function new_capture()
  return setmetatable({
    yapp_interfaces = 0,
    carriers = 0,
    count = 0,
    early = 0, -- packets before the second interface: all that may be YAPP are of bus 1
    keeps = false, -- true if the buses of packets are wanted
    has_serial = false, -- true if a serial line, whose packets may have a direction, is among them
    has_serial_frames = false, -- true if one of its packets may have a YAPP frame
    has_indexes = false, -- true if Linux cooked v2 is among the interfaces
    entries = {}, -- [number of a packet] = its bus * TIMES + when it was captured
    interfaces = {}, -- of the file
    linktypes = {}, -- [number] = true
    first = 0, -- number of interfaces in the sections before
    firsts = {}, -- by section
    buses = {}, -- list of { interface, index, name = of the interface }
    merged = {}, -- [bus] = the one that it is, of an earlier section
    uses = {}, -- by name: how many buses have it
    names = {},
    is_taken = {}, -- by name
    drops = {},
    lacks_times = false,
    stamps_differ = false,
    stamp = nil, -- of the first packet of pcap
    start = false,
    has_packets = false,
    is_unknown = false,
  }, Capture)
end

--- Read the buses of a file.  Of a file without YAPP only the first bytes are read.  One
-- whose interfaces are all Ethernet or PPI is read if a packet in these bytes has a CAN frame.
-- head  its first bytes, M.HEAD at most
-- more  function(skip, count) -> the next bytes behind so many that are skipped, at most `count`;
--       nil at the end, and where a pipe must be left alone
-- returns a capture: {
--   yapp_interfaces      number of interfaces that may carry YAPP
--   carriers      number of others, whose packets may have CAN frames inside
--   has_several   true if it tells several buses apart, or will do so in a live capture
--   is_live       true if it is pcapng without a packet yet, as when a capture begins
--   is_told       true if it is of a format that this module reads
--   is_unknown    true if it may have buses that this module cannot tell apart: a file of Vector
--                 BLF, or pcapng that was not read to its end and may describe them later
--   count         how many packets were read
--   names         [bus] = its name
--   drops         list of { time = seconds since 1970 or nil, frame = number of the packet behind
--                 the loss or nil, bus = name or nil, count = packets that were dropped }
--   lacks_times   true if packets have no time stamps
--   stamps_differ true if two of the packets that were read have different ones
--   start         if the first packet has no time stamp: that of the next one, seconds since 1970
--   offset        of the CAN frame's data in each packet; nil where it is not always the same
--   head          its first bytes, if it has packets and these may have YAPP frames, in TCP, UDP or
--                 others, of which one packet may have only the beginning
--   has_serial_frames  true if a packet of a serial line in pcapng may have a YAPP frame
--   may_have_frames  true if its first bytes may have YAPP frames, or it has no packets yet }
function M.read(head, more)
  local self, has_frame = new_capture(), has_header(head)
  local window = setmetatable({ text = head, start = 0, stop = #head, is_little = true }, Window)
  function window.more(skip, count)
    if self.yapp_interfaces > 0 or self.buses[1] or has_frame then return more(skip, count) end
    self.is_unknown = #head >= M.HEAD
  end
  local magic = sub(head, 1, 4)
  local format = FORMATS[magic]
  if format then format[1](self, window, format[2], format[3]) end
  self.is_unknown = self.is_unknown or magic == "LOGG"
  self.is_told = format ~= nil and not self.is_unknown
  conclude(self)
  if self.start == NEXT then self.start = false end
  self.head = self.has_packets and has_header(head, frame.has_id) and head or nil
  self.may_have_frames = has_frame or not self.has_packets
  return self
end

--- Return the options of tshark that may decode YAPP in the capture's serial lines: a list.
function Capture:serial_options()
  local user, list = {}, {}
  for linktype in pairs(self.linktypes) do
    if IS_SERIAL[linktype] and linktype <= 162 then user[#user + 1] = linktype end
  end
  table.sort(user)
  if user[1] then list[1] = "-o yapp.user_dlt:" .. table.concat(user, ",") end
  if self.linktypes[RTAC] then list[#list + 1] = "-d rtacser.data,yapp_serial" end
  return list
end

--- Return the bus of a packet that was read.
-- number    of the packet
-- captured  seconds since 1970 at which Wireshark says that it was captured, nil not to compare
-- returns   its bus; 0 where its interface carries no YAPP; nil where the file's packet of this
--           number is another: a read filter has shifted the numbers
function Capture:bus(number, captured)
  if number <= self.early then return 1 end
  local entry = self.entries[number]
  if not entry then return nil end
  local difference = captured and (captured * 1e6 - entry) % TIMES or 0
  if difference > 2 and difference < TIMES - 2 then return nil end
  local bus = floor(entry / TIMES)
  return self.merged[bus] or bus
end

--- Return a function(number, offset, pinfo), which finds the bus of each packet in their order.  It
-- returns the bus, nil where it is not known; and whether it is known.  Once a packet is another
-- than the file's, all that follow are.
-- compares_times  true if pinfo.abs_ts is when the packet was captured
-- later           function(number): the same for packets that were not read
function Capture:bus_finder(compares_times, later)
  local is_shifted = false
  return function(number, _, pinfo)
    if number > self.count then return later(number) end
    local bus = not is_shifted and self:bus(number, compares_times and pinfo.abs_ts or nil)
    is_shifted = not bus
    return bus or nil, not is_shifted
  end
end

-- Return a bus of an interface; the parameters are those of Capture:bus_by_fields.
local function bus_in(self, interface, index, event, direction)
  if direction and IS_SERIAL[interface.linktype] then
    return bus_of_direction(self, interface, FLAG_DIRECTIONS[direction] or 0)
  end
  return bus_number(self, interface, event and (DIRECTIONS[event] or "tx") or index)
end

--- Return the bus of a packet that was not read, by the values of Wireshark's fields.
-- section    its number, from 1
-- interface  its number in the section
-- index      of Linux cooked v2, 0 for none; event: of RTAC, or nil
-- name       of the interface, or nil
-- direction  of its flags, or nil
-- returns    a bus; nil where the section was not read
function Capture:bus_by_fields(section, interface, index, event, name, direction)
  local first = self.firsts[section] or section == 1 and 0
  if not first then return nil end
  local number = first + interface
  local record = self.interfaces[number + 1] or
    { number = number, name = name and utf8.name(name), buses = {} }
  self.interfaces[number + 1] = record
  local bus = bus_in(self, record, index, event, direction)
  if not self.names[bus] then name_bus(self, bus) end
  -- In a live capture further indexes may follow, so a bus with an index is one of several at once.
  local is_first = self.is_live and bus == 1 and index ~= 0 and not event
  self.has_several = self.has_several or is_first
  return bus
end

--- Return the name of a bus.
-- bus      nil where the capture has one
-- is_ip    true if the packet came in UDP or TCP, so by any interface
-- returns  text, nil where the capture has no name for it
function Capture:name(bus, is_ip)
  if bus then return self.names[bus] end
  if self.is_unknown and not is_ip then return nil end
  local only = not is_ip and not self.has_several and self.buses[1]
  local interface = only and only.interface or self.interfaces[1]
  if only or #self.interfaces == 1 then return interface and interface.name end
end

return M
