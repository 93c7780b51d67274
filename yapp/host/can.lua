-- SPDX-License-Identifier: GPL-2.0-or-later
-- The dissector of YAPP on CAN: hands each frame to the reading, and the result to the view.
-- Wireshark's API.

local can_id = require "yapp.wire.can_id"
local frame_key = require "yapp.base.frame_key"
local records = require "yapp.reading.records"

local M = {}

local fields_of = can_id.fields
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
-- parts  { reading = a reading.reading, view = a show.view, wants = a show.wants,
--          capture = a capture.capture, headers = a host.header;
--          settings: its accepts_all is the preference yapp.all_extended }
function M.new(parts)
  return setmetatable(parts, Dissector)
end

--- Forget the capture file.
function Dissector:reset()
  -- True if the bus of a frame has to be asked for.
  self.bus_is_per_packet = self.capture.bus_is_per_packet
  self.newest_key = 0 -- of the frames that were read: one above it is new
  self.number = 0 -- of the latest packet that is YAPP's
  self:begin_count()
  self.frame = records.new_can_frame()
  self.asked = false -- the answer of Wants:ask that the frame has
end

-- Find out whether the current frame is a revisit, and which parts of it are wanted.
-- returns  see Wants:ask
local function ask(self, frame, pinfo, tree)
  local visited = frame.key <= self.newest_key and pinfo.visited
  local wants = self.wants:ask(tree, pinfo, visited)
  frame.visited = visited
  frame.is_only_pass, frame.wants_state = wants.is_only_pass, wants.state
  self.asked = not visited and self.wants.first_pass or false
  return wants
end

--- Return whether a later packet was dissected before this one, as in the second pass of two.
function Dissector:is_second_pass(number)
  return frame_key.number(self.newest_key) > number
end

-- Set what a packet has of a frame.
-- id  29-bit CAN id
local function fill(self, frame, tvb, pinfo, id)
  local number = pinfo.number
  frame.key = number * PACKET + offset_of(tvb)
  frame.number = number
  frame.time = pinfo.rel_ts
  frame.can_id = fields_of[id]
  -- Without bytes raw() would throw past Lua: not even pcall catches that.
  frame.data = length_of(tvb) > 0 and raw_of(tvb) or ""
  frame.reported = reported_of(tvb)
  if self.bus_is_per_packet then
    local bus, is_bus_known = self.capture.bus_of(number, pinfo)
    frame.bus, frame.is_bus_known = bus or false, is_bus_known
  end
end

-- Return whether a frame of zeros is a remote frame.
local function is_remote(self, frame, pinfo)
  if frame.visited and frame.can_id.ctrl ~= 0 then return false end -- it was taken for a fragment
  return self.headers:is_remote(pinfo)
end

--- Dissect one frame.
-- id           29-bit CAN id
-- accepts_all  true if the user says that every extended frame is YAPP
-- returns      the number of bytes that are ours, 0 for a frame that is not
function Dissector:dissect(tvb, pinfo, tree, id, accepts_all)
  local frame = self.frame
  fill(self, frame, tvb, pinfo, id)
  frame.accepts_all = accepts_all
  -- A frame above the newest one is new, and in tshark's first pass all frames want the same.
  local key, wants = frame.key, self.wants.first_pass
  local is_new = key > self.newest_key
  if not is_new or wants ~= self.asked then wants = ask(self, frame, pinfo, tree) end
  if frame.reported == 0 or ZEROS[frame.data] and is_remote(self, frame, pinfo) then return 0 end
  if is_new then self.newest_key = key end
  local result = self.reading:read(frame)
  if not result then
    self:remember(tvb, pinfo, id)
    return 0
  end
  self.number = frame.number
  if wants.shows or not result.is_usual then
    self.view:show_frame(result, wants, tvb, pinfo, tree)
  end
  return frame.reported
end

--- Remember an extended data frame that is not YAPP's, so far: a tap of its packet counts it.
-- id  29-bit CAN id, nil if it is not known
function Dissector:remember(tvb, pinfo, id)
  if not self.reading.listener or length_of(tvb) == 0 then return end
  id = id or self.headers:find_id(pinfo)
  if not id then return end
  local frame = records.new_can_frame()
  fill(self, frame, tvb, pinfo, id)
  frame.visited, frame.seq = pinfo.visited, frame.can_id.seq
  self.refused = frame
end

--- Begin to count frames that are not YAPP's.
function Dissector:begin_count()
  self.refused, self.refused_count = false, 0
end

--- Count the frame that was refused, if it is of this packet, and report it: it may be a message.
-- A tap of all packets calls this while `refused` is set.
function Dissector:count_refused(number)
  local frame = self.refused
  self.refused = false
  if frame.number ~= number then return end
  self.refused_count = self.refused_count + 1
  self.reading:report_undissected(frame)
end

--- Return the dissector for SocketCAN's table of ids, where match_uint is the CAN id.
-- calls  { begun, ended = numbers }, which it counts
function Dissector:new_table_dissector(calls)
  local settings, dissect = self.settings, self.dissect
  return function(tvb, pinfo, tree)
    calls.begun = calls.begun + 1
    local length = dissect(self, tvb, pinfo, tree, pinfo.match_uint, settings.accepts_all)
    calls.ended = calls.ended + 1
    return length
  end
end

--- Dissect a frame that did not come through the table of ids: the user says that it is YAPP.
-- returns  the number of bytes that are ours, 0 for no extended data frame
function Dissector:dissect_any(tvb, pinfo, tree)
  local id, is_unknown = self.headers:find_id(pinfo)
  if id then
    local length = self:dissect(tvb, pinfo, tree, id, true)
    if length > 0 then self.refused = false end -- by the table of ids
    return length
  end
  local reported = reported_of(tvb)
  if not is_unknown or reported == 0 then return 0 end
  self.headers:start() -- from the next frame on the id is known
  self.wants:ask(tree, pinfo, pinfo.visited)
  self.view:show_without_id(pinfo, tree)
  return reported
end

return M
