-- SPDX-License-Identifier: GPL-2.0-or-later
-- The output and logs of candump: recognises a file, and reads the CAN frames in its lines as
-- packets.  Pure Lua.
--
-- A line, after can-utils (lib.c, candump.c), has the form LOG or SCREEN behind the CAN id;
-- parse_head reads the text before it.  A line without a frame has one of the forms OTHERS.  A line
-- pasted from a document has these forms, too.
local memo = require "yapp.base.memo"
local text = require "yapp.file.text"
local utf8 = require "yapp.base.utf8"

local match = string.match

local M = {}

-- Why a line gives no frame.
local UNKNOWN = "not a candump line, skipped"
local TIME = "no such time, line skipped"
local ID = text.ID
local DATA = text.DATA
-- Notes about a line with a frame.
local BEHIND = "text behind the frame, ignored"
local REPAIRED = "letters that look like hex digits, read as such"

-- Lines without a frame: a pattern, a reason, and whether they are harmless.  candump -e prints
-- below an error frame, behind a tab, its meaning.
local OTHERS = {
  { "^%s*$", "an empty line, skipped", true },
  { "^%s*[#;/]", "a comment, skipped", true },
  { "^Enabling Logfile '", "a message of candump's, skipped", true },
  { "while logging[.!]?%s*$", "a message of candump's, skipped", true },
  { "^DROPCOUNT: ", "candump lost frames" },
  { "#%x%x:%x%x:%x+#%x*%s*[RT]?%s*$", "a CAN XL frame, skipped", true }, -- of a log
  { "%[%d%d%d%d%]%s+%(%x%x|", "a CAN XL frame, skipped", true }, -- on the screen
  { "^\t%l+%-[%l-]+%f[{%s\0]" },
}

-- Return the id with SocketCAN's flags for 3 (standard) or 8 (extended, or error) hex digits, or
-- nil.
local function parse_id(digits)
  local id = tonumber(digits, 16)
  if #digits == 3 and id < 0x800 then return id end
  if #digits ~= 8 or id >= 2 * text.ERROR then return nil end
  return id < text.ERROR and id + text.EXTENDED or id
end

-- Times -------------------------------------------------------------------------------------------

local latest, latest_seconds = "", nil -- date: many frames are of one second

-- Return the seconds since 1970 of a date, local time as Wireshark shows it; nil for another text.
local function parse_date(date)
  if date == latest then return latest_seconds end
  local parts = {}
  parts.year, parts.month, parts.day, parts.hour, parts.min, parts.sec =
    date:match("^(%d%d%d%d)%-(%d%d)%-(%d%d) (%d%d):(%d%d):(%d%d)$")
  latest, latest_seconds = date, parts.year and text.seconds_of(parts)
  return latest_seconds
end

-- Fill in the time in the parentheses, or return why not.  An absolute time has ten digits at
-- least: candump pads it.  Old versions of asc2log write "1.1000000" for two seconds.
local function parse_stamp(record, stamp)
  local whole, fraction = stamp:match("^%f[%d]([%d%-: ]*%d)%.(%d+)$")
  if not whole then return TIME end
  record.is_date = #whole > 12
  local read = record.is_date and parse_date or tonumber
  record.seconds = read(whole)
  record.nanoseconds = tonumber((fraction .. "00000000"):sub(1, 9))
  record.is_relative = #whole < 10
  record.is_short = #whole == 3 -- as candump pads a time that is not absolute
  if fraction == "1000000" and record.seconds then
    record.seconds, record.nanoseconds = record.seconds + 1, 0
  end
  return not record.seconds and TIME or nil
end

-- Data --------------------------------------------------------------------------------------------

local function fill_remote(record, length)
  record.id = record.id + text.REMOTE
  record.length = length
  record.data = ("\0"):rep(length)
end

-- Lengths that only a CAN FD frame has.
local FD_LENGTHS = {
  [12] = true, [16] = true, [20] = true, [24] = true, [32] = true, [48] = true, [64] = true,
}

