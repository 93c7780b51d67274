-- SPDX-License-Identifier: GPL-2.0-or-later
-- What is kept of the frames of a capture, in little memory.  Pure Lua, 5.2 and 5.4.
--
-- A look (a number that grows: of a frame, as a rule) has a code, and some have an extra:
--   0            nothing
--   1 .. 253     belongs to the look that is so many looks later
--   254 NUMBER   extra: a number below 2^32
--   255 TEXT     extra: a text of at most 65,535 bytes
-- Those of the newest looks lie in tables.  Behind them 256 looks at a time become one text, a block: their codes, and
-- then, of each look with an extra, in order, the extra and a note: a long capture takes half the memory, and Lua's
-- collector, which goes over all tables and texts again and again, has next to nothing to go over.
-- A note is 6 bytes: twice the delta in nanoseconds plus 1, 0 for none; plus 1 where the message has a fault flag set.

local collector = require("yapp_collector")

local M = {}

local byte, char, sub, floor = string.byte, string.char, string.sub, math.floor
local concat = table.concat
local unpack = rawget(table, "unpack")

local BLOCK = 256
M.NUMBER, M.TEXT = 254, 255
M.MAX_DISTANCE = 253 -- what a code has room for
M.MAX_TEXT = 0xFFFF -- bytes
local NUMBER, TEXT = M.NUMBER, M.TEXT

local NOTE = 6
local MAX_DELTA = 2 ^ (8 * NOTE - 1)
local NANOSECONDS = 1e9 -- in a second

local Archive = {}
Archive.__index = Archive

--- Nothing is known yet.
-- It has, by look, to write into: codes and extras; deltas (seconds since the source's previous message) and faulty
-- (whether a fault flag is set) of messages.  And due: a look from which on `pack` has something to do.
function M.new()
  return setmetatable({ codes = {}, extras = {}, deltas = {}, faulty = {}, blocks = {}, opened = {}, buffer = {},
    first = 0, due = BLOCK + M.MAX_DISTANCE }, Archive)
end

-- Packing -----------------------------------------------------------------------------------------------------------

--- A number below 2^48 as 6 bytes, little endian.
function M.bytes_of(n)
  local a, b, c, d, e = n % 0x100, n % 0x10000, n % 0x1000000, n % 0x100000000, n % 0x10000000000
  return char(a, (b - a) / 0x100, (c - b) / 0x10000, (d - c) / 0x1000000, (e - d) / 0x100000000,
    (n - e) / 0x10000000000)
end

--- A delta in seconds as a number below 2^47: nanoseconds plus 1, 0 for none; nil where it does not fit.
function M.from_delta(delta)
  if not delta then return 0 end
  local number = floor(delta * NANOSECONDS + 0.5) + 1
  return number > 0 and number < MAX_DELTA and number or nil
end

--- And back.
function M.to_delta(number)
  return number > 0 and (number - 1) / NANOSECONDS or nil
end

local bytes_of, from_delta, to_delta = M.bytes_of, M.from_delta, M.to_delta

-- What does not fit stays where it is.
local function note_of(self, look)
  local delta = from_delta(self.deltas[look])
  if delta then self.deltas[look] = nil end
  local note = 2 * (delta or 0)
  if self.faulty[look] then note, self.faulty[look] = note + 1, nil end
  return bytes_of(note)
end

local function pack_extra(self, look, code, rest)
  local extra, count = self.extras[look], #rest
  if code == TEXT then
    local length = #extra
    rest[count + 1], rest[count + 2] = char(length % 0x100, (length - length % 0x100) / 0x100), extra
  else
    rest[count + 1], rest[count + 2] = sub(bytes_of(extra), 1, 4), ""
  end
  rest[count + 3] = note_of(self, look)
  self.extras[look] = nil
end

local function pack_block(self, number)
  local codes, buffer, rest, is_empty = self.codes, self.buffer, {}, true
  local before = number * BLOCK - 1
  for i = 1, BLOCK do
    local look = before + i
    local code = codes[look]
    if code then
      codes[look], is_empty = nil, false
      if code >= NUMBER then pack_extra(self, look, code, rest) end
    end
    buffer[i] = code or 0
  end
  if is_empty then return end
  local block = char(unpack(buffer, 1, BLOCK)) .. concat(rest)
  self.blocks[number] = block
  collector.packed(#block)
end

--- Packs what is old: what lies further behind the newest look than a code reaches.  What is written for an older look
-- stays in the tables.
function Archive:pack(newest)
  while newest >= self.due do
    pack_block(self, self.first)
    self.first, self.due = self.first + 1, self.due + BLOCK
  end
end

-- Asking ------------------------------------------------------------------------------------------------------------

--- The number in so many bytes of a text.
function M.number_at(text, at, count)
  local number = 0
  for i = at + count - 1, at, -1 do number = number * 0x100 + byte(text, i) end
  return number
end

local number_at = M.number_at

-- The extras of a block: { [index] = { extra, note } }.  The last two blocks stay open: who goes through a capture asks
-- for some looks of one by turns with some of the next.
local function open(self, number)
  local slot = number % 2
  local opened = self.opened[slot]
  if opened and opened.number == number then return opened end
  local block, at = self.blocks[number], BLOCK + 1
  opened = { number = number }
  for i = 1, BLOCK do
    local code = byte(block, i)
    if code == NUMBER then
      opened[i] = { number_at(block, at, 4), number_at(block, at + 4, NOTE) }
      at = at + 4 + NOTE
    elseif code == TEXT then
      local behind = at + 2 + number_at(block, at, 2)
      opened[i] = { sub(block, at + 2, behind - 1), number_at(block, behind, NOTE) }
      at = behind + NOTE
    end
  end
  self.opened[slot] = opened
  return opened
end

-- Where a look is packed: its block, the block's number, its index there; nil where it is not.
local function find(self, look)
  if look >= self.first * BLOCK or look % 1 ~= 0 then return nil end
  local number = floor(look / BLOCK)
  return self.blocks[number], number, look - number * BLOCK + 1
end

--- The code of a look, nil for nothing, and its extra.
function Archive:get(look)
  local code = self.codes[look]
  if code then return code, self.extras[look] end
  local block, number, index = find(self, look)
  code = block and byte(block, index) or 0
  if code >= NUMBER then return code, open(self, number)[index][1] end
  return code > 0 and code or nil
end

local function packed_note(self, look)
  local block, number, index = find(self, look)
  return block and byte(block, index) >= NUMBER and open(self, number)[index][2] or 0
end

--- The delta of a look, to the nanosecond; nil for none.
function Archive:delta(look)
  if self.deltas[look] then return self.deltas[look] end
  local note = packed_note(self, look)
  return to_delta((note - note % 2) / 2)
end

--- Whether the message that ends at a look has a fault flag set.
function Archive:is_faulty(look)
  return self.faulty[look] or packed_note(self, look) % 2 == 1
end

return M
