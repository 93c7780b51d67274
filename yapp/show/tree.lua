-- SPDX-License-Identifier: GPL-2.0-or-later
-- What a user sees of YAPP: the tree, the expert items, the Info column.  The messages:
-- show.taurus.  Wireshark's API; what is shown comes in finished, from the reassembly or the
-- framing.

local fields_of = require("yapp.show.fields")
local info_of = require("yapp.message.info")
local messages_of = require("yapp.show.taurus")

local M = {}

local add = fields_of.add
local add_le = fields_of.add_le
local add_generated = fields_of.add_generated
local append_text = fields_of.append_text

local STATUS_CODE = { bad = 0, good = 1 } -- any other is unverified
local UNVERIFIED = 2
local CRC_TEXT = { good = " [correct]", bad = " [incorrect, should be 0x%08x]" }

local Tree = {}
Tree.__index = Tree

--- Makes fields and expert items and hands them to the two protocols.
-- options  { yapp =, taurus = Proto, catalogue = compiled, reader = a message.reader }
function M.new(options)
  local self = setmetatable({
    yapp = options.yapp,
    taurus = options.taurus,
    reader = options.reader,
    messages = messages_of.new(options.taurus, options.catalogue),
    default_names = {}, -- titles by ID
  }, Tree)
  for id, message in pairs(options.catalogue.by_id) do self.default_names[id] = message.title end
  self.fields, self.experts = fields_of.of_yapp(self.yapp, self.default_names)
  return self
end

--- Forgets what was wanted of the file before.
function Tree:reset()
  self.wanted, self.is_only_pass = nil, false
  self.messages:reset()
end

--- Says that tshark shows none again of the packets that it shows now for the first time.
function Tree:only_pass()
  self.wanted, self.is_only_pass = nil, true
end

-- What is wanted ----------------------------------------------------------------------------------

local IS_TSHARK = not gui_enabled()
local NO_COLUMN = "(info)" -- what the API calls it where there are no columns at all
local SAYS_PROTOCOLS = not get_version():find("^4%.[0-5]%.")
-- COMPAT 4.0: no filter can name a column there.
local FILTERS_COLUMNS = not get_version():find("^4%.0%.")

-- Where nobody wants a tree.
local function without_tree(has_columns, is_only_pass)
  return {
    columns = has_columns,
    is_only_pass = is_only_pass,
    yapp = false,
    taurus = false,
    tree = false,
    standing = false,
    names = false,
  }
end
local LIST = without_tree(true, false) -- of Wireshark

-- What is wanted of a look at a packet.
local function ask(self, tree, pinfo, is_first)
  local has_columns = not is_first or tostring(pinfo.cols.info) ~= NO_COLUMN
  -- From 4.6 on there is always a tree.
  if not tree.hidden then
    return is_first and without_tree(has_columns, has_columns) or LIST
  end
  -- The first pass of two shows no tree; and it has columns only where a filter names one, which
  -- needs a tree.
  local is_only_pass = is_first and (tree.visible or
    has_columns and not (FILTERS_COLUMNS and pcall(all_field_infos)))
  -- The API asks by dissector, and those exist only when loading has ended.
  local yapp = tree:referenced(Dissector.get("yapp"))
  local taurus = tree:referenced(Dissector.get("taurus"))
  return {
    columns = has_columns,
    is_only_pass = is_only_pass,
    yapp = yapp,
    taurus = taurus,
    tree = yapp or taurus,
    standing = taurus and (not is_first or self.messages:wants_standing(tree)),
    names = not SAYS_PROTOCOLS and not self.reader.stat.wanted,
  }
end

--- What anyone wants of a packet.
-- is_again  whether the packet was shown before
-- returns   { yapp = whether YAPP's own items are visible, filtered or printed, taurus = whether
--           those of messages are, tree = whether any of both, standing = whether, of these, what
--           also stands at those that change nothing, names = whether, without them, the names of
--           protocols are (see bare), columns = whether there are columns: tshark has them for a
--           packet list, and not with -V, -q, most of -T or in a first pass of two; is_only_pass =
--           whether it is sure that no packet is shown again, so that nothing need be kept: a tenth
--           of a packet list }.  In tshark this does not change within a first pass, so it is asked
--           once and kept in `wanted`; in Wireshark, and on later looks of sharkd, it may.
function Tree:wants(tree, pinfo, is_again)
  if not IS_TSHARK or is_again then return ask(self, tree, pinfo, false) end
  local wants = self.wanted or ask(self, tree, pinfo, true)
  wants.is_only_pass = wants.is_only_pass or self.is_only_pass
  self.wanted = wants
  return wants
end

--- Where nobody wants YAPP's own items, but there is a tree, and the names of protocols are wanted:
--- its name, for who asks for them (-z io,phs).
-- wants       of the tree; is_message: whether there is a message's name too
-- COMPAT 4.0, 4.4: from 4.6 on `referenced` tells.
function Tree:bare(tree, wants, is_message)
  add(tree, self.yapp)
  if is_message and not wants.taurus then add(tree, self.taurus) end
end

--- Adds an expert item of YAPP's.
-- name  its filter without "yapp."; text: see show.fields, add_expert
function Tree:expert(item, name, text)
  fields_of.add_expert(item, self.experts["yapp." .. name], text)
end

--- Adds a field of YAPP's that no bytes of the packet say, where it has a value.
-- name     its filter without "yapp."; value: nil or false for none
-- returns  the item; nil or false without one
function Tree:generated(item, name, value)
  return value and add_generated(item, self.fields[name], value)
