-- SPDX-License-Identifier: GPL-2.0-or-later
-- The contents of packets of byte streams and datagrams: frames, and bytes of none.  Pure Lua.
--
-- Packets are added once, in the order of the capture.  Revisits ask by frame key.
--
--   packet 7   |end of A|good frame B|start of C|   findings A (of packets 6 and 7) and B, and the
--   packet 8   |end of C|                           pending bytes of C, which packet 8 shows
--
-- TCP segments bring their sequence numbers.  Bytes that came before are left out.  A segment
-- behind a gap waits for the missing one, until it is clear that the capture does not have it.
--
-- A datagram of whole frames is complete in itself.  Other datagrams are a byte stream, as of a
-- bridge from a serial line, which cuts where it likes.  A lost one costs the frames it cut.
--
-- Such datagrams may be recorded twice: the copies are another stream, of which only good frames
-- count.
--
-- A conversation may be unknown when its first bytes come: they are on trial.

local frame = require "yapp.wire.frame"
local mavlink = require "yapp.serial.mavlink"
local memo = require "yapp.base.memo"
local repeats = require "yapp.serial.repeats"

local M = {}

local sub = string.sub

-- How long segments wait for a missing one: seconds, and bytes of the stream behind it.  A sender
-- usually repeats a segment within a second, and few send 64 KB ahead.
local MAX_WAIT, MAX_AHEAD = 1, 65535
-- A sequence number that differs by more is of a new connection.
local MAX_DISTANCE = 2 ^ 20
-- How many bytes of an unknown conversation are kept, and of how many conversations.
local MAX_TRIAL, MAX_TRIALS = 4096, 64
local MAX_HEADER = 24 -- bytes: in telnet each may be there twice

-- Stands for the contents of a packet of good frames alone: Streams:find reads its bytes anew.
local PLAIN = { findings = {}, pending = 0 }

local Streams = {}
Streams.__index = Streams

-- Besides the fields below, a stream has
--   latest    the latest packet; findings = those that it makes final
-- and of TCP, nil until they are known
--   next_seq  sequence number of the next byte
--   acked     sequence number that the other side has acknowledged
--   sent_seq  all bytes before it were sent, as the header of the segment sent_by shows
--   gap       the gap before the held segments, see Streams:drops
local function new_stream(framer)
  return {
    framer = framer,
    pieces = {},      -- contents with bytes in no finding yet: pieces[first] to pieces[last]
    first = 1,
    last = 0,
    is_ended = false, -- true if a new TCP connection has begun
    is_cut = false,   -- true if a frame went on in another packet
    held = {},        -- contents of the segments behind a gap, by sequence number
  }
end

--- Make the streams of a capture.
-- new_framer  function() -> a serial.framer
-- can_judge   function(time): true if time stamps tell copies from originals
function M.new(new_framer, can_judge)
  return setmetatable({
    new_framer = new_framer,
    can_judge = can_judge,
    repeats = repeats.new(can_judge),
    copies_by_key = memo(function() return new_stream(new_framer()) end),
    reader = new_framer(), -- of bytes that are complete in themselves, see Streams:split
    by_key = memo(function() return new_stream(new_framer()) end),
    trials = {}, -- by key, of unknown conversations, see new_trial
    trial_count = 0,
    trials_by_tag = {}, -- how many, by tag of serial.lines
    failed = {}, -- by key, of TCP: true if a trial ended without YAPP that a header had begun
    contents_by_key = {}, -- by frame key: the results of Streams:add
    seqs = {},     -- by key, of TCP: the sequence number that follows others' bytes
    gaps = {},     -- those that were not filled, see Streams:drops
  }, Streams)
end

-- Findings ---------------------------------------------------------------------------------------

