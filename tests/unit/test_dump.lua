-- A raw serial dump: records, offsets, times, and what is not a dump.
local lu = require("luaunit")
local crc = require("yapp_crc")
local dump = require("yapp_dump")
local stream = require("yapp_stream")

-- What the API's file objects do.
local function file_of(text)
  local at = 1
  return {
    read = function(_, count)
      if at > #text then return nil end
      local piece = text:sub(at, at + count - 1)
      at = at + #piece
      return piece
    end,
    seek = function(_, _, offset)
      at = offset + 1
      return offset
    end,
  }
end

local function le(value, size)
  local bytes = {}
  for i = 1, size do bytes[i], value = string.char(value % 256), (value - value % 256) / 256 end
  return table.concat(bytes)
end

local function frame(id, payload)
  local text = "YP\0\0" .. le(id, 4) .. le(#payload, 2) .. "\0\0" .. payload
  return text .. le(crc.of(text), 4)
end

local function new_framer() return stream.new(crc, function() return true end) end

-- ID 1 has a time stamp: its first byte, in seconds.
local function time_of(bytes)
  if bytes:byte(5) == 1 then return bytes:byte(13), 500 end
end

local function records(text)
  local file, log, list = file_of(text), dump.new(new_framer, time_of), {}
  while true do
    local record = log:read(file)
    if not record then return list, log, file end
    list[#list + 1] = record
  end
end

local TEXT = "boot\r\n" .. frame(2, "a") .. frame(1, "\7xx") .. frame(2, "b") .. "shell> " .. frame(1, "\9") .. "end"

local T = {}

function T.test_records_offsets_and_times()
  local list = records(TEXT)
  local rows = { -- bytes, seconds, nanoseconds
    { "boot\r\n", 0, 0 }, { frame(2, "a"), 0, 0 }, { frame(1, "\7xx"), 7, 500 }, { frame(2, "b"), 7, 500 },
    { "shell> ", 7, 500 }, { frame(1, "\9"), 9, 500 }, { "end", 9, 500 },
  }
  lu.assertEquals(#list, #rows)
  local offset = 0
  for i, row in ipairs(rows) do
    lu.assertEquals({ list[i].bytes, list[i].seconds, list[i].nanoseconds, list[i].offset },
      { row[1], row[2], row[3], offset }, "record " .. i)
    offset = offset + #row[1]
  end
end

function T.test_a_second_look_in_any_order()
  local list, log, file = records(TEXT)
  for i = #list, 1, -1 do
    lu.assertEquals(log:read_again(file, list[i].offset), list[i], "record " .. i)
  end
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
  for i = 1, #list, 37 do lu.assertEquals(log:read_again(file, list[i].offset).bytes, list[i].bytes) end
end

function T.test_what_is_a_dump()
  local rows = {
    { "", false }, { "YP", false }, { "some text\n", false }, { frame(2, "a"), true },
    { ("noise"):rep(20000) .. frame(2, "a"), true }, { frame(2, "a"):sub(1, -2) .. "?", false },
    { ("\0"):rep(2000000) .. frame(2, "a"), false }, -- too late
  }
  for i, row in ipairs(rows) do
    lu.assertEquals(dump.recognise(file_of(row[1]), new_framer), row[2], "row " .. i)
  end
end

return T
