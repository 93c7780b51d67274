-- SPDX-License-Identifier: GPL-2.0-or-later
-- CAN frames whose header is needed.  A dissector sees only the data of a frame, a tap all of its
-- packet.  So while a statistic runs, a frame can wait until a tap of its packet has read its
-- header.  Wireshark's API.
--
-- A frame:
--   no dissector accepts it ──► REMEMBERED ──► the tap counts it, and reports a possible message
--   its id is not known, or ──► DEFERRED ────► the tap dissects it, unless it is no data frame
--   whether it is remote
--
-- Without a deferral, a wrapper in front of SocketCAN reads all headers (host.socketcan).  Frames
-- that are shown cannot be deferred, because a tap has no tree.  So:
--
--   none ──allow──► is_undecided ──decide: nothing is shown──► defers, and the wrapper ends
--    ▲                   │
--    └──── decide: a tree or columns are shown

local can_id = require "yapp.wire.can_id"
local frame_key = require "yapp.base.frame_key"
local records = require "yapp.reading.records"
local socketcan = require "yapp.host.socketcan"

local M = {}

local Deferral = {}
Deferral.__index = Deferral

--- Make the deferral of one plugin.
-- reading  a reading.reading
-- builder  a show.tree, which knows if anything is shown
-- buses    a capture.capture
-- dissect  function(tvb, pinfo, tree, id, accepts_all, length), of host.can
function M.new(reading, builder, buses, dissect)
  return setmetatable({
    reading = reading,
    builder = builder,
    buses = buses,
    dissect = dissect,
    on_remember = false, -- function() while a statistic runs, see Deferral:open
    is_undecided = false, -- true if frames may be deferred, see Deferral:decide
    defers = false, -- true if they are
    -- The frame that waits:
    number = false, -- of its packet, or false
    offset = 0, -- of its data in the packet
    captured = 0, -- captured bytes of it; length = number of bytes on the bus
    length = 0,
    deferred = false, -- { id = nil if it is not known, accepts_all }; or false
    -- Frames whose header a tap has read, since the statistic began:
    can = 0, -- all of them
    extended = 0, -- extended data frames
  }, Deferral)
end

--- Forget the capture file.
function Deferral:reset()
  self.is_undecided, self.defers, self.number = false, false, false
end

--- Begin to remember frames: a statistic begins, and its tap of all packets calls
-- Deferral:on_header.
-- on_remember  function(), called when a frame is remembered
function Deferral:open(on_remember)
  self.on_remember = on_remember
  self:reset_counts()
end

--- Remember no more frames.
function Deferral:close()
  self.on_remember, self.number = false, false
end

--- Count anew.
function Deferral:reset_counts()
  self.can, self.extended = 0, 0
end

--- Allow to defer frames: this is tshark's only pass, and a tap sees every packet.
function Deferral:allow()
  self.is_undecided = true
end

--- Decide whether frames are deferred, once it is known whether anything is shown.
-- wants  of Tree:wants, nil if it is not known yet
function Deferral:decide(wants)
  if not (self.is_undecided and wants) then return end
  self.is_undecided, self.defers = false, not (wants.tree or wants.columns)
  if self.defers then socketcan.unwrap() end
end

--- Remember a frame that no dissector has accepted yet.
-- returns  true if a tap of its packet will read its header
function Deferral:remember(tvb, pinfo)
  if not (self.on_remember and socketcan.is_record(tvb, pinfo)) then return false end
  self.number, self.offset, self.deferred = pinfo.number, tvb:offset(), false
  self.captured, self.length = tvb:len(), tvb:reported_len()
  self.on_remember()
  return true
end

--- Defer a frame if that is possible.
-- id           29-bit CAN id, nil if it is not known
-- accepts_all  true if the user says that every extended frame is YAPP
-- returns      true if the tap of its packet will dissect it
function Deferral:defer(tvb, pinfo, tree, id, accepts_all)
  if self.is_undecided then -- asked now: the tap has no tree
    self:decide(self.builder:wants(tree, pinfo, false))
  end
  if not (self.defers and self:remember(tvb, pinfo)) then return false end
  self.deferred = { id = id, accepts_all = accepts_all }
  return true
end

--- Forget the frame that the table of ids refused: Decode As accepts it.
function Deferral:forget()
  if not self.deferred then self.number = false end
end

-- Return the record of a frame that was remembered.
local function new_frame(self, tvb, pinfo, id)
  local frame, number = records.new_can_frame(), pinfo.number
  frame.key, frame.number = number * frame_key.PACKET + self.offset, number
  frame.time = pinfo.rel_ts
  frame.can_id = can_id.fields[id]
  frame.seq = frame.can_id.seq
  frame.data, frame.reported = tvb:raw(self.offset, self.captured), self.length
  frame.bus = self.buses.bus_is_per_packet and self.buses.bus_of(number, pinfo) or false
  return frame
end

--- Go on with the frame that waits, if it is of this packet.  A tap of all packets calls this while
-- `number` is set.
-- tvb  of the packet
function Deferral:on_header(pinfo, tvb)
  local number, deferred = self.number, self.deferred
  self.number, self.deferred = false, false
  if number ~= pinfo.number then return end
  local offset, captured = self.offset, self.captured
  local id = socketcan.id_before(tvb, pinfo, offset, self.length, deferred and deferred.id)
  self.can = self.can + 1
  if not id then return end
  self.extended = self.extended + 1
  if deferred then
    local data = tvb(offset, captured):tvb()
    self.dissect(data, pinfo, nil, id, deferred.accepts_all, self.length)
  elseif captured > 0 then
    self.reading:report_undissected(new_frame(self, tvb, pinfo, id))
  end
end

return M
