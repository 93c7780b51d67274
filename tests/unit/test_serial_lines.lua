-- SPDX-License-Identifier: GPL-2.0-or-later
-- The lines of a capture: what tells them apart, and who shares a source.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local lines_of = require("yapp.serial.lines")

local T = {}

local TCP, UDP, SERIAL = lines_of.TCP, lines_of.UDP, 0
local A, B = "10.0.0.1", "10.0.0.2"

-- Lines, with buses named "bus 1" ... and an interface of UDP and TCP.
local function new_lines()
  return lines_of.new({ new_source = function(_, id, bus_key, bus, line)
    return { id = id, bus_key = bus_key, bus = bus, line = line }
  end }, { name = function(_, bus, is_ip) return is_ip and "eth0" or bus and "bus " .. bus or nil end })
end

function T.test_what_a_line_is()
  local lines = new_lines()
  local function shape(line)
    return { line.bus, line.label, line.has_address, line.is_ip, line.is_tcp, line.is_datagram, line.is_complete,
      line.interface or false, line.latest, line.awaited or false }
  end
  local tcp, udp = lines:of(TCP, A, 1, B, 2, nil, 5), lines:of(UDP, A, 1, B, 2, nil, 5)
  lu.assertEquals(shape(tcp), { A .. ":1", A .. ":1", true, true, true, false, false, "eth0", 5, false })
  lu.assertEquals(shape(udp), { A .. ":1", A .. ":1", true, true, false, true, false, "eth0", 5, false })
  lu.assertFalse(lines.has_serial)
  lu.assertEquals(shape(lines:of(SERIAL, "", 0, "", 0, 3)),
    { "bus 3", "bus 3", false, false, false, false, false, false, 0, false })
  lu.assertTrue(lines.has_serial)
  local dump = lines:of(UDP, "NONE", 0, "NONE", 0) -- a raw dump
  lu.assertEquals({ dump.label or "none", dump.is_datagram, dump.is_complete }, { "none", false, true })
  lu.assertEquals({ tcp.is_over, tcp.is_direct, tcp.interface }, { false, false, "eth0" })
  lu.assertEquals(lines:of(TCP, A, 1, B, 3, nil, nil).latest, 0)
end

-- Both directions know each other, and have a bus in common; UDP and TCP, and two buses, have none.
function T.test_directions()
  local lines = new_lines()
  local there, back = lines:of(TCP, A, 1, B, 2), lines:of(TCP, B, 2, A, 1)
  lu.assertEquals({ there.opposite, back.opposite }, { back.key, there.key })
  lu.assertEquals({ there.bus_key, there.trial_key }, { back.bus_key, back.trial_key })
  local udp = lines:of(UDP, A, 1, B, 2)
  lu.assertEquals({ udp.bus_key, udp.trial_key == there.trial_key }, { there.bus_key, false })
  lu.assertNotEquals(lines:of(TCP, A, 1, B, 3).bus_key, there.bus_key)
  local here = lines:of(SERIAL, "", 1, "", 2, 1)
  lu.assertEquals({ here.opposite, here.bus_key }, { lines:of(SERIAL, "", 2, "", 1, 1).key, "serial" })
  lu.assertNotEquals(lines:of(SERIAL, "", 1, "", 2, 2).key, here.key)
end

function T.test_the_same_line_again()
  local lines = new_lines()
  local line = lines:of(TCP, A, 1, B, 2, nil, 5)
  lu.assertIs(lines:of(TCP, A, 1, B, 2, nil, 7), line)
  lu.assertEquals(line.latest, 7)
  lu.assertIs(lines:of(TCP, A, 1, B, 2), line) -- a revisit has no time
  lu.assertEquals(line.latest, 7)
  local seen = { [line] = true } -- of all others none is one before
  for _, one in ipairs { { TCP, 2, 2 }, { TCP, 1, 3 }, { UDP, 1, 2 }, { TCP, 2, 1 }, { TCP, 1, 2, 1 }, { TCP, 1, 2, 2 },
    { SERIAL, 1, 2 }, { SERIAL, 1, 2, 1 }, { SERIAL, 1, 2, 2 } } do
    local other = lines:of(one[1], one[1] == SERIAL and "" or A, one[2], B, one[3], one[4], 7)
    lu.assertNil(seen[other])
    seen[other] = true
  end
  local tags = {}
  for _, ports in ipairs { { 2, 1, 0 }, { 2, 0, 1 }, { 3, 0, 0 }, { 2, 0, 65535 }, { 2, 65535, 0 } } do
    local tag = lines_of.tag(ports[1], ports[2], ports[3])
    lu.assertNil(tags[tag])
    tags[tag] = true
  end
  lu.assertEquals(line.tag, lines_of.tag(TCP, 1, 2))
end

function T.test_kinds()
  for _, row in ipairs { { TCP, A, true }, { UDP, A, true }, { SERIAL, A, false }, { UDP, "", false },
    { TCP, "NONE", false } } do
    lu.assertEquals(lines_of.is_ip(row[1], row[2]), row[3])
  end
