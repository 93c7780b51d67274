-- SPDX-License-Identifier: GPL-2.0-or-later
-- All that is known of a file's byte streams and datagrams: the frames of a packet, where their bytes came, and when.
-- Pure Lua, 5.2 and 5.4.
--
-- It is told the facts of a packet and says what the packet holds.  A first pass takes packets in order; any later look
-- asks, by the packet's number and the place of the bytes in it (a packet in a tunnel may have several pieces).
-- A first pass may be uninformed: `tshark -2` and sharkd build no tree then, nothing tells captured interfaces and
-- directions apart, and their bytes are one stream.  A second pass that can and comes in order takes the packets again,
-- each source a stream of its own.  Where last bytes lead it cannot ask the first: two sources' frames may begin alike.
--
-- Most packets are one good frame and no more.  Of such a one only the place is kept, and what was noted of it: the
-- rest is in its bytes, which come again with each look.  Of another its piece is kept (serial.kept).

local frame = require("yapp.wire.frame")
local serial_kept = require("yapp.serial.kept")

local M = {}

local HEADER, CRC_SIZE = frame.HEADER, frame.CRC_SIZE
local min, max, floor, sub = math.min, math.max, math.floor, string.sub

local Memory = {}
Memory.__index = Memory

local function new_pass(new_history)
  return {
    history = new_history(),
    streams = {},            -- [key]: see stream_of
    kept = serial_kept.new(), -- of each packet
    highest = 0,             -- the number of the last packet taken
    informed = false,        -- whether the pass told sources apart
  }
end

--- The memory of a file that is about to be read.
-- crc         the module wire.crc
-- options     { new_framer = function() -> a serial.stream, new_history = function() -> a message.history }
function M.new(crc, options)
  return setmetatable({ crc = crc, new_framer = options.new_framer, datagrams = options.new_framer(),
    first = new_pass(options.new_history), second = new_pass(options.new_history), plain = { good = true, from = 0 } },
    Memory)
end

--- Says that the first pass is the only one: next to nothing is kept.  (Were there a second one after all, it would
-- find everything anew.)
function Memory:only_pass()
  self.first.kept.is_only_pass = true
end

--- tshark's taps see one of the first packets.  A first pass of two has none, and has had all packets before they do.
function Memory:tapped(number)
  if not self.is_again and self.first.highest <= number then self:only_pass() end
end

-- What is known of a stream: when which message came; and, as far as it needs them, its framer, its length, the packets
-- with bytes that wait, and the pieces that will not change behind the packet at hand.
local function stream_of(pass, key)
  local stream = pass.streams[key]
  if not stream then
    stream = { length = 0, waiting = {}, first = 1, last = 0, settled = {} }
    pass.streams[key] = stream
  end
  return stream
end

-- What a packet holds --------------------------------------------------------------------------------------------

-- A frame, whole or cut.  bytes, at: where it is, 0-based.
local function message_of(self, event, bytes, at)
  local id, size, reserved, seq, ctl = frame.parse(bytes, at + 1)
  local length, crc, calculated = event.to - event.from, nil, nil
  local status = event.kind == "cut" and "cut" or event.good and "good" or "bad"
  if status == "bad" then
    crc = frame.crc(bytes, at + length)
    calculated = self.crc.update(self.crc.INITIAL, bytes, at + 1, at + length - CRC_SIZE)
  end
  return { status = status, id = id, seq = seq, ctl = ctl, size = size, reserved = reserved,
    payload = sub(bytes, at + HEADER + 1, at + min(HEADER + size, length)), crc = crc, calculated = calculated,
    missing = event.missing, truncated = event.truncated, length = length,
    at = not event.bytes and at or nil, bytes = event.bytes }
end

local function shown(self, event, piece, fact)
  local at, bytes = event.from - piece.base, event.bytes
  if event.kind == "skipped" then
    return { status = "skipped", length = event.to - event.from, at = not bytes and at or nil, bytes = bytes }
  end
  local message = message_of(self, event, bytes or fact.bytes, bytes and 0 or at)
  if event.parts then message.parts, message.shown_in = event.parts, fact.number end
  return message
end

-- The header of the frame that is open at the end of a stream; nil for none.
local function open_header(stream)
  local framer = stream.joined and stream.joined.framer or stream.framer
  return framer and framer:open_header()
end

-- Whether the capture ends before the frame of a packet's last bytes: a pass that has come to its end knows.
local function is_unfinished(self, pass, piece, fact)
  local stream = fact.visited and pass.highest >= self.first.highest and pass.streams[fact.stream]
  return stream and stream.newest == piece and open_header(stream) ~= nil
end

