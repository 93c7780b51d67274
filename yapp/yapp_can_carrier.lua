-- SPDX-License-Identifier: GPL-2.0-or-later
-- YAPP on CAN: what is shown of a frame.  Wireshark's API; what a frame is, yapp_can_memory knows.

local items = require("yapp_tree_items")
local parts_of = require("yapp_can_part")

local M = {}

local newest_part, part_text = parts_of.newest, parts_of.text
local add, add_le, add_generated, append_text = items.add, items.add_le, items.add_generated, items.append_text

local STATUS_TEXT = {
  bad = "  [BAD CRC]", short = "  [INCOMPLETE]", overrun = "  [OVERRUN]", unverified = "  [CUT SHORT]",
}
local CRC_TEXT = { good = ", CRC good", bad = ", CRC BAD" }

local REASSEMBLED = "Reassembled YAPP" -- what Wireshark's bytes pane calls it

local KINDS, SINGLE, START, address_of -- of yapp_can_id; set in M.new

local Carrier = {}
Carrier.__index = Carrier

--- The CAN side of the plugin.
-- parts    the modules { can_id =, can_memory =, ... }
-- tree     a tree builder (yapp_tree)
-- reader   a yapp_reader: what a finished message means
-- facts    a yapp_facts
-- claim    function(id): a frame of a message that is not in the catalogue was taken
function M.new(parts, tree, reader, facts, claim)
  local can_id = parts.can_id
  KINDS, SINGLE, START, address_of = can_id.KINDS, can_id.SINGLE, can_id.START, can_id.address
  return setmetatable({ parts = parts, tree = tree, reader = reader, facts = facts, claim = claim, view = {},
    record = {} }, Carrier)
end

--- Forgets the capture file: nothing survives into the next one.
-- options  as for yapp_can_memory.new
function Carrier:reset(options)
  self.memory = self.parts.can_memory.new(self.parts, options)
  self.names = {} -- [bus or false][id]: see new_names
end

-- The key of a source: bus and ID.
local function key_of(bus, id)
  return (bus or -1) * 0x800 + id
end

-- What the messages of an ID are called, and texts of their parts, for the first time: { bus = name of the bus or nil,
-- name = in the Info column, source = in the column Source, texts, titles = of YAPP's item by CAN CTRL,
-- parts = what statistics were told, by Seq, message = see finished }.
-- bus  number or nil
local function new_names(self, id, bus)
  local of_bus, bus_name = self.names[bus or false] or {}, self.facts:bus_name(bus)
  local name = self.reader:label(id, bus_name)
  self.names[bus or false] = of_bus
  of_bus[id] = { bus = bus_name, name = name, source = self.reader:source_text(id, bus_name), texts = {}, titles = {},
    parts = {}, message = { id = id, name = name, source = key_of(bus, id), blind_source = key_of(nil, id), bus = bus,
      bus_name = bus_name, at = 0 } }
  self.claim(id)
  return of_bus[id]
end

-- A view is what most of the following look at: { tvb, pinfo, tree, wants, address, facts, record, names, item = YAPP's
-- own item, or the tree where nobody wants one; wanted = whether anyone does }: one table for all frames.

-- What a message is given to the reader and the tree as; see yapp_reader.  Of each source one table, used again for its
-- next message: nobody keeps it, and a fresh one cost a tenth of the packet list.
local function finished(view, payload)
  local m, address, wants, facts = view.names.message, view.address, view.wants, view.facts
  m.tree, m.item, m.wanted, m.has_columns = view.tree, view.item, wants.yapp, wants.columns
  m.is_brief = not (wants.yapp or wants.taurus)
  m.seq, m.ctl, m.payload, m.size = address.seq, address.ctl, payload, #payload
  m.frame, m.time, m.visited = facts.number, view.pinfo.rel_ts, facts.is_again
  m.is_whole, m.is_unsure = true, nil
  m.message, m.raws, m.look, m.has_fault, m.change, m.number, m.delta, m.tvb = nil, nil, nil, nil, nil, nil, nil, nil
  return m
