-- SPDX-License-Identifier: GPL-2.0-or-later
-- The dissector of YAPP in byte streams and datagrams: UART captures, raw dumps, TCP and UDP.
-- Wireshark's API.

local crc = require "yapp.wire.crc"
local frame = require "yapp.wire.frame"
local frame_key = require "yapp.base.frame_key"
local framer = require "yapp.serial.framer"
local memo = require "yapp.base.memo"
local senders = require "yapp.serial.senders"
local show_fields = require "yapp.show.fields"
local streams = require "yapp.serial.streams"
local tcp = require "yapp.serial.tcp"
local usb = require "yapp.serial.usb"
local utf8 = require "yapp.base.utf8"

local M = {}

local sub = string.sub
local add, add_le = show_fields.add, show_fields.add_le
local append_text = show_fields.append_text

local HEADER, CRC_SIZE = frame.HEADER, frame.CRC_SIZE

local TCP, UDP = 2, 3 -- pinfo.port_type
-- pinfo.src of a packet without one: of a serial line, or of a raw dump, whose packets are like UDP
local NO_ADDRESS = { [""] = true, NONE = true }
local MAX_IN_INFO = 10 -- frames of a packet
local INSIDE = frame_key.PACKET / 2 -- offset of what TLS found in a packet

local Dissector = {}
Dissector.__index = Dissector

--- Make the dissector.
-- builder     a show.tree
-- reader      a message.reader
-- buses       a host.buses
-- tcp_header  Proto that reads TCP's headers
function M.new(builder, reader, buses, tcp_header)
  return setmetatable({
    builder = builder,
    reader = reader,
    buses = buses,
    tcp_header = tcp_header,
  }, Dissector)
end

--- Forget the capture file.
-- new_history  function() -> a message.history
function Dissector:reset(new_history)
  self.streams = streams.new(function() return self:new_framer() end)
  self.history = new_history()
  self.lines = {} -- by key, see line_of
  self.senders = senders.new()
  self.sources = memo(function() return {} end) -- by sender, by ID: whoever receives it
  self.in_pieces = {} -- see Dissector:notes
  self.inside = nil -- see put_inside
  self.usb = usb.new()
  self.found = {} -- [bus_key of a line] = true: conversations that were found by content
  tcp.stop()
end

--- Look at the first bytes of the capture file, which may have frames.
function Dissector:scan(head)
  self.senders:scan(head)
  if self:is_yapp(head) then self:watch_tcp() end
end

--- Make a framer.
-- patience  of serial.framer; nil for the usual
function Dissector:new_framer(patience)
  return framer.new(function(id) return self.reader:size_of(id) end, patience)
end

-- Packets ----------------------------------------------------------------------------------------

-- Make the line of a packet, one direction of a conversation or of a UART: {
--   key          of its stream
--   opposite     key of the other direction
--   bus_key      what a Command and its answers have in common: one key for both directions of a
--                conversation, one for all of a UART
--   bus          name or nil
--   label        text that tells its sources apart, nil if nothing does
--   has_address  whether its packets have a sender
--   is_ip, interface  whether it is in UDP or TCP; then the name of its interface, or nil
--   is_direct    whether TCP hands its bytes to YAPP; nil where TLS does
--   sources      [ID] = a source, see source_of; all lines of a sender share them }
local function new_line(self, pinfo, bus, is_ip)
  local kind, address, port = pinfo.port_type, tostring(pinfo.src), pinfo.src_port
  local here = address .. ":" .. port
  local there = tostring(pinfo.dst) .. ":" .. pinfo.dst_port
  local before = (bus or "") .. "|" .. kind .. "|"
  local name, has_address = self.buses:name(bus, is_ip), not NO_ADDRESS[address]
  local line = {
    key = before .. here .. "|" .. there,
    opposite = before .. there .. "|" .. here,
    bus_key = "serial",
    bus = name,
    label = has_address and here or bus and name,
    has_address = has_address,
    is_ip = is_ip,
    is_tcp = kind == TCP,
    is_datagram = kind == UDP and is_ip,
    is_complete = kind == UDP and not is_ip, -- of a raw dump
    interface = is_ip and name,
    sources = {},
  }
  if is_ip then
    line.bus_key = here < there and here .. there or there .. here
    line.bus = kind == UDP and self.senders:name_of(address, port) or senders.name(address, port)
    line.sources = self.sources[kind .. line.bus]
  end
  return line
