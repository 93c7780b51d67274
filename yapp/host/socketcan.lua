-- SPDX-License-Identifier: GPL-2.0-or-later
-- What SocketCAN says of a frame beside its data: the id of one that comes by Decode As, whether it
-- is a remote frame. Wireshark's API.
--
-- A dissector gets the data alone.  In SocketCAN's table of ids, which is how our messages are
-- found, pinfo.match_uint is the id.  Who takes all frames of a bus has the header read in front of
-- SocketCAN: exact, on every pass, at the cost of a name in frame.protocols and about 1 µs a CAN
-- frame; so only where the user asked for all of a bus.

local fields_of = require "yapp.host.fields".of

local M = {}

local EXTENDED, REMOTE, ERROR, MASK = 0x80000000, 0x40000000, 0x20000000, 0x20000000
local HEADER = 8 -- bytes that have the id

-- Of the frame that is dissected: { number = of its packet, can_id = 29 bits, nil for others }.
local header = {}
-- What the table of ids left to Decode As: { number, place, can_id }.
local refused = {}
local REFUSED = "yapp.refused" -- in the private table of a packet: of this look at it only

-- Fields ------------------------------------------------------------------------------------------

local NAMES = { ["can.id"] = true, ["can.flags.xtd"] = true, ["can.flags.rtr"] = true }

local function is_true(value) return value == true or value == 1 end

--- The id of the current frame, which came by Decode As.
-- returns  29-bit id; nil where it is not an extended data frame; nil and true where nothing says
function M.find_id(tvb, pinfo)
  if header.number == pinfo.number then return header.can_id end
  if M.is_refused(tvb, pinfo) then return refused.can_id end
  local fields = fields_of(NAMES)
  local id, extended = fields["can.id"], fields["can.flags.xtd"]
  if id ~= nil and extended ~= nil then return is_true(extended) and id % MASK or nil end
  -- "Ext. ID: 138428416 (0x8404000), Length: 8", as SocketCAN leaves it in the Info column.
  local text = tostring(pinfo.cols.info)
  if not (text:find("ID: ", 1, true) or text:find("^ERR")) then return nil, true end
  return tonumber(text:match("Ext%. ID: (%d+)"))
end

--- Whether a frame of zeros is a remote frame, as far as a header, a field or a column says so:
-- those have no data, but captures give them zeros.
function M.is_remote(pinfo)
  if header.number == pinfo.number then return header.can_id == nil end
  local rtr = fields_of(NAMES)["can.flags.rtr"]
  if rtr ~= nil then return is_true(rtr) end
  if tostring(pinfo.cols.protocol) == "CANFD" then return false end
  return tostring(pinfo.cols.info):find("Remote", 1, true) ~= nil
end

--- The table of ids had the current frame and left it to Decode As, which is asked next.
function M.note_refused(tvb, pinfo, can_id)
  refused.number = pinfo.number
  refused.place = tvb:offset()
  refused.can_id = can_id
  pinfo.private[REFUSED] = ""
end

--- Whether it did so.
function M.is_refused(tvb, pinfo)
  if refused.number ~= pinfo.number or refused.place ~= tvb:offset() then return false end
  return pinfo.private[REFUSED] ~= nil
end

--- Whether the current frame, which came with 0 for its id, did so by Decode As and not from the
-- table of ids: it has another id, or the table had it already.
function M.is_decode_as(tvb, pinfo)
  if M.is_refused(tvb, pinfo) then return true end
  local can_id, is_unknown = M.find_id(tvb, pinfo)
  return not is_unknown and can_id ~= 0
end

--- Forgets the capture file.
function M.init()
  header, refused = {}, {}
end

-- The header in front -----------------------------------------------------------------------------

-- The first word of a SocketCAN record; big endian in its own encapsulation (unless a preference
-- says otherwise), host order in cooked captures.
-- returns  29-bit id of an extended data frame, or nil
local function header_id(tvb, is_little)
  if tvb:len() < HEADER then return nil end
  local word = is_little and tvb(0, 4):le_uint() or tvb(0, 4):uint()
  local is_extended = word >= EXTENDED
  local is_remote = word % (2 * REMOTE) >= REMOTE
  local is_error = word % (2 * ERROR) >= ERROR
  if not is_extended or is_remote or is_error then return nil end
  return word % MASK
end

-- What the capture cut, C dissectors throw past Lua, and what that takes of Lua's 200 nested calls
-- never comes back: so SocketCAN is not called for half a header, and of a frame that is not ours
-- it sees the captured bytes alone, which is shown as malformed where without us it would be
-- limited in size.  An extended frame may be ours: its ID is taken for one of others when they have
-- thrown once; and when so many IDs have, all are.
local MOST_THROWN = 24
local thrown, thrown_count = {}, 0 -- CAN ids: nothing that was lost comes back with the next file
local cut_id -- of the cut frame that SocketCAN has, while it has it

-- Hands a frame on to SocketCAN.  A malformed one has its item by the time pcall returns, and is no
-- error of ours.
local function hand_on(inner, can_id, tvb, pinfo, tree)
  local length = tvb:len()
  if length < HEADER then return 0 end
  if cut_id then -- it never came back
    thrown[cut_id] = true
    thrown_count = thrown_count + 1
    cut_id = nil
  end
  local seen = tvb
  if length < tvb:reported_len() then
    local is_for_others = not can_id or thrown[can_id] or thrown_count >= MOST_THROWN
    if is_for_others then
      seen = tvb(0, length):tvb()
    else
      cut_id = can_id
    end
  end
  local ok, taken = pcall(inner.call, inner, seen, pinfo, tree)
  cut_id = nil
  return ok and taken or length
end

-- Whose table, what in it, and whether the id is in the host's order, little endian on every
-- machine of today.
local CARRIERS = {
  { "wtap_encap", wtap.SOCKETCAN, false },
  { "sll.ltype", 0x0C, true },
  { "sll.ltype", 0x0D, true },
}
local is_wrapped = false

--- Reads the CAN header of every frame from now on.
-- proto  a Proto for the wrapper
function M.wrap(proto)
  if is_wrapped then return end
  is_wrapped = true
  local carriers = {}
  for _, row in ipairs(CARRIERS) do
    local dissectors, value = DissectorTable.get(row[1]), row[2]
    local inner = dissectors:get_dissector(value)
    if inner then
      carriers[value] = { inner = inner, is_little = row[3], dissectors = dissectors }
    end
  end
  function proto.dissector(tvb, pinfo, tree)
    local carrier = carriers[pinfo.match_uint]
    if not carrier then return 0 end
    -- Records that a little endian machine wrote as they were.
    local is_swapped = pinfo.match_uint == wtap.SOCKETCAN and get_preference("can.byte_swap")
    local can_id = header_id(tvb, carrier.is_little or is_swapped)
    header.number = pinfo.number
    header.can_id = can_id
    return hand_on(carrier.inner, can_id, tvb, pinfo, tree)
  end
  for value, carrier in pairs(carriers) do carrier.dissectors:add(value, proto) end
end

return M
