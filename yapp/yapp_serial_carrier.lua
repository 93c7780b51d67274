-- YAPP in byte streams and datagrams: UART captures, TCP, UDP.  Wireshark's API.

local M = {}

local HEADER, CRC_SIZE = 12, 4
local TCP, UDP = 2, 3 -- pinfo.port_type
local ONE_MORE_SEGMENT = 0x0fffffff -- DESEGMENT_ONE_MORE_SEGMENT
local PATIENCE = 65551 -- bytes, the largest frame: TCP keeps no more for a frame that may yet come

local Carrier = {}
Carrier.__index = Carrier

--- The serial side of the plugin.
-- parts    the modules { crc =, serial_stream =, utf8 = }
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
  self.plain, self.plain_deltas = {}, {}
  function self.accepts(id, size)
    local message = self.tree.reader:message_of(id)
    return not message or message.size == size
  end
end

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

local function little(bytes, at, count)
  local value = 0
  for i = at + count - 1, at, -1 do value = value * 0x100 + bytes:byte(i) end
  return value
end

-- What a terminal gets besides letters, as it is shown.
local CONTROLS = { ["\a"] = "\\a", ["\b"] = "\\b", ["\t"] = "\\t", ["\n"] = "\\n", ["\r"] = "\\r", ["\27"] = "\\e" }

-- Text as a shell prints it, or nil for other bytes.
local function printable(utf8, bytes)
  if utf8.ascii(bytes):find("[^%g \a\b\t\n\r\27]") then return nil end
  local text = bytes
  if #bytes > 80 then text = bytes:sub(1, 80):gsub("[\192-\255][\128-\191]*$", "") .. "..." end
  return '"' .. text:gsub("%c", CONTROLS) .. '"'
end