-- Fill in the data that a log has behind "#": ##<flags><data> of CAN FD, R<length>_<DLC>,
-- <data>_<DLC>.  Some converters write CAN FD behind one "#", without flags.
local function parse_log(record, data, way, stop, line)
  local has_more = stop <= #line
  if has_more then record.note = BEHIND end
  record.sent = way == "T" and not has_more
  record.is_relative = record.is_short -- of candump -L -t d or z; other programs write short times
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
  record.fd = record.fd or FD_LENGTHS[record.length] or false
end

-- Fill in the data that the screen has behind the id: [8] classic, [08] CAN FD, {E} classic with
-- the raw DLC (-8).  Between the bytes is a blank, or with -S, which turns them around, a "`".
-- Behind them may stand ERRORFRAME, or in quotes the bytes as ASCII.
local function parse_screen(record, open, digits, data)
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
  local bytes, stop = text.parse_bytes(data, length, "^[%s`]+(%x+)()", text.BYTES)
  if not bytes or not data:find("^%s*$", stop) and not data:find("^%s+['`E]", stop) then
    return DATA
  end
  record.data = data:sub(1, stop - 1):find("`", 1, true) and bytes:reverse() or bytes
end

-- A line ------------------------------------------------------------------------------------------

-- The text behind the id in a line with a frame.
-- (1700000000.000001) can0 08404000#BBBE6FC720000000 R
local LOG = "^#(%S*)%s*([RT]?)%s*()"
--  (000.000499)  can0  RX - -  08404000   [8]  BB BE 6F C7 20 00 00 00   '..o. ...'
local SCREEN = "^%s+([%[{])(%x%x?)[%]}](.*)$"

-- Return the values in front of an id: the time, the bus, with -x the direction and the flags of
-- CAN FD; then the id and the index behind it.  Each may be nil.
local function parse_head(line)
  local stamp, first = match(line, "^%s*%(([^()]+)%)%s+()")
  local bus, second = match(line, "^%s*(%S+)%s+()", first)
  if not bus then return nil end
  local way, brs, esi, third = match(line, "^([RT])X ([B-]) ([E-])%s+()", second)
  local id, behind = match(line, "^(%x+)()", third or second)
  local flags = (brs == "B" and 1 or 0) + (esi == "E" and 2 or 0)
  return stamp, bus, way == "T", flags, id, behind
end

-- Fill in time and data, or return why not.
local function fill_record(record, stamp, line, read, a, b, c)
  if not record.id then return ID end
  local why = stamp and parse_stamp(record, stamp) or read(record, a, b, c, line)
  local max_length = record.fd and 64 or 8
  return why or record.length > max_length and DATA or nil
end

-- Return the frame in a line, or nil and why there is none.
local function frame_of(line)
  local stamp, bus, sent, flags, id, behind = parse_head(line)
  local read, a, b, c = parse_screen, match(line, SCREEN, behind)
  -- A log line without a time is of another program.
  if stamp and not a then read, a, b, c = parse_log, match(line, LOG, behind) end
  if not (id and a) then return nil, UNKNOWN end
  local record = {
    bus = bus, id = parse_id(id), fd = false, sent = sent, flags = flags, raw_dlc = 0,
    is_relative = false, is_short = false,
  }
  local why = fill_record(record, stamp, line, read, a, b, c)
  if not why then return record end
  return nil, stamp and why or UNKNOWN
end

-- Characters that stand for digits in the candump lines of the vendor's document: three Greek and
-- two Cyrillic letters, an O, and circles; and the space of a page that they were copied from.
local LOOK_ALIKES = {}
for letter, digit in
  ("\206\146B\206\149E\206\1520\208\1513\208\1776\194\160 "):gmatch("([\194-\208].)(.)") do
  LOOK_ALIKES[letter] = digit
end

-- Return the line with such letters as the digits that they stand for.
local function repair(line)
  line = line:gsub("[\194\206\208][\128-\191]", LOOK_ALIKES)
  line = line:gsub("%$\\odot \\odot%$", "00")
  return (line:gsub("(%x)O%f[%s\0]", "%10"))
end

