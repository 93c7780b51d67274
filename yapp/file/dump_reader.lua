-- SPDX-License-Identifier: GPL-2.0-or-later
-- Wireshark's file reader for raw serial dumps: thin, file.dump.lua does the work.

local M = {}

-- A record is an exported PDU: it names its dissector, and a UDP port type says that it is complete in itself.
local TAG_DISSECTOR, TAG_PORT_TYPE, PORT_TYPE_UDP = 12, 24, 3

local function tag(kind, value)
  value = value .. ("\0"):rep(-#value % 4)
  return Struct.pack(">I2I2", kind, #value) .. value
end

local function exported(dissector)
  return tag(TAG_DISSECTOR, dissector) .. tag(TAG_PORT_TYPE, Struct.pack(">I4", PORT_TYPE_UDP)) ..
    Struct.pack(">I2I2", 0, 0)
end

-- Bytes between frames may look like the start of one, which only what follows them has proved wrong.
local FRAME, SKIPPED = exported("yapp_serial"), exported("yapp_skipped")

local function fill(frame, record)
  frame.rec_type = wtap_rec_types.PACKET
  if record.seconds then
    frame.flags = wtap_presence_flags.TS
    frame.time = NSTime.new(record.seconds, record.nanoseconds)
  else
    frame.flags = 0
  end
  frame.data = (record.skipped and SKIPPED or FRAME) .. record.bytes
end

-- A dump has no mark at its start, and files of others may hold YAPP frames: only what is named .yapp is taken, or
-- what the user says is a dump.  No reader is told the name.  But a file with another name is shown to the readers for
-- any name before it is shown to those for .yapp; so one of the former, which takes nothing, notes what it was shown.
local NO_FRAME = "no YAPP frame with a good CRC, and the size that its ID has, in the whole file"
local HEAD = 256 -- bytes by which a file is known again

local function read_head(file)
  return file:read(HEAD) or ""
end

local function nothing() return false end

-- returns  the reader; function(head) -> whether the file has another name; and function(head) to be told which file
--          was refused for what it holds, as that is shown to the others next
local function name_reader()
  local shown, refused
  local handler = FileHandler.new("YAPP (tells other files from .yapp)", "yapp_name", "Takes no file", "r")

  function handler.read_open(file, _) -- held until the end, see host.facts
    local head = read_head(file)
    if head ~= refused then shown = head end
    refused = nil
    return false
  end
  handler.read, handler.seek_read = nothing, nothing

  local function has_other_name(head)
    local is_shown = shown == head
    shown = nil
    return is_shown
  end
  return handler, has_other_name, function(head) refused = head end
end

--- Makes the reader known to Wireshark.  To be called once.
-- dump        the module file.dump
-- new_framer  function() -> a serial.stream
-- time_of     function(frame bytes) -> seconds, nanoseconds, or nil
function M.register(dump, new_framer, time_of)
  local names, has_other_name, note_refused = name_reader()
  local handler = FileHandler.new("YAPP raw serial dump", "yapp_dump", "Bytes of a UART as they came", "r")
  handler.extensions = "yapp"

  function handler.read_open(file, capture)
    local head = read_head(file)
    if has_other_name(head) then return false end
    local opened = dump.open(file, new_framer, time_of, head)
    if not opened then
      note_refused(head)
      io.stderr:write("yapp: not opened as a raw serial dump: ", head == "" and "the file is empty" or NO_FRAME, "\n")
      return false
    end
    capture.encap = wtap_encaps.WIRESHARK_UPPER_PDU
    capture.time_precision = wtap_tsprecs.NSEC
    capture.private_table = opened
    return true
  end

  function handler.read(file, capture, frame)
    local record = capture.private_table:read(file)
    if not record then return false end
    fill(frame, record)
    return record.offset
  end

  function handler.seek_read(file, capture, frame, offset)
    local record = capture.private_table:read_again(file, offset)
    if not record then return false end
    fill(frame, record)
    return true
  end

  register_filehandler(names)
  register_filehandler(handler)
end

return M
