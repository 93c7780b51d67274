-- SPDX-License-Identifier: GPL-2.0-or-later
-- The statistics, one row each; and the argument of -z yapp,...: options and rules.  The errors of
-- options, Wireshark's menus and their help, and the tests come from the rows.  Pure Lua.
--
-- A new statistic is a row here and its module.

local check = require "yapp.stat.check"
local csv = require "yapp.stat.csv"
local events = require "yapp.stat.events"
local field_kinds = require "yapp.message.field_kinds"
local input = require "yapp.base.input"
local joined = require "yapp.base.joined"
local kinds = require "yapp.stat.kinds"
local measures = require "yapp.stat.measures"
local summary = require "yapp.stat.summary"

local M = {}

local demand, decimal, find, trim = input.demand, input.decimal, input.find, input.trim

local RULES = table.concat(kinds.RULES, "=N, ") .. "=N"
for _, measure in ipairs(measures.LIST) do RULES = RULES .. ", " .. measure.text end
local NO_RULE = "no rule follows %s: it is for those behind it"
local RANGE = "a range is A..B, A.. or ..B"
local INFINITE = math.huge
local MAX_FILE = 2 ^ 20 -- bytes of a file of rules

-- Rules -------------------------------------------------------------------------------------------
--
-- Functions from here to the rows of the statistics raise errors.

-- Return a number that is not below 0; for a count one without a fraction.
local function parse_limit(text, what, is_count)
  local value = decimal(text)
  local is_good = value and value >= 0 and not (is_count and text:find("%D"))
  return demand(is_good and value, "%q is not a %s", text, what)
end

-- An end of a range, which may be left out.
local function parse_end(text, none)
  if text == "" then return none end
  return demand(decimal(text), RANGE)
end

-- Return the ends of A..B, A.. or ..B.
local function parse_range(text)
  local low, high = text:match("^(.-)%.%.(.*)$")
  demand(low and text ~= "..", RANGE)
  low, high = parse_end(low, -INFINITE), parse_end(high, INFINITE)
  demand(low <= high, "nothing lies in this range")
  return low, high
end

-- Set the limits of a rule by its measure.
local function set_limits(rule, value)
  local measure = rule.kind
  if measure.takes_range and (not measure.bound or value:find("..", 1, true)) then
    rule.low, rule.high = parse_range(value)
  else
    rule[measure.bound] = parse_limit(value, measure.name, measure.is_count)
  end
end

-- MESSAGE.FIELD=A..B and MESSAGE.FIELD.spread=X
local function add_field(rule, name, value)
  local message, start, suffix = rule.message, name:match("^(.*)%.(%l+)$")
  local plain = measures.OF_FIELD[1]
  rule.kind = suffix ~= plain.name and find(measures.OF_FIELD, suffix) or plain
  if rule.kind ~= plain then name = start end
  local field, names = find(joined(message.fields, message.generated), name)
  demand(field, "%s has no field %q, but %s", message.name, name, names)
  demand(not field_kinds.BY_NAME[field.kind].is_text,
    "%s.%s is a text, which has no range", message.name, field.name)
  demand(not (rule.source and rule.kind.scope == "capture"),
    "a %s is of all sources, not of one", rule.kind.name)
  if rule.kind.bound or rule.kind.takes_range then set_limits(rule, value) end
  rule.want = rule.kind.want and rule.kind.want(rule, field) or { field = field }
end

-- Return the name of a rule MESSAGE.NAME=..., and its measure, nil for a field.  A field of the
-- user's may have the name of a measure: then NAME.value is the field, NAME.messages the measure.
local function find_measure(message, name)
  local short, kind = name:match("^(.*)%.(%l+)$")
  if kind == "value" then return short end
  local measure = find(measures.OF_MESSAGE, short)
  if kind == "messages" and measure then return short, measure end
  measure = find(measures.OF_MESSAGE, name)
  demand(not measure or not find(joined(message.fields, message.generated), name),
    "%s has a field %s: write %s.value for it, %s.messages for the messages", message.name, name,
    name, name)
  return name, measure
end

