-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,check: rules that a capture must keep, the exit code of a gate, a test report for CI.
-- Pure Lua, 5.2 to 5.5.

local groups = require "yapp.stat.groups"
local joined = require "yapp.base.joined"
local output = require "yapp.stat.output"
local rules = require "yapp.stat.rules"
local utf8 = require "yapp.base.utf8"

local M = {}

local words = output.words
-- Verdicts; order = theirs in the text, case = the element of a report in XML.
local FAILED = {
  order = 1,
  json = "false",
  text = "FAILED",
  title = "FAILED",
  case = '<failure message="%s"/>',
  code = output.EXIT_FAILED,
}
local UNJUDGED = {
  order = 2,
  json = "null",
  text = "NOT JUDGED",
  title = "not all of it could be judged",
  case = '<error message="%s"/>',
  code = output.EXIT_UNDECIDED,
}
local OK = {
  order = 3,
  json = "true",
  text = "ok",
  title = "all rules hold",
  case = "<system-out>%s</system-out>",
  code = output.EXIT_OK,
}
local COLUMNS = output.columns {
  { "ok", type = "boolean", title = "check",
    help = "whether the rule holds; null if it could not be judged" },
  { "rule", type = "string", help = "the rule" },
  { "who" },
  { "bus" },
  { "id" },
  { "source" },
  { "message" },
  { "frame" },
  { "seen", type = "number", help = "what was seen" },
  { "limit", type = "text", where = "json", help = "a number, or a text such as `9..11`" },
  { "worst", type = "number",
    help = "the value that is farthest outside" },
  { "note", type = "text", help = "why, or what else to know" },
}
--- The columns, see output.columns.
M.COLUMNS = COLUMNS

local NONE = "no message came that this rule applies to"

local Check = groups.class { lists_problems = true }

--- See groups.class.
M.new = Check.new

--- Return the values of a message type that rules are about.
function Check:wants(message_type)
  local list = {}
  for _, rule in ipairs(self.options.rules) do
    if rule.field and rule.message == message_type then list[#list + 1] = rule end
  end
  return list
end

-- Judging -----------------------------------------------------------------------------------------

-- Return whether a rule is about a source.
local function is_about(rule, group)
  local kind, message_type = rule.kind, group.type
  if not rules.is_of(rule, group.source) then return false end
  if rule.message then return message_type == rule.message end
  if kind.scope == "rare" then return groups.count(group, kind.name).seen > 0 end
  if not kind.about then return group.source.id ~= nil end
  local has = message_type and message_type[kind.about]
  return has and (type(has) ~= "table" or next(has) ~= nil)
end

-- As a measure: judge a rule that no group is about.  A default rule, or one of rare events, holds
-- if a message of its source came.
local function measure_none(_, rule, check)
  local message, source, is_rare = rule.message, rule.source, rule.kind.scope == "rare"
  if rule.is_default or is_rare then
    for _, group in ipairs(check.list) do
      local has_come = group.count > 0 or groups.count(group, "crc").seen > 0
      local is_seen = has_come and rules.is_of(rule, group.source)
      if is_seen then return 0, nil, not is_rare and NONE end
    end
  end
  local why = NONE
  if message then why = ("no %s came: see yapp.%s_ids"):format(message.title, message.name) end
  if source then why = ("no message of a source that yapp.sources calls %s came"):format(source) end
  return nil, nil, check.ending.reason or why
end

-- Why a rule cannot be judged, whatever was seen; nil for no reason.
-- ok           FAILED if it does not seem to hold
-- is_exceeded  true if the value is above the limit
local function reason_of(kind, group, ending, ok, is_exceeded)
  if kind.needs_time and ending.lacks_times then
    return ending.lacks_times
  end
  if ending.unread and (kind.can_fall or not is_exceeded) then return ending.unread end
  if ok == FAILED then return nil end
  if kind.needs_past and group.is_unreliable then
    return "what came before its messages is not known: see -z yapp,events"
  end
  return ending.reason
end

-- Add the row of a rule.
-- seen ...  of a measure
local function add_row(self, rule, group, seen, frame, note, worst)
  local shown = seen and tonumber(("%.12g"):format(seen)) -- 10, not 9.9999999999999982
  local ok = seen and shown >= rule.low and shown <= rule.high and OK or FAILED
  local is_exceeded = seen and shown > rule.high
  local reason = reason_of(rule.kind, group, self.ending, ok, is_exceeded)
  local limit = rule.text:match("=(.*)$")
  if reason or not seen then ok = UNJUDGED end
  self.counts[ok] = self.counts[ok] + 1
  self.rows[#self.rows + 1] = output.row(group.source or { name = rule.source }, {
    ok = ok,
    rule = rule.text,
    limit = tonumber(limit) or limit,
    seen = seen,
    frame = frame,
    note = reason or note,
    worst = worst,
  })
