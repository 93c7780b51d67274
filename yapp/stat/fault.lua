-- SPDX-License-Identifier: GPL-2.0-or-later
-- -z yapp,fault: the card of one fault.  What changed in the ten seconds before it, the latest
-- Command, the other controllers, what was lost near it, and the messages around it.  It ranks
-- evidence and names no cause.  Pure Lua, 5.2 to 5.5.

local band = require "yapp.base.bits".band
local field_kinds = require "yapp.message.field_kinds"
local groups = require "yapp.stat.groups"
local input = require "yapp.base.input"
local joined = require "yapp.base.joined"
local kinds = require "yapp.stat.kinds"
local lists = require "yapp.stat.lists"
local mapped = require "yapp.base.mapped"
local memo = require "yapp.base.memo"
local output = require "yapp.stat.output"
local text_of = require "yapp.message.text"

local Fault = { follows_changes = true }
Fault.__index = Fault

local insert, abs = table.insert, math.abs
local unpack = rawget(table, "unpack")

local BEFORE_FAULT = 10 -- seconds, which tell what is usual
-- A value left its range if it is so many usual spreads from the median of the values before it.
local FACTOR = 4
local WINDOW, MIN_VALUES = 10, 5 -- of the values before it
-- The usual spread comes of the calm third of the ten seconds: a third of the distances are less
-- than this part of the standard deviation of usual noise.
local CALM = 0.43
local FEW = 5 -- values: from so many, the spread is only half as sure
local ALONE = 1.5 -- the last value, which no other confirms, must be so much farther
local ENOUGH = 0.8 -- of the largest distance: the way back from it is as large
local BEFORE, BEHIND = 10, 5 -- messages
local MISSING = "there is no such fault: the capture has %d"

-- The sections of a card: their name and title, the keys of a row in JSON, nil for its own, and the
-- columns for people.
local KEYS, COLUMNS = "since frame bus id source message values", "since frame who values"
local CHANGE = "since frame message field flag from to unit times"
local SECTIONS = input.rows("name title keys columns", {
  { "flags", "Flags", "since field flag help", "since flag help" },
  { "changes", "Left its range of the ten seconds before", CHANGE, CHANGE },
  { "command", "The latest Command", KEYS, COLUMNS },
  { "others", "The other controllers", KEYS, COLUMNS },
  { "events", "Events within a second", nil, "since frame who kind details" },
  { "messages", "The messages around it", KEYS, COLUMNS },
})
local ROWS = {
  { "incident", "integer", "the number of the fault, from 1" },
  { "incidents", "integer", "how many faults there are" },
  "time frame bus id source message active",
}
for _, section in ipairs(SECTIONS) do
  insert(ROWS, { section.name, "list",
    ("%s: `%s`"):format(section.title, section.keys or "as in `events`") })
  section.columns = output.columns({}, section.columns)
end
--- The columns, see output.columns.
Fault.COLUMNS = output.columns(ROWS, "time rel frame bus id source message active",
  "rel frame who active")

--- Make the statistic.
-- options  { number = of the fault, or nil; frame = of a packet, or nil: the fault that is set
--          in it, or the next one }
function Fault.new(options, context)
  return setmetatable({
    number = options.number or not options.frame and 1,
    frame = options.frame,
    is_first = not (options.number or options.frame), -- which need not exist
    context = context,
    count = 0, -- of faults
    cards = {}, -- by source: of its latest fault
    card = nil, -- that is asked for
    old = {}, -- with those of `new` the events of ten seconds, at least
    new = {},
    begun = 0, -- when `new` began
  }, Fault)
end

-- Gathering ---------------------------------------------------------------------------------------

-- Return the card of a fault, at its first event a new one.
local function card_of(self, event)
  local source, incident = event.source, event.values.incident
  local card = self.cards[source]
  if not card or card.incident ~= incident then
    self.count = self.count + 1
    card = {
      number = self.count,
      incident = incident,
      cause = event.cause, -- event of the first message with the fault
      flags = {}, -- events of the flags that rose
      last = nil, -- the latest event of one
      events = joined(self.old, self.new), -- and those behind the fault
      behind = 0, -- number of messages of the source behind it
    }
    self.cards[source] = card
  end
  return card
end

-- Keep an event behind a fault, if its card shows it.
local function keep(card, event)
  if event.kind ~= "message" then
    if kinds.is_near(event, card.cause) then insert(card.events, event) end
  elseif event.source == card.cause.source and card.behind < BEHIND then
    card.behind = card.behind + 1
    insert(card.events, event)
  end
end

-- Return whether cards show an event.
local function is_shown(event)
  local kind, row = event.kind, kinds.BY_NAME[event.kind]
  if not row then return event.raws end
  return event.time and kind ~= "unknown" and (kind == "copies" or not row.is_counted_only)
