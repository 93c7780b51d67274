-- SPDX-License-Identifier: GPL-2.0-or-later
-- Vector's ASC, the text log of CANoe, CANalyzer, BUSMASTER, python-can, log2asc and loggers, as
-- packets.  Pure Lua.
--
--   date Tue Nov 14 22:13:20.001 2023
--   base hex  timestamps absolute
--   Begin Triggerblock Tue Nov 14 22:13:20.001 2023
--    0.001000 1  8408000x        Rx   d 8 FD 7F FD 7F FD 7F FD 7F
--    0.002000 CANFD   1 Rx   840C000x                          1 0 d 32 FD 7F ...
--
-- The programs differ: BUSMASTER leaves out "timestamps", others all of the head; some write "rx",
-- "D", a decimal comma, tabs.  Stamps in front of a trigger are negative.
local text = require "yapp.file.text"

local M = {}

local HEAD = 4096 -- bytes by which a file is known
local MAX_DATE = 64 -- characters
local SECOND = 1000000 -- times are in microseconds: that many are exact in every Lua
local EPOCH = 1000000000 * SECOND -- a stamp from here on is the time since 1970

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
local function parse_date(text_of_date)
  local words = text_of_date:sub(1, MAX_DATE):lower():gsub("%s+", " ")
  local date, month, milliseconds, half = {}
  month, date.day, date.hour, date.min, date.sec, milliseconds, half, date.year = words:match(DATE)
  date.month = MONTHS[month]
  if not date.month then return nil end
  if HALVES[half] then date.hour = date.hour % 12 + HALVES[half] end
  local seconds = text.seconds_of(date)
  return seconds and seconds * SECOND + ("0" .. milliseconds) * 1000
end

-- Return the time in front of a line, "-12.000123", in microseconds, and the text behind it; nil
-- without.
local function parse_stamp(line)
  local sign, whole, fraction, rest = line:match("^%s*(%-?)(%d+)%f[%D][.,]?(%d*)%s+(.*)$")
  if not rest or #whole > 10 then return nil end
  local time = whole * SECOND + tonumber((fraction .. "000000"):sub(1, 6))
  return sign == "-" and -time or time, rest
end

-- Return the nanoseconds, 0 to 999, that parse_stamp leaves out.
local function parse_rest(line)
  local digits = line:match("^%s*%d+[.,]%d%d%d%d%d%d(%d%d?%d?)%d*%s")
  return digits and tonumber((digits .. "00"):sub(1, 3)) or 0
end

-- A line ------------------------------------------------------------------------------------------

local UNKNOWN = "not an ASC line, skipped"
local ID = text.ID
local DATA = text.DATA

-- Lines without a time.
local PLAIN = {
  "^%s*$", "^%s*//", "^%s*;", "^%s*date%f[^%a]", "^%s*base%f[^%a]", "internal events logged",
  "^%s*begin trigger", "^%s*end trigger",
}
-- The texts behind a time in a line without a frame: of a channel, of another network, of J1939
-- (whose frames have lines of their own), and a request to send (the frame has a line of its own).
local EVENTS = {
  "^%d+%s+statistic:", "^%d+%s+overloadframe", "^%d+%s+j1939%a*%s", "^%d+%s+%w+%s+txrq%s",
  "^canfd%s+%d+%s+txrq%s", "^canxl%s", "^can%s+%d+%s+status:", "^l%d*%s", "^li?n?%d*%s", "^eth%s",
  "^fr%w*%s", "^most%d*%s", "^j%d+%a*%s", "^sv:", "^a429%a*%s",
}
-- With one of these behind the time, a line may have been a frame.
local LIKE_FRAMES = { "^%d+%s", "^%d+$", "^canfd%f[^%a]", "%f[%a][rt]x%f[^%a]" }

-- Return why a line without a frame was not understood, nil if it is known.
-- rest  the text behind its time, nil without a time
local function reason_of(line, rest)
  if not rest then return not text.has_one_of(line:lower(), PLAIN) and UNKNOWN or nil end
  local lower = rest:lower()
  local is_unknown = text.has_one_of(lower, LIKE_FRAMES) and not text.has_one_of(lower, EVENTS)
  return is_unknown and UNKNOWN or nil
end

-- Return the id in "8404000x", with SocketCAN's flag of an extended one; nil for another text.
local function parse_id(id, base)
  local digits, extended = id:match("^(%x+)([xX]?)$")
  local value = digits and #digits <= 10 and tonumber(digits, base)
  if not value then return nil end
  if extended == "" then return value < 0x800 and value or nil end
  return value < 0x20000000 and value + text.EXTENDED or nil
