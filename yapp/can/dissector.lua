-- SPDX-License-Identifier: GPL-2.0-or-later
-- The dissector of YAPP on CAN: shows what a frame is.  Wireshark's API.

local can_id = require "yapp.wire.can_id"
local decode = require "yapp.message.decode"
local frame_key = require "yapp.base.frame_key"
local memo = require "yapp.base.memo"
local reassembly = require "yapp.can.reassembly"
local show_fields = require "yapp.show.fields"
local socketcan = require "yapp.host.socketcan"

local M = {}

local CTRL_NAMES, START = can_id.CTRL_NAMES, can_id.START
local add, add_le, append_text = show_fields.add, show_fields.add_le, show_fields.append_text
local fields_of, BUS = can_id.fields, can_id.BUS
local number_of = frame_key.number
local sub = string.sub
-- A method that Lua has to look up in a Tvb costs more than what it does.
local length_of, raw_of, reported_of, offset_of = Tvb.len, Tvb.raw, Tvb.reported_len, Tvb.offset

-- YAPP has no remote frames, but captures give a remote frame zeros as data.  So ask of a frame of
-- zeros whether it is remote; if nothing says so, it is a data frame.
local ZEROS = {}
for length = 0, 8 do ZEROS[("\0"):rep(length)] = true end

local Dissector = {}
Dissector.__index = Dissector

--- Make the CAN side of the plugin.
-- builder      a show.tree
-- reader       a message.reader: what a finished message means
-- buses        a host.buses
-- register_id  function(id), which makes Wireshark call YAPP for frames of this message ID
-- note_frame   function(tvb, pinfo) -> whether a tap of the packet will call Dissector:read_noted
function M.new(builder, reader, buses, register_id, note_frame)
  return setmetatable({
    builder = builder,
    reader = reader,
    buses = buses,
    register_id = register_id,
    note_frame = note_frame,
    waiting = false, -- the frame that waits for a tap, see put_off
    intake = reader.intake,
  }, Dissector)
end

--- Forget the capture file.
-- history  a message.history
function Dissector:reset(history)
  self.history = history
  self.reassembly = reassembly.new()
  self.sources = memo(function(bus) -- [bus or false][ID] = a source
    return memo(function(id) return self.reader:new_source(id, bus, self.buses:name(bus)) end)
  end)
  self.newest_key = 0 -- a frame above it is new, which saves asking Wireshark
  -- Of the latest frame of ours.  A tap reports only frames that were not accepted, but Decode As
  -- may accept a frame that was noted when the table of ids refused it.
  self.accepted_key = 0
  self.expects_taps, self.has_taps = false, false -- see Dissector:expect_taps
  self.lost_bus = false -- whether a frame came whose bus is not known
  self.offset = self.buses.found.offset -- of the bytes of all frames in their packets, or nil
  self.asks = self.buses.asks -- whether the bus of a frame has to be asked for
  -- The current frame, see new_frame.  The next frame reuses the table, which saves a tenth of a
  -- packet list.
  self.frame = {
    bus = false, -- its number, or false
    is_bus_known = true,
    is_only_pass = false, -- whether it is never dissected again
    payload_offset = 0, -- see Tree:show_message
  }
end

-- Return the message that a frame ends, for message.reader.  For the statistics make one of any
-- frame, where status, payload and size may be missing.
local function new_message(frame, status, payload, size)
  return {
    source = frame.source,
    seq = frame.can_id.seq,
    key = frame.key,
    time = frame.pinfo.rel_ts,
    visited = frame.visited,
    is_unreliable = not (frame.visited or frame.is_bus_known),
    payload = payload,
    size = size,
    status = status,
  }
end

