-- SPDX-License-Identifier: GPL-2.0-or-later
-- Vector's ASC, the text log of CANoe, CANalyzer, python-can and log2asc, as packets.  Pure Lua.
--
--   date Tue Nov 14 22:13:20.001 2023
--   base hex  timestamps absolute
--   Begin Triggerblock Tue Nov 14 22:13:20.001 2023
--    0.001000 1  8408000x        Rx   d 8 FD 7F FD 7F FD 7F FD 7F
--    0.002000 CANFD   1 Rx   840C000x                          1 0 d 32 FD 7F ...
--
-- The programs differ in small things: "rx", "D", tabs.  Stamps in front of a trigger are negative.
local text = require "yapp.file.text"

local M = {}

local HEAD = 4096 -- bytes by which a file is known
local SECOND, MILLISECOND = 1000000000, 1000000 -- nanoseconds

-- Times -------------------------------------------------------------------------------------------

local MONTHS = {
  jan = 1, feb = 2, mar = 3, apr = 4, may = 5, jun = 6, jul = 7, aug = 8, sep = 9, oct = 10,
  nov = 11, dec = 12,
}
local DATE = "(%a+) (%d%d?) (%d%d?):(%d%d):(%d%d)%.?(%d?%d?%d?)%d* ?([ap]?)m? (20%d%d)"
local HALVES = { a = 0, p = 12 } -- of a day

-- Return a date, the recorder's local time, in milliseconds since 1970; nil for another
-- text.
--   Tue Nov 14 10:13:20.001 pm 2023
-- python-can writes 1 ms as ".1".
local function parse_date(text_of_date)
  local words = text_of_date:sub(1, 64):lower():gsub("%s+", " ")
  local month, day, hour, min, sec, milliseconds, half, year = words:match(DATE)
  if not MONTHS[month] then return nil end
  if HALVES[half] then hour = hour % 12 + HALVES[half] end
  local seconds = os.time {
    year = year, month = MONTHS[month], day = day, hour = hour, min = min, sec = sec,
  }
  return seconds * 1000 + ("0" .. milliseconds)
end

-- Return the time in front of a line, "-12.000123", in nanoseconds, and the text behind it; nil
-- without.
local function parse_stamp(line)
  local sign, whole, fraction, rest = line:match("^%s*(%-?)(%d+)[.,](%d+)%s+(.*)$")
  if not rest or #whole > 9 then return nil end
  local time = whole * SECOND + (fraction .. "00000000"):sub(1, 9)
  return sign == "-" and -time or time, rest
end

-- A line ------------------------------------------------------------------------------------------

-- Known lines without a time.
local PLAIN = {
  "^%s*$", "^%s*//", "^%s*;", "^%s*date%f[^%a]", "^%s*base%f[^%a]", "internal events logged",
  "^%s*begin trigger", "^%s*end trigger",
}
-- The texts behind a time in a line without a frame: of a channel, of another network, of J1939
-- (whose frames have lines of their own), and a request to send (the frame has a line of its own).
local EVENTS = {
  "^%d+%s+statistic:", "^%d+%s+overloadframe", "^%d+%s+j1939", "%stxrq%s", "^canxl%s",
  "^l%w*%s", "^eth%s", "^fr%w*%s", "^most", "^j%d", "^sv:", "^a429",
}
-- With one of these behind the time, a line may have been a frame.
local LIKE_FRAMES = { "^%d+%s", "^%d+$", "^canfd%f[^%a]", "%f[%a][rt]x%f[^%a]" }

-- Return whether a line without a frame is known.
-- rest  the text behind its time, nil without a time
local function is_event(line, rest)
  if not rest then return text.has_one_of(line:lower(), PLAIN) end
  local lower = rest:lower()
  return text.has_one_of(lower, EVENTS) or not text.has_one_of(lower, LIKE_FRAMES)
end

-- Return the id in "8404000x", with SocketCAN's flag of an extended one; nil for another text.
local function parse_id(id, base)
  local digits, extended = id:match("^(%x+)([xX]?)$")
  local value = digits and #digits <= 10 and tonumber(digits, base)
  if not value then return nil end
  if extended == "" then return value < 0x800 and value or nil end
  return value < text.ERROR and value + text.EXTENDED or nil
end

local BYTE = "^%s*(%x%x?%x?)%f[%X]()"

-- Fill in "d 8 FD 7F ...", "r 8": a length of 9 to 15 means 8.
local function parse_classic(record, rest, base)
  local kind, code, data = rest:match("^([dDrR])%s*(%x?)%s*(.*)$")
  record.length = math.min(tonumber(code or "", 16) or 0, 8)
  if kind == "r" or kind == "R" then
    record.id = record.id + text.REMOTE
    record.data = ""
  elseif kind and code ~= "" then
    record.data = text.parse_bytes(data, record.length, BYTE, base)
  end
end

