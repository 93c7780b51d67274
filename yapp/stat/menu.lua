-- SPDX-License-Identifier: GPL-2.0-or-later
-- Wireshark's menus Tools > YAPP and Statistics: the texts of -z yapp,... in windows, the page of a flight, help.
-- Wireshark's API.

local page, text = require("yapp.stat.page"), require("yapp.stat.text")

local M = {}

local TITLES = { summary = "Summary", faults = "Faults", events = "Events", check = "Check", csv = "Export tables" }
local ORDER = { "summary", "faults", "events", "check", "csv" }
local RULES = "fault=0,crc=0,incomplete=0"
local PAGE, HELP = "Open the flight page", "Help"
local MOST = 1000 -- frames in a display filter: more make Wireshark slow

-- Asks for one line.
local function ask(title, label, default, answered)
  new_dialog("YAPP " .. title, function(answer)
    if answer and answer ~= "" then answered(answer) end
  end, { name = label, value = default })
end

-- Writes a text into a new file.
local function save(path, content)
  local there = io.open(path, "r")
  if there then
    there:close()
    return report_failure(("YAPP: %s is there already: another name"):format(path))
  end
  local file, problem = io.open(path, "w")
  local ok = file and file:write(content) and file:close()
  if not ok then report_failure(("YAPP: %s cannot be written: %s"):format(path, problem or "no place for it")) end
end

-- Beside the capture, where it is known.
local function default_path(name)
  local capture = page.capture()
  return capture ~= "" and capture:gsub("%.[^./\\]*$", "") .. "-" .. name or name
end

local function show_frames(content)
  local frames = text.frames(content)
  if #frames == 0 then return report_failure("YAPP: no frame stands in this window") end
  set_filter(("frame.number in {%s}"):format(table.concat(frames, ", ", 1, math.min(#frames, MOST))))
  apply_filter()
end

-- A window with a text that can be made anew, copied and saved, and whose frames can be shown.
-- make  function() -> the text
local function open_window(title, make)
  local window, content = TextWindow.new("YAPP " .. title), nil
  local function refresh()
    content = make()
    window:set(content)
  end
  window:add_button("Refresh", refresh)
  window:add_button("Copy", function() copy_to_clipboard(content) end)
  window:add_button("Save", function()
    local path = default_path(title:lower():gsub(" ", "-") .. ".txt")
    ask("Save", "New file", path, function(answer) save(answer, content) end)
  end)
  window:add_button("Show frames", function() show_frames(content) end)
  refresh()
end

-- Wireshark closes a window when Lua collects it: this one has no button that holds it.
local texts = {}

local function open_text(title, content)
  local window = TextWindow.new("YAPP " .. title)
  window:set(content)
  texts[#texts + 1] = window
end

-- The preferences that say what is in a capture, as they are now.
local function preferences(catalogue)
  local names, list = { "sources", "late", "user_dlt" }, {}
  for _, message in ipairs(catalogue.messages) do names[#names + 1] = message.name .. "_ids" end
  for _, name in ipairs(names) do
    local value = get_preference("yapp." .. name)
    if value and value ~= "" then list[#list + 1] = ("yapp.%s:%s"):format(name, value) end
  end
  return list
end

-- Wireshark waits while the page is made.
local function open_page(catalogue)
  ask(PAGE, "Capture", page.capture(), function(capture)
    local path, said = page.make(capture, preferences(catalogue))
    if not path then return open_text("Flight page", said) end
    if said ~= "" then open_text("Flight page", said) end
    browser_open_url(page.address(path))
  end)
end

--- Makes the menus.
-- stat     of stat.taps
-- returns  { show = function(text), which opens the window of an argument of -z }
function M.register(stat)
  local menu = {}

  -- The statistic runs when its window opens, and anew by its button: packets that have come since count too.
  function menu.show(argument)
    local what = argument:match("^yapp,(%w+)") or ""
    open_window(TITLES[what] or what, function() return stat:run(argument) end)
  end

  local actions = {
    check = function()
      ask(TITLES.check, "Rules", RULES, function(rules) menu.show("yapp,check," .. rules) end)
    end,
    csv = function()
      ask(TITLES.csv, "New folder", default_path("tables"), function(folder) menu.show("yapp,csv," .. folder) end)
    end,
  }
  for _, what in ipairs(ORDER) do
    local action = actions[what] or function() menu.show("yapp," .. what) end
    register_menu("YAPP/" .. TITLES[what], action, MENU_TOOLS_UNSORTED)
    register_menu("YAPP " .. TITLES[what], action, MENU_STAT_UNSORTED) -- 4.0 shows a slash there as it is
  end
  register_menu("YAPP/" .. PAGE, function() open_page(stat.plugin.catalogue) end, MENU_TOOLS_UNSORTED)
  register_menu("YAPP/" .. HELP, function() open_text(HELP, require("yapp.stat.help")) end, MENU_TOOLS_UNSORTED)
  return menu
end

return M
