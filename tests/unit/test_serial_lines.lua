-- SPDX-License-Identifier: GPL-2.0-or-later
-- The lines of packets, and their sources.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local lines = require("yapp.serial.lines")

local TCP, UDP = 2, 3 -- pinfo.port_type
local COMMAND, MOTOR = { name = "command" }, { name = "motor", answers = "command" }

local function new(named)
  local types = { messages = { COMMAND, MOTOR } }
  function types.type_of(_, id) return ({ [0] = COMMAND, [0x210] = MOTOR })[id] end
  types.sources = { names_bus = function(_, bus) return bus == named end }
  function types.new_source(_, id, bus_key, bus) return { id = id, bus_key = bus_key, bus = bus } end
  return lines.new(types, { name = function(_, bus) return "if" .. (bus or 0) end })
end

local T = {}

-- A controller is its address, whoever talks with it and by which port; it receives Commands.
function T.test_sources_in_udp_and_tcp()
  for _, kind in ipairs { UDP, TCP } do
    local self = new()
    local there = self:of(kind, "10.0.0.1", 4001, "10.0.0.9", 50000)
    local again = self:of(kind, "10.0.0.1", 4001, "10.0.0.9", 50001)
    local back = self:of(kind, "10.0.0.9", 50000, "10.0.0.1", 4001)
    lu.assertIs(self:of(kind, "10.0.0.1", 4001, "10.0.0.9", 50000), there)
    lu.assertIs(there.conversation, back.conversation)
    lu.assertFalse(there.conversation == again.conversation)
    local motor, command = self:source(there, 0x210), self:source(back, 0)
    lu.assertEquals({ motor.bus, command.bus, command.bus_key }, { "10.0.0.1", there.label, motor.bus_key })
    lu.assertIs(self:source(again, 0x210), motor)
    lu.assertEquals(self:source(back, 0x123).bus, "10.0.0.9")
    lu.assertEquals({ there.is_tcp, there.is_datagram, there.has_address }, { kind == TCP, kind == UDP, true })
  end
end

function T.test_ports_that_the_user_names()
  for address, bus in pairs { ["10.0.0.1"] = "10.0.0.1:4001", ["fe80::1"] = "[fe80::1]:4001" } do
    local self = new(bus)
    local named = self:of(UDP, address, 4001, "10.0.0.9", 50000)
    local other = self:of(UDP, address, 4002, "10.0.0.9", 50000)
    lu.assertEquals({ self:source(named, 0x210).bus, self:source(other, 0x210).bus }, { bus, address })
    local back = self:of(UDP, "10.0.0.9", 50000, address, 4001)
    lu.assertEquals(self:source(back, 0).bus, bus)
  end
end

function T.test_serial_lines_and_dumps()
  local self = new()
  lu.assertFalse(self.has_serial)
  local first, second = self:of(0, "", 0, "", 0, 1), self:of(0, "", 0, "", 0, 2)
  local only = self:of(0, "", 0, "", 0) -- the only interface needs no label
  lu.assertEquals({ first.bus, second.bus, only.bus }, { "if1", "if2", "if0" })
  lu.assertEquals({ first.bus_key, second.bus_key, first.has_address }, { "serial", "serial", false })
  lu.assertEquals({ first.label, second.label, only.label }, { "if1", "if2" })
  for bus = 0, 1 do lu.assertFalse(self:of(0, "", 0, "", 0, bus) == only) end
  lu.assertTrue(self.has_serial)
  lu.assertTrue(self:of(UDP, "", 0, "", 0).is_complete)
  lu.assertEquals(self:source(first).bus, "if1") -- of bytes of no frame
  lu.assertIs(self:source(first, 0x210).skipped, self:source(first))
  local adapter = self:of_adapter("usb1.6.1#rx", "usb1.6")
  lu.assertIs(self:of_adapter("usb1.6.1#rx", "usb1.6"), adapter)
  lu.assertEquals({ adapter.bus, adapter.bus_key, adapter.has_address }, { "usb1.6.1#rx", "usb1.6", true })
end

return T
