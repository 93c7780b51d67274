-- SPDX-License-Identifier: GPL-2.0-or-later
-- Shows YAPP in byte streams and datagrams: UART captures, raw dumps, TCP and UDP.
-- Wireshark's API.

local frame = require("yapp.wire.frame")
local framer = require("yapp.serial.framer")
local items = require("yapp.show.fields")
local streams = require("yapp.serial.streams")
local tcp = require("yapp.serial.tcp")
local utf8 = require("yapp.base.utf8")

local M = {}

local add, add_le = items.add, items.add_le
local add_generated, append_text = items.add_generated, items.append_text
local floor = math.floor

local HEADER, CRC_SIZE = frame.HEADER, frame.CRC_SIZE

local TCP, UDP = 2, 3 -- pinfo.port_type
local NO_ADDRESS = { [""] = true, NONE = true } -- as the API has it
local MAX_IN_INFO = 10 -- frames of a packet

-- The frame key of a packet: number * PACKET + offset of its bytes.  Its n-th event has key + n - 1:
-- a frame takes 16 bytes, so that is no other packet's key, also if a tunnel has several in one.
local PACKET = 2 ^ 17

-- What history says in frame keys.
local LINKS = { "command_in", "previous_change", "next_change" }

local Dissector = {}
Dissector.__index = Dissector

--- Make the dissector.
-- tree    a show.tree
-- reader  a message.reader
-- buses   a host.buses
-- watch   Proto for the look at TCP's headers
function M.new(tree, reader, buses, watch)
  return setmetatable({
    tree = tree,
    reader = reader,
    buses = buses,
    watch = watch,
    streams = nil, -- a serial.streams
    history = nil, -- a message.history
    deltas = {},   -- [frame key] = seconds since the source's previous good message
    sources = {},  -- [key of a stream][ID] = a source, see message.reader
    has_tcp = false, -- whether a TCP connection is YAPP's
  }, Dissector)
end

--- Forget the capture file.
-- new_history  function() -> a message.history
function Dissector:reset(new_history)
  self.streams = streams.new(function() return self:new_framer() end)
  self.history = new_history()
  self.deltas, self.sources, self.has_tcp = {}, {}, false
  tcp.stop()
end

--- Make a framer.
-- patience  of serial.framer; nil for the usual
function Dissector:new_framer(patience)
  return framer.new(function(id) return self.reader:size_of(id) end, patience)
end

--- Whether bytes are YAPP, for a heuristic: they hold a good frame, or they are nothing but messages
-- of the catalogue, which may be damaged.  Headers must be the document's: another ID or size may be
-- somebody else's.
function Dissector:is_yapp(bytes)
  local finder, is_catalogue = self:new_framer(), true
  local function fits(id, size) return self.reader:fits(id, size) ~= false end
  for _, found in ipairs { finder:feed(bytes), finder:finish() } do
    for _, event in ipairs(found) do
      local is_frame = frame.judge(event.bytes, 1, fits) ~= nil
      if is_frame and event.status == "good" then return true end
      local id, size = frame.parse(event.bytes, 1)
      local is_known = event.status ~= "skipped" and is_frame and self.reader:fits(id, size)
      is_catalogue = is_catalogue and is_known
    end
  end
  return is_catalogue
end

-- Packets ----------------------------------------------------------------------------------------

-- Returns sender and receiver of a packet.
local function ends_of(pinfo)
  return ("%s|%d"):format(tostring(pinfo.src), pinfo.src_port),
    ("%s|%d"):format(tostring(pinfo.dst), pinfo.dst_port)
end

-- Returns the key of the stream from one end to another.
-- bus  number, nil for none
local function stream_key(kind, bus, here, there)
  return ("%s|%d|%s|%s"):format(bus or "", kind, here, there)
end

-- Returns what is known of a packet: what serial.streams takes, and
--   bus_key      by which a Command and what it commands know each other: both directions of a
--                conversation; all of a UART
--   line         text that tells its sources apart, nil if nothing does
--   has_address  whether it has a sender
local function new_packet(self, tvb, pinfo, segment)
  local kind, number, bytes = pinfo.port_type, pinfo.number, tvb and tvb:raw() or ""
  local is_ip = kind == UDP or kind == TCP
  local here, there = ends_of(pinfo)
  local bus = not is_ip and self.buses:of(pinfo, number) or nil
  local bus_name, has_address = self.buses:name(bus, is_ip), not NO_ADDRESS[tostring(pinfo.src)]
  local line, bus_key = bus and bus_name, "serial"
  if has_address then line = here:gsub("|", ":") end
  if is_ip then bus_key = here < there and here .. there or there .. here end
  local length = segment and segment.length or tvb:reported_len()
  return {
    key = number * PACKET + (segment and segment.offset or tvb:offset()),
    number = number,
    bytes = bytes,
    length = length,
    truncated = length > #bytes,
    time = pinfo.rel_ts,
    epoch = segment and pinfo.abs_ts,
    visited = pinfo.visited,
    transport = kind == UDP and "datagram" or "stream",
    stream = stream_key(kind, bus, here, there),
    seq = segment and segment.seq,
    bus_key = bus_key,
    bus_name = bus_name,
    line = line,
    has_address = has_address,
  }
