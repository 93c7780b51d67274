-- SPDX-License-Identifier: GPL-2.0-or-later
-- What the first bytes of a capture file say about the rest.  Pure Lua, 5.2 and 5.4.

local frame = require("yapp.wire.frame")
local utf8 = require("yapp.base.utf8")

local M = {}

--- How many bytes to look at: within what Wireshark can rewind on a pipe (128 KB on 4.0).
M.LENGTH = 65536

-- Link types: SocketCAN, exported PDUs, RTAC serial, DLT_USER 0 .. 15, and Linux cooked captures, whose packets have
-- the protocol at this offset: 0x000C for CAN, 0x000D for CAN FD.
local LINKTYPE_SOCKETCAN, LINKTYPE_SLL2, LINKTYPE_RTAC = 227, 276, 250
local SOCKETCAN_HEADER = 8 -- bytes
local OURS = { [LINKTYPE_SOCKETCAN] = true, [252] = true, [LINKTYPE_RTAC] = true }
for linktype = 147, 162 do OURS[linktype] = true end
local PROTOCOL = { [113] = 14, [LINKTYPE_SLL2] = 0 }

-- Block types of pcapng, and options of an interface
local SECTION, INTERFACE, ENHANCED, SIMPLE, OLD = 0x0A0D0D0A, 1, 6, 3, 2
local IF_NAME, END_OF_OPTIONS = 2, 0

local function number(head, at, size, little)
  local value = 0
  for i = 0, size - 1 do
    local byte = head:byte(little and at + size - 1 - i or at + i)
    if not byte then return nil end
    value = value * 0x100 + byte
  end
  return value
end

-- Whether a packet of this link type may be ours.
local function is_ours(linktype, head, at)
  local offset = PROTOCOL[linktype]
  local protocol = offset and number(head, at + offset, 2)
  return OURS[linktype] or protocol == 0x0C or protocol == 0x0D
end

