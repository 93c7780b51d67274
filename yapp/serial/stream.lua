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
-- A datagram of whole frames is complete in itself.  Other datagrams are a byte stream, as of a
-- bridge from a serial line, which cuts where it likes.  A lost one costs the frames it cut.

local crc = require "yapp.wire.crc"
local frame = require "yapp.wire.frame"
local memo = require "yapp.base.memo"

local M = {}

local sub = string.sub
local HEADER, CRC_SIZE = frame.HEADER, frame.CRC_SIZE

local MAX_HELD = 16 -- segments behind a gap
local MAX_DISTANCE = 2 ^ 20 -- a sequence number that differs by more is of a new connection

-- Stands for the contents of a packet of good frames alone: Streams:find reads its bytes anew.
local PLAIN = { findings = {}, pending = 0 }

local Streams = {}
Streams.__index = Streams

local function new_stream(framer)
  return {
    framer = framer,
    pieces = {},     -- contents with bytes in no finding yet, the oldest first
    latest = nil,    -- the latest packet
    held = {},       -- contents of the segments behind a gap, by sequence number
    first_seq = nil, -- of TCP: sequence number of the first byte
    next_seq = nil,  -- of the next byte; nil before the first segment with one
    is_over = false, -- of TCP: true if the next segment begins a connection
  }
end

--- Make the streams of a capture.
-- new_framer  function(line) -> a serial.framer
function M.new(new_framer)
  return setmetatable({
    reader = new_framer {}, -- of bytes that are complete in themselves, see Streams:split
    by_line = memo(function(line) return new_stream(new_framer(line)) end),
    contents_by_key = {}, -- by frame key: the results of Streams:add
    losses = {}, -- see Streams:drops
  }, Streams)
end

-- Transfers ---------------------------------------------------------------------------------------

