-- SPDX-License-Identifier: GPL-2.0-or-later
-- The lines of a file: wherever its bytes are cut, and again at any offset.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local text = require("yapp.file.text")

local T = {}

-- A file in memory that gives so many bytes at a time, and counts how often it is moved.
local function file_of(bytes, at_once)
  local file = { at = 0, moved = 0 }
  function file:read(count)
    local part = bytes:sub(self.at + 1, self.at + math.min(count, at_once))
    self.at = self.at + #part
    return part ~= "" and part or nil
  end
  function file:seek(_, offset)
    self.at, self.moved = offset, self.moved + 1
  end
  return file
end

local BYTES = "\none\n\ntwo\r\n\n\nthe last"
local LINES = { { "", 0 }, { "one", 1 }, { "", 5 }, { "two\r", 6 }, { "", 11 }, { "", 12 }, { "the last", 13 } }

function T.test_lines_of_pieces()
  for at_once = 1, #BYTES + 1 do
    local file, lines, found = file_of(BYTES, at_once), text.lines(""), {}
    local line, offset = lines:next(file)
    while line do
      found[#found + 1] = { line, offset }
      line, offset = lines:next(file)
    end
    lu.assertEquals(found, LINES, at_once)
  end
end

-- Inside the text at hand nothing is read anew.
function T.test_going_to_an_offset()
  local file = file_of(BYTES, 100)
  local lines = text.lines("")
  lines:next(file)
  for _, one in ipairs { LINES[1], LINES[4], LINES[6], LINES[7], { "t", #BYTES - 1 } } do
    lines:go_to(file, one[2])
    lu.assertEquals({ lines:next(file) }, one)
  end
  lu.assertEquals(file.moved, 0)
  lines:go_to(file, #BYTES)
  lu.assertNil(lines:next(file))
  lines:go_to(file, 6)
  lu.assertEquals({ lines:next(file) }, LINES[4])
  lu.assertTrue(file.moved > 0)
end

-- Of a line longer than 4096 bytes the begin stays, whatever its length; the lines behind it have their offsets.
function T.test_a_long_line()
  for _, length in ipairs { 4096, 4097, 65535, 65536, 65537, 1000000 } do
    for _, at_once in ipairs { 1000, 65536 } do
      local bytes = "first\n" .. ("x"):rep(length) .. "\nbehind\nlast"
      local file, lines = file_of(bytes, at_once), text.lines("")
      lu.assertEquals({ lines:next(file) }, { "first", 0 })
      local long = lines:next(file)
      lu.assertEquals(#long > 4096, length > 4096)
      lu.assertTrue(#long <= 4097 + 65536)
      lu.assertEquals(long, ("x"):rep(#long))
      lu.assertTrue(#lines.text <= 4097 + 65536)
      lu.assertEquals({ lines:next(file) }, { "behind", length + 7 })
      lines:go_to(file, length + 7)
      lu.assertEquals({ lines:next(file) }, { "behind", length + 7 })
      lu.assertEquals({ lines:next(file) }, { "last", length + 14 })
      lu.assertNil(lines:next(file))
    end
  end
end

-- What is named is where the line begins that is not there, or not whole.
function T.test_a_file_that_cannot_be_read_on()
  for _, before in ipairs { "", "one\ntwo" } do
    local pieces = { before ~= "" and before or nil }
    local file = { read = function()
      local piece = table.remove(pieces, 1)
      return piece, piece == nil and "Input/output error" or nil
    end }
    local lines = text.lines("")
    if before ~= "" then lu.assertEquals(lines:next(file), "one") end
    lu.assertErrorMsgContains(("behind byte %d (Input/output error)"):format(before == "" and 0 or 4),
      function() lines:next(file) end)
  end
end

return T
