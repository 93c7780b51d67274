-- The id of a CAN frame that came to us without one: by Decode As, by a heuristic.  Wireshark's API.
--
-- A dissector that SocketCAN calls gets the payload alone.  Called from the table of ids it finds the id in
-- pinfo.match_uint; else there are the CAN header, which a wrapper around SocketCAN reads (exact, on every pass, at
-- the cost of a name in frame.protocols: only where the user asked for all of a bus), the tree and the Info column.

local M = {}

local EXTENDED, REMOTE, ERROR, MASK = 0x80000000, 0x40000000, 0x20000000, 0x20000000

local Ids = {}
Ids.__index = Ids

--- fields  function(frame number) -> { [filter name] = value } of the tree so far, and whether none of CAN's is missing
function M.new(fields)
  local self = setmetatable({ fields = fields }, Ids)
  self:reset()
  return self
end

--- Forgets the capture file.
function Ids:reset()
  self.number, self.read = 0, 0
  self.is_swapped = get_preference("can.byte_swap") -- of records that a little endian machine wrote as they were
end

--- Notes the id of a frame for those who are asked next; forget it when nobody will ask.
function Ids:note(number, id)
  self.number, self.id = number, id
end

function Ids:forget()
  self.number = 0
end

-- "Ext. ID: 138428416 (0x8404000), Length: 8", as SocketCAN leaves it
-- returns  the text, nil where the columns are not there
local function column(pinfo)
  local text = tostring(pinfo.cols.info)
  return (text:find("ID: ", 1, true) or text:find("^ERR")) and text or nil
end

local function truth(value) return value == true or value == 1 end

--- The id of the current frame.
-- returns  29-bit id; nil where it is not an extended data frame; nil and true where nothing says
function Ids:find(pinfo)
  if self.number == pinfo.number then return self.id end
  local fields, is_whole = self.fields(pinfo.number)
  local id, extended = fields["can.id"], fields["can.flags.xtd"]
  if is_whole then
    local data = truth(extended) and not truth(fields["can.flags.rtr"])
    return data and id and id % MASK or nil
  end
  local text = column(pinfo)
  if not text then return nil, true end
  return not text:find("Remote", 1, true) and tonumber(text:match("Ext%. ID: (%d+)")) or nil
end

--- Whether the current frame is a remote frame: those have no data, but captures give them zeros.
-- returns  true or false; nil where nothing says
function Ids:is_remote(pinfo)
  if self.read == pinfo.number then return self.no_data end
  local fields, is_whole = self.fields(pinfo.number)
  local rtr = fields["can.flags.rtr"]
  if rtr ~= nil then return truth(rtr) end
  if is_whole then return false end -- CAN FD has no remote frames
  local text = column(pinfo)
  if not text then return nil end
  return text:find("Remote", 1, true) ~= nil
end

-- The first word of a SocketCAN record; big endian in its own encapsulation (unless a preference says otherwise), host
-- order in cooked captures.
local function header_id(tvb, little)
  if tvb:len() < 8 then return nil end
  local word = little and tvb(0, 4):le_uint() or tvb(0, 4):uint()
  if word < EXTENDED or word % (2 * REMOTE) >= REMOTE or word % (2 * ERROR) >= ERROR then return nil end
  return word % MASK
end

--- Reads the CAN header of every frame from now on.
-- proto  a Proto for the wrapper
function Ids:wrap(proto)
  if self.wrapped then return end
  self.wrapped = true
  local little = true -- the host's order, on every machine that Wireshark is built for today
  local carriers = {}
  for _, row in ipairs { { "wtap_encap", wtap.SOCKETCAN, false }, { "sll.ltype", 0x0C, little },
    { "sll.ltype", 0x0D, little } } do
    local tables = DissectorTable.get(row[1])
    carriers[#carriers + 1] = { tables = tables, value = row[2], little = row[3], inner = tables:get_dissector(row[2]) }
  end
  function proto.dissector(tvb, pinfo, tree)
    local key = pinfo.match_uint
    for _, carrier in ipairs(carriers) do
      if carrier.value == key and carrier.inner then
        local id = header_id(tvb, carrier.little or key == wtap.SOCKETCAN and self.is_swapped)
        self.read, self.no_data = pinfo.number, not id -- or not extended: then the frame is not ours either
        self:note(pinfo.number, id)
        -- What the capture cut, others throw past Lua, which never gets back what that takes of its stack: so SocketCAN
        -- is not called for half a header, and of a frame that is not ours it sees the captured bytes alone: that is
        -- shown as malformed, where without us it would be limited in size.  A frame that is malformed has its item by
        -- the time pcall returns, and is no error of ours.
        local length = tvb:len()
        if length < 8 then return 0 end
        local seen = not id and length < tvb:reported_len() and tvb(0, length):tvb() or tvb
        local ok, taken = pcall(carrier.inner.call, carrier.inner, seen, pinfo, tree)
        return ok and taken or length
      end
    end
    return 0
  end
  for _, carrier in ipairs(carriers) do
    if carrier.inner then carrier.tables:add(carrier.value, proto) end
  end
end

return M
