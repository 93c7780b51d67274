-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,fault: the card of one fault.  What changed in the ten seconds before it, the latest
-- Command, the other controllers, what was lost near it, and the messages around it.  It ranks
-- evidence and names no cause.  Pure Lua, 5.2 to 5.5.

local band = require "yapp.base.bits".band
local field_kinds = require "yapp.message.field_kinds"
local groups = require "yapp.stat.groups"
local joined = require "yapp.base.joined"
local kinds = require "yapp.stat.kinds"
local lists = require "yapp.stat.lists"
local memo = require "yapp.base.memo"
local output = require "yapp.stat.output"
local text_of = require "yapp.message.text"

local M = {}

local insert, abs = table.insert, math.abs
local KINDS, is_number = field_kinds.BY_NAME, field_kinds.is_number

local USUAL = 10 -- seconds before the fault, which tell what is usual
-- A value left its range if it is so many usual spreads from the median of the values before it.
local FACTOR = 4
local WINDOW, MIN_VALUES = 10, 5 -- of the values before it
-- The usual spread comes of the calm third of the ten seconds: a third of the distances are less
-- than this part of the standard deviation of usual noise.
local CALM = 0.43
local FEW = 5 -- values: from so many, the spread is only half as sure
local ALONE = 1.5 -- the last value, which no other confirms, must be so much farther
local ENOUGH = 0.8 -- of the largest distance: the way back from it is as large
local NEAR = 1 -- seconds before and behind the fault
local BEFORE, BEHIND = 10, 5 -- messages
local ON_OFF = { [0] = "off", "on" }
local NO_FAULT = "no fault is set in frame %d or behind it"
local NO_NUMBER = "there is no fault %d"

-- By key: title, columns for people, and keys of JSON.
local MESSAGE = "since frame bus id source message faults values"
local SECTIONS = {
  { "flags", "Flags", "since flag help", "since field flag help" },
  { "changes", "Left its range of the ten seconds before", "since frame what",
    "since frame message field flag unit from to times at_fault" },
  { "command", "The latest Command", "since frame what", MESSAGE },
  { "others", "The other controllers", "since frame who what", MESSAGE },
  { "events", "Events within a second", "since frame who kind details" },
  { "messages", "The messages around it", "since frame what", MESSAGE },
}
local TITLES = { since = "since/s", who = "source", kind = "event", what = "" }

local COLUMNS = {
  { "incident", type = "integer", help = "the number of the fault, from 1; null for none" },
  { "incidents", type = "integer", help = "how many faults the capture has" },
  { "time" },
  { "frame" },
  { "bus" },
  { "id" },
  { "source" },
  { "message" },
  { "active" },
}
for _, section in ipairs(SECTIONS) do
  local keys, shown = section[4], {}
  insert(COLUMNS, { section[1], type = "list",
    help = ("%s: `%s`"):format(section[2], keys or "as in `events`") })
  for i, name in ipairs(output.words(section[3])) do
    shown[i] = { name, where = "text window", title = TITLES[name] }
  end
  section.columns, section.keys = output.columns(shown), keys and output.words(keys)
end
--- The columns, see output.columns.
M.COLUMNS = output.columns(COLUMNS)

local Fault = { follows_changes = true }
Fault.__index = Fault

--- Make the statistic.
-- options  { number = of the fault, from 1, or nil; at = number of a packet: the fault that is set
--          in it, or the next one; or nil }
function M.new(options, context)
  local self = setmetatable({
    is_chosen = options.at or options.number,
    number = not options.at and (options.number or 1),
    at = options.at,
    context = context,
    count = 0, -- of faults
    cards = {}, -- by source: of its latest fault
    card = nil, -- that is asked for
    sources = {},
    messages = nil, -- by source: events of its messages of the latest ten seconds, at least one
    near = {}, -- the other events of the latest second
  }, Fault)
  self.messages = memo(function(source)
    insert(self.sources, source)
    return {}
  end)
  return self
end

-- Gathering ---------------------------------------------------------------------------------------

-- Append an event to a list that has the latest seconds.
local function append(list, event, seconds)
  insert(list, event)
  while event.time - list[1].time > seconds do table.remove(list, 1) end
end

