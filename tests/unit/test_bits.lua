-- SPDX-License-Identifier: GPL-2.0-or-later
-- Bit operations: unsigned in every Lua, whatever its library gives.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local bits = require("yapp.base.bits")

local T = {}

-- a, b, both, one of them
function T.test_rows()
  local rows = {
    { 0, 0, 0, 0 }, { 0xFFFFFFFF, 0xFFFFFFFF, 0xFFFFFFFF, 0 }, { 0xFFFFFFFF, 0, 0, 0xFFFFFFFF },
    { 0x80000000, 0x80000001, 0x80000000, 1 }, { 0x40010000, 0xC0030000, 0x40010000, 0x80020000 }, { 5, 3, 1, 6 },
  }
  for i, row in ipairs(rows) do
    lu.assertEquals({ bits.band(row[1], row[2]), bits.bxor(row[1], row[2]) }, { row[3], row[4] }, "row " .. i)
  end
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
  rawset(_G, "bit", { band = signed(library.band), bxor = signed(library.bxor) })
  local again = dofile("yapp/base/bits.lua")
  rawset(_G, "bit", before)
  lu.assertEquals(again.band(0x80000001, 0xFFFFFFFF), 0x80000001)
  lu.assertEquals(again.bxor(0x80000001, 1), 0x80000000)
end

return T
