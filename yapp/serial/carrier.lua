-- SPDX-License-Identifier: GPL-2.0-or-later
-- YAPP in byte streams and datagrams, UART captures, TCP, UDP: asks the memory what a packet holds,
-- and shows it.
-- Wireshark's API.

local frame = require("yapp.wire.frame")
local items = require("yapp.show.fields")
local serial_memory = require("yapp.serial.memory")
local serial_stream = require("yapp.serial.stream")
local utf8 = require("yapp.base.utf8")

local M = {}

local add, add_le = items.add, items.add_le
local add_generated, append_text = items.add_generated, items.append_text

local HEADER, CRC_SIZE = frame.HEADER, frame.CRC_SIZE

local TCP, UDP = 2, 3 -- pinfo.port_type
local NO_ADDRESS = { [""] = true, NONE = true } -- as the API has it
local ONE_MORE_SEGMENT = 0x0fffffff -- DESEGMENT_ONE_MORE_SEGMENT
local MOST_IN_INFO = 10 -- frames of a packet

local Carrier = {}
Carrier.__index = Carrier

--- The serial side of the plugin.
-- tree     a tree builder (show.tree)
-- reader   a message.reader: what a finished message means
-- buses    a host.buses
function M.new(tree, reader, buses)
  return setmetatable({ tree = tree, reader = reader, buses = buses }, Carrier)
end

--- Forgets the capture file.
-- new_history  function() -> a message.history
function Carrier:reset(new_history)
  self.memory = serial_memory.new {
    new_framer = function() return self:framer() end,
    new_history = new_history,
  }
  self.sources = {} -- by stream, by ID
end

--- A framer of a stream: a serial.stream.
function Carrier:framer()
  return serial_stream.new(function(id) return self.reader:size_of(id) end)
end

--- Whether bytes hold one whole frame with a good CRC: what a heuristic has to see.  Its header
-- must be one of the document's: what has another ID or size may be somebody else's.
function Carrier:has_frame(bytes)
  local function accepts(id, size)
    return self.reader:fits(id, size) ~= false
  end
  for _, event in ipairs(self:framer():feed(bytes)) do
    if event.good and frame.judge(event.bytes, 1, accepts) then return true end
  end
  return false
end

-- A packet ----------------------------------------------------------------------------------------

-- The facts of a packet, for the memory, and what is shown of its stream: bus_name; bus_key, by
-- which a Command and what it commands know each other (both ways of a conversation; all there is
-- on a UART, whose directions are sources of their own); line, what tells its sources apart, nil
-- where nothing does; has_address; time.
local function facts_of(self, tvb, pinfo)
  local kind, number = pinfo.port_type, pinfo.number
  local is_ip = kind == UDP or kind == TCP
  local address = tostring(pinfo.src)
  local here = ("%s|%d"):format(address, pinfo.src_port)
  local there = ("%s|%d"):format(tostring(pinfo.dst), pinfo.dst_port)
  local transport, bus_key, bus, knows_all = "stream", "serial", nil, true
  if is_ip then
    bus_key = here < there and here .. there or there .. here
  else
    bus, knows_all = self.buses:of(pinfo, number)
  end
  if kind == UDP then
    transport = "datagram"
  elseif kind == TCP and pinfo.can_desegment > 0 then
    transport = "segment"
  end
  local bus_name, has_address = self.buses:name(bus, is_ip), not NO_ADDRESS[address]
  local line = bus and bus_name
  if has_address then line = ("%s:%d"):format(address, pinfo.src_port) end
  return {
    number = number,
    place = tvb:offset(),
    bytes = tvb:raw(),
    truncated = tvb:reported_len() > tvb:len(),
    time = pinfo.rel_ts,
    visited = pinfo.visited,
    knows_all = knows_all,
    transport = transport,
    stream = ("%s|%d|%s|%s"):format(bus or "", kind, here, there),
    bus_key = bus_key,
    bus_name = bus_name,
    line = line,
    has_address = has_address,
  }
end

-- A source, see message.reader.
local function source_of(self, fact, id)
  local of_stream = self.sources[fact.stream] or {}
  self.sources[fact.stream] = of_stream
  local source = of_stream[id]
  if not source then
    local key = fact.stream .. "|" .. id
    source = self.reader:new_source(key, id, fact.bus_key, fact.bus_name, fact.line)
    source.message.stream = fact.stream
    of_stream[id] = source
  end
  return source
end

-- What is shown -----------------------------------------------------------------------------------

-- What a terminal gets besides letters, as it is shown.
local CONTROLS = {
  ["\a"] = "\\a",
  ["\b"] = "\\b",
  ["\t"] = "\\t",
  ["\n"] = "\\n",
  ["\r"] = "\\r",
  ["\27"] = "\\e",
}

