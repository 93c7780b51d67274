-- SPDX-License-Identifier: GPL-2.0-or-later
-- The reading of a capture: reads each frame and packet once, in the order of the capture, and
-- returns its result.  Pure Lua.
--
--   frame ──► can.reassembly ─┐
--                             ├─► transfer ─► message ─► result ─► listener
--   packet ─► serial.stream ──┘        (values, copy or not, history)
--
-- On a revisit, it returns the same result.

local can_id = require "yapp.wire.can_id"
local copies = require "yapp.reading.copies"
local decode = require "yapp.message.decode"
local framer = require "yapp.serial.framer"
local number_of = require "yapp.base.frame_key".number
local history = require "yapp.message.history"
local lines = require "yapp.serial.lines"
local memo = require "yapp.base.memo"
local reassembly = require "yapp.can.reassembly"
local records = require "yapp.reading.records"
local streams = require "yapp.serial.stream"

local Reading = {}
Reading.__index = Reading

local HEADER = require("yapp.wire.frame").HEADER
local BUS = can_id.BUS
local NONE = {} -- to be read only

--- Make the reading.
-- types  a message.types
-- capture  a capture.capture
-- on_unknown  see can.reassembly
function Reading.new(types, capture, on_unknown)
  return setmetatable({
    types = types,
    capture = capture,
    on_unknown = on_unknown,
    listener = false, -- while a statistic runs, see Reading:listen
  }, Reading)
end

--- Report results from now on, but for plain fragments, which no statistic counts.
-- listener  gets each, as listener:report(result); false for no listener
function Reading:listen(listener)
  self.listener = listener
end

--- Forget the capture file.
-- late  of message.history
function Reading:reset(late)
  self.history = history.new(self.types.messages, self.capture, late)
  self.copies = copies.new(self.capture)
  -- CAN:
  self.reassembly = reassembly.new(self.capture, self.on_unknown)
  self.sources = memo(function(bus) -- [bus or false][ID] = a source
    return memo(function(id) return self.types:new_source(id, bus, self.capture:name(bus)) end)
  end)
  self.result = records.new_result("other", false) -- of the current frame, used again as that is
  -- Streams:
  self.streams = streams.new(function() return self:new_framer() end)
  self.lines = lines.new(self.types, self.capture)
  self.ending = false -- see Reading:finish
end

-- Report a result, and return it.
local function report(self, result)
  local listener = self.listener
  if listener then listener:report(result) end
  return result
end

-- Messages ----------------------------------------------------------------------------------------

-- Make the record of the message of a transfer.
-- frame  that ends it
local function new_message(frame, transfer)
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
    has_fault = false, -- true if a fault flag is set; a damaged message has none
    copy_of = false, -- frame key of the message that it is a copy of, or false
    -- Of message.history:
    change = false, -- the change, or false
    delta = false, -- seconds since the source's previous good message, or false
    state = false, -- the state at the message, or false if it is not known or not wanted
    -- True if its past is not known: nothing tells its bus, or controllers share its source.
    is_unreliable = not (frame.visited or frame.is_bus_known),
  }
end

-- Decode the values.  The payload has min_size bytes of its type at least.  Only a good message may
-- have more than the type's size.
local function decode_values(message, message_type)
  local size, is_good = message.transfer.size, message.status == "good"
  local is_longer = size > message_type.size
  if size < message_type.min_size or is_longer and not is_good then return end
  local raws, remarks = message_type.read(message.payload)
  message.raws = raws
  if remarks then
    message.remarks = remarks
    message.has_fault = message.status ~= "bad" and remarks.has_fault or false
  end
  if is_longer then message.undecoded = size - message_type.size end
end

-- Set the history's values of a message.
local function add_history(self, message, frame)
  local change, delta
  if frame.visited then
    change, delta = self.history:change(message)
  else
    change, delta = self.history:add(message, frame.is_only_pass)
  end
  message.change, message.delta = change or false, delta or false
  if delta == nil or change and change.unreliable then message.is_unreliable = true end
  message.state = frame.wants_state and self.history:state(message) or false
  -- In a stream, the ID of a damaged frame may be damaged, too.
  if message.source.line and message.status ~= "good" then message.delta = false end
