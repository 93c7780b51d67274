-- SPDX-License-Identifier: GPL-2.0-or-later
-- YAPP on CAN: what is shown of a frame.  Wireshark's API; what a frame is, can.memory knows.

local can_id = require "yapp.wire.can_id"
local items = require "yapp.show.fields"
local memory = require "yapp.can.memory"
local socketcan = require "yapp.host.socketcan"

local M = {}

local KINDS, START, END = can_id.KINDS, can_id.START, can_id.END
local address_of = can_id.address
local add, add_le = items.add, items.add_le
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
-- claim    function(id): a frame of this ID was taken, which the catalogue may not know
function M.new(tree, reader, buses, claim)
  return setmetatable({
    tree = tree,
    reader = reader,
    buses = buses,
    claim = claim,
    stat = reader.stat,
    title = tree.yapp.description .. ", ", -- how YAPP's item begins
  }, Carrier)
end

--- Forgets the capture file: nothing survives into the next one.
-- new_history  function() -> a message.history
function Carrier:reset(new_history)
  local reader, buses, sources = self.reader, self.buses, {}
  local function source_of(id, bus)
    local key = (bus or -1) * 0x800 + id
    local source = sources[key]
    if not source then
      source = reader:new_source(key, id, bus, buses:name(bus))
      sources[key] = source
    end
    return source
  end
  self.source_of = source_of
  self.memory = memory.new {
    new_history = new_history,
    source_of = source_of,
    claim = self.claim,
  }
  self.highest = 0 -- number so far: a frame above it is new, which saves asking Wireshark
  -- The frame of now, as the memory takes it, and tvb, pinfo, tree: used again for the next one.
  -- COMPAT 5.2: where there is nothing, false: to write nil under a name that has none makes the
  -- table anew.
  local place = buses.found.place
  self.frame = { place = place or 0, bus = false, knows_bus = true }
  self.has_places, self.asks = not place, buses.asks
end

-- Statistics are told of a frame of a message that is still open, should the capture end before the
-- message does, and of what is lost.
local function source_record(frame)
  local address, source = frame.address, frame.entry.source
  return {
    id = address.id,
    seq = address.seq,
    source = source.key,
    bus = source.bus,
    bus_name = source.bus_name,
    frame = frame.number,
    time = frame.pinfo.rel_ts,
    visited = frame.is_again,
    is_end = address.ctrl == END,
  }
end

