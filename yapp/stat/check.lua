-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,check: rules that a capture must keep, the exit code of a gate, a test report for CI.
-- Pure Lua, 5.2 to 5.5.
--
-- 0 every rule was judged and held, 20 one did not hold, 21 one could not be judged; both: 20.

local groups, output = require("yapp.stat.groups"), require("yapp.stat.output")
local tell, utf8 = require("yapp.stat.tell"), require("yapp.base.utf8")

local M = {}

local OK = { json = "true", text = "ok", code = 0 }
local FAILED = { json = "false", text = "FAILED", code = 20, case = "failure" }
local UNJUDGED = { json = "null", text = "NOT JUDGED", code = 21, case = "error" }
local TITLES = {
  [OK.code] = "all rules hold",
  [FAILED.code] = "FAILED",
  [UNJUDGED.code] = "not all of it could be judged",
}
local KEYS = output.words("ok rule bus id source message frame seen limit worst note")

local Check = groups.class { compares = true }

--- See groups.class; its context has, too, problems = function() -> texts: why what comes of it
-- cannot be trusted, and named = function() -> list of the sources that the user named, see
-- message.sources.
M.new = Check.new

--- The rules about values.
function Check:wants(message)
  local list = {}
  for _, rule in ipairs(self.options.rules) do
    if rule.field and rule.message == message then
      list[#list + 1] = rule
    end
  end
  return list
end

-- Judging ---------------------------------------------------------------------------------------

local function is_its(rule, source)
  return not rule.source or source.name == rule.source
end

-- Whether a rule that is about nothing that came holds all the same: a message of its source came.
-- Nil where it does not.
local function holds_of_none(self, rule)
  local kind = tell.KINDS[rule.kind]
  if not (kind and kind.is_rare or rule.is_default) then
    return nil
  end
  for _, group in ipairs(self.list) do
    local has_come = group.count > 0 or group.counts.crc
    if has_come and is_its(rule, group.source) then
      return true
    end
  end
end

-- Of a source: what is seen, in which frame, whether that is well, nil where it cannot be judged;
-- of a range the worst value and a note.
local of_source = {}

function of_source.count(rule, group)
  return group.count, group.last_frame, group.count >= rule.limit
end

function of_source.rate(rule, group)
  local rate = groups.pace(group) or group.count == 1 and 0 or nil
  return rate, group.last_frame, rate and rate >= rule.limit
end

function of_source.gap(rule, group, last)
  if group.count == 0 then return end
  local gap, frame = group.gap_max or 0, group.gap_max_frame
  local to_end = last and tell.span(group.last, last.rel) or 0
  if to_end > gap then gap, frame = to_end, nil end
  return gap, frame or group.last_frame, gap <= rule.limit
end

function of_source.range(rule, group)
  local values = group.values[rule]
  if values.seen == 0 then return end
  local note = ("of %d values"):format(values.seen)
  return values.outside, values.frame, values.outside == 0, values.worst, note
end

-- How many events of a kind there are.
local function count_events(rule, group)
  local seen, frame = groups.seen(group, rule.kind)
  local is_well = seen <= rule.limit
  local is_known = group.count > 0 and not (is_well and group.is_unsure)
  if tell.KINDS[rule.kind].needs_past and not is_known then
    is_well = nil
  end
  return seen, frame, is_well
end

-- The same of all sources.
local of_all = {}

-- Of the sources that the user named with a message those that never came.
function of_all.absent(self, rule)
  local names, ok = {}, holds_of_none(self, rule)
  for _, row in ipairs(self.absent) do
    if is_its(rule, row) then
      names[#names + 1] = output.who(row)
    end
  end
  for _, row in ipairs(self.context.named()) do
    if row.message and is_its(rule, row) then
      ok = #names <= rule.limit
    end
  end
  return #names, nil, ok, nil, table.concat(names, ", ")
end

function of_all.spread(self, rule)
  local spread = self.spreads[rule]
  if not (spread and spread.worst) then return end
  return spread.worst, spread.frame, spread.worst <= rule.limit
end

-- Whether a rule is about a source.
local function is_about(rule, group)
  local kind, message = tell.KINDS[rule.kind], group.message
  if not is_its(rule, group.source) then return false end
  if not kind then return message == rule.message end
  if kind.is_rare then
    return group.counts[rule.kind] ~= nil
  end
  if not kind.about then return group.source.id ~= nil end
  local has = message and message[kind.about]
  return has and (type(has) ~= "table" or next(has) ~= nil)
end

-- Adds a row; the exit code follows from all of them.
-- group  nil for all sources
local function add_row(self, rule, group, seen, frame, is_well, worst, note)
  local ok = is_well and OK or FAILED
  if is_well == nil then
    local is_unsure = group and group.is_unsure
    ok, note = UNJUDGED, is_unsure and "what came before is not known" or "nothing to judge it by"
  end
  if ok == FAILED or self.code == OK.code then
    self.code = ok.code
  end
  local row = output.row(group and group.source or { name = rule.source }, {
    ok = ok,
    rule = rule.text,
    seen = seen,
    limit = { json = output.value(rule.limit or rule.text:match("=(.*)$")) },
    frame = frame,
    worst = worst,
    note = note,
  })
  table.insert(self.rows, row)
end

-- Adds the rows of a rule: one for each source that it is about, or one in all.
local function judge(self, rule, last)
  local measure, is_about_any = of_all[rule.kind], false
  if measure then
    return add_row(self, rule, nil, measure(self, rule))
  end
  measure = of_source[rule.kind] or count_events
  for _, group in ipairs(self:sorted()) do
    if is_about(rule, group) then
      is_about_any = true
      add_row(self, rule, group, measure(rule, group, last))
    end
  end
  if is_about_any then return end
  local ok = holds_of_none(self, rule)
  add_row(self, rule, nil, ok and 0, nil, ok)
end

-- A report in JUnit's XML ------------------------------------------------------------------------

local ENTITIES = { ["<"] = "&lt;", [">"] = "&gt;", ["&"] = "&amp;", ['"'] = "&quot;" }
local REPORT = '<?xml version="1.0" encoding="UTF-8"?>\n<testsuite name="yapp.check" tests="%d" ' ..
  'failures="%d" errors="%d">\n%s</testsuite>\n'
local NAME, MESSAGE = output.words("rule bus id source"), output.words("seen worst note frame")

-- XML has no control characters, not even as entities.
local function escape(text)
  return (utf8.printable(text):gsub('[<>&"]', ENTITIES))
end

-- kind  "failure" or "error", with a text; nil where all is well
local function case_of(name, kind, text)
  local case = ('  <testcase classname="yapp.check" name="%s"'):format(escape(name))
  if not kind then return case .. "/>\n" end
  return ('%s><%s message="%s"/></testcase>\n'):format(case, kind, escape(text))
end

-- "seen 1, frame 7": what a row has of these, as people read it.
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

-- Writes it; returns what went wrong, nil for nothing.
local function report(path, rows, problems)
  local cases, counts = {}, { failure = 0, error = #problems }
  for i, row in ipairs(rows) do
    local kind = row.ok.case
    local name = row.id and texts_of(row, NAME, false, " ") or row.rule
    if kind then counts[kind] = counts[kind] + 1 end
    cases[i] = case_of(name, kind, texts_of(row, MESSAGE, true, ", "))
  end
  for _, problem in ipairs(problems) do
    cases[#cases + 1] = case_of(problem, "error", problem)
  end
  local text = REPORT:format(#cases, counts.failure, counts.error, table.concat(cases))
  return output.save(path, text)
end

-- The end ---------------------------------------------------------------------------------------

--- last     { rel =, ... } of the last packet of any kind; nil where there was none
-- returns  the exit code, and a text that says why where the table does not, nil for nothing
function Check:finish(last)
  local options, problems = self.options, self.context.problems()
  self.rows, self.code = {}, OK.code
  for _, rule in ipairs(options.rules) do
    judge(self, rule, last)
  end
  for _, problem in ipairs(options.problems) do
    problems[#problems + 1] = problem
  end
  local problem = options.junit and report(options.junit, self.rows, problems)
  if problem then
    problems[#problems + 1] = "the report is not written: " .. problem
  end
  if self.code == OK.code and problems[1] then
    self.code = UNJUDGED.code
  end
  output.print(self.context, "YAPP check: " .. TITLES[self.code], KEYS, self.rows)
  return self.code, problems[1] and "check: " .. table.concat(problems, "\ncheck: ") or nil
end

return M