end

-- Return the line of a packet, and whether it is known where it was captured.
local function line_of(self, pinfo)
  local kind, bus, is_bus_known = pinfo.port_type, nil, true
  local address, port = tostring(pinfo.src), pinfo.src_port
  local is_ip = (kind == UDP or kind == TCP) and not NO_ADDRESS[address]
  if not is_ip then bus, is_bus_known = self.buses:of(pinfo, pinfo.number, 0) end
  if is_ip and kind == UDP and not pinfo.visited then self.senders:note(address, port) end
  local here, there = address .. ":" .. port, tostring(pinfo.dst) .. ":" .. pinfo.dst_port
  local key = (bus or "") .. "|" .. kind .. "|" .. here .. "|" .. there
  local line = self.lines[key]
  if not line then
    line = new_line(self, pinfo, bus, is_ip)
    self.lines[key] = line
  end
  return line, is_bus_known
end

-- Return the source of a message.
local function source_of(self, line, id)
  local source = line.sources[id]
  if not source then
    if line.is_ip then line.label = self.senders:short(line.bus) end
    source = self.reader:new_source(id, line.bus_key, line.bus, line)
    line.sources[id] = source
  end
  return source
end

-- Return the line of an adapter.
-- part  of serial.usb
local function line_of_adapter(self, part)
  local line = self.lines[part.name]
  if not line then
    line = {
      key = part.name,
      opposite = part.opposite,
      bus_key = part.device,
      bus = part.name,
      label = part.name,
      has_address = true,
      is_ip = false,
      sources = {},
    }
    self.lines[part.name] = line
  end
  return line
end

-- Return what is known of a packet, as serial.streams takes it, and
--   line          of line_of
--   is_bus_known  whether it is known where it was captured
--   tvb           where its bytes are, if a tree is wanted
--   tree          where they are shown
--   wants         of show.tree
-- tvb      its bytes; of a segment with the header of TCP
-- segment  of serial.tcp; nil for other packets
local function new_packet(self, tvb, pinfo, tree, segment)
  local start, line, is_bus_known = segment and segment.start or 0, line_of(self, pinfo)
  local bytes = tvb:len() > start and tvb:raw(start) or ""
  local number, visited, length = pinfo.number, pinfo.visited, tvb:reported_len() - start
  local wants = self.builder:wants(tree, pinfo, visited)
  local key = number * frame_key.PACKET + tvb:offset() + start
  local epoch = segment and segment.epoch or length > #bytes and pinfo.abs_ts
  if wants.tree and segment and bytes ~= "" then tvb = tvb(start):tvb() end
  return {
    key = key,
    number = number,
    bytes = bytes,
    length = length,
    truncated = length > #bytes,
    time = pinfo.rel_ts,
    epoch = epoch,
    visited = visited,
    is_datagram = line.is_datagram,
    is_complete = line.is_complete,
    is_tcp = line.is_tcp,
    is_found = self.found[line.bus_key],
    stream = line.key,
    seq = segment and segment.seq,
    bus_name = line.bus,
    line = line,
    is_bus_known = is_bus_known,
    tvb = tvb,
    tree = tree,
    wants = wants,
  }
end

-- Return the same of what an adapter carries.
-- part  of serial.usb
local function new_part(self, part, tvb, pinfo, tree)
  local bytes, line, number = part.bytes, line_of_adapter(self, part), pinfo.number
  local wants = self.builder:wants(tree, pinfo, pinfo.visited)
  if wants.tree then
    local own = part.has_status and ByteArray.new(bytes, true):tvb("Serial line")
    tvb = own or tvb(part.offset):tvb()
  end
  return {
    key = number * frame_key.PACKET + part.offset,
    number = number,
    bytes = bytes,
    length = part.truncated and #bytes + 1 or #bytes,
    truncated = part.truncated,
    time = pinfo.rel_ts,
    epoch = part.truncated and pinfo.abs_ts,
    visited = pinfo.visited,
    stream = line.key,
    bus_name = line.bus,
    line = line,
    is_bus_known = true,
    tvb = tvb,
    tree = tree,
    wants = wants,
  }
