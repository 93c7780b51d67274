-- SPDX-License-Identifier: GPL-2.0-or-later
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local utf8 = require("yapp.base.utf8")

local T = {}

function T.test_printable()
  for text, expected in pairs {
    [""] = "", ["can0"] = "can0", ["\195\188 \240\144\128\128"] = "\195\188 \240\144\128\128",
    ["a\255b\0c\127"] = "a\\xffb\\x00c\\x7f", ["\194\133"] = "\\xc2\\x85", ["\195"] = "\\xc3",
    ["\192\128"] = "\\xc0\\x80", ["\224\128\128"] = "\\xe0\\x80\\x80", ["\244\144\128\128"] = "\\xf4\\x90\\x80\\x80",
    ["\224\194\176\160\128"] = "\\xe0\194\176\\xa0\\x80", -- what was on the sides of a character is not joined
    ["\195\195\188"] = "\\xc3\195\188", ["\237\160\128\n"] = "\\xed\\xa0\\x80\\x0a",
  } do
    lu.assertEquals(utf8.printable(text), expected)
    lu.assertEquals(utf8.is_printable(text), text == expected)
  end
end

return T
