-- SPDX-License-Identifier: GPL-2.0-or-later
-- What carriers tell the statistics, and what kind of thing each of it is.  Pure Lua, 5.2 to 5.5.
--
-- A record is what is told of a message or of a loss: {
--   kind     "message" (good: its CRC is, or it is a single frame), "crc", "incomplete",
--            "unfinished", "skipped"
--   frame    number of the frame that shows it: a message's last; of a loss where it is noticed
--   rel      its time: seconds since the first packet
--   source   { key = of bus or stream and ID, bus_key, bus = its name or nil, name = that the user
--            gave it or nil, id =, message = compiled or nil }: one table for all its records
--   seq, payload, fits = whether the message of the catalogue takes the payload
--   change   of message.history, or nil; is_unsure = whether it is not known what came before
--   invalid  list of { field = name, value = raw } of what the catalogue does not define, or nil
--   what     of "incomplete": "incomplete", "orphan" or "overrun"; lost = the message, a table that
--            all its losses have, or nil; fault = { void = whether nothing is lost after all }
--   length   of "skipped": bytes, which grow while packets of the stream have nothing else; and
--            last_frame }
--
-- An event is what a statistic lists or counts, made of records by Kinds: { kind = one of KINDS,
-- rel, frame, source, record = which shows it, values = by the keys of its kind }.

local band = require("yapp.base.bits").band
local decode = require("yapp.message.decode")
local output = require("yapp.stat.output")

local M = {}

local LOST = {
  ["fragment.incomplete"] = "incomplete", ["fragment.orphan"] = "orphan",
  ["fragment.overrun"] = "overrun",
  truncated = "incomplete", -- by the capture: what was not decoded was not checked
}
-- What a message without a good CRC is, by its status; of the others nothing is told.
local KIND_OF = { bad = "crc", unverified = "incomplete", single = "incomplete" }
local DEFINED = { ["value.special"] = true, ["fault.active"] = true } -- remarks on what is defined
local NOTHING = {}

--- The kinds of events: { [name] = {
--   text        what people read, with {key} for the value of a key; nil where it is no event of a
--               list
--   keys        of JSON, besides those that all events have
--   counts_as   the kind that it is for rules, where it has none of its own
--   about       what a message of the catalogue has whose sources a rule is about; nil for every
--               source that has an ID
--   needs_past  whether it shows in good messages only, where it is known what came before
--   is_rare     whether a rule is about the sources that have it, and holds where none has } }
M.KINDS = {
  fault = {
    text = "{flag} {event}",
    keys = "field flag event active",
    about = "alarms",
    needs_past = true,
  },
  crc = { text = "bad CRC" },
  incomplete = { text = "{what}", keys = "what" },
  unfinished = { text = "the capture ends before it", counts_as = "incomplete" },
  reboot = { text = "the controller's time went back", about = "time", needs_past = true },
  stale = { text = "the controller's time stood still", about = "time", needs_past = true },
  silence = {
    text = "nothing for {length} s",
    keys = "length",
    about = "every",
    needs_past = true,
  },
  invalid = {
    text = "{field} has {value}, which is not defined",
    keys = "field value",
    about = "fields",
  },
  absent = { text = "no message of it came" },
  unknown = { is_rare = true },
  skipped = { text = "{length} bytes of no frame", keys = "length", is_rare = true },
}

local Tell = {}
Tell.__index = Tell

--- stat    a stat.taps
-- reader  a message.reader
function M.new(stat, reader)
  local self = setmetatable({ stat = stat, reader = reader }, Tell)
  self:reset()
  return self
end

--- Forgets the capture file.
function Tell:reset()
  self.sources = {}
  self.stretches = {} -- by stream: the record of skipped bytes, while nothing else comes
end

local function source_of(self, m)
  local source = self.sources[m.source]
  if not source then
    source = {
      key = m.source, bus_key = m.bus, bus = m.bus_name, id = m.id,
      name = m.id and self.reader:name_of(m.id, m.bus_name),
      message = m.id and self.reader:message_of(m.id, m.bus_name),
      parts = {}, -- by Seq: see Tell:part
      orphan = false, -- or { seq }: the message that lost its Start, while its frames come
    }
    self.sources[m.source] = source
  end
  return source
end

-- All eight names at once: Lua's table of eight is half of one that grows to nine.
local function record_of(self, kind, m)
  return {
    kind = kind,
    frame = m.frame,
    rel = m.time,
    source = source_of(self, m),
    seq = m.seq,
    payload = m.payload,
    fits = m.raws ~= nil,
    change = m.change,
  }
end

