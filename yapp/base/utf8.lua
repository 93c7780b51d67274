-- SPDX-License-Identifier: GPL-2.0-or-later
-- UTF-8 in bytes that may be anything.  Pure Lua, 5.2 and 5.4.

local M = {}

-- Characters beyond ASCII (Unicode, "Well-Formed UTF-8 Byte Sequences"; C: a byte that goes on), no
-- control characters
local CHARACTERS = {
  "\194[\160-\191]", "[\195-\223]C",
  "\224[\160-\191]C", "[\225-\236\238\239]CC", "\237[\128-\159]C",
  "\240[\144-\191]CC", "[\241-\243]CCC", "\244[\128-\143]CC",
}
for i, character in ipairs(CHARACTERS) do CHARACTERS[i] = character:gsub("C", "[\128-\191]") end

--- The text with a "?" for each character beyond ASCII; bytes that are no UTF-8, or a control
-- character's, stay.
function M.ascii(text)
  if not text:find("[\128-\255]") then return text end
  for _, character in ipairs(CHARACTERS) do text = text:gsub(character, "?") end
  return text
end

--- Whether the text is UTF-8 without control characters.
function M.is_printable(text)
  return not M.ascii(text):find("[%c\128-\255]")
end

-- A character that may be printed, or several of ASCII; nil where there is none.
local function printable_at(text, at)
  local ascii = text:match("^[^%c\128-\255]+", at)
  if ascii then return ascii end
  for _, character in ipairs(CHARACTERS) do
    local found = text:match("^" .. character, at)
    if found then return found end
  end
end

--- The text fit to be printed: "\xNN" for each byte of a control character, and each that is no
-- UTF-8.
function M.printable(text)
  if M.is_printable(text) then return text end
  local parts, at = {}, 1
  while at <= #text do
    local part = printable_at(text, at)
    parts[#parts + 1] = part or ("\\x%02X"):format(text:byte(at))
    at = at + #(part or "?")
  end
  return table.concat(parts)
end

return M