end

-- Heuristics -------------------------------------------------------------------------------------

--- Return whether bytes are YAPP: they hold a good frame, or a message of the catalogue with a bad
-- CRC or bytes missing.  Ten bytes of its header are given, so chance does not make one.
function Dissector:is_yapp(bytes)
  if not frame.find(bytes, 1) then return false end
  for _, finding in ipairs(self.streams:read(bytes)) do
    local id = finding.status ~= "skipped" and frame.parse(bytes, finding.offset + 1)
    if finding.status == "good" or id and self.reader:size_of(id) then return true end
  end
  return false
end

-- Longer packets of an unknown conversation are YAPP if one by itself is.
local MAX_SHORT = 128

--- Return whether a packet of an unknown conversation is YAPP, alone or with what came before.
function Dissector:accepts(tvb, pinfo, tree)
  if pinfo.in_error_pkt or tvb:len() == 0 then return false end
  if pinfo.visited then
    return self.streams:is_stored(pinfo.number * frame_key.PACKET + tvb:offset())
  end
  local bytes, streams_of = tvb:raw(), self.streams
  local is_yapp = self:is_yapp(bytes)
  local is_on_trial = not is_yapp and #bytes <= MAX_SHORT and streams_of:may_begin(bytes)
  if not (is_yapp or is_on_trial) then return false end
  local packet = new_packet(self, tvb, pinfo, tree)
  if packet.is_found then return false end -- dissect has left it to others
  local is_found = streams_of:try(packet, not packet.wants.is_only_pass, is_yapp)
  self.found[packet.line.bus_key] = is_found or nil
  if is_found and not is_yapp then
    table.insert(self.in_pieces, senders.option(packet.is_tcp, pinfo.src_port, pinfo.dst_port))
  end
  return is_found
end

-- Return what the statistics take of something that is no message.
-- packet  where this is noticed
-- source  of message.reader, or the line
local function new_report(packet, source, seq)
  return {
    source = source,
    seq = seq,
    key = packet.key,
    time = packet.time,
    visited = packet.visited,
  }
end

-- Messages ---------------------------------------------------------------------------------------

-- Return the message of a finding, for message.reader, and
--   length      number of bytes of its frame
--   missing     number of bytes, of one that is not complete
--   crc, calculated  of a bad one
-- and the fields of its view, see Tree:show_message.  The n-th finding of a packet has the frame
-- key of the packet + n - 1.  As a frame has at least 16 bytes, no other packet has that key, not
-- even in a tunnel that puts several packets into one.
local function new_message(self, packet, finding, index)
  local length = finding.is_telnet and #finding.bytes or finding.to - finding.from
  local key = packet.key + index - 1
  local bytes, offset = finding.bytes or packet.bytes, finding.offset or 0
  local id, size, reserved, seq = frame.parse(bytes, offset + 1)
  local m = {
    source = source_of(self, packet.line, id),
    seq = seq,
    key = key,
    time = packet.time,
    visited = packet.visited,
    is_unreliable = not packet.is_bus_known,
    size = size,
    reserved = reserved,
    payload = sub(bytes, offset + HEADER + 1, offset + math.min(HEADER + size, length)),
    length = length,
    status = finding.status,
    missing = finding.missing,
    packet_keys = finding.packet_keys,
    wants = packet.wants,
    tree = packet.tree,
    item = packet.tree,
    payload_tvb = false,
    payload_offset = offset + HEADER,
  }
  if finding.status == "bad" then
    local last = offset + length
    m.crc = frame.crc(bytes, last)
    m.calculated = crc.update(crc.INITIAL, bytes, offset + 1, last - CRC_SIZE)
  end
  return m
end