end

-- A message that came the short way, of which nobody wants YAPP's own items; returns what the Info column says of it.
local function plain_message(self, view)
  local payload, wants = view.record.message.payload, view.wants
  local m = finished(view, payload)
  m.item = self.tree:bare(view.tree, wants, true)
  m.status, m.good = "good", true
  if wants.taurus then m.tvb = ByteArray.new(payload, true):tvb(REASSEMBLED) end
  return self.tree:payload(self:read(m, view.record))
end

local plain_facts = { is_again = false } -- of a frame that came the short way, and of no other

-- Has the memory take a frame; the short way, where it goes: a new one of which nothing can be said but that it begins
-- a message, is its next part, or all that it lacks.
-- returns  its record and facts; nil for a frame that is not YAPP's
local function take(self, tvb, pinfo, address, is_wide)
  local memory = self.memory
  if not memory.is_again and address.ctrl ~= SINGLE then
    local number, place, data, bus = self.facts:plain_frame(tvb, pinfo, memory.highest)
    local record = number and memory:plain(address, number, place, data, bus)
    if record then
      local facts = plain_facts
      facts.number, facts.data, facts.reported, facts.bus = number, data, #data, bus
      return record, facts
    end
  end
  local facts = self.facts:can_frame(tvb, pinfo, memory.highest)
  if facts.reported == 0 then return nil end
  if facts.is_odd and (facts.remote or facts.doubtful and facts.data == "") then
    if facts.doubtful then memory:guess() else memory:pass_over(facts) end
    return nil
  end
  facts.wide = is_wide
  return memory:look(address, facts, self.record), facts
end

--- Dissects one frame.
-- can_id   29-bit CAN id
-- is_wide  whether the user says that every extended frame is YAPP
-- returns  the number of bytes that are ours, 0 for a frame that is not
function Carrier:dissect(tvb, pinfo, tree, can_id, is_wide)
  local builder, address, info = self.tree, address_of(can_id), nil
  local record, facts = take(self, tvb, pinfo, address, is_wide)
  if not record then return 0 end
  local bus, is_again = facts.bus, facts.is_again
  local of_bus = self.names[bus or false]
  local names = of_bus and of_bus[address.id] or new_names(self, address.id, bus)
  local wants = not is_again and builder.wanted or self:wants(tree, pinfo, is_again)
  if self.reader.stat.wants_parts and record.message and not record.is_last then
    local part = self:told_part(names, address, bus)
    part.frame, part.time, part.visited = facts.number, pinfo.rel_ts, is_again
  end
  local is_bare = facts == plain_facts and not wants.yapp -- most are: no tree, and nothing to say but the Info text
  if not is_bare or record.is_last then
    local view = self.view
    view.tvb, view.pinfo, view.tree, view.wants = tvb, pinfo, tree, wants
    view.address, view.facts, view.record, view.names = address, facts, record, names
    if is_bare then info = plain_message(self, view) else info = self:show(view) end
  elseif wants.names then
    builder:bare(tree, wants)
  end
  if wants.columns then
    local columns = pinfo.cols
    columns.protocol, columns.src = "YAPP", names.source
    columns.info = info or newest_part(names, address, record.message, facts.number, facts.reported)
  end
  return facts.reported
end

-- What anyone wants of a packet, see Tree:wants.
function Carrier:wants(tree, pinfo, is_again)
  local wants = self.tree:wants(tree, pinfo, is_again)
  if wants.is_only_pass then self.memory:only_pass() end
  return wants
end

--- tshark's taps see one of the first packets: see yapp_can_memory.
function Carrier:tapped(number)
  self.memory:tapped(number)
end

--- Says that a first pass may have been told wrong ids.
function Carrier:guess()
  self.memory:guess()
end

