-- SPDX-License-Identifier: GPL-2.0-or-later
-- The view of YAPP's messages, however they came: parts of the tree, expert items, the Info column.
-- show.frame and show.packet show their frames and packets, show.taurus their values.
-- Wireshark's API.

local show_fields = require "yapp.show.fields"
local memo = require "yapp.base.memo"
local messages_of = require "yapp.show.taurus"
local number_of = require "yapp.base.frame_key".number

local M = {}

local add = show_fields.add
local set_generated = show_fields.set_generated
local append_text = show_fields.append_text
local referenced = TreeItem.referenced

-- By status: crc.status, the text behind the CRC, and the text of the item.
local CRC = {
  bad = { 0, " [incorrect, should be 0x%08x]", ", CRC BAD" },
  good = { 1, " [correct]", ", CRC good" },
}
local UNVERIFIED = { 2, " [unverified]", ", CRC unverified" }

local Tree = {}
Tree.__index = Tree

--- The last word in Info, by the status of the message.
Tree.MARKS = {
  good = "",
  bad = "  [BAD CRC]",
  incomplete = "  [INCOMPLETE]",
  overrun = "  [OVERRUN]",
  truncated = "  [TRUNCATED]",
}

--- Make the view of messages.
-- options  { yapp =, taurus = Proto, catalogue = compiled, reading = a reading.reading;
--          fields, taurus_fields = of the two, see show.fields; names = { [id] = title } }
function M.new(options)
  return setmetatable({
    yapp = options.yapp,
    label = options.yapp.description .. ", ", -- of its items, see Tree:add_item
    taurus = options.taurus,
    reading = options.reading,
    messages = messages_of.new(options.taurus, options.catalogue.messages, options.taurus_fields),
    fields = options.fields,
    default_names = options.names, -- by ID
    wanted = nil, -- of Tree:wants, in the first pass of tshark
    is_only_pass = false, -- true if it is known that there is one pass
  }, Tree)
end

--- Forget the answers about the file before.
function Tree:reset()
  self.wanted, self.is_only_pass = nil, false
end

--- Make this first pass of tshark the only one: no packet is revisited.
function Tree:set_only_pass()
  self.wanted, self.is_only_pass = nil, true
end

-- The parts of a packet that are wanted -----------------------------------------------------------

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

local LIST = { columns = true, shows = true } -- a packet list of Wireshark, or of later passes

-- The API takes a dissector to ask about a protocol, and ours exist only after loading.
local dissectors = memo(function(name) return Dissector.get(name) end)

-- Ask Wireshark which parts of a packet are wanted.
local function ask_wants(self, tree)
  local yapp, taurus = referenced(tree, dissectors.yapp), referenced(tree, dissectors.taurus)
  return {
    columns = true,
    shows = true,
    yapp = yapp,
    taurus = taurus,
    tree = yapp or taurus,
    state = taurus,
    names = not SAYS_PROTOCOLS and not self.reading.listener,
  }
end

-- Ask Wireshark in tshark's first pass, where the answer is the same for all packets.
local function ask_first_pass(self, tree, pinfo)
  local has_columns = tostring(pinfo.cols.info) ~= NO_COLUMN
  local wants = tree.hidden and ask_wants(self, tree) or {}
  wants.columns = has_columns
  wants.shows = has_columns or wants.tree or wants.names
  wants.plans = {}
  wants.is_only_pass = self.is_only_pass or is_only_pass(tree, has_columns)
  wants.state = wants.taurus and self.messages:wants_state(tree)
  return wants
end

--- Return which parts of a packet are wanted.
-- visited   true if the packet was shown before
-- returns   {
--   yapp          true if YAPP's own items are shown, filtered or printed
--   taurus        true if those of messages are
--   tree          true if one of the two is
--   state         true if the state of messages that change nothing is wanted, too
--   names         true if the names of the protocols are wanted although the above are not, see
--                 Tree:add_protocol_names
--   shows         true if anything but expert items is wanted
--   columns       true if there are columns: tshark has them for a packet list, and not with -V,
--                 -q, most of -T or in a first pass of two
--   plans         see show.taurus, nil where the answer may change
--   is_only_pass  true if it is sure that no packet is shown again, so that nothing need be kept: a
--                 tenth of a packet list }
-- In tshark's first pass the answer is the same for all packets, so it is asked once; in Wireshark,
-- and in later passes, it may change.
function Tree:wants(tree, pinfo, visited)
  if IS_TSHARK and not visited then
    self.wanted = self.wanted or ask_first_pass(self, tree, pinfo)
    return self.wanted
  end
  return tree.hidden and ask_wants(self, tree) or LIST
