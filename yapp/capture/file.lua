-- SPDX-License-Identifier: GPL-2.0-or-later
-- Reads a capture file, pcap or pcapng: the bus of each packet, the names of buses, the time of the
-- first packet, packets that were lost while capturing, bytes that may be YAPP.  Pure Lua.
--
-- Wireshark does not tell a dissector the interface of a packet; the file does.  A bus is an
-- interface of the file, an index in it (Linux cooked v2), or a direction in it (RTAC; packet flags
-- of serial lines).  Buses are numbered from 1 in the order in which they show.

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
local SAME_TIME = 2e-6 -- seconds between the file's stamp and Wireshark's for the same packet

-- Link types whose packets may carry YAPP: SocketCAN, alone and in Linux cooked captures; serial
-- lines: exported PDUs and DLT_USER 0 .. 15, whose packets may have a direction; RTAC serial.
local SOCKETCAN, COOKED, COOKED_2, RTAC = 227, 113, 276, 250
local IS_SERIAL = { [252] = true }
for linktype = 147, 162 do IS_SERIAL[linktype] = true end
local FLAG_DIRECTIONS = { [0] = 0, "rx", "tx" } -- by the lowest two bits of a packet's flags
local EVENT_DIRECTIONS = { "tx", "rx", "tx", "rx" } -- of an RTAC packet by its event
local IS_CAN = { ["\0\12"] = true, ["\0\13"] = true } -- protocols: CAN and CAN FD

-- By link type: function(head) -> the index of a packet's bus in its interface; nil for a packet
-- that carries no YAPP.  head: the first HEADER bytes of the packet.
local HEADER = 20
local INDEX_OF = {
  [RTAC] = function(head) return EVENT_DIRECTIONS[byte(head, 9)] or "tx" end,
  [COOKED_2] = function(head)
    if not IS_CAN[sub(head, 1, 2)] or #head < HEADER then return nil end
    local a, b, c, d = byte(head, 5, 8)
    return a * 0x1000000 + b * 0x10000 + c * 0x100 + d
  end,
}

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

local File = {}
File.__index = File

-- Give a bus a name that no other has.  If several buses have the name of its interface, or may
-- have it in a live capture, append "#" and the index, or the number of the interface.
local function name_bus(self, number)
  local bus = self.buses[number]
  local name, has_index = bus.name, bus.index ~= 0
  local suffix = "#" .. (has_index and bus.index or bus.interface.number)
  if self.uses[name] > 1 or has_index and self.is_live then name = name .. suffix end
  while self.is_taken[name] do name = name .. suffix end
  self.is_taken[name], self.names[number] = true, name
end

-- Return the number of a bus, which may be new.
-- index  in its interface; 0 if it is the only one
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

-- Return the bus of a packet of a serial line.
-- direction  "rx", "tx" or 0; that which comes first has the bus of the interface
local function bus_of_direction(self, interface, direction)
  interface.direction = interface.direction or direction
  if direction == interface.direction then return interface.bus end
  return bus_number(self, interface, direction)
end

-- Keep the bus of the latest packet, and when it was captured: seconds since 1970.
local function keep_bus(self, bus, seconds)
  self.bus_by_number[self.count], self.stamps[self.count] = bus, seconds
end

-- Return the bus of a packet, 0 if it carries no YAPP.
-- offset  of its data
local function bus_by_header(self, window, interface, offset)
  local index_of = INDEX_OF[interface.linktype]
  if not index_of then return interface.bus end
  local index = index_of(window:bytes(offset, HEADER))
  return index and bus_number(self, interface, index) or 0
end

-- Times -------------------------------------------------------------------------------------------

-- Compare a time stamp with the first one of its interface, or file: others may begin at another
-- time.  A recorder without a clock gives all packets one stamp.
local function compare_stamp(self, interface, seconds)
  interface.stamp = interface.stamp or seconds
  if seconds ~= interface.stamp then self.stamps_differ = true end
end

-- Divide a stamp exactly: 1700000000123456789 units of 10^-9 s do not fit into a double.
-- bytes       of it, the highest first
-- per_second  number of units in a second
-- returns     { seconds, nanoseconds }
local function exact_time(bytes, per_second)
  local seconds, rest = 0, 0
  for i = 1, #bytes do
    rest = rest * 0x100 + byte(bytes, i)
    seconds = seconds * 0x100 + floor(rest / per_second)
    rest = rest % per_second
  end
  local is_fine = per_second > 1e9
  return { seconds, floor(is_fine and rest / (per_second / 1e9) or rest * (1e9 / per_second)) }
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

