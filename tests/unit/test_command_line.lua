-- SPDX-License-Identifier: GPL-2.0-or-later
-- The options of tshark's command line, however they are written.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local command_line = require("yapp.capture.command_line")

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")

local T = {}

local function options(...)
  return command_line.parse(table.concat({ "tshark", ... }, "\0") .. "\0")
end

function T.test_a_display_filter_however_it_is_written()
  for _, words in ipairs { { "-Y", "yapp" }, { "-Yyapp" }, { "-qY", "yapp" }, { "-2Yyapp" },
    { "-VxY", "yapp" } } do
    lu.assertEquals(options(unpack(words)).Y, "yapp")
  end
  lu.assertEquals(options("--display-filter=yapp"), { Y = "yapp" })
  lu.assertEquals(options("--read-file", "-Y", "--color"), { r = "-Y", color = "" })
end

function T.test_a_value_is_no_option()
  local found = options("-r", "-Y", "-o", "-b", "-zYb", "-T", "fields", "-e", "-Y")
  lu.assertEquals(found, { r = "-Y", o = "-b", z = "Yb", T = "fields", e = "-Y" })
end

function T.test_a_ring_buffer()
  lu.assertEquals(options("-i", "-", "-b", "packets:25", "-qw", "r.pcapng"),
    { i = "-", b = "packets:25", q = "", w = "r.pcapng" })
  lu.assertEquals(options("-qbfiles:2").b, "files:2")
  lu.assertNil(options("-q", "-B", "2").b)
end

function T.test_nothing()
  lu.assertEquals(options(), {})
  lu.assertEquals(command_line.parse(""), {})
  lu.assertEquals(command_line.parse("-q\0"), {}) -- the program
  lu.assertEquals(options("-"), {})
end

return T
