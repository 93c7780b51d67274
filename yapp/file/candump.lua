-- SPDX-License-Identifier: GPL-2.0-or-later
-- The text candump prints and logs: a whole file into a series of packets. Pure Lua.
local candump_line = require("yapp.file.candump_line")
local recognise = require("yapp.file.candump_recognise")
local utf8 = require("yapp.base.utf8")

local parse, usual, packet = candump_line.parse, candump_line.usual, candump_line.packet
local LONGEST, LENGTHS = candump_line.LONGEST, candump_line.LENGTHS
local find, match, gsub, sub, format = string.find, string.match, string.gsub, string.sub, string.format

local M = {}

local BLOCK = 65536 -- bytes read at once

-- So many lines are reported one by one for each reason.
local REPORTED = 3
-- Buses with a number of their own, and those named in the packet list: no file has so many, except a hostile one.
local MOST_BUSES, COMMENTED_BUSES = 4096, 100
-- Heads of packets that are kept, one for each bus and id.
local MOST_HEADS = 4096

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
-- A file
----------------------------------------------------------------------------------------------------------

--- Opens a file if it is candump text.
-- @param file anything with read(bytes) and seek("set", offset), at its start, as io.open gives it
-- @param options { all = true to take all candump text, false to leave to Wireshark's own reader what that gets right;
--   by_value = whether that reader tells extended ids by their value, as 4.6 does; big_endian = whether this host is;
--   report = function(text), called with a line for each message, or nil }
-- @return what read and seek_read need, with decimals (6 or 9) of the times. Nil if the file is not taken; and then the
--   name of its bus, if it is a log that Wireshark's own reader gets right
function M.open(file, options)
  local found, plain_bus = recognise.look(file, options)
  if not found then return nil, plain_bus and utf8.printable(plain_bus) end
  local log = {
    decimals = found.decimals, deltas = found.deltas, encoding = found.encoding,
    report = options.report or function() end, big_endian = options.big_endian,
    lines = new_lines(found.text), random = new_lines(""), -- in order; and wherever a frame is wanted again
    seconds = 0, nanoseconds = 0, marks = {}, count = 0, -- of deltas
    buses = {}, taken = {}, bus_count = 0, head_count = 0, comments = {}, pending = {}, skipped = {},
  }
  log.lines.pos = found.start
  return log
end

-- A bus: { number = the one its name ends in (can1 is 1) unless another bus has it, else the first free one; name =
-- fit to be printed; heads = of packets, by the id's digits }. Second result: true if it is new.
local function bus_of(log, name)
  local bus = log.buses[name]
  if bus then return bus, false end
  if log.bus_count == MOST_BUSES then return { number = MOST_BUSES, name = utf8.printable(name), heads = {} }, false end
  local number = tonumber(match(name, "%f[%d]%d?%d?%d$"))
  if not number or log.taken[number] then
    number = log.lowest or 0
    while log.taken[number] do number = number + 1 end
    log.lowest = number + 1
  end
  bus = { number = number, name = utf8.printable(name), heads = {} }
  log.buses[name], log.taken[number], log.bus_count = bus, true, log.bus_count + 1
  return bus, true
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
  if not candump_line.HARMLESS[why] then log.pending[#log.pending + 1] = message end
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
local function comment_on(log, bus, offset, is_new)
  if is_new and log.bus_count <= COMMENTED_BUSES then
    log.pending[#log.pending + 1] = format("Interface index %d is %s", bus.number, bus.name)
  end
  if #log.pending > 0 then log.comments[offset], log.pending = table.concat(log.pending, "\n"), {} end
end

-- Lines of the usual form, with an id that has been on their bus before, are read in one step: nearly all of a large
-- file are such, and this takes half of the time. Returns what read returns, or nothing.
local function usual_frame(log, lines)
  local seconds, nanoseconds, name, digits, data, stop = usual(lines.text, lines.pos)
  local bus = stop and log.buses[name]
  local head = bus and bus.heads[digits]
  if not head then return nil end
  local offset = lines.base + lines.pos - 1
  lines.pos, lines.number = stop, lines.number + 1
  return offset, head .. LENGTHS[#data] .. data, bus, seconds, nanoseconds, log.comments[offset]
end

-- The next line of the usual form with this bus and id can be read so.
local function keep_head(log, line, bus, bytes)
  local _, _, _, digits = usual(line .. "\n", 1)
  if not digits or bus.heads[digits] then return end
  if log.head_count == MOST_HEADS then
    for _, other in pairs(log.buses) do other.heads = {} end
    log.head_count = 0
  end
  bus.heads[digits], log.head_count = sub(bytes, 1, candump_line.HEAD), log.head_count + 1
end

-- The file, or what reads it as if it were ASCII.
local function decoded(log, file)
  local encoding = log.encoding
  if not encoding then return file end
  encoding.file = file
  return encoding
end

-- Reads on to a frame in a line that need not be of the usual form.
local function next_frame(log, file)
  local lines = log.lines
  local line, offset = next_line(lines, file)
  while line do
    local record, why = parse(line)
    if record then
      local bus, is_new = bus_of(log, record.bus)
      if log.deltas then
        mark(log, offset)
        add_delta(log, record)
      end
      if record.note then skip(log, line, record.note) end
      if is_new or #log.pending > 0 then comment_on(log, bus, offset, is_new) end
      local bytes = packet(record, bus.number, log.big_endian)
      keep_head(log, line, bus, bytes)
      return offset, bytes, bus, record.seconds, record.nanoseconds, log.comments[offset]
    end
    if why then skip(log, line, why) end
    line, offset = next_line(lines, file)
  end
  report_total(log)
end

--- Reads the next frame. (No record: one for each line of a large file is a fifth of the time, most of it the
-- collector's.)
-- @param log from open
-- @param file the file it was opened with
-- @return its offset, the packet's bytes (see file.candump_line), the bus { number, name }, the seconds and
--   nanoseconds since 1970 or since the first frame (nil without a time), a comment or nil. Nothing at the end
function M.read(log, file)
  if #log.pending == 0 and not log.deltas then
    local offset, bytes, bus, seconds, nanoseconds, comment = usual_frame(log, log.lines)
    if offset then return offset, bytes, bus, seconds, nanoseconds, comment end
  end
  return next_frame(log, decoded(log, file))
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
-- @return the same as read gave, or nil
function M.seek_read(log, file, offset)
  file = decoded(log, file)
  go_before(log, file, offset)
  local lines = log.random
  if not log.deltas then
    local at, bytes, bus, seconds, nanoseconds, comment = usual_frame(log, lines)
    if at then return at, bytes, bus, seconds, nanoseconds, comment end
  end
  repeat
    local line, at = next_line(lines, file)
    local record = line and parse(line)
    if record and log.deltas then add_delta(lines, record) end
    if record and at == offset then
      local bus = bus_of(log, record.bus)
      return at, packet(record, bus.number, log.big_endian), bus, record.seconds, record.nanoseconds,
        log.comments[offset]
    end
  until not line or at >= offset
end

return M
