-- SPDX-License-Identifier: GPL-2.0-or-later
-- Framing: finds YAPP frames in bytes that also hold noise, shell text and damaged frames.
-- Pure Lua.
--
-- Each "YP" with a header behind it is a candidate.  Candidates are judged in the order of their
-- starts: the first one with a good CRC is a frame, and all that overlap it are dropped.  So a
-- frame wins over what its payload contains.  Bytes behind the start of an open candidate, whose
-- end has not come, wait for it:
--
--   0         12                              69      bytes 12 to 60 hold a good frame; it is shown
--   |YP header|  ...  |YP good frame|   ...   |       only if the CRC at 69 is bad
--
-- But a header of noise may claim 65,535 bytes.  So good frames do not wait for an open candidate
-- of more than `patience` bytes, or of `noise_patience` if its header is not plausible: that of
-- "TYPE = 12".  If a good frame comes first, that candidate is dropped.
--
-- The header decides what a candidate without a good CRC is.  A message of the catalogue is that
-- message, damaged, up to where the next one begins.  Another plausible ID is a bad frame if all
-- its bytes came and no message of the catalogue begins in them.  Everything else is noise.

local crc = require "yapp.wire.crc"
local frame = require "yapp.wire.frame"

local M = {}

local byte, sub = string.byte, string.sub

local HEADER, CRC_SIZE = frame.HEADER, frame.CRC_SIZE
local Y = byte(frame.SYNC)

-- The longest open candidates that good frames inside them wait for: 7 s of a controller's
-- messages, or two messages.
local PATIENCE, NOISE_PATIENCE = 4096, 128

-- Noise may be full of candidates.  So each byte of a stream earns credit for CREDIT bytes of CRC,
-- saved up to MAX_CREDIT.  A candidate that costs more than the credit counts as damaged.
-- Candidates of 32 to 63 bytes have one credit, those of 64 to 127 bytes another, and so on: large
-- ones cannot spend the credit of small ones.
local CREDIT = 2
local MAX_CREDIT = 4 * frame.LARGEST

local Framer = {}
Framer.__index = Framer