end

--- Add the names of the protocols to a tree in which no field of YAPP is wanted, for -z io,phs.
-- wants    of the tree
-- message  of reading.messages, or nil; if it has values, it has the name of Taurus, too
-- COMPAT 4.0, 4.4: from 4.6 on `referenced` tells.
function Tree:add_protocol_names(tree, wants, message)
  add(tree, self.yapp)
  if message and message.raws and not wants.taurus then add(tree, self.taurus) end
end

-- Items of YAPP's ---------------------------------------------------------------------------------

--- Add YAPP's own item, and return it.
-- text  behind the name of the protocol
function Tree:add_item(tree, range, text)
  return add(tree, self.yapp, range, self.label .. text)
end

--- Add an expert item of YAPP's.
-- name  its filter without "yapp."
-- text  see show.fields, add_expert
function Tree.add_expert(_, item, name, text)
  show_fields.add_expert(item, "yapp." .. name, text)
end

--- Add the expert items of anomalies.
-- anomalies  of a result
function Tree:add_anomalies(item, anomalies)
  for _, one in ipairs(anomalies) do self:add_expert(item, one.expert, one.text) end
end

--- Add the id, with the name that the user's mapping gives it.
-- range   TvbRange, nil where the CAN id has it
-- source  of message.types
function Tree:add_id(item, range, source)
  local id, title = source.id, source.type and source.type.title
  local pf = self.fields.id
  local added = range and add(item, pf, range, id) or set_generated(add(item, pf, id))
  if title == self.default_names[id] then return end
  added:set_text(("Message ID: %s (0x%08x)"):format(title or "Unknown", id))
end

--- Add the bus, where there is one, and the source.
-- source  of message.types
function Tree:add_source(item, source)
  local fields = self.fields
  if source.bus then set_generated(add(item, fields.bus, source.bus)) end
  set_generated(add(item, fields.source, source.text))
end

