-- SPDX-License-Identifier: GPL-2.0-or-later
-- The statistics' ear: makes events of the results of the reading.  Pure Lua, 5.2 to 5.5.
--
-- The values of a good message's event are kinds.NOTHING for most messages, else {
--   change         of message.history, or nil
--   invalid        list of values of `invalid` events, or nil
--   size           number of its bytes, if the catalogue does not decode all of them
--   undecoded      number of these bytes behind those that the catalogue has, or nil
--   is_unreliable  true if the past of the message is not known }
-- The values of a loss are { what = "incomplete", "orphan" or "overrun" }.

local can_id = require "yapp.wire.can_id"
local compiler = require "yapp.message.catalogue"
local field_kinds = require "yapp.message.field_kinds"
local kinds = require "yapp.stat.kinds"
local memo = require "yapp.base.memo"

local M = {}

local END = can_id.END

local LOSSES = {
  ["fragment.incomplete"] = { what = "incomplete" },
  ["fragment.orphan"] = { what = "orphan" },
  ["fragment.overrun"] = { what = "overrun" },
}
-- The kind of a message by its status.  A truncated message could not be checked.  A message of
-- another status makes no event: its anomalies do.
local KIND_OF = { good = "message", bad = "crc", truncated = "incomplete" }

local Intake = {}
Intake.__index = Intake

-- The state of a source.
local function new_state()
  return {
    orphan_seq = false, -- of the message that lost its Start, while its frames come
    unknown_seq = nil, -- the latest, see report_undissected
  }
end

--- Make an intake, which is closed.
-- catalogue  compiled
function M.new(catalogue)
  return setmetatable({
    catalogue = catalogue,
    queue = nil, -- a stat.queue, while it is open
    leaving = {}, -- taps, see Intake:remove_later
    states = nil, -- by source
    has_orphans = false, -- true if a state has had an orphan
    stretches = nil, -- by line: skipped bytes, while nothing else comes
  }, Intake)
end

--- Begin to hand on events.  Forget an earlier reading.
function Intake:open(queue)
  self.queue = queue
  self.states, self.stretches, self.has_orphans = memo(new_state), {}, false
end

--- Hand on no more events.
function Intake:close()
  self.queue = nil
end

--- Remove a tap when the next event of a message comes: a tap cannot go while it is called.
function Intake:remove_later(tap)
  table.insert(self.leaving, tap)
end

-- Return the event of a frame, or of the message that it ends.
local function new_event(kind, frame, values, message)
  return kinds.new_event(kind, frame.number, frame.time, frame.source, values, message or frame)
end

local function offer(self, kind, frame, values, message)
  local line, leaving = frame.source.line, self.leaving
  if self.stretches[line] then self.stretches[line] = nil end -- a needless nil costs in 5.2
  if leaving[1] then
    self.leaving = {}
    for _, tap in ipairs(leaving) do tap:remove() end
  end
  self.queue:offer(new_event(kind, frame, values, message), frame.visited)
end

-- Messages ----------------------------------------------------------------------------------------

-- The values of a message that the catalogue does not define; nil for none.
local function invalid_of(message)
  local of_type, list = message.source.type, nil
  for _, remark in ipairs(message.remarks) do
    local index, is_undefined = remark[1], remark[3]
    if is_undefined then
      local field, raw = of_type.fields[index], message.raws[index]
      local shape = field_kinds.BY_NAME[field.kind].code or "0x%02x" -- as the document has it
      list = list or {}
      list[#list + 1] = {
        field = field.name,
        value = raw,
        code = shape:format(raw),
        effect = remark[2] == "command.key.invalid" and " (the controller ignores this command)",
      }
    end
  end
  return list
end

