-- SPDX-License-Identifier: GPL-2.0-or-later
-- Reads a capture file, pcap or pcapng: the bus of each packet, the names of buses, the time of the
-- first packet, packets that were lost while capturing, bytes that may be YAPP.  Pure Lua.
--
-- Wireshark does not tell a dissector the interface of a packet; the file does.  A bus is an
-- interface of the file, an index in it (Linux cooked v2), or a direction in it (RTAC; packet flags
-- of serial lines).  Buses are numbered from 1 in the order in which they show.

local frame = require "yapp.wire.frame"
local utf8 = require "yapp.base.utf8"

local File = {}
File.__index = File

local byte, find, floor, max, sub = string.byte, string.find, math.floor, math.max, string.sub

--- How many bytes of a pipe may be read: Wireshark can rewind so many.
File.HEAD = 65536
local MAX_SECTION = 1024 -- bytes of the first block that name the program
local CHUNK = 1048576 -- bytes that are read at once, and the most that are read of a block
local SAME_TIME = 2e-6 -- seconds between the file's stamp and Wireshark's for the same packet

-- The bytes of a file -----------------------------------------------------------------------------

local Window = {}
Window.__index = Window

function Window:bytes(offset, count)
  return sub(self.text, offset - self.start + 1, offset - self.start + count)
end

-- Return the number that bytes are, the highest first; of 8 bytes it has a sign.
local function big_endian(bytes)
  local number = #bytes == 8 and byte(bytes) > 127 and -1 or 0
  for i = 1, #bytes do number = number * 0x100 + byte(bytes, i) end
  return number
end

-- The same in the order of the file; 0 for nil.
function Window:value(bytes)
  bytes = bytes or ""
  return big_endian(self.is_little and bytes:reverse() or bytes)
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
local function has_header(bytes)
  return frame.find_header(bytes, 1) ~= nil
end

-- Buses -------------------------------------------------------------------------------------------

local COOKED_2, RTAC = 276, 250
local IS_CAN = { ["\0\12"] = true, ["\0\13"] = true } -- protocols of Linux cooked captures
local EVENT_DIRECTIONS = { "tx", "rx", "tx", "rx" } -- of an RTAC packet by its event
local FLAG_DIRECTIONS = { "rx", "tx" } -- by the lowest two bits of a packet's flags
local HEADER = 8 + 1

local function index_by_flags(_, flags) return FLAG_DIRECTIONS[flags % 4] or 0 end

-- By link type that may carry YAPP: {
--   index_of  function(head, flags) -> the index of a packet's bus in its interface, nil for a
--             packet that carries none; nil where the interface is one bus.  head has the first
--             HEADER bytes of the packet
--   is_can    true if packets may begin with the header of a CAN frame
--   option    of tshark that decodes YAPP in it; or nil }
local LINKS = {
  [227] = { is_can = true }, -- SocketCAN
  [113] = { is_can = true }, -- Linux cooked
  [COOKED_2] = {
    is_can = true,
    index_of = function(head)
      local is_can = IS_CAN[sub(head, 1, 2)] and #head == HEADER
      return is_can and big_endian(sub(head, 5, 8)) or nil
    end,
  },
  [RTAC] = {
    index_of = function(head) return EVENT_DIRECTIONS[byte(head, 9)] or "tx" end,
    option = "-d rtacser.data,yapp_serial",
  },
  [252] = { index_of = index_by_flags }, -- exported PDUs, of serial lines
}
for linktype = 147, 162 do -- DLT_USER 0 .. 15
  LINKS[linktype] = { index_of = index_by_flags, option = "-o yapp.user_dlt:" .. linktype }
end

-- Return the number of a bus, which may be new.
-- index  in its interface; 0 if it is the only one
local function bus_number(self, interface, index)
  local number = interface.buses[index]
  if not number then
    local name = interface.name or "if" .. interface.number
    number = #self.buses + 1
    interface.buses[index] = number
    self.buses[number] = { interface = interface, name = name, index = index }
    self.uses[name] = (self.uses[name] or 0) + 1
  end
  return number
