-- SPDX-License-Identifier: GPL-2.0-or-later
-- The ports of servers of YAPP.  Wireshark's API.
--
-- A client sends from a port that its system picks.  If another protocol has that port, Wireshark
-- hands it the packets, and the heuristics never see them:
--
--   10.0.0.2:44818 -> 10.0.0.9:14550   EtherNet/IP has 44818; Wireshark asks who has 14550 first
--
-- So once YAPP is found in a conversation, the lower port looks for YAPP, too, unless another
-- protocol has it.  Packets whose other port no protocol has are left to the heuristics.

local M = {}

local TCP = 2 -- pinfo.port_type
local TABLES = { [true] = DissectorTable.get("tcp.port"), [false] = DissectorTable.get("udp.port") }

local registered = {} -- list of { table of dissectors, port }
local own, dissect -- Proto; its dissector, which most captures do not need

--- Use a protocol from now on.
-- proto      that looks for YAPP, and leaves other bytes
-- dissector  of it: function(tvb, pinfo, tree)
function M.use(proto, dissector)
  own, dissect = proto, dissector
end

--- Register the server's port of a conversation.
function M.register(is_tcp, port)
  local ports = TABLES[is_tcp]
  if ports:get_dissector(port) then return end -- it may be ours already
  own.dissector = dissect
  ports:add(port, own)
  registered[#registered + 1] = { ports, port }
end

local function table_of(pinfo)
  return pinfo.port_type == TCP and TABLES[true] or TABLES[false]
end

--- Return whether another protocol has the client's port of a packet.
function M.is_of_others(pinfo)
  local client = math.max(pinfo.src_port, pinfo.dst_port)
  return table_of(pinfo):get_dissector(client) ~= nil
end

--- Return whether another protocol has a port of a packet.
function M.has_other(pinfo)
  local ports = table_of(pinfo)
  for _, port in ipairs { pinfo.src_port, pinfo.dst_port } do
    local dissector = ports:get_dissector(port)
    if dissector and tostring(dissector) ~= own.name then return true end
  end
  return false
end

--- Give back all ports, except ports that the user has given to another protocol since.
function M.unregister_all()
  for _, row in ipairs(registered) do
    local ports, port = row[1], row[2]
    if tostring(ports:get_dissector(port)) == own.name then ports:remove(port, own) end
  end
  registered = {}
end

return M
