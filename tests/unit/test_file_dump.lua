-- SPDX-License-Identifier: GPL-2.0-or-later
-- A raw serial dump: records, offsets, times, and what is not a dump.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local dump = require("yapp.file.dump")
local framer = require("yapp.serial.framer")
local levels = require("levels")
local file_of = require("support").file
local stream_generator = require("stream_generator")

local frame = stream_generator.frame

local function new_framer() return framer.new(function() return nil end) end

-- ID 1 has a time stamp: its first byte, in seconds.
local function time_of(bytes)
  if bytes:byte(5) == 1 then return bytes:byte(13), 500 end
end

local OPTIONS = { new_framer = new_framer, time_of = time_of }
-- The port type in front of the bytes of a record.
local SKIPPED = { ["\3"] = false, ["\5"] = true }

-- What read and seek_read return, as a record.
local function record_of(offset, packet, seconds, nanoseconds)
  if not offset then return nil end
  lu.assertEquals({ packet:sub(1, 23), packet:sub(25, 28) }, { "\0\12\0\12yapp_serial\0\0\24\0\4\0\0\0", "\0\0\0\0" })
  return { offset = offset, bytes = packet:sub(29), seconds = seconds, nanoseconds = nanoseconds,
    is_skipped = SKIPPED[packet:sub(24, 24)] }
end

