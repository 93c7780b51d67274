-- SPDX-License-Identifier: GPL-2.0-or-later
-- Vector's ASC, the text log of CANoe, CANalyzer and python-can, as packets.  Pure Lua.
--
--   date Tue Nov 14 22:13:20.001 2023
--   base hex  timestamps absolute
--   Begin Triggerblock Tue Nov 14 22:13:20.001 2023
--    0.001000 1  8408000x        Rx   d 8 FD 7F FD 7F FD 7F FD 7F
--    0.002000 CANFD   1 Rx   840C000x                          1 0 d 32 FD 7F ...
local text = require "yapp.file.text"

local M = {}

local HEAD = 4096 -- bytes by which a file is known
local MAX_DATE = 64 -- characters
local BASES = { hex = 16, dec = 10 } -- of ids and data
local SECOND = 1000000 -- times are in microseconds: that many are exact in every Lua

local MONTHS = {}
for name, number in ([[jan 1 jän 1 feb 2 mar 3 mär 3 mrz 3 apr 4 may 5 mai 5 jun 6
  jul 7 aug 8 sep 9 oct 10 okt 10 nov 11 dec 12 dez 12]]):gmatch("(%S+) (%d+)") do
  MONTHS[name] = number
end

-- Times -------------------------------------------------------------------------------------------

local DATE = "(%S+) (%d%d?) (%d%d?):(%d%d):(%d%d)%.?(%d?%d?%d?)%d* ?([ap]?)m? (%d%d%d%d)"
local HALVES = { a = 0, p = 12 } -- of a day

-- Return a date, the recorder's local time, in microseconds since 1970; nil for another text.
--   Tue Nov 14 10:13:20.001 pm 2023
-- python-can writes 1 ms as ".1".
local function read_date(text_of_date)
  local words = text_of_date:sub(1, MAX_DATE):lower():gsub("%s+", " ")
  local date, month, milliseconds, half = {}
  month, date.day, date.hour, date.min, date.sec, milliseconds, half, date.year = words:match(DATE)
  date.month = MONTHS[month]
  if not date.month then return nil end
  if HALVES[half] then date.hour = date.hour % 12 + HALVES[half] end
  local seconds = text.seconds_of(date)
  return seconds and seconds * SECOND + ("0" .. milliseconds) * 1000
end

-- Return the time in front of a line, "12.000123", in microseconds, and what follows; nil without.
local function read_stamp(line)
  local whole, fraction, rest = line:match("^%s*(%d+)%f[%D]%.?(%d*)%s+(.*)$")
  if not rest or #whole > 7 then return nil end -- 115 days
  return whole * SECOND + tonumber((fraction .. "000000"):sub(1, 6)), rest
end

-- A line ------------------------------------------------------------------------------------------

-- Return the id in "8404000x", with SocketCAN's flag of an extended one; nil for another text.
local function read_id(id, base)
  local digits, extended = id:match("^(%x+)(x?)$")
  local value = digits and #digits <= 10 and tonumber(digits, base)
  if not value then return nil end
  if extended == "" then return value < 0x800 and value or nil end
  return value < 0x20000000 and value + text.EXTENDED or nil
end

local BYTE = "^%s*(%x%x?%x?)%f[%X]()"
local BYTES = {}
for _, base in pairs(BASES) do
  BYTES[base] = text.byte_table(function(digits) return tonumber(digits, base) end)
end

-- Fill in "d 8 FD 7F ...", "r 8": a length of 9 to 15 means 8.
local function read_classic(record, rest, base)
  local kind, code, data = rest:match("^([dr])%s*(%x?)%s*(.*)$")
  record.length = math.min(tonumber(code or "", 16) or 0, 8)
  if kind == "r" then
    record.id = record.id + text.REMOTE
    record.data = ""
  elseif kind == "d" and code ~= "" then
    record.data = text.read_bytes(data, record.length, BYTE, BYTES[base])
  end
end

-- BRS, ESI, DLC, length, then data, duration, bits, flags
local FLEXIBLE = "([01])%s+([01])%s+%x%s+(%d+)(.*)$"

-- Fill in a CAN FD frame, with or without a name in front.
local function read_flexible(record, rest, base)
  local brs, esi, length, data = rest:match("^" .. FLEXIBLE)
  if not brs then brs, esi, length, data = rest:match("^%S+%s+" .. FLEXIBLE) end
  record.length = tonumber(length)
  if not length or record.length > 64 then return end
  local stop
  record.data, stop = text.read_bytes(data, record.length, BYTE, BYTES[base])
  local flags = tonumber(data:match("^%s*%d+%s+%d+%s+(%x+)", stop) or "1000", 16)
  if flags % 0x2000 >= 0x1000 then
    record.fd = true
    record.flags = 4 + brs + 2 * esi -- FDF, BRS, ESI
  end
