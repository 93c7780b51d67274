-- SPDX-License-Identifier: GPL-2.0-or-later
-- What the pure parts of the plugin take of the benchmark's yapp.pcap, in plain Lua: lua5.2 parts.lua yapp.pcap
-- Prints a line for each step, "name seconds", each with what the steps before it do, garbage collection included; and
-- how many messages there were.
if not arg then return end -- run by Wireshark, in a plugin folder

local top = arg[0]:match("^(.*)tests[/\\]bench[/\\]") or "./"
package.path = top .. "yapp/?.lua;" .. package.path

local parts = {}
for _, name in ipairs { "can_frames", "can_id", "can_interleave", "can_memory", "can_reassembly",
  "can_repeated", "catalogue", "crc", "decode", "decode_info", "history", "reader" } do
  parts[name] = require("yapp_" .. name)
end
local catalogue = parts.catalogue.compile(dofile(top .. "taurus_fields.lua"))

local NO_HISTORY = { change = function() end }
local FILE_HEADER, RECORD, DATA = 24, 32, 24 -- bytes: of a pcap, of a CAN frame, before its data

-- Calls see(facts, 29-bit id) for each frame; the facts are those of yapp_can_memory.look, in one table.
local function each_frame(path, see)
  local file = assert(io.open(path, "rb"))
  file:read(FILE_HEADER)
  local facts = { number = 0, place = 0, reported = 8, informed = true }
  for record in function() return file:read(RECORD) end do
    local a, b, c, d, length = record:byte(17, 21)
    facts.number, facts.data = facts.number + 1, record:sub(DATA + 1, DATA + length)
    see(facts, a % 0x20 * 0x1000000 + b * 0x10000 + c * 0x100 + d)
  end
  file:close()
end

local function new_memory()
  return parts.can_memory.new(parts, {
    size_of = function(id) return catalogue.by_id[id] and catalogue.by_id[id].size end,
    new_history = function() return parts.history.new { catalogue = catalogue } end,
  })
end

-- What yapp_can_carrier gives to the reader: one table for all messages.
local function finish(m, address, facts, entry)
  m.id, m.seq, m.ctl, m.payload, m.size = address.id, address.seq, address.ctl, entry.payload, entry.size
  m.source, m.frame, m.time, m.is_whole, m.is_brief = address.id, facts.number, facts.number / 5000, true, true
  m.status, m.good = entry.status, entry.status == "good"
  m.message, m.raws, m.look, m.has_fault, m.change, m.number, m.delta = nil, nil, nil, nil, nil, nil, nil
end

-- How many good messages a capture has, by the steps up to one.
local function run(path, step)
  local memory, reader = new_memory(), parts.reader.new(parts.decode, catalogue, { wanted = false })
  local record, m, count = {}, {}, 0
  local address_of = parts.can_id.address
  each_frame(path, function(facts, can_id)
    if step == "file" then return end
    local address = address_of(can_id)
    local found = memory:look(address, facts, record)
    if not found.is_last then return end
    if found.message.status == "good" then count = count + 1 end
    if step == "reassembly" then return end
    finish(m, address, facts, found.message)
    reader:read(m, step == "values" and NO_HISTORY or memory, found)
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
