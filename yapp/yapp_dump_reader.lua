-- Wireshark's file reader for raw serial dumps: thin, yapp_dump.lua does the work.

local M = {}

-- A record is an exported PDU: it names its dissector, and a UDP port type says that it is complete in itself.
local TAG_DISSECTOR, TAG_PORT_TYPE, PORT_TYPE_UDP = 12, 24, 3

local function tag(kind, value)
  value = value .. ("\0"):rep(-#value % 4)
  return Struct.pack(">I2I2", kind, #value) .. value
end

local EXPORTED = tag(TAG_DISSECTOR, "yapp_serial") .. tag(TAG_PORT_TYPE, Struct.pack(">I4", PORT_TYPE_UDP)) ..
  Struct.pack(">I2I2", 0, 0)

local function fill(frame, record)
  frame.rec_type = wtap_rec_types.PACKET
  frame.flags = wtap_presence_flags.TS
  frame.time = NSTime.new(record.seconds, record.nanoseconds)
  frame.data = EXPORTED .. record.bytes
end

--- Makes the reader known to Wireshark.  To be called once.
-- dump        the module yapp_dump
-- new_framer  function() -> a yapp_stream
-- time_of     function(frame bytes) -> seconds, nanoseconds, or nil
function M.register(dump, new_framer, time_of)
  local handler = FileHandler.new("YAPP raw serial dump", "yapp_dump", "Bytes of a UART as they came", "r")
  handler.extensions = "yapp"

  function handler.read_open(file, capture)
    if not dump.recognise(file, new_framer) or not file:seek("set", 0) then return false end
    capture.encap = wtap_encaps.WIRESHARK_UPPER_PDU
    capture.time_precision = wtap_tsprecs.NSEC
    capture.private_table = dump.new(new_framer, time_of)
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

  register_filehandler(handler)
end

return M
