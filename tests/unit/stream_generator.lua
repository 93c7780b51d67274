-- SPDX-License-Identifier: GPL-2.0-or-later
-- Makes streams for the framing tests: frames, good and damaged in every way, amid text and noise.
if not arg then return end -- run by Wireshark, see run.lua
local crc = require("yapp.wire.crc")

local M = {}

--- The messages of the tests: payload size by id; every other id may have any size.
M.known = { [0x000] = 7, [0x200] = 17, [0x210] = 32 }

--- Numbers that are the same in every Lua: random(n) gives 1 .. n.
function M.random(seed)
  local state = seed * 7919 % 2147483647 + 1
  return function(n)
    state = state * 16807 % 2147483647
    return (state - state % 16) / 16 % n + 1
  end
end

--- An unsigned number as so many bytes, little endian.
function M.little_endian(value, count)
  local digits = {}
  for i = 1, count do
    digits[i] = string.char(value % 256)
    value = (value - value % 256) / 256
  end
  return table.concat(digits)
end
local little_endian = M.little_endian

--- A header that claims so many bytes of payload.
function M.header(id, size)
  return "YP\1\0" .. little_endian(id, 4) .. little_endian(size, 2) .. "\0\0"
end
local header = M.header

--- Bytes and the CRC over them.
function M.sealed(bytes)
  return bytes .. little_endian(crc.of(bytes), 4)
end
local sealed = M.sealed

--- A good frame.
function M.frame(id, payload)
  return sealed(header(id, #payload) .. payload)
end
local frame = M.frame

local function pick(random, list) return list[random(#list)] end

local function random_bytes(random, count)
  local bytes = {}
  for i = 1, count do bytes[i] = string.char(random(256) - 1) end
  return table.concat(bytes)
end

local function unknown_id(random) return 0x300 + random(0x4FF) end

local function good(random)
  local id = pick(random, { 0x000, 0x200, 0x210, unknown_id(random) })
  return frame(id, random_bytes(random, M.known[id] or random(40) - 1))
end

local function spliced(random, bytes, piece)
  local at = random(#bytes + 1)
  return bytes:sub(1, at - 1) .. piece .. bytes:sub(at)
end

-- Each makes one piece of a stream.
local PIECES = {
  good,
  good,

  text = function(random)
    return pick(random, { "taurus> status\r\n", "OK\r\nYP\r\n", "Y", "YY", "HAPPY PUPPY\n", "YP" })
  end,

  noise = function(random) return spliced(random, random_bytes(random, random(30)), "YP") end,

  flipped = function(random)
    local bytes, bit = good(random), pick(random, { 1, 2, 4, 8, 16, 32, 64, 128 })
    local at = random(#bytes)
    local value = bytes:byte(at)
    value = value % (2 * bit) >= bit and value - bit or value + bit
    return bytes:sub(1, at - 1) .. string.char(value) .. bytes:sub(at + 1)
  end,

  damaged_size = function(random)
    local bytes, size = good(random), pick(random, { random(60), random(300), 65535 })
    return bytes:sub(1, 8) .. little_endian(size, 2) .. bytes:sub(11)
  end,

  lost_bytes = function(random)
    local list = {}
    for i = 1, random(4) do
      local bytes = good(random)
      local at = random(#bytes)
      list[i] = bytes:sub(1, at - 1) .. bytes:sub(at + random(3))
    end
    return table.concat(list)
  end,

  grown = function(random)
    return frame(pick(random, { 0x000, 0x200, 0x210 }), random_bytes(random, random(60)))
  end,

  odd_but_good = function(random)
    local size = random(20)
    local start = pick(random, { header(2047 + random(9), size), header(0x1000000 * random(255), size),
      header(0x210, size):sub(1, 10) .. "\1\2" })
    return sealed(start .. random_bytes(random, size))
  end,

  cut = function(random)
    local bytes = good(random)
    return bytes:sub(1, random(#bytes) - 1)
  end,

  beheaded = function(random)
    local bytes = good(random)
    return bytes:sub(random(#bytes))
  end,

  inside_damaged = function(random)
    local payload = spliced(random, random_bytes(random, random(20)), good(random))
    return header(unknown_id(random), #payload + random(9) - 5) .. payload .. "\0\0\0\0"
  end,

  inside_good = function(random)
    return frame(unknown_id(random), spliced(random, random_bytes(random, random(20)), good(random)))
  end,

  two_good_overlapping = function(random)
    local rest = random_bytes(random, random(20))
    local second = header(unknown_id(random), 4 + #rest)
    local first = frame(unknown_id(random), random_bytes(random, random(20)) .. second)
    return first .. rest .. little_endian(crc.of(second .. first:sub(-4) .. rest), 4)
  end,

  claims = function(random)
    local bytes = {}
    for i = 1, random(12) do
      bytes[i] = header(unknown_id(random), pick(random, { 0, random(30), random(200), 65535 }))
      if random(3) == 1 then bytes[i] = bytes[i] .. random_bytes(random, random(6)) end
    end
    return table.concat(bytes)
  end,

  near_headers = function(random)
    local size = random(9) - 1
    return pick(random, { header(2047, size), header(2048, size), header(0x10000 + 5, size),
      header(0x210, size), header(0x210, 32), header(5, size):sub(1, 11) .. "\1" })
  end,

  yp = function(random) return ("YP"):rep(random(40)) end,
}

local names = {}
for name in pairs(PIECES) do names[#names + 1] = name end
table.sort(names, function(a, b) return tostring(a) < tostring(b) end)

--- A stream of so many pieces.
function M.stream(random, pieces)
  local bytes = {}
  for i = 1, pieces do bytes[i] = PIECES[pick(random, names)](random) end
  return table.concat(bytes)
end

--- Cuts a string: each piece has less than `longest` bytes, some have none.  All in one when longest is nil.
function M.cut(random, bytes, longest)
  if not longest then return { bytes } end
  local pieces, at = {}, 1
  while at <= #bytes do
    local length = longest == 1 and 1 or random(longest) - 1
    pieces[#pieces + 1] = bytes:sub(at, at + length - 1)
    at = at + length
  end
  return pieces
end

return M
