-- SPDX-License-Identifier: GPL-2.0-or-later
-- candump text in memory, and the frames in it.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local candump = require("yapp.file.candump")

local M = {}

M.file = require("support").file

-- The log or nil, its file, what it told.
-- is_plain  true if the text may be left to Wireshark's own reader
function M.opened(text, is_plain)
  local told = {}
  local file = M.file(is_plain and text or text .. "\n# for this reader\n")
  local log = candump.open(file, function(message) told[#told + 1] = message end)
  return log, file, told
end

-- What read and seek_read return, as a record.
function M.frame(offset, bytes, seconds, nanoseconds, bus)
  return offset and { offset = offset, bytes = bytes, bus = bus.number, bus_name = bus.name, seconds = seconds,
    nanoseconds = nanoseconds }
end

-- All frames of a text, which read again in another order are the same; nil where it is not taken.
function M.frames_of(text)
  local log, file, told = M.opened(text)
  local frames = {}
  if not log then return nil, told end
  local frame = M.frame(log:read(file))
  while frame do
    frames[#frames + 1] = frame
    frame = M.frame(log:read(file))
  end
  for i = #frames, 1, -1 do
    local one = frames[i * 7919 % #frames + 1]
    lu.assertEquals(M.frame(log:seek_read(file, one.offset)), one)
  end
  return frames, told, log
end

return M
