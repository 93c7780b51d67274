-- SPDX-License-Identifier: GPL-2.0-or-later
-- The contents of packets of byte streams and datagrams: frames, and bytes of none.  Pure Lua.
--
-- Packets are added once, in the order of the capture.  Revisits ask by frame key.
--
--   packet 7   |end of A|good frame B|start of C|   findings A (of packets 6 and 7) and B, and the
--   packet 8   |end of C|                           pending bytes of C, which packet 8 shows
--
-- TCP segments bring their sequence numbers.  Bytes that came before are left out.  A segment
-- behind a gap waits in a list for the missing one, until MAX_HELD segments wait or the connection
-- ends: then the missing one is lost.
--
-- Datagrams are a byte stream, too: a bridge from a serial line cuts where it likes.  A lost one
-- costs the frames it cut.

local crc = require "yapp.wire.crc"
local frame = require "yapp.wire.frame"
local joined = require "yapp.base.joined"
local memo = require "yapp.base.memo"

local Streams = {}
Streams.__index = Streams

local HEADER = frame.HEADER
local MAX_HELD = 16 -- segments behind a gap
local MAX_DISTANCE = 2 ^ 20 -- a sequence number that differs by more is of a new connection

-- Stands for the contents of a packet of good frames alone: Streams:find reads its bytes anew.
local PLAIN = {}

local function new_stream(framer)
  return {
    framer = framer,
    pieces = {},     -- contents with bytes in no finding yet, the oldest first
    latest = nil,    -- the latest packet
    held = {},       -- contents of the segments behind a gap, by sequence number
    first_seq = nil, -- of TCP: sequence number of the first byte
    next_seq = nil,  -- of the next byte; nil before the first segment
  }
end

local function new_contents(packet, findings)
  return {
    key = packet.key,
    findings = findings,
    pending = 0,
    packet = packet, -- nil once its bytes are added
    overlap = nil,   -- once its bytes are added: number of those that had come before
    from = 0,        -- and offset in the stream of the others
    to = 0,
  }
end

--- Make the streams of a capture.
-- new_framer  function() -> a serial.framer
function Streams.new(new_framer)
  local streams = {}
  return setmetatable({
    reader = new_framer(), -- of bytes that are complete in themselves
    streams = streams, -- in the order of their first packets
    by_line = memo(function() return new_stream(new_framer()) end, streams),
    contents_by_key = {}, -- by frame key: the results of Streams:add
    losses = {}, -- see Streams:drops
  }, Streams)
end

-- Byte streams ------------------------------------------------------------------------------------

