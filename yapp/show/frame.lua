-- SPDX-License-Identifier: GPL-2.0-or-later
-- The view of a CAN frame: its tree, its expert items, its columns.  One function for each
-- kind of result.  Wireshark's API.

local can_id = require "yapp.wire.can_id"
local show_fields = require "yapp.show.fields"
local number_of = require "yapp.base.frame_key".number

local M = {}

local CTRL_NAMES, START = can_id.CTRL_NAMES, can_id.START
local add, add_le, append_text = show_fields.add, show_fields.add_le, show_fields.append_text
local set_generated = show_fields.set_generated

local FrameView = {}
FrameView.__index = FrameView

--- Make the view of CAN frames.
-- builder  a show.tree
function M.new(builder)
  return setmetatable({
    builder = builder,
    fields = builder.fields,
    -- Of the current frame; see Tree:show_message:
    tvb = false, -- where its bytes are
    range = false, -- all of them, if YAPP's own item is wanted
    tree = false,
    item = false,
    wants = false,
    payload_tvb = false,
    payload_offset = 0,
  }, FrameView)
end

-- YAPP's own item ---------------------------------------------------------------------------------

-- Add YAPP's own item, with the fields of the CAN id as generated items.
local function add_item(self, frame)
  local builder, fields, of_id, source = self.builder, self.fields, frame.can_id, frame.source
  local kind = CTRL_NAMES[of_id.ctrl] or "undefined frame"
  self.range = self.tvb()
  local item = builder:add_item(self.tree, self.range, source.short .. ", " .. kind)
  builder:add_id(item, nil, source)
  set_generated(add(item, fields.ctl, of_id.ctl))
  set_generated(add(item, fields.seq, of_id.seq))
  set_generated(add(item, fields["can.ctrl"], of_id.ctrl))
  builder:add_source(item, source)
  return item
end

-- Add the fields in the bytes of a fragment.  A truncated Start has only the fields that were
-- captured.
local function add_fragment(self, result)
  local fields, length, item = self.fields, #result.frame.data, self.item
  if result.frame.can_id.ctrl ~= START then
    if length > 0 then add(item, fields["fragment.data"], self.range) end
    return
  end
  if length >= 4 then add_le(item, fields.crc, self.tvb(0, 4)) end
  if length >= 6 then append_text(add_le(item, fields.size, self.tvb(4, 2)), " bytes") end
  if length >= 8 then add_le(item, fields.reserved, self.tvb(6, 2)) end
  if result.transfer then append_text(item, (" of %d bytes"):format(result.transfer.size)) end
end

