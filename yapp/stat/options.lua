-- SPDX-License-Identifier: GPL-2.0-or-later
-- The statistics, one row each; and the argument of -z yapp,...: options and rules.  The errors of
-- options, Wireshark's menus and their help, and the tests come from the rows.  Pure Lua.
--
-- A new statistic is a row here and its module.

local buses = require "yapp.stat.buses"
local check = require "yapp.stat.check"
local csv = require "yapp.stat.csv"
local fault = require "yapp.stat.fault"
local input = require "yapp.base.input"
local kinds = require "yapp.stat.kinds"
local lists = require "yapp.stat.lists"
local rules_of = require "yapp.stat.rules"
local summary = require "yapp.stat.summary"
local watch = require "yapp.stat.watch"

local M = {}

local demand, find, trim = input.demand, input.find, input.trim

local NO_RULE = "no rule follows %s: it is for those behind it"

-- Options -----------------------------------------------------------------------------------------
--
-- Functions from here to the rows of the statistics raise errors.

-- Call a function of a row of LIST.  If it raises a text, note it as a problem of this part.
local function attempt(options, part, call, catalogue)
  local ok, why = pcall(call, options, part, catalogue)
  if ok then return end
  if part == "" then part = "an empty option" end
  table.insert(options.problems, ("%s%s: %s"):format(options.line, part, why))
end

local parse_check

local function add_rule(options, text, catalogue, source)
  local words = options.row.options .. ", filter=EXPRESSION"
  local rule = rules_of.parse(text, catalogue, source, words)
  table.insert(options.rules, rule)
  return rule
end

