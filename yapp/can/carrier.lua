-- SPDX-License-Identifier: GPL-2.0-or-later
-- YAPP on CAN: what is shown of a frame.  Wireshark's API; what a frame is, can.memory knows.

local items = require("yapp.show.items")
local can_items = require("yapp.can.items")
local parts_of = require("yapp.can.part")

local M = {}

local newest_part, part_text = parts_of.newest, parts_of.text
local add, add_generated, append_text = items.add, items.add_generated, items.append_text

local STATUS_TEXT = {
  bad = "  [BAD CRC]", short = "  [INCOMPLETE]", overrun = "  [OVERRUN]", unverified = "  [CUT SHORT]",
}

local REASSEMBLED = "Reassembled YAPP" -- what Wireshark's bytes pane calls it

local KINDS, START, address_of, plain_frame -- of wire.can_id and host.facts; set in M.new

local Carrier = {}
Carrier.__index = Carrier

--- The CAN side of the plugin.
-- parts    the modules { can_id =, can_memory =, ... }
-- tree     a tree builder (show.tree)
-- reader   a message.reader: what a finished message means
-- facts    a host.facts
-- claim    function(id): a frame of a message that is not in the catalogue was taken
function M.new(parts, tree, reader, facts, claim)
  local can_id = parts.can_id
  KINDS, START, address_of, plain_frame = can_id.KINDS, can_id.START, can_id.address, facts.plain_frame
  return setmetatable({ parts = parts, tree = tree, reader = reader, facts = facts, claim = claim, view = {},
    record = {}, stat = reader.stat }, Carrier)
end

--- Forgets the capture file: nothing survives into the next one.
-- options  as for can.memory.new
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
-- parts = what statistics were told, by Seq, message = see finished, plain = see plain_message }.
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

-- What a message is given to the reader and the tree as; see message.reader.  Of each source one table, used again for
-- its next message: nobody keeps it, and a fresh one cost a tenth of the packet list.
local function finished(view, payload)
  local m, address, wants, facts = view.names.message, view.address, view.wants, view.facts
  m.tree, m.item, m.wanted, m.has_columns = view.tree, view.item, wants.yapp, wants.columns
  m.is_brief = not (wants.yapp or wants.standing)
  m.seq, m.ctl, m.payload, m.size = address.seq, address.ctl, payload, #payload
  m.frame, m.time, m.visited = facts.number, view.pinfo.rel_ts, facts.is_again
  m.is_whole, m.is_unsure, m.tvb = true, nil, nil
  return m
end

-- The short way's own such table, while nobody wants YAPP's own items: next to nothing in it changes, and to write all
-- of it cost 3 % of the packet list.
local function plain_message(names)
  local m = names.message
  m = { id = m.id, name = m.name, source = m.source, blind_source = m.blind_source, bus = m.bus, bus_name = m.bus_name,
    at = 0, wanted = false, visited = false, is_whole = true, status = "good", good = true }
  names.plain = m
  return m
end

-- Shows such a message; returns what the Info column says of it.
local function show_plain(self, m, wants, record)
  local payload = record.message.payload
  m.payload, m.size, m.frame, m.tvb = payload, #payload, record.look, nil
  m.has_columns, m.is_brief = wants.columns, not wants.standing
  if wants.taurus then m.tvb = ByteArray.new(payload, true):tvb(REASSEMBLED) end
  return self.tree:payload(self:read(m, record))
end

local plain_facts = { is_again = false } -- of a frame that came the short way, and of no other

-- Shows a frame that the memory took; returns its length.
-- view  { tvb, pinfo, tree, address }
local function show_taken(self, view, facts, record)
  local address, pinfo, bus, is_again = view.address, view.pinfo, facts.bus, facts.is_again
  local of_bus = self.names[bus or false]
  local names = of_bus and of_bus[address.id] or new_names(self, address.id, bus)
  local wants = not is_again and self.tree.wanted or self:wants(view.tree, pinfo, is_again)
  view.facts, view.record, view.names, view.wants = facts, record, names, wants
  if self.stat.wants_parts and record.message and not record.is_last then
    local part = self:told_part(names, address, bus)
    part.frame, part.time, part.visited = facts.number, pinfo.rel_ts, is_again
  end
  local info = self:show(view)
  if wants.columns then
    local columns = pinfo.cols
    columns.protocol, columns.src, columns.info = "YAPP", names.source, info
  end
  return facts.reported
