-- SPDX-License-Identifier: GPL-2.0-or-later
-- The wishes of tshark's command line that the API does not tell.  Wireshark's API.

local command_line = require "yapp.base.command_line"

local M = {}

--- Return the options of the command line, see base.command_line; none in Wireshark, and where the
-- system does not tell them.  Linux does.
function M.options()
  local file = not gui_enabled() and io.open("/proc/self/cmdline", "rb")
  if not file then return {} end
  local text = file:read("*a")
  file:close()
  return command_line.options(text)
end

-- Return the number and the time of a file of a ring by the tail of its name,
-- 00002_20261125230028.pcapng or 20261125230028_00002.pcapng; number 0 for another file.
local function file_of(tail)
  local number, stamp = tail:match("^(%d%d%d%d%d)_(%d+)")
  if not number then stamp, number = tail:match("^(%d+)_(%d%d%d%d%d)") end
  return tonumber(number) or 0, stamp
end

--- Count the files in which a live capture with -b went on behind its first one, which is all that
-- tshark analyses.
-- options  of the command line
-- since    os.time() before the capture began
-- returns  their number, 0 without -b; nil if it cannot be known
function M.count_later_files(options, since)
  if not (options.b or options["ring-buffer"]) then return 0 end
  local path = options.w or ""
  local folder, name = path:match("^(.*[/\\])([^/\\]*)$")
  name = name or path
  local base, count = (name:match("^(.*)%.[^.]*$") or name) .. "_", 0
  local first_stamp = os.date("%Y%m%d%H%M%S", since)
  local is_open, files = pcall(Dir.open, folder or ".")
  if not is_open then return nil end
  for file in files do
    local number, stamp = file_of(file:sub(1, #base) == base and file:sub(#base + 1) or "")
    if number > 1 and stamp >= first_stamp then count = count + 1 end
  end
  files:close()
  return count
end

return M
