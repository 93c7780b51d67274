-- SPDX-License-Identifier: GPL-2.0-or-later
-- YAPP's own tree item of a frame on CAN.  Wireshark's API.  A builder is a show.tree, a view
-- can.carrier's.

local items = require("yapp.show.items")
local KINDS = require("yapp.wire.can_id").KINDS

local M = {}

local add, add_le, append_text = items.add, items.add_le, items.append_text

local CRC_TEXT = { good = ", CRC good", bad = ", CRC BAD" }

--- YAPP's own tree item, with what the CAN id says.
function M.frame(builder, view)
  local address = view.address
  local titles, ctrl = view.names.titles, address.ctrl
  local title = titles[ctrl]
  if not title then
    local kind = KINDS[ctrl] or "undefined frame"
    title = ("%s, %s, %s"):format(builder.yapp.description, view.names.name, kind)
    titles[ctrl] = title
  end
  view.range = view.tvb()
  local item = add(view.tree, builder.yapp, view.range, title)
  builder:add_address(item, address, view.names.bus)
  return item
end

--- What a Start says, as far as it was captured.
function M.start(builder, view)
  local fields, item, length = builder.fields, view.item, #view.facts.data
  if length >= 4 then add_le(item, fields.crc, view.tvb(0, 4)) end
  if length >= 6 then append_text(add_le(item, fields.size, view.tvb(4, 2)), " bytes") end
  if length >= 8 then add_le(item, fields.reserved, view.tvb(6, 2)) end
end

--- What YAPP's own item says of a message in its last frame.
-- numbers  of its frames
function M.message(builder, view, message, numbers)
  local item, entry, data, tvb = view.item, view.record.message, view.facts.data, message.tvb
  builder:generated(item, "reassembled.in", view.facts.number)
  append_text(builder:generated(item, "size", entry.size), " bytes")
  builder:generated(item, "reserved", entry.reserved or 0)
  builder:add_crc(item, nil, entry)
  builder:add_fragments(item, tvb or view.tvb, numbers, entry.count, #entry.payload, tvb and tvb())
  if entry.padding and entry.padding <= #data then
    add(item, builder.fields.padding, view.tvb(#data - entry.padding))
  end
  append_text(item, CRC_TEXT[entry.status] or ", CRC unverified")
end

return M
