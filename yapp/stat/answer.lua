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
local mapped = require "yapp.base.mapped"
local output = require "yapp.stat.output"
local undecoded = require "yapp.stat.undecoded"

local Answer = {}
Answer.__index = Answer

local NOTHING = kinds.NOTHING
local NO_LENGTHS = "%s: how long faults, gaps and silences lasted is not known"
local NO_COPIES = ", and a message that was recorded twice counts twice"
local STEPS = "time stamps went back %s: what lasted meanwhile seems too short"
local MANY_STEPS = ", and who is silent at the end is not known"
local LEFT_OUT = "changes of faults, reboots and gaps are unreliable and left out"
local UNRELIABLE = "nothing tells the buses of %s apart: " .. LEFT_OUT
local SHARED = "two controllers appear to send %s: from frame %d on " .. LEFT_OUT
local COPIED = " recorded twice; each counts once"
local HIDDEN = "damaged or lost messages may hide faults: "

--- Make the answer of a statistic.
-- run      a stat.run
-- options  see Run:add
function Answer.new(run, statistic, options)
  return setmetatable({
    run = run,
    statistic = statistic,
    options = options,
    matched = options.matched, -- of all packets: only the end shows which messages are unfinished
    undecoded = undecoded.new(run.settings),
    came = {}, -- sources with an event that counts
    latest = {}, -- by source: event of the latest message with a known past
    copies = 0, -- number of messages that were recorded once more, or several times
    originals = {}, -- [source] = frame key of the latest of them
    -- How often a fault may be hidden, by kind of event; false if the statistic does not say it.
    hiding = (options.rules.fault or options.row.looks_for_faults) and {},
    unreliable = {}, -- texts: whose history is unreliable; and by source
  }, Answer)
end

-- Return whether a message of a source may have a fault: an unknown message may.
local function may_have_faults(source)
  return not source.type or source.type.alarms[1]
end

-- Add the text on a source with an unreliable history, once.
local function add_unreliable(self, event)
  local source, texts, change = event.source, self.unreliable, event.values.change
  if texts[source] then return end
  local shape = change and change.shared and SHARED or UNRELIABLE
  texts[source] = true
  texts[#texts + 1] = shape:format(output.bus_and_id(source), event.frame)
end

local function add_message(self, event)
  local source, values = event.source, event.values
  if not event.raws or values.undecoded then
    self:count(kinds.new_follower("unknown", event,
      self.undecoded:count(source, #values.payload, values.undecoded)))
  end
  if values.is_unreliable then return add_unreliable(self, event) end
  self.latest[source] = event
end

-- A message that has copies counts once for all of them.
local function add_copy(self, event)
  local source, original = event.source, event.values.of
  if self.originals[source] ~= original then self.copies = self.copies + 1 end
  self.originals[source] = original
end

--- Count an event, whatever the filter says.
function Answer:count(event)
  local hiding, kind = self.hiding, event.kind
  if hiding and kind ~= "message" and may_have_faults(event.source) then
    hiding[kind] = (hiding[kind] or 0) + (event.values.count or 1)
  end
  self.statistic:add_event(event)
end

--- Count an event of a source, if the filter lets it count.  Only stat.buses filters a bus event.
function Answer:add(event)
  local matched, kind = self.matched, event.kind
  if matched and not matched[event.frame] then
    local row = kinds.BY_NAME[kind]
    if not (row and row.scope == "capture") or self.statistic.add_frame then return end
  end
  self.came[event.source] = true
  if kind == "message" then add_message(self, event) end
  if kind == "copies" then add_copy(self, event) end
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
local function count_active_faults(self, states)
  local list = mapped(states, function(state)
    local event = self.latest[state.source]
    return event and event.faults and event
  end)
  output.sort(list, function(event) return event.frame end)
  for _, event in ipairs(list) do
    for _, fault in ipairs(event.faults) do
      self:count(fault_event(event, fault, "active"))
    end
  end
end

local function count_absences(self, ending)
  local has_come = {} -- by row of yapp.sources
  for source in pairs(self.came) do has_come[source.row or source] = true end
  for _, row in ipairs(self.run.settings.sources.rows) do
    if row.type and not has_come[row] then
      self:count(kinds.new_event("absent", nil, ending.last, row))
    end
  end
end

-- Return how many messages gaps have room for, and how many of these are in silences.
local function count_missing(states)
  local missing, silent = 0, 0
  for _, state in ipairs(states) do
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
local function hidden_faults_text(self, states)
  local missing, silent = count_missing(self.matched and NOTHING or states) -- a filter makes gaps
  local texts = mapped(kinds.LIST, function(row)
    local count = row.hides and self.hiding[row.name]
    return count and count .. " " .. row.hides
  end)
  if missing > 0 then table.insert(texts, missing .. " missing by their period") end
  if silent > 0 then table.insert(texts, silent .. " of them in silences that are listed") end
  return texts[1] and HIDDEN .. table.concat(texts, ", ")
end

-- Return what time stamps do not tell: a text, nil for nothing.
local function times_text(ending)
  local steps, why = ending.run.steps, ending.lacks_times
  if why then return NO_LENGTHS:format(why) .. (ending.are_coarse and "" or NO_COPIES) end
  if steps == 0 then return nil end
  local is_end_known = steps == 1 or ending.run.turn > 0 and not ending.hides_end
  return STEPS:format(output.count(steps, "time")) .. (is_end_known and "" or MANY_STEPS)
end

-- Return the texts on all that the answer leaves out, and whether they make it undecided.
local function list_notes(self, ending)
  local statistic, reason, hint, copies = self.statistic, ending.reason, self.run.hint, self.copies
  if self.matched then
    hint = nil
    if not next(self.came) then reason = reason or "no message matches the filter" end
  end
  local unreliable = statistic.follows_changes and self.unreliable or NOTHING
  ending.is_unreliable = unreliable[1]
  local problems = statistic.lists_problems and NOTHING or ending.problems
  local copied = copies > 0 and output.were(copies, "message") .. COPIED
  local hidden = self.hiding and hidden_faults_text(self, ending.events.states)
  local notes = joined(problems, { reason or false, times_text(ending) }, self.undecoded:texts(),
    unreliable, { copied, hidden or false, hint })
  return notes, ending.problems[1] or unreliable[1]
end

--- End: all events have come.
-- ending   see Run:finish; these are set: sources = how many came, unknown = of how many of them
--          messages were not decoded, is_unreliable = true if the history of one is
-- returns  the exit code, nil for 0; a text to say, or nil; and a list of texts to say
function Answer:finish(ending)
  count_undissected(self, ending)
  count_active_faults(self, ending.events.states)
  count_absences(self, ending)
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

return Answer
