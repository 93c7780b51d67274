-- SPDX-License-Identifier: GPL-2.0-or-later
-- Framing: finds YAPP frames in bytes that also hold noise, shell text and damaged frames.
-- Pure Lua.
--
-- Each "YP" with a header behind it is a candidate.  Candidates are judged in the order of their
-- starts: the first one with a good CRC is a frame, and all that overlap it are dropped.  So a
-- frame wins over others in its payload.  Bytes behind the start of an open candidate, whose
-- end has not come, wait for it:
--
--   0         12                              69      bytes 12 to 60 hold a good frame; it is shown
--   |YP header|  .  |YP good frame|   ...   |       only if the CRC at 69 is bad
--
-- But a header of noise may claim 65,535 bytes.  So good frames do not wait for an open candidate
-- of more than `patience` bytes, or of `noise_patience` if its header is not plausible: that of
-- "TYPE = 12".  If a good frame comes first, that candidate is dropped.
--
-- The header decides on a candidate without a good CRC.  A message of the catalogue is that
-- message, damaged, up to where the next one begins.  Another plausible ID is a bad frame if all
-- its bytes came and no message of the catalogue begins in them.  Everything else is noise.
--
-- A serial server in telnet mode (RFC 854) sends each byte 0xFF twice.  If that makes a CRC good,
-- the stream is telnet from there on, and may have commands (RFC 2217) inside a frame:
--
--   59 50 00 00 .. FF FF 12 .. CRC   49 bytes in the stream, a frame of 48

local crc = require "yapp.wire.crc"
local frame = require "yapp.wire.frame"
local memo = require "yapp.base.memo"

local M = {}

local byte, find, sub = string.byte, string.find, string.sub

local HEADER, CRC_SIZE = frame.HEADER, frame.CRC_SIZE
local Y = byte(frame.SYNC)
local IAC = "\255" -- begins a command of telnet
local TWICE = IAC .. IAC -- a byte 0xFF in telnet
local SUBNEGOTIATION, SUBNEGOTIATION_END = 250, IAC .. "\240" -- commands; others above have 3 bytes
local MAX_SUBNEGOTIATION = 64 -- bytes: a damaged byte may begin one that does not end

-- The longest open candidates that good frames inside them wait for: 7 s of a controller's
-- messages, or two messages.
local PATIENCE, NOISE_PATIENCE = 4096, 128

-- Noise may be full of candidates.  So each byte of a stream earns credit for CREDIT bytes of CRC,
-- saved up to MAX_CREDIT.  A candidate that costs more than the credit counts as damaged.
-- Candidates of 32 to 63 bytes have one credit, those of 64 to 127 bytes another, and so on: large
-- ones cannot spend the credit of small ones.
local CREDIT = 2
local MAX_CREDIT = 4 * frame.LARGEST
local CLASSES = memo(function(length) return math.floor(math.log(length, 2)) end)

local SYNC_REGISTER = crc.of(frame.SYNC) -- behind the first bytes of each frame

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
    telnet = false, -- "may" be telnet, see Framer:expect_telnet, or "is"
    spent = {},    -- [logarithm of a candidate's length] = bytes that CRCs were computed over
    text = "",     -- the latest bytes
    text_from = 0, -- their offset in the stream
    to = 0,        -- the end of the stream so far; serial.streams also reads `to` and `from`
    from = 0,      -- the first byte that is in no finding yet
    searched = 0,  -- every candidate that begins before this is known
    is_ending = false, -- true if no more bytes come
    found = false, -- the open candidate that the search waited at last
  }, Framer)
  self:drop_candidates()
  return self
end

-- Drop all candidates.
function Framer:drop_candidates()
  self.candidates = {} -- those that failed and those that are open, by start
  self.first, self.last = 1, 0
  self.first_open = 1  -- in `candidates`: all before it have failed
  self.open_by_end = {} -- [offset] = the last open one that ends there
  self.known = {}       -- the starts of those that are messages of the catalogue
end

