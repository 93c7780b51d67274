-- SPDX-License-Identifier: GPL-2.0-or-later
-- A file of UTF-16 text, as PowerShell's `>` writes it, read as if it were ASCII. Pure Lua.
--
-- A character becomes a byte, or two beyond the basic plane: what is not ASCII, a "?". So offsets are counted in units
-- of two bytes, and are as good to seek by.
local find, gsub, sub = string.find, string.gsub, string.sub
local char = string.char

local M = {}

local Encoding = {}
Encoding.__index = Encoding

-- By the byte that is 0 in ASCII: the first one (big endian), or the second. Every pair of bytes to a character.
local BIG, LITTLE = {}, {}
for value = 0, 127 do
  BIG["\0" .. char(value)], LITTLE[char(value) .. "\0"] = char(value), char(value)
end
local function unknown() return "?" end
setmetatable(BIG, { __index = unknown })
setmetatable(LITTLE, { __index = unknown })

-- How such a text begins: a byte order mark or not, so many bytes to skip, the characters.
local STARTS = {
  { "^\255\254", 2, LITTLE }, { "^\254\255", 2, BIG },
  { "^[\1-\127]\0[\1-\127]\0", 0, LITTLE }, { "^\0[\1-\127]\0[\1-\127]", 0, BIG },
}

--- The first bytes of a file as text.
-- @param head string
-- @return the text, behind a byte order mark; and its encoding, nil unless it is UTF-16. That one reads and seeks like
--   a file, encoding.file, to be set before; its offset 0 is behind the byte order mark
function M.text(head)
  for _, row in ipairs(STARTS) do
    if find(head, row[1]) then
      local encoding = setmetatable({ skip = row[2], characters = row[3] }, Encoding)
      return encoding:decode(sub(head, row[2] + 1)), encoding
    end
  end
  return head
end

--- The text in some bytes; half a character at their end is dropped.
-- @param bytes from the start of the file, or from an even offset
function Encoding:decode(bytes)
  return (gsub(sub(bytes, 1, #bytes - #bytes % 2), "..", self.characters))
end

function Encoding:read(count)
  local bytes, why = self.file:read(2 * count)
  return bytes and self:decode(bytes), why
end

function Encoding:seek(whence, offset)
  return self.file:seek(whence, self.skip + 2 * offset)
end

return M
