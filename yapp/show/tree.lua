-- SPDX-License-Identifier: GPL-2.0-or-later
-- What a user sees of YAPP: the tree, the expert items, the Info column.  show.taurus shows the
-- messages.  Wireshark's API; the reassembly or the framing has finished what is shown.

local show_fields = require "yapp.show.fields"
local text_of = require "yapp.message.text"
local messages_of = require "yapp.show.taurus"
local number_of = require "yapp.base.frame_key".number

local M = {}

local add = show_fields.add
local add_generated = show_fields.add_generated
local append_text = show_fields.append_text

-- By status: crc.status, what follows the CRC, and what the item's text says.
local CRC = {
  bad = { 0, " [incorrect, should be 0x%08x]", ", CRC BAD" },
  good = { 1, " [correct]", ", CRC good" },
}
local UNVERIFIED = { 2, " [unverified]", ", CRC unverified" }

local Tree = {}
Tree.__index = Tree

--- What the Info column adds to a message, by its status.
Tree.MARKS = {
  good = "",
  bad = "  [BAD CRC]",
  incomplete = "  [INCOMPLETE]",
  overrun = "  [OVERRUN]",
  truncated = "  [TRUNCATED]",
}

--- Make fields and expert items and hand them to the two protocols.
-- options  { yapp =, taurus = Proto, catalogue = compiled, reader = a message.reader }
function M.new(options)
  local self = setmetatable({
    yapp = options.yapp,
    taurus = options.taurus,
    reader = options.reader,
    messages = messages_of.new(options.taurus, options.catalogue.messages),
    fields = nil,
    default_names = {}, -- titles by ID
    wanted = nil, -- of Tree:wants, in the first pass of tshark
    is_only_pass = false, -- whether it is known that there is one pass
  }, Tree)
  for id, message in pairs(options.catalogue.by_id) do self.default_names[id] = message.title end
  self.fields = show_fields.of_yapp(self.yapp, self.default_names, options.catalogue.messages)
  return self
end

--- Forget what was wanted of the file before.
function Tree:reset()
  self.wanted, self.is_only_pass = nil, false
end

--- Say that this first pass of tshark is its only one: no packet is revisited.
function Tree:only_pass()
  self.wanted, self.is_only_pass = nil, true
end

-- What is wanted ----------------------------------------------------------------------------------

-- Despite its name, tree.hidden says whether there is a tree at all, shown or not.
local IS_TSHARK = not gui_enabled()
local NO_COLUMN = "(info)" -- the text of a column if there are no columns
local SAYS_PROTOCOLS = not get_version():find("^4%.[0-5]%.")
-- COMPAT 4.0: no filter can name a column there.
local FILTERS_COLUMNS = not get_version():find("^4%.0%.")

-- Return whether tshark's first pass is its only one.  The first pass of two shows no tree.  It has
-- columns only if a filter names a column, and then it builds a tree.
local function is_only_pass(tree, has_columns)
  if not tree.hidden then return has_columns end
  return tree.visible or has_columns and not (FILTERS_COLUMNS and pcall(all_field_infos))
end

local LIST = { columns = true } -- a packet list of Wireshark, or of later passes

-- Ask Wireshark what is wanted of a packet.
local function ask(self, tree)
  -- The API takes a dissector here, and ours exist only after loading.
  local wants = { columns = true }
  wants.yapp = tree:referenced(Dissector.get("yapp"))
  wants.taurus = tree:referenced(Dissector.get("taurus"))
  wants.tree = wants.yapp or wants.taurus
  wants.state = wants.taurus
  wants.names = not SAYS_PROTOCOLS and not self.reader.intake.wanted
  return wants
end

-- Ask Wireshark in tshark's first pass, where the answer is the same for all packets.
local function ask_first(self, tree, pinfo)
  local has_columns = tostring(pinfo.cols.info) ~= NO_COLUMN
  local wants = tree.hidden and ask(self, tree) or {}
  wants.columns = has_columns
  wants.plans = {}
  wants.is_only_pass = self.is_only_pass or is_only_pass(tree, has_columns)
  wants.state = wants.taurus and self.messages:wants_state(tree)
  return wants
end

--- Return what is wanted of a packet.
-- visited   whether the packet was shown before
-- returns   {
--   yapp          whether YAPP's own items are shown, filtered or printed
--   taurus        whether those of messages are
--   tree          whether one of the two is
--   state         whether the state of messages that change nothing is wanted, too
--   names         whether the names of the protocols are wanted although the above are not, see
--                 Tree:add_protocol_names
--   columns       whether there are columns: tshark has them for a packet list, and not with -V,
--                 -q, most of -T or in a first pass of two
--   plans         see show.taurus, nil where the answer may change
--   is_only_pass  whether it is sure that no packet is shown again, so that nothing need be kept: a
--                 tenth of a packet list }
-- In tshark's first pass the answer is the same for all packets, so it is asked once; in Wireshark,
-- and in later passes, it may change.
function Tree:wants(tree, pinfo, visited)
  if IS_TSHARK and not visited then
    self.wanted = self.wanted or ask_first(self, tree, pinfo)
    return self.wanted
  end
  return tree.hidden and ask(self, tree) or LIST
end

--- Add the names of the protocols to a tree in which no field of YAPP is wanted, for -z io,phs.
-- wants       of the tree
-- is_message  whether there is a message's name too
-- COMPAT 4.0, 4.4: from 4.6 on `referenced` tells.
function Tree:add_protocol_names(tree, wants, is_message)
  add(tree, self.yapp)
  if is_message and not wants.taurus then add(tree, self.taurus) end
end

-- Items of YAPP's ---------------------------------------------------------------------------------

