-- SPDX-License-Identifier: GPL-2.0-or-later
-- The records that go into the reading of a capture and come out of it.  Pure Lua.  Each has one
-- constructor, which names every field.  host.serial has that of a packet, can.reassembly and
-- serial.transfers those of transfers.

local M = {}

local NONE = {} -- to be read only

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
    slot = 0, -- see can_id.slot
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

--- Make the record of the message of a transfer, which reading.messages fills in.
-- frame  that ends it
function M.new_message(frame, transfer)
  return { -- Lua makes room for 16 fields or for 32: more than 16 cost 2 % of a packet list
    transfer = transfer,
    source = frame.source, -- see message.types
    seq = frame.seq,
    key = frame.key,
    time = frame.time, -- seconds since the first packet
    status = transfer.status,
    payload = transfer.payload, -- the bytes of it that came
    raws = false, -- the values by index of field (message.decode); false if the size does not fit
    remarks = NONE, -- the remarkable values (message.decode)
    undecoded = false, -- number of payload bytes behind the type's size, false for none
    -- Of an unknown message: { type = that has its size, is_advised = true if Info says in full
    -- which preference decodes it }; false if no type has its size.
    like = false,
    copy_of = false, -- frame key of the message that it is a copy of, or false
    -- Of message.history:
    change = false, -- the change, or false
    delta = false, -- seconds since the source's previous good message, or false
    state = false, -- the state at the message, or false if it is not known or not wanted
    -- True if its past is not known: nothing tells its bus, or controllers share its source.
    is_unreliable = not (frame.visited or frame.is_bus_known),
  }
end

--- Make the record of the result of a frame, or of a part of a packet.
-- kind     "single", a message in one frame; "last", which ends a message of several; "fragment";
--          "other", which has no message; "skipped", bytes of no frame; "unfinished", a message
--          that the capture cuts off; "undissected", which may be a message that is not decoded
-- frame    see above
-- returns  all that the view and the statistics see
function M.new_result(kind, frame)
  return {
    kind = kind,
    frame = frame,
    transfer = false, -- that the frame belongs to, or false
    message = false, -- that it ends, or false
    anomalies = false, -- list of { expert, text, ... }, see can.reassembly; or false
    index = false, -- of the frame in its transfer, on a revisit; or false
    length = 0, -- number of bytes: of skipped ones; size of an undissected message
    is_usual = false, -- true if it needs no expert item
  }
end

return M
