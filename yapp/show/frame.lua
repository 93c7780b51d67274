-- SPDX-License-Identifier: GPL-2.0-or-later
-- The view of a CAN frame: its tree, its expert items, its columns.  One function for each
-- kind of result.  Wireshark's API.

local can_id = require "yapp.wire.can_id"
local number_of = require "yapp.base.frame_key".number
local parts = require "yapp.show.parts"

local M = {}

local CTRL_NAMES, START = can_id.CTRL_NAMES, can_id.START
local append_text = TreeItem.append_text

local FrameView = parts.new_class()

--- Make the view of CAN frames.
-- options  of show.parts
function M.new(options)
  return parts.new(FrameView, options)
end

-- YAPP's own item ---------------------------------------------------------------------------------

-- Begin YAPP's own item, with the fields of the CAN id as generated items.
local function begin_item(self, frame)
  local fields, source = frame.can_id, frame.source
  local kind = CTRL_NAMES[fields.ctrl] or "undefined frame"
  self:begin_item(self.tvb(), source.short .. ", " .. kind)
  self:add_id(nil, source)
  self:put("ctl", fields.ctl)
  self:put("seq", fields.seq)
  self:put("can.ctrl", fields.ctrl)
  self:add_source(source)
end

-- Add the fields in the bytes of a fragment.  A truncated Start has only the fields that were
-- captured.
local function add_fragment(self, result)
  local length, transfer = #result.frame.data, result.transfer
  if result.frame.can_id.ctrl ~= START then
    if length > 0 then self:put_bytes("fragment.data", 0, length) end
    return
  end
  if length >= 4 then self:put_bytes("crc", 0, 4) end
  if length >= 6 then append_text(self:put_bytes("size", 4, 2), " bytes") end
  if length >= 8 then self:put_bytes("reserved", 6, 2) end
  if transfer then append_text(self.item, (" of %d bytes"):format(transfer.size)) end
end

-- Add what the last of several frames completes: size, CRC and fragments.
-- tvb  of the payload, false if it is empty
local function add_transfer(self, frame, transfer, tvb)
  local range = tvb and tvb()
  self:put("reassembled.in", frame.number)
  append_text(self:put("size", transfer.size), " bytes")
  self:put("reserved", transfer.reserved or 0)
  self:add_crc_status(self:put("crc", transfer.crc), transfer)
  self:add_fragments(range or self.tvb(), transfer, #transfer.payload, range)
end

-- By kind of result: functions that return the text of the Info column ----------------------------

-- Show the frame that has a whole message, or its last fragment, and the message.
local function show_last(self, result)
  local frame, transfer, wants = result.frame, result.transfer, self.wants
  local payload_tvb = self.tvb
  local is_joined = #transfer > 1
  if is_joined and wants.tree then
    local payload = transfer.payload
    payload_tvb = payload ~= "" and ByteArray.new(payload, true):tvb("Reassembled YAPP")
  end
  if wants.yapp then
    if is_joined then add_transfer(self, frame, transfer, payload_tvb) end
    local start, length = frame.reported - (transfer.padding or 0), #frame.data
    if start < length then self:put_bytes("padding", start, length - start) end
  end
  self.tvb = payload_tvb
  return self:show_message(result)
end

-- By source: the texts of the fragments of its messages of one size and number of fragments.
local texts_by_source = setmetatable({}, { __mode = "k" })

-- Return the text of a fragment.  A good transfer has a known number of fragments; for another one
-- assume the number that classic CAN needs.
local function fragment_text(result)
  local frame, transfer, source = result.frame, result.transfer, result.frame.source
  if not transfer then return source.label .. "  fragment of no message" end
  local index, size, count = result.index or #transfer, transfer.size, 0
  if transfer[index] ~= frame.key then return source.label .. "  duplicate fragment" end
  if transfer.status == "good" then
    count = #transfer
  elseif #frame.data == 8 then
    count = (size + -size % 8) / 8 + 1
  end
  local texts = texts_by_source[source]
  if not texts or texts.size ~= size or texts.count ~= count then
    texts = { ("%s  Start of %d bytes"):format(source.short, size), size = size, count = count }
    texts_by_source[source] = texts
  end
  if not texts[index] then
    local text = index > count and "%s  fragment %d" or "%s  fragment %d of %d"
    texts[index] = text:format(source.short, index, count)
  end
  return texts[index]
end

-- Return the number of the packet in which the message of a fragment ends, on a revisit; nil if it
-- does not end.
local function find_end(self, frame, transfer)
  local last = transfer[#transfer]
  if transfer.payload then return number_of(last) end
  if not transfer.status and last == frame.key then self:add_expert("yapp.unfinished") end
end

local function show_fragment(self, result)
  local frame, transfer, number = result.frame, result.transfer, nil
  if frame.visited and transfer then number = find_end(self, frame, transfer) end
  if self.wants.yapp then
    add_fragment(self, result)
    if number then self:put("reassembled.in", number) end
    if transfer then self:add_has_fault(transfer.has_fault) end
  end
  if not self.wants.columns then return end
  local text = fragment_text(result)
  return number and ("%s  [Reassembled in #%d]"):format(text, number) or text
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

local function add_anomalies(self, result)
  local captured, reported = #result.frame.data, result.frame.reported
  if captured < reported then self:add_truncated("frame", captured, reported) end
  self:add_anomalies(result.anomalies)
end

--- Show a frame.
-- result  of the reading
-- wants   of show.wants
-- tree    nil in a tap, which has none
function FrameView:show(result, wants, tvb, pinfo, tree)
  local frame = result.frame
  self:begin(wants, tvb, tree, result.message)
  if wants.yapp then begin_item(self, frame) end
  local info = SHOW[result.kind](self, result)
  if not result.is_usual then add_anomalies(self, result) end
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
  self.item = tree
  self:add_expert("yapp.can.id.missing")
end

return M
