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

-- What the capture cut, C dissectors throw past Lua, and what that takes of Lua's 200 nested calls never comes back: so
-- SocketCAN is not called for half a header, and of a frame that is not ours it sees the captured bytes alone, which is
-- shown as malformed where without us it would be limited in size.  An extended frame may be ours: its ID is taken for
-- one of others when they have thrown once; and when so many IDs have, all are.
local MOST_THROWN = 24
local thrown, thrown_count = {}, 0 -- CAN ids: nothing that was lost comes back with the next file
local cut_id -- of the cut frame that SocketCAN has, while it has it

-- Whether of a frame that the capture cut the captured bytes alone are handed on.
local function is_for_others(can_id)
  return not can_id or thrown[can_id] or thrown_count >= MOST_THROWN
end

-- Hands a frame on to SocketCAN.  A malformed one has its item by the time pcall returns, and is no error of ours.
local function hand_on(inner, can_id, tvb, pinfo, tree)
  local length = tvb:len()
  if length < HEADER then return 0 end
  if cut_id then thrown[cut_id], thrown_count, cut_id = true, thrown_count + 1, nil end -- it never came back
  local seen = tvb
  if length < tvb:reported_len() then
    if is_for_others(can_id) then seen = tvb(0, length):tvb() else cut_id = can_id end
  end
  local ok, taken = pcall(inner.call, inner, seen, pinfo, tree)
  cut_id = nil
  return ok and taken or length
end

local is_on = false

--- Reads the CAN header of every frame from now on.
-- proto  a Proto for the wrapper
-- facts  a host.facts, which is told the ids
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
