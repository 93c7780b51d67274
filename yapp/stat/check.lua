-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,check: rules that a capture must keep, the exit code of a gate, a test report for CI.
-- Pure Lua, 5.2 to 5.5.

local field_kinds = require "yapp.message.field_kinds"
local groups = require "yapp.stat.groups"
local joined = require "yapp.base.joined"
local judge = require "yapp.stat.judge"
local output = require "yapp.stat.output"
local rules = require "yapp.stat.rules"
local utf8 = require "yapp.base.utf8"

local M = {}

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
    help = "the value that is nearest to a limit, or farthest outside" },
  { "margin", type = "number",
    help = "how far it lies within the limit, in the field's unit; negative outside" },
  { "percent", type = "number", unit = "%", title = "%",
    help = "the margin in percent of the range, or of the only limit" },
  { "note", type = "text", help = "why, or what else to know" },
}
--- The columns, see output.columns.
M.COLUMNS = COLUMNS
--- The verdict `ok` of a row whose rule does not hold.
M.FAILED = FAILED

local NONE = "no message came that this rule applies to"
local CLOSE = 5 -- percent of the range: what held by less is marked
local BRIEF = "outside, but not for so long" -- of a rule with for=

local Check = groups.class { lists_problems = true }

--- See groups.class.
M.new = Check.new

