-- SPDX-License-Identifier: GPL-2.0-or-later
-- YAPP on CAN: what is shown of a frame.  Wireshark's API; what a frame is, can.memory knows.

local can_id = require "yapp.wire.can_id"
local can_items = require "yapp.can.items"
local items = require "yapp.show.fields"
local memory = require "yapp.can.memory"
local part_text = require "yapp.can.part".text
local socketcan = require "yapp.host.socketcan"

local M = {}

local KINDS, START, END = can_id.KINDS, can_id.START, can_id.END
local address_of = can_id.address
local add, add_generated, append_text = items.add, items.add_generated, items.append_text
-- A method that Lua has to look up in a Tvb costs more than what it does.
local length_of, raw_of, reported_of, offset_of = Tvb.len, Tvb.raw, Tvb.reported_len, Tvb.offset

local STATUS_TEXT = {
  bad = "  [BAD CRC]", short = "  [INCOMPLETE]", overrun = "  [OVERRUN]", unverified = "  [CUT SHORT]",
}
local REASSEMBLED = "Reassembled YAPP" -- what Wireshark's bytes pane calls it

-- What a remote frame looks like where nothing says that it is one.
local ZEROS = {}
for length = 0, 8 do ZEROS[("\0"):rep(length)] = true end

local Carrier = {}
Carrier.__index = Carrier

--- The CAN side of the plugin.
-- tree     a tree builder (show.tree)
-- reader   a message.reader: what a finished message means
-- buses    a host.buses
-- claim    function(id): a frame of a message that is not in the catalogue was taken
function M.new(tree, reader, buses, claim)
  return setmetatable({ tree = tree, reader = reader, buses = buses, claim = claim, stat = reader.stat, frame = {} }, Carrier)
end

--- Forgets the capture file: nothing survives into the next one.
-- options  { new_history = function() -> a message.history }
function Carrier:reset(options)
  local reader, buses = self.reader, self.buses
  self.memory = memory.new { new_history = options.new_history,
    size_of = function(id, bus) return reader:size_of(id, buses:name(bus)) end }
  self.names = {} -- by source, see names_of
  self.place = buses.found.place
  self.highest = 0 -- the highest number so far: a frame above it is new, which saves asking Wireshark
end

-- The key of a source: bus and ID.
local function key_of(bus, id)
  return (bus or -1) * 0x800 + id
end

-- What the messages of a source are called: { bus = name or nil, name = in the Info column, source = in
-- the column Source; texts = of its parts, see can.part }.
local function new_names(self, bus, id)
  local bus_name = self.buses:name(bus)
  local names = { bus = bus_name, name = self.reader:label(id, bus_name),
    source = self.reader:source_text(id, bus_name), texts = {} }
  self.names[key_of(bus, id)] = names
  self.claim(id)
  return names
end

-- Statistics are told of a frame of a message that is still open, should the capture end before the message does, and of
-- what is lost.
local function source_record(frame, names)
  local address, bus = frame.address, frame.bus
  return { id = address.id, seq = address.seq, source = key_of(bus, address.id), bus = bus, bus_name = names.bus,
    frame = frame.number, time = frame.pinfo.rel_ts, visited = frame.is_again, is_end = address.ctrl == END }
end