-- Return the interface of a packet by its number in the section.
local function interface_of(self, number)
  return self.interfaces[self.first_interface + number + 1]
end

-- Add an interface to those of the file.
-- name  nil for none
local function add_interface(self, linktype, name)
  local interface = {
    number = #self.interfaces, -- in the file
    linktype = linktype,
    name = name and utf8.name(name),
    per_second = 1e6, -- time units
    shift = 0, -- seconds to add to its times
    buses = {}, -- by index
    bus = 0, -- of its packets, 0 if they carry no YAPP or if each tells it
    direction = nil, -- of a serial line: the first one that came, which has `bus`
    stamp = nil, -- that of its first packet
    dropped = 0, -- packets, as the statistics say
    accounted = 0, -- dropped packets, as options of packets say
  }
  self.interfaces[#self.interfaces + 1], self.linktypes[linktype] = interface, true
  local is_serial, is_mixed = IS_SERIAL[linktype], INDEX_OF[linktype] ~= nil
  if is_mixed or is_serial or linktype == SOCKETCAN or linktype == COOKED then
    self.yapp_interfaces = self.yapp_interfaces + 1
    if not is_mixed then interface.bus = bus_number(self, interface, 0) end
    self.has_indexes = self.has_indexes or linktype == COOKED_2
    if not self.keeps then self.early = self.count end
    self.keeps = self.keeps or is_mixed or is_serial or self.yapp_interfaces > 1
  end
  return interface
end

-- The functions in BLOCKS, below, read a block: its first CHUNK bytes are available.  They return
-- true to read no further.

local function read_interface(self, window, offset, length)
  if length < 20 then return true end
  local options = read_options(window, offset + 16, offset + length - 4)
  local name = (options[2] or ""):match("^[^\0]+")
  local interface = add_interface(self, window:number(offset + 8, 2), name)
  interface.per_second = units_per_second(options[9])
  interface.shift = window:value(options[14] or "")
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

-- Read the bus of the latest packet, and the packets that were dropped in front of it.
local function read_facts(self, window, offset, length, interface, seconds)
  local is_serial = IS_SERIAL[interface.linktype]
  local options = (is_serial or window.may_have_drops) and packet_options(window, offset, length)
  local bus
  if is_serial then
    self.has_serial_frames = self.has_serial_frames or has_header(window:bytes(offset + 28, length))
    local flags = window:value(options[2] or "")
    bus = bus_of_direction(self, interface, FLAG_DIRECTIONS[flags % 4] or 0)
  end
  if self.keeps then
    keep_bus(self, bus or bus_by_header(self, window, interface, offset + 28), seconds)
  end
  if window.may_have_drops then add_drops(self, window, interface, seconds, options) end
end

-- Read a block with a packet of an interface.
local function read_packet(self, window, offset, length)
  self.count = self.count + 1
  local is_wanted = self.keeps or window.may_have_drops or not self.stamps_differ
  if not is_wanted then return end -- the usual case
  if length < 32 then return true end
  local number, high, low = three_numbers(window, offset + 8)
  local interface = interface_of(self, number)
  if not interface then return self.keeps end
  local seconds = (high * 2 ^ 32 + low) / interface.per_second + interface.shift
  if self.count == 1 then
    local half, bytes = window:bytes(offset + 12, 4), window:bytes(offset + 16, 4)
    bytes = window.is_little and half:reverse() .. bytes:reverse() or half .. bytes
    self.first = exact_time(bytes, interface.per_second)
    self.first[1] = self.first[1] + interface.shift
  end
  compare_stamp(self, interface, seconds)
  read_facts(self, window, offset, length, interface, seconds)
end

-- A simple block has a packet of the section's first interface, without a time.
local function read_simple_packet(self, window, offset)
  self.count, self.lacks_times = self.count + 1, true
  local interface = interface_of(self, 0)
  if not interface then return true end
  if self.keeps then keep_bus(self, bus_by_header(self, window, interface, offset + 12), 0) end
end

-- Read how many packets an interface, or its operating system, dropped so far.
local function read_statistics(self, window, offset, length)
  local interface = interface_of(self, window:number(offset + 8, 4))
  if not interface then return end
  local options = read_options(window, offset + 20, offset + length - 4)
  local own, by_system = window:value(options[5] or ""), window:value(options[7] or "")
  interface.dropped = max(interface.dropped, own, by_system)
end

-- A packet that is none of a bus.  If it is the first one, Wireshark counts no times from it.
local function count_packet(self)
  self.count = self.count + 1
  if self.count == 1 then self.lacks_times = true end
end

local BLOCKS = {
  [1] = read_interface,
  [3] = read_simple_packet,
  [5] = read_statistics,
  [6] = read_packet,
}
-- Wireshark gives these a frame number, too: custom blocks, the systemd journal, events of sysdig.
for _, kind in ipairs { 0xBAD, 0x40000BAD, 9, 0x204, 0x216, 0x221 } do
  BLOCKS[kind] = count_packet
end
-- Numbers behind these are not known: obsolete packets, and events of sysdig that have a number in
-- Wireshark 4.6 and none in 4.4.
for _, kind in ipairs { 2, 0x208, 0x217, 0x222 } do
  BLOCKS[kind] = function() return true end
end

local SECTION = 0x0A0D0D0A

-- Begin a section, which has its own byte order and numbers its interfaces from 0.
-- returns  the length of its block
local function read_section(self, window, offset)
  window.is_little = window:bytes(offset + 8, 4) == "\77\60\43\26"
  find_drop_option(window)
  self.first_interface = #self.interfaces
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
    if read and read(self, window, offset, length) then break end
    offset = offset + length
  end
end

-- pcap --------------------------------------------------------------------------------------------

local function read_pcap(self, window, is_little, fractions)
  window.is_little = is_little
  local linktype = window:number(20, 4) % 0x10000 -- above it: the length of check sequences
  local interface, offset = add_interface(self, linktype), 24
  local is_mixed = INDEX_OF[linktype] ~= nil
  self.has_packets = window:has(24, 16)
  while offset + 16 <= window.stop or is_mixed and window:has(offset, 16) do
    local seconds, fraction, length = three_numbers(window, offset)
    local time = seconds + fraction / fractions
    self.first = self.first or { seconds, floor(fraction * 1e9 / fractions) }
    compare_stamp(self, interface, time)
    if length > MAX_BLOCK or self.stamps_differ and not is_mixed then break end
    if is_mixed then
      self.count = self.count + 1
      window:has(offset, 16 + HEADER)
      keep_bus(self, bus_by_header(self, window, interface, offset + 16), time)
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

-- The facts of a file -----------------------------------------------------------------------------

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
  self.has_packets = self.has_packets or self.count > 0
  local may_have_more = self.yapp_interfaces > 0 or #self.interfaces == 0
  self.is_live = self.is_pcapng and not self.has_packets and may_have_more
  self.may_add_buses = self.yapp_interfaces > 0 and (self.is_pcapng or self.keeps)
  for number = 1, #self.buses do name_bus(self, number) end
  self.has_several = #self.buses > 1 or self.is_live and self.has_indexes
  if not self.has_several then self.bus_by_number, self.stamps = {}, {} end
  complete_drops(self)
end

local function new_file()
  return setmetatable({
    yapp_interfaces = 0,
    count = 0,
    early = 0, -- packets before the second interface: all that may be YAPP are of bus 1
    keeps = false, -- true if packets may be of several buses
    has_serial_frames = false, -- true if a packet of a serial line may have a YAPP frame
    has_indexes = false, -- true if Linux cooked v2 is among the interfaces
    bus_by_number = {}, -- of packets: see keep_bus
    stamps = {},
    interfaces = {}, -- of the file
    linktypes = {}, -- [number] = true
    first_interface = 0, -- number of interfaces in the sections before
    buses = {}, -- list of { interface, index, name = of the interface }
    uses = {}, -- by name: how many buses have it
    names = {},
    is_taken = {}, -- by name
    drops = {},
    first = nil, -- when the first packet was captured: { seconds, nanoseconds }
    lacks_times = false,
    stamps_differ = false,
    has_packets = false,
    is_unknown = false,
  }, File)
end

--- Read the buses of a file.  Of a file without YAPP only the first bytes are read.
-- head  its first bytes, M.HEAD at most
-- more  function(skip, count) -> the next bytes behind so many that are skipped, at most `count`;
--       nil at the end, and where a pipe must be left alone
-- returns a file: {
--   may_add_buses  true if packets that were not read may be of another bus
--   has_several   true if it tells several buses apart, or will do so in a live capture
--   is_live       true if it is pcapng without a packet yet, as when a capture begins
--   is_told       true if it is of a format that this module reads
--   is_unknown    true if it may have buses that this module cannot tell apart: a file of Vector
--                 BLF, or pcapng that was not read to its end and may describe them later
--   count         how many packets were read
--   names         [bus] = its name
--   drops         list of { time = seconds since 1970 or nil, frame = number of the packet behind
--                 the loss or nil, bus = name or nil, count = packets that were dropped }
--   first         { seconds, nanoseconds } since 1970 of the first packet; nil if not known
--   lacks_times   true if packets have no time stamps
--   stamps_differ true if two of the packets that were read have different ones
--   head          its first bytes, if it has packets and these may have YAPP frames, in TCP, UDP or
--                 others, of which one packet may have only the beginning
--   has_serial_frames  true if a packet of a serial line in pcapng may have a YAPP frame
--   may_have_frames  true if its first bytes may have YAPP frames, or it has no packets yet }
function M.read(head, more)
  local self, has_frame = new_file(), has_header(head)
  local window = setmetatable({ text = head, start = 0, stop = #head, is_little = true }, Window)
  function window.more(skip, count)
    if self.yapp_interfaces > 0 or has_frame then return more(skip, count) end
    self.is_unknown = #head >= M.HEAD
  end
  local magic = sub(head, 1, 4)
  local format = FORMATS[magic]
  self.is_pcapng = format ~= nil and format[1] == read_pcapng
  if format then format[1](self, window, format[2], format[3]) end
  self.is_unknown = self.is_unknown or magic == "LOGG"
  self.is_told = format ~= nil and not self.is_unknown
  conclude(self)
  self.head = self.has_packets and has_header(head, frame.has_id) and head or nil
  self.may_have_frames = has_frame or not self.has_packets
  return self
end

--- Return the options of tshark that may decode YAPP in the file's serial lines: a list.
function File:serial_options()
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
function File:bus(number, captured)
  if number <= self.early then return 1 end
  local bus, stamp = self.bus_by_number[number], self.stamps[number]
  if bus and captured and math.abs(captured - stamp) > SAME_TIME then return nil end
  return bus
end

--- Return a function(number, pinfo), which finds the bus of each packet in their order.  It
-- returns the bus, nil where it is not known; and whether it is known.  Once a packet is another
-- than the file's, all that follow are.
-- compares_times  true if pinfo.abs_ts is when the packet was captured
-- later           function(number): the same for packets that were not read
function File:bus_finder(compares_times, later)
  local is_shifted = false
  return function(number, pinfo)
    if number > self.count then return later(number) end
    local bus = not is_shifted and self:bus(number, compares_times and pinfo.abs_ts or nil)
    is_shifted = not bus
    return bus or nil, not is_shifted
  end
end

--- Return the bus of a packet that was not read, by the values of Wireshark's fields.
-- number     of its interface
-- index      of Linux cooked v2, 0 for none; event: of RTAC, or nil
-- name       of the interface, or nil
-- direction  of its flags, or nil
-- returns    a bus
function File:bus_by_fields(number, index, event, name, direction)
  local interface = self.interfaces[number + 1] or
    { number = number, name = name and utf8.name(name), buses = {} }
  self.interfaces[number + 1] = interface
  if event then index = EVENT_DIRECTIONS[event] or "tx" end
  local bus
  if direction and IS_SERIAL[interface.linktype] then
    bus = bus_of_direction(self, interface, FLAG_DIRECTIONS[direction] or 0)
  else
    bus = bus_number(self, interface, index)
  end
  if not self.names[bus] then name_bus(self, bus) end
  -- In a live capture further indexes may follow, so a bus with an index is one of several at once.
  local is_first = self.is_live and bus == 1 and index ~= 0 and not event
  self.has_several = self.has_several or is_first
  return bus
end

--- Return the name of a bus.
-- bus      nil where the file has one
-- is_ip    true if the packet came in UDP or TCP, so by any interface
-- returns  text, nil where the file has no name for it
function File:name(bus, is_ip)
  if bus then return self.names[bus] end
  if self.is_unknown and not is_ip then return nil end
  local only = not is_ip and not self.has_several and self.buses[1]
  local interface = only and only.interface or self.interfaces[1]
  if only or #self.interfaces == 1 then return interface and interface.name end
end

return M
