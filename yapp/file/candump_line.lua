-- SPDX-License-Identifier: GPL-2.0-or-later
-- A line of what candump prints and logs: the CAN frame that it tells of.  Pure Lua.
--
-- Two forms, after can-utils (lib.c, candump.c), plus the same line pasted from a document:
--   log     (1700000000.000001) can0 08404000#BBBE6FC720000000 R
--   screen   (000.000499)  can0  RX - -  08404000   [8]  BB BE 6F C7 20 00 00 00   '..o. ...'
local text = require("yapp.file.text")

local char, find, gsub = string.char, string.find, string.gsub
local match, rep, sub = string.match, string.rep, string.sub

local M = {}

-- The longest line that candump prints has 64 bytes in binary digits, 700 characters in all.
local LONGEST = 4096

-- Why a line gives no frame.
local EMPTY = "an empty line, skipped"
local COMMENT = "a comment, skipped"
local SAID = "a message of candump's, skipped"
local DROPPED = "candump lost frames"
local UNKNOWN = "not a candump line, skipped"
local LONG = "longer than any candump line, skipped"
local TIME = "no such time, line skipped"
local ID = "no such CAN id, line skipped"
local DATA = "the data bytes do not fit, line skipped"
-- What there is to say about a line with a frame.
local BEHIND = "text behind the frame, ignored"
local REPAIRED = "letters that look like hex digits, read as such"

--- Of no interest in the packet list, and no reason to doubt that a file is candump's.
M.HARMLESS = { [EMPTY] = true, [COMMENT] = true, [SAID] = true }

-- Lines without a frame; candump -e prints what an error frame means, below it and behind a tab.
local OTHERS = {
  { "^%s*$", EMPTY },
  { "^%s*[#;/]", COMMENT },
  { "^DROPCOUNT: ", DROPPED },
  { "^Enabling Logfile '", SAID },
  { "while logging[.!]?%s*$", SAID },
  { "^\t%l+%-[%l-]+%f[{%s\0]" },
}

