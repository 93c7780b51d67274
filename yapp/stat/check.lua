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
local KEYS = {
  "ok", "rule", "bus", "id", "source", "message", "frame", "seen", "limit", "worst", "note",
}

local Check = {}
Check.__index = Check

--- options  { rules, problems = texts, junit = path or nil } of stat.options
-- context  { late = function() -> periods, problems = function() -> texts: why what comes of it
--          cannot be trusted, named = function() -> list of the sources that the user named, see
--          message.sources, and what output.print takes }
function M.new(options, context)
  local self = setmetatable({ options = options, context = context, absent = {},
    ranges = {}, -- by message: list of rules
    spreads = {} }, Check) -- by rule
  self.groups = groups.new(function(message)
    local list = {}
    for i, rule in ipairs(self.ranges[message] or {}) do
      list[i] = groups.values(message, rule.field, rule)
    end
    return list
  end)
  for _, rule in ipairs(options.rules) do
    local message = rule.message
    if rule.kind == "range" then
      self.ranges[message] = self.ranges[message] or {}
      table.insert(self.ranges[message], rule)
    elseif rule.kind == "spread" then
      self.spreads[rule] = groups.spread(message, rule.field, context.late)
    end
  end
  return self
end

function Check:event(event)
  if event.kind == "absent" then self.absent[#self.absent + 1] = event.source end
  self.groups:event(event)
end

function Check:message(record)
  local message, raws = self.groups:message(record)
  for rule, spread in pairs(message and self.spreads or {}) do
    if rule.message == message then spread:note(record, raws) end
  end
end

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
    if values.limits == rule and values.seen > 0 then
      return values.outside, values.frame, values.outside == 0, values.worst,
        ("of %d values"):format(values.seen)
    end
  end
end

-- How many events of a kind there are.
local function count_events(rule, group)
  local seen, frame = groups.seen(group, rule.kind)
  local is_well, is_open = seen <= rule.limit, false
  if tell.KINDS[rule.kind].needs_past then
    is_open = group.count == 0 or is_well and group.is_unsure
  end
  if is_open then return seen, frame end
  return seen, frame, is_well
end

-- Whether a rule is about a source.
local function is_about(rule, group)
  local kind, message = tell.KINDS[rule.kind], group.message
  if rule.source and group.source.name ~= rule.source then return false end
  if not kind then return message == rule.message end
  if kind.is_rare then return groups.seen(group, rule.kind) > 0 end
  if not kind.about then return group.source.id ~= nil end
  return message and kind.about(message)
end

-- Whether a rule that is about nothing that came holds all the same: a message of its source came.
-- Nil where it does not.
local function holds_of_none(self, rule)
  local kind = tell.KINDS[rule.kind]
  if not (kind and kind.is_rare or rule.is_default) then return nil end
  for _, group in ipairs(self.groups.list) do
    local is_its = not rule.source or group.source.name == rule.source
    if is_its and (group.count > 0 or group.counts.crc) then return true end
  end
end

-- Of the sources that the user named with a message those that never came.
local function count_absent(self, rule)
  local names, is_any = {}, false
  for _, row in ipairs(self.context.named()) do
    local is_its = not rule.source or row.name == rule.source
    is_any = is_any or row.message and is_its
  end
  for _, row in ipairs(self.absent) do
    if not rule.source or row.name == rule.source then names[#names + 1] = output.who(row) end
  end
  local ok = is_any and #names <= rule.limit
  if not is_any then ok = holds_of_none(self, rule) end
  return #names, ok, table.concat(names, ", ")
end

local NOTES = { [true] = "what came before is not known", [false] = "nothing to judge it by" }

local function row_of(rule, group, seen, frame, ok, worst, note)
  local row = output.row(group and group.source or { name = rule.source }, { rule = rule.text,
    seen = output.number(seen), frame = frame, worst = output.number(worst), note = note })
  row.limit = output.raw(output.value(rule.limit or rule.text:match("=(.*)$")))
  row.ok = { json = tostring(ok), text = ok and "ok" or "FAILED", is_failed = ok == false }
  if ok == nil then
    row.ok = { json = "null", text = "NOT JUDGED", is_open = true }
    row.note = NOTES[group and group.is_unsure or false]
  end
  return row
end

local function judge(self, rule, last)
  local spread, rows = self.spreads[rule], {}
  if rule.kind == "absent" then
    local seen, ok, names = count_absent(self, rule)
    return { row_of(rule, nil, seen, nil, ok, nil, names) }
  end
  if spread then
    local worst = spread.worst
    return { row_of(rule, nil, worst, spread.frame, worst and worst <= rule.limit) }
  end
  for _, group in ipairs(self.groups:sorted()) do
    if is_about(rule, group) then
      rows[#rows + 1] = row_of(rule, group, (measure[rule.kind] or count_events)(rule, group, last))
    end
  end
  if rows[1] then return rows end
  local ok = holds_of_none(self, rule)
  return { row_of(rule, nil, ok and 0, nil, ok) }
end

-- A report in JUnit's XML ------------------------------------------------------------------------

local ENTITIES = { ["<"] = "&lt;", [">"] = "&gt;", ["&"] = "&amp;", ['"'] = "&quot;" }

-- XML has no control characters, not even as entities.
local function escape(text)
  return (output.readable(text):gsub("%c", " "):gsub('[<>&"]', ENTITIES))
end

local CASE = '  <testcase classname="yapp.check" name="%s"%s>\n'
local REPORT = '<?xml version="1.0" encoding="UTF-8"?>\n<testsuite name="yapp.check" tests="%d" ' ..
  'failures="%d" errors="%d">\n%s</testsuite>\n'

-- Writes it; problems: lists of texts; returns what went wrong, nil for nothing.
local function report(path, rows, ...)
  local lines, counts = {}, { failure = 0, error = 0 }
  local function add(name, kind, text)
    local inner = "/"
    if kind then
      counts[kind] = counts[kind] + 1
      inner = ('><%s message="%s"/></testcase'):format(kind, escape(text))
    end
    lines[#lines + 1] = CASE:format(escape(name), inner)
  end
  for _, row in ipairs(rows) do
    local parts, seen = { row.rule }, {}
    for _, key in ipairs { "bus", "id", "source" } do
      local text = row.id and output.text(row[key]) or ""
      if text ~= "" then parts[#parts + 1] = text end
    end
    for _, key in ipairs { "seen", "worst", "note", "frame" } do
      local text = output.text(row[key])
      if key ~= "note" then text = key .. " " .. text end
      if row[key] then seen[#seen + 1] = text end
    end
    local kind = row.ok.is_failed and "failure" or row.ok.is_open and "error"
    add(table.concat(parts, " "), kind, table.concat(seen, ", "))
  end
  for _, problems in ipairs { ... } do
    for _, problem in ipairs(problems) do add(problem, "error", problem) end
  end
  local file, problem = output.create(path)
  if not file then return problem end
  file:write(REPORT:format(#lines, counts.failure, counts.error, table.concat(lines)))
  return output.finish { file }
end

--- last     { rel =, ... } of the last packet of any kind; nil where there was none
-- returns  the exit code, and a text that says why where the table does not, nil for nothing
function Check:finish(last)
  local options, problems = self.options, self.context.problems()
  local rows, is_failed, is_open = {}, false, false
  for _, rule in ipairs(options.rules) do
    for _, row in ipairs(judge(self, rule, last)) do
      rows[#rows + 1] = row
      is_failed, is_open = is_failed or row.ok.is_failed, is_open or row.ok.is_open
    end
  end
  local problem = options.junit and report(options.junit, rows, options.problems, problems)
  if problem then problems[#problems + 1] = "the report is not written: " .. problem end
  is_open = is_open or options.problems[1] or problems[1]
  local code = is_failed and FAILED or is_open and UNJUDGED or 0
  output.print(self.context, "YAPP check: " .. VERDICTS[code], KEYS, rows)
  for i, text in ipairs(problems) do problems[i] = "check: " .. text end
  return code, problems[1] and table.concat(problems, "\n") or nil
end

return M
