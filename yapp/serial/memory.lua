-- SPDX-License-Identifier: GPL-2.0-or-later
-- What the packets of byte streams and datagrams hold: their frames, where the bytes of these came,
-- and when.  Pure Lua.
--
-- It is told the facts of a packet and says what the packet holds.  Packets are taken in order, and
-- asked for again in any order, by number and by the place of the bytes in them: a packet in a
-- tunnel may have several pieces.

local crc = require("yapp.wire.crc")
local frame = require("yapp.wire.frame")
local passes = require("yapp.memory.passes")

local M = {}

local HEADER, CRC_SIZE = frame.HEADER, frame.CRC_SIZE
local min, max, sub = math.min, math.max, string.sub
local FORGOTTEN = { events = {}, done = 0, pending = 0 }
local NOTHING = {} -- of a packet that is a frame and no more

local Memory = {}
Memory.__index = Memory

--- The memory of a file that is about to be read.
-- options  { new_framer = function() -> a serial.stream, new_history = function() -> a
--          message.history }
function M.new(options)
  return setmetatable({
    new_framer = options.new_framer,
    datagrams = options.new_framer(), -- each is complete in itself, so one framer does for all
    passes = passes.new(options.new_history),
    streams = {},                     -- [pass] = { [key] = a stream }
  }, Memory)
end

-- What is known of a stream in a pass.
local function stream_of(self, pass, key)
  local streams = self.streams[pass] or {}
  self.streams[pass] = streams
  local stream = streams[key]
  if not stream then
    stream = {
      framer = self.new_framer(),
      length = 0, -- bytes that it was given
      waiting = {}, first = 1, last = 0, -- the packets with bytes that it has not given out
      joined = nil, -- where TCP joins segments: see take.segment
      fact = nil, look = nil, -- of the latest packet
    }
    streams[key] = stream
  end
  return stream
end

-- Taking a packet: each returns a piece -----------------------------------------------------------
--
-- { events, base = offset of the packet in its stream, done = bytes that are settled, pending =
-- bytes that wait, missing = bytes to come of the frame that waits }
-- An event is the framer's, with truncated = whether the capture cut it, and parts = looks at the
-- packets that it came in, where it began in an earlier one.

