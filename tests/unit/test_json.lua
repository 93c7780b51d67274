-- SPDX-License-Identifier: GPL-2.0-or-later
-- The JSON writer.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local json = require("yapp.stat.output")
local unpack = rawget(table, "unpack")

local T = {}

function T.test_values()
  local expected = {
    { 1, "1" }, { -0.5, "-0.5" }, { 0.1, "0.1" }, { 1 / 3, "0.33333333333333331" }, { 2 ^ 53 - 1, "9007199254740991" },
    { 1e300, "1e+300" }, { math.huge, "null" }, { -math.huge, "null" }, { 0 / 0, "null" },
    { 4294967295, "4294967295" }, { json.list { json.object({ "a" }, { a = 1 }) }, '[{"a":1}]' },
    { 'a"b\\c\n\1\127', [["a\"b\\c\\x0A\\x01\\x7F"]] }, { "°C", '"°C"' }, { "\255°", [["\\xFF°"]] },
  }
  for _, row in ipairs(expected) do lu.assertEquals(json.value(row[1]), row[2]) end
  lu.assertEquals(json.value(nil), "null")
end

-- From 2^53 on a double may stand for several whole numbers: people read it as it is, a fraction.
function T.test_whole_numbers_that_people_read()
  for number, expected in pairs { [2 ^ 53 - 1] = "9007199254740991", [-3] = "-3", [2 ^ 53] = "9.0072e+15",
    [1 / 3] = "0.333333" } do
    lu.assertEquals(json.text(number), expected)
  end
end

-- A disk that was full may have room again when the file ends: its bytes are missing all the same.
function T.test_a_file_that_could_not_be_written_for_a_moment()
  local path = os.tmpname()
  local file = assert(json.create(path))
  file.handle:close()
  local answers = { { true }, { nil, "No space left on device" }, { true } }
  file.handle = {
    write = function() return unpack(table.remove(answers, 1), 1, 2) end,
    close = function() return true end,
  }
  for _ = 1, 3 do file:write("some text") end
  lu.assertEquals(json.close_files { file }, path .. ": No space left on device")
  os.remove(path)
end

return T
