-- SPDX-License-Identifier: GPL-2.0-or-later
-- What is kept of a packet in the middle of a stream, as a text: tables for it take a kilobyte.  Pure Lua, 5.2 and 5.4.
--
-- Numbers of 2 bytes, little endian: place, done, pending, missing + 1 (0 for none), how many packets later the one is
-- that its last bytes lead to (0 for none); then of each event its kind, where it begins and ends (from 0x8000 before
-- the packet on), the length of its bytes, the number of its parts, how many packets before this one these are, and in
-- 6 bytes its delta.  Behind all of them the bytes.

local archive = require("yapp.base.archive")

local M = {}

local byte, char, sub, concat = string.byte, string.char, string.sub, table.concat
local min = math.min
local unpack = rawget(table, "unpack")

local SKIPPED, BAD, GOOD = 0, 1, 2
local BEFORE = 0x8000
local MAX_PARTS, MAX_EVENTS = 30, 100 -- what unpack takes at once

local buffer, length = {}, 0

-- Appends a number of 2 bytes; false for one that has more.
local function put(number)
  if number < 0 or number > 0xFFFF then return false end
  local low = number % 0x100
  buffer[length + 1], buffer[length + 2], length = low, (number - low) / 0x100, length + 2
  return true
end

local function put_parts(parts, number)
  if not put(#parts) then return false end
  for i = 1, #parts do
    if not put(number - parts[i]) then return false end
  end
  return true
end

local NO_PARTS = {}

-- Appends an event: its numbers to the buffer, its texts to rest; false for one that does not fit.
local function put_event(event, piece, rest)
  local kind = event.kind == "frame" and (event.good and GOOD or BAD) or event.kind == "skipped" and SKIPPED
  local parts, bytes, delta = event.parts or NO_PARTS, event.bytes or "", archive.from_delta(event.delta)
  if not kind or not delta or event.truncated or #parts > MAX_PARTS then return false end
  rest[#rest + 1], rest[#rest + 2] = archive.bytes_of(delta), bytes
  return put(kind) and put(event.from - piece.base + BEFORE) and put(event.to - piece.base + BEFORE) and
    put(#bytes) and put_parts(parts, piece.number)
end

--- A piece as a text.
-- piece    { number = of its packet, place, base, done, pending, missing, leads_to, events = { { kind, good, from, to,
--          bytes, parts, delta } ... } } of serial.memory
-- returns  string; nil for a piece that has more than a text has room for
function M.pack(piece)
  local events, rest = piece.events, {}
  length = 0
  local leads_to = piece.leads_to and piece.leads_to - piece.number or 0
  local fits = #events <= MAX_EVENTS and put(piece.place) and put(piece.done) and put(piece.pending) and
    put(piece.missing and piece.missing + 1 or 0) and put(leads_to) and put(#events)
  for i = 1, fits and #events or 0 do fits = fits and put_event(events[i], piece, rest) end
  if not fits then return nil end
  local text = {}
  for from = 1, length, 128 do text[#text + 1] = char(unpack(buffer, from, min(from + 127, length))) end
  text = concat(text) .. concat(rest)
  return #text <= archive.MAX_TEXT and text or nil
end

-- Takes numbers of 2 bytes from a text.
local function reader_of(text)
  local at = -1
  return function()
    at = at + 2
    local low, high = byte(text, at, at + 1)
    return low + 0x100 * high
  end, function() return at + 2 end
end

local function take_event(take, number)
  local kind, from, to, size, count = take(), take() - BEFORE, take() - BEFORE, take(), take()
  local event = { kind = kind == SKIPPED and "skipped" or "frame", from = from, to = to, size = size }
  if kind ~= SKIPPED then event.good = kind == GOOD end
  for i = 1, count do
    event.parts = event.parts or {}
    event.parts[i] = number - take()
  end
  return event
end

--- The piece of a text, with its base at 0.
-- number  of its packet
function M.unpack(text, number)
  local take, position = reader_of(text)
  local piece = { number = number, base = 0, place = take(), done = take(), pending = take(), events = {} }
  local missing, leads_to = take(), take()
  if missing > 0 then piece.missing = missing - 1 end
  if leads_to > 0 then piece.leads_to = number + leads_to end
  for i = 1, take() do piece.events[i] = take_event(take, number) end
  local at = position()
  for _, event in ipairs(piece.events) do
    event.delta = archive.to_delta(archive.number_at(text, at, 6))
    if event.size > 0 then event.bytes = sub(text, at + 6, at + 5 + event.size) end
    at, event.size = at + 6 + event.size, nil
  end
  return piece
end

return M