local function read_pcap(head, little)
  local linktype = (number(head, 21, 4, little) or 0) % 0x10000 -- above it, what is said of frame check sequences
  local found, at = { packets = #head > 40, sources = linktype == LINKTYPE_RTAC }, 25
  found.place = linktype == LINKTYPE_SOCKETCAN and SOCKETCAN_HEADER or nil
  found.later = linktype == LINKTYPE_SLL2
  while found.later and not found.sources do
    local length = number(head, at + 8, 4, little)
    if not length then break end
    found.sources = is_ours(linktype, head, at + 16)
    at = at + 16 + length
  end
  return found
end

-- The name of an interface, from its block's options; nil without one that can be shown.
-- at, stop  1-based: where the options begin, and where the block ends
local function interface_name(head, at, stop, little)
  while at + 4 <= stop do
    local option, length = number(head, at, 2, little), number(head, at + 2, 2, little)
    if not length or option == END_OF_OPTIONS or at + 4 + length > stop then return nil end
    if option == IF_NAME then
      local name = head:sub(at + 4, at + 3 + length):match("^[^\0]*")
      return #name > 0 and utf8.is_printable(name) and name or nil
    end
    at = at + 4 + length + -length % 4
  end
end

-- An interface of a pcapng file.
local function note_interface(found, head, at, length, little)
  local id, linktype = found.count, number(head, at + 8, 2, little)
  found.count = id + 1
  found.linktypes[id] = linktype or -1
  if OURS[linktype] then found.ours, found.only = found.ours + 1, id end
  found.may_be_ours = found.may_be_ours or OURS[linktype] or PROTOCOL[linktype] ~= nil
  found.sources = found.sources or linktype == LINKTYPE_RTAC or found.ours > 1
  if found.sections > 1 then return end -- the numbers begin again there
  found.interfaces[id] = linktype
  found.names[id] = interface_name(head, at + 16, at + length - 4, little)
end

-- A packet of a pcapng file: on a cooked capture it says whether its interface is one of ours.
local function note_packet(found, head, at, little)
  local id = number(head, at + 8, 4, little)
  local linktype = found.linktypes[id]
  if PROTOCOL[linktype] and is_ours(linktype, head, at + 28) then
    found.ours, found.linktypes[id], found.only = found.ours + 1, -1, id -- once
    found.sources = found.sources or linktype == LINKTYPE_SLL2 or found.ours > 1
  end
end

local function read_pcapng(head)
  local little = head:sub(9, 12) == "\77\60\43\26"
  local found = { packets = false, sources = false, later = true, interfaces = {}, names = {},
    count = 0, sections = 0, linktypes = {}, ours = 0 }
  local at = 1
  while true do
    local kind, length = number(head, at, 4, little), number(head, at + 4, 4, little)
    if not length or length < 12 then break end
    if kind == SECTION then
      found.sections = found.sections + 1
    elseif kind == INTERFACE then
      note_interface(found, head, at, length, little)
    elseif kind == ENHANCED then
      note_packet(found, head, at, little)
    end
    found.packets = found.packets or kind == ENHANCED or kind == SIMPLE or kind == OLD
    at = at + length
  end
  -- A pipe's interfaces may come after tshark has opened what was captured of it.
  found.begins = not found.packets and (found.count == 0 or found.may_be_ours)
  return found
end

local READERS = {
  ["\212\195\178\161"] = function(head) return read_pcap(head, true) end,
  ["\161\178\195\212"] = function(head) return read_pcap(head, false) end,
  ["\77\60\178\161"] = function(head) return read_pcap(head, true) end, -- nanoseconds
  ["\161\178\60\77"] = function(head) return read_pcap(head, false) end,
  ["\10\13\13\10"] = read_pcapng,
  ["LOGG"] = function() return { packets = true, sources = true } end, -- Vector BLF, of a CAN logger
}

local function any() return true end

-- Whether a plausible header of a YAPP frame is there.
local function has_header(head)
  local at = frame.find(head, 1)
  while at do
    if frame.judge(head, at, any) then return true end
    at = frame.find(head, at + 1)
  end
  return false
end

-- The name of a bus in a line of candump text: with or without a time, with a direction. Which lines are candump's
-- is told elsewhere; this is asked for lines of any text.
local BUS_IN = {
  "^%s*%([^()]+%)%s+(%S+)%s+%x+[#%s]", "^%s*(%S+)%s+%x+%s+[%[{]%x+[%]}]",
  "^[^[{]-(%S+)%s+[RT]X [B-] [E-]%s+%x+%s+[%[{]",
}

local LONGEST_START = 300 -- of a line: no bus stands behind it, and a long line without blanks would cost its square

local function bus_in(line)
  for _, pattern in ipairs(BUS_IN) do
    local bus = line:match(pattern)
    if bus then return bus end
  end
end

-- Whether a text has several buses, as candump writes them.
local function has_several_buses(head)
  local first
  if head:find("\0", 1, true) then return false end
  for line in head:gmatch("[^\r\n]+") do
    local bus = bus_in(line:sub(1, LONGEST_START))
    if bus and first and bus ~= first then return true end
    first = first or bus
  end
  return false
end

--- Reads a file's first bytes.
-- head     string
-- returns  { sources = whether the packets have several buses, interfaces or directions that the file tells apart,
--            later = whether what follows these bytes may have such; begins = whether a live capture of ours may have
--              just begun: a pcapng file without a packet yet;
--            place = where in each packet the data of its CAN frame begins, nil where that is not the same for all,
--            frames = whether YAPP frames may be in it: not when it has packets and none of the first has one,
--            interfaces = { [id] = link type }, of a pcapng file; names = { [id] = the name that the file gives it },
--              only names that can be shown (UTF-8, no control characters);
--            name = that of the only interface, nil where there are several; own_name = that of the only one of ours,
--            several_buses = whether candump text has more than one }
function M.read(head)
  local reader = READERS[head:sub(1, 4)]
  local found = reader and reader(head) or {}
  return {
    sources = found.sources or false,
    begins = found.begins or false,
    place = found.place,
    later = found.later ~= false and (#head == M.LENGTH or not found.packets),
    frames = not found.packets or has_header(head),
    interfaces = found.interfaces or {},
    names = found.names or {},
    name = found.count == 1 and found.names[0] or nil,
    own_name = found.ours == 1 and found.names[found.only] or nil,
    several_buses = not reader and has_several_buses(head),
  }
end

return M
