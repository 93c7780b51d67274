-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,check: rules that a capture must keep, the exit code of a gate, a test report for CI.
-- Pure Lua, 5.2 to 5.5.

local field_kinds = require "yapp.message.field_kinds"
local groups = require "yapp.stat.groups"
local input = require "yapp.base.input"
local joined = require "yapp.base.joined"
local judge = require "yapp.stat.judge"
local mapped = require "yapp.base.mapped"
local output = require "yapp.stat.output"
local rules = require "yapp.stat.rules"
local utf8 = require "yapp.base.utf8"

local M = groups.class { new_values = judge.new, add_values = judge.add, lists_problems = true }

local unpack = rawget(table, "unpack")

-- Verdicts, in the order of the text; case = the element of a report in XML.
local FAILED, UNJUDGED, OK = unpack(input.rows("order json text title code case", {
  { 1, "false", "FAILED", "FAILED", output.EXIT_FAILED, '<failure message="%s"/>' },
  {
    2,
    "null",
    "NOT JUDGED",
    "not all of it could be judged",
    output.EXIT_UNDECIDED,
    '<error message="%s"/>',
  },
  { 3, "true", "ok", "all rules hold", output.EXIT_OK, "<system-out>%s</system-out>" },
}))
--- The columns, see output.columns.
M.COLUMNS = output.columns({
  { "ok", "boolean", "whether the rule holds; null if it could not be judged", title = "check" },
  { "rule", "string", "the rule" },
  "bus id source message frame",
  { "seen", "number", "what was seen" },
  { "limit", "text", "a number, or a text such as `9..11`" },
  { "worst", "number", "the value that is nearest to a limit, or farthest outside" },
  { "margin", "number", "how far it lies within the limit, in the field's unit; negative outside" },
  {
    "percent",
    "number",
    "the margin in percent of the range, or of the only limit",
    unit = "%",
    title = "%",
  },
  { "note", "text", "why, or what else to know" },
}, "ok rule bus id source message frame seen worst margin percent note",
  "ok rule who message seen worst margin percent note")
--- The verdict `ok` of a row whose rule does not hold.
M.FAILED = FAILED

local TOO_FEW = "too few good messages, values that are not reserved, or other sources: see " ..
  "yapp.sources and the preferences of IDs"
local END_UNKNOWN = "time stamps went back several times: who is silent at the end is not known"
local CLOSE = 5 -- percent of the range: what held by less is marked

-- Judging -----------------------------------------------------------------------------------------

-- Return whether a rule is about a source.
local function is_about(rule, group)
  local kind, message_type = rule.kind, group.type
  if not rules.is_of(rule, group.source) then return false end
  if rule.message then return message_type == rule.message end
  if kind.scope == "rare" then return group.counts[kind.name].seen > 0 end
  if not kind.about then return group.source.id ~= nil end
  local has = message_type and message_type[kind.about]
  return has and (type(has) ~= "table" or next(has))
end

-- As a measure: judge a rule that no group is about.  A default rule, or one of rare events, holds
-- if a message of its source came.
local function measure_none(_, rule, check)
  local is_rare = rule.kind.scope == "rare"
  for _, group in ipairs(check.list) do
    local has_come = group.count > 0 and rules.is_of(rule, group.source)
    if has_come and (rule.is_default or is_rare) then
      return 0, nil, not is_rare and "no message came that this rule applies to"
    end
  end
end

-- Set the margin of a row whose rule was judged: of numbers, not of counts and codes.
-- found  of a measure
local function set_margin(row, rule, found)
  row.worst = found and found.value
  if rule.kind.is_count or found and not field_kinds.is_number(rule.field) then return end
  found = found or { value = row.seen, low = rule.low, high = rule.high }
  local percent, margin = judge.margin(found)
  row.margin, row.percent = groups.clean(margin), percent
  if row.ok ~= OK or not percent or percent >= CLOSE then return end
  local mark = percent < 0 and "outside, but not for so long" or "close to its limit"
  row.note = row.note and row.note .. ", " .. mark or mark
end

