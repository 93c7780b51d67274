-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,check: rules that a capture must keep, the exit code of a gate, a test report for CI.
-- Pure Lua, 5.2 to 5.5.

local groups = require("yapp.stat.groups")
local kinds = require("yapp.stat.kinds")
local output = require("yapp.stat.output")
local utf8 = require("yapp.base.utf8")

local M = {}

local words, span = output.words, kinds.span
-- Verdicts, in the order of the text.
local FAILED = {
  json = "false",
  text = "FAILED",
  title = "FAILED",
  case = "failure",
  code = output.EXIT_FAILED,
}
local UNJUDGED = {
  json = "null",
  text = "NOT JUDGED",
  title = "not all of it could be judged",
  case = "error",
  code = output.EXIT_UNDECIDED,
}
local OK = { json = "true", text = "ok", title = "all rules hold", code = output.EXIT_OK }
local KEYS = {
  json = words("ok rule bus id source message frame seen limit worst note"),
  text = words("ok rule bus id source message frame seen worst note"),
  window = words("ok rule who message seen worst note"),
}
local NO_TIMES = "packets of this capture have no time stamps"
local NO_VALUE = "no good message of it came"
local SAME_SEQ = {
  json = '"Seq No never changes: lost messages do not show"',
  text = "Seq No never changes: lost messages do not show",
  short = "Seq No never changes",
}
local UNRELIABLE = "what came before its messages is not known: see -z yapp,events"
-- Rules about time that no kind of event has.
local RESTS_ON_TIME = { needs_time = true, needs_past = true }
local TIMED = { rate = RESTS_ON_TIME, gap = RESTS_ON_TIME, spread = RESTS_ON_TIME }

local Check = groups.class { compares = true }

--- See groups.class.
M.new = Check.new

