-- SPDX-License-Identifier: GPL-2.0-or-later
-- The bus on which a packet was captured, and the packets that the capture dropped.
-- Wireshark's API.
--
-- The file tells it (host.capture), or the reader of ours that reads the file.  In a live capture,
-- and in a pipe behind its first bytes, fields of the packet tell it: a tap makes Wireshark build
-- the tree that has these.

local capture = require "yapp.host.capture"
local file_readers = require "yapp.file.readers"
local socketcan = require "yapp.host.socketcan"

local M = {}

local FIELDS = "frame.interface_id || frame.interface_name || frame.section_number || " ..
  "sll.ifindex || rtacser.eventtype || frame.packet_flags_direction"
local NAMES = {}
for name in FIELDS:gmatch("[%w_.]+") do NAMES[name] = true end
local IS_TSHARK = not gui_enabled()
local IS_WINDOWS = package.config:sub(1, 1) == "\\"

local Buses = {}
Buses.__index = Buses

local MAX_FREE = 8 -- numbers of files in a row: a new file gets the lowest that is free

-- Return the read positions of all open files of this process, as one text.  Linux tells them; on
-- macOS /dev/fd/N is the open file itself.
local function positions()
  local list, free = {}, 0
  for number = 3, 63 do
    local info = io.open("/proc/self/fdinfo/" .. number)
    local file = info or io.open("/dev/fd/" .. number)
    list[#list + 1] = info and info:read("*l") or file and file:seek()
    if file then file:close() end
    free = file and 0 or free + 1
    if free == MAX_FREE then break end
  end
  return table.concat(list, " ")
end

-- Read the first bytes of a capture.
-- returns  the bytes; true if it is a file: more of a pipe must not be read, as Wireshark cannot
--          rewind it further.  In tshark, the read of a file moves the position of an open file;
--          and why they cannot be read, nil if they can
local function read_head(file)
  local before = positions()
  local head, why = file:read(capture.HEAD)
  return head or "", not IS_TSHARK or IS_WINDOWS or positions() ~= before, why
end

--- Look at the head of each file from now on.  Call it once.
function M.watch()
  local self = setmetatable({ seen = capture.read("", function() end) }, Buses)
  -- Register a reader that opens no file: only a reader's read_open is shown the file.  Give both
  -- arguments a name, so that Lua keeps them: Wireshark writes into both when read_open is back.
  local handler = FileHandler.new("YAPP reads heads of files (opens none)", "yapp_head",
    "Looks at the headers", "rms")
  function handler.read_open(file, _)
    self.has_seen_file = true
    local head, is_file, why = read_head(file)
    local function more(skip, count)
      if not is_file then return nil end
      if skip > 0 then file:seek("cur", skip) end
      local bytes, problem = file:read(count)
      why = why or problem
      return bytes
    end
    self.seen = capture.read(head, more)
    self.is_short = #head < capture.HEAD
    self.is_long_pipe = not (self.is_short or is_file)
    self.is_damaged = why ~= nil -- as a compressed file that was cut off
    file_readers.forget()
    return false
  end
  function handler.read() return false end
  function handler.seek_read() return false end
  register_filehandler(handler)
  self:init()
  return self
end

-- The bus by the fields of the current packet; nil where they do not tell it.
local function bus_by_fields(found)
  local fields = socketcan.fields_of(NAMES)
  local interface, index = fields["frame.interface_id"], fields["sll.ifindex"]
  local event, name = fields["rtacser.eventtype"], fields["frame.interface_name"]
  if not (interface or index or event) then return nil end
  if name == "unknown" then name = nil end
  local section = fields["frame.section_number"] or 1
  local direction = fields["frame.packet_flags_direction"]
  return found:bus_by_fields(section, interface or 0, index or 0, event, name, direction)
end

-- Find the bus of a packet behind those that were read when the file was opened.
-- returns  as find_bus
local function find_later(self, number)
  local bus = self.kept[number] or bus_by_fields(self.found)
  -- The bus that was the only one when the file was opened stays without a number.
  if not self.found.has_several and (bus or 1) == 1 then return nil, true end
  self.kept[number] = bus
  return bus, bus ~= nil
end

-- The least offset of CAN data inside an Ethernet frame (IEEE 1722): it is of that one's interface,
-- which is known if it is the only one.
local IN_ETHERNET = 42

-- Find the bus of a packet, see Buses:init.
-- in_file  of Capture:bus_finder
local function find_bus(self, in_file, number, offset, pinfo)
  local found, bus, name = self.found, nil, nil
  if not found.is_told then bus, name = file_readers.current() end
  if bus then
    found.names[bus] = name
    return bus, true
  end
  if found.has_several then return in_file(number, offset, pinfo) end
  if number > found.count and self.tap then return find_later(self, number) end
  local is_inside = offset >= IN_ETHERNET and found.carriers < 2
  return nil, not found.is_unknown or is_inside
end

-- Return whether fields tell the bus of packets behind those that were read.
local function are_fields_needed(self)
  local found = self.found
  -- A short file may be of a live capture that already had packets when it was opened.
  local may_go_on = self.is_short and found.has_several or found.is_live
  local is_open = self.is_long_pipe and found.yapp_interfaces > 0
  return may_go_on or is_open or self.is_damaged or self:missed_file()
end

-- Return which time of a packet to use, and that of the first packet.  If this has no time
-- stamp, pinfo.rel_ts is of no use: 4.0 counts from 1970, 4.4 and 4.6 say 0.
local function clock_of(found)
  if found.start then return "abs_ts", found.start end
  return "rel_ts", 0
end

--- Use the file that was seen last: it is about to be dissected.  Files seen before it did not
-- open, or were only previewed in a file dialog.
function Buses:init()
  local found = self.seen
  self.found = found
  self.plain_bus = file_readers.log().plain_bus
  self.time_name, self.start = clock_of(found)
  self.kept = {} -- [number of a packet] = its bus, as fields told it: later there may be no tree
  local needs_fields = are_fields_needed(self)
  self.bus_is_per_packet = needs_fields or found.has_several or
    not (found.is_told or self.plain_bus)
  if needs_fields then
    self.tap = self.tap or Listener.new("frame", FIELDS)
  elseif self.tap then
    self.tap:remove()
    self.tap = nil
  end
  local in_file = found:bus_finder(IS_TSHARK, function(number) return find_later(self, number) end)
  local is_all_told = found.is_told and found.has_several and not self.tap
  --- Return where the current packet was captured.
  -- number   of the packet, which Wireshark need not be asked for again
  -- offset   of the bytes in the packet
  -- returns  the number of its bus, nil if the capture has only one or nothing tells it; and
  --          true if the bus is known
  self.of = is_all_told and in_file or function(number, offset, pinfo)
    return find_bus(self, in_file, number, offset, pinfo)
  end
end

--- Return whether the capture was opened before the plugin was loaded: Wireshark loaded its Lua
-- plugins again.  Then fields tell the bus, and nothing tells of dropped packets.
function Buses:missed_file()
  return not (IS_TSHARK or self.has_seen_file)
end

--- Return whether the capture is a regular file, and longer than its first bytes.
function Buses:has_more_to_read()
  return not (self.is_short or self.is_long_pipe)
end

--- Return whether the capture is known to have several buses.
function Buses:are_several()
  return self.found.has_several or file_readers.log().has_several
end

--- Return the packets that the capture dropped: a list of { time = seconds since 1970
-- or nil, frame = number of the packet behind the loss or nil, bus = name or nil, count }.
function Buses:drops()
  local drops = self.found.drops
  return drops[1] and drops or file_readers.log().drops or {}
end

--- Return whether packets of the capture have time stamps, and whether these tell when packets were
-- captured: those of controllers do not.  A reader of ours knows it with the first packet.
function Buses:has_times()
  local found = self.found
  local has_times = not found.lacks_times
  if found.is_told then return has_times, has_times end -- no reader of ours reads it
  local log = file_readers.log()
  has_times = has_times and not log.lacks_times
  return has_times, has_times and not log.lacks_clock
end

--- Return whether the first packets of the file have different time stamps: then these mean
-- something.
function Buses:stamps_differ()
  return self.found.stamps_differ or file_readers.log().stamps_differ or false
end

--- Return the seconds from the first time stamp of the capture to the current packet.
function Buses:time(pinfo)
  return pinfo[self.time_name] - self.start
end

--- Return the name of a bus.
-- bus      its number; nil where the capture has one or tells none apart
-- is_ip    true if the packet came in UDP or TCP, so by any interface
-- returns  text, or nil where the capture names none
function Buses:name(bus, is_ip)
  return self.found:name(bus, is_ip) or not bus and self.plain_bus or nil
end

return M