-- Add YAPP's own item of a message.
-- tvb  where the bytes of the frame are
local function add_frame(self, m, tvb)
  local builder, offset, source = self.builder, m.payload_offset - HEADER, m.source
  local fields = builder.fields
  local item = add(m.tree, builder.yapp, tvb(offset, m.length))
  append_text(item, (", %s"):format(source.label))
  add(item, fields.sync, tvb(offset, 2))
  add(item, fields.seq, tvb(offset + 2, 1))
  add(item, fields.ctl, tvb(offset + 3, 1))
  builder:add_id(item, tvb(offset + 4, 4), source)
  append_text(add_le(item, fields.size, tvb(offset + 8, 2)), " bytes")
  add_le(item, fields.reserved, tvb(offset + 10, 2))
  builder:add_source(item, source)
  if m.packet_keys then
    local payload = #m.payload > 0 and tvb(m.payload_offset, #m.payload) or nil
    builder:generated(item, "reassembled.in", frame_key.number(m.key))
    builder:add_fragments(item, tvb(), m.packet_keys, m.length, payload)
  end
  if m.missing then
    append_text(item, ", incomplete")
  else
    builder:add_crc(item, tvb(m.payload_offset + m.size, CRC_SIZE), m)
  end
  return item
end

-- Show what is wrong with a message.
local function show_anomalies(self, m)
  local builder = self.builder
  if m.status == "bad" then builder:bad_crc(m.item, m) end
  if m.missing then
    local expert = m.status == "truncated" and m.status or "fragment.incomplete"
    local text = "%d of the frame's %d bytes are missing"
    builder:expert(m.item, expert, text:format(m.missing, HEADER + m.size + CRC_SIZE))
    if self.reader.intake.wanted then self.reader.intake:anomalies(m, { { expert = expert } }) end
  end
  if m.reserved ~= 0 then
    local text = ("The reserved bytes are 0x%04x, not 0"):format(m.reserved)
    builder:expert(m.item, "reserved.nonzero", text)
  end
end

