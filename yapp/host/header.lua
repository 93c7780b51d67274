-- SPDX-License-Identifier: GPL-2.0-or-later
-- The headers of CAN frames: SocketCAN hands on their data alone.  Wireshark's API.
--
-- SocketCAN finds our messages in its table of ids, where pinfo.match_uint is the id.  Of all other
-- frames a wrapper in front of SocketCAN reads the header.  It begins only with Decode As,
-- yapp.all_extended or a statistic.  It costs about 3 µs a CAN frame, so in tshark's only pass, if
-- nothing is shown, it ends: then a frame whose header is needed waits until a tap, which sees the
-- whole packet, reads it.
--
--   no dissector accepts it ──► the tap counts it, and reports a possible message
--   its id is not known, or ──► the tap dissects it, unless it is no data frame
--   whether it is remote

local can_id = require "yapp.wire.can_id"
local fields_of = require "yapp.capture.fields"
local frame_key = require "yapp.base.frame_key"
local records = require "yapp.reading.records"
local wrapper = require "yapp.host.wrapper"

local M = {}

local EXTENDED, MASK = 0x80000000, 0x20000000
local HEADER = 8 -- bytes that have the id
local NAMES = { ["can.id"] = true, ["can.flags.xtd"] = true, ["can.flags.rtr"] = true }
-- Where CAN frames come from: table, and value in it.
local ORIGINS = { { "wtap_encap", wtap.SOCKETCAN }, { "sll.ltype", 0x0C }, { "sll.ltype", 0x0D } }

local Headers = {}
Headers.__index = Headers

local function is_true(value) return value == true or value == 1 end

-- Return the 29-bit id of the first word of a SocketCAN record, nil for no extended data frame.
-- Above the id it has three bits: extended, remote, error.
local function data_id(word)
  return word >= EXTENDED and word < EXTENDED + MASK and word % MASK or nil
end

--- Make the reader of headers.
-- proto  Proto for the wrapper
function M.new(proto)
  local self = setmetatable({
    number = false, -- of the packet whose header was read last
    id = nil, -- that the header has: 29 bits; nil if it is of no extended data frame
    dissect = false, -- see Headers:use
    report = false,
    is_open = false, -- true while a statistic runs
    defers = false, -- true if frames wait to be dissected
    waiting = false, -- the frame that waits for a tap, see Headers:remember
    can = 0, -- headers that a tap has read
    extended = 0, -- those of extended data frames
  }, Headers)
  self.wrapper = wrapper.new(proto, ORIGINS, function(tvb, pinfo, value)
    -- In its own encapsulation a preference says that a little endian machine wrote the records; in
    -- cooked captures the id is in the host's order, little endian on every machine of today.
    local is_little = value ~= wtap.SOCKETCAN or get_preference("can.byte_swap")
    local word = tvb:len() >= HEADER and tvb(0, 4)
    self.number = pinfo.number
    self.id = word and data_id(is_little and word:le_uint() or word:uint()) or nil
  end)
  return self
end

--- Forget the capture file.
function Headers:reset()
  self.number, self.defers, self.waiting = false, false, false
end

--- Read the header of every frame from now on.
function Headers:start()
  self.wrapper:start()
end

--- Read no more headers.
function Headers:stop()
  self.wrapper:stop()
end

--- Return the id of the current frame, which came by Decode As or by the heuristics.
-- returns  29-bit id; nil if it is no extended data frame; nil and true if nothing tells
function Headers:find_id(pinfo)
  if self.number == pinfo.number then return self.id end
  local fields = fields_of(NAMES)
  local id, extended = fields["can.id"], fields["can.flags.xtd"]
  if id ~= nil and extended ~= nil then return is_true(extended) and id % MASK or nil end
  -- "Ext. ID: 138428416 (0x8404000), Length: 8", as SocketCAN leaves it in the Info column.
  local text = tostring(pinfo.cols.info)
  if not text:find("ID: ", 1, true) then return nil, true end
  return tonumber(text:match("Ext%. ID: (%d+)"))
end

--- Return whether a header or a field says that a frame of zeros is a remote frame: remote frames
-- have no data, but captures give them zeros.  Return nil if nothing says it.
function Headers:is_remote(pinfo)
  if self.number == pinfo.number then return self.id == nil end
  local remote = fields_of(NAMES)["can.flags.rtr"]
  if remote ~= nil then return is_true(remote) end
