-- SPDX-License-Identifier: GPL-2.0-or-later
-- Loaded behind the plugin: the garbage collector is always at work, so what is not held any more goes at once.
if not os.getenv("YAPP_COLLECT") then return end -- run by Wireshark, in a plugin folder
collectgarbage("setpause", 1)
collectgarbage("setstepmul", 1000)
collectgarbage()
local tap = Listener.new("frame")
function tap.draw() io.stderr:write("pause ", collectgarbage("setpause", 1), "\n") end
