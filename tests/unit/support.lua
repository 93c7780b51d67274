-- SPDX-License-Identifier: GPL-2.0-or-later
-- What several files of unit tests use.
local M = {}

--- The bytes of hexadecimal digits, with blanks between them or not.
function M.bytes(hex)
  return (hex:gsub("%s", ""):gsub("%x%x", function(digits) return string.char(tonumber(digits, 16)) end))
end

--- How many kilobytes Lua holds.
function M.kilobytes()
  collectgarbage()
  collectgarbage()
  return collectgarbage("count")
end

--- A file in memory as Wireshark gives it: it reads in order and goes to any offset, unless it is a pipe.
-- buffer  bytes of a pipe that can be read again
function M.file(text, is_pipe, buffer)
  local file = { pos = 0 }
  function file:read(count)
    local part = text:sub(self.pos + 1, self.pos + count)
    self.pos = self.pos + #part
    return part ~= "" and part or nil
  end
  function file:seek(_, offset)
    if is_pipe and self.pos > buffer then return nil, "Illegal seek" end
    self.pos = offset
    return offset
  end
  return file
end

return M
