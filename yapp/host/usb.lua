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

local is_watching = false

--- Hand on each packet of USB from now on.  Call it once or more.
-- proto    Proto for the watch
-- hand_on  function(kind, tvb, pinfo, tree): kind of serial.usb
function M.watch(proto, hand_on)
  if is_watching then return end
  is_watching = true
  local encapsulations, inner, kind_of = DissectorTable.get("wtap_encap"), {}, {}
  function proto.dissector(tvb, pinfo, tree)
    local encapsulation = pinfo.match_uint
    local ok, length = pcall(inner[encapsulation].call, inner[encapsulation], tvb, pinfo, tree)
    hand_on(kind_of[encapsulation], tvb, pinfo, tree)
    return ok and length or tvb:len()
  end
  for _, row in ipairs(KINDS) do
    local encapsulation = row[1]
    inner[encapsulation] = encapsulation and encapsulations:get_dissector(encapsulation)
    if inner[encapsulation] then
      kind_of[encapsulation] = row[2]
      encapsulations:add(encapsulation, proto)
    end
  end
end

return M
