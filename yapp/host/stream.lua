-- SPDX-License-Identifier: GPL-2.0-or-later
-- The dissector of YAPP in byte streams and datagrams: UART captures, raw dumps, TCP, UDP and USB.
-- It hands each packet to the reading, and the result to the view.  Wireshark's API.
--
-- Wireshark's TCP hands on bytes without their sequence numbers.  Which segments it keeps to itself
-- or joins depends on its version and preferences.  So a wrapper in front of TCP reads the header,
-- and shows the segments of YAPP's lines when TCP has shown them.
--
-- Nothing hands a USB adapter's bytes to YAPP: usb.bulk takes no Decode As, and for FTDI's adapters
-- Wireshark asks its own dissector alone.  So a wrapper is in front of USB, too.

local addresses = require "yapp.host.addresses"
local band = require "yapp.base.bits".band
local frame = require "yapp.wire.frame"
local frame_key = require "yapp.base.frame_key"
local lines = require "yapp.serial.lines"
local usb = require "yapp.serial.usb"
local wrapper = require "yapp.host.wrapper"

local M = {}

local PACKET = frame_key.PACKET
local TLS = PACKET / 2 -- offset of the bytes that TLS found in a packet
local TCP_HEADER = 20
local CUT_HEADER = 8 -- bytes that Dissector:count_headers takes for a header that was cut
local FIN, SYN, RST = 1, 2, 4 -- flags of TCP
-- The kinds of USB packets: encapsulation of Wireshark, name of serial.usb.
local USB_KINDS = {
  { wtap.USB_LINUX, "usbmon" },
  { wtap.USB_LINUX_MMAPPED, "usbmon_mapped" },
  { wtap.USBPCAP, "usbpcap" },
}
local PORTS = { [lines.TCP] = "tcp", [lines.UDP] = "udp" }
-- A method that Lua has to look up in a Tvb costs more than its work.
local length_of, raw_of, reported_of, offset_of = Tvb.len, Tvb.raw, Tvb.reported_len, Tvb.offset

local Dissector = {}
Dissector.__index = Dissector

-- Read the header of a segment; nil if it is not there or if an ICMP error only quotes it.
local function read_segment(tvb, pinfo)
  if tvb:len() < TCP_HEADER or pinfo.in_error_pkt then return nil end
  local seq, _, size, flags = Struct.unpack(">I4I4BB", tvb:raw(4, 10))
  local start, is_syn = band(size, 0xF0) / 4, band(flags, SYN) ~= 0
  if start < TCP_HEADER or start > tvb:len() or band(flags, RST) ~= 0 then return nil end
  return {
    start = start, -- of its bytes
    seq = (seq + (is_syn and 1 or 0)) % 0x100000000, -- of the first one
    is_syn = is_syn,
    is_end = band(flags, FIN) ~= 0,
  }
end

