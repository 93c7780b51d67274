-- SPDX-License-Identifier: GPL-2.0-or-later
-- Wireshark's file reader for candump text: thin, everything about the text is in file.candump.lua.
local PACKET, HAS_TIME = wtap_rec_types.PACKET, wtap_presence_flags.TS
local NSTime = NSTime

local M = {}

--- Number of the bus the record just read came from; nil when no candump text is being read. A dissector can
-- ask on a first pass, where records are read and dissected in turns and fields may not be there. It must set this
-- to nil in its init: sharkd opens another file without closing the first.
M.current_bus = nil
--- Its name, fit to be printed; the same holds for it.
M.current_bus_name = nil
--- The name of the one bus of the log that was opened last, where Wireshark's own reader took it: of 4.0 and 4.4 that
-- reader forgets the name. Nil for any other file.
M.plain_bus = nil

-- Two readers of one kind. The first is asked before Wireshark's own and takes what that gets wrong or not at
-- all. The second is asked last, so it serves who names it: -X "read_format:yapp_candump" takes any candump text.
local READERS = {
  { "candump text (YAPP reader, automatic)", "yapp_candump_auto", "rs", all = false },
  { "candump text (YAPP reader)", "yapp_candump", "r", all = true },
}

-- Wireshark names no file here.
local function report(text)
  io.stderr:write("candump reader: ", text, "\n")
end

local function set_time(frame, seconds, nanoseconds)
  if seconds then
    frame.flags = HAS_TIME
    frame.time = NSTime.new(seconds, nanoseconds)
  else
    frame.flags = 0
  end
end

local function fill(frame, bytes, bus, comment)
  frame.rec_type = PACKET
  frame.data = bytes
  if comment then frame.comment = comment end
  M.current_bus, M.current_bus_name = bus.number, bus.name
end

local function forget()
  M.current_bus, M.current_bus_name = nil, nil
end

-- Whether Wireshark's own reader takes 00000000 for a standard id.
local function goes_by_value()
  local major, minor = get_version():match("^(%d+)%.(%d+)")
  return major ~= nil and (tonumber(major) > 4 or tonumber(major) == 4 and tonumber(minor) >= 5)
end

local function make_reader(candump, row, big_endian)
  local options = { all = row.all, report = report, by_value = goes_by_value(), big_endian = big_endian }
  local handler = FileHandler.new(row[1], row[2], row[1], row[3])

  function handler.read_open(file, capture)
    forget()
    local log
    log, M.plain_bus = candump.open(file, options)
    if not log then return false end
    capture.encap = wtap_encaps.SLL2
    capture.time_precision = log.decimals == 9 and wtap_tsprecs.NSEC or wtap_tsprecs.USEC
    capture.private_table = log
    return true
  end

  function handler.read(file, capture, frame)
    local offset, bytes, bus, seconds, nanoseconds, comment = candump.read(capture.private_table, file)
    if not offset then return false end
    set_time(frame, seconds, nanoseconds)
    fill(frame, bytes, bus, comment)
    return offset
  end

  function handler.seek_read(file, capture, frame, offset)
    local found, bytes, bus, seconds, nanoseconds, comment = candump.seek_read(capture.private_table, file, offset)
    if not found then return false end
    set_time(frame, seconds, nanoseconds)
    fill(frame, bytes, bus, comment)
    return true
  end

  handler.read_close = forget
  return handler
end

--- Makes the readers known to Wireshark. To be called once.
-- @param candump the module file.candump
function M.register(candump)
  local big_endian = Struct.pack("=I4", 1):byte(4) == 1
  for _, row in ipairs(READERS) do register_filehandler(make_reader(candump, row, big_endian)) end
end

return M
