-- SPDX-License-Identifier: GPL-2.0-or-later
-- No module requires this one.  Wireshark runs it if the folder yapp/ is below a plugin folder,
-- where Wireshark runs every Lua file: in folders first, by name.  Each other module then fails to
-- find the modules that it requires.  So name the cause first, ahead of a thousand errors.
-- In a clone ci/clone.lua runs it still earlier.

local function say()
  local folder = debug.getinfo(1, "S").source:match("^@(.*[/\\])yapp[/\\]base[/\\]") or "./"
  io.stderr:write(("yapp: %s is a clone in a plugin folder, where Wireshark runs every file: " ..
    "move it elsewhere, and run make install or tools/install.py there\n"):format(folder))
end

if not package.loaded["yapp.base.alone"] then say() end
package.loaded["yapp.base.alone"] = say
