-- SPDX-License-Identifier: GPL-2.0-or-later
-- What the pure modules of the plugin take of the benchmark's yapp.pcap: lua5.2 parts.lua yapp.pcap
-- Prints a line for each step, "name seconds", each with what the steps before it do, garbage
-- collection included; and how many messages there were.
if not arg then return end -- run by Wireshark, in a plugin folder

local top = arg[0]:match("^(.*)tests[/\\]bench[/\\]") or "./"
package.path = top .. "?.lua;" .. package.path

local can_id = require "yapp.wire.can_id"
local catalogue_compiler = require "yapp.message.catalogue"
local history = require "yapp.message.history"
local info = require "yapp.message.info"
local memory = require "yapp.can.memory"
local message_reader = require "yapp.message.reader"

local catalogue = catalogue_compiler.compile(dofile(top .. "taurus_fields.lua"))
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
    see(number, record:sub(DATA + 1, DATA + length),
      a % 0x20 * 0x1000000 + b * 0x10000 + c * 0x100 + d)
  end
  file:close()
end

local function new_memory()
  return memory.new {
    source_of = function(id) return catalogue.by_id[id] or {} end,
    claim = function() end,
    new_history = function()
      return history.new { late = 2.5, catalogue = catalogue, has_times = function() return true end }
    end,
  }
end

-- A finished message, as can.carrier gives it to the reader.
local function finished(frame, payload)
  local address = frame.address
  return { id = address.id, seq = address.seq, ctl = address.ctl, source = address.id,
    frame = frame.number, time = frame.number / 5000, payload = payload, size = #payload,
    is_whole = true, status = "good", good = true, wants = {} }
end

-- How many good messages a capture has, by the steps up to one.
local function run(path, step)
  local known, reader = new_memory(), message_reader.new(catalogue, { wanted = false })
  local frame, count = { place = 0, is_again = false, knows_bus = true, bus = false, is_wide = false }, 0
  each_frame(path, function(number, data, id)
    if step == "file" then return end
    frame.address, frame.number = can_id.address[id], number
    frame.data, frame.reported = data, #data
    local message = known:look(frame)
    if not message or message.last ~= frame.look then return end
    if message.status == "good" then count = count + 1 end
    local m = finished(frame, message.payload)
    if step == "reassembly" then return end
    reader:read(m, step == "values" and NO_HISTORY or known, frame)
    if step == "info" then info.text(m.message, m.raws, m.payload, m.message.title, m.look) end
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
