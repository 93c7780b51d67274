-- SPDX-License-Identifier: GPL-2.0-or-later
-- Makes the fields and expert items, YAPP's own from the rows below, those of messages from the
-- compiled catalogue; and adds them to a tree.  Wireshark's API.
--
-- A field of YAPP's is a row of YAPP, an expert item a row of M.EXPERTS.

local can_id = require "yapp.wire.can_id"
local joined = require "yapp.base.joined"

local M = {}

local unpack = rawget(table, "unpack")
local BILLION = 1000000000
local CRC_STATUS = { [0] = "Bad", "Good", "Unverified" }

-- filter, type, title, description, base, values
local YAPP = {
  { "yapp.id", "UINT32", "Message ID",
    "Message ID: which message it is, and which controller sent it", "HEX" },
  { "yapp.ctl", "UINT8", "Control (CTL)",
    "YAPP's control byte" },
  { "yapp.seq", "UINT8", "Sequence number",
    "Numbers the messages of a source, from 0 to 255" },
  { "yapp.size", "UINT16", "Payload size",
    "Payload of the message in bytes" },
  { "yapp.reserved", "UINT16", "Reserved",
    "Reserved bytes of the header, 0", "HEX" },
  { "yapp.sync", "UINT16", "Sync",
    "The bytes YP, with which a frame in a stream begins", "HEX" },
  { "yapp.can.ctrl", "UINT8", "CAN frame",
    "Which part of a message a CAN frame is", nil, can_id.CTRL_NAMES },
  { "yapp.crc", "UINT32", "CRC",
    "CRC-32K of header and payload, as it was sent", "HEX" },
  { "yapp.crc.status", "UINT8", "CRC status",
    "Whether the CRC is that of the bytes", nil, CRC_STATUS },
  { "yapp.crc.calculated", "UINT32", "Calculated CRC",
    "What the CRC should be, where it is bad", "HEX" },
  { "yapp.payload", "BYTES", "Payload",
    "Payload that the catalogue does not explain" },
  { "yapp.undecoded", "BYTES", "Not decoded",
    "Payload behind the last field that the catalogue has" },
  { "yapp.padding", "BYTES", "CAN FD padding",
    "Bytes that fill a CAN FD frame" },
  { "yapp.fragments", "NONE", "Fragments",
    "The frames that a message was put together from" },
  { "yapp.fragment", "FRAMENUM", "Fragment",
    "A frame of the message" },
  { "yapp.fragment.data", "BYTES", "Fragment data",
    "What a frame has of the message's payload" },
  { "yapp.fragment.count", "UINT32", "Fragment count",
    "How many frames the message came in" },
  { "yapp.reassembled.in", "FRAMENUM", "Reassembled in",
    "The frame in which the message ends" },
  { "yapp.reassembled.length", "UINT32", "Reassembled length",
    "Bytes that were put together" },
  { "yapp.reassembled.data", "BYTES", "Reassembled data",
    "Payload that came in several frames" },
  { "yapp.skipped", "BYTES", "Skipped bytes",
    "Bytes of a stream that belong to no frame" },
  { "yapp.time_delta", "RELATIVE_TIME", "Time since the previous message with this ID",
    "Since the previous message with this ID on this bus or stream" },
  { "yapp.bus", "STRING", "Bus",
    "Name of the bus, where the capture has one" },
  { "yapp.source", "STRING", "Source",
    "The name from yapp.sources; without one the ID, behind the bus if there are several" },
  { "yapp.message.fault", "BOOLEAN", "Message has a fault flag set",
    "Set in every frame of a message that has a fault" },
  { "yapp.copy_of", "FRAMENUM", "Copy of the message in",
    "The frame of the same message that was recorded before" },
  { "yapp.seq.missing", "UINT8", "Messages missing before this one",
    "How many messages are missing before this one, by sequence number" },
}

