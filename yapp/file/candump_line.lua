-- SPDX-License-Identifier: GPL-2.0-or-later
-- A line of what candump prints and logs: the CAN frame that it tells of, and that frame as a packet. Pure Lua.
--
-- Two forms, after can-utils (lib.c, candump.c), plus the same line pasted from a document:
--   log     (1700000000.000001) can0 08404000#BBBE6FC720000000 R
--   screen   (000.000499)  can0  RX - -  08404000   [8]  BB BE 6F C7 20 00 00 00   '..o. ...'
local find, match, gmatch, gsub = string.find, string.match, string.gmatch, string.gsub
local byte, char, sub, rep, format = string.byte, string.char, string.sub, string.rep, string.format

local M = {}

-- The longest line candump prints has 64 bytes in binary digits, 700 characters in all.
local LONGEST = 4096
M.LONGEST = LONGEST

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
M.HARMLESS = { [EMPTY] = true, [COMMENT] = true, [SAID] = true, [BEHIND] = true }
M.NEUTRAL = { [EMPTY] = true, [COMMENT] = true, [SAID] = true, [DROPPED] = true, [XL] = true }

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

-- What stands for digits in the candump lines of the vendor's document: two Greek and two Cyrillic letters, an O, and
-- circles; and the space of a page that they were copied from.
local LOOK_ALIKES = {
  ["\206\146"] = "B", ["\206\149"] = "E", ["\208\151"] = "3", ["\208\177"] = "6", ["\194\160"] = " ",
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

-- Linux cooked capture v2, big endian: protocol, reserved, interface index, device type, packet type, no address.
local CAN, CAN_FD, ARPHRD_CAN, TO_US, OUTGOING = 0x0C, 0x0D, 280, 0, 4

--- The bytes of a packet before the CAN frame's length: the same for all frames with this id on a bus.
M.HEAD = 24

--- A frame as a packet of link type LINUX_SLL2: the cooked header, the SocketCAN header, the data.
-- @param record from parse
-- @param number of its bus
-- @param big_endian true on a host of that kind: Wireshark takes the id in the host's order here
-- @return the bytes, a string
function M.packet(record, number, big_endian)
  local id = record.id
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

--- What stands behind M.HEAD for so many data bytes: length, flags, reserved, raw DLC.
M.LENGTHS = {}
for length = 0, 8 do M.LENGTHS[length] = char(length, 0, 0, 0) end

-- Decimal and hex digits, by their codes.
local HEX = {}
for code = 48, 102 do HEX[code] = tonumber(char(code), 16) end

-- The data bytes of 16 hex digits. Text that is not made needs no collector: that is why these are no captures.
local function eight_bytes(text, at)
  local a, b, c, d, e, f, g, h, i, j, k, l, m, n, o, p = byte(text, at, at + 15)
  return char(HEX[a] * 16 + HEX[b], HEX[c] * 16 + HEX[d], HEX[e] * 16 + HEX[f], HEX[g] * 16 + HEX[h],
    HEX[i] * 16 + HEX[j], HEX[k] * 16 + HEX[l], HEX[m] * 16 + HEX[n], HEX[o] * 16 + HEX[p])
end

local function nanoseconds_at(text, at)
  local a, b, c, d, e, f = byte(text, at, at + 5)
  return (a * 100000 + b * 10000 + c * 1000 + d * 100 + e * 10 + f - 48 * 111111) * 1000
end

--- Reads a line of the usual form in one step: a classic data frame in a log, nothing behind it, LF or CRLF.
--   (1700000000.000001) can0 08404000#BBBE6FC720000000
-- @param text with the line in it
-- @param at where the line begins
-- @return seconds and nanoseconds, the bus, the id's digits, the data bytes, and where the next line begins; nil for
--   any other line
function M.usual(text, at)
  local seconds, fraction, bus, digits, from, to, stop =
    match(text, "^%((%d+)%.()%d%d%d%d%d%d%) (%S+) (%x+)#()%x*()\r?\n()", at)
  local count = stop and to - from
  if not count or count > 16 or count % 2 ~= 0 or #seconds > 12 then return nil end
  local data = count == 16 and eight_bytes(text, from) or gsub(sub(text, from, to - 1), "%x%x", FROM_HEX)
  return tonumber(seconds), nanoseconds_at(text, fraction), bus, digits, data, stop
end

return M
