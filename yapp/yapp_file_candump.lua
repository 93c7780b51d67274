-- The text candump prints and logs: lines into CAN frames, a whole file into a series of them. Pure Lua.
--
-- Two forms, after can-utils (lib.c, candump.c), plus the same line pasted from a document:
--   log     (1700000000.000001) can0 08404000#BBBE6FC720000000 R
--   screen   (000.000499)  can0  RX - -  08404000   [8]  BB BE 6F C7 20 00 00 00   '..o. ...'
local find, match, gmatch, gsub = string.find, string.match, string.gmatch, string.gsub
local byte, char, sub, rep, format = string.byte, string.char, string.sub, string.rep, string.format

local M = {}

-- Sizes, in bytes. A pipe can be rewound inside Wireshark's own buffer only, which is never less than HEAD
-- and never as much as SURE (less than 256 KB on 4.0, than 8 MB on 4.4 and 4.6).
local HEAD = 4096
local SURE = 16 * 1024 * 1024
local BLOCK, PIECE = 65536, 1024 * 1024
-- The longest line candump prints has 64 bytes in binary digits, 700 characters in all.
local LONGEST = 4096

-- Flags in the upper bits of a SocketCAN id (linux/can.h).
local EXTENDED, REMOTE, ERROR = 0x80000000, 0x40000000, 0x20000000

-- Why a line gives no frame.
local EMPTY, COMMENT = "an empty line, skipped", "a comment, skipped"
local UNKNOWN, LONG = "not a candump line, skipped", "longer than any candump line, skipped"
local TIME, ID = "no such time, line skipped", "no such CAN id, line skipped"
local DATA, XL = "the data bytes do not fit, line skipped", "CAN XL is not supported, line skipped"
local DROPPED, SAID = "candump lost frames", "a message of candump's, skipped"
-- What there is to say about a line with a frame.
local BEHIND, REPAIRED = "text behind the frame, ignored", "letters that look like hex digits, read as such"
-- Of no interest in the packet list; and no reason to doubt that a file is candump's.
local HARMLESS = { [EMPTY] = true, [COMMENT] = true, [SAID] = true, [BEHIND] = true }
local NEUTRAL = { [EMPTY] = true, [COMMENT] = true, [SAID] = true, [DROPPED] = true, [XL] = true }
-- So many lines are reported one by one for each reason.
local REPORTED = 3
-- Buses with a number of their own, and those named in the packet list: no file has so many, except a hostile one.
local MOST_BUSES, COMMENTED_BUSES = 4096, 100

-- The first word of what `candump -e` prints below an error frame.
local ERROR_TEXT = {}
for word in gmatch("tx-timeout lost-arbitration controller-problem protocol-violation transceiver-status " ..
  "no-acknowledgement-on-tx bus-off bus-error restarted-after-bus-off error-counter-tx-rx", "%S+") do
  ERROR_TEXT[word] = true
end

-- Two hex digits in any case, or eight binary digits, to a byte.
local FROM_HEX, FROM_BITS = {}, {}
for value = 0, 255 do
  local high, low = match(format("%02x", value), "(.)(.)")
  for _, h in ipairs { high, high:upper() } do
    for _, l in ipairs { low, low:upper() } do FROM_HEX[h .. l] = char(value) end
  end
  local bits, left = "", value
  for _ = 1, 8 do
    bits, left = format("%d", left % 2) .. bits, (left - left % 2) / 2
  end
  FROM_BITS[bits] = char(value)
end

----------------------------------------------------------------------------------------------------------
-- A line
----------------------------------------------------------------------------------------------------------

-- The id with its flags for 3 (standard) or 8 (extended, or error) hex digits, or nil.
local function read_id(digits)
  local id = tonumber(digits, 16)
  if #digits == 3 then return id < 0x800 and id or nil end
  if #digits ~= 8 or id >= 2 * ERROR then return nil end
  return id < ERROR and id + EXTENDED or id
end

-- Digits behind the decimal point, in nanoseconds.
local function nanoseconds(fraction)
  if #fraction == 6 then return tonumber(fraction) * 1000 end
  return tonumber(sub(fraction .. "00000000", 1, 9))
end