end

-- Keep what the latest packet tells.  If packets may be of several buses: its bus, 0 if it carries
-- no YAPP.  Other links may carry CAN, too: each interface is a bus.
-- offset   of its data
-- seconds  since 1970.  A recorder without a clock gives all packets one stamp
local function keep_packet(self, window, interface, offset, flags, seconds)
  self.stamp = self.stamp or seconds
  self.stamps_differ = self.stamps_differ or seconds ~= self.stamp
  if not self.keeps then return end
  local link, index = interface.link, 0
  if link and link.index_of then index = link.index_of(window:bytes(offset, HEADER), flags) end
  self.bus_by_number[self.count] = index and bus_number(self, interface, index) or 0
  self.stamps[self.count] = seconds
end

-- Return a new interface.
-- number    in the file
-- linktype  nil if it is not known; name is nil for none
local function new_interface(number, linktype, name)
  local link = LINKS[linktype or false]
  return {
    number = number,
    link = link,
    is_serial = link and link.index_of == index_by_flags,
    is_can = not linktype or link ~= nil and link.is_can or false,
    name = name and utf8.printable(name),
    per_second = 1e6, -- time units
    shift = 0, -- seconds to add to its times
    buses = {}, -- by index
    latest = "", -- of a serial line: the latest bytes, which may begin a header
    accounted = 0, -- dropped packets that are among the drops
  }
end

