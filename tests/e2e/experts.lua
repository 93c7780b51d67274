-- SPDX-License-Identifier: GPL-2.0-or-later
-- Loaded in front of the plugin: prints each expert item as the plugin registers it: filter, group, severity.
if not os.getenv("YAPP_EXPERTS") then return end -- run by Wireshark, in a plugin folder

local function name_of(list, value)
  for name, one in pairs(list) do
    if one == value then return name end
  end
end

local new = ProtoExpert.new
function ProtoExpert.new(filter, text, group, severity)
  io.stdout:write(filter, " ", name_of(expert.group, group), " ", name_of(expert.severity, severity), "\n")
  return new(filter, text, group, severity)
end
