-- SPDX-License-Identifier: GPL-2.0-or-later
-- What candump prints and logs: whether a file is such, and its frames as packets.  Pure Lua.
local candump_line = require("yapp.file.candump_line")
local text = require("yapp.file.text")
local utf8 = require("yapp.base.utf8")

local parse, usual = candump_line.parse, candump_line.usual
local char, find, format = string.char, string.find, string.format
local gmatch, gsub = string.gmatch, string.gsub
local match, sub = string.match, string.sub

local M = {}

-- Sizes, in bytes.  A pipe can be rewound inside Wireshark's own buffer only, which is never less
-- than HEAD and never as much as SURE (less than 256 KB on 4.0, than 8 MB on 4.4 and 4.6).
local HEAD = 4096
local SURE = 16 * 1024 * 1024
local PIECE = 1024 * 1024

-- So many lines are reported one by one for each reason.
local REPORTED = 3

-- Which files are candump's
-- -------------------------------------------------------------------------

-- How many digits Wireshark's own reader takes behind "#", by what comes first: data, remote, CAN
-- FD.
local PLAIN_DIGITS = { [""] = {}, R = { [0] = true, true }, ["#"] = {} }
for count = 0, 8 do
  PLAIN_DIGITS[""][2 * count] = true
end
for count in gmatch("0 1 2 3 4 5 6 7 8 12 16 20 24 32 48 64", "%d+") do
  PLAIN_DIGITS["#"][2 * count + 1] = true
end

-- A test for text of whole lines, all of them log lines of this bus that Wireshark's own reader
-- gets right in every version.  It takes one space, six decimals, a number of digits that fits, and
-- nothing more; it does not tell two buses apart before 4.6, and an empty line ends the file for it
-- on 4.6. From 4.6 on it goes by an id's value, not by its digits: 00000000 is a standard id to it,
-- and an error frame's an extended one (by_value).
local function plain_test(bus, by_value)
  local name = gsub(bus, "%W", "%%%0")
  local pattern = "%(%d+%.%d%d%d%d%d%d%) " .. name .. " ([0-7]%x+)#([#R]?)()%x*()\r?\n"
  local function erase(id, kind, from, to)
    local is_misread = by_value and (id < "00000800" or id >= "20000000")
    local is_id = #id == 3 or #id == 8 and not is_misread
    return is_id and PLAIN_DIGITS[kind][to - from] and "" or nil
  end
  return function(lines) return gsub(lines, pattern, erase) == "" end
end

local function nanoseconds_of(record)
  return record.seconds * 1000000000 + record.nanoseconds
end

-- candump -t d prints the time since the frame before, -t z since the first one.  On one bus the
-- latter climb, or stay where an adapter stamps several frames at once; the former go up and down,
-- or repeat. (Of several buses two frames may change places.)
local function are_deltas(records)
  local last, falls, repeats, rises = {}, 0, 0, 0
  for _, record in ipairs(records) do
    local time = record.is_relative and nanoseconds_of(record) or 0
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

