-- SPDX-License-Identifier: GPL-2.0-or-later
-- Makes the fields and expert items, YAPP's own from the rows below, those of messages from the
-- compiled catalogue; and adds them to a tree.  Wireshark's API.
--
-- A field of YAPP's is a row of YAPP, an expert item a row of EXPERTS, a value of the history a row
-- of add_states.

local decode = require("yapp.message.decode")

local M = {}

local unpack = rawget(table, "unpack")
local HEX, NONE = base.HEX, base.NONE
local FRAME_KINDS = { [0] = "Single", "Start", "Middle", "End" }
local CRC_STATUS = { [0] = "Bad", "Good", "Unverified" }

-- filter, type, title, description, base, values
local YAPP = {
  { "id", "UINT32", "Message ID",
    "Message ID: which message it is, and which controller sent it", HEX },
  { "ctl", "UINT8", "Control (CTL)",
    "YAPP's control byte" },
  { "seq", "UINT8", "Sequence number",
    "Numbers the messages of a source, from 0 to 255" },
  { "size", "UINT16", "Payload size",
    "Payload of the message in bytes" },
  { "reserved", "UINT16", "Reserved",
    "Reserved bytes of the header, 0", HEX },
  { "sync", "UINT16", "Sync",
    "The bytes YP, with which a frame in a stream begins", HEX },
  { "can.ctrl", "UINT8", "CAN frame",
    "Which part of a message a CAN frame is", nil, FRAME_KINDS },
  { "crc", "UINT32", "CRC",
    "CRC-32K of header and payload, as it was sent", HEX },
  { "crc.status", "UINT8", "CRC status",
    "Whether the CRC is that of the bytes", nil, CRC_STATUS },
  { "crc.calculated", "UINT32", "Calculated CRC",
    "What the CRC should be, where it is bad", HEX },
  { "payload", "BYTES", "Payload",
    "Payload that the catalogue does not explain" },
  { "undecoded", "BYTES", "Not decoded",
    "Payload behind the last field that the catalogue has" },
  { "padding", "BYTES", "CAN FD padding",
    "Bytes that fill a CAN FD frame" },
  { "fragments", "NONE", "Fragments",
    "The frames that a message was put together from" },
  { "fragment", "FRAMENUM", "Fragment",
    "A frame of the message" },
  { "fragment.data", "BYTES", "Fragment data",
    "What a frame has of the message's payload" },
  { "fragment.count", "UINT32", "Fragment count",
    "How many frames the message came in" },
  { "reassembled.in", "FRAMENUM", "Reassembled in",
    "The frame in which the message ends" },
  { "reassembled.length", "UINT32", "Reassembled length",
    "Bytes that were put together" },
  { "reassembled.data", "BYTES", "Reassembled data",
    "Payload that came in several frames" },
  { "skipped", "BYTES", "Skipped bytes",
    "Bytes of a stream that belong to no frame" },
  { "time_delta", "RELATIVE_TIME", "Time since the previous message with this ID",
    "Since the previous message with this ID on this bus or stream" },
  { "bus", "STRING", "Bus",
    "Name of the bus, where the capture has one" },
  { "source", "STRING", "Source",
    "Name of this bus and ID, else both as they are" },
  { "message.fault", "BOOLEAN", "Message has a fault flag set",
    "Set in every frame of a message that has a fault" },
  { "seq.missing", "UINT8", "Messages missing before this one",
    "How many messages are missing before this one, by sequence number" },
}

