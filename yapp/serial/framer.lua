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
--
-- A serial server in telnet mode (RFC 854) sends each byte 0xFF twice.  If that makes a CRC good,
-- the stream is telnet from there on.

local crc = require "yapp.wire.crc"
local frame = require "yapp.wire.frame"
local memo = require "yapp.base.memo"
local telnet = require "yapp.serial.telnet"

local M = {}

local byte, sub = string.byte, string.sub

local HEADER, CRC_SIZE = frame.HEADER, frame.CRC_SIZE
local Y = byte(frame.SYNC)

-- Bytes that the stream waits for: all of a message of the catalogue; of another plausible header
-- as many as a controller sends in 7 s; of noise, such as "TYPE = 12", two messages.
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
-- options   nil for none, or { is_patient = true if the stream waits for each candidate,
--           may_be_telnet = true if it may be of a serial server in telnet mode }
-- Document: "UART Stream Framing".
function M.new(size_of, options)
  return setmetatable({
    size_of = size_of,
    options = options or {},
    is_telnet = false,
    rest = "",     -- of telnet: the latest bytes, which may go on with a command
    spent = {},    -- [logarithm of a candidate's length] = bytes that CRCs were computed over
    text = "",     -- the latest bytes
    text_from = 0, -- their offset in the stream
    to = 0,        -- the end of the stream so far
    from = 0,      -- the first byte that is in no finding yet
    searched = 0,  -- every candidate that begins before this is judged
    failed = {},   -- plausible ones without a good CRC that are not decided on, by start
    open = false,  -- the one that the stream waits for
    findings = {},
  }, Framer)
end

-- Return the candidate of a "YP", nil if its header has not come.
-- index  in the text
local function candidate_at(self, index)
  local id, size, reserved = frame.parse(self.text, index)
  if not id then return nil end
  local known, smallest = self.size_of(id)
  local fits = not known or size <= known and size >= (smallest or known)
  local is_plausible = fits and reserved == 0 and id <= frame.MAX_ID
  local from, length = self.text_from + index - 1, HEADER + size + CRC_SIZE
  return {
    from = from,
    to = from + length,
    length = length,
    is_plausible = is_plausible,
    is_known = is_plausible and known ~= nil,
  }
end

-- Return whether the stream waits for the end of a candidate.
local function may_wait(self, candidate)
  if candidate.is_known or self.options.is_patient then return true end
  return candidate.length <= (candidate.is_plausible and PATIENCE or NOISE_PATIENCE)
end

-- Return whether the CRC of a frame is good.
-- text, index  its bytes, from there on; length = of it
local function is_good(self, text, index, length)
  local class, earned = CLASSES[length], CREDIT * self.to
  local spent = math.max(self.spent[class] or 0, earned) + length
  if spent > earned + MAX_CREDIT then return false end
  self.spent[class] = spent
  local to = index + length - 1
  local sum = crc.update(SYNC_REGISTER, text, index + #frame.SYNC, to - CRC_SIZE)
  return sum == frame.crc(text, to)
end

-- Go on as telnet from a candidate on, if its CRC is good without what telnet adds.
-- returns  true if it is; else the number of bytes that have to come to know that, nil for none
local function try_telnet(self, index, length)
  if self.is_telnet or not self.options.may_be_telnet then return false end
  local mark = self.text:find(telnet.TWICE, index, true)
  if not mark or mark >= index + length then return false end
  local plain, rest = telnet.decode(sub(self.text, index))
  if #plain < length then return false, length - #plain end
  if not is_good(self, plain, 1, length) then return false end
  self.text, self.rest, self.is_telnet = sub(self.text, 1, index - 1) .. plain, rest, true
  self.to = self.text_from + #self.text
  return true
end

-- Append the bytes up to an offset as a finding.
local function add_finding(self, to, status, missing)
  local from, offset = self.from, self.from - self.text_from
  self.from = to
  self.findings[#self.findings + 1] = {
    status = status,
    missing = missing,
    from = from,
    to = to,
    bytes = sub(self.text, offset + 1, offset + to - from),
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

-- Return where the next message of the catalogue begins inside of a failed candidate, or `limit`.
-- index  of the candidate in the list
local function next_known(failed, index, limit)
  local candidate = failed[index]
  for i = index + 1, #failed do
    local start = failed[i].from
    if start >= candidate.to or start >= limit then return limit end
    if failed[i].is_known then return start end
  end
  return limit
end

-- Return the status of a failed candidate, and its end: "bad", "incomplete", or "open" if that is
-- not decided yet; nil for noise and inside of a damaged frame before it.
-- limit, behind  of settle
local function status_of(self, index, limit, behind)
  local candidate = self.failed[index]
  if candidate.from < self.from then return nil end
  local stop = next_known(self.failed, index, limit)
  if candidate.to <= stop then return "bad", candidate.to end
  if stop == limit and behind == "open" then return "open" end
  if candidate.is_known or stop == limit and behind == "end" then return "incomplete", stop end
end

-- Append the bytes before `limit` as findings: the damaged frames, the earliest start first, and
-- the bytes between them.
-- behind  what begins at the limit: "open", "good" (a frame) or "end" (nothing)
local function settle(self, limit, behind)
  local open = {}
  for index, candidate in ipairs(self.failed) do
    local status, stop
    if not open[1] then status, stop = status_of(self, index, limit, behind) end
    if status == "open" then limit = candidate.from end
    if open[1] or status == "open" then
      open[#open + 1] = candidate
    elseif status then
      local missing = candidate.to - stop
      skip(self, candidate.from)
      add_finding(self, stop, status, missing > 0 and missing or nil)
    end
  end
  self.failed = open
  skip(self, limit)
end

-- Judge the candidate at an index of the text.
-- returns  true to wait for more bytes
local function judge(self, index, is_end)
  local candidate = candidate_at(self, index)
  if not candidate then
    if is_end then self.searched = self.to end
    return not is_end
  end
  local length, is_frame, missing = candidate.length, false, candidate.to - self.to
  if missing <= 0 then
    is_frame = is_good(self, self.text, index, length)
    if not is_frame then is_frame, missing = try_telnet(self, index, length) end
  end
  if is_frame then
    settle(self, candidate.from, "good")
    add_finding(self, candidate.to, "good")
    self.failed, self.searched = {}, candidate.to
    return false
  end
  if missing and missing > 0 and not is_end and may_wait(self, candidate) then
    self.open = candidate
    return true
  end
  local has_come = candidate.to <= self.to or is_end
  if candidate.is_plausible and has_come then table.insert(self.failed, candidate) end
  self.searched = candidate.from + #frame.SYNC
  return false
end

-- Judge the candidates that begin in bytes that have not been searched.
local function search(self, is_end)
  self.open = false
  repeat
    local index = frame.find(self.text, self.searched - self.text_from + 1)
    if not index then
      local is_begun = not is_end and self.to > self.searched and byte(self.text, -1) == Y
      self.searched = is_begun and self.to - 1 or self.to
      return
    end
    self.searched = self.text_from + index - 1
  until judge(self, index, is_end)
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
--            from     offset in the stream, which counts no bytes that telnet added
--            to       offset behind the last byte
--            bytes    string }
-- Document: "UART Stream Framing".
function Framer:add(bytes, is_end, findings)
  self.findings = findings or {}
  if self.from > self.text_from then
    self.text, self.text_from = sub(self.text, self.from - self.text_from + 1), self.from
  end
  if self.is_telnet then bytes, self.rest = telnet.decode(self.rest .. bytes) end
  self.text, self.to = self.text .. bytes, self.to + #bytes
  search(self, is_end)
  settle(self, self.searched, is_end and "end" or "open")
  if is_end then self.rest = "" end
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

return M
