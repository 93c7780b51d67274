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
      framer = self.new_framer(), length = 0, -- and the bytes that it was given
      waiting = {}, first = 1, last = 0,      -- the packets with bytes that it has not given out
      joined = nil,                           -- where TCP joins segments: see take.segment
      fact = nil, piece = nil,                -- of the latest packet
    }
    streams[key] = stream
  end
  return stream
end

-- Taking a packet: each returns a piece -----------------------------------------------------------
--
-- { events, base = offset of the packet in its stream, done = bytes that are settled, pending =
-- bytes that wait,
--   missing = bytes to come of the frame that waits, leads_to = look at the packet that shows it,
--   stream }
-- An event is the framer's, with truncated = whether the capture cut it; without bytes where they
-- are in the packet; with parts = looks at its packets, look = of the message where the packet has
-- one before it, delta = of its source.

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
  for _, event in ipairs(rest) do event.truncated = is_truncated or nil end
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
    waiting[i].piece.leads_to = look
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
  local piece = {
    events = events,
    base = base,
    done = done - base,
    pending = to - done,
    missing = framer:waiting(),
  }
  if piece.pending > 0 then
    stream.last = stream.last + 1
    stream.waiting[stream.last] = { piece = piece, look = look, from = base, to = to }
    piece.stream = stream
  end
  return piece
end

-- Whether a packet is one good frame and no more.  Most are, and of those nothing is kept but the
-- delta: the rest is in their bytes, which come again with each look.
local function is_one_frame(piece, fact)
  local event = piece.events[1]
  if piece.done < #fact.bytes or not event or not event.good then return false end
  return event.from == piece.base and event.to - event.from == piece.done
end

-- Takes a packet into its stream.
local function take_packet(self, pass, look, fact)
  local stream = stream_of(self, pass, fact.stream)
  local piece = take[fact.transport](self, stream, fact, look)
  stream.fact, stream.piece = fact, piece
  for i, event in ipairs(piece.events) do
    if event.from >= piece.base then event.bytes = nil end -- they are in the packet anyway
    if i > 1 and event.kind ~= "skipped" then
      event.look = pass:another()
      pass.entries[event.look] = false
    end
  end
  pass.entries[look] = not is_one_frame(piece, fact) and piece
  return piece
end

-- What the pass knows of a packet; nil for nothing.
local function recall(pass, look, fact)
  local kept, size = pass.entries[look], #fact.bytes
  if type(kept) == "table" or kept == nil then return kept end
  local event = { kind = "frame", good = true, from = 0, to = size, delta = kept or nil }
  return { events = { event }, base = 0, done = size, pending = 0 }
end

-- What a packet holds -----------------------------------------------------------------------------

-- The numbers of the packets of some looks, but for those that a read filter rejected.
local function numbers_of(pass, looks)
  local numbers = {}
  for _, look in ipairs(looks) do numbers[#numbers + 1] = pass:number(look) end
  return numbers
end

-- An event as it is told.
local function shown(pass, event, piece, fact)
  local at, bytes, length = event.from - piece.base, fact.bytes, event.to - event.from
  local status = event.kind
  if status == "frame" then status = event.good and "good" or "bad" end
  local told = { status = status, length = length, bytes = event.bytes }
  if not event.bytes then told.at = at end
  if status == "skipped" then return told end
  if event.bytes then at, bytes = 0, event.bytes end
  told.id, told.size, told.reserved, told.seq, told.ctl = frame.parse(bytes, at + 1)
  told.payload = sub(bytes, at + HEADER + 1, at + min(HEADER + told.size, length))
  told.missing, told.truncated = event.missing, event.truncated
  if status == "bad" then
    told.crc = frame.crc(bytes, at + length)
    told.calculated = crc.update(crc.INITIAL, bytes, at + 1, at + length - CRC_SIZE)
  end
  if event.parts then
    told.parts = numbers_of(pass, event.parts)
    told.count = #event.parts
    told.shown_in = fact.number
  end
  return told
end

-- The header of the frame that is open at the end of a stream; nil for none.
local function open_header(stream)
  return (stream.joined or stream).framer:open_header()
end

-- Whether the capture ends before the frame of a packet's last bytes: a pass that has come to its
-- end knows.
local function is_unfinished(self, pass, piece)
  local stream = piece.stream
  return stream and stream.piece == piece and pass.highest >= self.passes.first.highest and
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
--            where it began in an earlier one, parts = numbers of the packets it came in, count =
--            of them, with any that a read filter rejected, and shown_in = the last: where it began
--            in an earlier one }
--          Nothing in it changes later.
function Memory:look(fact)
  local pass, look, is_now = self.passes:look(fact.number, fact.place, fact.visited, fact.knows_all)
  if not pass then return nil end
  if is_now and not fact.knows_all then pass.is_partial = true end
  local piece = is_now and take_packet(self, pass, look, fact) or recall(pass, look, fact)
  if not piece then return nil end
  local events = {}
  for i, event in ipairs(piece.events) do events[i] = shown(pass, event, piece, fact) end
  local leads_to = piece.leads_to and pass:number(piece.leads_to)
  if leads_to == fact.number then leads_to = nil end
  return {
    pass = pass,
    look = look,
    is_now = is_now,
    piece = piece,
    events = events,
    done = piece.done,
    pending = piece.pending,
    missing = piece.missing,
    leads_to = leads_to,
    is_unfinished = fact.visited and is_unfinished(self, pass, piece),
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
  if not message.good then return nil end
  local pass, event = packet.pass, packet.piece.events[index]
  message.is_unsure = pass.is_partial and fact.knows_all
  if message.is_unsure then return nil end
  local look = event.look or packet.look
  if not packet.is_now then
    message.delta = event.delta
    return pass:change(look, message)
  end
  local change, delta = pass:note(look, message)
  message.delta, event.delta = delta, delta
  if not pass.entries[look] then pass.entries[look] = delta or false end
  return change
end

--- How things stand at it, once Memory:change has told.
function Memory.standing(_, message, packet)
  return message.good and not message.is_unsure and packet.pass:standing(message) or nil
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