-- Date and hour "2023-11-14 22" in seconds since 1970, or nil. candump prints local time, as Wireshark does. The
-- last one is kept: a log has thousands of lines an hour.
local last_hour, last_hour_seconds
local function hour_seconds(text)
  if text ~= last_hour then
    local y, m, d, h = match(text, "^(%d%d%d%d)%-(%d%d)%-(%d%d) (%d%d)$")
    y, m, d, h = tonumber(y), tonumber(m), tonumber(d), tonumber(h)
    if not y or y < 1970 or m < 1 or m > 12 or d < 1 or d > 31 or h > 23 then return nil end
    last_hour, last_hour_seconds = text, os.time { year = y, month = m, day = d, hour = h }
  end
  return last_hour_seconds
end

-- Seconds, nanoseconds, relative or not of what stands in the parentheses; nil if it is no time.
-- An absolute time has ten digits at least: candump pads it.
local function read_stamp(text)
  local seconds, fraction = match(text, "^(%d+)%.(%d+)$")
  if seconds then
    if #seconds > 12 then return nil end
    return tonumber(seconds), nanoseconds(fraction), #seconds < 10
  end
  local hour, minute, second, part = match(text, "^(%d+%-%d+%-%d+ %d%d):(%d%d):(%d%d)%.(%d+)$")
  seconds = hour and hour_seconds(hour)
  if not seconds then return nil end
  return seconds + 60 * tonumber(minute) + tonumber(second), nanoseconds(part), false
end

-- What stands behind "#" in a log: fills in the record, or returns the reason why it cannot.
local function read_log_data(record, text)
  local most, hex = 8, text
  local first = byte(text, 1)
  if first == 35 then -- "#": CAN FD, flags in one digit
    record.fd, most = true, 64
    record.flags, hex = tonumber(sub(text, 2, 2), 16), sub(text, 3)
    if not record.flags then return DATA end
  elseif first == 82 or first == 114 then -- "R" or "r": remote frame, its length in one digit
    local digit, raw = match(text, "^.([0-8]?)_?(%x?)$")
    if not digit or raw ~= "" and not find(text, "8_[9A-Fa-f]$") then return DATA end
    record.id, record.length = record.id + REMOTE, tonumber(digit) or 0
    record.data, record.raw_dlc = rep("\0", record.length), tonumber(raw, 16) or 0
    return nil
  end
  if find(hex, "[_.]") then
    local plain, raw = match(hex, "^(.-)_([9A-Fa-f])$")
    if plain then hex, record.raw_dlc = plain, tonumber(raw, 16) end
    hex = gsub(hex, "(%x%x)%.", "%1")
  end
  local data, count = gsub(hex, "%x%x", FROM_HEX)
  if 2 * count ~= #hex or count > most then return DATA end
  record.data, record.length = data, count
end

local function log_line(line)
  local seconds, fraction, bus, id, data, rest =
    match(line, "^%s*%((%d+)%.(%d+)%)%s+(%S+)%s+(%x+)#(%S*)(.*)$")
  if not seconds then return nil end
  if #seconds > 12 then return nil, TIME end
  if rest ~= "" then rest = match(rest, "%S.*%f[%s\0]") or "" end
  local record = { bus = bus, id = read_id(id), fd = false, flags = 0, length = 0, data = "", raw_dlc = 0,
    seconds = tonumber(seconds), nanoseconds = nanoseconds(fraction), relative = false, sent = rest == "T" }
  if not record.id then return nil, find(data, "^%x%x:") and XL or ID end
  local why = read_log_data(record, data)
  if why then return nil, why end
  if rest ~= "" and rest ~= "R" and rest ~= "T" then record.note = BEHIND end
  return record
end

-- The four ways candump prints data bytes: hex or binary (-i), in order or swapped (-S).
local LAYOUTS = {
  { first = "%s+%x%x", next = "%s+%x%x", bytes = FROM_HEX },
  { first = "%s+%x%x", next = "`%x%x", bytes = FROM_HEX, swapped = true },
  { first = "%s+" .. rep("[01]", 8), next = "%s+" .. rep("[01]", 8), bytes = FROM_BITS },
  { first = "%s+" .. rep("[01]", 8), next = "`" .. rep("[01]", 8), bytes = FROM_BITS, swapped = true },
}
for _, layout in ipairs(LAYOUTS) do
  layout.pattern = {}
  for count = 1, 64 do
    layout.pattern[count] = "^(" .. layout.first .. rep(layout.next, count - 1) .. ")%f[%X](.*)$"
  end
