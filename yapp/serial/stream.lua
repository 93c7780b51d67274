-- SPDX-License-Identifier: GPL-2.0-or-later
-- Stream framing: finds YAPP frames in bytes that also hold noise, shell text and damaged frames.  Pure Lua.
--
-- A candidate is "YP" with a plausible header.  Candidates may overlap; they are judged in the order of their
-- ends, as if the bytes came one at a time.  A good CRC proves every overlapping candidate wrong.  A bad one stays
-- tentative until nothing good can overlap it any more.

local frame = require("yapp.wire.frame")

local M = {}

local byte, sub = string.byte, string.sub
local min, max = math.min, math.max

local HEADER, CRC_SIZE = frame.HEADER, frame.CRC_SIZE
local Y = byte(frame.SYNC)

----------------------------------------------------------------------------------------------------
-- The bytes not yet given out, by absolute offset.  New bytes are joined to a short text, in which all the
-- searching is done; what is older waits in pieces, so that a long wait does not mean a copy with each new byte.

local Buffer = {}
Buffer.__index = Buffer

local LONG_TEXT = 1024 -- from here on the text is moved to the pieces
local KEPT_TEXT = 16   -- except for these: an unfinished header or CRC may begin in them

local function new_buffer()
  return setmetatable({
    from = 0,                          -- the first byte held
    text = "", text_from = 0, to = 0,  -- the newest bytes, and the offset behind them
    pieces = {}, first = 1, last = 0,  -- the older bytes
    front = 0,                         -- where the first piece begins (the text, when there is no piece)
  }, Buffer)
end

-- Whether what is searched now will be in pieces when more is appended.
function Buffer:is_long()
  return #self.text >= LONG_TEXT
end

function Buffer:append(bytes)
  local text = self.text
  if self.from > self.text_from then
    text = sub(text, self.from - self.text_from + 1)
    self.text_from, self.front = self.from, self.from
  end
  if #text >= LONG_TEXT then
    self.last = self.last + 1
    self.pieces[self.last] = sub(text, 1, -KEPT_TEXT - 1)
    self.text_from = self.to - KEPT_TEXT
    text = sub(text, -KEPT_TEXT)
  end
  self.text, self.to = text .. bytes, self.to + #bytes
end

-- No bytes are held, and none before `to` ever will be.
function Buffer:pass(to)
  self.from, self.text, self.text_from, self.to, self.front = to, "", to, to, to
end

