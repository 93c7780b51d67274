-- SPDX-License-Identifier: GPL-2.0-or-later
-- Loaded behind the plugin: the garbage collector is always at work, so what is not held any more goes at once.
collectgarbage("setpause", 1)
collectgarbage("setstepmul", 1000)
collectgarbage()
