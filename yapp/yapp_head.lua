-- What the first bytes of a capture file say about the rest.  Pure Lua, 5.2 and 5.4.

local M = {}

--- How many bytes to look at: within what Wireshark can rewind on a pipe (128 KB on 4.0).
M.LENGTH = 65536

-- Link types: SocketCAN, DLT_USER 0 .. 15, exported PDUs, RTAC serial
local LINKTYPE_SLL2, LINKTYPE_RTAC = 276, 250
local OURS = { [227] = true, [252] = true, [LINKTYPE_RTAC] = true }
for linktype = 147, 162 do OURS[linktype] = true end

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

-- SLL2 has the protocol first: 0x000C CAN, 0x000D CAN FD.
local function is_can_over_sll2(head, at)
  local protocol = number(head, at, 2)
  return protocol == 0x0C or protocol == 0x0D
end

local function read_pcap(head, little)
  local linktype = (number(head, 21, 4, little) or 0) % 0x10000 -- above it, what is said of frame check sequences
  return {
    packets = #head > 40,
    sources = linktype == LINKTYPE_RTAC or linktype == LINKTYPE_SLL2 and is_can_over_sll2(head, 41),
  }
end

local function read_pcapng(head)
  local little = head:sub(9, 12) == "\77\60\43\26"
  local at, linktypes, count = 1, {}, 0
  local found = { packets = false, sources = false }
  while true do
    local kind, length = number(head, at, 4, little), number(head, at + 4, 4, little)
    if not length or length < 12 then break end
    if kind == INTERFACE then
      local linktype = number(head, at + 8, 2, little)
      linktypes[#linktypes + 1] = linktype or -1
      if OURS[linktype] then count = count + 1 end
      found.sources = found.sources or linktype == LINKTYPE_RTAC or count > 1
    elseif kind == ENHANCED then
      local linktype = linktypes[(number(head, at + 8, 4, little) or 0) + 1]
      found.sources = found.sources or linktype == LINKTYPE_SLL2 and is_can_over_sll2(head, at + 28)
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

-- Whether a plausible header of a YAPP frame is there: "YP", an ID up to 2047, reserved bytes 0.
local function has_header(head)
  local at = head:find("YP", 1, true)
  while at do
    local id1, id2, id3, _, _, reserved0, reserved1 = head:byte(at + 5, at + 11)
    if reserved1 and id1 <= 7 and id2 == 0 and id3 == 0 and reserved0 == 0 and reserved1 == 0 then return true end
    at = head:find("YP", at + 1, true)
  end
  return false
end

--- Reads a file's first bytes.
-- head     string
-- returns  { sources = whether the packets have several buses, interfaces or directions that the file tells apart,
--            frames = whether YAPP frames may be in it: not when it has packets and none of the first has one }
function M.read(head)
  local reader = READERS[head:sub(1, 4)]
  if not reader then return { sources = false, frames = true } end
  local found = reader(head)
  return { sources = found.sources or false, frames = not found.packets or has_header(head) }
end

return M
