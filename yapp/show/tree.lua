-- SPDX-License-Identifier: GPL-2.0-or-later
-- What a user sees of YAPP: the fields, the expert items, the tree, the Info column. The messages: show.taurus.
-- Wireshark's API; what is shown comes in finished, from the reassembly or the framing.

local info_of = require("yapp.message.info")
local items = require("yapp.show.items")
local tree_taurus = require("yapp.show.taurus")

local M = {}

local add, add_le, add_generated = items.add, items.add_le, items.add_generated
local append_text, set_text = items.append_text, items.set_text

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
  { "bus", "string", "Bus" },
  { "source", "string", "Source" },
  { "message.fault", "bool", "Message has a fault flag set" },
  { "seq.missing", "uint8", "Messages missing before this one", "DEC" },
}

-- filter, what it says by itself, group, severity
local YAPP_EXPERTS = {
  { "crc.bad", "Bad CRC", "CHECKSUM", "ERROR" },
  { "fragment.orphan", "Middle or End without a Start", "SEQUENCE", "WARN" },
  { "fragment.incomplete", "Message with bytes missing", "REASSEMBLE", "WARN" },
  { "fragment.overrun", "More bytes than the message's size", "REASSEMBLE", "WARN" },
  { "fragment.duplicate", "Frame delivered twice", "SEQUENCE", "NOTE" },
  { "unfinished", "The capture ends before the message does", "REASSEMBLE", "WARN" },
  { "late", "A long gap before this message", "SEQUENCE", "WARN" },
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
    elseif not row[4] then
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
-- options  { yapp =, taurus = Proto, catalogue = compiled, reader = a message.reader }
function M.new(options)
  local self = setmetatable({ yapp = options.yapp, taurus = options.taurus, reader = options.reader,
    default_names = {} }, Tree)
  for id, message in pairs(options.catalogue.by_id) do self.default_names[id] = message.title end
  self.fields = make_yapp_fields(self.default_names)
  local list = {}
  for _, row in ipairs(FIELDS) do list[#list + 1] = self.fields[row[1]] end
  self.yapp.fields = list

  self.messages = tree_taurus.new(self.taurus, options.catalogue)
  self.yapp_experts = tree_taurus.make_experts(self.yapp, "yapp.", YAPP_EXPERTS)
  return self
end

--- Forgets what was wanted of the file before.
function Tree:reset()
  self.wanted = nil
  self.messages:reset()
end

-- What is wanted -----------------------------------------------------------------------------------------------------

-- The API asks what is wanted by dissector, and those exist only when loading has ended.
local function find_handles(self)
  self.yapp_handle, self.taurus_handle = Dissector.get("yapp"), Dissector.get("taurus")
end

local IS_TSHARK = not gui_enabled()
local NO_COLUMN = "(info)" -- what the API calls it where there are no columns at all
local SAYS_PROTOCOLS = not get_version():find("^4%.[0-5]%.")
-- COMPAT 4.0: no filter can name a column there.
local FILTERS_COLUMNS = not get_version():find("^4%.[01]%.")
local NOTHING, LIST = {}, { columns = true } -- where nobody wants a tree
local ONLY_LIST = { columns = true, is_only_pass = true }

-- Whether columns and tree are those of a pass behind which none comes.  A first pass of two shows no tree, and it has
-- columns only for a filter that names one: then with a tree, as each filter needs it.
local function is_last_pass(tree, has_columns)
  return tree.visible or has_columns and not (FILTERS_COLUMNS and pcall(all_field_infos))
end

-- What is wanted of a look at a packet.
local function ask(self, tree, pinfo, is_steady)
  local has_columns = not is_steady or tostring(pinfo.cols.info) ~= NO_COLUMN
  if not tree.hidden then -- false where there is none; always true from 4.6 on
    return not has_columns and NOTHING or is_steady and ONLY_LIST or LIST
  end
  if not self.yapp_handle then find_handles(self) end
  local taurus = tree:referenced(self.taurus_handle)
  return { columns = has_columns, is_only_pass = is_steady and is_last_pass(tree, has_columns),
    yapp = tree:referenced(self.yapp_handle),
    taurus = taurus, standing = taurus and (not is_steady or self.messages:wants_standing(tree)),
    names = not SAYS_PROTOCOLS and not self.reader.stat.wanted }
end

--- What anyone wants of a packet.
-- is_again  whether the packet was shown before
-- returns   { yapp = whether YAPP's own items are visible, filtered or printed, taurus = whether those of messages are,
--           standing = whether, of these, what also stands at messages that change nothing,
--           names = whether, without them, the names of protocols are (see bare), columns = whether there are columns:
--           tshark has them for a packet list, and not with -V, -q, most of -T or in a first pass of two;
--           is_only_pass = whether it is sure that no packet will be shown again }.  In tshark this does not change
--           within a first pass, so it is asked once and kept in `wanted`; in Wireshark, and on later looks of sharkd,
--           it may.
function Tree:wants(tree, pinfo, is_again)
  local is_steady = IS_TSHARK and not is_again
  local wants = is_steady and self.wanted or ask(self, tree, pinfo, is_steady)
  if is_steady then self.wanted = wants end
  return wants
end

--- Where nobody wants YAPP's own items, but there is a tree: its name, for who asks for protocols (-z io,phs).
-- wants       of the tree; is_message: whether there is a message's name too
-- returns     the tree, for the expert items
-- COMPAT 4.0, 4.4: from 4.6 on `referenced` tells.
function Tree:bare(tree, wants, is_message)
  if wants.names then
    add(tree, self.yapp)
    if is_message and not wants.taurus then add(tree, self.taurus) end
  end
  return tree
end

--- What an ID is called: "Motor Data", "Motor Data 0x212 (can1)", "Motor Data left_fore", "ID 0x123".
-- bus_name  text, or nil where the capture names none
function Tree:name(id, bus_name)
  return self.reader:label(id, bus_name)
end

--- Adds an expert item of YAPP's.
-- text  what there is to say of this packet: its own item, so that the expert's text is the same each time and
--       `-z expert` can count it; nil where the expert's says all
function Tree:expert(item, name, text)
  if text and item.visible then item = add_generated(item, text) end
  item:add_proto_expert_info(self.yapp_experts[name])
end

--- Adds what the CAN id says, all of it generated.
-- address  wire.can_id's
function Tree:add_address(item, address, bus_name)
  local fields = self.fields
  self:add_id(item, nil, address.id, bus_name)
  add_generated(item, fields.ctl, address.ctl)
  add_generated(item, fields.seq, address.seq)
  add_generated(item, fields["can.ctrl"], address.ctrl)
  self:add_source(item, address.id, bus_name)
end

--- Adds the id, with the name that the user's mapping gives it.
-- range  TvbRange, nil where the CAN id has it
function Tree:add_id(item, range, id, bus_name)
  local added = range and add(item, self.fields.id, range, id) or add_generated(item, self.fields.id, id)
  local message = self.reader:message_of(id, bus_name)
  local title = message and message.title
  if title ~= self.default_names[id] then
    set_text(added, string.format("Message ID: %s (0x%08x)", title or "Unknown", id))
  end
end

--- Adds the bus and the name of the source, where there are such.
function Tree:add_source(item, id, bus_name)
  if bus_name then add_generated(item, self.fields.bus, bus_name) end
  local source = self.reader:name_of(id, bus_name)
  if source then add_generated(item, self.fields.source, source) end
end

--- Adds the frames that a message was put together from.
-- tvb      of the whole; numbers: of its frames; count: of them, with any that a read filter rejected; length: in bytes
function Tree:add_fragments(item, tvb, numbers, count, length)
  local fields = self.fields
  local list = add_generated(item, fields.fragments, tvb())
  set_text(list, ("%d fragments (%d bytes)"):format(count, length))
  for i = 1, #numbers do add_generated(list, fields.fragment, numbers[i]) end
  add_generated(list, fields["fragment.count"], count)
  add_generated(list, fields["reassembled.length"], length)
end

--- Adds a CRC with its status, and the expert item when it is bad.
-- range   TvbRange of the CRC or nil where it was sent in another frame
-- message { crc, status, calculated }
function Tree:add_crc(item, range, message)
  local fields, status = self.fields, message.status
  local crc = range and add_le(item, fields.crc, range) or add_generated(item, fields.crc, message.crc)
  local code = STATUS_CODE[status] or UNVERIFIED
  if status == "good" then
    append_text(crc, " [correct]")
  elseif status == "bad" then
    append_text(crc, string.format(" [incorrect, should be 0x%08x]", message.calculated))
  else
    append_text(crc, " [unverified]")
  end
  add_generated(item, fields["crc.status"], code)
  if status == "bad" then
    add_generated(item, fields["crc.calculated"], message.calculated)
  end
  return crc
end

--- Says that a CRC is bad, with what was received and expected.
function Tree:bad_crc(item, message)
  self:expert(item, "crc.bad", string.format("Received 0x%08x, expected 0x%08x",
    message.crc, message.calculated))
end

--- Adds what YAPP's own item says of a message's history: the time since the previous one, messages that are missing.
-- message  of message.reader
function Tree:add_delta(item, message)
  local change, fields = message.change or {}, self.fields
  if change.delta then add_generated(item, fields.time_delta, items.relative_time(change.delta)) end
  if change.missing then add_generated(item, fields["seq.missing"], change.missing) end
  if message.has_fault then add_generated(item, fields["message.fault"], true) end
end

--- A number of bytes in words: "1 byte", "2 bytes".
function Tree.bytes(count)
  return count == 1 and "1 byte" or ("%d bytes"):format(count)
end

-- A message that is not in the catalogue, or not as it is there: bytes.
local function show_bytes(self, m)
  local size = Tree.bytes(m.size)
  if m.wanted and m.tvb and #m.payload > 0 then m.item:add(self.fields.payload, m.tvb(m.at, #m.payload)) end
  local name = m.name
  if not m.message then
    local text, info = self.reader:hint(m)
    self:expert(m.item, "id.unknown", text)
    return ("%s  %s%s"):format(name, Tree.bytes(#m.payload), info or "")
  end
  self:expert(m.item, "size.mismatch", ("%s has %s, the catalogue says %d"):format(name, size, m.message.size))
  return ("%s  %s, not %d"):format(name, size, m.message.size)
end

--- Shows a finished message: the message of the catalogue, or bytes.
-- m        of message.reader, with { tree = where the Taurus tree goes, item = YAPP's own item or the tree, wanted =
--          whether there is one, tvb and at = where the payload lies, tvb nil where nobody wants a tree,
--          has_columns = whether anyone sees the Info column }
-- returns  what the Info column says of it, or a part of that where nobody sees it
function Tree:payload(m)
  if m.wanted then self:add_delta(m.item, m) end
  local change = m.change
  if change and change.late then
    self:expert(m.item, "late", ("%.3f s since the previous one"):format(change.late))
  end
  if not m.raws then return show_bytes(self, m) end
  if #m.payload == 0 then m.tvb = nil end
  local name = m.name
  m.label = name ~= m.message.title and name or nil
  m.is_steady = IS_TSHARK and not m.visited
  local top = self.messages:show(m.tree, m.item, m)
  local info = m.has_columns and info_of.text(m.message, m.raws, m.payload, name) or ""
  if not change then return info end
  self.messages:add_change(top or m.item, m, top ~= nil)
  return info .. (change.reboot and "  REBOOT" or change.stale and "  STALE" or "")
end

return M
