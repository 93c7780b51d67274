-- SPDX-License-Identifier: GPL-2.0-or-later
-- The view of a packet of a byte stream or datagram: its frames, the bytes of no frame, and the
-- bytes that wait for more.  Wireshark's API.

local frame = require "yapp.wire.frame"
local frame_key = require "yapp.base.frame_key"
local show_fields = require "yapp.show.fields"
local utf8 = require "yapp.base.utf8"

local M = {}

local add, add_le = show_fields.add, show_fields.add_le
local append_text, set_generated = show_fields.append_text, show_fields.set_generated
local HEADER, CRC_SIZE = frame.HEADER, frame.CRC_SIZE
local MAX_IN_INFO = 10 -- frames of a packet

local PacketView = {}
PacketView.__index = PacketView

--- Make the view of packets.
-- builder  a show.tree
function M.new(builder)
  return setmetatable({
    builder = builder,
    fields = builder.fields,
    -- Of the current packet, or of its current message; see Tree:show_message:
    wants = false,
    tree = false,
    item = false,
    payload_tvb = false,
    payload_offset = 0,
  }, PacketView)
end

-- Messages ----------------------------------------------------------------------------------------

-- Add YAPP's own item of a frame; return it.
-- tvb  where the bytes of the frame are
local function add_item(self, result, tvb)
  local builder, fields, transfer = self.builder, self.fields, result.transfer
  local source, offset, payload = result.frame.source, transfer.offset, transfer.payload
  local item = builder:add_item(self.tree, tvb(offset, transfer.length), source.short)
  add(item, fields.sync, tvb(offset, 2))
  add(item, fields.seq, tvb(offset + 2, 1))
  add(item, fields.ctl, tvb(offset + 3, 1))
  builder:add_id(item, tvb(offset + 4, 4), source)
  append_text(add_le(item, fields.size, tvb(offset + 8, 2)), " bytes")
  add_le(item, fields.reserved, tvb(offset + 10, 2))
  builder:add_source(item, source)
  if transfer.packet_keys then
    local range = #payload > 0 and tvb(offset + HEADER, #payload) or nil
    set_generated(add(item, fields["reassembled.in"], result.frame.number))
    builder:add_fragments(item, tvb(), transfer.packet_keys, transfer.length, range)
  end
  if transfer.missing then
    append_text(item, ", incomplete")
  else
    builder:add_crc(item, tvb(offset + HEADER + transfer.size, CRC_SIZE), transfer)
  end
  return item
end

