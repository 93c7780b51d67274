-- SPDX-License-Identifier: GPL-2.0-or-later
-- Wireshark's menus Tools > YAPP and Statistics: the texts of -z yapp,... in windows, the decoding
-- of unknown IDs, and help.  Wireshark's API.

local mapped = require "yapp.base.mapped"
local options_of = require "yapp.stat.options"
local preferences = require "yapp.host.preferences"
local rules_of = require "yapp.stat.rules"
local undecoded = require "yapp.stat.undecoded"

local M = {}

local MAX_FRAMES = 1000 -- in a display filter: more make Wireshark slow

local MAX_SECONDS = 1 -- of reading: a window that takes longer is not refreshed by itself
-- New folders begin like this: Lua does not know that of the capture.
local FOLDER = (os.getenv("HOME") or os.getenv("USERPROFILE") or ".") .. "/yapp-"
local DECODE = "Decode unknown IDs by size"

local HELP = [[
YAPP, the packet protocol of Taurus motor controllers, on CAN, CAN FD,
UART, TCP and UDP.

To see                          display filter
every message with a fault      taurus.fault.active
where a fault begins            taurus.fault.raised
where it ends                   taurus.fault.cleared
all frames of these messages    yapp.message.fault
a gap; a controller rebooted    yapp.late || taurus.reboot
bad CRCs                        yapp.crc.status == 0
bytes are missing               yapp.fragment.incomplete
the Start is missing            yapp.fragment.orphan
the capture ends in a message   yapp.unfinished
commands that are ignored       taurus.command.key.invalid
no sensor, or out of range      taurus.value.special
one controller                  yapp.source == "left"

Tools > YAPP
%s
A rule is fault=0, motor.rate=9..11 or motor.dc_voltage=40..55; several
have commas between. Rules about a message:
%s
In a window, Show frames makes a display filter of the frames that
stand in it: a click on one in the packet list leads to it.  On the
command line, without a limit to the width, the same is

    tshark -q -r flight.pcapng -z yapp,faults

All of a flight on one time axis, in the browser, makes the program
yapp-tables, a Python package in the folder tools of the plugin's files:

    pip install "./tools[report]"
    yapp-tables report flight.pcapng --out flight.html

Other IDs than the default, several controllers, names for them:
Edit > Preferences > Protocols > YAPP.
Columns, colours, filter buttons and graphs: the profile YAPP, at the
right of the status bar.  README.md and the folder docs of this plugin's
files have more.
]]

local function show_frames(frames)
  if not frames[1] then
    return report_failure("YAPP: no frame stands in this window")
  end
  local numbers = {}
  for _, frame in ipairs(frames) do
    if frame ~= numbers[#numbers] then numbers[#numbers + 1] = frame end
  end
  local count = math.min(#numbers, MAX_FRAMES)
  set_filter(("frame.number in {%s}"):format(table.concat(numbers, ", ", 1, count)))
  apply_filter()
end

-- [window] = function(), called when packets have come, of the windows that are open.
local on_packets_of = {}

-- Return an answer with advice that fits Wireshark; the page in the browser has buttons.
local function with_menus(answer)
  if yapp_is_whole then return answer end
  answer = answer:gsub("%. Try %-o [^\n]*", ". Tools > YAPP > " .. DECODE .. " decodes them")
  return (answer:gsub("; try %-d ", "; choose in Analyze > Decode As: "))
end

-- Open a window with a text.  Its buttons make the text anew, copy it, show its frames.
-- make  function() -> the text, the frames
-- stat  of stat.taps
local function open_window(title, make, stat)
  local window, content, frames = TextWindow.new("YAPP " .. title), "", {}
  local total = math.huge -- of the reading; so many while it goes on, or if its text is old
  local seconds = 0 -- that it took
  local function refresh()
    local begin = os.clock()
    total = math.huge
    content, frames = make()
    content = with_menus(content)
    total, seconds = stat.total, os.clock() - begin
    -- A closed window takes no text; the reading may go on without it.
    if on_packets_of[window] then window:set(content) end
  end
  -- A window whose reading takes long says once that it is old.
  on_packets_of[window] = function()
    if stat.total <= total then return end
    if seconds < MAX_SECONDS then return refresh() end
    total = math.huge
    window:set("More packets have come: press Refresh\n\n" .. content)
  end
  window:set_atclose(function()
    on_packets_of[window] = nil
  end)
  window:add_button("Refresh", refresh)
  window:add_button("Copy", function() copy_to_clipboard(content) end)
  window:add_button("Show frames", function() show_frames(frames) end)
  refresh()
end

-- Decode all unknown IDs of the capture that have the size of a message as that message, and say
-- so in a window, with a way back.
local function decode_by_size(stat)
  local answer, before, after, said = stat:run("yapp,faults,json"), {}, {}, ""
  for name, ids in answer:gmatch("%-o yapp%.([%w_]+)_ids:(%S+)") do
    local key = name .. "_ids"
    before[key], after[key] = undecoded.ranges_of(stat.settings.ids[name]), ids
    said = said .. ("yapp.%s was %s, and is now\n  %s\n"):format(key, before[key], ids)
  end
  if said == "" then
    return report_failure("YAPP: " .. (answer:match("only %d+ of[^\n]*") or
      "no message of an unknown ID has the size of a message in the catalogue"))
  end
  local window = TextWindow.new("YAPP " .. DECODE)
  window:add_button("Undo", function()
    preferences.set(before)
    window:set("The preferences are as they were.\n")
  end)
  window:set(said)
  preferences.set(after)
end

-- Hold the help window: Wireshark closes a window that Lua collects, and no button refers to this
-- one.
local help

-- Return a line for each row: the value of a key, and the help.
local function lines_of(rows, key)
  return table.concat(mapped(rows, function(row) return row[key] .. ": " .. row.help .. "\n" end))
end

local function open_help()
  help = TextWindow.new("YAPP Help")
  help:set(HELP:format(lines_of(options_of.MENUS, "title"), lines_of(rules_of.LIST, "text") ..
    lines_of(rules_of.SUFFIXES, "text")))
end

--- Make the menus.
-- stat     of stat.taps
-- returns  function(text), which opens the window of an argument of -z
--          function(), to be called when packets have come
function M.register(stat)
  -- The statistic runs when its window opens, and again by its button: packets that have come since
  -- count too.
  local function show(argument)
    local row = options_of.BY_NAME[argument:match("^yapp,(%w+)")]
    open_window(row and row.title or "", function() return stat:run(argument) end, stat)
  end

  for _, row in ipairs(options_of.MENUS) do
    local argument = "yapp," .. row.name
    local function on_answer(answer)
      show(answer == "" and argument or argument .. "," .. answer)
    end
    register_menu("YAPP/" .. row.title, function()
      if not row.ask then return show(argument) end
      local default = row.file and FOLDER .. row.file or ""
      new_dialog("YAPP " .. row.title, on_answer, { name = row.ask, value = default })
    end, MENU_TOOLS_UNSORTED)
  end
  register_menu("YAPP/" .. DECODE, function() decode_by_size(stat) end, MENU_TOOLS_UNSORTED)
  register_menu("YAPP/Help", open_help, MENU_TOOLS_UNSORTED)
  -- Wireshark has submenus of plugins in Tools alone: elsewhere it shows a slash as it is.
  local function summary() show("yapp,summary") end
  register_menu("YAPP Summary (more: Tools > YAPP)", summary, MENU_STAT_UNSORTED)
  return show, function()
    if stat.is_reading then return end
    for _, call in pairs(on_packets_of) do call() end
  end
end

return M
