-- SPDX-License-Identifier: GPL-2.0-or-later
-- The parts that the views of a CAN frame (show.frame) and of a packet of a stream (show.packet)
-- have in common.  Wireshark's API.
--
-- A view draws one result after the other on
--   tree         Wireshark's; nil in a tap, which has none
--   item         YAPP's own item of the message, or the tree if that item is not wanted
--   tvb, offset  where the bytes of the frame are, and then those of the message's payload; used
--                only if an item is wanted
-- What is wanted (show.wants) is asked for before each item, but not for expert items: Wireshark
-- lists them always.

local catalogue_compiler = require "yapp.message.catalogue"
local number_of = require "yapp.base.frame_key".number
local show_fields = require "yapp.show.fields"

local M = {}

local add, add_le = TreeItem.add, TreeItem.add_le
local append_text, set_generated = TreeItem.append_text, TreeItem.set_generated

-- By status: crc.status, the text behind the CRC, and the text of the item.
local CRC = {
  bad = { 0, " [incorrect, should be 0x%08x]", ", CRC BAD" },
  good = { 1, " [correct]", ", CRC good" },
}
local UNVERIFIED = { 2, " [unverified]", ", CRC unverified" }

-- By status: the last word in Info, of a transfer that is neither good nor bad.
local MARKS = {
  incomplete = "  [INCOMPLETE]",
  overrun = "  [OVERRUN]",
  truncated = "  [TRUNCATED]",
}

local View = {}
View.__index = View

--- Make a class of views.
function M.new_class()
  local class = setmetatable({}, View)
  class.__index = class
  return class
end

--- Make a view.
-- class    of M.new_class, with methods of its own
-- options  { yapp = Proto; fields = of show.fields; taurus = a show.taurus; messages = of the
--          catalogue; names = { [id] = title } }
function M.new(class, options)
  return setmetatable({
    yapp = options.yapp,
    label = options.yapp.description .. ", ", -- of YAPP's items
    fields = options.fields,
    taurus = options.taurus,
    messages = options.messages,
    names = options.names,
    -- See above:
    wants = false,
    tree = false,
    item = false,
    tvb = false,
    offset = 0,
  }, class)
end

--- Begin with a frame or packet.
-- message  that it has, or nil; for the names of the protocols
function View:begin(wants, tvb, tree, message)
  self.wants, self.tvb, self.tree, self.item = wants, tvb, tree, tree
  if not (wants.names and tree) then return end
  add(tree, self.yapp)
  if message and message.raws and not wants.taurus then self.taurus:add_name(tree) end
end

-- Single items ------------------------------------------------------------------------------------

--- Return a number of bytes in words: "1 byte", "2 bytes".
function M.bytes_text(count)
  return count == 1 and "1 byte" or ("%d bytes"):format(count)
end

--- Begin YAPP's own item.
-- text  behind the name of the protocol
function View:begin_item(range, text)
  self.item = add(self.tree, self.yapp, range, self.label .. text)
end

--- Add a field whose value no bytes of the packet hold; return its item.
-- name  its filter without "yapp."
function View:put(name, value)
  return set_generated(add(self.item, self.fields[name], value))
end

--- Add a field of bytes, or of a little-endian number; return its item.
function View:put_bytes(name, offset, length)
  return add_le(self.item, self.fields[name], self.tvb(offset, length))
end

--- Add an expert item.
-- name, text  as show.fields, add_expert takes them
function View:add_expert(name, text)
  show_fields.add_expert(self.item, name, text)
end

--- Add the expert item of a truncated frame or packet.
-- what  it is called
function View:add_truncated(what, captured, length)
  local text = "The capture has %d of the %s's %d bytes"
  self:add_expert("yapp.truncated", text:format(captured, what, length))
end

--- Add the expert items of anomalies.
-- anomalies  of a result, or false
function View:add_anomalies(anomalies)
  for _, anomaly in ipairs(anomalies or {}) do
    self:add_expert("yapp." .. anomaly.expert, anomaly.text)
  end
end

--- Add the id, with the name that the user's mapping gives it.
-- range   TvbRange, nil where the CAN id has it
-- source  of message.types
function View:add_id(range, source)
  local id, title = source.id, source.type and source.type.title
  local field = self.fields.id
  local item = range and add(self.item, field, range, id) or self:put("id", id)
  if title == self.names[id] then return end
  item:set_text(("Message ID: %s (0x%08x)"):format(title or "Unknown", id))
end

--- Add the bus, where there is one, and the source.
-- source  of message.types
function View:add_source(source)
  if source.bus then self:put("bus", source.bus) end
  self:put("source", source.text)
end