local function show_anomalies(self, frame)
  local item, anomalies = frame.item, frame.anomalies
  if #frame.data < frame.reported then
    local text = "The capture has %d of the frame's %d bytes"
    self.builder:expert(item, "truncated", text:format(#frame.data, frame.reported))
  end
  if not anomalies then return end
  for _, one in ipairs(anomalies) do self.builder:expert(item, one.expert, one.text) end
  if self.intake.wanted then
    self.intake:anomalies(new_message(frame), anomalies, frame.can_id.ctrl == can_id.END)
  end
end

-- YAPP's own item ---------------------------------------------------------------------------------

-- Add YAPP's own item, with the fields of the CAN id as generated items.
local function add_item(self, frame)
  local builder, fields, source = self.builder, frame.can_id, frame.source
  local kind = CTRL_NAMES[fields.ctrl] or "undefined frame"
  frame.range = frame.tvb()
  local item = add(frame.tree, builder.yapp, frame.range)
  append_text(item, (", %s, %s"):format(source.label, kind))
  builder:add_id(item, nil, source)
  builder:generated(item, "ctl", fields.ctl)
  builder:generated(item, "seq", fields.seq)
  builder:generated(item, "can.ctrl", fields.ctrl)
  builder:add_source(item, source)
  return item
end

-- Add what the bytes of a fragment are.  A truncated Start has only the fields that were captured.
local function add_fragment(self, frame)
  local fields, length, item = self.builder.fields, #frame.data, frame.item
  if frame.can_id.ctrl ~= START then
    if length > 0 then add(item, fields["fragment.data"], frame.range) end
    return
  end
  if length >= 4 then add_le(item, fields.crc, frame.tvb(0, 4)) end
  if length >= 6 then append_text(add_le(item, fields.size, frame.tvb(4, 2)), " bytes") end
  if length >= 8 then add_le(item, fields.reserved, frame.tvb(6, 2)) end
  if frame.message then append_text(item, (" of %d bytes"):format(frame.message.size)) end
end

-- Add what a message's last or only frame completes: size, CRC, fragments and padding.
local function add_message(self, frame)
  local builder, message, data, item = self.builder, frame.message, frame.data, frame.item
  if #message > 1 then
    local payload = frame.payload_tvb and frame.payload_tvb()
    builder:generated(item, "reassembled.in", number_of(frame.key))
    append_text(builder:generated(item, "size", message.size), " bytes")
    builder:generated(item, "reserved", message.reserved or 0)
    message.crc = message.crc or can_id.crc(frame.can_id, message.payload)
    builder:add_crc(item, nil, message)
    builder:add_fragments(item, payload or frame.range, message, #message.payload, payload)
  end
  local start = frame.reported - (message.padding or 0)
  if start < #data then add(item, builder.fields.padding, frame.tvb(start)) end
end

-- Messages ----------------------------------------------------------------------------------------

-- Return a Tvb with the payload of a message, false for none.
local function payload_tvb_of(frame)
  local message = frame.message
  if #message == 1 then return frame.tvb end
  return message.payload ~= "" and ByteArray.new(message.payload, true):tvb("Reassembled YAPP")
end

-- Show the frame that has a whole message, or its last fragment, and the message.
local function show_last(self, frame)
  local builder, message, wants, item = self.builder, frame.message, frame.wants, frame.item
  local status = message.status
  local m = new_message(frame, status, message.payload, message.size)
  local tvb = wants.tree and payload_tvb_of(frame)
  frame.payload_tvb = tvb
  if wants.yapp then add_message(self, frame) end
  if status == "bad" then builder:bad_crc(item, message) end
  local mark = #message > 1 and builder.MARKS[status] or ""
  local has_offsets = self.reader:read(m, self.history, wants)
  if #message > 1 and not (frame.visited or frame.is_only_pass) then
    self.reassembly:keep(message, m.has_fault)
  end
  if has_offsets then return builder:show_message(m, frame) .. mark end
  if wants.yapp then
    if tvb then add(item, builder.fields.payload, tvb()) end
    builder:add_delta(item, m)
  end
  local text = "%s  %d of %d bytes%s"
  return text:format(m.source.label, message.received, message.size, mark)
end

-- Fragments ---------------------------------------------------------------------------------------

-- Return the text of a fragment.  A good message has a known number of fragments; for another one
-- assume the number that classic CAN needs.  The source caches the texts for messages of one size
-- and number of fragments.
local function fragment_text(frame)
  local source, message = frame.source, frame.message
  local index, size, count = frame.index or #message, message.size, 0
  if message.status == "good" then
    count = #message
  elseif #frame.data == 8 then
    count = math.ceil(size / 8) + 1
  end
  if message[index] ~= frame.key then return source.label .. "  duplicate fragment" end
  local texts = source.texts
  if texts.size ~= size or texts.count ~= count then
    texts = { ("%s  Start of %d bytes"):format(source.label, size), size = size, count = count }
    source.texts = texts
  end
  if not texts[index] then
    local text = index > count and "%s  fragment %d" or "%s  fragment %d of %d"
    texts[index] = text:format(source.label, index, count)
  end
  return texts[index]
end

local function show_fragment(self, frame)
  local builder, message, item, in_number = self.builder, frame.message, frame.item, nil
  local last, wants = message[#message], frame.wants
  if frame.visited then
    if message.payload then
      in_number = last % 1 == 0 and number_of(last)
    elseif not message.status and last == frame.key then
      builder:expert(item, "unfinished")
    end
  end
  if wants.yapp then
    add_fragment(self, frame)
    builder:generated(item, "reassembled.in", in_number)
    builder:generated(item, "message.fault", message.has_fault)
  end
  if self.intake.wants_fragments then self.intake:fragment(new_message(frame)) end
  if not wants.columns then return end
  local text = fragment_text(frame)
  return in_number and ("%s  [Reassembled in #%d]"):format(text, in_number) or text
end

-- A frame that belongs to no message.
local function show_other(self, frame)
  local ctrl, name = frame.can_id.ctrl, frame.source.label
  if frame.wants.yapp then add_fragment(self, frame) end
  if not CTRL_NAMES[ctrl] then return ("%s  CAN CTRL %d"):format(name, ctrl) end
  local text = ("%s  %s"):format(name, CTRL_NAMES[ctrl])
  return ctrl ~= START and text .. " without a Start" or text
end

local SHOW = { -- by kind, see can.reassembly: what returns the text of the Info column
  single = show_last, last = show_last, fragment = show_fragment, other = show_other,
}

-- Frames ------------------------------------------------------------------------------------------

-- Show a frame of ours.
-- kind ...  of can.reassembly
local function show(self, frame, kind, message, anomalies, index)
  if frame.can_id.ctrl == START then self.register_id(frame.source.id) end
  frame.message, frame.anomalies, frame.index = message or false, anomalies, index or false
  self.accepted_key = frame.key
  local builder, pinfo, tree = self.builder, frame.pinfo, frame.tree
  local wants = not frame.visited and builder.wanted or builder:wants(tree, pinfo, frame.visited)
  frame.wants, frame.item = wants, tree
  frame.is_only_pass = wants.is_only_pass -- the record serves the next frames, too
  if wants.yapp then
    frame.item = add_item(self, frame)
  elseif wants.names then
    builder:add_protocol_names(tree, wants, kind == "last" or kind == "single")
  end
  local info = SHOW[kind](self, frame)
  if frame.anomalies or #frame.data < frame.reported then show_anomalies(self, frame) end
  if not wants.columns then return end
  local columns = pinfo.cols
  columns.protocol = "YAPP"
  columns.src = frame.source.text
  columns.info = info
end

-- Return the record of a frame, which is used again for the next frame: {
--   key            see base.frame_key
--   visited        whether it is a revisit
--   can_id         the fields of its CAN id (wire.can_id)
--   bus            its number, or false; is_bus_known
--   source, slot   see message.reader and can_id.slot
--   data           the captured bytes; reported = their number on the bus
--   accepts_all    whether the user says that every extended frame is YAPP
--   is_only_pass   whether it is never dissected again
--   message, anomalies, index  as can.reassembly says
--   tvb, pinfo, tree, range    of Wireshark
--   wants, item, payload_tvb, payload_offset  see Tree:show_message }
local function new_frame(self, tvb, reported, pinfo, tree, id, accepts_all)
  local frame, number, offset = self.frame, pinfo.number, self.offset or offset_of(tvb)
  if self.asks then
    local bus, is_bus_known = self.buses:of(pinfo, number, offset)
    frame.bus, frame.is_bus_known = bus or false, is_bus_known
    self.lost_bus = self.lost_bus or not is_bus_known
  end
  local fields, bus = fields_of[id], frame.bus
  local key = number * frame_key.PACKET + offset
  local visited = false
  if key > self.newest_key then
    self.newest_key = key
  else
    visited = pinfo.visited
    -- Else a read filter (-R) dropped the packet before, and this one has its number.
    if not visited then self.reassembly:forget(key) end
  end
  frame.key = key
  frame.visited = visited
  frame.can_id = fields
  frame.source = self.sources[bus][fields.id]
  frame.slot = fields.message_key + (bus or 0) * BUS
  -- raw() of an empty Tvb would throw past Lua: not even pcall catches that.
  frame.data = length_of(tvb) > 0 and raw_of(tvb) or ""
  frame.reported = reported
  frame.accepts_all = accepts_all
  frame.tvb = tvb
  frame.pinfo = pinfo
  frame.tree = tree
  return frame
end

--- Say that a tap sees every packet, in tshark's only pass.  If nothing is shown, frames can wait
-- for it, and no other headers need be read.
function Dissector:expect_taps()
  self.expects_taps = true
end

--- Decide whether frames wait for a tap, once it is known whether anything is shown.
-- wants  of Tree:wants, nil if it is not known yet
function Dissector:decide_on_taps(wants)
  if not (self.expects_taps and wants) then return end
  self.expects_taps = false
  if wants.tree or wants.columns then return end
  self.has_taps = true
  socketcan.unwrap()
end

--- Return whether a later packet was dissected before this one, as in the second pass of two.
function Dissector:is_second_pass(number)
  return number_of(self.newest_key) > number
end

-- If nothing tells yet the id of a frame, or whether it is a data frame, put it off until a tap of
-- its packet has read its header.  Return whether there is such a tap.
-- id  nil if it is not known
local function put_off(self, tvb, pinfo, tree, id, accepts_all)
  if not (self.has_taps or self.expects_taps) then return false end
  self:decide_on_taps(self.builder:wants(tree, pinfo, false)) -- asked now: the tap has no tree
  if not (self.has_taps and self.note_frame(tvb, pinfo)) then return false end
  self.waiting = { id = id, accepts_all = accepts_all }
  self.newest_key = 0 -- to be dissected by the tap is no revisit
  return true
end

--- Dissect one frame.
-- id           29-bit CAN id
-- accepts_all  whether the user says that every extended frame is YAPP
-- reported     number of bytes on the bus; nil if the Tvb knows it
-- returns      the number of bytes that are ours, 0 for a frame that is not
function Dissector:dissect(tvb, pinfo, tree, id, accepts_all, reported)
  reported = reported or reported_of(tvb)
  if reported == 0 then return 0 end
  local frame = new_frame(self, tvb, reported, pinfo, tree, id, accepts_all)
  local may_be_remote, kind, message, anomalies, index = ZEROS[frame.data], nil, nil, nil, nil
  if frame.visited then
    kind, message, anomalies, index = self.reassembly:recall(frame)
    may_be_remote = may_be_remote and kind == "single"
    if message then frame.source = message.source end
  end
  if may_be_remote then
    local is_remote = socketcan.is_remote(pinfo)
    if is_remote then return 0 end
    if is_remote == nil and put_off(self, tvb, pinfo, tree, id, accepts_all) then
      return reported
    end
  end
  if not frame.visited then kind, message, anomalies = self.reassembly:take(frame) end
  if kind then
    show(self, frame, kind, message, anomalies, index)
    return reported
  end
  self.note_frame(tvb, pinfo)
  return 0
end

--- Show as bytes a frame that the user calls YAPP, but whose CAN id is not known.  That is the
-- first frame of Decode As, on a pass that builds no tree.
function Dissector:without_id(tvb, pinfo, tree)
  local builder, item = self.builder, tree
  if tvb:len() > 0 and put_off(self, tvb, pinfo, tree, nil, true) then
    return tvb:reported_len()
  end
  if builder:wants(tree, pinfo, true).yapp then
    item = add(tree, builder.yapp, tvb())
    if tvb:len() > 0 then add(item, builder.fields.payload, tvb()) end
  end
  pinfo.cols.protocol = "YAPP"
  builder:expert(item, "can.id.missing")
  return tvb:reported_len()
end

-- Return what a frame may be by its data, as { [CAN CTRL] = payload size of the message }: a Start,
-- or a message of the catalogue that fits into a single frame.
local function possible_sizes(self, data)
  local sizes, _, size, reserved = {}, can_id.start(data)
  if #data == 8 and reserved == 0 and size > 8 then sizes[START] = size end
  for _, message in ipairs(self.reader.messages) do
    size = can_id.single_size(data, #data, message.min_size, message.size)
    if size and decode.is_plausible(message, sub(data, 1, size)) then sizes[0] = size end
  end
  return sizes
end

-- Return the payload size that a frame has as a message that is not dissected; nil for none.
local function unknown_size(self, fields, source, data)
  local message, size = source.message, possible_sizes(self, data)[fields.ctrl]
  if fields.ctl ~= 0 then return message and size or nil end
  local is_longer = fields.ctrl == 0 and message and #data > message.size
  if is_longer and decode.is_plausible(message, sub(data, 1, message.size)) then return #data end
  return size
end

-- Report to the statistics a frame that is not dissected, if it may be a message or begin one:
--   of an unknown ID
--   of a known ID, with a YAPP CTL other than 0
--   of a known ID, with bytes behind its values
local function report_unknown(self, pinfo, id, offset, data)
  local fields, number = fields_of[id], pinfo.number
  local bus = self.asks and self.buses:of(pinfo, number, offset)
  local source = self.sources[bus or false][fields.id]
  local size = unknown_size(self, fields, source, data)
  if not size then return end
  self.intake:unknown {
    source = source,
    seq = fields.seq,
    key = number * frame_key.PACKET + offset,
    time = pinfo.rel_ts,
    size = size,
  }
end

--- Go on with the frame that was noted: dissect it if it was put off, else report it.
-- tvb       of its packet, in a tap
-- offset    of the frame's data; captured = length of it in the capture, length = on the bus
-- returns   whether it is an extended data frame
function Dissector:read_noted(tvb, pinfo, offset, captured, length)
  local waiting, is_accepted = self.waiting, number_of(self.accepted_key) == pinfo.number
  local id = socketcan.id_before(tvb, pinfo, offset, length, waiting and waiting.id)
  self.waiting = false
  if id and waiting then
    local data = tvb(offset, captured):tvb()
    self:dissect(data, pinfo, nil, id, waiting.accepts_all, length)
  elseif id and captured > 0 and not is_accepted then
    report_unknown(self, pinfo, id, offset, tvb:raw(offset, captured))
  end
  return id ~= nil
end

--- Return the messages that the capture ends before.
-- returns  list of { source, seq, key = frame key of their last frame }
function Dissector:unfinished()
  local list = {}
  for _, message in ipairs(self.reassembly:unfinished()) do
    -- Where buses are not known any more, a message of a known bus may have gone on unseen.
    if not (self.lost_bus and message.source.bus_key) then
      list[#list + 1] = {
        source = message.source,
        seq = message.slot % 0x100,
        key = message[#message],
      }
    end
  end
  return list
end

return M