local function offer(self, record, m)
  local stream = m.stream or false
  if self.stretches[stream] then self.stretches[stream] = nil end -- in Lua 5.2 costly if it is nil
  self.stat:offer(record, m.visited)
end

local function invalid_of(m)
  local list
  for _, remark in ipairs(decode.remarks(m.message, m.raws) or NOTHING) do
    local index, expert = remark[1], remark[2]
    if not DEFINED[expert] then
      list = list or {}
      list[#list + 1] = { field = m.message.fields[index].name, value = m.raws[index] }
    end
  end
  return list
end

--- A finished message, read.
-- m  of message.reader, as read; stream = key of its stream, nil on CAN
function Tell:message(m)
  local kind = m.good and "message" or KIND_OF[m.status]
  if not kind then return end
  local record = record_of(self, kind, m)
  record.source.orphan = false
  if kind == "incomplete" then record.what = kind end
  if m.look and m.good then
    record.invalid = invalid_of(m)
  end
  if m.is_unsure then record.is_unsure = true end
  offer(self, record, m)
end

-- What the orphaned frames of one message have in common: those in a row of one Seq, to its End.
local function orphaned(source, m)
  local orphan = source.orphan
  if not orphan or orphan.seq ~= m.seq then
    orphan = { seq = m.seq }
  end
  source.orphan = not m.is_end and orphan
  return orphan
end

--- Faults of a frame: those that say that a message, or a part of one, is lost.
-- m       { id, seq, source, bus, bus_name, stream, frame, time, visited, is_end = whether it is
--         an End }
-- faults  list of { expert, message = the one that is lost, void = whether it has been taken back }
function Tell:faults(m, faults)
  for _, fault in ipairs(faults) do
    local what = LOST[fault.expert]
    if what then
      local record = record_of(self, "incomplete", m)
      if what == "orphan" then
        record.lost = orphaned(record.source, m)
      else
        record.lost, record.source.orphan = fault.message, false
      end
      record.what, record.fault = what, fault
      offer(self, record, m)
    end
  end
end

--- Bytes of a stream that belong to no frame: over several packets in a row they are one stretch.
-- m  { id = nil, frame, time, visited, bus, bus_name, source = key of the stream, length = bytes }
function Tell:skipped(m)
  local stretch = self.stretches[m.source]
  if stretch and m.frame > stretch.last_frame then -- else the capture is read anew
    stretch.last_frame, stretch.length = m.frame, stretch.length + m.length
    return
  end
  stretch = record_of(self, "skipped", m)
  stretch.last_frame, stretch.length = m.frame, m.length
  self.stretches[m.source] = stretch
  self.stat:offer(stretch, m.visited)
end

--- A frame of a message that has not ended: when it came, should the capture end before the message
-- does.  Its frame, time and visited may change later: they are those of the latest.
function Tell:part(m)
  source_of(self, m).parts[m.seq] = m
end

--- The messages that the capture ends before.
-- messages  list of { source, seq, frame = number of their last frame }
-- returns   records, in the order of their frames
function Tell:unfinished(messages)
  local records = {}
  for _, message in ipairs(messages) do
    local source = self.sources[message.source]
    local part = source and source.parts[message.seq]
    if part and part.frame == message.frame then
      table.insert(records, record_of(self, "unfinished", part))
    end
  end
  table.sort(records, function(a, b) return a.frame < b.frame end)
  return records
end

--- The seconds between two times, which are those of a capture: to the nanosecond, so that 0.1 s is
-- no more than 0.1.
function M.span(from, to)
  return math.floor((to - from) * 1e9 + 0.5) / 1e9
end

-- Kinds -----------------------------------------------------------------------------------------

local Kinds = {}
Kinds.__index = Kinds

--- What makes events of records, for one statistic.
-- plugin     { late, named }, see stat.taps
-- statistic  whose event(event) is called
function M.kinds(plugin, statistic)
  return setmetatable({
    plugin = plugin,
    statistic = statistic,
    states = {}, by_key = {}, -- of sources with good messages
    came = {}, -- the sources of which something came that counts
  }, Kinds)
end

local function tell_of(self, kind, record, values)
  self.statistic:event {
    kind = kind,
    rel = record.rel,
    frame = record.frame,
    source = record.source,
    record = record,
    values = values or NOTHING,
  }
end

-- fault  one of a state
local function tell_fault(self, record, fault, event)
  local is_over = event ~= "raised" and fault.since
  tell_of(self, "fault", record, {
    field = fault.field,
    flag = fault.flag,
    help = fault.help,
    event = event,
    active = output.seconds(is_over and M.span(fault.since, record.rel)),
  })
end

-- The flags of a field that are faults, those that no table defines too.
local function alarms_of(field)
  local list = {}
  for _, flag in ipairs(field.flags) do
    if band(flag.mask, field.alarm_bits) ~= 0 then
      list[#list + 1] = flag
    end
  end
  local undefined = band(field.undefined, field.alarm_bits)
  for place = 0, 31 do
    local mask = 2 ^ place
    if band(undefined, mask) ~= 0 then
      list[#list + 1] = { name = ("undefined_0x%x"):format(mask), mask = mask }
    end
  end
  return list
end

local function note_fault(self, state, record, fault, is_set)
  local set = {}
  for _, one in ipairs(state.set) do
    if one.field == fault.field and one.flag == fault.flag then
      fault.since = one.since
    else
      set[#set + 1] = one
    end
  end
  if is_set then
    fault.since, set[#set + 1] = record.rel, fault
  end
  state.set = set
  if state.counts then
    tell_fault(self, record, fault, is_set and "raised" or "cleared")
  end
end

-- The faults of a source that begin and end with a change of a field's flags.
local function note_faults(self, state, record, change)
  local before = change.value - change.raised + change.cleared
  for _, flag in ipairs(alarms_of(change.field)) do
    local is_set = band(change.value, flag.mask) ~= 0
    if is_set ~= (band(before, flag.mask) ~= 0) then
      note_fault(self, state, record, {
        field = change.field.name,
        flag = flag.name,
        help = flag.help,
      }, is_set)
    end
  end
end

-- What a good message that counts tells besides faults.
local function note_events(self, record, change)
  if change.reboot then
    tell_of(self, "reboot", record)
  end
  if change.stale then
    tell_of(self, "stale", record)
  end
  if not record.fits then
    tell_of(self, "unknown", record)
  end
  for _, one in ipairs(record.invalid or NOTHING) do
    tell_of(self, "invalid", record, one)
  end
end

-- state: last = the latest record, counts = whether it does; set = the faults that are set, in the
-- order in which they rose, { field, flag, help, since } each: replaced, never written, as told may
-- be the same list; told = those that were set at told_by, the latest record that counts.
local function state_of(self, key)
  local state = self.by_key[key]
  if not state then
    state = {
      last = nil,
      counts = false,
      set = NOTHING,
      told = NOTHING,
      told_by = { frame = 0 },
      order = #self.states + 1,
    }
    self.by_key[key], self.states[state.order] = state, state
  end
  return state
end

local function note_good(self, record, counts)
  local state, change = state_of(self, record.source.key), record.change or NOTHING
  if change.late and state.counts then
    tell_of(self, "silence", state.last, { length = output.seconds(change.late) })
  end
  state.last, state.counts = record, counts
  if counts then note_events(self, record, change) end
  for _, one in ipairs(change.flags or NOTHING) do
    note_faults(self, state, record, one)
  end
  if counts then
    state.told, state.told_by = state.set, record
  end
end

--- Takes a record, in the order of the capture.
-- counts  whether the user's filter lets it count: of others it is kept what they change, so that
--         what comes behind them is right
function Kinds:record(record, counts)
  if counts then self.came[record.source] = true end
  if record.kind == "message" then
    note_good(self, record, counts)
  elseif counts then
    tell_of(self, record.kind, record, record)
  end
end

-- Silences that last to the end of the capture.
local function note_silence(self, last)
  for _, state in ipairs(self.states) do
    local record = state.last
    local every = record.source.message and record.source.message.every
    local length = M.span(record.rel, last.rel)
    if every and state.counts and length > self.plugin.late() * every then
      tell_of(self, "silence", record, { length = output.seconds(length), is_last = true })
    end
  end
end

-- The faults that are still set at the last message of their source that counts.
local function note_active(self)
  table.sort(self.states, function(a, b)
    if a.told_by.frame ~= b.told_by.frame then
      return a.told_by.frame < b.told_by.frame
    end
    return a.order < b.order
  end)
  for _, state in ipairs(self.states) do
    for _, fault in ipairs(state.told) do
      tell_fault(self, state.told_by, fault, "active")
    end
  end
end

local function has_come(self, row)
  for source in pairs(self.came) do
    local is_there = not row.bus or row.bus == source.bus
    if is_there and source.id == row.id and source.name == row.name then
      return true
    end
  end
  return false
end

--- All records have come.
-- last  { rel = } of the last packet of any kind; nil where there was none
function Kinds:finish(last)
  if last then note_silence(self, last) end
  note_active(self)
  for _, row in ipairs(self.plugin.named()) do
    if row.message and not has_come(self, row) then
      tell_of(self, "absent", { rel = last and last.rel, source = row })
    end
  end
end

return M
