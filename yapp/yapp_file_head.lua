-- What the first bytes of a capture file say about the rest.  Pure Lua, 5.2 and 5.4.

local frame = require("yapp_frame")

local M = {}

--- How many bytes to look at: within what Wireshark can rewind on a pipe (128 KB on 4.0).
M.LENGTH = 65536

-- Link types: SocketCAN, exported PDUs, RTAC serial, DLT_USER 0 .. 15, and Linux cooked captures, whose packets have
-- the protocol at this offset: 0x000C for CAN, 0x000D for CAN FD.
local LINKTYPE_SLL2, LINKTYPE_RTAC = 276, 250
local OURS = { [227] = true, [252] = true, [LINKTYPE_RTAC] = true }
for linktype = 147, 162 do OURS[linktype] = true end
local PROTOCOL = { [113] = 14, [LINKTYPE_SLL2] = 0 }

-- Block types of pcapng
local INTERFACE, ENHANCED, SIMPLE, OLD = 1, 6, 3, 2

local function number(head, at, size, little)
  local value = 0
  for i = 0, size - 1 do
    local byte = head:byte(little and at + size - 1 - i or at + i)
    if not byte then return nil end
    value = value * 0x100 + byte
  end
  return value
end

-- Whether a packet of this link type may be ours.
local function is_ours(linktype, head, at)
  local offset = PROTOCOL[linktype]
  local protocol = offset and number(head, at + offset, 2)
  return OURS[linktype] or protocol == 0x0C or protocol == 0x0D
end

local function read_pcap(head, little)
  local linktype = (number(head, 21, 4, little) or 0) % 0x10000 -- above it, what is said of frame check sequences
  local found, at = { packets = #head > 40, sources = linktype == LINKTYPE_RTAC }, 25
  found.later = linktype == LINKTYPE_SLL2
  while found.later and not found.sources do
    local length = number(head, at + 8, 4, little)
    if not length then break end
    found.sources = is_ours(linktype, head, at + 16)
    at = at + 16 + length
  end
  return found
end

local function read_pcapng(head)
  local little = head:sub(9, 12) == "\77\60\43\26"
  local at, linktypes, count = 1, {}, 0
  local found = { packets = false, sources = false, later = true }
  while true do
    local kind, length = number(head, at, 4, little), number(head, at + 4, 4, little)
    if not length or length < 12 then break end
    if kind == INTERFACE then
      local linktype = number(head, at + 8, 2, little)
      linktypes[#linktypes + 1] = linktype or -1
      if OURS[linktype] then count = count + 1 end
      found.sources = found.sources or linktype == LINKTYPE_RTAC or count > 1
    elseif kind == ENHANCED then
      local interface = (number(head, at + 8, 4, little) or 0) + 1
      local linktype = linktypes[interface]
      if PROTOCOL[linktype] and is_ours(linktype, head, at + 28) then
        count, linktypes[interface] = count + 1, -1 -- once
        found.sources = found.sources or linktype == LINKTYPE_SLL2 or count > 1
      end
    end
    found.packets = found.packets or kind == ENHANCED or kind == SIMPLE or kind == OLD
    at = at + length
  end
  return found
end

local READERS = {
  ["\212\195\178\161"] = function(head) return read_pcap(head, true) end,
  ["\161\178\195\212"] = function(head) return read_pcap(head, false) end,
  ["\77\60\178\161"] = function(head) return read_pcap(head, true) end, -- nanoseconds
  ["\161\178\60\77"] = function(head) return read_pcap(head, false) end,
  ["\10\13\13\10"] = read_pcapng,
  ["LOGG"] = function() return { packets = true, sources = true } end, -- Vector BLF, of a CAN logger
}

local function any() return true end

-- Whether a plausible header of a YAPP frame is there.
local function has_header(head)
  local at = frame.find(head, 1)
  while at do
    if frame.judge(head, at, any) then return true end
    at = frame.find(head, at + 1)
  end
  return false
end

-- What looks like a Start of a CAN message with a Seq: CAN CTRL 1, YAPP CTL 0, 8 bytes, the reserved ones 0.  In a
-- SocketCAN record (big endian, or little in cooked captures) and as a candump writes it.
local NUMBERED_STARTS = {
  "[\128-\159].@[^\0]\8.........\0\0", "[^\0]@.[\128-\159]\8.........\0\0",
  "[01]%x%x%x40%x[1-9A-F]#" .. ("%x"):rep(12) .. "0000", "[01]%x%x%x40[1-9A-F]0#" .. ("%x"):rep(12) .. "0000",
  "[01]%x%x%x40%x[1-9A-F] [^\n]- 00 00", "[01]%x%x%x40[1-9A-F]0 [^\n]- 00 00",
}

local function has_numbered_starts(head)
  for _, pattern in ipairs(NUMBERED_STARTS) do
    if head:find(pattern) then return true end
  end
  return false
end

--- Reads a file's first bytes.
-- head     string
-- returns  { sources = whether the packets have several buses, interfaces or directions that the file tells apart,
--            later = whether what follows these bytes may have such,
--            frames = whether YAPP frames may be in it: not when it has packets and none of the first has one,
--            numbered = whether it seems to have Starts of CAN messages with a Seq }
function M.read(head)
  local reader = READERS[head:sub(1, 4)]
  local found = reader and reader(head) or {}
  return {
    sources = found.sources or false,
    later = found.later ~= false and (#head == M.LENGTH or not found.packets),
    frames = not found.packets or has_header(head),
    numbered = has_numbered_starts(head),
  }
end

return M