end

-- By the word in front of the channel: what reads the text behind the id.
local FORMS = { [""] = read_classic, CANFD = read_flexible }

--- Read one line.
-- line     without its end
-- base     10 or 16: of the file's ids and data
-- returns  a record { bus = channel, id = with SocketCAN's flags, fd, sent, length, flags,
--          raw_dlc = 0, data }, or nil for a line that is no frame; the time in front of the line
--          in microseconds, or nil; and a reason if the line may have been a frame
function M.parse(line, base)
  local stamp, rest = read_stamp(line)
  if not stamp then return nil end
  local kind, channel, behind = rest:match("^(%a*)%s*(%d%d?%d?)%s+(%S.*)$")
  local read = FORMS[kind]
  if not read then return nil, stamp end
  local record = { bus = tonumber(channel), flags = 0, raw_dlc = 0 }
  if behind:find("^[RTx]*%s*ErrorFrame") then
    record.id = text.ERROR + 0x80 -- a bus error
    record.length = 8
    record.data = ("\0"):rep(8)
    return record, stamp
  end
  local id, direction, data = behind:match("^(%w+)%s+([RT]x)%s+(.*)$")
  if kind == "CANFD" then direction, id, data = behind:match("^([RT]x)%s+(%w+)%s+(.*)$") end
  record.id = id and read_id(id, base)
  if not record.id then return nil, stamp end
  record.sent = direction == "Tx"
  read(record, data, base)
  if not record.data then return nil, stamp, text.DATA end
  return record, stamp
end

-- A file ------------------------------------------------------------------------------------------

-- The channel of an extended frame, classic or CAN FD.
local CHANNEL = "\n[ \t]*[%d.]+[ \tCANFD]+(%d+)[ \tRxT]+%x+x%s"

-- Patterns of lines with a date, by the field of the log that gets the date.
local DATES = {
  date = "^%s*date%f[%s\0](.*)",
  began = "^%s*[Bb]egin%s+[Tt]riggerblock%s+(%S.*)",
}
local NO_DATE = "no such date: times count from the date before, or from 0. Correct it, as in " ..
  '"Tue Nov 14 22:13:20.001 2023"'

-- Take the date of a line, if it has one.
local function take_date(log, line)
  for name, pattern in pairs(DATES) do
    local written = line:match(pattern)
    local date = written and read_date(written)
    if date then log[name] = date elseif written then log:skip(line, NO_DATE) end
  end
end

-- Return the frame in a line, as text.open says.  A block of a log says when it began: python-can
-- counts from there, CANoe from the date of the file.
local function read_record(log, line, offset)
  local record, stamp, why = M.parse(line, log.base)
  if not offset then return record end
  if not stamp then return take_date(log, line) end
  if log.began then
    local is_since_date = math.abs(log.date + stamp - log.began) < 2 * SECOND
    log.start = is_since_date and log.date or log.began
    log.began = nil
  end
  log.clock = log.is_relative and log.clock + stamp or stamp
  if record then
    local number = record.bus
    log.buses[number] = log.buses[number] or { number = number, name = "CAN-" .. number }
    log.times[offset] = (log.start or log.date) + log.clock
  elseif why then
    log:count_unread()
    log:skip(line, why)
  end
  return record
end

--- Open a file if it is ASC.
-- file     with read and seek, at its begin
-- report   function(text), called with what is to be said of a line
-- returns  a log with read and seek_read, whose buses are called as Wireshark's reader of BLF calls
--          them, and { has_several = whether its first lines have several; drops = as readers.log
--          returns them }; nil for another file
function M.open(file, report)
  local head = file:read(HEAD) or ""
  if not head:find("^%s*date%s") then return nil end
  local base, stamps = head:match("\n[ \t]*base[ \t]+(%a+)[ \t]+timestamps[ \t]+(%a+)")
  if not BASES[base] then return nil end
  local first, has_several = head:match(CHANNEL), false
  for channel in head:gmatch(CHANNEL) do has_several = has_several or channel ~= first end
  return text.open(head, report, {
    record = read_record,
    per_second = SECOND,
    has_several = has_several,
    base = BASES[base],
    is_relative = stamps == "relative",
    date = 0, -- of the file
    began = nil, -- the date of a block until its first stamp comes
    start = nil, -- what stamps count from, if not from the date
    clock = 0, -- the last stamp; if they are relative, the sum of all
  })
end

return M
