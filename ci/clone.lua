-- SPDX-License-Identifier: GPL-2.0-or-later
-- Wireshark runs every Lua file below its plugin folder, in folders first, by name.  This is the
-- first one of a clone there: it says that the clone does not belong there.
local clone = debug.getinfo(1, "S").source:match("^@(.*[/\\])ci[/\\]") or "./"
local say = loadfile(clone .. "yapp/base/alone.lua") -- nil in an unpacked zip, which is no clone
if say then say() end
