-- SPDX-License-Identifier: GPL-2.0-or-later
-- The addresses of packets as numbers: Wireshark shows them by name if the user has switched on
-- name resolution.  Wireshark's API.

local M = {}

local Addresses = {}
Addresses.__index = Addresses

--- Make the addresses of a capture.
function M.new()
  return setmetatable({ numbers = {} }, Addresses) -- [text of Wireshark's] = as a number
end

local function ipv4_text(number)
  local texts = {}
  for i = 4, 1, -1 do
    texts[i] = ("%d"):format(number % 256)
    number = (number - number % 256) / 256
  end
  return table.concat(texts, ".")
end

-- Return an address as a number: Wireshark compares addresses by their bytes, whatever they are
-- called.  Return nil for one that is no IPv4 address.
local function find_number(address)
  local low, high = 0, 2 ^ 32 - 1
  while low < high do
    local middle = math.floor((low + high) / 2)
    if Address.ip(ipv4_text(middle)) < address then low = middle + 1 else high = middle end
  end
  local text = ipv4_text(low)
  return Address.ip(text) == address and text or nil
end

--- Return the text of an address, as a number if it is one of IPv4.
function Addresses:text(address)
  local text = tostring(address)
  local number = self.numbers[text]
  if not number then
    local is_number = text == "" or text:find("^[%d.]+$") or text:find(":", 1, true)
    number = not is_number and find_number(address) or text
    self.numbers[text] = number
  end
  return number
end

return M
