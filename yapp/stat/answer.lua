-- SPDX-License-Identifier: GPL-2.0-or-later
-- One statistic of a run: hands it the events that its filter lets count, and works out what its
-- answer leaves out.  Pure Lua, 5.2 to 5.5.
--
-- A statistic has
--   add_event(event)        of each event that counts; event.cause = the event of the message that
--                           shows it, if it is not that itself
--   finish(ending, notes)   returns the exit code and a text, each nil for none: ending = see
--                           Answer:finish; notes = texts on all that its answer leaves out
--   follows_changes         true if it shows changes since the message before
--   lists_problems          true if it lists ending.problems itself

local fault_event = require("yapp.stat.events").fault_event
local joined = require "yapp.base.joined"
local kinds = require "yapp.stat.kinds"
local number_of = require("yapp.base.frame_key").number
local output = require "yapp.stat.output"
local undecoded = require "yapp.stat.undecoded"

local M = {}

local NOTHING = kinds.NOTHING
local NO_SPANS = "how long faults, gaps and silences lasted is not known"
local NO_COPIES = ", and a message that was recorded twice counts twice"
local EQUAL_STAMPS = "time stamps of %s stand still or go back: " .. NO_SPANS .. NO_COPIES
local STEPS = "time stamps went back %s: what lasted meanwhile seems too short"
local MANY_STEPS = ", and who is silent at the end is not known"
local LEFT_OUT = "changes of faults, reboots and gaps are unreliable and left out"
local UNRELIABLE = "nothing tells the buses of %s apart: " .. LEFT_OUT
local SHARED = "two controllers appear to send %s: from frame %d on " .. LEFT_OUT
local SHARED_BEFORE = "; its reboots, jumps and silences are left out from frame %d on"

local Answer = {}
Answer.__index = Answer

--- Make the answer of a statistic.
-- settings  see stat.taps
-- options   of stat.options
function M.new(settings, statistic, options)
  return setmetatable({
    settings = settings,
    statistic = statistic,
    options = options,
    -- A set of the numbers of packets that the filter lets count, nil without one: a tap fills it.
    -- It keeps all packets, as only the end shows which messages are unfinished.
    matched = options.filter and {},
    undecoded = undecoded.new(settings),
    came = {}, -- sources with an event that counts
    latest = {}, -- by source: event of the latest message with a known past
    copies = 0, -- number of messages that were recorded once more, or several times
    originals = {}, -- [source] = frame key of the latest of them
    -- How often a fault may be hidden, by kind of event; nil if the statistic does not say it.
    hiding = (options.rules.fault or options.row.looks_for_faults) and {} or nil,
    unreliable = {}, -- texts: whose history is unreliable; and by source
    equal_stamps = {}, -- texts: whose stamps stand still; and by source
  }, Answer)
end

-- Return whether a message of a source may have a fault: an unknown message may.
local function may_have_faults(source)
  return not source.type or source.type.alarms[1] ~= nil
end

