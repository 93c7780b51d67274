-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,watch: the controllers while packets come, once a second: a table in place in a terminal,
-- a line of JSON in a pipe; at the end what `faults` prints.  Pure Lua, 5.2 to 5.5.
--
-- tshark calls nothing while no packet comes, so the table stands still then; the next packet says
-- for how long.

local buses = require "yapp.stat.buses"
local check = require "yapp.stat.check"
local judge = require "yapp.stat.judge"
local kinds = require "yapp.stat.kinds"
local lists = require "yapp.stat.lists"
local output = require "yapp.stat.output"
local summary = require "yapp.stat.summary"

local M = {}

local LAST_WIDE = "[\192-\255][\128-\191]*$" -- a last character beyond ASCII, maybe cut
local CLEAR, RED, NORMAL = "\27[H\27[J", "\27[31m", "\27[m"
local WIDE = 120 -- columns of a terminal that has room for all of the table
local TITLE, PAUSE = "YAPP watch: %s in %.1f s", ", no packet for %d s before that"
local MORE = "... %d more lines: make the window higher"
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
-- The table: a line for each source, which the terminal may cut.
local TABLE = output.columns({
  { "hz", title = "Hz" },
  { "age", title = "age/s" },
  { "limit", title = "nearest limit" },
}, "who message count hz age faults limit values", "who count hz age faults values limit")
local SOURCE_KEYS = table.concat(summary.COLUMNS.json, " ") ..
  " hz age faults latest_fault latest_fault_time"

local Watch = { follows_changes = true }
Watch.__index = Watch

--- Make the statistic.
-- options  { rules = of check; stop = "fault", "rule" or nil; bitrate = see stat.buses }
-- context  { terminal = function() -> its width, its height, true if a packet list scrolls there;
--          flush = function() -> nil if the output is closed; stop = function(), ends the run;
--          the rest for output.print, see stat.answer }
function M.new(options, context)
  return setmetatable({
    options = options,
    context = context,
    check = check.new(options, context),
    -- A terminal shows no ranges of values, a fourth of the work.
    summary = summary.new({ brief = not context.json }, context),
    faults = lists.new({ what = "faults" }, context),
    buses = buses.new(options, context),
    raised = {}, -- by source: event of the latest fault that was raised
    -- By source, at the latest tick with a message: { count, at = its time, hz }.
    before = {},
    must_stop = false, -- true if the next packet ends the run
    code = nil, -- the exit code, if `stop` ended it
    is_over = false, -- true if it ends
  }, Watch)
end

--- Add an event, see stat.answer.
function Watch:add_event(event)
  if self.options.rules[1] then self.check:add_event(event) end
  self.summary:add_event(event)
  if event.kind == "message" then return end
  self.faults:add_event(event)
  self.buses:add_event(event)
  if event.kind == "fault" and event.values.event == "raised" then
    self.raised[event.source] = event
    self.must_stop = self.options.stop == "fault"
  end
end

-- The state of a source ---------------------------------------------------------------------------

-- Return the rate since the latest tick: by the stamps of messages, as packets come in heaps; 0
-- two periods behind the last one.
local function rate_of(self, group, age)
  local count, at = group.count, group.last.at
  local before = self.before[group.source] or { count = 1, at = at - group.length, hz = 0 }
  local length, hz = kinds.span(before.at, at), before.hz
  if length > 0 then hz = (count - before.count) / length end
  self.before[group.source] = { count = count, at = at, hz = hz }
  return age * hz < 2 and hz or 0
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
end

-- Add the limit that the latest values are nearest to; return whether they are outside.
local function add_limit(self, row, group)
  local found = judge.latest(self.check.by_source[group.source].values, group.last.frame)
  if not found then return false end
  local is_outside = found.room < 0
  local shape = is_outside and "%s %.6g OUTSIDE %s" or "%s %.6g in %s"
  row.limit = shape:format(found.rule.field.name, found.value, found.rule.limit)
  return is_outside
end

-- Return the row of a source with good messages.
local function row_of(self, group, ending)
  local row, last, message_type = summary.row(group, ending), group.last, group.type
  local age, every = ending.length_since(last), message_type and message_type.every
  local is_silent = every and age > self.context.settings.late * every
  local hz = rate_of(self, group, age)
  row.values.text = last.raws and message_type.info(last.raws)
  row.hz = { value = tonumber(("%.4g"):format(hz)), text = ("%.1f"):format(hz) }
  row.age = output.seconds(age)
  row.age.text = row.age.short .. (is_silent and " SILENT" or "")
  add_faults(self, row, group)
  row.is_red = add_limit(self, row, group) or is_silent or last.faults
  return row
end

local function rows_of(self, ending)
  local rows = {}
  for _, group in ipairs(self.summary.list) do
    if group.last then rows[#rows + 1] = row_of(self, group, ending) end
  end
  output.sort(rows, function(row) return output.sortable(row.who) end)
  return rows
end

-- Output ------------------------------------------------------------------------------------------

-- Print the tables in as many lines and columns as the terminal has.
-- tables  a list of { columns, rows }; a row that is_red is red
local function print_tables(self, title, tables)
  local lines, width, height, has_list = { title }, self.context.terminal()
  for _, one in ipairs(tables) do
    local columns, rows, heading = one[1], one[2], #lines
    local function out(text)
      local row, line = rows[#lines - heading], text:sub(1, width)
      line = line:gsub(LAST_WIDE, ""):gsub("\n", "")
      lines[#lines + 1] = HAS_COLOR and row and row.is_red and RED .. line .. NORMAL or line
    end
    local shown = width < WIDE and columns.window or columns.text
    if rows[1] then output.table({ out = out }, { text = shown }, rows) end
  end
  local last = height - 1 -- the cursor is below it
  if #lines > last then lines[last] = MORE:format(#lines - last + 1) end
  if not has_list then self.context.out(CLEAR) end
  self.context.out(table.concat(lines, "\n", 1, math.min(#lines, last)) .. "\n")
end

-- Print how things stand; return whether a rule failed that no more packets can mend.
-- pause  seconds for which no packet came
local function print_state(self, ending, pause)
  local rows, bus_rows = rows_of(self, ending), self.buses:rows(ending)
  local rules, failed, has_failed = self.check:judge(ending), {}, false
  for _, row in ipairs(rules) do
    row.is_red = row.ok == check.FAILED
    if row.is_red then failed[#failed + 1] = row end
    has_failed = has_failed or row.is_final
  end
  if self.context.json then
    self.context.out(output.object(M.COLUMNS.json, {
      time = ending.last and self.context.dates:value(ending.last),
      sources = output.objects(SOURCE_KEYS, rows),
      rules = output.objects(check.COLUMNS.json, rules),
      buses = output.objects(buses.COLUMNS.json, bus_rows),
    }).json .. "\n")
  else
    local title = TITLE:format(output.count(#rows, "source"), ending.length)
    if pause > 1 then title = title .. PAUSE:format(pause) end
    print_tables(self, title, {
      { TABLE, rows },
      { check.COLUMNS, failed },
      { buses.COLUMNS, bus_rows },
    })
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
