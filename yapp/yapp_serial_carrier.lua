-- YAPP in byte streams and datagrams: UART captures, TCP, UDP.  Wireshark's API.

local M = {}

local HEADER, CRC_SIZE = 12, 4
local TCP, UDP = 2, 3 -- pinfo.port_type
local ONE_MORE_SEGMENT = 0x0fffffff -- DESEGMENT_ONE_MORE_SEGMENT
local PATIENCE = 4096 -- bytes up to which every new segment is looked at; a longer wait asks for more at a time

local Carrier = {}
Carrier.__index = Carrier

--- The serial side of the plugin.
-- parts    the modules { crc =, stream = }
-- tree     a tree builder
-- context  function(pinfo) -> a number that tells captured interfaces and directions apart, nil where nothing does
function M.new(parts, tree, context)
  local self = setmetatable({ parts = parts, tree = tree, context = context }, Carrier)
  self:reset()
  return self
end

--- Forgets the capture file.
function Carrier:reset()
  self.passes = { {}, {} }
  for _, pass in ipairs(self.passes) do pass.streams, pass.packets, pass.highest = {}, {}, 0 end
end

function Carrier:framer()
  local by_id = self.tree.by_id
  return self.parts.stream.new(self.parts.crc, function(id, size)
    local message = by_id[id]
    return not message or message.size == size
  end)
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

local function little(bytes, at, count)
  local value = 0
  for i = at + count - 1, at, -1 do value = value * 0x100 + bytes:byte(i) end
  return value
end

