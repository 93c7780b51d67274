-- SPDX-License-Identifier: GPL-2.0-or-later
-- The dissector of YAPP on CAN: shows what a frame is.  Wireshark's API.

local can_id = require "yapp.wire.can_id"
local frame_key = require "yapp.base.frame_key"
local reassembly = require "yapp.can.reassembly"
local show_fields = require "yapp.show.fields"
local socketcan = require "yapp.host.socketcan"

local M = {}

local KINDS, START, END = can_id.KINDS, can_id.START, can_id.END
local add, add_le, append_text = show_fields.add, show_fields.add_le, show_fields.append_text
local fields_of, slot_of = can_id.fields, can_id.slot
local number_of, PACKET = frame_key.number, frame_key.PACKET
-- A method that Lua has to look up in a Tvb costs more than what it does.
local length_of, raw_of, reported_of, offset_of = Tvb.len, Tvb.raw, Tvb.reported_len, Tvb.offset

local STATUS_TEXT = {
  bad = "  [BAD CRC]",
  short = "  [INCOMPLETE]",
  overrun = "  [OVERRUN]",
  unverified = "  [TRUNCATED]",
}
local CRC_TEXT = { good = ", CRC good", bad = ", CRC BAD" }
local REASSEMBLED = "Reassembled YAPP" -- what Wireshark's bytes pane calls it
local FIRST = 1e99 -- seconds since a source's previous message, of its first one

-- What a remote frame looks like where nothing says that it is one.
local ZEROS = {}
for length = 0, 8 do ZEROS[("\0"):rep(length)] = true end

-- YAPP has no remote frames; what is not known to be one is data.
local function is_remote(frame)
  return ZEROS[frame.data] and socketcan.is_remote(frame.pinfo)
end

local Dissector = {}
Dissector.__index = Dissector

--- Make the CAN side of the plugin.
-- tree         a tree builder (show.tree)
-- reader       a message.reader: what a finished message means
-- buses        a host.buses
-- register_id  function(id): frames of this message ID are YAPP's
function M.new(tree, reader, buses, register_id)
  return setmetatable({
    tree = tree,
    reader = reader,
    buses = buses,
    register_id = register_id,
    stat = reader.stat,
    title = tree.yapp.description .. ", ", -- how YAPP's item begins
  }, Dissector)
end

-- Make the table of the sources on a bus.
local function new_bus(sources, bus)
  sources[bus] = {}
  return sources[bus]
end

--- Forget the capture file.
-- history  a message.history
function Dissector:reset(history)
  self.history = history
  self.reassembly = reassembly.new()
  self.sources = setmetatable({}, { __index = new_bus }) -- [bus or false][ID] = a source
  self.deltas = {} -- [frame key of a single frame] = seconds, or FIRST; nil: not known
  self.newest_key = 0 -- a frame above it is new, which saves asking Wireshark
  self.lost_bus = false -- whether the bus of any frame was not known
  self.offset = self.buses.found.offset -- of the bytes of all frames in their packets, or nil
  self.asks = self.buses.asks -- whether the bus of a frame has to be asked for
  -- The frame of now, used again for the next one: a tenth of a packet list.
  -- COMPAT 5.2: where there is nothing, false: to write nil under a name that has none makes the
  -- table anew.
  self.frame = {
    key = 0, -- see base.frame_key
    can_id = false, -- the fields of its CAN id (wire.can_id)
    bus = false, source = false, slot = 0, -- number or false; of message.reader; wire.can_id.slot
    data = "", reported = 0, -- captured bytes; length on the bus
    accepts_all = false, -- whether the user says that every extended frame is YAPP
    is_only_pass = false, -- whether it is never dissected again
    number = 0, visited = false, is_bus_known = true, -- of its packet; whether its bus is known
    message = false, anomalies = false, index = 0, -- as can.reassembly says
    tvb = false, pinfo = false, tree = false, range = false, -- of Wireshark
  }
end

-- The record of a frame for the statistics.  If the frame ends a message, it is for
-- message.reader, too, and the arguments behind wants are given.
local function new_record(self, frame, wants, item, status, payload, size)
  local fields, source, delta = frame.can_id, frame.source, false
  local is_unreliable = not frame.is_bus_known
  if frame.visited then
    delta = frame.message and frame.message.delta or self.deltas[frame.key] or false
    is_unreliable = not delta
    if delta == FIRST then delta = false end
  end
  return {
    id = fields.id,
    seq = fields.seq,
    name = source.name,
    source = source.key,
    bus = source.bus,
    bus_name = source.bus_name,
    number = frame.key,
    frame = frame.number,
    time = frame.pinfo.rel_ts,
    visited = frame.visited,
    is_end = fields.ctrl == END,
    is_unreliable = is_unreliable,
    delta = delta,
    payload = payload,
    size = size,
    status = status,
    good = status == "good",
    is_whole = status ~= "short" and status ~= "overrun",
    wants = wants,
    tree = frame.tree,
    item = item,
    tvb = false,
    at = 0,
    -- Of the reader:
    message = nil, raws = nil, is_remarkable = nil, has_fault = nil, change = nil, state = nil,
    undecoded = nil,
  }
