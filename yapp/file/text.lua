-- SPDX-License-Identifier: GPL-2.0-or-later
-- What readers of CAN logs share: a file's lines, a CAN frame as a packet.  Pure Lua.
local char, find, sub = string.char, string.find, string.sub

local M = {}

local BLOCK = 65536 -- bytes read at once

-- Lines
-- ---------------------------------------------------------------------------------------------

local Lines = {}
Lines.__index = Lines

--- The lines of a file: `text` is the part of it from offset `base` on, the next line begins at
-- `pos`.
-- @param text the first bytes of the file, which is right behind them
function M.lines(text)
  return setmetatable({ text = text, base = 0, pos = 1, number = 0 }, Lines)
end

--- Goes to an offset, inside the text at hand when possible.
function Lines:go_to(file, offset)
  local pos = offset - self.base + 1
  if pos >= 1 and pos <= #self.text then
    self.pos = pos
    return
  end
  file:seek("set", offset)
  self.text, self.base, self.pos = "", offset, 1
end

-- Reads on behind what is left of the text: more, the longer the line is.
-- returns  false at the end of the file
function Lines:read_on(file)
  local rest = sub(self.text, self.pos)
  local more, why = file:read(math.max(BLOCK, #rest))
  self.base = self.base + self.pos - 1
  if why then error("cannot read the line at offset " .. self.base .. ": " .. why, 0) end
  self.text = rest .. (more or "")
  self.pos = 1
  return #self.text > #rest
end

--- Goes on behind a line that somebody else has read in the text.
-- @param pos where the next one begins
-- @return the offset of the line
function Lines:skip_to(pos)
  local offset = self.base + self.pos - 1
  self.pos = pos
  self.number = self.number + 1
  return offset
end

--- The next line.
-- @return the line without its "\n", and its offset; nil at the end
function Lines:next(file)
  local stop = find(self.text, "\n", self.pos, true)
  while not stop and self:read_on(file) do
    stop = find(self.text, "\n", 1, true)
  end
  if not stop and self.pos > #self.text then return nil end
  local line = sub(self.text, self.pos, (stop or 0) - 1)
  return line, self:skip_to((stop or #self.text) + 1)
end

-- Packets
-- -------------------------------------------------------------------------------------------

-- Flags in the upper bits of a SocketCAN id (linux/can.h).
M.EXTENDED = 0x80000000
M.REMOTE = 0x40000000
M.ERROR = 0x20000000

local function big_endian(number)
  local bytes = ""
  for _ = 1, 4 do
    local low = number % 256
    bytes = char(low) .. bytes
    number = (number - low) / 256
  end
  return bytes
end

--- The bytes of a packet before the CAN frame's length: the same for all such frames on a bus.
-- (Wireshark takes the id in the host's order here, and this is the usual one.)
-- @param number of the bus
-- @param record id (32 bits, flags as SocketCAN has them), fd, sent
function M.head(number, record)
  local protocol = record.fd and "\0\13" or "\0\12"
  local sent = record.sent and "\4" or "\0"
  -- Linux cooked capture v2: protocol, reserved, interface index, device type, packet type, no
  -- address
  return protocol .. "\0\0" .. big_endian(number) .. "\1\24" .. sent .. ("\0"):rep(9) ..
    big_endian(record.id):reverse()
end

--- A frame as a packet of link type LINUX_SLL2: the cooked header, the SocketCAN header, the data.
-- @param number of the bus
-- @param record what head needs, and length, flags, raw_dlc (9 to 15, or 0), data
-- @return the bytes, a string
function M.packet(number, record)
  local lengths = char(record.length, record.flags, 0, record.raw_dlc)
  return M.head(number, record) .. lengths .. record.data
end

return M
