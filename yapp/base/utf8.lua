-- SPDX-License-Identifier: GPL-2.0-or-later
-- UTF-8 in bytes that may be anything.  Pure Lua, 5.2 and 5.4.

local M = {}

-- Patterns of the characters beyond ASCII, without control characters (Unicode, "Well-Formed UTF-8
-- Byte Sequences").  C stands for a continuation byte.
local CHARACTERS = {
  "\194[\160-\191]", "[\195-\223]C",
  "\224[\160-\191]C", "[\225-\236\238\239]CC", "\237[\128-\159]C",
  "\240[\144-\191]CC", "[\241-\243]CCC", "\244[\128-\143]CC",
}
for i, character in ipairs(CHARACTERS) do CHARACTERS[i] = character:gsub("C", "[\128-\191]") end

-- Characters that are invisible, or that change the text around them: Unicode's
-- Default_Ignorable_Code_Point, the separators U+2028 and U+2029, annotations; and U+FFFE, U+FFFF,
-- which XML does not allow.
local INVISIBLE = {
  "\194\173",                     -- U+00AD, soft hyphen
  "\205\143", "\216\156",         -- U+034F, U+061C
  "\225\133[\159\160]",           -- U+115F, U+1160
  "\225\158[\180\181]",           -- U+17B4, U+17B5
  "\225\160[\139-\143]",          -- U+180B to U+180F
  "\226\128[\139-\143]",          -- U+200B to U+200F
  "\226\128[\168-\174]",          -- U+2028 to U+202E
  "\226\129[\160-\175]",          -- U+2060 to U+206F
  "\227\133\164",                 -- U+3164
  "\239\184[\128-\143]",          -- U+FE00 to U+FE0F
  "\239\187\191", "\239\190\160", -- U+FEFF, U+FFA0
  "\239\191[\176-\187]",          -- U+FFF0 to U+FFFB
  "\239\191[\190\191]",           -- U+FFFE, U+FFFF
  "\240\155\178[\160-\163]",      -- U+1BCA0 to U+1BCA3
  "\240\157\133[\179-\186]",      -- U+1D173 to U+1D17A
  "\243\160",                     -- U+E0000 to U+E0FFF: tags and variations
}

-- A control character, or a byte beyond ASCII, and the continuation bytes behind it.
local UNSURE = "[%c\128-\255][\128-\191]*"

--- Return the text with a "?" for each character beyond ASCII.  Bytes that are not UTF-8 stay, as
-- do those of control characters.
function M.ascii(text)
  if not text:find("[\128-\255]") then return text end
  for _, character in ipairs(CHARACTERS) do text = text:gsub(character, "?") end
  return text
end

-- Return the printable character beyond ASCII that bytes begin with, "" for none.
local function printable_start(bytes)
  for _, character in ipairs(CHARACTERS) do
    local found = bytes:match("^" .. character)
    for _, invisible in ipairs(found and INVISIBLE or {}) do
      if found:find(invisible) then return "" end
    end
    if found then return found end
  end
  return ""
end

-- Return a control character, or a byte beyond ASCII and the continuation bytes behind it, fit to
-- be printed.
local function shown(bytes, shape)
  local character = printable_start(bytes)
  return character .. bytes:sub(#character + 1):gsub(".", function(byte)
    return (shape or "\\x%02X"):format(byte:byte())
  end)
end

--- Return the text fit to be printed, with "\xNN" for each byte of a control or invisible
-- character, and for bytes that are not UTF-8.
function M.printable(text)
  return (text:gsub(UNSURE, shown))
end

--- The same with "\xnn", as values of fields have it.
function M.value(text)
  return (text:gsub(UNSURE, function(bytes) return shown(bytes, "\\x%02x") end))
end

--- Return whether the text is UTF-8 without control characters and without invisible ones.
function M.is_printable(text)
  return M.printable(text) == text
end

--- Return a name fit to be printed.  Different names stay different: a backslash that looks like
-- one of M.printable's becomes "\x5C".  The five characters a\x01 become a\x5Cx01.
function M.name(text)
  return M.printable((text:gsub("\\(x%x%x)", "\\x5C%1")))
end

return M