--- Read a line of candump's output or log.
-- line     text without its line end; colours and a byte order mark are dropped
-- returns  the frame: { bus = name, id = with SocketCAN's flags, fd, flags = of CAN FD: 1 BRS, 2
--          ESI; length = bytes, or the DLC of a remote frame; data = string, zero in a remote
--          frame; raw_dlc = 9 to 15, or 0; sent; seconds, nanoseconds, is_relative = nil without a
--          time; note = a remark on the line, or nil }.  For a line without a frame: nil;
--          a reason, nil for a line that -e prints below a frame; true if the line is harmless: the
--          packet list need not report it, and the file may still be candump's
function M.parse(line)
  line = line:gsub("^\239\187\191", ""):gsub("\27%[[%d;]*m", "")
  local record, why = frame_of(line)
  if record then return record end
  local readable = repair(line)
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

-- Sizes, in bytes.  A pipe can be rewound only inside Wireshark's own buffer, which has at least
-- HEAD and less than SURE bytes (less than 256 KB on 4.0, than 8 MB on 4.4 and 4.6).
local HEAD = 4096
local SURE = 16 * 1024 * 1024
local PIECE = 1024 * 1024

local SECOND = 1000000000 -- nanoseconds
local MAX_DROPPED = 0xFFFFFFFF -- candump counts them in 32 bits
local NO_BUS = { [""] = true, any = true }

-- Which files are candump's -----------------------------------------------------------------------

-- How many digits Wireshark's own reader takes behind "#", for data, remote and CAN FD frames.
local PLAIN_DIGITS = {
  [""] = "0 2 4 6 8 10 12 14 16", R = "0 1", ["#"] = "1 3 5 7 9 11 13 15 17 25 33 41 49 65 97 129",
}
for kind, counts in pairs(PLAIN_DIGITS) do
  local set = {}
  for count in counts:gmatch("%d+") do set[tonumber(count)] = true end
  PLAIN_DIGITS[kind] = set
end

-- Return a test for text of whole lines: true if all are log lines of this bus that Wireshark's own
-- reader gets right in every version (tests/e2e/test_candump.py compares the two readers).
-- Wireshark's reader takes one space, six decimals, a number of digits that fits, and nothing more.
-- It does not tell two buses apart before 4.6, and an empty line ends the file for it on 4.6.  From
-- 4.6 on it goes by an id's value, not by its digits (by_value): it takes 00000000 for a standard
-- id, and the id of an error frame for an extended one.
local function plain_test(bus, by_value)
  local name = bus:gsub("%W", "%%%0")
  local pattern = "%(%d+%.%d%d%d%d%d%d%) " .. name .. " ([0-7]%x+)#([#R]?)()%x*()\r?\n"
  local function erase(id, kind, from, to)
    local is_misread = by_value and (id < "00000800" or id >= "20000000")
    local is_id = #id == 3 or #id == 8 and not is_misread
    return is_id and PLAIN_DIGITS[kind][to - from] and "" or nil
  end
  return function(lines) return lines:gsub(pattern, erase) == "" end
end

-- Return the relative time of a record in nanoseconds, 0 if it has none.
local function relative_time(record)
  return record.is_relative and record.seconds * SECOND + record.nanoseconds or 0
end

-- Return whether the times are those since the frame before (candump -t d), not those since the
-- first one (-t z).  On one bus, times since the first frame climb, or stay if an adapter stamps
-- several frames at once.  Times since the frame before go up and down, or repeat.  (Of several
-- buses two frames may change places.)
local function are_deltas(records)
  local last, falls, repeats, rises = {}, 0, 0, 0
  for _, record in ipairs(records) do
    local time, before = relative_time(record), last[record.bus]
    if time < (before or 0) then
      falls = falls + 1
    elseif time > (before or time) then
      rises = rises + 1
    elseif before and time > 0 then
      repeats = repeats + 1
    end
    last[record.bus] = time
  end
  if falls > 0 or rises <= 1 then falls = falls + repeats end
  return 10 * falls > #records
end

-- Return whether not all records have the time stamp of the first one.
local function do_stamps_differ(records)
  local first = records[1]
  for _, record in ipairs(records) do
    if record.seconds ~= first.seconds or record.nanoseconds ~= first.nanoseconds then
      return true
    end
  end
  return false
