-- SPDX-License-Identifier: GPL-2.0-or-later
-- Reads the CAN header in front of SocketCAN, for those who take all frames of a bus: exact, on every pass, at the cost
-- of a name in frame.protocols and about 1 µs a CAN frame; so only where the user asked for all of a bus.  Wireshark's
-- API.

local M = {}

local EXTENDED, REMOTE, ERROR, MASK = 0x80000000, 0x40000000, 0x20000000, 0x20000000
local HEADER = 8 -- bytes that have the id

-- The first word of a SocketCAN record; big endian in its own encapsulation (unless a preference says otherwise), host
-- order in cooked captures.
-- returns  29-bit id of an extended data frame, or nil
local function header_id(tvb, is_little)
  if tvb:len() < HEADER then return nil end
  local word = is_little and tvb(0, 4):le_uint() or tvb(0, 4):uint()
  if word < EXTENDED or word % (2 * REMOTE) >= REMOTE or word % (2 * ERROR) >= ERROR then return nil end
  return word % MASK
end

-- Hands a frame on to SocketCAN.  What the capture cut, others throw past Lua, which never gets back what that takes of
-- its stack: so SocketCAN is not called for half a header, and of a frame that is not ours it sees the captured bytes
-- alone: that is shown as malformed, where without us it would be limited in size.  A frame that is malformed has its
-- item by the time pcall returns, and is no error of ours.
local function hand_on(inner, can_id, tvb, pinfo, tree)
  local length = tvb:len()
  if length < HEADER then return 0 end
  local seen = not can_id and length < tvb:reported_len() and tvb(0, length):tvb() or tvb
  local ok, taken = pcall(inner.call, inner, seen, pinfo, tree)
  return ok and taken or length
end

local is_on = false

--- Reads the CAN header of every frame from now on.
-- proto  a Proto for the wrapper
-- facts  a yapp_facts, which is told the ids
function M.wrap(proto, facts)
  if is_on then return end
  is_on = true
  local little = true -- the host's order, on every machine that Wireshark is built for today
  local carriers = {}
  for _, row in ipairs { { "wtap_encap", wtap.SOCKETCAN, false }, { "sll.ltype", 0x0C, little },
    { "sll.ltype", 0x0D, little } } do
    local dissectors = DissectorTable.get(row[1])
    local inner = dissectors:get_dissector(row[2])
    if inner then carriers[row[2]] = { inner = inner, is_little = row[3], dissectors = dissectors } end
  end
  function proto.dissector(tvb, pinfo, tree)
    local carrier = carriers[pinfo.match_uint]
    if not carrier then return 0 end
    local is_swapped = pinfo.match_uint == wtap.SOCKETCAN and facts.is_swapped
    local can_id = header_id(tvb, carrier.is_little or is_swapped)
    facts:note_header(pinfo.number, can_id)
    return hand_on(carrier.inner, can_id, tvb, pinfo, tree)
  end
  for value, carrier in pairs(carriers) do carrier.dissectors:add(value, proto) end
end

return M
