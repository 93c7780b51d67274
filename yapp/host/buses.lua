-- SPDX-License-Identifier: GPL-2.0-or-later
-- On which bus a packet was captured: may this capture have several, which one is it, what is it
-- called.  Wireshark's API.
--
-- The file says it (host.capture), or the reader of ours that it came through.  Of a live capture,
-- of Vector BLF and of what else is not read here the fields say it, where there is a tree; a tap
-- asks for them.

local capture = require "yapp.host.capture"
local fields_of = require "yapp.host.fields".of
local readers = require "yapp.file.readers"

local M = {}

local FIELDS = "frame.interface_id || frame.interface_name || sll.ifindex || rtacser.eventtype"
local NAMES = {}
for name in FIELDS:gmatch("[%w_.]+") do NAMES[name] = true end
local BLF = "LOGG"
local IN_TSHARK = not gui_enabled() -- where a read filter may shift the numbers of packets

local Buses = {}
Buses.__index = Buses

local PACKED = { ["\31\139"] = true, ["\40\181"] = true, ["\4\34"] = true } -- gzip, Zstandard, LZ4

-- The first line, or so many bytes, of a file; "" where it cannot be read.
local function first(path, what)
  local file = io.open(path, "rb")
  local text = file and file:read(what)
  if file then file:close() end
  return text or ""
end

-- Whether a file is none that is read forward once, as far as that is known: Wireshark cannot
-- rewind a pipe behind what is read here of it.  Linux says how far a file that is open has been
-- read, a packed one not as far as its bytes are long, a pipe 0; elsewhere there is nobody to ask.
local function is_file(bytes)
  if first("/proc/self/fdinfo/0", "*l") == "" then return true end
  for number = 3, 63 do
    local position = tonumber(first("/proc/self/fdinfo/" .. number, "*l"):match("%d+")) or 0
    if position >= bytes then return true end
    if position > 0 and PACKED[first("/proc/self/fd/" .. number, 2)] then return true end
  end
  return false
end

--- Looks at files from now on.  Call it once.
function M.watch()
  local self = setmetatable({ seen = capture.read("", function() end) }, Buses)
  -- A reader that never reads: the only place where the API shows a file.  It names both arguments:
  -- what a reader does not hold may be collected while it reads, and Wireshark writes into both
  -- when it is back.
  local handler = FileHandler.new("YAPP's look at files (opens none)", "yapp_look",
    "Looks at the headers", "rms")
  function handler.read_open(file, _)
    local head = file:read(capture.OF_A_PIPE) or ""
    local is_long = #head == capture.OF_A_PIPE
    local may_go_on = is_long and is_file(#head)
    self.seen = capture.read(head, function(count) return may_go_on and file:read(count) or nil end)
    self.seen_blf, self.seen_whole = head:sub(1, 4) == BLF, may_go_on or not is_long
    readers.forget()
    return false
  end
  function handler.read() return false end
  function handler.seek_read() return false end
  register_filehandler(handler)
  self:init()
  return self
end

--- A new file is about to be dissected.  What was seen since the last one may be of others, which
-- did not open or were only looked at in a file dialog: nothing of it counts before.
function Buses:init()
  local found = self.seen
  self.found, self.is_blf, self.is_shifted = found, self.seen_blf, false
  self.plain_bus = readers.plain_bus()
  -- [number of a packet] = its bus, where a field said it: a later look may have no tree
  self.kept = {}
  -- Of a log that Wireshark's own reader takes, it is known that it has one; a window may have
  -- looked at another file since.
  self.asks = not (IN_TSHARK and self.plain_bus) and
    (found.has_several or found.begins or found.may_be_ours or not found.is_told)
  local needs_fields = found.begins or self.is_blf or found.has_several and not self.seen_whole
  if needs_fields then
    self.tap = self.tap or Listener.new("frame", FIELDS)
  elseif self.tap then
    self.tap:remove()
    self.tap = nil
  end
end

--- Whether the capture tells several sources apart, as far as is known.
function Buses:are_several()
  return self.found.has_several or self.is_blf or readers.are_several()
end

--- Whether the file may have YAPP frames in TCP or UDP, by its first bytes.
function Buses:may_have_frames()
  return self.found.may_have_frames
end

--- Whether the first bytes of the file have YAPP frames, in TCP, UDP or whatever.
function Buses:has_frames()
  return self.found.has_packets and self.found.may_have_frames
end

-- The source that the fields of the current packet tell; nil without a tree.
local function source_by_fields(found)
  local fields = fields_of(NAMES)
  local interface, index = fields["frame.interface_id"], fields["sll.ifindex"]
  local event = fields["rtacser.eventtype"]
  if not (interface or index or event) then return nil end
  local direction = capture.DIRECTION[event] or 0
  local bus = found:source(interface or 0, index or 0, direction)
  local name = fields["frame.interface_name"]
  if name and name ~= "unknown" then found.names[bus] = found.names[bus] or name end
  return bus
end

-- The bus by the fields of the current packet, and whether it is known.  Where the file had one
-- source when it was opened, that goes on without a number.
local function by_fields(self, number)
  local found = self.found
  local had_one = not (self.is_blf or found.has_several)
  local bus = source_by_fields(found)
  if not bus then return nil, had_one end
  if bus == 1 and had_one then
    found.own_name = found.own_name or found.names[bus]
    return nil, true
  end
  self.kept[number] = bus
  return bus, true
end

--- Where the current packet was captured.
-- number   of it, which Wireshark need not be asked for again
-- returns  its bus, a number; nil where the capture has one, or nothing says; and whether this is
--          known
function Buses:of(pinfo, number)
  local bus, name = readers.current()
  if bus then
    self.found.names[bus] = name
    return bus, true
  end
  if not self.asks then return nil, true end
  local found = self.found
  if number > found.count then
    bus = self.kept[number]
    if bus then return bus, true end
    return by_fields(self, number)
  end
  if not found.has_several then return nil, true end
  bus = not self.is_shifted and found:bus(number, IN_TSHARK and pinfo.abs_ts or nil)
  if bus and bus > 0 then return bus, true end
  self.is_shifted = true
  return nil, false
end

--- What a bus is called.
-- bus      its number; nil where the capture has one or tells none apart
-- is_ip    whether it came in UDP or TCP, so by any interface
-- returns  text, or nil where the capture names none
function Buses:name(bus, is_ip)
  if bus then return self.found.names[bus] end
  if is_ip then return self.found.only_name or self.plain_bus end
  return self.found.own_name or self.found.only_name or self.plain_bus
end

return M
