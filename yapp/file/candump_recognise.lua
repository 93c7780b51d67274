-- SPDX-License-Identifier: GPL-2.0-or-later
-- Whether a file is candump text, and whether Wireshark's own reader gets it right. Pure Lua.
local candump_line = require("yapp.file.candump_line")
local utf16 = require("yapp.file.utf16")

local parse, NEUTRAL, LONGEST = candump_line.parse, candump_line.NEUTRAL, candump_line.LONGEST
local find, match, gmatch, gsub, sub = string.find, string.match, string.gmatch, string.gsub, string.sub

local M = {}

-- Sizes, in bytes. A pipe can be rewound inside Wireshark's own buffer only, which is never less than HEAD
-- and never as much as SURE (less than 256 KB on 4.0, than 8 MB on 4.4 and 4.6).
local HEAD = 4096
local SURE = 16 * 1024 * 1024
local PIECE = 1024 * 1024

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
    local record = parse(sub(whole, 1, size) .. line)
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
-- decimals they have (6 or 9), its first bus, and the test for plain lines if all of these are plain.
local function recognise(text, by_value)
  local frames, others, before, timed, decimals, bus = 0, 0, {}, {}, 6, nil
  for line in gmatch(text, "([^\n]*)\n") do
    local record, why = parse(line)
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
  return { deltas = are_deltas(timed), decimals = decimals, bus = bus, is_plain = is_plain(text) and is_plain or nil }
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

--- Looks at a file from its start.
-- @param file anything with read(bytes) and seek("set", offset)
-- @param options as for open in file.candump
-- @return nil for a file that is not taken, and the name of its bus if Wireshark's own reader gets it all right. Else
--   { text (from the start, the file is right behind it), start (of the first line in it, from 1), encoding (see
--   file.utf16, or nil), deltas (whether its times are those since the frame before), decimals (6 or 9) }
function M.look(file, options)
  local head = file:read(HEAD) or ""
  local at_end = #head < HEAD
  local encoding
  head, encoding = utf16.text(head)
  if find(head, "\0", 1, true) then return nil end
  local start = #match(head, "^\239?\187?\191?") + 1 -- a byte order mark
  local found = recognise((whole_lines(sub(head, start), at_end)), options.by_value)
  if not found then return nil end
  found.text, found.start, found.encoding = head, start, encoding
  if found.is_plain and start == 1 and not encoding and not options.all then
    found.text = text_that_needs_us(file, head, found.is_plain)
    if not found.text then return nil, found.bus end
  end
  return found
end

return M