-- Return why a rule cannot be judged, whatever was seen; nil for no reason.
-- is_final  true if it does not hold, and no later packet can mend it
local function reason_of(rule, group, ending, verdict, is_final)
  if rule.needs_time and ending.lacks_times then return ending.lacks_times end
  if ending.unread and not is_final then return ending.unread end
  if verdict == FAILED then return nil end
  if rule.kind.sees_end and ending.hides_end then return END_UNKNOWN end
  if rule.kind.needs_past and group.is_unreliable then
    return "what came before its messages is not known: see -z yapp,events"
  end
  return ending.reason
end

local function verdict_of(rule, seen)
  if not seen then return UNJUDGED end
  local shown = groups.clean(seen)
  return shown >= rule.low and shown <= rule.high and OK or FAILED
end

-- Return the row with the verdict on a rule.
-- seen ...  of a measure
local function judge_group(rule, group, ending, seen, frame, note, found)
  local verdict = verdict_of(rule, seen)
  local is_final = verdict == FAILED and not rule.kind.can_mend
  local reason = reason_of(rule, group, ending, verdict, is_final)
  local row = output.row(group.source or { name = rule.source }, {
    ok = reason and UNJUDGED or verdict,
    rule = rule.text,
    limit = tonumber(rule.limit) or rule.limit,
    seen = seen,
    frame = frame,
    note = reason or note or not seen and TOO_FEW .. rule.condition,
    is_final = is_final,
  })
  if row.ok ~= UNJUDGED then set_margin(row, rule, found) end
  return row
end

--- Judge all rules; return the rows: of each rule one for each of its sources, or one in all.
function M:judge(ending)
  local rows, sorted = {}, self:sort()
  self.ending = ending
  for _, rule in ipairs(self.options.rules) do
    local measure, about = rule.measure, { self.capture }
    if rule.kind.scope ~= "capture" then
      about = mapped(sorted, function(group) return is_about(rule, group) and group end)
    end
    if not about[1] then measure, about[1] = measure_none, self.capture end
    for _, group in ipairs(about) do
      rows[#rows + 1] = judge_group(rule, group, ending, measure(group, rule, self))
    end
  end
  return rows
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
  local name = row.rule or row.note
  for _, key in ipairs { "bus", "id", "source" } do
    if row[key] then name = name .. " " .. output.text(row[key]) end
  end
  local texts = mapped({ "seen", "worst", "margin", "percent", "note", "frame" }, function(key)
    return row[key] and key .. " " .. output.text(row[key])
  end)
  return CASE:format(escape(name), row.ok.case:format(escape(table.concat(texts, ", "))))
end

-- Return how many rows have a verdict.
local function count(rows, verdict)
  return #mapped(rows, function(row) return row.ok == verdict end)
end

-- Write it; return an error, nil for none.
local function write_report(path, rows)
  local file, problem = output.create(path)
  if not file then return problem end
  local cases = table.concat(mapped(rows, case_of))
  file:write(REPORT:format(#rows, count(rows, FAILED), count(rows, UNJUDGED), cases))
  return output.close_files { file }
end

-- The end ---------------------------------------------------------------------------------------

--- End, see stat.answer.
-- returns  the exit code, and a text on errors other than rules, nil for none
function M:finish(ending, notes)
  local options, context, judged = self.options, self.context, self:judge(ending)
  local rows, problems = joined(judged), joined(ending.problems, options.problems)
  for _, text in ipairs(problems) do rows[#rows + 1] = { ok = UNJUDGED, note = text } end
  local problem = options.junit and write_report(options.junit, rows)
  if problem then
    problems[#problems + 1] = "the report is not written: " .. problem
    rows[#rows + 1] = { ok = UNJUDGED, note = problems[#problems] }
  end
  output.sort(rows, function(row)
    return row.ok.order, row.ok == OK and row.percent or math.huge
  end)
  local worst, shown = rows[1].ok, options.json and judged or rows
  output.print(context, "YAPP check: " .. worst.title, M.COLUMNS, shown, notes)
  if not options.json then
    context.out(("\n%d of %d rules failed, %d not judged\n"):format(
      count(rows, FAILED), #rows, count(rows, UNJUDGED)))
  end
  return worst.code, problems[1] and "check: " .. table.concat(problems, "\ncheck: ")
end

return M