end

local BYTE = "^%s*(%x%x?%x?)%f[%X]()"
local BYTES = {}
for _, base in ipairs { 10, 16 } do
  BYTES[base] = text.byte_table(function(digits) return tonumber(digits, base) end)
end

-- Fill in "d 8 FD 7F ...", "r 8": a length of 9 to 15 means 8.
local function parse_classic(record, rest, base)
  local kind, code, data = rest:match("^([dDrR])%s*(%x?)%s*(.*)$")
  record.length = math.min(tonumber(code or "", 16) or 0, 8)
  if kind == "r" or kind == "R" then
    record.id = record.id + text.REMOTE
    record.data = ""
  elseif kind and code ~= "" then
    record.data = text.parse_bytes(data, record.length, BYTE, BYTES[base])
  end
end

-- BRS, ESI, DLC, length, then data, duration, bits, flags
local FLEXIBLE = "([01])%s+([01])%s+%x%d?%s+(%d+)(.*)$"

-- Fill in a CAN FD frame, with or without a name in front.
local function parse_flexible(record, rest, base)
  local brs, esi, length, data = rest:match("^" .. FLEXIBLE)
  if not brs then brs, esi, length, data = rest:match("^%S+%s+" .. FLEXIBLE) end
  record.length = tonumber(length)
  if not length or record.length > 64 then return end
  local stop
  record.data, stop = text.parse_bytes(data, record.length, BYTE, BYTES[base])
  local flags = tonumber(data:match("^%s*%d+%s+%d+%s+(%x+)", stop) or "1000", 16)
  if flags % 0x2000 >= 0x1000 then
    record.fd = true
    record.flags = 4 + brs + 2 * esi -- FDF, BRS, ESI
  end
end

-- By the word in front of the channel: the function that reads the text behind the id; the pattern
-- of id and direction, and whether the direction is in front.
local FORMS = {
  [""] = { read = parse_classic, pattern = "^(%w+)%s+([RrTt])[Xx]%s+(.*)$" },
  CANFD = { read = parse_flexible, pattern = "^([RrTt])[Xx]%s+(%w+)%s+(.*)$", is_turned = true },
}

--- Read one line.
-- line     without its end
-- base     10 or 16: of the file's ids and data
-- returns  a record { bus = channel, id = with SocketCAN's flags, fd, sent, length, flags,
--          raw_dlc = 0, data }, or nil for a line without a frame; the time in front of the line
--          in microseconds, or nil; and a reason if the line was not understood
function M.parse(line, base)
  local stamp, rest = parse_stamp(line)
  if not stamp then return nil, nil, reason_of(line) end
  local kind, channel, behind = rest:match("^(%a*)%s*(%d%d?%d?)%s+(%S.*)$")
  local form = FORMS[(kind or "none"):upper()]
  if not form then return nil, stamp, reason_of(line, rest) end
  local record = { bus = tonumber(channel), flags = 0, raw_dlc = 0 }
  if behind:find("^[RrTtXx]*%s*[Ee]rror[Ff]rame") then
    record.id = text.ERROR + 0x80 -- a bus error
    record.length = 8
    record.data = ("\0"):rep(8)
    return record, stamp
  end
  local id, direction, data = behind:match(form.pattern)
  if form.is_turned then id, direction = direction, id end
  if not id then return nil, stamp, reason_of(line, rest) end
  record.id = parse_id(id, base)
  if not record.id then return nil, stamp, ID end
  record.sent = direction == "T" or direction == "t"
  form.read(record, data, base)
  if not record.data then return nil, stamp, DATA end
  return record, stamp
end

-- A file ------------------------------------------------------------------------------------------

-- Patterns of lines with a date, by the field of the log that gets the date.
local DATES = {
  date = "^%s*date%f[%s\0](.*)",
  began = "^%s*[Bb]egin%s+[Tt]riggerblock%s+(%S.*)",
}
local NO_DATE = "no such date: times count from the date before, or from 0. Correct it, as in " ..
  '"Tue Nov 14 22:13:20.001 2023"'

-- Set the date of a log from a line, if it has one.
local function set_date(log, line)
  for name, pattern in pairs(DATES) do
    local written = line:match(pattern)
    local date = written and parse_date(written)
    if date then log[name] = date elseif written then log:skip(line, NO_DATE) end
  end
end