-- Expert items: filter, text, group, severity.  The text is the same each time, so that `-z expert`
-- counts it; numbers stand in the item's label, see M.add_expert.
local EXPERTS = {
  { "yapp.crc.bad", "Bad CRC", "CHECKSUM", "ERROR" },
  { "yapp.fragment.orphan", "Middle or End without a Start", "SEQUENCE", "WARN" },
  { "yapp.fragment.incomplete", "Message with bytes missing", "REASSEMBLE", "WARN" },
  { "yapp.fragment.overrun", "More bytes than the message's size", "REASSEMBLE", "WARN" },
  { "yapp.fragment.duplicate", "Frame delivered twice", "SEQUENCE", "NOTE" },
  { "yapp.unfinished", "Message cut off by the end of the capture", "REASSEMBLE", "WARN" },
  { "yapp.late", "A long gap before this message", "SEQUENCE", "WARN" },
  { "yapp.size.mismatch", "Payload length is not the catalogue's", "PROTOCOL", "WARN" },
  { "yapp.id.unknown", "Message ID is not in the catalogue", "UNDECODED", "NOTE" },
  { "yapp.reserved.nonzero", "Reserved bytes are not 0", "PROTOCOL", "WARN" },
  { "yapp.can.ctrl.invalid", "CAN CTRL is not defined", "PROTOCOL", "WARN" },
  { "yapp.can.id.missing", "The CAN id of this frame is not known", "UNDECODED", "WARN" },
  { "yapp.stream.skipped", "Bytes that belong to no frame", "SEQUENCE", "NOTE" },
  { "yapp.truncated", "The capture cut the packet short", "MALFORMED", "WARN" },
  { "yapp.source.shared", "Two controllers send this ID on one bus: their clocks alternate",
    "SEQUENCE", "WARN" },
  { "taurus.fault.active", "Fault flags are set", "RESPONSE_CODE", "ERROR" },
  { "taurus.fault.raised", "A fault was raised", "RESPONSE_CODE", "ERROR" },
  { "taurus.fault.cleared", "A fault was cleared", "RESPONSE_CODE", "NOTE" },
  { "taurus.reboot", "Controller rebooted (its clock went back)", "SEQUENCE", "WARN" },
  { "taurus.stale", "Controller clock did not advance", "SEQUENCE", "WARN" },
  { "taurus.jump", "Controller's clock jumped ahead", "SEQUENCE", "WARN" },
  { "taurus.command.key.invalid", "Key is not defined (the controller ignores this command)",
    "PROTOCOL", "WARN" },
  { "taurus.value.special", "Reserved value: not a number, infinite or out of range",
    "PROTOCOL", "NOTE" },
  { "taurus.flags.undefined", "A bit is set that no table defines", "PROTOCOL", "NOTE" },
  { "taurus.value.invalid", "Value that is not defined", "PROTOCOL", "WARN" },
}

--- The filter names of all expert items: { [name] = true }.
M.EXPERT_NAMES = {}
for _, row in ipairs(EXPERTS) do M.EXPERT_NAMES[row[1]] = true end

