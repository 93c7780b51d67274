-- SPDX-License-Identifier: GPL-2.0-or-later
-- The CAN buses below the messages: their error frames become events; and -z yapp,buses: the frames
-- of each bus, its errors, its load.  Pure Lua, 5.2 to 5.5.
--
-- Linux, and Wireshark's readers of other files, write the errors that a CAN controller reports as
-- frames (linux/can/error.h): a class in the place of the CAN id, and 8 bytes, of which the second
-- has the controller's state.

local band = require("yapp.base.bits").band
local input = require "yapp.base.input"
local kinds = require "yapp.stat.kinds"
local mapped = require "yapp.base.mapped"
local memo = require "yapp.base.memo"
local output = require "yapp.stat.output"
local socketcan = require "yapp.wire.socketcan"

local Buses = {}
Buses.__index = Buses

local span = kinds.span
local read_header = socketcan.read
local CONTROLLER = 0x04 -- class: the controller's state follows
local ENDED = 1 -- seconds behind which a report without a state is a new one

-- What an error frame may report, the gravest first: of these `buses` counts one a frame.
-- bits      of its class; above these, those of the controller's state
-- is_event  true if it is the `what` of an event
-- is_state  true if it shows a state of the bus, which lasts until another one comes
local REPORTS = input.rows("name bits is_event is_state", {
  { "off", 0x40, true, true },
  { "passive", 0x300000, true, true },
  { "restarted", 0x100, true, true },
  { "no_ack", 0x20, true },
  { "tx_timeout", 0x01, true },
  { "overflow", 0x030000 },
  { "warning", 0x4C0000, false, true }, -- or less
  { "protocol", 0x08 },
  { "arbitration", 0x02 },
  { "bus", 0x290 }, -- and all that has no other name
})
local NAMES = mapped(REPORTS, function(report) return report.name end)