end

-- A client that connects again from another port is the same source; one that goes on beside it is not.
function T.test_a_client_that_connects_again()
  for _, row in ipairs { { 8.1, false, true }, { 8, false, false }, { 5.1, true, true }, { nil, false, false },
    { nil, true, true } } do
    local lines = new_lines()
    local line = lines:of(TCP, A, 1, B, 2, nil, 5)
    line.is_over = row[2]
    local other = lines:of(TCP, A, 9, B, 2, nil, row[1])
    lu.assertEquals(other.bus == line.bus, row[3], tostring(row[1]))
    lu.assertEquals(lines:source(other, 7) == lines:source(line, 7), row[3])
    lu.assertNotEquals(lines:of(TCP, A, 10, B, 3, nil, 50).bus, line.bus) -- another receiver
    lu.assertNotEquals(lines:of(UDP, A, 11, B, 2, nil, 50).bus, line.bus)
  end
end

-- Who receives a sender's messages does not matter, but UDP and TCP are apart.
function T.test_sources()
  local lines = new_lines()
  local one, other = lines:of(UDP, A, 1, B, 2), lines:of(UDP, A, 1, "10.0.0.3", 2)
  local source = lines:source(one, 7)
  lu.assertEquals({ source.id, source.bus_key, source.bus, source.line == one }, { 7, one.bus_key, A .. ":1", true })
  lu.assertEquals(one.label, "…1:1")
  lu.assertIs(lines:source(other, 7), source)
  lu.assertNotEquals(lines:source(one, 8), source)
  lu.assertNotEquals(lines:source(lines:of(TCP, A, 1, B, 2), 7), source)
  lu.assertNotEquals(lines:source(lines:of(UDP, A, 2, B, 2), 7), source)
  local serial = lines:of(SERIAL, "", 0, "", 0, 3)
  lines:source(serial, 7)
  lu.assertEquals(serial.label, "bus 3") -- as it is, no shorter name
end

-- Who takes a new port for each datagram is named by the address; a port of TCP is one of a connection.
function T.test_a_sender_with_a_new_port_each_time()
  for kind, bus in pairs { [UDP] = A, [TCP] = A .. ":99" } do
    local lines = new_lines()
    for port = 1, 20 do lines:of(kind, A, port, B, port, nil, port / 5) end
    lu.assertEquals(lines:of(kind, A, 99, B, 99, nil, 5).bus, bus)
  end
end

function T.test_the_first_bytes_of_a_file_name_senders()
  local self, scanned = new_lines(), nil
  function self.senders.scan(_, bytes) scanned = bytes end
  lu.assertEquals({ self:scan("head"), scanned }, { {}, "head" })
end

function T.test_an_adapter()
  local lines, endpoint = new_lines(), { name = "1.2.3 in", opposite = "1.2.3 out", device = "1.2" }
  local line = lines:of_adapter(endpoint)
  lu.assertEquals({ line.key, line.opposite, line.bus_key, line.trial_key, line.tag, line.bus, line.label,
    line.has_address, line.is_ip }, { "1.2.3 in", "1.2.3 out", "1.2", "1.2.3 in", "1.2.3 in",
    "1.2.3 in", "1.2.3 in", true, false })
  lu.assertIs(lines:of_adapter(endpoint), line)
end

-- Of a conversation whose first frame the file has, that frame has to be read.
function T.test_conversations_that_nothing_was_read_of()
  local function unread(change)
    local lines = new_lines()
    local conversation = { is_tcp = true, from = A .. ":1", to = B .. ":2", payload = "first" }
    lines:await { conversation, { is_tcp = true, from = A .. ":1", to = B .. ":2", payload = "second" } }
    change(lines, lines:of(TCP, A, 1, B, 2))
    local list = lines:list_unread { conversation }
    lu.assertIs(list[1], #list > 0 and conversation or nil)
    return #list == 1
  end
  lu.assertTrue(unread(function() end))
  lu.assertTrue(unread(function(lines, line) lines:source(line, 7) end))
  lu.assertTrue(unread(function(_, line) lines_of.mark_read(line, { payload = "first", status = "good" }) end))
  for transfer, is_read in pairs { [{ payload = "first", status = "good" }] = true,
    [{ payload = "fi", status = "truncated" }] = true, [{ payload = "second", status = "good" }] = false } do
    lu.assertEquals(unread(function(lines, line)
      lines:source(line, 7)
      lines_of.mark_read(line, transfer)
    end), not is_read)
  end
  local lines = new_lines()
  lu.assertEquals(#lines:list_unread { { is_tcp = false, from = A .. ":1", to = B .. ":2" } }, 1)
  lines:source(lines:of(UDP, A, 1, B, 2), 7)
  lu.assertEquals(#lines:list_unread { { is_tcp = false, from = A .. ":1", to = B .. ":2" } }, 0)
end

return T