end

-- `count` data bytes at the start of the text, and what stands behind them; nil if they are not there.
local function screen_bytes(text, count)
  if count == 0 then return "", text end
  for _, layout in ipairs(LAYOUTS) do
    local digits, rest = match(text, layout.pattern[count])
    if digits and not find(rest, "^`") then
      local data = gsub(digits, "[%s`]+(%x+)", layout.bytes)
      return layout.swapped and data:reverse() or data, rest
    end
  end
end

-- Whether text behind `count` data bytes is candump's own: nothing, ERRORFRAME, or the bytes as ASCII.
local function is_own_tail(text, count)
  if text == "" or find(text, "^%s*$") or find(text, "^%s+ERRORFRAME%s*$") then return true end
  local _, ascii = match(text, "^%s+(['`])(.*)%1%s*$")
  return ascii ~= nil and #ascii == count
end

-- Length and raw DLC from the brackets: [8] classic, [08] CAN FD, {E} classic with the raw DLC (-8).
local function read_length(record, open, digits)
  record.fd = #digits == 2
  if open == "{" then
    local dlc = not record.fd and tonumber(digits, 16)
    record.length = dlc and math.min(dlc, 8)
    record.raw_dlc = dlc and dlc > 8 and dlc or 0
  else
    record.length = tonumber(digits)
  end
  return record.length and record.length <= (record.fd and 64 or 8)
end

-- The data of a screen line: fills in the record, or returns the reason why it cannot.
local function read_screen_data(record, text)
  if find(text, "^%s+remote request%s*$") then
    if record.fd then return DATA end
    record.id, record.data = record.id + REMOTE, rep("\0", record.length)
    return nil
  end
  local data, rest = screen_bytes(text, record.length)
  if not data then return DATA end
  record.data = data
  if is_own_tail(rest, record.length) then return nil end
  -- Without a time a line is candump's only if all of it is; more bytes than announced are never right.
  if not record.seconds or not find(rest, "^%s") then return UNKNOWN end
  if find(rest, "^%s+%x%x%f[%X]") then return DATA end
  record.note = BEHIND
end

local function screen_line(line)
  local stamp, rest = match(line, "^%s*%(([^()]+)%)%s+(.*)$")
  rest = rest or line
  local way, brs, esi
  local bus, id, open, digits, data = match(rest, "^%s*(%S+)%s+(%x+)%s+([%[{])(%x%x?)[%]}](.*)$")
  if not bus then
    bus, way, brs, esi, id, open, digits, data =
      match(rest, "^%s*(%S+)%s+([RT])X ([B-]) ([E-])%s+(%x+)%s+([%[{])(%x%x?)[%]}](.*)$")
  end
  if not bus then return nil, UNKNOWN end
  local record = { bus = bus, id = read_id(id), fd = false, flags = 0, length = 0, data = "", raw_dlc = 0,
    sent = way == "T" }
  if not record.id then return nil, stamp and ID or UNKNOWN end
  if not read_length(record, open, digits) then return nil, stamp and DATA or UNKNOWN end
  if stamp then
    record.seconds, record.nanoseconds, record.relative = read_stamp(stamp)
    if not record.seconds then return nil, TIME end
  end
  record.flags = (brs == "B" and 1 or 0) + (esi == "E" and 2 or 0)
  local why = read_screen_data(record, data)
  if why then return nil, why end
  return record
end

-- Letters that hex digits turn into on the way from a printed document: Greek, Cyrillic, and mathematics.
local LOOK_ALIKES = {
  ["\206\145"] = "A", ["\208\144"] = "A", ["\206\146"] = "B", ["\208\146"] = "B", ["\208\161"] = "C",
  ["\206\149"] = "E", ["\208\149"] = "E", ["\208\151"] = "3", ["\208\177"] = "6", ["\206\152"] = "0",
  ["\206\159"] = "0", ["\208\158"] = "0", ["\194\160"] = " ",
}

-- The line with such letters as the digits they stand for, or nil if it has none.
local function repaired(line)
  local text, count = gsub(line, "[\194\206\208][\128-\191]", LOOK_ALIKES)
  local circles
  text, circles = gsub(text, "%$\\odot \\odot%$", "00")
  return count + circles > 0 and gsub(text, "(%x)O%f[%s\0]", "%10") or nil
