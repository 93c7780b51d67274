-- SPDX-License-Identifier: GPL-2.0-or-later
-- What is known of the packets of a capture: the bus of each, whether their times are real, and how
-- many were lost.  No other module looks for that.  Wireshark's API.
--
-- The file tells it (capture.file), or the reader of ours that reads the file.  In a live capture,
-- and in a pipe behind its first bytes, fields of the packet tell its bus: a tap makes Wireshark
-- build the tree that has these.

local command_line = require "yapp.capture.command_line"
local ending = require "yapp.capture.ending"
local fields_of = require "yapp.capture.fields"
local stamps_of = require "yapp.capture.stamps"
local file_readers = require "yapp.file.readers"
local files = require "yapp.capture.file"

local M = {}

local FIELDS = "frame.interface_id || frame.interface_name || frame.section_number || " ..
  "sll.ifindex || rtacser.eventtype || frame.packet_flags_direction"
local NAMES = {}
for name in FIELDS:gmatch("[%w_.]+") do NAMES[name] = true end
local IS_TSHARK = not gui_enabled()
local IS_WINDOWS = package.config:sub(1, 1) == "\\"
local TOO_FAR = 2 ^ 62 -- offset that no file has
local SAME_TIME = 2e-6 -- seconds

local Capture = {}
Capture.__index = Capture

-- Return whether more than the first bytes may be read: Wireshark rewinds a file, a pipe no further
-- than these.  Two passes need a file, where a seek too far fails at once.  Of one pass a name with
-- an extension shows it; a file that is taken for a pipe is dissected alike, but slower.
local function is_file(file)
  if not IS_TSHARK or IS_WINDOWS then return true end
  local options = command_line.options()
  local path = options.r or options["read-file"] or ""
  return path:find("%.%w+$") ~= nil or not file:seek("set", TOO_FAR)
end

