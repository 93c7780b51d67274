-- SPDX-License-Identifier: GPL-2.0-or-later
-- How fields and expert items are made from their rows, and times from seconds.  Wireshark's API is a stand-in here;
-- tests/e2e compares what is shown.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")

local T = {}

local GLOBALS = { "TreeItem", "ProtoField", "ProtoExpert", "ftypes", "base", "frametype", "expert", "NSTime" }
local seen, fields

-- A table whose fields are their own names, behind a prefix.
local function names_of(prefix)
  return setmetatable({}, { __index = function(_, name) return prefix .. name end })
end

function T.setUp()
  seen = { fields = {}, experts = {}, added = {} }
  _G.TreeItem = {
    add = function(_, text)
      table.insert(seen.added, text)
      return { add_proto_expert_info = function(_, one) table.insert(seen.added, { text, one }) end }
    end,
    set_generated = function(item)
      seen.is_generated = true
      return item
    end,
  }
  _G.ftypes, _G.frametype = names_of("", ""), names_of("frame ")
  _G.base = { DEC = "DEC", HEX = "HEX", NONE = "NONE" }
  _G.expert = { group = names_of("group "), severity = names_of("severity ") }
  _G.ProtoField = { new = function(title, filter, ...)
    seen.fields[filter] = { title, ... }
    return filter
  end }
  _G.ProtoExpert = { new = function(filter, ...)
    seen.experts[filter] = { ... }
    return filter
  end }
  _G.NSTime = { new = function(...) return { ... } end }
  package.loaded["yapp.show.fields"] = nil
  fields = require("yapp.show.fields")
end

function T.tearDown()
  for _, name in ipairs(GLOBALS) do _G[name] = nil end
  package.loaded["yapp.show.fields"] = nil
end

function T.test_fields_of_yapp()
  local proto, names = {}, { [7] = "Seven" }
  local made = fields.of_yapp(proto, fields.rows(names, { { name = "motor", title = "Motor Data", filters = {} } }))
  lu.assertEquals({ made.seq, made["like.motor"] }, { "yapp.seq", "yapp.like.motor" })
  lu.assertIs(proto.fields, made)
  lu.assertIs(seen.fields["yapp.id"][3], names)
  lu.assertEquals(seen.fields["yapp.id"][4], "HEX")
  lu.assertEquals({ seen.fields["yapp.seq"][1], seen.fields["yapp.seq"][2], seen.fields["yapp.seq"][4] },
    { "Sequence number", "UINT8", "DEC" })
  lu.assertEquals(seen.fields["yapp.can.ctrl"][3], { [0] = "Single", "Start", "Middle", "End" }) -- of the document
  lu.assertEquals(seen.fields["yapp.crc.status"][3], { [0] = "Bad", "Good", "Unverified" })
  lu.assertEquals({ seen.fields["yapp.payload"][4], seen.fields["yapp.fragment"][3] }, { "NONE", "frame NONE" })
  lu.assertEquals({ seen.fields["yapp.like.motor"][1], seen.fields["yapp.like.motor"][4] }, { "Could be Motor Data",
    "HEX" })
  for _, name in ipairs { "yapp.crc", "yapp.crc.calculated", "yapp.reserved", "yapp.sync" } do
    lu.assertEquals(seen.fields[name][4], "HEX", name)
  end
  lu.assertEquals(seen.experts["yapp.crc.bad"], { "Bad CRC", "group CHECKSUM", "severity ERROR" })
  for name in pairs(proto.experts) do lu.assertStrMatches(name, "yapp%..+") end
  for name in pairs(seen.experts) do lu.assertTrue(fields.EXPERT_NAMES[name], name) end
end

function T.test_fields_of_messages()
  local proto, values = {}, { [0] = "Off" }
  local made = fields.of_taurus(proto, {
    { "taurus.one", "UINT8", "One", "About one", "HEX", values, 3 }, { "taurus.two", "BOOLEAN", "Two", "About two", 8,
      nil, 1 },
    { "taurus.three", "FRAMENUM", "Three", "About three", nil, "ACK" } })
  lu.assertEquals(seen.fields, { ["taurus.one"] = { "One", "UINT8", values, "HEX", 3, "About one" },
    ["taurus.two"] = { "Two", "BOOLEAN", nil, 8, 1, "About two" },
    ["taurus.three"] = { "Three", "FRAMENUM", "frame ACK", "NONE", nil, "About three" } })
  lu.assertEquals({ made["taurus.one"], proto.fields == made }, { "taurus.one", true })
  for name in pairs(proto.experts) do lu.assertStrMatches(name, "taurus%..+") end
  lu.assertNotNil(proto.experts["taurus.reboot"])
end

-- What a change is called in Info, and in the label of its item.
function T.test_changes()
  local found = {}
  for _, row in ipairs(fields.CHANGES) do found[row[1]] = { row.change, row.word,
    row.label and row.label:format(2.25) } end
  lu.assertEquals(found, { ["yapp.late"] = { "late", nil, "Silent for 2.250 s" }, ["yapp.source.shared"] = { "shared" },
    ["taurus.reboot"] = { "reboot", "REBOOT", ("Controller rebooted (its clock went back by %.1f s)"):format(2.25) },
    ["taurus.stale"] = { "stale", "STALE" },
    ["taurus.jump"] = { "jump", "JUMP", ("Controller's clock jumped ahead by %.1f s"):format(2.25) } })
end

function T.test_expert_items()
  fields.of_yapp({}, {})
  local item = { visible = true, add_proto_expert_info = function(_, one) table.insert(seen.added, one) end }
  fields.add_expert(nil, "yapp.crc.bad", "text")
  fields.add_expert(item, "yapp.crc.bad")
  lu.assertEquals({ seen.added, seen.is_generated }, { { "yapp.crc.bad" } })
  fields.add_expert(item, "yapp.crc.bad", "text")
  lu.assertEquals(seen.added, { "yapp.crc.bad", "text", { "text", "yapp.crc.bad" } })
  lu.assertTrue(seen.is_generated)
  item.visible = false
  fields.add_expert(item, "yapp.crc.bad", "text")
  lu.assertEquals(seen.added[4], "yapp.crc.bad", "nobody sees the text")
end

function T.test_times()
  for seconds, wanted in pairs { [0] = { 0, 0 }, [1.5] = { 1, 500000000 }, [-1.5] = { -1, -500000000 },
    [0.0000000006] = { 0, 1 }, [0.0000000004] = { 0, 0 }, [-0.25] = { 0, -250000000 }, [2.9999999999] = { 3, 0 },
    [-2.9999999999] = { -3, 0 } } do
    local found = fields.relative_time(seconds)
    lu.assertTrue(found[1] == wanted[1] and found[2] == wanted[2], seconds)
  end
end

return T
