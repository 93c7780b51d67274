-- SPDX-License-Identifier: GPL-2.0-or-later
-- The CAN ids for which SocketCAN calls YAPP.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")

local T = {}

local added, ids -- { [CAN id] = true }, as SocketCAN's table has them

function T.setUp()
  added = {}
  _G.DissectorTable = { get = function(name)
    lu.assertEquals(name, "can.extended_id")
    return { add = function(_, key, proto)
      lu.assertEquals(proto, "yapp")
      local first, last = tostring(key):match("^(%d+)-?(%d*)$")
      for id = tonumber(first), tonumber(last) or tonumber(first) do added[id] = true end
    end }
  end }
  package.loaded["yapp.host.can_ids"] = nil
  ids = require("yapp.host.can_ids").new("yapp")
end

function T.tearDown() _G.DissectorTable = nil end

local function has(id, ctrl, seq) return added[id * 0x40000 + ctrl * 0x4000 + seq] or false end

function T.test_starts_of_every_id()
  local count = 0
  for _ in pairs(added) do count = count + 1 end
  for id = 0, 0x7FF do lu.assertTrue(has(id, 1, 0), id) end
  lu.assertEquals(count, 0x800)
end

function T.test_an_id_of_a_message()
  ids:register_id(0x210)
  for ctrl = 0, 3 do
    for seq = 0, 255 do lu.assertTrue(has(0x210, ctrl, seq)) end
  end
  lu.assertEquals({ has(0x210, 4, 0), has(0x211, 1, 1) }, { false, false })
end

-- Of an unknown ID all Starts once one came, and the Middles and Ends of the Seq Nos that came.
function T.test_an_unknown_id()
  for _, seq in ipairs { 7, 9, 7 } do ids:register_start(0x300, seq) end
  for seq = 0, 255 do
    lu.assertEquals({ has(0x300, 0, seq), has(0x300, 1, seq) }, { false, true }, seq)
    for ctrl = 2, 3 do lu.assertEquals(has(0x300, ctrl, seq), seq == 7 or seq == 9, seq) end
  end
  ids:register_id(0x210)
  added = {}
  ids:register_start(0x210, 7)
  lu.assertEquals(added, {})
end

-- Of the 65th and later ones the next Starts alone.
function T.test_many_unknown_ids()
  local function last_start(id)
    local last = 0
    while has(id, 1, last + 1) do last = last + 1 end
    for seq = last + 2, 255 do lu.assertFalse(has(id, 1, seq), seq) end
    return last
  end
  for id = 0x300, 0x33F do ids:register_start(id, 0) end
  lu.assertEquals({ last_start(0x300), last_start(0x33F) }, { 255, 255 })
  for _, seq in ipairs { 0, 1, 2, 15, 16, 17, 30, 100, 222, 223, 224, 254, 255 } do
    ids:register_start(0x340, seq)
    lu.assertTrue(last_start(0x340) >= math.min(seq + 16, 255), seq)
    lu.assertTrue(last_start(0x340) <= seq + 32, seq)
  end
  ids:register_start(0x341, 0)
  ids:register_start(0x341, 240)
  lu.assertEquals(last_start(0x341), 255)
end

return T
