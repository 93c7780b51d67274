-- SPDX-License-Identifier: GPL-2.0-or-later
-- What a capture file says of its packets: the bus of each, what buses are called, how many packets
-- were dropped while capturing, and whether YAPP may be in it.  Pure Lua.
--
-- Wireshark does not tell a dissector the interface of a packet.  The file does: this module reads
-- the headers of the blocks of pcapng and of the records of pcap.
--
-- A bus is an interface, an index in it (Linux cooked v2), or a direction in it (RTAC).  Buses that
-- may carry YAPP are numbered from 1 in the order in which they show.

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

-- Link types whose packets may carry YAPP: SocketCAN, exported PDUs, DLT_USER 0 .. 15.
local SOCKETCAN = 227
local CARRIERS = { [SOCKETCAN] = true, [252] = true }
for linktype = 147, 162 do CARRIERS[linktype] = true end

-- Link types of which each packet tells its bus: RTAC serial, Linux cooked captures.
local RTAC, COOKED, COOKED_2 = 250, 113, 276
local IS_CAN = { ["\0\12"] = true, ["\0\13"] = true } -- protocols: CAN and CAN FD
local DIRECTION = { 0, 1, 0, 1 } -- of an RTAC packet by its event
local DIRECTION_NAMES = { [0] = "tx", "rx" }

-- By link type: function(head) -> index and direction of a packet's bus, by its first 16 bytes; nil
-- for a packet that carries no YAPP.
local BUS_OF = {
  [RTAC] = function(head) return 0, DIRECTION[byte(head, 9)] or 0 end,
  [COOKED] = function(head)
    if IS_CAN[sub(head, 15, 16)] then return 0, 0 end
  end,
  [COOKED_2] = function(head)
    if not IS_CAN[sub(head, 1, 2)] or #head < 16 then return nil end
    local a, b, c, d = byte(head, 5, 8)
    return a * 0x1000000 + b * 0x10000 + c * 0x100 + d, 0
  end,
}

local TIMES = 2 ^ 40 -- microseconds that are told apart: 12 days, see Capture:bus

-- The bytes of a file -----------------------------------------------------------------------------

local Window = {}
Window.__index = Window

function Window:bytes(offset, count)
  return sub(self.text, offset - self.start + 1, offset - self.start + count)
end

-- The number that bytes are; of 8 bytes it has a sign.
local function number_of(bytes, is_little)
  if is_little then bytes = bytes:reverse() end
  local number = #bytes == 8 and byte(bytes) > 127 and -1 or 0
  for i = 1, #bytes do number = number * 0x100 + byte(bytes, i) end
  return number
end

function Window:number(offset, count)
  return number_of(self:bytes(offset, count), self.is_little)
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

-- How the option epb_dropcount, of 8 bytes, begins in either byte order.
local DROPS_LITTLE, DROPS_BIG = "\4\0\8\0", "\0\4\0\8"

-- Notes whether epb_dropcount may be among the bytes at hand, which costs less than to read the
-- options of each block.
local function look_for_drops(window)
  local option = window.is_little and DROPS_LITTLE or DROPS_BIG
  window.may_have_drops = find(window.text, option, 1, true) ~= nil
end

-- Makes `count` bytes, at most CHUNK, at an offset available; skips what lies in front of them.
-- returns  whether they are there
function Window:has(offset, count)
  if offset + count <= self.stop then return true end
  local more = self.more(max(0, offset - self.stop), CHUNK)
  if not more then return false end
  self.text = self:bytes(offset, CHUNK) .. more
  self.start, self.stop = offset, offset + #self.text
  look_for_drops(self)
  return offset + count <= self.stop
end

-- Buses -------------------------------------------------------------------------------------------

local Capture = {}
Capture.__index = Capture

local function base_name(bus)
  return bus.interface.name or "if" .. bus.interface.number
end

-- Gives a bus a name that no other has.
-- is_shared  whether the name of its interface stands for several: then "#" and what tells them
--            apart follow
local function name_bus(self, number, is_shared)
  local bus = self.buses[number]
  local name = base_name(bus)
  if is_shared then name = name .. "#" .. bus.suffix end
  while self.is_taken[name] do name = name .. "#" .. bus.suffix end
  self.is_taken[name], self.names[number] = true, name
