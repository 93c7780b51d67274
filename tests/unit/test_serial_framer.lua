-- SPDX-License-Identifier: GPL-2.0-or-later
-- Stream framing: each rule by itself, then random streams against a plain reading of the rules.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local crc = require("yapp.wire.crc")
local framer = require("yapp.serial.framer")
local levels = require("levels")
local generator = require("stream_generator")

local frame, header, little_endian = generator.frame, generator.header, generator.little_endian
local GOOD = frame(5, "good")
local MOTOR = frame(0x210, ("motor data "):rep(3):sub(1, 32))
local LARGEST, PATIENCE, NOISE_PATIENCE = 65551, 4096, 128

local function size_of(id) return generator.known[id] end
local function new() return framer.new(size_of) end

-- An finding in words: "good 0-20", "incomplete 4-16 +9".
local function words(finding)
  local missing = finding.missing and " +" .. finding.missing or ""
  return finding.status .. " " .. finding.from .. "-" .. finding.to .. missing
end

local function in_words(findings)
  local list = {}
  for i, finding in ipairs(findings) do list[i] = words(finding) end
  return table.concat(list, ", ")
end

local function feeds(s, bytes, expected) lu.assertEquals(in_words(s:add(bytes)), expected) end

local T = {}

-- The rules, read plainly ---------------------------------------------------------------------------

-- What the 12 bytes of a header say, nil where they have not come.
local function read_header(bytes, from)
  local fields = { bytes:byte(from + 3, from + 12) }
  if #fields < 10 then return nil end
  local function number(at, count)
    local value = 0
    for i = count - 1, 0, -1 do value = value * 256 + fields[at + i] end
    return value
  end
  local id, size, reserved = number(3, 4), number(7, 2), number(9, 2)
  local known = generator.known[id]
  local is_plausible = reserved == 0 and id <= 2047 and (known == nil or known == size)
  return { from = from, to = from + 16 + size, is_plausible = is_plausible, is_known = is_plausible and known ~= nil }
end

local function has_good_crc(bytes, candidate)
  local sent = bytes:sub(candidate.to - 3, candidate.to)
  return little_endian(crc.of(bytes:sub(candidate.from + 1, candidate.to - 4)), 4) == sent
end

