-- SPDX-License-Identifier: GPL-2.0-or-later
-- The CAN buses below the messages: their error frames become events.  Pure Lua, 5.2 to 5.5.
--
-- Linux, and Wireshark's readers of other files, write the errors that a CAN controller reports as
-- frames (linux/can/error.h): a class in the place of the CAN id, and 8 bytes, of which the second
-- has the controller's state.

local bits = require "yapp.base.bits"
local kinds = require "yapp.stat.kinds"

local M = {}

local band, byte, find = bits.band, string.byte, string.find
local new_event, span = kinds.new_event, kinds.span
local HEADER = 8 -- bytes of a SocketCAN record in front of the data
local ERROR = 0x20000000 -- flag of an error frame in its first word
local CONTROLLER = 0x04 -- class: the controller's state follows
local NEAR = 1 -- seconds

-- What an error frame may report, the gravest first: of these `buses` counts one a frame.
-- class, controller  bits in its class, or in the controller's state
-- event    true if it is the `what` of an event
-- state    true if it stands for a new state of the bus
local REPORTS = {
  { name = "off", class = 0x40, event = true, state = true },
  { name = "passive", controller = 0x30, event = true, state = true },
  { name = "restarted", class = 0x100, event = true, state = true },
  { name = "no_ack", class = 0x20, event = true },
  { name = "tx_timeout", class = 0x01, event = true },
  { name = "overflow", controller = 0x03 },
  { name = "warning", controller = 0x0C, state = true },
  { name = "active", controller = 0x40, state = true },
  { name = "protocol", class = 0x08 },
  { name = "arbitration", class = 0x02 },
  { name = "transceiver", class = 0x10 },
  { name = "bus", class = 0x80 },
}
-- The states in which a bus works.
local GOOD = { warning = "active", active = "active" }

-- Return where the SocketCAN record begins in a packet: in front of it, a cooked capture has a
-- header with the device type CAN, 280.
local function record_offset(packet)
  if find(packet, "^\0[\12\13]......\1\24") then return 20 end
  return #packet > 16 and find(packet, "^\0[\0-\4]\1\24") and 16 or 0
end

-- Return the class that four bytes have, the highest first; a number that is none if these are not
-- of an error frame: above the class, that has one of three flags.
local function class_of(a, b, c, d)
  local word = 0x1000000 * a + 0x10000 * b + 0x100 * c + d
  return word >= ERROR and word < 2 * ERROR and word - ERROR or ERROR
end

--- Read an error frame.
-- packet   its bytes, from the beginning of the packet
-- returns  the values of its event: { reports = list of rows of REPORTS, the gravest first }
function M.read_error(packet)
  local offset = record_offset(packet)
  local a, b, c, d = byte(packet, offset + 1, offset + 4)
  -- Records of SocketCAN are big endian, those of cooked captures in the order of the host.  Taken
  -- the wrong way round, the class is none, or has a bit above all that there are.
  local class = math.min(class_of(a, b, c, d), class_of(d, c, b, a))
  local has_state = band(class, CONTROLLER) > 0
  local state, reports = has_state and byte(packet, offset + HEADER + 2) or 0, {}
  for _, report in ipairs(REPORTS) do
    if band(class, report.class or 0) + band(state, report.controller or 0) > 0 then
      reports[#reports + 1] = report
    end
  end
  return { reports = reports }
end

-- From error frames to events ---------------------------------------------------------------------

local Errors = {}
Errors.__index = Errors

--- Make the events of the error frames of one run.
-- hand_on  function(event)
function M.new_errors(hand_on)
  return setmetatable({
    hand_on = hand_on,
    states = {}, -- by source: { state = the latest, [name of a report] = its latest time }
  }, Errors)
end

local function emit(self, kind, cause, values)
  self.hand_on(new_event(kind, cause.frame, cause.time, cause.source, values))
end

-- Return whether a report begins something.  A state lasts until another one comes.  Nothing tells
-- when frames are acknowledged again: so that ends when the bus works again, or after a second.
local function is_new(known, report, time)
  local name = GOOD[report.name] or report.name
  if report.state then
    local is_other = name ~= known.state
    if is_other and name ~= "passive" then known.no_ack, known.tx_timeout = nil, nil end
    known.state = name
    return is_other
  end
  local latest = known[name]
  known[name] = time
  return not latest or span(latest, time) > NEAR
end

--- Add the event of an error frame, in the order of the capture.
function Errors:add(event)
  local source = event.source
  local known, is_state_known = self.states[source] or { state = "active" }, false
  self.states[source] = known
  self.hand_on(event)
  for _, report in ipairs(event.values.reports) do
    local counts = not (report.state and is_state_known) and is_new(known, report, event.time)
    is_state_known = is_state_known or report.state
    if counts and report.event then
      emit(self, "bus", event, { what = report.name })
      local rule = "bus_" .. report.name
      if kinds.BY_NAME[rule] then emit(self, rule, event, { note = source.bus }) end
    end
    if report.name == "overflow" then emit(self, "dropped", event, { count = 1 }) end
  end
end

--- Return the bus events within a second of a silence, a loss or a fault: "bus off at 2.110 s"; nil
-- for none.
-- event   of an ID or bus; bus_events = list of the `bus` events of the capture
function M.near(event, bus_events)
  local kind, from = event.kind, event.time
  local row, texts = kinds.BY_NAME[kind], {}
  if not (from and (row.hides or kind == "silence" or kind == "fault")) then return nil end
  local length = kind == "silence" and tonumber(event.values.length.json) or 0
  for _, one in ipairs(bus_events) do
    local is_near = one.time >= from - NEAR and one.time <= from + length + NEAR
    if is_near and one.source.bus == event.source.bus then
      texts[#texts + 1] = ("%s at %.3f s"):format(one.values.what, one.time)
    end
  end
  return texts[1] and "bus " .. table.concat(texts, ", ") or nil
end

return M
