-- SPDX-License-Identifier: GPL-2.0-or-later
-- The oracle for programs: lua5.4 can_verdicts.lua FOLDER, with the repository's top; it reads lines and
-- writes one for each frame.
--
-- In: "ID=SIZE ..." of the known messages; then for each frame "BUS CAN_ID ACCEPTS_ALL REPORTED DATA",
-- numbers decimal, "-" for the CAN id of one that is no extended data frame, and behind x the captured
-- bytes in hex.
-- Out: "WHAT ANOMALIES IN_NUMBER MEMBERS PADDING IS_UNSURE", lists with commas, "-" for none.
if not arg then return end -- run by Wireshark, in a plugin folder

package.path = arg[1] .. "/?.lua;" .. arg[1] .. "/tests/unit/?.lua;" .. package.path
local oracle = require("can_oracle")

local known, frames = {}, {}
for id, size in io.read("*l"):gmatch("(%d+)=(%d+)") do known[tonumber(id)] = tonumber(size) end
for line in io.lines() do
  local bus, can_id, all, reported, hex = line:match("^(%d+) (%S+) (%d) (%d+) x(%x*)$")
  frames[#frames + 1] = {
    number = #frames + 1,
    time = #frames / 1000,
    bus = tonumber(bus),
    can_id = tonumber(can_id),
    accepts_all = all == "1",
    reported = tonumber(reported),
    data = hex:gsub("%x%x", function(byte) return string.char(tonumber(byte, 16)) end),
  }
end

local function list(items)
  return items and items[1] and table.concat(items, ",") or "-"
end

for _, verdict in ipairs(oracle.verdicts(frames, known)) do
  print(verdict.what, list(verdict.anomalies), verdict.in_number or "-", list(verdict.members),
    verdict.padding or "-", verdict.is_unsure and 1 or 0)
end
