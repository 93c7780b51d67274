-- SPDX-License-Identifier: GPL-2.0-or-later
-- The view of a packet of a byte stream or datagram: its frames, the bytes of no frame, and the
-- bytes that wait for more.  Wireshark's API.

local frame = require "yapp.wire.frame"
local number_of = require "yapp.base.frame_key".number
local parts = require "yapp.show.parts"
local utf8 = require "yapp.base.utf8"

local M = {}

local add, append_text = TreeItem.add, TreeItem.append_text
local bytes_text = parts.bytes_text
local HEADER, CRC_SIZE = frame.HEADER, frame.CRC_SIZE
local MAX_IN_INFO = 10 -- frames of a packet

local PacketView = parts.new_class()

--- Make the view of packets.
-- options  of show.parts
function M.new(options)
  return parts.new(PacketView, options)
end

-- Results: functions that return the text of the Info column --------------------------------------

-- Begin YAPP's own item of a frame.
local function begin_item(self, result)
  local transfer, source, tvb = result.transfer, result.frame.source, self.tvb
  local offset, payload = transfer.offset, transfer.payload
  self:begin_item(tvb(offset, transfer.length), source.short)
  add(self.item, self.fields.sync, tvb(offset, 2)) -- the one field that is not little-endian
  self:put_bytes("seq", offset + 2, 1)
  self:put_bytes("ctl", offset + 3, 1)
  self:add_id(tvb(offset + 4, 4), source)
  append_text(self:put_bytes("size", offset + 8, 2), " bytes")
  self:put_bytes("reserved", offset + 10, 2)
  self:add_source(source)
  if transfer.packet_keys then
    local range = #payload > 0 and tvb(offset + HEADER, #payload) or nil
    self:put("reassembled.in", result.frame.number)
    self:add_fragments(tvb(), transfer.packet_keys, transfer.length, range)
  end
  if transfer.missing then
    append_text(self.item, ", incomplete")
  else
    self:add_crc_status(self:put_bytes("crc", offset + HEADER + transfer.size, CRC_SIZE), transfer)
  end
end

local function show_message(self, result)
  if self.wants.yapp then begin_item(self, result) end
  self.offset = result.transfer.offset + HEADER
  self:add_anomalies(result.anomalies)
  return self:show_message(result)
end

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
  if not utf8.is_printable((bytes:gsub("[\a\b\t\n\r\27]", ""))) then return "" end
  local text = bytes
  if #bytes > 80 then
    text = bytes:sub(1, 80):gsub("[\192-\255][\128-\191]*$", "") .. "..."
  end
  return ' "' .. text:gsub("%c", CONTROLS) .. '"'
end

local function show_skipped(self, result)
  local transfer = result.transfer
  local offset, length, text = transfer.offset, transfer.length, quote(transfer.payload)
  local size = bytes_text(length)
  if self.wants.yapp then
    self:begin_item(self.tvb(offset, length), size .. " skipped")
    append_text(self:put_bytes("skipped", offset, length), text)
  end
  local expert = size .. " that belong to no frame" .. text:gsub("^ ", ": ")
  self:add_expert("yapp.stream.skipped", expert)
  return ("Skipped %s%s"):format(size, text)
end

-- Show a result of a packet.
-- tvb  of the packet
local function show_result(self, result, tvb)
  local bytes = result.transfer.bytes
  self.item, self.tvb = self.tree, tvb
  if bytes and self.wants.tree then
    self.tvb = ByteArray.new(bytes, true):tvb("Reassembled YAPP")
  end
  if result.message then return show_message(self, result) end
  return show_skipped(self, result)
end

-- Show the pending bytes of a packet.
local function show_pending(self, packet, contents, tvb)
  local pending, leads_to = contents.pending, contents.leads_to and number_of(contents.leads_to)
  local offset = #packet.bytes - pending
  self.item, self.tvb = self.tree, tvb
  if self.wants.yapp then
    self:begin_item(tvb(offset, pending), "part of a frame")
    self:put_bytes("fragment.data", offset, pending)
    if leads_to then self:put("reassembled.in", leads_to) end
  end
  if contents.is_unfinished then self:add_expert("yapp.unfinished") end
  if leads_to then return ("[Reassembled in #%d]"):format(leads_to) end
  return ("[%s wait for more]"):format(bytes_text(pending))
end

-- Packets -----------------------------------------------------------------------------------------

-- Add the expert item of a truncated packet, unless one of its frames has it.
local function show_truncated(self, packet, results)
  local last = results[#results]
  if packet.bytes == "" or last and last.transfer.missing then return end
  self.item = self.tree
  self:add_truncated("packet", #packet.bytes, packet.length)
end

-- Return the first message of a packet that has values, or nil.
local function find_decoded(results)
  for _, result in ipairs(results) do
    if result.message and result.message.raws then return result.message end
  end
end

--- Show the contents of a packet.
-- packet    see host.stream
-- contents  of Reading:add_packet
-- wants     of show.wants
-- tvb       where its bytes are, if a tree is wanted
function PacketView:show(packet, contents, wants, tvb, pinfo, tree)
  local texts, source, results = {}, nil, contents.results
  self:begin(wants, tvb, tree, wants.names and find_decoded(results))
  for i, result in ipairs(results) do
    local text = show_result(self, result, tvb)
    source = source or result.message and result.frame.source.text
    if i <= MAX_IN_INFO then texts[i] = text end
  end
  local more = #results - MAX_IN_INFO
  if more > 0 then texts[#texts + 1] = ("and %d more"):format(more) end
  if contents.pending > 0 then texts[#texts + 1] = show_pending(self, packet, contents, tvb) end
  if wants.columns and texts[1] then
    local columns = pinfo.cols
    columns.protocol, columns.info = "YAPP", table.concat(texts, " | ")
    if source and not packet.line.has_address then columns.src = source end
  end
  if packet.truncated then show_truncated(self, packet, results) end
end

return M
