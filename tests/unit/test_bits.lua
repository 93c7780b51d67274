-- SPDX-License-Identifier: GPL-2.0-or-later
-- Bit operations: unsigned in every Lua, whatever its library gives.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local bits = require("yapp.base.bits")

local T = {}

-- a, b, both, one of them, any of them
local ROWS = {
  { 0, 0, 0, 0, 0 }, { 0xFFFFFFFF, 0xFFFFFFFF, 0xFFFFFFFF, 0, 0xFFFFFFFF },
  { 0xFFFFFFFF, 0, 0, 0xFFFFFFFF, 0xFFFFFFFF }, { 0x80000000, 0x80000001, 0x80000000, 1, 0x80000001 },
  { 0x40010000, 0xC0030000, 0x40010000, 0x80020000, 0xC0030000 }, { 5, 3, 1, 6, 7 },
}

local function check(library)
  for i, row in ipairs(ROWS) do
    local a, b = row[1], row[2]
    local found = { library.band(a, b), library.bxor(a, b), library.bor(a, b) }
    lu.assertEquals(found, { row[3], row[4], row[5] }, "row " .. i)
  end
end

function T.test_rows()
  check(bits)
end

-- Wireshark's Lua 5.2 has BitOp, with signed results; plain Lua 5.2 has no such library to test with.
function T.test_signed_library()
  if not bits.library then return end
  local library, before = bits.library, rawget(_G, "bit")
  local function signed(operation)
    return function(a, b)
      local result = operation(a, b)
      return result < 0x80000000 and result or result - 0x100000000
    end
  end
  rawset(_G, "bit", { band = signed(library.band), bor = signed(library.bor), bxor = signed(library.bxor) })
  local again = dofile("yapp/base/bits.lua")
  rawset(_G, "bit", before)
  check(again)
end

return T
