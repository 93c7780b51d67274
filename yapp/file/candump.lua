-- SPDX-License-Identifier: GPL-2.0-or-later
-- The output and logs of candump: recognises a file, and reads the CAN frames in its lines as
-- packets.  Pure Lua.
local memo = require "yapp.base.memo"
local text = require "yapp.file.text"
local utf8 = require "yapp.base.utf8"

local char, match = string.char, string.match

local M = {}

local SECOND = 1000000000 -- nanoseconds

-- A line ------------------------------------------------------------------------------------------

-- Return the id with SocketCAN's flags for 3 (standard) or 8 (extended, or error) hex digits, or
-- nil.
local function parse_id(digits)
  local id = tonumber(digits, 16)
  if #digits == 3 and id < 0x800 then return id end
  if #digits ~= 8 or id >= 2 * text.ERROR then return nil end
  return id < text.ERROR and id + text.EXTENDED or id
end

-- All fields at once: a table that does not grow takes half the time.
local function new_record(bus, id)
  return {
    bus = bus, id = parse_id(id), fd = false, sent = false, flags = 0, raw_dlc = 0, length = 0,
    data = "", stamp = "", seconds = nil, nanoseconds = nil,
  }
end

-- Fill in a remote frame, which asks for so many bytes and has none.
local function make_remote(record, length)
  record.id = record.id and record.id + text.REMOTE
  record.length = length
  return record
end

-- Lengths that only a CAN FD frame has.
local FD_LENGTHS = {
  [12] = true, [16] = true, [20] = true, [24] = true, [32] = true, [48] = true, [64] = true,
}

-- Read the data that a log has behind "#": #<flags><data> of CAN FD, R<length>_<DLC>, <data>_<DLC>.
-- Some converters write CAN FD without "#" and flags.
local function read_log(bus, id, data, way, behind)
  if behind:find("%S") then return nil end
  local record = new_record(bus, id)
  record.sent = way == "T"
  local mark, length, hex, dlc = match(data, "^(R?)(%d?)(%x*)_?(%x?)$")
  local flags, flexible = match(data, "^#(%x)(%x*)$")
  record.raw_dlc = tonumber(dlc or "", 16) or 0
  if mark == "R" then return make_remote(record, tonumber(length) or 0) end
  if flags then
    record.fd, record.flags = true, tonumber(flags, 16)
  end
  hex = flexible or length and length .. hex
  if not hex or #hex % 2 ~= 0 then return nil end
  record.data, record.length = hex:gsub("%x%x", text.BYTES)
  record.fd = record.fd or FD_LENGTHS[record.length] or false
  return record
end

-- Read the data that the screen has behind the id: [8] classic, [08] CAN FD, {E} classic with the
-- raw DLC (-8).  Behind the bytes may stand ERRORFRAME, or in quotes the bytes as ASCII.
local function read_screen(bus, id, open, digits, data)
  local is_raw = open == "{"
  local length = tonumber(digits, is_raw and 16 or 10)
  if not length then return nil end
  local record = new_record(bus, id)
  if is_raw and length > 8 then record.raw_dlc, length = length, 8 end
  record.fd = #digits == 2
  if data:find("^%s+remote request%s*$") then return make_remote(record, length) end
  local stop
  record.data, stop = text.parse_bytes(data, length, "^%s+(%x%x)%f[%X]()", 16)
  record.length = length
  local is_whole = stop and (data:find("^%s*$", stop) or data:find("^%s+['E]", stop))
  return is_whole and record or nil
end

