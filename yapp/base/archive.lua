-- SPDX-License-Identifier: GPL-2.0-or-later
-- What is kept of the frames of a capture, in little memory.  Pure Lua, 5.2 and 5.4.
--
-- A look (a number that grows: of a frame, as a rule) may have an extra: a number below 2^32, or a text of at most
-- 65,535 bytes.  In an archive with groups each text says which looks before its own belong to it: its first byte is
-- their number, each byte behind that how many looks they are away.
-- The extras of the newest looks lie in tables.  Behind them those of 256 looks become one text, a block: of each, in
-- order, its index in the block, the extra, and a note.  A long capture takes half the memory, and Lua's collector,
-- which goes over all tables and texts again and again, has next to nothing to go over.
-- A note is 6 bytes: twice the delta in nanoseconds plus 1, 0 for none; plus 1 where the message has a fault flag set.

local collector = require("yapp.base.collector")

local M = {}

local byte, char, sub, floor, max = string.byte, string.char, string.sub, math.floor, math.max
local concat = table.concat

local BLOCK = 256
local NUMBER, TEXT = 0, 1 -- what an extra is, in a block
M.MAX_DISTANCE = 255 -- of a look from the text that it belongs to
M.MAX_TEXT = 0xFFFF -- bytes

local NOTE = 6
local MAX_DELTA = 2 ^ (8 * NOTE - 1)
local NANOSECONDS = 1e9 -- in a second

local Archive = {}
Archive.__index = Archive

--- Nothing is known yet.
-- has_groups  whether its texts say which looks belong to them
-- It has, by look, to write into: extras; deltas (seconds since the source's previous message) and faulty (whether a
-- fault flag is set) of messages.  And due: a look from which on `pack` has something to do.
function M.new(has_groups)
  return setmetatable({ has_groups = has_groups, extras = {}, deltas = {}, faulty = {}, blocks = {}, opened = {},
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

local function pack_extra(self, look, extra, rest)
  local count, index = #rest, look % BLOCK
  if type(extra) == "string" then
    local length = #extra
    rest[count + 1] = char(index, TEXT, length % 0x100, (length - length % 0x100) / 0x100)
    rest[count + 2] = extra
  else
    rest[count + 1], rest[count + 2] = char(index, NUMBER), sub(bytes_of(extra), 1, 4)
  end
  rest[count + 3] = note_of(self, look)
  self.extras[look] = nil
end

local function pack_block(self, number)
  local extras, rest = self.extras, {}
  for look = number * BLOCK, number * BLOCK + BLOCK - 1 do
    local extra = extras[look]
    if extra then pack_extra(self, look, extra, rest) end
  end
  if not rest[1] then return end
  local block = concat(rest)
  self.blocks[number] = block
  collector.packed(#block)
end

--- Packs what is old: what lies further behind the newest look than a text reaches, so that no later text claims a look
-- of a block.  What is written for an older look stays in the tables.
function Archive:pack(newest)
  while newest >= self.due do
    if next(self.extras) then pack_block(self, self.first) else collector.packed(0) end
    self.first, self.due = self.first + 1, self.due + BLOCK
  end
end

--- Throws away what is in the tables, instead of packing it: nobody will look at it again.
function Archive:forget(newest)
  self.extras, self.deltas, self.faulty, self.due = {}, {}, {}, newest + BLOCK
  collector.packed(0)
end

-- Asking ------------------------------------------------------------------------------------------------------------

--- The number in so many bytes of a text.
function M.number_at(text, at, count)
  local number = 0
  for i = at + count - 1, at, -1 do number = number * 0x100 + byte(text, i) end
  return number
end

local number_at = M.number_at

-- The looks that belong to a text, into a table: [look] = the text's.
local function note_group(lasts, text, last)
  for i = 2, byte(text) + 1 do
    local distance = byte(text, i)
    if distance > 0 then lasts[last - distance] = last end
  end
end

-- What is in a block: { number, [look] = { extra, note }, lasts = { [look] = that of its text } }.  The last two blocks
-- stay open: who goes through a capture asks for some looks of one by turns with some of the next.
-- returns  nil where there is none
local function open(self, number)
  local slot, block = number % 2, self.blocks[number]
  local opened = self.opened[slot]
  if opened and opened.number == number or not block then return block and opened end
  local at = 1
  opened = { number = number, lasts = {} }
  while at <= #block do
    local index, kind = byte(block, at, at + 1)
    local look, from, behind = number * BLOCK + index, at + 2, at + 6
    if kind == TEXT then from, behind = at + 4, at + 4 + number_at(block, at + 2, 2) end
    local extra = kind == TEXT and sub(block, from, behind - 1) or number_at(block, from, 4)
    opened[look] = { extra, number_at(block, behind, NOTE) }
    if kind == TEXT and self.has_groups then note_group(opened.lasts, extra, look) end
    at = behind + NOTE
  end
  self.opened[slot] = opened
  return opened
end

-- What is packed of a look, { extra, note }; nil for nothing.
local function packed(self, look)
  if look >= self.first * BLOCK or look % 1 ~= 0 then return nil end
  local block = open(self, floor(look / BLOCK))
  return block and block[look]
end

--- The extra of a look, nil for none.
function Archive:get(look)
  local extra = self.extras[look]
  if extra then return extra end
  local found = packed(self, look)
  return found and found[1]
end

--- The look of the text that a look before it belongs to, nil for none.
function Archive:last_of(look)
  for number = floor(look / BLOCK), floor(look / BLOCK) + 1 do
    local block = open(self, number)
    if block and block.lasts[look] then return block.lasts[look] end
  end
  local lasts, from = {}, look % 1 == 0 and max(look + 1, self.first * BLOCK) or look + 1 -- what is before is packed
  for last = from, look + M.MAX_DISTANCE do
    local text = self.extras[last]
    if type(text) == "string" then note_group(lasts, text, last) end
    if lasts[look] then return last end
  end
end

local function packed_note(self, look)
  local found = packed(self, look)
  return found and found[2] or 0
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
