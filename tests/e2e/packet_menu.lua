-- SPDX-License-Identifier: GPL-2.0-or-later
-- Loaded behind the plugin: prints what items of the packet menu hand to Wireshark's windows.  tshark has no windows.
if not os.getenv("YAPP_MENU") then return end -- run by Wireshark, in a plugin folder

package.path = "" -- the plugin finds its modules: no others, such as those of the folder where the tests run
local show_menu = require("yapp.show.menu")

local items = {}
_G.register_packet_menu = function(title, act) items[title:match("/(.*)$")] = act end
_G.new_dialog = function(_, _, row) io.write(row.value, "\n") end

-- -z yappmenu,needs: which field each item that filters needs
register_stat_cmd_arg("yappmenu,needs", function()
  local needs = {}
  _G.register_packet_menu = function(title, _, field) needs[#needs + 1] = title .. "=" .. field end
  local message = { name = "motor", title = "Motor Data", alarms = { { filter = "taurus.motor.fault_flags" } } }
  show_menu.register({}, { messages = { message } })
  io.write(table.concat(needs, "\n"), "\n")
end)

-- The controller 0x210 of a bus, and the preference yapp.sources, of each line of a text
for bus, sources in (os.getenv("YAPP_MENU")):gmatch("([^\n]*)|([^\n]*)") do
  show_menu.register({ sources = sources }, { messages = { { name = "motor", title = "Motor Data", alarms = {} } } })
  local name = items["Name this controller ..."]
  if bus == "" then
    name({ name = "yapp.id", value = 0x210 })
  else
    name({ name = "yapp.id", value = 0x210 }, { name = "yapp.bus", value = bus })
  end
end
