-- CRC-32K/6.4 (Koopman), the check value of YAPP frames.  Pure Lua, 5.2 and 5.4.
--
-- Polynomial 0x1'32C0'0699, most significant bit first, not reflected, initial value 0xFFFFFFFF, no final xor
-- (vendor document, "CRC Calculation").

local M = {}

local POLYNOMIAL = 0x32C00699
M.INITIAL = 0xFFFFFFFF

local byte = string.byte
local tointeger = rawget(math, "tointeger")

-- One step of the table, in plain arithmetic: exact in doubles and in integers alike.
local function xor_slowly(a, b)
  local result, place = 0, 1
  for _ = 1, 32 do
    if a % 2 ~= b % 2 then result = result + place end
    a, b, place = (a - a % 2) / 2, (b - b % 2) / 2, place * 2
  end
  return result
end

local TABLE = {}
for i = 0, 255 do
  local register = i * 2 ^ 24
  for _ = 1, 8 do
    local top = register >= 2 ^ 31
    register = (register * 2) % 2 ^ 32
    if top then register = xor_slowly(register, POLYNOMIAL) end
  end
  -- COMPAT 5.4: 2 ^ 24 is a float there, and the native operators want integers.
  TABLE[i] = tointeger and tointeger(register) or register
end

-- Native operators are syntax errors in Lua 5.2, so they hide in a string.
local NATIVE = [[
  local TABLE, byte = ...
  return function(register, data, from, to)
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
]]

-- Lua 5.2: Wireshark has BitOp ("bit", signed results), plain Lua has "bit32" (unsigned).
local function with_library(library)
  local bxor, lshift, rshift = library.bxor, library.lshift, library.rshift
  return function(register, data, from, to)
    for i = from, to do
      register = bxor(lshift(register, 8), TABLE[bxor(rshift(register, 24), byte(data, i))])
    end
    return register % 0x100000000
  end
end

local native = load(NATIVE, "=yapp_crc native")
local run = native and native(TABLE, byte) or with_library(rawget(_G, "bit") or require("bit32"))

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

return M
