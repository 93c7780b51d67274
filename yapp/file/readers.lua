-- SPDX-License-Identifier: GPL-2.0-or-later
-- Wireshark's file readers of candump text, Vector's ASC and raw serial dumps, and the facts of the
-- files.  The modules of the formats do the work.

local asc = require "yapp.file.asc"
local candump = require "yapp.file.candump"
local dump = require "yapp.file.dump"

local M = {}

local NO_BUS = {}
local bus -- of the record read last
local latest -- the log opened or read last, or the facts of one left to Wireshark
local other_name -- the first bytes of a file whose name does not end with .yapp

--- Forget all files.  Call it before any reader sees a file: sharkd opens another file without
-- closing the first.
function M.forget()
  bus, latest, other_name = NO_BUS, {}, nil
end
M.forget()

--- Return the bus of the record that was read last.  A dissector can ask on a first pass, where
-- records are read and dissected in turns and fields may be absent.
-- returns  its number and its name, fit to be printed; nil if no reader of ours read the record, or
--          it is of a dump
function M.current()
  return bus.number, bus.name
end

--- Return the facts of the log that was opened or read last, each nil for other files.
-- returns  { has_several = true if it has several buses, by its first lines; drops = list of
--          { count = packets that were lost while capturing, bus = name or nil, frame = number of
--          the packet behind the loss or nil, time = that packet's seconds since 1970 or nil },
--          complete when the file has been read; lacks_times = true if packets have no time stamps;
--          stamps_differ = true if the time stamps of its first frames do;
--          first = { seconds, nanoseconds } of the record that was read first;
--          lacks_clock = true if times are the controllers' own, as in a raw dump;
--          plain_bus = name of the only bus of a log that Wireshark's own reader took, which
--          forgets it on 4.0 and 4.4 }
function M.log()
  return latest
end

-- Fill a record with the results of a log's read or seek_read.
-- returns  its offset; false at the end
local function fill(log, frame, offset, bytes, seconds, nanoseconds, its_bus)
  latest = log
  if not offset then return false end
  frame.rec_type = wtap_rec_types.PACKET
  frame.flags = seconds and wtap_presence_flags.TS or 0
  if seconds then
    frame.time = NSTime.new(seconds, nanoseconds)
    log.first = log.first or { seconds, nanoseconds }
  else
    log.lacks_times = true
  end
  frame.data = bytes
  bus = its_bus or NO_BUS
  return offset
end

-- Register a reader.  (No tail calls: Lua may collect an object that a reader does not hold, and
-- Wireshark writes into it when the reader is back.)
-- title, name  of the reader
-- kind         "rs" is asked before Wireshark's own readers of text, "r" after them
-- encap        link type of its packets
-- open         function(file), which returns a log; or nil, and the facts, as of M.log, of a log
--              that is left to Wireshark's own reader
-- extension    of the files that Wireshark offers to it first, or nil
local function register(title, name, kind, encap, open, extension)
  local handler = FileHandler.new(title, name, title, kind)
  handler.extensions = extension

  function handler.read_open(file, capture)
    bus = NO_BUS
    local log, plain_log = open(file)
    latest = log or plain_log or latest
    if not log then return false end
    capture.encap = encap
    capture.time_precision = log.decimals == 9 and wtap_tsprecs.NSEC or wtap_tsprecs.USEC
    capture.private_table = log
    return true
  end

  function handler.read(file, capture, frame)
    local log = capture.private_table
    local offset = fill(log, frame, log:read(file))
    return offset
  end

  function handler.seek_read(file, capture, frame, offset)
    local log = capture.private_table
    return fill(log, frame, log:seek_read(file, offset)) ~= false
  end

  function handler.read_close() bus = NO_BUS end
  register_filehandler(handler)
end

-- Return the function that reports a text.  Wireshark names no file here.
local function reporter(name)
  return function(text) io.stderr:write(name, ": ", text, "\n") end
end

-- A dump has no mark at its start, and other files may hold YAPP frames.  So a file is a
-- dump only if its name ends with .yapp, or if the user says so.  Wireshark does not tell a reader
-- the name.  It asks the readers without an extension first, unless the file has the extension of
-- another.  So the reader of candump text notes the files that are not .yapp.
local NO_FRAME = "no YAPP frame with a good CRC, and the size that its ID has, in the whole file"
local HEAD = 256 -- bytes by which a file is known again

--- Register the readers with Wireshark.  Call it once.
-- options  of dump.open
function M.register(options)
  local report = reporter("candump reader")
  register("candump text (YAPP reader)", "yapp_candump", "rs", wtap_encaps.SLL2, function(file)
    other_name = file:read(HEAD) or ""
    file:seek("set", 0)
    return candump.open(file, report)
  end)
  local report_asc = reporter("ASC reader")
  register("Vector ASC (YAPP reader)", "yapp_asc", "r", wtap_encaps.SLL2, function(file)
    return asc.open(file, report_asc)
  end, "asc")
  local report_dump = reporter("yapp: not opened as a raw serial dump")
  local encap = wtap_encaps.WIRESHARK_UPPER_PDU
  register("YAPP raw serial dump", "yapp_dump", "r", encap, function(file)
    local head = file:read(HEAD) or ""
    local is_other = head == other_name
    other_name = nil
    if is_other then return nil end
    local log = dump.open(file, options, head)
    if not log then report_dump(head == "" and "the file is empty" or NO_FRAME) end
    return log
  end, "yapp")
end

return M
