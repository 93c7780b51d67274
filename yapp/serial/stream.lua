-- SPDX-License-Identifier: GPL-2.0-or-later
-- Stream framing: finds YAPP frames in bytes that also hold noise, shell text and damaged frames.
-- Pure Lua.
--
-- Each "YP" with a header behind it is a candidate.  Candidates may overlap; they are judged in the
-- order of their ends, as if the bytes came one at a time.  A good CRC proves every overlapping
-- candidate wrong, whatever its header says.  Of those without one the header decides: one of the
-- catalogue's messages is that message, damaged, up to where the next begins; one of an unknown ID
-- of the document's is a frame where it is whole and none of the others lie in it; any other is
-- noise. They wait until nothing good can overlap them any more.

local crc = require("yapp.wire.crc")
local frame = require("yapp.wire.frame")

local M = {}

local byte, sub, min = string.byte, string.sub, math.min

local HEADER, CRC_SIZE = frame.HEADER, frame.CRC_SIZE
local Y = byte(frame.SYNC)

-- Noise may be nothing but candidates.  So each byte brings a credit of bytes that a CRC may be
-- worked out over, which is saved up; a candidate that it does not suffice for counts as damaged.
local CREDIT = 4
local MAX_CREDIT = 16 * frame.LARGEST

local Stream = {}
Stream.__index = Stream

--- A stream of bytes, empty yet.
-- size_of  function(id) -> payload size of the catalogue's message, nil for an unknown ID, and the
--          smallest that it may have, nil for the same
-- returns  the stream; feed() it.  Document: "UART Stream Framing".
function M.new(size_of)
  local self = setmetatable({
    size_of = size_of,
    credit = MAX_CREDIT,
    text = "", text_from = 0, to = 0, -- what has come of late, its place in the stream, and its end
    from = 0,                         -- the first byte that is not given out
    searched = 0,                     -- no candidate begins before this that is not known
    found = nil,                      -- the candidate that begins there
  }, Stream)
  self:forget()
  return self
end

-- No candidate is left of those that wait or have failed.
function Stream:forget()
  self.by_start, self.first, self.last = {}, 1, 0
  self.undecided = 1 -- in by_start: none before it waits
  self.by_end, self.ending, self.waiting_count = {}, 1, 0
  self.known = {} -- where those begin that are messages of the catalogue
end

-- The next candidate whose header has come; nil where none has.  The same one until it waits.
function Stream:find()
  if self.found then return self.found end
  local at = frame.find(self.text, self.searched - self.text_from + 1)
  if not at then
    local is_begun = self.to > self.searched and byte(self.text, -1) == Y
    self.searched = is_begun and self.to - 1 or self.to
    return nil
  end
  local from = self.text_from + at - 1
  self.searched = from
  local id, size, reserved = frame.parse(self.text, at)
  if not id then return nil end
  local known, smallest = self.size_of(id)
  local fits = not known or size <= known and size >= (smallest or known)
  local is_plausible = reserved == 0 and id <= frame.MAX_ID and fits
  self.found = {
    from = from,
    to = from + HEADER + size + CRC_SIZE,
    is_plausible = is_plausible,
    is_known = is_plausible and known ~= nil,
    next_known = 0,     -- in self.known, the first one behind it
    has_failed = false, -- its CRC is bad; until then it waits
  }
  return self.found
end

