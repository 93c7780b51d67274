-- SPDX-License-Identifier: GPL-2.0-or-later
-- What the plugin needs of Wireshark's windows, for a page in the browser.  The page writes its
-- request, changes a preference of this file, and reads the answer.  Lines of standard output that
-- begin with \1 are for the page.

local REQUEST, ANSWER = "/page/request", "/page/answer"

local statistics = {} -- [name behind -z] = function(text)
local names = {} -- these names in the order of the plugin
local content -- what the plugin shows in the window that it opened last

local function answer(text)
  local file = assert(io.open(ANSWER, "wb"))
  file:write(text)
  file:close()
end

local function ignore() end

-- The page opens whole captures: no packet comes after the last.
yapp_is_whole = true

-- The page is one of Wireshark's windows: packets can be read again at any time.
function gui_enabled() return true end

-- Before print returns, the page has Wireshark read all packets again.
function retap_packets() print("\1retap") end

function report_failure(text) print("\1said " .. text:gsub("\n", " ")) end

function register_stat_cmd_arg(name, run)
  names[#names + 1] = name
  statistics[name] = run
end

TextWindow = {
  new = function()
    local window = { add_button = ignore, append = ignore, set_atclose = ignore }
    function window.set(_, text) content = text end
    return window
  end,
}

-- The page has menus of its own.
register_menu, register_packet_menu = ignore, nil

-- A plugin must not end the page.
function os.exit(code) error(("os.exit(%s)"):format(tostring(code)), 0) end

local ok, problem = pcall(dofile, "/yapp/yapp.lua")
if not ok then report_failure(tostring(problem)) end
answer(table.concat(names, "\n"))

local page = Proto("yapp_page", "YAPP, the page")
page.prefs.request = Pref.string("Request", "", "Written by the page")
local answered = ""

function page.prefs_changed()
  if page.prefs.request == answered then return end
  answered = page.prefs.request
  content = ""
  local text = io.lines(REQUEST)()
  local run = statistics[text:match("^yapp,%w+")] or statistics.yapp
  local is_done, why = pcall(run, text)
  answer(is_done and content or tostring(why))
end
