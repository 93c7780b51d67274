-- SPDX-License-Identifier: GPL-2.0-or-later
-- CRC-32K/6.4 (Koopman), the check value of YAPP frames.  Pure Lua, 5.2 and 5.4.
--
-- Polynomial 0x1'32C0'0699, most significant bit first, not reflected, initial value 0xFFFFFFFF, no final xor
-- (vendor document, "CRC Calculation").

local bits = require("yapp.base.bits")

local M = {}

local POLYNOMIAL = 0x32C00699
M.INITIAL = 0xFFFFFFFF

local byte = string.byte

local TABLE = {}
for i = 0, 255 do
  local register = i * 0x1000000
  for _ = 1, 8 do
    local top = register >= 0x80000000
    register = register * 2 % 0x100000000
    if top then register = bits.bxor(register, POLYNOMIAL) end
  end
  TABLE[i] = register
end

-- For Lua 5.4.
local NATIVE = [[
  local TABLE, byte = ...
  local function run(register, data, from, to)
    local at = from
    while at + 7 <= to do
      local a, b, c, d, e, f, g, h = byte(data, at, at + 7)
      register = (register << 8 & 0xFFFFFFFF) ~ TABLE[register >> 24 ~ a]
      register = (register << 8 & 0xFFFFFFFF) ~ TABLE[register >> 24 ~ b]
      register = (register << 8 & 0xFFFFFFFF) ~ TABLE[register >> 24 ~ c]
      register = (register << 8 & 0xFFFFFFFF) ~ TABLE[register >> 24 ~ d]
      register = (register << 8 & 0xFFFFFFFF) ~ TABLE[register >> 24 ~ e]
      register = (register << 8 & 0xFFFFFFFF) ~ TABLE[register >> 24 ~ f]
      register = (register << 8 & 0xFFFFFFFF) ~ TABLE[register >> 24 ~ g]
      register = (register << 8 & 0xFFFFFFFF) ~ TABLE[register >> 24 ~ h]
      at = at + 8
    end
    for i = at, to do
      register = (register << 8 & 0xFFFFFFFF) ~ TABLE[register >> 24 ~ byte(data, i)]
    end
    return register
  end
  local function apply(map, x)
    return map[1][x & 255] ~ map[2][x >> 8 & 255] ~ map[3][x >> 16 & 255] ~ map[4][x >> 24]
  end
  return run, apply
]]

-- For Lua 5.2.
local function with_library(library)
  local bxor, band, lshift, rshift = library.bxor, library.band, library.lshift, library.rshift
  -- A call costs more than a table look-up here: eight bytes a step, each through its own table, and so the register's,
  -- which arithmetic takes apart.
  local NEXT = { [0] = TABLE }
  for k = 1, 7 do
    NEXT[k] = {}
    for i = 0, 255 do
      local register = NEXT[k - 1][i]
      NEXT[k][i] = bxor(lshift(register, 8), TABLE[rshift(register, 24)]) % 0x100000000
    end
  end
  local T0, T1, T2, T3, T4, T5, T6, T7 = TABLE, NEXT[1], NEXT[2], NEXT[3], NEXT[4], NEXT[5], NEXT[6], NEXT[7]
  local function run(register, data, from, to)
    local at = from
    while at + 7 <= to do
      local a, b, c, d, e, f, g, h = byte(data, at, at + 7)
      local z = register % 0x100
      register = (register - z) / 0x100
      local y = register % 0x100
      register = (register - y) / 0x100
      local x = register % 0x100
      register = bxor(T7[(register - x) / 0x100], T6[x], T5[y], T4[z],
        T7[a], T6[b], T5[c], T4[d], T3[e], T2[f], T1[g], T0[h]) % 0x100000000
      at = at + 8
    end
    if at + 3 <= to then -- as what a CRC checks mostly ends
      local a, b, c, d = byte(data, at, at + 3)
      register = bxor(register, ((a * 0x100 + b) * 0x100 + c) * 0x100 + d) % 0x100000000
      local z = register % 0x100
      register = (register - z) / 0x100
      local y = register % 0x100
      register = (register - y) / 0x100
      local x = register % 0x100
      register = bxor(T3[(register - x) / 0x100], T2[x], T1[y], T0[z])
      at = at + 4
    end
    for i = at, to do
      register = bxor(lshift(register, 8), TABLE[bxor(rshift(register, 24), byte(data, i))])
    end
    return register % 0x100000000
  end
  local function apply(map, x)
    return bxor(map[1][band(x, 255)], map[2][band(rshift(x, 8), 255)],
      map[3][band(rshift(x, 16), 255)], map[4][rshift(x, 24)]) % 0x100000000
  end
  return run, apply
end

-- apply: a linear map of the register; the map is four tables, one for each byte of the register.
local run, apply
if bits.library then
  run, apply = with_library(bits.library)
else
  run, apply = load(NATIVE, "=wire.crc native")(TABLE, byte)
end

--- Runs the register over data[from .. to].
-- register  number 0 .. 0xFFFFFFFF, M.INITIAL to begin with
-- data      string
-- from, to  1-based, inclusive; the whole string when left out
-- returns   the new register, 0 .. 0xFFFFFFFF.  Document: "CRC Calculation".
function M.update(register, data, from, to)
  return run(register, data, from or 1, to or #data)
end

--- The CRC of a string, from the initial value.
function M.of(data)
  return run(M.INITIAL, data, 1, #data)
end

--- The exclusive or of two registers, 0 .. 0xFFFFFFFF each.
M.xor = bits.bxor

local POWERS = {} -- [k]: the map "2^k zero bytes go through the register", made when first asked for

local function power(k)
  if POWERS[k] then return POWERS[k] end
  local half = k > 0 and power(k - 1)
  local map, weight = {}, 1
  for place = 1, 4 do
    map[place] = {}
    for i = 0, 255 do
      local x = i * weight
      map[place][i] = half and apply(half, apply(half, x)) or run(x, "\0", 1, 1)
    end
    weight = weight * 256
  end
  POWERS[k] = map
  return map
end

--- Runs the register over zero bytes, in steps that grow with the logarithm of their number.
-- The register is linear: update(a, data) xor update(b, data) = advance(a xor b, #data).  So the CRC of a
-- part of some bytes follows from the registers at its two ends.
-- register  number 0 .. 0xFFFFFFFF
-- count     zero bytes, 0 or more
-- returns   the new register, 0 .. 0xFFFFFFFF.  Document: "CRC Calculation".
function M.advance(register, count)
  local k = 0
  while count > 0 and register ~= 0 do
    if count % 2 == 1 then register = apply(power(k), register) end
    count, k = (count - count % 2) / 2, k + 1
  end
  return register
end

return M
