-- SPDX-License-Identifier: GPL-2.0-or-later
-- Wireshark's file readers of candump text, Vector's ASC and raw serial dumps, and the bus of the
-- record that one of them read last: thin, the modules of the formats do the work.
local asc = require("yapp.file.asc")
local candump = require("yapp.file.candump")
local dump = require("yapp.file.dump")

local PACKET, HAS_TIME = wtap_rec_types.PACKET, wtap_presence_flags.TS
local NSTime = NSTime

local M = {}

-- Of the record read last; and of a log that Wireshark's own reader takes.
local NO_BUS = {}
local current, plain = NO_BUS, nil

--- Where the record that was read last came from.  A dissector can ask on a first pass, where
-- records are read and dissected in turns and fields may not be there.
-- @return the number of its bus, and the bus's name, fit to be printed; nil where it was read by no
--   reader of ours, or is of a dump
function M.current()
  return current.number, current.name
end

--- The name of the one bus of the log that was opened last, where Wireshark's own reader took it:
-- of 4.0 and 4.4 that reader forgets the name.  Nil for any other file.
function M.plain_bus()
  return plain
end

--- A file is looked at: nothing is known of it.  To be called before any reader sees it: sharkd
-- opens another file without closing the first.
function M.forget()
  current, plain = NO_BUS, nil
end

-- Fills a record with what a log's read or seek_read returned.
local function fill(frame, offset, bytes, seconds, nanoseconds, bus, comment)
  if not offset then return false end
  frame.rec_type = PACKET
  frame.flags = seconds and HAS_TIME or 0
  if seconds then frame.time = NSTime.new(seconds, nanoseconds) end
  if comment then frame.comment = comment end
  frame.data = bytes
  current = bus or NO_BUS
  return offset
end

-- What all readers do alike; what is theirs is open(file), which returns a log or nil.  (No tail
-- calls: what a reader does not hold may be collected, and Wireshark writes into it when the reader
-- is back.)
local function register(title, name, kind, row)
  local handler = FileHandler.new(title, name, title, kind)
  handler.extensions = row.extension

  function handler.read_open(file, capture)
    current = NO_BUS
    local log = row.open(file)
    if not log then return false end
    capture.encap = row.encap
    capture.time_precision = log.decimals == 9 and wtap_tsprecs.NSEC or wtap_tsprecs.USEC
    capture.private_table = log
    return true
  end

  function handler.read(file, capture, frame)
    local offset = fill(frame, capture.private_table:read(file))
    return offset
  end

  function handler.seek_read(file, capture, frame, offset)
    return fill(frame, capture.private_table:seek_read(file, offset)) ~= false
  end

  function handler.read_close() current = NO_BUS end
  register_filehandler(handler)
end

-- Wireshark names no file here.
local function report(text)
  io.stderr:write("candump reader: ", text, "\n")
end

-- Whether Wireshark's own reader takes 00000000 for a standard id.
local function goes_by_value()
  local major, minor = get_version():match("^(%d+)%.(%d+)")
  return (tonumber(major) or 0) * 100 + (tonumber(minor) or 0) >= 405
end

-- Two readers of one kind.  The first is asked before Wireshark's own and takes what that gets
-- wrong or not at all.  The second is asked last, so it serves who names it: -X
-- "read_format:yapp_candump" takes any candump text.
local function register_candump(title, name, kind, takes_all)
  local options = { all = takes_all, report = report, by_value = goes_by_value() }
  local function open(file)
    local log
    log, plain = candump.open(file, options)
    return log
  end
  register(title, name, kind, { open = open, encap = wtap_encaps.SLL2 })
end

-- A dump has no mark at its start, and files of others may hold YAPP frames: only what is named
-- .yapp is taken, or what the user says is a dump.  No reader is told the name.  But a file with
-- another name is shown to the readers for any name before it is shown to those for .yapp; so one
-- of the former, which takes nothing, notes what it was shown.
local NO_FRAME = "no YAPP frame with a good CRC, and the size that its ID has, in the whole file"
local HEAD = 256 -- bytes by which a file is known again

local function register_dump(options)
  -- The first bytes of what has another name; and of what was refused for what it holds, as that is
  -- shown to the others next.
  local shown, refused

  local function note_name(file)
    local head = file:read(HEAD) or ""
    if head ~= refused then shown = head end
    refused = nil
  end

  local function open(file)
    local head = file:read(HEAD) or ""
    local has_other_name = shown == head
    shown = nil
    if has_other_name then return nil end
    local log = dump.open(file, options, head)
    if log then return log end
    refused = head
    local why = head == "" and "the file is empty" or NO_FRAME
    io.stderr:write("yapp: not opened as a raw serial dump: ", why, "\n")
  end

  register("YAPP (tells other files from .yapp)", "yapp_name", "r", { open = note_name })
  register("YAPP raw serial dump", "yapp_dump", "r",
    { open = open, encap = wtap_encaps.WIRESHARK_UPPER_PDU, extension = "yapp" })
end

--- Makes the readers known to Wireshark.  To be called once.
-- @param options what dump.open needs
function M.register(options)
  register_candump("candump text (YAPP reader, automatic)", "yapp_candump_auto", "rs", false)
  register_candump("candump text (YAPP reader)", "yapp_candump", "r", true)
  register("Vector ASC (YAPP reader)", "yapp_asc", "r",
    { open = asc.open, encap = wtap_encaps.SLL2, extension = "asc" })
  register_dump(options)
end

return M