end

-- Returns the source of a message, see message.reader.
local function source_of(self, packet, id)
  local of_stream = self.sources[packet.stream] or {}
  self.sources[packet.stream] = of_stream
  local source = of_stream[id]
  if not source then
    local key = packet.stream .. "|" .. id
    source = self.reader:new_source(key, id, packet.bus_key, packet.bus_name, packet.line)
    of_stream[id] = source
  end
  return source
end

-- History ----------------------------------------------------------------------------------------

--- Return what changed with a message, see message.history; nil for nothing.
-- m  of message.reader; gets delta
function Dissector:change(m)
  if not m.good then return nil end
  if m.visited then
    m.delta = self.deltas[m.number] or false
    return self.history:change(m)
  end
  local change, delta = self.history:note(m)
  m.delta = delta or false
  if not m.wants.is_only_pass then self.deltas[m.number] = delta end
  return change
end

--- Return the state at a message, see message.history, with numbers of packets.
-- m  as Dissector:change has had it
function Dissector:standing(m)
  local state = m.good and self.history:standing(m)
  for _, name in ipairs(state and LINKS or {}) do
    state[name] = state[name] and floor(state[name] / PACKET)
  end
  return state
end

-- What is shown ----------------------------------------------------------------------------------

-- Control characters of a terminal, and how they are shown.
local CONTROLS = {
  ["\a"] = "\\a",
  ["\b"] = "\\b",
  ["\t"] = "\\t",
  ["\n"] = "\\n",
  ["\r"] = "\\r",
  ["\27"] = "\\e",
}

-- Returns bytes as quoted text, nil if they are no text.
local function quote(bytes)
  if utf8.ascii(bytes):find("[^%g \a\b\t\n\r\27]") then return nil end
  local text = bytes
  if #bytes > 80 then
    text = bytes:sub(1, 80):gsub("[\192-\255][\128-\191]*$", "") .. "..."
  end
  return '"' .. text:gsub("%c", CONTROLS) .. '"'
end

local LABELS = { good = ", CRC good", bad = ", CRC BAD", incomplete = ", incomplete" }
local MARKS = { good = "", bad = "  [BAD CRC]", incomplete = "  [INCOMPLETE]" } -- in the Info column

-- Returns the numbers of the packets with these keys.
local function numbers_of(keys)
  local numbers = {}
  for i, key in ipairs(keys) do numbers[i] = floor(key / PACKET) end
  return numbers
end

