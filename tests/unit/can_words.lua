-- SPDX-License-Identifier: GPL-2.0-or-later
-- CAN frames in words, and what the reassembly says of them in words: "S32 M8 M8 M8 E8" is a good
-- message of 32 bytes.
--
-- What is said: "." of a fragment, the status of a message at its last frame, "single", "-" of a frame
-- that is not YAPP's, "start", "orphan" and "invalid" of others; and "+" before what is wrong.
--
-- A word is a frame: [sender a, b, ...] S M E (Start, Middle, End), X (CAN CTRL 9) or L (single), a
-- number, marks.
--   S32    a Start that says 32 bytes, with the right CRC for the sender's next payload
--   M8 E3  the next 8, or 3, bytes of that payload          L7   a single frame of 7 bytes
-- marks: /7 only 7 bytes long (or longer, with zeros), ~4 only 4 bytes captured, p12 zeros up to 12
--        bytes, = of a Start: the one before it once more
-- Each sender has payloads of its own; all have the same key unless the test gives ids.
local can_id = require "yapp.wire.can_id"
local crc = require "yapp.wire.crc"
local frame_key = require "yapp.base.frame_key"
local reassembly = require "yapp.can.reassembly"
local KNOWN = require "can_oracle".KNOWN
local little_endian = require "stream_generator".little_endian

local M = {}

local unpack = rawget(table, "unpack") or rawget(_G, "unpack")
local KIND = { L = 0, S = 1, M = 2, E = 3, X = 9 }

--- The reassembly of a capture with the messages of KNOWN, and its sources.
-- options  { min_size = of all known messages }
function M.new(options)
  options = options or {}
  local sources = {}
  local capture = { is_time_real = function() return true end }
  return {
    reassembly = reassembly.new(capture, function() end),
    source_of = function(id, bus)
      local key = id + (bus or -1) * 0x800
      sources[key] = sources[key] or
        { size = KNOWN[id], min_size = options.min_size or KNOWN[id], bus = bus, key = key }
      return sources[key]
    end,
  }
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

--- Whether the tests take a message for one with a fault.
function M.has_fault(payload)
  return payload ~= "" and payload:byte() % 2 == 1
end

local OTHER = { "start", "orphan", "orphan" } -- by CAN CTRL

--- Send a frame, or ask for one that was sent; a message that ends is kept, with a fault where its
-- first byte is odd.
-- frame    { can_id =, data =, number =, and what else can.reassembly takes }; offset: 8 if left out
-- visited  whether it was sent before
-- returns  in words what it is, with what is wrong; and { message, payload = of a message that ends
--          here, anomalies, in_number = of the packet that shows the message }
function M.visit(known, frame, visited)
  local fields, bus = can_id.fields[frame.can_id], frame.bus or false
  local record = { key = frame.number * frame_key.PACKET + (frame.offset or 8), can_id = fields,
    time = frame.time or frame.number / 1000, slot = fields.message_key + (frame.bus or 0) * can_id.BUS,
    source = known.source_of(fields.id, bus), bus = bus,
    data = frame.data, reported = frame.reported or #frame.data,
    accepts_all = frame.accepts_all or false, is_only_pass = frame.is_only_pass or false }
  local look = visited and known.reassembly.recall or known.reassembly.add
  local kind, message, anomalies = look(known.reassembly, record)
  if not kind then return "-", {} end
  local text = kind == "last" and message.status or kind == "fragment" and "." or kind
  if kind == "other" then text = OTHER[fields.ctrl] or "invalid" end
  local found = { message = message, anomalies = anomalies or {} }
  if kind == "last" then
    found.payload = message.payload
    if not visited and M.has_fault(message.payload) then reassembly.mark_fault(message) end
  end
  if message and message.payload and #message > 1 then found.in_number = frame_key.number(message[#message]) end
  local names = {}
  for i, anomaly in ipairs(anomalies or {}) do names[i] = anomaly.expert end
  table.sort(names)
  return table.concat({ text, unpack(names) }, "+"), found
end

--- The numbers of the packets of a message.
function M.numbers(message)
  local numbers = {}
  for i, key in ipairs(message) do numbers[i] = frame_key.number(key) end
  return numbers
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
  if kind == "S" and not marks:find("=", 1, true) then
    sender.count = sender.count + 1
    sender.payload, sender.at = payload_of(name .. "x", sender.count, number), 1
    sender.start = M.start(id[1], sender.payload, { ctl = id[2], seq = id[3] })
  end
  if kind == "S" then return sender.start end
  local data = sender.payload:sub(sender.at, sender.at + number - 1)
  sender.at = sender.at + number
  return data .. ("x"):rep(number - #data)
end

--- The frames that words mean, numbered from 1 on.
-- options  ids = { [sender] = { id, ctl, seq } }, accepts_all, buses (true: each sender has a bus of
--          its own, which the capture tells); a frame comes 1 ms behind the one before
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
      reported = length, time = #list * 1e-3,
      data = captured and data:sub(1, captured) or data, accepts_all = options.accepts_all,
      bus = options.buses and ("_" .. name):byte(-1) or nil }
  end
  return list
end

--- Send frames, or ask for them, in order; returns what is said of each, in one text.
function M.visits(known, frames, visited)
  local list = {}
  for i, frame in ipairs(frames) do list[i] = M.visit(known, frame, visited) end
  return table.concat(list, " ")
end

--- Send frames; returns what each of them is when it is visited again, what M.new made, and the
-- frames.
-- options  as for M.frames and M.new
function M.send(text, options)
  options = options or {}
  local known, frames = M.new(options), M.frames(text, options)
  M.visits(known, frames)
  return M.visits(known, frames, true), known, frames
end

return M
