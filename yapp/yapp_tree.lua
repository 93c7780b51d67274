-- What a user sees of YAPP: the fields, the expert items, the tree, the Info column. The messages: yapp_tree_taurus.
-- Wireshark's API; what is shown comes in finished, from the reassembly or the framing.

local tree_taurus = require("yapp_tree_taurus")

local M = {}

local FRAME_KINDS = { [0] = "Single", "Start", "Middle", "End" }
local CRC_STATUS = { [0] = "Bad", "Good", "Unverified" }
local STATUS_CODE = { bad = 0, good = 1 } -- any other is unverified
local UNVERIFIED = 2

-- filter, kind, title, base or type, values
local FIELDS = {
  { "id", "uint32", "Message ID", "HEX" },
  { "ctl", "uint8", "Control (CTL)", "DEC" },
  { "seq", "uint8", "Sequence number", "DEC" },
  { "size", "uint16", "Payload size", "DEC" },
  { "reserved", "uint16", "Reserved", "HEX" },
  { "sync", "uint16", "Sync", "HEX" },
  { "can.ctrl", "uint8", "CAN frame", "DEC", FRAME_KINDS },
  { "crc", "uint32", "CRC", "HEX" },
  { "crc.status", "uint8", "CRC status", "DEC", CRC_STATUS },
  { "crc.calculated", "uint32", "Calculated CRC", "HEX" },
  { "payload", "bytes", "Payload" },
  { "padding", "bytes", "CAN FD padding" },
  { "fragments", "none", "Fragments" },
  { "fragment", "framenum", "Fragment" },
  { "fragment.data", "bytes", "Fragment data" },
  { "fragment.count", "uint32", "Fragment count", "DEC" },
  { "reassembled.in", "framenum", "Reassembled in" },
  { "reassembled.length", "uint32", "Reassembled length", "DEC" },
  { "skipped", "bytes", "Skipped bytes" },
  { "time_delta", "relative_time", "Time since the previous message with this ID" },
}

-- filter, what it says by itself, group, severity
local YAPP_EXPERTS = {
  { "crc.bad", "Bad CRC", "CHECKSUM", "ERROR" },
  { "fragment.orphan", "Middle or End without a Start", "SEQUENCE", "WARN" },
  { "fragment.incomplete", "Message with bytes missing", "REASSEMBLE", "WARN" },
  { "fragment.overrun", "More bytes than the message's size", "REASSEMBLE", "WARN" },
  { "size.mismatch", "Payload length is not the catalogue's", "PROTOCOL", "WARN" },
  { "id.unknown", "Message ID is not in the catalogue", "UNDECODED", "NOTE" },
  { "reserved.nonzero", "Reserved bytes are not 0", "PROTOCOL", "WARN" },
  { "can.ctrl.invalid", "CAN CTRL is not defined", "PROTOCOL", "WARN" },
  { "can.id.missing", "The CAN id of this frame is not known", "UNDECODED", "WARN" },
  { "stream.skipped", "Bytes that belong to no frame", "SEQUENCE", "NOTE" },
  { "truncated", "The capture cut the packet short", "MALFORMED", "WARN" },
}

local function make_yapp_fields(names)
  local fields = {}
  for _, row in ipairs(FIELDS) do
    local name, kind, title = row[1], row[2], row[3]
    local filter, values = "yapp." .. name, row[5]
    if name == "id" then values = names end
    if kind == "framenum" then
      fields[name] = ProtoField.framenum(filter, title, base.NONE)
    elseif kind == "bytes" or kind == "none" or kind == "relative_time" then
      fields[name] = ProtoField[kind](filter, title)
    else
      fields[name] = ProtoField[kind](filter, title, base[row[4]], values)
    end
  end
  return fields
end

local Tree = {}
Tree.__index = Tree