-- Text as a shell prints it, or nil for other bytes.
local function printable(bytes)
  if bytes:find("[^%g \r\n\t\27]") then return nil end
  local text = bytes:sub(1, 80):gsub("[%c]", { ["\r"] = "\\r", ["\n"] = "\\n", ["\t"] = "\\t", ["\27"] = "\\e" })
  return '"' .. text .. (#bytes > 80 and '..."' or '"')
end

-- A frame, good, bad or cut.  tvb and at: where its bytes are.
function Carrier:show_frame(tree, tvb, at, event, wanted)
  local builder, bytes = self.tree, event.bytes
  local fields = builder.fields
  local id, size = little(bytes, 5, 4), little(bytes, 9, 2)
  local status = event.kind == "cut" and "cut" or event.good and "good" or "bad"
  local message = { status = status }
  if status ~= "cut" then message.crc = little(bytes, #bytes - 3, 4) end
  if status == "bad" then message.calculated = self.parts.crc.update(self.parts.crc.INITIAL, bytes, 1, #bytes - 4) end
  local payload = bytes:sub(HEADER + 1, math.min(HEADER + size, #bytes))
  local item = tree
  if wanted then
    item = tree:add(builder.yapp, tvb(at, #bytes))
    item:append_text((", %s"):format(builder:name(id)))
    item:add(fields.sync, tvb(at, 2))
    item:add(fields.seq, tvb(at + 2, 1))
    item:add(fields.ctl, tvb(at + 3, 1))
    builder:add_id(item, tvb(at + 4, 4), id)
    item:add_le(fields.size, tvb(at + 8, 2)):append_text(" bytes")
    item:add_le(fields.reserved, tvb(at + 10, 2))
    if event.parts then self:add_parts(item, tvb, event) end
    if status ~= "cut" then builder:add_crc(item, tvb(at + HEADER + size, CRC_SIZE), message) end
    item:append_text(status == "good" and ", CRC good" or status == "bad" and ", CRC BAD" or ", not whole")
    builder:add_delta(item, event.delta)
  end
  if status == "bad" then builder:bad_crc(item, message) end
  if status == "cut" then
    local text = ("The frame has %d bytes, %d of them are missing"):format(HEADER + size + CRC_SIZE, event.missing)
    builder:expert(item, event.truncated and "truncated" or "fragment.incomplete", text)
  end
  local info = builder:payload(tree, item, id, payload, wanted and tvb, at + HEADER, status == "cut")
  return info .. (status == "bad" and "  [BAD CRC]" or status == "cut" and "  [INCOMPLETE]" or "")
end

-- The packets that a frame came in.
function Carrier:add_parts(item, tvb, event)
  local fields = self.tree.fields
  local last = event.parts[#event.parts]
  item:add(fields["reassembled.in"], last):set_generated()
  local list = item:add(fields.fragments, tvb())
  list:set_text(("%d fragments (%d bytes)"):format(#event.parts, #event.bytes))
  list:set_generated()
  for _, number in ipairs(event.parts) do list:add(fields.fragment, number):set_generated() end
  list:add(fields["fragment.count"], #event.parts):set_generated()
  list:add(fields["reassembled.length"], #event.bytes):set_generated()
end

function Carrier:show_skipped(tree, tvb, at, event, wanted)
  local builder, bytes = self.tree, event.bytes
  local text = printable(bytes)
  local item = tree
  if wanted then
    item = tree:add(builder.yapp, tvb(at, #bytes))
    item:append_text((", %d bytes skipped"):format(#bytes))
    local skipped = item:add(builder.fields.skipped, tvb(at, #bytes))
    if text then skipped:append_text(" " .. text) end
  end
  builder:expert(item, "stream.skipped", ("%d bytes that belong to no frame%s"):format(#bytes,
    text and ": " .. text or ""))
  return ("Skipped %d bytes%s"):format(#bytes, text and " " .. text or "")
end

-- Shows events.  base is the stream offset of the packet's first byte: what began in it, lies in the tvb.
function Carrier:show(tvb, pinfo, tree, events, base, raw)
  local wanted = self.tree:wanted(tree, true)
  local infos = {}
  for i, event in ipairs(events) do
    local source, at = tvb, event.from - base
    if at < 0 or event.to - base > #raw then
      if wanted then source, at = ByteArray.new(event.bytes, true):tvb("Reassembled YAPP"), 0 end
    elseif not event.bytes then
      event = setmetatable({ bytes = raw:sub(at + 1, event.to - base) }, { __index = event })
    end
    local info = event.kind == "skipped" and self:show_skipped(tree, source, at, event, wanted) or
      event.kind ~= "skipped" and self:show_frame(tree, source, at, event, wanted)
    if i <= 10 then infos[i] = info end
  end
  if #events > 10 then infos[11] = ("and %d more"):format(#events - 10) end
  local columns = pinfo.cols
  columns.protocol = "YAPP"
  columns.info = table.concat(infos, " | ")
end

-- Datagrams and TCP ---------------------------------------------------------------------------------------------

-- The time since the previous message with this ID in the stream.
local function note_times(pinfo, times, events)
  local now
  for _, event in ipairs(events) do
    if event.good then
      now = now or pinfo.rel_ts
      local id = little(event.bytes, 5, 4)
      event.delta = times[id] and now - times[id]
      times[id] = now
    end
  end
end

-- By which packets of one stream know each other.
function Carrier:key(pinfo)
  return ("%s|%s|%s|%s|%s|%s"):format(tostring(self.context(pinfo)), pinfo.port_type, tostring(pinfo.src),
    pinfo.src_port, tostring(pinfo.dst), pinfo.dst_port)
end

-- Times are known on the first pass only, where packets come in order; they are kept by packet, and where TCP shows
-- several pieces of one packet, by piece.
function Carrier:deltas(pinfo, events, place)
  local number = pinfo.number
  local pass = self.passes[1]
  if not pinfo.visited then
    local key = self:key(pinfo)
    local stream = pass.streams[key]
    if not stream then
      stream = { times = {} }
      pass.streams[key] = stream
    end
    note_times(pinfo, stream.times, events)
    local kept = {}
    for i, event in ipairs(events) do kept[i] = event.delta or false end
    local packet = pass.packets[number]
    if place == 0 or not packet then
      packet = {}
      pass.packets[number] = packet
    end
    packet[place] = kept
  else
    local kept = (pass.packets[number] or {})[place] or {}
    for i, event in ipairs(events) do event.delta = kept[i] or nil end
  end
end

-- A datagram is complete in itself.
function Carrier:datagram(tvb, pinfo, tree)
  local raw = tvb:raw()
  local framer = self:framer()
  local events = framer:feed(raw)
  for _, event in ipairs(framer:finish()) do
    event.truncated = tvb:reported_len() > #raw
    events[#events + 1] = event
  end
  self:deltas(pinfo, events, 0)
  self:show(tvb, pinfo, tree, events, 0, raw)
  return tvb:len()
end

-- TCP joins the segments: what is not yet whole comes again with what follows.
function Carrier:segment(tvb, pinfo, tree)
  local raw = tvb:raw()
  local framer = self:framer()
  local events = framer:feed(raw)
  if #events > 0 then
    self:deltas(pinfo, events, tvb:offset())
    self:show(tvb, pinfo, tree, events, 0, raw)
  end
  local pending = #raw - framer:offset()
  if pending > 0 then
    local missing = framer:waiting()
    pinfo.desegment_offset = framer:offset()
    pinfo.desegment_len = missing and pending > PATIENCE and math.min(missing, (pending - pending % 16) / 16) or
      ONE_MORE_SEGMENT
  end
  return tvb:len()
end

-- Streams that nobody joins for us ------------------------------------------------------------------------------

-- Which packets the bytes of an event came in, and that those before the last lead to it.
local function link(stream, event, number)
  local parts = {}
  for _, packet in ipairs(stream.recent) do
    if packet.to > event.from and packet.from < event.to then
      parts[#parts + 1] = packet.number
      if packet.number ~= number and event.kind == "frame" then packet.leads_to = number end
    end
  end
  if #parts > 1 and event.kind == "frame" then event.parts = parts end
end

-- Takes the packet's bytes into its stream; keeps what has to be shown, without the bytes that the packet has anyway.
function Carrier:take(pass, pinfo, raw, number)
  local key = self:key(pinfo)
  local stream = pass.streams[key]
  if not stream then
    stream = { framer = self:framer(), length = 0, recent = {}, times = {} }
    pass.streams[key] = stream
  end
  local packet = { number = number, from = stream.length, to = stream.length + #raw }
  stream.length = packet.to
  stream.recent[#stream.recent + 1] = packet
  packet.events = stream.framer:feed(raw)
  note_times(pinfo, stream.times, packet.events)
  for _, event in ipairs(packet.events) do
    if event.from < packet.from then link(stream, event, number) else event.bytes = nil end
  end
  local done, rest = stream.framer:offset(), {}
  for _, recent in ipairs(stream.recent) do
    if recent.to > done then rest[#rest + 1] = recent end
  end
  stream.recent = rest
  packet.pending, packet.missing = packet.to - math.max(done, packet.from), stream.framer:waiting()
  pass.packets[number] = packet
  return packet
end

-- Which pass has what there is to show of a packet.  A first pass without fields cannot tell interfaces and
-- directions apart; where they matter, a second pass that has the fields and comes in order knows better.
function Carrier:packet(pinfo, raw)
  local number = pinfo.number
  local first, second = self.passes[1], self.passes[2]
  if not pinfo.visited then
    if self.context(pinfo) then first.informed = true end
    return self:take(first, pinfo, raw, number)
  end
  if not first.informed and self.context(pinfo) then
    if number > second.highest then
      second.highest = number
      return self:take(second, pinfo, raw, number)
    end
    return second.packets[number] or first.packets[number]
  end
  return first.packets[number]
end

function Carrier:serial(tvb, pinfo, tree)
  local raw = tvb:len() > 0 and tvb:raw() or ""
  local packet = self:packet(pinfo, raw)
  if not packet then return 0 end
  self:show(tvb, pinfo, tree, packet.events, packet.from, raw)
  local columns, builder = pinfo.cols, self.tree
  if packet.pending > 0 then
    local wanted = builder:wanted(tree, false)
    if wanted then
      local item = tree:add(builder.yapp, tvb(#raw - packet.pending, packet.pending))
      item:append_text(", part of a frame")
      item:add(builder.fields["fragment.data"], tvb(#raw - packet.pending, packet.pending))
      if packet.leads_to then item:add(builder.fields["reassembled.in"], packet.leads_to):set_generated() end
    end
    local text = packet.leads_to and ("[Reassembled in #%d]"):format(packet.leads_to) or
      packet.missing and ("[%d bytes of a frame, %d to come]"):format(packet.pending, packet.missing) or
      ("[%d bytes wait for more]"):format(packet.pending)
    columns.info:append((#packet.events > 0 and " | " or "") .. text)
  end
  if tvb:reported_len() > #raw then
    builder:expert(tree, "truncated", ("The capture has %d of the packet's %d bytes"):format(#raw, tvb:reported_len()))
  end
  return tvb:len()
end

--- Dissects what a carrier hands over.
-- returns the number of bytes that are ours
function Carrier:dissect(tvb, pinfo, tree)
  if tvb:reported_len() == 0 then return 0 end
  local kind = pinfo.port_type
  if kind == UDP then return self:datagram(tvb, pinfo, tree) end
  if kind == TCP and pinfo.can_desegment > 0 then return self:segment(tvb, pinfo, tree) end
  return self:serial(tvb, pinfo, tree)
end

return M