-- Says what is wrong with a frame.
local function show_faults(self, frame, item)
  if #frame.data < frame.reported then
    local text = "The capture has %d of the frame's %d bytes"
    self.tree:expert(item, "truncated", text:format(#frame.data, frame.reported))
  end
  if not frame.faults then return end
  for _, fault in ipairs(frame.faults) do self.tree:expert(item, fault.expert, fault.text) end
  if self.stat.wanted then self.reader.tell:faults(source_record(frame), frame.faults) end
end

-- YAPP's own item ---------------------------------------------------------------------------------

-- With what the CAN id says.
local function add_item(self, frame)
  local builder, address, source = self.tree, frame.address, frame.entry.source
  local kind = KINDS[address.ctrl] or "undefined frame"
  local title, range = self.title .. source.name .. ", " .. kind, frame.tvb()
  local item = add(frame.tree, builder.yapp, range, title)
  builder:add_address(item, address, source)
  frame.range = range
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
  builder:generated(item, "reassembled.in", frame.number)
  append_text(builder:generated(item, "size", entry.size), " bytes")
  builder:generated(item, "reserved", entry.reserved or 0)
  builder:add_crc(item, nil, entry)
  local payload, length = tvb and tvb(), #entry.payload
  builder:add_fragments(item, payload or frame.range, frame.pass:numbers(entry), #entry, length,
    payload)
  if entry.padding and entry.padding <= #data then
    add(item, builder.fields.padding, frame.tvb(#data - entry.padding))
  end
  append_text(item, CRC_TEXT[entry.status] or ", CRC unverified")
end

-- A part of a message.
local function add_part(self, frame, item, leads_to)
  local builder, message = self.tree, frame.entry
  if frame.address.ctrl == START then
    add_start(self, frame, item)
    append_text(item, (" of %d bytes"):format(message.size))
  elseif frame.data ~= "" then
    add(item, builder.fields["fragment.data"], frame.range)
  end
  builder:generated(item, "reassembled.in", leads_to)
  builder:generated(item, "message.fault", message.has_fault)
end

-- Messages ----------------------------------------------------------------------------------------

-- A finished message.
local function finished(frame, wants, item, payload, status, size)
  local m = frame.entry.source.message
  m.seq = frame.address.seq
  m.frame = frame.number
  m.time = frame.pinfo.rel_ts
  m.visited = frame.is_again
  m.payload = payload
  m.size = size
  m.status = status
  m.good = status == "good"
  m.is_whole = true
  m.tree = frame.tree
  m.item = item
  m.tvb = false
  m.wants = wants
  return m
end

-- A single-frame message.
local function show_single(self, frame, wants, item)
  local data, reported, source = frame.data, frame.reported, frame.entry.source
  local most = source.size
  local least = source.min_size or most
  local size = most and can_id.single_size(data, reported, least, most) or reported
  local payload = size < #data and data:sub(1, size) or data
  local m = finished(frame, wants, item, payload, "single", size)
  m.good = #data == reported
  if wants.tree then m.tvb = frame.tvb end
  self.reader:read(m, self.memory, frame)
  local info = self.tree:payload(m)
  if wants.yapp and #data > size then
    add(item, self.tree.fields.padding, frame.tvb(size))
  end
  return info
end

-- A message of which bytes are missing, or that has too many.
local function show_unfit(self, frame, m)
  local builder, message = self.tree, frame.entry
  m.is_whole = false
  self.reader:read(m, self.memory, frame)
  if m.wants.yapp and m.tvb then add(m.item, builder.fields.payload, m.tvb()) end
  if m.wants.yapp then builder:add_delta(m.item, m) end
  local text = ("%s  %d of %d bytes"):format(m.name, message.received, message.size)
  return text .. STATUS_TEXT[message.status]
end

-- The last frame of a message: what was put together.
local function show_message(self, frame, wants, item)
  local builder, message = self.tree, frame.entry
  local status, payload = message.status, message.payload
  local m = finished(frame, wants, item, payload, status, message.size)
  if wants.tree and payload ~= "" then
    m.tvb = ByteArray.new(payload, true):tvb(REASSEMBLED)
  end
  if wants.yapp then add_message(self, frame, item, m.tvb) end
  if status == "bad" then builder:bad_crc(item, message) end
  if status == "short" or status == "overrun" then return show_unfit(self, frame, m) end
  self.reader:read(m, self.memory, frame)
  local info = builder:payload(m)
  return m.good and info or info .. STATUS_TEXT[status]
end

-- Parts -------------------------------------------------------------------------------------------

-- The texts of the parts of a message of a size, in frames of classic CAN: "Motor Data  part 2 of
-- 5".
local function new_texts(source, size)
  local usual = math.ceil(size / 8) + 1
  local texts = { source.name .. ("  Start of %d bytes"):format(size), size = size, usual = usual }
  for i = 2, math.min(usual, MOST_TEXTS) do
    texts[i] = ("%s  part %d of %d"):format(source.name, i, usual)
  end
  source.texts = texts
  return texts
end

-- A part that did not come as most do: before the End of its message, in frames of classic CAN.
-- How many parts there are is sure in the end; before that, it is what classic CAN needs.
local function other_part_text(source, message, look, length)
  local texts, index = source.texts, #message
  while index > 1 and message[index] ~= look do index = index - 1 end
  if message[index] ~= look then return source.name .. "  part once more" end
  local parts = length == 8 and texts.usual or 0
  if message.status == "good" then parts = #message end
  if index == 1 then return texts[1] end
  if index > parts then return ("%s  part %d"):format(source.name, index) end
  return ("%s  part %d of %d"):format(source.name, index, parts)
end

-- A Start, a Middle, or an End that completes nothing.
local function show_part(self, frame, wants, item)
  local leads_to, is_unfinished
  if frame.is_again then leads_to, is_unfinished = self.memory:outcome(frame) end
  if wants.yapp then add_part(self, frame, item, leads_to) end
  if is_unfinished then self.tree:expert(item, "unfinished") end
  if self.stat.wants_parts then self.reader.tell:part(source_record(frame)) end
  if not wants.columns then return end
  local message, length = frame.entry, #frame.data
  local source = message.source
  local texts = source.texts
  if texts.size ~= message.size then texts = new_texts(source, message.size) end
  local text = length == 8 and not frame.is_again and not message.status and texts[#message]
    or other_part_text(source, message, frame.look, length)
  return leads_to and ("%s  [Reassembled in #%d]"):format(text, leads_to) or text
end

-- A frame that belongs to no message.
local function show_alone(self, frame, wants, item)
  local ctrl, name = frame.address.ctrl, frame.entry.source.name
  if ctrl == 0 then return show_single(self, frame, wants, item) end
  if wants.yapp and ctrl == START then
    add_start(self, frame, item)
  elseif wants.yapp and frame.data ~= "" then
    add(item, self.tree.fields["fragment.data"], frame.range)
  end
  if not KINDS[ctrl] then return ("%s  CAN CTRL %d"):format(name, ctrl) end
  local text = ("%s  %s"):format(name, KINDS[ctrl])
  return ctrl ~= START and text .. " without a Start" or text
end

-- Frames ------------------------------------------------------------------------------------------

-- Shows a frame of ours.
local function show(self, frame, entry)
  local builder, pinfo, item = self.tree, frame.pinfo, frame.tree
  local wants = not frame.is_again and builder.wanted or builder:wants(item, pinfo, frame.is_again)
  frame.is_only_pass = wants.is_only_pass -- and those that follow
  local is_last, show_it = entry.last == frame.look, show_alone
  if is_last then
    show_it = show_message
  elseif entry.size then
    show_it = show_part
  end
  if wants.yapp then
    item = add_item(self, frame)
  elseif wants.names then
    builder:bare(item, wants, is_last or not entry.size and frame.address.ctrl == 0)
  end
  local info = show_it(self, frame, wants, item)
  if frame.faults or #frame.data < frame.reported then show_faults(self, frame, item) end
  if not wants.columns then return end
  local columns = pinfo.cols
  columns.protocol = "YAPP"
  columns.src = entry.source.text
  columns.info = info
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
  frame.number = number
  frame.is_again = is_again
  frame.data = data
  frame.reported = reported
  frame.address = address_of[id]
  frame.is_wide = is_wide
  frame.tvb = tvb
  frame.pinfo = pinfo
  frame.tree = tree
  if self.has_places then frame.place = offset_of(tvb) end
  if self.asks then
    local bus, knows_bus = self.buses:of(pinfo, number)
    frame.bus, frame.knows_bus = bus or false, knows_bus
  end
  local entry = self.memory:look(frame)
  if not entry then return 0 end
  show(self, frame, entry)
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

--- Whether a frame that nobody dissects may be a Start: it has the bytes of one.
function Carrier.is_start(_, tvb)
  if length_of(tvb) ~= 8 then return false end
  local _, size, reserved = can_id.start(raw_of(tvb))
  return reserved == 0 and size > 8
end

--- Reports it to the statistics, if its CAN id is that of a Start.
-- id  29-bit CAN id
function Carrier:report_start(tvb, pinfo, id)
  local address, number = address_of[id], pinfo.number
  if address.ctrl ~= START or address.ctl ~= 0 then return end
  local _, size = can_id.start(raw_of(tvb))
  local source = self.source_of(address.id, self.buses:of(pinfo, number))
  self.reader.tell:start {
    id = address.id,
    seq = address.seq,
    size = size,
    source = source.key,
    bus = source.bus,
    bus_name = source.bus_name,
    frame = number,
    time = pinfo.rel_ts,
    visited = pinfo.visited,
  }
end

--- The messages that the capture ends before.
-- returns  list of { source, seq, frame = number of their last frame }
function Carrier:unfinished()
  local list = {}
  for i, message in ipairs(self.memory:unfinished()) do
    list[i] = {
      source = message.source.key,
      seq = message.address.seq,
      frame = math.floor(message[#message]),
    }
  end
  return list
end

return M
