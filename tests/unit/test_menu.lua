-- SPDX-License-Identifier: GPL-2.0-or-later
-- The menus Tools > YAPP and Statistics: which entry opens which statistic, and what the buttons of its window do.
-- Wireshark's windows are stand-ins here; tests/gui has the real ones.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")

local T = {}

local NAMES = { "set_preference", "apply_preferences", "redissect_packets", "yapp_is_whole",
  "register_menu", "new_dialog", "TextWindow", "report_failure", "set_filter", "apply_filter",
  "copy_to_clipboard", "MENU_TOOLS_UNSORTED", "MENU_STAT_UNSORTED" }
-- The entries of Tools > YAPP in their order, what each opens, and whether it asks first: typed once more.
local OPENS = { { "Summary", "yapp,summary" }, { "Faults", "yapp,faults" }, { "Fault", "yapp,fault", true },
  { "Events", "yapp,events" },
  { "Compare", "yapp,compare" }, { "CAN buses", "yapp,buses" },
  { "Export tables", "yapp,csv", true }, { "Check", "yapp,check", true } }

local seen -- what the plugin asked of the windows

-- A menu with stand-ins for Wireshark's windows.
local function menu()
  seen = { items = {}, order = {}, windows = {}, dialogs = {}, runs = {}, failures = {}, filters = {}, applied = 0,
    set = {} }
  _G.MENU_TOOLS_UNSORTED, _G.MENU_STAT_UNSORTED = "tools", "statistics"
  function _G.register_menu(title, act, group)
    seen.items[title] = { act = act, group = group }
    seen.order[#seen.order + 1] = title
  end
  function _G.new_dialog(title, act, row) seen.dialogs[#seen.dialogs + 1] = { title = title, act = act, row = row } end
  function _G.report_failure(text) seen.failures[#seen.failures + 1] = text end
  function _G.set_filter(text) seen.filters[#seen.filters + 1] = text end
  function _G.apply_filter() seen.applied = seen.applied + 1 end
  function _G.copy_to_clipboard(text) seen.copied = text end
  function _G.set_preference(name, value) seen.set[name] = value end
  function _G.apply_preferences() end
  function _G.redissect_packets() end
  _G.TextWindow = { new = function(title)
    local window = { title = title, buttons = {}, names = {} }
    function window.set(self, text) self.text = text end
    function window.set_atclose(self, act) self.close = act end
    function window.add_button(self, name, act)
      self.buttons[name] = act
      self.names[#self.names + 1] = name
    end
    seen.windows[#seen.windows + 1] = window
    return window
  end }
  local stat = { frames = { 7, 9, 7 }, total = 10 }
  function stat.run(self, argument)
    seen.runs[#seen.runs + 1] = argument
    self.read() -- while it reads, Wireshark draws the taps
    return ("%s, run %d"):format(argument, #seen.runs), self.frames
  end
  package.loaded["yapp.stat.windows"] = nil
  local show, on_packets = require("yapp.stat.windows").register(stat)
  stat.read = on_packets
  return show, stat, on_packets
end

function T.tearDown()
  for _, name in ipairs(NAMES) do _G[name] = nil end
  package.loaded["yapp.stat.windows"] = nil
end

local function last(list) return list[#list] end

function T.test_each_entry_opens_its_statistic()
  menu()
  for _, row in ipairs(OPENS) do
    local title, argument = row[1], row[2]
    local item = seen.items["YAPP/" .. title]
    lu.assertNotNil(item, title)
    lu.assertEquals(item.group, "tools")
    local dialogs = #seen.dialogs
    item.act()
    lu.assertEquals(#seen.dialogs - dialogs, row[3] and 1 or 0)
    if row[3] then
      lu.assertEquals(last(seen.dialogs).title, "YAPP " .. title)
      last(seen.dialogs).act("")
    end
    lu.assertEquals(last(seen.runs), argument)
    lu.assertEquals(last(seen.windows).title, "YAPP " .. title)
    lu.assertEquals(last(seen.windows).text, ("%s, run %d"):format(argument, #seen.runs))
  end
  lu.assertEquals(#seen.order, #OPENS + 3) -- Decode unknown IDs, Help, and the one in Statistics
end

function T.test_what_an_entry_asks_for()
  menu()
  seen.items["YAPP/Check"].act()
  lu.assertEquals(last(seen.dialogs).row.value, "")
  lu.assertEquals(last(seen.dialogs).row.name, "Rules (empty: check everything)")
  last(seen.dialogs).act("fault=0")
  lu.assertEquals(last(seen.runs), "yapp,check,fault=0")
  local runs = #seen.runs
  last(seen.dialogs).act(nil) -- Cancel
  lu.assertEquals(#seen.runs, runs)
  seen.items["YAPP/Export tables"].act()
  lu.assertEquals(last(seen.dialogs).row.name, "New folder")
  lu.assertStrMatches(last(seen.dialogs).row.value, ".*/yapp%-tables")
  last(seen.dialogs).act("/tmp/here")
  lu.assertEquals(last(seen.runs), "yapp,csv,/tmp/here")
end

function T.test_the_entry_in_statistics()
  menu()
  local title = last(seen.order)
  lu.assertStrContains(title, "Summary")
  lu.assertEquals(seen.items[title].group, "statistics")
  seen.items[title].act()
  lu.assertEquals(seen.runs, { "yapp,summary" })
end

function T.test_help()
  menu()
  seen.items["YAPP/Help"].act()
  lu.assertEquals(last(seen.windows).title, "YAPP Help")
  local text = last(seen.windows).text
  for _, row in ipairs(OPENS) do lu.assertStrContains(text, "\n" .. row[1]) end
  for _, rule in ipairs { "motor.rate", "motor.dc_voltage" } do lu.assertStrContains(text, rule) end
  for _, row in ipairs(require("yapp.stat.rules").LIST) do
    lu.assertStrContains(text, row.text)
    lu.assertStrContains(text, row.help)
  end
end

-- A filter that is misspelt would find nothing.
function T.test_the_filters_of_help_exist()
  menu()
  seen.items["YAPP/Help"].act()
  local file, count = assert(io.open("docs/filters.md")), 0
  local page = file:read("*a")
  file:close()
  for _, prefix in ipairs { "yapp", "taurus" } do
    for name in last(seen.windows).text:gmatch("%f[%w]" .. prefix .. "%.[%l_.]*%l") do
      lu.assertStrContains(page, "`" .. name .. "`")
      count = count + 1
    end
  end
  lu.assertEquals(count, 13)
end

function T.test_refresh_and_copy()
  local show = menu()
  show("yapp,events")
  local window = last(seen.windows)
  lu.assertEquals(window.names, { "Refresh", "Copy", "Save", "Show frames" })
  window.buttons.Refresh()
  lu.assertEquals(seen.runs, { "yapp,events", "yapp,events" })
  lu.assertEquals(window.text, "yapp,events, run 2")
  window.buttons.Copy()
  lu.assertEquals(seen.copied, "yapp,events, run 2")
end

-- While a capture goes on.  The reading of a long one would keep Wireshark busy.
function T.test_a_window_is_refreshed_when_packets_have_come()
  local show, stat, on_packets = menu()
  local clock, seconds = os.clock, 0
  rawset(os, "clock", function()
    seconds = seconds + (stat.is_slow and 0.6 or 0.1)
    return seconds
  end)
  show("yapp,events")
  local window = last(seen.windows)
  on_packets()
  lu.assertEquals(window.text, "yapp,events, run 1") -- nothing has come
  stat.total = 11
  on_packets()
  lu.assertEquals(window.text, "yapp,events, run 2")
  stat.total, stat.is_reading = 12, true -- for another window
  on_packets()
  lu.assertEquals(window.text, "yapp,events, run 2")
  stat.is_reading, stat.is_slow = false, true
  on_packets()
  stat.total = 13
  on_packets()
  lu.assertEquals(window.text, "yapp,events, run 4")
  rawset(os, "clock", clock)
end

-- Once, so that the window does not scroll while somebody reads; not in what is copied.
function T.test_a_window_says_that_it_is_old()
  local show, stat, on_packets = menu()
  local clock, seconds = os.clock, 0
  rawset(os, "clock", function()
    seconds = seconds + 2
    return seconds
  end)
  show("yapp,events")
  local window = last(seen.windows)
  stat.total = 11
  on_packets()
  lu.assertEquals(window.text, "More packets have come: press Refresh\n\nyapp,events, run 1")
  window.text = "as it was"
  stat.total = 12
  on_packets()
  lu.assertEquals(window.text, "as it was")
  window.buttons.Copy()
  lu.assertEquals(seen.copied, "yapp,events, run 1")
  window.buttons.Refresh()
  lu.assertEquals(window.text, "yapp,events, run 2")
  stat.total = 13
  window.close()
  stat.total = nil -- nobody asks for it
  on_packets()
  lu.assertEquals(window.text, "yapp,events, run 2")
  rawset(os, "clock", clock)
end

-- What to do fits the place: Wireshark has menus, the page in the browser a button.
function T.test_advice()
  local show, stat = menu()
  function stat.run()
    return "5 messages were not decoded: 0x211. Try -o yapp.motor_ids:0x210-0x211 -o yapp.health_ids:0x200-0x201\n" ..
      "YAPP headers were not decoded; try -d udp.port==5,yapp_serial\n", {}
  end
  show("yapp,faults")
  lu.assertEquals(last(seen.windows).text, "5 messages were not decoded: 0x211. Tools > YAPP > " ..
    "Decode unknown IDs by size decodes them\n" ..
    "YAPP headers were not decoded; choose in Analyze > Decode As: udp.port==5,yapp_serial\n")
  _G.yapp_is_whole = true
  show("yapp,faults")
  lu.assertStrContains(last(seen.windows).text, "Try -o yapp.motor_ids")
end

function T.test_decode_unknown_ids()
  local _, stat = menu()
  local decode = seen.items["YAPP/Decode unknown IDs by size"].act
  local answer = "5 messages were not decoded: 0x213. Try -o yapp.motor_ids:0x210-0x213 -o yapp.my_pump_ids:0x1\n"
  stat.settings = { ids = { motor = { 0x211, 0x210 }, my_pump = {} } }
  function stat.run(_, text) return text == "yapp,faults,json" and answer end
  decode()
  local before = { ["yapp.motor_ids"] = "0x210-0x211", ["yapp.my_pump_ids"] = "" }
  lu.assertEquals(seen.set, { ["yapp.motor_ids"] = "0x210-0x213", ["yapp.my_pump_ids"] = "0x1" })
  lu.assertStrContains(last(seen.windows).text, "yapp.motor_ids was 0x210-0x211, and is now\n  0x210-0x213\n")
  last(seen.windows).buttons.Undo()
  lu.assertEquals(seen.set, before)
  lu.assertStrContains(last(seen.windows).text, "as they were")
  answer = "YAPP faults: 0\n"
  decode()
  lu.assertEquals(seen.failures, { "YAPP: no message of an unknown ID has the size of a message in the catalogue" })
  answer = "only 0 of 7 packets were read, as another window read: press Refresh\n"
  decode()
  lu.assertStrContains(last(seen.failures), "YAPP: only 0 of 7")
end

-- A reading takes seconds: until there is an answer, the window says how far it is.  It may be closed meanwhile.
function T.test_a_window_says_that_it_reads()
  local show, stat = menu()
  local said = {}
  function stat.run(_, _, on_progress)
    local window = last(seen.windows)
    said[#said + 1] = window.text
    on_progress(7)
    said[#said + 1] = window.text
    if seen.is_closing then window.close() end
    on_progress(9)
    return "the answer", {}
  end
  show("yapp,events")
  lu.assertEquals(said, { "Reading: 0 of 10 packets\n", "Reading: 7 of 10 packets\n" })
  local window = last(seen.windows)
  lu.assertEquals(window.text, "the answer")
  seen.is_closing = true
  window.buttons.Refresh()
  lu.assertEquals(window.text, "Reading: 7 of 10 packets\n", "nothing is written to a closed window")
end

function T.test_show_frames()
  local show, stat = menu()
  show("yapp,events")
  last(seen.windows).buttons["Show frames"]()
  lu.assertEquals({ seen.filters, seen.applied }, { { "frame.number in {7, 9}" }, 1 })
  stat.frames = { 5 }
  show("yapp,events")
  last(seen.windows).buttons["Show frames"]()
  lu.assertEquals(last(seen.filters), "frame.number in {5}")
  stat.frames = {}
  show("yapp,events")
  last(seen.windows).buttons["Show frames"]()
  lu.assertEquals({ #seen.filters, seen.applied, #seen.failures }, { 2, 2, 1 })
  stat.frames = {}
  for number = 1, 1001 do stat.frames[number] = number end
  show("yapp,events")
  last(seen.windows).buttons["Show frames"]()
  lu.assertStrContains(last(seen.filters), " 1000}")
end

-- The folder of the user's files: on Windows another variable has it.
function T.test_where_a_file_is_saved()
  local show, getenv = menu(), os.getenv
  show("yapp,events")
  for folder, name in pairs { ["/home/x"] = "HOME", ["C:/x"] = "USERPROFILE", ["."] = "neither" } do
    rawset(os, "getenv", function(asked) return asked == name and folder or nil end)
    last(seen.windows).buttons.Save()
    rawset(os, "getenv", getenv)
    lu.assertEquals(last(seen.dialogs).row.value, folder .. "/yapp-events.txt")
  end
end

function T.test_save()
  local show = menu()
  show("yapp,events")
  local path = os.tmpname()
  os.remove(path)
  last(seen.windows).buttons.Save()
  lu.assertStrContains(last(seen.dialogs).row.value, "/yapp-events.txt")
  last(seen.dialogs).act("")
  lu.assertEquals(seen.failures, {})
  last(seen.dialogs).act(path)
  local file = assert(io.open(path))
  lu.assertEquals(file:read("*a"), "yapp,events, run 1")
  file:close()
  last(seen.dialogs).act(path) -- what is there stays
  lu.assertStrContains(last(seen.failures), "not written")
  os.remove(path)
end

function T.test_a_proposed_file_has_no_blanks()
  menu()("yapp,csv,tables")
  last(seen.windows).buttons.Save()
  lu.assertStrContains(last(seen.dialogs).row.value, "/yapp-export-tables.txt")
end

return T