-- Appends what a framer found; skipped bytes that follow skipped bytes are one event.
local function append(events, found)
  for _, event in ipairs(found) do
    local last = events[#events]
    if last and last.kind == "skipped" and event.kind == "skipped" then
      last.to, last.bytes = event.to, last.bytes .. event.bytes
    else
      events[#events + 1] = event
    end
  end
end

-- Whatever waits in the framer is cut off.
local function finish(framer, events, is_truncated)
  local rest = framer:finish()
  for _, event in ipairs(rest) do event.truncated = is_truncated end
  append(events, rest)
end

local take = {} -- by transport

function take.datagram(self, _, fact)
  local framer = self.datagrams
  local base = framer:offset()
  local events = framer:feed(fact.bytes)
  finish(framer, events, fact.truncated)
  return { events = events, base = base, done = #fact.bytes, pending = 0 }
end

-- TCP hands over again what waits, with what follows, in a piece of its own: only what follows is
-- new to the framer.
function take.segment(self, stream, fact)
  local bytes, joined = fact.bytes, stream.joined
  local known = joined and #joined.text or 0
  local is_lost = known > 0 and (fact.place > 0 or sub(bytes, 1, known) ~= joined.text)
  if not joined or is_lost then
    joined, known = { framer = self.new_framer(), text = "", events = {}, base = 0 }, 0
    stream.joined = joined
  end
  local framer, events, base = joined.framer, joined.events, joined.base
  append(events, framer:feed(sub(bytes, known + 1)))
  -- TCP keeps no more for a frame that may yet come than the largest one takes.
  if #bytes > frame.LARGEST and framer:offset() - base <= known then finish(framer, events) end
  local done = framer:offset() - base
  if done > known then
    joined.events, joined.base = {}, framer:offset()
  else
    -- TCP lets go of no bytes as long as none of the new ones go with them: what is found waits
    -- too.
    events, done = {}, 0
  end
  joined.text = sub(bytes, done + 1)
  return { events = events, base = base, done = done, pending = 0 }
end

-- The packets whose bytes are all before this offset wait no longer.
local function forget(stream, offset)
  local waiting = stream.waiting
  while stream.first <= stream.last and waiting[stream.first].to <= offset do
    waiting[stream.first] = nil
    stream.first = stream.first + 1
  end
end

-- Which packets the bytes of a frame came in; they lead to the one that shows it.  This may be a
-- later one where a frame is bad and one that overlaps it was still open.
local function link(stream, event, base, look)
  local waiting, parts = stream.waiting, {}
  for i = stream.first, stream.last do
    if waiting[i].from >= event.to then break end
    parts[#parts + 1] = waiting[i].look
    waiting[i].kept.leads_to = look
  end
  if base < event.to then parts[#parts + 1] = look end
  event.parts = parts
end

-- Streams that nobody joins for us.
function take.stream(_, stream, fact, look)
  local framer = stream.framer
  local base, to = stream.length, stream.length + #fact.bytes
  stream.length = to
  local events = framer:feed(fact.bytes)
  if fact.truncated then finish(framer, events, true) end
  for _, event in ipairs(events) do
    forget(stream, event.from)
    if event.from < base and event.kind ~= "skipped" then link(stream, event, base, look) end
  end
  forget(stream, framer:offset())
  local done = max(framer:offset(), base)
  return {
    events = events,
    base = base,
    done = done - base,
    pending = to - done,
    missing = framer:waiting(),
  }
end

-- What is kept of a packet ------------------------------------------------------------------------
--
-- Of one that is a good frame and no more the seconds since the source's previous one, or false:
-- the rest is in its bytes, which come again with each look.  Else a table:
--   1 .. n     by event, the seconds since its source's previous one
--   looks      by event, the look of a frame that has another before it in the packet
--   leads_to   look at the packet that shows the bytes that wait
-- and the piece, or, where it has good frames only, as most have: waited = the bytes of the first
-- one in earlier packets, parts = looks at these; then the piece is made again.

local function has_good_frames_only(piece, fact)
  for _, event in ipairs(piece.events) do
    if not event.good then return false end
  end
  return piece.events[1] and piece.done + piece.pending == #fact.bytes
end

local function kept_of(piece, fact)
  if not has_good_frames_only(piece, fact) then
    for _, event in ipairs(piece.events) do
      if event.from >= piece.base then event.bytes = nil end -- they are in the packet anyway
    end
    return piece
  end
  local first, base = piece.events[1], piece.base
  local is_all = piece.pending == 0 and not piece.events[2]
  if is_all and first.from == base then return false end
  local waited = first.from < base and sub(first.bytes, 1, base - first.from) or ""
  return { waited = waited, parts = first.parts, looks = nil, leads_to = nil }
end

-- The piece of a packet that is looked at again.
local function piece_of(self, kept, fact)
  local of_packet = type(kept) == "table" and kept or NOTHING
  if of_packet.events then return of_packet end
  local framer, waited = self.new_framer(), of_packet.waited or ""
  local events = framer:feed(waited .. fact.bytes)
  events[1].parts = of_packet.parts
  local done = framer:offset() - #waited
  return {
    events = events,
    base = #waited,
    done = done,
    pending = #fact.bytes - done,
    missing = framer:waiting(),
  }
end

-- Takes a packet into its stream.
local function take_packet(self, pass, look, fact)
  local stream = stream_of(self, pass, fact.stream)
  local piece = take[fact.transport](self, stream, fact, look)
  local kept = kept_of(piece, fact)
  stream.fact, stream.look = fact, look
  pass.entries[look] = kept
  if piece.events[2] then kept.looks = {} end
  for i = 2, #piece.events do
    if piece.events[i].kind ~= "skipped" then
      kept.looks[i] = pass:another()
      pass.entries[kept.looks[i]] = false
    end
  end
  if piece.pending > 0 then
    local to = piece.base + #fact.bytes
    stream.last = stream.last + 1
    stream.waiting[stream.last] = { kept = kept, look = look, from = piece.base, to = to }
  end
  return kept, piece
end

-- What a packet holds -----------------------------------------------------------------------------

-- A frame as it is told.
-- bytes, from  string with it, and where it begins there; length: of it
local function told_frame(event, status, bytes, from, length)
  local id, size, reserved, seq, ctl = frame.parse(bytes, from)
  local is_bad, last = status == "bad", from + length - 1
  return {
    status = status,
    length = length,
    at = nil,
    bytes = nil,
    id = id,
    size = size,
    reserved = reserved,
    seq = seq,
    ctl = ctl,
    payload = sub(bytes, from + HEADER, from - 1 + min(HEADER + size, length)),
    crc = is_bad and frame.crc(bytes, last) or nil,
    calculated = is_bad and crc.update(crc.INITIAL, bytes, from, last - CRC_SIZE) or nil,
    missing = event.missing,
    truncated = event.truncated,
    parts = nil,
    count = nil,
  }
end

-- An event as it is told.
local function told(pass, event, piece, fact)
  local length, status = event.to - event.from, event.kind
  local at, parts = event.from - piece.base, event.parts
  local is_earlier = at < 0
  local result
  if status == "frame" then status = event.good and "good" or "bad" end
  if status == "skipped" then
    result = { status = status, length = length }
  else
    local bytes, from = fact.bytes, at + 1
    if is_earlier then bytes, from = event.bytes, 1 end
    result = told_frame(event, status, bytes, from, length)
  end
  if is_earlier then result.bytes = event.bytes else result.at = at end
  if parts then result.parts, result.count = pass:numbers(parts), #parts end
  return result
end

-- The header of the frame that is open at the end of a stream; nil for none.
local function open_header(stream)
  return (stream.joined or stream).framer:open_header()
end

-- Whether the capture ends before the frame of a packet's last bytes: a pass that has come to its
-- end knows.
local function ends_open(self, pass, look, fact)
  local stream = self.streams[pass][fact.stream]
  return stream and stream.look == look and pass.highest >= self.passes.first.highest and
    open_header(stream) ~= nil
end

--- What a packet holds.
-- fact     what is known of it, a table that may be kept:
--            number, place        of the packet; of its bytes in it, in bytes: the same with each
--                                 look
--            bytes, truncated     string; whether the capture has fewer than the packet had
--            transport            "datagram"; "segment", of TCP, which hands over again what is not
--                                 `done`; "stream"
--            stream               key of the stream
--            visited, knows_all   whether it is a later look; whether the key tells captured
--                                 sources apart
-- returns  nil where no pass was asked about these bytes, else
--          { events = array, done = bytes that are settled, pending = bytes at the end that wait
--          for more,
--            missing = bytes to come of the frame that waits, nil where no header is whole,
--            leads_to = number of the packet that shows them, as far as is known; is_unfinished =
--            whether the capture ends before the frame that they begin: a later look knows }
--          An event is a frame, finished, or a range of bytes that belong to none (status and place
--          only):
--          { status = "good" | "bad" | "cut" | "skipped", id, seq, ctl, size, reserved, payload,
--            crc, calculated = where bad, missing = bytes of one that is cut, truncated = whether
--            the capture cut it, length = bytes, at = 0-based in the packet, or bytes = string
--            where it began in an earlier one: then parts = numbers of the packets it came in, the
--            last one is this, and count = of them, with any that a read filter rejected }
--          Nothing in it changes later.
function Memory:look(fact)
  local pass, look, is_now = self.passes:look(fact.number, fact.place, fact.visited, fact.knows_all)
  if not pass then return nil end
  local kept, piece
  if is_now then
    if not fact.knows_all then pass.is_partial = true end
    kept, piece = take_packet(self, pass, look, fact)
  else
    kept = pass.entries[look]
    if kept == nil then return nil end
    piece = piece_of(self, kept, fact)
  end
  local events, leads_to, is_unfinished = {}, nil, false
  for i, event in ipairs(piece.events) do events[i] = told(pass, event, piece, fact) end
  if piece.pending > 0 and fact.visited then
    leads_to = kept.leads_to and pass:number(kept.leads_to)
    is_unfinished = not kept.leads_to and ends_open(self, pass, look, fact)
  end
  return {
    pass = pass,
    look = look,
    is_now = is_now,
    kept = kept,
    events = events,
    done = piece.done,
    pending = piece.pending,
    missing = piece.missing,
    leads_to = leads_to ~= fact.number and leads_to or nil,
    is_unfinished = is_unfinished,
  }
end

--- What is new in a frame (see message.history).
-- message  as History:note takes it; number, delta and is_unsure are filled in
-- packet   from look, for this fact
-- index    of the frame among its events
-- fact     as given to look
-- returns  a change, or nil, as for a frame that is not good, and where it is_unsure: the first
--          pass took several sources for one
function Memory.change(_, message, packet, index, fact)
  local pass, kept = packet.pass, packet.kept
  local of_packet = type(kept) == "table" and kept
  message.delta, message.is_unsure = false, false
  if not message.good then return nil end
  message.is_unsure = pass.is_partial and fact.knows_all
  if message.is_unsure then return nil end
  local look = index == 1 and packet.look or kept.looks[index]
  if not packet.is_now then
    if of_packet then kept = of_packet[index] end
    message.delta = kept or false
    return pass:change(look, message)
  end
  local change, delta = pass:note(look, message)
  message.delta = delta or false
  if of_packet then
    of_packet[index] = delta
  else
    pass.entries[look] = delta or false
  end
  return change
end

--- Nobody will look at a packet again: what is kept of it goes.
-- packet  from look
function Memory.forget(_, packet)
  packet.pass.entries[packet.look] = FORGOTTEN
end

--- How things stand at it, once Memory:change has told.
function Memory.standing(_, message, packet)
  return message.good and not message.is_unsure and packet.pass:standing(message)
end

--- The frames that the capture ends before, as far as the pass that was made last has come.
-- returns  list of { header = string, fact = of the last packet with bytes of it }
function Memory:unfinished()
  local list = {}
  for _, stream in pairs(self.streams[self.passes:last()] or {}) do
    local header = open_header(stream)
    if header then list[#list + 1] = { header = header, fact = stream.fact } end
  end
  return list
end

return M