-- Return a function(filter, type, title, description, base, values, mask) -> ProtoField, and the
-- list of all that it makes.
-- base: of a number; or the width in bits of a boolean's field.  values: a table, or a frametype
local function new_maker()
  local list = {}
  return function(filter, kind, title, about, shape, values, mask)
    shape = shape or kind:find("INT") and base.DEC or NONE
    local pf = ProtoField.new(title, filter, ftypes[kind], values, shape, mask, about)
    list[#list + 1] = pf
    return pf
  end, list
end

local experts = {} -- [filter] = ProtoExpert, made once, when the plugin loads

-- Make the expert items of a protocol, whose filters begin with this prefix.
local function make_experts(proto, prefix)
  local own = {}
  for _, row in ipairs(EXPERTS) do
    local name, text, group, severity = unpack(row)
    if name:find(prefix, 1, true) == 1 then
      own[name] = ProtoExpert.new(name, text, expert.group[group], expert.severity[severity])
      experts[name] = own[name]
    end
  end
  proto.experts = own
end

--- Make YAPP's own fields and expert items and hand them to the protocol.
-- yapp     Proto
-- names    { [id] = title } of the messages that are known
-- messages of the catalogue
-- returns  { [filter without "yapp."] = ProtoField }
function M.of_yapp(yapp, names, messages)
  local fields, make, list = {}, new_maker()
  for _, row in ipairs(YAPP) do
    local name, kind, title, about, shape, values = unpack(row, 1, 6)
    if name == "id" then values = names end
    fields[name] = make("yapp." .. name, kind, title, about, shape, values)
  end
  for _, message in ipairs(messages) do
    local name = "like." .. message.name
    fields[name] = make("yapp." .. name, "UINT32", "Could be " .. message.title,
      "ID that is not in the catalogue, of a message with the size of " .. message.title, HEX)
  end
  yapp.fields = list
  make_experts(yapp, "yapp.")
  return fields
end

-- Fields of messages ------------------------------------------------------------------------------

-- Make what a flags field has below it.
local function make_flags(field, made, kind, make)
  local title, group, about = field.title, field.group, field.description
  made.undefined = make(group .. ".undefined", "UINT32", "Undefined bits",
    "Bits that nothing defines: " .. about, HEX)
  made.flags = {}
  for i, flag in ipairs(field.flags) do
    made.flags[i] = make(flag.filter, "BOOLEAN", flag.title, flag.description, field.size * 8, nil,
      flag.mask)
  end
  if #field.flags == 0 then return end
  made.names = make(field.filter .. ".names", "STRING", title,
    "Names of the bits that are set: " .. about)
  for way, verb in pairs { raised = "rose", cleared = "fell" } do
    made[way] = make(group .. "." .. way, kind, title .. " " .. way,
      ("Bits that %s since the source's previous good message: %s"):format(verb, about), HEX)
  end
end

-- Wireshark's types of the kinds whose name is not a type.
local TYPES = { time = "RELATIVE_TIME", bool = "BOOLEAN", float = "DOUBLE", ieee = "DOUBLE" }

-- Return the type and the base of a field's own ProtoField.
local function type_of(field)
  local kind, width = field.kind, field.size * 8
  if field.scale then return "DOUBLE" end
  if kind == "flags" then return "UINT" .. width, HEX end
  if kind == "uint" then return "UINT" .. width, field.values and HEX end
  if kind == "int" then return "INT" .. width end
  return TYPES[kind] or kind:upper()
end

-- Make the ProtoFields of a field.
local function make_field(field, make)
  local title, about, made = field.array_title or field.title, field.description, {}
  local kind, shape = type_of(field)
  if field.kind == "flags" then
    make_flags(field, made, kind, make)
  elseif field.special then
    made.special = make(field.special, "UINT8", title,
      "Why there is no number, a reserved count, NaN or infinity: " .. about, nil, decode.SPECIALS)
  end
  local mask = not field.scale and field.mask or nil
  made.pf = make(field.filter, kind, title, about, shape, field.values, mask)
  return made
end

-- Call add(value, filter, type, title, description, base, values) for each field that shows a
-- message's state; value(state, m) returns what to show, or nil.
local function add_states(message, add)
  -- Prefer a field of nothing but faults: so filters keep their names if a flag of another field
  -- becomes a fault.
  local fault, filter = message.fault_field or message.alarms[1], message.filter
  if message.time then
    add(function(state) return state.drift and M.relative_time(state.drift) end,
      filter .. ".clock_drift", "RELATIVE_TIME", "Clock drift",
      "Controller's clock less the capture's since the source's first message or reboot")
  end
  if message.answers then
    local command = message.answers:gsub("^%l", string.upper):gsub("_", " ")
    add(function(state) return state.command_in end,
      ("%s.%s_in"):format(filter, message.answers), "FRAMENUM", ("Latest %s in"):format(command),
      ("The latest %s on this bus before the message"):format(command), nil, frametype.REQUEST)
  end
  if not fault then return end
  add(function(state, m)
    local since = state.active_since
    return since and M.relative_time(m.time - since)
  end, fault.group .. ".active_time", "RELATIVE_TIME", "Time since the oldest of them was raised",
    "Since the oldest fault that is still set was raised")
  for _, way in ipairs { "previous", "next" } do
    add(function(state) return state[way .. "_change"] end,
      ("%s.%s_change"):format(fault.group, way), "FRAMENUM",
      ("%s: %s change in"):format(fault.title, way),
      ("The source's %s message that changes a fault"):format(way))
  end
end

--- Make the fields and expert items of the messages and hand them to the protocol.
-- taurus     Proto
-- catalogue  compiled
-- returns    { [message] = { pf, generated = list of ProtoFields, states = list of { pf, value =
--            function(state, m) } } }; { [field] = { pf, special, flags (list), names, undefined,
--            raised, cleared } }, where the elements of an array share theirs
function M.of_taurus(taurus, catalogue)
  local messages, fields, by_filter, make, list = {}, {}, {}, new_maker()
  for _, message in ipairs(catalogue.messages) do
    local about = "A whole message: " .. message.title
    local own = { generated = {}, states = {} }
    own.pf = make(message.filter, "NONE", message.title, about)
    for i, item in ipairs(message.generated) do
      own.generated[i] = make(item.filter, "DOUBLE", item.title, item.description)
    end
    add_states(message, function(value, ...)
      table.insert(own.states, { value = value, pf = make(...) })
    end)
    for _, field in ipairs(message.fields) do
      by_filter[field.filter] = by_filter[field.filter] or make_field(field, make)
      fields[field] = by_filter[field.filter]
    end
    messages[message] = own
  end
  taurus.fields = list
  make_experts(taurus, "taurus.")
  return messages, fields
end

-- Adding items ------------------------------------------------------------------------------------

-- As functions, the item first: a method that Lua has to look up in an item costs a third of what
-- adding a field does.
local add = TreeItem.add
local set_generated = TreeItem.set_generated
M.add = add
M.add_le = TreeItem.add_le
M.append_text = TreeItem.append_text

--- Add a generated item: no bytes of the packet hold its value.
-- pf       ProtoField, or a text
-- returns  the item
function M.add_generated(item, pf, value)
  return set_generated(add(item, pf, value))
end

--- Add an expert item.
-- name  its filter
-- text  about this packet, or nil.  It becomes a generated item, as the expert item's own text
--       stays the same for all packets
function M.add_expert(item, name, text)
  if text and item.visible then item = M.add_generated(item, text) end
  item:add_proto_expert_info(experts[name])
end

--- Return seconds, a double, as a time to the nanosecond.
function M.relative_time(seconds)
  local sign = seconds < 0 and -1 or 1
  local whole, rest = math.modf(sign * seconds)
  rest = math.floor(rest * 1e9 + 0.5)
  if rest == 1e9 then whole, rest = whole + 1, 0 end
  return NSTime.new(sign * whole, sign * rest)
end

return M
