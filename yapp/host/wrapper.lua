-- SPDX-License-Identifier: GPL-2.0-or-later
-- A Proto of ours in front of dissectors of Wireshark's: it sees the header that they keep to
-- themselves, and hands each packet on.  It costs a name in frame.protocols and 1 to 3 µs a packet,
-- so it runs only where YAPP needs it.  Wireshark's API.

local Wrapper = {}
Wrapper.__index = Wrapper

-- A dissector of Wireshark's may throw past Lua at bytes that the capture lacks.  Each time Lua
-- loses two of its 200 nested calls for good.  So after this many a truncated packet is handed on
-- as if no more than the captured bytes had been sent: then the dissector raises an error of Lua's.
local MAX_THROWN = 24
local open = 0 -- calls for truncated packets that have not returned

--- Make a wrapper, which does nothing before Wrapper:start.
-- proto    Proto
-- entries  list of { name of a DissectorTable, value in it, name of the dissector that Wireshark
--          has there }; the name is needed where Wireshark takes the dissector away when it reloads
--          its Lua plugins
-- before   function(tvb, pinfo, value) -> what the header says, nil for nothing
-- after    function(header, tvb, pinfo, tree), called once the packet is shown, if `before` had
--          something to say; or nil
function Wrapper.new(proto, entries, before, after)
  return setmetatable({
    proto = proto,
    entries = entries,
    before = before,
    after = after,
    inner = nil, -- [value] = the dissector of Wireshark's, while it runs
    number = nil, -- of the packet that is dissected, and what its header says
    header = nil,
  }, Wrapper)
end

-- Let Wireshark dissect a packet.
-- returns  the number of bytes that it took
local function call_inner(inner, tvb, pinfo, tree)
  local length = tvb:len()
  local is_truncated = length < tvb:reported_len()
  if is_truncated and open >= MAX_THROWN then
    if length == 0 then return 0 end
    tvb, is_truncated = tvb(0, length):tvb(), false
  end
  local count = is_truncated and 1 or 0
  open = open + count
  local ok, taken = pcall(inner.call, inner, tvb, pinfo, tree) -- Wireshark shows the error
  open = open - count
  return ok and taken or length
end

-- Dissect a packet.
local function dissect(self, tvb, pinfo, tree)
  local value = pinfo.match_uint
  local header = self.before(tvb, pinfo, value)
  self.number, self.header = pinfo.number, header
  local taken = call_inner(self.inner[value], tvb, pinfo, tree)
  if self.after and header then self.after(header, tvb, pinfo, tree) end
  return taken
end

--- Begin to see packets.
function Wrapper:start()
  if self.inner then return end
  self.inner = {}
  function self.proto.dissector(...) return dissect(self, ...) end
  for _, entry in ipairs(self.entries) do
    local dissectors, value, name = DissectorTable.get(entry[1]), entry[2], entry[3]
    local inner = dissectors:get_dissector(value) or name and Dissector.get(name)
    self.inner[value] = inner
    if inner then dissectors:add(value, self.proto) end
  end
end

--- Return whether the header of a packet was read, and what it says.
-- number  of the packet
function Wrapper:read(number)
  return self.number == number, self.header
end

return Wrapper