end

-- The reason why a line that is no frame is skipped, or nil for text that belongs to candump's form.
local function other_line(line, why)
  if find(line, "^%s*$") then return EMPTY end
  if find(line, "^%s*[#;]") or find(line, "^%s*//") then return COMMENT end
  if find(line, "^DROPCOUNT: ") then return DROPPED end
  if find(line, "^Enabling Logfile '") or find(line, "while logging[.!]?%s*$") then return SAID end
  local word = match(line, "^\t([%l-]+)")
  if word and ERROR_TEXT[word] then return nil end
  return why
end

--- Reads one line.
-- @param line text without its line end; colours are dropped
-- @return the frame: bus (its name), id (32 bits, flags as SocketCAN has them), fd, flags (CAN FD: 1 BRS, 2 ESI),
--   length (bytes, or the DLC of a remote frame), data (a string of that length, zero in a remote frame),
--   raw_dlc (9 to 15 or 0), sent; seconds, nanoseconds and relative unless there is no time; note (what is
--   to say about the line, or nil). Otherwise nil and a reason, or nil alone for a line of -e below a frame.
function M.parse(line)
  if #line > LONGEST then return nil, LONG end
  if find(line, "\27", 1, true) then line = gsub(line, "\27%[[%d;]*m", "") end
  local record, why
  if find(line, "#", 1, true) then
    record, why = log_line(line)
    if record or why then return record, why end
  end
  record, why = screen_line(line)
  if record then return record end
  local text = repaired(line)
  record = text and screen_line(text)
  if record then
    record.note = REPAIRED
    return record
  end
  return nil, other_line(line, why)
end

----------------------------------------------------------------------------------------------------------
-- Lines of a file
----------------------------------------------------------------------------------------------------------

-- Lines are cut from `text`, the part of the file from offset `base` on; `pos` is where the next one starts.
local function new_lines(text)
  return { text = text, base = 0, pos = 1, number = 0 }
end

