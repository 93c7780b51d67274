-- SPDX-License-Identifier: GPL-2.0-or-later
-- The headers of CAN frames: SocketCAN hands on their data alone.  Wireshark's API.
--
-- SocketCAN finds our messages in its table of ids, where pinfo.match_uint is the id.  With Decode
-- As or yapp.all_extended a wrapper in front of SocketCAN reads the headers, which costs about 3 µs
-- a frame.  A statistic's tap reads one where nothing else tells what it has (host.can).

local fields_of = require "yapp.capture.fields"
local wrapper = require "yapp.host.wrapper"

local Headers = {}
Headers.__index = Headers

local EXTENDED, MASK = 0x80000000, 0x20000000
local HEADER = 8 -- bytes that have the id
local read_fields = fields_of("can.id can.flags.xtd can.flags.rtr")
-- Where CAN frames come from: table, and value in it.
local ORIGINS = { { "wtap_encap", wtap.SOCKETCAN }, { "sll.ltype", 0x0C }, { "sll.ltype", 0x0D } }

-- Return the id that a header has: 29 bits; nil if it is of no extended data frame.  Above the id
-- its first word has three bits: extended, remote, error.
-- value  of ORIGINS
local function read_id(tvb, _, value)
  -- In its own encapsulation a preference says that a little endian machine wrote the records; in
  -- cooked captures the id is in the host's order, little endian on every machine of today.
  local is_little = value ~= wtap.SOCKETCAN or get_preference("can.byte_swap")
  if tvb:len() < HEADER then return nil end
  local bytes = tvb(0, 4)
  local word = is_little and bytes:le_uint() or bytes:uint()
  return word >= EXTENDED and word < EXTENDED + MASK and word % MASK or nil
end

local function is_true(value) return value == true or value == 1 end

--- Make the reader of headers.
-- proto  Proto for the wrapper
function Headers.new(proto)
  return setmetatable({ wrapper = wrapper.new(proto, ORIGINS, read_id) }, Headers)
end

--- Read the header of every frame from now on.
function Headers:start()
  self.wrapper:start()
end

--- Return the id of the current frame, which did not come through the table of ids.
-- returns  29-bit id; nil if it is no extended data frame; nil and true if nothing tells
function Headers:find_id(pinfo)
  local is_read, header_id = self.wrapper:read(pinfo.number)
  if is_read then return header_id end
  local fields = read_fields()
  local id, extended = fields["can.id"], fields["can.flags.xtd"]
  if id ~= nil and extended ~= nil then return is_true(extended) and id % MASK or nil end
  -- "Ext. ID: 138428416 (0x8404000), Length: 8", as SocketCAN leaves it in the Info column.
  local text = tostring(pinfo.cols.info)
  if not text:find("ID: ", 1, true) then return nil, true end
  return tonumber(text:match("Ext%. ID: (%d+)"))
end

--- Return whether a header or a field says that a frame of zeros is a remote frame: remote frames
-- have no data, but captures give them zeros.  Return nil if nothing says it.
function Headers:is_remote(pinfo)
  local is_read, id = self.wrapper:read(pinfo.number)
  if is_read then return id == nil end
  local remote = read_fields()["can.flags.rtr"]
  if remote ~= nil then return is_true(remote) end
end

return Headers
