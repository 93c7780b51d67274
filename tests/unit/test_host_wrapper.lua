-- SPDX-License-Identifier: GPL-2.0-or-later
-- A Proto of ours in front of dissectors of Wireshark's, which are stand-ins here.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")

local T = {}

local tables, shown -- { [table] = { [value] = dissector } }; what dissectors of Wireshark's got

local function inner(name, call)
  return { name = name, call = function(_, ...)
    shown[#shown + 1] = { name, ... }
    if call then return call(...) end
    return 16
  end }
end

-- Bytes of a packet: so many are captured of so many.
local function buffer(captured, reported)
  local tvb = { len = function() return captured end, reported_len = function() return reported or captured end }
  return setmetatable(tvb, { __call = function(_, offset, length)
    assert(offset == 0 and length == captured and length > 0, "Range is out of bounds")
    return { tvb = function() return buffer(captured) end }
  end })
end

function T.setUp()
  shown = {}
  tables = { ["ip.proto"] = { [6] = inner("tcp"), [17] = inner("udp") }, wtap_encap = { [95] = inner("usb") } }
  _G.DissectorTable = { get = function(name)
    local own = tables[name]
    return {
      get_dissector = function(_, value) return own[value] end,
      add = function(_, value, dissector) own[value] = dissector end,
    }
  end }
  _G.Dissector = { get = function(name) return inner(name) end }
  package.loaded["yapp.host.wrapper"] = nil
end

function T.tearDown()
  _G.DissectorTable, _G.Dissector, package.loaded["yapp.host.wrapper"] = nil, nil, nil
end

local ENTRIES = { { "ip.proto", 6, "tcp" }, { "wtap_encap", 95 } }

-- A wrapper whose header is that of `headers` by the number of the packet, or the number itself.
local function new(after, headers)
  local proto = {}
  local wrapper = require("yapp.host.wrapper").new(proto, ENTRIES, function(_, pinfo, value)
    if headers then return headers[pinfo.number] end
    return { number = pinfo.number, value = value }
  end, after)
  return wrapper, function(tvb, number, value)
    return proto.dissector(tvb, { number = number, match_uint = value or 6 }, "tree")
  end, proto
end

function T.test_it_comes_and_goes()
  local wrapper, dissect, proto = new()
  local before = tables["ip.proto"][6]
  wrapper:stop()
  lu.assertIs(tables["ip.proto"][6], before)
  wrapper:start()
  wrapper:start()
  lu.assertIs(tables["ip.proto"][6], proto)
  lu.assertIs(tables.wtap_encap[95], proto)
  lu.assertEquals(tables["ip.proto"][17].name, "udp")
  lu.assertEquals(dissect(buffer(40), 1), 16)
  lu.assertEquals({ shown[1][1], shown[1][4], { wrapper:read(1) }, { wrapper:read(2) } },
    { "tcp", "tree", { true, { number = 1, value = 6 } }, { false, { number = 1, value = 6 } } })
  dissect(buffer(40), 2, 95)
  lu.assertEquals({ shown[2][1], select(2, wrapper:read(2)).value }, { "usb", 95 })
  wrapper:stop()
  lu.assertIs(tables["ip.proto"][6], before)
  lu.assertEquals(tables.wtap_encap[95].name, "usb")
  lu.assertEquals({ dissect(buffer(40), 3), #shown, (wrapper:read(2)) }, { 0, 2, false })
end

-- When Wireshark reloads its Lua plugins, a wrapper that was there takes TCP away with it.
function T.test_a_dissector_that_is_gone()
  tables["ip.proto"][6], tables.wtap_encap[95] = nil, nil
  local wrapper, dissect = new()
  wrapper:start()
  lu.assertNil(tables.wtap_encap[95])
  lu.assertEquals({ dissect(buffer(40), 1), shown[1][1] }, { 16, "tcp" })
end

function T.test_what_it_hears_of_a_packet()
  local heard = {}
  local wrapper, dissect = new(function(header, tvb, pinfo, tree)
    heard[#heard + 1] = { header, tvb:len(), pinfo.number, tree, #shown }
  end, { [1] = "one", [3] = "three" })
  wrapper:start()
  for number = 1, 3 do dissect(buffer(40 + number), number) end
  lu.assertEquals(heard, { { "one", 41, 1, "tree", 1 }, { "three", 43, 3, "tree", 3 } }, "behind Wireshark's")
end

-- A tunnel has TCP in TCP: behind the inner segment the outer one is current again.
function T.test_a_packet_in_a_packet()
  local current, dissect, wrapper = {}, nil, nil
  local function note() current[#current + 1] = select(2, wrapper:read(1)) end
  tables["ip.proto"][6] = inner("tcp", function(tvb)
    note()
    if tvb:len() == 40 then dissect(buffer(20), 1) end
    note()
    return 3
  end)
  local headers = setmetatable({}, { __index = function() return #shown == 0 and "outer" or "inner" end })
  wrapper, dissect = new(function() end, headers)
  wrapper:start()
  lu.assertEquals(dissect(buffer(40), 1), 3)
  lu.assertEquals(current, { "outer", "inner", "inner", "outer" })
  lu.assertNil(select(2, wrapper:read(1)))
end

-- At bytes that are not there a C dissector throws past Lua, which costs two of Lua's 200 nested calls for good.
function T.test_calls_that_never_return()
  local wrapper, dissect = new()
  wrapper:start()
  for number = 1, 60 do dissect(buffer(11, 16), number) end -- calls that return cost none of Lua's
  lu.assertEquals(shown[60][2]:reported_len(), 16)
  wrapper.inner[6], shown = inner("tcp", coroutine.yield), {}
  for count = 1, 30 do
    coroutine.wrap(dissect)(buffer(11, 16), count)
    lu.assertEquals(shown[count][2]:reported_len(), count <= 24 and 16 or 11, count)
  end
  wrapper.inner[6] = inner("tcp")
  lu.assertEquals({ dissect(buffer(40), 99), dissect(buffer(0, 4), 99), #shown }, { 16, 0, 31 }, "others are as before")
end

function T.test_an_error_of_wiresharks()
  tables["ip.proto"][6] = inner("tcp", function() error("Malformed") end)
  local wrapper, dissect = new()
  wrapper:start()
  lu.assertEquals(dissect(buffer(40), 1), 40)
end

return T