-- Reads on in the file; false at its end. Of a line without end only what tells that it is too long is kept.
local function read_on(lines, file)
  local rest = sub(lines.text, lines.pos)
  lines.base = lines.base + lines.pos - 1
  if #rest > LONGEST then
    lines.cut = lines.cut or { text = sub(rest, 1, LONGEST + 1), offset = lines.base }
    lines.base, rest = lines.base + #rest, ""
  end
  local more, why = file:read(BLOCK)
  if why then error("cannot read on at offset " .. lines.base + #rest .. ": " .. why, 0) end
  more = more or ""
  lines.text, lines.pos = rest .. more, 1
  return more ~= ""
end

-- The next line without its "\n", and its offset; nil at the end.
local function next_line(lines, file)
  local stop = find(lines.text, "\n", lines.pos, true)
  while not stop and read_on(lines, file) do stop = find(lines.text, "\n", lines.pos, true) end
  stop = stop or #lines.text + 1
  local start, cut = lines.pos, lines.cut
  if start > #lines.text and not cut then return nil end
  lines.pos, lines.cut, lines.number = stop + 1, nil, lines.number + 1
  if cut then return cut.text, cut.offset end
  return sub(lines.text, start, stop - 1), lines.base + start - 1
end

-- Goes to an offset, inside the text at hand when possible.
local function go_to(lines, file, offset)
  local pos = offset - lines.base + 1
  lines.cut = nil
  if pos >= 1 and pos <= #lines.text then
    lines.pos = pos
  else
    file:seek("set", offset)
    lines.text, lines.base, lines.pos = "", offset, 1
  end
end

----------------------------------------------------------------------------------------------------------
-- Is it ours?
----------------------------------------------------------------------------------------------------------

-- The digits the built-in reader takes behind "#", by what comes first: data, remote, CAN FD.
local PLAIN_DIGITS = { [""] = {}, R = { [0] = true, [1] = true }, ["#"] = {} }
for count = 0, 8 do PLAIN_DIGITS[""][2 * count] = true end
for _, count in ipairs { 0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64 } do
  PLAIN_DIGITS["#"][1 + 2 * count] = true
end

-- A test for text of whole lines, all of them log lines of this bus the built-in reader of every version gets
-- right. It takes one space, six decimals, a number of digits that fits, and nothing more; it does not tell two
-- buses apart before 4.6, and an empty line ends the file for it on 4.6. From 4.6 on it goes by an id's value, not by
-- its digits: 00000000 is a standard id to it, and an error frame's an extended one (by_value).
local function plain_test(bus, by_value)
  local name = gsub(bus, "%W", "%%%0")
  local pattern = "%(%d+%.%d%d%d%d%d%d%) " .. name .. " ([0-7]%x+)#([#R]?)()%x*()\r?\n"
  local function erase(id, kind, data, data_end)
    local size = #id
    local right = size == 3 or size == 8 and not (by_value and (id < "00000800" or id >= "20000000"))
    return right and PLAIN_DIGITS[kind][data_end - data] and "" or nil
  end
  return function(text) return gsub(text, pattern, erase) == "" end
end

-- candump -t d prints the time since the frame before, -t z since the first one. On one bus the latter climb, or
-- stay where an adapter stamps several frames at once; the former go up and down, or repeat. (Of several buses two
-- frames may change places.)
local function are_deltas(records)
  local last, falls, repeats, rises = {}, 0, 0, 0
  for _, record in ipairs(records) do
    local time = record.seconds * 1000000000 + record.nanoseconds
    local before = last[record.bus] or time
    if time < before then
      falls = falls + 1
    elseif time > before then
      rises = rises + 1
    elseif time > 0 and last[record.bus] then
      repeats = repeats + 1
    end
    last[record.bus] = time
  end
  if falls > 0 or rises <= 1 then falls = falls + repeats end
  return 10 * falls > #records
end

-- Cuts text behind its last line end. At the end of the file all of it is lines.
local function whole_lines(text, at_end)
  if at_end then return (gsub(text, "([^\n])$", "%1\n")), "" end
  local lines, rest = match(text, "^(.*\n)(.*)$")
  return lines or "", rest or text
end

-- What the rest of a line may be: cut in its id, in its length, in its data bytes, behind them.
local RESTS = { "^%x*#", "^%x*%s*[%[{]?%x*[%]}]", "^[%x%s`]+$", "['`]%s*$", " request%s*$" }

-- Whether a line is the rest of one of candump's whose start was cut off: with the start of another one in front it is
-- a frame again. Where their ids or lengths differ this fails, and it has to look like such a rest.
local function is_rest(line, whole)
  for size = 1, math.min(#whole, 200) do -- a frame's line has less in front of its data
    local record = M.parse(sub(whole, 1, size) .. line)
    if record and not record.note then return true end
  end
  for _, rest in ipairs(RESTS) do
    if find(line, rest) then return true end
  end
  return false
end

-- Whether a file of candump text may start with these lines, which are no frames: the rest of one in a log cut at its
-- start, or a shell's with the command. Any other first line may be another format's mark.
local function may_begin(lines, first_frame)
  for _, line in ipairs(lines) do
    if find(line, "candump ", 1, true) then return true end
  end
  return #lines == 0 or #lines == 1 and is_rest(lines[1], first_frame)
end

-- What the first lines of a file tell: nil if they are not candump's, else whether its times are deltas, how many
-- decimals they have (6 or 9), and the test for plain lines if all of these are plain.
local function recognise(text, by_value)
  local frames, others, before, timed, decimals, bus = 0, 0, {}, {}, 6, nil
  for line in gmatch(text, "([^\n]*)\n") do
    local record, why = M.parse(line)
    if record then
      if frames == 0 and not may_begin(before, line) then return nil end
      frames, bus = frames + 1, bus or record.bus
      if record.relative then timed[#timed + 1] = record end
      if record.seconds and record.nanoseconds % 1000 ~= 0 then decimals = 9 end
    elseif why and not NEUTRAL[why] then
      others = others + 1
      if frames == 0 then before[others] = line end
    end
  end
  if frames <= others then return nil end
  local is_plain = plain_test(bus, by_value)
  return { deltas = are_deltas(timed), decimals = decimals, is_plain = is_plain(text) and is_plain or nil }
end

-- Looks behind a plain start for a line that needs this reader. Returns the text read from the start of the file,
-- with the file right behind it, or nil if the file is plain throughout. A file that cannot be rewound is a pipe:
-- nobody else could read it any more, so it is taken. All text is kept until that is known.
local function text_that_needs_us(file, head, is_plain)
  local pieces, size = { head }, #head
  local _, rest = whole_lines(head, false)
  repeat
    local more = file:read(math.min(size, PIECE)) or ""
    size = size + #more
    if size < SURE then
      pieces[#pieces + 1] = more
      if not file:seek("set", 0) then return table.concat(pieces) end
      file:seek("set", size)
    end
    local lines
    lines, rest = whole_lines(rest .. more, more == "")
    if #rest > LONGEST or not is_plain(lines) then
      file:seek("set", #head)
      return head
    end
  until more == ""
end

----------------------------------------------------------------------------------------------------------
-- A file
----------------------------------------------------------------------------------------------------------

--- Opens a file if it is candump text.
-- @param file anything with read(bytes) and seek("set", offset), at its start, as io.open gives it
-- @param all true to take all candump text, false to leave to Wireshark's own reader what that gets right
-- @param report function(text), called with a line for each message; may be nil
-- @param by_value whether that reader tells extended ids by their value, as 4.6 does
-- @return what read and seek_read need, with decimals (6 or 9) of the times; nil if the file is not taken
function M.open(file, all, report, by_value)
  local head = file:read(HEAD) or ""
  if find(head, "\0", 1, true) then return nil end
  local start = #match(head, "^\239?\187?\191?") + 1 -- a byte order mark
  local found = recognise((whole_lines(sub(head, start), #head < HEAD)), by_value)
  if not found then return nil end
  local text = head
  if found.is_plain and start == 1 and not all then
    text = text_that_needs_us(file, head, found.is_plain)
    if not text then return nil end
  end
  local log = {
    decimals = found.decimals, deltas = found.deltas, report = report or function() end,
    lines = new_lines(text), random = new_lines(""), -- in order; and wherever a frame is wanted again
    seconds = 0, nanoseconds = 0, marks = {}, count = 0, -- of deltas
    buses = {}, taken = {}, bus_count = 0, comments = {}, pending = {}, skipped = {},
  }
  log.lines.pos = start
  return log
end

-- The number of a bus: the one its name ends in (can1 is 1) unless another bus has it, else the first free one.
-- Second result: true if it is new.
local function bus_number(log, name)
  local number = log.buses[name]
  if number then return number, false end
  if log.bus_count == MOST_BUSES then return MOST_BUSES, false end
  number = tonumber(match(name, "%f[%d]%d?%d?%d$"))
  if not number or log.taken[number] then
    number = log.lowest or 0
    while log.taken[number] do number = number + 1 end
    log.lowest = number + 1
  end
  log.buses[name], log.taken[number], log.bus_count = number, true, log.bus_count + 1
  return number, true
end

-- A line to tell of, for the most part one without a frame: at once, and in the packet list at the next frame.
local function skip(log, line, why)
  local count = (log.skipped[why] or 0) + 1
  log.skipped[why] = count
  if count > REPORTED then return end
  local message = format("line %d: %s", log.lines.number, why)
  local shown = match(gsub(gsub(sub(line, 1, 80), "%c", " "), "[\128-\255]", "?"), "%S.*%f[%s\0]")
  if shown then message = format('%s: "%s"', message, shown) end
  log.report(message)
  if not HARMLESS[why] then log.pending[#log.pending + 1] = message end
end

-- Says how many lines there were of what was not told line by line.
local function report_total(log)
  local parts = {}
  for why, count in pairs(log.skipped) do
    if count > REPORTED then parts[#parts + 1] = format("%d times: %s", count, why) end
  end
  table.sort(parts)
  for _, part in ipairs(parts) do log.report(part) end
  log.skipped = {}
end

-- Every so many deltas the time so far is kept: offset of the frame, time before it.
local MARK_EVERY = 64

local function mark(log, offset)
  if log.count % MARK_EVERY == 0 then
    log.marks[#log.marks + 1] = { offset = offset, seconds = log.seconds, nanoseconds = log.nanoseconds }
  end
  log.count = log.count + 1
end

-- Adds a relative time to the time in `clock`, and puts the sum in the record.
local function add_delta(clock, record)
  if not record.relative then return end
  local seconds, ns = clock.seconds + record.seconds, clock.nanoseconds + record.nanoseconds
  if ns >= 1000000000 then seconds, ns = seconds + 1, ns - 1000000000 end
  clock.seconds, clock.nanoseconds = seconds, ns
  record.seconds, record.nanoseconds = seconds, ns
end

-- The last mark at or before an offset.
local function mark_before(marks, offset)
  local low, high = 1, #marks
  while low < high do
    local middle = math.floor((low + high + 1) / 2)
    if marks[middle].offset <= offset then low = middle else high = middle - 1 end
  end
  return marks[low]
end

-- What the packet list shall say with the frame at this offset: its bus if it is the first of it, lines skipped.
local function comment_on(log, record, offset, is_new)
  if is_new and log.bus_count <= COMMENTED_BUSES then
    log.pending[#log.pending + 1] = format("Interface index %d is %s", record.number, record.bus)
  end
  if #log.pending > 0 then log.comments[offset], log.pending = table.concat(log.pending, "\n"), {} end
end

--- Reads the next frame.
-- @param log from open
-- @param file the file it was opened with
-- @return the frame as parse gives it, with number (of its bus), comment (text or nil), and its time since 1970
--   or since the first frame; and its offset. nil at the end
function M.read(log, file)
  local lines = log.lines
  local line, offset = next_line(lines, file)
  while line do
    local record, why = M.parse(line)
    if record then
      local is_new
      record.number, is_new = bus_number(log, record.bus)
      if log.deltas then
        mark(log, offset)
        add_delta(log, record)
      end
      if record.note then skip(log, line, record.note) end
      if is_new or #log.pending > 0 then comment_on(log, record, offset, is_new) end
      record.comment = log.comments[offset]
      return record, offset
    end
    if why then skip(log, line, why) end
    line, offset = next_line(lines, file)
  end
  report_total(log)
end

-- Puts the random lines where reading must start for the time at `offset` to be known: as near as possible.
local function go_before(log, file, offset)
  local lines = log.random
  if not log.deltas then return go_to(lines, file, offset) end
  local nearest = mark_before(log.marks, offset)
  local here = lines.base + lines.pos - 1
  if lines.seconds and here <= offset and here > nearest.offset then return end
  go_to(lines, file, nearest.offset)
  lines.seconds, lines.nanoseconds = nearest.seconds, nearest.nanoseconds
end

--- Reads a frame again.
-- @param log from open
-- @param file a second handle on the same file, used for nothing else
-- @param offset of the frame, as read gave it
-- @return the frame as read gave it, or nil
function M.seek_read(log, file, offset)
  go_before(log, file, offset)
  repeat
    local line, at = next_line(log.random, file)
    local record = line and M.parse(line)
    if record and log.deltas then add_delta(log.random, record) end
    if record and at == offset then
      record.number, record.comment = bus_number(log, record.bus), log.comments[offset]
      return record
    end
  until not line or at >= offset
end

----------------------------------------------------------------------------------------------------------
-- A packet
----------------------------------------------------------------------------------------------------------

-- Linux cooked capture v2, big endian: protocol, reserved, interface index, device type, packet type, no address.
local CAN, CAN_FD, ARPHRD_CAN, TO_US, OUTGOING = 0x0C, 0x0D, 280, 0, 4

--- A frame as a packet of link type LINUX_SLL2: the cooked header, the SocketCAN header, the data.
-- @param record from read or seek_read
-- @param big_endian true on a host of that kind: Wireshark takes the id in the host's order here
-- @return the bytes, a string
function M.packet(record, big_endian)
  local id, number = record.id, record.number
  local a = id % 256
  local b = (id - a) / 256 % 256
  local c = (id - a - 256 * b) / 65536 % 256
  local d = (id - a - 256 * b - 65536 * c) / 16777216
  if big_endian then a, b, c, d = d, c, b, a end
  local low = number % 256
  return char(0, record.fd and CAN_FD or CAN, 0, 0, 0, 0, (number - low) / 256, low,
    1, ARPHRD_CAN - 256, record.sent and OUTGOING or TO_US, 0, 0, 0, 0, 0, 0, 0, 0, 0,
    a, b, c, d, record.length, record.flags, 0, record.raw_dlc) .. record.data
end

return M
