-- SPDX-License-Identifier: GPL-2.0-or-later
-- Wireshark runs every Lua file below its plugin folder, in folders first, by name.  This is the
-- first one of a clone there: it says that the clone does not belong there.
local clone = debug.getinfo(1, "S").source:match("^@(.*[/\\])ci[/\\]") or "./"
-- An unpacked zip is no clone.  Wireshark's loadfile raises if there is no file.
local is_there, say = pcall(loadfile, clone .. "yapp/base/alone.lua")
if is_there and say then say() end