-- Add an interface to those of the file.
local function add_interface(self, linktype, name)
  local interface = new_interface(#self.interfaces, linktype, name)
  local link = interface.link
  local has_indexes = link and link.index_of
  table.insert(self.interfaces, interface)
  if link and not has_indexes then bus_number(self, interface, 0) end
  self.may_carry_yapp = self.may_carry_yapp or link ~= nil
  self.is_cooked = self.is_cooked or linktype == COOKED_2
  if not self.keeps and self.may_carry_yapp and (has_indexes or #self.interfaces > 1) then
    self.keeps = true
    for number = 1, self.count do
      self.bus_by_number[number] = bus_number(self, self.interfaces[1], 0)
    end
  end
  return interface
end

-- Times -------------------------------------------------------------------------------------------

-- Divide a stamp exactly: 1700000000123456789 units of 10^-9 s do not fit into a double.
-- high, low  halves of it, of 32 bits
-- returns    { seconds, nanoseconds }
local function exact_time(high, low, interface)
  local per_second, whole = interface.per_second, high * 2 ^ 32
  local rest = math.fmod(whole, per_second) -- exact, which % is not in Lua 5.2
  local units = rest + low
  return {
    floor((whole - rest) / per_second) + floor(units / per_second) + interface.shift,
    floor(units % per_second * 1e9 / per_second),
  }
end

-- pcapng ------------------------------------------------------------------------------------------

-- The options of a block: { [code] = bytes }.
-- offset, stop  of the first one, and behind the last one
local function read_options(window, offset, stop)
  local options = {}
  stop = math.min(stop, window.stop)
  while offset + 4 <= stop do
    local code, length = window:number(offset, 2), window:number(offset + 2, 2)
    if code == 0 or offset + 4 + length > stop then break end
    options[code] = options[code] or window:bytes(offset + 4, length)
    offset = offset + 4 + length + -length % 4
  end
  return options
end

-- Return an interface by its number in the section, nil for none.
local function interface_at(self, number)
  return self.interfaces[self.first_interface + number + 1]
end

-- The functions in BLOCKS, below, read a block of `length` bytes, of which the first CHUNK are
-- available.  They return true to read no further.

local function read_interface(self, window, offset, length)
  if length < 20 then return true end
  local options = read_options(window, offset + 16, offset + length - 4)
  local name = (options[2] or ""):match("^[^\0]+")
  local interface = add_interface(self, window:number(offset + 8, 2), name)
  local exponent = byte(options[9] or "\6") -- if_tsresol
  interface.per_second = exponent < 128 and 10 ^ exponent or 2 ^ (exponent - 128)
  interface.shift = window:value(options[14]) -- if_tsoffset
end

-- Add packets of an interface that were dropped.
-- seconds, number  of the packet behind the loss; nil where nothing tells it
local function add_drops(self, interface, count, seconds, number)
  if count <= 0 then return end
  interface.accounted = interface.accounted + count
  self.drops[#self.drops + 1] =
    { time = seconds, frame = number, bus = interface.name, count = count }
end

-- Read a block with a packet of an interface, by its number in the section: its bus, its time and
-- its options.
local function read_packet(self, window, offset, length, number)
  self.count = self.count + 1
  local is_wanted = self.keeps or window.may_have_drops or not self.stamps_differ
  if not is_wanted then return end -- the usual case
  local interface = interface_at(self, number)
  if length < 32 or not interface then return true end
  local high, low, captured = three_numbers(window, offset + 12)
  local seconds = (high * 2 ^ 32 + low) / interface.per_second + interface.shift
  local data, is_serial, options = offset + 28, interface.is_serial, {}
  if self.count == 1 then self.first = exact_time(high, low, interface) end
  if is_serial or window.may_have_drops then
    options = read_options(window, data + captured + -captured % 4, offset + length - 4)
    add_drops(self, interface, window:value(options[4]), seconds, self.count)
  end
  local link = interface.link
  if link and link.option and not self.has_serial_frames then
    local bytes = interface.latest .. window:bytes(data, captured)
    self.has_serial_frames, interface.latest = has_header(bytes), sub(bytes, 1 - frame.HEADER)
  end
  keep_packet(self, window, interface, data, window:value(options[2]), seconds)
end

-- Read how many packets an interface dropped so far.
local function read_statistics(self, window, offset, length, number)
  local interface = interface_at(self, number)
  if not interface then return end
  local options = read_options(window, offset + 20, offset + length - 4)
  add_drops(self, interface, window:value(options[5]) - interface.accounted)
end

-- A block that Wireshark gives a frame number, too.  If it is the first one, Wireshark counts no
-- times from it.
local function count_packet(self)
  self.count = self.count + 1
  self.bus_by_number[self.count] = 0
  self.lacks_times = self.lacks_times or self.count == 1
end

-- A simple block has a packet of the section's first interface, without a time.
local function read_simple_packet(self, window, offset)
  count_packet(self)
  self.lacks_times = true
  local interface = interface_at(self, 0)
  if interface then keep_packet(self, window, interface, offset + 12, 0, 0) end
end

local BLOCKS = {
  [1] = read_interface,
  [3] = read_simple_packet,
  [5] = read_statistics,
  [6] = read_packet,
  [9] = count_packet, -- of the systemd journal
  [0xBAD] = count_packet, -- custom blocks
  [0x40000BAD] = count_packet,
}

local SECTION = 0x0A0D0D0A

-- A section has its own byte order and numbers its interfaces from 0.
local function read_pcapng(self, window)
  local offset = 0
  while window:has(offset, 12) do
    local kind, length, number = three_numbers(window, offset)
    if kind == SECTION then
      window.is_little = window:bytes(offset + 8, 4) == "\77\60\43\26"
      find_drop_option(window)
      self.first_interface = #self.interfaces
      length = window:number(offset + 4, 4)
    end
    length = length + -length % 4 -- as Wireshark does it
    local is_there = length >= 12 and window:has(offset, math.min(length, CHUNK))
    local read = BLOCKS[kind]
    if not is_there or read and read(self, window, offset, length, number) then break end
    offset = offset + length
  end
  self.is_live = self.count == 0 and (self.may_carry_yapp or #self.interfaces == 0)
end

-- pcap --------------------------------------------------------------------------------------------

local function read_pcap(self, window, is_little, fractions)
  window.is_little = is_little
  local linktype = window:number(20, 4) % 0x10000 -- above it: the length of check sequences
  local interface, offset = add_interface(self, linktype), 24
  self.keeps = linktype == COOKED_2 or linktype == RTAC -- packets of others have no flags
  self.is_pcap = true
  while offset + 16 <= window.stop or self.keeps and window:has(offset, 16) do
    local seconds, fraction, length = three_numbers(window, offset)
    self.first = self.first or { seconds, floor(fraction * 1e9 / fractions) }
    if self.keeps then
      self.count = self.count + 1
      window:has(offset, 16 + HEADER)
    end
    keep_packet(self, window, interface, offset + 16, 0, seconds + fraction / fractions)
    if self.stamps_differ and not self.keeps then break end
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

-- Return whether all packets are of one bus, also those that were not read: a pcap file tells no
-- other one, and what dumpcap captures begins with all interfaces.  Of a pipe dumpcap hands on the
-- blocks of another program.
local function has_one_bus_for_good(self, head)
  local is_of_dumpcap = sub(head, 1, MAX_SECTION):find("Dumpcap", 1, true)
  return self.is_pcap and not self.keeps or
    is_of_dumpcap and #self.interfaces == 1 and #self.buses == 1
end

-- Set the facts that follow from all that was read.
local function conclude(self, head, has_frame)
  local has_packets, is_one = self.count > 0 or self.stamp, has_one_bus_for_good(self, head)
  self.may_have_frames = has_frame or not has_packets
  self.is_unknown = self.is_unknown or #self.interfaces > 1 and not self.may_carry_yapp
  self.may_add_buses = self.may_carry_yapp and not is_one
  self.has_several = #self.buses > 1 or self.is_live and self.is_cooked
  self.may_be_several = #self.interfaces > 1 or self.has_several or self.is_live and not is_one
end

--- Read the buses of a file.  Of a file without YAPP only the first bytes are read, unless a
-- statistic asks.
-- head  its first bytes, File.HEAD at most
-- more  function(skip, count) -> the next bytes behind so many that are skipped, at most `count`;
--       nil at the end, and where a pipe must be left alone
-- reads_all  true to read a file without YAPP, too
-- returns a file, with these facts, too:
--   has_several      true if it has several buses, or will have them in a live capture
--   may_be_several   true if a short file has several, or may get another one
--   may_add_buses    true if packets that were not read may be of another bus
--   may_have_frames  true if its head may have frames, or it has no packets yet
function File.read(head, more, reads_all)
  local magic, has_frame = sub(head, 1, 4), has_header(head)
  local format = FORMATS[magic]
  local self = setmetatable({
    interfaces = {}, -- of the file
    first_interface = 0, -- number of interfaces in the sections before
    may_carry_yapp = false, -- true if one of them may
    is_cooked = false, -- true if one is Linux cooked v2
    buses = {}, -- list of { interface, name, index }
    uses = {}, -- by name: how many buses have it
    keeps = false, -- true if packets may be of several buses
    bus_by_number = {}, -- of packets; 0 where its interface carries no YAPP
    stamps = {}, -- when they were captured, seconds since 1970; nil not to compare
    is_live = false, -- true if it is pcapng without a packet yet, as when a capture begins
    is_told = format ~= nil, -- true if it is of a format that this module reads
    -- True if it may have buses that this module cannot tell apart: a file of Vector BLF, or pcapng
    -- that was not read to its end and may describe them later, or that has several interfaces of
    -- which none is a bus.
    is_unknown = magic == "LOGG",
    count = 0, -- how many packets were read
    -- List of { time = seconds since 1970 or nil, frame = number of the packet behind the loss or
    -- nil, bus = name or nil, count = packets that were dropped }.
    drops = {},
    stamp = nil, -- of the first packet that was compared
    first = nil, -- { seconds, nanoseconds } since 1970 of the first packet; nil if not known
    lacks_times = false, -- true if packets have no time stamps
    stamps_differ = false, -- true if two of the packets that were read have different ones
    has_serial_frames = false, -- true if packets of a serial line in pcapng may have a frame
  }, File)
  local window = setmetatable({ text = head, start = 0, stop = #head, is_little = true }, Window)
  function window.more(skip, count)
    if self.may_carry_yapp or has_frame or reads_all then return more(skip, count) end
    self.is_unknown = #head >= File.HEAD
  end
  if format then format[1](self, window, format[2], format[3]) end
  conclude(self, head, has_frame)
  return self
end

--- Return the option of tshark that may decode YAPP in the file's serial lines, nil for none.
function File:serial_option()
  for _, interface in ipairs(self.interfaces) do
    local option = interface.link and interface.link.option
    if option then return option end
  end
end

--- Return a function(number, pinfo), which finds the bus of each packet in their order.  It returns
-- the bus, nil where it is not known, as of a CAN frame inside Ethernet; and whether it
-- is known.  A read filter shifts the numbers: once a packet is another than the file's, all that
-- follow are.
-- compares_times  true if pinfo.abs_ts is when the packet was captured
-- later           function(number): the same for packets that were not read
function File:bus_finder(compares_times, later)
  local is_shifted, bus_by_number, stamps = false, self.bus_by_number, self.stamps
  return function(number, pinfo)
    if number > self.count then return later(number) end
    local bus, stamp = bus_by_number[number], compares_times and stamps[number]
    if stamp and math.abs(pinfo.abs_ts - stamp) > SAME_TIME then bus = nil end
    is_shifted = is_shifted or not bus
    if is_shifted or bus == 0 then return nil, false end
    return bus, true
  end
end

--- Wireshark's fields that tell the bus of a packet; its number shows whether any can be seen.
File.FIELDS = "frame.number frame.interface_id frame.interface_name frame.section_number " ..
  "frame.packet_flags_direction sll.ifindex rtacser.eventtype"

-- Return the interface of a packet that was not read.
local function interface_by_fields(self, fields)
  local number, name = fields["frame.interface_id"] or 0, fields["frame.interface_name"]
  local interface = self.interfaces[number + 1] or
    new_interface(number, nil, name ~= "unknown" and name or nil)
  self.interfaces[number + 1] = interface
  return interface
end

--- Return the bus of a packet that was not read, nil where its fields do not tell it: in a later
-- section interfaces are numbered anew.
-- fields  values of File.FIELDS, by name
function File:bus_by_fields(fields)
  local index, event = fields["sll.ifindex"], fields["rtacser.eventtype"]
  if not (fields["frame.interface_id"] or index or event) then return nil end
  if (fields["frame.section_number"] or 1) > 1 then return nil end
  local interface = interface_by_fields(self, fields)
  if event then
    index = EVENT_DIRECTIONS[event] or "tx"
  elseif interface.is_serial then
    index = index_by_flags(nil, fields["frame.packet_flags_direction"] or 0)
  end
  return bus_number(self, interface, index or 0)
end

-- Return the name of a bus.  If several buses have the name of its interface, or may have it in a
-- live capture, "#" and its index follow, or the number of the interface.
local function bus_name(self, bus)
  local name, index = bus.name, bus.index ~= 0 and bus.index
  local may_be_several = self.is_live and type(bus.index) == "number" and index
  if self.uses[name] < 2 and not may_be_several then return name end
  return name .. "#" .. (index or bus.interface.number)
end

--- Return the name of a bus, nil where the file has none.
-- bus  nil where the file has one
function File:name(bus)
  local one = self.buses[bus or 1]
  if bus then return one and bus_name(self, one) end
  if not one or self.has_several or self.is_unknown then return nil end
  return self.is_live and one.index ~= 0 and bus_name(self, one) or one.interface.name
end

return File