local function new_card(self, event)
  local messages = {}
  for _, source in ipairs(self.sources) do messages[source] = joined(self.messages[source]) end
  self.count = self.count + 1
  return {
    number = self.count,
    incident = event.values.incident,
    cause = event.cause, -- event of the first message with the fault
    flags = {}, -- events of the flags that rose
    open = 0, -- how many of them are set
    last = nil, -- the latest event of one
    messages = messages, -- as they were at the fault
    behind = {}, -- those of the source behind it
    near = joined(self.near),
  }
end

-- Take the card of a source if a message with the fault is the one that is asked for.
local function choose(self, event)
  local card = self.cards[event.source]
  local is_asked = card and card.open > 0
    and (card.number == self.number or event.frame >= (self.at or math.huge))
  if is_asked and not self.card then self.card = card end
end

local function add_fault(self, event)
  local source, values = event.source, event.values
  local card = self.cards[source]
  if not card or card.incident ~= values.incident then card = new_card(self, event) end
  self.cards[source], card.last = card, event
  if values.event == "raised" then
    insert(card.flags, event)
    card.open = card.open + 1
  elseif values.event == "cleared" then
    card.open = card.open - 1
  end
  choose(self, event)
end

-- Return whether an event, or the silence that it begins, is within a second of a fault.
local function is_near(card, event)
  local time, at = event.time, card.cause.time
  local length = event.kind == "silence" and event.values.length.json or 0
  return time and time - NEAR <= at and at <= time + length + NEAR
end

local function add_message(self, event)
  local source, card = event.source, self.cards[event.source]
  append(self.messages[source], event, USUAL)
  if card and #card.behind < BEHIND then insert(card.behind, event) end
  choose(self, event)
end

--- Add an event, see stat.answer.
function Fault:add_event(event)
  local kind = event.kind
  if event.raws then return add_message(self, event) end
  if kind == "fault" then add_fault(self, event) end
  local row = kinds.BY_NAME[kind] or { is_counted_only = true }
  local is_shown = kind == "copies" or kind ~= "unknown" and not row.is_counted_only
  if not (event.time and is_shown) then return end
  append(self.near, event, NEAR)
  for _, card in pairs(self.cards) do
    if is_near(card, event) then insert(card.near, event) end
  end
end

-- What changed ------------------------------------------------------------------------------------

-- Return the distance of each value from the median of the values before it, that median, and the
-- usual spread.
-- values  numbers, NaN for reserved values
local function find_distances(values)
  local distances, middles, calm = {}, {}, {}
  for i, value in ipairs(values) do
    local before = {}
    for j = math.max(1, i - WINDOW), i - 1 do
      if values[j] == values[j] then insert(before, values[j]) end
    end
    distances[i] = 0
    if before[MIN_VALUES] then
      middles[i] = groups.median(before)
      distances[i] = value == value and abs(value - middles[i]) or math.huge
      insert(calm, distances[i])
    end
  end
  table.sort(calm)
  local count = #calm
  return distances, middles, (1 + FEW / count) * (calm[math.ceil(count / 3)] or 0) / CALM
end

-- Return the index of the value that left its range, with the next one or as the last one; the
-- usual value and the usual spread.  0 if none did.
-- step  the smallest difference of two numbers
local function find_departure(values, step)
  local distances, middles, spread = find_distances(values)
  local count, largest = #values, 0
  spread = math.max(spread, step)
  local limit = FACTOR * spread
  local function size_of(i)
    return math.min(distances[i], distances[i + 1] or distances[i] / ALONE)
  end
  for i = 1, count - 1 do largest = math.max(largest, size_of(i)) end
  -- What changes with the fault itself matters only if nothing did before.
  local least = largest > limit and ENOUGH * largest or 0
  for i = 1, count do
    if size_of(i) > limit and size_of(i) >= least then
      local first = i
      while distances[first - 1] > limit do first = first - 1 end -- the first distance is 0
      return first, middles[first], spread
    end
  end
  return 0
end

-- Return the index of the latest value that differs from the one before it, and that one; 0 for
-- none.
local function find_switch(values)
  for i = #values, 2, -1 do
    if values[i] ~= values[i - 1] then return i, values[i - 1] end
  end
  return 0
end

-- Return a value as people read it: "3346", "48.7", "0.35", "Speed Mode".
-- words  by value, of a code; nil of a number
local function value_text(value, words)
  if value ~= value then return "no number" end
  if words then return words[value] or ("%d"):format(value) end
  local size = abs(value)
  return ("%%.%df"):format(size >= 100 and 0 or size >= 10 and 1 or 2):format(value)
