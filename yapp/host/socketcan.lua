-- SPDX-License-Identifier: GPL-2.0-or-later
-- Facts about the current packet that SocketCAN does not hand on to our dissector: the CAN id of a
-- frame that comes by Decode As or a heuristic; whether a frame is a remote frame; the values of
-- other dissectors' fields.  Wireshark's API.
--
-- SocketCAN hands on the data alone.  It finds our messages in its table of ids, where
-- pinfo.match_uint is the id.  For all other frames a wrapper in front of SocketCAN reads the
-- header.  That is exact on every pass, but costs a name in frame.protocols and about 3 µs a CAN
-- frame.  So it begins only with Decode As, yapp.all_extended or a statistic.  If only statistics
-- are wanted, it ends: a tap, which sees the whole packet, reads the headers that are needed.

local fields_of = require "yapp.capture.fields"
local wrapper = require "yapp.host.wrapper"

local M = {}

local EXTENDED, MASK = 0x80000000, 0x20000000
local HEADER = 8 -- bytes that have the id
local NO_COLUMN = "(info)" -- the text of a column if there are no columns

-- The latest header that was read: { number = of its packet, can_id = 29 bits, nil if it is not of
-- an extended data frame }.
local header = {}

-- Fields ------------------------------------------------------------------------------------------

local NAMES = { ["can.id"] = true, ["can.flags.xtd"] = true, ["can.flags.rtr"] = true }

local function is_true(value) return value == true or value == 1 end

--- Return the id of the current frame, which came by Decode As or by the heuristics.
-- returns  29-bit id; nil if it is no extended data frame; nil and true if nothing tells
function M.find_id(pinfo)
  if header.number == pinfo.number then return header.can_id end
  local fields = fields_of(NAMES)
  local id, extended = fields["can.id"], fields["can.flags.xtd"]
  if id ~= nil and extended ~= nil then return is_true(extended) and id % MASK or nil end
  -- "Ext. ID: 138428416 (0x8404000), Length: 8", as SocketCAN leaves it in the Info column.
  local text = tostring(pinfo.cols.info)
  if not (text:find("ID: ", 1, true) or text:find("^ERR")) then return nil, true end
  return tonumber(text:match("Ext%. ID: (%d+)"))
end

--- Return whether a header, a field or a column says that a frame of zeros is a remote frame:
-- remote frames have no data, but captures give them zeros.  Return nil if nothing says it.
function M.is_remote(pinfo)
  if header.number == pinfo.number then return header.can_id == nil end
  local rtr = fields_of(NAMES)["can.flags.rtr"]
  if rtr ~= nil then return is_true(rtr) end
  local info = tostring(pinfo.cols.info)
  if info == NO_COLUMN then return nil end
  return tostring(pinfo.cols.protocol) ~= "CANFD" and info:find("Remote", 1, true) ~= nil
end

--- Forget the capture file.
function M.init()
  header = {}
end

-- The header in front -----------------------------------------------------------------------------

-- Return the 29-bit id of the first word of a SocketCAN record, nil for no extended data frame.
-- Above the id it has three bits: extended, remote, error.
local function data_id(word)
  return word >= EXTENDED and word < EXTENDED + MASK and word % MASK or nil
end

-- The same of a record; big endian in its own encapsulation (unless a preference says otherwise),
-- host order in cooked captures.
local function header_id(tvb, is_little)
  if tvb:len() < HEADER then return nil end
  return data_id(is_little and tvb(0, 4):le_uint() or tvb(0, 4):uint())
end

--- Return whether the data of a CAN frame may be that of a SocketCAN record, which fills its packet
-- to the end.  In other protocols, several CAN frames may lie in a packet.
function M.is_record(tvb, pinfo)
  local rest = pinfo.len - tvb:offset() -- nothing where a remote frame has its header alone
  return rest >= 0 and rest <= 8 or rest == 64 or rest == tvb:reported_len()
end

--- Return the id that the header in front of a record's data has.
-- tvb       of the whole packet
-- offset    of the data; length = on the bus
-- known_id  the id, nil if it is not known: it proves the header and its byte order
-- returns   29-bit id; nil if it is no extended data frame; known_id if this is no header
function M.id_before(tvb, pinfo, offset, length, known_id)
  local id = known_id
  local has_room = offset >= HEADER and offset <= tvb:len()
  if has_room and tvb(offset - 4, 1):uint() == length then
    local start = tvb(offset - HEADER, 4)
    local word, other = start:uint(), start:le_uint()
    -- Big endian are SocketCAN's own encapsulation and PPI; little endian cooked captures and logs.
    local is_big = offset == HEADER and not get_preference("can.byte_swap") or offset == 2 * HEADER
    if not is_big then word, other = other, word end
    if known_id and word % MASK ~= known_id then word = other end
    if not known_id or word % MASK == known_id then id = data_id(word) end
  end
  header.number, header.can_id = pinfo.number, id
  return id
end

-- Where CAN frames come from: table, value in it, and whether the id is in the host's order, which
-- is little endian on every machine of today.
local SOURCES = {
  { "wtap_encap", wtap.SOCKETCAN },
  { "sll.ltype", 0x0C },
  { "sll.ltype", 0x0D },
}

local function read_header(tvb, pinfo, value)
  -- In its own encapsulation a preference says that a little endian machine wrote the records.
  local is_little = value ~= wtap.SOCKETCAN or get_preference("can.byte_swap")
  header.number, header.can_id = pinfo.number, header_id(tvb, is_little)
end

local wrapper_of_can

--- Read the CAN header of every frame from now on.
-- proto  a Proto for the wrapper
function M.wrap(proto)
  wrapper_of_can = wrapper_of_can or wrapper.new(proto, SOURCES, read_header)
  wrapper_of_can:start()
end

--- Read no more headers.
function M.unwrap()
  if wrapper_of_can then wrapper_of_can:stop() end
end

return M