local function values_of(message)
  local invalid = message.remarks[1] and invalid_of(message)
  local is_decoded = message.raws and not message.undecoded
  if is_decoded and not (message.change or invalid or message.is_unreliable) then
    return kinds.NOTHING
  end
  return {
    change = message.change or nil,
    invalid = invalid or nil,
    size = not is_decoded and #message.payload or nil,
    undecoded = message.undecoded or nil,
    is_unreliable = message.is_unreliable or nil,
  }
end

-- Report a message that has ended.
local function report_message(self, frame, message)
  local kind, values = KIND_OF[message.status], nil
  if not kind then return end
  if self.has_orphans then self.states[message.source].orphan_seq = false end
  if message.copy_of then return offer(self, "copies", frame, { of = message.copy_of }, message) end
  if kind == "message" then
    values = values_of(message)
  elseif kind == "incomplete" then
    values = LOSSES["fragment.incomplete"]
  end
  offer(self, kind, frame, values, message)
end

-- Losses ------------------------------------------------------------------------------------------

-- Return whether an orphan begins a loss.  The orphans in a row with one Seq No, up to an End, are
-- one lost message.
local function begins_loss(state, seq, is_end)
  local begins = state.orphan_seq ~= seq
  state.orphan_seq = not is_end and seq
  return begins
end

-- Report the anomalies of a frame.  Anomalies that lose a message, or a part of one, are events.
-- anomalies  list of { expert }
local function report_anomalies(self, frame, anomalies)
  local state, is_end = self.states[frame.source], frame.can_id and frame.can_id.ctrl == END
  for _, anomaly in ipairs(anomalies) do
    local values = LOSSES[anomaly.expert]
    local is_orphan = values and values.what == "orphan"
    if is_orphan then
      self.has_orphans = true
      if not begins_loss(state, frame.seq, is_end) then values = nil end
    elseif values then
      state.orphan_seq = false
    end
    if values then offer(self, "incomplete", frame, values) end
  end
end

-- Report bytes of a stream that belong to no frame.  Over several packets in a row they are one
-- stretch, and one event, whose length grows.
-- frame  its source is the line
local function report_skipped(self, frame, length)
  local line, key = frame.source, frame.key
  local stretch = self.stretches[line]
  if stretch and key > stretch.last_key then -- else the capture is read anew
    stretch.last_key = key
    stretch.values.length = stretch.values.length + length
    return
  end
  local values = { length = length }
  self.stretches[line] = { last_key = key, values = values }
  self.queue:offer(new_event("skipped", frame, values), frame.visited)
end

-- Report a frame that may be a message that is not dissected, or the Start of one.  It counts as
-- one if its ID is known, if a message of the catalogue has its size, or if its Seq No follows that
-- of the source's previous such frame.
local function report_undissected(self, frame, size)
  local state = self.states[frame.source]
  local seq, is_message = state.unknown_seq, frame.source.type
  if seq and (seq + 1) % 256 == frame.seq then is_message = true end
  is_message = is_message or compiler.of_size(self.catalogue.messages, size)[1]
  state.unknown_seq = frame.seq
  if is_message then
    self.queue:add_undissected(new_event("undissected", frame, { size = size }))
  end
end

--- Make the events of a result.
-- result  see reading.records
function Intake:report(result)
  local kind, message, anomalies = result.kind, result.message, result.anomalies
  if message then
    report_message(self, result.frame, message)
  elseif kind == "skipped" then
    report_skipped(self, result.frame, result.length)
  elseif kind == "undissected" then
    report_undissected(self, result.frame, result.length)
  end
  if anomalies then report_anomalies(self, result.frame, anomalies) end
end

--- Make the events of the results that still waited when all packets had come.
-- results  of Reading:finish
-- returns  the events of the messages that the capture ends before, in the order of their frames
function Intake:finish(results)
  local events = {}
  for _, result in ipairs(results) do
    if result.kind == "unfinished" then
      events[#events + 1] = new_event("unfinished", result.frame)
    else
      self:report(result)
    end
  end
  table.sort(events, function(a, b) return a.frame < b.frame end)
  return events
end

return M