-- Cuts text behind its last line end.  At the end of the file all of it is lines.
local function whole_lines(piece, at_end)
  if at_end then return (gsub(piece, "([^\n])$", "%1\n")), "" end
  local lines = match(piece, "^.*\n") or ""
  return lines, sub(piece, #lines + 1)
end

-- What the rest of a line has whose start was cut off: an id and "#", a length, data bytes alone.
local RESTS = { "%x#", "[%[{]%x+[%]}]", "^#?[%x%s`]*[RT]?%s*$" }

local function is_rest(line)
  for _, rest in ipairs(RESTS) do
    if find(line, rest) then return true end
  end
  return false
end

-- Whether a file of candump text may start with these lines, which are no frames: the rest of one
-- in a log cut at its start, or a shell's with the command.  Any other first line may be another
-- format's mark.
local function may_begin(lines)
  for _, line in ipairs(lines) do
    if find(line, "candump ", 1, true) then return true end
  end
  return #lines == 0 or #lines == 1 and is_rest(lines[1])
end

-- What the first lines of a file tell: nil if they are not candump's, else { deltas = whether its
-- times are those since the frame before, decimals = 6 or 9, bus = the first one's name,
-- has_several = whether they have others too }.
local function recognise(lines)
  local records, others, has_several, decimals = {}, {}, false, 6
  for line in gmatch(lines, "([^\n]*)\n") do
    local record, why = parse(line)
    if record then
      if #records == 0 and not may_begin(others) then return nil end
      records[#records + 1] = record
      has_several = has_several or record.bus ~= records[1].bus
      if (record.nanoseconds or 0) % 1000 ~= 0 then decimals = 9 end
    elseif why and not candump_line.HARMLESS[why] then
      others[#others + 1] = line
    end
  end
  if #records <= #others then return nil end
  return {
    deltas = are_deltas(records),
    decimals = decimals,
    bus = records[1].bus,
    has_several = has_several,
  }
end

-- Looks behind a plain start for a line that needs this reader.  Returns the text read from the
-- start of the file, with the file right behind it, or nil if the file is plain throughout.  A file
-- that cannot be rewound is a pipe: nobody else could read it any more, so it is taken.  All text
-- is kept until that is known.
local function text_that_needs_us(file, head, is_plain)
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

-- A file
-- --------------------------------------------------------------------------------------------

local Log = {}
Log.__index = Log

--- Opens a file if it is candump text.
-- @param file anything with read(bytes) and seek("set", offset), at its start, as io.open gives it
-- @param options { all = true to take all candump text, false to leave to Wireshark's own reader
--   what that gets right; by_value = whether that reader tells extended ids by their value, as 4.6
--   does; report = function(text), called with a line for each message }
-- @return a log with read and seek_read, decimals (6 or 9) of the times, and has_several: whether
--   its first lines have several buses.  Nil if the file is not taken; and then the name of its
--   bus, if it is a log that Wireshark's own reader gets right
function M.open(file, options)
  local head = file:read(HEAD) or ""
  if find(head, "\0", 1, true) then return nil end
  local lines = whole_lines(head, #head < HEAD)
  local found = recognise(lines)
  if not found then return nil end
  local is_plain = plain_test(found.bus, options.by_value)
  if not options.all and is_plain(lines) then
    head = text_that_needs_us(file, head, is_plain)
    if not head then return nil, utf8.printable(found.bus) end
  end
  return setmetatable({
    decimals = found.decimals,
    has_several = found.has_several,
    deltas = found.deltas,
    report = options.report or print,
    lines = text.lines(head),
    again = text.lines(""), -- wherever a frame is wanted again
    clock = 0, -- of deltas: nanoseconds so far
    clocks = {}, -- and at each frame's offset
    buses = {}, -- by name
    taken = {}, -- by number: whether a bus has it
    skipped = {}, -- number of lines, by reason
    pending = {}, -- what the packet list is to say at the next frame
    comments = {}, -- what it says, by the frame's offset
  }, Log)
end

-- A bus: { number = the one its name ends in (can1 is 1) unless another bus has it, else the first
-- free one; name = fit to be printed; heads = of packets, by the id's digits }.
function Log:add_bus(name)
  local number = tonumber(match(name, "%f[%d]%d?%d?%d$"))
  if not number or self.taken[number] then
    number = 0
    while self.taken[number] do number = number + 1 end
  end
  local shown = utf8.printable(name)
  self.taken[number] = true
  self.buses[name] = { number = number, name = shown, heads = {} }
  self.pending[#self.pending + 1] = format("Interface index %d is %s", number, shown)
end

-- A line to tell of, for the most part one without a frame: at once, and in the packet list at the
-- next frame.  There may be many of a kind.
function Log:skip(line, why)
  local count = (self.skipped[why] or 0) + 1
  self.skipped[why] = count
  if count > REPORTED then return end
  local message = format("line %d: %s", self.lines.number, why)
  local shown = match(sub(line, 1, 50), "^%s*(.-)%s*$")
  if shown ~= "" then message = format('%s: "%s"', message, utf8.printable(shown)) end
  if count == REPORTED then message = message .. "; no more of these are told" end
  self.report(message)
  if not candump_line.HARMLESS[why] then self.pending[#self.pending + 1] = message end
end

-- What is to be kept of a frame that is read for the first time.
function Log:note(record, line, offset)
  if not self.buses[record.bus] then self:add_bus(record.bus) end
  if self.deltas and record.is_relative then
    self.clock = self.clock + nanoseconds_of(record)
    self.clocks[offset] = self.clock
  end
  if record.note then self:skip(line, record.note) end
  if #self.pending > 0 then
    self.comments[offset] = table.concat(self.pending, "\n")
    self.pending = {}
  end
end

-- What read returns for a frame that parse found.
function Log:packet(record, offset)
  local bus, seconds, nanoseconds = self.buses[record.bus], record.seconds, record.nanoseconds
  local clock = self.clocks[offset]
  if clock then
    nanoseconds = clock % 1000000000
    seconds = math.floor((clock - nanoseconds) / 1000000000)
  end
  return offset, text.packet(bus.number, record), seconds, nanoseconds, bus, self.comments[offset]
end

-- The head of a packet, and its bus; nil for a bus that is new, and where there is no such id.
function Log:head(name, digits)
  local bus = self.buses[name]
  if not bus then return nil end
  local head = bus.heads[digits]
  if not head then
    local id = candump_line.id(digits)
    head = id and text.head(bus.number, { id = id })
    bus.heads[digits] = head
  end
  return head, bus
end

-- The next frame.  Nearly all lines of a large file are of the usual form, which takes half of the
-- time of another: no record is made of it.
function Log:next(lines, file)
  local seconds, nanoseconds, name, digits, data, stop = usual(lines.text, lines.pos)
  if stop then
    local head, bus = self:head(name, digits)
    if head then
      local offset = lines:skip_to(stop)
      local bytes = head .. char(#data) .. "\0\0\0" .. data
      return offset, bytes, seconds, nanoseconds, bus, self.comments[offset]
    end
  end
  local line, offset = lines:next(file)
  while line do
    local record, why = parse(line)
    if record then
      if lines == self.lines then self:note(record, line, offset) end
      return self:packet(record, offset)
    end
    if why then self:skip(line, why) end
    line, offset = lines:next(file)
  end
end

--- Reads the next frame.
-- @param file the file it was opened with
-- @return its offset, the packet's bytes (link type LINUX_SLL2), the seconds and nanoseconds since
--   1970 or since the first frame (nil without a time), the bus { number, name }, a comment or nil.
--   Nil at the end
function Log:read(file)
  return self:next(self.lines, file)
end

--- Reads a frame again.
-- @param file a second handle on the same file, used for nothing else
-- @param offset of the frame, as read gave it
-- @return the same as read gave, or nil
function Log:seek_read(file, offset)
  self.again:go_to(file, offset)
  return self:next(self.again, file)
end

return M