-- Add the bytes of a packet to its stream.
-- overlap  how many of them the stream has already
local function add_bytes(stream, contents, overlap, findings)
  local framer, packet = stream.framer, contents.packet
  local from = framer.to
  local is_complete = packet.truncated or packet.line.is_complete
  framer:add(packet.bytes:sub(overlap + 1), is_complete, findings)
  contents.packet, contents.overlap = nil, overlap
  contents.from, contents.to = from, framer.to
  local last = findings[#findings]
  if packet.truncated and last and last.missing then last.status = "truncated" end
  table.insert(stream.pieces, contents)
end

-- Drop the contents whose bytes all come before an offset.
local function drop_pieces(stream, offset)
  local pieces = stream.pieces
  while pieces[1] and pieces[1].to <= offset do table.remove(pieces, 1) end
end

-- Set where the bytes of a finding are.
-- contents  of the packet that shows it
local function locate_finding(stream, finding, contents)
  if finding.from >= contents.from and finding.to <= contents.to then
    finding.offset, finding.bytes = contents.overlap + finding.from - contents.from, nil
  elseif finding.status ~= "skipped" then
    drop_pieces(stream, finding.from)
    finding.packet_keys = {}
    for _, piece in ipairs(stream.pieces) do
      if piece.from < finding.to then
        table.insert(finding.packet_keys, piece.key)
        if piece ~= contents then piece.leads_to = contents.key end
      end
    end
  end
end

-- Append the findings of bytes that are complete in themselves, and return the list.
local function split(self, bytes, findings)
  local framer = self.reader
  local from = framer.to
  for _, finding in ipairs(framer:add(bytes, true, findings)) do
    finding.offset, finding.bytes = finding.from - from, nil
  end
  return findings
end

-- TCP ---------------------------------------------------------------------------------------------

-- Return how far one sequence number is ahead of another; they count modulo 2^32.
local function distance(seq, other)
  return (seq - other + 0x80000000) % 0x100000000 - 0x80000000
end

-- Add a loss, see Streams:drops.
-- packet  behind it
local function add_loss(list, packet)
  local loss = { time = packet.epoch, frame = packet.number, bus = packet.line.bus, count = 1 }
  table.insert(list, loss)
end

-- Keep a segment in the order of the sequence numbers.
local function hold_segment(held, contents)
  local seq, index = contents.packet.seq, #held + 1
  while index > 1 and distance(seq, held[index - 1].packet.seq) < 0 do index = index - 1 end
  table.insert(held, index, contents)
end

-- Add the waiting segments that are in order, and those behind a lost one.
-- is_over  true if no missing segment will come
local function add_held(self, stream, findings, is_over)
  local held = stream.held
  while held[1] do
    local contents = held[1]
    local segment = contents.packet
    local overlap = distance(stream.next_seq, segment.seq)
    if overlap < 0 then
      if #held < MAX_HELD and not is_over then return end
      stream.framer:add("", true, findings)
      add_loss(self.losses, segment)
      overlap = 0
    end
    table.remove(held, 1)
    if overlap < segment.length then
      add_bytes(stream, contents, overlap, findings)
      stream.next_seq = (segment.seq + segment.length) % 0x100000000
    else
      contents.packet = nil
    end
  end
end

-- Add all that waits; what comes next is another stream.
local function end_stream(self, stream, findings)
  add_held(self, stream, findings, true)
  stream.framer:add("", true, findings)
end

-- Add a segment, and those that waited for it.
local function add_segment(self, stream, contents, findings)
  local packet, next_seq = contents.packet, stream.next_seq
  local seq = packet.seq
  local ahead = next_seq and distance(seq, next_seq)
  local is_new = packet.is_start or ahead and math.abs(ahead) > MAX_DISTANCE
  if is_new then end_stream(self, stream, findings) end
  if is_new or not next_seq then
    stream.first_seq, stream.next_seq = seq, seq
  elseif distance(seq, stream.first_seq) < 0 then -- it is late, and began before the first one
    stream.first_seq, contents.packet = seq, nil
    return split(self, packet.bytes, findings)
  end
  hold_segment(stream.held, contents)
  add_held(self, stream, findings, packet.is_end)
end

-- Packets -----------------------------------------------------------------------------------------

-- Return whether bytes hold good frames and nothing else.
local function is_plain(findings, bytes)
  local length = 0
  for _, finding in ipairs(findings) do
    if finding.status ~= "good" or finding.bytes then return false end
    length = length + finding.to - finding.from
  end
  return length == #bytes
end

-- Return whether a datagram of a conversation that was found by content is of others: it holds no
-- frame and begins none.  No bytes waited for it.
local function is_of_others(stream, packet, findings)
  local pending = stream.framer:pending()
  if not (packet.line.is_datagram and packet.is_found) then return false end
  for _, finding in ipairs(findings) do
    if finding.status ~= "skipped" then return false end
  end
  local is_chance = pending == "Y" and packet.bytes ~= "Y"
  return pending == "" or is_chance or not frame.may_be_header(pending, 1)
end

-- Add a packet to its stream.
local function add_to_stream(self, stream, contents)
  local packet, findings, framer = contents.packet, contents.findings, stream.framer
  if packet.seq then
    add_segment(self, stream, contents, findings)
  else
    add_bytes(stream, contents, 0, findings)
  end
  for _, finding in ipairs(findings) do
    if not finding.offset then locate_finding(stream, finding, contents) end
  end
  if contents.packet then -- its bytes wait for a missing segment
    contents.pending = #packet.bytes
  else
    contents.pending = math.max(contents.to - math.max(contents.from, framer.from), 0)
  end
end

--- Add the next packet of the capture.
-- packet  {
--   key          frame key; a second frame with this key replaces the first
--   number       of the packet
--   epoch        of a segment, or if it is truncated: seconds since 1970
--   bytes        string: those that were captured
--   truncated    true if the packet had more
--   line         of serial.lines
--   is_found     true if its conversation was found by content
--   seq          of TCP, if it is known: sequence number of the first byte
--   is_start, is_end  true if the segment begins or ends its connection
--   length       number of bytes that it had }
-- is_stored  true if Streams:find may ask for it
-- returns  nil for a datagram of others, else {
--   findings  as from serial.framer, or with the status "truncated": the capture has only a part
--             of the frame.  Each has its offset in the packet; or, if not all its bytes are in
--             this packet, in its `bytes`.  Of a frame packet_keys are the packets of these
--   pending   number of bytes at the end that are in no finding yet; of a segment that waits for a
--             missing one, all
--   leads_to  key of the packet that shows the pending bytes, nil until it has come }
function Streams:add(packet, is_stored)
  local stream, findings = self.by_line[packet.line], {}
  local framer, contents = stream.framer, new_contents(packet, findings)
  local has_waiting = framer.to > framer.from
  stream.latest = packet
  add_to_stream(self, stream, contents)
  local is_others = not has_waiting and is_of_others(stream, packet, findings)
  if is_others then framer:add("", true) end
  drop_pieces(stream, framer.from)
  if is_others then
    self.contents_by_key[packet.key] = nil -- of a packet before it that a read filter dropped
    return nil
  end
  local last = findings[#findings]
  if packet.truncated and not (last and last.missing) then -- it may have had whole frames
    add_loss(self.losses, packet)
  end
  if is_stored then
    self.contents_by_key[packet.key] = is_plain(findings, packet.bytes) and PLAIN or contents
  end
  return contents
end

--- Return the contents of a packet that was added before, nil if it was not.
function Streams:find(packet)
  local contents = self.contents_by_key[packet.key]
  if contents ~= PLAIN then return contents end
  return new_contents(packet, split(self, packet.bytes, {}))
end

-- The end -----------------------------------------------------------------------------------------

--- Return whether the capture ends before the frame that a packet's pending bytes begin.
function Streams:is_unfinished(contents, packet)
  if contents.pending == 0 or contents.leads_to then return false end
  local stream = self.by_line[packet.line]
  return stream.latest.key == packet.key and stream.framer:has_open_frame()
end

--- List the findings that wait in the streams, if the capture ends here.
-- may_go_on  true if more packets may come: then they wait on, as do segments behind a gap
-- returns    list of { packet = the stream's latest, findings = as from Streams:add }
function Streams:unfinished(may_go_on)
  local list = {}
  for _, stream in ipairs(self.streams) do
    local findings = {}
    if may_go_on then
      self.reader:add(stream.framer:pending(), true, findings)
    else
      end_stream(self, stream, findings)
    end
    list[#list + 1] = { packet = stream.latest, findings = findings }
  end
  return list
end

--- List the losses of the capture: segments of TCP connections, the ends of packets.
-- returns  list of { time = seconds since 1970, frame = number of the packet behind the gap,
--          bus = name or nil, count = 1 }
function Streams:drops()
  local waiting = {}
  for _, stream in ipairs(self.streams) do
    if stream.held[1] then add_loss(waiting, stream.held[1].packet) end
  end
  return joined(self.losses, waiting)
end

-- Transfers ---------------------------------------------------------------------------------------

--- Make the transfer of a finding.
-- finding  of Streams:add
-- bytes    of its packet
-- returns  it: {
--   status       "good", "bad" (CRC), "incomplete", "truncated" (by the capture), "skipped": bytes
--                of no frame
--   offset       in the bytes; length = number of its bytes that came
--   missing      number of bytes to come, nil for none
--   bytes        that hold it if those of its packet do not, or nil
--   packet_keys  of the packets that these came in, or nil
--   payload      all of skipped bytes; of a frame also
--   id, seq, size            of the header; size = of the whole payload
--   crc, calculated          of a bad one
--   anomalies    list of { expert } }
function Streams.new_transfer(finding, bytes)
  local status, anomalies = finding.status, {}
  local offset, length = finding.offset or 0, finding.to - finding.from
  bytes = (finding.bytes or bytes):sub(offset + 1, offset + length)
  local transfer = {
    status = status,
    offset = offset,
    length = length,
    missing = finding.missing,
    bytes = finding.bytes,
    packet_keys = finding.packet_keys,
    payload = bytes,
    anomalies = anomalies,
  }
  if status == "skipped" then return transfer end
  local id, size, reserved, seq = frame.parse(bytes, 1)
  transfer.id, transfer.seq, transfer.size = id, seq, size
  transfer.payload = bytes:sub(HEADER + 1, HEADER + size)
  if status == "bad" then
    transfer.crc = frame.crc(bytes, length)
    transfer.calculated = crc.of(bytes:sub(1, -1 - frame.CRC_SIZE))
  end
  if finding.missing then
    anomalies[1] = { expert = status == "truncated" and status or "fragment.incomplete" }
  end
  if reserved ~= 0 then table.insert(anomalies, { expert = "reserved.nonzero" }) end
  return transfer
end

return Streams
