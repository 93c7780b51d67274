-- SPDX-License-Identifier: GPL-2.0-or-later
-- The search of a capture file for conversations of YAPP behind its first bytes.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local generator = require("stream_generator")
local search = require("yapp.host.search")

local MAGIC = "\212\195\178\161"
local FRAME = generator.frame(0x210, ("x"):rep(32))

local function datagram(port, to_port)
  local ports = string.char(math.floor(port / 256), port % 256, math.floor(to_port / 256), to_port % 256)
  return "\69\0\0\76" .. ("\0"):rep(5) .. "\17\0\0" .. "\10\0\0\1\10\0\0\2" .. ports .. "\0\56\0\0" .. FRAME
end

local function found(bytes, skip)
  local path = os.tmpname()
  local file = assert(io.open(path, "wb"))
  file:write(bytes)
  file:close()
  local list = search.conversations(path, skip)
  os.remove(path)
  local words = {}
  for i, one in ipairs(list) do
    lu.assertNil(one.payload)
    words[i] = one.from .. " " .. one.to
  end
  return words
end

local T = {}
local ONE, OTHER = "10.0.0.1:502 10.0.0.2:44818", "10.0.0.1:503 10.0.0.2:44818"

function T.test_each_conversation_once_behind_the_first_bytes()
  local filling = MAGIC .. ("f"):rep(200000)
  local bytes = datagram(502, 44818)
  lu.assertEquals(found(filling .. bytes .. bytes .. datagram(503, 44818) .. bytes, 65536), { ONE, OTHER })
  lu.assertEquals(found(filling .. bytes, #filling + 30), {})
end

-- A frame wherever the file is read in pieces.
function T.test_frames_between_chunks()
  for before = 131072 - 100, 131072 + 4 do
    lu.assertEquals(found(MAGIC .. ("f"):rep(before) .. datagram(502, 44818), 4), { ONE }, before)
  end
end

-- Few frames of each chunk are looked at: one of another conversation shows in a later one.
function T.test_dense_traffic()
  local dense = {}
  for i = 1, 5000 do dense[i] = datagram(i % 50 == 0 and 503 or 502, 44818) end
  local list = found(MAGIC .. table.concat(dense), 4)
  table.sort(list)
  lu.assertEquals(list, { ONE, OTHER })
end

function T.test_files_that_are_not_searched()
  lu.assertEquals(found("\31\139\8\0" .. datagram(502, 44818), 4), {})
  lu.assertEquals(found("", 0), {})
  lu.assertEquals(search.conversations(nil, 0), {})
  lu.assertEquals(search.conversations("/no/such/file", 0), {})
end

return T