--- A frame that is YAPP's by the user's word, but whose CAN id nothing says: Decode As on its first frame, on a pass
-- that builds no tree.  Shown as bytes.
function Carrier:without_id(tvb, pinfo, tree)
  local builder = self.tree
  local item = tree
  self.memory:guess()
  if builder:wants(tree, pinfo, true).yapp then
    item = add(tree, builder.yapp, tvb())
    if tvb:len() > 0 then add(item, builder.fields.payload, tvb()) end
  end
  pinfo.cols.protocol = "YAPP"
  builder:expert(item, "can.id.missing")
  return tvb:reported_len()
end

-- Shows a frame: tree and expert items; returns what the Info column says of it.
function Carrier:show(view)
  local builder, record, facts, info = self.tree, view.record, view.facts
  view.wanted = view.wants.yapp
  local is_message = record.is_last or record.alone and view.address.ctrl == 0
  view.item = view.wanted and self:item(view) or builder:bare(view.tree, view.wants, is_message)
  if record.alone then
    info = self:show_alone(view)
  elseif record.is_last then
    info = self:show_message(view)
  else
    info = self:show_part(view)
  end
  if #facts.data < facts.reported then
    builder:expert(view.item, "truncated",
      ("The capture has %d of the frame's %d bytes"):format(#facts.data, facts.reported))
  end
  if record.faults then self:show_faults(view) end
  if record.is_unfinished then builder:expert(view.item, "unfinished") end
  return info
end

-- What is wrong with a frame; statistics are told of what is lost.
function Carrier:show_faults(view)
  local facts, address = view.facts, view.address
  for _, fault in ipairs(view.record.faults) do self.tree:expert(view.item, fault.expert, fault.text) end
  if not self.reader.stat.wanted then return end
  self.reader.tell:faults({ id = address.id, seq = address.seq, source = key_of(facts.bus, address.id),
    bus = facts.bus, bus_name = view.names.bus, frame = facts.number, time = view.pinfo.rel_ts,
    visited = facts.is_again, is_end = address.ctrl == self.parts.can_id.END }, view.record.faults)
end

-- And, for the messages that the capture ends before, of parts: of a message's in one record, told once, to which the
-- caller writes frame, time (seconds since the first packet) and visited of each.
function Carrier:told_part(names, address, bus)
  local part = names.parts[address.seq]
  if not part then
    part = { id = address.id, seq = address.seq, source = key_of(bus, address.id), bus = bus, bus_name = names.bus }
    names.parts[address.seq] = part
    self.reader.tell:part(part)
  end
  return part
end

--- The messages that the capture ends before.
-- returns  list of { source, seq, frame = number of their last frame }
function Carrier:unfinished()
  local list = {}
  for i, message in ipairs(self.memory:unfinished()) do
    list[i] = { source = key_of(message.bus, message.address.id), seq = message.address.seq,
      frame = math.floor(message[message.count]) }
  end
  return list
end

-- YAPP's own tree item, with what the CAN id says.
function Carrier:item(view)
  local builder, address = self.tree, view.address
  local titles, ctrl = view.names.titles, address.ctrl
  local title = titles[ctrl]
  if not title then
    title = ("%s, %s, %s"):format(builder.yapp.description, view.names.name, KINDS[ctrl] or "undefined frame")
    titles[ctrl] = title
  end
  view.range = view.tvb()
  local item = add(view.tree, builder.yapp, view.range, title)
  builder:add_address(item, address, view.names.bus)
  return item
end

-- A frame that stands alone: a single-frame message, or what belongs to none.
function Carrier:show_alone(view)
  local address, data = view.address, view.facts.data
  if address.ctrl == 0 then return self:show_single(view) end
  if view.wanted and address.ctrl == START then
    self:start_tree(view)
  elseif view.wanted and #data > 0 then
    add(view.item, self.tree.fields["fragment.data"], view.range)
  end
  if view.record.is_late then
    self.tree:expert(view.item, "can.id.missing",
      "The CAN id was not known on the first pass: reload to see the message")
  end
  local kind = KINDS[address.ctrl] or "CAN CTRL " .. address.ctrl
  local is_orphan = kind == "Middle" or kind == "End"
  return ("%s  %s%s"):format(view.names.name, kind, is_orphan and " without a Start" or "")
end

function Carrier:show_single(view)
  local facts, id = view.facts, view.address.id
  local data, reported = facts.data, facts.reported
  local known = self.reader:size_of(id, view.names.bus)
  local padding = known and self.parts.can_id.padding(data, reported, known)
  local payload = padding and padding > 0 and data:sub(1, known) or data
  local message = finished(view, payload)
  message.status, message.tvb = "single", (view.wanted or view.wants.taurus) and view.tvb
  message.good, message.size = #data == reported, padding and known or reported
  local info = self.tree:payload(self:read(message, view.record))
  if view.wanted and (padding or 0) > 0 and #data > known then
    add(view.item, self.tree.fields.padding, view.tvb(known))
  end
  return info
end

-- A finished message: its meaning and its history.
function Carrier:read(message, record)
  self.reader:read(message, self.memory, record)
  if message.has_fault then self.memory:note_fault(record) end
  return message
end

-- A Start, a Middle, or an End that completes nothing.
function Carrier:show_part(view)
  local fields, item, record = self.tree.fields, view.item, view.record
  local leads_to = record.leads_to
  if view.wanted then
    if view.address.ctrl == START then
      self:start_tree(view)
      append_text(item, (" of %d bytes"):format(record.message.size))
    elseif #view.facts.data > 0 then
      add(item, fields["fragment.data"], view.range)
    end
    if leads_to then add_generated(item, fields["reassembled.in"], leads_to) end
    if record.has_fault then add_generated(item, fields["message.fault"], true) end
  end
  local text = part_text(view.names, view.address, record.message, record.look, #view.facts.data)
  return leads_to and ("%s  [Reassembled in #%d]"):format(text, leads_to) or text
end

-- What a Start says, as far as it was captured.
function Carrier:start_tree(view)
  local fields, item, length = self.tree.fields, view.item, #view.facts.data
  if length >= 4 then add_le(item, fields.crc, view.tvb(0, 4)) end
  if length >= 6 then append_text(add_le(item, fields.size, view.tvb(4, 2)), " bytes") end
  if length >= 8 then add_le(item, fields.reserved, view.tvb(6, 2)) end
end

-- The last frame of a message: what was put together.
function Carrier:show_message(view)
  local builder, item, entry = self.tree, view.item, view.record.message
  local message, status = finished(view, entry.payload), entry.status
  message.status, message.good, message.size = status, status == "good", entry.size
  if #entry.payload > 0 and (view.wanted or view.wants.taurus) then
    message.tvb = ByteArray.new(entry.payload, true):tvb(REASSEMBLED)
  end
  if view.wanted then self:message_tree(view, message) end
  if status == "bad" then builder:bad_crc(item, entry) end
  if status == "short" or status == "overrun" then
    message.is_whole = false
    self:read(message, view.record)
    if view.wanted and message.tvb then add(item, builder.fields.payload, message.tvb()) end
    if view.wanted then builder:add_delta(item, message) end
    return ("%s  %d of %d bytes%s"):format(view.names.name, entry.received, entry.size, STATUS_TEXT[status])
  end
  return builder:payload(self:read(message, view.record)) .. (STATUS_TEXT[status] or "")
end

-- What YAPP's own item says of a message in its last frame.
function Carrier:message_tree(view, message)
  local builder, item, entry, data = self.tree, view.item, view.record.message, view.facts.data
  local fields = builder.fields
  add_generated(item, fields["reassembled.in"], view.facts.number)
  append_text(add_generated(item, fields.size, entry.size), " bytes")
  add_generated(item, fields.reserved, entry.reserved or 0)
  builder:add_crc(item, nil, entry)
  local numbers = self.memory:frames_of(view.record)
  builder:add_fragments(item, message.tvb or view.tvb, numbers, entry.count, #entry.payload)
  if entry.padding and entry.padding <= #data then
    add(item, fields.padding, view.tvb(#data - entry.padding))
  end
  append_text(item, CRC_TEXT[entry.status] or ", CRC unverified")
end

return M