-- Says what is wrong with a frame.
local function show_faults(self, frame, names, item)
  if #frame.data < frame.reported then
    self.tree:expert(item, "truncated",
      ("The capture has %d of the frame's %d bytes"):format(#frame.data, frame.reported))
  end
  if not frame.faults then return end
  for _, fault in ipairs(frame.faults) do self.tree:expert(item, fault.expert, fault.text) end
  if self.stat.wanted then self.reader.tell:faults(source_record(frame, names), frame.faults) end
end

-- YAPP's own item; the tree where nobody wants one, for the expert items.
local function item_of(self, frame, names, wants, is_message)
  if wants.yapp then return can_items.frame(self.tree, frame, names) end
  return wants.names and self.tree:bare(frame.tree, wants, is_message) or frame.tree
end

-- A finished message, as message.reader and show.tree take it.
local function finished(self, frame, names, wants, payload)
  local address = frame.address
  local id, bus = address.id, frame.bus
  return { id = id, seq = address.seq, ctl = address.ctl, name = names.name, source = key_of(bus, id), bus = bus,
    bus_name = names.bus, frame = frame.number, time = frame.pinfo.rel_ts, visited = frame.is_again, payload = payload,
    size = #payload, is_whole = true, at = 0, tree = frame.tree, item = nil, wanted = wants.yapp,
    has_columns = wants.columns, is_brief = not (wants.yapp or wants.standing), status = nil, good = nil, tvb = nil,
    message = nil, raws = nil, look = nil, has_fault = nil, change = nil }
end

-- Its meaning and its history.
local function read(self, m, frame)
  self.reader:read(m, self.memory, frame)
  self.memory:is_read(frame, m.has_fault)
  return m
end

-- A single-frame message.
local function show_single(self, frame, names, wants)
  local item = item_of(self, frame, names, wants, true)
  local data, reported = frame.data, frame.reported
  local known = self.reader:size_of(frame.address.id, names.bus)
  local padding = known and can_id.padding(data, reported, known)
  local m = finished(self, frame, names, wants, padding and padding > 0 and data:sub(1, known) or data)
  m.status, m.item, m.tvb = "single", item, (wants.yapp or wants.taurus) and frame.tvb
  m.good, m.size = #data == reported, padding and known or reported
  local info = self.tree:payload(read(self, m, frame))
  if wants.yapp and (padding or 0) > 0 and #data > known then
    add(item, self.tree.fields.padding, frame.tvb(known))
  end
  return info, item
end

-- The last frame of a message: what was put together.
local function show_message(self, frame, names, wants)
  local builder, message = self.tree, frame.entry
  local item = item_of(self, frame, names, wants, true)
  local m, status = finished(self, frame, names, wants, message.payload), message.status
  m.status, m.item, m.good, m.size = status, item, status == "good", message.size
  if m.payload ~= "" and (wants.yapp or wants.taurus) then
    m.tvb = ByteArray.new(m.payload, true):tvb(REASSEMBLED)
  end
  if wants.yapp then can_items.message(builder, frame, item, m, self.memory:frames_of(frame)) end
  if status == "bad" then builder:bad_crc(item, message) end
  if status == "short" or status == "overrun" then
    m.is_whole = false
    read(self, m, frame)
    if wants.yapp and m.tvb then add(item, builder.fields.payload, m.tvb()) end
    if wants.yapp then builder:add_delta(item, m) end
    return ("%s  %d of %d bytes%s"):format(names.name, message.received, message.size, STATUS_TEXT[status]), item
  end
  local info = builder:payload(read(self, m, frame))
  return status == "good" and info or info .. (STATUS_TEXT[status] or ""), item
end

-- The tree of a part of a message.
local function add_part(self, frame, item, leads_to)
  local fields, message = self.tree.fields, frame.entry
  if frame.address.ctrl == START then
    can_items.start(self.tree, frame, item)
    append_text(item, (" of %d bytes"):format(message.size))
  elseif frame.data ~= "" then
    add(item, fields["fragment.data"], frame.tvb())
  end
  if leads_to then add_generated(item, fields["reassembled.in"], leads_to) end
  if message.has_fault then add_generated(item, fields["message.fault"], true) end
end

-- A Start, a Middle, or an End that completes nothing.
local function show_part(self, frame, names, wants)
  local item, leads_to, is_unfinished = item_of(self, frame, names, wants), nil, nil
  if frame.is_again then leads_to, is_unfinished = self.memory:outcome(frame) end
  if wants.yapp then add_part(self, frame, item, leads_to) end
  if is_unfinished then self.tree:expert(item, "unfinished") end
  if self.stat.wants_parts then self.reader.tell:part(source_record(frame, names)) end
  if not wants.columns then return nil, item end
  local text = part_text(names, frame.address, frame.entry, frame.look, #frame.data)
  return leads_to and ("%s  [Reassembled in #%d]"):format(text, leads_to) or text, item
end

-- A frame that belongs to no message.
local function show_alone(self, frame, names, wants)
  local ctrl = frame.address.ctrl
  if ctrl == 0 then return show_single(self, frame, names, wants) end
  local item = item_of(self, frame, names, wants)
  if wants.yapp and ctrl == START then
    can_items.start(self.tree, frame, item)
  elseif wants.yapp and frame.data ~= "" then
    add(item, self.tree.fields["fragment.data"], frame.tvb())
  end
  local kind = KINDS[ctrl] or "CAN CTRL " .. ctrl
  local is_orphan = kind == "Middle" or kind == "End"
  return ("%s  %s%s"):format(names.name, kind, is_orphan and " without a Start" or ""), item
end

--- Dissects one frame.
-- id       29-bit CAN id
-- is_wide  whether the user says that every extended frame is YAPP
-- returns  the number of bytes that are ours, 0 for a frame that is not
function Carrier:dissect(tvb, pinfo, tree, id, is_wide)
  local frame, number, reported = self.frame, pinfo.number, reported_of(tvb)
  if reported == 0 then return 0 end
  -- raw() of nothing would throw past Lua, to Wireshark: what no Lua can catch.
  local data = length_of(tvb) > 0 and raw_of(tvb) or ""
  local is_again = number <= self.highest and pinfo.visited
  if not is_again then self.highest = number end -- with -R numbers come twice
  local address, bus, knows_bus = address_of(id), self.buses:of(pinfo)
  frame.number, frame.place, frame.is_again = number, self.place or offset_of(tvb), is_again
  frame.data, frame.reported, frame.bus, frame.knows_bus = data, reported, bus, knows_bus
  frame.address, frame.is_wide, frame.tvb, frame.pinfo, frame.tree = address, is_wide, tvb, pinfo, tree
  -- YAPP has no remote frames; what is not known to be one is data.
  if ZEROS[data] and not is_again and socketcan.is_remote(pinfo) then return 0 end
  local entry = self.memory:look(frame)
  if not entry then return 0 end
  local names = self.names[key_of(bus, address.id)] or new_names(self, bus, address.id)
  local wants = self.tree:wants(tree, pinfo, is_again)
  local show = entry.last == frame.look and show_message or entry.size and show_part or show_alone
  local info, item = show(self, frame, names, wants)
  if frame.faults or #data < reported then show_faults(self, frame, names, item) end
  if wants.columns then
    local columns = pinfo.cols
    columns.protocol, columns.src, columns.info = "YAPP", names.source, info
  end
  return reported
end

--- A frame that is YAPP's by the user's word, but whose CAN id nothing says: Decode As on its first frame, on a pass
-- that builds no tree.  Shown as bytes.
function Carrier:without_id(tvb, pinfo, tree)
  local builder, item = self.tree, tree
  self.memory:is_unknown()
  if builder:wants(tree, pinfo, true).yapp then
    item = add(tree, builder.yapp, tvb())
    if tvb:len() > 0 then add(item, builder.fields.payload, tvb()) end
  end
  pinfo.cols.protocol = "YAPP"
  builder:expert(item, "can.id.missing")
  return tvb:reported_len()
end

--- The messages that the capture ends before.
-- returns  list of { source, seq, frame = number of their last frame }
function Carrier:unfinished()
  local list = {}
  for i, message in ipairs(self.memory:unfinished()) do
    local address = message.address
    list[i] = { source = key_of(message.bus, address.id), seq = address.seq,
      frame = math.floor(message[#message]) }
  end
  return list
end

return M
