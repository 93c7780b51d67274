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

local choose, demand, find, trim = input.choose, input.demand, input.find, input.trim

-- Options -----------------------------------------------------------------------------------------
--
-- Functions from here to the rows of the statistics raise errors.

local function read_integer(value)
  return tonumber(value:match("^[1-9]%d*$"))
end

local read_rules

-- Return the value of an option: of junit=FILE a text, of bitrate=BITS a number, of json or
-- stop=fault what stands there; nil or false for another one.
-- shape  what the row of the statistic has behind the name
local function read_value(shape, value)
  if shape == "NUMBER" or shape == "BITS" then return read_integer(value) end
  if shape == "FILE" or shape == "NAME" then return value end
  return shape == value and (value == "" or value)
end

-- The rules that follow are about one source.
local function name_source(options, name)
  options.source, options.waiting[name] = name, true
end

-- Read an option that the row of the statistic names, or what only this statistic reads.
local function read_option(options, part)
  local row, name, value = options.row, part:match("^(%l+)%s*=%s*(.*)$")
  for word, shape in row.options:gmatch("(%l+)=?(%w*)") do
    local found = word == (name or part) and read_value(shape, value or "")
    if found and word == "rules" then return read_rules(options, found) end
    if found and word == "source" then return name_source(options, found) end
    if found then
      options[word] = found
      return
    end
  end
  demand(row.parse and row.parse(options, part),
    "the options of %s are %s, filter=EXPRESSION", row.name, row.options)
end

-- Call a function of a part of the argument, or of a line.  If it raises a text, note it as a
-- problem of this part.
-- place  "FILE:7: " of a line, else ""
local function attempt(options, call, part, place)
  local ok, why = pcall(call, options, part)
  if not ok then table.insert(options.problems, ("%s%s: %s"):format(place, part, why)) end
end

local function add_rule(options, text)
  local rule = rules_of.parse(text, options)
  table.insert(options.rules, rule)
  options.rules[rule.name] = rule
  options.waiting[options.source or false] = nil
  return rule
end

local function read_line(options, text)
  local source = text:match("^source%s*=%s*(.+)$")
  if not source then return add_rule(options, text) end
  name_source(options, source)
end

