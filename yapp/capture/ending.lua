-- SPDX-License-Identifier: GPL-2.0-or-later
-- Whether a file ends before its own end: its recorder lost power.  Wireshark shows what is there,
-- and says nothing of a zstd stream, on 4.0 of lz4, with its exit code of BLF.  Pure Lua.

local little_endian = require "yapp.base.little_endian"

local M = {}

local CUT = {} -- raised where bytes are missing

-- Return the number in the next bytes, the lowest first.
local function number(file, count)
  local bytes = file:read(count) or ""
  if #bytes < count then error(CUT) end
  return little_endian(bytes, 1, count)
end

-- Go on behind bytes, the last of which has to be there.
local function skip(file, count)
  if count == 0 then return end
  file:seek("cur", count - 1)
  number(file, 1)
end

-- By the first four bytes of a part: function(file), which goes behind the part.
local PARTS = {}

-- Vector BLF has its size in the header, which a recorder writes when it closes the file.
function PARTS.LOGG(file)
  local header = number(file, 4)
  skip(file, 8)
  local size = number(file, 8)
  if size <= header then error(CUT) end
  file:seek("set", size - 1)
  number(file, 1)
end

local CONTENT_SIZES = { [0] = 0, 2, 4, 8 }

-- A frame of zstd, without a dictionary: the last of its blocks is marked.
PARTS["\40\181\47\253"] = function(file)
  local descriptor = number(file, 1)
  local is_single, has_sum = descriptor % 64 >= 32, descriptor % 8 >= 4
  local content_size = CONTENT_SIZES[math.floor(descriptor / 64)]
  if is_single then content_size = math.max(content_size, 1) end
  skip(file, (is_single and 0 or 1) + content_size)
  repeat
    local block = number(file, 3)
    local is_repeated_byte = math.floor(block / 2) % 4 == 1
    skip(file, is_repeated_byte and 1 or math.floor(block / 8))
  until block % 2 == 1
  skip(file, has_sum and 4 or 0)
end

-- A frame of lz4: behind its blocks is a size of 0.
PARTS["\4\34\77\24"] = function(file)
  local flags = number(file, 1)
  local function size_if(bit, size) return flags % (2 * bit) >= bit and size or 0 end
  skip(file, 2 + size_if(8, 8) + size_if(1, 4))
  repeat
    local size = number(file, 4) % 2 ^ 31
    skip(file, size == 0 and size_if(4, 4) or size + size_if(16, 4))
  until size == 0
end

--- Return whether a file ends early; false where its format has no end of its own.
-- file  with read and seek, as io.open gives it, at its start
function M.is_cut(file)
  local ok, why = pcall(function()
    local part
    repeat
      part = PARTS[file:read(4) or ""]
      if part then part(file) end
    until not part
  end)
  if not ok and why ~= CUT then error(why, 0) end
  return not ok
end

return M
