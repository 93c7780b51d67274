-- SPDX-License-Identifier: GPL-2.0-or-later
-- A line of what candump prints and logs: the CAN frame in it.  Pure Lua.
--
-- Its forms, after can-utils (lib.c, candump.c), are rows of FORMS, or of OTHERS if it has no
-- frame.  A row of FORMS begins behind the CAN id; read_head reads what stands in front.  A line
-- pasted from a document has these forms, too.
local text = require("yapp.file.text")

local match = string.match

local M = {}

-- Why a line gives no frame.
local UNKNOWN = "not a candump line, skipped"
local TIME = "no such time, line skipped"
local ID = "no such CAN id, line skipped"
local DATA = "the data bytes do not fit, line skipped"
-- Notes about a line with a frame.
local BEHIND = "text behind the frame, ignored"
local REPAIRED = "letters that look like hex digits, read as such"

-- Lines without a frame: a pattern, a reason, and whether they are harmless.  candump -e prints
-- below an error frame, behind a tab, what it means.
local OTHERS = {
  { "^%s*$", "an empty line, skipped", true },
  { "^%s*[#;/]", "a comment, skipped", true },
  { "^Enabling Logfile '", "a message of candump's, skipped", true },
  { "while logging[.!]?%s*$", "a message of candump's, skipped", true },
  { "^DROPCOUNT: ", "candump lost frames" },
  { "^\t%l+%-[%l-]+%f[{%s\0]" },
}

--- Return the id with SocketCAN's flags for 3 (standard) or 8 (extended, or error) hex digits, or
-- nil.
function M.id(digits)
  local id = tonumber(digits, 16)
  if #digits == 3 and id < 0x800 then return id end
  if #digits ~= 8 or id >= 2 * text.ERROR then return nil end
  return id < text.ERROR and id + text.EXTENDED or id
end

-- Times
-- ---------------------------------------------------------------------------------------------

local latest, latest_seconds = "", nil -- date: many frames are of one second

-- Return the seconds since 1970 of a date, local time as Wireshark shows it; nil for another text.
local function read_date(date)
  if date == latest then return latest_seconds end
  local parts = {}
  parts.year, parts.month, parts.day, parts.hour, parts.min, parts.sec =
    date:match("^(%d%d%d%d)%-(%d%d)%-(%d%d) (%d%d):(%d%d):(%d%d)$")
  latest, latest_seconds = date, parts.year and text.seconds_of(parts)
  return latest_seconds
end

-- Fill in the time in the parentheses, or return why not.  An absolute time has ten digits at
-- least: candump pads it.
local function read_stamp(record, stamp)
  local whole, fraction = stamp:match("^%f[%d]([%d%-: ]*%d)%.(%d+)$")
  if not whole then return TIME end
  record.seconds = #whole <= 12 and tonumber(whole) or read_date(whole)
  record.nanoseconds = tonumber((fraction .. "00000000"):sub(1, 9))
  record.is_relative = #whole < 10
  return not record.seconds and TIME or nil
end

-- Data
-- ---------------------------------------------------------------------------------------------

local function fill_remote(record, length)
  record.id = record.id + text.REMOTE
  record.length = length
  record.data = ("\0"):rep(length)
end

-- Fill in the data that a log has behind "#": ##<flags><data> of CAN FD, R<length>_<DLC>,
-- <data>_<DLC>.
local function read_log(record, data, way, stop, line)
  local has_more = stop <= #line
  if has_more then record.note = BEHIND end
  record.sent = way == "T" and not has_more
  record.is_relative = false
  local length, dlc = data:match("^R(%d?)_?(%x?)$")
  local flags, hex = data:match("^#(%x)(%x*)$")
  if flags then
    record.fd = true
    record.flags = tonumber(flags, 16)
  elseif not length then
    hex, dlc = data:match("^(%x*)_?(%x?)$")
  end
  record.raw_dlc = tonumber(dlc or "", 16) or 0
  if length then return fill_remote(record, tonumber(length) or 0) end
  if not hex or #hex % 2 ~= 0 then return DATA end
  record.data, record.length = hex:gsub("%x%x", text.BYTES)
end