--- Return the rules about the values of a message type.
function Check:wants(message_type)
  local list = {}
  for _, rule in ipairs(self.options.rules) do
    if rule.field and rule.message == message_type then list[#list + 1] = rule end
  end
  return list
end

function Check:new_values(rules_of_type)
  return judge.new(rules_of_type, self.spreads)
end

function Check:add_values(group, event, longest) -- luacheck: no self
  judge.add(group.values, event, longest)
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
local function reason_of(rule, group, ending, ok, is_exceeded)
  local kind, condition = rule.kind, rule.condition
  local needs_time = kind.needs_time or rule.hold > 0 or condition and condition.after > 0
  if needs_time and ending.lacks_times then
    return ending.lacks_times
  end
  if ending.unread and (kind.can_fall or not is_exceeded) then return ending.unread end
  if ok == FAILED then return nil end
  if kind.needs_past and group.is_unreliable then
    return "what came before its messages is not known: see -z yapp,events"
  end
  return ending.reason
end

local function add_row(self, row)
  self.counts[row.ok] = self.counts[row.ok] + 1
  table.insert(self.rows, row)
end

-- Note that a rule hardly held.
local function mark(row)
  local note = row.percent < 0 and BRIEF or "close to its limit"
  row.note = row.note and row.note .. ", " .. note or note
end

-- Set the margin of a row whose rule was judged: of numbers, not of counts and codes.
-- found  of a measure
local function set_margin(row, rule, found)
  row.worst = found and found.value
  if rule.kind.is_count or found and not field_kinds.is_number(rule.field) then return end
  local one = found or { value = row.seen, low = rule.low, high = rule.high }
  local range, margin = one.high - one.low, math.min(one.value - one.low, one.high - one.value)
  if range == math.huge then range = math.min(math.abs(one.low), math.abs(one.high)) end
  row.margin = tonumber(("%.12g"):format(margin))
  if range == 0 or range == math.huge then return end
  row.percent = tonumber(("%.3g"):format(margin / range * 100))
  if row.ok == OK and row.percent < CLOSE then mark(row) end
end

-- Return whether no later packet can mend a rule that failed.
local function is_final(kind)
  return not (kind.can_fall or kind.bound == "low")
end

-- Add the verdict on a rule.
-- seen ...  of a measure
local function add_verdict(self, rule, group, seen, frame, note, found)
  local shown = seen and tonumber(("%.12g"):format(seen)) -- 10, not 9.9999999999999982
  local ok = seen and shown >= rule.low and shown <= rule.high and OK or FAILED
  local is_exceeded = seen and shown > rule.high
  local reason = reason_of(rule, group, self.ending, ok, is_exceeded)
  if reason or not seen then ok = UNJUDGED end
  local row = output.row(group.source or { name = rule.source }, {
    ok = ok,
    rule = rule.text,
    limit = tonumber(rule.limit) or rule.limit,
    seen = seen,
    frame = frame,
    note = reason or note,
    is_final = is_final(rule.kind),
  })
  if ok ~= UNJUDGED then set_margin(row, rule, found) end
  add_row(self, row)
end

-- Add the rows of a rule: one for each of its sources, or one in all.
local function judge_rule(self, rule)
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
    add_verdict(self, rule, group, measure(group, rule, self))
  end
end

-- A report in JUnit's XML ------------------------------------------------------------------------

local ENTITIES = { ["<"] = "&lt;", [">"] = "&gt;", ["&"] = "&amp;", ['"'] = "&quot;" }
local REPORT = '<?xml version="1.0" encoding="UTF-8"?>\n<testsuite name="yapp.check" tests="%d" ' ..
  'failures="%d" errors="%d">\n%s</testsuite>\n'
local CASE = '  <testcase classname="yapp.check" name="%s">%s</testcase>\n'

-- XML allows no control characters, not even as entities.
local function escape(text)
  return (utf8.printable(text):gsub('[<>&"]', ENTITIES))
end

-- Return the element of a row.
local function case_of(row)
  local texts, name = {}, row.rule or row.note
  for _, key in ipairs { "bus", "id", "source" } do
    if row.id and row[key] then name = name .. " " .. output.text(row[key]) end
  end
  local keys = { "seen", "worst", "margin", "percent", "note", "frame" }
  if row.ok == OK and not row.margin then keys = { "note" } end
  for _, key in ipairs(keys) do
    if row[key] then texts[#texts + 1] = key .. " " .. output.text(row[key]) end
  end
  local text = texts[1] and row.ok.case:format(escape(table.concat(texts, ", "))) or ""
  return CASE:format(escape(name), text)
end

-- Write it if it is asked for; return an error, nil for none.
local function write_report(self)
  local path, cases, counts = self.options.junit, {}, self.counts
  if not path then return nil end
  for i, row in ipairs(self.rows) do cases[i] = case_of(row) end
  local all = table.concat(cases)
  return output.save(path, REPORT:format(#cases, counts[FAILED], counts[UNJUDGED], all))
end

-- The end ---------------------------------------------------------------------------------------

--- Judge all rules; return the rows.
function Check:judge(ending)
  self.ending, self.rows = ending, {}
  self.counts = { [FAILED] = 0, [UNJUDGED] = 0, [OK] = 0 }
  for _, rule in ipairs(self.options.rules) do judge_rule(self, rule) end
  return self.rows
end

--- End, see stat.answer.
-- returns  the exit code, and a text on errors other than rules, nil for none
function Check:finish(ending, notes)
  local options, context = self.options, self.context
  local problems = joined(ending.problems, options.problems)
  local judged = joined(self:judge(ending))
  local counts = self.counts
  for _, text in ipairs(problems) do add_row(self, { ok = UNJUDGED, note = text }) end
  local problem = write_report(self)
  if problem then
    table.insert(problems, "the report is not written: " .. problem)
    add_row(self, { ok = UNJUDGED, note = problems[#problems] })
  end
  local rows = options.json and judged or self.rows
  local verdict = counts[FAILED] > 0 and FAILED or counts[UNJUDGED] > 0 and UNJUDGED or OK
  if not options.json then
    output.sort(rows, function(row)
      return row.ok.order, row.ok == OK and row.percent or math.huge
    end)
  end
  output.print(context, "YAPP check: " .. verdict.title, COLUMNS, rows, notes)
  if not options.json then
    local shape = "\n%d of %d rules failed, %d not judged\n"
    context.out(shape:format(counts[FAILED], #rows, counts[UNJUDGED]))
  end
  return verdict.code, problems[1] and "check: " .. table.concat(problems, "\ncheck: ")
end

return M
