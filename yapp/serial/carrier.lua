-- SPDX-License-Identifier: GPL-2.0-or-later
-- YAPP in byte streams and datagrams, UART captures, TCP, UDP: asks the memory what a packet holds, and shows it.
-- Wireshark's API.

local frame = require("yapp.wire.frame")
local items = require("yapp.show.items")

local M = {}

local add, add_le, add_generated, append_text = items.add, items.add_le, items.add_generated, items.append_text

local HEADER, CRC_SIZE = frame.HEADER, frame.CRC_SIZE

local TCP, UDP = 2, 3 -- pinfo.port_type
local length_of, raw_of, reported_of, offset_of = Tvb.len, Tvb.raw, Tvb.reported_len, Tvb.offset -- see show.items
local ONE_MORE_SEGMENT = 0x0fffffff -- DESEGMENT_ONE_MORE_SEGMENT

local Carrier = {}
Carrier.__index = Carrier

--- The serial side of the plugin.
-- parts    the modules { crc =, serial_memory =, serial_stream =, utf8 = }
-- tree     a tree builder (show.tree)
-- reader   a message.reader: what a finished message means
-- facts    a host.facts
function M.new(tree, reader, facts)
  local parts = { crc = require "yapp.wire.crc", serial_memory = require "yapp.serial.memory",
    serial_stream = require "yapp.serial.stream", utf8 = require "yapp.base.utf8" }
  local self = setmetatable({ parts = parts, tree = tree, reader = reader, facts = facts, fact = {}, view = {},
    message = {} }, Carrier)
  function self.accepts(id, size)
    local message = reader:message_of(id)
    return not message or message.size == size
  end
  return self
end

--- Forgets the capture file.
-- options  { new_history = function() -> a message.history }
function Carrier:reset(options)
  self.memory = self.parts.serial_memory.new(self.parts.crc, {
    new_framer = function() return self:framer() end, new_history = options.new_history })
  self.latest = {} -- [stream]: its latest packet that ends within a frame, as the statistics are told of one
end

--- A framer of a stream: a serial.stream.
function Carrier:framer()
  return self.parts.serial_stream.new(self.parts.crc, self.accepts)
end

--- Whether bytes hold one whole frame with a good CRC: what a heuristic has to see.
function Carrier:has_frame(bytes)
  local framer = self:framer()
  for _, event in ipairs(framer:feed(bytes)) do
    if event.good then return true end
  end
  return false
end

-- What is shown -------------------------------------------------------------------------------------------------

-- What a terminal gets besides letters, as it is shown.
local CONTROLS = { ["\a"] = "\\a", ["\b"] = "\\b", ["\t"] = "\\t", ["\n"] = "\\n", ["\r"] = "\\r", ["\27"] = "\\e" }

-- Text as a shell prints it, or nil for other bytes.
local function printable(utf8, bytes)
  if utf8.ascii(bytes):find("[^%g \a\b\t\n\r\27]") then return nil end
  local text = bytes
  if #bytes > 80 then text = bytes:sub(1, 80):gsub("[\192-\255][\128-\191]*$", "") .. "..." end
  return '"' .. text:gsub("%c", CONTROLS) .. '"'
end