-- Fill in what the screen has behind the id: [8] classic, [08] CAN FD, {E} classic with the raw DLC
-- (-8).  Between the bytes is a blank, or with -S, which turns them around, a "`".  Behind them is
-- nothing, ERRORFRAME, or in quotes the bytes as ASCII.
local function read_screen(record, open, digits, data)
  local is_raw = open == "{"
  local length = tonumber(digits, is_raw and 16 or 10)
  if not length then return DATA end
  if is_raw and length > 8 then
    record.raw_dlc = length
    length = 8
  end
  record.fd = #digits == 2
  record.length = length
  if data:find("^%s+remote request%s*$") then return fill_remote(record, length) end
  local bytes, stop = text.read_bytes(data, length, "^[%s`]+(%x+)()", text.BYTES)
  if not bytes or not data:find("^%s*$", stop) and not data:find("^%s+['`E]", stop) then
    return DATA
  end
  record.data = data:sub(1, stop - 1):find("`", 1, true) and bytes:reverse() or bytes
end

-- A line
-- ---------------------------------------------------------------------------------------------

-- Forms of a line with a frame: a pattern of what follows the id, and what reads it.  needs_time: a
-- line without a time is of another program.
local FORMS = {
  -- (1700000000.000001) can0 08404000#BBBE6FC720000000 R
  { "^#(%S*)%s*([RT]?)%s*()", read = read_log, needs_time = true },
  --  (000.000499)  can0  RX - -  08404000   [8]  BB BE 6F C7 20 00 00 00   '..o. ...'
  { "^%s+([%[{])(%x%x?)[%]}](.*)$", read = read_screen },
}

-- Return what stands in front of an id: the time, the bus, with -x the direction and the flags of
-- CAN FD; then the id and the index behind it.  Each may be nil.
local function read_head(line)
  local stamp, first = match(line, "^%s*%(([^()]+)%)%s+()")
  local bus, second = match(line, "^%s*(%S+)%s+()", first)
  if not bus then return nil end
  local way, brs, esi, third = match(line, "^([RT])X ([B-]) ([E-])%s+()", second)
  local id, behind = match(line, "^(%x+)()", third or second)
  local flags = (brs == "B" and 1 or 0) + (esi == "E" and 2 or 0)
  return stamp, bus, way == "T", flags, id, behind
end

-- Fill in time and data, or return why not.
local function fill(record, stamp, form, line, a, b, c)
  if not record.id then return ID end
  local why = stamp and read_stamp(record, stamp) or form.read(record, a, b, c, line)
  local max_length = record.fd and 64 or 8
  return why or record.length > max_length and DATA or nil
end

-- Return the frame in a line, or nil and why there is none.
local function frame_of(line)
  local stamp, bus, sent, flags, id, behind = read_head(line)
  for _, form in ipairs(FORMS) do
    local a, b, c = match(line, form[1], behind)
    if id and a and (stamp or not form.needs_time) then
      local record = {
        bus = bus, id = M.id(id), fd = false, sent = sent, flags = flags, raw_dlc = 0,
        is_relative = false,
      }
      local why = fill(record, stamp, form, line, a, b, c)
      if not why then return record end
      return nil, stamp and why or UNKNOWN
    end
  end
  return nil, UNKNOWN
end

-- Characters that stand for digits in the candump lines of the vendor's document: three Greek and
-- two Cyrillic letters, an O, and circles; and the space of a page that they were copied from.
local LOOK_ALIKES = {}
for letter, digit in
  ("\206\146B\206\149E\206\1520\208\1513\208\1776\194\160 "):gmatch("([\194-\208].)(.)") do
  LOOK_ALIKES[letter] = digit
end

-- Return the line with such letters as the digits that they stand for.
local function repaired(line)
  line = line:gsub("[\194\206\208][\128-\191]", LOOK_ALIKES)
  line = line:gsub("%$\\odot \\odot%$", "00")
  return (line:gsub("(%x)O%f[%s\0]", "%10"))
end

--- Read one line.
-- line     text without its line end; colours are dropped
-- returns  the frame: { bus = name, id = with SocketCAN's flags, fd, flags = of CAN FD: 1 BRS, 2
--          ESI; length = bytes, or the DLC of a remote frame; data = string, zero in a remote
--          frame; raw_dlc = 9 to 15, or 0; sent; seconds, nanoseconds, is_relative = nil without a
--          time; note = what is to be said of the line, or nil }.  For a line without a frame: nil;
--          a reason, nil for what -e prints below a frame; true if the line is harmless: the packet
--          list need not report it, and the file may still be candump's
function M.parse(line)
  line = line:gsub("\27%[[%d;]*m", "")
  local record, why = frame_of(line)
  if record then return record end
  local readable = repaired(line)
  record = readable ~= line and frame_of(readable)
  if record then
    record.note = REPAIRED
    return record
  end
  for _, other in ipairs(OTHERS) do
    if line:find(other[1]) then return nil, other[2], other[3] end
  end
  return nil, why
end

return M
