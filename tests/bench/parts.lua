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
local reassembly = require "yapp.can.reassembly"
local records = require "yapp.reading.records"
local messages_of = require "yapp.reading.messages"
local source_names = require "yapp.message.sources"
local types_of = require "yapp.message.types"

local catalogue = catalogue_compiler.compile(dofile(top .. "taurus_fields.lua"))
local NO_HISTORY = { add = function() end }
local NO_COPIES = { find = function() end }
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

local function new_history()
  local function has_times() return true, true end
  return history.new { late = 2.5, catalogue = catalogue, buses = { has_times = has_times } }
end

-- How many good messages a capture has, by the steps up to one.
local function run(path, step)
  local known, types = reassembly.new(function() return true end, function() end), types_of.new(catalogue)
  local messages = messages_of.new(types, step == "values" and NO_HISTORY or new_history(), NO_COPIES)
  local frame, count, sources = records.new_can_frame(), 0, {}
  types:use(catalogue.by_id, (source_names.parse("", catalogue)), {}, function() end)
  each_frame(path, function(number, data, id)
    if step == "file" then return end
    local fields = can_id.fields[id]
    frame.can_id, frame.key, frame.slot = fields, number, fields.message_key
    sources[fields.id] = sources[fields.id] or types:new_source(fields.id, false)
    frame.source, frame.seq, frame.time = sources[fields.id], fields.seq, number / 5000
    frame.data, frame.reported = data, #data
    local kind, message = known:add(frame)
    if kind ~= "last" then return end
    if message.status == "good" then count = count + 1 end
    if step == "reassembly" then return end
    local m = messages:read(frame, message)
    if step == "info" then local _ = m.source.label .. "  " .. m.source.write(m.raws) end
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
