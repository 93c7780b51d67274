-- SPDX-License-Identifier: GPL-2.0-or-later
-- The CAN buses below the messages: their error frames become events; and -z yapp,buses: the frames
-- of each bus, its errors, its load.  Pure Lua, 5.2 to 5.5.
--
-- Linux, and Wireshark's readers of other files, write the errors that a CAN controller reports as
-- frames (linux/can/error.h): a class in the place of the CAN id, and 8 bytes, of which the second
-- has the controller's state.

local bits = require "yapp.base.bits"
local kinds = require "yapp.stat.kinds"
local memo = require "yapp.base.memo"
local output = require "yapp.stat.output"

local M = {}

local band, byte, find = bits.band, string.byte, string.find
local new_event, span = kinds.new_event, kinds.span
local HEADER = 8 -- bytes of a SocketCAN record in front of the data
local ERROR = 0x20000000 -- flag of an error frame in its first word
local CONTROLLER = 0x04 -- class: the controller's state follows
local NEAR = 1 -- seconds

-- What an error frame may report, the gravest first: of these `buses` counts one a frame.
-- bits      of its class; above these, those of the controller's state
-- is_event  true if it is the `what` of an event
-- state     the state of the bus that it shows, or nil
local REPORTS = {
  { name = "off", bits = 0x40, is_event = true, state = "off" },
  { name = "passive", bits = 0x300000, is_event = true, state = "passive" },
  { name = "restarted", bits = 0x100, is_event = true, state = "restarted" },
  { name = "no_ack", bits = 0x20, is_event = true },
  { name = "tx_timeout", bits = 0x01, is_event = true },
  { name = "overflow", bits = 0x030000 },
  { name = "warning", bits = 0x0C0000, state = "active" },
  { name = "active", bits = 0x400000, state = "active" },
  { name = "protocol", bits = 0x08 },
  { name = "arbitration", bits = 0x02 },
  { name = "transceiver", bits = 0x10 },
  { name = "bus", bits = 0x80 },
}

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
  local state = band(class, CONTROLLER) > 0 and byte(packet, offset + HEADER + 2) or 0
  local found, reports = class % 0x10000 + state * 0x10000, {}
  for _, report in ipairs(REPORTS) do
    if band(found, report.bits) > 0 then reports[#reports + 1] = report end
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
    -- By source: { state = the latest, [name of another report] = its latest time }
    states = memo(function() return { state = "active" } end),
  }, Errors)
end

local function emit(self, kind, cause, values)
  self.hand_on(new_event(kind, cause.frame, cause.time, cause.source, values))
end

-- Return whether a report begins something.  A state lasts until another one comes.  Nothing tells
-- when frames are acknowledged again: so that ends when the bus works again, or after a second.
local function is_new(known, report, time)
  local name, state = report.name, report.state
  local latest = known[name]
  if not state then
    known[name] = time
    return not latest or span(latest, time) > NEAR
  end
  local is_other = state ~= known.state
  known.state = state
  if is_other and state ~= "passive" then known.no_ack, known.tx_timeout = nil, nil end
  return is_other
end

--- Add the event of an error frame, in the order of the capture.
function Errors:add(event)
  local known, has_state = self.states[event.source], false
  self.hand_on(event)
  for _, report in ipairs(event.values.reports) do
    local name, is_first = report.name, not (report.state and has_state)
    has_state = has_state or report.state
    if name == "overflow" then emit(self, "dropped", event, { count = 1 }) end
    if is_first and is_new(known, report, event.time) and report.is_event then
      emit(self, "bus", event, { what = name })
      local rule = "bus_" .. name
      if kinds.BY_NAME[rule] then emit(self, rule, event, { note = event.source.bus }) end
    end
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

-- buses -------------------------------------------------------------------------------------------

local BITS = 47 -- of a frame with an 11-bit id and without data, up to the next frame
local STUFFED = 34 -- how many of these stuffing may lengthen
local LONG_ID = 20 -- how many more a 29-bit id has
local STUFFING = 1 / 30 -- the mean of random bits; at most 1 / 4
local EXTENDED, REMOTE = 0x80, 0x40 -- flags in the highest byte of the id

-- Return how many bits a frame takes on its bus, with the mean stuffing.
-- packet  its bytes, from the beginning of the packet
local function bits_of(packet)
  local offset = record_offset(packet)
  local a, _, _, d, length = byte(packet, offset + 1, offset + 5)
  if not length then return 0 end -- the snap length cuts it
  local flags = offset > 0 and d or a -- in this order of bytes, see read_error
  local more = band(flags, EXTENDED) > 0 and LONG_ID or 0
  if band(flags, REMOTE) == 0 then more = more + 8 * length end
  return BITS + more + (STUFFED + more) * STUFFING