--- Makes fields and expert items and hands them to the two protocols.
-- yapp, taurus  Proto
-- catalogue     compiled
-- decode        the module yapp_decode
-- returns       the tree builder; set its by_id ({ [id] = message }) before use
function M.new(yapp, taurus, catalogue, decode)
  local self = setmetatable({ yapp = yapp, taurus = taurus, decode = decode,
    by_id = catalogue.by_id, default_names = {} }, Tree)
  for id, message in pairs(catalogue.by_id) do self.default_names[id] = message.title end
  self.fields = make_yapp_fields(self.default_names)
  local list = {}
  for _, row in ipairs(FIELDS) do list[#list + 1] = self.fields[row[1]] end
  yapp.fields = list

  self.messages = tree_taurus.new(taurus, catalogue)
  self.yapp_experts = tree_taurus.make_experts(yapp, "yapp.", YAPP_EXPERTS)
  return self
end

-- The API asks what is wanted by dissector, and those exist only when loading has ended.
function Tree:find_handles()
  self.yapp_handle, self.taurus_handle = Dissector.get("yapp"), Dissector.get("taurus")
  return self.yapp_handle
end

--- Whether anyone wants the tree of YAPP, or (with_taurus) of the message too: visible, filtered or printed.
function Tree:wanted(tree, with_taurus)
  return tree:referenced(self.yapp_handle or self:find_handles()) or
    with_taurus and tree:referenced(self.taurus_handle)
end

--- What an ID is called: "Motor Data", "ID 0x123".
function Tree:name(id)
  local message = self.by_id[id]
  return message and message.title or string.format("ID 0x%x", id)
end

--- Adds an expert item of YAPP's.
function Tree:expert(item, name, text)
  item:add_proto_expert_info(self.yapp_experts[name], text)
end

local function generated(item)
  item:set_generated()
  return item
end

-- The id, with the name that the user's mapping gives it.
function Tree:add_id(item, range, id)
  local added = range and item:add(self.fields.id, range, id) or generated(item:add(self.fields.id, id))
  local message = self.by_id[id]
  local title = message and message.title
  if title ~= self.default_names[id] then
    added:set_text(string.format("Message ID: %s (0x%08x)", title or "Unknown", id))
  end
end

--- Adds a CRC with its status, and the expert item when it is bad.
-- range   TvbRange of the CRC or nil where it was sent in another frame
-- message { crc, status, calculated }
function Tree:add_crc(item, range, message)
  local fields, status = self.fields, message.status
  local crc = range and item:add_le(fields.crc, range) or generated(item:add(fields.crc, message.crc))
  local code = STATUS_CODE[status] or UNVERIFIED
  if status == "good" then
    crc:append_text(" [correct]")
  elseif status == "bad" then
    crc:append_text(string.format(" [incorrect, should be 0x%08x]", message.calculated))
  else
    crc:append_text(" [unverified]")
  end
  generated(item:add(fields["crc.status"], code))
  if status == "bad" then
    generated(item:add(fields["crc.calculated"], message.calculated))
  end
  return crc
end

--- Says that a CRC is bad, with what was received and expected.
function Tree:bad_crc(item, message)
  self:expert(item, "crc.bad", string.format("Bad CRC: received 0x%08x, expected 0x%08x",
    message.crc, message.calculated))
end

--- Adds a time since the previous message, in seconds.
function Tree:add_delta(item, seconds)
  if not seconds then return end
  local negative = seconds < 0
  local nanoseconds = string.format("%.0f", math.abs(seconds) * 1e9)
  local whole, rest = tonumber(nanoseconds:sub(1, -10)) or 0, tonumber(nanoseconds:sub(-9))
  if negative then whole, rest = -whole, -rest end
  generated(item:add(self.fields.time_delta, NSTime.new(whole, rest)))
end

--- A number of bytes in words: "1 byte", "2 bytes".
function Tree.bytes(count)
  return count == 1 and "1 byte" or ("%d bytes"):format(count)
end

local shown = {} -- one message at a time

--- Shows a payload: the message of the catalogue, or bytes.
-- tree, item  where the Taurus tree goes, and YAPP's own item
-- id          message ID; payload: string, may be shorter than the message where the capture cut it
-- tvb, at     where the payload lies; nil when nobody wants a tree
-- size        the size of the message; the payload is shorter where the capture cut it
-- returns     what the Info column says of it
function Tree:payload(tree, item, id, payload, tvb, at, size)
  local message, decode = self.by_id[id], self.decode
  if not message or size ~= message.size then
    if tvb and #payload > 0 then item:add(self.fields.payload, tvb(at, #payload)) end
    if not message then
      self:expert(item, "id.unknown", string.format("Message ID 0x%x is not in the catalogue", id))
      return string.format("ID 0x%x  %s", id, Tree.bytes(#payload))
    end
    self:expert(item, "size.mismatch", string.format("%s has %s, the catalogue says %d",
      message.title, Tree.bytes(size), message.size))
    return string.format("%s  %s, not %d", message.title, Tree.bytes(size), message.size)
  end
  shown.message, shown.payload, shown.tvb, shown.at = message, payload, #payload > 0 and tvb or nil, at
  local raws, look = decode.read(message, payload)
  shown.raws, shown.look = raws, look
  self.messages:show(tree, item, shown)
  return decode.info(message, raws)
end

return M