-- The rules of a file, one a line.  A # behind a blank begins a comment.
local function read_rules(options, path, catalogue)
  demand(options.line == "", "a file of rules names no other")
  local file, problem = io.open(path, "rb")
  demand(file, "%s", problem)
  local text = file:read("*a") or "" -- nil for a folder
  file:close()
  local count, number_of_line = #options.rules + #options.problems, 0
  local source = options.source -- for the rules behind the file
  for line in (text:gsub("^\239\187\191", "") .. "\n"):gmatch("(.-)\r?\n") do
    number_of_line = number_of_line + 1
    local part = trim((" " .. line):gsub("%s#.*", ""))
    options.line = ("%s:%d: "):format(path, number_of_line)
    if part ~= "" then attempt(options, part, parse_check, catalogue) end
  end
  options.line, options.source = "", source
  demand(#options.rules + #options.problems > count, "there is no rule in it")
  local unused = options.unused
  options.unused = nil -- a rule behind the file would not be about this source
  demand(not unused, NO_RULE, unused)
end

function parse_check(options, part, catalogue)
  local name, value = part:match("^(%w+)%s*=%s*(.*)$")
  if name == "junit" or name == "source" or name == "rules" then
    demand(value ~= "", "it is empty")
    if name == "source" then
      demand(not options.unused, NO_RULE, options.unused)
      options.unused = part
    end
    if name == "rules" then return read_rules(options, value, catalogue) end
    options[name] = value
  else
    options.unused = nil
    add_rule(options, part, catalogue, options.source)
    options.looks_for_faults = options.looks_for_faults or name == "fault"
    options.judges_unknown = options.judges_unknown or name == "unknown"
  end
end

local function finish_check(options, _, catalogue)
  local rules = options.rules
  if rules[1] or options.problems[1] then
    -- No rule can check a message that was not decoded.
    if not options.judges_unknown then
      add_rule(options, "unknown=0", catalogue)
    end
    demand(not options.unused, NO_RULE, "it")
    return
  end
  options.looks_for_faults = true
  for _, kind in ipairs(kinds.RULES) do
    if not kinds.BY_NAME[kind].is_optional then
      add_rule(options, kind .. "=0", catalogue, options.source).is_default = true
    end
  end
end

local function refuse(options)
  demand(false, "the options of %s are %s, filter=EXPRESSION", options.what, options.row.options)
end

local function parse_csv(options, part, catalogue)
  if not options.folder then
    options.folder = part
    return
  end
  if options.folder ~= "-" or options.chosen then refuse(options) end
  local message, names = find(catalogue.messages, part)
  options.chosen = demand(message, "no such message; known messages: %s", names or "none")
end

local function finish_csv(options)
  local folder, chosen = options.folder or "", options.chosen
  demand(folder ~= "" and (folder ~= "-" or chosen), "it is csv,FOLDER or csv,-,MESSAGE")
  demand(not (chosen and options.json), "csv,- prints a table; json is for csv,FOLDER")
end

local function parse_buses(options, part)
  local bitrate = part:match("^bitrate=(%d+)$")
  if not bitrate then refuse(options) end
  options.bitrate = demand(tonumber(bitrate) > 0 and tonumber(bitrate), "it is 0")
end

local function parse_fault(options, part)
  local name, number = part:match("^(%l*)=?(%d+)$")
  demand(name == "" or name == "frame", "it is fault, fault,3 or fault,frame=719")
  options[name == "" and "number" or "at"] = tonumber(number)
end

local function parse_watch(options, part, catalogue)
  local name, value = part:match("^(%l+)%s*=%s*(.*)$")
  if name == "rules" then return read_rules(options, value, catalogue) end
  if name == "bitrate" then return parse_buses(options, part) end
  if name ~= "stop" or not (value == "fault" or value == "rule") then refuse(options) end
  options.stop = value
end

local function finish_watch(options)
  demand(options.stop ~= "rule" or options.rules[1], "stop=rule is about rules=FILE")
end

-- The statistics ----------------------------------------------------------------------------------

-- name     behind -z yapp,
-- title    in menus
-- new      function(options, context), makes it: see stat.answer
-- columns  of output.columns
-- options  the words besides filter=EXPRESSION: M.parse knows the words without "=" by this text
-- parse    function(options, part, catalogue), reads other options; nil if there are none
-- finish   the same, checks all options at the end; nil for no check
-- help     its meaning, for people
-- ask      the question of a menu; the answer follows the name
-- file     the name of a new file that a menu suggests
-- is_live  true if it shows packets while they come, in tshark alone
-- reads_frames  true if it reads all CAN frames, see stat.buses
-- table_only  true if its output has no room for notes
-- looks_for_faults  true if it must say which messages may hide a fault, as it does not list them
M.LIST = {
  {
    name = "summary",
    title = "Summary",
    new = summary.new,
    columns = summary.COLUMNS,
    options = "json",
    help = "of each controller: rate, gaps, losses, its values",
  },
  {
    name = "faults",
    title = "Faults",
    new = lists.new,
    columns = lists.COLUMNS.faults,
    options = "json",
    help = "when each fault rose and fell",
    looks_for_faults = true,
  },
  {
    name = "fault",
    title = "Fault",
    new = fault.new,
    columns = fault.COLUMNS,
    options = "json, frame=NUMBER",
    parse = parse_fault,
    help = "the card of one fault: what changed before it",
    ask = "Number of the fault, or frame=NUMBER (empty: the first)",
    looks_for_faults = true,
  },
  {
    name = "events",
    title = "Events",
    new = lists.new,
    columns = lists.COLUMNS.events,
    options = "json",
    help = "these, reboots, silences, bad CRCs, losses, in order",
  },
  {
    name = "compare",
    title = "Compare",
    new = summary.compare,
    columns = summary.COMPARED,
    options = "json",
    help = "the values of all controllers beside each other",
  },
  {
    name = "buses",
    title = "CAN buses",
    new = buses.new,
    columns = buses.COLUMNS,
    options = "json, bitrate=BITS",
    parse = parse_buses,
    help = "of each CAN bus: frames, error frames, load",
    reads_frames = true,
  },
  {
    name = "csv",
    title = "Export tables",
    new = csv.new,
    columns = csv.COLUMNS,
    options = "replace, all, json",
    parse = parse_csv,
    finish = finish_csv,
    help = "a CSV for each message, in a new folder",
    ask = "New folder",
    file = "tables",
    table_only = true,
  },
  {
    name = "check",
    title = "Check",
    new = check.new,
    columns = check.COLUMNS,
    options = "json, junit=FILE, source=NAME, rules=FILE",
    parse = parse_check,
    finish = finish_check,
    help = "whether all is well, or rules hold",
    ask = "Rules (empty: check everything)",
  },
  {
    name = "watch",
    title = "Watch",
    new = watch.new,
    columns = watch.COLUMNS,
    options = "json, rules=FILE, stop=fault, stop=rule, bitrate=BITS",
    parse = parse_watch,
    finish = finish_watch,
    help = "the controllers, once a second while packets come",
    looks_for_faults = true,
    is_live = true,
  },
}

--- The rows with a menu.
M.MENUS = {}
for _, row in ipairs(M.LIST) do
  if not row.is_live then M.MENUS[#M.MENUS + 1] = row end
end
--- The rows by name.
M.BY_NAME = {}
for _, row in ipairs(M.LIST) do M.BY_NAME[row.name] = row end

-- words  the options without "="
local function parse_part(options, part, words, catalogue)
  if words[part] then
    options[part] = true
  else
    attempt(options, part, options.row.parse or refuse, catalogue)
  end
end

--- Read the argument of -z.
-- text       "yapp,check,fault=0,motor.rate=9,filter=can.bus_id == 1, or so"
-- catalogue  compiled
-- returns    { what =, row = of LIST, filter = or nil,
--            json = true and other words of the row's options, if they were given,
--            statistics = LIST; number, at = of fault; folder, chosen = of csv; rules, junit = of
--            check; looks_for_faults = true if a rule is about faults; problems = list of texts,
--            each names its option }
function M.parse(text, catalogue)
  local head, filter = text:match("^(.-),%s*filter%s*=(.*)$") -- a display filter, commas and all
  local what, rest = (head or text):match("^yapp%s*,([^,]*)(.*)$")
  what = trim(what or "")
  local row = M.BY_NAME[what]
  local options = {
    what = what,
    row = row,
    statistics = M.LIST,
    filter = filter,
    rules = {},
    problems = {},
    line = "", -- in a file of rules "FILE:7: "
  }
  if not row then
    local _, names = find(M.LIST)
    options.problems[1] = ("%s: it is yapp,%s"):format(text, (names:gsub(", ", " or yapp,")))
    return options
  end
  local words = input.set((row.options:gsub("%w+=%w+", ""):gsub(",", "")))
  for part in rest:gmatch(",([^,]*)") do
    parse_part(options, trim(part), words, catalogue)
  end
  if row.finish then attempt(options, options.unused or what, row.finish, catalogue) end
  if filter and not filter:find("%S") then
    table.insert(options.problems, "filter=: the display filter is missing")
  end
  return options
end

return M
