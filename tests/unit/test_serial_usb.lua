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

local function device_descriptor(vendor)
  return "\18\1\0\2\0\0\0\64" .. le(vendor, 2) .. ("\1"):rep(8)
end

local function configuration(endpoint, size)
  return "\9\2\32\0\1\1\0\160\45" .. "\9\4\0\0\1\255\255\255\0" ..
    "\7\5" .. string.char(endpoint) .. "\2" .. le(size, 2) .. "\0"
end

-- The lines and bytes of packets.
local function lines_of(kind, packets)
  local self, list = usb.new(), {}
  for i, packet in ipairs(packets) do
    local part = self:read_packet(kind, packet)
    list[i] = part and part.line.name .. " " .. part.bytes .. (part.truncated and " ..." or "") or "nothing"
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

function T.test_the_other_direction()
  each_kind(function(kind, make)
    local self = usb.new()
    for endpoint, name in pairs { [0x81] = "rx", [0x01] = "tx" } do
      local line = self:read_packet(kind, make(BULK, endpoint, "abc")).line
      local other = name == "rx" and "tx" or "rx"
      lu.assertEquals({ line.name, line.opposite }, { "usb1.6.1#" .. name, "usb1.6.1#" .. other })
      lu.assertIs(self:read_packet(kind, make(BULK, endpoint, "def")).line, line)
    end
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

function T.test_status_of_ftdi()
  local long = ("0123456789"):rep(60)
  each_kind(function(kind, make)
    local function descriptors(vendor, size)
      return make(CONTROL, 0x80, device_descriptor(vendor)), make(CONTROL, 0x80, configuration(0x81, size))
    end
    local device, endpoint = descriptors(0x0403, 512)
    for _, row in ipairs {
      { { device, endpoint }, 512, "\2" }, { { descriptors(0x0403, 64) }, 64, "\1" },
      { { descriptors(0x0403, 64) }, 64, "\241" }, { { descriptors(0x0403, 64) }, 64, "\2" },
      { { descriptors(0x0403, 64) }, 64, "\0" }, { { descriptors(0x0403, 512 + 0x800) }, 512, "\2" },
      { { make(CONTROL, 0x80, "\18\3" .. ("x"):rep(16)) }, 64, "\1" }, -- a text of 18 bytes is no device
      { { device, make(CONTROL, 0x80, "\4\3ab" .. configuration(0x81, 512):sub(-7)) }, 64, "\0" }, -- no endpoint
      { {}, 64, "\1" }, { {}, 512, "\50" }, { { device }, 512, "\2" }, -- the status says it
    } do
      local packets = row[1]
      for _, data in ipairs { "abc", long, "", long:sub(1, row[2] - 2) } do
        packets[#packets + 1] = make(BULK, 0x81, status(data, row[2], row[3]))
      end
      packets[#packets + 1] = make(BULK, 0x02, "out")
      local found = lines_of(kind, packets)
      lu.assertEquals(table.concat(found, "|", #found - 4), table.concat({ "usb1.6.1#rx abc",
        "usb1.6.1#rx " .. long, "usb1.6.1#rx ", "usb1.6.1#rx " .. long:sub(1, row[2] - 2), "usb1.6.2#tx out" }, "|"))
    end
  end)
end

-- Other adapters may send bytes that look like a status.
function T.test_bytes_that_look_like_a_status()
  each_kind(function(kind, make)
    lu.assertEquals(lines_of(kind, { make(CONTROL, 0x80, device_descriptor(0x10C4)), make(BULK, 0x81, "\1\96abc") }),
      { "nothing", "usb1.6.1#rx \1\96abc" })
    lu.assertEquals(lines_of(kind, { make(BULK, 0x81, "\1\128abc") }), { "usb1.6.1#rx \1\128abc" })
    lu.assertEquals(lines_of(kind, { make(BULK, 0x81, "YP1"), make(BULK, 0x81, "\1\96abc"), make(BULK, 0x81, "\1") }),
      { "usb1.6.1#rx YP1", "usb1.6.1#rx \1\96abc", "usb1.6.1#rx \1" })
  end)
end

-- While no line is known, only what may begin a frame or describes a device is read.
function T.test_packets_of_others()
  local noise = ("x"):rep(200)
  each_kind(function(kind, make)
    local split = status(("x"):rep(61) .. "YP" .. noise, 64, "\1")
    for data, is_of_others in pairs {
      [noise] = true, [("Y"):rep(3) .. "x"] = true, ["YxxP" .. noise] = true,
      ["YP"] = false, [noise .. "YP" .. noise] = false, ["xY"] = false, [split] = false, ["\1\96Y"] = false,
    } do
      lu.assertEquals({ data, usb.is_of_others(kind, make(BULK, 0x81, data)) }, { data, is_of_others })
    end
    lu.assertFalse(usb.is_of_others(kind, make(CONTROL, 0x80, "abc")))
    lu.assertTrue(usb.is_of_others(kind, make(INTERRUPT, 0x82, "YP")))
    lu.assertTrue(usb.is_of_others(kind, ""))
  end)
end

function T.test_descriptors_that_are_damaged()
  each_kind(function(kind, make)
    for _, bytes in ipairs { "\0\1", "\18\1", "\9\2\32\0\7\5", "\7\5\129\2", ("\0"):rep(40), "\2\2\2\2\2", "\1" } do
      lu.assertEquals(lines_of(kind, { make(CONTROL, 0x80, bytes), make(BULK, 0x81, "abc") })[2], "usb1.6.1#rx abc")
    end
  end)
end

return T