end

-- Frames that wait for a tap ----------------------------------------------------------------------

--- Use these with the frames that waited.
-- dissect  function(tvb, pinfo, tree, id, accepts_all, length), of host.can
-- report   function(frame, pinfo), called with a frame that no dissector accepted
function Headers:use(dissect, report)
  self.dissect, self.report = dissect, report
end

--- Begin to remember frames, and count anew: a statistic begins, and its tap of all packets calls
-- Headers:on_packet.
function Headers:open()
  self.is_open, self.can, self.extended = true, 0, 0
end

--- Remember no more frames.
function Headers:close()
  self.is_open, self.waiting, self.defers = false, false, false
end

--- Let a tap read the headers that are needed, in tshark's only pass.
-- wants  of Wants:ask: a frame that is shown cannot wait, because a tap has no tree
function Headers:use_taps(wants)
  self.defers = not (wants.tree or wants.columns)
  if self.defers then self:stop() end
end

-- Return whether the data of a CAN frame may be that of a SocketCAN record, which fills its packet
-- to the end.  In other protocols, several CAN frames may lie in a packet.
local function is_record(tvb, pinfo)
  local rest = pinfo.len - tvb:offset() -- nothing where a remote frame has its header alone
  return rest >= 0 and rest <= 8 or rest == 64 or rest == tvb:reported_len()
end

--- Remember a frame until a tap of its packet has read its header.
-- is_ours      true if the tap has to dissect it, nil if no dissector has accepted it yet
-- id           29-bit CAN id, nil if it is not known
-- accepts_all  true if the user says that every extended frame is YAPP
-- returns      true if it waits
function Headers:remember(tvb, pinfo, is_ours, id, accepts_all)
  local may_wait = self.is_open and (self.defers or not id) -- without an id nothing else reads it
  if not (may_wait and is_record(tvb, pinfo)) then return false end
  self.waiting = {
    number = pinfo.number,
    offset = tvb:offset(), -- of its data in the packet
    captured = tvb:len(),
    length = tvb:reported_len(), -- on the bus
    is_ours = is_ours,
    id = id,
    accepts_all = accepts_all,
  }
  return true
end

--- Forget the frame that the table of ids refused: Decode As accepts it.
function Headers:forget()
  if self.waiting and not self.waiting.is_ours then self.waiting = false end
end

-- Return the id that the header in front of a record's data has: nil if it is no extended data
-- frame, the known one if this is no header.
-- tvb  of the whole packet
local function id_before(frame, tvb)
  local offset, known_id = frame.offset, frame.id
  local has_room = offset >= HEADER and offset <= tvb:len()
  if not has_room or tvb(offset - 4, 1):uint() ~= frame.length then return known_id end
  local start = tvb(offset - HEADER, 4)
  -- Big endian is SocketCAN's own encapsulation; little endian cooked captures.
  local is_big = offset == HEADER and not get_preference("can.byte_swap")
  local word = is_big and start:uint() or start:le_uint()
  if known_id and word % MASK ~= known_id then return known_id end
  return data_id(word)
end

-- Return the record of a frame that no dissector accepted.
local function new_frame(frame, id, tvb, pinfo)
  local record = records.new_can_frame()
  record.number = frame.number
  record.key = frame.number * frame_key.PACKET + frame.offset
  record.time = pinfo.rel_ts
  record.can_id = can_id.fields[id]
  record.seq = record.can_id.seq
  record.data, record.reported = tvb:raw(frame.offset, frame.captured), frame.length
  return record
end

--- Go on with the frame that waits, if it is of this packet.  A tap of all packets calls this while
-- `waiting` is set.
-- tvb  of the packet
function Headers:on_packet(pinfo, tvb)
  local frame = self.waiting
  self.waiting = false
  if frame.number ~= pinfo.number then return end
  local id = id_before(frame, tvb)
  self.number, self.id = frame.number, id
  self.can = self.can + 1
  if not id then return end
  self.extended = self.extended + 1
  if frame.is_ours then
    local data = tvb(frame.offset, frame.captured):tvb()
    self.dissect(data, pinfo, nil, id, frame.accepts_all, frame.length)
  elseif frame.captured > 0 then
    self.report(new_frame(frame, id, tvb, pinfo), pinfo)
  end
end

return M
