-- SPDX-License-Identifier: GPL-2.0-or-later
-- Other copies of the plugin in Wireshark's plugin folders.  Of files with one name Wireshark runs the first by the
-- alphabet, and says nothing of the others: so the copy that runs looks for them when the first file is opened.
-- Version 1.0.0 did not look; where it comes first, this file is still run, its name being new, and tells of its own
-- folder.

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

local function has_plugin(folder)
  local file = io.open(folder .. "yapp.lua", "r")
  return file ~= nil and file:close()
end

-- COMPAT 4.0: Dir.open of a folder that this user may not read writes to where an uninitialised pointer points.
local function may_read(folder)
  if package.config:sub(1, 1) ~= "/" then return true end -- Windows opens no folder as a file
  local file = io.open(folder, "r")
  return file ~= nil and file:close()
end

-- The folders below this one, and itself, each with a slash at its end, into the list found.
local function list(folder, depth, found)
  found[#found + 1] = slashes(folder .. "/")
  if depth == 0 or not may_read(folder) then return end
  local there, names = pcall(Dir.open, folder)
  if not there then return end
  for name in names do
    local path = folder .. "/" .. name
    if name:sub(1, 1) ~= "." and Dir.exists(path) then list(path, depth - 1, found) end
  end
end

-- From 4.4 on Wireshark puts each folder that it runs plugins from into package.path; before, folders are listed.
local IN_PATH = not get_version():find("^4%.[0-3]%.")

-- The folders below a plugin folder, each with a slash at its end.
local function folders_in(root)
  local found = {}
  if not IN_PATH then
    if Dir.exists(root) then list(root, DEPTH, found) end
    return found
  end
  root = slashes(root .. "/")
  for folder in package.path:gmatch("([^;]+[/\\])%?%.lua") do
    folder = slashes(folder)
    if folder:sub(1, #root) == root then found[#found + 1] = folder end
  end
  return found
end

-- Those in which there is a yapp.lua, in the order of the alphabet.
local function in_plugin_folders()
  local is_known, folders = {}, {}
  local roots = { Dir.global_plugins_path(), Dir.personal_plugins_path(), Dir.personal_config_path("plugins") }
  for _, root in ipairs(roots) do
    for _, folder in ipairs(folders_in(root)) do
      if not is_known[folder] and has_plugin(folder) then folders[#folders + 1] = folder end
      is_known[folder] = true
    end
  end
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

--- Says which copies in Wireshark's plugin folders are left out, a line each, and whether this one is a clone there;
-- once, and not before all plugins are loaded.
-- @param loaded  the copy that runs: { path = its yapp.lua, version = }
function M.tell(loaded)
  if M.is_told then return end
  M.is_told = true
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
