-- SPDX-License-Identifier: GPL-2.0-or-later
-- Serial lines at their USB adapter: CDC-ACM, CP210x, CH340, FTDI and others, in packets of usbmon
-- (Linux) and USBPcap (Windows).  Pure Lua.
--
-- Their bulk endpoints carry the bytes of the line as they are.  FTDI's adapters put two bytes of
-- status in front of each packet of the bus, of which a transfer may have several:
--
--   01 60 59 50 ...   62 bytes of the line behind 2 of status, then again 2 and up to 62

local little_endian = require "yapp.base.little_endian"

local Usb = {}
Usb.__index = Usb

local byte, floor, sub = string.byte, math.floor, string.sub

local BULK = 3 -- a transfer
local SUBMIT, COMPLETE = byte("S"), byte("C") -- events of usbmon
local STATUS = 2 -- bytes
local FULL_SPEED, HIGH_SPEED = 64, 512 -- the largest packet of a bulk endpoint

-- By kind of packet: function(bytes) -> { bus, device, endpoint, transfer; offset, length = of its
-- data }; nil for a packet without data that came in or went out.
local HEADERS = {}

local function usbmon(size)
  return function(bytes)
    if #bytes < size then return nil end
    local event, transfer, endpoint, device = byte(bytes, 9, 12)
    local has_data = byte(bytes, 16) == 0
    if not has_data or event ~= (endpoint >= 0x80 and COMPLETE or SUBMIT) then return nil end
    return {
      bus = little_endian(bytes, 13, 2),
      device = device,
      endpoint = endpoint,
      transfer = transfer,
      offset = size,
      length = little_endian(bytes, 33, 4),
    }
  end
end

HEADERS.usbmon = usbmon(48)
HEADERS.usbmon_mapped = usbmon(64)

function HEADERS.usbpcap(bytes)
  if #bytes < 27 then return nil end
  local endpoint, is_complete = byte(bytes, 22), byte(bytes, 17) % 2 == 1
  if is_complete ~= (endpoint >= 0x80) then return nil end
  return {
    bus = little_endian(bytes, 18, 2),
    device = little_endian(bytes, 20, 2),
    endpoint = endpoint,
    transfer = byte(bytes, 23),
    offset = little_endian(bytes, 1, 2),
    length = little_endian(bytes, 24, 4),
  }
end

--- Make the facts of a capture's devices.
function Usb.new()
  return setmetatable({
    is_plain = {}, -- by device: true if its data has no status
  }, Usb)
end

-- Return the size of FTDI's packets, by the status in front of the first one; nil for no status.
local function size_by_status(data)
  local modem, line = byte(data, 1, STATUS)
  if not line or floor(line / 2) % 16 ~= 0 or line >= 128 then return nil end
  return modem % 16 == 1 and FULL_SPEED or modem % 16 == 2 and HIGH_SPEED or nil
end

-- Return the bytes of the line in data that was received, without the status in front of each
-- packet, and whether it has one.  All that an adapter with a status sends begins with one.
local function without_status(self, device, data)
  local size = not self.is_plain[device] and size_by_status(data)
  self.is_plain[device] = not size
  if not size then return data, false end
  local parts = {}
  for offset = 0, #data - 1, size do
    parts[#parts + 1] = sub(data, offset + STATUS + 1, offset + size)
  end
  return table.concat(parts), true
end

--- Read a packet.
-- kind   of HEADERS: "usbmon", "usbmon_mapped", "usbpcap"
-- bytes  those that were captured
-- returns  nil if it has no bytes of a line, else {
--   name        of its line: usb1.6.1#rx, of endpoint 1; rx is from the adapter to the host
--   device      name of the adapter: usb1.6, of bus 1 and address 6
--   bytes       of the line, those that were captured; length = number of bytes that it had
--   start       of its data in the packet
--   has_status  true if there is more than the bytes of the line }
function Usb:read_packet(kind, bytes)
  local header = HEADERS[kind](bytes)
  local data = header and header.transfer == BULK and sub(bytes, header.offset + 1)
  if not data or data == "" then return nil end
  local endpoint, device = header.endpoint, ("usb%d.%d"):format(header.bus, header.device)
  local is_received, of_line, has_status = endpoint >= 0x80, data, false
  if is_received then of_line, has_status = without_status(self, device, data) end
  return {
    name = ("%s.%d#%s"):format(device, endpoint % 0x80, is_received and "rx" or "tx"),
    device = device,
    bytes = of_line,
    length = #of_line + header.length - #data,
    start = header.offset,
    has_status = has_status,
  }
end

return Usb
