-- SPDX-License-Identifier: GPL-2.0-or-later
-- Framing: finds YAPP frames in bytes that also hold noise, shell text and damaged frames.
-- Pure Lua.
--
-- Each "YP" with a header behind it is a candidate.  Candidates are judged in the order of their
-- starts: the first one with a good CRC is a frame, and all that overlap it are dropped.  So a
-- frame wins over others in its payload.  The bytes behind an open candidate, whose end has not
-- come, wait for it:
--
--   0         12                              69      bytes 12 to 60 hold a good frame; it is shown
--   |YP header|  .  |YP good frame|   ...   |       only if the CRC at 69 is bad
--
-- But a header of noise may claim 65,535 bytes.  A candidate that claims more than the stream waits
-- for is a frame only if all its bytes are there at once; else it is noise.
--
-- The header decides on a candidate without a good CRC.  A message of the catalogue is that
-- message, damaged, up to where the next one begins.  Another plausible ID is a bad frame if all
-- its bytes came and no message of the catalogue begins in them.  Everything else is noise.

local crc = require "yapp.wire.crc"
local frame = require "yapp.wire.frame"
local input = require "yapp.base.input"

local Framer = {}
Framer.__index = Framer

local byte, sub = string.byte, string.sub

local HEADER, CRC_SIZE = frame.HEADER, frame.CRC_SIZE
local Y = byte(frame.SYNC)

-- Bytes that the stream waits for: all of a message of the catalogue; of another plausible header
-- as many as a controller sends in 7 s; of noise, such as "TYPE = 12", two messages.
local PATIENCE, NOISE_PATIENCE = 4096, 128

-- Noise may be full of candidates above PATIENCE.  Their CRCs are computed over at most this many
-- bytes for each byte of the stream; those beyond that are noise.
local MAX_WORK = 2

local SYNC_REGISTER = crc.of(frame.SYNC) -- behind the first bytes of each frame

--- Make the framer of a stream.
-- size_of  function(id) -> payload size of the catalogue's message, nil for an unknown ID; and
--          its smallest size, nil if that is the same
-- Document: "UART Stream Framing".
function Framer.new(size_of)
  return setmetatable({
    size_of = size_of,
    text = "",     -- the latest bytes
    text_from = 0, -- their offset in the stream
    to = 0,        -- the end of the stream so far
    from = 0,      -- the first byte that is in no finding yet
    searched = 0,  -- every candidate that begins before this is judged
    work = 0,      -- bytes that the CRCs of candidates above PATIENCE were computed over
    failed = {},   -- plausible ones without a good CRC that are not decided on, by start
    open = false,  -- the one that the stream waits for
    findings = {},
  }, Framer)
end

-- Candidates --------------------------------------------------------------------------------------

-- Return the candidate of a "YP", nil if its header has not come.
-- index  in the text
local function candidate_at(self, index)
  local id, size, reserved = frame.parse(self.text, index)
  if not id then return nil end
  local known, smallest = self.size_of(id)
  local fits = not known or size <= known and size >= (smallest or known)
  local is_plausible = fits and reserved == 0 and id <= input.MAX_ID
  local from = self.text_from + index - 1
  return {
    from = from,
    to = from + HEADER + size + CRC_SIZE,
    is_plausible = is_plausible,
    is_known = is_plausible and known ~= nil,
  }
end

-- Return whether the stream waits for the end of a candidate.
local function may_wait(candidate)
  local patience = candidate.is_plausible and PATIENCE or NOISE_PATIENCE
  return candidate.is_known or candidate.to - candidate.from <= patience
end

