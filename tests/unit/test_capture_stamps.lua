-- SPDX-License-Identifier: GPL-2.0-or-later
-- Time stamps that are coarse, and a clock that is set forward.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local PACKET = require("yapp.base.frame_key").PACKET
local stamps_of = require("yapp.capture.stamps")

local T = {}

-- Add messages { stamp, controller's clock or nil } of one source; return their even times, "-" for one that waits.
local function add(stamps, rows)
  local list, before, clock = {}, nil, nil
  for i, row in ipairs(rows) do
    local time = stamps:add(row[1], i * PACKET, row[2] and before, before and row[2] and row[2] - clock)
    list[i] = time or "-"
    if row[2] then before, clock = time or row[1], row[2] end
  end
  return list
end

function T.test_a_clock_that_is_set()
  local stamps = stamps_of.new()
  local rows = { { 0, 5 }, { 1, 6 }, { 101.5 }, { 102, 7 }, { 103, 8 }, { 103.5 } }
  lu.assertEquals(add(stamps, rows), { 0, 1, "-", 2, 3, 3.5 })
  lu.assertEquals(stamps.sets, { { to = 101.5, length = 100, number = 3, stop = math.huge } })
  lu.assertEquals({ stamps:even(101, 2), stamps:even(101.5, 3), stamps:are_coarse() }, { 101, 1.5, false })
  stamps:reset()
  lu.assertEquals({ stamps.sets, stamps:even(200, 5) }, { {}, 200 })
end

-- To what it was, or less: then it is still ahead, and no length contains that.
function T.test_a_clock_that_is_set_back()
  for back, even in pairs { [3] = 3, [53] = -47 } do
    local rows = { { 0, 5 }, { 1, 6 }, { 102, 7 }, { back, 8 }, { back + 1, 9 } }
    lu.assertEquals(add(stamps_of.new(), rows), { 0, 1, 2, even, even + 1 })
  end
end

function T.test_gaps_without_a_step()
  for _, rows in ipairs {
    { { 0, 5 }, { 1, 6 }, { 101, 106 } }, -- all waited
    { { 0, 5 }, { 1, 6 }, { 11, 6.5 } }, -- 9.5 s, too little
    { { 0, 50 }, { 1, 51 }, { 101, 2 }, { 104, 5 } }, -- the controller was off
    { { 0 }, { 100 }, { 103 } }, -- nobody has a clock
  } do
    local stamps = stamps_of.new()
    add(stamps, rows)
    lu.assertEquals(stamps.sets, {})
    lu.assertNil(stamps.gap and stamps.gap.to == 100 and "it waits for ever")
  end
end

-- One of 100 messages may have the stamp of the one before.
function T.test_coarse_stamps()
  for last, is_coarse in pairs { [98] = true, [99] = false } do
    local rows, stamps = { { 0, 0 }, { 0, 0.1 } }, stamps_of.new()
    for i = 1, last do rows[#rows + 1] = { i, i } end
    add(stamps, rows)
    lu.assertEquals(stamps:are_coarse(), is_coarse)
  end
  local stamps = stamps_of.new()
  add(stamps, { { 0, 0 }, { 0, 90 }, { 0, 0.1 }, { 0, 0.1 } }) -- two controllers; the same clock
  lu.assertFalse(stamps:are_coarse())
end

return T