-- The forms of a line with a frame, behind the time in parentheses:
-- pattern     its captures are the arguments of read
-- read        returns the record, nil if the line is damaged
-- like        patterns: a line that has one, and was not understood, was a frame
-- needs_time  true if a line without a time is of another program
local FORMS = {
  { -- candump -l, -L: (1700000000.000001) can0 08404000#BBBE6FC720000000 R
    pattern = "^(%S+)%s+(%x+)#(%S*)%s*([RT]?)(.*)$",
    read = read_log,
    like = { "^%s*%([%d-]", "%x#" },
    needs_time = true,
  },
  { -- candump:  (000.000499)  can0  08404000   [8]  BB BE 6F C7 20 00 00 00   '..o. ...'
    pattern = "^%s*(%S+)%s+(%x+)%s+([%[{])(%x%x?)[%]}](.*)$",
    read = read_screen,
    like = { "[%[{]%x+[%]}]%s" },
  },
  { -- candump -x:  (000.000499)  can0  TX B E  08404000  [08]  BB BE 6F C7 20 00 00 00
    pattern = "^%s*(%S+)%s+([RT])X ([B-]) ([E-])%s+(%x+)%s+([%[{])(%x%x?)[%]}](.*)$",
    read = function(bus, way, brs, esi, id, open, digits, data)
      local record = read_screen(bus, id, open, digits, data)
      if not record then return nil end
      record.sent = way == "T"
      record.flags = (brs == "B" and 1 or 0) + (esi == "E" and 2 or 0)
      return record
    end,
    like = {},
  },
  { -- candump of canutils: <0x08404000> [8] bb be 6f c7 20 00 00 00
    pattern = "^%s*<0x(%x+)>%s+(%[)(%d)%](.*)$",
    read = function(id, ...) return read_screen(nil, id, ...) end,
    like = { "^%s*<0x%x" },
  },
}
local LIKE = {}
for _, form in ipairs(FORMS) do
  for _, pattern in ipairs(form.like) do LIKE[#LIKE + 1] = pattern end
end

-- Known lines without a frame.  candump -e prints below an error frame, behind a tab, its meaning.
local OTHERS = {
  "^%s*$", "^%s*[#;/]", "^Enabling Logfile '", "while logging[.!]?%s*$", "^DROPCOUNT: ",
  "#%x%x:%x%x:%x+#", -- CAN XL, in a log
  "%[%d%d%d%d%]%s+%(%x%x|", -- CAN XL, on the screen
  "^\t%l+%-[%l-]+%f[{%s\0]",
}

local DATE = "^(20%d%d)%-(%d%d)%-(%d%d) (%d%d):(%d%d):(%d%d)$"

-- Return the seconds since 1970, or nil.  A date is local time, as Wireshark shows it.  An
-- absolute time has ten digits at least: candump pads it.
local function parse_seconds(whole)
  if #whole <= 12 then return tonumber(whole) end
  local year, month, day, hour, min, sec = match(whole, DATE)
  if not year then return nil end
  return os.time { year = year, month = month, day = day, hour = hour, min = min, sec = sec }
end

-- Fill in the time.  Return false if there is no such time.
local function parse_stamp(record, stamp)
  local whole, fraction = match(stamp, "^(%d[%d%-: ]*)%.(%d+)$")
  local seconds = whole and parse_seconds(whole)
  if not seconds then return false end
  -- Old versions of asc2log write "1.1000000" for two seconds.
  if fraction == "1000000" then seconds, fraction = seconds + 1, "0" end
  record.stamp, record.seconds = stamp, seconds
  record.nanoseconds = tonumber((fraction .. "00000000"):sub(1, 9))
  return true
end

-- Return the frame in a line, nil if there is none.
local function frame_of(line)
  local stamp, from = match(line, "^%s*%(([^()]+)%)%s+()")
  for _, form in ipairs(FORMS) do
    local a, b, c, d, e, f, g, h = match(line, form.pattern, from)
    if a and (stamp or not form.needs_time) then
      local record = form.read(a, b, c, d, e, f, g, h)
      local is_good = record and record.id and record.length <= (record.fd and 64 or 8) and
        (not stamp or parse_stamp(record, stamp))
      return is_good and record or nil
    end
  end
  return nil
end

--- Read a line of candump's output or log.
-- line     text without its line end; colours are dropped
-- returns  as parse of text.open; a record has no bus if its line has none
function M.parse(line)
  if line:find("\27", 1, true) then line = line:gsub("\27%[[%d;]*m", "") end
  local record = frame_of(line)
  return record, not record and text.has_one_of(line, OTHERS)
end

-- Which files are candump's -----------------------------------------------------------------------

-- Bytes.  A pipe can be rewound only inside Wireshark's own buffer, which has at least HEAD and
-- less than SURE bytes (less than 256 KB on 4.0, than 8 MB on 4.4 and 4.6).
local HEAD = 4096
local SURE = 16 * 1024 * 1024
local PIECE = 1024 * 1024

-- Data bytes, or a part of them: the first line of a file may have lost its start.
local REST = "^#?[%x%s]*[RT]?%s?$"

-- Return whether candump text may begin with these lines before its first frame: the rest of a
-- line, or a shell's lines with the command.  Another first line may be another format's mark.
local function may_begin(found)
  local before = table.concat(found.others, "\n", 1, found.before)
  return found.before == 0 or before:find("candump ", 1, true) or
    found.before == 1 and (text.has_one_of(before, LIKE) or before:find(REST))
end

-- Return whether the times are those since the frame before (candump -t d), not those since the
-- first one (-t z): these climb on each bus, but for a few.
local function are_deltas(records)
  local falls, last = 0, {}
  for _, record in ipairs(records) do
    local stamp, bus = record.stamp, record.bus or ""
    if stamp:find("^%d%d%d%.") then -- not absolute, as candump pads it
      if stamp < (last[bus] or "") then falls = falls + 1 end
      last[bus] = stamp
    end
  end
  return 10 * falls > #records
end

-- Return a function that erases lines from a text: the frames of this bus that Wireshark's own
-- reader gets right in every version.  It is written in C: a run takes up to a quarter less time
-- with it.  It does not tell two buses apart before 4.6; on 4.6 an empty line ends the file, and
-- 00000000 is a standard id.
local function plain_eraser(bus)
  local pattern = "%(%d+%.%d%d%d%d%d%d%) " .. bus:gsub("%W", "%%%0") .. " (%x+)#()%x*()\r?\n"
  local function erase(id, from, to)
    local is_standard = #id == 3 and id < "800"
    local is_extended = #id == 8 and id >= "00000800" and id < "20000000"
    local count = to - from
    return (is_standard or is_extended) and count <= 16 and count % 2 == 0 and "" or nil
  end
  return function(lines) return (lines:gsub(pattern, erase)) end
end

-- Look behind a plain head for a line that is not plain.  A file that cannot be rewound is a pipe:
-- no other reader could read it any more, so all text is kept until that is known.
-- rest     what the eraser leaves of the head
-- returns  the text read from the start of the file, which is right behind it; nil if the whole
--          file is plain
local function find_unusual_text(file, head, rest, erase_plain)
  local all, size = head, #head
  while not rest:find("\n", 1, true) and #rest <= HEAD do
    local more = file:read(PIECE)
    if not more and (rest == "" or erase_plain(rest .. "\n") == "") then return nil end
    more = more or "\n"
    size = size + #more
    if size < SURE then
      all = all .. more
      if not file:seek("set", 0) then return all end
      file:seek("set", size)
    end
    rest = erase_plain(rest .. more)
  end
  file:seek("set", #head)
  return head
end

-- A file ------------------------------------------------------------------------------------------

local MAX_DROPPED = 0xFFFFFFFF -- candump counts them in 32 bits
local NO_BUS = { [""] = true, any = true }

-- Note the packets that candump lost, and the time of a frame.
local function note(log, line, record, offset)
  local count, bus = line:match("^DROPCOUNT: dropped (%d+)[^']*'?([^',]*)")
  if count then
    log:quote(line, "candump lost frames")
    log.drops[#log.drops + 1] = {
      count = math.min(tonumber(count), MAX_DROPPED),
      bus = not NO_BUS[bus] and utf8.printable(bus) or nil,
    }
  elseif record and log.has_deltas and record.seconds then
    log.clock = log.clock + record.seconds * SECOND + record.nanoseconds
    log.times[offset] = log.clock
  end
end

-- A classic data frame in a log, nothing behind it: (1700000000.000001) can0 08404000#BBBE6FC7
local USUAL = "^%((%d+)%.(%d%d%d%d%d%d)%) (%S+) (%x+)#(%x*)\r?\n()"

local IDS = memo(parse_id)

-- Read a line of the usual form: nearly all lines of a large log.  A run takes a third less time.
local function read_usual(log, lines)
  local seconds, fraction, name, digits, hex, stop = match(lines.text, USUAL, lines.pos)
  local bus, id = log.buses[name], digits and IDS[digits]
  if not (bus and id) or #hex > 16 or #hex % 2 ~= 0 or #seconds > 12 then return nil end
  if lines == log.lines then log.frames = log.frames + 1 end
  local data = hex:gsub("%x%x", text.BYTES)
  local packet = text.head(bus.number, id) .. char(#data) .. "\0\0\0" .. data
  return lines:skip_to(stop), packet, tonumber(seconds), fraction * 1000, bus
end

--- Open a file if it is candump text.
-- file     anything with read(bytes) and seek("set", offset), at its start, as io.open gives it
-- report   function(text), called with a remark on a line
-- returns  a log with read and seek_read, and { decimals = 6 or 9, of the times; has_several =
--          true if its first lines have several buses; stamps_differ, drops = as readers.log
--          returns them }.  Otherwise nil, and if Wireshark's own reader gets the log right,
--          facts for readers.log: { plain_bus, stamps_differ }
function M.open(file, report)
  local head = file:read(HEAD) or ""
  if head:find("^[^\n]*\0") then return nil end -- no text; a log that was cut off may have some
  local found = text.survey(head, #head < HEAD, M.parse)
  local count = #found.records
  if count == 0 or count < #found.others or not may_begin(found) then return nil end
  local bus, has_deltas = found.records[1].bus, are_deltas(found.records)
  if bus and not has_deltas then
    local erase_plain = plain_eraser(bus)
    head = find_unusual_text(file, head, erase_plain(head), erase_plain)
    if not head then
      return nil, { plain_bus = utf8.printable(bus), stamps_differ = found.stamps_differ }
    end
  end
  return text.open(head, report, {
    parse = M.parse,
    note = note,
    read_usual = not has_deltas and read_usual or nil,
    like = LIKE,
    has_deltas = has_deltas,
    clock = 0, -- sum of the deltas in nanoseconds
    decimals = head:find("%(%d+%.%d%d%d%d%d%d%d%d%d%)") and 9 or 6,
    has_several = found.has_several,
    stamps_differ = found.stamps_differ,
  })
end

return M