local function packet_of(self, pass, piece, fact)
  local events = {}
  for i, event in ipairs(piece.events) do events[i] = shown(self, event, piece, fact) end
  return { pass = pass, piece = piece, events = events, done = piece.done, pending = piece.pending,
    missing = piece.missing, leads_to = piece.leads_to, is_unfinished = is_unfinished(self, pass, piece, fact) }
end

local function plain_packet(self, pass, fact)
  local size, plain = #fact.bytes, self.plain
  plain.to = size
  return { pass = pass, events = { message_of(self, plain, fact.bytes, 0) }, done = size, pending = 0 }
end

-- Datagrams ------------------------------------------------------------------------------------------------------

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
  for _, event in ipairs(rest) do event.truncated = truncated or nil end
  append(events, rest)
end

local take = {} -- by transport; each returns a piece: { events, base, done, pending, missing }

-- Complete in itself, so one framer does for all.
function take.datagram(self, _, fact)
  local framer = self.datagrams
  local base = framer:offset()
  local events = framer:feed(fact.bytes)
  if framer:offset() < base + #fact.bytes then finish(framer, events, fact.truncated) end
  return { events = events, base = base, done = #fact.bytes, pending = 0 }
end

-- TCP ------------------------------------------------------------------------------------------------------------

-- TCP hands over again what waits, with what follows, in a piece of its own: only what follows is new to the framer.
function take.segment(self, stream, fact)
  local joined, bytes = stream.joined, fact.bytes
  local known = joined and #joined.waiting or 0
  if not joined or known > 0 and (fact.place > 0 or sub(bytes, 1, known) ~= joined.waiting) then
    joined, known = { framer = self.new_framer(), events = {}, base = 0 }, 0
    stream.joined = joined
  end
  local framer, events, base = joined.framer, joined.events, joined.base
  append(events, framer:feed(sub(bytes, known + 1)))
  -- TCP keeps no more for a frame that may yet come than the largest one takes.
  if #bytes > frame.LARGEST and framer:offset() - base <= known then finish(framer, events) end
  local done = framer:offset() - base
  if done > known then
    joined.events, joined.base = {}, framer:offset()
  else -- TCP lets go of no bytes as long as none of the new ones go with them: what is found waits too
    events, done = {}, 0
  end
  joined.waiting = sub(bytes, done + 1)
  return { events = events, base = base, done = done, pending = 0 }
end

-- Streams that nobody joins for us -------------------------------------------------------------------------------

-- Which packets the bytes of a frame came in; they lead to the one that shows it.  This may be a later one where a
-- frame is bad and one that overlaps it was still open.
local function link(stream, event, base, number)
  local waiting, parts = stream.waiting, {}
  for i = stream.first, stream.last do
    if waiting[i].from >= event.to then break end
    parts[#parts + 1] = waiting[i].number
    if waiting[i].number ~= number then waiting[i].piece.leads_to = number end
  end
  if base < event.to then parts[#parts + 1] = number end
  event.parts = parts
end

-- The packets whose bytes are all before this offset wait no longer.
local function forget(stream, offset)
  local waiting = stream.waiting
  while stream.first <= stream.last and waiting[stream.first].to <= offset do
    stream.settled[#stream.settled + 1] = waiting[stream.first].piece
    waiting[stream.first] = nil
    stream.first = stream.first + 1
  end
end

function take.stream(self, stream, fact)
  local framer = stream.framer or self.new_framer()
  local base, to = stream.length, stream.length + #fact.bytes
  stream.framer, stream.length = framer, to
  local events = framer:feed(fact.bytes)
  if fact.truncated then finish(framer, events, true) end
  for _, event in ipairs(events) do
    forget(stream, event.from)
    if event.from < base and event.kind ~= "skipped" then link(stream, event, base, fact.number) end
  end
  local done = framer:offset()
  forget(stream, done)
  local pending = to - max(done, base)
  local piece = { events = events, base = base, done = to - base - pending, pending = pending,
    missing = framer:waiting() }
  if pending > 0 then
    stream.last = stream.last + 1
    stream.waiting[stream.last] = { piece = piece, number = fact.number, from = base, to = to }
  end
  return piece
end

-- The passes -----------------------------------------------------------------------------------------------------

-- Takes a packet that is one good frame, without what others need: this saves a tenth of the time of a packet.
-- returns  the packet; nil for any other, of which nothing is taken
local function take_plain(self, pass, stream, fact)
  local number, place, bytes = fact.number, fact.place, fact.bytes
  if fact.truncated or fact.transport == "segment" or pass.kept:has(number) then return nil end
  if fact.transport == "datagram" then
    if not self.datagrams:pass(bytes) then return nil end
  else
    if not stream.framer or not stream.framer:pass(bytes) then return nil end
    stream.length = stream.length + #bytes
  end
  pass.kept:keep_place(number, place)
  local packet = plain_packet(self, pass, fact)
  packet.is_now = true
  return packet
end

-- Takes a packet into its stream.
local function take_packet(self, pass, fact)
  local stream = stream_of(pass, fact.stream)
  pass.highest = fact.number
  if stream.settled[1] then pass.kept:settle(stream.settled, fact.number) end
  local plain = take_plain(self, pass, stream, fact)
  if plain then return plain end
  local piece = take[fact.transport](self, stream, fact)
  stream.newest, stream.number = piece, fact.number
  for _, event in ipairs(piece.events) do
    if event.from >= piece.base then event.bytes = nil end -- they are in the packet anyway
  end
  local packet = packet_of(self, pass, piece, fact)
  packet.is_now = true
  if pass.kept:keep(piece, fact) then
    packet.piece = nil
  elseif piece.pending == 0 then
    stream.settled[#stream.settled + 1] = piece
  end
  return packet
end

-- What the pass knows of a packet, or nil.
local function recall(self, pass, fact)
  local piece, is_plain = pass.kept:recall(fact.number, fact.place)
  if is_plain then return plain_packet(self, pass, fact) end
  return piece and packet_of(self, pass, piece, fact)
end

--- What a packet holds.
-- fact     what is known of it; the memory keeps nothing of this table:
--            number, place        of the packet; of its bytes in it, in bytes: the same with each look
--            bytes, truncated     string; whether the capture has fewer than the packet had
--            transport            "datagram"; "segment", of TCP, which hands over again what is not `done`; "stream"
--            stream               key of the stream, on a first pass and where `informed`
--            visited, informed    whether it is a later look; whether the key tells captured sources apart
-- returns  nil where the first pass was not asked about these bytes, else
--          { events = array, done = bytes that are settled, pending = bytes at the end that wait for more,
--            missing = bytes to come of the frame that waits, nil where no header is whole,
--            leads_to = number of the packet that shows them, as far as is known;
--            is_unfinished = whether the capture ends before the frame that they begin: a later look knows }
--          An event is a frame, finished, or a range of bytes that belong to none (status and place only):
--          { status = "good" | "bad" | "cut" | "skipped", id, seq, ctl, size, reserved, payload,
--            crc, calculated = where bad, missing = bytes of one that is cut, truncated = whether the capture cut it,
--            length = bytes, at = 0-based in the packet, or bytes = string where it began in an earlier one,
--            parts = numbers of the packets it came in and shown_in = the last, where it began in an earlier one }
--          Nothing in it changes later.
function Memory:look(fact)
  local first, second = self.first, self.second
  if not fact.visited then
    first.informed = first.informed or fact.informed
    return take_packet(self, first, fact)
  end
  self.is_again = true
  if fact.informed and not first.informed or first.kept.is_only_pass then
    local packet = fact.number <= second.highest and recall(self, second, fact)
    if packet then return packet end
    if fact.number >= second.highest then return take_packet(self, second, fact) end
  end
  return recall(self, first, fact)
end

--- Whether the first pass told sources apart.
function Memory:is_informed()
  return self.first.informed
end

--- The frames that the capture ends before, as far as the pass that was made last has come.
-- returns  list of { stream = its key, header = string, number = of the last packet with bytes of it }
function Memory:unfinished()
  local list = {}
  for key, stream in pairs((self.second.highest > 0 and self.second or self.first).streams) do
    local header = open_header(stream)
    if header then list[#list + 1] = { stream = key, header = header, number = stream.number } end
  end
  return list
end

local PLACE = 2 ^ -21 -- of a byte in its packet
local LINKS = { "command_in", "previous_change", "next_change" } -- in a change of message.history

--- What changed with a frame since its source's previous good one (see message.history).
-- message  as History:note takes it; number, delta and is_unsure are filled in
-- packet   from look, for this fact
-- index    of the frame among its events
-- fact     as given to look
-- returns  a change, or nil, as for a frame that is not good, and where it is_unsure: the first pass took several
--          sources for one; its numbers are those of packets
function Memory:change(message, packet, index, fact)
  if not message.good then return nil end
  message.is_unsure = packet.pass == self.first and fact.informed and not self.first.informed
  if message.is_unsure then return nil end
  local pass, piece, number, change = packet.pass, packet.piece, fact.number
  message.number = number + (fact.place + (packet.events[index].at or 0)) * PLACE
  if packet.is_now then
    local delta
    change, delta = pass.history:note(message)
    if piece then piece.events[index].delta = delta else pass.kept.archive.deltas[number] = delta end
  else
    if piece then message.delta = piece.events[index].delta else message.delta = pass.kept.archive:delta(number) end
    change = pass.history:change(message)
  end
  if not change then return nil end
  if change.is_alarm or change.active_since then
    change.next_change = pass.history:next_change(message.number, message.source)
  end
  for _, name in ipairs(LINKS) do change[name] = change[name] and floor(change[name]) end
  return change
end

return M