end

local function is_plain(message)
  if message.status ~= "good" or not message.raws then return false end
  return not (message.remarks[1] or message.undecoded or message.copy_of or message.change)
end

--- Read the message of a transfer.
-- frame  that ends it, see reading.records
-- transfer  { status, size, payload }, see records.STATUSES
-- returns   the message, and whether it is good and decoded and has nothing else to show
function Reading:read_message(frame, transfer)
  local message_type, message = frame.source.type, new_message(frame, transfer)
  local status = records.STATUSES[message.status]
  if message_type and status.is_placed then decode_values(message, message_type) end
  if status.is_proved then
    message.copy_of = self.copies:find(message, frame.visited, frame.is_only_pass) or false
  end
  if not (message.is_unreliable or message.copy_of) then add_history(self, message, frame) end
  return message, is_plain(message)
end

-- CAN ---------------------------------------------------------------------------------------------

-- Set source and slot of a frame; return what reassembly says of it.
local function reassemble(self, frame)
  local fields, bus, fragments = frame.can_id, frame.bus, self.reassembly
  frame.source, frame.seq = self.sources[bus][fields.id], fields.seq
  frame.slot = fields.message_key + (bus or 0) * BUS
  local read = frame.visited and fragments.recall or fragments.add
  local kind, transfer, anomalies = read(fragments, frame)
  if transfer then frame.source = transfer.source end
  return kind, transfer or false, anomalies or false
end

--- Read the next frame of the capture, and report its result; recall the result on a revisit.
-- frame    see reading.records
-- returns  its result, which is used again for the next frame; nil for a frame that is not YAPP's
function Reading:read(frame)
  local kind, transfer, anomalies = reassemble(self, frame)
  if not kind then return nil end
  local result, message, is_usual = self.result, false, true
  if kind == "last" or kind == "single" then
    message, is_usual = self:read_message(frame, transfer)
    if message.has_fault then reassembly.mark_fault(transfer) end
  end
  result.kind = kind
  result.frame = frame
  result.transfer = transfer
  result.message = message
  result.anomalies = anomalies
  result.is_usual = is_usual and not anomalies and #frame.data == frame.reported
  if kind == "fragment" and not anomalies then return result end -- no statistic counts it
  return report(self, result)
end