-- List the errors of a frame, but for its CRC.
local function anomalies_of(transfer)
  local list, missing = {}, transfer.missing
  if missing then
    local text = "%d of the frame's %d bytes are missing"
    list[1] = {
      expert = transfer.status == "truncated" and "truncated" or "fragment.incomplete",
      text = text:format(missing, HEADER + transfer.size + CRC_SIZE),
    }
  end
  if transfer.reserved ~= 0 then
    local text = "The reserved bytes are 0x%04x, not 0"
    list[#list + 1] = { expert = "reserved.nonzero", text = text:format(transfer.reserved) }
  end
  return list[1] and list or false
end

--- Make the transfer of a finding.
-- finding  of Streams:add
-- bytes    of its packet
-- returns  the transfer; of a frame also the ID and the Seq No of its header, and its anomalies: a
--          list of { expert, text }, or false.  The transfer is {
--   status       "good", "bad" (CRC), "incomplete", "truncated" (by the capture), "skipped": bytes
--                of no frame
--   size         of the payload, as its header has it; reserved = its reserved bytes
--   payload      the bytes of it that came; all of skipped bytes
--   offset       of the frame in the bytes; length = number of its bytes that came
--   missing      number of bytes to come, nil for none
--   bytes        that hold it if those of its packet do not, or nil
--   packet_keys  of the packets that these came in, or nil
--   crc, calculated  of a bad one }
function M.new_transfer(finding, bytes)
  bytes = finding.bytes or bytes
  local offset, length = finding.offset or 0, finding.to - finding.from
  local id, size, reserved, seq = frame.parse(bytes, offset + 1)
  local is_skipped = finding.status == "skipped"
  local from, to = offset + HEADER + 1, offset + math.min(HEADER + (size or 0), length)
  if is_skipped then from, to = offset + 1, offset + length end
  local transfer = {
    status = finding.status,
    size = size,
    reserved = reserved,
    payload = sub(bytes, from, to),
    offset = offset,
    length = length,
    missing = finding.missing,
    bytes = finding.bytes,
    packet_keys = finding.packet_keys,
    crc = nil,
    calculated = nil,
  }
  if is_skipped then return transfer end
  if finding.status == "bad" then
    local last = offset + length
    transfer.crc = frame.crc(bytes, last)
    transfer.calculated = crc.update(crc.INITIAL, bytes, offset + 1, last - CRC_SIZE)
  end
  return transfer, id, seq, anomalies_of(transfer)
end

-- Findings ----------------------------------------------------------------------------------------

-- Add the bytes of a packet to its stream.
-- overlap  how many of them the stream has already
local function add_bytes(stream, contents, overlap, findings)
  local framer, packet = stream.framer, contents.packet
  local from = framer.to
  framer:add(sub(packet.bytes, overlap + 1), packet.truncated, findings)
  contents.packet, contents.overlap = nil, overlap
  contents.from, contents.to = math.min(from, framer.to), framer.to
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
  local is_inside = finding.from >= contents.from and finding.to <= contents.to
  if is_inside and not stream.framer.is_telnet then
    finding.offset, finding.bytes = contents.overlap + finding.from - contents.from, nil
  elseif not is_inside and finding.status ~= "skipped" then
    drop_pieces(stream, finding.from)
    finding.packet_keys = {}
    for _, piece in ipairs(stream.pieces) do
      if piece.from < finding.to and piece.to > finding.from then
        table.insert(finding.packet_keys, piece.key)
        if piece ~= contents then piece.leads_to = contents.key end
      end
    end
  end
end

-- TCP ---------------------------------------------------------------------------------------------

-- Return how far one sequence number is ahead of another; they count modulo 2^32.
local function distance(seq, other)
  return (seq - other + 0x80000000) % 0x100000000 - 0x80000000
end

-- Return a loss, see Streams:drops.
-- packet  behind it
local function new_loss(packet)
  return { time = packet.epoch, frame = packet.number, bus = packet.line.bus, count = 1 }
end

-- Keep a segment in the order of the sequence numbers.
local function hold_segment(stream, contents)
  local held, seq, index = stream.held, contents.packet.seq, #stream.held + 1
  while index > 1 and distance(seq, held[index - 1].packet.seq) < 0 do index = index - 1 end
  table.insert(held, index, contents)
end

-- Add the waiting segments that are in order, and those behind a lost one.
-- is_over  true if no missing segment will come
local function add_held(self, stream, findings, is_over)
  local held = stream.held
  while held[1] do
    local segment = held[1].packet
    local overlap = distance(stream.next_seq, segment.seq)
    if overlap < 0 then
      if #held < MAX_HELD and not is_over then return end
      stream.framer:add("", true, findings)
      table.insert(self.losses, new_loss(segment))
      overlap = 0
    end
    local contents = table.remove(held, 1)
    if overlap < segment.length then
      add_bytes(stream, contents, overlap, findings)
      stream.next_seq = (segment.seq + segment.length) % 0x100000000
    else
      contents.packet = nil
    end
  end
end

-- Add a segment, and those that waited for it.
local function add_segment(self, stream, contents, findings)
  local packet = contents.packet
  local next_seq, seq = stream.next_seq, packet.seq
  local is_far = next_seq and math.abs(distance(seq, next_seq)) > MAX_DISTANCE
  if stream.is_over or is_far then
    add_held(self, stream, findings, true)
    stream.framer:add("", true, findings)
  end
  if stream.is_over or is_far or not next_seq then
    stream.first_seq, stream.next_seq, stream.is_over = seq, seq, false
  elseif distance(seq, stream.first_seq) < 0 then -- it is late, and began before the first one
    stream.first_seq, contents.packet = seq, nil
    for i, finding in ipairs(self:split(packet.bytes)) do findings[i] = finding end
    return
  end
  hold_segment(stream, contents)
  add_held(self, stream, findings, packet.is_end)
end

--- Begin a new TCP connection on a line.
function Streams:begin_connection(line)
  self.by_line[line].is_over = true
end

-- Packets -----------------------------------------------------------------------------------------

-- Return whether bytes hold good frames and nothing else.
local function is_plain(findings, bytes)
  local length = 0
  for _, finding in ipairs(findings) do
    if finding.status ~= "good" or not finding.offset then return false end
    length = length + finding.to - finding.from
  end
  return length == #bytes
end

--- Return the findings of bytes that are complete in themselves; each has its offset in them.
function Streams:split(bytes)
  local framer = self.reader
  local from = framer.to
  local findings = framer:add(bytes, true)
  for _, finding in ipairs(findings) do
    finding.offset, finding.bytes = finding.from - from, nil
  end
  return findings
end

-- Return the findings of a datagram that is complete in itself, nil for any other packet.
local function split_alone(self, packet)
  local line = packet.line
  local is_complete = line.is_complete
  if not (line.is_datagram or is_complete) or packet.truncated then return nil end
  local findings = self:split(packet.bytes)
  return (is_complete or is_plain(findings, packet.bytes)) and findings or nil
end

-- Return whether a datagram of a conversation that was found by content is of others: it holds no
-- frame, goes on with none and begins none.
-- has_waiting  true if bytes waited for it
local function is_of_others(stream, contents, line, has_waiting)
  if has_waiting or not (line.is_datagram and line.conversation.is_found) then return false end
  for _, finding in ipairs(contents.findings) do
    if finding.status ~= "skipped" then return false end
  end
  local pending = stream.framer:pending()
  if pending == "Y" then return contents.to - contents.from > 1 end -- chance
  return pending == "" or not frame.may_be_header(pending, 1)
end

local function new_contents(packet, findings)
  return {
    key = packet.key,
    findings = findings,
    pending = 0,
    is_others = false,
    packet = packet, -- nil once its bytes are added
    overlap = 0,     -- number of its bytes that had come before
    from = 0,        -- offset in the stream of the others, once they are added
    to = 0,
  }
end

-- Add a packet to its stream.
local function add_to_stream(self, stream, contents)
  local packet, findings, framer = contents.packet, contents.findings, stream.framer
  stream.latest = packet
  if packet.seq then
    add_segment(self, stream, contents, findings)
  else
    add_bytes(stream, contents, 0, findings)
  end
  for _, finding in ipairs(findings) do
    if not finding.offset then locate_finding(stream, finding, contents) end
  end
  drop_pieces(stream, framer.from)
  if contents.packet then -- its bytes wait for a missing segment
    contents.pending = #packet.bytes
  elseif contents.to > framer.from then
    contents.pending = contents.to - math.max(contents.from, framer.from)
  end
end

-- Add the loss of a packet whose end the capture lacks: it may have had whole frames.
local function add_truncated_loss(self, packet, findings)
  local last = findings[#findings]
  if not (last and last.missing) then table.insert(self.losses, new_loss(packet)) end
end

--- Add the next packet of the capture.
-- packet  {
--   key          frame key; a second frame with this key replaces the first
--   number       of the packet
--   epoch        of a segment, or if it is truncated: seconds since 1970
--   bytes        string: those that were captured
--   truncated    true if the packet had more
--   line         of serial.lines
--   seq          of TCP, if it is known: sequence number of the first byte
--   is_end       true if the segment ends its connection
--   length       number of bytes that it had }
-- is_stored  true if Streams:find may ask for it
-- returns  {
--   findings  as from serial.framer, or with the status "truncated": the capture has only a part
--             of the frame; and offset = in the packet.  If not all its bytes are in this packet:
--             bytes = string, and packet_keys = of the packets they came in (none of skipped
--             bytes).  Of telnet: bytes = those without what telnet adds
--   pending   number of bytes at the end that are in no finding yet; of a segment that waits for a
--             missing one, all
--   is_others true if it is a datagram of others: no other field of it holds
--   leads_to  key of the packet that shows the pending bytes, nil until it has come }
function Streams:add(packet, is_stored)
  local line = packet.line
  local whole, stream = split_alone(self, packet), rawget(self.by_line, line)
  local has_waiting = stream ~= nil and stream.framer.to > stream.framer.from
  if whole and not has_waiting then
    if is_stored then self.contents_by_key[packet.key] = PLAIN end
    return new_contents(packet, whole)
  end
  local findings = {}
  local contents = new_contents(packet, findings)
  stream = self.by_line[line]
  -- A lost datagram cut the bytes that wait if the next one is complete in itself.
  if whole then stream.framer:add("", true, findings) end
  add_to_stream(self, stream, contents)
  if is_of_others(stream, contents, line, has_waiting) then
    stream.framer:add("", true)
    drop_pieces(stream, stream.framer.from)
    contents.is_others = true
    self.contents_by_key[packet.key] = nil -- of a packet before it that a read filter dropped
    return contents
  end
  if packet.truncated then add_truncated_loss(self, packet, findings) end
  if is_stored then
    local can_be_read_anew = not line.is_datagram and is_plain(findings, packet.bytes)
    self.contents_by_key[packet.key] = can_be_read_anew and PLAIN or contents
  end
  return contents
end

--- Return the contents of a packet that was added before, nil if it was not.
function Streams:find(packet)
  local contents = self.contents_by_key[packet.key]
  if contents ~= PLAIN then return contents end
  return new_contents(packet, self:split(packet.bytes))
end

--- Return whether the capture ends before the frame that a packet's pending bytes begin.
function Streams:is_unfinished(contents, packet)
  if contents.pending == 0 or contents.leads_to then return false end
  local stream = self.by_line[packet.line]
  return stream.latest.key == packet.key and stream.framer:has_open_frame()
end

-- List the bytes that wait in a stream: its pending ones, and the segments behind each gap.
-- returns  list of { bytes, packet = the stream's latest; behind a gap the last with some of them;
--          first = the first one behind a gap }
local function list_waiting(stream)
  local last = { bytes = stream.framer:pending(), packet = stream.latest }
  local list, next_seq = { last }, stream.next_seq
  for _, contents in ipairs(stream.held) do
    local packet = contents.packet
    local overlap = distance(next_seq, packet.seq)
    if overlap < 0 then
      last, overlap = { bytes = "", first = packet }, 0
      list[#list + 1] = last
    end
    if overlap < packet.length then
      last.bytes, last.packet = last.bytes .. sub(packet.bytes, overlap + 1), packet
      next_seq = (packet.seq + packet.length) % 0x100000000
    end
  end
  return list
end

--- List the findings that wait in the streams, if the capture ends here.
-- returns  list of { packet = see above, findings = as from Streams:add, each with its bytes, and
--          offset = in these }
function Streams:unfinished()
  local list = {}
  for _, stream in pairs(self.by_line) do
    for _, piece in ipairs(list_waiting(stream)) do
      piece.findings = self:split(piece.bytes)
      for _, finding in ipairs(piece.findings) do finding.bytes = piece.bytes end
      if piece.packet then list[#list + 1] = piece end
    end
  end
  return list
end

--- List the losses of the capture: segments of TCP connections, the ends of packets.
-- returns  list of { time = seconds since 1970, frame = number of the packet behind the gap,
--          bus = name or nil, count = 1 }
function Streams:drops()
  local list = {}
  for _, loss in ipairs(self.losses) do list[#list + 1] = loss end
  for _, stream in pairs(self.by_line) do
    for _, piece in ipairs(list_waiting(stream)) do
      if piece.first then list[#list + 1] = new_loss(piece.first) end
    end
  end
  table.sort(list, function(a, b) return a.frame < b.frame end)
  return list
end

return M
