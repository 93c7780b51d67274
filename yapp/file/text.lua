-- SPDX-License-Identifier: GPL-2.0-or-later
-- What the readers of CAN logs in text share: the lines of a file, and a CAN frame as a packet.  Pure Lua.
local char, find, sub = string.char, string.find, string.sub

local M = {}

local BLOCK = 65536 -- bytes read at once

--- Longer than any line of a log: candump prints 700 characters for 64 bytes in binary digits.
M.LONGEST = 4096

-- Lines ---------------------------------------------------------------------------------------------

local Lines = {}
Lines.__index = Lines

--- The lines of a file: `text` is the part of it from offset `base` on, the next line begins at `pos`.
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

-- Reads a block behind what is left of the text.
-- returns  false at the end of the file
function Lines:read_on(file)
  local rest = sub(self.text, self.pos)
  self.base = self.base + self.pos - 1
  local more, why = file:read(BLOCK)
  if why then error("cannot read on at offset " .. self.base + #rest .. ": " .. why, 0) end
  self.text, self.pos = rest .. (more or ""), 1
  return #self.text > #rest
end

--- The next line.
-- @return the line without its "\n", of one beyond LONGEST its start only, and its offset; nil at the end
function Lines:next(file)
  local stop, start, offset = find(self.text, "\n", self.pos, true), nil, nil
  while not stop do
    if #self.text - self.pos > M.LONGEST then
      start = start or sub(self.text, self.pos, self.pos + M.LONGEST)
      offset = offset or self.base + self.pos - 1
      self.pos = #self.text + 1
    end
    if not self:read_on(file) then break end
    stop = find(self.text, "\n", 1, true)
  end
  if not stop and not start and self.pos > #self.text then return nil end
  stop = stop or #self.text + 1
  start = start or sub(self.text, self.pos, stop - 1)
  offset = offset or self.base + self.pos - 1
  self.pos, self.number = stop + 1, self.number + 1
  return start, offset
end

--- Digits behind a decimal point, in nanoseconds.
function M.nanoseconds(fraction)
  return tonumber(sub(fraction .. "00000000", 1, 9))
end

-- Packets -------------------------------------------------------------------------------------------

-- Flags in the upper bits of a SocketCAN id (linux/can.h).
M.EXTENDED, M.REMOTE, M.ERROR = 0x80000000, 0x40000000, 0x20000000

-- Linux cooked capture v2, big endian: protocol, reserved, interface index, device type, packet type,
-- no address.
local CAN, CAN_FD, ARPHRD_CAN, TO_US, OUTGOING = "\0\12", "\0\13", "\1\24", "\0", "\4"
local RESERVED, NO_ADDRESS = "\0\0", ("\0"):rep(9)

local function big_endian(number)
  local d = number % 0x100
  local c = (number - d) / 0x100 % 0x100
  local b = (number - number % 0x10000) / 0x10000 % 0x100
  return char((number - number % 0x1000000) / 0x1000000, b, c, d)
end

--- The bytes of a packet before the CAN frame's length: the same for all such frames on a bus.
-- @param number of the bus
-- @param record id (32 bits, flags as SocketCAN has them), fd, sent
function M.head(number, record)
  return (record.fd and CAN_FD or CAN) .. RESERVED .. big_endian(number) .. ARPHRD_CAN ..
    (record.sent and OUTGOING or TO_US) .. NO_ADDRESS .. big_endian(record.id):reverse()
end

--- What stands behind the head for so many data bytes: length, flags, reserved, raw DLC.
M.LENGTHS = {}
for length = 0, 8 do M.LENGTHS[length] = char(length, 0, 0, 0) end

--- A frame as a packet of link type LINUX_SLL2: the cooked header, the SocketCAN header, the data.
-- (Wireshark takes the id in the host's order here, and this is the usual one.)
-- @param number of the bus
-- @param record what head needs, and length, flags, raw_dlc (9 to 15, or 0), data
-- @return the bytes, a string
function M.packet(number, record)
  return M.head(number, record) .. char(record.length, record.flags, 0, record.raw_dlc) ..
    record.data
end

return M
