-- SPDX-License-Identifier: GPL-2.0-or-later
-- What the packets of byte streams and datagrams hold: frames, and bytes of none.  Pure Lua.
--
-- Packets are taken once, in the order of the capture.  Revisits ask by frame key.
--
--   packet 7   |end of A|good frame B|start of C|   events A (of packets 6 and 7) and B, and the
--   packet 8   |end of C|                           pending bytes of C, which packet 8 shows
--
-- TCP segments bring their sequence numbers.  Bytes that came before are left out.  A segment behind
-- a gap waits for the missing one, until it is clear that the capture does not have it.

local crc = require("yapp.wire.crc")
local frame_of = require("yapp.wire.frame")

local M = {}

local HEADER, CRC_SIZE = frame_of.HEADER, frame_of.CRC_SIZE
local abs, max, min, sub = math.abs, math.max, math.min, string.sub

-- How long segments wait for a missing one: seconds, and bytes of the stream.  A sender that hears
-- nothing repeats it within a second, as a rule, and few send 64 KB ahead.
local MAX_WAIT, MAX_AHEAD = 1, 65535
-- A sequence number further off is that of a new connection.
local MAX_DISTANCE = 2 ^ 20

-- Of a packet that holds good frames and nothing else: its own bytes tell them again.
local PLAIN = { events = {}, pending = 0 }

local Streams = {}
Streams.__index = Streams

-- A stream.  `framer` finds its frames.
local function new_stream(framer)
  return {
    framer = framer,
    pieces = {},      -- those with bytes that are in no event yet: pieces[first] to pieces[last]
    first = 1,
    last = 0,
    latest = nil,     -- the latest packet
    -- Of TCP:
    next_seq = nil,   -- sequence number of the next byte
    acked = nil,      -- the latest acknowledgement of the other side
    is_ended = false, -- whether a new connection has begun
    held = {},        -- the segments behind a gap, by sequence number
    gap = nil,        -- the packet that showed the gap
  }
end

--- Make the streams of a capture.
-- new_framer  function() -> a serial.framer
function M.new(new_framer)
  return setmetatable({
    new_framer = new_framer,
    datagrams = new_stream(new_framer()), -- each is complete in itself: one stream does for all
    by_key = {},
    contents = {}, -- by frame key
    gaps = {},     -- [packet behind a gap that was not filled] = true
  }, Streams)
end

-- Events -----------------------------------------------------------------------------------------