end

-- Choose the card that is asked for, if an event shows its fault.
local function choose(self, card, event)
  local frame = self.frame
  if card.number == self.number or frame and event.frame >= frame then
    self.card = self.card or card
  end
end

--- Add an event, see stat.answer.
function Fault:add_event(event)
  if not is_shown(event) then return end
  for _, card in pairs(self.card and { self.card } or self.cards) do keep(card, event) end
  local new, faults, card = self.new, event.faults, self.cards[event.source]
  if event.kind == "fault" then
    card = card_of(self, event)
    card.last = event
    if event.values.event == "raised" then insert(card.flags, event) end
    choose(self, card, event)
  elseif faults and card and card.incident == faults[1].incident then
    choose(self, card, event) -- not at the first message, which comes before its faults
  end
  if event.at - self.begun > BEFORE_FAULT then
    self.old, self.new, self.begun = new, {}, event.at
  end
  insert(self.new, event)
end

-- What changed ------------------------------------------------------------------------------------

-- Return how far each value is from the median of those before it, these medians, and the usual
-- spread of the values.
local function find_distances(values, field)
  local step = field.min and (field.max - field.min) / field.ordinary or field.scale or 0
  local distances, middles, calm = {}, {}, {}
  for i, value in ipairs(values) do
    local before = { unpack(values, math.max(1, i - WINDOW), i - 1) }
    local has_middle = before[MIN_VALUES]
    local middle = has_middle and groups.median(before) or value
    middles[i], distances[i] = middle, value == middle and 0 or abs(value - middle)
    if has_middle then insert(calm, distances[i]) end
  end
  table.sort(calm)
  local usual = (calm[math.ceil(#calm / 3)] or 0) / CALM
  return distances, middles, math.max(step, usual * (1 + FEW / math.max(1, #calm)))
end

-- Return the index of the value that left its range, with the next one or as the last one; the
-- usual value and the usual spread.  Nil if none did.
local function find_departure(values, field)
  local distances, middles, spread = find_distances(values, field)
  local limit, sizes, largest, last = FACTOR * spread, {}, 0, #values
  for i, distance in ipairs(distances) do
    sizes[i] = math.min(distance, distances[i + 1] or distance / ALONE)
    if i < last and sizes[i] > limit then largest = math.max(largest, sizes[i]) end
  end
  -- What changes with the fault itself matters only if nothing did before.
  for i, size in ipairs(sizes) do
    if size > limit and size >= ENOUGH * largest then
      local first = i
      while distances[first - 1] > limit do first = first - 1 end -- the first distance is 0
      return first, middles[first], spread
    end
  end
end

-- Return the index of the latest value that differs from the one before it, and that one; nil for
-- none.
local function find_switch(values)
  for i = #values, 2, -1 do
    if values[i] ~= values[i - 1] then return i, values[i - 1] end
  end
end

-- Make a row of an event.
local function new_row(card, event, row)
  row.since, row.frame = output.seconds(event.at - card.cause.at), event.frame
  row.since.text = row.since.short
  return row
end

-- Return the values of a field, or of one of its flags, as numbers.
local function values_of(messages, field, flag)
  local read = field_kinds.reader[field]
  return mapped(messages, function(event)
    local number = read(event.raws)
    if flag then return band(number, flag.mask) == 0 and 0 or 1 end
    return number == number and number or math.huge -- of a reserved value
  end)
end

-- Return a number as people read it.
local function shown(value, shape)
  return shape and { value = value, text = shape:format(value) } or value
end

-- Append the row of the change of a field, or of one of its flags, if there is one.
-- messages  events of its source up to the fault
-- find      function(values, field) -> index, usual value, and of a number the usual spread
local function add_change(rows, card, messages, field, find, flag)
  local values = values_of(messages, field, flag)
  local index, from, spread = find(values, field)
  if not index then return end
  local event, to = messages[index], values[index]
  local is_far_from_0 = spread and abs(from) > FACTOR * spread
  insert(rows, new_row(card, event, {
    message = event.source.type.name,
    field = field.name,
    flag = flag and flag.name,
    unit = field.unit,
    from = shown(from, field.rounded),
    to = shown(to, field.rounded),
    times = is_far_from_0 and shown(to / from, "%.2f") or nil,
    -- Of the changes in one message, the largest comes first.
    size = spread and abs(to - from) / spread or 0,
  }))
end

local function add_changes(rows, card, messages)
  for _, field in ipairs(messages[1].source.type.fields) do
    for _, flag in ipairs(field.flags or {}) do
      local is_fault = band(flag.mask, field.alarm_bits) ~= 0
      if not is_fault then add_change(rows, card, messages, field, find_switch, flag) end
    end
    local find = field.values and find_switch or field_kinds.is_number(field) and find_departure
    if find then add_change(rows, card, messages, field, find) end
  end
end

-- Output ------------------------------------------------------------------------------------------

-- Return whether two sources are of one controller: by their names, else by bus and last digit.
local function is_same_controller(a, b)
  if a.name and b.name then return a.name == b.name end
  return a.bus_key == b.bus_key and a.id % 16 == b.id % 16
end

local function message_row(card, event)
  local message_type, names, values = event.source.type, {}, {}
  for i, field in ipairs(message_type.fields) do
    local text = field_kinds.text(field, event.raws[field.index])
    names[i] = field.name
    values[field.name] = not field_kinds.BY_NAME[field.kind].is_text and tonumber(text) or text
  end
  local text, faults = message_type.info(event.raws), text_of.faults(message_type, event.raws)
  local row = output.row(event.source, {
    values = {
      json = output.object(names, values).json,
      text = faults == "" and text or "FAULT " .. faults .. "  " .. text,
    },
  })
  return new_row(card, event, row)
end

-- Return the messages of the Command before a fault: the controller's own, else the latest of its
-- bus.
local function find_command(source, all)
  local commands = mapped(all, function(messages)
    local other = messages[1].source
    local is_command = other.bus_key == source.bus_key and other.type.name == source.type.answers
    return is_command and messages
  end)
  output.sort(commands, function(messages)
    local latest = messages[#messages]
    return is_same_controller(latest.source, source) and 1 or 0, latest.frame
  end)
  return commands[#commands]
end

-- Add the rows about the sources before a fault.
-- all  lists of their messages
local function add_sources(row, card, all)
  local source, changes = card.cause.source, row.changes
  local command = find_command(source, all)
  for _, messages in ipairs(all) do
    local latest, count = messages[#messages], #changes
    local is_command = messages == command
    if is_command or is_same_controller(latest.source, source) then
      add_changes(changes, card, messages)
    elseif latest.source.type == source.type then
      insert(row.others, message_row(card, latest))
    end
    if is_command then
      local values = message_row(card, latest)
      if #changes == count then values.values.text = "unchanged  " .. values.values.text end
      insert(row.command, values)
    end
  end
  output.sort(changes, function(change) return change.frame, -change.size end)
end

-- Return the row of a card, with the rows of its sections.
local function row_of(self, card, ending)
  local cause, all = card.cause, {}
  local by_source = memo(nil, all) -- messages of the ten seconds before
  local row = output.row(cause.source, {
    incident = card.number,
    incidents = self.count,
    time = self.context.dates:value(cause.time),
    rel = output.seconds(cause.time),
    active = not ending.lacks_times and new_row(card, card.last, {}).since or nil,
    frame = cause.frame,
  })
  for _, section in ipairs(SECTIONS) do row[section.name] = {} end
  local function event_row(event)
    return new_row(card, event, lists.event_row(self.context, event, ending))
  end
  row.flags = mapped(card.flags, event_row)
  for _, event in ipairs(card.events) do
    if event.kind == "message" then
      local is_before = event.frame <= cause.frame and cause.at - event.at <= BEFORE_FAULT
      if is_before then insert(by_source[event.source], event) end
      if event.source == cause.source then insert(row.messages, message_row(card, event)) end
    elseif kinds.is_near(event, cause) and event.values.incident ~= card.incident then
      insert(row.events, event_row(event))
    end
  end
  while #row.messages > BEFORE + 1 + card.behind do table.remove(row.messages, 1) end
  add_sources(row, card, all)
  return row
end

-- Print a card.
local function print_card(context, title, row, notes)
  for _, section in ipairs(context.json and SECTIONS or {}) do
    row[section.name] = output.objects(section.keys, row[section.name])
  end
  output.print(context, title, Fault.COLUMNS, { row }, notes)
  for _, section in ipairs(context.json and {} or SECTIONS) do
    local list = row[section.name]
    context.out(("\n%s%s\n"):format(section.title, list[1] and ":" or ": none"))
    if list[1] then output.table(context, section.columns, list) end
  end
end

--- End, see stat.answer.
function Fault:finish(ending, notes)
  local context, card = self.context, self.card
  local count, code = lists.count_text(self.count, ending)
  if card then
    print_card(context, ("YAPP fault: %d of %s"):format(card.number, count),
      row_of(self, card, ending), notes)
    return code
  end
  local rows = context.json and { { incidents = self.count } } or {}
  output.print(context, "YAPP fault: " .. count, Fault.COLUMNS, rows, notes)
  if self.is_first then return code end
  return output.EXIT_UNDECIDED, MISSING:format(self.count)
end

return Fault
