-- SPDX-License-Identifier: GPL-2.0-or-later
-- The dissector of YAPP in byte streams and datagrams: UART captures, raw dumps, TCP and UDP.  It
-- hands each packet to the reading, and the result to the view.  Wireshark's API.

local frame_key = require "yapp.base.frame_key"
local joined = require "yapp.base.joined"
local lines = require "yapp.serial.lines"
local ports = require "yapp.host.ports"
local senders = require "yapp.serial.senders"
local tcp = require "yapp.host.tcp"
local usb = require "yapp.serial.usb"

local M = {}

local PACKET = frame_key.PACKET
local INSIDE = PACKET / 2 -- offset of the bytes that TLS found in a packet
-- A method that Lua has to look up in a Tvb costs more than its work.
local length_of, raw_of, reported_of, offset_of = Tvb.len, Tvb.raw, Tvb.reported_len, Tvb.offset

local Dissector = {}
Dissector.__index = Dissector

--- Make the dissector.
-- reading     a reading.reading
-- view        a show.packet
-- builder     a show.tree
-- buses       a capture.capture
-- tcp_header  Proto that reads TCP's headers
function M.new(reading, view, builder, buses, tcp_header)
  return setmetatable({
    reading = reading,
    view = view,
    builder = builder,
    buses = buses,
    tcp_header = tcp_header,
    in_pieces = {}, -- conversations, see Dissector:notes
    conversations = {}, -- those that are known to be in the file, see Dissector:expect
    read_late = {}, -- those whose first bytes may have been YAPP, and were not read
    inside = false, -- bytes that TLS found in the current packet, see put_inside
    usb = false, -- of serial.usb
  }, Dissector)
end

--- Forget the capture file.
function Dissector:reset()
  self.in_pieces, self.inside, self.usb = {}, false, usb.new()
  self.conversations, self.read_late = {}, {}
  tcp.stop()
  ports.unregister_all()
end