-- Text as a shell prints it, or nil for other bytes.
local function printable(bytes)
  if utf8.ascii(bytes):find("[^%g \a\b\t\n\r\27]") then return nil end
  local text = bytes
  if #bytes > 80 then
    text = bytes:sub(1, 80):gsub("[\192-\255][\128-\191]*$", "") .. "..."
  end
  return '"' .. text:gsub("%c", CONTROLS) .. '"'
end

local LABELS = { good = ", CRC good", bad = ", CRC BAD", cut = ", not whole" }
local MARKS = { good = "", bad = "  [BAD CRC]", cut = "  [INCOMPLETE]" } -- in the Info column

-- YAPP's own item.  tvb and at: where the bytes of the frame are.
local function add_frame(self, view, source, tvb, at, event)
  local builder, fact = self.tree, view.fact
  local fields = builder.fields
  local item = add(view.tree, builder.yapp, tvb(at, event.length))
  append_text(item, (", %s"):format(source.name))
  add(item, fields.sync, tvb(at, 2))
  add(item, fields.seq, tvb(at + 2, 1))
  add(item, fields.ctl, tvb(at + 3, 1))
  builder:add_id(item, tvb(at + 4, 4), event.id, fact.bus_name)
  append_text(add_le(item, fields.size, tvb(at + 8, 2)), " bytes")
  add_le(item, fields.reserved, tvb(at + 10, 2))
  builder:add_source(item, source)
  if event.parts then
    local payload = #event.payload > 0 and tvb(at + HEADER, #event.payload) or nil
    add_generated(item, fields["reassembled.in"], fact.number)
    builder:add_fragments(item, tvb(), event.parts, event.count, event.length, payload)
  end
  if event.status ~= "cut" then
    builder:add_crc(item, tvb(at + HEADER + event.size, CRC_SIZE), event)
  end
  append_text(item, LABELS[event.status])
  return item
end

-- A frame that has lost bytes.
local function say_cut(self, m, event)
  local expert = event.truncated and "truncated" or "fragment.incomplete"
  local text = "The frame has %d bytes, %d of them are missing"
  self.tree:expert(m.item, expert, text:format(HEADER + event.size + CRC_SIZE, event.missing))
  if self.reader.stat.wanted then
    self.reader.tell:faults(m, { { expert = expert } })
  end
end

-- A frame as a message.
local function finished(view, source, event)
  local m, fact, status = source.message, view.fact, event.status
  m.seq = event.seq
  m.size = event.size
  m.payload = event.payload
  m.status = status
  m.good = status == "good"
  -- Where in it the bytes are missing nobody knows, unless the capture cut it.
  m.is_whole = status ~= "cut" or event.truncated or false
  m.frame = fact.number
  m.time = fact.time
  m.visited = fact.visited
  m.tree = view.tree
  m.item = view.tree
  m.tvb = false
  m.wants = view.wants
  return m
end

