-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,watch: the controllers while packets come, once a second: a table in place in a terminal,
-- a line of JSON in a pipe; at the end what `faults` prints.  Pure Lua, 5.2 to 5.5.
--
-- tshark calls nothing while no packet comes, so the table stands still then; the next packet says
-- for how long.

local buses = require "yapp.stat.buses"
local check = require "yapp.stat.check"
local groups = require "yapp.stat.groups"
local judge = require "yapp.stat.judge"
local kinds = require "yapp.stat.kinds"
local lists = require "yapp.stat.lists"
local output = require "yapp.stat.output"
local summary = require "yapp.stat.summary"

local M = {}

local LAST_WIDE = "[\192-\255][\128-\191]*$" -- a last character beyond ASCII, maybe cut
local CLEAR, RED, NORMAL = "\27[H\27[J", "\27[31m", "\27[m"
local HAS_COLOR = (os.getenv("NO_COLOR") or "") == ""

--- The columns, see output.columns.
M.COLUMNS = output.columns({
  { "time", "time", "of the latest packet" },
  {
    "sources",
    "list",
    "the keys of `summary`, `hz`, `age`, `faults`, the latest fault and its time",
  },
  { "rules", "list", "the keys of `check`" },
  { "buses", "list", "the keys of `buses`" },
}, "")
-- The table: a line for each source; the values at last, as the terminal may cut them.
local TABLE = output.columns({
  { "hz", title = "Hz" },
  { "age", title = "age/s" },
  { "limit", title = "nearest limit" },
}, "who message count hz age faults limit values")
local SOURCE_KEYS = table.concat(summary.COLUMNS.json, " ") ..
  " hz age faults latest_fault latest_fault_time"

local Watch = { follows_changes = true }
Watch.__index = Watch

--- Make the statistic.
-- options  { rules = of check; stop = "fault", "rule" or nil; bitrate = see stat.buses }
-- context  { terminal = { size, in_place } or nil; stop = function(), ends the run; the
--          rest for output.print, see stat.answer }
function M.new(options, context)
  return setmetatable({
    options = options,
    context = context,
    check = check.new(options, context),
    summary = summary.new(options, context),
    faults = lists.new({ what = "faults" }, context),
    buses = buses.new(options, context),
    raised = {}, -- by source: event of the latest fault that was raised; of a message the first
    before = {}, -- by source: { count, at = of the latest message } at the latest tick
    must_stop = false, -- true if the next packet ends the run
    code = nil, -- the exit code, if `stop` ended it
    is_over = false, -- true if it ends
  }, Watch)
end

--- Add an event, see stat.answer.
function Watch:add_event(event)
  self.check:add_event(event)
  self.summary:add_event(event)
  if event.kind == "message" then return end
  self.faults:add_event(event)
  self.buses:add_event(event)
  if event.kind == "fault" and event.values.event == "raised" then
    local latest = self.raised[event.source]
    if not (latest and latest.frame == event.frame) then self.raised[event.source] = event end
    self.must_stop = self.options.stop == "fault"
  end
end

-- The state of a source ---------------------------------------------------------------------------

-- Return the rate since the latest tick: by the stamps of messages, as packets come in heaps.
local function rate_of(self, group)
  local count, at, before = group.count, group.last.at, self.before[group.source]
  self.before[group.source] = { count = count, at = at }
  if not before then return groups.rate(group) end
  local length = kinds.span(before.at, at)
  return length > 0 and (count - before.count) / length or 0
end

-- Add the faults that are set to a row, and the latest one; people read this if none is set.
local function add_faults(self, row, group)
  local names, raised = {}, self.raised[group.source]
  for i, fault in ipairs(group.last.faults or kinds.NOTHING) do names[i] = fault.flag.name end
  row.faults = { json = output.list(names).json, text = table.concat(names, ", ") }
  if raised then
    local time = self.context.dates:value(raised.time)
    row.latest_fault, row.latest_fault_time = raised.values.flag, time
    if not names[1] then
      row.faults.text = ("(%s at %s)"):format(row.latest_fault, time.text:sub(12, 19))
    end
  end
  return names[1] ~= nil
end

-- Add the limit that the latest values are nearest to; return whether they are outside.
local function add_limit(self, row, group)
  local found = judge.latest(self.check.by_source[group.source].values, group.last.frame)
  if not found then return false end
  local is_outside = found.share < 0
  local shape = is_outside and "%s %.6g OUTSIDE %s" or "%s %.6g in %s"
  row.limit = shape:format(found.rule.field.name, found.value, found.rule.limit)
  return is_outside
