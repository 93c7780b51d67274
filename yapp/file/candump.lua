-- SPDX-License-Identifier: GPL-2.0-or-later
-- The output and logs of candump: recognises a file, and reads the CAN frames in its lines as
-- packets.  Pure Lua.
local memo = require "yapp.base.memo"
local text = require "yapp.file.text"
local utf8 = require "yapp.base.utf8"

local match = string.match

local M = {}

local SECOND = 1000000000 -- nanoseconds

-- Times -------------------------------------------------------------------------------------------

local DATE = "^(20%d%d)%-(%d%d)%-(%d%d) (%d%d):(%d%d):(%d%d)$"

-- Return the seconds since 1970, or nil.  A date is local time, as Wireshark shows it.  An
-- absolute time has ten digits at least: candump pads it.
local function parse_seconds(whole)
  if #whole <= 12 then return tonumber(whole) end
  local year, month, day, hour, min, sec = match(whole, DATE)
  if not year then return nil end
  return os.time { year = year, month = month, day = day, hour = hour, min = min, sec = sec }
end

local function set_time(record, stamp)
  if not stamp then return true end
  local whole, fraction = match(stamp, "^(%d[%d%-: ]*)%.(%d+)$")
  local seconds = whole and parse_seconds(whole)
  if not seconds then return false end
  -- Old versions of asc2log write "1.1000000" for two seconds.
  if fraction == "1000000" then seconds, fraction = seconds + 1, "0" end
  record.stamp, record.seconds = stamp, seconds
  record.nanoseconds = tonumber((fraction .. "00000000"):sub(1, 9))
  return true
end

-- A line ------------------------------------------------------------------------------------------

-- Return the id with SocketCAN's flags for 3 (standard) or 8 (extended, or error) hex digits, or
-- nil.
local function parse_id(digits)
  local id = tonumber(digits, 16)
  if #digits == 3 and id < 0x800 then return id end
  if #digits ~= 8 or id >= 2 * text.ERROR then return nil end
  return id < text.ERROR and id + text.EXTENDED or id
end

-- Return a remote frame, which asks for so many bytes and has none.
local function remote(bus, digits, length)
  local id = parse_id(digits)
  return { bus = bus, id = id and id + text.REMOTE, length = length, data = "" }
end

-- Read the data that a log has behind "#": those of CAN FD are #<flags><data>, or have a length
-- that only CAN FD has; a remote frame is R<length>.
local function read_log(_, bus, id, hex, way, behind)
  local length, flags = match(hex, "^R(%d?)$"), match(hex, "^#(%x)")
  if behind:find("%S") then return nil end
  local record
  if length then
    record = remote(bus, id, tonumber(length) or 0)
  else
    hex = flags and hex:sub(3) or hex
    if hex:find("%X") or #hex % 2 ~= 0 then return nil end
    record = { bus = bus, id = parse_id(id), data = hex:gsub("%x%x", text.BYTES) }
    record.fd = flags ~= nil or #record.data > 8 and #record.data % 4 == 0
    record.flags = flags and tonumber(flags, 16)
  end
  record.sent = way == "T"
  return record
end