--- Look at the head of each file from now on.  Call it once.
function M.watch()
  local seen = files.read("", function() end)
  local self = setmetatable({ seen = seen, stamps = stamps_of.new() }, Capture)
  -- Register a reader that opens no file: only a reader's read_open is shown the file.  Give both
  -- arguments a name, so that Lua keeps them: Wireshark writes into both when read_open is back.
  local handler = FileHandler.new("YAPP reads heads of files (opens none)", "yapp_head",
    "Looks at the headers", "rms")
  function handler.read_open(file, _)
    local head, why = file:read(files.HEAD)
    head = head or ""
    self.is_short = #head < files.HEAD
    local may_read = not self.is_short and is_file(file)
    file:seek("set", #head)
    local function more(skip, count)
      if not may_read then return nil end
      if skip > 0 then file:seek("cur", skip) end
      local bytes, problem = file:read(count)
      why = why or problem
      return bytes
    end
    self.seen = files.read(head, more)
    self.has_seen_file = true
    self.is_long_pipe = not (self.is_short or may_read)
    self.is_damaged = why ~= nil -- as a compressed file that was cut off
    file:seek("set", 0)
    self.seen.is_cut = (self.is_short or may_read) and ending.is_cut(file)
    file_readers.forget()
    return false
  end
  function handler.read() return false end
  function handler.seek_read() return false end
  register_filehandler(handler)
  self:init()
  return self
end

-- The bus by the fields of the current packet; nil where they do not tell it: in a later section
-- interfaces are numbered anew.
local function bus_by_fields(found)
  local fields = fields_of(NAMES)
  local interface, index = fields["frame.interface_id"], fields["sll.ifindex"]
  local event, name = fields["rtacser.eventtype"], fields["frame.interface_name"]
  if not (interface or index or event) or (fields["frame.section_number"] or 1) > 1 then return end
  if name == "unknown" then name = nil end
  local direction = fields["frame.packet_flags_direction"]
  return found:bus_by_fields(interface or 0, index or 0, event, name, direction)
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

-- Find the bus of a packet, see Capture:init.
-- in_file  of File:bus_finder
local function find_bus(self, in_file, number, pinfo)
  local found, bus, name = self.found, nil, nil
  if not found.is_told then bus, name = file_readers.current() end
  if bus then
    self.names[bus] = name
    return bus, true
  end
  if found.has_several then return in_file(number, pinfo) end
  if number > found.count and self.tap then return find_later(self, number) end
  return nil, not found.is_unknown
end

-- Return whether fields tell the bus of packets behind those that were read.
local function are_fields_needed(self)
  local found = self.found
  -- A short file may be of a live capture that already had packets when it was opened.
  local may_go_on = self.is_short and found.has_several or found.is_live
  local is_open = self.is_long_pipe and found.may_add_buses
  return may_go_on or is_open or self.is_damaged or self:missed_file()
end

--- Use the file that was seen last: it is about to be dissected.  Files seen before it did not
-- open, or were only previewed in a file dialog.
function Capture:init()
  local found = self.seen
  self.found = found
  self.stamps:reset()
  self.plain_bus = file_readers.log().plain_bus
  self.names = {} -- by bus, of a reader of ours
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
  -- returns  the number of its bus, nil if the capture has only one or nothing tells it; and
  --          true if the bus is known
  self.bus_of = is_all_told and in_file or function(number, pinfo)
    return find_bus(self, in_file, number, pinfo)
  end
end

--- Return whether the capture was opened before the plugin was loaded: Wireshark loaded its Lua
-- plugins again.  Then fields tell the bus, and nothing tells of dropped packets.
function Capture:missed_file()
  return not (IS_TSHARK or self.has_seen_file)
end

--- Return whether the capture is known to have several buses.
function Capture:are_several()
  return self.found.has_several or file_readers.log().has_several
end

--- Return whether the file ends before its own end, see capture.ending.  Of a compressed one its
-- name tells it, which not every system tells; nil where nothing does.
function Capture:is_cut()
  local options = command_line.options()
  local path = options.r or options["read-file"]
  local file = not self.found.is_cut and path and io.open(path, "rb")
  local is_cut = file and ending.is_cut(file) or self.found.is_cut
  if file then file:close() end
  return is_cut
end

--- Return the packets that the capture dropped: a list of { time = seconds since 1970
-- or nil, frame = number of the packet behind the loss or nil, bus = name or nil, count }.
function Capture:drops()
  local drops = self.found.drops
  return drops[1] and drops or file_readers.log().drops or {}
end

--- Return whether packets of the capture have time stamps, and whether these tell when packets were
-- captured: those of controllers do not.  A reader of ours knows it with the first packet.
function Capture:has_times()
  local found = self.found
  local has_times = not found.lacks_times
  if found.is_told then return has_times, has_times end -- no reader of ours reads it
  local log = file_readers.log()
  has_times = has_times and not log.lacks_times
  return has_times, has_times and not log.lacks_clock
end

--- Return whether the time of a packet tells when it was captured.  Equal stamps are no stamps:
-- until one of a pipe differs, nothing tells.
-- time  seconds since the first packet
function Capture:is_time_real(time)
  local _, has_clock = self:has_times()
  if not has_clock or time ~= 0 then return has_clock end
  return self.found.stamps_differ or file_readers.log().stamps_differ or false
end

--- Return when the time of a packet counts from: that of the first packet, to the nanosecond where
-- the file or a reader of ours tells it.
-- pinfo    of any packet
-- returns  seconds and nanoseconds since 1970, integers
function Capture.begin(self, pinfo)
  local begin = pinfo.abs_ts - pinfo.rel_ts -- to a quarter of a microsecond
  local first = self.found.first or file_readers.log().first
  -- A read filter may have dropped the first packet of the file.
  if first and math.abs(first[1] + first[2] / 1e9 - begin) < SAME_TIME then
    return first[1], first[2]
  end
  local microseconds = math.floor(begin * 1e6 + 0.5)
  return math.floor(microseconds / 1e6), microseconds % 1e6 * 1000
end

--- Return the name of a bus.
-- bus      its number; nil where the capture has one or tells none apart
-- is_ip    true if the packet came in UDP or TCP, so by any interface
-- returns  text, or nil where the capture names none
function Capture:name(bus, is_ip)
  return self.names[bus or 0] or self.found:name(bus, is_ip) or not bus and self.plain_bus or nil
end

return M
