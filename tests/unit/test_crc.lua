-- SPDX-License-Identifier: GPL-2.0-or-later
-- CRC-32K against the document's worked example and the check value worked out bit by bit.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local bytes = require("support").bytes
local crc = require("yapp.wire.crc")

local T = {}

function T.test_document_example()
  local frame = bytes("59 50 00 00 10 02 00 00 20 00 00 00 FD7FFD7FFD7FFD7FF5AFFD7F1801 00000140 00000000" ..
    "E38CD23CE04E0000 05 FF")
  lu.assertEquals(crc.of(frame), 0xC76FBEBB)
end

function T.test_empty_is_the_initial_value()
  lu.assertEquals(crc.of(""), 0xFFFFFFFF)
end

-- The definition, one bit at a time, in arithmetic only.
local function bitwise(data)
  local register = 0xFFFFFFFF
  for i = 1, #data do
    local byte = data:byte(i)
    for bit = 7, 0, -1 do
      local top = (register >= 2 ^ 31) ~= (math.floor(byte / 2 ^ bit) % 2 == 1)
      register = (register * 2) % 2 ^ 32
      if top then
        local result, place, a, b = 0, 1, register, 0x32C00699
        for _ = 1, 32 do
          if a % 2 ~= b % 2 then result = result + place end
          a, b, place = math.floor(a / 2), math.floor(b / 2), place * 2
        end
        register = result
      end
    end
  end
  return register
end

function T.test_every_length_against_the_definition()
  local data = {}
  for n = 1, 40 do
    data[n] = string.char((n * 73 + 11) % 256)
    local s = table.concat(data)
    lu.assertEquals(crc.of(s), bitwise(s), "length " .. n)
  end
end

function T.test_in_pieces()
  local s = bytes("59500000100200002000000001020304")
  for cut = 0, #s do
    lu.assertEquals(crc.update(crc.update(crc.INITIAL, s, 1, cut), s, cut + 1, #s), crc.of(s))
  end
end

return T
