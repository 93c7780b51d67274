-- SPDX-License-Identifier: GPL-2.0-or-later
-- YAPP's own tree item of a frame on CAN.  Wireshark's API.  A builder is a show.tree, a frame
-- can.carrier's.

local items = require "yapp.show.fields"
local KINDS = require "yapp.wire.can_id".KINDS

local M = {}

local add, add_le, append_text = items.add, items.add_le, items.append_text

local CRC_TEXT = { good = ", CRC good", bad = ", CRC BAD" }

--- YAPP's own tree item, with what the CAN id says.
function M.frame(builder, frame, names)
  local kind = KINDS[frame.address.ctrl] or "undefined frame"
  local title = ("%s, %s, %s"):format(builder.yapp.description, names.name, kind)
  local item = add(frame.tree, builder.yapp, frame.tvb(), title)
  builder:add_address(item, frame.address, names.bus)
  return item
end

--- What a Start says, as far as it was captured.
function M.start(builder, frame, item)
  local fields, length = builder.fields, #frame.data
  if length >= 4 then add_le(item, fields.crc, frame.tvb(0, 4)) end
  if length >= 6 then append_text(add_le(item, fields.size, frame.tvb(4, 2)), " bytes") end
  if length >= 8 then add_le(item, fields.reserved, frame.tvb(6, 2)) end
end

--- What YAPP's own item says of a message in its last frame.
-- numbers  of its frames
function M.message(builder, frame, item, message, numbers)
  local entry, data, tvb = frame.entry, frame.data, message.tvb
  builder:generated(item, "reassembled.in", frame.number)
  append_text(builder:generated(item, "size", entry.size), " bytes")
  builder:generated(item, "reserved", entry.reserved or 0)
  builder:add_crc(item, nil, entry)
  builder:add_fragments(item, tvb or frame.tvb, numbers, #entry, #entry.payload, tvb and tvb())
  if entry.padding and entry.padding <= #data then
    add(item, builder.fields.padding, frame.tvb(#data - entry.padding))
  end
  append_text(item, CRC_TEXT[entry.status] or ", CRC unverified")
end

return M
