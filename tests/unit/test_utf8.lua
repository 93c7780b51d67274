-- SPDX-License-Identifier: GPL-2.0-or-later
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local utf8 = require("yapp.base.utf8")

local T = {}

function T.test_characters()
  for text, expected in pairs { [""] = "", ["taurus> \b\0"] = "taurus> \b\0", ["41 \194\176C"] = "41 ?C",
    ["\194\160\223\191\224\160\128\237\159\191\239\191\191"] = "?????",
    ["\240\144\128\128\244\143\191\191"] = "??" } do
    lu.assertEquals(utf8.ascii(text), expected)
  end
end

-- Alone, cut, too long a form, a surrogate, beyond the last character, a control character.
function T.test_other_bytes_stay()
  for _, bytes in ipairs { "\128", "\194", "\192\128", "\224\128\128", "\237\160\128", "\244\144\128\128", "\194\133",
    "\255" } do
    lu.assertStrMatches(utf8.ascii("a" .. bytes .. "b"), "a.*[\128-\255].*b")
  end
end

-- A character taken out does not join what was on its sides.
function T.test_nothing_is_joined()
  lu.assertEquals(utf8.ascii("\224\194\176\160\128"), "\224?\160\128")
end

function T.test_printable()
  for text, expected in pairs {
    [""] = "", ["can0"] = "can0", ["\195\188 \240\144\128\128"] = "\195\188 \240\144\128\128",
    ["a\255b\0c\127"] = "a\\xFFb\\x00c\\x7F", ["\194\133"] = "\\xC2\\x85", ["\195"] = "\\xC3",
    ["\195\195\188"] = "\\xC3\195\188", ["\237\160\128\n"] = "\\xED\\xA0\\x80\\x0A",
  } do
    lu.assertEquals(utf8.printable(text), expected)
    lu.assertEquals(utf8.printable(text, "\\x%02x"), (expected:gsub("\\x%x%x", string.lower)))
    lu.assertEquals(utf8.is_printable(text), text == expected)
  end
end

return T
