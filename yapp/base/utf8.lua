-- SPDX-License-Identifier: GPL-2.0-or-later
-- UTF-8 in bytes that may be anything.  Pure Lua, 5.2 and 5.4.

local M = {}

-- Patterns of the characters beyond ASCII, without control characters (Unicode, "Well-Formed UTF-8
-- Byte Sequences").  C stands for a continuation byte.
local CHARACTERS = {
  "^\194[\160-\191]", "^[\195-\223]C",
  "^\224[\160-\191]C", "^[\225-\236\238\239]CC", "^\237[\128-\159]C",
  "^\240[\144-\191]CC", "^[\241-\243]CCC", "^\244[\128-\143]CC",
}
for i, character in ipairs(CHARACTERS) do CHARACTERS[i] = character:gsub("C", "[\128-\191]") end

-- Return the character that bytes begin with, "" for none.
local function first_character(bytes)
  for _, character in ipairs(CHARACTERS) do
    local found = bytes:match(character)
    if found then return found end
  end
  return ""
end

--- Return the text fit to be printed: control characters, and bytes that are not UTF-8, are \xNN.
-- shape  of such a byte, "\\x%02X" if it is nil
function M.printable(text, shape)
  -- A control character, or a byte beyond ASCII, and the continuation bytes behind it.
  return (text:gsub("[%c\128-\255][\128-\191]*", function(bytes)
    local character = first_character(bytes)
    return character .. bytes:sub(#character + 1):gsub(".", function(byte)
      return (shape or "\\x%02X"):format(byte:byte())
    end)
  end))
end

--- Return whether the text is UTF-8 without control characters.
function M.is_printable(text)
  return M.printable(text) == text
end

return M