-- Read the data that the screen has behind the id: [8] classic, [08] CAN FD.  Behind the bytes may
-- stand ERRORFRAME, or in quotes the bytes as ASCII.
local function read_screen(_, bus, id, digits, data)
  local length = tonumber(digits)
  if data:find("^%s+remote request%s*$") then return remote(bus, id, length) end
  local bytes, stop = text.parse_bytes(data, length, "^%s+(%x%x)%f[%X]()", 16)
  if not (stop and (data:find("^%s*$", stop) or data:find("^%s+['E]", stop))) then return nil end
  return { bus = bus, id = parse_id(id), data = bytes, fd = #digits == 2 }
end

local FORMS = {
  { -- candump -l, -L: (1700000000.000001) can0 08404000#BBBE6FC720000000 R
    pattern = "^(%S+)%s+(%x+)#(%S*)%s*([RT]?)(.*)$",
    read = read_log,
    like = "%x#",
    needs_time = true,
  },
  { -- candump:  (000.000499)  can0  08404000   [8]  BB BE 6F C7 20 00 00 00   '..o. ...'
    pattern = "^%s*(%S+)%s+(%x+)%s+%[(%d%d?)%](.*)$",
    read = read_screen,
    like = "%[%x+%]%s",
  },
  { -- candump -x:  (000.000499)  can0  TX B E  08404000  [08]  BB BE 6F C7 20 00 00 00
    pattern = "^%s*(%S+)%s+([RT])X ([B-]) ([E-])%s+(%x+)%s+%[(%d%d?)%](.*)$",
    read = function(log, bus, way, brs, esi, id, digits, data)
      local record = read_screen(log, bus, id, digits, data)
      if not record then return nil end
      record.sent = way == "T"
      record.flags = (brs == "B" and 1 or 0) + (esi == "E" and 2 or 0)
      return record
    end,
    like = "^%s*%([%d-]", -- a time, or its first digits
  },
  { -- candump of canutils: <0x08404000> [8] bb be 6f c7 20 00 00 00
    pattern = "^%s*<0x(%x+)>%s+%[(%d)%](.*)$",
    read = function(log, ...) return read_screen(log, nil, ...) end,
    like = "^%s*<0x%x",
  },
}

-- candump -e prints below an error frame, behind a tab, its meaning.
local KNOWN = {
  "^%s*$", "^%s*[#;/]", "^enabling logfile '", "while logging[.!]?%s*$", "^dropcount: ",
  "#%x%x:%x%x:%x+#", -- CAN XL, in a log
  "%[%d%d%d%d%]%s+%(%x%x|", -- CAN XL, on the screen
  "^\t%l+%-[%l-]+%f[{%s\0]",
}

-- A file ------------------------------------------------------------------------------------------

-- Note the packets that candump lost, and the time of a frame.
local function note(log, line, record, offset)
  local count, bus = line:match("^DROPCOUNT: dropped (%d+)[^']*'?([^',]*)")
  if count then
    log:quote(line, "candump lost frames")
    log.drops[#log.drops + 1] = {
      count = tonumber(count),
      bus = bus ~= "" and bus ~= "any" and utf8.printable(bus) or nil,
    }
  elseif record and log.has_deltas and record.seconds then
    log.clock = log.clock + record.seconds * SECOND + record.nanoseconds
    log.times[offset] = log.clock
  end
end

-- Return whether the times are those since the frame before (candump -t d), not those since the
-- first one (-t z): these climb on each bus, but for a few.
local function are_deltas(records)
  local falls, last = 0, {}
  for _, record in ipairs(records) do
    local stamp, bus = record.stamp or "", record.bus or ""
    if stamp:find("^%d%d%d%.") then -- not absolute, as candump pads it
      if stamp < (last[bus] or "") then falls = falls + 1 end
      last[bus] = stamp
    end
  end
  return 10 * falls > #records
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
  local packet = text.packet(bus.number, { id = id, data = hex:gsub("%x%x", text.BYTES) })
  return lines:skip_to(stop), packet, tonumber(seconds), fraction * 1000, bus
end

-- Return a function that erases lines from a text: the frames of this bus that Wireshark's own
-- reader gets right in every version.  It is written in C: a run takes up to a quarter less time
-- with it.  It does not tell two buses apart before 4.6; on 4.6 an empty line ends the file, and
-- 00000000 is a standard id.
local function plain_eraser(bus)
  local pattern = "%f[^\n\0]%(%d+%.%d%d%d%d%d%d%) " .. bus:gsub("%W", "%%%0") ..
    " (%x+)#()%x*()\r?\n"
  local function erase(digits, from, to)
    local id, count = IDS[digits], to - from
    local is_plain = id and (id < 0x800 or id >= text.EXTENDED + 0x800)
    return is_plain and count <= 16 and count % 2 == 0 and "" or nil
  end
  return function(lines) return (lines:gsub(pattern, erase)) end
end

-- Bytes.  A pipe can be rewound only inside Wireshark's own buffer, which has at least HEAD and
-- less than SURE bytes (less than 256 KB on 4.0, than 8 MB on 4.4 and 4.6).
local HEAD = 4096
local SURE = 16 * 1024 * 1024

-- Look in a file for a line that is not plain.  If the file cannot be rewound it is a pipe, which
-- no other reader could read any more.
-- returns  the text read from the start of the file, which is right behind it; nil if the whole
--          file is plain
local function find_unusual_text(file, head, erase_plain)
  local rest, size = erase_plain(head), #head
  while not rest:find("\n") and #rest <= HEAD do
    local more = file:read(SURE)
    if not more and (rest == "" or erase_plain(rest .. "\n") == "") then return nil end
    more = more or "\n"
    if not file:seek("set", 0) then return head .. more end
    size = size + #more
    file:seek("set", size)
    rest = erase_plain(rest .. more)
  end
  file:seek("set", #head)
  return head
end

--- The format of candump's lines, see file.text.
M.FORMAT = {
  stamp = "^%s*%(([^()]+)%)%s+()",
  set_time = set_time,
  forms = FORMS,
  known = KNOWN,
  note = note,
}

-- Return whether the lines of a head are candump's.  Another first line may be another format's
-- mark, unless it is a shell's or the end of a line of data.
local function is_candump(log)
  local may_begin = log.before == "" or log.before:find("candump ", 1, true) or
    log.before:find("^[^\n]*%x%x%s*[RT]?%s*$")
  return may_begin and log.records[1] and #log.records >= log.others
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
  local log = text.new(head, #head < HEAD, M.FORMAT, {
    clock = 0, -- sum of the deltas in nanoseconds
  })
  if not is_candump(log) then return nil end
  local bus = log.records[1].bus
  log.has_deltas = are_deltas(log.records)
  if bus and not log.has_deltas then
    head = find_unusual_text(file, head, plain_eraser(bus))
    if not head then
      return nil, { plain_bus = utf8.printable(bus), stamps_differ = log.stamps_differ }
    end
  end
  log.read_usual = not log.has_deltas and read_usual
  log.decimals = head:find("%.%d%d%d%d%d%d%d%d%d%f[%D]") and 9 or 6
  return log:open(head, report)
end

return M
