-- What other layers say of a packet: its bus, interface or direction, its CAN id.  Wireshark's API.
--
-- A dissector is not told.  Fields say it, but only where a tree is built, and a Field extractor would build one for
-- every packet of every capture.  So a file is looked at when it is opened, its first bytes only, and only where
-- these say that it has several sources of ours a tap asks for the fields.  A CAN id is asked for where there is a tree
-- without it: Wireshark 4.4 and later leave out what nobody wants.

local M = {}

local WANTED = "frame.interface_id || sll.ifindex || rtacser.eventtype"
local CAN_WANTED = "can.id || can.flags.xtd || can.flags.rtr || canfd.flags.brs"
local NAMES = {}
for name in (WANTED .. " || " .. CAN_WANTED):gmatch("[%w_.]+") do NAMES[name] = true end

local Buses = {}
Buses.__index = Buses

--- Looks at files from now on.  Call it once.
-- head  the module yapp_file_head
function M.watch(head)
  local self = setmetatable({ found = head.read(""), says_bus = {}, numbers = {}, count = 0 }, Buses)
  -- A reader that never reads: the only place where the API shows a file.
  local handler = FileHandler.new("YAPP's look at files (opens none)", "yapp_look", "Looks at the first bytes", "rms")
  function handler.read_open(file)
    self.found = head.read(file:read(head.LENGTH) or "")
    return false
  end
  function handler.read() return false end
  function handler.seek_read() return false end
  register_filehandler(handler)
  return self
end

local function remove(tap)
  if tap then tap:remove() end
end

--- A new file is about to be dissected.
function Buses:init()
  if self.found.sources then
    self.tap = self.tap or Listener.new("frame", WANTED)
  else
    remove(self.tap)
    self.tap = nil
  end
  remove(self.can_tap)
  self.can_tap, self.asked_at, self.says_bus, self.numbers, self.count = nil, nil, {}, {}, 0
end

--- Whether the file tells several sources apart, by its first bytes.
function Buses:are_several()
  return self.found.sources
end

--- Whether the file may have YAPP frames in TCP or UDP, by its first bytes.
function Buses:may_have_frames()
  return self.found.frames
end

-- all_field_infos raises where there is no tree; and on 4.0 the value of an item without bytes, such as a packet
-- comment, throws past Lua: only what is wanted is asked for its value.
local function by_name(ok, ...)
  local found = {}
  if ok then
    for _, info in ipairs { ... } do
      local name = info.name
      if NAMES[name] then found[name] = info.value end
    end
  end
  return found, ok
end

--- The fields of a CAN frame that are in the tree so far, from the next frame on if nobody wanted them.
-- number   of the frame
-- returns { [filter name] = value }, empty on a pass that builds no tree; and whether none is left out
function Buses:can_fields(number)
  local fields, has_tree = by_name(pcall(all_field_infos))
  if not has_tree then return fields, false end
  local is_asked = self.can_tap and self.asked_at ~= number
  local is_whole = fields["can.id"] ~= nil and fields["can.flags.xtd"] ~= nil and
    (is_asked or fields["can.flags.rtr"] ~= nil or fields["canfd.flags.brs"] ~= nil)
  if not is_whole and not self.can_tap then
    self.can_tap, self.asked_at = Listener.new("frame", CAN_WANTED), number
  end
  return fields, is_whole
end

local DIRECTION = { 0, 1, 0, 1 } -- of RTAC events: data sent, data received, ...

-- The number of a source: 1, 2, 3, as they show.  (Exact for a million interfaces of 2^32 indexes each.)
function Buses:number(interface, index, direction)
  local source = interface * 2 ^ 33 + index * 2 + direction
  local number = self.numbers[source]
  if not number then
    number = self.count + 1
    self.numbers[source], self.count = number, number
  end
  return number
end

--- Where the current packet was captured: a number, nil where the capture does not say, false where only this pass
-- does not.
function Buses:current(pinfo)
  if not self.tap and not self.found.later then return nil end
  local visited = pinfo.visited
  if self.says_bus[visited] == false then return false end
  local fields = by_name(pcall(all_field_infos))
  local interface, index, event = fields["frame.interface_id"], fields["sll.ifindex"], fields["rtacser.eventtype"]
  local says_bus = interface ~= nil or index ~= nil or event ~= nil
  -- One or the other for all of a pass: a message does not begin on a bus and end on none.
  if self.says_bus[visited] == nil then self.says_bus[visited] = says_bus end
  if not says_bus then return false end
  return self:number(interface or 0, index or 0, DIRECTION[event] or 0)
end

return M
