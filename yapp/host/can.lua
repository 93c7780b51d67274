-- SPDX-License-Identifier: GPL-2.0-or-later
-- The dissector of YAPP on CAN: hands each frame to the reading, and the result to the view.
-- Wireshark's API.

local can_id = require "yapp.wire.can_id"
local deferral = require "yapp.host.deferral"
local frame_key = require "yapp.base.frame_key"
local records = require "yapp.reading.records"
local socketcan = require "yapp.host.socketcan"

local M = {}

local fields_of, START = can_id.fields, can_id.START
local PACKET = frame_key.PACKET
-- A method that Lua has to look up in a Tvb costs more than its work.
local length_of, raw_of, reported_of, offset_of = Tvb.len, Tvb.raw, Tvb.reported_len, Tvb.offset

-- YAPP has no remote frames, but captures give a remote frame zeros as data.  So ask of a frame of
-- zeros whether it is remote; if nothing says so, it is a data frame.
local ZEROS = {}
for length = 0, 8 do ZEROS[("\0"):rep(length)] = true end

local Dissector = {}
Dissector.__index = Dissector

--- Make the dissector.
-- reading      a reading.reading
-- view         a show.frame
-- builder      a show.tree
-- buses        a host.buses
-- register_start  function(id, seq), which makes Wireshark call YAPP for the frames behind a Start
--              of an unknown ID
-- settings     its accepts_all: the preference yapp.all_extended
function M.new(reading, view, builder, buses, register_start, settings)
  local self = setmetatable({
    reading = reading,
    view = view,
    builder = builder,
    buses = buses,
    register_start = register_start,
    settings = settings,
    frame = records.new_can_frame(),
  }, Dissector)
  self.deferral = deferral.new(reading, builder, buses, function(...) self:dissect(...) end)
  return self
end

--- Forget the capture file.
function Dissector:reset()
  self.deferral:reset()
  self.offset = self.buses.found.offset -- of the bytes of all frames in their packets, or nil
  -- Whether the bus of a frame has to be asked for.
  self.bus_is_per_packet = self.buses.bus_is_per_packet
  self.has_start = self.buses.found.start -- see Buses:time
  self.frame = records.new_can_frame()
end

-- Fill the record of the current frame; return it, and its wanted parts.
-- is_deferred  whether it comes from a tap, where Wireshark calls every packet visited
local function fill_frame(self, tvb, reported, pinfo, tree, id, accepts_all, is_deferred)
  local frame, number, offset = self.frame, pinfo.number, self.offset or offset_of(tvb)
  if self.bus_is_per_packet then
    local bus, is_bus_known = self.buses.of(number, offset, pinfo)
    frame.bus, frame.is_bus_known = bus or false, is_bus_known
  end
  local fields, key, builder = fields_of[id], number * PACKET + offset, self.builder
  -- A frame above the newest one is new, which saves asking Wireshark.
  local visited = key <= self.reading.newest_key and not is_deferred and pinfo.visited
  local wants = not visited and builder.wanted or builder:wants(tree, pinfo, visited)
  frame.key = key
  frame.number = number
  frame.time = self.has_start and self.buses:time(pinfo) or pinfo.rel_ts
  frame.visited = visited
  frame.can_id = fields
  frame.seq = fields.seq
  -- raw() of an empty Tvb would throw past Lua: not even pcall catches that.
  frame.data = length_of(tvb) > 0 and raw_of(tvb) or ""
  frame.reported = reported
  frame.accepts_all = accepts_all
  frame.is_only_pass = wants.is_only_pass
  frame.wants_state = wants.state
  return frame, wants
end

--- Return whether a later packet was dissected before this one, as in the second pass of two.
function Dissector:is_second_pass(number)
  return frame_key.number(self.reading.newest_key) > number
end

-- Return how many bytes are ours of a frame of zeros that is not dissected now: none of a remote
-- frame, all of one that waits for a tap; nil to dissect it.
local function pass_over(self, frame, tvb, pinfo, tree, id)
  if frame.visited and frame.can_id.ctrl ~= 0 then return nil end -- it was taken for a fragment
  local is_remote = socketcan.is_remote(pinfo)
  if is_remote then return 0 end
  local waits = is_remote == nil and self.deferral:defer(tvb, pinfo, tree, id, frame.accepts_all)
  return waits and frame.reported or nil
end

-- Register the ids of the frames behind the Start of an unknown message.
local function register_unknown(self, frame)
  if frame.can_id.ctrl == START then self.register_start(frame.can_id.id, frame.seq) end
end

--- Dissect one frame.
-- id           29-bit CAN id
-- accepts_all  whether the user says that every extended frame is YAPP
-- length       of a deferred frame, whose Tvb does not know it: its bytes on the bus; else nil
-- returns      the number of bytes that are ours, 0 for a frame that is not
function Dissector:dissect(tvb, pinfo, tree, id, accepts_all, length)
  local reported = length or reported_of(tvb)
  if reported == 0 then return 0 end
  local frame, wants = fill_frame(self, tvb, reported, pinfo, tree, id, accepts_all, length)
  local passed = ZEROS[frame.data] and pass_over(self, frame, tvb, pinfo, tree, id)
  if passed then return passed end
  local visited, reading = frame.visited, self.reading
  local result = visited and reading:recall_frame(frame)
  if not visited then result = reading:add_frame(frame) end
  if not result then
    self.deferral:note(tvb, pinfo)
    return 0
  end
  if not frame.source.message then register_unknown(self, frame) end
  if wants.shows or not result.is_usual then self.view:show(result, wants, tvb, pinfo, tree) end
  return reported
end

--- Return the dissector for SocketCAN's table of ids, where match_uint is the CAN id.
-- calls  { begun, ended = numbers }, which it counts
function Dissector:of_table(calls)
  return function(tvb, pinfo, tree)
    calls.begun = calls.begun + 1
    local accepts_all = self.settings.accepts_all
    local length = self:dissect(tvb, pinfo, tree, pinfo.match_uint, accepts_all)
    calls.ended = calls.ended + 1
    return length
  end
end

--- Dissect a frame that the user calls YAPP, but whose CAN id is not known.
-- returns  the number of bytes that are ours
function Dissector:without_id(tvb, pinfo, tree)
  if not (tvb:len() > 0 and self.deferral:defer(tvb, pinfo, tree, nil, true)) then
    self.view:show_without_id(self.builder:wants(tree, pinfo, true), tvb, pinfo, tree)
  end
  return tvb:reported_len()
end

return M