-- BRS, ESI, DLC, length, then data, duration, bits, flags
local FLEXIBLE = "([01])%s+([01])%s+%x%d?%s+(%d+)(.*)$"
local FDF = 0x1000 -- in the flags

-- Fill in a CAN FD frame, with or without a name in front.
local function parse_flexible(record, rest, base)
  local brs, esi, length, data = rest:match("^" .. FLEXIBLE)
  if not brs then brs, esi, length, data = rest:match("^%S+%s+" .. FLEXIBLE) end
  record.length = tonumber(length)
  if not length or record.length > 64 then return end
  local stop
  record.data, stop = text.parse_bytes(data, record.length, BYTE, base)
  local flags = tonumber(data:match("^%s*%d+%s+%d+%s+(%x+)", stop) or "1000", 16)
  if flags % (2 * FDF) >= FDF then
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

-- Return the frame in the text behind a time, nil if there is none.
local function frame_of(rest, base)
  local kind, channel, behind = rest:match("^(%a*)%s*(%d%d?%d?)%s+(%S.*)$")
  local form = FORMS[(kind or "none"):upper()]
  if not form then return nil end
  local record = { bus = "CAN-" .. tonumber(channel), flags = 0, raw_dlc = 0 }
  if behind:find("^[RrTtXx]*%s*[Ee]rror[Ff]rame") then
    record.id = text.ERROR + 0x80 -- a bus error
    record.length, record.data = 8, ("\0"):rep(8)
    return record
  end
  local id, direction, data = behind:match(form.pattern)
  if form.is_turned then id, direction = direction, id end
  record.id = id and parse_id(id, base)
  if not record.id then return nil end
  record.sent = direction:upper() == "T"
  form.read(record, data, base)
  return record.data and record or nil
end

--- Read one line.
-- line     without its end
-- base     10 or 16: of the file's ids and data
-- returns  as parse of text.open, but for the time: stamp = nanoseconds, see note
function M.parse(line, base)
  local stamp, rest = parse_stamp(line)
  local record = rest and frame_of(rest, base)
  if not record then return nil, is_event(line, rest) end
  record.stamp = stamp
  return record
end

-- A file ------------------------------------------------------------------------------------------

local NO_DATE = "no such date: times count from the date before, or from 0. Correct it, as in " ..
  '"Tue Nov 14 22:13:20.001 2023"'

-- Return the date that a line has behind a word, nil for none.
local function date_in(log, line, pattern)
  local written = line:match(pattern)
  local date = written and parse_date(written)
  if written and not date then log:quote(line, NO_DATE) end
  return date
end

-- Note the dates of a line without a time.
local function note_dates(log, line)
  log.date = date_in(log, line, "^%s*date%s(.*)") or log.date
  log.began = date_in(log, line, "^%s*[Bb]egin%s+[Tt]riggerblock%s+(%S.*)") or log.began
end

-- Note the dates, and the time of a frame.  A block has the time when it began: python-can counts
-- from there, CANoe from the date of the file.
local function note(log, line, record, offset)
  local stamp = record and record.stamp or parse_stamp(line)
  if not stamp then return note_dates(log, line) end
  if log.began then
    local is_since_date = math.abs(log.date + stamp / MILLISECOND - log.began) < 2000
    log.zero, log.began = is_since_date and log.date or log.began, nil
  end
  local zero = log.zero or log.date
  log.start = log.start == 0 and math.floor(zero / 1000) or log.start
  log.clock = stamp + (log.is_relative and log.clock or 0)
  if record then log.times[offset] = log.clock + (zero - log.start * 1000) * MILLISECOND end
end

local BASES = { hex = 16, dec = 10 } -- of ids and data

--- Open a file if it is ASC: if one of its first lines says the base.
-- file     with read and seek, at its begin
-- report   function(text), called with a note on a line
-- returns  a log with read and seek_read, whose buses are called as Wireshark's reader of BLF calls
--          them, and { decimals = 6, has_several, stamps_differ, drops = as readers.log returns
--          them }; nil for another file
function M.open(file, report)
  local head = file:read(HEAD) or ""
  local word, stamps = ("\n" .. head):match("\n[^%w\n]*base%s+(%a+)%s+([^\r\n]*)")
  local base = BASES[word]
  if not base then return nil end
  local function parse(line) return M.parse(line, base) end
  local found = text.survey(head, #head < HEAD, parse)
  return text.open(head, report, {
    parse = parse,
    note = note,
    like = { "" }, -- each line that is not understood may have been a frame
    date = 0, -- of the file, in milliseconds since 1970
    began = nil, -- the date of a block until its first stamp comes
    zero = nil, -- the time that stamps count from, if not from the date
    clock = 0, -- the last stamp; if they are relative, the sum of all
    is_relative = stamps:find("^timestamps%s+relative") ~= nil,
    decimals = 6,
    has_several = found.has_several,
    stamps_differ = found.stamps_differ,
  })
end

return M