--- Make the framer of a stream.
-- size_of   function(id) -> payload size of the catalogue's message, nil for an unknown ID; and its
--           smallest size, nil if that is the same
-- patience  bytes: the longest open candidate, plausible or not, that good frames inside it wait
--           for; nil for the usual ones
-- Document: "UART Stream Framing".
function M.new(size_of, patience)
  local self = setmetatable({
    size_of = size_of,
    patience = patience or PATIENCE,
    noise_patience = patience or NOISE_PATIENCE,
    spent = {},    -- [logarithm of a candidate's length] = bytes that CRCs were computed over
    text = "",     -- the latest bytes
    text_from = 0, -- their offset in the stream
    to = 0,        -- the end of the stream so far; serial.streams also reads `to` and `from`
    from = 0,      -- the first byte that is in no finding yet
    searched = 0,  -- every candidate that begins before this is known
    found = false, -- the open candidate that the search waited at last
  }, Framer)
  self:forget()
  return self
end

-- Drop all candidates.
function Framer:forget()
  self.candidates = {} -- those that failed and those that are open, by start
  self.first, self.last = 1, 0
  self.first_open = 1  -- in `candidates`: all before it have failed
  self.open_by_end = {} -- [offset] = the last open one that ends there
  self.known = {}       -- the starts of those that are messages of the catalogue
end

-- Return the candidate of a "YP", nil if its header has not come.
-- index  in the text, 1-based
local function candidate_at(self, index)
  local id, size, reserved = frame.parse(self.text, index)
  if not id then return nil end
  local known, smallest = self.size_of(id)
  local fits = not known or size <= known and size >= (smallest or known)
  local is_plausible = reserved == 0 and id <= frame.MAX_ID and fits
  local from = self.text_from + index - 1
  return {
    from = from,
    to = from + HEADER + size + CRC_SIZE,
    is_plausible = is_plausible,
    is_known = is_plausible and known ~= nil,
    has_failed = false, -- whether its CRC is bad; false while it is open
  }
end

-- Return the next candidate whose header has come, nil where none has.
function Framer:find()
  if self.found and self.found.from == self.searched then return self.found end
  local index = frame.find(self.text, self.searched - self.text_from + 1)
  if not index then
    local is_begun = self.to > self.searched and byte(self.text, -1) == Y
    self.searched = is_begun and self.to - 1 or self.to
    return nil
  end
  self.searched = self.text_from + index - 1
  return candidate_at(self, index)
end

-- Whether the CRC of a candidate is good.
function Framer:is_good(candidate)
  local length = candidate.to - candidate.from
  local class, earned = math.floor(math.log(length, 2)), MAX_CREDIT + CREDIT * self.to
  local spent = math.max(self.spent[class] or 0, earned - MAX_CREDIT) + length
  if spent > earned then return false end
  self.spent[class] = spent
  local index, to = candidate.from - self.text_from + 1, candidate.to - self.text_from
  return crc.update(crc.INITIAL, self.text, index, to - CRC_SIZE) == frame.crc(self.text, to)
end

-- Append the bytes up to an offset as a finding.
function Framer:give(to, status, missing)
  local from, offset = self.from, self.from - self.text_from
  self.from = to
  table.insert(self.findings, {
    status = status,
    missing = missing,
    from = from,
    to = to,
    bytes = sub(self.text, offset + 1, offset + to - from),
  })
end

-- Skip the bytes up to an offset.  They go to the latest finding if it is of skipped bytes, too.
function Framer:skip(to)
  if to <= self.from then return end
  local latest = self.findings[#self.findings]
  if not (latest and latest.status == "skipped") then return self:give(to, "skipped") end
  latest.bytes = latest.bytes .. sub(self.text, self.from - self.text_from + 1, to - self.text_from)
  latest.to, self.from = to, to
end

-- Return what a candidate without a good CRC is, if nothing before `limit` is open.
-- behind   what begins at the limit: "open", "good" (a frame) or "end" (nothing)
-- returns  "bad" or "incomplete" and its end; nil for noise; "open" if that is not decided yet
local function fate_of(self, candidate, limit, behind)
  if candidate.from < self.from or not candidate.is_plausible then return nil end
  local stop = math.min(limit, self.known[candidate.next_known] or limit)
  if candidate.to <= stop then return "bad", candidate.to end
  if stop == limit and behind == "open" then return "open" end
  if candidate.is_known or stop == limit and behind == "end" then return "incomplete", stop end
end

-- Append what lies before `limit` as findings: the damaged frames, the earliest start first, and
-- the bytes between them.
function Framer:settle(limit, behind)
  while self.first <= self.last and self.candidates[self.first].from < limit do
    local candidate = self.candidates[self.first]
    local status, stop = fate_of(self, candidate, limit, behind)
    if status == "open" then
      limit = candidate.from
      break
    end
    if status then
      self:skip(candidate.from)
      self:give(stop, status, candidate.to > stop and candidate.to - stop or nil)
    end
    self.candidates[self.first] = nil
    self.first = self.first + 1
  end
  self:skip(limit)
end

-- Append a candidate as a finding if its CRC is good; return whether it is good.
function Framer:accept(candidate)
  if not self:is_good(candidate) then
    candidate.has_failed = true
    return false
  end
  self:settle(candidate.from, "good")
  self:give(candidate.to, "good")
  if self.last > 0 then self:forget() end
  self.searched = candidate.to
  return true
end

-- Keep a candidate that failed or is open.  It gets
--   next_known  index in `known`: the first one behind it
--   same_end    another open candidate that ends where this one does, or nil
function Framer:keep(candidate)
  self.last = self.last + 1
  self.candidates[self.last] = candidate
  if candidate.is_known then self.known[#self.known + 1] = candidate.from end
  candidate.next_known = #self.known + 1
  if not candidate.has_failed then
    candidate.same_end = self.open_by_end[candidate.to]
    self.open_by_end[candidate.to] = candidate
  end
end

local function by_start(a, b) return a.from < b.from end

-- Judge the open candidates whose end has come.
-- before  the end of the stream before these bytes came
function Framer:close(before)
  if not next(self.open_by_end) then return end
  local due = {}
  for to = before + 1, self.to do
    local candidate = self.open_by_end[to]
    self.open_by_end[to] = nil
    while candidate do
      due[#due + 1], candidate = candidate, candidate.same_end
    end
  end
  table.sort(due, by_start)
  for _, candidate in ipairs(due) do
    if self:accept(candidate) then return end -- it overlaps the others
  end
end

-- Judge the candidates that begin in bytes that have not been searched.
-- is_end  whether no more bytes come
function Framer:search(is_end)
  local candidate = self:find()
  while candidate do
    local is_open, length = candidate.to > self.to, candidate.to - candidate.from
    local patience = candidate.is_plausible and self.patience or self.noise_patience
    if is_open and not is_end and length <= patience then
      self.found = candidate
      return
    end
    if is_open or not self:accept(candidate) then
      self:keep(candidate)
      self.searched = candidate.from + #frame.SYNC
    end
    candidate = self:find()
  end
end

-- Return the first open candidate that is kept, by start, or nil.
function Framer:first_waiting()
  local candidate = self.candidates[self.first_open]
  while candidate and candidate.has_failed do
    self.first_open = self.first_open + 1
    candidate = self.candidates[self.first_open]
  end
  return candidate
end

--- Take the next bytes of the stream.
-- bytes     string of any length
-- is_end    whether the stream ends behind them.  Then all findings become final: a frame whose end
--           has not come is "incomplete", too.  Later bytes begin a new stream
-- findings  list that the new findings are appended to; nil for a new one
-- returns  the list, with the findings that are final now, in the stream's order; each byte of the
--          stream is in one finding: {
--            status   "good"; "bad" (CRC); "incomplete", a frame that ends where the next begins;
--                     "skipped", bytes of no frame
--            missing  number of bytes, of an incomplete frame
--            from     offset in the stream
--            to       offset behind the last byte
--            bytes    string }
-- Document: "UART Stream Framing".
function Framer:add(bytes, is_end, findings)
  local before = self.to
  self.findings = findings or {}
  if self.from > self.text_from then
    self.text, self.text_from = sub(self.text, self.from - self.text_from + 1), self.from
  end
  self.text, self.to = self.text .. bytes, before + #bytes
  self:close(before)
  self:search(is_end)
  if is_end then
    self:settle(self.to, "end")
    self:forget()
    self.searched = self.to
  else
    local waiting = self:first_waiting()
    self:settle(waiting and waiting.from or self.searched, "open")
    if self.last > 0 and self.first > self.last then self:forget() end
  end
  return self.findings
end

--- Return the bytes that are in no finding yet.
function Framer:pending()
  return sub(self.text, self.from - self.text_from + 1)
end

--- Return whether a frame is not final yet: a capture that ends here ends before it.  A part of a
-- header is none, nor is what is more likely noise.
-- returns  boolean, and the number of bytes to come, nil if all came
function Framer:open_frame()
  for i = self.first, self.last + 1 do
    local candidate = self.candidates[i] or self:find()
    if candidate and candidate.is_plausible and candidate.from >= self.from then
      local missing = candidate.to - self.to
      return true, missing > 0 and missing or nil
    end
  end
  return false
end

return M
