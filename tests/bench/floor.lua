-- SPDX-License-Identifier: GPL-2.0-or-later
-- The least that a Lua dissector can cost on the benchmark's yapp.pcap: what is above it is the plugin's own.
--   tshark -X lua_script:floor.lua -X lua_script1:LEVEL -r yapp.pcap ...
--
--   empty    the call alone
--   columns  id, number and bytes read, Protocol and Info set: the floor of a packet list
--   asked    and what the plugin asks besides: where the frame lies and how long it was; and its column Source
--   gated    columns, and in the last frame of a message one item, if it is wanted: the floor of a filter
--   tree     columns, and in the last frame of a message its 69 items: the floor of -V
local LEVELS = { empty = true, columns = true, asked = true, gated = true, tree = true }
local level = ...
if not LEVELS[level] then return end -- run by Wireshark, in a plugin folder

local END = 0x840C000 -- of Motor Data

local floor = Proto("floor", "Floor")
local fields = {}
for i = 1, 69 do fields[i] = ProtoField.uint32("floor.f" .. i, "Field " .. i) end
floor.fields = fields
local bytes = 0

local function add_items(tree, tvb, number, count)
  local item = tree:add(floor, tvb())
  local range = tvb(0, 4)
  for i = 1, count do item:add(fields[i], range, number) end
end

function floor.dissector(tvb, pinfo, tree)
  if level == "empty" then return 8 end
  local id, number, data = pinfo.match_uint, pinfo.number, tvb:raw()
  bytes = bytes + #data
  local columns, length = pinfo.cols, 8
  columns.protocol = "YAPP"
  if level == "asked" then
    bytes, length = bytes + tvb:offset() + tvb:len(), tvb:reported_len()
    columns.src = "0x210"
  end
  columns.info = "Motor Data  fragment 2 of 5"
  if id >= END then
    if level == "tree" then
      add_items(tree, tvb, number, #fields)
    elseif level == "gated" and tree:referenced(fields[1]) then
      add_items(tree, tvb, number, 1)
    end
  end
  return length
end

DissectorTable.get("can.extended_id"):add("138428416-138477567", floor)