-- A frame, good, bad or cut.  tvb and at: where its bytes are.
function Carrier:show_frame(tree, tvb, at, event, bytes, wanted)
  local builder = self.tree
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
    if event.parts then self:add_parts(item, tvb, event, #bytes) end
    if status ~= "cut" then builder:add_crc(item, tvb(at + HEADER + size, CRC_SIZE), message) end
    item:append_text(status == "good" and ", CRC good" or status == "bad" and ", CRC BAD" or ", not whole")
  end
  if status == "bad" then builder:bad_crc(item, message) end
  if status == "cut" then
    local text = ("The frame has %d bytes, %d of them are missing"):format(HEADER + size + CRC_SIZE, event.missing)
    builder:expert(item, event.truncated and "truncated" or "fragment.incomplete", text)
  end
  local m = { tree = tree, item = item, id = id, payload = payload, size = size, wanted = wanted, tvb = wanted and tvb,
    at = at + HEADER, good = status == "good", is_whole = true }
  builder.reader:read(m, {}, function() return { delta = event.delta } end)
  local info = builder:payload(m)
  return info .. (status == "bad" and "  [BAD CRC]" or status == "cut" and "  [INCOMPLETE]" or "")
end

-- The packets that a frame came in.
function Carrier:add_parts(item, tvb, event, length)
  local fields, parts = self.tree.fields, event.parts
  item:add(fields["reassembled.in"], event.shown_in):set_generated()
  local list = item:add(fields.fragments, tvb())
  list:set_text(("%d fragments (%d bytes)"):format(#parts, length))
  list:set_generated()
  for _, number in ipairs(parts) do list:add(fields.fragment, number):set_generated() end
  list:add(fields["fragment.count"], #parts):set_generated()
  list:add(fields["reassembled.length"], length):set_generated()
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

-- Shows events.  base is the stream offset of the packet's first byte: what lies in it has no bytes of its own.
function Carrier:show(tvb, pinfo, tree, events, base, raw)
  local wanted = self.tree:wants_any(tree)
  local infos = {}
  for i, event in ipairs(events) do
    local source, at = tvb, event.from - base
    local bytes = event.bytes or raw:sub(at + 1, event.to - base)
    if event.bytes and wanted then source, at = ByteArray.new(bytes, true):tvb("Reassembled YAPP"), 0 end
    local info = event.kind == "skipped" and self:show_skipped(tree, source, at, bytes, wanted) or
      event.kind ~= "skipped" and self:show_frame(tree, source, at, event, bytes, wanted)
    if i <= 10 then infos[i] = info end
  end
  if #events > 10 then infos[11] = ("and %d more"):format(#events - 10) end
  local columns = pinfo.cols
  columns.protocol = "YAPP"
  columns.info = table.concat(infos, " | ")
end

-- Streams -------------------------------------------------------------------------------------------------------

-- By which packets of one stream know each other.
function Carrier:key(pinfo)
  local kind = pinfo.port_type
  local source = kind ~= TCP and kind ~= UDP and self.context(pinfo)
  return ("%s|%s|%s|%s|%s|%s"):format(tostring(source), kind, tostring(pinfo.src), pinfo.src_port,
    tostring(pinfo.dst), pinfo.dst_port)
end

-- What is known of the stream that a packet belongs to: when which message came, and of one that nobody joins for us
-- its framer, its length, and the packets with bytes that wait.
function Carrier:stream(pass, pinfo)
  local key = self:key(pinfo)
  local stream = pass.streams[key]
  if not stream then
    stream = { times = {}, length = 0, waiting = {}, first = 1, last = 0 }
    pass.streams[key] = stream
  end
  return stream
end

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

-- Appends events; skipped bytes that follow skipped bytes are one event.
local function append(events, more)
  for _, event in ipairs(more) do
    local last = events[#events]
    if last and last.kind == "skipped" and event.kind == "skipped" then
      last.to, last.bytes = event.to, last.bytes .. event.bytes
    else
      events[#events + 1] = event
    end
  end
end

-- Whatever waits in the framer is cut off.
local function finish(framer, events, truncated)
  local rest = framer:finish()
  for _, event in ipairs(rest) do event.truncated = truncated end
  append(events, rest)
end

local function is_truncated(tvb)
  return tvb:reported_len() > tvb:len()
end

-- The capture cut the packet short: this is said at the frame that it cut, where there is one.
function Carrier:say_truncated(tvb, tree, events)
  local last = events[#events]
  if is_truncated(tvb) and not (last and last.kind == "cut") then
    self.tree:expert(tree, "truncated", ("The capture has %d of the packet's %d bytes"):format(tvb:len(),
      tvb:reported_len()))
  end
end

-- Datagrams and TCP ---------------------------------------------------------------------------------------------

-- These are searched on the first pass only, where packets come in order.  What was found is kept by packet, and by
-- the place of the bytes in it, where a packet has several pieces.  A conversation may have been recognized late: what
-- came before and was not ours on the first pass, is not ours later.
function Carrier:piece(tvb, pinfo, search)
  local packets, number, place = self.passes[1].packets, pinfo.number, tvb:offset()
  if pinfo.visited then return packets[number] and packets[number][place] end
  local stream = self:stream(self.passes[1], pinfo)
  local piece = search(self, tvb, tvb:raw(), stream)
  note_times(pinfo, stream.times, piece.events)
  for _, event in ipairs(piece.events) do event.bytes = nil end
  packets[number] = packets[number] or {}
  packets[number][place] = piece
  return piece
end

-- A datagram is complete in itself.
function Carrier:search_datagram(tvb, raw)
  local framer = self:framer()
  local events = framer:feed(raw)
  finish(framer, events, is_truncated(tvb))
  return { events = events, base = 0, done = #raw }
end

-- Whether a packet is one good frame and nothing else.  What is kept of such a one is that it was ours, by the place of
-- its bytes, and its delta.  (A packet that a read filter rejected had the same number.)
function Carrier:is_plain(tvb, pinfo, raw)
  local number, place = pinfo.number, tvb:offset()
  local known = self.plain[number]
  if pinfo.visited then return known == place end
  if known and known ~= place then return false end
  if is_truncated(tvb) or not self.parts.serial_stream.is_frame(self.parts.crc, self.accepts, raw) then
    self.plain[number] = nil
    return false
  end
  self.plain[number] = place
  return true
end

function Carrier:show_plain(tvb, pinfo, tree, raw)
  local event = { kind = "frame", good = true, from = 0, to = #raw, bytes = raw }
  local events, number = { event }, pinfo.number
  if not pinfo.visited then
    note_times(pinfo, self:stream(self.passes[1], pinfo).times, events)
    self.plain_deltas[number] = event.delta
  end
  event.bytes, event.delta = nil, self.plain_deltas[number]
  self:show(tvb, pinfo, tree, events, 0, raw)
end

function Carrier:datagram(tvb, pinfo, tree)
  local raw = tvb:raw()
  if self:is_plain(tvb, pinfo, raw) then
    self:show_plain(tvb, pinfo, tree, raw)
    return #raw
  end
  local piece = self:piece(tvb, pinfo, self.search_datagram)
  if not piece then return 0 end
  self:show(tvb, pinfo, tree, piece.events, piece.base, tvb:raw())
  self:say_truncated(tvb, tree, piece.events)
  return tvb:len()
end

--- Dissects bytes of which it is known that they belong to no frame.
-- returns the number of bytes that are ours
function Carrier:skipped(tvb, pinfo, tree)
  if tvb:len() == 0 then return 0 end
  self:show(tvb, pinfo, tree, { { kind = "skipped", from = 0, to = tvb:len() } }, 0, tvb:raw())
  return tvb:len()
end

-- TCP hands over again what waits, with what follows, in a tvb of its own: only what follows is new to the framer.
function Carrier:search_segment(tvb, raw, stream)
  local joined = stream.joined
  local known = joined and #joined.waiting or 0
  if not joined or known > 0 and (tvb:offset() > 0 or raw:sub(1, known) ~= joined.waiting) then
    joined, known = { framer = self:framer(), events = {}, base = 0 }, 0
    stream.joined = joined
  end
  local framer, events, base = joined.framer, joined.events, joined.base
  append(events, framer:feed(raw:sub(known + 1)))
  if #raw > PATIENCE and framer:offset() - base <= known then finish(framer, events) end
  local done = framer:offset() - base
  if done > known then
    joined.events, joined.base = {}, framer:offset()
  else -- TCP lets go of no bytes as long as none of the new ones go with them: what is found waits too
    events, done = {}, 0
  end
  joined.waiting = raw:sub(done + 1)
  return { events = events, base = base, done = done }
end

function Carrier:segment(tvb, pinfo, tree)
  local piece = self:piece(tvb, pinfo, self.search_segment)
  if not piece then return 0 end
  if #piece.events > 0 then self:show(tvb, pinfo, tree, piece.events, piece.base, tvb:raw()) end
  if piece.done < tvb:len() then
    pinfo.desegment_offset, pinfo.desegment_len = piece.done, ONE_MORE_SEGMENT
  end
  return tvb:len()
end

-- Streams that nobody joins for us ------------------------------------------------------------------------------

-- Which packets the bytes of a frame came in; they lead to the one that shows it.  This may be a later one where a
-- frame is bad and one that overlaps it was still open.
local function link(stream, event, number)
  local waiting, parts = stream.waiting, {}
  for i = stream.first, stream.last do
    local packet = waiting[i]
    if packet.from >= event.to then break end
    parts[#parts + 1] = packet.number
    if packet.number ~= number then packet.leads_to = number end
  end
  event.parts, event.shown_in = parts, number
end

-- The packets whose bytes are all before this offset wait no longer.
local function forget(stream, offset)
  local waiting = stream.waiting
  while stream.first <= stream.last and waiting[stream.first].to <= offset do
    waiting[stream.first] = nil
    stream.first = stream.first + 1
  end
end

-- Takes the packet's bytes into its stream; keeps what has to be shown, without the bytes that the packet has anyway.
function Carrier:take(pass, pinfo, raw, truncated)
  local stream, number = self:stream(pass, pinfo), pinfo.number
  stream.framer = stream.framer or self:framer()
  local packet = { number = number, from = stream.length, to = stream.length + #raw }
  stream.length = packet.to
  stream.last = stream.last + 1
  stream.waiting[stream.last] = packet
  packet.events = stream.framer:feed(raw)
  if truncated then finish(stream.framer, packet.events, true) end
  note_times(pinfo, stream.times, packet.events)
  for _, event in ipairs(packet.events) do
    forget(stream, event.from)
    if event.from >= packet.from then
      event.bytes = nil
    elseif event.kind ~= "skipped" then
      link(stream, event, number)
    end
  end
  local done = stream.framer:offset()
  forget(stream, done)
  packet.pending, packet.missing = packet.to - math.max(done, packet.from), stream.framer:waiting()
  pass.packets[number] = packet
  return packet
end

-- Which pass has what there is to show of a packet.  A first pass without fields cannot tell interfaces and
-- directions apart; where they matter, a second pass that has the fields and comes in order knows better, but for what
-- is to come.  The first pass is not asked for that: frames of two sources may begin with the same bytes.
function Carrier:packet(pinfo, raw, truncated)
  local number = pinfo.number
  local first, second = self.passes[1], self.passes[2]
  if not pinfo.visited then
    if self.context(pinfo) then first.informed = true end
    return self:take(first, pinfo, raw, truncated)
  end
  if not first.informed and self.context(pinfo) then
    if number > second.highest then
      second.highest = number
      return self:take(second, pinfo, raw, truncated)
    end
    return second.packets[number] or first.packets[number]
  end
  return first.packets[number]
end

-- Shows the bytes at the packet's end that wait for more; returns what the Info column says of them.
function Carrier:show_pending(tvb, tree, packet, size)
  local builder, pending = self.tree, packet.pending
  if builder:wants_yapp(tree) then
    local range = tvb(size - pending, pending)
    local item = tree:add(builder.yapp, range)
    item:append_text(", part of a frame")
    item:add(builder.fields["fragment.data"], range)
    if packet.leads_to then item:add(builder.fields["reassembled.in"], packet.leads_to):set_generated() end
  end
  return packet.leads_to and ("[Reassembled in #%d]"):format(packet.leads_to) or
    packet.missing and ("[%s of a frame, %d to come]"):format(builder.bytes(pending), packet.missing) or
    ("[%s wait for more]"):format(builder.bytes(pending))
end

function Carrier:serial(tvb, pinfo, tree)
  local raw = tvb:raw()
  local packet = self:packet(pinfo, raw, is_truncated(tvb))
  if not packet then return 0 end
  self:show(tvb, pinfo, tree, packet.events, packet.from, raw)
  if packet.pending > 0 then
    local text = self:show_pending(tvb, tree, packet, #raw)
    pinfo.cols.info:append((#packet.events > 0 and " | " or "") .. text)
  end
  self:say_truncated(tvb, tree, packet.events)
  return tvb:len()
end

--- Dissects what a carrier hands over.
-- returns the number of bytes that are ours
function Carrier:dissect(tvb, pinfo, tree)
  if tvb:len() == 0 or pinfo.in_error_pkt then return 0 end -- an ICMP error only quotes what was sent before
  local kind = pinfo.port_type
  if kind == UDP then return self:datagram(tvb, pinfo, tree) end
  if kind == TCP and pinfo.can_desegment > 0 then return self:segment(tvb, pinfo, tree) end
  return self:serial(tvb, pinfo, tree)
end

return M