-- YAPP's own item.  tvb and at: where the bytes of the frame are.
local function add_frame(self, view, tvb, at, message)
  local builder, status = self.tree, message.status
  local fields = builder.fields
  local item = add(view.tree, builder.yapp, tvb(at, message.length))
  append_text(item, (", %s"):format(builder:name(message.id, view.bus_name)))
  add(item, fields.sync, tvb(at, 2))
  add(item, fields.seq, tvb(at + 2, 1))
  add(item, fields.ctl, tvb(at + 3, 1))
  builder:add_id(item, tvb(at + 4, 4), message.id, view.bus_name)
  append_text(add_le(item, fields.size, tvb(at + 8, 2)), " bytes")
  add_le(item, fields.reserved, tvb(at + 10, 2))
  builder:add_source(item, message.id, view.bus_name)
  if message.parts then
    add_generated(item, fields["reassembled.in"], message.shown_in)
    builder:add_fragments(item, tvb, message.parts, #message.parts, message.length)
  end
  if status ~= "cut" then builder:add_crc(item, tvb(at + HEADER + message.size, CRC_SIZE), message) end
  append_text(item, status == "good" and ", CRC good" or status == "bad" and ", CRC BAD" or ", not whole")
  return item
end

-- The key of a source.
local function source_of(stream, id)
  return stream .. "|" .. id
end

-- What a frame means, and its history: in a record that is used again, as nobody keeps it.
local function read(self, view, index, message)
  local fact, name, m = view.fact, view.bus_name, self.message
  m.tree, m.wanted, m.id, m.seq, m.ctl = view.tree, view.wanted, message.id, message.seq, message.ctl
  m.size, m.payload, m.status, m.good = message.size, message.payload, message.status, message.status == "good"
  m.is_whole, m.source, m.bus, m.bus_name = true, source_of(fact.stream, message.id), view.bus_key, name
  m.has_columns = view.wants.columns
  m.name, m.frame, m.time = self.tree:name(message.id, name), fact.number, view.pinfo.rel_ts
  m.visited, m.is_brief, m.is_unsure = fact.visited, not view.wanted, nil
  self.reader:read(m, self.memory, view.packet, index, fact)
  return m
end

-- A frame, good, bad or cut; returns what the Info column says of it.
local function show_frame(self, view, tvb, index)
  local message = view.packet.events[index]
  local builder, status, at = self.tree, message.status, message.at or 0
  local m = read(self, view, index, message)
  m.item = view.wanted and add_frame(self, view, tvb, at, message) or view.tree
  m.tvb, m.at = view.wanted and tvb, at + HEADER
  if status == "bad" then builder:bad_crc(m.item, message) end
  if status == "cut" then
    local text = ("The frame has %d bytes, %d of them are missing"):format(HEADER + message.size + CRC_SIZE,
      message.missing)
    local expert = message.truncated and "truncated" or "fragment.incomplete"
    builder:expert(m.item, expert, text)
    if self.reader.stat.wanted then self.reader.tell:faults(m, { { expert = expert } }) end
  end
  return builder:payload(m) .. (status == "bad" and "  [BAD CRC]" or status == "cut" and "  [INCOMPLETE]" or "")
end

local function show_skipped(self, view, tvb, at, bytes)
  local builder = self.tree
  local text = printable(self.parts.utf8, bytes)
  local item = view.tree
  if view.wanted then
    item = item:add(builder.yapp, tvb(at, #bytes))
    item:append_text((", %s skipped"):format(builder.bytes(#bytes)))
    local skipped = item:add(builder.fields.skipped, tvb(at, #bytes))
    if text then skipped:append_text(" " .. text) end
  end
  builder:expert(item, "stream.skipped", ("%s that belong to no frame%s"):format(
    builder.bytes(#bytes), text and ": " .. text or ""))
  return ("Skipped %s%s"):format(builder.bytes(#bytes), text and " " .. text or "")
end

-- Shows the bytes at the packet's end that wait for more; returns what the Info column says of them.
local function show_pending(self, view, packet)
  local builder, pending, leads_to, item = self.tree, packet.pending, packet.leads_to, view.tree
  if view.wants.yapp then
    local range = view.tvb(packet.done, pending)
    item = add(item, builder.yapp, range)
    append_text(item, ", part of a frame")
    add(item, builder.fields["fragment.data"], range)
    if leads_to then add_generated(item, builder.fields["reassembled.in"], leads_to) end
  end
  if packet.is_unfinished then builder:expert(item, "unfinished") end
  return leads_to and ("[Reassembled in #%d]"):format(leads_to) or
    packet.missing and ("[%s of a frame, %d to come]"):format(builder.bytes(pending), packet.missing) or
    ("[%s wait for more]"):format(builder.bytes(pending))
end

-- Shows what a packet holds; what lies in the packet has no bytes of its own.
-- view  { tvb, pinfo, tree, wants, packet, fact, bus_key, bus_name }; gets wanted = whether anyone wants a tree
local function show(self, view)
  local tvb, packet, wants, raw, info = view.tvb, view.packet, view.wants, view.fact.bytes, ""
  local events = packet.events
  view.wanted = wants.yapp or wants.taurus
  if not view.wanted then self.tree:bare(view.tree, wants, true) end
  for i, event in ipairs(events) do
    local source, at, bytes = tvb, event.at, event.bytes
    local text
    if bytes and view.wanted then source = ByteArray.new(bytes, true):tvb("Reassembled YAPP") end
    if event.status == "skipped" then
      text = show_skipped(self, view, source, at or 0, bytes or raw:sub(at + 1, at + event.length))
    else
      text = show_frame(self, view, source, i)
    end
    if i <= 10 then info = i == 1 and text or info .. " | " .. text end
  end
  if #events > 10 then info = ("%s | and %d more"):format(info, #events - 10) end
  if packet.pending > 0 then info = info .. (events[1] and " | " or "") .. show_pending(self, view, packet) end
  if not wants.columns then return end
  local columns = view.pinfo.cols
  columns.protocol, columns.info = "YAPP", info
end

-- Statistics are told of the frames that the capture ends before, and when their last bytes came.
local function note_latest(self, pinfo, fact, bus_key, bus_name)
  self.latest[fact.stream] = { frame = fact.number, time = pinfo.rel_ts, bus = bus_key, bus_name = bus_name }
end

--- The messages that the capture ends before, for the statistics.
-- returns  list of { source, seq, frame = number of the packet with its last bytes }
function Carrier:unfinished()
  local list = {}
  for _, open in ipairs(self.memory:unfinished()) do
    local m = self.latest[open.stream]
    if m and m.frame == open.number then
      local id, _, _, seq = frame.parse(open.header, 1)
      m.id, m.seq, m.source = id, seq, source_of(open.stream, id)
      self.reader.tell:part(m)
      list[#list + 1] = m
    end
  end
  return list
end

-- The capture cut the packet short: this is said at the frame that it cut, where there is one.
local function say_truncated(self, tvb, tree, events)
  local last = events[#events]
  if not (last and last.status == "cut") then
    self.tree:expert(tree, "truncated", ("The capture has %d of the packet's %d bytes"):format(tvb:len(),
      tvb:reported_len()))
  end
end

-- What is asked --------------------------------------------------------------------------------------------------

-- How a packet's bytes come: see the memory.
local function transport_of(pinfo)
  local kind = pinfo.port_type
  return kind == UDP and "datagram" or kind == TCP and pinfo.can_desegment > 0 and "segment" or "stream", kind
end

-- By which packets of one stream know each other.
local function key_of(pinfo, kind, source)
  return ("%s|%d|%s|%d|%s|%d"):format(source or "", kind, tostring(pinfo.src), pinfo.src_port, tostring(pinfo.dst),
    pinfo.dst_port)
end

-- By which a Command and what it commands know each other: both ways of a conversation; all there is on a UART, whose
-- directions are sources of their own.
local function bus_of(pinfo, kind)
  if kind ~= UDP and kind ~= TCP then return "serial" end
  local one = ("%s|%s"):format(tostring(pinfo.src), pinfo.src_port)
  local other = ("%s|%s"):format(tostring(pinfo.dst), pinfo.dst_port)
  return one < other and one .. other or other .. one
end

-- The number of a packet's interface or direction.  Where the file's first bytes have one source, that has none: a look
-- that is told no more then finds the same.  Others that show later have theirs where the first pass was told of them.
local function source_of_packet(self, pinfo, kind)
  if kind == UDP or kind == TCP then return nil end
  local bus = self.facts:of(pinfo)
  if self.facts:are_several() then return bus end
  return bus and bus > 1 and (not pinfo.visited or self.memory:is_informed()) and bus or nil
end

-- The facts of a packet, in a record that is used again; its bus, for history; and the name of that.
local function facts_of(self, tvb, pinfo, length)
  local fact, transport, kind = self.fact, transport_of(pinfo)
  local source = source_of_packet(self, pinfo, kind)
  fact.number, fact.place, fact.bytes, fact.transport = pinfo.number, offset_of(tvb), raw_of(tvb), transport
  fact.visited, fact.informed, fact.truncated = pinfo.visited, source ~= nil, reported_of(tvb) > length
  fact.stream = key_of(pinfo, kind, source)
  return fact, bus_of(pinfo, kind), self.facts:name(source, kind == UDP or kind == TCP)
end

--- tshark's taps see one of the first packets: see serial.memory.
function Carrier:tapped(number)
  self.memory:tapped(number)
end

--- Dissects what a carrier hands over.
-- returns the number of bytes that are ours
function Carrier:dissect(tvb, pinfo, tree)
  local length = length_of(tvb)
  if length == 0 or pinfo.in_error_pkt then return 0 end -- an ICMP error only quotes what was sent before
  local fact, bus_key, bus_name = facts_of(self, tvb, pinfo, length)
  local packet = self.memory:look(fact)
  if not packet then return 0 end
  local events, transport, size = packet.events, fact.transport, #fact.bytes
  local wants = self.tree:wants(tree, pinfo, fact.visited)
  if wants.is_only_pass then self.memory:only_pass() end
  if #events > 0 or transport ~= "segment" then
    local view = self.view
    view.tvb, view.pinfo, view.tree, view.packet, view.fact = tvb, pinfo, tree, packet, fact
    view.wants, view.bus_key, view.bus_name = wants, bus_key, bus_name
    show(self, view)
  end
  if self.reader.stat.wanted and packet.done < size then
    note_latest(self, pinfo, fact, bus_key, bus_name)
  end
  if transport == "segment" then
    if packet.done < size then pinfo.desegment_offset, pinfo.desegment_len = packet.done, ONE_MORE_SEGMENT end
  elseif fact.truncated then
    say_truncated(self, tvb, tree, events)
  end
  return size
end

--- Dissects bytes of which it is known that they belong to no frame.
-- returns the number of bytes that are ours
function Carrier:skipped(tvb, pinfo, tree)
  local size = tvb:len()
  if size > 0 then
    show(self, { tvb = tvb, pinfo = pinfo, tree = tree, wants = self.tree:wants(tree, pinfo, true),
      fact = { bytes = tvb:raw() },
      packet = { events = { { status = "skipped", at = 0, length = size } }, pending = 0 } })
  end
  return size
end

return M
