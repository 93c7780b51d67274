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

function Counts:wants(message_type)
  return self.context.json and groups.numbers_of(message_type) or {}
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
    before = {}, -- by source: { count, time = of the latest message } at the latest tick
    must_stop = false, -- true if the next packet ends the run
    has_failed = false, -- true if `stop` ended it
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
  self.before[group.source] = { count = group.count, time = last.time }
  if not before then return groups.rate(group) end
  local count, length = group.count - before.count, kinds.span(before.time, last.time)
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

-- Return the lines of the table: its heading, and one for each row.
local function lines_of(rows)
  local lines = {}
  output.table({ out = function(line) lines[#lines + 1] = line:gsub("\n$", "") end }, TABLE, rows)
  return lines
end

local function bus_line(row)
  local load, errors = "", row.errors.text == "" and "no error frames" or row.errors.text
  if row.load then
    load = ("load %s, at most %s in 1 s, "):format(row.load.text, row.load_max.text)
  end
  return ("bus %s: %s%s"):format(row.bus or "", load, errors)
end

-- Return what stands below the table: the buses and the rules that failed.
local function footer_of(rules, bus_rows)
  local lines, failed = {}, {}
  for i, row in ipairs(bus_rows) do lines[i] = bus_line(row) end
  for _, row in ipairs(rules) do
    if row.ok == check.FAILED then failed[#failed + 1] = row.rule .. " " .. row.who end
  end
  if failed[1] then
    local count = ("%d of %d rules FAILED: "):format(#failed, #rules)
    lines[#lines + 1] = count .. table.concat(failed, ", ")
  end
  return lines
end

local function print_table(self, rows, rules, bus_rows, ending, pause)
  local terminal = self.context.terminal
  local width, height = terminal.size()
  local red, normal = RED, NORMAL
  if terminal.has_no_color then red, normal = "", "" end
  local sources = output.count(#rows, "source")
  local title = ("YAPP watch: %s in %.1f s"):format(sources, ending.last or 0)
  if pause > 1 then title = title .. (", no packet for %d s before that"):format(pause) end
  local all, footer = lines_of(rows), footer_of(rules, bus_rows)
  local lines = { cut(title, width) }
  local shown = math.max(math.min(#rows, height - 4 - #footer), 0)
  for i = 1, shown + 1 do
    local is_red = i > 1 and rows[i - 1].is_red
    local line = cut(all[i], width)
    lines[#lines + 1] = is_red and red .. line .. normal or line
  end
  if shown < #rows then
    lines[#lines + 1] = cut(("... %d more: make the window higher"):format(#rows - shown), width)
  end
  for _, line in ipairs(footer) do lines[#lines + 1] = cut(line, width) end
  local before = terminal.in_place() and CLEAR or ""
  self.context.out(before .. table.concat(lines, "\n") .. "\n")
end

-- Print how things stand; return the rows of the rules.
-- pause  seconds for which no packet came
local function print_state(self, ending, pause)
  local rows, bus_rows = rows_of(self, ending), self.buses:rows(ending)
  local rules = self.check and self.check:judge(ending) or kinds.NOTHING
  if not self.context.json then
    print_table(self, rows, rules, bus_rows, ending, pause)
  else
    print_json(self, rows, rules, bus_rows, ending)
  end
  return rules
end

-- Return whether a rule failed that no more packets can mend.
local function has_failed(rules)
  for _, row in ipairs(rules) do
    if row.ok == check.FAILED and row.is_final then return true end
  end
end

--- Print how things stand, once a second.
-- ending  see Run:finish
-- pause   seconds since the latest tick
function Watch:tick(ending, pause)
  if self.is_over then return end
  local rules = print_state(self, ending, pause)
  local is_read = self.context.flush() -- false if the pipe is closed
  self.has_failed = self.must_stop or self.options.stop == "rule" and has_failed(rules)
  self.is_over = self.has_failed or not is_read
  if self.is_over then self.context.stop() end
end

--- End, see stat.answer.
function Watch:finish(ending, notes)
  print_state(self, ending, 0)
  if not self.context.json then self.context.out("\n") end
  local code = self.faults:finish(ending, notes)
  return self.has_failed and output.EXIT_FAILED or code
end

return M
