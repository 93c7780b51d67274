-- SPDX-License-Identifier: GPL-2.0-or-later
-- The packets of USB.  Wireshark's API.
--
-- Nothing hands a serial adapter's bytes to YAPP: usb.bulk takes no Decode As, and for FTDI's
-- adapters Wireshark asks its own dissector alone.  So a watch in front of USB hands on each packet
-- when Wireshark has shown it.  It costs about 2 µs a packet, so it runs only where YAPP is looked
-- for.

local M = {}

-- The kinds of packets: encapsulation of Wireshark, name of serial.usb.
local KINDS = {
  { wtap.USB_LINUX, "usbmon" },
  { wtap.USB_LINUX_MMAPPED, "usbmon_mapped" },
  { wtap.USBPCAP, "usbpcap" },
}

-- A dissector of Wireshark's may throw past Lua at damaged or truncated packets.  Each time Lua
-- loses one of its 200 nested calls for good.  So the watch ends after this many.
local MAX_THROWN = 24

local encapsulations = DissectorTable.get("wtap_encap")
local inner, kind_of = {}, {} -- by encapsulation: its dissector, its kind
local is_watching, is_ended, thrown = false, false, 0

local function stop()
  is_ended = true
  for encapsulation, dissector in pairs(inner) do encapsulations:add(encapsulation, dissector) end
end

-- Let Wireshark dissect a packet.
local function show(dissector, tvb, pinfo, tree)
  thrown = thrown + 1
  if thrown == MAX_THROWN and not is_ended then stop() end
  local ok, length = pcall(dissector.call, dissector, tvb, pinfo, tree)
  thrown = thrown - 1
  return ok and length or tvb:len()
end

--- Return notes on packets that were not examined: a list of texts.
function M.notes()
  if not is_ended then return {} end
  local text = "Wireshark failed at %d USB packets: those behind them were not searched"
  return { text:format(MAX_THROWN) }
end

--- Hand on each packet of USB from now on.  Call it once or more.
-- proto      Proto for the watch
-- on_packet  function(kind, tvb, pinfo, tree): kind of serial.usb
function M.watch(proto, on_packet)
  if is_watching then return end
  is_watching = true
  function proto.dissector(tvb, pinfo, tree)
    local encapsulation = pinfo.match_uint
    local length = show(inner[encapsulation], tvb, pinfo, tree)
    on_packet(kind_of[encapsulation], tvb, pinfo, tree)
    return length
  end
  for _, row in ipairs(KINDS) do
    local encapsulation, kind = row[1], row[2]
    local dissector = encapsulation and encapsulations:get_dissector(encapsulation)
    if dissector then
      inner[encapsulation], kind_of[encapsulation] = dissector, kind
      encapsulations:add(encapsulation, proto)
    end
  end
end

return M
