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
local joined = require "yapp.base.joined"
local lines = require "yapp.serial.lines"
local usb = require "yapp.serial.usb"
local wrapper = require "yapp.host.wrapper"

local Dissector = {}
Dissector.__index = Dissector

local PACKET = frame_key.PACKET
local TCP_HEADER = 20
local FIN, SYN, RST = 1, 2, 4 -- flags of TCP
-- The packets of USB: encapsulation of Wireshark, name of serial.usb.
local USB_KINDS = {
  [wtap.USB_LINUX] = "usbmon",
  [wtap.USB_LINUX_MMAPPED] = "usbmon_mapped",
  [wtap.USBPCAP] = "usbpcap",
}
-- A method that Lua has to look up in a Tvb costs more than its work.
local length_of, raw_of, reported_of, offset_of = Tvb.len, Tvb.raw, Tvb.reported_len, Tvb.offset

-- Read the header of a segment; nil if it is not there or if an ICMP error only quotes it.
local function read_segment(tvb, pinfo)
  if tvb:len() < TCP_HEADER or pinfo.in_error_pkt then return nil end
  local seq, _, size, flags = Struct.unpack(">I4I4BB", tvb:raw(4, 10))
  local start, is_syn = band(size, 0xF0) / 4, band(flags, SYN) ~= 0
  if start < TCP_HEADER or start > tvb:len() or band(flags, RST) ~= 0 then return nil end
  return {
    start = start,
    seq = (seq + (is_syn and 1 or 0)) % 0x100000000,
    is_start = is_syn,
    is_end = band(flags, FIN) ~= 0,
  }
end

--- Make the dissector.
-- parts  { reading = a reading.reading, view = a show.view, wants = a show.wants,
--          capture = a capture.capture; Protos for the wrappers: tcp_header, usb_header;
--          counted = function(f) -> f, whose calls are counted }
function Dissector.new(parts)
  local self, usb_entries = setmetatable(parts, Dissector), {}
  for kind in pairs(USB_KINDS) do table.insert(usb_entries, { "wtap_encap", kind }) end
  self.tcp = wrapper.new(parts.tcp_header, { { "ip.proto", 6, "tcp" } }, read_segment,
    parts.counted(function(...) self:dissect_segment(...) end))
  self.usb_packets = wrapper.new(parts.usb_header, usb_entries, function(_, _, value)
    return USB_KINDS[value]
  end, parts.counted(function(...) self:dissect_usb(...) end))
  return self
end

--- Forget the capture file.
function Dissector:reset()
  self.usb = usb.new()
  self.addresses = addresses.new()
  self.number = 0 -- of the latest packet that is YAPP's, or an error that quotes one
  self.undecoded = {} -- { [option that decodes them] = number of headers }
  self.found = {} -- [conversation] = true if it was found by content
  self.latest = {} -- [line] = its latest bytes, if they may begin a header
  self.is_shown = {} -- [line of TCP] = true if its segments are shown when TCP has shown them
end

--- Look for YAPP in TCP and USB from now on.
function Dissector:watch()
  self.tcp:start()
  self.usb_packets:start()
end

-- Return the line of a packet, and whether it is known where the packet was captured.
-- kind  pinfo.port_type
local function line_of(self, pinfo, kind)
  local names, bus, is_bus_known = self.addresses, nil, true
  local from = names:text(pinfo.src)
  if not lines.is_ip(kind, from) then
    bus, is_bus_known = self.capture.bus_of(pinfo.number, pinfo)
  end
  local line = self.reading.lines:of(kind, from, pinfo.src_port, names:text(pinfo.dst),
    pinfo.dst_port, bus)
  return line, is_bus_known
end

-- Return whether bytes are the header of a message of the catalogue, but for its "Y".
local function lacks_first(self, bytes)
  local id, size = frame.parse(bytes, 0)
  return id and bytes:find("^P") and self.reading.types:size_of(id) == size
end

