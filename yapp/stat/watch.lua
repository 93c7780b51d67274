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

local CLEAR, RED, NORMAL = "\27[H\27[J", "\27[31m", "\27[m"

local COLUMNS = output.columns {
  { "time", where = "json", help = "of the latest packet" },
  { "sources", type = "list", where = "json",
    help = "the keys of `summary`, `hz`, `age`, `faults`, the latest fault and its time" },
  { "rules", type = "list", where = "json", help = "the keys of `check`" },
  { "buses", type = "list", where = "json", help = "the keys of `buses`" },
}
--- The columns, see output.columns.
M.COLUMNS = COLUMNS
-- The table: a line for each source.
local TABLE = output.columns {
  { "who", where = "text" },
  { "message", where = "text" },
  { "count", where = "text" },
  { "hz", where = "text", title = "Hz" },
  { "age", where = "text", title = "age/s" },
  { "faults", where = "text" },
  { "limit", where = "text", title = "nearest limit" },
  { "values", where = "text" }, -- at last, as the terminal may cut it
}
local SOURCE_KEYS = output.words(table.concat(summary.COLUMNS.json, " ") .. " " ..
  "hz age faults latest_fault latest_fault_time")

-- Counts, and in JSON the ranges of values, as in `summary`.
local Counts = groups.class {}
local new_values = Counts.new_values

function Counts:new_values(message_type)
  return self.context.json and new_values(self, message_type) or {}
end

local Watch = { follows_changes = true }
Watch.__index = Watch

--- Make the statistic.
-- options  { rules = of check; stop = "fault", "rule" or nil; bitrate = see stat.buses }
-- context  { terminal = { width, height, in_place } or nil; stop = function(), ends the run; the
--          rest for output.print, see stat.answer }
function M.new(options, context)
  return setmetatable({
    options = options,
    context = context,
    counts = Counts.new(options, context),
    faults = lists.new({ what = "faults" }, context),
    buses = buses.new(options, context),
    check = options.rules[1] and check.new(options, context),
    raised = {}, -- by source: event of the latest fault that was raised
    before = {}, -- by source: { count, at = of the latest message } at the latest tick
    must_stop = false, -- true if the next packet ends the run
    code = nil, -- the exit code, if `stop` ended it
    is_over = false, -- true if it ends
  }, Watch)
end

--- Add an event, see stat.answer.
function Watch:add_event(event)
  self.counts:add_event(event)
  self.faults:add_event(event)
  self.buses:add_event(event)
  if self.check then self.check:add_event(event) end
  if event.kind == "fault" and event.values.event == "raised" then
    self.raised[event.source] = event
    self.must_stop = self.options.stop == "fault"
  end
end

--- Show the frames of a bus, see stat.buses.
function Watch:add_frame(...)
  self.buses:add_frame(...)
end

function Watch:add_yapp(...)
  self.buses:add_yapp(...)
end

-- The state of a source ---------------------------------------------------------------------------

-- Return the rate since the latest tick: by the stamps of messages, as packets come in heaps.
local function rate_of(self, group)
  local last = group.last
  local before = self.before[group.source]
  self.before[group.source] = { count = group.count, at = last.at }
  if not before then return groups.rate(group) end
  local count, length = group.count - before.count, kinds.span(before.at, last.at)
  return length > 0 and count / length or 0
end

-- Add the faults that are set to a row, and the latest one; people read this if none is set.
local function add_faults(self, row, group)
  local names, quoted, raised = {}, {}, self.raised[group.source]
  for i, fault in ipairs(group.last.faults or kinds.NOTHING) do
    names[i], quoted[i] = fault.flag.name, output.value(fault.flag.name)
  end
  local text = table.concat(names, ", ")
  if raised then
    row.latest_fault = raised.values.flag
    row.latest_fault_time = self.context.dates:value(raised.time)
  end
  if raised and not names[1] then
    local clock = row.latest_fault_time.text:match("(%d+:%d+:%d+)") or ""
    text = ("(%s at %s)"):format(row.latest_fault, clock)
  end
  row.faults = { json = "[" .. table.concat(quoted, ",") .. "]", text = text }
  row.has_faults = names[1] ~= nil
end

