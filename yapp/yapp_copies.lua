-- SPDX-License-Identifier: GPL-2.0-or-later
-- Other copies of the plugin in Wireshark's plugin folders.  Of files with one name Wireshark runs the first by the
-- alphabet, and says nothing of the others: so the copy that runs looks for them.  Version 1.0.0 did not look; where it
-- comes first, this file is still run, its name being new, and tells of its own folder.

local M = {}

local DEPTH = 5 -- of folders in the plugin folder; a link to a parent ends there

-- One dialog in Wireshark, stderr in tshark.
local function say(text)
  if gui_enabled() and report_failure then return report_failure("YAPP: " .. text) end
  io.stderr:write("yapp: " .. text .. "\n")
end

local function slashes(path)
  return (path:gsub("[/\\]+", "/"))
end

-- The folders below this one that have a yapp.lua, each with a slash at its end: { folder = true }.
local function find(folder, depth, found)
  local there, names = pcall(Dir.open, folder)
  if not there then return end
  for name in names do
    local path = folder .. "/" .. name
    if name == "yapp.lua" then
      found[slashes(folder .. "/")] = true
    elseif depth > 0 and name:sub(1, 1) ~= "." and Dir.exists(path) then
      find(path, depth - 1, found)
    end
  end
end

-- COMPAT 4.4: listing a folder by Dir corrupts the program's memory there ("malloc(): mismatching next->prev_size" in
-- about half of the runs), so nothing is looked for: the first copy by the alphabet loads, and no line says so.
local CANNOT_LIST = get_version():find("^4%.[1-4]%.") ~= nil

local function in_plugin_folders()
  if CANNOT_LIST then return {} end
  local found, folders = {}, {}
  local roots = { Dir.global_plugins_path(), Dir.personal_plugins_path(), Dir.personal_config_path("plugins") }
  for _, folder in ipairs(roots) do
    find(folder, DEPTH, found)
  end
  for folder in pairs(found) do folders[#folders + 1] = folder end
  table.sort(folders)
  return folders
end

local function version_of(folder)
  local file = io.open(folder .. "yapp.lua", "r")
  local text = file and file:read(2000) or ""
  if file then file:close() end
  return text:match('local VERSION = "([^"]*)"') or "?"
end

local function is_clone(folder)
  return Dir.exists(folder .. "tests/unit") == true
end

local CLONE = "a clone of the repository does not belong in a plugin folder, where its tests are run as plugins: " ..
  "move it elsewhere and run 'make install' in it"

local function not_loaded(folder, version, loaded)
  say(("%syapp.lua (%s) is not loaded: %s (%s) is already there; %s"):format(folder, version, loaded.path,
    loaded.version, is_clone(folder) and CLONE or "remove one of them"))
end

--- Says which copies in Wireshark's plugin folders are left out, a line each, and whether this one is a clone there.
-- @param loaded  the copy that runs: { path = its yapp.lua, version = }
function M.tell(loaded)
  for _, folder in ipairs(in_plugin_folders()) do
    if folder .. "yapp.lua" ~= slashes(loaded.path) then
      not_loaded(folder, version_of(folder), loaded)
    elseif is_clone(folder) then
      say(folder .. ": " .. CLONE)
    end
  end
end

local loaded = package.loaded["yapp.plugin"]
local folder = debug.getinfo(1, "S").source:match("^@(.*[/\\])yapp[/\\]")
if loaded and folder and slashes(folder .. "yapp.lua") ~= slashes(loaded.path) then
  not_loaded(folder, version_of(folder), loaded)
end

return M
