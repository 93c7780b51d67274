-- SPDX-License-Identifier: GPL-2.0-or-later
-- Loaded behind the plugin: -z yappmenu prints which field each item of the packet menu needs.  tshark has no windows.
package.path = "" -- the plugin finds its modules: no others, such as those of the folder where the tests run
local show_menu = require("yapp.show.menu")

register_stat_cmd_arg("yappmenu", function()
  local needs = {}
  _G.register_packet_menu = function(title, _, field) needs[#needs + 1] = title .. "=" .. field end
  local message = { name = "motor", title = "Motor Data", alarms = { { filter = "taurus.motor.fault_flags" } } }
  show_menu.register({}, { messages = { message } })
  io.write(table.concat(needs, "\n"), "\n")
end)