--- Make the dissector.
-- parts  { reading = a reading.reading, view = a show.view, wants = a show.wants,
--          buses = a capture.capture; Protos for the wrappers: tcp_header, usb_header;
--          counted = function(f) -> f, whose calls are counted }
function M.new(parts)
  local self = setmetatable(parts, Dissector)
  local usb_entries, kinds, counted = {}, {}, parts.counted
  for _, row in ipairs(USB_KINDS) do
    if row[1] then
      usb_entries[#usb_entries + 1], kinds[row[1]] = { "wtap_encap", row[1] }, row[2]
    end
  end
  self.tcp = wrapper.new(parts.tcp_header, { { "ip.proto", 6, "tcp" } }, read_segment,
    counted(function(...) self:dissect_segment(...) end))
  self.usb_packets = wrapper.new(parts.usb_header, usb_entries, function(_, _, value)
    return kinds[value]
  end, counted(function(...) self:dissect_usb(...) end))
  return self
end

--- Forget the capture file.
function Dissector:reset()
  self.usb = usb.new()
  self.addresses = addresses.new()
  self.tls_keys, self.next_tls_key = {}, 0 -- [number and bytes of a packet] = a frame key
  self.number = 0 -- of the latest packet that is YAPP's, or an error that quotes one
  self.undecoded = {} -- { [option that decodes them] = number of headers }
end

--- Look for YAPP in TCP and USB from now on.
function Dissector:watch()
  self.tcp:start()
  self.usb_packets:start()
end

-- Return the line of a packet, and whether it is known where the packet was captured.
-- kind       pinfo.port_type
-- is_in_tls  true if TLS found its bytes
local function line_of(self, pinfo, kind, is_in_tls)
  local names, bus, is_bus_known = self.addresses, nil, true
  local from = names:text(pinfo.src)
  if is_in_tls then
    bus = 1 -- a line beside that of TCP
  elseif not lines.is_ip(kind, from) then
    bus, is_bus_known = self.buses.bus_of(pinfo.number, pinfo)
  end
  local line = self.reading.lines:of(kind, from, pinfo.src_port, names:text(pinfo.dst),
    pinfo.dst_port, bus)
  return line, is_bus_known
end

-- Make the record of a packet, or of a part of one.
-- line    see serial.lines
-- offset  of its bytes in the packet
-- length  number of bytes that it had
-- returns  it, and what is wanted of it, see Wants:ask
local function new_packet(self, line, pinfo, tree, offset, bytes, length)
  local number, visited = pinfo.number, pinfo.visited
  local is_truncated = length > #bytes
  local wants = self.wants:ask(tree, pinfo, visited)
  return {
    key = number * PACKET + offset,
    number = number,
    time = pinfo.rel_ts, -- seconds since the first packet
    epoch = (is_truncated or line.is_tcp) and pinfo.abs_ts, -- since 1970, or false
    visited = visited,
    bytes = bytes, -- those that were captured
    length = length,
    truncated = is_truncated,
    line = line,
    seq = nil, -- of TCP, if it is known: of the first byte
    is_end = false, -- true if it ends a TCP connection
    is_bus_known = true, -- true if the capture tells where it was captured
    is_only_pass = wants.is_only_pass, -- true if it is never dissected again
    wants_state = wants.state, -- true if the state of its messages is wanted
  }, wants
end

-- Return the record of all bytes that a dissector gets, and what is wanted of them.
local function whole_packet(self, line, tvb, pinfo, tree)
  local bytes = length_of(tvb) > 0 and raw_of(tvb) or ""
  return new_packet(self, line, pinfo, tree, offset_of(tvb), bytes, reported_of(tvb))
end

-- Dissect a packet; return whether it is YAPP's.
-- tvb  where its bytes are
local function dissect(self, packet, wants, tvb, pinfo, tree)
  local reading = self.reading
  local read = packet.visited and reading.recall_packet or reading.add_packet
  local contents = read(reading, packet)
  if not contents then return false end
  self.number = packet.number
  self.view:show_packet(packet, contents, wants, tvb, pinfo, tree)
  return true
end

-- Return whether a packet has the end of a header, which others of its line may have begun.
local function ends_header(line, bytes)
  local text = line.latest .. bytes
  line.latest = text:sub(1 - frame.HEADER)
  return frame.find_header(text, 1) ~= nil
end

-- Count headers in a packet that is not decoded.
local function count_undecoded(self, pinfo, count)
  local port = math.min(pinfo.src_port, pinfo.dst_port)
  local option = ("-d %s.port==%d,yapp_serial"):format(PORTS[pinfo.port_type] or "udp", port)
  self.undecoded[option] = (self.undecoded[option] or 0) + count
end

--- Return whether a packet of an unknown conversation is YAPP: it holds a whole header.  A header
-- that packets have in pieces is counted.
function Dissector:accepts(tvb, pinfo)
  if pinfo.in_error_pkt or length_of(tvb) == 0 then return false end
  local bytes = raw_of(tvb)
  local is_found, is_piece = frame.find_header(bytes, 1) ~= nil, #bytes < frame.HEADER
  if not (is_found or is_piece and not pinfo.visited) then return false end
  local line = line_of(self, pinfo, pinfo.port_type)
  if is_found then
    line.conversation.is_found = true
  elseif ends_header(line, bytes) and #bytes < CUT_HEADER then
    count_undecoded(self, pinfo, 1)
  end
  return is_found
end

-- TCP ---------------------------------------------------------------------------------------------

-- Dissect a segment that TCP has shown.
-- tvb  with the header of TCP
function Dissector:dissect_segment(segment, tvb, pinfo, tree)
  local line, start = line_of(self, pinfo, lines.TCP), segment.start
  if not line.is_shown then return end
  if segment.is_syn and not pinfo.visited then self.reading.streams:begin_connection(line) end
  local length = tvb:reported_len() - start
  if length == 0 and not segment.is_end then return end
  local bytes = tvb:len() > start and tvb:raw(start) or ""
  local packet, wants = new_packet(self, line, pinfo, tree, tvb:offset() + start, bytes, length)
  packet.seq, packet.is_end = segment.seq, segment.is_end
  if wants.tree and bytes ~= "" then tvb = tvb(start):tvb() end
  dissect(self, packet, wants, tvb, pinfo, tree)
end

-- Return the frame key of bytes that TLS found in a packet, which may have several such records.
local function key_in_tls(self, pinfo, bytes)
  local name = pinfo.number .. " " .. bytes
  local key = pinfo.visited and self.tls_keys[name]
  if not key then
    key = math.max(pinfo.number * PACKET + TLS, self.next_tls_key)
    self.tls_keys[name], self.next_tls_key = key, key + #bytes
  end
  return key
end

-- Dissect bytes in TCP.  Those of a segment are shown when TCP has shown the segment.  TLS found
-- bytes that do not lie in the packet.
-- returns  true if they are YAPP's
local function dissect_in_tcp(self, tvb, pinfo, tree)
  local line, is_inside = line_of(self, pinfo, lines.TCP), tvb:offset() == 0
  local _, segment = self.tcp:read(pinfo.number)
  if segment and (line.is_shown or not is_inside) then
    line.is_shown = true
    return true
  end
  if is_inside then line = line_of(self, pinfo, lines.TCP, true) end
  local packet, wants = whole_packet(self, line, tvb, pinfo, tree)
  if is_inside then
    packet.key = key_in_tls(self, pinfo, packet.bytes)
  else -- the header of this one was not read
    self.tcp:start()
    line.is_shown = true
  end
  return dissect(self, packet, wants, tvb, pinfo, tree)
end

-- Others ------------------------------------------------------------------------------------------

--- Dissect the bytes of a packet.
-- returns  the number of bytes that are ours
function Dissector:dissect(tvb, pinfo, tree)
  local size, kind = length_of(tvb), pinfo.port_type
  if size == 0 then return 0 end
  if pinfo.in_error_pkt then -- an ICMP error only quotes bytes that were sent before
    self.number = pinfo.number
    return 0
  end
  if kind == lines.TCP and lines.is_ip(kind, tostring(pinfo.src)) then
    return dissect_in_tcp(self, tvb, pinfo, tree) and size or 0
  end
  local line, is_bus_known = line_of(self, pinfo, kind)
  local packet, wants = whole_packet(self, line, tvb, pinfo, tree)
  packet.is_bus_known = is_bus_known
  return dissect(self, packet, wants, tvb, pinfo, tree) and size or 0
end

-- Return where the bytes are that an adapter carries, less its status.
local function part_tvb(part, tvb)
  if part.has_status then return ByteArray.new(part.bytes, true):tvb("Serial line") end
  return tvb(part.offset):tvb()
end

--- Dissect a packet of USB that Wireshark has shown, if it has bytes of a serial line with YAPP.
-- kind  of serial.usb
function Dissector:dissect_usb(kind, tvb, pinfo, tree)
  local part = length_of(tvb) > 0 and self.usb:read_packet(kind, raw_of(tvb))
  if not part or part.bytes == "" then return end
  local line = self.reading.lines:of_adapter(part.name, part.device)
  local conversation = line.conversation
  -- At 115,200 baud adapters hand on 11 bytes a millisecond, less than a header.
  conversation.is_found = conversation.is_found or ends_header(line, part.bytes)
  if not conversation.is_found then return end
  local length = part.truncated and #part.bytes + 1 or #part.bytes
  local packet, wants = new_packet(self, line, pinfo, tree, part.offset, part.bytes, length)
  dissect(self, packet, wants, wants.tree and part_tvb(part, tvb), pinfo, tree)
end

--- Dissect bytes of a raw dump that are of no frame.
-- returns  the number of bytes that are ours
function Dissector:dissect_skipped(tvb, pinfo, tree)
  local size = tvb:len()
  if size > 0 then
    local line = line_of(self, pinfo, pinfo.port_type)
    local packet, wants = whole_packet(self, line, tvb, pinfo, tree)
    self.view:show_packet(packet, self.reading:add_skipped(packet), wants, tvb, pinfo, tree)
  end
  return size
end

-- What was not decoded ----------------------------------------------------------------------------

--- Count the headers in a packet of UDP or TCP that is not YAPP's, as another protocol has its port
-- or no segment of its conversation holds a whole one.  Called by a tap.
-- tvb  of the whole packet
function Dissector:count_headers(pinfo, tvb)
  if pinfo.number == self.number or tvb:len() == 0 then return end
  local bytes = tvb:raw()
  local count, index = 0, frame.find_header(bytes, 1, true)
  while index do
    count, index = count + 1, frame.find_header(bytes, index + 1, true)
  end
  if count > 0 then count_undecoded(self, pinfo, count) end
end

--- Return the options of tshark that decode conversations that were not: a list, and the number of
-- headers in these.
function Dissector:undecoded_options()
  local list, count = {}, 0
  for option, headers in pairs(self.undecoded) do
    list[#list + 1], count = option, count + headers
  end
  table.sort(list)
  return list, count
end

--- Return whether packets of a serial line came.
function Dissector:has_serial()
  return self.reading.lines.has_serial
end

return M
