-- SPDX-License-Identifier: GPL-2.0-or-later
-- Bit operations on numbers of 32 bits.  Pure Lua, 5.2 and 5.4.

local M = {}

-- Native operators are syntax errors in Lua 5.2, so they hide in a string.
local native = load([[
  return function(a, b) return a & b end,
    function(a, b) return a | b end,
    function(a, b) return a ~ b end
]], "=base.bits native")

--- Lua 5.2's library, nil where there are native operators: BitOp in Wireshark (signed results),
-- bit32 in plain Lua (unsigned).  Loops that cannot afford one more call use it, and take each
-- result modulo 0x100000000.
M.library = not native and (rawget(_G, "bit") or require "bit32") or nil

--- A faster band for loops, whose result may be negative: compare it with 0 only.
M.fast_band = native and native() or M.library.band

--- band(a, b): the bits set in both.  bor(a, b): in at least one.  bxor(a, b): in exactly one.
-- a, b     integers, 0 .. 0xFFFFFFFF
-- returns  the same
if native then
  M.band, M.bor, M.bxor = native()
else
  for _, name in ipairs { "band", "bor", "bxor" } do
    local operation = M.library[name]
    M[name] = function(a, b) return operation(a, b) % 0x100000000 end
  end
end

return M
