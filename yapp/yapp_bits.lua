-- Bit operations on unsigned 32 bit numbers, the one place for them.  Pure Lua, 5.2 and 5.4.

local M = {}

-- Native operators are syntax errors in Lua 5.2, so they hide in a string.
local native = load([[
  return function(a, b) return a & b end, function(a, b) return a | b end, function(a, b) return a ~ b end
]])

--- band(a, b), bor(a, b), bxor(a, b): of numbers 0 .. 0xFFFFFFFF, unsigned.
if native then
  M.band, M.bor, M.bxor = native()
else
  -- Wireshark's Lua 5.2 has BitOp, whose results are signed; plain Lua 5.2 has bit32.
  local library = rawget(_G, "bit") or require("bit32")
  local band, bor, bxor = library.band, library.bor, library.bxor
  function M.band(a, b) return band(a, b) % 0x100000000 end
  function M.bor(a, b) return bor(a, b) % 0x100000000 end
  function M.bxor(a, b) return bxor(a, b) % 0x100000000 end
end

return M
