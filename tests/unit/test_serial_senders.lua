-- SPDX-License-Identifier: GPL-2.0-or-later
-- Names of senders, and senders that take a new port for each datagram.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local generator = require("stream_generator")
local senders = require("yapp.serial.senders")

local T = {}

local V4, V6 = "192.168.1.10", "fe80::1"
local FRAME = generator.frame(0x210, ("x"):rep(32))

function T.test_names()
  lu.assertEquals(senders.name(V4, 40000), "192.168.1.10:40000")
  lu.assertEquals(senders.name(V6, 14550), "[fe80::1]:14550")
  lu.assertEquals(senders.name(V6, nil), V6)
end

-- What differs comes first, and no two senders have one short name.
function T.test_short_names()
  local self = senders.new()
  for _, row in ipairs {
    { "192.168.1.12:40000", "…12:40000" }, { "192.168.1.13:40000", "…13:40000" },
    { "192.168.1.12:40001", "…12:40001" }, { "192.168.2.12:40000", "…2.12:40000" },
    { "10.0.2.12:40000", "…0.2.12:40000" }, { "11.0.2.12:40000", "11.0.2.12:40000" },
    { "192.168.1.12:40000", "…12:40000" }, { "192.168.1.10", "…10" },
    { "192.168.1.5:40000", "…5:40000" },
    { "[fe80::1]:14550", "…1]:14550" }, { "[fe80::2:1]:14550", "…2:1]:14550" }, { "host", "host" },
  } do
    lu.assertEquals(self:shorten(row[1]), row[2])
  end
end