-- Return whether a packet has the end of a header, and whether others of its line began it.  Many
-- packets of others end with a "Y": only of a small one it is kept.
local function ends_header(self, line, bytes)
  local kept = self.latest[line] or lacks_first(self, bytes) and "Y" or ""
  local text = kept .. bytes
  local index = frame.find_header(text, 1)
  self.latest[line] = text:match(#bytes < frame.HEADER and "YP?.*" or "YP.*", 1 - frame.HEADER)
  return index ~= nil, index and index <= #kept
end

-- Packets -----------------------------------------------------------------------------------------

-- Return where the bytes of a packet are.
local function tvb_of(packet, tvb)
  if packet.has_status then return ByteArray.new(packet.bytes, true):tvb("Serial line") end
  return packet.start > 0 and packet.bytes ~= "" and tvb(packet.start):tvb() or tvb
end

-- Dissect a packet; return whether it is YAPP's.
-- packet  {
--   line          of serial.lines
--   is_bus_known  true if the capture tells where it was captured
--   bytes         those that were captured; length = number of bytes that it had
--   start         of the bytes in the tvb
--   has_status    true if the tvb has other bytes between them
--   seq           of TCP, if it is known: of the first byte
--   is_start, is_end  true if it begins or ends a TCP connection
--   is_skipped    true if its bytes are known to be of no frame; and what this function adds:
--   is_found      true if its conversation was found by content
--   key, number, visited
--   time          seconds since the first packet
--   epoch         since 1970; of TCP, and if it is truncated
--   truncated     true if it had more bytes
--   is_only_pass  true if it is never dissected again
--   wants_state   true if the state of its messages is wanted }
local function dissect(self, packet, tvb, pinfo, tree)
  local number, visited = pinfo.number, pinfo.visited
  local wants = self.wants:ask(tree, pinfo, visited)
  packet.is_found = self.found[packet.line.conversation]
  packet.key = number * PACKET + offset_of(tvb) + packet.start
  packet.number, packet.visited, packet.time = number, visited, pinfo.rel_ts
  packet.truncated = packet.length > #packet.bytes
  if packet.truncated or packet.line.is_tcp then packet.epoch = pinfo.abs_ts end
  packet.is_only_pass, packet.wants_state = wants.is_only_pass, wants.state
  local contents = self.reading:read_packet(packet)
  if not contents then return false end
  self.number = number
  self.view:show_packet(packet, contents, wants, wants.tree and tvb_of(packet, tvb), pinfo, tree)
  return true
end

--- Dissect a segment that TCP has shown.
-- segment  of read_segment
-- tvb      with the header of TCP
function Dissector:dissect_segment(segment, tvb, pinfo, tree)
  local line, start = line_of(self, pinfo, lines.TCP), segment.start
  if not self.is_shown[line] then return end
  segment.line, segment.is_bus_known = line, true
  segment.bytes = tvb:len() > start and tvb:raw(start) or ""
  segment.length = tvb:reported_len() - start
  if segment.length == 0 and not (segment.is_start or segment.is_end) then return end
  dissect(self, segment, tvb, pinfo, tree)
end

--- Dissect the bytes of a packet.  Those of a TCP segment are shown when TCP has shown it.
-- returns  the number of bytes that are ours
function Dissector:dissect(tvb, pinfo, tree)
  local size, kind = length_of(tvb), pinfo.port_type
  if size == 0 then return 0 end
  if pinfo.in_error_pkt then -- an ICMP error only quotes bytes that were sent before
    self.number = pinfo.number
    return 0
  end
  local is_skipped = kind == lines.SKIPPED
  local line, is_bus_known = line_of(self, pinfo, is_skipped and lines.UDP or kind)
  if line.is_tcp then
    self.is_shown[line] = true
    if self.tcp:read(pinfo.number) then return size end
    self.tcp:start() -- from the next segment on headers are read
  end
  return dissect(self, {
    line = line,
    is_bus_known = is_bus_known,
    is_skipped = is_skipped,
    bytes = raw_of(tvb),
    length = reported_of(tvb),
    start = 0,
  }, tvb, pinfo, tree) and size or 0
end

--- Dissect a packet of USB that Wireshark has shown, if it has bytes of a serial line with YAPP.
-- kind  of serial.usb
function Dissector:dissect_usb(kind, tvb, pinfo, tree)
  local packet = length_of(tvb) > 0 and self.usb:read_packet(kind, raw_of(tvb))
  if not packet or packet.bytes == "" then return end
  local line = self.reading.lines:of_adapter(packet.name, packet.device)
  local found, conversation = self.found, line.conversation
  -- At 115,200 baud adapters hand on 11 bytes a millisecond, less than a header.
  found[conversation] = found[conversation] or ends_header(self, line, packet.bytes)
  if not found[conversation] then return end
  packet.line, packet.is_bus_known = line, true
  dissect(self, packet, tvb, pinfo, tree)
end

-- Search ------------------------------------------------------------------------------------------

-- Count headers in a packet that is not decoded.
local function count_undecoded(self, pinfo, count)
  local kind = pinfo.port_type == lines.TCP and "tcp" or "udp"
  local port = math.min(pinfo.src_port, pinfo.dst_port)
  local option = ("-d %s.port==%d,yapp_serial"):format(kind, port)
  self.undecoded[option] = (self.undecoded[option] or 0) + count
end

--- Return whether a packet of an unknown conversation is YAPP: it holds a whole header.  A header
-- that packets have in pieces is counted.
function Dissector:accepts(tvb, pinfo)
  if pinfo.in_error_pkt or length_of(tvb) == 0 then return false end
  local bytes = raw_of(tvb)
  local is_found = frame.find_header(bytes, 1) ~= nil
  local has_piece = #bytes < frame.HEADER or bytes:find("YP", 1 - frame.HEADER, true) or
    lacks_first(self, bytes)
  if not is_found and (pinfo.visited or not (has_piece or next(self.latest))) then return false end
  local line = line_of(self, pinfo, pinfo.port_type)
  local _, is_cut = ends_header(self, line, bytes)
  if is_cut then count_undecoded(self, pinfo, 1) end
  if is_found then self.found[line.conversation], self.latest[line] = true, nil end
  return is_found
end

--- Count the headers in a packet of UDP or TCP that another protocol takes.  Called by a tap.
-- tvb  of the whole packet
function Dissector:count_headers(pinfo, tvb)
  if pinfo.number == self.number or tvb:len() == 0 then return end
  local bytes = tvb:raw()
  local count, index = 0, frame.find_header(bytes, 1)
  while index do
    count, index = count + 1, frame.find_header(bytes, index + 1)
  end
  if count > 0 then count_undecoded(self, pinfo, count) end
end

--- Return the options of tshark that decode YAPP in packets in which none was found.
-- returns  a list, and the number of headers that these packets have, 0 if it is not known
function Dissector:undecoded_options()
  local found, list, count = self.capture.found, {}, 0
  for option, headers in pairs(self.undecoded) do
    list[#list + 1], count = option, count + headers
  end
  table.sort(list)
  if found.has_serial_frames and not self.reading.lines.has_serial then
    list = joined({ found:serial_option() }, list)
  end
  return list, count
end

return Dissector
