-- SPDX-License-Identifier: GPL-2.0-or-later
-- Vector's ASC, the text log of CANoe and CANalyzer that python-can writes too: lines into CAN frames.  Pure Lua.
--
--   date Tue Nov 14 22:13:20.001 2023
--   base hex  timestamps absolute
--   Begin Triggerblock Tue Nov 14 22:13:20.001 2023
--    0.001000 1  8408000x        Rx   d 8 FD 7F FD 7F FD 7F FD 7F
--    0.002000 CANFD   1 Rx   840C000x                          1 0 d 32 FD 7F ...
local M = {}

local HEAD, BLOCK, LONGEST = 4096, 65536, 1024 -- bytes; 64 bytes of data in decimal, and all that may stand around
local EXTENDED, REMOTE, ERROR, BUS_ERROR = 0x80000000, 0x40000000, 0x20000000, 0x80
local FDF, BRS, ESI = 4, 1, 2 -- of a SocketCAN frame
local MOST_STARTS = 1000 -- times at which a log began anew
local NANO = 1000000000

local MONTHS = {}
for number, names in ipairs { "jan jän", "feb", "mar mär mrz", "apr", "may mai", "jun", "jul", "aug", "sep", "oct okt",
  "nov", "dec dez" } do
  for name in names:gmatch("%S+") do MONTHS[name] = number end
end

-- Dates ---------------------------------------------------------------------------------------------------------------

-- "Tue Nov 14 10:13:20.001 pm 2023", the recorder's local time: { seconds = since 1970, nanoseconds }; nil for no date.
-- python-can writes 1 ms as ".1".
local function read_date(text)
  local month, day, hour, minute, second, rest = text:match("^%s*%S+%s+(%S+)%s+(%d+)%s+(%d+):(%d+):(%d+)(.*)$")
  month = month and MONTHS[month:lower()]
  local fraction, half, year = (rest or ""):match("^%.?(%d*)%s*([aApP]?)[mM]?%s+(%d%d%d%d)")
  if not month or not year then return nil end
  hour = tonumber(hour)
  if half ~= "" then hour = hour % 12 + (half:lower() == "p" and 12 or 0) end
  local seconds = os.time { year = tonumber(year), month = month, day = tonumber(day), hour = hour,
    min = tonumber(minute), sec = tonumber(second) }
  return seconds and { seconds = seconds, nanoseconds = (tonumber(fraction:sub(1, 3)) or 0) * 1000000 }
end

local function later(start, nanoseconds)
  local all = start.nanoseconds + nanoseconds
  return start.seconds + math.floor((all - all % NANO) / NANO), all % NANO
end

-- "12.000123" in nanoseconds
local function read_stamp(text)
  local whole, fraction = text:match("^(%d+)%.?(%d*)$")
  if not whole or #whole > 7 then return nil end -- 115 days
  return tonumber(whole) * NANO + tonumber((fraction .. "000000000"):sub(1, 9))
end

-- The time in front of a line, and what is behind it; nil for a line without.  (Of a pattern that goes on behind the
-- digits, a thousand digits would be tried a thousand times over.)
local function stamp_of(line)
  local text, rest = line:match("^%s*(%d*%.?%d*)()")
  local stamp = line:find("^%s", rest) and read_stamp(text)
  if stamp then return stamp, line:match("^%s*(.*)$", rest) end
end

-- A line --------------------------------------------------------------------------------------------------------------

-- "8404000x": the number, with SocketCAN's flag of an extended one
local function read_id(text, base)
  local digits, extended = text:match("^(%x+)(x?)$")
  local id = digits and #digits <= 10 and tonumber(digits, base)
  if not id or id >= (extended == "x" and 0x20000000 or 0x800) then return nil end
  return extended == "x" and id + EXTENDED or id
end

-- So many data bytes, and what is behind them; nil where there are fewer
local function read_data(text, count, base)
  local bytes, at = {}, 1
  for i = 1, count do
    local from, to, digits = text:find("^%s*(%x+)", at)
    local value = from and #digits <= 3 and tonumber(digits, base)
    if not value or value > 255 then return nil end
    bytes[i], at = string.char(value), to + 1
  end
  return table.concat(bytes), text:sub(at)
end

-- Length of an 8 byte frame as it is counted: 9 to 15 mean 8
local function classic(record, text, base)
  local kind, code, rest = text:match("^([dr])%s*(%x?)%s*(.*)$")
  if not kind or kind == "d" and code == "" then return nil end
  local length = math.min(tonumber(code, 16) or 0, 8)
  record.length, record.data, record.flags = length, "", 0
  if kind == "r" then
    record.id = record.id + REMOTE
  else
    record.data = read_data(rest, length, base)
  end
  return record.data and record
end

-- Behind the id: a name or none, BRS, ESI, DLC, length, data, duration, bits, flags
local function flexible(record, text, base)
  local brs, esi, code, length, rest = text:match("^%s*([01])%s+([01])%s+(%x)%s+(%d+)(.*)$")
  if not brs then brs, esi, code, length, rest = text:match("^%s*%S+%s+([01])%s+([01])%s+(%x)%s+(%d+)(.*)$") end
  length = tonumber(length or 65)
  if not code or length > 64 then return nil end
  local data, behind = read_data(rest, length, base)
  if not data then return nil end
  local flags = tonumber(behind:match("^%s*%d+%s+%d+%s+(%x+)") or "1000", 16)
  record.length, record.data, record.flags = length, data, 0
  if flags % 0x20 >= 0x10 then
    record.id, record.data = record.id + REMOTE, ""
  elseif flags % 0x2000 >= 0x1000 then
    record.fd, record.flags = true, FDF + (brs == "1" and BRS or 0) + (esi == "1" and ESI or 0)
  end
  if not record.fd and length > 8 then return nil end
  return record
