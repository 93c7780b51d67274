-- SPDX-License-Identifier: GPL-2.0-or-later
-- YAPP on CAN: what is shown of a frame.  Wireshark's API; what a frame is, can.memory knows.

local can_id = require "yapp.wire.can_id"
local items = require "yapp.show.fields"
local memory = require "yapp.can.memory"
local socketcan = require "yapp.host.socketcan"

local M = {}

local KINDS, START, END = can_id.KINDS, can_id.START, can_id.END
local address_of = can_id.address
local add, add_le, add_generated = items.add, items.add_le, items.add_generated
local append_text = items.append_text
-- A method that Lua has to look up in a Tvb costs more than what it does.
local length_of, raw_of, reported_of, offset_of = Tvb.len, Tvb.raw, Tvb.reported_len, Tvb.offset

local STATUS_TEXT = {
  bad = "  [BAD CRC]",
  short = "  [INCOMPLETE]",
  overrun = "  [OVERRUN]",
  unverified = "  [CUT SHORT]",
}
local CRC_TEXT = { good = ", CRC good", bad = ", CRC BAD" }
local REASSEMBLED = "Reassembled YAPP" -- what Wireshark's bytes pane calls it
local MOST_TEXTS = 64 -- of the parts of a message, that are kept

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
  local self = { tree = tree, reader = reader, buses = buses, claim = claim, stat = reader.stat }
  return setmetatable(self, Carrier)
end

--- Forgets the capture file: nothing survives into the next one.
-- options  { new_history = function() -> a message.history }
function Carrier:reset(options)
  local reader, buses = self.reader, self.buses
  local sizes = {} -- by key of a source, false of an unknown one
  local function size_of(id, bus)
    local key = (bus or -1) * 0x800 + id
    if sizes[key] == nil then sizes[key] = reader:size_of(id, buses:name(bus)) or false end
    return sizes[key] or nil
  end
  self.memory = memory.new { new_history = options.new_history, size_of = size_of }
  self.names = {} -- by source, see new_names
  self.place = buses.found.place
  self.highest = 0 -- number so far: a frame above it is new, which saves asking Wireshark
  self.frame = {} -- of now, as the memory takes it; and tvb, pinfo, tree
end

-- The key of a source: bus and ID.
local function key_of(bus, id)
  return (bus or -1) * 0x800 + id
end

-- What the messages of a source are called.  And a message, as message.reader and show.tree take
-- it: one table for all of a source, see finished.
local function new_names(self, key, bus, id)
  local bus_name = self.buses:name(bus)
  local name = self.reader:label(id, bus_name)
  local names = {
    bus = bus_name,
    name = name, -- in the Info column
    source = self.reader:source_text(id, bus_name), -- in the column Source
    texts = {}, -- of the parts of its messages, see part_text
    message = { id = id, name = name, source = key, bus = bus, bus_name = bus_name, at = 0 },
  }
  self.names[key] = names
  self.claim(id)
  return names
end

-- Statistics are told of a frame of a message that is still open, should the capture end before the
-- message does, and of what is lost.
local function source_record(frame, names)
  local address, bus = frame.address, frame.bus
  return {
    id = address.id,
    seq = address.seq,
    source = key_of(bus, address.id),
    bus = bus,
    bus_name = names.bus,
    frame = frame.number,
    time = frame.pinfo.rel_ts,
    visited = frame.is_again,
    is_end = address.ctrl == END,
  }
end

