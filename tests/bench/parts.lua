-- SPDX-License-Identifier: GPL-2.0-or-later
-- What the pure parts of the plugin take of the benchmark's yapp.pcap, in plain Lua: lua5.2 parts.lua yapp.pcap
-- Prints a line for each step, "name seconds", each with what the steps before it do, garbage collection included; and
-- how many messages there were.
if not arg then return end -- run by Wireshark, in a plugin folder

local top = arg[0]:match("^(.*)tests[/\\]bench[/\\]") or "./"
package.path = top .. "?.lua;" .. package.path

local parts = {
  can_frames = require "yapp.can.frames", can_id = require "yapp.wire.can_id", can_interleave = require "yapp.can.interleave",
  can_memory = require "yapp.can.memory", can_reassembly = require "yapp.can.reassembly",
  can_repeated = require "yapp.can.repeated",
  catalogue = require "yapp.message.catalogue", crc = require "yapp.wire.crc",
  decode = require "yapp.message.decode", decode_info = require "yapp.message.info",
  history = require "yapp.message.history", reader = require "yapp.message.reader",
}
local catalogue = parts.catalogue.compile(dofile(top .. "taurus_fields.lua"))

local NO_HISTORY = { change = function() end }
local FILE_HEADER, RECORD, DATA = 24, 32, 24 -- bytes: of a pcap, of a CAN frame, before its data

-- Calls see(number, data, 29-bit id) for each frame.
local function each_frame(path, see)
  local file = assert(io.open(path, "rb"))
  file:read(FILE_HEADER)
  local number = 0
  for record in function() return file:read(RECORD) end do
    local a, b, c, d, length = record:byte(17, 21)
    number = number + 1
    see(number, record:sub(DATA + 1, DATA + length), a % 0x20 * 0x1000000 + b * 0x10000 + c * 0x100 + d)
  end
  file:close()
end

-- The memory of a packet list in tshark.
local function new_memory()
  local memory = parts.can_memory.new(parts, {
    size_of = function(id) return catalogue.by_id[id] and catalogue.by_id[id].size end,
    new_history = function() return parts.history.new { catalogue = catalogue } end,
  })
  memory:only_pass()
  return memory
end

-- What a frame is, the way that yapp_can_carrier goes: the short one wherever that goes.
-- facts  of yapp_can_memory.look, in one table; its number, data and reported are filled in
-- returns  its message, and the record of one that ends here
local function take(memory, address, facts, number, data)
  local taker, message, is_last = memory.short[address.ctrl], nil, nil
  if taker then message, is_last = memory:plain(taker, address, number, data) end
  if message then return message, is_last and memory:plain_record(number, message, true) end
  facts.number, facts.data, facts.reported = number, data, #data
  local record = memory:look(address, facts, {})
  return record.message, record.is_last and record
end

-- What yapp_can_carrier gives to the reader: one table for all messages.
local function finish(m, address, number, message)
  m.seq, m.payload, m.size, m.frame, m.time = address.seq, message.payload, message.size, number, number / 5000
  m.id, m.source = address.id, address.id
end

-- How many good messages a capture has, by the steps up to one.
local function run(path, step)
  local memory, reader = new_memory(), parts.reader.new(catalogue, { wanted = false })
  local facts, count = { place = 0, informed = true }, 0
  local m = { ctl = 0, is_whole = true, status = "good", good = true }
  local address_of = parts.can_id.address
  each_frame(path, function(number, data, can_id)
    if step == "file" then return end
    local address = address_of(can_id)
    local message, record = take(memory, address, facts, number, data)
    if not record then return end
    if message.status == "good" then count = count + 1 end
    if step == "reassembly" then return end
    finish(m, address, number, message)
    reader:read(m, step == "values" and NO_HISTORY or memory, record)
    if step == "info" then parts.decode_info.text(m.message, m.raws, m.payload) end
  end)
  return count
end

local count
for _, step in ipairs { "file", "reassembly", "values", "history", "info" } do
  collectgarbage()
  local start = os.clock()
  count = run(arg[1], step)
  print(step, os.clock() - start)
end
print("messages", count)
