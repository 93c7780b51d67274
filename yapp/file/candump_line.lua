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
local XL = "CAN XL is not supported, line skipped"
-- What there is to say about a line with a frame.
local BEHIND = "text behind the frame, ignored"
local REPAIRED = "letters that look like hex digits, read as such"

--- Of no interest in the packet list, and no reason to doubt that a file is candump's.
M.HARMLESS = { [EMPTY] = true, [COMMENT] = true, [SAID] = true }

-- Lines without a frame; candump -e prints what an error frame means, below it and behind a tab.
local OTHERS = {
  { "^%s*$", EMPTY },
  { "^%s*[#;]", COMMENT },
  { "^%s*//", COMMENT },
  { "^DROPCOUNT: ", DROPPED },
  { "^Enabling Logfile '", SAID },
  { "while logging[.!]?%s*$", SAID },
  { "^\t%l+%-[%l-]+%f[{%s\0]" },
}

-- Two hex digits, or the eight binary ones of candump -i, to a byte.
local BYTES = setmetatable({}, { __index = function(bytes, digits)
  local byte = char(tonumber(digits, #digits == 2 and 16 or 2))
  bytes[digits] = byte
  return byte
end })

-- So many bytes on the screen, in hex and in binary digits, and what stands behind them.  Between
-- them is a blank, or with -S, which turns them around, a "`".
local ON_SCREEN = { [0] = { "^(%s-)(.*)$" } }
for count = 1, 64 do
  ON_SCREEN[count] = {
    "^(" .. rep("[%s`]+%x%x", count) .. ")%f[%X](.*)$",
    "^(" .. rep("[%s`]+" .. rep("[01]", 8), count) .. ")%f[%X](.*)$",
  }
end

--- The id with SocketCAN's flags for 3 (standard) or 8 (extended, or error) hex digits, or nil.
function M.id(digits)
  local id = tonumber(digits, 16)
  if #digits == 3 and id < 0x800 then return id end
  if #digits ~= 8 or id >= 2 * text.ERROR then return nil end
  return id < text.ERROR and id + text.EXTENDED or id
end

-- Fills in the time that stands in the parentheses, or returns why it cannot.  An absolute time has
-- ten digits at least: candump pads it.  A date is local time, as Wireshark shows it.
local function read_stamp(record, stamp)
  local seconds, fraction = match(stamp, "^(%d+)%.(%d+)$")
  if seconds then
    record.seconds, record.is_relative = tonumber(seconds), #seconds < 10
    if #seconds > 12 then return TIME end
  else
    local year, month, day, hour, min, sec, part =
      match(stamp, "^(%d%d%d%d)%-(%d%d)%-(%d%d) (%d%d):(%d%d):(%d%d)%.(%d+)$")
    if not year or year < "1970" or month > "12" then return TIME end
    local date = { year = year, month = month, day = day, hour = hour, min = min, sec = sec }
    record.seconds = os.time(date)
    fraction = part
  end
  record.nanoseconds = tonumber(sub(fraction .. "00000000", 1, 9))
end

local function make_remote(record, length)
  record.id, record.length, record.data = record.id + text.REMOTE, length, rep("\0", length)
end

-- What stands behind "#" in a log: ##<flags><data> of CAN FD, R<length>_<DLC>, <data>_<DLC>.
local function read_log(record, data, behind)
  local flags, hex = match(data, "^#(%x)(%x*)$")
  local length, dlc = match(data, "^R(%d?)_?(%x?)$")
  if flags then
    record.fd, record.flags = true, tonumber(flags, 16)
  elseif length then
    make_remote(record, tonumber(length) or 0)
  else
    hex, dlc = match(data, "^(%x*)_?(%x?)$")
    if not hex then return DATA end
  end
  record.raw_dlc = tonumber(dlc or "", 16) or 0
  if hex then
    if #hex % 2 ~= 0 then return DATA end
    record.data, record.length = gsub(hex, "%x%x", BYTES)
  end
  record.is_relative = false
  record.sent = behind == "T"
  if behind ~= "" and behind ~= "R" and behind ~= "T" then record.note = BEHIND end
end

-- The data bytes on the screen, and what stands behind them: nothing, ERRORFRAME, or the bytes as
-- ASCII is candump's own.
local function read_bytes(record, data)
  local patterns = ON_SCREEN[record.length]
  local digits, behind = match(data, patterns[1])
  if not digits then digits, behind = match(data, patterns[2]) end
  if not digits then return DATA end
  record.data = gsub(digits, "[%s`]+(%x+)", BYTES)
  if find(digits, "`", 1, true) then record.data = record.data:reverse() end
  if find(behind, "^%s*$") or find(behind, "^%s+ERRORFRAME%s*$") then return nil end
  local _, ascii = match(behind, "^%s+(['`])(.*)%1%s*$")
  if ascii and #ascii == record.length then return nil end
  -- Without a time a line is candump's only if all of it is; too many bytes are never right.
  if not record.seconds or find(behind, "^%S") then return DATA end
  if find(behind, "^%s+%x%x%f[%X]") then return DATA end
  record.note = BEHIND
end

-- What stands behind the id on the screen: [8] classic, [08] CAN FD, {E} classic with the raw DLC
-- (-8).
local function read_screen(record, open, length, data)
  record.fd = #length == 2
  length = tonumber(length, open == "{" and 16 or 10)
  if open == "{" and length and length > 8 then length, record.raw_dlc = 8, length end
  if not length or length > 64 then return DATA end
  record.length = length
  if not find(data, "^%s+remote request%s*$") then return read_bytes(record, data) end
  if record.fd then return DATA end
  make_remote(record, length)
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
  if not record.id then return find((...), "^%x%x:") and XL or ID end
  local why = stamp and read_stamp(record, stamp) or read(record, ...)
  if not why and record.length > (record.fd and 64 or 8) then why = DATA end
  return why
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
  if why then return nil, stamp and why or UNKNOWN end
  return record
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
  return (gsub(gsub(line, "%$\\odot \\odot%$", "00"), "(%x)O%f[%s\0]", "%10"))
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