-- Says what is wrong with a frame.
local function show_faults(self, frame, names, item)
  if #frame.data < frame.reported then
    local text = "The capture has %d of the frame's %d bytes"
    self.tree:expert(item, "truncated", text:format(#frame.data, frame.reported))
  end
  if not frame.faults then return end
  for _, fault in ipairs(frame.faults) do self.tree:expert(item, fault.expert, fault.text) end
  if self.stat.wanted then self.reader.tell:faults(source_record(frame, names), frame.faults) end
end

-- YAPP's own item ---------------------------------------------------------------------------------

-- With what the CAN id says; the tree where nobody wants one, for the expert items.
local function item_of(self, frame, names, wants)
  local builder, address, entry = self.tree, frame.address, frame.entry
  if not wants.yapp then
    local is_message = entry.last == frame.look or not entry.size and address.ctrl == 0
    return builder:bare(frame.tree, wants, is_message)
  end
  local kind = KINDS[address.ctrl] or "undefined frame"
  local title = ("%s, %s, %s"):format(builder.yapp.description, names.name, kind)
  local item = add(frame.tree, builder.yapp, frame.tvb(), title)
  builder:add_address(item, address, names.bus)
  return item
end

-- What a Start says, as far as it was captured.
local function add_start(self, frame, item)
  local fields, length = self.tree.fields, #frame.data
  if length >= 4 then add_le(item, fields.crc, frame.tvb(0, 4)) end
  if length >= 6 then append_text(add_le(item, fields.size, frame.tvb(4, 2)), " bytes") end
  if length >= 8 then add_le(item, fields.reserved, frame.tvb(6, 2)) end
end

-- What is put together in a message's last frame.
local function add_message(self, frame, item, tvb)
  local builder, entry, data = self.tree, frame.entry, frame.data
  local numbers = self.memory:frames_of(frame)
  builder:generated(item, "reassembled.in", frame.number)
  append_text(builder:generated(item, "size", entry.size), " bytes")
  builder:generated(item, "reserved", entry.reserved or 0)
  builder:add_crc(item, nil, entry)
  builder:add_fragments(item, tvb or frame.tvb, numbers, #entry, #entry.payload, tvb and tvb())
  if entry.padding and entry.padding <= #data then
    add(item, builder.fields.padding, frame.tvb(#data - entry.padding))
  end
  append_text(item, CRC_TEXT[entry.status] or ", CRC unverified")
end

-- A part of a message.
local function add_part(self, frame, item, leads_to)
  local fields, message = self.tree.fields, frame.entry
  if frame.address.ctrl == START then
    add_start(self, frame, item)
    append_text(item, (" of %d bytes"):format(message.size))
  elseif frame.data ~= "" then
    add(item, fields["fragment.data"], frame.tvb())
  end
  if leads_to then add_generated(item, fields["reassembled.in"], leads_to) end
  if message.has_fault then add_generated(item, fields["message.fault"], true) end
end

-- Messages ----------------------------------------------------------------------------------------

-- A finished message.  Nobody keeps it: the source's next one is told in the same table, as a
-- new one took a tenth of a packet list.
local function finished(frame, names, wants, item, payload)
  local m = names.message
  m.seq = frame.address.seq
  m.frame = frame.number
  m.time = frame.pinfo.rel_ts
  m.visited = frame.is_again
  m.payload = payload
  m.is_whole = true
  m.tree = frame.tree
  m.item = item
  m.tvb = nil
  m.wanted = wants.yapp
  m.has_columns = wants.columns
  return m
end

-- Its meaning and its history.
local function read(self, m, frame)
  self.reader:read(m, self.memory, frame)
  self.memory:is_read(frame, m.has_fault)
  return m
end

-- A single-frame message.
local function show_single(self, frame, names, wants, item)
  local data, reported, payload = frame.data, frame.reported, frame.data
  local known = self.reader:size_of(frame.address.id, names.bus)
  local padding = known and can_id.padding(data, reported, known)
  if padding and padding > 0 then payload = data:sub(1, known) end
  local m = finished(frame, names, wants, item, payload)
  m.status = "single"
  m.good = #data == reported
  m.size = padding and known or reported
  if wants.yapp or wants.taurus then m.tvb = frame.tvb end
  local info = self.tree:payload(read(self, m, frame))
  if wants.yapp and padding and #data > known then
    add(item, self.tree.fields.padding, frame.tvb(known))
  end
  return info
end

-- A message of which bytes are missing, or that has too many.
local function show_unfit(self, frame, names, m)
  local builder, message = self.tree, frame.entry
  m.is_whole = false
  read(self, m, frame)
  if m.wanted and m.tvb then add(m.item, builder.fields.payload, m.tvb()) end
  if m.wanted then builder:add_delta(m.item, m) end
  local text = ("%s  %d of %d bytes"):format(names.name, message.received, message.size)
  return text .. STATUS_TEXT[message.status]
end

-- The last frame of a message: what was put together.
local function show_message(self, frame, names, wants, item)
  local builder, message = self.tree, frame.entry
  local status = message.status
  local m = finished(frame, names, wants, item, message.payload)
  m.status = status
  m.good = status == "good"
  m.size = message.size
  if (wants.yapp or wants.taurus) and m.payload ~= "" then
    m.tvb = ByteArray.new(m.payload, true):tvb(REASSEMBLED)
  end
  if wants.yapp then add_message(self, frame, item, m.tvb) end
  if m.good then return builder:payload(read(self, m, frame)) end
  if status == "bad" then builder:bad_crc(item, message) end
  if status == "short" or status == "overrun" then return show_unfit(self, frame, names, m) end
  return builder:payload(read(self, m, frame)) .. STATUS_TEXT[status]
end

-- Parts -------------------------------------------------------------------------------------------

-- The texts of the parts of a message of a size, in frames of classic CAN: "Motor Data  part 2 of
-- 5".
local function new_texts(names, size)
  local usual = math.ceil(size / 8) + 1
  local texts = { names.name .. ("  Start of %d bytes"):format(size), size = size, usual = usual }
  for i = 2, math.min(usual, MOST_TEXTS) do
    texts[i] = ("%s  part %d of %d"):format(names.name, i, usual)
  end
  names.texts = texts
  return texts
end

-- What the Info column says of a part.
local function part_text(names, message, look, length)
  local texts, index = names.texts, #message
  if texts.size ~= message.size then texts = new_texts(names, message.size) end
  while index > 1 and message[index] ~= look do index = index - 1 end
  -- How many parts there are is sure in the end; before that, it is what classic CAN needs.
  local parts = message.status == "good" and #message or length == 8 and texts.usual or 0
  if index == 1 or parts == texts.usual and texts[index] then
    return message[index] == look and texts[index] or names.name .. "  part once more"
  end
  if index > parts then return ("%s  part %d"):format(names.name, index) end
  return ("%s  part %d of %d"):format(names.name, index, parts)
end

-- A Start, a Middle, or an End that completes nothing.
local function show_part(self, frame, names, wants, item)
  local leads_to, is_unfinished
  if frame.is_again then leads_to, is_unfinished = self.memory:outcome(frame) end
  if wants.yapp then add_part(self, frame, item, leads_to) end
  if is_unfinished then self.tree:expert(item, "unfinished") end
  if self.stat.wants_parts then self.reader.tell:part(source_record(frame, names)) end
  if not wants.columns then return nil end
  local text = part_text(names, frame.entry, frame.look, #frame.data)
  return leads_to and ("%s  [Reassembled in #%d]"):format(text, leads_to) or text
end

-- A frame that belongs to no message.
local function show_alone(self, frame, names, wants, item)
  local ctrl = frame.address.ctrl
  if ctrl == 0 then return show_single(self, frame, names, wants, item) end
  if wants.yapp and ctrl == START then
    add_start(self, frame, item)
  elseif wants.yapp and frame.data ~= "" then
    add(item, self.tree.fields["fragment.data"], frame.tvb())
  end
  local text = ("%s  %s"):format(names.name, KINDS[ctrl] or "CAN CTRL " .. ctrl)
  return KINDS[ctrl] and ctrl ~= START and text .. " without a Start" or text
end

-- Frames ------------------------------------------------------------------------------------------

-- Shows a frame of ours.
local function show(self, frame, names, pinfo, item)
  local entry, builder = frame.entry, self.tree
  local wants = not frame.is_again and builder.wanted or
    builder:wants(item, pinfo, frame.is_again)
  if wants.yapp or wants.names then item = item_of(self, frame, names, wants) end
  local show_it = entry.size and show_part or show_alone
  if entry.last == frame.look then show_it = show_message end
  local info = show_it(self, frame, names, wants, item)
  if frame.faults or #frame.data < frame.reported then show_faults(self, frame, names, item) end
  if wants.columns then
    local columns = pinfo.cols
    columns.protocol = "YAPP"
    columns.src = names.source
    columns.info = info
  end
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
  -- YAPP has no remote frames; what is not known to be one is data.
  if ZEROS[data] and not is_again and socketcan.is_remote(pinfo) then return 0 end
  local address, bus, knows_bus = address_of(id), nil, true
  if self.buses.asks then bus, knows_bus = self.buses:of(pinfo) end
  frame.number = number
  frame.place = self.place or offset_of(tvb)
  frame.is_again = is_again
  frame.data = data
  frame.reported = reported
  frame.bus = bus
  frame.knows_bus = knows_bus
  frame.address = address
  frame.is_wide = is_wide
  frame.tvb = tvb
  frame.pinfo = pinfo
  frame.tree = tree
  if not self.memory:look(frame) then return 0 end
  local key = (bus or -1) * 0x800 + address.id
  local names = self.names[key] or new_names(self, key, bus, address.id)
  show(self, frame, names, pinfo, tree)
  return reported
end

--- A frame that is YAPP's by the user's word, but whose CAN id nothing says: Decode As on its first
-- frame, on a pass that builds no tree.  Shown as bytes.
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
    list[i] = {
      source = key_of(message.bus, address.id),
      seq = address.seq,
      frame = math.floor(message[#message]),
    }
  end
  return list
end

return M