-- The bytes from the first one held up to `to`; they are held no longer.
function Buffer:take(to)
  if self.first > self.last then
    local from = self.from - self.front
    self.from = to
    return sub(self.text, from + 1, to - self.front)
  end
  local parts = {}
  while self.from < to do
    local piece = self.pieces[self.first] or self.text
    local piece_to = self.front + #piece
    local stop = min(to, piece_to)
    parts[#parts + 1] = sub(piece, self.from - self.front + 1, stop - self.front)
    self.from = stop
    if stop == piece_to and self.first <= self.last then
      self.pieces[self.first] = nil
      self.first, self.front = self.first + 1, piece_to
    end
  end
  return table.concat(parts)
end

----------------------------------------------------------------------------------------------------
-- Waiting candidates, a binary heap: the lowest `order` on top.

local function push(heap, candidate)
  local at = #heap + 1
  while at > 1 do
    local parent = (at - at % 2) / 2
    if heap[parent].order < candidate.order then break end
    heap[at], at = heap[parent], parent
  end
  heap[at] = candidate
end

local function pop(heap)
  local size = #heap
  local top, moved = heap[1], heap[size]
  heap[size], size = nil, size - 1
  local at, child = 1, 2
  while child <= size do
    if child < size and heap[child + 1].order < heap[child].order then child = child + 1 end
    if moved.order < heap[child].order then break end
    heap[at], at, child = heap[child], child, 2 * child
  end
  if size > 0 then heap[at] = moved end
  return top
end

----------------------------------------------------------------------------------------------------
-- The stream

local Stream = {}
Stream.__index = Stream

--- A stream of bytes, empty yet.
-- crc      the module wire.crc
-- accepts  function(id, size) -> boolean: false rules a candidate out (a known message of another size)
-- returns  the stream; feed() it.  Document: "UART Stream Framing".
function M.new(crc, accepts)
  local self = setmetatable({ crc = crc, accepts = accepts, buffer = new_buffer(), searched = 0 }, Stream)
  self:forget()
  return self
end

-- No candidate is left of those whose header has come.
function Stream:forget()
  self.heap = {}                               -- the waiting ones
  self.queue, self.first, self.last = {}, 1, 0 -- the waiting and the bad ones, by start
  self.undecided = 1                           -- in the queue: none before it is waiting
end

-- Of candidates, the one that ends first goes first, of those that end together the one that starts first.
local function new_candidate(from, length)
  local to = from + length
  return { from = from, to = to, order = to * 0x20000 - length }
end

-- Searches for the next candidate.  In front of a header whose end is yet to come the search stops and waits.
-- returns the candidate or nil; the same one again until `searched` is behind its start
function Stream:find_candidate()
  if self.found and self.found.from >= self.searched then return self.found end
  local buffer = self.buffer
  local text, text_from = buffer.text, buffer.text_from
  self.found = nil
  while true do
    local at = frame.find(text, self.searched - text_from + 1)
    if not at then
      self.searched = max(self.searched, byte(text, -1) == Y and buffer.to - 1 or buffer.to)
      return nil
    end
    local from = text_from + at - 1
    local size = frame.judge(text, at, self.accepts)
    self.searched = size == nil and from + 2 or from
    if size == false then return nil end
    if size then
      self.found = new_candidate(from, HEADER + size + CRC_SIZE)
      self.found.header = sub(text, at, at + HEADER - 1)
      return self.found
    end
  end
end

-- One register runs over the bytes, for all waiting candidates together (see crc.advance).  It runs when something asks
-- for it, and before its bytes are moved to the pieces: to run over each packet's bytes alone costs more.  It stays in
-- front of the sent CRC of each that waits.
function Stream:run_register(to)
  local buffer = self.buffer
  local text_from = buffer.text_from
  self.register = self.crc.update(self.register, buffer.text, self.run_to - text_from + 1, to - text_from)
  self.run_to = to
end

-- The candidate's header has come: it waits for its end.
-- candidate.difference is between the common register and one of its own, where the common one had run to.
function Stream:wait_for(candidate)
  local crc, from = self.crc, candidate.from
  if not self.heap[1] then
    self.register, self.run_to = crc.INITIAL, from
  elseif self.run_to < from then
    self:run_register(from)
  end
  local text_from = self.buffer.text_from
  local own = crc.update(crc.INITIAL, self.buffer.text, from - text_from + 1, self.run_to - text_from)
  candidate.difference, candidate.difference_at = crc.xor(self.register, own), self.run_to
  push(self.heap, candidate)
  self.last = self.last + 1
  self.queue[self.last] = candidate
  self.searched = from + 2
end

-- Whether the CRC is good, of a candidate whose end has come.
function Stream:is_good(candidate)
  local crc, buffer, payload_to = self.crc, self.buffer, candidate.to - CRC_SIZE
  self:run_register(payload_to)
  local other = crc.advance(candidate.difference, payload_to - candidate.difference_at)
  return crc.xor(self.register, other) == frame.crc(buffer.text, candidate.to - buffer.text_from)
end

-- Gives out the bytes up to `to` as one event.
function Stream:give(events, to, kind, good, missing)
  local from = self.buffer.from
  events[#events + 1] = { kind = kind, good = good, missing = missing, from = from, to = to,
    bytes = self.buffer:take(to) }
end

function Stream:skip(events, to)
  if to > self.buffer.from then self:give(events, to, "skipped") end
end

-- Gives out what lies before `limit`: the failed candidates, the earliest start first, and the bytes between.
-- over_limit  what becomes of one that reaches beyond: "drop" it, or "keep" it and all behind its start
function Stream:settle(events, limit, over_limit)
  while self.first <= self.last do
    local candidate = self.queue[self.first]
    if candidate.from >= limit then break end
    local overlapped = candidate.from < self.buffer.from
    if not overlapped and candidate.to <= limit then
      self:skip(events, candidate.from)
      local missing = candidate.missing
      if missing then
        self:give(events, candidate.to, "cut", nil, missing)
      else
        self:give(events, candidate.to, "frame", false)
      end
    elseif not overlapped and over_limit == "keep" then
      limit = candidate.from
      break
    end
    self.queue[self.first] = nil
    self.first = self.first + 1
  end
  self:skip(events, limit)
end

-- The first candidate that waits, by start, or nil.
function Stream:first_waiting()
  local queue = self.queue
  while queue[self.undecided] and queue[self.undecided].bad do self.undecided = self.undecided + 1 end
  return queue[self.undecided]
end

-- The last byte of the candidate that ends first has come.
function Stream:resolve(events)
  local candidate = pop(self.heap)
  if not self:is_good(candidate) then
    candidate.bad = true
    return
  end
  self:settle(events, candidate.from, "drop")
  self:give(events, candidate.to, "frame", true)
  self:forget()
  self.searched = candidate.to
end

-- Takes the starts and ends of candidates in the order in which their bytes came.
function Stream:walk(events)
  while true do
    local ending, starting = self.heap[1], self:find_candidate()
    if ending and ending.to <= (starting and starting.from + HEADER or self.buffer.to) then
      self:resolve(events)
    elseif starting then
      self:wait_for(starting)
    else
      break
    end
  end
end

-- Whether bytes are one frame with a good CRC, and nothing in it looks like another.
function Stream:is_frame(bytes)
  if frame.find(bytes, 1) ~= 1 then return false end
  local crc, size, length = self.crc, frame.judge(bytes, 1, self.accepts), #bytes
  return size and length == HEADER + size + CRC_SIZE and not frame.find(bytes, 3) and
    crc.update(crc.INITIAL, bytes, 1, length - CRC_SIZE) == frame.crc(bytes, length)
end

--- Takes bytes that are one good frame and no more, when nothing waits: there is nothing to search or to keep.  Most
-- frames come so, one in a packet.
-- bytes    string
-- returns  whether they were; otherwise nothing has happened, and feed() takes them
function Stream:pass(bytes)
  local buffer = self.buffer
  if buffer.from ~= buffer.to or not self:is_frame(bytes) then return false end
  self.searched = buffer.to + #bytes
  buffer:pass(self.searched)
  return true
end

--- Takes the next bytes of the stream.
-- bytes    string of any length
-- returns  array of the events that these bytes made final, in the stream's order; each byte is in one event:
--            { kind = "frame", good = true or false }  a whole frame, with a good or a bad CRC
--            { kind = "skipped" }                      bytes of no frame
--          and in each: from, to (0-based offsets in the stream, `to` is behind the last byte), bytes (string)
-- Document: "UART Stream Framing".
function Stream:feed(bytes)
  local from = self.buffer.to
  if self:pass(bytes) then
    return { { kind = "frame", good = true, from = from, to = self.buffer.to, bytes = bytes } }
  end
  local events, buffer = {}, self.buffer
  if self.heap[1] and buffer:is_long() then self:run_register(buffer.to - CRC_SIZE) end
  buffer:append(bytes)
  self:walk(events)
  local waiting = self:first_waiting()
  self:settle(events, waiting and waiting.from or self.searched, "keep")
  return events
end

--- Ends the stream; whatever waits becomes final.  Bytes fed later begin afresh.
-- returns  array of events as from feed(), and
--            { kind = "cut", missing = bytes }  a frame whose header is there and whose end never came
function Stream:finish()
  local events, to = {}, self.buffer.to
  for _, candidate in ipairs(self.heap) do
    candidate.missing, candidate.to = candidate.to - to, to
  end
  self:settle(events, to, "drop")
  self:forget()
  self.searched = to
  return events
end

--- The offset of the first byte not yet given out in an event.
function Stream:offset()
  return self.buffer.from
end

--- The frame of which nothing is decided yet, the earliest: where the capture ends here, it ends before this frame.
-- returns  its header; nil where there is none, or only a part of its header
function Stream:open_header()
  for i = self.first, self.last do
    local candidate = self.queue[i]
    if candidate.from >= self.buffer.from then return candidate.header end
  end
end

--- The bytes missing for the end of the earliest waiting candidate.
-- returns  bytes; nil when no candidate waits, or only a part of a header
function Stream:waiting()
  local waiting = self:first_waiting()
  return waiting and waiting.to - self.buffer.to
end

return M
