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

local Capture = {}
Capture.__index = Capture

local read_fields = fields_of(files.FIELDS)
local IS_TSHARK = not gui_enabled()
local IS_WINDOWS = package.config:sub(1, 1) == "\\"
local TOO_FAR = 2 ^ 62 -- offset that no file has
local SAME_TIME = 2e-6 -- seconds

-- The path of the file that tshark reads, "" where the system does not tell it.
local function path_of_file()
  return command_line.options().r or ""
end

-- Return whether more than the first bytes may be read: Wireshark rewinds a file, a pipe no further
-- than these.  Two passes need a file, where a seek too far fails at once.  Of one pass a name with
-- an extension shows it; a file that is taken for a pipe is dissected alike, but slower.
local function is_file(file)
  return not IS_TSHARK or IS_WINDOWS or path_of_file():find("%.%w+$") ~= nil or
    not file:seek("set", TOO_FAR)
end

-- Read the head of a file, and behind it what tells of its packets.
-- returns  a capture.file with { is_cut, see capture.ending; is_short = true if the head is all;
--          needs_fields = true if fields tell the bus of packets that were not read }
local function read_file(file)
  local head, why = file:read(files.HEAD)
  head = head or ""
  local is_short = #head < files.HEAD
  local may_read = not is_short and is_file(file)
  file:seek("set", #head)
  local found = files.read(head, function(skip, count)
    if not may_read then return nil end
    file:seek("cur", skip)
    local bytes, problem = file:read(count)
    why = why or problem
    return bytes
  end, command_line.options().z ~= nil) -- a statistic asks for drops and numbers
  file:seek("set", 0)
  local is_long_pipe = not (is_short or may_read)
  found.is_cut = not is_long_pipe and ending.is_cut(file)
  -- A short file may be of a live capture that already had packets when it was opened; one that is
  -- damaged, as a compressed file that was cut off, was not read to its end.
  found.needs_fields = is_short and found.may_be_several or
    is_long_pipe and found.may_add_buses or why ~= nil
  return found
end

--- Look at the head of each file from now on.  Call it once.
function Capture.watch()
  local seen = files.read("", function() end)
  seen.needs_fields = not IS_TSHARK -- see missed_file
  local self = setmetatable({ seen = seen, stamps = stamps_of.new() }, Capture)
  -- Register a reader that opens no file: only a reader's read_open is shown the file.  Give both
  -- arguments a name, so that Lua keeps them: Wireshark writes into both when read_open is back.
  local handler = FileHandler.new("YAPP reads heads of files (opens none)", "yapp_head",
    "Looks at the headers", "rms")
  function handler.read_open(file, _)
    self.seen, self.has_seen_file = read_file(file), true
    file_readers.forget()
    return false
  end
  function handler.read() return false end
  function handler.seek_read() return false end
  register_filehandler(handler)
  self:init()
  return self
end

-- Find the bus of a packet behind those that were read when the file was opened.
-- returns  as Capture.bus_of
local function find_later(self, number)
  local found, bus, may_be_first = self.found, self.kept[number], true
  if not bus then
    local fields = read_fields()
    bus = found:bus_by_fields(fields)
    may_be_first = bus or fields["frame.number"] -- CAN inside of another protocol sees no fields
  end
  -- The bus that was the only one when the file was opened stays without a number.
  if not found.has_several and may_be_first and (bus or 1) == 1 then return nil, true end
  self.kept[number] = bus
  return bus, bus ~= nil
end

-- Find the bus of a packet of a file that does not tell several buses apart.
-- returns  as Capture.bus_of
local function find_bus(self, number)
  local bus, name = file_readers.current()
  if bus then
    self.names[bus] = name
    return bus, true
  end
  if number > self.found.count and self.tap then return find_later(self, number) end
  return nil, not self.found.is_unknown
end

--- Use the file that was seen last: it is about to be dissected.  Files seen before it did not
-- open, or were only previewed in a file dialog.
function Capture:init()
  local found = self.seen
  self.found = found
  self.stamps:reset()
  local plain_bus = file_readers.log().plain_bus
  self.names = { [0] = plain_bus } -- by bus, of a reader of ours
  self.kept = {} -- [number of a packet] = its bus, as fields told it: later there may be no tree
  self.bus_is_per_packet = found.needs_fields or found.has_several or
    not (plain_bus or found.is_told and not found.is_unknown)
  if found.needs_fields then
    self.tap = self.tap or Listener.new("frame", (files.FIELDS:gsub(" ", " || ")))
  elseif self.tap then
    self.tap:remove()
    self.tap = nil
  end
  local in_file = found:bus_finder(IS_TSHARK, function(number) return find_later(self, number) end)
  --- Return where the current packet was captured.
  -- number   of the packet, which Wireshark need not be asked for again
  -- returns  the number of its bus, nil if the capture has only one or nothing tells it; and
  --          true if the bus is known
  self.bus_of = found.has_several and in_file or function(number) return find_bus(self, number) end
end

--- Return whether the capture was opened before the plugin was loaded: Wireshark loaded its Lua
-- plugins again.  Then fields tell the bus, and nothing tells of dropped packets.
function Capture:missed_file()
  return not (IS_TSHARK or self.has_seen_file)
end

-- Return the facts of the capture: a capture.file, or of another format as readers.log.
local function facts_of(self)
  return self.found.is_told and self.found or file_readers.log()
end

--- Return whether the capture is known to have several buses.
function Capture:are_several()
  return facts_of(self).has_several or false
end

--- Return whether a packet may begin with the header of a CAN frame; nil where the file does not
-- tell it.
function Capture:is_can(number, pinfo)
  local found = self.found
  if not found.is_told then return nil end
  local bus = found.buses[self.bus_of(number, pinfo) or 1]
  return bus ~= nil and bus.interface.is_can
end

--- Return whether the file ends before its own end, see capture.ending.  Of a compressed one its
-- name tells it, which not every system tells; nil where nothing does.
function Capture:is_cut()
  if self.found.is_cut then return true end
  local file = io.open(path_of_file(), "rb")
  local is_cut = file and ending.is_cut(file)
  if file then file:close() end
  return is_cut
end

--- Return the packets that the capture dropped: a list of { time = seconds since 1970
-- or nil, frame = number of the packet behind the loss or nil, bus = name or nil, count }.
function Capture:drops()
  return facts_of(self).drops or {}
end

--- Return whether packets of the capture have time stamps, and whether these tell when packets were
-- captured: those of controllers do not.  A reader of ours knows it with the first packet.
function Capture:has_times()
  local facts = facts_of(self)
  local has_times = not facts.lacks_times
  return has_times, has_times and not facts.lacks_clock
end

--- Return whether the time of a packet tells when it was captured.  Equal stamps are no stamps:
-- until one of a pipe differs, nothing tells.
-- time  seconds since the first packet
function Capture:is_time_real(time)
  local _, has_clock = self:has_times()
  return has_clock and (time ~= 0 or facts_of(self).stamps_differ or false)
end

--- Return when the time of a packet counts from: that of the first packet, to the nanosecond where
-- the file or a reader of ours tells it.
-- pinfo    of any packet
-- returns  seconds and nanoseconds since 1970, integers
function Capture:begin(pinfo)
  local begin = pinfo.abs_ts - pinfo.rel_ts -- to a quarter of a microsecond
  local first = facts_of(self).first
  -- A read filter may have dropped the first packet of the file.
  if first and math.abs(first[1] + first[2] / 1e9 - begin) < SAME_TIME then
    return first[1], first[2]
  end
  local microseconds = math.floor(begin * 1e6 + 0.5)
  return math.floor(microseconds / 1e6), microseconds % 1e6 * 1000
end

--- Return the name of a bus.
-- bus      its number; nil where the capture has one or tells none apart
-- returns  text, or nil where the capture names none
function Capture:name(bus)
  return self.names[bus or 0] or self.found:name(bus)
end

return Capture
