-- SPDX-License-Identifier: GPL-2.0-or-later
-- Wireshark's file reader for Vector's ASC: thin, everything about the text is in file.asc.lua.
local M = {}

local function fill(frame, record, data)
  frame.rec_type = wtap_rec_types.PACKET
  frame.flags = record.seconds and wtap_presence_flags.TS or 0
  if record.seconds then frame.time = NSTime.new(record.seconds, record.nanoseconds) end
  frame.data = data
end

--- Makes the reader known to Wireshark. To be called once.
-- @param parts { asc = the module file.asc, packet = function(record, bus number, big_endian) -> a packet of
--   LINUX_SLL2,
--   told = a table whose current_bus is the channel of the frame just read, and current_bus_name what it is called: as
--   Wireshark's reader of BLF, CANoe's other format, has it }
function M.register(parts)
  local big_endian, told = Struct.pack("=I4", 1):byte(4) == 1, parts.told
  local handler = FileHandler.new("Vector ASC (YAPP reader)", "yapp_asc", "Vector ASC (YAPP reader)", "r")

  local function forget() told.current_bus, told.current_bus_name = nil, nil end

  local function give(frame, record)
    fill(frame, record, parts.packet(record, record.number, big_endian))
    told.current_bus, told.current_bus_name = record.number, ("CAN-%d"):format(record.number)
  end

  function handler.read_open(file, capture)
    forget()
    local log = parts.asc.open(file)
    if not log then return false end
    capture.encap = wtap_encaps.SLL2
    capture.time_precision = wtap_tsprecs.USEC
    capture.private_table = log
    return true
  end

  function handler.read(file, capture, frame)
    local record, offset = parts.asc.read(capture.private_table, file)
    if not record then return false end
    give(frame, record)
    return offset
  end

  function handler.seek_read(file, capture, frame, offset)
    local record = parts.asc.seek_read(capture.private_table, file, offset)
    if not record then return false end
    give(frame, record)
    return true
  end

  handler.read_close = forget
  handler.extensions = "asc"
  register_filehandler(handler)
end

return M