end

local function show_anomalies(self, frame, item)
  if #frame.data < frame.reported then
    local text = "The capture has %d of the frame's %d bytes"
    self.tree:expert(item, "truncated", text:format(#frame.data, frame.reported))
  end
  if not frame.anomalies then return end
  for _, one in ipairs(frame.anomalies) do self.tree:expert(item, one.expert, one.text) end
  if self.stat.wanted then self.reader.stat:faults(new_record(self, frame), frame.anomalies) end
end

-- YAPP's own item ---------------------------------------------------------------------------------

-- Add it with what the CAN id says, all of that generated.
local function add_item(self, frame)
  local builder, address, source = self.tree, frame.can_id, frame.source
  local kind = KINDS[address.ctrl] or "undefined frame"
  frame.range = frame.tvb()
  local item = add(frame.tree, builder.yapp, frame.range, self.title .. source.name .. ", " .. kind)
  builder:add_id(item, nil, address.id, source.bus_name)
  builder:generated(item, "ctl", address.ctl)
  builder:generated(item, "seq", address.seq)
  builder:generated(item, "can.ctrl", address.ctrl)
  builder:add_source(item, source)
  return item
end

-- What the bytes of a fragment are: in a Start the fields that were captured.
local function add_fragment(self, frame, item)
  local fields, length = self.tree.fields, #frame.data
  if frame.can_id.ctrl ~= START then
    if length > 0 then add(item, fields["fragment.data"], frame.range) end
    return
  end
  if length >= 4 then add_le(item, fields.crc, frame.tvb(0, 4)) end
  if length >= 6 then append_text(add_le(item, fields.size, frame.tvb(4, 2)), " bytes") end
  if length >= 8 then add_le(item, fields.reserved, frame.tvb(6, 2)) end
  if frame.message then append_text(item, (" of %d bytes"):format(frame.message.size)) end
end

-- The numbers of the packets of a message, without those that a read filter dropped.
local function numbers_of(message)
  local numbers = {}
  for _, key in ipairs(message) do
    if key % 1 == 0 then numbers[#numbers + 1] = number_of(key) end
  end
  return numbers
end

-- What is reassembled in a message's last frame.
local function add_message(self, frame, item, tvb)
  local builder, message, data = self.tree, frame.message, frame.data
  local payload, padding = tvb and tvb(), message.padding or 0
  builder:generated(item, "reassembled.in", frame.number)
  append_text(builder:generated(item, "size", message.size), " bytes")
  builder:generated(item, "reserved", message.reserved or 0)
  builder:add_crc(item, nil, message)
  builder:add_fragments(item, payload or frame.range, numbers_of(message), #message,
    #message.payload, payload)
  if padding > 0 and padding <= #data then
    add(item, builder.fields.padding, frame.tvb(#data - padding))
  end
  append_text(item, CRC_TEXT[message.status] or ", CRC unverified")
end

-- Messages ----------------------------------------------------------------------------------------

-- Reads the message of a record, and keeps what the history says.
local function read(self, frame, m)
  self.reader:read(m, self.history)
  if frame.visited or frame.is_only_pass then return end
  -- Of a source that two controllers share the history says so itself, on a revisit, too.
  local delta = frame.is_bus_known and (m.delta or FIRST)
  if frame.message then
    self.reassembly:keep(frame.message, delta, m.has_fault)
  elseif delta then
    self.deltas[frame.key] = delta
  end
end

local function show_single(self, frame, wants, item)
  local data, reported, source = frame.data, frame.reported, frame.source
  local most = source.size
  local least = source.min_size or most
  local size = most and can_id.single_size(data, reported, least, most) or reported
  local m = new_record(self, frame, wants, item, "single", data:sub(1, size), size)
  m.good = #data == reported
  if wants.tree then m.tvb = frame.tvb end
  read(self, frame, m)
  local info = self.tree:payload(m)
  if wants.yapp and #data > size then
    add(item, self.tree.fields.padding, frame.tvb(size))
  end
  return info
end

-- The last frame of a message: what was reassembled.
local function show_last(self, frame, wants, item)
  local builder, message = self.tree, frame.message
  local status, payload = message.status, message.payload
  local m = new_record(self, frame, wants, item, status, payload, message.size)
  if wants.tree and payload ~= "" then
    m.tvb = ByteArray.new(payload, true):tvb(REASSEMBLED)
  end
  if wants.yapp then add_message(self, frame, item, m.tvb) end
  if status == "bad" then builder:bad_crc(item, message) end
  read(self, frame, m)
  if m.is_whole then
    local info = builder:payload(m)
    return m.good and info or info .. STATUS_TEXT[status]
  end
  if wants.yapp then
    if m.tvb then add(item, builder.fields.payload, m.tvb()) end
    builder:add_delta(item, m)
  end
  local text = "%s  %d of %d bytes%s"
  return text:format(m.name, message.received, message.size, STATUS_TEXT[status])
end

-- Fragments ---------------------------------------------------------------------------------------

-- Return the text of a fragment.  How many fragments a message has is sure once it is good; before
-- that, it is what classic CAN needs.  A source keeps the texts for messages of one size.
local function fragment_text(frame)
  local source, message, index = frame.source, frame.message, frame.index
  local name, size, texts = source.name, message.size, source.texts
  if message[index] ~= frame.key then return name .. "  duplicate fragment" end
  if texts.size ~= size then
    texts = { name .. ("  Start of %d bytes"):format(size) }
    texts.size, texts.usual = size, math.ceil(size / 8) + 1
    source.texts = texts
  end
  local usual = texts.usual
  local count = #frame.data == 8 and usual or 0
  if message.status == "good" then count = #message end
  if index == 1 or count == usual and texts[index] then return texts[index] end
  if index > count then return ("%s  fragment %d"):format(name, index) end
  local text = ("%s  fragment %d of %d"):format(name, index, count)
  if count == usual then texts[index] = text end
  return text
end

local function show_fragment(self, frame, wants, item)
  local builder, message, in_number = self.tree, frame.message, nil
  local last = message[#message]
  if frame.visited then
    if message.payload then
      in_number = last % 1 == 0 and number_of(last)
    elseif not message.status and last == frame.key then
      builder:expert(item, "unfinished")
    end
  end
  if wants.yapp then
    add_fragment(self, frame, item)
    builder:generated(item, "reassembled.in", in_number)
    builder:generated(item, "message.fault", message.has_fault)
  end
  if self.stat.wants_parts then self.reader.stat:part(new_record(self, frame)) end
  if not wants.columns then return end
  local text = fragment_text(frame)
  return in_number and ("%s  [Reassembled in #%d]"):format(text, in_number) or text
end

-- A frame that belongs to no message.
local function show_other(self, frame, wants, item)
  local ctrl, name = frame.can_id.ctrl, frame.source.name
  if wants.yapp then add_fragment(self, frame, item) end
  if not KINDS[ctrl] then return ("%s  CAN CTRL %d"):format(name, ctrl) end
  local text = ("%s  %s"):format(name, KINDS[ctrl])
  return ctrl ~= START and text .. " without a Start" or text
end

local SHOW = { -- by kind, see can.reassembly
  single = show_single, last = show_last, fragment = show_fragment, other = show_other,
}

-- Frames ------------------------------------------------------------------------------------------

-- Shows a frame of ours.
local function show(self, frame, kind)
  local builder, pinfo, item, visited = self.tree, frame.pinfo, frame.tree, frame.visited
  local wants = not visited and builder.wanted or builder:wants(item, pinfo, visited)
  frame.is_only_pass = wants.is_only_pass -- and those that follow
  if wants.yapp then
    item = add_item(self, frame)
  elseif wants.names then
    builder:bare(item, wants, kind == "last" or kind == "single")
  end
  local info = SHOW[kind](self, frame, wants, item)
  if frame.anomalies or #frame.data < frame.reported then show_anomalies(self, frame, item) end
  if not wants.columns then return end
  local columns = pinfo.cols
  columns.protocol = "YAPP"
  columns.src = frame.source.text
  columns.info = info
end

-- Return the source of a message ID on a bus, the first time that it is asked for.
-- bus  number or false
local function new_source(self, id, bus)
  local key = (bus or -1) * 0x800 + id
  local source = self.reader:new_source(key, id, bus, self.buses:name(bus))
  self.sources[bus][id] = source
  return source
end

-- Say what a frame is that Wireshark dissects for the first time.
-- returns  its kind, see can.reassembly; nil for a frame that is not YAPP's
local function take(self, frame)
  local kind, message, anomalies = self.reassembly:take(frame)
  frame.message, frame.anomalies, frame.index = message, anomalies, message and #message
  if kind and frame.can_id.ctrl == START then self.register_id(frame.can_id.id) end
  if not frame.is_bus_known then self.lost_bus = true end
  return kind
end

-- Say what a visited frame is.
-- returns  as take
local function recall(self, frame)
  local kind, message, anomalies, index = self.reassembly:recall(frame)
  if message then frame.source = message.source end
  frame.message, frame.anomalies, frame.index = message, anomalies, index
  return not (kind == "single" and is_remote(frame)) and kind
end

local function find_bus(self, frame, pinfo, number)
  local bus, is_known = self.buses:of(pinfo, number)
  frame.bus, frame.is_bus_known = bus or false, is_known
end

-- Return whether Wireshark dissects a frame again whose key is not new.  If not, a read filter (-R)
-- dropped the packet before, and its number comes twice.
local function is_revisit(self, pinfo, key)
  local visited = pinfo.visited
  if not visited then self.reassembly:drop(key) end
  return visited
end

-- Return the record of a frame, which is used again for the next frame.
-- reported  its length on the bus
local function new_frame(self, tvb, reported, pinfo, tree, id, accepts_all)
  local frame, number = self.frame, pinfo.number
  if self.asks then find_bus(self, frame, pinfo, number) end
  local fields, bus = fields_of[id], frame.bus
  local key = number * PACKET + (self.offset or offset_of(tvb))
  local visited = key <= self.newest_key and is_revisit(self, pinfo, key)
  if not visited then self.newest_key = key end
  frame.key = key
  frame.number = number
  frame.visited = visited
  frame.can_id = fields
  frame.source = self.sources[bus][fields.id] or new_source(self, fields.id, bus)
  frame.slot = slot_of(fields, bus)
  -- raw() of nothing would throw past Lua, to Wireshark: what no Lua can catch.
  frame.data = length_of(tvb) > 0 and raw_of(tvb) or ""
  frame.reported = reported
  frame.accepts_all = accepts_all
  frame.tvb = tvb
  frame.pinfo = pinfo
  frame.tree = tree
  return frame
end

--- Dissect one frame.
-- id           29-bit CAN id
-- accepts_all  whether the user says that every extended frame is YAPP
-- returns      the number of bytes that are ours, 0 for a frame that is not
function Dissector:dissect(tvb, pinfo, tree, id, accepts_all)
  local reported, kind = reported_of(tvb), nil
  if reported == 0 then return 0 end
  local frame = new_frame(self, tvb, reported, pinfo, tree, id, accepts_all)
  if frame.visited then
    kind = recall(self, frame)
  elseif not is_remote(frame) then
    kind = take(self, frame)
  end
  if not kind then return 0 end
  show(self, frame, kind)
  return reported
end

--- Show a frame that is YAPP's by the user's word, but whose CAN id nothing says, as bytes: the
-- first frame of Decode As, on a pass that builds no tree.
function Dissector:without_id(tvb, pinfo, tree)
  local builder, item = self.tree, tree
  if builder:wants(tree, pinfo, true).yapp then
    item = add(tree, builder.yapp, tvb())
    if tvb:len() > 0 then add(item, builder.fields.payload, tvb()) end
  end
  pinfo.cols.protocol = "YAPP"
  builder:expert(item, "can.id.missing")
  return tvb:reported_len()
end

--- Report to the statistics what may be a Start that nothing dissects: it has the bytes of one.
-- find_id  function(pinfo) -> 29-bit CAN id, or nil
function Dissector:report_start(tvb, pinfo, find_id)
  if length_of(tvb) ~= 8 then return end
  local _, size, reserved = can_id.start(raw_of(tvb))
  local id = reserved == 0 and size > 8 and find_id(pinfo)
  local fields = id and fields_of[id]
  if not fields or fields.ctrl ~= START or fields.ctl ~= 0 then return end
  local frame = new_frame(self, tvb, 8, pinfo, nil, id, false)
  self.reader.stat:start(new_record(self, frame, nil, nil, nil, nil, size))
end

--- Return the messages that the capture ends before.
-- returns  list of { source, seq, frame = number of their last packet }
function Dissector:unfinished()
  local list = {}
  for _, message in ipairs(self.reassembly:unfinished()) do
    -- It may have gone on behind a frame from which on the buses were not known.
    if not (self.lost_bus and message.source.bus) then
      list[#list + 1] = {
        source = message.source.key,
        seq = message.slot % 0x100,
        frame = number_of(message[#message]),
      }
    end
  end
  return list
end

return M