-- Return whether the CRC of a candidate is good; all its bytes have come.
-- index  in the text
local function is_good(self, candidate, index)
  local length = candidate.to - candidate.from
  if length > PATIENCE then
    if self.work + length > MAX_WORK * (self.to + frame.LARGEST) then
      candidate.is_plausible = false
      return false
    end
    self.work = self.work + length
  end
  local text, last = self.text, index + length - 1
  local sum = crc.update(SYNC_REGISTER, text, index + #frame.SYNC, last - CRC_SIZE)
  return sum == frame.crc(text, last)
end

-- Findings ----------------------------------------------------------------------------------------

-- Append the bytes up to an offset as a finding.
local function add_finding(self, to, status, missing)
  local from = self.from
  self.from = to
  self.findings[#self.findings + 1] = {
    status = status,
    missing = missing,
    from = from,
    to = to,
    bytes = sub(self.text, from - self.text_from + 1, to - self.text_from),
  }
end

-- Skip the bytes up to an offset.  They go to the latest finding if it is of skipped bytes, too.
local function skip(self, to)
  if to <= self.from then return end
  local latest = self.findings[#self.findings]
  if not (latest and latest.status == "skipped") then return add_finding(self, to, "skipped") end
  latest.bytes = latest.bytes .. sub(self.text, self.from - self.text_from + 1, to - self.text_from)
  latest.to, self.from = to, to
end

-- Return where the first message of the catalogue begins inside of the first failed candidate, or
-- `limit`.
local function next_known(failed, limit)
  for i = 2, #failed do
    if failed[i].from >= failed[1].to then return limit end
    if failed[i].is_known then return failed[i].from end
  end
  return limit
end

-- Return the status of a failed candidate; nil for noise.
-- stop           where the next message begins
-- limit, behind  of settle
local function status_of(candidate, stop, limit, behind)
  local is_last = stop == limit
  if candidate.to <= stop then return "bad" end
  if is_last and behind == "open" then return "open" end
  if candidate.is_known or is_last and behind == "end" then return "incomplete" end
end

-- Append the bytes before `limit` as findings: the damaged frames, the earliest start first, and
-- the bytes between them.
-- behind  what begins at the limit: "open", "good" (a frame) or "end" (nothing)
local function settle(self, limit, behind)
  local failed = self.failed
  while failed[1] do
    local candidate, stop = failed[1], next_known(failed, limit)
    local is_apart = candidate.from >= self.from -- not inside of a damaged frame before it
    local status = is_apart and status_of(candidate, stop, limit, behind)
    if status then skip(self, candidate.from) end
    if status == "open" then return end
    local missing = candidate.to > stop and candidate.to - stop or nil
    if status then add_finding(self, math.min(candidate.to, stop), status, missing) end
    table.remove(failed, 1)
  end
  skip(self, limit)
end

-- Judge a candidate.
-- index    in the text
-- returns  true to wait for more bytes
local function judge(self, candidate, index, is_end)
  local has_come = candidate.to <= self.to
  if has_come and is_good(self, candidate, index) then
    settle(self, candidate.from, "good")
    add_finding(self, candidate.to, "good")
    self.searched = candidate.to
    return false
  end
  local may_count = has_come or may_wait(candidate)
  if may_count and not (has_come or is_end) then
    self.open = candidate
    return true
  end
  if may_count and candidate.is_plausible then table.insert(self.failed, candidate) end
  self.searched = candidate.from + #frame.SYNC
  return false
end

-- Judge the candidates that begin in bytes that have not been searched.
local function search(self, is_end)
  local candidate
  self.open = false
  repeat
    local index = frame.find(self.text, self.searched - self.text_from + 1)
    if not index then
      local is_begun = not is_end and self.to > self.searched and byte(self.text, -1) == Y
      self.searched = is_begun and self.to - 1 or self.to
      return
    end
    self.searched = self.text_from + index - 1
    candidate = candidate_at(self, index)
  until not candidate or judge(self, candidate, index, is_end)
  if is_end then self.searched = self.to end -- behind a part of a header
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
--            from     offset in the stream
--            to       offset behind the last byte that came
--            bytes    string
--            missing  number of bytes of a frame that have not come, nil for none }
-- Document: "UART Stream Framing".
function Framer:add(bytes, is_end, findings)
  self.findings = findings or {}
  if self.from > self.text_from then
    self.text, self.text_from = sub(self.text, self.from - self.text_from + 1), self.from
  end
  self.text, self.to = self.text .. bytes, self.to + #bytes
  search(self, is_end)
  settle(self, self.searched, is_end and "end" or "open")
  return self.findings
end

--- Return the bytes that are in no finding yet.
function Framer:pending()
  return sub(self.text, self.from - self.text_from + 1)
end

--- Return whether a frame is not final yet: a capture that ends here ends before it.  A part of a
-- header is none, nor are bytes that are more likely noise.
function Framer:has_open_frame()
  return self.failed[1] ~= nil or self.open and self.open.is_plausible
end

return Framer
