-- SPDX-License-Identifier: GPL-2.0-or-later
-- The headers of TCP segments.  Wireshark's API.
--
-- Wireshark's TCP hands on bytes without their sequence numbers.  Which segments it keeps to itself
-- or joins depends on its version and preferences.  So a watch in front of TCP reads the header,
-- and hands on the segment when TCP has shown it.  That costs a name in frame.protocols and about 1
-- µs a segment, so it runs only in captures with YAPP on TCP.

local band = require "yapp.base.bits".band

local M = {}

local TCP = 6 -- IP protocol
local HEADER = 20
local FIN, SYN, RST, ACK = 1, 2, 4, 16 -- flags

-- A dissector of another protocol may throw past Lua at a truncated segment.  Each time Lua loses
-- one of its 200 nested calls for good.  So the watch ends after this many.
local MAX_THROWN = 24

local protocols, tcp = DissectorTable.get("ip.proto"), Dissector.get("tcp")
-- When Wireshark reloads its Lua plugins, the watch that was there takes TCP away with it.
if not protocols:get_dissector(TCP) then protocols:add(TCP, tcp) end
local is_watching, thrown = false, 0
local segment, inside -- that TCP is dissecting, nil for none; number of the packet that TCP has

-- Read a header; nil if it is not there or if an ICMP error only quotes it.
local function read_header(tvb, pinfo)
  if tvb:len() < HEADER or pinfo.in_error_pkt then return nil end
  local seq, ack, size, flags = Struct.unpack(">I4I4BB", tvb:raw(4, 10))
  local start, is_syn = band(size, 0xF0) / 4, band(flags, SYN) ~= 0
  if start < HEADER or start > tvb:len() then return nil end
  return {
    offset = tvb:offset() + start,
    start = start,
    length = band(flags, RST) == 0 and tvb:reported_len() - start or 0,
    seq = (seq + (is_syn and 1 or 0)) % 0x100000000,
    ack = band(flags, ACK) ~= 0 and ack or nil,
    is_syn = is_syn,
    is_end = band(flags, FIN + RST) ~= 0,
    number = pinfo.number,
    epoch = pinfo.abs_ts,
    is_ours = false,
  }
end

--- End the watch.
function M.stop()
  if is_watching then protocols:add(TCP, tcp) end
  is_watching, inside, segment = false, nil, nil
end

--- Read the header of every segment from now on.
-- proto       Proto for the watch
-- on_segment  function(segment, tvb, pinfo, tree), called when TCP has shown a segment: see
--             M.current
function M.watch(proto, on_segment)
  if is_watching or thrown >= MAX_THROWN then return end
  is_watching = true
  function proto.dissector(tvb, pinfo, tree)
    if inside and inside ~= pinfo.number then
      segment, thrown = nil, thrown + 1
      if thrown >= MAX_THROWN then M.stop() end
    end
    local outer, current = segment, read_header(tvb, pinfo)
    segment, inside = current, pinfo.number
    local ok, length = pcall(tcp.call, tcp, tvb, pinfo, tree)
    segment, inside = outer, outer and inside
    if current then on_segment(current, tvb, pinfo, tree) end
    return ok and length or tvb:len()
  end
  protocols:add(TCP, proto)
end

--- Return the segment that TCP is dissecting, nil for none.
-- number   of the packet that is dissected
-- returns  {
--   start    offset of its bytes, behind TCP's header; offset = in the packet
--   length   number of data bytes that were sent; 0 for a reset
--   seq      sequence number of the first one
--   ack      sequence number that it acknowledges, or nil
--   is_syn   true if it begins a connection; is_end = true if it ends one
--   number, epoch  of its packet: epoch = seconds since 1970
--   is_ours  to be set if TCP hands it to YAPP }
function M.current(number)
  return inside == number and segment or nil -- else a dissector threw past Lua
end

return M