end

-- Cut text behind its last line end.  At the end of the file all of it is lines.
local function whole_lines(piece, at_end)
  local lines = piece:match("^.*\n") or ""
  local rest = piece:sub(#lines + 1)
  if at_end and rest ~= "" then return piece .. "\n", "" end
  return lines, rest
end

-- Patterns of a line whose start was cut off: an id and "#", a length, data bytes alone.
local RESTS = { "%x#", "[%[{]%x+[%]}]", "^#?[%x%s`]*$", "^#?[%x%s`]*[RT]%s*$" }

-- Return whether candump text may start with these lines without a frame: the rest of a line, in a
-- log that was cut at its start, or a shell's lines with the command.  Any other first line may be
-- the mark of another format.
local function may_begin(lines)
  if #lines == 0 or table.concat(lines, "\n"):find("candump ", 1, true) then return true end
  return #lines == 1 and text.has_one_of(lines[1], RESTS)
end

-- Survey the first lines of a file; return nil if they are not candump's: { deltas = true
-- if the times are those since the frame before, decimals = 6 or 9, bus = name of the first one,
-- has_several = true if there are others, stamps_differ = true if not all stamps are equal }.
local function recognise(lines)
  local records, others = {}, {}
  local found = { decimals = 6, has_several = false }
  for line in lines:gmatch("([^\n]*)\n") do
    local record, why, is_harmless = M.parse(line)
    if record then
      if #records == 0 and not may_begin(others) then return nil end
      records[#records + 1] = record
      found.bus = found.bus or record.bus
      if record.bus ~= found.bus then found.has_several = true end
      if (record.nanoseconds or 0) % 1000 ~= 0 then found.decimals = 9 end
    elseif why and not is_harmless then
      others[#others + 1] = line
    end
  end
  found.deltas, found.stamps_differ = are_deltas(records), do_stamps_differ(records)
  return #records > #others and found or nil
end

-- Look behind a plain start for a line that needs this reader.  A file that cannot be rewound is a
-- pipe: no other reader could read it any more, so it is taken.  All text is kept until that is
-- known.
-- returns  the text read from the start of the file, which is right behind it; nil if the whole
--          file is plain
local function find_unusual_text(file, head, is_plain)
  local all, size = head, #head
  local lines, rest = whole_lines(head, false)
  while is_plain(lines) and #rest <= HEAD do
    local more = file:read(PIECE) or ""
    size = size + #more
    if size < SURE then
      all = all .. more
      if not file:seek("set", 0) then return all end
      file:seek("set", size)
    end
    lines, rest = whole_lines(rest .. more, more == "")
    if more == "" and is_plain(lines) then return nil end
  end
  file:seek("set", #head)
  return head
end

-- A file ------------------------------------------------------------------------------------------

-- Add a bus: { number = the one its name ends in (can1 is 1) unless another bus has it, else the
-- first free one; name = fit to be printed; heads = of packets, by the id's digits }.
local function add_bus(log, name)
  while log.taken[log.free] do log.free = log.free + 1 end
  local number = tonumber(name:match("%f[%d]%d?%d?%d$"))
  if not number or log.taken[number] then number = log.free end
  log.taken[number] = true
  local shown = utf8.name(name)
  local heads = memo(function(digits)
    local id = parse_id(digits)
    return id and text.head(number, { id = id })
  end)
  log.buses[name] = { number = number, name = shown, heads = heads }
  log.pending[#log.pending + 1] = ("Interface index %d is %s"):format(number, shown)
end

-- A line that has one of these, and was not understood, was a frame.
local LIKE_FRAMES = { "^%s*%([%d-]", "%x#", "%[%x+%]%s", "{%x}%s" }

-- Account for a line without a frame: add the packets that candump lost.
local function add_other_line(log, line, why, is_harmless)
  local count, bus = line:match("^DROPCOUNT: dropped (%d+)[^']*'?([^',]*)")
  if not count then
    if is_harmless then return log:skip(line, why, true) end
    return log:lose(line, why, not text.has_one_of(line, LIKE_FRAMES))
  end
  log:skip(line, why)
  log.drops[#log.drops + 1] = {
    count = math.min(tonumber(count), MAX_DROPPED),
    bus = not NO_BUS[bus] and utf8.name(bus) or nil,
  }
end

local HOUR = 3600 -- seconds

-- Local times (candump -t A) go back by an hour when summer time ends.  Let the time go on: add an
-- hour, until the reader's own time zone does so, too, if it has the same summer time.
--   02:59:59, 02:00:00, 02:30:00: the last two are 03:00:00 and 03:30:00
local function shift_over_hour(log, record, offset)
  local step = record.seconds - (log.latest_date or record.seconds)
  log.latest_date = record.seconds
  if step >= -HOUR and step < -HOUR / 2 then
    log.hour = log.hour + HOUR
  elseif log.hour > 0 and step >= HOUR then
    log.hour = log.hour - HOUR
  end
  log.shifts[offset] = log.hour > 0 and log.hour or nil
end

-- Return the frame in a line, as text.open says.
local function parse_record(log, line, offset)
  local record, why, is_harmless = M.parse(line)
  if not offset then return record end
  if why then add_other_line(log, line, why, is_harmless) end
  if not record then return nil end
  if not log.buses[record.bus] then add_bus(log, record.bus) end
  if log.deltas then
    log.clock = log.clock + relative_time(record)
    log.times[offset] = record.is_relative and log.clock or nil
  end
  if record.is_date then shift_over_hour(log, record, offset) end
  if record.note then log:skip(line, record.note) end
  return record
end

-- A classic data frame in a log, nothing behind it: (1700000000.000001) can0 08404000#BBBE6FC7
local USUAL = "^%((%d+)%.(%d%d%d%d%d%d)%) (%S+) (%x+)#(%x*)\r?\n()"

-- Read the next frame.  Nearly all lines of a large file have the usual form.  Their packets are
-- made without a record, in half of the time.
local function next_frame(log, lines, file)
  local seconds, fraction, name, digits, hex, stop = lines.text:match(USUAL, lines.pos)
  local bus = log.buses[name]
  local head = bus and #hex <= 16 and #hex % 2 == 0 and #seconds <= 12 and bus.heads[digits]
  if not head then return text.next(log, lines, file) end
  local offset = lines:skip_to(stop)
  local data = hex:gsub("%x%x", text.BYTES)
  local bytes = head .. string.char(#data) .. "\0\0\0" .. data
  return offset, bytes, tonumber(seconds), fraction * 1000, bus, log.comments[offset]
end

--- Open a file if it is candump text.
-- file     anything with read(bytes) and seek("set", offset), at its start, as io.open gives it
-- options  { all = true to take all candump text, false to leave files to Wireshark's own
--          reader that it gets right; by_value = true if that reader goes by the value of an id, as
--          4.6 does; report = function(text), called with a remark on a line }
-- returns  a log with read and seek_read, and { decimals = 6 or 9, of the times; has_several =
--          true if its first lines have several buses; stamps_differ, drops = as readers.log
--          returns them }.  Otherwise nil, and if Wireshark's own reader gets the log right,
--          facts for readers.log: { plain_bus, stamps_differ }
function M.open(file, options)
  local head = file:read(HEAD) or ""
  if head:find("^[^\n]*\0") then return nil end -- no text; a log that was cut off may have some
  local lines = whole_lines(head, #head < HEAD)
  local log = recognise(lines)
  if not log then return nil end
  local is_plain = plain_test(log.bus, options.by_value)
  if not (options.all or log.deltas) and is_plain(lines) then
    head = find_unusual_text(file, head, is_plain)
    if not head then
      return nil, { plain_bus = utf8.name(log.bus), stamps_differ = log.stamps_differ }
    end
  end
  log.record, log.next = parse_record, not log.deltas and next_frame or nil
  log.per_second = SECOND
  log.clock = 0 -- sum of the deltas in nanoseconds
  log.latest_date = nil -- seconds of the latest time that was a date
  log.hour = 0 -- seconds to add to dates
  log.taken = {} -- by number: true if a bus has it
  log.free = 0 -- all numbers below are taken
  return text.open(head, options.report, log)
end

return M