-- Adds YAPP's own item of a message.
-- tvb, at  where the bytes of the frame are
local function add_frame(self, view, source, tvb, at, message)
  local builder, packet = self.tree, view.packet
  local fields = builder.fields
  local item = add(view.tree, builder.yapp, tvb(at, message.length))
  append_text(item, (", %s"):format(source.name))
  add(item, fields.sync, tvb(at, 2))
  add(item, fields.seq, tvb(at + 2, 1))
  add(item, fields.ctl, tvb(at + 3, 1))
  builder:add_id(item, tvb(at + 4, 4), message.id, packet.bus_name)
  append_text(add_le(item, fields.size, tvb(at + 8, 2)), " bytes")
  add_le(item, fields.reserved, tvb(at + 10, 2))
  builder:add_source(item, source)
  if message.parts then
    local numbers = numbers_of(message.parts)
    local payload = #message.payload > 0 and tvb(at + HEADER, #message.payload) or nil
    add_generated(item, fields["reassembled.in"], packet.number)
    builder:add_fragments(item, tvb(), numbers, #numbers, message.length, payload)
  end
  if message.status ~= "incomplete" then
    builder:add_crc(item, tvb(at + HEADER + message.size, CRC_SIZE), message)
  end
  append_text(item, LABELS[message.status])
  return item
end

-- Says that a message lost bytes.
local function say_incomplete(self, m, message)
  local expert = message.truncated and "truncated" or "fragment.incomplete"
  local text = ("%d of the frame's %d bytes are missing")
    :format(message.missing, HEADER + message.size + CRC_SIZE)
  self.tree:expert(m.item, expert, text)
  if self.reader.stat.wanted then
    self.reader.tell:faults(m, { { expert = expert } })
  end
end

-- Returns a message as message.reader, message.history, show.tree and the statistics take it.
local function new_message(view, source, message, index)
  local packet, status = view.packet, message.status
  return {
    source = source.key,
    id = message.id,
    name = source.name,
    bus = source.bus,
    bus_name = source.bus_name,
    stream = packet.stream,
    seq = message.seq,
    size = message.size,
    payload = message.payload,
    status = status,
    good = status == "good",
    -- Nobody knows where in it bytes are missing, unless the capture cut it.
    is_whole = status ~= "incomplete" or message.truncated or false,
    number = packet.key + index - 1,
    frame = packet.number,
    time = packet.time,
    visited = packet.visited,
    wants = view.wants,
    tree = view.tree,
    item = view.tree,
    tvb = false,
    at = 0,
    delta = false,
    is_unsure = false,
  }
end

-- Shows a message; returns what the Info column says of it, and its source.
local function show_message(self, view, tvb, event, index)
  local builder, packet = self.tree, view.packet
  local message = streams.message(event, packet.bytes)
  local status, at, source = message.status, event.at or 0, source_of(self, packet, message.id)
  local m = new_message(view, source, message, index)
  self.reader:read(m, self)
  if m.wants.tree then
    m.item, m.tvb, m.at = add_frame(self, view, source, tvb, at, message), tvb, at + HEADER
  end
  if status == "bad" then builder:bad_crc(m.item, message) end
  if status == "incomplete" then say_incomplete(self, m, message) end
  if message.reserved ~= 0 then
    local text = ("The reserved bytes are 0x%04x, not 0"):format(message.reserved)
    builder:expert(m.item, "reserved.nonzero", text)
  end
  if m.is_whole or not m.message then return builder:payload(m) .. MARKS[status], source end
  if m.wants.yapp and #m.payload > 0 then
    add(m.item, builder.fields.payload, tvb(m.at, #m.payload))
  end
  return m.name .. MARKS[status], source
end

-- Shows bytes of no frame; returns what the Info column says of them.
local function show_skipped(self, view, tvb, event)
  local builder, packet, tell = self.tree, view.packet, self.reader.tell
  local length, at, item = event.to - event.from, event.at or 0, view.tree
  local bytes = event.bytes or packet.bytes:sub(at + 1, at + length)
  local text, size = quote(bytes), builder.bytes(length)
  if view.wants.tree then
    item = add(item, builder.yapp, tvb(at, length))
    append_text(item, (", %s skipped"):format(size))
    local skipped = add(item, builder.fields.skipped, tvb(at, length))
    if text then append_text(skipped, " " .. text) end
  end
  local quoted = text and ": " .. text or ""
  builder:expert(item, "stream.skipped", ("%s that belong to no frame%s"):format(size, quoted))
  if self.reader.stat.wanted and tell.skipped then
    tell:skipped {
      frame = packet.number,
      time = packet.time,
      visited = packet.visited,
      bus = packet.bus_key,
      bus_name = packet.bus_name,
      source = packet.stream,
      length = length,
    }
  end
  return ("Skipped %s%s"):format(size, text and " " .. text or "")
end

-- Returns what the Info column says of pending bytes.
local function pending_text(contents, size, leads_to)
  if leads_to then return ("[Reassembled in #%d]"):format(leads_to) end
  if contents.is_held then return ("[%s behind a missing TCP segment]"):format(size) end
  if contents.missing then return ("[%s of a frame, %d to come]"):format(size, contents.missing) end
  return ("[%s wait for more]"):format(size)
end

-- Shows the bytes at the end of a packet that wait for more; returns what the Info column says.
local function show_pending(self, view, contents)
  local builder, packet, item = self.tree, view.packet, view.tree
  local pending, leads_to = contents.pending, contents.leads_to
  leads_to = leads_to and floor(leads_to / PACKET)
  if view.wants.tree then
    local range = view.tvb(#packet.bytes - pending, pending)
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

-- Shows what a packet holds.  A view is what most of the above look at.
local function show(self, tvb, pinfo, tree, packet, contents, wants)
  local events, texts, first_source = contents.events, {}, nil
  local view = { tvb = tvb, tree = tree, packet = packet, wants = wants }
  if wants.names and not wants.tree then self.tree:bare(tree, wants, true) end
  for i, event in ipairs(events) do
    local event_tvb, text, source = tvb, nil, nil
    if event.bytes and wants.tree then
      event_tvb = ByteArray.new(event.bytes, true):tvb("Reassembled YAPP")
    end
    if event.status == "skipped" then
      text = show_skipped(self, view, event_tvb, event)
    else
      text, source = show_message(self, view, event_tvb, event, i)
    end
    first_source = first_source or source
    if i <= MAX_IN_INFO then texts[i] = text end
  end
  if #events > MAX_IN_INFO then
    texts[#texts + 1] = ("and %d more"):format(#events - MAX_IN_INFO)
  end
  if contents.pending > 0 then texts[#texts + 1] = show_pending(self, view, contents) end
  if not wants.columns or not texts[1] then return end
  local columns = pinfo.cols
  columns.protocol, columns.info = "YAPP", table.concat(texts, " | ")
  if first_source and not packet.has_address then columns.src = first_source.text end
end

-- Dissects a packet; returns whether it is YAPP's.
-- tvb      its bytes; nil for a segment of which the capture has none
-- segment  of serial.tcp, nil for other packets
local function dissect_packet(self, tvb, pinfo, tree, segment)
  local packet, contents = new_packet(self, tvb, pinfo, segment), nil
  local wants = self.tree:wants(tree, pinfo, packet.visited)
  if packet.visited then
    contents = self.streams:find(packet)
    if not contents then return false end
  else
    contents = self.streams:take(packet, not wants.is_only_pass)
  end
  show(self, tvb, pinfo, tree, packet, contents, wants)
  local last = contents.events[#contents.events]
  if packet.truncated and tvb and not (last and last.status == "incomplete") then
    local text = "The capture has %d of the packet's %d bytes"
    self.tree:expert(tree, "truncated", text:format(#packet.bytes, packet.length))
  end
  return true
end

-- Dissects a segment that TCP has shown.
local function dissect_segment(self, segment, tvb, pinfo, tree)
  self.has_tcp = self.has_tcp or segment.is_ours
  if not self.has_tcp then return end
  local here, there = ends_of(pinfo)
  local key = stream_key(TCP, nil, here, there)
  if not pinfo.visited then
    if segment.ack then self.streams:acknowledge(stream_key(TCP, nil, there, here), segment.ack) end
    if segment.is_syn then self.streams:begin(key) end
  end
  local is_ours = segment.is_ours or self.streams:follows(key)
  if not is_ours or segment.length == 0 then return end
  local bytes = tvb:len() > segment.start and tvb(segment.start):tvb() or nil
  dissect_packet(self, bytes, pinfo, tree, segment)
end

--- Watch TCP, to know the sequence numbers from the first segment on.
function Dissector:watch_tcp()
  tcp.watch(self.watch, function(...) dissect_segment(self, ...) end)
end

--- Dissect the bytes of a packet.
-- returns  the number of bytes that are ours
function Dissector:dissect(tvb, pinfo, tree)
  local size = tvb:len()
  -- An ICMP error only quotes what was sent before.
  if size == 0 or pinfo.in_error_pkt then return 0 end
  if pinfo.port_type == TCP then
    local segment = tcp.current()
    if segment then
      segment.is_ours = true -- TCP may have joined it to others: it comes by itself
      return size
    end
    self.has_tcp = true
    self:watch_tcp()
  end
  return dissect_packet(self, tvb, pinfo, tree) and size or 0
end

--- Dissect bytes of a raw dump that are of no frame.
-- returns  the number of bytes that are ours
function Dissector:skipped(tvb, pinfo, tree)
  local size = tvb:len()
  if size == 0 then return 0 end
  local packet = new_packet(self, tvb, pinfo)
  local contents = { events = { { status = "skipped", from = 0, to = size, at = 0 } }, pending = 0 }
  show(self, tvb, pinfo, tree, packet, contents, self.tree:wants(tree, pinfo, packet.visited))
  return size
end

--- Return the messages that the capture ends before, for the statistics, which are told of their last
-- bytes.
-- returns  list of { id, seq, source = key, frame = number of the packet with its last bytes, time,
--          bus, bus_name }
function Dissector:unfinished()
  local list = {}
  for i, open in ipairs(self.streams:unfinished()) do
    local packet, id, _, _, seq = open.packet, frame.parse(open.header, 1)
    list[i] = {
      id = id,
      seq = seq,
      source = source_of(self, packet, id).key,
      frame = packet.number,
      time = packet.time,
      bus = packet.bus_key,
      bus_name = packet.bus_name,
    }
    self.reader.tell:part(list[i])
  end
  return list
end

--- Return the gaps in TCP connections, as host.buses returns the packets that a capture dropped.
function Dissector:drops()
  return self.streams:drops()
end

return M