-- A frame, good, bad or cut; returns what the Info column says of it.
local function show_frame(self, view, tvb, index)
  local builder, event, fact = self.tree, view.packet.events[index], view.fact
  local status, at, source = event.status, event.at or 0, source_of(self, fact, event.id)
  local m = finished(view, source, event)
  self.reader:read(m, self.memory, view.packet, index, fact)
  if m.wants.tree then
    m.item, m.tvb, m.at = add_frame(self, view, source, tvb, at, event), tvb, at + HEADER
  end
  if status == "bad" then builder:bad_crc(m.item, event) end
  if status == "cut" then say_cut(self, m, event) end
  if event.reserved ~= 0 then
    local text = ("The reserved bytes are 0x%04x, not 0"):format(event.reserved)
    builder:expert(m.item, "reserved.nonzero", text)
  end
  if m.is_whole or not m.message then return builder:payload(m) .. MARKS[status] end
  if m.wants.yapp and #m.payload > 0 then
    add(m.item, builder.fields.payload, tvb(m.at, #m.payload))
  end
  return m.name .. MARKS[status]
end

local function show_skipped(self, view, tvb, at, bytes)
  local builder, fact, tell = self.tree, view.fact, self.reader.tell
  local text, size = printable(bytes), builder.bytes(#bytes)
  local item = view.tree
  if view.wants.tree then
    item = add(item, builder.yapp, tvb(at, #bytes))
    append_text(item, (", %s skipped"):format(size))
    local skipped = add(item, builder.fields.skipped, tvb(at, #bytes))
    if text then append_text(skipped, " " .. text) end
  end
  local quoted = text and ": " .. text or ""
  builder:expert(item, "stream.skipped", ("%s that belong to no frame%s"):format(size, quoted))
  if self.reader.stat.wanted and tell.skipped then
    tell:skipped {
      frame = fact.number,
      time = fact.time,
      visited = fact.visited,
      bus = fact.bus_key,
      bus_name = fact.bus_name,
      source = fact.stream,
      length = #bytes,
    }
  end
  return ("Skipped %s%s"):format(size, text and " " .. text or "")
end

-- An event of the packet; returns what the Info column says of it.
local function show_event(self, view, tvb, index)
  local event = view.packet.events[index]
  if event.status ~= "skipped" then return show_frame(self, view, tvb, index) end
  local bytes = event.bytes or view.fact.bytes:sub(event.at + 1, event.at + event.length)
  return show_skipped(self, view, tvb, event.at or 0, bytes)
end

-- Shows the bytes at the packet's end that wait for more; returns what the Info column says of
-- them.
local function show_pending(self, view)
  local builder, packet, item = self.tree, view.packet, view.tree
  local leads_to, size = packet.leads_to, self.tree.bytes(packet.pending)
  if view.wants.tree then
    local range = view.tvb(packet.done, packet.pending)
    item = add(item, builder.yapp, range)
    append_text(item, ", part of a frame")
    add(item, builder.fields["fragment.data"], range)
    builder:generated(item, "reassembled.in", leads_to)
  end
  if packet.is_unfinished then builder:expert(item, "unfinished") end
  if leads_to then return ("[Reassembled in #%d]"):format(leads_to) end
  if packet.missing then return ("[%s of a frame, %d to come]"):format(size, packet.missing) end
  return ("[%s wait for more]"):format(size)
end

-- The columns, for the texts of what a packet holds.
local function show_columns(self, view, texts)
  local columns, fact = view.pinfo.cols, view.fact
  columns.protocol, columns.info = "YAPP", table.concat(texts, " | ")
  for _, event in ipairs(view.packet.events) do
    if event.id and not fact.has_address then
      columns.src = source_of(self, fact, event.id).text
      return
    end
  end
end

-- Shows what a packet holds.  A view is what most of the above look at.
local function show(self, tvb, pinfo, tree, fact, packet)
  local texts, wants = {}, self.tree:wants(tree, pinfo, fact.visited)
  local view = {
    tvb = tvb,
    pinfo = pinfo,
    tree = tree,
    fact = fact,
    packet = packet,
    wants = wants,
  }
  if wants.names and not wants.tree then self.tree:bare(tree, wants, true) end
  for i, event in ipairs(packet.events) do
    local bytes, of_event = event.bytes, tvb -- what lies in the packet has no bytes of its own
    if bytes and wants.tree then
      of_event = ByteArray.new(bytes, true):tvb("Reassembled YAPP")
    end
    local text = show_event(self, view, of_event, i)
    if i <= MOST_IN_INFO then texts[i] = text end
  end
  if #packet.events > MOST_IN_INFO then
    texts[#texts + 1] = ("and %d more"):format(#packet.events - MOST_IN_INFO)
  end
  if packet.pending > 0 then texts[#texts + 1] = show_pending(self, view) end
  if wants.columns then show_columns(self, view, texts) end
  if wants.is_only_pass and packet.pass then self.memory:forget(packet) end
end

-- The capture cut the packet short: this is said at the frame that it cut, where there is one.
local function say_truncated(self, tvb, tree, events)
  local last = events[#events]
  if last and last.status == "cut" then return end
  local text = "The capture has %d of the packet's %d bytes"
  self.tree:expert(tree, "truncated", text:format(tvb:len(), tvb:reported_len()))
end

--- Dissects what a carrier hands over.
-- returns the number of bytes that are ours
function Carrier:dissect(tvb, pinfo, tree)
  local size = tvb:len()
  -- An ICMP error only quotes what was sent before.
  if size == 0 or pinfo.in_error_pkt then return 0 end
  local fact = facts_of(self, tvb, pinfo)
  local packet = self.memory:look(fact)
  if not packet then return 0 end
  local is_segment = fact.transport == "segment"
  if packet.events[1] or not is_segment then show(self, tvb, pinfo, tree, fact, packet) end
  if is_segment and packet.done < size then
    pinfo.desegment_offset = packet.done
    pinfo.desegment_len = ONE_MORE_SEGMENT
  elseif fact.truncated and not is_segment then
    say_truncated(self, tvb, tree, packet.events)
  end
  return size
end

--- Dissects bytes of which it is known that they belong to no frame.
-- returns the number of bytes that are ours
function Carrier:skipped(tvb, pinfo, tree)
  local size = tvb:len()
  if size > 0 then
    local event = { status = "skipped", at = 0, length = size }
    show(self, tvb, pinfo, tree, facts_of(self, tvb, pinfo), { events = { event }, pending = 0 })
  end
  return size
end

--- The messages that the capture ends before, for the statistics, which are told of their last
-- bytes.
-- returns  list of { source, seq, frame = number of the packet with its last bytes }
function Carrier:unfinished()
  local list = {}
  for i, open in ipairs(self.memory:unfinished()) do
    local fact, id, _, _, seq = open.fact, frame.parse(open.header, 1)
    list[i] = {
      id = id,
      seq = seq,
      source = source_of(self, fact, id).key,
      frame = fact.number,
      time = fact.time,
      bus = fact.bus_key,
      bus_name = fact.bus_name,
    }
    self.reader.tell:part(list[i])
  end
  return list
end

return M