end

local function new_row(card, event, row)
  local seconds = output.seconds(math.floor((event.time - card.cause.time) * 1e9 + 0.5) / 1e9)
  row.since, row.frame = { json = seconds.json, text = seconds.short }, event.frame
  return row
end

-- Return the text of a change: "DC Current  18.9 -> 48.7 A (2.6 times), 54.7 at the fault".
local function change_text(row)
  local words, to = row.words, value_text(row.to, row.words)
  local text = ("%s  %s -> %s"):format(row.title, value_text(row.from, words), to)
  if row.unit and row.to == row.to then text = text .. " " .. row.unit end
  if (row.times or 0) >= 1.4 then text = ("%s (%.1f times)"):format(text, row.times) end
  local at_fault = value_text(row.at_fault, words)
  return at_fault == to and text or ("%s, %s at the fault"):format(text, at_fault)
end

-- Append the row of a change of a value, if there is one.
-- messages  of its source up to the fault
-- read      function(raw) -> the value, a number
-- find      function(values, step) -> index, usual value and spread
-- row       { title, words, flag }
local function add_change(rows, card, messages, field, read, find, row)
  local values, step = {}, field.min and (field.max - field.min) / field.ordinary
  for i, event in ipairs(messages) do values[i] = read(event.raws[field.index]) end
  local index, from, spread = find(values, step or field.scale or 0)
  local event, to = messages[index], values[index]
  if not event then return end
  if event.source ~= card.cause.source then
    row.title = event.source.type.title .. " " .. row.title
  end
  row.event, row.message = event, event.source.type.name
  row.field, row.unit = field.name, field.unit
  row.from, row.to, row.at_fault = from, to, values[#values]
  -- Not of a usual value that is about 0.
  row.times = spread and abs(from) > FACTOR * spread and to / from or nil
  -- Of the changes in one message, the largest comes first.
  row.size = spread and to == to and abs(to - from) / spread or 0
  row.what = change_text(row)
  insert(rows, new_row(card, event, row))
end

-- Add the changes of the values of a source before a fault.
local function add_changes(rows, card, source)
  local messages = card.messages[source]
  local function add(...) add_change(rows, card, messages, ...) end
  for _, field in ipairs(source.type.fields) do
    local words = field.values or KINDS[field.kind].words
    local function number_of(raw) return field_kinds.number(field, raw) end
    for _, flag in ipairs(field.flags or {}) do
      local function bit_of(raw) return band(raw or 0, flag.mask) == 0 and 0 or 1 end
      local title = field.title .. " " .. flag.name
      if band(flag.mask, field.alarm_bits) == 0 then
        add(field, bit_of, find_switch, { flag = flag.name, title = title, words = ON_OFF })
      end
    end
    if words or is_number(field) then
      local find = words and find_switch or find_departure
      add(field, number_of, find, { title = field.title, words = words })
    end
  end
end

-- Return whether two sources are of one controller: by their names, else by bus and last digit.
local function is_same_controller(a, b)
  if a.name and b.name then return a.name == b.name end
  return a.bus_key == b.bus_key and a.id % 16 == b.id % 16
end

-- Return the event of the latest Command before a fault: the controller's own, else its bus's.
local function find_command(card)
  local source, latest, found = card.cause.source, 0, nil
  for sender, messages in pairs(card.messages) do
    local event = messages[#messages]
    local is_command = sender.bus_key == source.bus_key and sender.type.name == source.type.answers
    local rank = is_same_controller(sender, source) and math.huge or event.frame
    if is_command and rank > latest then latest, found = rank, event end
  end
  return found
end

local function message_row(card, event)
  local message_type, names, values = event.source.type, {}, {}
  for i, field in ipairs(message_type.fields) do
    local text = field_kinds.text(field, event.raws[field.index])
    names[i] = field.name
    values[field.name] = not KINDS[field.kind].is_text and tonumber(text) or text
  end
  local faults = text_of.faults(message_type, event.raws)
  return new_row(card, event, output.row(event.source, {
    faults = faults:match(".+"),
    values = output.object(names, values),
    what = (faults .. "  " .. message_type.info(event.raws)):match("^ *(.*)"),
  }))
end

-- Return the rows of the changes before a fault, in the order of time.
-- sources  of the controller and of its Command
local function change_rows(card, sources)
  local all, rows = {}, {}
  for _, source in ipairs(sources) do add_changes(all, card, source) end
  for _, row in ipairs(all) do
    if card.cause.time - row.event.time <= USUAL then insert(rows, row) end
  end
  output.sort(rows, function(row) return row.event.time, -row.size end)
  return rows
end

local function command_row(card, command, changes)
  local row, note = message_row(card, command), "unchanged  "
  for _, change in ipairs(changes) do
    if change.event.source == command.source then note = "" end
  end
  row.what = note .. row.what
  return row
end

local function flag_rows(card)
  local rows = {}
  for i, event in ipairs(card.flags) do
    local values = event.values
    rows[i] = new_row(card, event,
      { field = values.field, flag = values.flag, help = values.help })
  end
  return rows
end

local function event_rows(self, card, ending)
  local rows = {}
  for _, event in ipairs(card.near) do
    if is_near(card, event) and event.values.incident ~= card.incident then
      insert(rows, new_row(card, event, lists.event_row(self.context, event, ending)))
    end
  end
  return rows
end

-- Return the rows of the sections, by key.
local function find_rows(self, card, ending)
  local command, own, others, around = find_command(card), {}, {}, {}
  local cause = card.cause
  for _, source in ipairs(self.sources) do
    local messages = card.messages[source]
    local event = messages and messages[#messages]
    if event and (event == command or is_same_controller(source, cause.source)) then
      insert(own, source)
    elseif event and source.type == cause.source.type then
      insert(others, message_row(card, event))
    end
  end
  local changes = change_rows(card, own)
  local messages = joined(card.messages[cause.source], card.behind)
  for i = math.max(1, #messages - #card.behind - BEFORE), #messages do
    insert(around, message_row(card, messages[i]))
  end
  return {
    flags = flag_rows(card),
    changes = changes,
    command = { command and command_row(card, command, changes) },
    others = others,
    events = event_rows(self, card, ending),
    messages = around,
  }
end

-- Print the sections of a card for people.
local function print_sections(context, row, rows)
  local shape = "\n%s, frame %d%s\n%s UTC, %s s after the start\n"
  context.out(shape:format(row.who, row.frame, row.duration, row.time.text, row.rel.short))
  for _, section in ipairs(SECTIONS) do
    local list = rows[section[1]]
    context.out(("\n%s%s\n"):format(section[2], list[1] and ":" or ": none"))
    if list[1] then output.table(context, section.columns, list) end
  end
end

-- Return the row of a card, with its sections in JSON.
local function card_row(self, card, rows, lacks_times)
  local cause = card.cause
  local active = not lacks_times and new_row(card, card.last, {}).since or nil
  local shape = card.open > 0 and ", still set after %s s" or ", for %s s"
  local row = {
    incident = card.number,
    time = self.context.dates:value(cause.time),
    rel = output.seconds(cause.time),
    frame = cause.frame,
    active = active,
    duration = active and shape:format(active.text) or "",
  }
  for _, section in ipairs(SECTIONS) do
    local objects = {}
    for i, one in ipairs(rows[section[1]]) do
      objects[i] = output.object(section.keys or one.keys, one)
    end
    row[section[1]] = output.list(objects)
  end
  return output.row(cause.source, row)
end

--- End, see stat.answer.
function Fault:finish(ending, notes)
  local context, card, row, rows = self.context, self.card, {}, {}
  local code = ending.unknown > 0 and output.EXIT_UNDECIDED or nil
  local count = lists.count_text(self.count, ending)
  local title = "YAPP fault: " .. count
  if card then
    rows = find_rows(self, card, ending)
    local names = {}
    for i, flag in ipairs(rows.flags) do names[i] = flag.flag end
    row = card_row(self, card, rows, ending.lacks_times)
    title = ("YAPP fault: %s (%d of %s)"):format(table.concat(names, ", "), card.number, count)
  end
  row.incidents = self.count
  output.print(context, title, M.COLUMNS, context.json and { row } or {}, notes)
  if card and not context.json then print_sections(context, row, rows) end
  if card or not self.is_chosen then return code end
  local missing = self.at and NO_FAULT:format(self.at) or NO_NUMBER:format(self.number)
  return output.EXIT_UNDECIDED, missing
end

return M