-- Add the parts that the last or only frame of a transfer completes: size, CRC, fragments and
-- padding.
local function add_transfer(self, result)
  local frame, transfer, item, fields = result.frame, result.transfer, self.item, self.fields
  if #transfer > 1 then
    local payload = self.payload_tvb and self.payload_tvb()
    set_generated(add(item, fields["reassembled.in"], frame.number))
    append_text(set_generated(add(item, fields.size, transfer.size)), " bytes")
    set_generated(add(item, fields.reserved, transfer.reserved or 0))
    self.builder:add_crc(item, nil, transfer, transfer.crc)
    self.builder:add_fragments(item, payload or self.range, transfer, #transfer.payload, payload)
  end
  local start = frame.reported - (transfer.padding or 0)
  if start < #frame.data then add(item, fields.padding, self.tvb(start)) end
end

-- By kind of result: functions that return the text of the Info column ----------------------------

-- Return a Tvb with the payload of a transfer, false for none.
local function payload_tvb_of(self, transfer)
  if #transfer == 1 then return self.tvb end
  return transfer.payload ~= "" and ByteArray.new(transfer.payload, true):tvb("Reassembled YAPP")
end

-- Show the frame that has a whole message, or its last fragment, and the message.
local function show_last(self, result)
  local builder, wants, message = self.builder, self.wants, result.message
  local transfer = result.transfer
  local status = transfer.status
  self.payload_tvb = wants.tree and payload_tvb_of(self, transfer)
  if wants.yapp then add_transfer(self, result) end
  if status == "bad" then builder:add_bad_crc(self.item, transfer) end
  local mark = #transfer > 1 and builder.MARKS[status] or ""
  if not transfer.received then return builder:show_message(result, self) .. mark end
  if wants.yapp then
    if self.payload_tvb then add(self.item, self.fields.payload, self.payload_tvb()) end
    builder:add_delta(self.item, message)
  end
  local text = "%s  %d of %d bytes%s"
  return text:format(message.source.label, transfer.received, transfer.size, mark)
end

-- Return the text of a fragment.  A good transfer has a known number of fragments; for another one
-- assume the number that classic CAN needs.  The source caches the texts for transfers of one size
-- and number of fragments.
local function fragment_text(result)
  local frame, transfer, index = result.frame, result.transfer, result.index
  local source = frame.source
  if not transfer then return source.label .. "  fragment of no message" end
  local size, count = transfer.size, 0
  if not index then
    index = #transfer
  elseif transfer[index] ~= frame.key then
    return source.label .. "  duplicate fragment"
  end
  if transfer.status == "good" then
    count = #transfer
  elseif #frame.data == 8 then
    count = (size + -size % 8) / 8 + 1
  end
  local texts = source.texts
  if texts.size ~= size or texts.count ~= count then
    texts = { ("%s  Start of %d bytes"):format(source.short, size), size = size, count = count }
    source.texts = texts
  end
  local text = texts[index]
  if text then return text end
  text = index > count and "%s  fragment %d" or "%s  fragment %d of %d"
  texts[index] = text:format(source.short, index, count)
  return texts[index]
end

-- Return the number of the packet in which the message of a fragment ends, on a revisit; nil if it
-- does not end.
local function find_end(self, frame, transfer)
  local last = transfer[#transfer]
  if transfer.payload then return number_of(last) end
  if not transfer.status and last == frame.key then
    self.builder:add_expert(self.item, "unfinished")
  end
end

local function show_fragment(self, result)
  local frame, transfer, wants, number = result.frame, result.transfer, self.wants, nil
  if frame.visited and transfer then number = find_end(self, frame, transfer) end
  if wants.yapp then
    add_fragment(self, result)
    if number then set_generated(add(self.item, self.fields["reassembled.in"], number)) end
    if transfer then self.builder:add_has_fault(self.item, transfer.has_fault) end
  end
  if not wants.columns then return end
  local text = fragment_text(result)
  if number then text = ("%s  [Reassembled in #%d]"):format(text, number) end
  return text
end

-- A frame that belongs to no transfer.
local function show_other(self, result)
  local ctrl, name = result.frame.can_id.ctrl, result.frame.source.label
  if self.wants.yapp then add_fragment(self, result) end
  if not CTRL_NAMES[ctrl] then return ("%s  CAN CTRL %d"):format(name, ctrl) end
  local text = ("%s  %s"):format(name, CTRL_NAMES[ctrl])
  return ctrl ~= START and text .. " without a Start" or text
end

local SHOW = {
  single = show_last, last = show_last, fragment = show_fragment, other = show_other,
}

-- Frames ------------------------------------------------------------------------------------------

local function show_anomalies(self, frame, anomalies)
  local builder, item = self.builder, self.item
  if #frame.data < frame.reported then
    local text = "The capture has %d of the frame's %d bytes"
    builder:add_expert(item, "truncated", text:format(#frame.data, frame.reported))
  end
  if anomalies then builder:add_anomalies(item, anomalies) end
end

--- Show a frame.
-- result  of the reading
-- wants   of Tree:wants
-- tree    nil in a tap, which has none
function FrameView:show(result, wants, tvb, pinfo, tree)
  local frame = result.frame
  self.tvb, self.tree, self.item, self.wants = tvb, tree, tree, wants
  if wants.yapp then
    self.item = add_item(self, frame)
  elseif wants.names then
    self.builder:add_protocol_names(tree, wants, result.message)
  end
  local info = SHOW[result.kind](self, result)
  if not result.is_usual then show_anomalies(self, frame, result.anomalies) end
  if not wants.columns then return end
  local columns = pinfo.cols
  columns.protocol = "YAPP"
  columns.src = frame.source.text
  columns.info = info
end

--- Show a frame that the user calls YAPP, but whose CAN id is not known.  That is the first frame
-- of Decode As, on a pass that builds no tree: an expert item says it to -z expert.
function FrameView:show_without_id(pinfo, tree)
  pinfo.cols.protocol = "YAPP"
  self.builder:add_expert(tree, "can.id.missing")
end

return M