-- Appends what a framer found; skipped bytes that follow skipped bytes are one event.
local function append(events, found)
  for _, event in ipairs(found) do
    local last = events[#events]
    if last and last.status == "skipped" and event.status == "skipped" then
      last.to, last.bytes = event.to, last.bytes .. event.bytes
    else
      events[#events + 1] = event
    end
  end
end

-- No more bytes follow those that wait in a stream.
local function finish(stream, events, is_truncated)
  local rest = stream.framer:finish()
  for _, event in ipairs(rest) do event.truncated = is_truncated end
  append(events, rest)
end

-- Feeds a packet to its stream.
-- known  number of its bytes that the stream has
local function feed(stream, piece, known, events)
  local framer, packet = stream.framer, piece.packet
  piece.known, piece.from = known, framer:length()
  append(events, framer:feed(sub(packet.bytes, known + 1)))
  piece.to = framer:length()
  if packet.transport == "datagram" or packet.truncated then
    finish(stream, events, packet.truncated)
  end
  stream.last = stream.last + 1
  stream.pieces[stream.last] = piece
end

-- Says where the bytes of an event are.
local function locate(stream, event, own)
  if own.from and event.from >= own.from and event.to <= own.to then
    event.at, event.bytes = own.known + event.from - own.from, nil
    return
  end
  if event.status == "skipped" then return end
  event.parts = {}
  for i = stream.first, stream.last do
    local piece = stream.pieces[i]
    if piece.from < event.to and piece.to > event.from then
      event.parts[#event.parts + 1] = piece.packet.key
      if piece ~= own then piece.contents.leads_to = own.packet.key end
    end
  end
end

-- Drops the packets whose bytes all come before an offset.
local function drop_pieces(stream, offset)
  while stream.first <= stream.last and stream.pieces[stream.first].to <= offset do
    stream.pieces[stream.first] = nil
    stream.first = stream.first + 1
  end
end

-- TCP --------------------------------------------------------------------------------------------

-- Returns how far one sequence number is ahead of another; they count modulo 2^32.
local function distance(seq, other)
  return (seq - other + 0x80000000) % 0x100000000 - 0x80000000
end

-- Keeps a segment in the order of the sequence numbers.
local function hold(stream, piece)
  local held, at = stream.held, #stream.held + 1
  while at > 1 and distance(piece.packet.seq, held[at - 1].packet.seq) < 0 do at = at - 1 end
  table.insert(held, at, piece)
end

-- Whether the capture lacks the segment that others wait for.
local function is_lost(stream, packet)
  return stream.acked and distance(stream.acked, stream.next_seq) > 0 or
    distance(packet.seq, stream.next_seq) > MAX_AHEAD or
    packet.time - stream.gap.time > MAX_WAIT
end

-- Feeds the segments that wait, as far as they are in order.
-- packet    the current one
-- gives_up  whether none of the missing ones will come
local function feed_held(self, stream, packet, gives_up, events)
  while stream.held[1] do
    local piece = stream.held[1]
    local seq, length = piece.packet.seq, piece.packet.length
    local known = distance(stream.next_seq, seq)
    if known < 0 then
      stream.gap = stream.gap or packet
      self.gaps[stream.gap] = true
      if not gives_up and not is_lost(stream, packet) then return end
      finish(stream, events)
      stream.gap, known = nil, 0
    elseif known < length and stream.gap then
      self.gaps[stream.gap], stream.gap = nil, nil
    end
    table.remove(stream.held, 1)
    if known < length then
      feed(stream, piece, known, events)
      stream.next_seq = (seq + length) % 0x100000000
    else
      piece.from, piece.to = 0, 0
    end
  end
end

-- Takes a segment, and those that waited for it.
local function take_segment(self, stream, piece, events)
  local packet = piece.packet
  local next_seq = stream.next_seq or packet.seq
  if stream.is_ended or abs(distance(packet.seq, next_seq)) > MAX_DISTANCE then
    feed_held(self, stream, packet, true, events)
    finish(stream, events)
    next_seq, stream.is_ended = packet.seq, false
  end
  stream.next_seq = next_seq
  hold(stream, piece)
  feed_held(self, stream, packet, false, events)
end

--- Note what the other side of a TCP connection has received.
-- key  of the stream
-- ack  sequence number of the byte that it expects next
function Streams:acknowledge(key, ack)
  local stream = self.by_key[key]
  if not stream then return end
  if not stream.acked or distance(ack, stream.acked) > 0 then stream.acked = ack end
end

--- Note that a new TCP connection begins.
-- key  of the stream
function Streams:begin(key)
  local stream = self.by_key[key]
  if stream then stream.is_ended, stream.acked = true, nil end
end

--- Whether a segment can be taken in its place: the stream is YAPP's, and its sequence numbers are
-- known.
-- key  of the stream
function Streams:follows(key)
  local stream = self.by_key[key]
  return stream ~= nil and stream.next_seq ~= nil
end

-- Packets ----------------------------------------------------------------------------------------

-- Whether a packet holds good frames and nothing else.
local function is_plain(contents, packet)
  local events = contents.events
  for _, event in ipairs(events) do
    if event.status ~= "good" or not event.at then return false end
  end
  local first, last = events[1], events[#events]
  return first and first.at == 0 and last.at + last.to - last.from == #packet.bytes
end

-- Takes a packet into a stream; returns what it holds.
local function contents_of(self, stream, packet, is_segment)
  local contents = {
    events = {},
    pending = 0,
    missing = nil,
    is_held = false,
    leads_to = nil,
    stream = stream,
  }
  local events, framer = contents.events, stream.framer
  local own = { packet = packet, contents = contents, known = 0, from = nil, to = nil }
  if is_segment then
    take_segment(self, stream, own, events)
  else
    feed(stream, own, 0, events)
  end
  for _, event in ipairs(events) do
    drop_pieces(stream, event.from)
    locate(stream, event, own)
  end
  drop_pieces(stream, framer:offset())
  if not own.from then
    contents.is_held, contents.pending = true, #packet.bytes
  elseif own.to > framer:offset() then
    contents.pending, contents.missing = own.to - max(own.from, framer:offset()), framer:waiting()
  end
  return contents
end

--- Take the next packet of the capture.
-- packet  {
--   key        frame key; a key that comes again replaces what was stored
--   number, bus_name, bus_key
--   time       seconds since the first packet; epoch = since 1970, or nil
--   bytes      string: those that were captured
--   truncated  whether the packet had more
--   transport  "datagram" or "stream"
--   stream     key of the stream
--   seq        of TCP, where it is known: the first byte's sequence number; length = number of
--              bytes that it had }; it is kept
-- is_stored  whether Streams:find may ask for it
-- returns    what it holds: {
--   events    as from serial.framer, and truncated = whether the capture cut the frame short;
--             at = offset in the packet; if not all its bytes are in this packet, bytes = string and
--             parts = keys of the packets they came in, which skipped bytes have not
--   pending   number of bytes at the end that are in no event yet; missing = number of bytes to come
--             of the frame that they begin, or nil; is_held = whether they are behind a gap
--   leads_to  key of the packet that shows the pending bytes, nil until it has come }
function Streams:take(packet, is_stored)
  local stream = self.datagrams
  if packet.transport ~= "datagram" then
    stream = self.by_key[packet.stream] or new_stream(self.new_framer())
    self.by_key[packet.stream] = stream
  end
  local contents = contents_of(self, stream, packet, packet.seq)
  stream.latest = packet
  if is_stored then
    self.contents[packet.key] = is_plain(contents, packet) and PLAIN or contents
  end
  return contents
end

--- Return what a packet holds that was taken before, nil if it was not.
function Streams:find(packet)
  local contents = self.contents[packet.key]
  if contents ~= PLAIN then return contents end
  return contents_of(self, self.datagrams, packet, false)
end

--- Whether the capture ends before the frame that a packet's pending bytes begin.
-- contents  of the packet
function Streams:is_unfinished(contents, packet)
  local stream = contents.stream
  return contents.pending > 0 and not contents.leads_to and stream.latest.key == packet.key and
    stream.framer:open_header() ~= nil
end

--- Return the frames that the capture ends before.
-- returns  list of { header = string, packet = the last one with bytes of it }
function Streams:unfinished()
  local list = {}
  for _, stream in pairs(self.by_key) do
    local header = stream.framer:open_header()
    if header then list[#list + 1] = { header = header, packet = stream.latest } end
  end
  return list
end

--- Return the gaps in TCP streams: segments that the capture does not have.
-- returns  list of { time = seconds since 1970, frame = number of the packet behind the gap,
--          bus = name or nil, count = 1 }
function Streams:drops()
  local list = {}
  for packet in pairs(self.gaps) do
    list[#list + 1] = {
      time = packet.epoch,
      frame = packet.number,
      bus = packet.bus_name,
      count = 1,
    }
  end
  table.sort(list, function(a, b) return a.frame < b.frame end)
  return list
end

--- Return the message in an event that is a frame.
-- event    of a packet
-- bytes    of the packet
-- returns  { status, missing, truncated, parts = as in the event; length = number of bytes; id, seq,
--          ctl, size, reserved, payload; crc, calculated = if it is bad }
function M.message(event, bytes)
  local from, length = 1, event.to - event.from
  if event.bytes then bytes = event.bytes else from = event.at + 1 end
  local id, size, reserved, seq, ctl = frame_of.parse(bytes, from)
  local is_bad, last = event.status == "bad", from + length - 1
  return {
    status = event.status,
    missing = event.missing,
    truncated = event.truncated,
    parts = event.parts,
    length = length,
    id = id,
    seq = seq,
    ctl = ctl,
    size = size,
    reserved = reserved,
    payload = sub(bytes, from + HEADER, from - 1 + min(HEADER + size, length)),
    crc = is_bad and frame_of.crc(bytes, last) or nil,
    calculated = is_bad and crc.update(crc.INITIAL, bytes, from, last - CRC_SIZE) or nil,
  }
end

return M
