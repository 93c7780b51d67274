-- SPDX-License-Identifier: GPL-2.0-or-later
-- The view of a CAN frame, and of a packet of a byte stream or datagram: its tree, its expert
-- items, its columns.  Wireshark's API.
--
-- A view draws one result after the other on
--   tree         Wireshark's; nil in a tap, which has none
--   item         YAPP's own item of the message, or the tree if that item is not wanted
--   tvb, offset  where the bytes of the frame are, and then those of the message's payload; used
--                only if an item is wanted
-- What is wanted (show.wants) is asked for before each item, but not for expert items: Wireshark
-- lists them always.

local can_id = require "yapp.wire.can_id"
local catalogue_compiler = require "yapp.message.catalogue"
local frame_of = require "yapp.wire.frame"
local number_of = require "yapp.base.frame_key".number
local show_fields = require "yapp.show.fields"

local View = {}
View.__index = View

local add, add_le = TreeItem.add, TreeItem.add_le
local append_text, set_generated = TreeItem.append_text, TreeItem.set_generated
local CTRL_NAMES, START = can_id.CTRL_NAMES, can_id.START
local HEADER, CRC_SIZE = frame_of.HEADER, frame_of.CRC_SIZE

-- By status of a transfer: crc.status, and the text behind the item.
local CRC = { bad = { 0, ", CRC BAD" }, good = { 1, ", CRC good" } }
local UNVERIFIED = { 2, ", CRC unverified" }

--- Make the view.
-- options  { yapp = Proto; fields = of show.fields; taurus = a show.taurus; messages = of the
--          catalogue; names = { [id] = title } }
function View.new(options)
  return setmetatable(options, View)
end

-- Begin with a frame or packet.
local function begin(self, wants, tvb, tree)
  self.wants, self.tvb, self.tree, self.item, self.offset = wants, tvb, tree, tree, 0
  self.needs_name = false
  if not (wants.names and tree) then return end
  add(tree, self.yapp)
  self.needs_name = not wants.taurus -- of the Taurus messages
end

-- Single items ------------------------------------------------------------------------------------

-- Return a number of bytes in words: "1 byte", "2 bytes".
local function bytes_text(count)
  return count == 1 and "1 byte" or ("%d bytes"):format(count)
end

-- Begin YAPP's own item.
-- text  behind the name of the protocol
local function begin_item(self, range, text)
  self.item = add(self.tree, self.yapp, range, self.yapp.description .. ", " .. text)
end

-- Add a field whose value no bytes of the packet hold; return its item.
-- name  its filter without "yapp."
local function put(self, name, value)
  return set_generated(add(self.item, self.fields[name], value))
end

-- Add a field of bytes, or of a little-endian number; return its item.
local function put_bytes(self, name, offset, length)
  return add_le(self.item, self.fields[name], self.tvb(offset, length))
end

-- Add an expert item.
-- text  as show.fields, add_expert takes it
local function add_expert(self, name, text)
  show_fields.add_expert(self.item, "yapp." .. name, text)
end

-- Add the expert items of anomalies.
-- anomalies  of a result, or false
local function add_anomalies(self, anomalies)
  for _, anomaly in ipairs(anomalies or {}) do add_expert(self, anomaly.expert, anomaly.text) end
end

-- Add the id, with the name that the user's mapping gives it, the bus, where there is one, and the
-- source.
-- range   TvbRange of the id, nil where the CAN id has it
-- source  of message.types
local function add_source(self, range, source)
  local id, title = source.id, source.type and source.type.title
  local item = range and add(self.item, self.fields.id, range, id) or put(self, "id", id)
  if title ~= self.names[id] then
    item:set_text(("Message ID: %s (0x%08x)"):format(title or "Unknown", id))
  end
  if source.bus then put(self, "bus", source.bus) end
  put(self, "source", source.text)
end

