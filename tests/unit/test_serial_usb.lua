-- SPDX-License-Identifier: GPL-2.0-or-later
-- Packets of usbmon and USBPcap: which bytes of a serial line they have.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local le = require("stream_generator").little_endian
local usb = require("yapp.serial.usb")

local T = {}

local CONTROL, BULK, INTERRUPT = 2, 3, 1

-- A packet of each kind: of a transfer, in or out, with data.
local KINDS = {}

local function usbmon(rest)
  return function(transfer, endpoint, data, bus, device, length)
    local event = endpoint >= 0x80 and "C" or "S"
    return ("\9"):rep(8) .. event .. string.char(transfer, endpoint, device or 6) .. le(bus or 1, 2) .. "-" ..
      (data == "" and ">" or "\0") .. ("\1"):rep(16) .. le(length or #data, 4) .. le(#data, 4) ..
      ("\0"):rep(8 + rest) .. data
  end
end

KINDS.usbmon, KINDS.usbmon_mapped = usbmon(0), usbmon(16)

function KINDS.usbpcap(transfer, endpoint, data, bus, device, length)
  return le(28, 2) .. ("\9"):rep(8) .. ("\0"):rep(6) .. (endpoint >= 0x80 and "\1" or "\0") .. le(bus or 1, 2) ..
    le(device or 6, 2) .. string.char(endpoint, transfer) .. le(length or #data, 4) .. "\3" .. data
end

-- The lines and bytes of packets.
local function lines_of(kind, packets)
  local self, list = usb.new(), {}
  for i, packet in ipairs(packets) do
    local part = self:read_packet(kind, packet)
    list[i] = part and part.name .. " " .. part.bytes .. (part.length > #part.bytes and " ..." or "") or "nothing"
  end
  return list
end

local function each_kind(run)
  for kind, make in pairs(KINDS) do run(kind, make) end
end

function T.test_bytes_of_a_line()
  each_kind(function(kind, make)
    lu.assertEquals(lines_of(kind, {
      make(BULK, 0x81, "abc"), make(BULK, 0x01, "def"), make(BULK, 0x82, "x", 2, 127),
      make(BULK, 0x81, "ab", 1, 6, 3), make(BULK, 0x81, ""), make(INTERRUPT, 0x82, "abc"), make(CONTROL, 0x80, "abc"),
      make(BULK, 0x81, "abc"):sub(1, 20), "",
    }), { "usb1.6.1#rx abc", "usb1.6.1#tx def", "usb2.127.2#rx x", "usb1.6.1#rx ab ...", "nothing", "nothing",
      "nothing", "nothing", "nothing" })
  end)
end

-- What a transfer asks for has no data, whatever its length says.
function T.test_what_is_only_asked_for()
  for _, kind in ipairs { "usbmon", "usbmon_mapped" } do
    local asked = KINDS[kind](BULK, 0x81, "abc"):gsub("C", "S", 1)
    lu.assertEquals(lines_of(kind, { asked }), { "nothing" })
  end
end

local function status(data, size, modem)
  local parts = {}
  for at = 1, math.max(#data, 1), size - 2 do
    parts[#parts + 1] = modem .. "\96" .. data:sub(at, at + size - 3)
  end
  return table.concat(parts)
end

-- Other adapters may send bytes that look like a status: not all their packets do.
function T.test_status_of_ftdi()
  local long = ("0123456789"):rep(60)
  each_kind(function(kind, make)
    for modem, size in pairs { ["\1"] = 64, ["\241"] = 64, ["\2"] = 512 } do
      for _, data in ipairs { "abc", long, "", long:sub(1, size - 2) } do
        local found = lines_of(kind, { make(BULK, 0x81, status(data, size, modem)), make(BULK, 0x02, "out") })
        lu.assertEquals(found, { "usb1.6.1#rx " .. data, "usb1.6.2#tx out" })
      end
    end
    lu.assertEquals(lines_of(kind, { make(BULK, 0x81, "YP1"), make(BULK, 0x81, "\1\96abc") }),
      { "usb1.6.1#rx YP1", "usb1.6.1#rx \1\96abc" })
  end)
end

return T
