-- SPDX-License-Identifier: GPL-2.0-or-later
-- Whether the first packets of a capture file have different time stamps.  Pure Lua.
--
-- A recorder without a clock gives all packets one stamp.  So packets with the stamp of the first
-- one may have come at once, or at any time, until another stamp is known.

local M = {}

local byte, sub = string.byte, string.sub

-- Return a number of four bytes.
local function number_at(head, index, is_little)
  local a, b, c, d = byte(head, index, index + 3)
  if is_little then a, b, c, d = d, c, b, a end
  return ((a * 256 + b) * 256 + c) * 256 + d
end

-- Return an iterator over the stamps, as their bytes, of the packets of pcap.
local function pcap_stamps(head, is_little)
  local index = 25
  return function()
    if index + 15 > #head then return nil end
    local stamp = sub(head, index, index + 7)
    index = index + 16 + number_at(head, index + 8, is_little)
    return stamp
  end
end

local PACKET = 6 -- the kind of a block

-- Return the same of the packets of the first interface of pcapng: others may have other units.
local function pcapng_stamps(head)
  local is_little = sub(head, 9, 12) == "\77\60\43\26"
  local index, interface = 1, nil
  return function()
    while index + 19 <= #head do
      local at, kind = index, number_at(head, index, is_little)
      local length = number_at(head, index + 4, is_little)
      if length < 12 then return nil end
      index = index + length + -length % 4
      if kind == PACKET then
        interface = interface or sub(head, at + 8, at + 11)
        if sub(head, at + 8, at + 11) == interface then return sub(head, at + 12, at + 19) end
      end
    end
  end
end

local READERS = {
  ["\212\195\178\161"] = pcap_stamps,
  ["\77\60\178\161"] = pcap_stamps,
  ["\161\178\195\212"] = pcap_stamps,
  ["\161\178\60\77"] = pcap_stamps,
  ["\10\13\13\10"] = pcapng_stamps,
}

--- Return whether two packets have different stamps; nil for a file of another format.
-- head  the first bytes of the file
function M.differ(head)
  local magic = sub(head, 1, 4)
  local reader, first = READERS[magic], nil
  if not reader then return nil end
  for stamp in reader(head, byte(magic) > 64 and byte(magic) ~= 161) do
    first = first or stamp
    if stamp ~= first then return true end
  end
  return false
end

return M
