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

local MONTHS = {} -- { jan = 1, feb = 2, ... }
for month, name in ipairs {
  "jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec",
} do
  MONTHS[name] = month
end
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

local STAMP = "^%s*(%-?)(%d+)[.,](%d+)%s" -- "-12.000123"

-- Return the time in front of a line in nanoseconds, nil without.
local function parse_stamp(line)
  local sign, whole, fraction = line:match(STAMP)
  if not sign or #whole > 9 then return nil end
  local time = whole * SECOND + (fraction .. "00000000"):sub(1, 9)
  return sign == "-" and -time or time
end

local function set_time(record, stamp)
  record.stamp = stamp and parse_stamp(stamp)
  return record.stamp ~= nil
end

-- A line ------------------------------------------------------------------------------------------

-- Return the id in "8404000x", with SocketCAN's flag of an extended one; nil for another text.
local function parse_id(log, id)
  local digits, extended = id:match("^(%x+)([xX]?)$")
  local value = digits and #digits <= 10 and tonumber(digits, log.base)
  if not value then return nil end
  if extended == "" then return value < 0x800 and value or nil end
  return value < text.ERROR and value + text.EXTENDED or nil
end

-- Return a record without data.
local function new_record(log, channel, id, direction)
  return {
    bus = "CAN-" .. tonumber(channel),
    id = parse_id(log, id),
    sent = direction:upper() == "T",
  }
end

local BYTE = "^%s*(%x%x?%x?)%f[%X]()"

-- Read "d 8 FD 7F ...", "r 8": a length of 9 to 15 means 8.
local function read_classic(log, channel, id, direction, rest)
  local record = new_record(log, channel, id, direction)
  local kind, code, data = rest:match("^([dDrR])%s*(%x?)%s*(.*)$")
  local length = math.min(tonumber(code or "", 16) or 0, 8)
  if kind == "r" or kind == "R" then
    record.id = record.id and record.id + text.REMOTE
    record.length, record.data = length, ""
  elseif kind and code ~= "" then
    record.data = text.parse_bytes(data, length, BYTE, log.base)
  end
  return record
end

-- BRS, ESI, DLC, length, then data, duration, bits, flags
local FLEXIBLE = "([01])%s+([01])%s+%x%d?%s+(%d+)(.*)$"
local FDF = 0x1000 -- in the flags

-- Read a line of CAN FD, with or without a name in front.  Its frame may be a classic one.
local function read_flexible(log, channel, direction, id, rest)
  local record = new_record(log, channel, id, direction)
  local brs, esi, length, data = rest:match("^" .. FLEXIBLE)
  if not brs then brs, esi, length, data = rest:match("^%S+%s+" .. FLEXIBLE) end
  if not length then return nil end
  local stop
  record.data, stop = text.parse_bytes(data, tonumber(length), BYTE, log.base)
  local flags = tonumber(data:match("^%s*%d+%s+%d+%s+(%x+)", stop) or "1000", 16)
  if flags % (2 * FDF) >= FDF then
    record.fd = true
    record.flags = 4 + brs + 2 * esi -- FDF, BRS, ESI
  end
  return record
end

-- Class and state of an error frame (linux/can/error.h), by what a line reports.
local REPORTS = {
  errorframe = { 0x80, 0 },
  ["chip status busoff"] = { 0x40, 0 },
  ["chip status error passive"] = { 0x04, 0x30 },
  ["chip status warning level"] = { 0x04, 0x0C },
  ["rx queue overrun"] = { 0x04, 0x01 },
}

local FORMS = {
  { --  0.001000 1  8408000x        Rx   d 8 FD 7F FD 7F FD 7F FD 7F
    pattern = "^(%d%d?%d?)%s+(%w+)%s+([RrTt])[Xx]%s+(.*)$",
    read = read_classic,
    like = "%f[%a][rt]x%s+[dr]%f[%A]",
    needs_time = true,
  },
  { --  0.002000 CANFD   1 Rx   840C000x                          1 0 d 32 FD 7F ...
    pattern = "^[Cc][Aa][Nn][Ff][Dd]%s+(%d%d?%d?)%s+([RrTt])[Xx]%s+(%x+[xX]?)%s+(.*)$",
    read = read_flexible,
    like = "canfd%f[^%a]",
    needs_time = true,
  },
  { --  0.001000 1  ErrorFrame
    --  0.001000 CAN 1 Status:chip status error passive - TxErr: 132 RxErr: 0
    pattern = "^[CANFDcanfd]*%s*(%d%d?%d?)%s+%f[%S][RrTtXx]*%s*(%a.*)$",
    read = function(_, channel, rest)
      rest = rest:lower()
      local report = REPORTS[rest:match("^errorframe") or rest:match("^status:([%l ]*%l)")]
      return report and {
        bus = "CAN-" .. tonumber(channel),
        id = text.ERROR + report[1],
        data = "\0" .. string.char(report[2]) .. ("\0"):rep(6),
      }
    end,
    like = STAMP .. "+%d+%f[%s\0]", -- a channel
    needs_time = true,
  },
}

-- Comments, lines of the head; statistics of a channel, of J1939 (whose frames have lines of their
-- own), and a request to send (the frame has a line of its own).
local KNOWN = {
  "^%s*$", "^%s*//", "^%s*;", "^%s*date%f[^%a]", "^%s*base%f[^%a]", "internal events logged",
  "^%s*begin trigger", "^%s*end trigger", "%d%s+statistic:", "%d%s+overloadframe", "%d%s+j1939",
  "%stxrq%s",
}

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

-- Note the dates of a line without a time.  Behind the first frame times go on.
local function note_dates(log, line)
  local date = date_in(log, line, "^%s*date%s(.*)")
  local began = date_in(log, line, "^%s*[Bb]egin%s+[Tt]riggerblock%s+(%S.*)")
  if log.frames > 0 then return end
  log.date, log.began = date or log.date, began or log.began
end

-- Note the dates, and the time of a frame.  A block has the time when it began: python-can counts
-- from there, CANoe from the date of the file.
local function note(log, line, record, offset)
  local stamp = record and record.stamp or parse_stamp(line)
  if not stamp then return note_dates(log, line) end
  if log.began then
    local is_since_date = math.abs(log.date + stamp / MILLISECOND - log.began) < 2000
    log.date, log.began = is_since_date and log.date or log.began, nil
  end
  log.start = math.floor(log.date / 1000)
  log.clock = stamp + (log.is_relative and log.clock or 0)
  if record then log.times[offset] = log.clock + log.date % 1000 * MILLISECOND end
end

--- The format of ASC's lines, see file.text.  A log of it has base = 10 or 16, of ids and data.
M.FORMAT = {
  stamp = "^(%s*%-?%d+[.,]%d+%s)%s*()",
  set_time = set_time,
  forms = FORMS,
  known = KNOWN,
  event = STAMP, -- of the recorder, or of another network
  note = note,
}

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
  if not BASES[word] then return nil end
  local log = text.new(head, #head < HEAD, M.FORMAT, {
    base = BASES[word],
    date = 0, -- that stamps count from, in milliseconds since 1970
    began = nil, -- the date of a block until its first stamp comes
    clock = nil, -- the last stamp; if they are relative, the sum of all
    is_relative = stamps:find("^timestamps%s+relative") ~= nil,
    decimals = 6,
  })
  return log:open(head, report)
end

return M
