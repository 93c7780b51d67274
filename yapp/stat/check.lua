-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,check: rules that a capture must keep, and the exit code of a gate.  Pure Lua, 5.2 and 5.4.
--
-- 0 every rule was judged and held, 20 one did not hold, 21 one could not be judged; both: 20.

local json, text = require("yapp.stat.json"), require("yapp.stat.text")
local groups, rules, junit = require("yapp.stat.groups"), require("yapp.stat.rules"), require("yapp.stat.junit")

local M = {}

M.FAILED, M.UNJUDGED = 20, 21
local KEYS = { "rule", "source", "ok", "seen", "limit", "frame", "bus", "id", "message", "worst" }

local Check = {}
Check.__index = Check

--- options  { rules = of stat.rules, problems = texts, json = boolean, junit = path or nil }
-- context  { out = function(text), complain = function(text), decode = module, is_whole = whether the catalogue loaded
--          whole, has_source = function(name) -> boolean }
function M.new(options, context)
  local self = setmetatable({ options = options, context = context, ranges = {}, results = {}, seen = 0 }, Check)
  self.rules = {}
  local has_unknown = false
  for i, rule in ipairs(options.rules) do
    self.rules[i] = rule
    has_unknown = has_unknown or rule.kind == "unknown"
    if rule.kind == "range" then self.ranges[#self.ranges + 1] = rule end
  end
  -- What was not decoded was not checked.
  if not has_unknown then self.rules[#self.rules + 1] = rules.read("unknown=0") end
  self.groups = groups.new(function(source) return self:new_group(source) end)
  return self
end

-- Counts of a source: { seen =, frame = the first one's } of each kind, and the ranges that are about its message.
function Check:new_group(source)
  local group = { count = 0, ranges = {}, counts = {} }
  for kind in pairs(rules.COUNTED) do group.counts[kind] = { seen = 0 } end
  for _, rule in ipairs(self.ranges) do
    local message = source.message
    if message == rule.message then
      group.ranges[#group.ranges + 1] = { rule = rule, index = message.index[rule.field], inside = 0, outside = 0 }
    end
  end
  return group
end

local function add(count, frame)
  count.seen, count.frame = count.seen + 1, count.frame or frame
end

local function raises(change)
  for _, one in ipairs(change.flags or {}) do
    if one.alarm_raised ~= 0 then return true end
  end
  return false
end

-- The number that a range is about: a value in its unit, a time in seconds, flags and codes as they are sent; nil for
-- a reserved count.
local function number_of(decode, field, raw, payload)
  if field.kind == "time" then
    local seconds, nanoseconds = decode.time(payload, field.offset)
    return seconds + nanoseconds / 1e9
  end
  if field.values or field.flags then return tonumber(raw) end
  local value = decode.value(field, raw)
  if type(value) == "string" then value = tonumber(value) end -- of 64 bits, where a double is not exact
  return type(value) == "number" and value == value and value or nil
end

local function outside(rule, value)
  return rule.low and value < rule.low and rule.low - value or
    rule.high and value > rule.high and value - rule.high or nil
end

-- The value that lies farthest outside is the one that is shown; a reserved count beats all.
local function note_value(range, value, frame, decode)
  local rule = range.rule
  local by = not value and math.huge or outside(rule, value)
  if by and value and (rule.field.kind == "float" or rule.field.scale) then -- with the digits that people see
    value = decode.rounded(rule.field, value)
    by = outside(rule, value)
  end
  if not by then
    range.inside = range.inside + 1
  else
    range.outside = range.outside + 1
    if not range.by or by > range.by then range.by, range.worst, range.frame = by, value, frame end
  end
end

function Check:note_ranges(group, record)
  local decode, payload = self.context.decode, record.payload
  local raws = decode.read(group.message, payload)
  for _, range in ipairs(group.ranges) do
    local field, raw = range.rule.field, raws[range.index]
    if raw or field.kind == "time" and field.offset + field.size <= #payload then
      note_value(range, number_of(decode, field, raw, payload), record.frame, decode)
    end
  end
end

-- A good message.
function Check:good(group, record)
  local gap = group.last and groups.span(group.last, record.rel)
  if gap and gap > (group.gap or -1) then group.gap, group.gap_frame = gap, record.frame end
  group.first, group.last, group.last_frame = group.first or record.rel, record.rel, record.frame
  group.count, group.is_unsure = group.count + 1, group.is_unsure or record.is_unsure
  local change, counts = record.change, group.counts
  if not record.fits then add(counts.unknown, record.frame) end
  if change then
    if change.reboot then add(counts.reboot, record.frame) end
    if change.stale then add(counts.stale, record.frame) end
    if change.flags and raises(change) then add(counts.fault, record.frame) end
  end
  if record.fits and group.ranges[1] then self:note_ranges(group, record) end
end

function Check:message(record)
  if not record.lost then self.seen = self.seen + 1 end
  local group = self.groups:of(record)
  if record.lost then
    add(group.counts.incomplete, record.frame)
  elseif record.is_bad then
    add(group.counts.crc, record.frame)
  elseif record.good then
    self:good(group, record)
  end
end

-- Judging -------------------------------------------------------------------------------------------------------

-- Of each kind: what is seen of a source and in which frame; ok, or nil where it cannot be judged.
local judge = {}

local function judge_count(rule, group)
  local count = group.counts[rule.kind]
  return { seen = count.seen, frame = count.frame, ok = count.seen <= rule.limit }
end

judge.crc, judge.incomplete, judge.unknown = judge_count, judge_count, judge_count

-- These are seen in good messages only, where it is known what came before.
local function judge_good(rule, group)
  local result = judge_count(rule, group)
  if group.count == 0 or result.ok and group.is_unsure then result.ok = nil end
  return result
end

judge.fault, judge.reboot, judge.stale = judge_good, judge_good, judge_good

function judge.count(rule, group)
  return { seen = group.count, frame = group.last_frame, ok = group.count >= rule.limit }
end

function judge.rate(rule, group)
  local span = group.count > 1 and groups.span(group.first, group.last)
  local rate = span and span > 0 and (group.count - 1) / span or group.count == 1 and 0 or nil
  return { seen = rate, frame = group.last_frame, ok = rate and rate >= rule.limit }
end

function judge.gap(rule, group, last)
  if group.count == 0 then return {} end
  local gap, frame = group.gap or 0, group.gap_frame or group.last_frame
  local to_end = last and groups.span(group.last, last.rel) or 0
  if to_end > gap then gap, frame = to_end, group.last_frame end
  return { seen = gap, frame = frame, ok = gap <= rule.limit }
end

function judge.range(rule, group)
  for _, range in ipairs(group.ranges) do
    if range.rule == rule then
      if range.inside + range.outside == 0 then return {} end
      return { seen = range.outside, frame = range.frame, ok = range.outside == 0, worst = range.worst,
        values = range.inside + range.outside }
    end
  end
  return {}
end

-- Which sources a rule is about.
local function is_about(rule, group)
  if rule.source and group.source.name ~= rule.source then return false end
  local kind, message = rule.kind, group.message
  if kind == "crc" or kind == "incomplete" then return true end
  if kind == "unknown" then return group.counts.unknown.seen > 0 end
  if kind == "fault" then return message ~= nil and #message.alarms > 0 end
  if kind == "reboot" or kind == "stale" then return message ~= nil and message.time ~= nil end
  return message == rule.message
end

local function limit_of(rule)
  if rule.kind ~= "range" then return rule.limit end
  return rule.text:match("=(.*)$")
end

function Check:judge_rule(rule, list, last)
  local results, found = self.results, false
  for _, group in ipairs(list) do
    if is_about(rule, group) then
      local result = judge[rule.kind](rule, group, last)
      result.rule, result.group, found = rule, group, true
      results[#results + 1] = result
    end
  end
  if found then return end
  -- No unknown message is what the rule asks for, where there are messages.
  local ok = rule.kind == "unknown" and self.seen > 0 and (not rule.source or self:has_messages(rule.source)) or nil
  results[#results + 1] = { rule = rule, seen = ok and 0 or nil, ok = ok }
end

function Check:has_messages(source)
  for _, group in ipairs(self.groups.list) do
    if group.source.name == source then return true end
  end
  return false
end

-- What is printed -----------------------------------------------------------------------------------------------

local function line(result)
  local rule, source = result.rule, result.group and result.group.source or {}
  return json.object(KEYS, { rule = rule.text, source = source.name or rule.source, ok = result.ok,
    seen = result.seen, limit = limit_of(rule), frame = result.frame, bus = source.bus, id = source.id,
    message = source.message and source.message.name, worst = result.worst }) .. "\n"
end

local WORDS = { [true] = "ok", [false] = "FAILED" }

local function seen_text(result)
  local kind = result.rule.kind
  if result.ok == nil then
    local group = result.group
    return not group and "no message that it is about" or
      group.is_unsure and group.count > 0 and "what came before is not known" or "nothing to judge"
  end
  if kind == "rate" then return ("%.3f Hz"):format(result.seen) end
  if kind == "gap" then return ("%.6f s"):format(result.seen) end
  if kind ~= "range" then return tostring(result.seen) end
  if result.seen == 0 then return ("%d inside"):format(result.values) end
  return ("%d of %d outside, worst %s"):format(result.seen, result.values, text.number(result.worst) or "reserved")
end

local function name_of(source)
  return (source.bus and source.bus .. " " or "") .. text.id(source.id) .. (source.name and " " .. source.name or "")
end

local function print_table(self)
  local rows = {}
  for i, result in ipairs(self.results) do
    local source = result.group and result.group.source
    rows[i] = { WORDS[result.ok] or "NOT JUDGED", result.rule.text, source and source.bus,
      source and text.id(source.id), source and source.name or result.rule.source,
      source and (source.message and source.message.title or "unknown"),
      seen_text(result), result.frame }
  end
  self.context.out(text.table({ "check", "rule", "bus", "ID", "source", "message", "seen", ">frame" }, rows))
end

-- The cases of a test report: { name =, status = "ok", "failed" or "error", text = }.
local function cases(self)
  local list = {}
  for i, result in ipairs(self.results) do
    local where = result.group and " " .. name_of(result.group.source) or ""
    list[i] = { name = result.rule.text .. where,
      status = result.ok and "ok" or result.ok == false and "failed" or "error",
      text = seen_text(result) .. (result.frame and (", frame %d"):format(result.frame) or "") }
  end
  for _, problem in ipairs(self.options.problems) do
    list[#list + 1] = { name = problem, status = "error", text = problem }
  end
  return list
end

local function print_results(self, code)
  if self.options.json then
    for _, result in ipairs(self.results) do self.context.out(line(result)) end
    return
  end
  print_table(self)
  self.context.out(code == 0 and "\nYAPP check: all rules hold\n" or
    code == M.FAILED and "\nYAPP check: FAILED\n" or "\nYAPP check: not all of it could be judged\n")
end

--- last     { rel =, ... } of the last packet of any kind; nil where there was none
-- returns  the exit code: nil for 0, M.FAILED or M.UNJUDGED, and a text that says why where the table does not
function Check:finish(last)
  local options, problems = self.options, {}
  local list = self.groups:sorted()
  for _, rule in ipairs(self.rules) do self:judge_rule(rule, list, last) end
  local failed, unjudged = false, #options.problems > 0
  for _, result in ipairs(self.results) do
    failed, unjudged = failed or result.ok == false, unjudged or result.ok == nil
    local source = result.rule.source
    if source and not self.context.has_source(source) then
      problems[#problems + 1] = ("check: no source is called %s in the preference"):format(source)
    end
  end
  if not self.context.is_whole then
    unjudged, problems[#problems + 1] = true, "check: the catalogue did not load whole"
  end
  if options.junit then
    local ok, problem = junit.write(options.junit, cases(self))
    if not ok then unjudged, problems[#problems + 1] = true, "check: the report is not written: " .. problem end
  end
  local code = failed and M.FAILED or unjudged and M.UNJUDGED or 0
  print_results(self, code)
  return code > 0 and code or nil, problems[1] and table.concat(problems, "\n") or nil
end

return M