-- Show a message; return what the Info column says of it.
local function show_message(self, m, tvb)
  local builder, source = self.builder, m.source
  local has_offsets = self.reader:read(m, self.history, m.wants)
  if m.status ~= "good" then m.delta = false end -- its ID may be damaged, unlike a CAN id
  if m.wants.tree then m.item, m.payload_tvb = add_frame(self, m, tvb), tvb end
  show_anomalies(self, m)
  local mark = builder.MARKS[m.status]
  if has_offsets or not source.message then return builder:show_message(m, m) .. mark end
  if m.wants.yapp and #m.payload > 0 then
    add(m.item, builder.fields.payload, tvb(m.payload_offset, #m.payload))
  end
  return source.label .. mark
end

-- Bytes of no frame ------------------------------------------------------------------------------

-- Control characters of a terminal, and how they are shown.
local CONTROLS = {
  ["\a"] = "\\a",
  ["\b"] = "\\b",
  ["\t"] = "\\t",
  ["\n"] = "\\n",
  ["\r"] = "\\r",
  ["\27"] = "\\e",
}

-- Return a space and bytes as quoted text, "" if they are no text.
local function quote(bytes)
  if utf8.ascii(bytes):find("[^%g \a\b\t\n\r\27]") then return "" end
  local text = bytes
  if #bytes > 80 then
    text = bytes:sub(1, 80):gsub("[\192-\255][\128-\191]*$", "") .. "..."
  end
  return ' "' .. text:gsub("%c", CONTROLS) .. '"'
end

-- Show skipped bytes; return their text for the Info column.
local function show_skipped(self, packet, tvb, finding)
  local builder, item, intake = self.builder, packet.tree, self.reader.intake
  local length, offset = finding.to - finding.from, finding.offset or 0
  local text = quote(finding.bytes or sub(packet.bytes, offset + 1, offset + length))
  local size = builder.bytes(length)
  if packet.wants.tree then
    item = add(item, builder.yapp, tvb(offset, length))
    append_text(item, (", %s skipped"):format(size))
    append_text(add(item, builder.fields.skipped, tvb(offset, length)), text)
  end
  local expert = size .. " that belong to no frame" .. text:gsub("^ ", ": ")
  builder:expert(item, "stream.skipped", expert)
  if intake.wanted then intake:skipped(new_report(packet, packet.line), length) end
  return ("Skipped %s%s"):format(size, text)
end

-- Return what the Info column says of pending bytes.
local function pending_text(contents, size, leads_to)
  if leads_to then return ("[Reassembled in #%d]"):format(leads_to) end
  if contents.is_held then return ("[%s behind a missing TCP segment]"):format(size) end
  if contents.missing then return ("[%s of a frame, %d to come]"):format(size, contents.missing) end
  return ("[%s wait for more]"):format(size)
end

-- Show the pending bytes of a packet; return what the Info column says of them.
local function show_pending(self, packet, contents)
  local builder, item, pending = self.builder, packet.tree, contents.pending
  local leads_to = contents.leads_to and frame_key.number(contents.leads_to)
  if packet.wants.tree then
    local range = packet.tvb(#packet.bytes - pending, pending)
    item = add(item, builder.yapp, range)
    append_text(item, ", part of a frame")
    add(item, builder.fields["fragment.data"], range)
    builder:generated(item, "reassembled.in", leads_to)
  end
  if packet.visited and self.streams:is_unfinished(contents, packet) then
    builder:expert(item, "unfinished")
  end
  return pending_text(contents, builder.bytes(pending), leads_to)
end

-- Dissection -------------------------------------------------------------------------------------

-- Show a finding of a packet; return what the Info column says of it, and the name of its source.
local function show_finding(self, packet, finding, index)
  local tvb = packet.tvb
  if finding.bytes and packet.wants.tree then
    tvb = ByteArray.new(finding.bytes, true):tvb("Reassembled YAPP")
  end
  if finding.status == "skipped" then return show_skipped(self, packet, tvb, finding) end
  local m = new_message(self, packet, finding, index)
  return show_message(self, m, tvb), m.source.text
end

-- Show what a packet holds.
local function show(self, packet, pinfo, contents)
  local wants, texts, source, tree = packet.wants, {}, nil, packet.tree
  if wants.names and not wants.tree then self.builder:add_protocol_names(tree, wants, true) end
  for i, finding in ipairs(contents.findings) do
    local text, name = show_finding(self, packet, finding, i)
    source = source or name
    if i <= MAX_IN_INFO then texts[i] = text end
  end
  local more = #contents.findings - MAX_IN_INFO
  if more > 0 then texts[#texts + 1] = ("and %d more"):format(more) end
  if contents.pending > 0 then texts[#texts + 1] = show_pending(self, packet, contents) end
  if not wants.columns or not texts[1] then return end
  local columns = pinfo.cols
  columns.protocol, columns.info = "YAPP", table.concat(texts, " | ")
  if source and not packet.line.has_address then columns.src = source end
end

-- Dissect a packet; return whether it is YAPP's.
local function dissect(self, packet, pinfo)
  local contents
  if packet.visited then
    contents = self.streams:find(packet)
    if not contents then return false end
  else
    contents = self.streams:take(packet, not packet.wants.is_only_pass)
    if contents.is_others then return false end
  end
  show(self, packet, pinfo, contents)
  local last = contents.findings[#contents.findings]
  if packet.truncated and packet.bytes ~= "" and not (last and last.missing) then
    local text = "The capture has %d of the packet's %d bytes"
    self.builder:expert(packet.tree, "truncated", text:format(#packet.bytes, packet.length))
  end
  return true
end

-- Let a packet be what TLS found in a segment: a stream beside that of TCP.  Several records of a
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
  packet.stream, packet.key = "tls|" .. packet.stream, number * frame_key.PACKET + offset
end

-- Dissect a segment that TCP has shown.
local function dissect_segment(self, segment, tvb, pinfo, tree)
  local line = line_of(self, pinfo)
  local has_order = pinfo.visited or self.streams:note_header(line.key, line.opposite, segment)
  line.is_direct = line.is_direct or segment.is_ours
  if segment.length == 0 or not (segment.is_ours or has_order) then return end
  dissect(self, new_packet(self, tvb, pinfo, tree, segment), pinfo)
end

--- Watch TCP, to know the sequence numbers from the first segment on.
function Dissector:watch_tcp()
  tcp.watch(self.tcp_header, function(...) dissect_segment(self, ...) end)
end

-- Dissect bytes in TCP.  Those of a segment are shown when TCP has shown the segment.  Others are
-- what TLS found in one, unless TCP has joined segments: but then others of the line came alone.
-- returns  whether they are YAPP's
local function dissect_in_tcp(self, tvb, pinfo, tree)
  local segment, offset = tcp.current(pinfo.number), tvb:offset()
  local is_direct = segment and offset == segment.offset or not segment and offset > 0
  is_direct = is_direct or line_of(self, pinfo).is_direct
  if segment and is_direct then
    segment.is_ours = true -- these bytes may be of several: dissect_segment shows it
    return true
  end
  local packet = new_packet(self, tvb, pinfo, tree)
  if is_direct then
    self:watch_tcp()
  else
    put_inside(self, packet) -- TLS needs no watch, and would lose the records that came before
  end
  return dissect(self, packet, pinfo)
end

--- Dissect the bytes of a packet.
-- returns  the number of bytes that are ours
function Dissector:dissect(tvb, pinfo, tree)
  local size = tvb:len()
  -- An ICMP error only quotes what was sent before.
  if size == 0 or pinfo.in_error_pkt then return 0 end
  if pinfo.port_type == TCP then return dissect_in_tcp(self, tvb, pinfo, tree) and size or 0 end
  return dissect(self, new_packet(self, tvb, pinfo, tree), pinfo) and size or 0
end

--- Dissect a packet of USB that Wireshark has shown, if it has bytes of a serial line with YAPP.
-- kind  of serial.usb
function Dissector:dissect_usb(kind, tvb, pinfo, tree)
  local part = self.usb:read(kind, tvb:raw())
  if not part or part.bytes == "" then return end
  local is_found, streams_of, bytes = self.found[part.name], self.streams, part.bytes
  local may_be = is_found or self:is_yapp(bytes) or streams_of:may_begin(bytes)
  if not may_be then return end
  local packet = new_part(self, part, tvb, pinfo, tree)
  if not (is_found or packet.visited) then
    is_found = streams_of:try(packet, not packet.wants.is_only_pass, self:is_yapp(bytes))
    self.found[part.name] = is_found or nil
  end
  if is_found then dissect(self, packet, pinfo) end
end

--- Dissect bytes of a raw dump that are of no frame.
-- returns  the number of bytes that are ours
function Dissector:skipped(tvb, pinfo, tree)
  local size = tvb:len()
  if size > 0 then
    local finding = { status = "skipped", from = 0, to = size, offset = 0 }
    show(self, new_packet(self, tvb, pinfo, tree), pinfo, { findings = { finding }, pending = 0 })
  end
  return size
end

-- Report a finding in bytes that wait when the capture ends.  Wireshark may capture on: there every
-- message that waits is one that the capture ends before.
local function report_waiting(self, list, packet, finding, i)
  local id, _, _, seq = frame.parse(finding.bytes, finding.offset + 1)
  local length = finding.to - finding.from
  if finding.status == "skipped" then
    local is_sure = length >= HEADER -- else it may be a part of one
    if is_sure then self.reader.intake:skipped(new_report(packet, packet.line), length) end
  elseif finding.missing or gui_enabled() then
    list[#list + 1] = new_report(packet, source_of(self, packet.line, id), seq)
    self.reader.intake:fragment(list[#list])
  else
    -- The key of no other message: packets have fewer findings than bytes.
    local m = new_message(self, packet, finding, packet.length + i)
    self.reader:read(m, self.history, packet.wants)
  end
end

--- Return the messages that the capture ends before.  Report their last bytes to the statistics,
-- and what else waits: messages behind one that seems to be open, or behind a TCP gap.
-- returns  list of { source, seq, key = frame key of the packet with its last bytes, ... }
function Dissector:unfinished()
  local list = {}
  for _, open in ipairs(self.streams:unfinished()) do
    for i, finding in ipairs(open.findings) do
      report_waiting(self, list, open.packet, finding, i)
    end
  end
  return list
end

--- Return what to say of conversations whose packets hold no whole header: a list of texts.
function Dissector:notes()
  if not self.in_pieces[1] then return {} end
  local text = "YAPP came in pieces without a whole header: to list its packets, add %s"
  return { text:format(table.concat(self.in_pieces, " ")) }
end

--- Return the gaps in TCP connections, in the form of Buses:drops.
function Dissector:drops()
  return self.streams:drops()
end

return M