-- The rules of a file, one a line.  A # behind a blank begins a comment.
function read_rules(options, path)
  local file, problem = io.open(path, "rb")
  demand(file, "%s", problem)
  local source, number, count = options.source, 0, #options.rules + #options.problems
  for line in file:lines() do
    number = number + 1
    local part = trim((" " .. line:gsub("^\239\187\191", " ")):gsub("%s#.*", ""))
    if part ~= "" then attempt(options, read_line, part, ("%s:%d: "):format(path, number)) end
  end
  file:close()
  options.source = source -- for the rules behind the file
  demand(#options.rules + #options.problems > count, "there is no rule in it")
end

local function finish_check(options)
  local rules = options.rules
  if rules[1] or options.problems[1] then
    options.source = nil
    -- No rule can check a message that was not decoded.
    if not rules.unknown then add_rule(options, "unknown=0") end
  else
    for _, kind in ipairs(kinds.RULES) do
      if not kind.is_optional then add_rule(options, kind.name .. "=0").is_default = true end
    end
  end
  local name = next(options.waiting)
  demand(not name, "no rule follows source=%s", name)
end

local function parse_csv(options, part)
  if not options.folder then
    options.folder = part
  elseif options.folder == "-" and not options.chosen then
    options.chosen = choose(options.catalogue.messages, part, "message")
  else
    return false
  end
  return true
end

local function finish_csv(options)
  demand(options.chosen or (options.folder or "-") ~= "-", "it is csv,FOLDER or csv,-,MESSAGE")
end

local function parse_fault(options, part)
  options.number = read_integer(part)
  return options.number
end

local function finish_watch(options)
  demand(options.stop ~= "rule" or options.rules[1], "stop=rule is about rules=FILE")
end

-- The statistics ----------------------------------------------------------------------------------

-- name     behind -z yapp,
-- module   has new(options, context), which makes it: see stat.answer; COLUMNS of output.columns,
--          or these by name
-- title    in menus
-- options  besides filter=EXPRESSION: read_option knows them by this text
-- help     its meaning, for people
-- parse    function(options, part), reads other parts; returns whether it did
-- finish   the same, checks all options at the end; nil for no check
-- ask      the question of a menu; the answer follows the name
-- file     the name of a new file that a menu suggests
-- is_live  true if it shows packets while they come, in tshark alone
-- table_only  true if its output has no room for notes
-- looks_for_faults  true if it must say which messages may hide a fault, as it does not list them
local COMPARE = { new = summary.compare, COLUMNS = summary.COMPARED }
M.LIST = input.rows("name module title options help", {
  { "summary", summary, "Summary", "json, brief",
    "of each controller: rate, gaps, losses, its values" },
  { "faults", lists, "Faults", "json", "when each fault rose and fell", looks_for_faults = true },
  {
    "fault",
    fault,
    "Fault",
    "json, frame=NUMBER",
    "the card of one fault: what changed before it",
    parse = parse_fault,
    ask = "Number of the fault, or frame=NUMBER (empty: the first)",
    looks_for_faults = true,
  },
  { "events", lists, "Events", "json", "these, reboots, silences, bad CRCs, losses, in order" },
  { "compare", COMPARE, "Compare", "json", "the values of all controllers beside each other" },
  {
    "buses",
    buses,
    "CAN buses",
    "json, bitrate=BITS",
    "of each CAN bus: frames, error frames, load",
  },
  {
    "csv",
    csv,
    "Export tables",
    "replace, all, json",
    "a CSV for each message, in a new folder",
    parse = parse_csv,
    finish = finish_csv,
    ask = "New folder",
    file = "tables",
    table_only = true,
  },
  {
    "check",
    check,
    "Check",
    "json, junit=FILE, source=NAME, rules=FILE",
    "whether all is well, or rules hold",
    parse = add_rule,
    finish = finish_check,
    ask = "Rules (empty: check everything)",
  },
  {
    "watch",
    watch,
    "Watch",
    "json, rules=FILE, stop=fault, stop=rule, bitrate=BITS",
    "the controllers, once a second while packets come",
    finish = finish_watch,
    looks_for_faults = true,
    is_live = true,
  },
})

--- The rows with a menu, and all rows by name.
M.MENUS, M.BY_NAME = {}, {}
for _, row in ipairs(M.LIST) do
  local columns = row.module.COLUMNS
  row.new, row.columns = row.module.new, columns[row.name] or columns
  M.BY_NAME[row.name] = row
  if not row.is_live then M.MENUS[#M.MENUS + 1] = row end
end

--- Read the argument of -z.
-- text       "yapp,check,fault=0,motor.rate=9,filter=can.bus_id == 1, or so"
-- catalogue  compiled
-- returns    { row = of LIST, nil if there is none; what = its name; filter = or nil; the options
--            that it names, as json = true; rules = list, and by name; folder, chosen = of csv;
--            number = of fault; statistics = LIST; problems = list of texts; waiting = set of the
--            names of sources that no rule follows yet }
function M.parse(text, catalogue)
  local head, filter = text:match("^(.-),%s*filter%s*=(.*)$") -- a display filter, commas and all
  local what, rest = (head or text):match("^yapp%s*,([^,]*)(.*)$")
  local row, names = find(M.LIST, trim(what or ""))
  local options = { row = row, statistics = M.LIST, filter = filter, rules = {}, problems = {},
    waiting = {} }
  if not row then
    options.problems[1] = ("%s: no such statistic; known: %s"):format(text, names)
    return options
  end
  options.what, options.catalogue = row.name, catalogue
  for part in rest:gmatch("[^,]+") do attempt(options, read_option, trim(part), "") end
  if row.finish then attempt(options, row.finish, row.name, "") end
  return options
end

return M
