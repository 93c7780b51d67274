-- SPDX-License-Identifier: GPL-2.0-or-later
-- Bit operations: unsigned in every Lua.
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

function T.test_rows()
  for i, row in ipairs(ROWS) do
    local a, b = row[1], row[2]
    local found = { bits.band(a, b), bits.bxor(a, b), bits.bor(a, b) }
    lu.assertEquals(found, { row[3], row[4], row[5] }, "row " .. i)
  end
end

return T
