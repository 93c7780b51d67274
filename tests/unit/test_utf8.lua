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
    lu.assertEquals(utf8.is_printable(text), text == expected)
  end
end

-- What nobody sees, or what turns the direction of text, is written like a control character.
function T.test_invisible_characters()
  for text, expected in pairs {
    ["a\226\128\139b"] = "a\\xE2\\x80\\x8Bb",                -- U+200B, zero width space
    ["\226\128\143"] = "\\xE2\\x80\\x8F",                    -- U+200F, right-to-left mark
    ["\226\128\174\195\188"] = "\\xE2\\x80\\xAE\195\188",    -- U+202E, right-to-left override
    ["\226\129\160\226\129\169"] = "\\xE2\\x81\\xA0\\xE2\\x81\\xA9", -- U+2060, U+2069
    ["\216\156"] = "\\xD8\\x9C",                              -- U+061C, Arabic letter mark
    ["\239\187\191x"] = "\\xEF\\xBB\\xBFx",                  -- U+FEFF
    ["ro\194\173tor"] = "ro\\xC2\\xADtor",                  -- U+00AD, soft hyphen
    ["\243\160\128\161\243\160\129\191"] = "\\xF3\\xA0\\x80\\xA1\\xF3\\xA0\\x81\\xBF", -- U+E0021, U+E007F, tags
    ["\239\191\189\239\191\190\239\191\191"] = "\239\191\189\\xEF\\xBF\\xBE\\xEF\\xBF\\xBF", -- U+FFFD is seen; U+FFFE
    ["\227\133\164\225\160\142"] = "\\xE3\\x85\\xA4\\xE1\\xA0\\x8E", -- U+3164, U+180E
    ["\243\161\128\128\239\191\188"] = "\243\161\128\128\239\191\188", -- U+E1000, U+FFFC stay
    ["\226\128\138\226\128\144"] = "\226\128\138\226\128\144", -- U+200A, U+2010 are seen
  } do
    lu.assertEquals(utf8.printable(text), expected)
    lu.assertEquals(utf8.is_printable(text), text == expected)
  end
end

-- Names that differ stay different, and a name that was made fit stays as it is.
function T.test_names_stay_different()
  local names = { "a\1", "a\\x01", "a\\x5Cx01", "a\\\1", "a\255", "a\\xFF", "\\Device\\NPF_{1}", "a\\x",
    "a\226\128\139", "a" }
  local shown = {}
  for _, name in ipairs(names) do
    local text = utf8.name(name)
    lu.assertNil(shown[text], text)
    shown[text] = true
    lu.assertTrue(utf8.is_printable(text))
    lu.assertEquals(utf8.printable(text), text)
  end
  lu.assertEquals({ utf8.name(names[1]), utf8.name(names[2]), utf8.name(names[7]) },
    { "a\\x01", "a\\x5Cx01", names[7] })
end

return T