-- Add the bytes of a packet to its stream.
-- overlap  how many of them the stream has already
local function add_bytes(stream, contents, overlap)
  local framer, packet, findings = stream.framer, contents.packet, stream.findings
  contents.packet, contents.overlap, contents.from = nil, overlap, framer.to
  if packet.line.is_tcp then framer:expect_telnet() end
  local bytes = overlap > 0 and sub(packet.bytes, overlap + 1) or packet.bytes
  framer:add(bytes, packet.truncated, findings)
  contents.to = framer.to
  local last = findings[#findings]
  if packet.truncated and last and last.missing then last.status = "truncated" end
  stream.last = stream.last + 1
  stream.pieces[stream.last] = contents
end

-- Drop the contents whose bytes all come before an offset.
local function drop_pieces(stream, offset)
  while stream.first <= stream.last and stream.pieces[stream.first].to <= offset do
    stream.pieces[stream.first] = nil
    stream.first = stream.first + 1
  end
end

-- Set where the bytes of a finding are.
-- contents  of the packet that shows it
local function locate_finding(stream, finding, contents)
  local from = contents.from
  if finding.from >= from and finding.to <= contents.to then
    if finding.is_telnet then return end
    finding.offset, finding.bytes = contents.overlap + finding.from - from, nil
    return
  end
  if finding.status == "skipped" then return end
  drop_pieces(stream, finding.from)
  stream.is_cut, finding.packet_keys = true, {}
  for i = stream.first, stream.last do
    local piece = stream.pieces[i]
    if piece.from < finding.to and piece.to > finding.from then
      finding.packet_keys[#finding.packet_keys + 1] = piece.key
      if piece ~= contents then piece.leads_to = contents.key end
    end
  end
end

-- TCP --------------------------------------------------------------------------------------------

-- Return how far one sequence number is ahead of another; they count modulo 2^32.
local function distance(seq, other)
  return (seq - other + 0x80000000) % 0x100000000 - 0x80000000
end

-- Keep a segment in the order of the sequence numbers.
local function hold_segment(stream, contents)
  local held, seq, index = stream.held, contents.packet.seq, #stream.held + 1
  while index > 1 and distance(seq, held[index - 1].packet.seq) < 0 do index = index - 1 end
  table.insert(held, index, contents)
end

-- Return whether the capture does not have the segment that others wait for.
local function is_lost(stream, packet)
  return stream.acked and distance(stream.acked, stream.next_seq) > 0 or
    distance(packet.seq, stream.next_seq) > MAX_AHEAD or
    packet.epoch - stream.gap.time > MAX_WAIT
end

-- Return the gap that a segment shows, see Streams:drops.
local function new_gap(stream, segment)
  local bus = stream.latest.line.bus
  return { time = segment.epoch, frame = segment.number, bus = bus, count = 1 }
end

-- Return the gap at the end of a connection, nil for none.
local function last_gap(stream)
  local sent_seq = stream.sent_seq
  if sent_seq and distance(sent_seq, stream.next_seq) > 0 then
    return new_gap(stream, stream.sent_by)
  end
end

-- Add the waiting segments that are in order; go on behind a gap if its segment is lost.
-- is_over  true if no missing segment will come
local function add_held(self, stream, is_over)
  local held, latest = stream.held, stream.latest
  while held[1] do
    local segment = held[1].packet
    local overlap = distance(stream.next_seq, segment.seq)
    if overlap < 0 then
      stream.gap = stream.gap or new_gap(stream, latest)
      if not is_over and not is_lost(stream, latest) then return end
      stream.framer:add("", true, stream.findings)
      table.insert(self.gaps, stream.gap)
      overlap, stream.gap = 0, nil
    end
    local contents = table.remove(held, 1)
    if overlap < segment.length then
      add_bytes(stream, contents, overlap)
      stream.next_seq, stream.gap = (segment.seq + segment.length) % 0x100000000, nil
    else
      contents.packet = nil
    end
  end
end

-- Keep that a segment's header shows that all bytes before a sequence number were sent.  The number
-- is one less than it says, as the end of a connection counts as a byte.
local function update_sent(stream, seq, segment)
  local next_seq = not stream.is_ended and stream.next_seq
  if not next_seq or distance(seq, next_seq) > MAX_DISTANCE then return end
  if distance(seq, stream.sent_seq or next_seq) > 0 then
    stream.sent_seq, stream.sent_by = seq, segment
  end
end

-- Add a segment, and those that waited for it.
local function add_segment(self, stream, contents)
  local packet = contents.packet
  local next_seq = stream.next_seq or self.seqs[packet.stream] or packet.seq
  if stream.is_ended or math.abs(distance(packet.seq, next_seq)) > MAX_DISTANCE then
    add_held(self, stream, true)
    stream.framer:add("", true, stream.findings)
    self.gaps[#self.gaps + 1] = last_gap(stream)
    next_seq, stream.is_ended, stream.sent_seq = packet.seq, false, nil
  end
  stream.next_seq = next_seq
  hold_segment(stream, contents)
  add_held(self, stream, false)
end

--- Add the header of a TCP segment.
-- key       of its stream
-- opposite  key of the stream of the other direction
-- segment   of host.tcp
-- returns   true if the segment can be put in order: its stream and its next sequence number are
--           known
function Streams:add_header(key, opposite, segment)
  local stream, other = rawget(self.by_key, key), rawget(self.by_key, opposite)
  local ack = segment.ack
  if other and ack then
    if distance(ack, other.acked or ack - 1) > 0 then other.acked = ack end
    update_sent(other, ack - 1, segment)
  end
  if stream then
    if segment.is_syn then stream.is_ended, stream.acked = true, nil end
    update_sent(stream, segment.seq - 1, segment)
    return stream.next_seq
  end
  local seq, length = segment.seq, segment.length
  local overlap = distance(self.seqs[key] or seq, seq)
  if not segment.is_ours and overlap >= 0 and overlap <= length then
    self.seqs[key] = (seq + length) % 0x100000000
  end
end

-- Packets ----------------------------------------------------------------------------------------

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
-- bytes  string
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

-- Return the stream that a packet belongs to, and whether it is one of copies.
-- is_alone  true if the packet is complete in itself: then its messages are compared
local function stream_of(self, packet, is_alone)
  local key = packet.stream
  if is_alone or not packet.line.is_datagram then return self.by_key[key], false end
  local number = self.repeats:copy_number(packet)
  if number == 0 then return self.by_key[key], false end
  return self.copies_by_key[key .. "|" .. number], true
end

-- Remove all findings but good frames: bytes that were not recorded twice are no loss.
local function keep_good(findings)
  local count = 0
  for i, finding in ipairs(findings) do
    findings[i] = nil
    if finding.status == "good" then
      count = count + 1
      findings[count] = finding
    end
  end
end

-- Return how many bytes wait in a stream.
local function count_waiting(stream)
  return stream and stream.framer.to - stream.framer.from or 0
end

-- Return whether a datagram begins a frame behind its findings.  A single "Y" at the end of other
-- bytes is chance, and so is "YP" that begins no header, unless datagrams are known to cut
-- frames.
local function begins_frame(stream, contents)
  local pending, length = contents.pending, contents.to - contents.from
  if pending == 0 or stream.is_cut then return pending > 0 end
  if pending == 1 then return length == 1 end
  return frame.may_be_plausible(stream.framer:pending(), 1)
end

-- Return whether a datagram is of others: it holds no frame, goes on with none and begins none.
-- waited  number of bytes that waited for it
local function is_of_others(stream, contents, waited)
  for _, finding in ipairs(contents.findings) do
    if finding.status ~= "skipped" then return false end
  end
  return waited == 0 and not begins_frame(stream, contents)
end

-- Return whether a datagram is of MAVLink, and no frame is in it.
local function is_of_mavlink(self, bytes)
  if not mavlink.is_whole(bytes) then return false end
  for _, finding in ipairs(self:split(bytes)) do
    if finding.status == "good" then return false end
  end
  return true
end

local function new_contents(packet, findings)
  return {
    key = packet.key,
    findings = findings,
    pending = 0,
    is_held = false,
    is_others = false,
    packet = packet, -- nil once its bytes are added
    overlap = 0,     -- number of its bytes that had come before
    from = 0,        -- offset in the stream of the others, once they are added
    to = 0,
  }
end

-- Add a packet to its stream; return its contents.
local function add_to_stream(self, stream, contents)
  local packet, findings, framer = contents.packet, contents.findings, stream.framer
  stream.latest, stream.findings = packet, findings
  if packet.seq then
    add_segment(self, stream, contents)
  else
    add_bytes(stream, contents, 0)
  end
  for i = 1, #findings do locate_finding(stream, findings[i], contents) end
  drop_pieces(stream, framer.from)
  if contents.packet then -- its bytes wait for a missing segment
    contents.is_held, contents.pending = true, #packet.bytes
  elseif contents.to > framer.from then
    local _, missing = framer:open_frame()
    contents.pending = contents.to - math.max(contents.from, framer.from)
    contents.missing = missing
  end
end

-- Keep the contents of a packet for Streams:find.
local function keep_contents(self, packet, contents)
  local can_be_read_anew = not packet.line.is_datagram and is_plain(contents.findings, packet.bytes)
  self.contents_by_key[packet.key] = can_be_read_anew and PLAIN or contents
end

-- Add the gap of a packet whose end the capture lacks: whole frames may be missing.
local function add_truncated_gap(self, stream, packet, findings)
  local last = findings[#findings]
  if packet.truncated and not (last and last.missing) then
    table.insert(self.gaps, new_gap(stream, packet))
  end
end

--- Add the next packet of the capture.
-- packet  {
--   key          frame key; a second frame with this key replaces the first
--   number       of the packet
--   epoch        of a segment, or if it is truncated: seconds since 1970
--   bytes        string: those that were captured
--   truncated    true if the packet had more
--   is_found     true if its conversation was found by content: it may have datagrams of others
--   stream       key of the stream; line = of serial.lines
--   seq          of TCP, if it is known: sequence number of the first byte
--   length       number of bytes that it had }
-- is_stored  true if Streams:find may ask for it
-- returns  {
--   findings  as from serial.framer, or with the status "truncated": the capture has only a part
--             of the frame; and offset = in the packet.  If not all its bytes are in this packet:
--             bytes = string, and packet_keys = of the packets they came in (none of skipped
--             bytes).  Of a frame of telnet: bytes = those before telnet
--   pending   number of bytes at the end that are in no finding yet
--   is_held   true if it is a segment that waits for a missing one: then all are pending
--   missing   number of bytes to come of the frame that the pending ones begin, or nil
--   is_others true if it is a datagram of others: no other field of it holds
--   leads_to  key of the packet that shows the pending bytes, nil until it has come }
function Streams:add(packet, is_stored)
  local may_be_of_others = packet.is_found and packet.line.is_datagram
  if may_be_of_others and is_of_mavlink(self, packet.bytes) then
    local contents = new_contents(packet, {})
    contents.is_others = true
    return contents
  end
  local whole = split_alone(self, packet)
  if whole and count_waiting(rawget(self.by_key, packet.stream)) == 0 then
    if is_stored then self.contents_by_key[packet.key] = PLAIN end
    return new_contents(packet, whole)
  end
  local stream, is_copy = stream_of(self, packet, whole)
  local waited, findings = count_waiting(stream), {}
  local contents = new_contents(packet, findings)
  -- A lost datagram cut the bytes that wait if the next one is complete in itself.
  if whole then stream.framer:add("", true, findings) end
  add_to_stream(self, stream, contents)
  if may_be_of_others and is_of_others(stream, contents, waited) then
    stream.framer:add("", true)
    drop_pieces(stream, stream.framer.from)
    contents.is_others = true
    return contents
  end
  if is_copy then keep_good(findings) else add_truncated_gap(self, stream, packet, findings) end
  if is_stored then keep_contents(self, packet, contents) end
  return contents
end

--- Return the contents of a packet that was added before, nil if it was not.
function Streams:find(packet)
  local contents = self.contents_by_key[packet.key]
  if contents ~= PLAIN then return contents end
  return new_contents(packet, self:split(packet.bytes))
end

--- Return whether a packet was added before, and stored.
function Streams:is_stored(key)
  return self.contents_by_key[key] ~= nil
end

-- Return whether a frame may begin in bytes of an unknown conversation.
local function has_start(bytes)
  return bytes:find("YP", 1, true) or sub(bytes, -1) == "Y"
end

--- Return whether a frame may begin in a packet of an unknown conversation.
Streams.may_begin = has_start

--- Return whether a packet of an unknown conversation may go on with a frame.
-- tag  of its line
function Streams:may_go_on(tag)
  return self.trials_by_tag[tag] ~= nil
end

local function count_trial(self, tag, change)
  local by_tag = self.trials_by_tag
  local count = (by_tag[tag] or 0) + change
  self.trial_count, by_tag[tag] = self.trial_count + change, count > 0 and count or nil
end

-- End the trial of a conversation that has not shown YAPP.
local function fail_trial(self, key)
  local trial = self.trials[key]
  if trial.is_tcp and trial.has_header then self.failed[key] = true end
  self.trials[key] = nil
  count_trial(self, trial.tag, -1)
end

-- Begin the trial of a conversation, if a frame may begin in its bytes.
local function new_trial(self, packet)
  if not has_start(packet.bytes) then return nil end
  if self.trial_count >= MAX_TRIALS then
    for key in pairs(self.trials) do fail_trial(self, key) end
  end
  local trial = {
    framer = self.new_framer(),
    repeats = repeats.new(self.can_judge),
    -- The same if each datagram was recorded twice: pieces smaller than a header do not show it.
    paired_framer = packet.line.is_datagram and self.new_framer() or nil,
    paired_repeats = packet.line.is_datagram and repeats.new(self.can_judge) or nil,
    packets = {},
    tag = packet.line.tag,
    is_tcp = packet.line.is_tcp,
    has_header = false, -- true if the begin of one came
  }
  if packet.line.is_tcp then trial.framer:expect_telnet() end
  if packet.line.is_datagram then trial.paired_repeats:expect_pairs(packet.stream) end
  self.trials[packet.stream] = trial
  count_trial(self, trial.tag, 1)
  return trial
end

-- Return the trial that a packet belongs to, which may be new; nil for none.
local function trial_for(self, packet)
  if packet.line.is_datagram and is_of_mavlink(self, packet.bytes) then return nil end
  return self.trials[packet.stream] or new_trial(self, packet)
end

-- Return whether bytes of a trial show that it is YAPP.
local function is_proof(framer, findings)
  for _, finding in ipairs(findings) do
    if finding.status == "good" then return true end
  end
  return framer:has_known()
end

--- End the trial of a conversation.
-- key      of its stream
-- returns  list of the packets that came so far; empty if it has none
function Streams:end_trial(key)
  local trial = self.trials[key]
  if not trial then return {} end
  self.trials[key] = nil
  count_trial(self, trial.tag, -1)
  return trial.packets
end

-- Return whether the bytes of a trial may go on: with a plausible header, or the start of one.
local function has_begun(framer)
  local pending = framer.to - framer.from
  if pending == 0 or pending > MAX_TRIAL then return false end
  return pending < MAX_HEADER or framer:open_frame()
end

-- Keep a packet of a trial that may go on.
local function keep_on_trial(trial, packet)
  local framer, paired = trial.framer, trial.paired_framer
  if not (has_begun(framer) or paired and has_begun(paired)) then return false end
  -- A "Y" at the end of several bytes may be chance.
  trial.has_header = trial.has_header or framer.to - framer.from > 1 or #packet.bytes == 1
  table.insert(trial.packets, packet)
  return true
end

-- Return whether the bytes of a trial show that it is YAPP, each packet of which was recorded
-- twice.
local function is_in_pairs(trial, packet)
  local framer = trial.paired_framer
  if not framer or trial.paired_repeats:copy_number(packet) > 0 then return false end
  return is_proof(framer, framer:add(packet.bytes, packet.truncated))
end

-- Return whether a trial has had the bytes of a packet: by its port, which asks before the
-- heuristics do; or in the packet that it is a copy of.
local function has_packet(trial, packet)
  local packets = trial.packets
  local latest = packets[#packets]
  if latest and latest.key == packet.key then return true end
  if not packet.line.is_datagram or trial.repeats:copy_number(packet) == 0 then return false end
  packets[#packets + 1] = packet
  return true
end

-- Return whether a good frame begins before an offset.
local function is_good_before(findings, offset)
  for _, finding in ipairs(findings) do
    if finding.status == "good" then return finding.from < offset end
  end
  return false
end

-- Add a packet to a trial.
-- returns  true if its bytes show YAPP; true if those before belong to its first frame
local function add_to_trial(trial, packet)
  local framer = trial.framer
  local from = framer.to
  local findings = framer:add(packet.bytes, packet.truncated)
  return is_proof(framer, findings), is_good_before(findings, from)
end

-- End a trial that has proved YAPP; return the list of its packets.
-- is_joined  true if they belong to the first frame; else they may be of others
local function end_proved_trial(self, packet, is_joined)
  local packets = self:end_trial(packet.stream)
  for _, earlier in ipairs(packets) do earlier.is_found = not is_joined end
  return packets
end

--- Return whether bytes of a TCP conversation, which were not added, may have been YAPP: a trial
-- of them failed, as it does if segments come out of order.
function Streams:has_failed(key)
  return self.failed[key] or false
end

--- Add a packet of an unknown conversation to its trial.
-- packet     as of Streams:add
-- is_proved  true if the packet alone shows that it is YAPP
-- returns    nil, unless the bytes that came so far have a frame, or the header of a message of the
--            catalogue.  Then the list of the earlier packets, for Streams:add.  If they do not
--            belong to the packet's first frame, they may be of others: is_found is set
function Streams:try_packet(packet, is_proved)
  local trial = self.trials[packet.stream]
  if is_proved then -- even if it is a copy
    local is_joined = trial and select(2, add_to_trial(trial, packet))
    return end_proved_trial(self, packet, is_joined)
  end
  trial = trial_for(self, packet)
  if not trial then return nil end
  local are_pairs = is_in_pairs(trial, packet)
  if not are_pairs and has_packet(trial, packet) then return nil end
  local is_shown = add_to_trial(trial, packet)
  if are_pairs and not is_shown then self.repeats:expect_pairs(packet.stream) end
  if is_shown or are_pairs then return end_proved_trial(self, packet, true) end
  if not keep_on_trial(trial, packet) then fail_trial(self, packet.stream) end
  return nil
end

--- Return whether the capture ends before the frame that a packet's pending bytes begin.
function Streams:is_unfinished(contents, packet)
  if contents.pending == 0 or contents.leads_to then return false end
  local stream = self.by_key[packet.stream]
  return stream.latest.key == packet.key and stream.framer:open_frame()
end

-- List the bytes that wait in a stream: its pending ones, and the segments behind each gap.
-- returns  list of { bytes, packet = the stream's latest; behind a gap the last with some of them }
local function list_waiting(stream)
  local last = { bytes = stream.framer:pending(), packet = stream.latest }
  local list, next_seq = { last }, stream.next_seq
  for _, contents in ipairs(stream.held) do
    local packet = contents.packet
    local overlap = distance(next_seq, packet.seq)
    if overlap < 0 then
      last, overlap = { bytes = "" }, 0
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
  for _, stream in pairs(self.by_key) do
    for _, piece in ipairs(list_waiting(stream)) do
      piece.findings = self:split(piece.bytes)
      for _, finding in ipairs(piece.findings) do finding.bytes = piece.bytes end
      list[#list + 1] = piece
    end
  end
  return list
end

--- List the losses of the capture: segments of TCP connections, the ends of packets.
-- returns  list of { time = seconds since 1970, frame = number of the packet behind the gap,
--          bus = name or nil, count = 1 }
function Streams:drops()
  local list = {}
  for _, gap in ipairs(self.gaps) do list[#list + 1] = gap end
  for _, stream in pairs(self.by_key) do list[#list + 1] = stream.gap or last_gap(stream) end
  table.sort(list, function(a, b) return a.frame < b.frame end)
  return list
end

return M
