-- SPDX-License-Identifier: GPL-2.0-or-later
-- Statistics over tables of events, for several files of unit tests.
-- luacheck: no max line length (as in test_statistics.lua)
local lu = require("luaunit")
local catalogue_of = require("yapp.message.catalogue")
local events_of = require("yapp.stat.events")
local faults_of = require("yapp.message.faults")
local joined = require("yapp.base.joined")
local kinds_of = require("yapp.stat.kinds")
local options_of = require("yapp.stat.options")
local run_of = require("yapp.stat.run")
local sources_of = require("yapp.message.sources")
local stamps_of = require("yapp.capture.stamps")

local M = {}

--- The note on a rule that is not judged.
M.TOO_FEW = "too few good messages, values that are not reserved, or other sources: see yapp.sources and the preferences of IDs"

-- Events stand for results here.
local append = events_of.append
function M.setUp()
  function events_of.append(list, result) list[#list + 1] = result.event end
end
function M.tearDown() events_of.append = append end

local function result_of(event)
  return { kind = event.kind, frame = { number = event.frame, visited = false }, event = event }
end

-- A catalogue of three messages: a volt is a count, 255 is a reserved count.
local PROBLEMS
M.CATALOGUE, PROBLEMS = catalogue_of.compile {
  { name = "motor", title = "Motor Data", id = 0x210, size = 11, every = 0.1,
    { "volts", "float8", "Volts", min = 0, max = 250, unit = "V" },
    { "fault_flags", "uint8", "Faults", group = "fault", alarm = true,
      flags = { { "hot", 0x1, "Hot" }, { "stall", 0x6, "Stall" } } },
    { "mode", "uint8", "Mode", values = { [0] = "off", [3] = "on", [12] = "idle" } },
    { "clock", "int64_ns", "Clock" } },
  { name = "note", title = "Note", id = 1, size = 1, { "text", "string", "Text", length = 1 } },
  { name = "health", title = "Health", id = 0x200, size = 8, every = 0.5, { "clock", "int64_ns", "Clock" } },
}
lu.assertEquals(PROBLEMS, {})

--- A payload of Motor Data; its clock is 4.5 s.
function M.payload(volts, flags, mode)
  return string.char(volts, flags or 0, mode or 3) .. "\0\x8d\x38\x0c\1\0\0\0"
end

M.LEFT = { bus_key = 1, bus = "can0", name = "left", id = 0x210, type = M.CATALOGUE.messages[1] }
--- The event of a good message of 10 V; with: what is otherwise.
function M.record(frame, rel, with)
  with = with or {}
  local source, content = with.source or M.LEFT, with.payload or M.payload(10)
  local m = { seq = with.seq or 0, payload = content, remarks = {}, change = with.change, undecoded = with.undecoded,
    is_unreliable = with.is_unreliable }
  if with.fits ~= false then
    local raws, remarks = source.type.read(content)
    m.raws, m.remarks = raws, remarks or {}
  end
  return kinds_of.new_event(with.kind or "message", frame, rel, source, with.values or m, m)
end

-- Adds to changes of flags the faults that rise and fall, as the history does.
local function add_faults(records)
  local by_source = {}
  for _, one in ipairs(records) do
    local change = one.values.change
    if change and change.flags then
      by_source[one.source] = by_source[one.source] or faults_of.new()
      change.faults = by_source[one.source]:update(change.flags, one.frame * 0x20000, one.time or 0)
    end
  end
end

local function settings_of(with)
  local rows, catalogue = with.named or { { id = 0x210, name = "left" } }, with.catalogue or M.CATALOGUE
  local sources = { rows = rows }
  if with.sources_text then sources = sources_of.parse(with.sources_text, catalogue) end
  local ids = with.ids or {}
  for _, message in ipairs(catalogue.messages) do ids[message.name] = ids[message.name] or { message.id } end
  return { published = with.published or { fields = {}, experts = {}, preferences = {} }, version = "9.8.7", catalogue = catalogue, late = 2.5, sources = sources, ids = ids,
    problems = { with.problem } }
end

--- Runs statistics over events; last: when the last packet came; matches: { [frame] = true } of a filter; epoch: of the
-- first packet; named: sources.  Returns what was printed, the code, and the texts.
function M.run(arguments, records, with)
  with = with or {}
  local settings = settings_of(with)
  local printed, queue = {}, run_of.new(settings, stamps_of.new(), with.hint)
  for _, argument in ipairs(arguments) do
    local options = options_of.parse("yapp," .. argument, settings.catalogue)
    if not argument:find("^check") then lu.assertEquals(options.problems, {}) end
    local context = { out = function(text) printed[#printed + 1] = text end, settings = settings,
      dates = queue.dates, frames = with.frames, make_folder = with.make_folder,
      json = options.json, terminal = with.terminal, flush = with.flush, stop = with.stop }
    local ok, statistic = pcall(options.row.new, options, context)
    if not ok then return nil, nil, { statistic } end
    options.matched = with.matches
    queue:add(statistic, options)
  end
  queue.dates:set_first(with.epoch or 1700000000, 5, 0)
  local function has_clock() return not with.lacks_clock end
  add_faults(records)
  for _, one in ipairs(records) do
    queue:report(result_of(one))
    queue:packet(one.frame, one.time, has_clock)
  end
  if with.last then queue:packet(9999, with.last, has_clock) end
  local results = {}
  for i, one in ipairs(with.unfinished or {}) do results[i] = result_of(one) end
  local code, texts = queue:finish { results = results, drops = with.drops or {},
    problems = joined(settings.problems, { with.unread }), unread = with.unread,
    lacks_times = with.lacks_times, extended = with.extended or 0 }
  return table.concat(printed), code, texts
end

--- The lines of a text.
function M.lines(text)
  local list = {}
  for line in text:gmatch("[^\n]+") do list[#list + 1] = line end
  return list
end

return M