--- Expert items: filter, text, group, severity.  The text is the same each time, so that
-- `-z expert` counts it; numbers stand in the item's label, see M.add_expert.  An anomaly, a remark
-- on a value or a change raises it: else the result is a usual one, see reading.records, of which
-- the view draws nothing for `-z expert`.  Of a change:
--   change  its name in message.history
--   label   of the item, with the number of the change; nil for the text
--   word    in the Info column, or nil
M.EXPERTS = {
  { "yapp.crc.bad", "Bad CRC", "CHECKSUM", "ERROR" },
  { "yapp.fragment.orphan", "Middle or End without a Start", "SEQUENCE", "WARN" },
  { "yapp.fragment.incomplete", "Message with bytes missing", "REASSEMBLE", "WARN" },
  { "yapp.fragment.overrun", "More bytes than the message's size", "REASSEMBLE", "WARN" },
  { "yapp.fragment.duplicate", "Frame delivered twice", "SEQUENCE", "NOTE" },
  { "yapp.copy", "Message that was recorded twice", "SEQUENCE", "NOTE" },
  { "yapp.unfinished", "Message cut off by the end of the capture", "REASSEMBLE", "WARN" },
  { "yapp.late", "A long gap before this message", "SEQUENCE", "WARN",
    change = "late", label = "Silent for %.3f s" },
  { "yapp.size.mismatch", "Payload length is not the catalogue's", "PROTOCOL", "WARN" },
  { "yapp.id.unknown", "Message ID is not in the catalogue", "UNDECODED", "NOTE" },
  { "yapp.reserved.nonzero", "Reserved bytes are not 0", "PROTOCOL", "WARN" },
  { "yapp.can.ctrl.invalid", "CAN CTRL is not defined", "PROTOCOL", "WARN" },
  { "yapp.can.id.missing", "The CAN id of this frame is not known", "UNDECODED", "WARN" },
  { "yapp.stream.skipped", "Bytes that belong to no frame", "SEQUENCE", "NOTE" },
  { "yapp.truncated", "The capture cut the packet short", "MALFORMED", "WARN" },
  { "yapp.source.shared", "Two controllers send this ID on one bus: their clocks alternate",
    "SEQUENCE", "WARN", change = "shared" },
  { "taurus.fault.active", "Fault flags are set", "RESPONSE_CODE", "ERROR" },
  { "taurus.fault.raised", "A fault was raised", "RESPONSE_CODE", "ERROR" },
  { "taurus.fault.cleared", "A fault was cleared", "RESPONSE_CODE", "NOTE" },
  { "taurus.reboot", "Controller rebooted (its clock went back)", "SEQUENCE", "WARN",
    change = "reboot", label = "Controller rebooted (its clock went back by %.1f s)",
    word = "REBOOT" },
  { "taurus.stale", "Controller clock did not advance", "SEQUENCE", "WARN",
    change = "stale", word = "STALE" },
  { "taurus.jump", "Controller's clock jumped ahead", "SEQUENCE", "WARN",
    change = "jump", label = "Controller's clock jumped ahead by %.1f s", word = "JUMP" },
  { "taurus.disabled", "A Command turned off motors that were turning", "SEQUENCE", "WARN",
    change = "disabled" },
  { "taurus.command.key.invalid", "Key is not defined (the controller ignores this command)",
    "PROTOCOL", "WARN" },
  { "taurus.value.special", "Reserved value: not a number, infinite or out of range",
    "PROTOCOL", "NOTE" },
  { "taurus.flags.undefined", "A bit is set that no table defines", "PROTOCOL", "NOTE" },
  { "taurus.value.invalid", "Value that is not defined", "PROTOCOL", "WARN" },
}

-- Make a field of the columns of a row behind its filter: type, title, description, base, values,
-- mask.
-- shape   base of a number, by its name in the API; or the width in bits of a boolean's field
-- values  a table, or the name of a type of frame
local function new_field(filter, kind, title, about, shape, values, mask)
  shape = shape or kind:find("INT") and "DEC" or "NONE"
  values = kind == "FRAMENUM" and frametype[values or "NONE"] or values
  return ProtoField.new(title, filter, ftypes[kind], values, base[shape] or shape, mask, about)
end

local experts = {} -- [filter] = ProtoExpert, made once, when the plugin loads

--- Return the rows of all fields: { filter, type, title, description, ... }, those of YAPP first.
-- names    { [id] = title } of the messages that are known
-- messages of the catalogue
function M.rows(names, messages)
  YAPP[1][6] = names -- of yapp.id
  local rows = joined(YAPP)
  for _, message in ipairs(messages) do
    rows[#rows + 1] = { "yapp.like." .. message.name, "UINT32", "Could be " .. message.title,
      "ID that is not in the catalogue, of a message with the size of " .. message.title, "HEX" }
  end
  for _, message in ipairs(messages) do rows = joined(rows, message.filters) end
  return rows
end

--- Make the fields and expert items whose filters begin with a prefix, and hand them to a protocol.
-- rows     of M.rows
-- returns  { [filter without "yapp."] = ProtoField }
function M.define(proto, prefix, rows)
  local fields, own = {}, {}
  for _, row in ipairs(rows) do
    local filter = row[1]
    if filter:find(prefix, 1, true) == 1 then
      fields[filter:match("^yapp%.(.*)") or filter] = new_field(unpack(row, 1, 7))
    end
  end
  for _, row in ipairs(M.EXPERTS) do
    local name, text, group, severity = unpack(row, 1, 4)
    if name:find(prefix, 1, true) == 1 then
      own[name] = ProtoExpert.new(name, text, expert.group[group], expert.severity[severity])
      experts[name] = own[name]
    end
  end
  proto.fields, proto.experts = fields, own
  return fields
end

-- Adding items ------------------------------------------------------------------------------------

local add, set_generated = TreeItem.add, TreeItem.set_generated

--- Add an expert item.
-- item  nil in a tap, which has no tree
-- name  its filter
-- text  about this packet, or nil.  It becomes a generated item, as the expert item's own text
--       stays the same for all packets
function M.add_expert(item, name, text)
  if not item then return end
  if text and item.visible then item = set_generated(add(item, text)) end
  item:add_proto_expert_info(experts[name])
end

--- Return seconds, a double, as a time to the nanosecond.
function M.relative_time(seconds)
  local sign = seconds < 0 and -1 or 1
  local nanoseconds = math.floor(sign * seconds * BILLION + 0.5)
  return NSTime.new(sign * math.floor(nanoseconds / BILLION), sign * (nanoseconds % BILLION))
end

return M
