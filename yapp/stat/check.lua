-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,check: rules that a capture must keep, the exit code of a gate, a test report for CI.
-- Pure Lua, 5.2 to 5.5.
--
-- 0 every rule was judged and held, 20 one did not hold, 21 one could not be judged; both: 20.

local groups, output = require("yapp.stat.groups"), require("yapp.stat.output")
local decode = require("yapp.message.decode")
local span = require("yapp.stat.tell").span

local M = {}

local FAILED, UNJUDGED = 20, 21
local VERDICTS = { [0] = "all rules hold", [FAILED] = "FAILED",
  [UNJUDGED] = "not all of it could be judged" }
local KEYS = { "rule", "source", "ok", "seen", "limit", "frame", "bus", "id", "message", "worst" }
-- Of nothing that they are about there is none where there are messages.
local HOLDS_OF_NONE = { unknown = true, skipped = true }
-- What is seen in good messages only, where it is known what came before.
local NEEDS_GOOD = { fault = true, reboot = true, stale = true, silence = true }

local Check = {}
Check.__index = Check

--- options  { rules, problems = texts, json = boolean, junit = path or nil } of stat.options
-- context  { out = function(text), late = function() -> periods, width = of a line or nil,
--          problems = function() -> texts: why what comes of it cannot be trusted,
--          named = function() -> list of the sources that the user named, see message.sources }
function M.new(options, context)
  local self = setmetatable({ options = options, context = context, ranges = {}, spreads = {},
    absent = {} }, Check)
  self.groups = groups.new(function() return {} end)
  for _, rule in ipairs(options.rules) do
    if rule.kind == "range" then self.ranges[rule] = {} end -- by group
    if rule.kind == "spread" then
      self.spreads[rule] = groups.spread(rule.message, rule.field, context.late)
    end
  end
  return self
end

