-- SPDX-License-Identifier: GPL-2.0-or-later
-- The kinds of event, one row each, and the event itself.  The lists of `events`, the keys of JSON,
-- the rules of `check`, the errors of options, the help and the tests come from these rows.
-- Pure Lua, 5.2 to 5.5.
--
-- A new kind is a row here and the code that makes its events.  Of a row with `change`, stat.events
-- makes them: if a change of message.history has the row's name.  A window shows each event; of
-- kinds that may come often, MERGED in stat.lists, it shows one line.

local input = require "yapp.base.input"

local M = {}

local NEAR = 1 -- seconds

-- name        the first value: in JSON and in rules
-- text        the second one, for people: {key} is a value of the event
-- keys        in JSON, besides those of every event
-- is_optional true if `check` without rules does not judge it (others as NAME=0)
-- is_counted_only  true if `events` does not list it, as it is nothing that happened
-- counts_as   the kind whose rule counts it; nil if it has a rule NAME=N of its own; "none": no
--             rule counts it
-- amount      the key whose values the rule adds up; nil: each message counts once
-- change      the key for the value of message.history's change of this name
-- hides       if a fault may be hidden there: the text behind its count in "may hide faults"
-- scope       "capture": one verdict for the whole capture; "rare": one for each source that has
--             such events; nil: one for each source that can have them
-- about       key that the message type of a source must have; nil for any source with an ID
-- needs_time  true if it can be judged only if packets have time stamps
-- sees_end    true if it counts the time to the capture's end
-- can_mend    true if more packets may mend a rule that failed
M.LIST = input.rows("name text", {
  {
    "fault",
    "{flag} {event}{after}",
    keys = "field flag event active",
    about = "alarms",
  },
  { "crc", "bad CRC", hides = "with a bad CRC" },
  { "incomplete", "{what}", keys = "what", hides = "incomplete" },
  {
    "unfinished",
    "cut off by the end of the capture",
    counts_as = "incomplete",
    hides = "cut off by the end of the capture",
  },
  {
    "missing",
    "messages missing by Seq No: {count}",
    keys = "count",
    amount = "count",
    change = "count",
    hides = "missing by Seq No",
  },
  {
    "reboot",
    "controller rebooted (its clock went back by {length} s)",
    change = "length",
    about = "time",
  },
  {
    "stale",
    "controller clock did not advance",
    change = "stale",
    about = "time",
    needs_time = true,
  },
  {
    "jump",
    "controller clock jumped ahead by {length} s",
    keys = "length",
    change = "length",
    about = "time",
    needs_time = true,
  },
  {
    "shared",
    "two controllers appear to send this ID",
    change = "shared",
    about = "time",
  },
  {
    "silence",
    "silent for {length} s",
    keys = "length",
    about = "every",
    needs_time = true,
    sees_end = true,
  },
  {
    "invalid",
    "{field} {code} is not defined{effect}",
    keys = "field value",
    about = "fields",
  },
  {
    "disabled",
    "a Command disables {motors} while turning: {rest}",
    keys = "length",
    about = "enables",
    is_optional = true,
  },
  {
    "clock",
    "the capture's own clock {step} by {size} s",
    keys = "length",
    scope = "capture",
  },
  { "bus", "bus {what}", keys = "what", counts_as = "none", scope = "capture" },
  { "bus_off", "bus off", is_counted_only = true, scope = "capture" },
  { "bus_passive", "bus passive", is_counted_only = true, scope = "capture" },
  {
    "bus_errors",
    "an error frame",
    is_optional = true,
    is_counted_only = true,
    scope = "capture",
  },
  {
    "dropped",
    "packets lost while capturing: {count}",
    keys = "count",
    amount = "count",
    hides = "lost while capturing",
    scope = "capture",
  },
  { "absent", "no message of it came", scope = "capture", can_mend = true },
  { "copies", "recorded twice", is_optional = true, is_counted_only = true },
  {
    "unknown",
    "{size} bytes, {count} times: {note}",
    keys = "size count like",
    scope = "rare",
  },
  {
    "skipped",
    "{length} bytes of no frame",
    keys = "length",
    hides = "in bytes of no frame",
    scope = "rare",
    is_optional = true,
  },
})

--- The rows by name.
M.BY_NAME = {}
--- The rows that are changes.
M.CHANGES = {}
--- The rows that have a rule.
M.RULES = {}
for _, row in ipairs(M.LIST) do
  row.is_count = true -- of its rule, see stat.rules
  -- It can be judged only with a message that was decoded; with a reliable history.
  row.needs_values = row.about and row.about ~= "every"
  row.needs_past = row.change or row.about and row.about ~= "fields"
  M.BY_NAME[row.name] = row
  if row.change then M.CHANGES[#M.CHANGES + 1] = row end
  if not row.counts_as then M.RULES[#M.RULES + 1] = row end
end

--- The values of an event that has none.
M.NOTHING = {}

--- Make an event, which statistics list and count.
-- kind    "message" for a good message, else the name of a row
-- frame   number of the packet; time = seconds since the first one
-- source  of message.types, one table for all its events; for events of a bus, or of the capture,
--         with its bus and name alone, or with nothing
-- values  by the keys of its kind, and by those in its text; of a good message the message
-- message  of a message: { seq, raws = its raw values, nil or false where the catalogue does not
--         decode it }
function M.new_event(kind, frame, time, source, values, message)
  return {
    kind = kind,
    time = time,
    at = time, -- without what the capture's clock was set forward: for lengths; stat.run sets it
    frame = frame,
    source = source,
    values = values or M.NOTHING,
    seq = message and message.seq,
    raws = message and message.raws,
  }
end

--- Make an event that follows from the event of a message, its cause.
function M.new_follower(kind, cause, values)
  local event = M.new_event(kind, cause.frame, cause.time, cause.source, values)
  event.cause, event.at = cause, cause.at
  return event
end

--- Return whether another event is within a second of an event, or of the silence that it begins.
function M.is_near(event, other)
  local length = event.kind == "silence" and event.values.length.json or 0
  return other.at >= event.at - NEAR and other.at <= event.at + length + NEAR
end

--- Return the seconds between two times of a capture, rounded to the nanosecond, so that a gap of
-- 0.1 s does not exceed 0.1; 0 if the stamps go back.
function M.span(from, to)
  return math.max(0, math.floor((to - from) * 1e9 + 0.5) / 1e9)
end

return M
