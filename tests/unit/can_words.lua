-- SPDX-License-Identifier: GPL-2.0-or-later
-- CAN frames in words, and what the memory says of them in words: "S32 M8 M8 M8 E8" is a good
-- message of 32 bytes.
--
-- A word is a frame: [sender a, b, ...] S M E (Start, Middle, End), X (CAN CTRL 9) or L (single), a
-- number, marks.
--   S32    a Start that says 32 bytes, with the right CRC for the sender's next payload
--   M8 E3  the next 8, or 3, bytes of that payload          L7   a single frame of 7 bytes
-- marks: ! wrong CRC, r reserved bytes 5 (the CRC covers them), /7 only 7 bytes long (or longer,
-- with zeros),
--        ~4 only 4 bytes captured, ? bytes that nobody sent, p12 zeros up to 12 bytes, = the frame
--        before it once more
-- Each sender has payloads of its own; all have the same key unless the test gives ids.
local can_id = require("yapp.wire.can_id")
local crc = require("yapp.wire.crc")
local memory = require("yapp.can.memory")
local little_endian = require("stream_generator").little_endian

local M = {}

local KIND = { L = 0, S = 1, M = 2, E = 3, X = 9 }
M.KNOWN = { [0x000] = 7, [0x200] = 17, [0x210] = 32, [0x211] = 32 } -- sizes of known messages

-- A history that knows of each source when its message before came, and where.
local function new_history()
  local latest = {}
  return {
    note = function(_, m)
      local before = latest[m.source]
      latest[m.source] = m
      local delta = before and m.time - before.time
      return before and { delta = delta, command_in = before.number }, delta
    end,
    change = function(_, m) return m.delta and { delta = m.delta } end,
  }
end

--- A memory of the messages of KNOWN.
-- min_size  of all of them, nil where other sizes are wrong
function M.new(min_size)
  local sources = {}
  local function source_of(id, bus)
    local key = id + (bus or -1) * 0x800
    sources[key] = sources[key] or { size = M.KNOWN[id], min_size = min_size, bus = bus }
    return sources[key]
  end
  return memory.new { source_of = source_of, claim = function() end, new_history = new_history }
end

function M.can_id(id, ctrl, ctl, seq)
  return id * 0x40000 + ctrl * 0x4000 + (ctl or 0) * 0x100 + (seq or 0)
end

--- The data of a Start.
-- options  { ctl =, seq =, reserved =, wrong = its CRC, size = another than the payload's }
function M.start(id, payload, options)
  options = options or {}
  local header = can_id.header({ id = id, ctl = options.ctl or 0, seq = options.seq or 0 },
    #payload, options.reserved)
  local sum = crc.of(header .. payload)
  if options.wrong then sum = sum % 2 == 0 and sum + 1 or sum - 1 end
  return little_endian(sum, 4) .. little_endian(options.size or #payload, 2) ..
    little_endian(options.reserved or 0, 2)
end

local ALONE = { [0] = "single", "start", "orphan", "orphan" } -- by CAN CTRL

--- A look at a frame, and all that is done with it: a message that ends is read.  It has a fault
-- where its first byte is odd.
-- frame    { can_id =, data =, number =, and what else can.memory takes }; of its own are place
--          (8), knows_bus (true)
-- returns  in words what it is, with what is wrong; the record
function M.look(known, frame, is_again)
  local record = { address = can_id.address[frame.can_id], number = frame.number,
    place = frame.place or 8, is_again = is_again or false, data = frame.data,
    reported = frame.reported or #frame.data, bus = frame.bus or false,
    knows_bus = frame.knows_bus ~= false, is_wide = frame.is_wide or false,
    is_only_pass = frame.is_only_pass }
  local entry = known:look(record)
  if not entry then return "-", record end
  local is_last = entry.last == record.look
  local text = is_last and entry.status or entry.size and "part" or
    ALONE[record.address.ctrl] or "invalid"
  if is_last or text == "single" then
    local payload = is_last and entry.payload or record.data
    local message = { source = record.address.id + (record.bus or -1) * 0x800,
      time = record.number / 8, has_fault = payload ~= "" and payload:byte() % 2 == 1,
      good = not is_last or text == "good" }
    record.change = known:change(message, record)
    record.delta = message.delta or nil
  end
  local faults = {}
  for i, fault in ipairs(record.faults or {}) do faults[i] = fault.expert end
  table.sort(faults)
  if #faults > 0 then text = text .. "+" .. table.concat(faults, "+") end
  return text, record
end

local function payload_of(sender, count, size)
  local bytes = {}
  for i = 1, size do
    bytes[i] = string.char((sender:byte() * 31 + count * 17 + i * i + i) % 255 + 1)
  end
  return table.concat(bytes)
end

-- The bytes of one word on the bus.
local function data_of(sender, name, id, kind, number, marks)
  if kind == "S" then
    sender.count = sender.count + 1
    sender.payload, sender.at = payload_of(name .. "x", sender.count, number), 1
    return M.start(id[1], sender.payload, { ctl = id[2], seq = id[3],
      wrong = marks:find("!", 1, true) and true,
      reserved = marks:find("r", 1, true) and 5 or nil })
  end
  if marks:find("?", 1, true) then return ("?"):rep(number) end
  if marks:find("=", 1, true) then return sender.payload:sub(sender.at - number, sender.at - 1) end
  local data = sender.payload:sub(sender.at, sender.at + number - 1)
  sender.at = sender.at + number
  return data .. ("x"):rep(number - #data)
end

--- The frames that words mean, numbered from 1 on.
-- options  ids = { [sender] = { id, ctl, seq } }, is_wide, buses (true: each sender has a bus of
--          its own, which the capture tells)
function M.frames(text, options)
  local senders, list, ids = {}, {}, options.ids or {}
  for word in text:gmatch("%S+") do
    local name, kind, number, marks = word:match("^(%l?)([SMELX])(%d+)(.*)$")
    senders[name] = senders[name] or { count = 0, payload = "", at = 1 }
    local id = ids[name] or ids[""] or { 0x123, 0, 0 }
    local data = data_of(senders[name], name, id, kind, tonumber(number), marks)
    local length = tonumber(marks:match("p(%d+)") or marks:match("/(%d+)") or #data)
    data = data:sub(1, length) .. ("\0"):rep(length - #data)
    local captured = marks:match("~(%d+)")
    list[#list + 1] = { can_id = M.can_id(id[1], KIND[kind], id[2], id[3]), number = #list + 1,
      reported = length,
      data = captured and data:sub(1, captured) or data, is_wide = options.is_wide,
      bus = options.buses and ("_" .. name):byte(-1) or nil }
  end
  return list
end

--- Looks at frames, in order; returns what is said of each, in one text.
function M.looks(known, frames, is_again)
  local list = {}
  for i, frame in ipairs(frames) do list[i] = M.look(known, frame, is_again) end
  return table.concat(list, " ")
end

--- Sends frames; returns what each of them is at a later look, the memory, and the frames.
-- options  as for M.frames, and min_size
function M.send(text, options)
  options = options or {}
  local known, frames = M.new(options.min_size), M.frames(text, options)
  M.looks(known, frames)
  return M.looks(known, frames, true), known, frames
end

return M
