-- SPDX-License-Identifier: GPL-2.0-or-later
-- From a finding of serial.framer to a transfer.  Pure Lua.

local crc = require "yapp.wire.crc"
local frame = require "yapp.wire.frame"

local M = {}

local sub = string.sub
local HEADER, CRC_SIZE = frame.HEADER, frame.CRC_SIZE

-- List the errors of a frame, but for its CRC.
local function anomalies_of(transfer)
  local list, missing = {}, transfer.missing
  if missing then
    local text = "%d of the frame's %d bytes are missing"
    list[1] = {
      expert = transfer.status == "truncated" and "truncated" or "fragment.incomplete",
      text = text:format(missing, HEADER + transfer.size + CRC_SIZE),
    }
  end
  if transfer.reserved ~= 0 then
    local text = "The reserved bytes are 0x%04x, not 0"
    list[#list + 1] = { expert = "reserved.nonzero", text = text:format(transfer.reserved) }
  end
  return list
end

--- Make the transfer of a finding.
-- finding  that is not skipped
-- bytes    that hold it, from its offset on
-- returns  the transfer, and the ID and the Seq No of its header, and its anomalies: a list of
--          { expert, text }, or false.  The transfer is {
--   status       "good", "bad" (CRC), "incomplete", "truncated" (by the capture)
--   size         of the payload, as its header has it; reserved = its reserved bytes
--   payload      the bytes of it that came
--   offset       of the frame in the bytes; length = number of its bytes that came
--   missing      number of bytes to come, nil for none
--   bytes        that hold it if those of its packet do not, or nil
--   packet_keys  of the packets that these came in, or nil
--   crc, calculated  of a bad one }
function M.new(finding, bytes)
  local offset = finding.offset or 0
  local length = finding.is_telnet and #finding.bytes or finding.to - finding.from
  local id, size, reserved, seq = frame.parse(bytes, offset + 1)
  local transfer = {
    status = finding.status,
    size = size,
    reserved = reserved,
    payload = sub(bytes, offset + HEADER + 1, offset + math.min(HEADER + size, length)),
    offset = offset,
    length = length,
    missing = finding.missing,
    bytes = finding.bytes,
    packet_keys = finding.packet_keys,
    crc = nil,
    calculated = nil,
  }
  if finding.status == "bad" then
    local last = offset + length
    transfer.crc = frame.crc(bytes, last)
    transfer.calculated = crc.update(crc.INITIAL, bytes, offset + 1, last - CRC_SIZE)
  end
  local is_usual = reserved == 0 and not finding.missing
  return transfer, id, seq, not is_usual and anomalies_of(transfer)
end

return M