--- Expect that each byte 0xFF may come twice.
function Framer:expect_telnet()
  self.telnet = self.telnet or "may"
end

-- Return the index behind a command of telnet, nil if its end has not come.
-- index  of its 0xFF
local function find_command_end(text, index)
  local command = byte(text, index + 1)
  if command == SUBNEGOTIATION then
    local _, last = find(text, SUBNEGOTIATION_END, index + 2, true)
    if last and last - index < MAX_SUBNEGOTIATION then return last + 1 end
    if #text - index < MAX_SUBNEGOTIATION then return nil end
  end
  local stop = command and index + (command > SUBNEGOTIATION and 3 or 2)
  return stop and stop <= #text + 1 and stop
end

-- Return bytes of telnet as they were before it: a doubled 0xFF once, and no commands.
-- index, count  of the first one in the text; how many are wanted
-- returns  them, and how many bytes of the text they are; or nil, and how many are to come at least
local function undouble(text, index, count)
  local parts, start = {}, index
  while count > 0 do
    local mark = find(text, IAC, index, true)
    local part = sub(text, index, math.min((mark or #text + 1) - 1, index + count - 1))
    count, index = count - #part, index + #part
    if count > 0 then
      if not mark or mark == #text then return nil, count end
      if byte(text, mark + 1) == 255 then
        part, count, index = part .. IAC, count - 1, mark + 2
      else
        index = find_command_end(text, mark)
        if not index then return nil, count end
      end
    end
    parts[#parts + 1] = part
  end
  return table.concat(parts), index - start
end

-- Return whether a header may be that of a message, its size, and whether its ID is known.
local function read_header(self, text, index)
  local id, size, reserved = frame.parse(text, index)
  if not id or reserved ~= 0 or id > frame.MAX_ID then return false, size end
  local known, smallest = self.size_of(id)
  local fits = not known or size <= known and size >= (smallest or known)
  return fits, size, known ~= nil
end

-- Return the index of the next bytes that telnet may have changed, nil for none.
local function find_mark(self, index)
  if not self.telnet then return nil end
  return find(self.text, self.telnet == "is" and IAC or TWICE, index, true)
end

-- Return the candidate of a "YP", nil if its header has not come.
-- index  in the text, 1-based
local function candidate_at(self, index)
  local is_plausible, size, is_known = read_header(self, self.text, index)
  local mark = find_mark(self, index)
  if mark and mark < index + HEADER and (self.telnet == "is" or not is_plausible) then
    local header = undouble(self.text, index, HEADER)
    if not (header or self.is_ending) then return nil end
    local is_better, its_size, its_known = read_header(self, header or "", 1)
    if is_better or self.telnet == "is" then
      is_plausible, size, is_known = is_better, its_size, its_known
    end
  end
  if not size then return nil end
  local from, length = self.text_from + index - 1, HEADER + size + CRC_SIZE
  return {
    from = from,
    to = from + length,
    length = length, -- before telnet
    bytes = nil,     -- of a frame in telnet: those before it
    is_plausible = is_plausible,
    is_known = is_plausible and is_known,
    has_failed = false, -- true if its CRC is bad; false while it is open
  }
end

-- Return the next candidate whose header has come, nil where none has.
function Framer:find_candidate()
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

-- Check the CRC of a frame; return whether it is good.
-- text, index  its bytes, from there on; length = of it
function Framer:check_crc(text, index, length)
  local class, earned = CLASSES[length], CREDIT * self.to
  local spent = math.max(self.spent[class] or 0, earned) + length
  if spent > earned + MAX_CREDIT then return false end
  self.spent[class] = spent
  local to = index + length - 1
  local sum = crc.update(SYNC_REGISTER, text, index + #frame.SYNC, to - CRC_SIZE)
  return sum == frame.crc(text, to)
end

-- Return whether a candidate is a frame of telnet.  If more bytes have to come, its end moves.
function Framer:check_telnet(candidate, index)
  local bytes, count = undouble(self.text, index, candidate.length)
  local is_sure = self.telnet == "is"
  if bytes and self:check_crc(bytes, 1, candidate.length) then
    candidate.to, candidate.bytes, self.telnet = candidate.from + count, bytes, "is"
    return true
  end
  if bytes and is_sure then
    candidate.to = candidate.from + count
  elseif not bytes and not self.is_ending then
    candidate.to = self.to + count
  end
  return false
end

-- Return whether a candidate whose end has come is a frame; the end of one of telnet may move.
function Framer:judge(candidate)
  local index, is_sure = candidate.from - self.text_from + 1, self.telnet == "is"
  if not self.telnet then return self:check_crc(self.text, index, candidate.length) end
  local mark = find_mark(self, index)
  local may_be_telnet = mark and mark < index + candidate.length
  if not (may_be_telnet and is_sure) then
    candidate.to = candidate.from + candidate.length
    if self:check_crc(self.text, index, candidate.length) then return true end
  end
  return may_be_telnet and self:check_telnet(candidate, index)
end

-- Expect no more bytes of telnet, as the stream ends.
function Framer:end_telnet()
  for i = self.first, self.last + 1 do
    local candidate = self.candidates[i] or self.found
    if candidate then candidate.to = candidate.from + candidate.length end
  end
end

-- Append the bytes up to an offset as a finding.
-- bytes  nil for those in the text
function Framer:add_finding(to, status, missing, bytes)
  local from, offset = self.from, self.from - self.text_from
  self.from = to
  self.findings[#self.findings + 1] = {
    status = status,
    missing = missing,
    from = from,
    to = to,
    is_telnet = bytes and true,
    bytes = bytes or sub(self.text, offset + 1, offset + to - from),
  }
end

-- Skip the bytes up to an offset.  They go to the latest finding if it is of skipped bytes, too.
function Framer:skip(to)
  if to <= self.from then return end
  local latest = self.findings[#self.findings]
  if not (latest and latest.status == "skipped") then return self:add_finding(to, "skipped") end
  latest.bytes = latest.bytes .. sub(self.text, self.from - self.text_from + 1, to - self.text_from)
  latest.to, self.from = to, to
end

-- Classify a candidate without a good CRC, if nothing before `limit` is open.
-- behind   what begins at the limit: "open", "good" (a frame) or "end" (nothing)
-- returns  "bad" or "incomplete" and its end; nil for noise; "open" if that is not decided yet
local function class_of(self, candidate, limit, behind)
  if candidate.from < self.from or not candidate.is_plausible then return nil end
  local stop = math.min(limit, self.known[candidate.next_known] or limit)
  if candidate.to <= stop then return "bad", candidate.to end
  if stop == limit and behind == "open" then return "open" end
  if candidate.is_known or stop == limit and behind == "end" then return "incomplete", stop end
end

-- Append the bytes before `limit` as findings: the damaged frames, the earliest start first, and
-- the bytes between them.
function Framer:settle(limit, behind)
  while self.first <= self.last and self.candidates[self.first].from < limit do
    local candidate = self.candidates[self.first]
    local status, stop = class_of(self, candidate, limit, behind)
    if status == "open" then
      limit = candidate.from
      break
    end
    if status then
      self:skip(candidate.from)
      self:add_finding(stop, status, candidate.to > stop and candidate.to - stop or nil)
    end
    self.candidates[self.first] = nil
    self.first = self.first + 1
  end
  self:skip(limit)
end

-- Append a candidate as a finding if its CRC is good; return whether it is good.
function Framer:accept(candidate)
  if not self:judge(candidate) then
    candidate.has_failed = candidate.to <= self.to -- else its end is still to come
    return false
  end
  self:settle(candidate.from, "good")
  self:add_finding(candidate.to, "good", nil, candidate.bytes)
  if self.last > 0 then self:drop_candidates() end
  self.searched = candidate.to
  return true
end

-- Judge an open candidate when its end comes.  It gets
--   same_end    another open candidate that ends where this one does, or nil
function Framer:expect_end(candidate)
  candidate.same_end = self.open_by_end[candidate.to]
  self.open_by_end[candidate.to] = candidate
end

-- Keep a candidate that failed or is open.  It gets
--   next_known  index in `known`: the first one behind it
function Framer:keep_candidate(candidate)
  self.last = self.last + 1
  self.candidates[self.last] = candidate
  if candidate.is_known then self.known[#self.known + 1] = candidate.from end
  candidate.next_known = #self.known + 1
  if not candidate.has_failed then self:expect_end(candidate) end
end

local function by_start(a, b) return a.from < b.from end

-- Judge the open candidates whose end has come.
-- before  the end of the stream before these bytes came
function Framer:judge_ended(before)
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
    if not candidate.has_failed then self:expect_end(candidate) end
  end
end

-- Judge the candidates that begin in bytes that have not been searched.
function Framer:search()
  local candidate = self:find_candidate()
  while candidate do
    local patience = candidate.is_plausible and self.patience or self.noise_patience
    local is_frame = candidate.to <= self.to and self:accept(candidate)
    local is_open = candidate.to > self.to
    if is_open and not self.is_ending and candidate.length <= patience then
      self.found = candidate
      return
    end
    if not is_frame then
      self:keep_candidate(candidate)
      self.searched = candidate.from + #frame.SYNC
    end
    candidate = self:find_candidate()
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

--- Add the next bytes of the stream.
-- bytes     string of any length
-- is_end    true if the stream ends behind them.  Then all findings become final: a frame whose end
--           has not come is "incomplete", too.  Later bytes begin a new stream
-- findings  list that the new findings are appended to; nil for a new one
-- returns  the list, with the findings that are final now, in the stream's order; each byte of the
--          stream is in one finding: {
--            status   "good"; "bad" (CRC); "incomplete", a frame that ends where the next begins;
--                     "skipped", bytes of no frame
--            missing  number of bytes, of an incomplete frame
--            from     offset in the stream
--            to       offset behind the last byte
--            is_telnet  true if its bytes are not those of the stream, but as before telnet
--            bytes    string }
-- Document: "UART Stream Framing".
function Framer:add(bytes, is_end, findings)
  local before = self.to
  self.findings, self.is_ending = findings or {}, is_end
  if self.from > self.text_from then
    self.text, self.text_from = sub(self.text, self.from - self.text_from + 1), self.from
  end
  self.text, self.to = self.text .. bytes, before + #bytes
  if is_end and self.telnet == "may" then self:end_telnet() end
  self:judge_ended(before)
  self:search()
  if is_end then
    self:settle(self.to, "end")
    if self.last > 0 then self:drop_candidates() end
    self.searched = self.to
  else
    local waiting = self:first_waiting()
    self:settle(waiting and waiting.from or self.searched, "open")
    if self.last > 0 and self.first > self.last then self:drop_candidates() end
  end
  return self.findings
end

-- Return the first candidate in bytes of no finding yet that has a quality, nil for none.
-- quality  "is_known" or "is_plausible"
local function first_with(self, quality)
  for i = self.first, self.last + 1 do
    local candidate = self.candidates[i] or self:find_candidate()
    if candidate and candidate[quality] and candidate.from >= self.from then return candidate end
  end
end

--- Return whether bytes in no finding yet begin with the header of a message of the catalogue.
function Framer:has_known()
  return first_with(self, "is_known") ~= nil
end

--- Return the bytes that are in no finding yet.
function Framer:pending()
  return sub(self.text, self.from - self.text_from + 1)
end

--- Return whether a frame is not final yet: a capture that ends here ends before it.  A part of a
-- header is none, nor are bytes that are more likely noise.
-- returns  boolean, and the number of bytes to come, nil if all came
function Framer:open_frame()
  local candidate = first_with(self, "is_plausible")
  if not candidate then return false end
  local missing = candidate.to - self.to
  return true, missing > 0 and missing or nil
end

return M