-- "fault=0", "motor.rate=9.5", "motor.dc_voltage=40..55": { text, source,
--   kind       a row of kinds or of measures
--   low, high  the limits of the value to judge
--   message    compiled, of MESSAGE.
--   want       an entry of Groups:wants, nil for a rule about no field }
local function parse_rule(text, catalogue, source)
  local name, value = text:match("^([^=]*)=(.*)$")
  local kind = kinds.BY_NAME[name]
  local rule = { text = text, source = source, kind = kind, low = -INFINITE, high = INFINITE }
  if kind and not kind.counts_as then
    rule.high = parse_limit(value, "number of messages", true)
    return rule
  end
  local message_name, rest = (name or ""):match("^([^.]+)%.(.+)$")
  demand(message_name, "a rule is one of %s; options are %s, filter=EXPRESSION", RULES,
    M.BY_NAME.check.options)
  local message, names = find(catalogue.messages, message_name)
  rule.message = demand(message, "there is no message %q, but %s", message_name, names)
  rest, rule.kind = find_measure(message, rest)
  if rule.kind then set_limits(rule, value) else add_field(rule, rest, value) end
  return rule
end

-- Options -----------------------------------------------------------------------------------------

-- Call a function of a row of LIST.  If it raises a text, note it as a problem of this part.
local function attempt(options, part, call, catalogue)
  local ok, why = pcall(call, options, part, catalogue)
  if ok then return end
  if part == "" then part = "an empty option" end
  table.insert(options.problems, ("%s%s: %s"):format(options.line, part, why))
end

-- Return a part without the blanks around the first of these signs.
local function without_blanks(part, sign)
  local from, to = part:find(sign, 1, true)
  return from and trim(part:sub(1, from - 1)) .. sign .. trim(part:sub(to + 1)) or part
end

local parse_check

-- The rules of a file, one a line.  A # begins a comment, unless it stands in the name of a source.
local function read_rules(options, path, catalogue)
  demand(options.line == "", "a file of rules names no other")
  local file, problem = io.open(path, "rb")
  demand(file, "%s", problem)
  local text = file:read(MAX_FILE) or ""
  file:close()
  demand(#text < MAX_FILE, "the file is too long")
  local count, number_of_line = #options.rules + #options.problems, 0
  local source = options.source -- for the rules behind the file
  for line in (text:gsub("^\239\187\191", "") .. "\n"):gmatch("(.-)\r?\n") do
    number_of_line = number_of_line + 1
    local part = trim((" " .. line):gsub("%s#.*", ""))
    if not part:find("^source%s*=") then part = trim(part:gsub("#.*", "")) end
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
  part = without_blanks(without_blanks(part, "="), "..")
  local name, value = part:match("^(%w+)=(.*)$")
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
    table.insert(options.rules, parse_rule(part, catalogue, options.source))
    options.looks_for_faults = options.looks_for_faults or name == "fault"
    options.judges_unknown = options.judges_unknown or name == "unknown"
  end
end

local function finish_check(options, _, catalogue)
  local rules = options.rules
  if rules[1] or options.problems[1] then
    -- No rule can check a message that was not decoded.
    if not options.judges_unknown then
      rules[#rules + 1] = parse_rule("unknown=0", catalogue)
    end
    demand(not options.unused, NO_RULE, "it")
    return
  end
  options.looks_for_faults = true
  for _, kind in ipairs(kinds.RULES) do
    if not kinds.BY_NAME[kind].is_optional then
      local rule = parse_rule(kind .. "=0", catalogue, options.source)
      rule.is_default, rules[#rules + 1] = true, rule
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

-- The statistics ----------------------------------------------------------------------------------

-- name     behind -z yapp,
-- title    in menus
-- new      function(options, context), makes it: see stat.derive
-- columns  of output.columns
-- options  the words besides filter=EXPRESSION: M.parse knows the words without "=" by this text
-- parse    function(options, part, catalogue), reads other options; nil if there are none
-- finish   the same, checks all options at the end; nil for no check
-- help     its meaning, for people
-- ask      the question of a menu; the answer follows the name
-- file     the name of a new file that a menu suggests
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
    new = events.new,
    columns = events.COLUMNS.faults,
    options = "json",
    help = "when each fault rose and fell",
    looks_for_faults = true,
  },
  {
    name = "events",
    title = "Events",
    new = events.new,
    columns = events.COLUMNS.events,
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
}

--- The rows by name.
M.BY_NAME = {}
for _, row in ipairs(M.LIST) do M.BY_NAME[row.name] = row end

-- words  the options without "="
local function parse_part(options, part, words, catalogue)
  -- A message may have the name of an option: csv,-,all prints the message all.
  local is_message = options.folder == "-" and not options.chosen and
    find(catalogue.messages, part)
  if words[part] and not is_message then
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
--            statistics = LIST; folder, chosen = of csv; rules, junit = of check;
--            looks_for_faults = true if a rule is about faults; problems = list of texts, each
--            names its option }
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