local function records(text)
  local file, list = file_of(text), {}
  local log = dump.open(file, OPTIONS)
  while true do
    local record = record_of(log:read(file))
    if not record then return list, log, file end
    list[#list + 1] = record
  end
end

local TEXT = "boot\r\n" .. frame(2, "a") .. frame(1, "\7xx") .. frame(2, "b") .. "shell> " .. frame(1, "\9") .. "end"

-- Checks records against rows { bytes, seconds, nanoseconds }, a time of nil for none; offsets follow.
local function assert_records(text, rows)
  local list = records(text)
  lu.assertEquals(#list, #rows)
  local offset = 0
  for i, row in ipairs(rows) do
    lu.assertTrue(list[i].bytes == row[1], "record " .. i) -- long ones are not worth printing
    local shown = { list[i].offset, list[i].seconds, list[i].nanoseconds }
    lu.assertEquals(shown, { offset, row[2], row[3] }, "record " .. i)
    offset = offset + #row[1]
  end
end

local T = {}

function T.test_records_offsets_and_times()
  assert_records(TEXT, {
    { "boot\r\n", 7, 500 }, { frame(2, "a"), 7, 500 }, { frame(1, "\7xx"), 7, 500 }, { frame(2, "b"), 7, 500 },
    { "shell> ", 7, 500 }, { frame(1, "\9"), 9, 500 }, { "end", 9, 500 },
  })
  local list, log = records(TEXT)
  for i, record in ipairs(list) do
    lu.assertEquals(record.is_skipped, i == 1 or i == 5 or i == 7, "record " .. i)
  end
  lu.assertEquals({ log.decimals, log.lacks_clock }, { 9, true })
end

-- The rules of a dump's time once more, in half seconds.
local function new_model()
  local clocks_of, shift, time = {}, 0, nil
  return function(id, stamp)
    time = time or stamp
    clocks_of[id] = clocks_of[id] or {}
    local clocks, best = clocks_of[id], nil
    for _, clock in ipairs(clocks) do -- the one that goes on with the stamp, and advances least
      local goes_on = clock.last <= stamp and stamp + clock.shift > time - 2
      if goes_on and (not best or clock.last > best.last) then best = clock end
    end
    if not best then
      local step = stamp + shift - time
      best = { shift = 0 <= step and step < 2 and shift or time - stamp }
      clocks[#clocks + 1] = best
    end
    best.last, shift = stamp, best.shift
    time = math.max(time, stamp + shift)
    return time
  end
end

function T.test_random_clocks()
  local random = stream_generator.random(1)
  for _ = 1, levels.size(50, 500) do
    local parts, expected, found, model = {}, {}, {}, new_model()
    for i = 1, 60 do
      local id, stamp = random(3), random(24)
      parts[i], expected[i] = frame(id, string.char(stamp)), model(id, stamp)
    end
    local file = file_of(table.concat(parts))
    local log = dump.open(file, { new_framer = new_framer, time_of = function(bytes)
      return math.floor(bytes:byte(13) / 2), bytes:byte(13) % 2 * 500000000
    end })
    for i = 1, #parts do
      local record = record_of(log:read(file))
      lu.assertEvalToTrue(record.nanoseconds == 0 or record.nanoseconds == 500000000)
      found[i] = record.seconds * 2 + record.nanoseconds / 500000000
    end
    lu.assertEquals(found, expected)
  end
end

function T.test_without_a_time_stamp()
  local bad = frame(1, "\9"):sub(1, -2) .. "?"
  assert_records("> " .. frame(2, "a") .. bad, { { "> " }, { frame(2, "a") }, { bad } })
end

function T.test_a_time_stamp_that_comes_late()
  local list = records(frame(2, "a") .. ("x"):rep(1200000) .. frame(1, "\9") .. frame(2, "b"))
  lu.assertNil(list[1].seconds)
  lu.assertNil(list[2].seconds)
  lu.assertEquals({ list[#list].bytes, list[#list].seconds }, { frame(2, "b"), 9 })
  -- 1 MiB is searched: a stamp may be in its last byte, not behind it.
  local first, stamped = frame(2, "a"), frame(1, "\9")
  local noise = ("x"):rep(1048576 - #first - #stamped)
  lu.assertEquals(records(first .. noise .. stamped)[1].seconds, 9)
  lu.assertNil(records(first .. noise .. ("x"):rep(#stamped) .. stamped)[1].seconds)
end

function T.test_a_second_look_in_any_order()
  local list, log, file = records(TEXT)
  for i = #list, 1, -1 do
    lu.assertEquals(record_of(log:seek_read(file, list[i].offset)), list[i], "record " .. i)
  end
  lu.assertNil(log:seek_read(file_of(TEXT:sub(1, 20)), list[3].offset)) -- the file is shorter now
end

function T.test_many_records_cross_the_chunks()
  local pieces = {}
  for i = 1, 5000 do pieces[i] = frame(i % 2 + 1, ("p"):rep(i % 60 + 1)) .. (i % 10 == 0 and "noise" or "") end
  local text = table.concat(pieces)
  local list, log, file = records(text)
  local joined = {}
  for i, record in ipairs(list) do joined[i] = record.bytes end
  lu.assertTrue(table.concat(joined) == text)
  lu.assertEquals(#list, 5500)
  for i = 1, #list, 37 do lu.assertEquals(record_of(log:seek_read(file, list[i].offset)).bytes, list[i].bytes) end
end

-- Wireshark takes a record of 256 KB at most.
function T.test_long_ranges_are_several_records()
  for _, length in ipairs { 65000, 65536, 131071, 131072, 300000, 1000000 } do
    local text = frame(2, "a") .. ("x"):rep(length) .. frame(2, "b")
    local joined = {}
    for i, record in ipairs(records(text)) do
      lu.assertTrue(#record.bytes > 0 and #record.bytes <= 65536)
      joined[i] = record.bytes
    end
    lu.assertEquals(#joined, 2 + math.ceil(length / 65536))
    lu.assertTrue(table.concat(joined) == text)
  end
end

function T.test_what_is_a_dump()
  local rows = {
    { "", false }, { "YP", false }, { "some text\n", false }, { frame(2, "a"), true },
    { ("noise"):rep(20000) .. frame(2, "a"), true }, { frame(2, "a"):sub(1, -2) .. "?", false },
  }
  for i, row in ipairs(rows) do
    lu.assertEquals(dump.open(file_of(row[1]), OPTIONS) ~= nil, row[2], "row " .. i)
  end
end

return T
