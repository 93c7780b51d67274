-- On which bus, interface or direction a packet was captured.  Wireshark's API.
--
-- A dissector is not told.  Fields say it, but only where a tree is built, and a Field extractor would build one for
-- every packet of every capture.  So a file is looked at when it is opened, its first bytes only, and only where
-- these say that it has several sources of ours a tap asks for the fields.

local M = {}

local WANTED = "frame.interface_id || sll.ifindex || rtacser.eventtype"

local Buses = {}
Buses.__index = Buses

--- Looks at files from now on.  Call it once.
-- head  the module yapp_head
function M.watch(head)
  local self = setmetatable({ found = head.read("") }, Buses)
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

--- A new file is about to be dissected.
function Buses:init()
  if self.found.sources and not self.tap then
    self.tap = Listener.new("frame", WANTED)
  elseif not self.found.sources and self.tap then
    self.tap:remove()
    self.tap = nil
  end
end

--- Whether the file may have YAPP frames in TCP or UDP, by its first bytes.
function Buses:may_have_frames()
  return self.found.frames
end

-- all_field_infos raises where there is no tree.
local function by_name(ok, ...)
  local found = {}
  if ok then
    for _, info in ipairs { ... } do found[info.name] = info.value end
  end
  return found
end

--- Fields that are in the tree so far.
-- returns { [filter name] = value }; empty on a pass that builds no tree
function M.fields()
  return by_name(pcall(all_field_infos))
end

local DIRECTION = { 0, 1, 0, 1 } -- of RTAC events: data sent, data received, ...

--- Where the current packet was captured: a number, nil where the capture (or this pass) does not say.
function Buses:current()
  if not self.tap then return nil end
  local fields = M.fields()
  local interface, index, event = fields["frame.interface_id"], fields["sll.ifindex"], fields["rtacser.eventtype"]
  if not interface and not index and not event then return nil end
  return (interface or 0) * 0x20000 + (index or 0) % 0x10000 * 2 + (DIRECTION[event] or 0)
end

return M
