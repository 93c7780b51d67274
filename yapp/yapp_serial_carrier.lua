-- YAPP in byte streams and datagrams, UART captures, TCP, UDP: asks the memory what a packet holds, and shows it.
-- Wireshark's API.

local frame = require("yapp_frame")

local M = {}

local HEADER, CRC_SIZE = frame.HEADER, frame.CRC_SIZE

local TCP, UDP = 2, 3 -- pinfo.port_type
local ONE_MORE_SEGMENT = 0x0fffffff -- DESEGMENT_ONE_MORE_SEGMENT

local Carrier = {}
Carrier.__index = Carrier

--- The serial side of the plugin.
-- parts    the modules { crc =, serial_memory =, serial_stream =, utf8 = }
-- tree     a tree builder
-- context  function(pinfo) -> a number that tells captured interfaces and directions apart, nil where nothing does
function M.new(parts, tree, context)
  local self = setmetatable({ parts = parts, tree = tree, context = context, fact = {} }, Carrier)
  self:reset()
  return self
end

--- Forgets the capture file.
function Carrier:reset()
  local by_id = self.tree.by_id
  function self.accepts(id, size)
    local message = by_id[id]
    return not message or message.size == size
  end
  self.memory = self.parts.serial_memory.new(self.parts.crc, function() return self:framer() end)
end

--- A framer of a stream: a yapp_serial_stream.
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

-- The frame itself.  tvb and at: where its bytes are.
function Carrier:add_frame(tree, tvb, at, message)
  local builder, status = self.tree, message.status
  local fields = builder.fields
  local item = tree:add(builder.yapp, tvb(at, message.length))
  item:append_text((", %s"):format(builder:name(message.id)))
  item:add(fields.sync, tvb(at, 2))
  item:add(fields.seq, tvb(at + 2, 1))
  item:add(fields.ctl, tvb(at + 3, 1))
  builder:add_id(item, tvb(at + 4, 4), message.id)
  item:add_le(fields.size, tvb(at + 8, 2)):append_text(" bytes")
  item:add_le(fields.reserved, tvb(at + 10, 2))
  if message.parts then self:add_parts(item, tvb, message) end
  if status ~= "cut" then builder:add_crc(item, tvb(at + HEADER + message.size, CRC_SIZE), message) end
  item:append_text(status == "good" and ", CRC good" or status == "bad" and ", CRC BAD" or ", not whole")
  builder:add_delta(item, message.delta)
  return item
end

-- A frame, good, bad or cut; returns what the Info column says of it.
function Carrier:show_frame(tree, tvb, at, message, wanted)
  local builder, status, size = self.tree, message.status, message.size
  local item = wanted and self:add_frame(tree, tvb, at, message) or tree
  if status == "bad" then builder:bad_crc(item, message) end
  if status == "cut" then
    local text = ("The frame has %d bytes, %d of them are missing"):format(HEADER + size + CRC_SIZE, message.missing)
    builder:expert(item, message.truncated and "truncated" or "fragment.incomplete", text)
  end
  local info = builder:payload(tree, item, message.id, message.payload, wanted and tvb, at + HEADER, size)
  return info .. (status == "bad" and "  [BAD CRC]" or status == "cut" and "  [INCOMPLETE]" or "")
end