-- Set log.clock, the time of a line's frame, from the stamp in front of it.  A block has the time
-- when it began: python-can counts from there, CANoe from the date of the file.
local function set_clock(log, line, stamp)
  if log.began then
    local date = log.date or 0
    local is_since_date = math.abs(date + stamp - log.began) < 2 * SECOND
    log.start, log.began = is_since_date and date or log.began, nil
  end
  if log.is_relative then
    log.rest = log.rest + parse_rest(line)
    stamp = log.sum + stamp + math.floor(log.rest / 1000)
    log.rest = log.rest % 1000
  end
  log.sum = stamp
  -- Without a date, times count from 0; from a whole second later if the first is below 0.
  log.start = log.start or log.date or math.max(0, math.ceil(-stamp / SECOND)) * SECOND
  log.clock = log.sum + (log.sum < EPOCH and log.start or 0)
end

-- Return the frame in a line, as text.open says.
local function parse_record(log, line, offset)
  local record, stamp, why = M.parse(line, log.base)
  if not offset then return record end
  if why then log:lose(line, why) end
  if not stamp then return set_date(log, line) end
  set_clock(log, line, stamp)
  if record then
    local number = record.bus
    log.buses[number] = log.buses[number] or { number = number, name = "CAN-" .. number }
    log.times[offset] = log.clock
  end
  return record
end

-- Read the first lines by a base.
-- returns  { base; frames = how many lines are frames; others = how many may be damaged ones or
--          another format's; has_several = true if the extended frames are of several channels;
--          stamps_differ = true if the stamps of frames do }
local function survey(lines, base)
  local found = { base = base, frames = 0, others = 0, has_several = false, stamps_differ = false }
  local channel, first
  for line in lines:gmatch("[^\r\n]+") do
    local record, stamp, why = M.parse(line, base)
    if record then
      found.frames = found.frames + 1
      first = first or stamp
      found.stamps_differ = found.stamps_differ or stamp ~= first
      local its_channel = record.id >= text.EXTENDED and record.bus or channel
      channel = channel or its_channel
      found.has_several = found.has_several or its_channel ~= channel
    elseif why then
      found.others = found.others + 1
    end
  end
  return found
end

-- Return whether lines begin as ASC does, with a date, a base, a comment or a time; and their
-- words about the base, "hex" and "timestamps relative", or nil.
local function parse_head(lines)
  local is_asc, base, rest
  for line in lines:gmatch("[^\r\n]+") do
    local word, value, more = line:match("^%s*(%a+)%f[%s]%s*(%S*)(.*)$")
    if word == "base" then base, rest = value, more end
    if is_asc == nil and line:find("%S") and not line:find("^%s*//") then
      is_asc = word == "date" or word == "base" or parse_stamp(line) ~= nil
    end
  end
  return is_asc, base, rest
end

local BASES = { hex = 16, dec = 10 } -- of ids and data

-- Read the first lines by the base in which more of them are frames: "160 107" is not hexadecimal.
local function survey_both(lines)
  local in_hex, in_dec = survey(lines, BASES.hex), survey(lines, BASES.dec)
  return in_dec.frames > in_hex.frames and in_dec or in_hex
end

-- Return the facts of the first lines of a file, nil if it is not ASC: those of survey, and
-- is_relative = true if times are those since the line before.  A file whose head says no base
-- needs more frames than other lines.
local function recognise(head)
  local lines = (#head < HEAD and head or head:match("^.*\n") or ""):gsub("^\239\187\191", "")
  local is_asc, said, rest = parse_head(lines)
  if not is_asc or said and not BASES[said] then return nil end
  local found = said and survey(lines, BASES[said]) or survey_both(lines)
  found.is_relative = (rest or ""):find("^%s*timestamps%s+relative") ~= nil
  return (said or found.frames > found.others) and found or nil
end

--- Open a file if it is ASC.
-- file     with read and seek, at its begin
-- report   function(text), called with a note on a line
-- returns  a log with read and seek_read, whose buses are called as Wireshark's reader of BLF calls
--          them, and { has_several = true if its first lines have several; drops = as readers.log
--          returns them }; nil for another file
function M.open(file, report)
  local head = file:read(HEAD) or ""
  local log = recognise(head)
  if not log then return nil end
  log.record, log.per_second = parse_record, SECOND
  log.date = nil -- of the file
  log.began = nil -- the date of a block until its first stamp comes
  log.start = nil -- the time that stamps count from, if not from the date
  log.sum = 0 -- the last stamp; if they are relative, the sum of all
  log.rest = 0 -- nanoseconds that the sum leaves out
  log.clock = 0 -- the time of the last line
  return text.open(head, report, log)
end

return M