-- The name of a sender after a list of ports, one each 0.1 s or at the times of a second list.
local function name_after(ports, times)
  local self = senders.new()
  for i, port in ipairs(ports) do self:count_datagram(V4, port, times and times[i] or i / 10) end
  return self:name_of(V4, ports[#ports])
end

local function numbers(first, last)
  local list = {}
  for i = first, last do list[#list + 1] = i end
  return list
end

function T.test_new_ports_in_a_live_capture()
  lu.assertEquals(name_after(numbers(1, 15)), V4 .. ":15") -- so many controllers may be behind it
  lu.assertEquals(name_after(numbers(1, 16)), V4)
  local at_once = {}
  for i = 1, 16 do at_once[i] = 100 + i / 1000 end
  lu.assertEquals(name_after(numbers(1, 16), at_once), V4 .. ":16") -- 16 controllers that begin
  lu.assertEquals(name_after { 5 }, V4 .. ":5")
  local two = {}
  for i = 1, 100 do two[i] = i % 2 end
  lu.assertEquals(name_after(two), V4 .. ":0")
end

-- A datagram in the bytes of a file, behind something of a link.
local function in_ip(ip, port)
  local ports = string.char((port - port % 256) / 256, port % 256) .. "\56\214"
  return "any link" .. ip .. ports .. "\0\56\0\0" .. FRAME .. FRAME
end

local function ipv4(port, last)
  return in_ip("\69\0\0\76\0\0\0\0\64\17\0\0\192\168\1" .. string.char(last or 10) .. "\192\168\1\20", port)
end

local function ipv6(port, address)
  return in_ip("\96\0\0\0\0\56\17\64" .. address .. address, port)
end

function T.test_new_ports_in_the_first_bytes_of_a_file()
  local fe80, all = "\254\128" .. ("\0"):rep(13) .. "\1", "\32\1\13\184" .. ("\0\1"):rep(6)
  for make, address in pairs {
    [ipv4] = V4,
    [function(port) return ipv6(port, "\0\1" .. ("\0"):rep(7) .. "\5\0\6\0\7\0\8") end] = "1::5:6:7:8",
    [function(port) return ipv6(port, fe80) end] = V6,
    [function(port) return ipv6(port, all) end] = "2001:db8:1:1:1:1:1:1",
  } do
    for _, row in ipairs { -- ports, and whether they change
      { { 5, 6, 7, 9 }, true }, { { 5, 6, 7 }, false }, { { 5, 6, 7, 9, 5 }, false },
      { { 5, 5, 6, 6, 7, 7, 9, 9 }, true }, { { 5, 5, 5, 5, 6, 6, 6, 6, 7, 9 }, true },
      { { 5, 5, 5, 5, 5, 5, 6, 6, 6, 6, 6, 6, 7, 9 }, false }, { {}, false },
      -- A port that was picked by chance came back.
      { { 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 12, 21, 22, 23, 24, 25, 26, 27 }, true },
      { { 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 11, 12, 13, 14, 15, 16, 17, 18 }, false },
      { { 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 12, 21, 22, 23, 24, 25, 26, 27, 13 }, false }, -- two of 17
    } do
      local self, parts = senders.new(), {}
      for i, port in ipairs(row[1]) do parts[i] = make(port) end
      self:scan(table.concat(parts))
      local wanted = row[2] and address or senders.name(address, 8)
      lu.assertEquals(self:name_of(address, 8), wanted, table.concat(row[1], " "))
    end
  end
end

function T.test_what_is_no_datagram()
  local self = senders.new()
  self:scan(FRAME .. ("x"):rep(60) .. FRAME .. "YP" .. ("\0"):rep(30))
  self:scan("")
  lu.assertEquals(next(self.is_changing), nil)
  self:scan(ipv4(1, 11) .. ipv4(2, 12) .. ipv4(3, 13) .. ipv4(4, 11))
  lu.assertEquals(next(self.is_changing), nil)
end

-- Datagrams of any length belong to one conversation.
function T.test_a_conversation_of_datagrams_of_two_lengths()
  local long = generator.frame(0x123, ("x"):rep(600))
  local length = #long + 8
  local ip = "any link\69\0" .. string.char(2, length + 20 - 512) .. "\0\0\0\0\64\17\0\0\192\168\1\10\192\168\1\20"
  local udp = "\0\9\56\214" .. string.char((length - length % 256) / 256, length % 256) .. "\0\0"
  lu.assertEquals(#senders.conversations(ip .. udp .. long), 1)
  lu.assertEquals(#senders.conversations(ipv4(9) .. ip .. udp .. long), 1)
end

-- The first byte of IPv6 has the version and half of the traffic class.
function T.test_versions_of_ip()
  for first = 0x50, 0x7F do
    local bytes = ipv6(9, ("a"):rep(16)):gsub("\96", string.char(first), 1)
    lu.assertEquals(#senders.conversations(bytes), 0x60 <= first and first <= 0x6F and 1 or 0, first)
  end
end

-- Bytes of another packet may look like IPv6 with UDP.  Then the two lengths differ.
function T.test_lengths_of_ipv6()
  local function count(length)
    local bytes = ipv6(9, ("a"):rep(16)):gsub("\56\214%z\56", "\56\214\0" .. string.char(length))
    return #senders.conversations(bytes)
  end
  lu.assertEquals({ count(56), count(55), count(57) }, { 1, 0, 0 })
end

-- A packet that ends in the header of a frame, behind its ID.
function T.test_the_begin_of_a_header()
  local function count(length, port, header)
    local ip = "\69\0\0" .. string.char(28 + length) .. "\0\0\0\0\64\17\0\0\192\168\1\10\192\168\1\20"
    local udp = string.char(0, port) .. "\56\214\0" .. string.char(8 + length) .. "\0\0"
    return #senders.conversations("any" .. ip .. udp .. header:sub(1, length) .. ("x"):rep(20))
  end
  local found = {}
  for length = 1, 12 do found[length] = count(length, 9, FRAME) end
  lu.assertEquals(found, { 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1 })
  lu.assertEquals(count(8, 9, "YP\0\0\16\8\0\0"), 0) -- an ID above 0x7FF
  lu.assertEquals(senders.conversations("any" .. FRAME:sub(1, 8)), {})
  lu.assertEquals(senders.conversations(ipv4(40000):sub(1, -#FRAME - #FRAME + 10)), {}) -- cut by the end of the bytes
end

function T.test_ids_of_several_senders()
  local function shared(bytes)
    local self = senders.new()
    self:scan(bytes)
    return self:shared_ids(senders.conversations(bytes))
  end
  local health = ipv4(40000, 11):gsub("\16\2", "\0\2")
  lu.assertEquals(shared(ipv4(40000) .. ipv4(40000)), {})
  lu.assertEquals(shared(ipv4(40000) .. health), {}) -- another ID
  lu.assertEquals(shared(ipv4(40000, 10) .. health .. ipv4(40000, 12)), { [0x210] = true })
  lu.assertEquals(shared(ipv4(40000) .. ipv4(40001)), { [0x210] = true })
  lu.assertEquals(shared(ipv4(1) .. ipv4(2) .. ipv4(3) .. ipv4(4)), {}) -- one that takes new ports
end

function T.test_options()
  local function options_of(bytes) return senders.options(senders.conversations(bytes)) end
  local function tcp(ports, rest)
    local words = string.char((20 + #rest) / 4 * 16) -- the size of the header
    return "any" .. "\69\0\0\76\0\0\0\0\64\6\0\0\192\168\1\10\192\168\1\20" .. ports .. ("\0"):rep(8) .. words ..
      "\24" .. ("\0"):rep(6) .. rest .. FRAME
  end
  lu.assertEquals(options_of(ipv4(40000) .. ipv4(40001) .. FRAME), { "-d udp.port==14550,yapp_serial" })
  lu.assertEquals(options_of(tcp("\15\161\195\80", "") .. tcp("\195\80\15\162", ("\1"):rep(12))),
    { "-d tcp.port==4001,yapp_serial", "-d tcp.port==4002,yapp_serial" })
  lu.assertEquals(options_of(ipv4(5) .. ipv4(6)), { "-d udp.port==5,yapp_serial", "-d udp.port==6,yapp_serial" })
  lu.assertEquals(options_of(ipv4(5) .. ipv4(6) .. ipv4(7)), { "-d udp.port==14550,yapp_serial" }) -- one for all
  lu.assertEquals(options_of("any" .. FRAME), {})
  lu.assertEquals(#senders.conversations(ipv4(40000) .. ipv4(40000) .. ipv4(40001)), 2)
  lu.assertEquals(senders.conversations(ipv4(40000))[1].payload, FRAME:sub(13, -5))
  local cut = ipv4(40000):gsub("\0\56\0\0YP", "\0\55\0\0YP") -- a frame that ends in another datagram
  lu.assertNil(senders.conversations(cut)[1].payload)
  -- Bytes of the packet before that look like IPv6 with TCP: 40 bytes, and a header of 20.
  local function before(length, words, flags)
    return "any\96\0\0\0" .. length .. "\6" .. ("\0"):rep(33) .. ("\0"):rep(12) .. words .. (flags or "\24") ..
      ("\0"):rep(6) .. FRAME
  end
  lu.assertEquals(options_of(before("\0\52", "\80")), { "-d tcp.port==0,yapp_serial" })
  lu.assertEquals(options_of(before("\0\52", "\70")), {})
  lu.assertEquals(#options_of(before("\36\0", "\80")), 1)
  for _, length in ipairs { "\36\1", "\199\52" } do lu.assertEquals(options_of(before(length, "\80")), {}) end
  for _, flags in ipairs { "\0", "\18", "\20", "\8" } do -- no ACK, or with SYN or RST
    lu.assertEquals(options_of(before("\0\52", "\80", flags)), {})
  end
  lu.assertEquals(options_of(before("\0\52", "\80", "\17")), { "-d tcp.port==0,yapp_serial" })
end

return T