end

-- Return the row of a source with good messages.
local function row_of(self, group, ending)
  local row, last, message_type = summary.row(group, ending), group.last, group.type
  local age, every = ending.length_since(last), message_type and message_type.every
  local is_silent = every and age > self.context.settings.late * every
  local hz = rate_of(self, group)
  row.values.text = last.raws and message_type.info(last.raws)
  row.hz = hz and { value = tonumber(("%.4g"):format(hz)), text = ("%.1f"):format(hz) }
  row.age = output.seconds(age)
  row.age.text = row.age.short .. (is_silent and " SILENT" or "")
  local has_faults, is_outside = add_faults(self, row, group), add_limit(self, row, group)
  row.is_red = is_silent or has_faults or is_outside
  return row
end

local function rows_of(self, ending)
  local rows = {}
  for _, group in ipairs(self.summary:sort()) do
    if group.last then rows[#rows + 1] = row_of(self, group, ending) end
  end
  output.sort(rows, function(row) return output.sortable(row.who) end)
  return rows
end

-- Output ------------------------------------------------------------------------------------------

local function print_json(self, rows, rules, bus_rows, ending)
  self.context.out(output.object(M.COLUMNS.json, {
    time = ending.last and self.context.dates:value(ending.last),
    sources = output.objects(SOURCE_KEYS, rows),
    rules = output.objects(check.COLUMNS.json, rules),
    buses = output.objects(buses.COLUMNS.json, bus_rows),
  }).json .. "\n")
end

-- Print the tables in as many lines and columns as the terminal has; a row is red where something
-- is wrong.
local function print_tables(self, rows, failed, bus_rows, ending, pause)
  local terminal, lines = self.context.terminal, {}
  local width, height = terminal.size()
  local function add_line(text, is_red)
    local line = #text > width and text:sub(1, width):gsub(LAST_WIDE, "") or text
    lines[#lines + 1] = is_red and HAS_COLOR and RED .. line .. NORMAL or line
  end
  local function add_table(columns, list)
    local index = 0 -- of the row; 0 is the heading
    local function out(text)
      local row = list[index]
      add_line(text:gsub("\n$", ""), row and (row.is_red or row.ok))
      index = index + 1
    end
    if list[1] then output.table({ out = out }, columns, list) end
  end
  local title = ("YAPP watch: %s in %.1f s"):format(output.count(#rows, "source"), ending.last or 0)
  if pause > 1 then title = title .. (", no packet for %d s before that"):format(pause) end
  add_line(title)
  add_table(TABLE, rows)
  add_table(check.COLUMNS, failed)
  add_table(buses.COLUMNS, bus_rows)
  local more = #lines - height + 2
  if more > 1 then
    for _ = 1, more do table.remove(lines) end
    add_line(("... %d more lines: make the window higher"):format(more))
  end
  self.context.out((terminal.in_place() and CLEAR or "") .. table.concat(lines, "\n") .. "\n")
end

-- Print how things stand; return whether a rule failed that no more packets can mend.
-- pause  seconds for which no packet came
local function print_state(self, ending, pause)
  local rows, bus_rows = rows_of(self, ending), self.buses:rows(ending)
  local rules, failed, has_failed = self.check:judge(ending), {}, false
  for _, row in ipairs(rules) do
    if row.ok == check.FAILED then
      failed[#failed + 1] = row
      has_failed = has_failed or row.is_final
    end
  end
  if self.context.json then
    print_json(self, rows, rules, bus_rows, ending)
  else
    print_tables(self, rows, failed, bus_rows, ending, pause)
  end
  return has_failed
end

--- Print how things stand, once a second.
-- ending  see Run:finish
-- pause   seconds since the latest tick
function Watch:tick(ending, pause)
  if self.is_over then return end
  local has_failed = print_state(self, ending, pause)
  if self.must_stop or has_failed and self.options.stop == "rule" then
    self.code = output.EXIT_FAILED
  end
  self.is_over = self.code or not self.context.flush() -- that fails if the pipe is closed
  if self.is_over then self.context.stop() end
end

--- End, see stat.answer.
function Watch:finish(ending, notes)
  print_state(self, ending, 0)
  if not self.context.json then self.context.out("\n") end
  local code = self.faults:finish(ending, notes)
  return self.code or code
end

return M
