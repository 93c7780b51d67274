-- SPDX-License-Identifier: GPL-2.0-or-later
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local utf8 = require("yapp.base.utf8")

local T = {}

function T.test_printable()
  for text, expected in pairs {
    [""] = "", ["can0"] = "can0", ["\195\188 \240\144\128\128"] = "\195\188 \240\144\128\128",
    ["a\255b\0c\127"] = "a\\xFFb\\x00c\\x7F", ["\194\133"] = "\\xC2\\x85", ["\195"] = "\\xC3",
    ["\192\128"] = "\\xC0\\x80", ["\224\128\128"] = "\\xE0\\x80\\x80", ["\244\144\128\128"] = "\\xF4\\x90\\x80\\x80",
    ["\224\194\176\160\128"] = "\\xE0\194\176\\xA0\\x80", -- what was on the sides of a character is not joined
    ["\195\195\188"] = "\\xC3\195\188", ["\237\160\128\n"] = "\\xED\\xA0\\x80\\x0A",
  } do
    lu.assertEquals(utf8.printable(text), expected)
    lu.assertEquals(utf8.printable(text, "\\x%02x"), (expected:gsub("\\x%x%x", string.lower)))
    lu.assertEquals(utf8.is_printable(text), text == expected)
  end
end

return T