--- Add an expert item of YAPP's.
-- name  its filter without "yapp."
-- text  see show.fields, add_expert
function Tree.expert(_, item, name, text)
  show_fields.add_expert(item, "yapp." .. name, text)
end

--- Add a generated field of YAPP's if it has a value.
-- name     its filter without "yapp."
-- value    nil or false for none
-- returns  the item; nil or false without one
function Tree:generated(item, name, value)
  return value and add_generated(item, self.fields[name], value)
end

--- Add the id, with the name that the user's mapping gives it.
-- range   TvbRange, nil where the CAN id has it
-- source  of message.reader
function Tree:add_id(item, range, source)
  local id, title = source.id, source.message and source.message.title
  local added = range and add(item, self.fields.id, range, id) or self:generated(item, "id", id)
  if title == self.default_names[id] then return end
  added:set_text(("Message ID: %s (0x%08x)"):format(title or "Unknown", id))
end

--- Add the bus, where there is one, and the source.
-- source  of message.reader
function Tree:add_source(item, source)
  self:generated(item, "bus", source.bus)
  add_generated(item, self.fields.source, source.text)
end

--- Add the frames that a message was put together from.
-- whole    TvbRange
-- keys     of its frames; one that a read filter dropped has a fraction, and gets no link
-- length   in bytes
-- payload  TvbRange of the message's payload, nil where it has none
function Tree:add_fragments(item, whole, keys, length, payload)
  local list = self:generated(item, "fragments", whole)
  list:set_text(("%d fragments (%d bytes)"):format(#keys, length))
  for _, key in ipairs(keys) do
    if key % 1 == 0 then add_generated(list, self.fields.fragment, number_of(key)) end
  end
  self:generated(list, "fragment.count", #keys)
  self:generated(list, "reassembled.length", length)
  self:generated(list, "reassembled.data", payload)
end

--- Add a CRC with its status, and append the status to the item's text.
-- range    TvbRange of the CRC or nil where it was sent in another frame
-- message  { crc, status, calculated }
function Tree:add_crc(item, range, message)
  local shown, calculated = CRC[message.status] or UNVERIFIED, message.calculated
  local crc = range and show_fields.add_le(item, self.fields.crc, range)
    or self:generated(item, "crc", message.crc)
  append_text(crc, shown[2]:format(calculated))
  self:generated(item, "crc.status", shown[1])
  self:generated(item, "crc.calculated", shown == CRC.bad and calculated)
  append_text(item, shown[3])
end

--- Say that a CRC is bad, with what was received and expected.
function Tree:bad_crc(item, message)
  local text = ("Received 0x%08x, expected 0x%08x"):format(message.crc, message.calculated)
  self:expert(item, "crc.bad", text)
end

--- Add what YAPP's own item says of a message's history: the time since the previous one, messages
-- that are missing, whether a fault is set.
-- message  of message.reader
function Tree:add_delta(item, message)
  local delta, change = message.delta, message.change
  self:generated(item, "time_delta", delta and show_fields.relative_time(delta))
  self:generated(item, "seq.missing", change and change.missing)
  self:generated(item, "message.fault", message.has_fault)
end

--- Return a number of bytes in words: "1 byte", "2 bytes".
function Tree.bytes(count)
  return count == 1 and "1 byte" or ("%d bytes"):format(count)
end

-- Messages ----------------------------------------------------------------------------------------

-- Add the bytes of a payload from an offset on.
local function add_bytes(self, m, view, name, offset)
  local length, tvb = #m.payload - offset, view.payload_tvb
  if view.wants.yapp and tvb and length > 0 then
    add(view.item, self.fields[name], tvb(view.payload_offset + offset, length))
  end
end

-- Say that a payload does not have the catalogue's size.
-- returns  what the Info column says
local function add_mismatch(self, m, view)
  local source = m.source
  local least, most = source.min_size, source.size
  local known = least < most and ("%d to %d"):format(least, most) or most
  local text = ("%s, the catalogue says %s"):format(Tree.bytes(m.size), known)
  self:expert(view.item, "size.mismatch", ("%s has %s"):format(source.label, text))
  return ("%s, %s"):format(source.label, text)
end

-- Show a message that is not in the catalogue, or not as it is there: bytes.
local function show_bytes(self, m, view)
  add_bytes(self, m, view, "payload", 0)
  if m.source.message then return add_mismatch(self, m, view) end
  local text, info, like = self.reader:hint(m)
  if like and view.wants.yapp then self:generated(view.item, "like." .. like, m.source.id) end
  self:expert(view.item, "id.unknown", text)
  return ("%s  %s%s"):format(m.source.label, Tree.bytes(#m.payload), info or "")
end

--- Show a finished message: the message of the catalogue, or bytes.
-- m        of message.reader, as read
-- view     { wants = of Tree:wants; tree = where the Taurus tree goes; item = YAPP's own item, or
--          the tree; payload_tvb and payload_offset = where the payload lies, payload_tvb false if
--          no tree is wanted }
-- returns  what the Info column says of it; only a part of that if there are no columns
function Tree:show_message(m, view)
  local top, info, source = nil, "", m.source
  if view.wants.yapp then self:add_delta(view.item, m) end
  if not m.raws then
    info = show_bytes(self, m, view)
  else
    top = (view.payload_tvb or m.is_remarkable) and self.messages:show(m, view)
    if view.wants.columns then
      info = text_of.info(source.message, m.raws, source.label, m.is_remarkable)
    end
  end
  if m.change or top and m.state then
    info = info .. self.messages:add_change(m, top or nil, view.item)
  end
  if m.undecoded then
    add_bytes(self, m, view, "undecoded", source.size)
    add_mismatch(self, m, view)
    info = ("%s  [%s, %d not decoded]"):format(info, Tree.bytes(m.size), m.undecoded)
  end
  return info
end

return M
