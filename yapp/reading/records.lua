-- SPDX-License-Identifier: GPL-2.0-or-later
-- The records that go into the reading of a capture and come out of it.  Pure Lua.  Each has one
-- constructor, which names every field.  host.stream has that of a packet, can.reassembly and
-- serial.stream those of transfers.

local M = {}

--- The statuses of a transfer that has ended:
--   kind       of its event; a lost one has none: its anomalies have
--   is_placed  true if its bytes stand at known offsets
--   is_proved  true if all bytes came
M.STATUSES = {
  good = { kind = "message", is_placed = true, is_proved = true },
  bad = { kind = "crc", is_placed = true, is_proved = true }, -- its CRC
  truncated = { kind = "incomplete", is_placed = true }, -- by the capture: it was not checked
  incomplete = {},
  overrun = {},
}

--- Make the record of a CAN frame.  It is used again for the next frame, which saves a tenth of a
-- packet list: keep no reference to it.
function M.new_can_frame()
  return {
    -- host.can fills in:
    key = 0, -- see base.frame_key
    number = 0, -- of its packet
    time = 0, -- seconds since the first packet
    visited = false, -- true if it is a revisit
    can_id = false, -- the fields of its CAN id (wire.can_id)
    seq = 0, -- of can_id
    data = "", -- the captured bytes
    reported = 0, -- number of bytes on the bus
    bus = false, -- its number, or false
    is_bus_known = true, -- true if the capture tells where it was captured
    accepts_all = false, -- true if the user says that every extended frame is YAPP
    is_only_pass = false, -- true if it is never dissected again
    wants_state = false, -- true if the state of its message is wanted
    -- The reading fills in:
    source = false, -- see message.types
    slot = 0, -- see can_id.BUS
  }
end

--- Make the record of a frame in a packet.  The n-th finding of a packet has the frame key of the
-- packet + n - 1.  As a frame has at least 16 bytes, no other packet has that key, not even in a
-- tunnel that puts several packets into one.
function M.new_serial_frame(packet, index, source, seq)
  return {
    key = packet.key + index - 1,
    number = packet.number,
    time = packet.time,
    visited = packet.visited,
    seq = seq,
    is_bus_known = packet.is_bus_known,
    is_only_pass = packet.is_only_pass,
    wants_state = packet.wants_state,
    source = source, -- the line, of skipped bytes
  }
end

--- Make the record of the result of a frame, or of a part of a packet.
-- kind     "single", a message in one frame; "last", which ends a message of several; "fragment";
--          "other", which has no message; "skipped", bytes of no frame; "unfinished", a message
--          that the capture cuts off; "undissected", which may be a message that is not decoded
-- frame    see above
-- values   of its event, see stat.kinds; nil for a result without an event of its own
-- returns  all that the view and the statistics see
function M.new_result(kind, frame, values)
  return {
    kind = kind,
    frame = frame,
    transfer = false, -- that the frame belongs to, or false
    message = false, -- that it ends, or false
    anomalies = false, -- list of { expert, text, ... }, see can.reassembly; or false
    values = values or false,
    is_usual = false, -- true if it needs no expert item
  }
end

return M
