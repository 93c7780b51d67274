-- SPDX-License-Identifier: GPL-2.0-or-later
-- Bit operations on integers 0 .. 0xFFFFFFFF, whose results are such integers, too.  Pure Lua.
--
--   band(a, b)  the bits set in both
--   bor(a, b)   in at least one
--   bxor(a, b)  in exactly one
--
-- Lua 5.2 has its library bit32.  Later versions have operators, which are syntax errors in 5.2, so
-- they hide in a string.

local native = load([[
  return {
    band = function(a, b) return a & b end,
    bor = function(a, b) return a | b end,
    bxor = function(a, b) return a ~ b end,
  }
]], "=base.bits native")

return native and native() or require "bit32"