-- The candidate that was found waits for its end.
function Stream:wait_for(candidate)
  self.found, self.searched = nil, candidate.from + #frame.SYNC
  self.last = self.last + 1
  self.by_start[self.last] = candidate
  if candidate.is_known then self.known[#self.known + 1] = candidate.from end
  candidate.next_known = #self.known + 1
  local by_end, at = self.by_end, self.ending + self.waiting_count
  while at > self.ending and by_end[at - 1].to > candidate.to do
    by_end[at], at = by_end[at - 1], at - 1
  end
  by_end[at], self.waiting_count = candidate, self.waiting_count + 1
end

-- Whether the CRC is good, of a candidate whose end has come.
function Stream:is_good(candidate)
  local length = candidate.to - candidate.from
  if length > self.credit then return false end
  self.credit = self.credit - length
  local at, to = candidate.from - self.text_from + 1, candidate.to - self.text_from
  return crc.update(crc.INITIAL, self.text, at, to - CRC_SIZE) == frame.crc(self.text, to)
end

-- Gives out the bytes up to `to` as an event.
function Stream:give(events, to, kind, good, missing)
  local from, at = self.from, self.from - self.text_from
  self.from = to
  events[#events + 1] = {
    kind = kind,
    good = good,
    missing = missing,
    from = from,
    to = to,
    bytes = sub(self.text, at + 1, at + to - from),
  }
end

function Stream:skip(events, to)
  if to > self.from then self:give(events, to, "skipped") end
end

-- What a candidate without a good CRC turns out to be, where nothing before `limit` is open any
-- more.
-- how      what is behind the limit: "open", what may yet prove good; "good", a frame; "end",
--          nothing
-- returns  "frame" or "cut", and where it ends; nil where its bytes are of no frame; "open"
local function fate_of(self, candidate, limit, how)
  if candidate.from < self.from or not candidate.is_plausible then return nil end
  local stop = min(limit, self.known[candidate.next_known] or limit)
  if candidate.to <= stop then return "frame", candidate.to end
  if stop == limit and how == "open" then return "open" end
  if candidate.is_known or stop == limit and how == "end" then return "cut", stop end
end

-- Gives out what lies before `limit`: the damaged frames, the earliest start first, and the bytes
-- between.
function Stream:settle(events, limit, how)
  while self.first <= self.last and self.by_start[self.first].from < limit do
    local candidate = self.by_start[self.first]
    local kind, stop = fate_of(self, candidate, limit, how)
    if kind == "open" then
      limit = candidate.from
      break
    end
    if kind then
      self:skip(events, candidate.from)
      self:give(events, stop, kind, false, kind == "cut" and candidate.to - stop or nil)
    end
    self.by_start[self.first] = nil
    self.first = self.first + 1
  end
  self:skip(events, limit)
end

-- The last byte of the candidate that ends first has come.
function Stream:resolve(events)
  local candidate = self.by_end[self.ending]
  self.by_end[self.ending] = nil
  self.ending, self.waiting_count = self.ending + 1, self.waiting_count - 1
  if not self:is_good(candidate) then
    candidate.has_failed = true
    return
  end
  self:settle(events, candidate.from, "good")
  self:give(events, candidate.to, "frame", true)
  self:forget()
  self.found, self.searched = nil, candidate.to
end

-- The first candidate that waits, by start, or nil.
function Stream:first_waiting()
  local candidate = self.by_start[self.undecided]
  while candidate and candidate.has_failed do
    self.undecided = self.undecided + 1
    candidate = self.by_start[self.undecided]
  end
  return candidate
end

--- Takes the next bytes of the stream.
-- bytes    string of any length
-- returns  array of the events that these bytes made final, in the stream's order; each byte is in
--          one event:
--            { kind = "frame", good = true or false }  a whole frame, with a good or a bad CRC
--            { kind = "cut", missing = bytes }  a frame that ends where the next begins
--            { kind = "skipped" }               bytes of no frame
--          and in each: from, to (0-based offsets in the stream, `to` is behind the last byte),
--          bytes (string)
-- Document: "UART Stream Framing".
function Stream:feed(bytes)
  local events = {}
  if self.from > self.text_from then
    self.text, self.text_from = sub(self.text, self.from - self.text_from + 1), self.from
  end
  self.text, self.to = self.text .. bytes, self.to + #bytes
  self.credit = min(self.credit + CREDIT * #bytes, MAX_CREDIT)
  while true do -- the starts and ends of candidates in the order in which their bytes came
    local starting, ending = self:find(), self.by_end[self.ending]
    if ending and ending.to <= (starting and starting.from + HEADER or self.to) then
      self:resolve(events)
    elseif starting then
      self:wait_for(starting)
    else
      break
    end
  end
  local waiting = self:first_waiting()
  self:settle(events, waiting and waiting.from or self.searched, "open")
  if self.last > 0 and self.first > self.last then self:forget() end
  return events
end

--- Ends the stream; whatever waits becomes final.  Bytes fed later begin afresh.
-- returns  array of events as from feed(); a frame whose header is there and whose end never came
--          is "cut" too
function Stream:finish()
  local events = {}
  self:settle(events, self.to, "end")
  self:forget()
  self.searched = self.to
  return events
end

--- The offset of the first byte not yet given out in an event.
function Stream:offset()
  return self.from
end

--- The frame of which nothing is decided yet, the earliest: where the capture ends here, it ends
-- before this frame.
-- returns  its header; nil where there is none, or only a part of its header, or where it is more
--          likely noise
function Stream:open_header()
  for i = self.first, self.last do
    local candidate = self.by_start[i]
    if candidate.is_plausible and candidate.from >= self.from then
      local at = candidate.from - self.text_from
      return sub(self.text, at + 1, at + HEADER)
    end
  end
end

--- The bytes missing for the end of the earliest waiting candidate.
-- returns  bytes; nil where none waits, or only a part of a header, or what is more likely noise
function Stream:waiting()
  local candidate = self:first_waiting()
  return candidate and candidate.is_plausible and candidate.to - self.to or nil
end

return M