-- The packets that a frame came in.
function Carrier:add_parts(item, tvb, message)
  local fields, parts = self.tree.fields, message.parts
  item:add(fields["reassembled.in"], message.shown_in):set_generated()
  local list = item:add(fields.fragments, tvb())
  list:set_text(("%d fragments (%d bytes)"):format(#parts, message.length))
  list:set_generated()
  for _, number in ipairs(parts) do list:add(fields.fragment, number):set_generated() end
  list:add(fields["fragment.count"], #parts):set_generated()
  list:add(fields["reassembled.length"], message.length):set_generated()
end

function Carrier:show_skipped(tree, tvb, at, bytes, wanted)
  local builder = self.tree
  local text = printable(self.parts.utf8, bytes)
  local item = tree
  if wanted then
    item = tree:add(builder.yapp, tvb(at, #bytes))
    item:append_text((", %s skipped"):format(builder.bytes(#bytes)))
    local skipped = item:add(builder.fields.skipped, tvb(at, #bytes))
    if text then skipped:append_text(" " .. text) end
  end
  builder:expert(item, "stream.skipped", ("%s that belong to no frame%s"):format(
    builder.bytes(#bytes), text and ": " .. text or ""))
  return ("Skipped %s%s"):format(builder.bytes(#bytes), text and " " .. text or "")
end

-- Shows events; what lies in the packet has no bytes of its own.
function Carrier:show(tvb, pinfo, tree, events, raw)
  local wanted = self.tree:wanted(tree, true)
  local infos = {}
  for i, event in ipairs(events) do
    local source, at, bytes = tvb, event.at, event.bytes
    local info
    if bytes and wanted then source = ByteArray.new(bytes, true):tvb("Reassembled YAPP") end
    if event.status == "skipped" then
      info = self:show_skipped(tree, source, at or 0, bytes or raw:sub(at + 1, at + event.length), wanted)
    else
      info = self:show_frame(tree, source, at or 0, event, wanted)
    end
    if i <= 10 then infos[i] = info end
  end
  if #events > 10 then infos[11] = ("and %d more"):format(#events - 10) end
  local columns = pinfo.cols
  columns.protocol = "YAPP"
  columns.info = table.concat(infos, " | ")
end

-- Shows the bytes at the packet's end that wait for more; returns what the Info column says of them.
function Carrier:show_pending(tvb, tree, packet)
  local builder, pending, leads_to = self.tree, packet.pending, packet.leads_to
  if builder:wanted(tree, false) then
    local range = tvb(packet.done, pending)
    local item = tree:add(builder.yapp, range)
    item:append_text(", part of a frame")
    item:add(builder.fields["fragment.data"], range)
    if leads_to then item:add(builder.fields["reassembled.in"], leads_to):set_generated() end
  end
  return leads_to and ("[Reassembled in #%d]"):format(leads_to) or
    packet.missing and ("[%s of a frame, %d to come]"):format(builder.bytes(pending), packet.missing) or
    ("[%s wait for more]"):format(builder.bytes(pending))
end

-- The capture cut the packet short: this is said at the frame that it cut, where there is one.
function Carrier:say_truncated(tvb, tree, events)
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
  return ("%s|%s|%s|%s|%s|%s"):format(source or "", kind, tostring(pinfo.src), pinfo.src_port, tostring(pinfo.dst),
    pinfo.dst_port)
end

-- The facts of a packet, in a record that is used again.
function Carrier:facts(tvb, pinfo)
  local fact, transport, kind = self.fact, transport_of(pinfo)
  local source = kind ~= UDP and kind ~= TCP and self.context(pinfo) or nil
  fact.number, fact.place, fact.bytes, fact.transport = pinfo.number, tvb:offset(), tvb:raw(), transport
  fact.visited, fact.informed, fact.truncated = pinfo.visited, source ~= nil, tvb:reported_len() > tvb:len()
  if not fact.visited or source then
    fact.stream, fact.time = key_of(pinfo, kind, source), pinfo.rel_ts
  end
  return fact
end

--- Dissects what a carrier hands over.
-- returns the number of bytes that are ours
function Carrier:dissect(tvb, pinfo, tree)
  if tvb:len() == 0 or pinfo.in_error_pkt then return 0 end -- an ICMP error only quotes what was sent before
  local fact = self:facts(tvb, pinfo)
  local packet = self.memory:look(fact)
  if not packet then return 0 end
  local events, transport, size = packet.events, fact.transport, #fact.bytes
  if #events > 0 or transport ~= "segment" then self:show(tvb, pinfo, tree, events, fact.bytes) end
  if packet.pending > 0 then
    pinfo.cols.info:append((#events > 0 and " | " or "") .. self:show_pending(tvb, tree, packet))
  end
  if transport == "segment" then
    if packet.done < size then pinfo.desegment_offset, pinfo.desegment_len = packet.done, ONE_MORE_SEGMENT end
  elseif fact.truncated then
    self:say_truncated(tvb, tree, events)
  end
  return size
end

--- Dissects bytes of which it is known that they belong to no frame.
-- returns the number of bytes that are ours
function Carrier:skipped(tvb, pinfo, tree)
  local size = tvb:len()
  if size > 0 then self:show(tvb, pinfo, tree, { { status = "skipped", at = 0, length = size } }, tvb:raw()) end
  return size
end

return M