end

-- Names the buses of a file that was read.
local function name_buses(self)
  local uses = {}
  for _, bus in ipairs(self.buses) do
    local name = base_name(bus)
    uses[name] = (uses[name] or 0) + 1
  end
  for number, bus in ipairs(self.buses) do name_bus(self, number, uses[base_name(bus)] > 1) end
end

-- The number of a bus, which may be new.
-- index, direction  0 where its packets have none
local function bus_number(self, interface, index, direction)
  local key = interface.number * 2 ^ 33 + index * 2 + direction
  local number = self.bus_numbers[key]
  if not number then
    number = #self.buses + 1
    local suffix = index > 0 and index or interface.number
    if interface.linktype == RTAC then suffix = DIRECTION_NAMES[direction] end
    self.buses[number] = { interface = interface, suffix = suffix }
    self.bus_numbers[key] = number
  end
  return number
end

-- Keeps the bus of the latest packet, and when it was captured.
-- offset   of its data
-- seconds  since 1970
local function keep_bus(self, window, interface, offset, seconds)
  local bus = interface.bus
  if not bus then
    local index, direction = BUS_OF[interface.linktype](window:bytes(offset, 16))
    bus = index and bus_number(self, interface, index, direction) or 0
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

-- A number in an option; 0 where it is missing.
local function option_number(window, option)
  return option and number_of(option, window.is_little) or 0
end

-- Time units in a second, by the option if_tsresol.
local function units_per_second(option)
  local exponent = option and byte(option) or 6
  return exponent < 128 and 10 ^ exponent or 2 ^ (exponent - 128)
end

-- The functions from here on read a block, which is there as far as it is no longer than CHUNK.
-- They return true where what follows is not to be read.