end

-- The long way of a frame, which all can go; returns what Carrier:dissect does.
local function dissect_any(self, tvb, pinfo, tree, address, is_wide)
  local memory, view = self.memory, self.view
  local facts = self.facts:can_frame(tvb, pinfo, memory.highest)
  if facts.reported == 0 then return 0 end
  if facts.is_odd and (facts.remote or facts.doubtful and facts.data == "") then
    if facts.doubtful then memory:guess() else memory:pass_over(facts) end
    return 0
  end
  facts.wide = is_wide
  local record = memory:look(address, facts, self.record)
  if not record then return 0 end
  view.tvb, view.pinfo, view.tree, view.address = tvb, pinfo, tree, address
  return show_taken(self, view, facts, record)
end

--- Dissects one frame: on the short way where that goes, a new frame of which nothing can be said but that it begins a
-- message, is its next part, or all that it lacks.
-- can_id   29-bit CAN id
-- is_wide  whether the user says that every extended frame is YAPP
-- returns  the number of bytes that are ours, 0 for a frame that is not
function Carrier:dissect(tvb, pinfo, tree, can_id, is_wide)
  local memory, address = self.memory, address_of(can_id)
  local taker, number, data, bus, message, is_last = memory.short[address.ctrl], nil
  if taker then
    number, data, bus = plain_frame(self.facts, tvb, pinfo, memory.highest, memory.usual)
    if number then message, is_last = memory:plain(taker, address, number, data, bus) end
  end
  if not message then return dissect_any(self, tvb, pinfo, tree, address, is_wide) end
  local wants, of_bus = self.tree.wanted or self:wants(tree, pinfo, false), self.names[bus or false]
  local names, length, info = of_bus and of_bus[address.id], #data, nil
  if not names or wants.yapp then
    local view, facts = self.view, plain_facts
    facts.number, facts.data, facts.reported, facts.bus = number, data, length, bus
    view.tvb, view.pinfo, view.tree, view.address = tvb, pinfo, tree, address
    return show_taken(self, view, facts, memory:plain_record(number, message, is_last))
  end
  if wants.names then self.tree:bare(tree, wants, is_last) end
  if is_last then
    local m = names.plain or plain_message(names)
    m.tree, m.item, m.seq, m.time = tree, tree, address.seq, pinfo.rel_ts
    info = show_plain(self, m, wants, memory:plain_record(number, message, true))
  elseif self.stat.wants_parts then
    local part = self:told_part(names, address, bus)
    part.frame, part.time, part.visited = number, pinfo.rel_ts, false
  end
  if wants.columns then
    local columns = pinfo.cols
    columns.protocol, columns.src = "YAPP", names.source
    columns.info = info or newest_part(names, address, message, number, length)
  end
  return length
end

-- What anyone wants of a packet, see Tree:wants; the memory is told of an only pass.
function Carrier:wants(tree, pinfo, is_again)
  local wants = self.tree:wants(tree, pinfo, is_again)
  if wants.is_only_pass then self.memory:only_pass() end
  return wants
end

--- tshark's taps see one of the first packets: see can.memory.
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
  view.item = view.wanted and can_items.frame(builder, view) or builder:bare(view.tree, view.wants, is_message)
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
  if not self.stat.wanted then return end
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

-- A frame that stands alone: a single-frame message, or what belongs to none.
function Carrier:show_alone(view)
  local address, data = view.address, view.facts.data
  if address.ctrl == 0 then return self:show_single(view) end
  if view.wanted and address.ctrl == START then
    can_items.start(self.tree, view)
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
      can_items.start(self.tree, view)
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

-- The last frame of a message: what was put together.
function Carrier:show_message(view)
  local builder, item, entry = self.tree, view.item, view.record.message
  local message, status = finished(view, entry.payload), entry.status
  message.status, message.good, message.size = status, status == "good", entry.size
  if #entry.payload > 0 and (view.wanted or view.wants.taurus) then
    message.tvb = ByteArray.new(entry.payload, true):tvb(REASSEMBLED)
  end
  if view.wanted then can_items.message(builder, view, message, self.memory:frames_of(view.record)) end
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

return M