-- Two hex digits, or the eight binary ones of candump -i, to a byte; nil for other texts.
local BASES = { [2] = 16, [8] = 2 }
local BYTES = setmetatable({}, { __index = function(bytes, digits)
  local base = BASES[#digits]
  local value = base and tonumber(digits, base)
  if not value then return nil end
  local byte = char(value)
  bytes[digits] = byte
  return byte
end })

--- The id with SocketCAN's flags for 3 (standard) or 8 (extended, or error) hex digits, or nil.
function M.id(digits)
  local id = tonumber(digits, 16)
  if #digits == 3 and id < 0x800 then return id end
  if #digits ~= 8 or id >= 2 * text.ERROR then return nil end
  return id < text.ERROR and id + text.EXTENDED or id
end

-- A date, local time as Wireshark shows it: seconds since 1970, and the digits of the fraction.
local function read_date(stamp)
  local year, month, day, hour, min, sec, fraction =
    match(stamp, "^(%d%d%d%d)%-(%d%d)%-(%d%d) (%d%d):(%d%d):(%d%d)%.(%d+)$")
  if not year or year < "1970" or month > "12" then return nil end
  local date = { year = year, month = month, day = day, hour = hour, min = min, sec = sec }
  return os.time(date), fraction
end

-- Fills in the time that stands in the parentheses, or returns why it cannot.  An absolute time has
-- ten digits at least: candump pads it.
local function read_stamp(record, stamp)
  local digits, fraction = match(stamp, "^(%d+)%.(%d+)$")
  local seconds = tonumber(digits)
  record.is_relative = digits ~= nil and #digits < 10
  if not digits then seconds, fraction = read_date(stamp) end
  if not seconds or digits and #digits > 12 then return TIME end
  record.seconds = seconds
  record.nanoseconds = tonumber(sub(fraction .. "00000000", 1, 9))
end

local function make_remote(record, length)
  record.id = record.id + text.REMOTE
  record.length = length
  record.data = rep("\0", length)
end

-- A log, what stands behind "#": ##<flags><data> of CAN FD, R<length>_<DLC>, <data>_<DLC>.
local function read_log(record, data, behind)
  local is_known = behind == "" or behind == "R" or behind == "T"
  if not is_known then record.note = BEHIND end
  record.sent = behind == "T"
  record.is_relative = false
  local length, dlc = match(data, "^R(%d?)_?(%x?)$")
  local flags, hex = match(data, "^#(%x)(%x*)$")
  if flags then
    record.fd = true
    record.flags = tonumber(flags, 16)
  elseif not length then
    hex, dlc = match(data, "^(%x*)_?(%x?)$")
  end
  record.raw_dlc = tonumber(dlc or "", 16) or 0
  if length then return make_remote(record, tonumber(length) or 0) end
  if not hex or #hex % 2 ~= 0 then return DATA end
  record.data, record.length = gsub(hex, "%x%x", BYTES)
end

-- The data bytes on the screen.  Between them is a blank, or with -S, which turns them around, a
-- "`".  Behind them stands nothing, ERRORFRAME, or in quotes the bytes as ASCII.
local function read_bytes(record, data)
  local bytes, at = {}, 1
  for i = 1, record.length do
    local digits, stop = match(data, "^[%s`]+(%x+)()", at)
    bytes[i] = BYTES[digits or ""]
    if not bytes[i] then return DATA end
    at = stop
  end
  local is_known = find(data, "^%s*$", at) or find(data, "^%s+['`E]", at)
  if not is_known then return DATA end
  record.data = table.concat(bytes)
  if find(sub(data, 1, at - 1), "`", 1, true) then record.data = record.data:reverse() end
end

-- The screen, what stands behind the id: [8] classic, [08] CAN FD, {E} classic with the raw DLC
-- (-8).
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
  if find(data, "^%s+remote request%s*$") then return make_remote(record, length) end
  return read_bytes(record, data)
end

-- A line's time, and what is behind it: in a log, on the screen, and there with -x the direction
-- and the flags of CAN FD.
local STAMP = "^%s*%(([^()]+)%)%s+(.*)$"
local LOG = "^(%S+)%s+(%x+)#(%S*)%s*(.-)%s*$"
local SCREEN = "^%s*(%S+)%s+(%x+)%s+([%[{])(%x%x?)[%]}](.*)$"
local DIRECTION = "^(%s*%S+)%s+([RT])X ([B-]) ([E-])(%s.*)$"
local FLAGS = { B = 1, E = 2 }

-- Fills in what stands behind the id, or returns why it cannot.
local function fill(record, stamp, read, ...)
  if not record.id then return ID end
  local why = stamp and read_stamp(record, stamp) or read(record, ...)
  if why then return why end
  local most = record.fd and 64 or 8
  return record.length > most and DATA or nil
end

-- The frame in a line, or nil and why there is none.
local function frame_of(line)
  local stamp, rest = match(line, STAMP)
  rest = rest or line
  local front, way, brs, esi, back = match(rest, DIRECTION)
  if front then rest = front .. back end
  local read, bus, id, a, b, c = read_log, match(rest, LOG)
  if not stamp or not bus then
    read, bus, id, a, b, c = read_screen, match(rest, SCREEN)
  end
  if not bus then return nil, UNKNOWN end
  local record = {
    bus = bus,
    id = M.id(id),
    fd = false,
    sent = way == "T",
    flags = (FLAGS[brs] or 0) + (FLAGS[esi] or 0),
    raw_dlc = 0,
    is_relative = false,
  }
  local why = fill(record, stamp, read, a, b, c)
  if not why then return record end
  return nil, stamp and why or UNKNOWN
end

-- What stands for digits in the candump lines of the vendor's document: three Greek and two
-- Cyrillic letters, an O, and circles; and the space of a page that they were copied from.
local LOOK_ALIKES = {
  ["\206\146"] = "B",
  ["\206\149"] = "E",
  ["\206\152"] = "0",
  ["\208\151"] = "3",
  ["\208\177"] = "6",
  ["\194\160"] = " ",
}

-- The line with such letters as the digits they stand for.
local function repaired(line)
  line = gsub(line, "[\194\206\208][\128-\191]", LOOK_ALIKES)
  line = gsub(line, "%$\\odot \\odot%$", "00")
  return (gsub(line, "(%x)O%f[%s\0]", "%10"))
end

--- Reads one line.
-- @param line text without its line end; colours are dropped
-- @return the frame: bus (its name), id (32 bits, flags as SocketCAN has them), fd, flags (CAN FD:
--   1 BRS, 2 ESI), length (bytes, or the DLC of a remote frame), data (a string of that length,
--   zero in a remote frame), raw_dlc (9 to 15 or 0), sent; seconds, nanoseconds and is_relative
--   unless there is no time; note (what is to say about the line, or nil).  Otherwise nil and a
--   reason, or nil alone for a line of -e below a frame.
function M.parse(line)
  if #line > LONGEST then return nil, LONG end
  line = gsub(line, "\27%[[%d;]*m", "")
  local record, why = frame_of(line)
  if record then return record end
  local readable = repaired(line)
  record = readable ~= line and frame_of(readable)
  if record then
    record.note = REPAIRED
    return record
  end
  for _, other in ipairs(OTHERS) do
    if find(line, other[1]) then return nil, other[2] end
  end
  return nil, why
end

--- Reads a line of the usual form in one step: a classic data frame in a log, nothing behind it.
--   (1700000000.000001) can0 08404000#BBBE6FC720000000
-- @param lines text with the line in it
-- @param at where the line begins
-- @return seconds and nanoseconds, the bus, the id's digits, the data bytes, and where the next
--   line begins; nil for any other line
function M.usual(lines, at)
  local seconds, fraction, bus, digits, hex, stop =
    match(lines, "^%((%d+)%.(%d%d%d%d%d%d)%) (%S+) (%x+)#(%x*)\r?\n()", at)
  if not stop or #hex > 16 or #hex % 2 ~= 0 or #seconds > 12 then return nil end
  local data = gsub(hex, "%x%x", BYTES)
  return tonumber(seconds), tonumber(fraction) * 1000, bus, digits, data, stop
end

return M
