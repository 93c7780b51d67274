-- SPDX-License-Identifier: GPL-2.0-or-later
-- Datagrams that the recorder holds twice.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local repeats_of = require("yapp.serial.repeats")

local T = {}

local HEAD = "YP\1\0\16\2\0\0" -- a header up to the ID

-- Which copy each packet { seconds, bytes, stream } is, 0 for none; from a time on they can be judged.
local function found(rows, from, key_of_pairs)
  local repeats, list = repeats_of.new(function(time) return time >= (from or 0) end), {}
  if key_of_pairs then repeats:expect_pairs(key_of_pairs) end
  for i, row in ipairs(rows) do
    list[i] = repeats:copy_number { time = row[1], bytes = row[2], stream = row[3] or "stream" }
  end
  return list, repeats
end

function T.test_a_header_proves_a_copy()
  lu.assertEquals(found { { 0, HEAD }, { 0.0199, HEAD }, { 0.0001, HEAD } }, { 0, 1, 2 })
  lu.assertEquals(found { { 0, "x" .. HEAD .. "y" }, { 0.001, "x" .. HEAD .. "y" } }, { 0, 1 })
  lu.assertEquals(found { { 0, HEAD:sub(1, 7) }, { 0.001, HEAD:sub(1, 7) } }, { 0, 0 })
  lu.assertEquals(found { { 0, ("YP"):rep(6) }, { 0.001, ("YP"):rep(6) } }, { 0, 0 }) -- of no ID
  lu.assertEquals(found { { 0, "YPE" .. HEAD }, { 0.001, "YPE" .. HEAD } }, { 0, 1 })
  lu.assertEquals(found { { 0, HEAD }, { 0.02, HEAD } }, { 0, 0 })
  lu.assertEquals(found { { 0.02, HEAD }, { 0, HEAD } }, { 0, 0 })
  lu.assertEquals(found { { 0, HEAD }, { 0.001, HEAD, "another" } }, { 0, 0 })
  lu.assertEquals(found({ { 0, HEAD }, { 0.001, HEAD }, { 0.002, HEAD } }, 0.001), { 0, 0, 1 })
end

-- The packet behind an original that came twice is expected twice, and no oftener.
function T.test_what_is_behind_a_copy()
  lu.assertEquals(found { { 0, HEAD }, { 0, HEAD }, { 0.001, "p" }, { 0.001, "p" }, { 0.001, "p" } }, { 0, 1, 0, 1, 0 })
  lu.assertEquals(found { { 0, HEAD }, { 0.001, "p" }, { 0.001, "p" } }, { 0, 0, 0 })
  lu.assertEquals(found { { 0, "p" }, { 0, "p" } }, { 0, 0 })
  lu.assertEquals(found({ { 0, "p" }, { 0, "p" }, { 0, "q" }, { 0, "q" } }, 0, "stream"), { 0, 1, 0, 1 })
end

-- Originals are known for 20 ms, and not much longer.
function T.test_what_is_kept()
  lu.assertEquals(found { { 0, "a" }, { 0.015, HEAD }, { 0.021, "b" }, { 0.022, HEAD } }, { 0, 0, 0, 1 })
  local rows = {}
  for i = 1, 100 do rows[i] = { i / 100, "p" .. i } end
  local _, repeats = found(rows)
  local count, stream = 0, repeats.by_stream.stream
  for _, kept in ipairs { stream.recent, stream.older } do
    for _ in pairs(kept) do count = count + 1 end
  end
  lu.assertTrue(count >= 2 and count <= 6, count)
end

return T