--- Add the frames that a message was put together from.
-- whole    TvbRange
-- keys     of its frames
-- length   in bytes
-- payload  TvbRange of the message's payload, nil where it has none
function View:add_fragments(whole, keys, length, payload)
  local fields, list = self.fields, self:put("fragments", whole)
  list:set_text(("%d fragments (%d bytes)"):format(#keys, length))
  for _, key in ipairs(keys) do
    set_generated(add(list, fields.fragment, number_of(key)))
  end
  set_generated(add(list, fields["fragment.count"], #keys))
  set_generated(add(list, fields["reassembled.length"], length))
  if payload then set_generated(add(list, fields["reassembled.data"], payload)) end
end

--- Finish a CRC: its status stands behind it and behind the item.
-- crc       its item
-- transfer  { status; calculated = CRC of a bad one }
function View:add_crc_status(crc, transfer)
  local shown, calculated = CRC[transfer.status] or UNVERIFIED, transfer.calculated
  append_text(crc, shown[2]:format(calculated))
  self:put("crc.status", shown[1])
  if shown == CRC.bad then self:put("crc.calculated", calculated) end
  append_text(self.item, shown[3])
end

--- Add that a message has a fault, in each of its frames.
function View:add_has_fault(has_fault)
  if has_fault then self:put("message.fault", true) end
end

-- Messages ----------------------------------------------------------------------------------------

-- Add what the message's history says to YAPP's own item: the time since the previous one, how many
-- are missing, whether a fault is set.
local function add_history(self, message)
  local delta, missing = message.delta, message.change and message.change.missing
  if delta then self:put("time_delta", show_fields.relative_time(delta)) end
  if missing then self:put("seq.missing", missing) end
  if message.copy_of then self:put("copy_of", number_of(message.copy_of)) end
  self:add_has_fault(message.has_fault)
end

--- Add the bytes of a payload from an offset on.
-- name  of the field, without "yapp."
function View:add_payload(message, name, offset)
  local length = #message.payload - offset
  if self.wants.yapp and length > 0 then self:put_bytes(name, self.offset + offset, length) end
end

-- Add the expert item of a payload that does not have the catalogue's size.
-- returns  its text
local function add_mismatch(self, message)
  local source, size = message.source, M.bytes_text(message.transfer.size)
  local least, most = source.min_size, source.size
  local known = least < most and ("%d to %d"):format(least, most) or most
  local text = ("%s, %s, the catalogue says %s"):format(source.label, size, known)
  self:add_expert("yapp.size.mismatch", text)
  return text
end

-- Show that an ID is not in the catalogue.  If a message type has the size, the expert item has the
-- whole preference that decodes the ID.
-- returns  the text for the Info column
local function show_unknown(self, message)
  local id, size = message.source.id, message.transfer.size
  local text = ("Message ID 0x%x is not in the catalogue"):format(id)
  local info = ("%s  %s"):format(message.source.label, M.bytes_text(#message.payload))
  local like = message.status == "good" and catalogue_compiler.of_size(self.messages, size)[1]
  if like then
    if self.wants.yapp then self:put("like." .. like.name, id) end
    local name = like.name .. "_ids"
    text = ("%s; it has the size of %s: -o yapp.%s:%s,0x%x decodes it"):format(text, like.title,
      name, self.yapp.prefs[name], id)
    info = ("%s, the size of %s"):format(info, like.title)
  end
  self:add_expert("yapp.id.unknown", text)
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
  local transfer, label, count = message.transfer, message.source.label, #message.payload
  self:add_payload(message, "payload", 0)
  if transfer.status == "incomplete" or transfer.status == "overrun" then
    local received = transfer.received or count
    return ("%s  %d of %d bytes"):format(label, received, transfer.size)
  end
  return message.source.type and add_mismatch(self, message) or show_unknown(self, message)
end

-- Show that a transfer is not good.
-- returns  the text for the Info column with that
local function show_damage(self, transfer, info)
  if transfer.status ~= "bad" then return info .. MARKS[transfer.status] end
  local text = "Received 0x%08x, expected 0x%08x"
  self:add_expert("yapp.crc.bad", text:format(transfer.crc, transfer.calculated))
  return "BAD CRC  " .. info
end

--- Show a message: its values if it is in the catalogue, or its bytes.
-- result   of the reading, with the message
-- returns  its text for the Info column; only a part of that if there are no columns
function View:show_message(result)
  local message, wants, info = result.message, self.wants, ""
  local transfer = message.transfer
  if wants.yapp then add_history(self, message) end
  if not message.raws then
    info = show_bytes(self, message)
  elseif wants.columns then
    info = values_text(result)
  end
  if wants.tree or not result.is_usual then
    local before, behind = self.taurus:show(message, self)
    info = before .. info .. behind
  end
  if transfer.status ~= "good" then info = show_damage(self, transfer, info) end
  if message.copy_of then
    self:add_expert("yapp.copy")
    info = ("%s  [copy of #%d]"):format(info, number_of(message.copy_of))
  end
  if message.undecoded then
    self:add_payload(message, "undecoded", message.source.size)
    add_mismatch(self, message)
    local size = M.bytes_text(transfer.size)
    info = ("%s  [%s, %d not decoded]"):format(info, size, message.undecoded)
  end
  return info
end

return M