-- The candidates by start, and where those begin whose header is not complete, the last first.
local function all_candidates(bytes)
  local list, partial = {}, {}
  for from = #bytes - 1, 0, -1 do
    local start = bytes:sub(from + 1, from + 2)
    if start == "YP" or start == "Y" then
      local candidate = read_header(bytes, from)
      local length = candidate and candidate.to - candidate.from
      local is_noise = length and length > (candidate.is_plausible and PATIENCE or NOISE_PATIENCE)
      if not candidate then
        partial[#partial + 1] = from
      elseif not is_noise then
        table.insert(list, 1, candidate)
      end
    end
  end
  return list, partial
end

-- The good frames that are given out, and the end of the last one: of those that overlap the one that begins first.
-- While the stream goes on, frames wait for an open candidate that began before them.
local function proven(bytes, candidates, is_over)
  local list, behind = {}, 0
  for _, c in ipairs(candidates) do
    local is_open = c.to > #bytes
    if c.from >= behind and is_open and not is_over then break end
    if c.from >= behind and not is_open and has_good_crc(bytes, c) then
      list[#list + 1], behind = c, c.to
    end
  end
  return list, behind
end

-- The first offset from one on where a message of the catalogue begins, or the limit.
local function next_known(candidates, from, limit)
  for _, c in ipairs(candidates) do
    if c.is_known and c.from >= from and c.from < limit then return c.from end
  end
  return limit
end

-- What lies between two offsets where no good frame is, as findings.  Behind `limit` is a good frame ("good"), nothing
-- ("end"), or what is open: then also how far it is decided.
local function damaged(candidates, at, limit, how)
  local findings = {}
  for _, c in ipairs(candidates) do
    if c.is_plausible and c.from >= at and c.from < limit then
      local stop = next_known(candidates, c.from + 1, limit)
      local missing = c.to > stop and c.to - stop or nil
      if missing and stop == limit and how == "open" then return findings, c.from end
      if not missing or c.is_known or stop == limit and how == "end" then
        at = missing and stop or c.to
        local status = missing and "incomplete" or "bad"
        findings[#findings + 1] = { status = status, missing = missing, from = c.from, to = at }
      end
    end
  end
  return findings, limit
end

-- All findings of a stream that is over, in words.
local function expected_events(bytes)
  local candidates = all_candidates(bytes)
  local good, chosen, at = proven(bytes, candidates, true), {}, 0
  good[#good + 1] = { from = #bytes, to = #bytes }
  for i, c in ipairs(good) do
    for _, finding in ipairs((damaged(candidates, at, c.from, i < #good and "good" or "end"))) do
      chosen[#chosen + 1] = finding
    end
    if i < #good then chosen[#chosen + 1] = { status = "good", from = c.from, to = c.to } end
    at = c.to
  end
  local findings
  findings, at = {}, 0
  for _, finding in ipairs(chosen) do
    if finding.from > at then findings[#findings + 1] = { status = "skipped", from = at, to = finding.from } end
    findings[#findings + 1], at = finding, finding.to
  end
  if at < #bytes then findings[#findings + 1] = { status = "skipped", from = at, to = #bytes } end
  return in_words(findings)
end

-- How far a stream that goes on has been given out.
local function expected_offset(bytes)
  local candidates, partial = all_candidates(bytes)
  local _, at = proven(bytes, candidates)
  local limit = #bytes
  for _, from in ipairs(partial) do
    if from >= at then limit = from end
  end
  for i = #candidates, 1, -1 do
    local c = candidates[i]
    if c.from >= at and c.to > #bytes then limit = c.from end
  end
  local _, offset = damaged(candidates, at, limit, "open")
  return offset
end

-- Feeds the pieces; checks that the findings hold every byte once, in order.
-- Skipped ranges that only the cuts part are joined.
local function run(pieces)
  local s, at, joined = new(), 0, {}
  local bytes = table.concat(pieces)
  local function take(findings)
    for i, finding in ipairs(findings) do
      lu.assertEquals(finding.from, at)
      lu.assertEquals(finding.bytes, bytes:sub(finding.from + 1, finding.to))
      at = finding.to
      local previous = joined[#joined]
      if previous and previous.status == "skipped" and finding.status == "skipped" then
        lu.assertEquals(i, 1, "skipped ranges of one call are one")
        previous.to = finding.to
      else
        joined[#joined + 1] = finding
      end
    end
    lu.assertEquals(s.from, at)
  end
  for _, piece in ipairs(pieces) do take(s:add(piece)) end
  take(s:add("", true))
  lu.assertEquals(at, #bytes)
  return in_words(joined)
end

-- "YP" in the text of a shell is a header that is not plausible, as is that of a known ID with another size.
function T.test_frames_do_not_wait_for_noise()
  feeds(new(), "TYPE = 12\r\n> " .. GOOD, "skipped 0-13, good 13-33")
  local flipped = MOTOR:sub(1, 8) .. "\160" .. MOTOR:sub(10)
  feeds(new(), flipped .. MOTOR .. MOTOR, "skipped 0-48, good 48-96, good 96-144")
  local grown, s = frame(0x210, GOOD .. ("x"):rep(NOISE_PATIENCE - 36)), new()
  feeds(s, grown:sub(1, -2), "")
  feeds(s, grown:sub(-1), "good 0-128")
  grown = frame(0x210, GOOD .. ("x"):rep(NOISE_PATIENCE - 35))
  feeds(new(), grown:sub(1, 100), "skipped 0-12, good 12-32, skipped 32-100")
end

-- The header of a large frame may be noise: then nothing may wait for 65,535 bytes.
function T.test_frames_do_not_wait_for_a_large_one()
  feeds(new(), header(5, PATIENCE - 15) .. GOOD, "skipped 0-12, good 12-32")
  feeds(new(), header(5, 65535) .. "text" .. GOOD, "skipped 0-16, good 16-36")
  local s = new()
  feeds(s, header(5, PATIENCE - 16) .. GOOD, "")
  feeds(s, ("x"):rep(PATIENCE - 33), "")
  feeds(s, "x", "skipped 0-12, good 12-32, skipped 32-4096")
end

function T.test_a_large_frame_wins_if_all_its_bytes_are_there()
  local large = frame(5, GOOD .. ("x"):rep(PATIENCE))
  feeds(new(), large .. GOOD, "good 0-4132, good 4132-4152")
  feeds(new(), large:sub(1, 1000), "skipped 0-12, good 12-32, skipped 32-1000")
  lu.assertEquals(in_words(new():add(header(5, 65535) .. "text", true)), "skipped 0-16")
end

function T.test_random_streams_in_random_pieces()
  for seed = 1, levels.size(60, 600) do
    local random = generator.random(seed)
    local bytes = generator.stream(random, random(16))
    local expected = expected_events(bytes)
    for _, longest in ipairs({ false, 1, 4, 40, 200 }) do
      lu.assertEquals(run(generator.cut(random, bytes, longest)), expected, "seed " .. seed)
    end
  end
end

function T.test_random_streams_give_out_all_that_is_final()
  for seed = 2001, 2000 + levels.size(12, 80) do
    local random = generator.random(seed)
    local bytes, s = generator.stream(random, random(8)), new()
    for at = 1, #bytes do
      s:add(bytes:sub(at, at))
      local context = "seed " .. seed .. " byte " .. at
      lu.assertEquals(s.from, expected_offset(bytes:sub(1, at)), context)
    end
  end
end

-- Work and memory -----------------------------------------------------------------------------------

-- Bytes that make much work: candidates as dense as they come.
local HARD = {
  falling_ends = function(_, at) return header(5, 65535 - 2 * at % 65000) end,
  dense_claims = function() return "YP\0\0\5\0\0\0" end, -- the next "YP" is the size
  intact_in_claims = function(random) return random(100) == 1 and GOOD or header(5, 65535) end,
}
local function hard(make, count)
  local random, parts, length = generator.random(7), {}, 0
  while length < count do
    local part = make(random, length)
    parts[#parts + 1], length = part, length + #part
  end
  return table.concat(parts):sub(1, count)
end

local function feed_in_pieces(s, bytes, length)
  for at = 1, #bytes, length do s:add(bytes:sub(at, at + length - 1)) end
end

-- Instructions of the Lua machine, in thousands.
local function instructions(run_it)
  local thousands = 0
  debug.sethook(function() thousands = thousands + 1 end, "", 1000)
  run_it()
  debug.sethook()
  return thousands
end

function T.test_work_is_linear()
  for kind, make in pairs(HARD) do
    local once, s = hard(make, 100000), new()
    feed_in_pieces(s, once, 1400) -- the candidates that wait are now as many as ever
    local first = instructions(function() feed_in_pieces(s, once, 1400) end)
    local twice = instructions(function() feed_in_pieces(s, once .. once, 1400) end)
    lu.assertTrue(twice <= 2 * first + first / 4 + 10, kind .. ": " .. first .. ", then " .. twice)
    lu.assertTrue(first <= 100 * 200, kind .. ": " .. first .. " thousand instructions for 100,000 bytes")
  end
end

-- The CRCs of large candidates leave enough for the frames inside of them.
function T.test_frames_in_a_flood_of_large_candidates()
  local bytes = (header(5, 65535) .. MOTOR .. header(5, 20000) .. MOTOR):rep(600) .. ("x"):rep(65536)
  local s, good = new(), 0
  for at = 1, #bytes, 65536 do
    for _, finding in ipairs(s:add(bytes:sub(at, at + 65535))) do
      if finding.status == "good" then good = good + 1 end
    end
  end
  lu.assertEquals(good, 1200)
end

function T.test_memory_is_bounded_by_the_largest_candidate()
  for kind, make in pairs(HARD) do
    local bytes, s, fed = hard(make, levels.size(70000, 200000)), new(), 0
    collectgarbage()
    local before = collectgarbage("count")
    for at = 1, #bytes, 1000 do
      s:add(bytes:sub(at, at + 999))
      fed = fed + math.min(1000, #bytes - at + 1)
      -- a bad frame that waits, and the candidate that starts in its last byte
      lu.assertTrue(fed - s.from <= 2 * LARGEST, kind .. " at " .. fed)
    end
    collectgarbage()
    lu.assertTrue(collectgarbage("count") - before < 8192, kind)
  end
end

return T