-- Add a text about a source to a list, once.
local function add_text(list, source, shape, ...)
  if list[source] then return end
  list[source], list[#list + 1] = true, shape:format(output.bus_and_id(source), ...)
end

local function add_message(self, event)
  local source, values = event.source, event.values
  if values == NOTHING then
    self.latest[source] = event
    return
  end
  if values.size then
    local unknown = self.undecoded:count(source, values.size, values.undecoded)
    self:count(kinds.new_follower("unknown", event, unknown))
  end
  if not values.is_unreliable then
    self.latest[source] = event
    return
  end
  local shared = values.change and values.change.shared
  local since = shared and number_of(shared) or event.frame
  local shape = since < event.frame and SHARED .. SHARED_BEFORE or shared and SHARED or UNRELIABLE
  add_text(self.unreliable, source, shape, event.frame, since)
end

-- What else events of some kinds do.
local on_kind = { message = add_message }

-- A message that has copies counts once for all of them.
function on_kind.copies(self, event)
  local source, original = event.source, event.values.of
  if self.originals[source] ~= original then self.copies = self.copies + 1 end
  self.originals[source] = original
end

function on_kind.fault(self, event)
  if event.values.event == "raised" or event.values.active then return end
  add_text(self.equal_stamps, event.source, EQUAL_STAMPS)
end

--- Count an event, whatever the filter says.
function Answer:count(event)
  local hiding, kind = self.hiding, event.kind
  if hiding and kind ~= "message" and may_have_faults(event.source) then
    hiding[kind] = (hiding[kind] or 0) + (event.values.count or 1)
  end
  self.statistic:add_event(event)
end

--- Count an event of a source, if the filter lets it count.
function Answer:add(event)
  local matched, call = self.matched, on_kind[event.kind]
  if matched and not matched[event.frame] then return end
  self.came[event.source] = true
  if call then call(self, event) end
  self:count(event)
end

-- The end -----------------------------------------------------------------------------------------

-- Possible messages that are not dissected.  If other messages came, they are `unknown` events.
local function count_undissected(self, ending)
  for _, event in ipairs(ending.events.undissected) do
    if not self.matched or self.matched[event.frame] then
      local values = self.undecoded:count(event.source, event.values.size)
      if not ending.reason then self:count(kinds.new_follower("unknown", event, values)) end
    end
  end
end

-- The faults that are still set at the last message of their source that counts.
local function count_active_faults(self, events)
  local list = {}
  for _, state in ipairs(events.states) do
    local event = self.latest[state.source]
    if event and event.faults then list[#list + 1] = event end
  end
  output.sort(list, function(event) return event.frame end)
  for _, event in ipairs(list) do
    for _, fault in ipairs(event.faults) do
      self:count(fault_event(event, fault, "active"))
    end
  end
end

local function has_come(self, row)
  for source in pairs(self.came) do
    if source.row == row then return true end
  end
end

local function count_absences(self, ending)
  for _, row in ipairs(self.settings.sources.rows) do
    if row.type and not has_come(self, row) then
      self:count(kinds.new_event("absent", nil, ending.last, row))
    end
  end
end

-- When the capture's clock was set forward.
local function count_sets(self, ending)
  for _, set in ipairs(ending.sets) do
    local length = output.seconds(set.length)
    local values = { length = length, step = "was set forward", size = length }
    self:count(kinds.new_event("clock", number_of(set.key), set.to, {}, values))
  end
end

-- The packets that were lost while capturing.
local function count_drops(self, ending)
  for _, drop in ipairs(ending.drops) do
    local time = drop.time and math.floor((drop.time - ending.begin) * 1e6 + 0.5) / 1e6
    local values = { count = drop.count }
    self:count(kinds.new_event("dropped", drop.frame, time, { bus = drop.bus }, values))
  end
end

-- Return how many messages gaps have room for, and how many of these are in silences.
local function count_missing(events)
  local missing, silent = 0, 0
  for _, state in ipairs(events.states) do
    if may_have_faults(state.source) then
      missing = missing + state.room_at_end
      if not state.is_numbered then
        missing, silent = missing + state.room, silent + state.room_silent
      end
    end
  end
  return missing, silent
end

-- Return a text: how many damaged or lost messages may have had a fault; nil for none.
local function hidden_faults_text(self, events)
  local texts, missing, silent = {}, 0, 0
  if not self.matched then missing, silent = count_missing(events) end
  for _, row in ipairs(kinds.LIST) do
    local count = row.hides and self.hiding[row.name]
    if count then texts[#texts + 1] = ("%d %s"):format(count, row.hides) end
  end
  if missing > 0 then texts[#texts + 1] = ("%d missing by their period"):format(missing) end
  if silent > 0 then
    texts[#texts + 1] = ("%d of them in silences that are listed"):format(silent)
  end
  return texts[1] and "damaged or lost messages may hide faults: " .. table.concat(texts, ", ")
end

-- Return how many messages were recorded twice, a text; nil for none.
local function copies_text(count)
  if count == 0 then return nil end
  return output.were(count, "message") .. " recorded twice; each counts once"
end

-- Return what time stamps do not tell: a list of texts.
local function time_notes(self, ending)
  if ending.lacks_times then
    local rest = ending.are_coarse and "" or NO_COPIES
    return { ending.lacks_times .. ": " .. NO_SPANS .. rest }
  end
  local steps, texts = ending.steps, {}
  if steps > 0 then texts[1] = STEPS:format(output.count(steps, "time")) end
  if steps > 1 then texts[1] = texts[1] .. MANY_STEPS end
  return joined(texts, self.equal_stamps)
end

-- Return the texts on all that the answer leaves out, and whether they make it undecided.
local function list_notes(self, ending)
  local reason, matched = ending.reason, self.matched
  if matched and not next(self.came) then reason = reason or "no message matches the filter" end
  local unreliable = self.statistic.follows_changes and self.unreliable or NOTHING
  local problems = self.statistic.lists_problems and NOTHING or ending.problems
  local notes = joined(problems, { reason }, time_notes(self, ending), self.undecoded:texts(),
    unreliable, { copies_text(self.copies) })
  if self.hiding then notes[#notes + 1] = hidden_faults_text(self, ending.events) end
  if not matched then notes[#notes + 1] = ending.hint end
  return notes, ending.problems[1] ~= nil or unreliable[1] ~= nil
end

--- End: all events have come.
-- ending   see Run:finish; its sources and unknown are set: how many sources came, and of how many
--          of them messages were not decoded
-- returns  the exit code, nil for 0; a text to say, or nil; and a list of texts to say
function Answer:finish(ending)
  count_undissected(self, ending)
  count_active_faults(self, ending.events)
  count_absences(self, ending)
  count_drops(self, ending)
  count_sets(self, ending)
  ending.sources, ending.unknown = 0, self.undecoded:count_sources(self.came)
  for source in pairs(self.came) do
    if source.id then ending.sources = ending.sources + 1 end
  end
  local notes, is_undecided = list_notes(self, ending)
  local code, text = self.statistic:finish(ending, notes)
  if is_undecided then return code or output.EXIT_UNDECIDED, text, notes end
  local has_no_notes = self.options.json or self.options.row.table_only
  return code, text, has_no_notes and notes or NOTHING
end

return M