-- Add the frames that a message was put together from.
-- whole    TvbRange
-- keys     of its frames
-- length   in bytes
-- payload  TvbRange of the message's payload, nil where it has none
local function add_fragments(self, whole, keys, length, payload)
  local fields, list = self.fields, put(self, "fragments", whole)
  for _, key in ipairs(keys) do
    set_generated(add(list, fields.fragment, number_of(key)))
  end
  set_generated(add(list, fields["fragment.count"], #keys))
  set_generated(add(list, fields["reassembled.length"], length))
  if payload then set_generated(add(list, fields["reassembled.data"], payload)) end
end

-- Add the status of a transfer's CRC, which stands behind the item, too.
local function add_crc_status(self, transfer)
  local shown = CRC[transfer.status] or UNVERIFIED
  put(self, "crc.status", shown[1])
  if transfer.calculated then put(self, "crc.calculated", transfer.calculated) end
  append_text(self.item, shown[2])
end

-- Messages ----------------------------------------------------------------------------------------

-- Add what the message's history says to YAPP's own item: the time since the previous one, how many
-- are missing, whether a fault is set.
local function add_history(self, message)
  local delta, missing = message.delta, message.change and message.change.missing
  if delta then put(self, "time_delta", show_fields.relative_time(delta)) end
  if missing then put(self, "seq.missing", missing) end
  if message.copy_of then put(self, "copy_of", number_of(message.copy_of)) end
  if message.has_fault then put(self, "message.fault", true) end
end

-- Add the bytes of a payload from an offset on.
-- name  of the field, without "yapp."
local function add_payload(self, message, name, offset)
  local length = #message.payload - offset
  if self.wants.yapp and length > 0 then put_bytes(self, name, self.offset + offset, length) end
end

-- Show that an ID is not in the catalogue, and which message type has the size.
-- returns  the text for the Info column
local function show_unknown(self, message)
  local source, size = message.source, message.transfer.size
  local info = ("%s  %s"):format(source.label, bytes_text(#message.payload))
  local like = message.status == "good" and catalogue_compiler.of_size(self.messages, size)[1]
  if like then
    if self.wants.yapp then put(self, "like." .. like.name, source.id) end
    info = ("%s, the size of %s"):format(info, like.title)
  end
  add_expert(self, "id.unknown")
  return info
end

-- Return the text of a message's values in Info.  The source stands in it even if a column shows it
-- where something is wrong: Wireshark's list of expert items has no such column.
local function values_text(result)
  local message = result.message
  local source = message.source
  local name = result.is_usual and source.short or source.label
  return name .. "  " .. source.write(message.raws)
end

-- Show the bytes of a message without values; return the text for the Info column.
local function show_bytes(self, message)
  local transfer, source = message.transfer, message.source
  local label, least, most = source.label, source.min_size, source.size
  add_payload(self, message, "payload", 0)
  if transfer.status == "incomplete" or transfer.status == "overrun" then
    local received = transfer.received or #message.payload
    return ("%s  %d of %d bytes"):format(label, received, transfer.size)
  end
  if not most then return show_unknown(self, message) end
  add_expert(self, "size.mismatch")
  local known = least < most and ("%d to %d"):format(least, most) or most
  return ("%s, %s, the catalogue says %s"):format(label, bytes_text(transfer.size), known)
end

-- Show that a transfer is not good.
-- returns  the text for the Info column with that
local function show_damage(self, transfer, info)
  local status = transfer.status
  if status ~= "bad" then return ("%s  [%s]"):format(info, status:upper()) end
  add_expert(self, "crc.bad")
  return "BAD CRC  " .. info
end

-- Show a message: its values if it is in the catalogue, or its bytes.
-- result   of the reading, with the message
-- returns  its text for the Info column; only a part of that if there are no columns
local function show_message(self, result)
  local message, wants, info = result.message, self.wants, ""
  local transfer = message.transfer
  if wants.yapp then add_history(self, message) end
  if not message.raws then
    info = show_bytes(self, message)
  elseif wants.columns then
    info = values_text(result)
  end
  if self.needs_name and message.raws then
    self.taurus:add_name(self.tree)
    self.needs_name = false
  end
  if wants.tree or not result.is_usual then
    local before, behind = self.taurus:show(message, self)
    info = before .. info .. behind
  end
  if transfer.status ~= "good" then info = show_damage(self, transfer, info) end
  if message.copy_of then
    add_expert(self, "copy")
    info = ("%s  [copy of #%d]"):format(info, number_of(message.copy_of))
  end
  if message.undecoded then
    add_payload(self, message, "undecoded", message.source.size)
    add_expert(self, "size.mismatch")
    local size = bytes_text(transfer.size)
    info = ("%s  [%s, %d not decoded]"):format(info, size, message.undecoded)
  end
  return info
end

-- CAN frames --------------------------------------------------------------------------------------

-- Begin YAPP's own item, with the fields of the CAN id as generated items.
local function begin_frame(self, frame)
  local fields, source = frame.can_id, frame.source
  local kind = CTRL_NAMES[fields.ctrl] or "undefined frame"
  begin_item(self, self.tvb(), source.short .. ", " .. kind)
  add_source(self, nil, source)
  put(self, "ctl", fields.ctl)
  put(self, "seq", fields.seq)
  put(self, "can.ctrl", fields.ctrl)
end

-- Add what the last of several frames completes: size, CRC and fragments.
-- tvb  of the payload, false if it is empty
local function add_transfer(self, frame, transfer, tvb)
  local range = tvb and tvb()
  put(self, "reassembled.in", frame.number)
  put(self, "size", transfer.size)
  put(self, "reserved", transfer.reserved or 0)
  put(self, "crc", transfer.crc)
  add_crc_status(self, transfer)
  add_fragments(self, range or self.tvb(), transfer, #transfer.payload, range)
end

-- Show the frame that has a whole message, or its last fragment, and the message.
-- returns  the text for the Info column
local function show_last(self, result)
  local frame, transfer, wants = result.frame, result.transfer, self.wants
  local tvb, is_joined = self.tvb, #transfer > 1
  if is_joined and wants.tree then
    local payload = transfer.payload
    tvb = payload ~= "" and ByteArray.new(payload, true):tvb("Reassembled YAPP")
  end
  if wants.yapp then
    if is_joined then add_transfer(self, frame, transfer, tvb) end
    local start, length = frame.reported - (transfer.padding or 0), #frame.data
    if start < length then put_bytes(self, "padding", start, length - start) end
  end
  self.tvb = tvb
  return show_message(self, result)
end

-- Return the number of the packet in which the message of a fragment ends, on a revisit; nil if it
-- does not end.
local function find_end(self, frame, transfer)
  local last = transfer[#transfer]
  if transfer.payload then return number_of(last) end
  if not transfer.status and last == frame.key then add_expert(self, "unfinished") end
end

-- Add the fields in the bytes of a frame that ends no message.
local function add_bytes(self, frame)
  local length = #frame.data
  if frame.can_id.ctrl == START and length >= 8 then
    put_bytes(self, "crc", 0, 4)
    put_bytes(self, "size", 4, 2)
    put_bytes(self, "reserved", 6, 2)
  elseif length > 0 then
    put_bytes(self, "fragment.data", 0, length)
  end
end

-- Return the text of the Info column of a frame that ends no message.
local function fragment_text(frame, transfer)
  local ctrl, source = frame.can_id.ctrl, frame.source
  local name = CTRL_NAMES[ctrl] or "CAN CTRL " .. ctrl
  if not transfer then return source.label .. "  " .. name .. " of no message" end
  local text = source.short .. "  " .. name
  return ctrl == START and text .. " of " .. transfer.size .. " bytes" or text
end

-- Show a frame that ends no message; return the text for the Info column.
local function show_fragment(self, result)
  local frame, transfer, number = result.frame, result.transfer, nil
  if frame.visited and transfer then number = find_end(self, frame, transfer) end
  if self.wants.yapp then
    add_bytes(self, frame)
    if number then put(self, "reassembled.in", number) end
    if transfer and transfer.has_fault then put(self, "message.fault", true) end
  end
  if not self.wants.columns then return end
  local text = fragment_text(frame, transfer)
  return number and ("%s  [Reassembled in #%d]"):format(text, number) or text
end

--- Show a CAN frame.
-- result  of the reading
-- wants   of show.wants
-- tree    nil in a tap, which has none
function View:show_frame(result, wants, tvb, pinfo, tree)
  local frame = result.frame
  begin(self, wants, tvb, tree)
  if wants.yapp then begin_frame(self, frame) end
  local info = (result.message and show_last or show_fragment)(self, result)
  if not result.is_usual then
    if #frame.data < frame.reported then add_expert(self, "truncated") end
    add_anomalies(self, result.anomalies)
  end
  if not wants.columns then return end
  local columns = pinfo.cols
  columns.protocol = "YAPP"
  columns.src = frame.source.text
  columns.info = info
end

--- Show a frame that the user calls YAPP, but whose CAN id is not known.  That is the first frame
-- of Decode As, on a pass that builds no tree: an expert item says it to -z expert.
function View:show_without_id(pinfo, tree)
  pinfo.cols.protocol = "YAPP"
  self.item = tree
  add_expert(self, "can.id.missing")
end

-- Packets of streams ------------------------------------------------------------------------------

-- Begin YAPP's own item of a frame in a stream.
local function begin_stream_frame(self, result)
  local transfer, source, tvb = result.transfer, result.frame.source, self.tvb
  local offset, payload = transfer.offset, transfer.payload
  begin_item(self, tvb(offset, transfer.length), source.short)
  add(self.item, self.fields.sync, tvb(offset, 2)) -- the one field that is not little-endian
  put_bytes(self, "seq", offset + 2, 1)
  put_bytes(self, "ctl", offset + 3, 1)
  add_source(self, tvb(offset + 4, 4), source)
  put_bytes(self, "size", offset + 8, 2)
  put_bytes(self, "reserved", offset + 10, 2)
  if transfer.packet_keys then
    local range = #payload > 0 and tvb(offset + HEADER, #payload) or nil
    put(self, "reassembled.in", result.frame.number)
    add_fragments(self, tvb(), transfer.packet_keys, transfer.length, range)
  end
  if transfer.missing then
    append_text(self.item, ", incomplete")
  else
    put_bytes(self, "crc", offset + HEADER + transfer.size, CRC_SIZE)
    add_crc_status(self, transfer)
  end
end

-- Show bytes of no frame; return the text for the Info column.
local function show_skipped(self, transfer)
  local offset, length = transfer.offset, transfer.length
  local text = transfer.payload:sub(1, 80):gsub("[^ -~]", ".") -- as a hex dump shows bytes
  local size = bytes_text(length)
  if self.wants.yapp then
    begin_item(self, self.tvb(offset, length), size .. " skipped")
    put_bytes(self, "skipped", offset, length)
  end
  add_expert(self, "stream.skipped")
  return ('Skipped %s "%s"'):format(size, text)
end

-- Show a result of a packet; return the text for the Info column.
-- tvb  of the packet
local function show_result(self, result, tvb)
  local transfer = result.transfer
  self.item, self.tvb = self.tree, tvb
  if transfer.bytes and self.wants.tree then
    self.tvb = ByteArray.new(transfer.bytes, true):tvb("Reassembled YAPP")
  end
  if not result.message then return show_skipped(self, transfer) end
  if self.wants.yapp then begin_stream_frame(self, result) end
  self.offset = transfer.offset + HEADER
  add_anomalies(self, result.anomalies)
  return show_message(self, result)
end

-- Show the pending bytes of a packet; return the text for the Info column.
local function show_pending(self, packet, contents, tvb)
  local pending, leads_to = contents.pending, contents.leads_to and number_of(contents.leads_to)
  local offset = #packet.bytes - pending
  self.item, self.tvb = self.tree, tvb
  if self.wants.yapp then
    begin_item(self, tvb(offset, pending), "part of a frame")
    put_bytes(self, "fragment.data", offset, pending)
    if leads_to then put(self, "reassembled.in", leads_to) end
  end
  if contents.is_unfinished then add_expert(self, "unfinished") end
  if leads_to then return ("[Reassembled in #%d]"):format(leads_to) end
  return ("[%s wait for more]"):format(bytes_text(pending))
end

--- Show the contents of a packet.
-- packet    see host.stream
-- contents  of Reading:read_packet
-- wants     of show.wants
-- tvb       where its bytes are, if a tree is wanted
function View:show_packet(packet, contents, wants, tvb, pinfo, tree)
  local texts, source, results = {}, nil, contents.results
  begin(self, wants, tvb, tree)
  for i, result in ipairs(results) do
    texts[i] = show_result(self, result, tvb)
    source = source or result.message and result.frame.source.text
  end
  if contents.pending > 0 then texts[#texts + 1] = show_pending(self, packet, contents, tvb) end
  if wants.columns and texts[1] then
    local columns = pinfo.cols
    columns.protocol, columns.info = "YAPP", table.concat(texts, " | ")
    if source and not packet.line.has_address then columns.src = source end
  end
  local last = results[#results]
  local is_said = packet.bytes == "" or last and last.transfer.missing -- by one of its frames
  if packet.truncated and not is_said then
    self.item = tree
    add_expert(self, "truncated")
  end
end

return View
