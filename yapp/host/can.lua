-- SPDX-License-Identifier: GPL-2.0-or-later
-- The dissector of YAPP on CAN: hands each frame to the reading, and the result to the view.
-- Wireshark's API.

local can_id = require "yapp.wire.can_id"
local frame_key = require "yapp.base.frame_key"
local records = require "yapp.reading.records"
local socketcan = require "yapp.wire.socketcan"

local Dissector = {}
Dissector.__index = Dissector

local fields_of = can_id.fields
local PACKET = frame_key.PACKET
-- A method that Lua has to look up in a Tvb costs more than its work.
local length_of, raw_of, reported_of, offset_of = Tvb.len, Tvb.raw, Tvb.reported_len, Tvb.offset

-- YAPP has no remote frames, but captures give a remote frame zeros as data.  So ask of a frame of
-- zeros whether it is remote.  If nothing says so, it waits for a statistic's tap of its packet,
-- which sees the header; without a statistic it is a data frame.
local ZEROS = {}
for length = 0, 8 do ZEROS[("\0"):rep(length)] = true end

--- Make the dissector.
-- parts  { reading = a reading.reading, view = a show.view, wants = a show.wants,
--          capture = a capture.capture, headers = a host.header;
--          settings: its accepts_all is the preference yapp.all_extended }
function Dissector.new(parts)
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
-- id  29-bit CAN id, nil if it is not known
local function fill(self, frame, tvb, pinfo, id)
  local number = pinfo.number
  frame.key = number * PACKET + offset_of(tvb)
  frame.number = number
  frame.time = pinfo.rel_ts
  frame.can_id = id and fields_of[id]
  -- Without bytes raw() would throw past Lua: not even pcall catches that.
  frame.data = length_of(tvb) > 0 and raw_of(tvb) or ""
  frame.reported = reported_of(tvb)
  if self.bus_is_per_packet then
    local bus, is_bus_known = self.capture.bus_of(number, pinfo)
    frame.bus, frame.is_bus_known = bus or false, is_bus_known
  end
end

-- Let the frame wait until a tap of its packet sees its header.
-- id          29-bit CAN id, nil if only the header tells it
-- is_claimed  true to read it then; false to count it, as it is not YAPP's
-- returns     the number of bytes that are ours
local function wait(self, id, is_claimed)
  self.waits, self.id, self.is_claimed = true, id, is_claimed
  if not is_claimed then return 0 end
  self.number = self.frame.number
  return self.frame.reported
end

-- Return how many bytes of a frame of zeros are ours: 0 of a remote frame, all of one that waits;
-- nil for a data frame, which is to be read.
local function judge_zeros(self, pinfo, id, wants)
  local frame = self.frame
  if frame.visited and frame.can_id.ctrl ~= 0 then return nil end -- it was taken for a fragment
  local is_remote = self.headers:is_remote(pinfo)
  if is_remote then return 0 end
  if is_remote == nil and self.reading.listener and not wants.shows then
    return wait(self, id, true)
  end
end

--- Dissect one frame.
-- id           29-bit CAN id
-- accepts_all  true if the user says that every extended frame is YAPP
-- returns      the number of bytes that are ours, 0 for a frame that is not
function Dissector:dissect(tvb, pinfo, tree, id, accepts_all)
  local frame = self.frame
  if self.waits then self:resume(frame.number, "") end -- no tap has seen its packet
  fill(self, frame, tvb, pinfo, id)
  frame.accepts_all = accepts_all
  -- A frame above the newest one is new, and in tshark's first pass all frames want the same.
  local key, wants = frame.key, self.wants.first_pass
  local is_new = key > self.newest_key
  if not is_new or wants ~= self.asked then wants = ask(self, frame, pinfo, tree) end
  if frame.reported == 0 then return 0 end
  local length = ZEROS[frame.data] and judge_zeros(self, pinfo, id, wants)
  if length then return length end
  if is_new then self.newest_key = key end
  local result = self.reading:read(frame)
  if not result then return self.reading.listener and wait(self, nil, false) or 0 end
  self.number = frame.number
  if wants.shows or not result.is_usual then
    self.view:show_frame(result, wants, tvb, pinfo, tree)
  end
  return frame.reported
end

--- Remember a frame that no dissector accepts: if it is an extended data frame, a tap counts it.
function Dissector:remember(tvb, pinfo)
  if self.waits or not self.reading.listener or length_of(tvb) == 0 then return end
  fill(self, self.frame, tvb, pinfo)
  self.frame.visited = pinfo.visited
  wait(self, nil, false)
end

--- Begin to count frames that are not YAPP's.
function Dissector:begin_count()
  self.waits, self.refused_count = false, 0
end

--- Go on with the frame that waits, if it is an extended data frame.
-- number  of a packet, which is that of the frame but in Wireshark
-- packet  its bytes
function Dissector:resume(number, packet)
  local frame, id = self.frame, self.id
  local flags, header_id, length = socketcan.read(packet)
  self.waits = false
  if not id or id == header_id then
    id = flags == socketcan.EXTENDED and length == frame.reported and header_id
  end
  if not id or frame.number ~= number then return end
  frame.can_id = fields_of[id]
  frame.seq = frame.can_id.seq
  if self.is_claimed then
    self.newest_key = math.max(self.newest_key, frame.key)
    if self.reading:read(frame) then return end
  end
  self.refused_count = self.refused_count + 1
  self.reading:report_undissected(frame)
end

--- Dissect a frame that did not come through the table of ids: the user says that it is YAPP.
-- returns  the number of bytes that are ours, 0 for no extended data frame
function Dissector:dissect_any(tvb, pinfo, tree)
  local id, is_unknown = self.headers:find_id(pinfo)
  if id then return self:dissect(tvb, pinfo, tree, id, true) end
  local reported, frame = reported_of(tvb), self.frame
  if not is_unknown or reported == 0 then return 0 end
  self.headers:start() -- from the next frame on the id is known
  fill(self, frame, tvb, pinfo)
  frame.accepts_all = true
  local wants = ask(self, frame, pinfo, tree)
  if self.reading.listener and not wants.shows then return wait(self, nil, true) end
  self.view:show_without_id(pinfo, tree)
  return reported
end

return Dissector