-- Return the text of the limit that the latest values are nearest to, and whether it is broken.
local function limit_of(self, source)
  local group = self.check and rawget(self.check.by_source, source)
  local found = group and judge.latest(group.values, group.last and group.last.frame)
  if not found then return "", false end
  local shape = found.share < 0 and "%s %.6g OUTSIDE %s" or "%s %.6g in %s"
  return shape:format(found.rule.field.name, found.value, found.rule.limit), found.share < 0
end

-- Return the row of a source with good messages; it has the keys of `summary`, too.
local function row_of(self, group, ending)
  local source, last, message_type = group.source, group.last, group.type
  local row = summary.row(group, ending)
  local age, every = ending.length_since(last), message_type and message_type.every
  local limit, is_outside = limit_of(self, source)
  local is_silent = every and age > self.context.settings.late * every
  local hz = rate_of(self, group)
  row.hz, row.age = hz and tonumber(("%.4g"):format(hz)), output.seconds(age)
  row.age.text = row.age.short .. (is_silent and " SILENT" or "")
  add_faults(self, row, group)
  row.values.text = last.raws and message_type.info(last.raws) or ""
  row.limit = limit
  row.is_red = is_silent or is_outside or row.has_faults
  row.order = output.sortable(row.who)
  return row
end

local function rows_of(self, ending)
  local rows = {}
  for _, group in ipairs(self.counts:sort()) do
    if group.last then rows[#rows + 1] = row_of(self, group, ending) end
  end
  output.sort(rows, function(row) return row.order end)
  return rows
end

-- Output ------------------------------------------------------------------------------------------

-- Return a list of rows with these keys as JSON.
local function list_of(rows, keys)
  local objects = {}
  for i, row in ipairs(rows) do objects[i] = output.object(keys, row) end
  return output.list(objects)
end

local function print_json(self, rows, rules, bus_rows, ending)
  self.context.out(output.object(COLUMNS.json, {
    time = ending.last and self.context.dates:value(ending.last),
    sources = list_of(rows, SOURCE_KEYS),
    rules = list_of(rules, check.COLUMNS.json),
    buses = list_of(bus_rows, buses.COLUMNS.json),
  }).json .. "\n")
end

-- Return the first characters of a text, which is UTF-8.
local function cut(text, width)
  local count = 0
  for from in text:gmatch("()[^\128-\191]") do
    if count == width then return text:sub(1, from - 1) end
    count = count + 1
  end
  return text
end

-- Append a table: its heading, and a line for each row, red where something is wrong.
local function append_table(lines, columns, rows, terminal, width)
  local index = 0
  local function add_line(text)
    local row, line = rows[index], cut(text:gsub("\n$", ""), width)
    if row and (row.is_red or row.ok) and not terminal.has_no_color then
      line = RED .. line .. NORMAL
    end
    lines[#lines + 1], index = line, index + 1
  end
  if rows[1] then output.table({ out = add_line }, columns, rows) end
end

local function print_tables(self, rows, failed, bus_rows, ending, pause)
  local terminal, lines = self.context.terminal, {}
  local width, height = terminal.size()
  local title = ("YAPP watch: %s in %.1f s"):format(output.count(#rows, "source"), ending.last or 0)
  if pause > 1 then title = title .. (", no packet for %d s before that"):format(pause) end
  lines[1] = cut(title, width)
  append_table(lines, TABLE, rows, terminal, width)
  append_table(lines, check.COLUMNS, failed, terminal, width)
  append_table(lines, buses.COLUMNS, bus_rows, terminal, width)
  local more = #lines - height + 1
  if more > 0 then
    lines[height - 1] = cut(("... %d more lines: make the window higher"):format(more + 1), width)
  end
  local text = table.concat(lines, "\n", 1, math.min(#lines, height - 1))
  self.context.out((terminal.in_place() and CLEAR or "") .. text .. "\n")
end

-- Print how things stand; return whether a rule failed that no more packets can mend.
-- pause  seconds for which no packet came
local function print_state(self, ending, pause)
  local rows, bus_rows = rows_of(self, ending), self.buses:rows(ending)
  local rules, failed = self.check and self.check:judge(ending) or kinds.NOTHING, {}
  local has_failed = false
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
