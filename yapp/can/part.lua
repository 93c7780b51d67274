-- SPDX-License-Identifier: GPL-2.0-or-later
-- What the Info column says of the parts of a message on CAN: "Motor Data  part 2 of 5".  Pure Lua, 5.2 and 5.4.

local START = require("yapp.wire.can_id").START

local M = {}

local MAX_KEPT = 64 -- texts of a long message

--- The text of a part.  They are the same for every message of an ID and size, so they are kept: those of a message in
-- frames of classic CAN by the number of the part.
-- names    { name = what the message is called, texts = {}, which is this function's }
-- address  wire.can_id.address of its frame
-- message  of can.reassembly; look: the frame's; length: the frame's captured bytes
function M.text(names, address, message, look, length)
  local size, texts = message.size, names.texts
  if texts.size ~= size then
    texts = { ("%s  Start of %d bytes"):format(names.name, size), size = size }
    names.texts = texts
  end
  if address.ctrl == START then return texts[1] end
  local index = #message
  while index > 1 and message[index] ~= look do index = index - 1 end
  if message[index] ~= look then return names.name .. "  part once more" end
  -- How many parts there are is sure in the end; before that, it is what classic CAN needs.
  local usual = 1 + (size + 7 - (size + 7) % 8) / 8
  local parts = message.status == "good" and #message or length == 8 and usual
  if not parts or index > parts then return ("%s  part %d"):format(names.name, index) end
  local key = parts == usual and index or parts * 0x1000 + index
  local text = texts[key] or ("%s  part %d of %d"):format(names.name, index, parts)
  if parts <= MAX_KEPT then texts[key] = text end
  return text
end

return M