--- Return what an error frame reports: a list of rows of REPORTS, the gravest first, and of several
-- states only that one.
-- packet  its bytes, from the beginning of the packet
function Buses.read_error(packet)
  local _, class, _, _, state = read_header(packet)
  if band(class, CONTROLLER) > 0 then class = class + state * 0x10000 end
  local reports, has_state = {}, false
  for _, report in ipairs(REPORTS) do
    local is_shown = band(class, report.bits) > 0 and not (report.is_state and has_state)
    if is_shown then reports[#reports + 1] = report end
    has_state = has_state or is_shown and report.is_state
  end
  return reports
end

-- From error frames to events ---------------------------------------------------------------------

-- Return whether a report begins something.  Nothing tells when frames are acknowledged again: so
-- that ends when the bus works again, or after a second.
-- known  of a bus: { state = the latest one, times = by the name of another report }
local function is_new(known, report, time)
  local name, before, latest = report.name, known.state, known.times[report.name]
  if not report.is_state then
    known.times[name] = time
    return not latest or span(latest, time) > ENDED
  end
  known.state = name
  if name ~= before and name ~= "passive" then known.times = {} end
  return name ~= before
end

--- Make the events of the error frames of one run.
-- hand_on  function(event)
-- returns  function(event), to be called for each error frame, in the order of the capture
function Buses.new_errors(hand_on)
  local known_by_source = memo(function() return { state = "warning", times = {} } end)
  return function(event)
    local known = known_by_source[event.source]
    local function emit(kind, values) hand_on(kinds.new_follower(kind, event, values)) end
    hand_on(event)
    for _, report in ipairs(event.values.reports) do
      local name, rule = report.name, "bus_" .. report.name
      if name == "overflow" then emit("dropped", { count = 1 }) end
      if is_new(known, report, event.time) and report.is_event then
        emit("bus", { what = name })
        if kinds.BY_NAME[rule] then emit(rule, { note = event.source.bus }) end
      end
    end
  end
end

--- Return the bus events within a second of a silence, a loss or a fault: "bus off at 2.110 s"; nil
-- for none.
-- event   of an ID or bus; bus_events = list of the `bus` events of the capture
function Buses.near(event, bus_events)
  local kind = event.kind
  local is_wanted = kinds.BY_NAME[kind].hides or kind == "silence" or kind == "fault"
  local texts = mapped(event.time and is_wanted and bus_events or {}, function(one)
    local is_near = one.source.bus == event.source.bus and kinds.is_near(event, one)
    return is_near and ("%s at %.3f s"):format(one.values.what, one.time)
  end)
  return texts[1] and "bus " .. table.concat(texts, ", ")
end

-- buses -------------------------------------------------------------------------------------------

-- Return how many bits a frame takes on its bus, with the pause behind it and the mean stuffing of
-- random bits.
local function bits_of(packet)
  local flags, _, length = read_header(packet)
  if not flags then return 0 end
  local more = band(flags, socketcan.REMOTE) > 0 and 0 or 8 * length
  if band(flags, socketcan.EXTENDED) > 0 then more = more + 20 end
  return 47 + more + (34 + more) / 30
end

--- The columns, see output.columns.
Buses.COLUMNS = output.columns({
  "bus",
  { "frames", "integer", "data and remote frames" },
  { "rate", "number", "(frames - 1) / (last - first)", unit = "Hz" },
  { "yapp", "integer", "the frames of them that are YAPP's", title = "YAPP" },
  {
    "errors",
    "values",
    "error frames by the gravest that each reports: `" .. table.concat(NAMES, " ") .. "`",
  },
  { "first", title = "first/s" },
  { "last", title = "last/s" },
  { "load", "number", "the mean share of `bitrate=` that frames take" },
  { "load_max", "number", "the highest within a second", title = "in 1 s" },
}, "bus frames rate yapp others errors first last load load_max")

-- The row of a bus, whose other columns complete_row fills in.
local function new_bus(source)
  return {
    bus = source.bus,
    frames = 0,
    yapp = 0,
    counts = memo(function() return 0 end), -- of error frames, by name of the gravest report
    begin = nil, -- when its frames came
    latest = nil,
    bits = 0, -- of all frames
    recent = {}, -- frames of the last second: [number] = { time, bits }
    oldest = 1, -- number of the oldest of them
    recent_bits = 0, -- of them
    max_bits = 0,
  }
end

--- Make the statistic.
-- options  { bitrate = bits in a second, or nil }
-- context  of output.print
function Buses.new(options, context)
  local self = setmetatable({ bitrate = options.bitrate, context = context, list = {} }, Buses)
  self.by_source = memo(new_bus, self.list)
  return self
end

--- Add an event, see stat.answer.
function Buses:add_event(event)
  if event.kind ~= "bus_errors" then return end
  local counts, gravest = self.by_source[event.source].counts, event.values.reports[1]
  local name = gravest and gravest.name or "bus"
  counts[name] = counts[name] + 1
end

--- Add a data or remote frame.
-- source  of its bus, as events have it; time in seconds
-- packet   its bytes, from the beginning of the packet
-- is_yapp  true if the frame is YAPP's
function Buses:add_frame(source, time, packet, is_yapp)
  local bus, bits = self.by_source[source], bits_of(packet)
  local recent = bus.recent
  if is_yapp then bus.yapp = bus.yapp + 1 end
  bus.frames, bus.begin, bus.latest = bus.frames + 1, bus.begin or time, time
  recent[bus.frames] = { time = time, bits = bits }
  bus.bits, bus.recent_bits = bus.bits + bits, bus.recent_bits + bits
  while time - recent[bus.oldest].time >= 1 do
    bus.recent_bits = bus.recent_bits - recent[bus.oldest].bits
    recent[bus.oldest], bus.oldest = nil, bus.oldest + 1
  end
  bus.max_bits = math.max(bus.max_bits, bus.recent_bits)
end

-- Return a share of the bits in some seconds.
local function share(self, bits, seconds)
  local value = self.bitrate and seconds > 0 and bits / seconds / self.bitrate
  return value and { value = value, text = ("%.1f %%"):format(100 * value) } or nil
end

local function complete_row(self, bus, ending)
  local length = 0
  local texts = mapped(NAMES, function(name)
    local count = bus.counts[name]
    return count > 0 and count .. " " .. name
  end)
  bus.errors = { json = output.object(NAMES, bus.counts).json, text = table.concat(texts, ", ") }
  if bus.begin and not ending.lacks_times then length = span(bus.begin, bus.latest) end
  bus.rate = length > 0 and (bus.frames - 1) / length or nil
  bus.others = bus.frames - bus.yapp
  bus.first, bus.last = output.seconds(bus.begin), output.seconds(bus.latest)
  bus.load = share(self, bus.bits, length)
  bus.load_max = share(self, bus.max_bits, math.min(length, 1))
end

--- Return the row of each bus.
function Buses:rows(ending)
  for _, bus in ipairs(self.list) do complete_row(self, bus, ending) end
  return self.list
end

--- End, see stat.answer.
function Buses:finish(ending, notes)
  output.print(self.context, "YAPP buses: " .. #self.list, Buses.COLUMNS, self:rows(ending), notes)
end

return Buses