end

--- Reads one line.
-- @param line  without its end
-- @param base  10 or 16, of the file's ids and data
-- @return a record { stamp = ns, number = channel, id = with SocketCAN's flags, fd, sent, length, flags, raw_dlc = 0,
--   data }, or nil for a line that is no frame
function M.parse(line, base)
  local stamp, rest = stamp_of(line)
  if not stamp then return nil end
  local record = { stamp = stamp, raw_dlc = 0 }
  local channel, id, direction, behind = rest:match("^(%d+)%s+(%x+x?)%s+([RT]x)%s+(.*)$")
  local read = classic
  if not channel then
    channel, direction, id, behind = rest:match("^CANFD%s+(%d+)%s+([RT]x)%s+(%x+x?)%s+(.*)$")
    read = flexible
  end
  if channel then
    record.id = read_id(id, base)
    record.number, record.sent = tonumber(channel), direction == "Tx" or nil
    return record.id and record.number <= 0xFFFF and read(record, behind, base) or nil
  end
  channel, behind = rest:gsub("^CANFD%s+", ""):match("^(%d+)%s+(.*)$")
  record.number = channel and (behind:find("^ErrorFrame") or behind:find("^[RT]x%s+ErrorFrame")) and tonumber(channel)
  if not record.number or record.number > 0xFFFF then return nil end
  record.id, record.length, record.flags, record.data = ERROR + BUS_ERROR, 8, 0, ("\0"):rep(8)
  return record
end

-- A file --------------------------------------------------------------------------------------------------------------

--- Opens a file if it is ASC.
-- @param file  with read and seek, at its begin
-- @return a log, for read and seek_read; nil for another file
function M.open(file)
  local head = file:read(HEAD) or ""
  local date = head:match("^%s*date%s+([^\r\n]*)")
  local base, times = head:match("\n%s*base%s+(%a+)%s+timestamps%s+(%a+)")
  if not date or not ({ hex = true, dec = true })[base] then return nil end
  return { base = base == "hex" and 16 or 10, is_relative = times == "relative", date = read_date(date), clock = 0,
    text = head, from = 0, at = 1, starts = {}, clocks = {} }
end

-- Goes on behind a line that is longer than any frame's.
local function skip_line(log, file)
  local stop
  repeat
    log.from, log.text, log.at = log.from + #log.text, file:read(BLOCK) or "", 1
    stop = log.text:find("\n", 1, true)
  until stop or log.text == ""
  log.at = (stop or 0) + 1
end

-- The next line and its offset in the file; nil at the end, "" for one that is too long.
local function next_line(log, file)
  local stop = log.text:find("\n", log.at, true)
  while not stop and #log.text - log.at < LONGEST do
    local more = file:read(BLOCK)
    if not more or more == "" then break end
    log.from, log.text, log.at = log.from + log.at - 1, log.text:sub(log.at) .. more, 1
    stop = log.text:find("\n", 1, true)
  end
  if log.at > #log.text then return nil end
  local offset = log.from + log.at - 1
  if (stop or #log.text) - log.at > LONGEST then
    if stop then log.at = stop + 1 else skip_line(log, file) end
    return "", offset
  end
  local line = log.text:sub(log.at, stop or #log.text)
  log.at = (stop or #log.text) + 1
  return line, offset
end

-- A block of a log says when it began: python-can counts from there, CANoe from the date of the file.
local function begin(log, offset, stamp)
  local start = log.trigger
  if log.date and math.abs(later(log.date, stamp) - start.seconds) < 2 then start = log.date end
  log.trigger = nil
  if #log.starts < MOST_STARTS then log.starts[#log.starts + 1] = { offset = offset, start = start } end
end

local function start_at(log, offset)
  for i = #log.starts, 1, -1 do
    if log.starts[i].offset <= offset then return log.starts[i].start end
  end
  return log.date
end

-- Gives a record its time; without a date in the file it has none.
local function set_time(log, record, offset)
  local start = start_at(log, offset)
  if start then
    record.seconds, record.nanoseconds = later(start, log.is_relative and (log.clocks[offset] or 0) or record.stamp)
  end
  return record
end

--- Reads the next frame.
-- @return a record as parse gives, with seconds and nanoseconds, and its offset for seek_read; nil at the end
function M.read(log, file)
  while true do
    local line, offset = next_line(log, file)
    if not line then return nil end
    local stamp = stamp_of(line)
    if stamp and log.trigger then begin(log, offset, stamp) end
    if stamp and log.is_relative then log.clock = log.clock + stamp end
    local record = M.parse(line, log.base)
    if record then
      if log.is_relative then log.clocks[offset] = log.clock end
      return set_time(log, record, offset), offset
    end
    local date = not stamp and line:match("^%s*[Bb]egin%s+[Tt]riggerblock%s+(.*)")
    if date then log.trigger = read_date(date) end
  end
end

--- Reads a frame again.
-- @param offset  that read gave
-- @return the record; nil where there is none
function M.seek_read(log, file, offset)
  file:seek("set", offset)
  local record = M.parse((file:read(LONGEST) or ""):match("^[^\n]*"), log.base)
  return record and set_time(log, record, offset)
end

return M