function Check:event(event)
  if event.kind == "absent" then
    self.absent[#self.absent + 1] = event.source
  else
    self.groups:event(event)
  end
end

local function outside(rule, value)
  if not value then return math.huge end -- a reserved count beats all
  return rule.low and value < rule.low and rule.low - value or
    rule.high and value > rule.high and value - rule.high or nil
end

-- The value that lies farthest outside is the one that is shown.
local function note_range(rule, range, record, raws)
  local field, index = rule.field, rule.message.index[rule.field]
  if field.kind ~= "time" and raws[index] == nil then return end
  local value = groups.number(field, raws, index, record.payload)
  local by = outside(rule, value)
  if by and value then
    value = groups.rounded(field, value)
    by = outside(rule, value)
  end
  range.values = range.values + 1
  if not by then return end
  range.seen = range.seen + 1
  if not range.by or by > range.by then
    range.by, range.worst, range.frame = by, value, record.frame
  end
end

function Check:message(record)
  local group = self.groups:message(record)
  if not record.fits or record.kind ~= "message" then return end
  for rule, of_group in pairs(self.ranges) do
    if rule.message == group.message then
      local range = of_group[group] or { values = 0, seen = 0 }
      of_group[group] = range
      note_range(rule, range, record, decode.read(group.message, record.payload))
    end
  end
  for rule, spread in pairs(self.spreads) do
    if rule.message == group.message then
      spread:note(record, decode.read(group.message, record.payload))
    end
  end
end

-- Judging ---------------------------------------------------------------------------------------

-- Of a source: what is seen and in which frame; ok, or nil where it cannot be judged.
local measure = {}

function measure.count(rule, group)
  return { seen = group.count, frame = group.last_frame, ok = group.count >= rule.limit }
end

function measure.rate(rule, group)
  local rate = groups.rate(group) or group.count == 1 and 0 or nil
  return { seen = rate, frame = group.last_frame, ok = rate and rate >= rule.limit }
end

function measure.gap(rule, group, last)
  if group.count == 0 then return {} end
  local gap, frame = group.gap_max or 0, group.gap_max_frame or group.last_frame
  local to_end = last and span(group.last, last.rel) or 0
  if to_end > gap then gap, frame = to_end, group.last_frame end
  return { seen = gap, frame = frame, ok = gap <= rule.limit }
end

local function judge(self, rule, group, last)
  if measure[rule.kind] then return measure[rule.kind](rule, group, last) end
  if rule.kind == "range" then
    local range = self.ranges[rule][group]
    if not range then return {} end
    return { seen = range.seen, frame = range.frame, ok = range.seen == 0, worst = range.worst,
      values = range.values }
  end
  local seen, frame = groups.seen(group, rule.kind)
  local result = { seen = seen, frame = frame, ok = seen <= rule.limit }
  if NEEDS_GOOD[rule.kind] and (group.count == 0 or result.ok and group.is_unsure) then
    result.ok = nil
  end
  return result
end

-- Which sources a rule is about.
local function is_about(rule, group)
  local kind, message = rule.kind, group.message
  if rule.source and group.source.name ~= rule.source then return false end
  if HOLDS_OF_NONE[kind] then return groups.seen(group, kind) > 0 end
  if kind == "crc" or kind == "incomplete" then return group.source.id ~= nil end
  if not message then return false end
  if kind == "fault" then return message.alarms[1] ~= nil end
  if kind == "reboot" or kind == "stale" then return message.time ~= nil end
  if kind == "silence" then return message.every ~= nil end
  return kind == "invalid" or message == rule.message
end

-- Whether a rule that is about nothing that came holds all the same; nil where it is not judged.
local function holds_of_none(self, rule)
  if not (HOLDS_OF_NONE[rule.kind] or rule.is_default) then return nil end
  for _, group in ipairs(self.groups.list) do
    local is_its = not rule.source or group.source.name == rule.source
    local is_read = group.count > 0 or group.counts.crc and not rule.is_default
    if is_its and is_read and (group.message or not rule.is_default) then return true end
  end
end

-- Of the sources that the user named with a message those that never came.
local function judge_absent(self, rule)
  local result, names, is_any = { rule = rule, seen = 0 }, {}, false
  for _, row in ipairs(self.context.named()) do
    if row.message and (not rule.source or row.name == rule.source) then is_any = true end
  end
  for _, row in ipairs(self.absent) do
    if not rule.source or row.name == rule.source then
      local bus, id, name = output.source_cells(row)
      names[#names + 1] = name or bus and bus .. " " .. id or id
    end
  end
  if not is_any then
    result.ok = holds_of_none(self, rule)
  else
    result.seen, result.ok, result.names = #names, #names <= rule.limit, table.concat(names, ", ")
  end
  return result
end

local function judge_rule(self, rule, list, last)
  if rule.kind == "absent" then return { judge_absent(self, rule) } end
  local spread = self.spreads[rule]
  if spread then
    local worst = spread.worst
    local ok = worst and worst <= rule.limit
    return { { rule = rule, seen = worst, frame = spread.frame, ok = ok } }
  end
  local results = {}
  for _, group in ipairs(list) do
    if is_about(rule, group) then
      local result = judge(self, rule, group, last)
      result.rule, result.group = rule, group
      results[#results + 1] = result
    end
  end
  if results[1] then return results end
  local ok = holds_of_none(self, rule)
  return { { rule = rule, seen = ok and 0, ok = ok } }
end

-- What is printed -------------------------------------------------------------------------------

local NOTHING = {}

local function line(result)
  local rule, source = result.rule, result.group and result.group.source or NOTHING
  return output.line(KEYS, source, { rule = rule.text, source = rule.source,
    limit = rule.limit or rule.text:match("=(.*)$") }, result)
end

local function unjudged_text(rule, group)
  if rule.kind == "spread" then return "no two sources at a time" end
  if not group then return "no message that it is about" end
  return group.is_unsure and "what came before is not known" or "nothing to judge"
end

local function seen_text(result)
  local kind, seen = result.rule.kind, result.seen
  if result.ok == nil then return unjudged_text(result.rule, result.group) end
  if kind == "rate" then return ("%.3f Hz"):format(seen) end
  if kind == "gap" then return ("%.6f s"):format(seen) end
  if kind == "spread" then return output.number(seen) end
  if kind == "absent" and seen > 0 then return ("%d: %s"):format(seen, result.names) end
  if kind ~= "range" then return tostring(seen) end
  if seen == 0 then return ("%d inside"):format(result.values) end
  local worst = output.number(result.worst) or "reserved"
  return ("%d of %d outside, worst %s"):format(seen, result.values, worst)
end

local WORDS = { [true] = "ok", [false] = "FAILED" }

local function table_of(results, width)
  local rows = {}
  for i, result in ipairs(results) do
    local source = result.group and result.group.source or { name = result.rule.source }
    local bus, id, name, title = output.source_cells(source)
    rows[i] = { WORDS[result.ok] or "NOT JUDGED", result.rule.text, bus, id, name, title,
      result.frame, seen_text(result) }
  end
  return output.table({ "check", "rule", "bus", "ID", "source", "message", ">frame", "seen" }, rows,
    width, { "message", "bus" })
end

local function print_results(self, results, code)
  local out = self.context.out
  if self.options.json then
    for _, result in ipairs(results) do out(line(result)) end
  else
    out(table_of(results, self.context.width))
    out(("\nYAPP check: %s\n"):format(VERDICTS[code or 0]))
  end
end

-- A report in JUnit's XML ------------------------------------------------------------------------

local ENTITIES = { ["<"] = "&lt;", [">"] = "&gt;", ["&"] = "&amp;", ['"'] = "&quot;" }

-- XML has no control characters, not even as entities.
local function escape(text)
  return (output.readable(text):gsub("%c", " "):gsub('[<>&"]', ENTITIES))
end

local function case_of(name, kind, text)
  local start = ('  <testcase classname="yapp.check" name="%s"'):format(escape(name))
  if kind == "ok" then return start .. "/>" end
  return ('%s><%s message="%s"/></testcase>'):format(start, kind, escape(text))
end

local CASE_KINDS = { [true] = "ok", [false] = "failure" }

-- Writes it; returns what went wrong, nil for nothing.
local function report(path, results, ...)
  local lines, counts = {}, { ok = 0, failure = 0, error = 0 }
  local function add(name, kind, text)
    counts[kind], lines[#lines + 1] = counts[kind] + 1, case_of(name, kind, text)
  end
  for _, result in ipairs(results) do
    local name, text = result.rule.text, seen_text(result)
    if result.group then
      local bus, id, source = output.source_cells(result.group.source)
      for _, part in ipairs { bus or "", id, source or "" } do
        if part ~= "" then name = name .. " " .. part end
      end
    end
    if result.frame then text = ("%s, frame %d"):format(text, result.frame) end
    add(name, CASE_KINDS[result.ok] or "error", text)
  end
  for _, problems in ipairs { ... } do
    for _, problem in ipairs(problems) do add(problem, "error", problem) end
  end
  local file, problem = output.create(path)
  if not file then return problem end
  file:write(('<?xml version="1.0" encoding="UTF-8"?>\n<testsuite name="yapp.check" tests="%d" ' ..
    'failures="%d" errors="%d">\n%s\n</testsuite>\n'):format(#lines, counts.failure, counts.error,
    table.concat(lines, "\n")))
  return output.finish { file }
end

-- The end ---------------------------------------------------------------------------------------

-- What is wrong besides the rules.
local function problems_of(self)
  local problems, names = self.context.problems(), {}
  for _, row in ipairs(self.context.named()) do names[row.name or false] = true end
  for _, rule in ipairs(self.options.rules) do
    if rule.source and not names[rule.source] then
      problems[#problems + 1] = ("no source is called %s in the preference"):format(rule.source)
      names[rule.source] = true
    end
  end
  return problems
end

-- The results of all rules; whether one failed, whether one was not judged.
local function judge_all(self, last)
  local results, list, is_failed, is_unjudged = {}, self.groups:sorted(), false, false
  for _, rule in ipairs(self.options.rules) do
    for _, result in ipairs(judge_rule(self, rule, list, last)) do
      results[#results + 1] = result
      is_failed, is_unjudged = is_failed or result.ok == false, is_unjudged or result.ok == nil
    end
  end
  return results, is_failed, is_unjudged
end

--- last     { rel =, ... } of the last packet of any kind; nil where there was none
-- returns  the exit code: nil for 0, 20 or 21, and a text that says why where the table does not
function Check:finish(last)
  local options, problems = self.options, problems_of(self)
  local results, is_failed, is_unjudged = judge_all(self, last)
  local problem = options.junit and report(options.junit, results, options.problems, problems)
  if problem then problems[#problems + 1] = "the report is not written: " .. problem end
  is_unjudged = is_unjudged or options.problems[1] or problems[1]
  local code = is_failed and FAILED or is_unjudged and UNJUDGED or nil
  print_results(self, results, code)
  for i, text in ipairs(problems) do problems[i] = "check: " .. text end
  return code, problems[1] and table.concat(problems, "\n") or nil
end

return M