end

local NAMES = {}
for i, report in ipairs(REPORTS) do NAMES[i] = report.name end

local COLUMNS = output.columns {
  { "bus" },
  { "frames", type = "integer", help = "data and remote frames" },
  { "rate", type = "number", unit = "Hz", help = "(frames - 1) / (last - first)" },
  { "yapp", type = "integer", title = "YAPP", help = "the frames of them that are YAPP's" },
  { "others", where = "text window" },
  { "errors", type = "values",
    help = "error frames by the gravest that each reports: `" .. table.concat(NAMES, " ") .. "`" },
  { "first", where = "text", title = "first/s" },
  { "last", where = "text", title = "last/s" },
  { "load", type = "number", help = "the mean share of `bitrate=` that frames take" },
  { "load_max", type = "number", title = "in 1 s", help = "the highest within a second" },
}
--- The columns, see output.columns.
M.COLUMNS = COLUMNS

local Buses = {}
Buses.__index = Buses

local function new_bus(source)
  return {
    source = source,
    frames = 0,
    yapp = 0,
    errors = {}, -- by name of the gravest report: number of error frames
    first = nil, -- when its frames came
    last = nil,
    bits = 0, -- of all frames
    recent = {}, -- frames of the last second: [number] = { time, bits }
    oldest = 1, -- number of the oldest of them
    recent_bits = 0,
    max_bits = 0,
  }
end

--- Make the statistic.
-- options  { bitrate = bits in a second, or nil }
-- context  of output.print
function M.new(options, context)
  local list = {}
  return setmetatable({
    options = options,
    context = context,
    list = list,
    by_source = memo(new_bus, list),
  }, Buses)
end

--- Add an event, see stat.answer.
function Buses:add_event(event)
  if event.kind ~= "bus_errors" then return end
  local errors, gravest = self.by_source[event.source].errors, event.values.reports[1]
  local name = gravest and gravest.name or "bus"
  errors[name] = (errors[name] or 0) + 1
end

local function add_bits(bus, time, added)
  local recent = bus.recent
  recent[bus.frames] = { time, added }
  bus.bits, bus.recent_bits = bus.bits + added, bus.recent_bits + added
  while time - recent[bus.oldest][1] >= 1 do
    bus.recent_bits = bus.recent_bits - recent[bus.oldest][2]
    recent[bus.oldest], bus.oldest = nil, bus.oldest + 1
  end
  bus.max_bits = math.max(bus.max_bits, bus.recent_bits)
end

--- Add a data or remote frame.
-- source  of its bus, as events have it; time in seconds
-- packet  its bytes, from the beginning of the packet
function Buses:add_frame(source, time, packet)
  local bus = self.by_source[source]
  bus.frames = bus.frames + 1
  bus.first, bus.last = bus.first or time, time
  if self.options.bitrate then add_bits(bus, time, bits_of(packet)) end
end

--- Count a frame as one of YAPP's.
function Buses:add_yapp(source)
  self.by_source[source].yapp = self.by_source[source].yapp + 1
end

-- A share: JSON has it as it is.
local function share(value)
  return { value = tonumber(("%.6g"):format(value)), text = ("%.1f %%"):format(100 * value) }
end

local function errors_of(bus)
  local texts, counts = {}, {}
  for i, name in ipairs(NAMES) do
    local count = bus.errors[name] or 0
    counts[name] = count
    texts[i] = count > 0 and ("%d %s, "):format(count, name) or ""
  end
  return { json = output.object(NAMES, counts).json, text = table.concat(texts):gsub(", $", "") }
end

local function row_of(self, bus, ending)
  local row = {
    bus = bus.source.bus,
    frames = bus.frames,
    yapp = bus.yapp,
    others = bus.frames - bus.yapp,
    errors = errors_of(bus),
    first = output.seconds(bus.first),
    last = output.seconds(bus.last),
  }
  local length, bitrate = bus.first and span(bus.first, bus.last) or 0, self.options.bitrate
  if length == 0 or ending.lacks_times then return row end
  row.rate = (bus.frames - 1) / length
  if not bitrate then return row end
  row.load, row.load_max = share(bus.bits / length / bitrate), share(bus.max_bits / bitrate)
  return row
end

--- Return the row of each bus.
function Buses:rows(ending)
  local rows = {}
  for i, bus in ipairs(self.list) do rows[i] = row_of(self, bus, ending) end
  return rows
end

--- End, see stat.answer.
function Buses:finish(ending, notes)
  local rows = self:rows(ending)
  output.print(self.context, ("YAPP buses: %d"):format(#rows), COLUMNS, rows, notes)
end

return M
