-- SPDX-License-Identifier: GPL-2.0-or-later
-- Statistics in Wireshark: Tools > YAPP and Statistics > YAPP, the texts of -z yapp,... in windows.  Wireshark's API.

local M = {}

local TITLES = { summary = "Summary", faults = "Faults", events = "Events", check = "Check", csv = "Export tables" }
local ORDER = { "summary", "faults", "events", "check", "csv" }
local RULES = "fault=0,crc=0,incomplete=0"

--- Makes the menus.
-- stat     of yapp_stat
-- returns  { show = function(text), which opens the window of an argument of -z }
function M.register(stat)
  local menu = {}

  -- The statistic runs when its window opens, and anew by its button: packets that have come since count too.
  function menu.show(text)
    local what = text:match("^yapp,(%w+)") or ""
    local window = TextWindow.new("YAPP " .. (TITLES[what] or what))
    local function refresh() window:set(stat:run(text)) end
    window:add_button("Refresh", refresh)
    refresh()
  end

  local function ask(title, label, default, complete)
    return function()
      new_dialog("YAPP " .. title, function(answer)
        if answer and answer ~= "" then menu.show(complete(answer)) end
      end, { name = label, value = default })
    end
  end

  local actions = {
    check = ask(TITLES.check, "Rules", RULES, function(rules) return "yapp,check," .. rules end),
    csv = ask(TITLES.csv, "New folder", "", function(folder) return "yapp,csv," .. folder end),
  }
  for _, what in ipairs(ORDER) do
    local action = actions[what] or function() menu.show("yapp," .. what) end
    register_menu("YAPP/" .. TITLES[what], action, MENU_TOOLS_UNSORTED)
    register_menu("YAPP " .. TITLES[what], action, MENU_STAT_UNSORTED) -- 4.0 shows a slash there as it is
  end
  return menu
end

return M