end

--- Adds what the CAN id says, all of it generated.
-- address  wire.can_id's
-- source   of message.reader
function Tree:add_address(item, address, source)
  self:add_id(item, nil, address.id, source.bus_name)
  local fields = self.fields
  add_generated(item, fields.ctl, address.ctl)
  add_generated(item, fields.seq, address.seq)
  add_generated(item, fields["can.ctrl"], address.ctrl)
  self:add_source(item, source)
end

--- Adds the id, with the name that the user's mapping gives it.
-- range  TvbRange, nil where the CAN id has it
function Tree:add_id(item, range, id, bus_name)
  local added = range and add(item, self.fields.id, range, id) or self:generated(item, "id", id)
  local message = self.reader:message_of(id, bus_name)
  local title = message and message.title
  if title == self.default_names[id] then return end
  added:set_text(("Message ID: %s (0x%08x)"):format(title or "Unknown", id))
end

--- Adds the bus, where there is one, and the source.
-- source  of message.reader
function Tree:add_source(item, source)
  self:generated(item, "bus", source.bus_name)
  add_generated(item, self.fields.source, source.text)
end

--- Adds the frames that a message was put together from.
-- whole    TvbRange; numbers: of its frames; count: of them, with any that a read filter rejected;
--          length: in bytes
-- payload  TvbRange of the message's payload, nil where it has none
function Tree:add_fragments(item, whole, numbers, count, length, payload)
  local list = self:generated(item, "fragments", whole)
  list:set_text(("%d fragments (%d bytes)"):format(count, length))
  local fragment = self.fields.fragment
  for _, number in ipairs(numbers) do add_generated(list, fragment, number) end
  self:generated(list, "fragment.count", count)
  self:generated(list, "reassembled.length", length)
  self:generated(list, "reassembled.data", payload)
end

--- Adds a CRC with its status.
-- range   TvbRange of the CRC or nil where it was sent in another frame
-- message { crc, status, calculated }
function Tree:add_crc(item, range, message)
  local status = message.status
  local calculated = message.calculated
  local crc = range and add_le(item, self.fields.crc, range)
    or self:generated(item, "crc", message.crc)
  append_text(crc, (CRC_TEXT[status] or " [unverified]"):format(calculated))
  self:generated(item, "crc.status", STATUS_CODE[status] or UNVERIFIED)
  if status == "bad" then self:generated(item, "crc.calculated", calculated) end
end

--- Says that a CRC is bad, with what was received and expected.
function Tree:bad_crc(item, message)
  local text = ("Received 0x%08x, expected 0x%08x"):format(message.crc, message.calculated)
  self:expert(item, "crc.bad", text)
end

--- Adds what YAPP's own item says of a message's history: the time since the previous one,
--  messages that are missing.
-- message  of message.reader
function Tree:add_delta(item, message)
  local delta, change = message.delta, message.change
  self:generated(item, "time_delta", delta and fields_of.relative_time(delta))
  self:generated(item, "seq.missing", change and change.missing)
  self:generated(item, "message.fault", message.has_fault)
end

--- A number of bytes in words: "1 byte", "2 bytes".
function Tree.bytes(count)
  return count == 1 and "1 byte" or ("%d bytes"):format(count)
end

-- Says that a payload has not the catalogue's size.
-- returns  what the Info column says
local function say_mismatch(self, m)
  local message, size, wanted = m.message, Tree.bytes(m.size), ("%d"):format(m.message.size)
  if message.min_size < message.size then
    wanted = ("%d to %s"):format(message.min_size, wanted)
  end
  wanted = "the catalogue says " .. wanted
  self:expert(m.item, "size.mismatch", ("%s has %s, %s"):format(m.name, size, wanted))
  return ("%s, %s, %s"):format(m.name, size, wanted)
end

-- A message that is not in the catalogue, or not as it is there: bytes.
local function show_bytes(self, m)
  if m.wants.yapp and m.tvb and #m.payload > 0 then
    add(m.item, self.fields.payload, m.tvb(m.at, #m.payload))
  end
  if m.message then return say_mismatch(self, m) end
  local text, info = self.reader:hint(m)
  self:expert(m.item, "id.unknown", text)
  return ("%s  %s%s"):format(m.name, Tree.bytes(#m.payload), info or "")
end

-- What is behind a payload's last field.
local function show_undecoded(self, m)
  if m.wants.yapp and m.tvb then
    add(m.item, self.fields.undecoded, m.tvb(m.at + m.message.size, m.undecoded))
  end
  say_mismatch(self, m)
  return ("  [%s, %d not decoded]"):format(Tree.bytes(m.size), m.undecoded)
end

--- Shows a finished message: the message of the catalogue, or bytes.
-- m        of message.reader, with { tree = where the Taurus tree goes, item = YAPP's own item or
--          the tree, tvb and at = where the payload lies, tvb nil where nobody wants a tree, wants
--          = of Tree:wants }
-- returns  what the Info column says of it, or a part of that where nobody sees it
function Tree:payload(m)
  local top, info = nil, ""
  if m.wants.yapp then self:add_delta(m.item, m) end
  if not m.raws then
    info = show_bytes(self, m)
  else
    top = (m.tvb or m.look) and self.messages:show(m)
    if m.wants.columns then info = info_of.text(m.message, m.raws, m.name, m.look) end
  end
  if m.change or top then info = info .. self.messages:add_change(m, top, self.experts) end
  if m.undecoded then info = info .. show_undecoded(self, m) end
  return info
end

return M
