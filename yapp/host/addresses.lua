-- SPDX-License-Identifier: GPL-2.0-or-later
-- The addresses of packets as numbers: Wireshark shows them by name if the user has switched on
-- name resolution.  Wireshark's API.

local memo = require "yapp.base.memo"

local Addresses = {}
Addresses.__index = Addresses

--- Make the addresses of a capture.
function Addresses.new()
  -- Lists of { address, text = as a number }: several addresses may have one name.
  return setmetatable({ by_name = memo() }, Addresses)
end

local function ipv4_text(groups)
  return table.concat(groups, ".")
end

-- Return the text of an address of IPv6, as Wireshark has it: the longest zeros are left out.
local function ipv6_text(groups)
  local text = ":"
  for _, group in ipairs(groups) do text = ("%s%x:"):format(text, group) end
  for length = 8, 2, -1 do
    local from, to = text:find((":0"):rep(length) .. ":", 1, true)
    if from then
      text = text:sub(1, from - 1) .. "::" .. text:sub(to + 1)
      break
    end
  end
  return (text:gsub("^:([^:])", "%1"):gsub("([^:]):$", "%1"))
end

-- Find an address among those that a text makes: Wireshark compares addresses by their bytes,
-- whatever they are called.
-- make, text_of  function(text) -> an address, function(groups) -> a text
-- count, top     of the groups: their number, and the highest bit of one
-- returns        its text, nil for an address of another kind
local function find_number(address, make, text_of, count, top)
  local groups = {}
  for i = 1, count do groups[i] = 0 end
  for i = 1, count do
    local bit = top
    while bit >= 1 do
      groups[i] = groups[i] + bit
      if address < make(text_of(groups)) then groups[i] = groups[i] - bit end
      bit = math.floor(bit / 2)
    end
  end
  local text = text_of(groups)
  return make(text) == address and text or nil
end

--- Return the text of an address, as a number if it is one of IPv4 or IPv6.
function Addresses:text(address)
  local name = tostring(address)
  if name == "" or name:find("^[%d.]+$") or name:find(":", 1, true) then return name end
  local list = self.by_name[name]
  for _, known in ipairs(list) do
    if known.address == address then return known.text end
  end
  local text = find_number(address, Address.ip, ipv4_text, 4, 128) or
    find_number(address, Address.ipv6, ipv6_text, 8, 32768) or name
  table.insert(list, { address = address, text = text })
  return text
end

return Addresses
