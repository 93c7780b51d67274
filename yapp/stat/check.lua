-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,check: rules that a capture must keep, the exit code of a gate, a test report for CI.
-- Pure Lua, 5.2 to 5.5.
--
-- 0 every rule was judged and held, 20 one did not hold, 21 one could not be judged; both: 20.

local groups, output = require("yapp.stat.groups"), require("yapp.stat.output")
local tell = require("yapp.stat.tell")

local M = {}

local FAILED, UNJUDGED = 20, 21
local VERDICTS = { [0] = "all rules hold", [FAILED] = "FAILED",
  [UNJUDGED] = "not all of it could be judged" }
local KEYS = output.words("ok rule bus id source message frame seen limit worst note")

local Check = {}
Check.__index = Check

--- options  { rules, problems = texts, junit = path or nil } of stat.options
-- context  { late = function() -> periods, problems = function() -> texts: why what comes of it
--          cannot be trusted, named = function() -> list of the sources that the user named, see
--          message.sources, and what output.print takes }
function M.new(options, context)
  local function rules_of(kind)
    return function(message)
      local list = {}
      for _, rule in ipairs(options.rules) do
        if rule.kind == kind and rule.message == message then
          list[#list + 1] = rule
        end
      end
      return list
    end
  end
  local gathered = groups.new(rules_of("range"), rules_of("spread"), context.late)
  return setmetatable({
    options = options,
    context = context,
    groups = gathered,
    absent = {},
  }, Check)
end

function Check:event(event)
  if event.kind == "absent" then
    self.absent[#self.absent + 1] = event.source
  end
  self.groups:event(event)
end

function Check:message(record) self.groups:message(record) end

-- Judging ---------------------------------------------------------------------------------------

-- Of a source: what is seen, in which frame, whether that is well, nil where it cannot be judged;
-- of a range the worst value and a note.
local measure = {}

function measure.count(rule, group)
  return group.count, group.last_frame, group.count >= rule.limit
end

function measure.rate(rule, group)
  local rate = groups.rate(group) or group.count == 1 and 0 or nil
  return rate, group.last_frame, rate and rate >= rule.limit
end

function measure.gap(rule, group, last)
  if group.count == 0 then return end
  local gap, frame = group.gap_max or 0, group.gap_max_frame
  local to_end = last and tell.span(group.last, last.rel) or 0
  if to_end > gap then gap, frame = to_end, nil end
  return gap, frame or group.last_frame, gap <= rule.limit
end

function measure.range(rule, group)
  for _, values in ipairs(group.values) do
    if values.want == rule and values.seen > 0 then
      local note = ("of %d values"):format(values.seen)
      return values.outside, values.frame, values.outside == 0, values.worst, note
    end
  end
end

-- How many events of a kind there are.
local function count_events(rule, group)
  local seen, frame = groups.seen(group, rule.kind)
  local is_well = seen <= rule.limit
  local needs_past = tell.KINDS[rule.kind].needs_past
  if needs_past and (group.count == 0 or is_well and group.is_unsure) then
    is_well = nil
  end
  return seen, frame, is_well
end

local function is_its(rule, source)
  return not rule.source or source.name == rule.source
end

-- Whether a rule is about a source.
local function is_about(rule, group)
  local kind, message = tell.KINDS[rule.kind], group.message
  if not is_its(rule, group.source) then return false end
  if not kind then return message == rule.message end
  if kind.is_rare then
    return group.counts[rule.kind] ~= nil
  end
  if not kind.about then
    return group.source.id ~= nil
  end
  local has = message and message[kind.about]
  return has and (type(has) ~= "table" or next(has) ~= nil)
end

-- Whether a rule that is about nothing that came holds all the same: a message of its source came.
-- Nil where it does not.
local function holds_of_none(self, rule)
  local kind = tell.KINDS[rule.kind]
  if not (kind and kind.is_rare or rule.is_default) then
    return nil
  end
  for _, group in ipairs(self.groups.list) do
    local has_come = group.count > 0 or group.counts.crc
    if has_come and is_its(rule, group.source) then
      return true
    end
  end
end

-- Of the sources that the user named with a message those that never came.
local function judge_absent(self, rule)
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

local function judge_spread(self, rule)
  for _, spread in ipairs(self.groups.spreads[rule.message] or {}) do
    if spread.want == rule and spread.worst then
      return spread.worst, spread.frame, spread.worst <= rule.limit
    end
  end
end

local TEXTS = { [true] = "ok", [false] = "FAILED" }

local function row_of(rule, group, seen, frame, is_well, worst, note)
  local source = group and group.source or { name = rule.source }
  if is_well == nil then
    local is_unsure = group and group.is_unsure
    note = is_unsure and "what came before is not known" or "nothing to judge it by"
  end
  return output.row(source, {
    is_well = is_well,
    ok = { json = output.value(is_well), text = TEXTS[is_well] or "NOT JUDGED" },
    rule = rule.text,
    seen = output.number(seen),
    limit = { json = output.value(rule.limit or rule.text:match("=(.*)$")) },
    frame = frame,
    worst = output.number(worst),
    note = note,
  })
end

local function judge(self, rule, last)
  if rule.kind == "absent" then
    return { row_of(rule, nil, judge_absent(self, rule)) }
  end
  if rule.kind == "spread" then
    return { row_of(rule, nil, judge_spread(self, rule)) }
  end
  local measured, rows = measure[rule.kind] or count_events, {}
  for _, group in ipairs(self.groups:sorted()) do
    if is_about(rule, group) then
      rows[#rows + 1] = row_of(rule, group, measured(rule, group, last))
    end
  end
  if rows[1] then return rows end
  local ok = holds_of_none(self, rule)
  return { row_of(rule, nil, ok and 0, nil, ok) }
end

-- A report in JUnit's XML ------------------------------------------------------------------------

local ENTITIES = { ["<"] = "&lt;", [">"] = "&gt;", ["&"] = "&amp;", ['"'] = "&quot;" }
local REPORT = '<?xml version="1.0" encoding="UTF-8"?>\n<testsuite name="yapp.check" tests="%d" ' ..
  'failures="%d" errors="%d">\n%s</testsuite>\n'

-- XML has no control characters, not even as entities.
local function escape(text)
  return (output.readable(text):gsub("%c", " "):gsub('[<>&"]', ENTITIES))
end

-- kind  "failure" or "error", with a text; nil where all is well
local function case_of(name, kind, text)
  local case = ('  <testcase classname="yapp.check" name="%s"'):format(escape(name))
  if not kind then return case .. "/>\n" end
  return ('%s><%s message="%s"/></testcase>\n'):format(case, kind, escape(text))
end

-- Writes it; returns what went wrong, nil for nothing.
local function report(path, rows, problems)
  local cases, failures, errors = {}, 0, #problems
  for i, row in ipairs(rows) do
    local kind, seen = nil, {}
    if row.is_well == false then
      kind, failures = "failure", failures + 1
    elseif row.is_well == nil then
      kind, errors = "error", errors + 1
    end
    for _, key in ipairs { "seen", "worst", "note", "frame" } do
      if row[key] then
        seen[#seen + 1] = key .. " " .. output.text(row[key])
      end
    end
    local name = row.rule
    for _, key in ipairs { "bus", "id", "source" } do
      if row.id and row[key] then
        name = name .. " " .. output.text(row[key])
      end
    end
    cases[i] = case_of(name, kind, table.concat(seen, ", "))
  end
  for _, problem in ipairs(problems) do
    cases[#cases + 1] = case_of(problem, "error", problem)
  end
  return output.save(path, REPORT:format(#cases, failures, errors, table.concat(cases)))
end

-- The rows of all rules, and the exit code that follows from them.
local function judge_all(self, last)
  local rows, code = {}, 0
  for _, rule in ipairs(self.options.rules) do
    for _, row in ipairs(judge(self, rule, last)) do
      rows[#rows + 1] = row
      if row.is_well == false then
        code = FAILED
      elseif row.is_well == nil and code == 0 then
        code = UNJUDGED
      end
    end
  end
  return rows, code
end

--- last     { rel =, ... } of the last packet of any kind; nil where there was none
-- returns  the exit code, and a text that says why where the table does not, nil for nothing
function Check:finish(last)
  local options, problems = self.options, self.context.problems()
  local rows, code = judge_all(self, last)
  for _, problem in ipairs(options.problems) do
    problems[#problems + 1] = problem
  end
  local problem = options.junit and report(options.junit, rows, problems)
  if problem then
    problems[#problems + 1] = "the report is not written: " .. problem
  end
  if code == 0 and problems[1] then code = UNJUDGED end
  output.print(self.context, "YAPP check: " .. VERDICTS[code], KEYS, rows)
  return code, problems[1] and "check: " .. table.concat(problems, "\ncheck: ") or nil
end

return M