end

-- Add the rows of a rule: one for each of its sources, or one in all.
local function judge(self, rule)
  local measure, about = rules.measure, {}
  if rule.kind.scope == "capture" then
    about[1] = self.capture
  else
    for _, group in ipairs(self:sort()) do
      if is_about(rule, group) then about[#about + 1] = group end
    end
  end
  if not about[1] then measure, about[1] = measure_none, self.capture end
  for _, group in ipairs(about) do
    add_row(self, rule, group, measure(group, rule, self))
  end
end

-- A report in JUnit's XML ------------------------------------------------------------------------

local ENTITIES = { ["<"] = "&lt;", [">"] = "&gt;", ["&"] = "&amp;", ['"'] = "&quot;" }
local REPORT = '<?xml version="1.0" encoding="UTF-8"?>\n<testsuite name="yapp.check" tests="%d" ' ..
  'failures="%d" errors="%d">\n%s</testsuite>\n'
local NAME, MESSAGE = words("rule bus id source"), words("seen worst note frame")
local NOTE = words("note")

-- XML allows no control characters, not even as entities.
local function escape(text)
  return (utf8.printable(text):gsub('[<>&"]', ENTITIES))
end

-- shape  of the element of a verdict with a text; nil for a rule that holds and has no note
local function case_of(name, shape, text)
  local case = ('  <testcase classname="yapp.check" name="%s"'):format(escape(name))
  if text == "" then return case .. "/>\n" end
  return ("%s>%s</testcase>\n"):format(case, shape:format(escape(text)))
end

-- Return the values that a row has of these keys, as people read them: "seen 1, frame 7".
local function texts_of(row, keys, with_key, between)
  local texts = {}
  for _, key in ipairs(keys) do
    local name = with_key and key .. " " or ""
    if row[key] then
      texts[#texts + 1] = name .. output.text(row[key])
    end
  end
  return table.concat(texts, between)
end

-- Write it if it is asked for; return an error, nil for none.
local function write_report(self, problems)
  local path, cases, counts = self.options.junit, {}, self.counts
  if not path then return nil end
  for i, row in ipairs(self.rows) do
    local name = row.id and texts_of(row, NAME, false, " ") or row.rule
    local keys = row.ok == OK and NOTE or MESSAGE
    cases[i] = case_of(name, row.ok.case, texts_of(row, keys, true, ", "))
  end
  for _, problem in ipairs(problems) do
    cases[#cases + 1] = case_of(problem, UNJUDGED.case, problem)
  end
  local errors, all = counts[UNJUDGED] + #problems, table.concat(cases)
  return output.save(path, REPORT:format(#cases, counts[FAILED], errors, all))
end

-- The end ---------------------------------------------------------------------------------------

--- End, see stat.answer.
-- returns  the exit code, and a text on errors other than rules, nil for none
function Check:finish(ending, notes)
  local options, context, rows = self.options, self.context, {}
  local problems = joined(ending.problems, options.problems)
  self.ending, self.rows = ending, rows
  self.counts = { [FAILED] = 0, [UNJUDGED] = 0, [OK] = 0 }
  for _, rule in ipairs(options.rules) do
    judge(self, rule)
  end
  local problem = write_report(self, problems)
  if problem then
    problems[#problems + 1] = "the report is not written: " .. problem
  end
  local failed, unjudged = self.counts[FAILED], self.counts[UNJUDGED] + #problems
  local verdict = failed > 0 and FAILED or unjudged > 0 and UNJUDGED or OK
  if not options.json then
    for _, text in ipairs(problems) do rows[#rows + 1] = { ok = UNJUDGED, note = text } end
    output.sort(rows, function(row) return row.ok.order end)
  end
  output.print(context, "YAPP check: " .. verdict.title, COLUMNS, rows, notes)
  if not options.json then
    context.out(("\n%d of %d rules failed, %d not judged\n"):format(failed, #rows, unjudged))
  end
  return verdict.code, problems[1] and "check: " .. table.concat(problems, "\ncheck: ")
end

return M
