# SPDX-License-Identifier: GPL-2.0-or-later
"""A file reader of another plugin: a file that begins with OTHER is its own, a record 23 bytes of it."""

# % its type, "r" or "rs"
OTHER_READER = """
local other = FileHandler.new("other text", "other_text", "other text", "%s")
function other.read_open(file, capture)
  if file:read(6) ~= "OTHER\\n" then return false end
  capture.encap = wtap.USER0
  return true
end
function other.read(file, capture, frame)
  local offset = file:seek("cur")
  local bytes = file:read(23)
  if not bytes then return false end
  frame.data = bytes
  return offset
end
other.seek_read = function() return false end
register_filehandler(other)
"""
