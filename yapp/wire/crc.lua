-- SPDX-License-Identifier: GPL-2.0-or-later
-- CRC-32K/6.4 (Koopman), the check value of YAPP frames.  Pure Lua.
--
-- Polynomial 0x1'32C0'0699, most significant bit first, not reflected, initial value 0xFFFFFFFF, no
-- final xor (vendor document, "CRC Calculation").

local bits = require "yapp.base.bits"

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

-- For Lua 5.3 and later, whose operators are syntax errors before.
local native = load([[
  local TABLE, byte = ...
  return function(register, data, from, to)
    local index = from or 1
    to = to or #data
    while index + 3 <= to do
      local a, b, c, d = byte(data, index, index + 3)
      register = (register << 8 & 0xFFFFFFFF) ~ TABLE[register >> 24 ~ a]
      register = (register << 8 & 0xFFFFFFFF) ~ TABLE[register >> 24 ~ b]
      register = (register << 8 & 0xFFFFFFFF) ~ TABLE[register >> 24 ~ c]
      register = (register << 8 & 0xFFFFFFFF) ~ TABLE[register >> 24 ~ d]
      index = index + 4
    end
    for i = index, to do
      register = (register << 8 & 0xFFFFFFFF) ~ TABLE[register >> 24 ~ byte(data, i)]
    end
    return register
  end
]], "=wire.crc native")

-- For Lua 5.2, where a call costs more than a table look-up.  A step takes eight bytes, each
-- through a table of its own.  Arithmetic splits the register into its four bytes, which go through
-- tables, too.
local function with_library()
  local bxor, lshift, rshift = bits.bxor, bits.lshift, bits.rshift
  local NEXT = { [0] = TABLE }
  for k = 1, 7 do
    NEXT[k] = {}
    for i = 0, 255 do
      local register = NEXT[k - 1][i]
      NEXT[k][i] = bxor(lshift(register, 8), TABLE[rshift(register, 24)])
    end
  end
  local T0, T1, T2, T3 = NEXT[0], NEXT[1], NEXT[2], NEXT[3]
  local T4, T5, T6, T7 = NEXT[4], NEXT[5], NEXT[6], NEXT[7]
  return function(register, data, from, to)
    local index = from or 1
    to = to or #data
    while index + 7 <= to do
      local a, b, c, d, e, f, g, h = byte(data, index, index + 7)
      local z = register % 0x100
      register = (register - z) / 0x100
      local y = register % 0x100
      register = (register - y) / 0x100
      local x = register % 0x100
      local w = (register - x) / 0x100
      register = bxor(T7[w], T6[x], T5[y], T4[z],
        T7[a], T6[b], T5[c], T4[d], T3[e], T2[f], T1[g], T0[h])
      index = index + 8
    end
    for i = index, to do
      local low = register % 0x1000000
      register = bxor(low * 0x100, T0[(register - low) / 0x1000000], T0[byte(data, i)])
    end
    return register
  end
end

--- Return the CRC register behind data[from .. to].
-- register  before these bytes, 0 .. 0xFFFFFFFF; M.INITIAL to begin with
-- data      string
-- from, to  1-based, inclusive; the whole string when left out
-- returns   the new register, 0 .. 0xFFFFFFFF.  Document: "CRC Calculation".
M.update = native and native(TABLE, byte) or with_library()

--- The CRC of a string, from the initial value.
function M.of(data)
  return M.update(M.INITIAL, data)
end

return M
