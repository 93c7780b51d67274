-- SPDX-License-Identifier: GPL-2.0-or-later
-- The conversations of YAPP in the capture file of tshark, behind its first bytes.  If other
-- protocols have the ports of one, no dissector of ours sees its packets; a statistic names it.
--
-- No packet is dissected for that: a search for "YP" takes about 0.3 ms for each MB of the file.

local senders = require "yapp.serial.senders"

local M = {}

local sub = string.sub

local CHUNK = 131072 -- bytes; larger ones do not fit into the processor's cache
local OVERLAP = 128 -- bytes in front of a chunk: the headers of a frame
local MAX_FRAMES = 64 -- of a chunk that are looked at: few MB are of one conversation alone
local MAGIC = {} -- the first bytes of pcap and pcapng; others may be compressed
for _, magic in ipairs { "\212\195\178\161", "\161\178\195\212", "\77\60\178\161", "\161\178\60\77",
  "\10\13\13\10" } do
  MAGIC[magic] = true
end

local function chunks(file)
  local before = ""
  return function()
    local chunk = file:read(CHUNK)
    local text = chunk and before .. chunk
    before = text and sub(text, -OVERLAP)
    return text
  end
end

--- Return the conversations in a regular file, see senders.conversations.
-- path  or nil
-- skip  bytes at its start that are not searched
function M.conversations(path, skip)
  local file, list, is_there = path and io.open(path, "rb"), {}, {}
  if not file then return list end
  if MAGIC[file:read(4)] and file:seek("set", skip) then
    for text in chunks(file) do
      for _, one in ipairs(senders.conversations(text, MAX_FRAMES)) do
        local key = table.concat({ tostring(one.is_tcp), one.from, one.to }, " ")
        -- It need not be the first frame of the conversation.
        one.payload = nil
        if not is_there[key] then list[#list + 1] = one end
        is_there[key] = true
      end
    end
  end
  file:close()
  return list
end

return M