-- Show a message; return its text for the Info column.
local function show_message(self, result, tvb)
  local builder, wants, message = self.builder, self.wants, result.message
  local transfer = result.transfer
  local status, offset = transfer.status, transfer.offset + HEADER
  self.item = wants.tree and add_item(self, result, tvb) or self.tree
  if status == "bad" then builder:add_bad_crc(self.item, transfer) end
  if result.anomalies then builder:add_anomalies(self.item, result.anomalies) end
  local mark = builder.MARKS[status]
  if status ~= "incomplete" or not message.source.type then
    self.payload_tvb, self.payload_offset = wants.tree and tvb, offset
    return builder:show_message(result, self) .. mark
  end
  if wants.yapp and #message.payload > 0 then
    add(self.item, self.fields.payload, tvb(offset, #message.payload))
  end
  return message.source.label .. mark
end

-- Bytes of no frame ------------------------------------------------------------------------------

-- Control characters of a terminal, and how they are shown.
local CONTROLS = {
  ["\a"] = "\\a",
  ["\b"] = "\\b",
  ["\t"] = "\\t",
  ["\n"] = "\\n",
  ["\r"] = "\\r",
  ["\27"] = "\\e",
}

-- Return a space and bytes as quoted text, "" if they are no text.
local function quote(bytes)
  if utf8.ascii(bytes):find("[^%g \a\b\t\n\r\27]") then return "" end
  local text = bytes
  if #bytes > 80 then
    text = bytes:sub(1, 80):gsub("[\192-\255][\128-\191]*$", "") .. "..."
  end
  return ' "' .. text:gsub("%c", CONTROLS) .. '"'
end

-- Show skipped bytes; return their text for the Info column.
local function show_skipped(self, result, tvb)
  local builder, transfer, item = self.builder, result.transfer, self.tree
  local offset, length, text = transfer.offset, transfer.length, quote(transfer.payload)
  local size = builder.bytes_text(length)
  if self.wants.tree then
    item = builder:add_item(item, tvb(offset, length), size .. " skipped")
    append_text(add(item, self.fields.skipped, tvb(offset, length)), text)
  end
  local expert = size .. " that belong to no frame" .. text:gsub("^ ", ": ")
  builder:add_expert(item, "stream.skipped", expert)
  return ("Skipped %s%s"):format(size, text)
end

-- Return the text of the Info column about pending bytes.
local function pending_text(contents, size, leads_to)
  if leads_to then return ("[Reassembled in #%d]"):format(leads_to) end
  if contents.is_held then return ("[%s behind a missing TCP segment]"):format(size) end
  if contents.missing then return ("[%s of a frame, %d to come]"):format(size, contents.missing) end
  return ("[%s wait for more]"):format(size)
end

-- Show the pending bytes of a packet; return their text for the Info column.
local function show_pending(self, packet, contents, tvb)
  local builder, fields, pending, item = self.builder, self.fields, contents.pending, self.tree
  local leads_to = contents.leads_to and frame_key.number(contents.leads_to)
  if self.wants.tree then
    local range = tvb(#packet.bytes - pending, pending)
    item = builder:add_item(item, range, "part of a frame")
    add(item, fields["fragment.data"], range)
    if leads_to then set_generated(add(item, fields["reassembled.in"], leads_to)) end
  end
  if contents.is_unfinished then builder:add_expert(item, "unfinished") end
  return pending_text(contents, builder.bytes_text(pending), leads_to)
end

-- Packets -----------------------------------------------------------------------------------------

-- Show a result; return its text for the Info column.
local function show_result(self, result, tvb)
  local bytes = result.transfer.bytes
  if bytes and self.wants.tree then tvb = ByteArray.new(bytes, true):tvb("Reassembled YAPP") end
  if result.message then return show_message(self, result, tvb) end
  return show_skipped(self, result, tvb)
end

-- Add the expert item of a truncated packet, unless one of its frames has it.
local function show_truncated(self, packet, results, tree)
  local last = results[#results]
  if packet.bytes == "" or last and last.transfer.missing then return end
  local text = "The capture has %d of the packet's %d bytes"
  self.builder:add_expert(tree, "truncated", text:format(#packet.bytes, packet.length))
end

-- Fill the columns.
-- texts   of the Info column; source = text of the first source, or nil
local function show_columns(packet, texts, source, columns)
  columns.protocol, columns.info = "YAPP", table.concat(texts, " | ")
  if source and not packet.line.has_address then columns.src = source end
end

-- Return the first message of a packet that has values; nil for none.
local function find_decoded(results)
  for _, result in ipairs(results) do
    local message = result.message
    if message and message.raws then return message end
  end
end

--- Show the contents of a packet.
-- packet    see host.stream
-- contents  of Reading:add_packet
-- wants     of Tree:wants
-- tvb       where its bytes are, if a tree is wanted
function PacketView:show(packet, contents, wants, tvb, pinfo, tree)
  local texts, source, results = {}, nil, contents.results
  self.wants, self.tree = wants, tree
  if wants.names and not wants.tree then
    self.builder:add_protocol_names(tree, wants, find_decoded(results))
  end
  for i = 1, #results do
    local result = results[i]
    local text = show_result(self, result, tvb)
    source = source or result.message and result.frame.source.text
    if i <= MAX_IN_INFO then texts[i] = text end
  end
  local more = #results - MAX_IN_INFO
  if more > 0 then texts[#texts + 1] = ("and %d more"):format(more) end
  if contents.pending > 0 then
    texts[#texts + 1] = show_pending(self, packet, contents, tvb)
  end
  if wants.columns and texts[1] then show_columns(packet, texts, source, pinfo.cols) end
  if packet.truncated then show_truncated(self, packet, results, tree) end
end

return M