local function read_interface(self, window, offset, length)
  if length < 20 then return true end
  local linktype = window:number(offset + 8, 2)
  local options = read_options(window, offset + 16, offset + length - 4)
  local name = (options[2] or ""):match("^[^\0]*")
  local interface = {
    number = #self.interfaces, -- in the file
    linktype = linktype,
    name = name ~= "" and utf8.name(name) or nil,
    per_second = units_per_second(options[9]),
    shift = option_number(window, options[14]), -- seconds to add to its times
    bus = 0, -- of its packets; nil where each tells it
    dropped = 0, -- packets, as the statistics say
    accounted = 0, -- of them, as packets say
  }
  self.interfaces[#self.interfaces + 1] = interface
  local is_mixed = BUS_OF[linktype] ~= nil
  if not (is_mixed or CARRIERS[linktype]) then return end
  self.carriers = self.carriers + 1
  interface.bus = not is_mixed and bus_number(self, interface, 0, 0) or nil
  if not self.keeps then self.early = self.count end
  self.keeps = is_mixed or self.carriers > 1
end

-- Reads a packet: an enhanced block, or one of the obsolete kind.
local function read_packet(self, window, offset, length, is_obsolete)
  self.count = self.count + 1
  local may_have_drops = window.may_have_drops or is_obsolete
  if not (self.keeps or may_have_drops) then return end -- the usual case
  if length < 32 then return true end
  local number, high, low = three_numbers(window, offset + 8)
  local drops = 0
  if is_obsolete then
    number = window:number(offset + 8, 2)
    drops = window:number(offset + 10, 2) % 0xFFFF -- 0xFFFF: not known
  end
  local interface = self.interfaces[self.first + number + 1]
  if not interface then return true end
  local seconds = (high * 2 ^ 32 + low) / interface.per_second + interface.shift
  if self.keeps then keep_bus(self, window, interface, offset + 28, seconds) end
  if may_have_drops then
    local captured = window:number(offset + 20, 4)
    local start = offset + 28 + captured + -captured % 4
    local options = read_options(window, start, offset + length - 4)
    drops = max(drops, option_number(window, options[4]))
  end
  if drops == 0 then return end
  interface.accounted = interface.accounted + drops
  self.losses[#self.losses + 1] =
    { time = seconds, frame = self.count, interface = interface, count = drops }
end

local function read_obsolete_packet(self, window, offset, length)
  return read_packet(self, window, offset, length, true)
end

-- A simple block: a packet of the section's first interface, without a time.
local function read_simple_packet(self, window, offset)
  self.count, self.has_no_times = self.count + 1, true
  local interface = self.interfaces[self.first + 1]
  if not interface then return true end
  if self.keeps then keep_bus(self, window, interface, offset + 12, 0) end
end

-- Reads how many packets an interface, or its operating system, dropped so far.
local function read_statistics(self, window, offset, length)
  local interface = self.interfaces[self.first + window:number(offset + 8, 4) + 1]
  if not interface then return end
  local options = read_options(window, offset + 20, offset + length - 4)
  interface.dropped = max(interface.dropped, option_number(window, options[5]),
    option_number(window, options[7]))
end

local function count_packet(self)
  self.count = self.count + 1
end

local function stop_reading()
  return true
end

local BLOCKS = {
  [1] = read_interface,
  [2] = read_obsolete_packet,
  [3] = read_simple_packet,
  [5] = read_statistics,
  [6] = read_packet,
  -- Wireshark gives these a frame number, too: of the systemd journal, custom, events of sysdig.
  [9] = count_packet,
  [0x00000BAD] = count_packet,
  [0x40000BAD] = count_packet,
  [0x204] = count_packet,
  [0x216] = count_packet,
  [0x221] = count_packet,
  -- Wireshark 4.6 gives these a frame number, 4.4 does not: further events of sysdig.
  [0x208] = stop_reading,
  [0x217] = stop_reading,
  [0x222] = stop_reading,
}

local SECTION = 0x0A0D0D0A

-- Begins a section, which has its own byte order and numbers its interfaces from 0.
-- returns  the length of its block
local function read_section(self, window, offset)
  window.is_little = window:bytes(offset + 8, 4) == "\77\60\43\26"
  look_for_drops(window)
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
    if read and read(self, window, offset, length) then break end
    offset = offset + length
  end
end

-- pcap --------------------------------------------------------------------------------------------

local function read_pcap(self, window, is_little, fractions)
  window.is_little = is_little
  if not window:has(0, 24) then return end
  local linktype = window:number(20, 4) % 0x10000 -- above it, what is said of check sequences
  self.place = linktype == SOCKETCAN and 8 or nil
  self.has_packets = window:has(24, 16)
  if linktype ~= COOKED_2 and linktype ~= RTAC then return end
  local interface = { number = 0, linktype = linktype }
  self.carriers = 1
  local offset = 24
  while window:has(offset, 16) do
    local seconds, fraction, length = three_numbers(window, offset)
    if length > MAX_BLOCK then break end
    self.count = self.count + 1
    window:has(offset, 32)
    keep_bus(self, window, interface, offset + 16, seconds + fraction / fractions)
    offset = offset + 16 + length
  end
end

-- By the first four bytes of a file.
local READERS = {
  ["\212\195\178\161"] = function(self, window) read_pcap(self, window, true, 1e6) end,
  ["\161\178\195\212"] = function(self, window) read_pcap(self, window, false, 1e6) end,
  ["\77\60\178\161"] = function(self, window) read_pcap(self, window, true, 1e9) end,
  ["\161\178\60\77"] = function(self, window) read_pcap(self, window, false, 1e9) end,
  ["\10\13\13\10"] = read_pcapng,
}

-- What is known of a capture ----------------------------------------------------------------------

-- Whether bytes have what may be the header of a YAPP frame.
local function has_header(bytes)
  local start = frame.find(bytes, 1)
  while start do
    if frame.judge(bytes, start, function() return true end) then return true end
    start = frame.find(bytes, start + 1)
  end
  return false
end

-- The packets that were dropped, as Capture.drops lists them.
local function list_drops(self)
  local drops = {}
  local function add(interface, count, time, number)
    local bus = self.has_several and self.names[interface.bus] or interface.name
    drops[#drops + 1] = { time = time, frame = number, bus = bus, count = count }
  end
  for _, loss in ipairs(self.losses) do add(loss.interface, loss.count, loss.time, loss.frame) end
  for _, interface in ipairs(self.interfaces) do
    local rest = interface.dropped - interface.accounted
    if rest > 0 then add(interface, rest) end
  end
  return drops
end

--- Read a file as far as it may have YAPP: of somebody else's no more than its first bytes.
-- head  its first bytes, M.HEAD at most
-- more  function(skip, count) -> the next bytes behind so many that are skipped, at most `count`;
--       nil at the end, and where a pipe must be left alone
-- returns a capture: {
--   carriers      number of interfaces that may carry YAPP
--   has_several   whether it tells several buses apart
--   is_live       whether it is pcapng without a packet yet, as when a capture begins
--   is_told       whether it is of a format that this module reads
--   is_unknown    whether it has buses that this module cannot tell: a file of Vector BLF
--   count         how many packets were read
--   names         [bus] = its name
--   drops         list of { time = seconds since 1970 or nil, frame = number of the packet behind
--                 the loss or nil, bus = name or nil, count = packets that were dropped }
--   has_no_times  whether packets have no time stamps
--   place         offset in each packet of a CAN frame's data; nil where it is not always the same
--   head          its first bytes, if they have what may be YAPP frames, in TCP, UDP or whatever
--   may_have_frames  whether they have, or it has no packets yet }
function M.read(head, more)
  local has_frame = has_header(head)
  local self = setmetatable({
    carriers = 0,
    count = 0,
    early = 0, -- packets in front of the second interface: those that may be YAPP's are of bus 1
    keeps = false, -- whether the buses of packets are wanted
    entries = {}, -- [number of a packet] = its bus * TIMES + when it was captured
    interfaces = {}, -- of the file
    first = 0, -- number of interfaces in the sections before
    firsts = {}, -- by section
    buses = {}, -- { interface, suffix = what tells it from others in its interface }
    bus_numbers = {}, -- by interface, index and direction
    names = {},
    is_taken = {}, -- by name
    losses = {},
    has_no_times = false,
    has_packets = false,
  }, Capture)
  local window = setmetatable({ text = head, start = 0, stop = #head, is_little = true }, Window)
  function window.more(skip, count)
    if self.carriers > 0 or has_frame then return more(skip, count) end
  end
  local reader = READERS[sub(head, 1, 4)]
  if reader then reader(self, window) end
  name_buses(self)
  local has_packets = self.has_packets or self.count > 0
  self.is_told = reader ~= nil
  self.is_unknown = sub(head, 1, 4) == "LOGG"
  self.has_several = #self.buses > 1
  self.is_live = reader == read_pcapng and not has_packets and
    (self.carriers > 0 or #self.interfaces == 0)
  self.head = has_frame and has_packets and head or nil
  self.may_have_frames = has_frame or not has_packets
  self.drops = list_drops(self)
  if not self.has_several then self.entries = {} end
  return self
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
  return floor(entry / TIMES)
end

--- Return the bus of a packet that was not read, by what Wireshark's fields say.
-- section    its number, from 1
-- interface  its number in the section
-- index      of Linux cooked v2, 0 for none; event: of RTAC, or nil
-- name       of the interface, or nil
-- returns    a bus; nil where the section was not read
function Capture:bus_by_fields(section, interface, index, event, name)
  local first = self.firsts[section] or section == 1 and 0
  if not first then return nil end
  local number = first + interface
  local record = self.interfaces[number + 1] or { number = number, name = name and utf8.name(name) }
  self.interfaces[number + 1] = record
  local bus = bus_number(self, record, index, DIRECTION[event] or 0)
  if not self.names[bus] then name_bus(self, bus) end
  return bus
end

--- Return what a bus is called.
-- bus      nil where the capture has one
-- is_ip    whether the packet came in UDP or TCP, so by any interface
-- returns  text, nil where the capture has no name for it
function Capture:name(bus, is_ip)
  if bus then return self.names[bus] end
  local only = not is_ip and not self.has_several and self.buses[1]
  local interface = only and only.interface or self.interfaces[1]
  if only or #self.interfaces == 1 then return interface and interface.name end
end

return M
