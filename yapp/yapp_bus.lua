-- On which bus, interface or direction a packet was captured.  Wireshark's API.
--
-- A dissector is not told.  Fields say it, but only where a tree is built, and a Field extractor would build one for
-- every packet of every capture.  So a file is looked at when it is opened, its first bytes only, and only where
-- these say that it has several sources of ours a tap asks for the fields.

local M = {}

local HEAD = 4096 -- within the first buffer: reading more could not be undone on a pipe
local WANTED = "frame.interface_id || sll.ifindex || rtacser.eventtype"

-- Link types: SocketCAN, DLT_USER 0 .. 15, exported PDUs, RTAC serial
local LINKTYPE_SLL2, LINKTYPE_RTAC = 276, 250
local OURS = { [227] = true, [252] = true, [LINKTYPE_RTAC] = true }
for linktype = 147, 162 do OURS[linktype] = true end

local function number(head, at, size, little)
  local value = 0
  for i = 0, size - 1 do
    local byte = head:byte(little and at + size - 1 - i or at + i)
    if not byte then return nil end
    value = value * 0x100 + byte
  end
  return value
end

-- SLL2 has the protocol first: 0x000C CAN, 0x000D CAN FD.
local function is_can_over_sll2(head, at)
  local protocol = number(head, at, 2)
  return protocol == 0x0C or protocol == 0x0D
end

local function pcap_has_sources(head, little)
  local linktype = number(head, 21, 2, little)
  return linktype == LINKTYPE_RTAC or linktype == LINKTYPE_SLL2 and is_can_over_sll2(head, 41)
end

local function pcapng_has_sources(head)
  local little = head:sub(9, 12) == "\77\60\43\26"
  local at, linktypes, sources = 1, {}, 0
  while true do
    local kind, length = number(head, at, 4, little), number(head, at + 4, 4, little)
    if not length or length < 12 then return sources > 1 end
    if kind == 1 then -- Interface Description Block
      local linktype = number(head, at + 8, 2, little)
      if linktype == LINKTYPE_RTAC then return true end
      if OURS[linktype] then sources = sources + 1 end
      linktypes[#linktypes + 1] = linktype
    elseif kind == 6 then -- Enhanced Packet Block
      local linktype = linktypes[(number(head, at + 8, 4, little) or 0) + 1]
      if linktype == LINKTYPE_SLL2 and is_can_over_sll2(head, at + 28) then return true end
    end
    at = at + length
  end
end

local READERS = {
  ["\212\195\178\161"] = function(head) return pcap_has_sources(head, true) end,
  ["\161\178\195\212"] = function(head) return pcap_has_sources(head, false) end,
  ["\77\60\178\161"] = function(head) return pcap_has_sources(head, true) end, -- nanoseconds
  ["\161\178\60\77"] = function(head) return pcap_has_sources(head, false) end,
  ["\10\13\13\10"] = pcapng_has_sources,
  ["LOGG"] = function() return true end, -- Vector BLF, a CAN logger's
}

--- Whether the first bytes of a capture file say that it has several buses, interfaces or directions.
-- head  string, the first bytes.  Pure.
function M.has_sources(head)
  local reader = READERS[head:sub(1, 4)]
  return reader ~= nil and reader(head)
end

local Buses = {}
Buses.__index = Buses

--- Looks at files from now on.  Call it once.
function M.watch()
  local self = setmetatable({}, Buses)
  -- A reader that never reads: the only place where the API shows a file.
  local handler = FileHandler.new("YAPP's look at interfaces (opens nothing)", "yapp_interfaces",
    "Finds out whether a capture has several buses", "rms")
  handler.extensions = ""
  function handler.read_open(file)
    self.file_has_sources = M.has_sources(file:read(HEAD) or "")
    return false
  end
  function handler.read() return false end
  function handler.seek_read() return false end
  register_filehandler(handler)
  return self
end

--- A new file is about to be dissected.
function Buses:init()
  if self.file_has_sources and not self.tap then
    self.tap = Listener.new("frame", WANTED)
  elseif not self.file_has_sources and self.tap then
    self.tap:remove()
    self.tap = nil
  end
end

--- Fields that are in the tree so far.
-- returns { [filter name] = value }; empty on a pass that builds no tree
function M.fields()
  local found = {}
  for _, info in ipairs { all_field_infos() } do found[info.name] = info.value end
  return found
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