-- Return the payload size of the message that a single frame may be; nil for none.
-- message_type  of its ID, or nil
local function single_size(self, message_type, data)
  for _, one in ipairs(self.types.messages) do
    local size = can_id.single_size(data, #data, one.min_size, one.size)
    if size and decode.is_plausible(one, data:sub(1, size)) then return size end
  end
  local size = message_type and message_type.size or #data
  return #data > size and decode.is_plausible(message_type, data:sub(1, size)) and #data or nil
end

--- Report a frame that is not dissected, if it may be a message or begin one:
--   of an unknown ID
--   of a known ID, with a YAPP CTL other than 0
--   of a known ID, with bytes behind its values
-- frame  see reading.records
function Reading:report_undissected(frame)
  local fields = frame.can_id
  local source, data, size = self.sources[frame.bus][fields.id], frame.data, nil
  if fields.ctl ~= 0 and not source.type then return end
  if fields.ctrl == can_id.START and #data == 8 then
    local _, total, reserved = can_id.start(data)
    size = reserved == 0 and total > 8 and total
  elseif fields.ctrl == 0 then
    size = single_size(self, source.type, data)
  end
  if not size then return end
  frame.source = source
  report(self, records.new_result("undissected", frame, { size = size }))
end

-- Streams -----------------------------------------------------------------------------------------

--- Make a framer for bytes of a capture.
function Reading:new_framer()
  return framer.new(function(id) return self.types:size_of(id) end)
end

-- Make the frame of a transfer in a packet.
-- index  of its finding
local function new_frame(self, packet, transfer, index)
  local source = self.lines:source(packet.line, transfer.id)
  return records.new_serial_frame(packet, index, source, transfer.seq)
end

-- Return the result of a finding, with the message that it holds.
-- index  of the finding in its packet
local function finding_result(self, packet, finding, index)
  local transfer = streams.new_transfer(finding, packet.bytes)
  local frame = new_frame(self, packet, transfer, index)
  local values = transfer.status == "skipped" and { length = transfer.length } or nil
  local result = records.new_result(values and "skipped" or "single", frame, values)
  result.transfer = transfer
  if values then return result end
  local message, is_usual = self:read_message(frame, transfer)
  result.message, result.anomalies = message, transfer.anomalies
  result.is_usual = is_usual and not result.anomalies[1]
  return result
end

--- Read the next packet of the capture, and report its results; recall them on a revisit.
-- packet   see host.stream
-- returns  { results = list of a result for each frame, and for each stretch of bytes of no frame;
--          pending, leads_to = see serial.stream; is_unfinished = on a revisit:
--          true if the capture ends before the frame that the pending bytes begin }; nil for a
--          packet that is not YAPP's: a datagram of others in a conversation that was found by
--          content
function Reading:read_packet(packet)
  local contents
  if packet.is_skipped then
    local findings = { { status = "skipped", from = 0, to = #packet.bytes } }
    contents = { findings = findings, pending = 0 }
  elseif packet.visited then
    contents = self.streams:find(packet)
  else
    contents = self.streams:add(packet, not packet.is_only_pass)
  end
  if not contents then return nil end
  local results = {}
  for i, finding in ipairs(contents.findings) do
    results[i] = report(self, finding_result(self, packet, finding, i))
  end
  return {
    results = results,
    pending = contents.pending,
    leads_to = contents.leads_to,
    is_unfinished = packet.visited and self.streams:is_unfinished(contents, packet),
  }
end

-- The end -----------------------------------------------------------------------------------------

-- The CAN messages that the capture ends before.
local function finish_frames(self, list)
  for _, open in ipairs(self.reassembly:unfinished()) do
    local transfer, key, frame = open.transfer, open.key, records.new_can_frame()
    frame.key, frame.number, frame.time = key, number_of(key), transfer.time
    frame.source, frame.seq = transfer.source, transfer.slot % 0x100
    list[#list + 1] = records.new_result("unfinished", frame, {})
  end
end

-- Return the result of a finding in bytes that wait when the capture ends; nil for bytes that may
-- be a part of a frame.
local function waiting_result(self, packet, finding, index, may_go_on)
  local is_skipped = finding.status == "skipped"
  if is_skipped and finding.to - finding.from < HEADER then return nil end
  if is_skipped or not (finding.missing or may_go_on) then
    -- The key of no other message: packets have fewer findings than bytes.
    return finding_result(self, packet, finding, packet.length + index)
  end
  local transfer = streams.new_transfer(finding, packet.bytes)
  return records.new_result("unfinished", new_frame(self, packet, transfer, 1), {})
end

--- Return the results that wait when all packets have come: messages that the capture ends
-- before, and others behind a frame that seems to be open, or behind a gap in a TCP connection.
-- may_go_on  true if more packets may come, as in Wireshark: there every message that waits is one
--            that the capture ends before; otherwise the first answer is the answer: messages that
--            are read again would be copies
function Reading:finish(may_go_on)
  if self.ending then return self.ending end
  local list = {}
  finish_frames(self, list)
  for _, open in ipairs(self.streams:unfinished(may_go_on)) do
    for i, finding in ipairs(open.findings) do
      list[#list + 1] = waiting_result(self, open.packet, finding, i, may_go_on)
    end
  end
  if not may_go_on then self.ending = list end
  return list
end

--- Return the gaps in TCP connections, in the form of Capture:drops.
function Reading:drops()
  return self.streams:drops()
end

return Reading