--- Expect conversations, which the bytes of the file have.
-- conversations  of serial.senders
function Dissector:expect(conversations)
  self.reading.lines:await(conversations)
  for _, one in ipairs(conversations) do
    self.conversations[#self.conversations + 1] = one
    ports.register(one.is_tcp, one.port)
  end
end

--- Search the first bytes of the capture file for conversations.
function Dissector:scan(head)
  self:expect(self.reading.lines:scan(head))
  if self.reading:is_yapp(head) then self:watch_tcp() end
end

-- Return the line of a packet, and whether it is known where the packet was captured.
-- kind  pinfo.port_type
local function line_of(self, pinfo, kind)
  local from, bus, is_bus_known, time = tostring(pinfo.src), nil, true, nil
  if not lines.is_ip(kind, from) then
    bus, is_bus_known = self.buses.bus_of(pinfo.number, pinfo)
  elseif not pinfo.visited then
    time = self.buses:time(pinfo)
  end
  local line = self.reading.lines:of(kind, from, pinfo.src_port, tostring(pinfo.dst),
    pinfo.dst_port, bus, time)
  return line, is_bus_known
end

-- Make the record of a packet, or of a part of one.
-- line    see serial.lines
-- offset  of its bytes in the packet
-- length  number of bytes that it had
-- returns  it, and what is wanted of it, see Tree:wants
local function new_packet(self, line, pinfo, tree, offset, bytes, length)
  local number, visited, is_truncated = pinfo.number, pinfo.visited, length > #bytes
  local wants = self.builder:wants(tree, pinfo, visited)
  return {
    key = number * PACKET + offset,
    number = number,
    time = self.buses:time(pinfo), -- seconds since the first packet
    epoch = is_truncated and pinfo.abs_ts, -- since 1970, or false
    visited = visited,
    bytes = bytes, -- those that were captured
    length = length,
    truncated = is_truncated,
    is_found = self.reading.found[line.trial_key], -- true if its conversation was found by content
    line = line,
    stream = line.key,
    seq = nil, -- of TCP, if it is known: of the first byte
    is_bus_known = true, -- true if the capture tells where it was captured
    is_only_pass = wants.is_only_pass, -- true if it is never dissected again
    wants_state = wants.state, -- true if the state of its messages is wanted
  }, wants
end

-- Return the record of all bytes that a dissector gets, and what is wanted of them.
-- kind  pinfo.port_type
local function whole_packet(self, tvb, pinfo, tree, kind)
  local line, is_bus_known = line_of(self, pinfo, kind)
  local bytes = length_of(tvb) > 0 and raw_of(tvb) or ""
  local packet, wants =
    new_packet(self, line, pinfo, tree, offset_of(tvb), bytes, reported_of(tvb))
  packet.is_bus_known = is_bus_known
  return packet, wants
end

-- Return whether a packet of an unknown conversation may go on with a frame.
local function may_go_on(streams, pinfo)
  return streams:may_go_on(lines.tag(pinfo.port_type, pinfo.src_port, pinfo.dst_port))
end

-- Try a packet of an unknown conversation; return whether it is YAPP.
local function try_packet(self, packet, pinfo)
  local is_found, is_in_pieces, has_failed = self.reading:try_packet(packet)
  local port = math.min(pinfo.src_port, pinfo.dst_port)
  local client_port = math.max(pinfo.src_port, pinfo.dst_port)
  local one = { is_tcp = packet.line.is_tcp, port = port, client_port = client_port }
  if is_in_pieces then table.insert(self.in_pieces, one) end
  -- Another protocol that has a port may have taken the first pieces.
  local is_late = has_failed or is_in_pieces and ports.has_other(pinfo)
  if is_late then table.insert(self.read_late, one) end
  if is_found then ports.register(packet.line.is_tcp, port) end
  return is_found
end

--- Return whether a packet of an unknown conversation is YAPP.
function Dissector:accepts(tvb, pinfo, tree)
  if tvb:len() == 0 then return false end
  local reading, bytes = self.reading, tvb:raw()
  local streams = reading.streams
  local may_begin = streams.may_begin(bytes)
  -- Most packets are of others, and few come while a conversation is on trial.
  if not (may_begin or streams.trial_count > 0 or pinfo.visited) then return false end
  if pinfo.in_error_pkt then return false end
  if pinfo.visited then return streams:is_stored(pinfo.number * PACKET + tvb:offset()) end
  if not (may_begin and reading:may_be_yapp(bytes) or may_go_on(streams, pinfo)) then
    return false
  end
  local packet = whole_packet(self, tvb, pinfo, tree, pinfo.port_type)
  return try_packet(self, packet, pinfo)
end

--- Return notes on conversations whose packets hold no whole header: a list of texts.
function Dissector:notes()
  if not self.in_pieces[1] then return {} end
  local text = "YAPP came in pieces without a whole header: to list its packets, add %s"
  return { text:format(table.concat(senders.options(self.in_pieces), " ")) }
end

--- Return the options of tshark that decode the conversations that were not read, or not from
-- their first bytes on: a list.
function Dissector:options()
  local unread = self.reading.lines:list_unread(self.conversations)
  return senders.options(joined(unread, self.read_late))
end

--- Return whether packets of a serial line came.
function Dissector:has_serial()
  return self.reading.lines.has_serial
end

-- Dissect a packet; return whether it is YAPP's.
-- tvb  where its bytes are
local function dissect(self, packet, wants, tvb, pinfo, tree)
  local reading, visited = self.reading, packet.visited
  local contents = visited and reading:recall_packet(packet)
  if not visited then contents = reading:add_packet(packet) end
  if not contents then return false end
  self.view:show(packet, contents, wants, tvb, pinfo, tree)
  return true
end

-- Dissect a segment that TCP has shown.
-- tvb  with the header of TCP
local function dissect_segment(self, segment, tvb, pinfo, tree)
  local line, start = line_of(self, pinfo, lines.TCP), segment.start
  local has_order = pinfo.visited or
    self.reading.streams:add_header(line.key, line.opposite, segment)
  line.is_direct = line.is_direct or segment.is_ours
  line.is_over = line.is_over or segment.is_end
  if segment.length == 0 or not (segment.is_ours or has_order) then return end
  local bytes = tvb:len() > start and tvb:raw(start) or ""
  local packet, wants = new_packet(self, line, pinfo, tree, tvb:offset() + start, bytes,
    tvb:reported_len() - start)
  packet.seq, packet.epoch = segment.seq, segment.epoch
  if wants.tree and bytes ~= "" then tvb = tvb(start):tvb() end
  dissect(self, packet, wants, tvb, pinfo, tree)
end

-- Put the bytes that TLS found in a segment into a stream beside that of TCP.  Several records of a
-- segment have keys behind each other, behind those of TCP; they come anew on each revisit.
local function put_inside(self, packet)
  local before, bytes, number = self.inside, packet.bytes, packet.number
  local is_next = before and before.number == number and
    not (packet.visited and before.first == bytes)
  local offset = is_next and before.offset or INSIDE
  self.inside = {
    number = number,
    offset = offset + #bytes,
    first = is_next and before.first or bytes,
  }
  packet.stream, packet.key = "tls|" .. packet.stream, number * PACKET + offset
end

-- Dissect bytes in TCP.  Those of a segment are shown when TCP has shown the segment.  TLS found
-- other bytes in one, unless TCP has joined segments: then other bytes of the line came alone.
-- returns  true if they are YAPP's
local function dissect_in_tcp(self, tvb, pinfo, tree)
  local segment, offset = tcp.current(pinfo.number), tvb:offset()
  local is_direct = segment and offset == segment.offset or not segment and offset > 0
  is_direct = is_direct or line_of(self, pinfo, lines.TCP).is_direct
  if segment and is_direct then
    segment.is_ours = true -- these bytes may be of several: dissect_segment shows it
    return true
  end
  local packet, wants = whole_packet(self, tvb, pinfo, tree, lines.TCP)
  if is_direct then
    self:watch_tcp()
  else
    put_inside(self, packet) -- TLS needs no watch, and would lose the records that came before
  end
  return dissect(self, packet, wants, tvb, pinfo, tree)
end

--- Watch TCP, to know the sequence numbers from the first segment on.
function Dissector:watch_tcp()
  tcp.watch(self.tcp_header, function(...) dissect_segment(self, ...) end)
end

--- Dissect the bytes of a packet.
-- returns  the number of bytes that are ours
function Dissector:dissect(tvb, pinfo, tree)
  local size, kind = length_of(tvb), pinfo.port_type
  -- An ICMP error only quotes bytes that were sent before.
  if size == 0 or pinfo.in_error_pkt then return 0 end
  if kind == lines.TCP then
    return dissect_in_tcp(self, tvb, pinfo, tree) and size or 0
  end
  local packet, wants = whole_packet(self, tvb, pinfo, tree, kind)
  return dissect(self, packet, wants, tvb, pinfo, tree) and size or 0
end

-- Return where the bytes are that an adapter carries, less its status.
local function part_tvb(part, tvb)
  if part.has_status then return ByteArray.new(part.bytes, true):tvb("Serial line") end
  return tvb(part.offset):tvb()
end

-- Return the bytes of a packet of USB, see Usb:read_packet, and their line.  Return nil if the line
-- cannot have YAPP.
local function part_of_line(self, kind, raw)
  local reading = self.reading
  local streams = reading.streams
  local is_idle = streams.trial_count == 0 and not next(reading.found)
  if is_idle and usb.is_of_others(kind, raw) then return nil end
  local part = self.usb:read_packet(kind, raw)
  if not part or part.bytes == "" then return nil end
  local line = reading.lines:of_adapter(part.line)
  local may_be_yapp = reading.found[line.trial_key] or streams.may_begin(part.bytes) or
    streams:may_go_on(line.tag)
  if may_be_yapp then return part, line end
end

--- Dissect a packet of USB that Wireshark has shown, if it has bytes of a serial line with YAPP.
-- kind  of serial.usb
function Dissector:dissect_usb(kind, tvb, pinfo, tree)
  local part, line = part_of_line(self, kind, tvb:raw())
  if not part then return end
  local reading, length = self.reading, part.truncated and #part.bytes + 1 or #part.bytes
  local packet, wants = new_packet(self, line, pinfo, tree, part.offset, part.bytes, length)
  local is_found = reading.found[line.trial_key] or
    not packet.visited and reading:try_packet(packet)
  if is_found then
    dissect(self, packet, wants, wants.tree and part_tvb(part, tvb), pinfo, tree)
  end
end

--- Dissect bytes of a raw dump that are of no frame.
-- returns  the number of bytes that are ours
function Dissector:dissect_skipped(tvb, pinfo, tree)
  local size = tvb:len()
  if size > 0 then
    local packet, wants = whole_packet(self, tvb, pinfo, tree, pinfo.port_type)
    self.view:show(packet, self.reading:add_skipped(packet), wants, tvb, pinfo, tree)
  end
  return size
end

return M