--- Return what the rules want of the values of a message.
function Check:wants(message)
  local list = {}
  for _, rule in ipairs(self.options.rules) do
    if rule.field and rule.message == message then
      list[#list + 1] = rule
    end
  end
  return list
end

-- Measures ----------------------------------------------------------------------------------------
--
-- Each returns { seen, frame, holds = whether the rule holds, nil where it cannot be judged; worst
-- = the value that is farthest outside, note }; where it cannot, the note says why.

local function is_its(rule, source)
  return not rule.source or source.name == rule.source
end

-- By rule: function(rule, group, ending), of a source.
local of_source = {}

function of_source.count(rule, group)
  return { seen = group.count, frame = group.last_frame, holds = group.count >= rule.limit }
end

function of_source.rate(rule, group)
  local rate = groups.pace(group) or group.count == 1 and 0 or nil
  if not rate then return { note = "no two messages at different times" } end
  local shown = tonumber(("%.12g"):format(rate)) -- 10, not 9.9999999999999982
  local holds = shown >= rule.low and shown <= rule.high
  return { seen = rate, frame = group.last_frame, holds = holds }
end

function of_source.gap(rule, group, ending)
  if group.count == 0 then return { note = NO_VALUE } end
  local gap, frame = group.gap_max or 0, group.gap_max_frame
  local to_end = span(group.last, ending.now or group.last)
  if to_end > gap then gap, frame = to_end, nil end
  return { seen = gap, frame = frame or group.last_frame, holds = gap <= rule.limit }
end

function of_source.range(rule, group)
  local values = group.values[rule]
  if values.seen == 0 then return { note = NO_VALUE } end
  return {
    seen = values.outside,
    frame = values.frame,
    holds = values.outside == 0,
    worst = values.worst,
    note = ("of %d values"):format(values.seen),
  }
end

-- How many events of a kind there are.
local function count_events(rule, group)
  if kinds.BY_NAME[rule.kind].needs_past and group.count == 0 then return { note = NO_VALUE } end
  local seen, frame, values = groups.seen(group, rule.kind)
  return { seen = seen, frame = frame, holds = seen <= rule.limit, note = values and values.note }
end

function of_source.missing(rule, group)
  local row = count_events(rule, group)
  if group.count > 1 and not group.is_numbered then row.note = SAME_SEQ end
  return row
end

-- By rule: function(check, rule), of the whole capture.
local of_capture = {}

function of_capture.absent(self, rule)
  local names, is_named = {}, rule.is_default
  for _, event in ipairs(self.of_capture.absent or {}) do
    local source = event.source
    if is_its(rule, source) then names[#names + 1] = source.name or output.place(source) end
  end
  for _, row in ipairs(self.context.settings.sources:list()) do
    is_named = is_named or row.message and is_its(rule, row)
  end
  if not is_named then return { note = "no source is named with a message: see yapp.sources" } end
  return { seen = #names, holds = #names <= rule.limit, note = table.concat(names, ", ") }
end

function of_capture.spread(self, rule)
  local spread = self.spreads[rule]
  if not (spread and spread.worst) then
    return { note = "no two sources of it have a value at one time" }
  end
  return { seen = spread.worst, frame = spread.frame, holds = spread.worst <= rule.limit }
end

-- How many events of a kind the capture has.
local function count_all(self, rule)
  local seen, frame, amount = 0, nil, kinds.BY_NAME[rule.kind].amount
  for _, event in ipairs(self.of_capture[rule.kind] or {}) do
    seen, frame = seen + (event.values[amount] or 1), frame or event.frame
  end
  return { seen = seen, frame = frame, holds = seen <= rule.limit }
end

-- Judging -----------------------------------------------------------------------------------------

-- Whether a rule is about a source.
local function is_about(rule, group)
  local kind, message = kinds.BY_NAME[rule.kind], group.message
  if not is_its(rule, group.source) then return false end
  if not kind then return message == rule.message end
  if kind.scope == "rare" then
    return group.counts[rule.kind] ~= nil
  end
  if not kind.about then return group.source.id ~= nil end
  local has = message and message[kind.about]
  return has and (type(has) ~= "table" or next(has) ~= nil)
end

-- Judge a rule that no group is about.  A default rule, or one of rare events, holds if a message
-- of its source came.
local function measure_none(self, rule, ending)
  local kind, message, source = kinds.BY_NAME[rule.kind], rule.message, rule.source
  if rule.is_default or kind and kind.scope == "rare" then
    for _, group in ipairs(self.list) do
      local has_come = group.count > 0 or group.counts.crc
      if has_come and is_its(rule, group.source) then return { seen = 0, holds = true } end
    end
  end
  if ending.reason then return { note = ending.reason } end
  if source then
    return { note = ("no message of a source that yapp.sources calls %s came"):format(source) }
  end
  if not message then return { note = "no message came that it is about" } end
  return { note = ("no %s came: see yapp.%s_ids"):format(message.title, message.name) }
end

-- Why a rule cannot be judged, whatever was seen; nil for no reason.
-- holds  whether it seems to
local function reason_of(rule, group, ending, holds)
  local kind = kinds.BY_NAME[rule.kind] or TIMED[rule.kind] or {}
  if kind.needs_time and ending.lacks_times then return NO_TIMES end
  if not holds then return nil end
  if kind.needs_past and group and group.is_unreliable then return UNRELIABLE end
  return ending.reason
end

-- Adds the row of a rule; the verdict on the capture follows from all of them.
-- group  nil for all sources
-- row    of a measure
local function add_row(self, rule, group, ending, row)
  local reason = reason_of(rule, group, ending, row.holds)
  row.ok = row.holds and OK or FAILED
  if reason or row.holds == nil then row.ok = UNJUDGED end
  if row.ok == FAILED or self.verdict == OK then self.verdict = row.ok end
  row.rule, row.limit = rule.text, rule.limit or rule.text:match("=(.*)$")
  row.note = reason or row.note
  local source = group and group.source or { name = rule.source }
  self.rows[#self.rows + 1] = output.row(source, row)
end

-- Adds the rows of a rule: one for each of its sources, or one in all.
local function judge(self, rule, ending)
  local kind, is_about_any = kinds.BY_NAME[rule.kind], false
  local measure = of_capture[rule.kind] or kind and kind.scope == "capture" and count_all
  if measure then
    return add_row(self, rule, nil, ending, measure(self, rule))
  end
  measure = of_source[rule.kind] or count_events
  for _, group in ipairs(self:sorted()) do
    if is_about(rule, group) then
      is_about_any = true
      add_row(self, rule, group, ending, measure(rule, group, ending))
    end
  end
  if not is_about_any then add_row(self, rule, nil, ending, measure_none(self, rule, ending)) end
end

-- A report in JUnit's XML ------------------------------------------------------------------------

local ENTITIES = { ["<"] = "&lt;", [">"] = "&gt;", ["&"] = "&amp;", ['"'] = "&quot;" }
local REPORT = '<?xml version="1.0" encoding="UTF-8"?>\n<testsuite name="yapp.check" tests="%d" ' ..
  'failures="%d" errors="%d">\n%s</testsuite>\n'
local NAME, MESSAGE = words("rule bus id source"), words("seen worst note frame")

-- XML allows no control characters, not even as entities.
local function escape(text)
  return (utf8.printable(text):gsub('[<>&"]', ENTITIES))
end

-- kind  "failure" or "error", with a text; nil where all is well
local function case_of(name, kind, text)
  local case = ('  <testcase classname="yapp.check" name="%s"'):format(escape(name))
  if not kind then return case .. "/>\n" end
  return ('%s><%s message="%s"/></testcase>\n'):format(case, kind, escape(text))
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

-- The rows in the order of their verdicts, problems among them; and how many of each there are.
local function sort(rows, problems)
  local sorted, counts = {}, {}
  for _, ok in ipairs { FAILED, UNJUDGED, OK } do
    local before = #sorted
    for _, row in ipairs(rows) do
      if row.ok == ok then sorted[#sorted + 1] = row end
    end
    for _, problem in ipairs(ok == UNJUDGED and problems or {}) do
      sorted[#sorted + 1] = { ok = ok, note = problem }
    end
    counts[ok] = #sorted - before
  end
  return sorted, counts
end

--- End, see stat.queue.
-- returns  the exit code, and a text that says what is wrong besides rules, nil for nothing
function Check:finish(ending)
  local options, context, problems = self.options, self.context, {}
  self.rows, self.verdict = {}, OK
  for _, rule in ipairs(options.rules) do
    judge(self, rule, ending)
  end
  for _, list in ipairs { context.settings.problems, options.problems } do
    for _, problem in ipairs(list) do problems[#problems + 1] = problem end
  end
  local problem = options.junit and report(options.junit, self.rows, problems)
  if problem then
    problems[#problems + 1] = "the report is not written: " .. problem
  end
  if self.verdict == OK and problems[1] then self.verdict = UNJUDGED end
  local rows, counts = sort(self.rows, problems)
  local title = "YAPP check: " .. self.verdict.title
  output.print(context, title, KEYS, options.json and self.rows or rows, ending.notes)
  if not options.json then
    local text = "\n%d of %d rules failed, %d not judged\n"
    context.out(text:format(counts[FAILED], #rows, counts[UNJUDGED]))
  end
  return self.verdict.code, problems[1] and "check: " .. table.concat(problems, "\ncheck: ")
end

return M