--- Add the frames that a message was put together from.
-- whole    TvbRange
-- keys     of its frames; one that a read filter dropped has a fraction, and gets no link
-- length   in bytes
-- payload  TvbRange of the message's payload, nil where it has none
function Tree:add_fragments(item, whole, keys, length, payload)
  local fields = self.fields
  local list = set_generated(add(item, fields.fragments, whole))
  list:set_text(("%d fragments (%d bytes)"):format(#keys, length))
  for i = 1, #keys do
    set_generated(add(list, fields.fragment, number_of(keys[i])))
  end
  set_generated(add(list, fields["fragment.count"], #keys))
  set_generated(add(list, fields["reassembled.length"], length))
  if payload then set_generated(add(list, fields["reassembled.data"], payload)) end
end

--- Add a CRC with its status, and append the status to the item's text.
-- range     TvbRange of the CRC or nil where it was sent in another frame
-- transfer  { status, calculated }
-- sent      the CRC, where there is no range
function Tree:add_crc(item, range, transfer, sent)
  local shown, fields = CRC[transfer.status] or UNVERIFIED, self.fields
  local crc = range and show_fields.add_le(item, fields.crc, range)
    or set_generated(add(item, fields.crc, sent))
  append_text(crc, shown[2]:format(transfer.calculated))
  set_generated(add(item, fields["crc.status"], shown[1]))
  if shown == CRC.bad then
    set_generated(add(item, fields["crc.calculated"], transfer.calculated))
  end
  append_text(item, shown[3])
end

--- Add the expert item of a bad CRC, with the received and the expected one.
function Tree:add_bad_crc(item, transfer)
  local text = ("Received 0x%08x, expected 0x%08x"):format(transfer.crc, transfer.calculated)
  self:add_expert(item, "crc.bad", text)
end

--- Add that a message has a fault, in each of its frames.
function Tree:add_has_fault(item, has_fault)
  if has_fault then set_generated(add(item, self.fields["message.fault"], true)) end
end

--- Add a message's history to YAPP's own item: the time since the previous one, messages
-- that are missing, whether a fault is set.
-- message  of reading.messages
function Tree:add_delta(item, message)
  local delta, change, fields = message.delta, message.change, self.fields
  if delta then set_generated(add(item, fields.time_delta, show_fields.relative_time(delta))) end
  if change and change.missing then
    set_generated(add(item, fields["seq.missing"], change.missing))
  end
  if message.copy_of then
    set_generated(add(item, fields.copy_of, number_of(message.copy_of)))
  end
  self:add_has_fault(item, message.remarks.has_fault)
end

--- Return a number of bytes in words: "1 byte", "2 bytes".
function Tree.bytes_text(count)
  return count == 1 and "1 byte" or ("%d bytes"):format(count)
end

-- Messages ----------------------------------------------------------------------------------------

-- Add the bytes of a payload from an offset on.
local function add_bytes(self, message, view, name, offset)
  local length, tvb = #message.payload - offset, view.payload_tvb
  if view.wants.yapp and tvb and length > 0 then
    add(view.item, self.fields[name], tvb(view.payload_offset + offset, length))
  end
end

-- Add the expert item of a payload that does not have the catalogue's size.
-- returns  its text for the Info column
local function add_mismatch(self, message, view)
  local source = message.source
  local least, most = source.min_size, source.size
  local known = least < most and ("%d to %d"):format(least, most) or most
  local text = ("%s, the catalogue says %s"):format(Tree.bytes_text(message.transfer.size), known)
  self:add_expert(view.item, "size.mismatch", ("%s has %s"):format(source.label, text))
  return ("%s, %s"):format(source.label, text)
end

-- Return the texts about a message that is not in the catalogue.  If a type has its size, they name
-- the preference that decodes it.
-- returns  a text for the packet, and one for the end of the Info column
local function unknown_texts(message)
  local like = message.like
  local text = ("Message ID 0x%x is not in the catalogue"):format(message.source.id)
  if not like then return text, "" end
  local title = like.type.title
  local size = "the size of " .. title
  local advice = (': see the preference "%s message IDs"'):format(title)
  text = ("%s; %d bytes, %s%s"):format(text, message.transfer.size, size, advice)
  return text, ", " .. size .. (like.is_advised and advice or "")
end

-- Show a message that is not in the catalogue, or not as it is there: bytes.
local function show_bytes(self, message, view)
  add_bytes(self, message, view, "payload", 0)
  if message.source.type then return add_mismatch(self, message, view) end
  local id, like = message.source.id, message.like
  local text, info = unknown_texts(message)
  if like and view.wants.yapp then
    set_generated(add(view.item, self.fields["like." .. like.type.name], id))
  end
  self:add_expert(view.item, "id.unknown", text)
  return ("%s  %s%s"):format(message.source.label, Tree.bytes_text(#message.payload), info)
end

-- Return the text of a message's values in Info.  The source stands in it even if a column shows it
-- where something is wrong: Wireshark's list of expert items has no such column.
local function values_text(result)
  local message = result.message
  local source = message.source
  local name = result.is_usual and source.short or source.label
  return name .. "  " .. source.write(message.raws)
end

--- Show a finished message: the message of the catalogue, or bytes.
-- result   of reading.records, with the message
-- view     { wants = of Tree:wants; tree = where the Taurus tree goes; item = YAPP's own item, or
--          the tree; payload_tvb and payload_offset = where the payload lies, payload_tvb false if
--          no tree is wanted }
-- returns  its text for the Info column; only a part of that if there are no columns
function Tree:show_message(result, view)
  local info, message = "", result.message
  if view.wants.yapp then self:add_delta(view.item, message) end
  if not message.raws then
    info = show_bytes(self, message, view)
  elseif view.wants.columns then
    info = values_text(result)
  end
  if view.payload_tvb or not result.is_usual then
    local faults, words = self.messages:show(message, view)
    info = faults .. info .. words
  end
  if message.copy_of then
    self:add_expert(view.item, "copy")
    info = ("%s  [copy of #%d]"):format(info, number_of(message.copy_of))
  end
  if message.undecoded then
    add_bytes(self, message, view, "undecoded", message.source.size)
    add_mismatch(self, message, view)
    local size = Tree.bytes_text(message.transfer.size)
    info = ("%s  [%s, %d not decoded]"):format(info, size, message.undecoded)
  end
  return info
end

return M
