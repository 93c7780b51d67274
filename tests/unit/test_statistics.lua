-- SPDX-License-Identifier: GPL-2.0-or-later
-- Statistics from tables of records: what is counted, what is printed, how a gate ends.
-- luacheck: no max line length (tables and JSON as they are printed)
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local answers = require("answers")
local catalogue_of = require("yapp.message.catalogue")
local input = require("yapp.base.input")
local kinds_of = require("yapp.stat.kinds")
local measures_of = require("yapp.stat.rules")
local options_of = require("yapp.stat.options")
local history_of = require("yapp.message.history")
local stamps_of = require("yapp.capture.stamps")

local T = { setUp = answers.setUp, tearDown = answers.tearDown }

local CATALOGUE, LEFT, lines, payload, record, run =
  answers.CATALOGUE, answers.LEFT, answers.lines, answers.payload, answers.record, answers.run
local MOTOR, NOTE, HEALTH = CATALOGUE.messages[1], CATALOGUE.messages[2], CATALOGUE.messages[3]
local FAULT = MOTOR.by_name.fault_flags
local RIGHT = { bus_key = 2, bus = 'can1"', id = 0x210, type = MOTOR }
local HEALTHY = { bus_key = 1, bus = "can0", id = 0x200, type = HEALTH } -- it has no faults
local ODD = { bus_key = 1, bus = "can0", id = 0x300 }

local NAMED_RIGHT = { { id = 0x210, bus = 'can"9', name = "right", type = MOTOR } }

local function lost(frame, rel, what, source)
  return record(frame, rel, { kind = "incomplete", values = { what = what }, fits = false, source = source })
end

local function bad(frame, rel, with)
  local one = record(frame, rel, with)
  one.kind = "crc"
  return one
end

local function raised(value, bits, cleared)
  return { flags = { { field = FAULT, value = value, raised = bits, cleared = cleared or 0 } } }
end

-- The statistics whose answer has room for notes: { "summary", "faults", ... }; and what prints data
-- alone: { "summary,json", ..., "csv,-,motor" }, without a verdict.
local IN_TEXT, AS_DATA = {}, {}
for _, row in ipairs(options_of.MENUS) do
  if not row.table_only then IN_TEXT[#IN_TEXT + 1] = row.name end
  if row.name ~= "check" then AS_DATA[#AS_DATA + 1] = row.table_only and row.name .. ",-,motor" or row.name .. ",json" end
end

local NOTHING_CAME = "no YAPP message found: the capture has no packets, or -R removed all of them\n"

-- summary -------------------------------------------------------------------------------------------------------

-- New columns come behind these.  A column that no row has a value of is not printed: it is not in found[2].
function T.test_summary_in_words()
  local printed = run({ "summary" }, { record(1, 0), record(2, 0.1, { source = RIGHT }), record(3, 0.25) },
    { last = 2 })
  local expected = lines([[
YAPP summary: 2 sources in 2.000 s

bus    ID     source  message     count  rate/Hz  gap/s min      mean       max  in frame  bad CRC  incomplete  late
can0   0x210  left    Motor Data      2     4.00   0.250000  0.250000  0.250000         3        0           0     0
can1"  0x210          Motor Data      1                                                          0           0     0

bus    ID     source  message     field  unit  min  mean  max  count
can0   0x210  left    Motor Data  volts  V      10    10   10      2
can1"  0x210          Motor Data  volts  V      10    10   10      1
]])
  local found = lines(printed)
  lu.assertEquals(#found, #expected)
  for i, line in ipairs(expected) do lu.assertEquals(found[i]:sub(1, #line), line) end
  lu.assertStrContains(found[2], "silent/s at the end  reboots  invalid  skipped  missing  copies")
  lu.assertEquals({ found[3]:match("1.750000"), found[4]:match("1.900000") }, { "1.750000", "1.900000" })
  lu.assertEquals(run({ "summary" }, {}), "YAPP summary: 0 sources in 0.000 s\n" .. NOTHING_CAME)
  lu.assertStrContains(run({ "summary" }, { record(1, 0) }), "volts  V      10    10   10      1\n") -- of one source
end

-- Random events of random sources, added up by a model; the rows are sorted by bus, then by ID.
function T.test_random_summaries()
  local stream = { bus_key = 3, bus = "tty" }
  local sources = { LEFT, { bus_key = 1, bus = "can0", id = 0x20f, type = MOTOR }, ODD, stream,
    { bus_key = 3, bus = "tty", id = 0x210, type = MOTOR, skipped = stream }, { bus_key = 2, bus = "can1", id = 0x200, type = MOTOR }, { bus_key = 2, bus = "can1", id = 0x50, type = MOTOR } }
  local LOST = { crc = "crc_bad", incomplete = "incomplete", unfinished = "incomplete", copies = "copies" }
  local KINDS = { "crc", "incomplete", "unfinished", "copies" }
  for seed = 1, 100 do
    math.randomseed(seed)
    local records, rows, by_source, time, is_new_stretch = {}, {}, {}, 1, true
    for frame = 1, math.random(60) do
      local source = sources[math.random(#sources)]
      local row, lost_kind = by_source[source], math.random(4) == 1 and KINDS[math.random(#KINDS)]
      time, is_new_stretch = time + math.random(-1, 6) / 16, is_new_stretch or source.skipped ~= nil
      if not row then
        row = { source = source, count = 0, crc_bad = 0, incomplete = 0, late = 0, reboots = 0, invalid = 0, skipped = 0, missing = 0,
          copies = 0, length = 0, volts = {} }
        by_source[source], rows[#rows + 1] = row, row
      end
      if not source.id then
        records[frame] = record(frame, time, { kind = "skipped", source = source, values = { length = frame }, fits = false })
        if is_new_stretch then row.skipped, is_new_stretch = row.skipped + 1, false end
      elseif lost_kind then
        local values = lost_kind == "copies" and { of = frame } or { what = "overrun" }
        records[frame] = record(frame, time, { kind = lost_kind, source = source, values = values, fits = false })
        row[LOST[lost_kind]] = row[LOST[lost_kind]] + 1
      else
        local volts, mode, flags = math.random(0, 255), math.random(0, 3), math.random(0, 9)
        local gap, missing, change = row.last and math.max(0, time - row.last), math.random(0, 2), {}
        if missing > 0 then change.missing = missing end
        if math.random(9) == 1 then change.reboot = 5 end
        if gap and gap > 0.25 and source.type then change.late = gap end
        records[frame] = record(frame, time, { source = source, change = change, fits = source.type ~= nil, payload = payload(volts, flags, mode) })
        row.count, row.last, row.missing = row.count + 1, time, row.missing + missing
        row.reboots, row.late = row.reboots + (change.reboot and 1 or 0), row.late + (change.late and 1 or 0)
        if gap then
          row.length, row.gap_min = row.length + gap, math.min(row.gap_min or gap, gap)
          if gap > (row.gap_max or -1) then row.gap_max, row.gap_max_frame = gap, frame end
          row.gap_mean = row.length / (row.count - 1)
          row.rate = row.length > 0 and (row.count - 1) / row.length or nil
        end
        if source.type then
          if mode == 1 or mode == 2 or flags > 7 then row.invalid = row.invalid + 1 end
          if volts <= 250 then row.volts[#row.volts + 1] = volts end
        end
      end
    end
    table.sort(rows, function(a, b)
      if a.source.bus ~= b.source.bus then return a.source.bus < b.source.bus end
      return (a.source.id or 0) < (b.source.id or 0)
    end)
    local printed = run({ "summary,json" }, records)
    local list = lines(printed)
    lu.assertEquals(run({ "summary,json,brief" }, records), (printed:gsub('"values":%b{}', '"values":{}')))
    lu.assertEquals(#list, #rows)
    for i, row in ipairs(rows) do
      local found, source = {}, row.source
      table.sort(row.volts)
      row.min, row.max = row.volts[1], row.volts[#row.volts]
      for _, volts in ipairs(row.volts) do row.mean = (row.mean or 0) + volts / #row.volts end
      row.id, row.source, row.volts, row.last, row.length = source.id, nil, nil, nil, nil
      lu.assertStrContains(list[i], ('{"bus":"%s",'):format(source.bus))
      for key, value in list[i]:gmatch('"([%w_]+)":([%d.e+-]+)') do found[key] = tonumber(value) end
      lu.assertAlmostEquals(found, row, 1e-8, seed)
    end
  end
end

-- faults and events ---------------------------------------------------------------------------------------------

-- What is raised and cleared between the messages that count is known, though it is not told.
function T.test_faults_of_the_messages_that_count()
  local records = { record(1, 1), record(2, 2, { change = raised(1, 1) }), record(3, 3),
    record(4, 4, { change = raised(0, 0, 1) }), record(5, 5) }
  local function found(...)
    local matches, shown = {}, {}
    for _, frame in ipairs { ... } do matches[frame] = true end
    for _, what in ipairs { "faults,json", "events,json" } do
      local texts = {}
      for i, line in ipairs(lines((run({ what }, records, { matches = matches, last = 5 })))) do
        texts[i] = line:match('"frame":(%d+)') .. " " .. (line:match('"event":"([^"]*)"') or "")
      end
      shown[#shown + 1] = table.concat(texts, ", ")
    end
    lu.assertStrContains(shown[2], shown[1])
    return shown[1]
  end
  lu.assertEquals(found(1, 2, 3, 4, 5), "2 raised, 4 cleared")
  lu.assertEquals(found(1, 2, 5), "2 raised") -- clear in frame 5
  lu.assertEquals(found(3), "3 active")
  lu.assertEquals(found(1, 2, 3), "2 raised, 3 active")
  lu.assertEquals(found(3, 4), "4 cleared")
  lu.assertEquals(found(1, 5), "")
  records[5] = record(5, 5, { change = raised(1, 1) }) -- it rises again, behind the last one that counts
  lu.assertEquals(found(2), "2 raised, 2 active")
  lu.assertEquals(found(2, 4), "2 raised, 4 cleared")
  lu.assertEquals(found(2, 5), "2 raised, 5 raised, 5 active")
end

function T.test_events_in_words()
  local undefined = { payload = payload(10, 0, 7) } -- a mode that stands in no table
  local stretch = { kind = "skipped", source = { key = "s", bus_key = 3, bus = "ttyA" }, values = { length = 5 }, fits = false }
  local records = { record(1, 0, undefined), lost(2, 0.1, "overrun", ODD), record(3, 0.2, undefined), record(4, 0.25, stretch) }
  lu.assertEquals(run({ "events" }, records, { last = 5 }), [[
YAPP events: 5

time (UTC)                  since start/s  frame  bus   ID     source  message     event       details
2023-11-14 22:13:20.000000       0.000000      1  can0  0x210  left    Motor Data  invalid     mode 0x07 is not defined
2023-11-14 22:13:20.100000       0.100000      2  can0  0x300          unknown     incomplete  overrun
2023-11-14 22:13:20.200000       0.200000      3  can0  0x210  left    Motor Data  invalid     mode 0x07 is not defined
2023-11-14 22:13:20.200000       0.200000      3  can0  0x210  left    Motor Data  silence     silent for 4.800 s
2023-11-14 22:13:20.250000       0.250000      4  ttyA                             skipped     5 bytes of no frame
]])
end

-- csv -----------------------------------------------------------------------------------------------------------

local COLUMNS = "volts,volts_special,fault_flags,fault_hot,fault_stall,mode,mode_text,clock"
local CELLS = "10,,0,0,0,3,on,4.500000000"
local ROWS = { record(1, 0.25), bad(2, 0.5), record(3, 1, { source = RIGHT, seq = 7 }),
  record(4, 2, { fits = false }), record(5, 3, { source = ODD, fits = false }) }

local function read(path)
  local file = assert(io.open(path, "rb"))
  local text = file:read("*a")
  file:close()
  return text
end

-- A folder of its own for a test; gone after it.
local function with_folder(test)
  local folder = os.tmpname()
  os.remove(folder)
  assert(os.execute("mkdir " .. folder))
  local ok, problem = pcall(test, folder, { make_folder = function() return true end })
  os.execute("rm -r " .. folder)
  if not ok then error(problem, 0) end
end

function T.test_csv_is_printed()
  lu.assertEquals(run({ "csv,-,motor" }, ROWS), "time,frame,bus,source,id,seq," .. COLUMNS .. "\n" ..
    "1700000000.250000005,1,can0,left,528,0," .. CELLS .. "\n" .. '1700000001.000000005,3,"can1""",,528,7,' .. CELLS .. "\n")
  local copy = record(3, 0.6, { kind = "copies", values = { of = 1 } })
  local cut = record(4, 0.7, { kind = "incomplete", values = { what = "incomplete" } })
  lu.assertEquals(run({ "csv,-,motor,all" }, { ROWS[2], copy, cut }), "time,frame,bus,source,id,seq,crc_good," .. COLUMNS .. "\n" ..
    "1700000000.500000005,2,can0,left,528,0,0," .. CELLS .. "\n")
end

function T.test_the_inventory()
  local catalogue = catalogue_of.compile { { name = "m", title = "M", id = 1, size = 4, every = 0.5,
    { "v", "float8", "V", min = 0, max = 250, unit = "V" }, { "w", "uint8", "W", unit = "%" }, { "f", "uint8", "F", group = "g", flags = { { "hot", 4, "Hot" } } },
    { "mode", "uint8", "Mode", values = { [0] = "off", [3] = "on", [7] = "up", [9] = "ok", [12] = "idle", [100] = "end" } },
    derived = { { "p", "v - w", "P", unit = "W" } } } }
  local published = { fields = { { "yapp.seq", "UINT8", "Seq No", "a number" } }, experts = { { "yapp.late", "Late", "SEQUENCE", "WARN" } },
    preferences = { { "late", "uint", "Late", 25, "tenths" } } }
  with_folder(function(folder, with)
    with.catalogue, with.published = catalogue, published
    run({ "csv," .. folder }, {}, with)
    local found = read(folder .. "/fields.json"):gsub(',"%w+":null', "")
    lu.assertStrContains(found, '{"version":1,"plugin":"9.8.7","messages":{"m":{"title":"M","every":0.5,"columns":[{"name":"time","unit":"s","type":"time"},')
    lu.assertStrContains(found, '{"name":"seq","type":"integer"},{"name":"v","unit":"V","type":"float","filter":"taurus.m.v","title":"V",' ..
      '"low":0,"high":250,"learnable":true},{"name":"v_special","type":"string","filter":"taurus.m.v","title":"V"},' ..
      '{"name":"w","unit":"%","type":"integer","filter":"taurus.m.w","title":"W","kind":"uint","bits":8},' ..
      '{"name":"f","type":"integer","filter":"taurus.m.f","title":"F","kind":"flags","bits":8},' ..
      '{"name":"g_hot","type":"bool","filter":"taurus.m.g.hot","title":"Hot"},{"name":"mode","type":"integer","filter":"taurus.m.mode",' ..
      '"title":"Mode","kind":"uint","bits":8,"values":{"0":"off","3":"on","7":"up","9":"ok","12":"idle","100":"end"}},' ..
      '{"name":"mode_text","type":"string","filter":"taurus.m.mode","title":"Mode"},{"name":"p","unit":"W","type":"float","filter":"taurus.m.p",' ..
      '"title":"P","learnable":true}],"formulas":[{"name":"p","of":"v","operator":"-","less":"w","unit":"W","title":"P"}]}},"statistics":{"summary":')
    lu.assertStrContains(found, '"fields":[{"name":"yapp.seq","type":"UINT8","title":"Seq No","help":"a number"}],"experts":[{"name":"yapp.late",' ..
      '"title":"Late","group":"SEQUENCE","severity":"WARN"}],"preferences":[{"name":"late","type":"uint","title":"Late","default":"25","help":"tenths"}]}')
  end)
end

function T.test_csv_overwrites_only_what_it_is_told_to()
  with_folder(function(folder, with)
    local printed, code = run({ "csv," .. folder }, ROWS, with)
    lu.assertStrContains(printed, "motor.csv      2\n")
    lu.assertEquals({ code, read(folder .. "/note.csv") }, { 0, "time,frame,bus,source,id,seq,text\n" })
    local _, _, texts = run({ "csv," .. folder }, {}, with)
    lu.assertStrMatches(texts[1], "csv: .*is there; add the option replace.*")
    lu.assertEquals(#lines(read(folder .. "/motor.csv")), 3)
    run({ "csv," .. folder .. ",replace" }, {}, with)
    lu.assertEquals(#lines(read(folder .. "/motor.csv")), 1)
    with.make_folder = function() return false end
    lu.assertEquals(select(3, run({ "csv,a/b" }, {}, with)), { "csv: the folder a/b cannot be made" })
  end)
end

-- As on Windows.
function T.test_csv_where_a_rename_does_not_replace()
  with_folder(function(folder, with)
    run({ "csv," .. folder }, ROWS, with)
    local rename = os.rename
    rawset(os, "rename", function(from, to)
      local there = io.open(to)
      if there then return there:close() and nil, "File exists" end
      return rename(from, to)
    end)
    local _, code, texts = run({ "csv," .. folder .. ",replace" }, {}, with)
    rawset(os, "rename", rename)
    lu.assertEquals({ code, #texts, #lines(read(folder .. "/motor.csv")) }, { 0, 1, 1 })
    lu.assertNil(io.open(folder .. "/motor.csv.part"))
  end)
end

-- /dev/full takes no byte: a full disk.
function T.test_csv_on_a_full_disk()
  with_folder(function(folder, with)
    assert(os.execute("ln -s /dev/full " .. folder .. "/motor.csv.part"))
    local _, code, texts = run({ "csv," .. folder }, ROWS, with)
    lu.assertEquals(code, 21)
    lu.assertStrContains(texts[1], "motor.csv: No space left on device")
    for _, name in ipairs { "motor.csv", "note.csv", "fields.json", "note.csv.part", "fields.json.part" } do
      lu.assertNil(io.open(folder .. "/" .. name), name)
    end
  end)
end

-- check ---------------------------------------------------------------------------------------------------------

-- The verdicts of rules over records: "rule source ok seen frame", each a line.
local function verdicts(rules, records, with)
  local printed, code, texts = run({ "check,json" .. (rules == "" and "" or "," .. rules) }, records, with)
  local found = {}
  for i, line in ipairs(lines(printed)) do
    found[i] = ("%s %s %s %s %s"):format(line:match('"rule":"([^"]*)"'), line:match('"source":"?([^",]*)'),
      line:match('"ok":(%w+)'), line:match('"seen":([^,]*)'), line:match('"frame":([^,]*)'))
  end
  return found, code, texts
end

-- Times are doubles: 0.3 - 0.2 is less than 0.1, and 1.1 - 1 is more.
function T.test_check_limits_that_are_just_kept()
  local records = {}
  for i = 1, 20 do records[i] = record(i, i / 10) end
  for rule, code in pairs { ["motor.gap=0.1"] = 0, ["motor.rate=10"] = 0, ["motor.rate=10.1"] = 20, ["motor.rate=10..10"] = 0,
    ["motor.rate=..9.9"] = 20, ["motor.rate=10.1.."] = 20 } do
    lu.assertEquals(select(2, verdicts(rule, records)), code, rule)
  end
end

-- Numbers of 64 bits that a double has not exactly are texts until they are counted.
function T.test_numbers_of_64_bits()
  local catalogue = catalogue_of.compile { { name = "big", title = "Big", id = 2, size = 8,
    { "wide", "uint64", "Wide" } } }
  local source = { key = "w", id = 2, type = catalogue.messages[1] }
  local records = { record(1, 0, { source = source, payload = "\3\0\0\0\0\0\0\0" }),
    record(2, 1, { source = source, payload = ("\255"):rep(8) }) }
  local with = { catalogue = catalogue }
  lu.assertEquals(verdicts("big.wide=0..2e19", records, with)[1], "big.wide=0..2e19 null true 0 1")
  lu.assertEquals(verdicts("big.wide=0..2e18", records, with)[1], "big.wide=0..2e18 null false 1 2")
  lu.assertStrContains(run({ "summary,json" }, records, with),
    '"min":3,"mean":9.2233720368547758e+18,"max":1.8446744073709552e+19')
  local since_1970 = {} -- in µs: their sum has more than 64 bits
  for i = 1, 6000 do since_1970[i] = record(i, i, { source = source, payload = "\0\64\30\24\36\10\6\0" }) end
  lu.assertStrContains(run({ "summary,json" }, since_1970, with), '"mean":1700000000000000,')
end

-- What falls as its count grows has its least value at the largest count.
function T.test_means_of_counts()
  local catalogue = catalogue_of.compile { { name = "m", title = "M", id = 2, size = 6,
    { "real", "float8", "Real", min = -125, max = 125 },
    { "sign", "int8", "Sign" },
    { "rise", "uint16", "Rise", scale = 0.1, offset = -1, unit = "V" },
    { "fall", "int16", "Fall", scale = -2 } } }
  local source, records = { key = "m", id = 2, type = catalogue.messages[1] }, {}
  for i, bytes in ipairs { "\100\255\10\0\1\0", "\255\1\20\0\2\0", "\200\246\30\0\255\255" } do
    records[i] = record(i, i, { source = source, payload = bytes })
  end
  lu.assertStrContains(run({ "summary,json" }, records, { catalogue = catalogue }), '"values":{' ..
    '"real":{"min":-25,"mean":25,"max":75},"sign":{"min":-10,"mean":-3.3333333333333335,"max":1},' ..
    '"rise":{"min":0,"mean":1,"max":2},"fall":{"min":-4,"mean":-1.3333333333333333,"max":2}}')
end

-- Where Seq No does not count, "0 missing" proves nothing, and says so.
function T.test_check_says_where_seq_no_does_not_number_messages()
  local function note_of(...)
    local records = {}
    for i, seq in ipairs { ... } do records[i] = record(i, i / 10, { seq = seq }) end
    local printed, code = run({ "check,json,missing=0" }, records)
    return code, printed:match('"rule":"missing=0".-"note":("?[^"]*"?)}')
  end
  lu.assertEquals({ note_of(5, 5, 5) }, { 0, '"Seq No is constant"' })
  lu.assertEquals({ note_of(5, 6, 7) }, { 0, "null" })
  lu.assertEquals({ note_of(5, 5, 6) }, { 0, "null" })
end

function T.test_what_cannot_be_judged()
  local function code_of(rules, records, with) return (select(2, verdicts(rules, records, with))) end
  local good = { record(1, 0) }
  lu.assertEquals(code_of("fault=0", {}), 21)
  lu.assertEquals(code_of("unknown=0", {}), 21)
  lu.assertEquals(code_of("note.count=1", good), 21)
  lu.assertEquals(code_of("source=nobody,motor.count=1", good), 21)
  lu.assertEquals(code_of("fault=0", { bad(1, 0) }), 21)
  lu.assertEquals(code_of("motor.rate=1", { record(1, 0), record(2, 0) }), 21)
  local stepped = { record(1, 0), record(2, 1), record(3, 0), record(4, 1), record(5, 2) } -- a step back has no length
  lu.assertEquals({ code_of("motor.rate=1.5", stepped), code_of("motor.rate=1", stepped) }, { 20, 0 })
  lu.assertEquals(code_of("crc=0", good, { problem = "the catalogue did not load whole" }), 21)
  lu.assertEquals(code_of("crc=0,nonsense=1", good), 21)
  lu.assertEquals(code_of("unknown=0", { lost(1, 0, "incomplete", ODD) }), 21)
  local unsure = record(2, 1, { is_unreliable = true }) -- what came before it is not known
  lu.assertEquals(code_of("fault=0", { good[1], unsure }), 21)
  for _, name in ipairs { "missing", "reboot", "stale", "jump", "shared", "silence" } do
    lu.assertEquals(code_of(name .. "=0", { good[1], unsure }), 21, name)
  end
  lu.assertEquals(code_of("crc=0", { good[1], unsure }), 0)
  local undecoded = { record(1, 0, { fits = false }), record(2, 1, { fits = false }) }
  for name, verdict in pairs { fault = "null", reboot = "null", stale = "null", jump = "null", shared = "null",
    invalid = "null", missing = "true", silence = "true", crc = "true", incomplete = "true" } do
    local found = verdicts(name .. "=0", undecoded)[1]
    lu.assertStrContains(found, ("%s=0 left %s "):format(name, verdict))
  end
  lu.assertEquals(verdicts("clock=0", {})[1], "clock=0 null null 0 null") -- nothing came
  lu.assertEquals(code_of("fault=0", { record(1, 0, { change = raised(1, 1) }), unsure }), 20)
  lu.assertEquals(code_of("motor.count=9,nonsense=1", good), 20) -- both
  lu.assertEquals(code_of("crc=0", good), 0)
end

-- What failed comes first, and of what held the least margin.
function T.test_check_in_words()
  lu.assertEquals(run({ "check,motor.volts=20..30,motor.gap=1,motor.volts=9.9..20,note.count=1" }, { record(1, 0), record(2, 0.5) }), [[
YAPP check: FAILED

check       rule                 bus   ID     source  message     frame  seen  worst  margin     %  note
FAILED      motor.volts=20..30   can0  0x210  left    Motor Data      1     2     10     -10  -100  of 2 values
NOT JUDGED  note.count=1                                                                            too few good messages, values that are not reserved, or other sources: see yapp.sources and the preferences of IDs
ok          motor.volts=9.9..20  can0  0x210  left    Motor Data      1     0     10     0.1  0.99  of 2 values, close to its limit
ok          motor.gap=1          can0  0x210  left    Motor Data      2   0.5            0.5    50
ok          unknown=0                                                       0

1 of 5 rules failed, 1 not judged
]])
end

function T.test_a_report_for_ci()
  with_folder(function(folder)
    local path = folder .. "/report.xml"
    local _, code = run({ "check,motor.count=2,crc=0,note.count=1,junit=" .. path }, { record(1, 0) })
    lu.assertEquals(code, 20)
    lu.assertEquals(read(path), [[
<?xml version="1.0" encoding="UTF-8"?>
<testsuite name="yapp.check" tests="4" failures="1" errors="1">
  <testcase classname="yapp.check" name="motor.count=2 can0 0x210 left"><failure message="seen 1, frame 1"/></testcase>
  <testcase classname="yapp.check" name="crc=0 can0 0x210 left"><system-out>seen 0</system-out></testcase>
  <testcase classname="yapp.check" name="note.count=1"><error message="note too few good messages, values that are not reserved, or other sources: see yapp.sources and the preferences of IDs"/></testcase>
  <testcase classname="yapp.check" name="unknown=0"><system-out>seen 0</system-out></testcase>
</testsuite>
]])
    local _, unwritable, texts = run({ "check,crc=0,junit=" .. folder .. "/none/x.xml" }, { record(1, 0) })
    lu.assertEquals(unwritable, 21)
    lu.assertStrContains(texts[1], "the report is not written")
    run({ "check,crc=0,x=1,junit=" .. path }, { record(1, 0) }, { problem = "own.lua was not read" })
    lu.assertStrContains(read(path), 'tests="4" failures="0" errors="2"')
    lu.assertStrContains(read(path), '<error message="note own.lua was not read"/>')
  end)
end

-- New kinds of event ------------------------------------------------------------------------------------------------

-- The lines of a statistic that have a text, without time and who.
local function found(what, text, records, with)
  local list = {}
  for _, line in ipairs(lines((run({ what }, records, with)))) do
    if line:find(text, 1, true) then list[#list + 1] = line:gsub('"time":.-"message":[^,}]*', "") end
  end
  return list
end

local NAMED = { { id = 0x210, name = "left", type = MOTOR }, { id = 0x210, bus = "can9", name = "right", type = MOTOR },
  { id = 0x211, type = MOTOR }, { id = 0x212, name = "tail" } }
LEFT.row = NAMED[1]

function T.test_sources_that_never_came()
  local records, with = { record(1, 0) }, { named = NAMED, last = 0.1 }
  lu.assertEquals(lines((run({ "events,json" }, records, with))), {
    '{"kind":"absent","time":1700000000.100000005,"frame":null,"bus":"can9","id":528,"source":"right","message":"motor"}',
    '{"kind":"absent","time":1700000000.100000005,"frame":null,"bus":null,"id":529,"source":null,"message":"motor"}' })
  lu.assertStrContains(run({ "events" }, records, with), "no message of it came")
  lu.assertEquals(verdicts("absent=1,absent=2", records, with), { "absent=1 null false 2 null", "absent=2 null true 2 null",
    "unknown=0 null true 0 null" })
  lu.assertStrContains(run({ "check,absent=1" }, records, with), "2  right, 0x211\n")
  local judged = { named = { NAMED[1], NAMED[2], NAMED[3] } }
  lu.assertStrContains(run({ "check,json,absent=2" }, records, judged), '"note":"right, 0x211"}')
  lu.assertEquals(verdicts("source=right,absent=0", records, with)[1], "absent=0 right false 1 null")
  lu.assertEquals(verdicts("source=left,absent=0", records, with)[1], "absent=0 left true 0 null")
  lu.assertEquals(select(2, verdicts("absent=0", records)), 21) -- nobody is named with a message
end

-- Where not all packets were read, a rule fails only if no more of them can mend it.
function T.test_unread_packets_may_mend_a_rule()
  local records = { record(1, 0), record(2, 0, { source = RIGHT, payload = payload(20) }),
    record(3, 1, { payload = payload(255) }), bad(4, 2) }
  local with = { unread = "not all packets were read", named = NAMED }
  local rules = { ["motor.volts=..9"] = "false", ["motor.volts.spread=1"] = "false",
    ["motor.gap=0.5"] = "false", ["crc=0"] = "false", ["motor.volts.mean=..9"] = "null", ["motor.volts.ratio=..0.1"] = "null",
    ["motor.volts.special=0.1"] = "null", ["motor.rate=..0.1"] = "null", ["absent=0"] = "null", ["motor.count=9"] = "null",
    ["motor.volts=..30"] = "null" }
  local judged = 0
  for rule, ok in pairs(rules) do
    local is_of_all = rule:find("spread") or rule == "absent=0" -- which is that of right
    for _, line in ipairs(verdicts((is_of_all and "" or "source=left,") .. rule, records, with)) do
      if line:sub(1, #rule) == rule then
        lu.assertEquals(line:match(" (%l+) %S+ %S+$"), ok, line)
        judged = judged + 1
      end
    end
  end
  lu.assertEquals(judged, 11)
  lu.assertStrContains(run({ "faults" }, records, with), "YAPP faults: UNKNOWN, not all packets were read, 0 in what was decoded\n")
end

-- Each rule about values but that of all sources is not judged, and says why, if its source has no good message.
function T.test_rules_without_a_value()
  local words = { MESSAGE = "motor", FIELD = "volts", OTHER = "mode", A = 1, B = 2, S = 1, X = 1 }
  for _, row in ipairs(measures_of.LIST) do
    if row.name ~= "count" and row.name ~= "rate" and row.scope ~= "capture" then
      local rule = row.text:gsub("X:A..B;X", "0:1..2;3"):gsub("%u+", words) -- "MESSAGE.gap=S": motor.gap=1
      local printed, code = run({ "check,source=left,crc=9," .. rule }, { bad(1, 0) })
      lu.assertStrContains(printed, answers.TOO_FEW, false, row.name)
      lu.assertEquals(code, 21, row.name)
    end
  end
end

function T.test_compare()
  local records = { record(1, 0, { payload = payload(10) }), record(2, 0.1, { source = RIGHT, payload = payload(12) }),
    record(3, 0.2, { payload = payload(11) }), -- 1 apart
    record(4, 0.3, { payload = payload(255) }), record(5, 0.35, { payload = payload(200) }), -- just as old as a value may be
    record(6, 0.5, { source = RIGHT, payload = payload(199) }) }
  lu.assertEquals(lines((run({ "compare,json" }, records)))[1], '{"message":"motor","field":"volts","unit":"V",' ..
    '"spread":188,"time":1700000000.350000005,"frame":5,"sources":[{"bus":"can0","id":528,"source":"left","count":3,' ..
    '"min":10,"mean":73.666666666666671,"max":200},{"bus":"can1\\"","id":528,"source":null,"count":2,"min":12,' ..
    '"mean":105.5,"max":199}]}')
  lu.assertEquals(run({ "compare" }, records), [[
YAPP compare: 2 sources of Motor Data

field  unit  source       min     mean  max  spread  since start/s  frame
volts  V     left          10  73.6667  200     188       0.350000      5
             can1" 0x210   12    105.5  199
]])
  for i, source in ipairs { HEALTHY, { bus_key = 2, bus = "can1", id = 0x200, type = HEALTH } } do
    records[6 + i] = record(6 + i, i, { source = source, payload = ("\0"):rep(8) })
  end
  lu.assertStrMatches(run({ "compare" }, records, { hint = "said once" }),
    "YAPP compare: 2 sources of Health\nsaid once\n\nYAPP compare: 2 sources of Motor Data\n\n.*")
  lu.assertNotStrContains(run({ "compare" }, records, { hint = "use filter=", matches = { [1] = true } }), "use filter=")
  lu.assertEquals(run({ "compare" }, { record(1, 0) }), "YAPP compare: no message has several sources\n")
end

-- The source whose mean is farthest from the median is first, and so is the field in which it stands out most.
function T.test_the_odd_ones_come_first()
  local catalogue = catalogue_of.compile { { name = "m", title = "M", id = 1, size = 4, { "a", "uint16", "A" }, { "b", "uint16", "B" } } }
  math.randomseed(1)
  for _ = 1, 50 do
    local records, rows, shown = {}, { { name = "a" }, { name = "b" } }, {}
    for i = 1, 3 do
      local source, texts = { bus_key = 1, bus = "can0", name = "s" .. i, id = i, type = catalogue.messages[1] }, { "", "" }
      for _, row in ipairs(rows) do
        local range = {}
        for at = 1, 2 do
          range[at] = math.random(0, 65535)
          texts[at] = texts[at] .. string.char(range[at] % 256, math.floor(range[at] / 256))
        end
        row[i] = { name = source.name, mean = (range[1] + range[2]) / 2, range = math.abs(range[1] - range[2]) }
      end
      for at, text in ipairs(texts) do records[3 * at + i - 3] = record(3 * at + i - 3, at, { source = source, payload = text }) end
    end
    for _, row in ipairs(rows) do
      table.sort(row, function(a, b) return a.mean < b.mean end)
      local first, middle, second = row[1], row[2], row[3]
      local one, other = middle.mean - first.mean, second.mean - middle.mean
      if one < other then first, second, one, other = second, first, other, one end
      row.odd, row.text = one / (other + (middle.mean + first.range) / 100), row.name .. first.name .. second.name .. middle.name
    end
    for name, source in (run({ "compare" }, records, { catalogue = catalogue })):gmatch("\n(%l?) +(s%d) ") do shown[#shown + 1] = name .. source end
    if rows[1].odd < rows[2].odd then rows[1], rows[2] = rows[2], rows[1] end
    lu.assertEquals(table.concat(shown), rows[1].text .. rows[2].text)
  end
end

-- In time, which goes on where the capture's goes back; at one time by frame, and what has no frame is last.
function T.test_events_at_one_time()
  local records = { bad(2, 1), bad(3, 0.5), bad(4, 2), bad(6, 2) }
  local printed = run({ "events,json" }, records, { last = 2, named = NAMED_RIGHT,
    unfinished = { record(5, 2, { kind = "unfinished" }) } })
  local frames = {}
  for i, line in ipairs(lines(printed)) do frames[i] = line:match('"frame":(%w+)') end
  lu.assertEquals(frames, { "2", "3", "3", "4", "5", "6", "null" }) -- the clock's step and the message at frame 3
end

-- A Command that disables motors which turn: random Commands and speeds on two buses against the definition.
function T.test_disabled()
  local catalogue = catalogue_of.compile {
    { name = "command", title = "Command", id = 0, size = 2, enables = "on", { "on", "uint8", "On" },
      { "key", "uint8", "Key", values = { [0xa5] = "Full" }, invalid = "command.key.invalid" } },
    { name = "motor", title = "Motor Data", id = 0x210, size = 1, answers = "command", speed = "rpm",
      { "rpm", "float8", "RPM", min = -125, max = 125, unit = "RPM" } },
  }
  local function source(bus, id, index)
    return { bus_key = bus, bus = "can" .. bus, id = id, type = catalogue.messages[index] }
  end
  local total = 0
  for seed = 1, 60 do
    math.randomseed(seed)
    local records, expected = {}, {}
    for bus = 1, 2 do
      local sources = { source(bus, 0x210, 2), source(bus, 0x211, 2), source(bus, 0, 1) }
      local speeds, highest, before, open = { 0, 0 }, { 0, 0 }, nil, nil
      for frame = 1, 60 do
        local index, at = math.random(3), frame + bus * 1000
        if index < 3 then
          local count = ({ math.random(0, 255), math.random(251, 255), math.random(110, 140) })[math.random(3)]
          records[#records + 1] = record(at, at, { source = sources[index], payload = string.char(count) })
          if count <= 250 then
            speeds[index] = math.abs(count - 125)
            highest[index] = math.max(highest[index], speeds[index])
          end
        else
          local on, is_ignored = math.random(3) > 1 and 1 or 0, math.random(5) == 1
          records[#records + 1] = record(at, at, { source = sources[3], payload = string.char(on, is_ignored and 0 or 0xa5) })
          if not is_ignored then
            records[#records].enables = before == 0 and on == 1 or nil
            local turns = speeds[1] * 10 > highest[1] or speeds[2] * 10 > highest[2]
            if on == 1 and open then expected[open] = expected[open] .. at - tonumber(open:match("%d+$")) end
            if on == 1 then open = nil end
            if before == 1 and on == 0 and turns then
              open = ("can%d %d"):format(bus, at)
              expected[open] = ""
            end
            before = on
          end
        end
      end
    end
    local past = history_of.new(catalogue.messages,
      { has_times = function() return true, true end, stamps = stamps_of.new() }, 2.5)
    for _, one in ipairs(records) do
      local values = one.values
      values.source, values.key, values.time, values.status = one.source, one.frame * 0x20000, one.time, "good"
      values.change = past:add(values)
      lu.assertEquals(values.change and values.change.enabled, one.enables)
    end
    local lengths, count = {}, 0
    for line in run({ "events,json" }, records, { catalogue = catalogue }):gmatch("[^\n]+") do
      local frame, bus, length = line:match('"disabled".-"frame":(%d+),"bus":"(can%d)","id":0.-"length":(%w+)')
      if frame then lengths[bus .. " " .. frame], count = length == "null" and "" or length, count + 1 end
    end
    lu.assertEquals(lengths, expected)
    total = total + count
  end
  lu.assertTrue(total > 200)
end

-- `check` alone -----------------------------------------------------------------------------------------------------

function T.test_all_is_well()
  local records, found_kinds, expected = { record(1, 0), record(2, 0.1) }, {}, {}
  local found_, code = verdicts("", records, { named = { NAMED[1] } })
  for i, line in ipairs(found_) do found_kinds[i] = line:match("^%S+ %S+ true 0") or line end
  for _, row in ipairs(kinds_of.LIST) do
    local source = row.scope and "null" or "left"
    if not (row.counts_as or row.is_optional) then expected[#expected + 1] = ("%s=0 %s true 0"):format(row.name, source) end
  end
  lu.assertEquals(found_kinds, expected)
  lu.assertEquals(code, 0)
  local note = { key = "n", id = 1, type = NOTE } -- no faults, no clock, no period
  lu.assertEquals(select(2, verdicts("", { record(1, 0, { source = note }) })), 0)
  lu.assertEquals(select(2, verdicts("source=left", records)), 0)
end

-- A window of Wireshark has room for 73 characters: a row is one line of it, but for a long text.
function T.test_tables_fit_a_window()
  local flag = { name = "long_name_of_a_flag", mask = 1 }
  local change = { flags = { { field = { name = "f", undefined = 0, alarm_bits = 1, flags = { flag } }, value = 1, raised = 1, cleared = 0 } },
    reboot = 5, late = 0.9 }
  local records = { record(1, 0), record(99999, 1, { change = change }), record(100000, 1.1, { source = RIGHT }) }
  local expected = { -- columns, frame of the first row
    summary = { "source message count rate/Hz gap/s late silent/s reboots", 99999 },
    faults = { "at/s frame source flag event active/s", 99999 }, check = { "check rule source message seen note", 99999 },
    events = { "at/s frame bus ID source details", 1 }, compare = { "field unit source min mean max spread", 100000 },
  }
  for _, what in ipairs(IN_TEXT) do
    local frames, row = {}, expected[what]
    local printed = run({ what }, records, { frames = frames, last = 9, named = NAMED })
    lu.assertEquals(row and { printed:match("\n\n *([^\n]*)\n"):gsub(" +", " "), frames[1] }, row)
    for _, line in ipairs(lines(printed)) do lu.assertEvalToTrue(#line <= 73 or what == "events" or what == "fault" or line:find("absent", 1, true) or line:find("may hide", 1, true), line) end
    lu.assertTrue(what == "buses" or printed:find("left", 1, true) ~= nil, what)
    if what == "summary" then lu.assertStrMatches(printed, ".*\n\nsource +field +unit +min +mean +max\n.*") end
  end
end

-- What may come often is one line for each source and kind.
function T.test_events_of_a_window_are_merged()
  local stream = { line = {}, bus_key = 3, bus = "uart" }
  local on_line = { bus_key = 3, bus = "uart", id = 0x210, type = MOTOR, skipped = stream }
  local stretch = function(frame, rel, length)
    return record(frame, rel, { kind = "skipped", source = stream, values = { length = length }, fits = false })
  end
  local both = { flags = { { field = FAULT, value = 3, raised = 3, cleared = 0 } } }
  local records = { record(1, 0), stretch(2, 0.01, 5), bad(3, 0.1), bad(4, 0.2), bad(5, 0.3, { source = RIGHT }), record(6, 0.305, { source = on_line }),
    stretch(7, 0.31, 7), record(8, 0.34, { change = both, payload = payload(10, 3) }) }
  local printed = run({ "events" }, records, { frames = {} })
  local list = {}
  for _, line in ipairs(lines(printed)) do
    if line:find("^ *%d") then list[#list + 1] = line:gsub(" +", " ") end
  end
  lu.assertEquals(list, { "0.010 2 uart 12 bytes of no frame, 2 times up to 0.310 s",
    "0.100 3 can0 0x210 left bad CRC, 2 times up to 0.200 s", '0.300 5 can1" 0x210 bad CRC',
    "0.340 8 can0 0x210 left hot, stall raised", "0.340 8 can0 0x210 left hot, stall active after 0.000 s" })
  lu.assertEquals(#lines((run({ "events,json" }, records))), 9)

  for kind, is_merged in pairs { clock = true, missing = true, dropped = true, stale = true, incomplete = true,
    unfinished = true, invalid = true, jump = false } do
    local often = { record(1, 0), record(2, 0.1, { kind = kind, values = {} }), record(3, 0.2, { kind = kind, values = {} }) }
    lu.assertEquals(run({ "events" }, often, { frames = {} }):find(", 2 times up to 0.200 s") ~= nil, is_merged, kind)
  end

  -- A reboot that Health shows first is that of Motor Data, which comes more often; 3 s later is another one.
  local reboot = { reboot = 5 }
  printed = run({ "events" }, { record(1, 0), record(2, 1, { source = HEALTHY, payload = ("\0"):rep(8), change = reboot }),
    record(3, 1.1, { change = reboot }), record(4, 1.2, { source = RIGHT, change = reboot }), record(5, 4.2, { change = reboot }) }, { frames = {} })
  list = {}
  for _, line in ipairs(lines(printed)) do list[#list + 1] = line:match("^ *[%d.]+ +(%d+) .*rebooted") end
  lu.assertEquals(list, { "3", "4", "5" })
end

-- For people a controller's messages are together, and without numbers it is the last one.
function T.test_messages_of_a_controller()
  local function of(id, name, message_type) return { bus_key = 1, bus = "can0", id = id, name = name, type = message_type } end
  local one, two, three = of(0x210, nil, MOTOR), of(0x211, nil, MOTOR), of(0x212, nil, MOTOR)
  local records = { record(1, 0, { source = of(0x200, nil, HEALTH), payload = ("\0"):rep(8) }), record(2, 0.1, { source = two, payload = payload(20) }),
    record(3, 0.2, { source = three }), record(4, 0.3, { source = one }), record(5, 0.4, { source = of(0x201, nil, HEALTH), payload = ("\0"):rep(8) }) }
  local ids = {}
  for id in run({ "summary" }, records):gmatch("0x2%x%x") do ids[#ids + 1] = id end
  lu.assertEquals(table.concat(ids, " ", 1, 5), "0x200 0x210 0x201 0x211 0x212")
  records[6] = record(6, 0.5, { source = of(0x20f, nil, MOTOR), payload = payload(255) }) -- never a number: the last one
  lu.assertStrMatches(run({ "compare" }, records, { frames = {} }), ".*\n *can0 0x212 +10%.00  10%.00  10%.00\n +can0 0x20f\n")
end

-- No false all-clear -----------------------------------------------------------------------------------------------

local known = {} -- sources by key

local function unknown(frame, bus, id, size, with)
  local key = bus .. id
  local source = not with and known[key] or { key = key, bus_key = bus, bus = bus ~= "" and bus or nil, id = id }
  known[key] = source
  for name, value in pairs(with or {}) do source[name] = value end
  return record(frame, frame, { source = source, payload = ("\0"):rep(size), fits = false })
end

-- The title of faults, without the sources that were not decoded, and the lines behind it.
local function said(records, with)
  local printed = run({ "faults" }, records, with):gsub("\n\n.*", "")
  return lines((printed:gsub("UNKNOWN, .- not decoded, (%d+) in what was decoded", "%1")))
end

-- A text for all, and an event for each source and size.
function T.test_messages_that_were_not_decoded()
  local records = { unknown(1, "can1", 0x212, 11), unknown(2, "can0", 0x213, 11), unknown(3, "can1", 0x211, 11),
    unknown(4, "can1", 0x211, 11), unknown(5, "can1", 0x210, 11, { type = MOTOR }) }
  lu.assertEquals(said(records)[2], "5 messages were not decoded: can0 0x213, can1 0x211, 0x212 (11 bytes each, the size of " ..
    "Motor Data); can1 0x210 (11 bytes, Motor Data with a YAPP CTL other than 0, see yapp.all_extended). " ..
    "Try -o yapp.motor_ids:0x210-0x213")
  local events = lines((run({ "events,json" }, records)))
  lu.assertEquals({ #events, events[4]:match('"like":"motor"') }, { 4, '"like":"motor"' })
  lu.assertStrContains(said({ records[3], records[4] })[2], "2 messages were not decoded: can1 0x211 (11 bytes each, the")
end

function T.test_what_an_answer_leaves_out()
  local good = { record(1, 5), record(2, 3, { source = RIGHT }) }
  local _, code, texts = run({ "summary" }, good, { problem = "own.lua was not read" })
  lu.assertEquals({ code, texts[1] }, { 21, "own.lua was not read" })
  local step = "time stamps went back %s: what lasted meanwhile seems too short"
  local printed = run({ "faults" }, { good[1], good[2], unknown(3, "can0", 0x300, 11) })
  lu.assertEquals({ lines(printed)[1], lines(printed)[2] },
    { "YAPP faults: UNKNOWN, 1 of 3 sources not decoded, 0 in what was decoded", step:format("1 time") })
  for size, expected in pairs { [2] = { ", and who is silent at the end is not known", "null 0" }, [0.5] = { "", "true 0" } } do
    local records = { good[1], record(2, 5 - size, { source = RIGHT }), record(3, 5 - 2 * size) }
    lu.assertEquals(lines(run({ "summary" }, records))[2], step:format("2 times") .. expected[1])
    lu.assertStrContains(verdicts("silence=0,motor.gap=9", records)[3], "motor.gap=9 left " .. expected[2])
  end
end

function T.test_messages_that_are_not_dissected()
  local function odd(frame) return record(frame, 1, { kind = "undissected", source = ODD, values = { size = 11 }, fits = false }) end
  lu.assertEquals(verdicts("unknown=0", { record(1, 0), odd(2) })[1], "unknown=0 null false 1 2")
  lu.assertEquals(verdicts("unknown=0", { record(1, 0), odd(2) }, { matches = { [1] = true } })[1], "unknown=0 null true 0 null")
  local printed, code = run({ "check" }, { odd(1) }, { extended = 5 })
  lu.assertEquals(code, 21)
  lu.assertStrContains(lines(printed)[3], "1 message was not decoded: can0 0x300 (11 bytes, the size of Motor Data). Try")
end

-- A message that was recorded twice counts once; the answer says it.
function T.test_copies()
  local function copy(frame, of) return record(frame, frame / 1000, { kind = "copies", values = { of = of } }) end
  local records = { record(1, 0), copy(2, 1), record(3, 0.003), copy(4, 3), copy(5, 3) }
  local twice = "2 messages were recorded twice; each counts once"
  for _, what in ipairs(IN_TEXT) do lu.assertStrContains(run({ what }, records), twice) end
  for _, verdict in ipairs(verdicts("", records)) do lu.assertNil(verdict:find("copies")) end
  lu.assertEquals(verdicts("copies=2,copies=3", records), { "copies=2 left false 3 2", "copies=3 left true 3 2",
    "unknown=0 null true 0 null" })
end

function T.test_messages_that_may_hide_faults()
  local title, text = "YAPP faults: 0", "damaged or lost messages may hide faults: "
  local records = { record(1, 0), bad(2, 0.1), bad(3, 0.2) }
  local two = text .. "2 with a bad CRC, 1 missing by their period" -- no good one came at 0.1 s
  lu.assertEquals(said(records), { title, two })
  local _, code, texts = run({ "faults,json" }, records)
  lu.assertEquals({ code, texts }, { 0, { two } })
  for _, what in ipairs { "check", "check,fault=0" } do
    lu.assertEquals(lines(run({ what }, records))[2], two)
  end
  for _, what in ipairs { "events", "summary", "check,crc=9" } do -- these count them, or look for no faults
    lu.assertNotStrContains(run({ what }, records), "hide")
  end
  lu.assertEquals(said { record(1, 0) }, { title })
  lu.assertEquals(said { record(1, 0), record(2, 1, { change = { late = 1 } }) }, -- 9 at 10 Hz
    { title, text .. "9 missing by their period, 9 of them in silences that are listed" })
  lu.assertEquals(said { record(1, 0, { seq = 1 }), record(2, 1, { seq = 2 }) }, { title }) -- Seq No would miss them
  lu.assertEquals(said { record(1, 0), bad(2, 0.1, { source = HEALTHY, payload = ("\0"):rep(8) }) }, { title })
  local later = record(2, 0, { payload = "\10\0\3\0\87\211\71\1\0\0\0" }) -- by its clock 1 s, with the stamp of the one before
  lu.assertEquals(said { record(1, 0), later, record(3, 0.1) }, { title, text .. "9 missing by their period" })
  -- of a message that is not known, nobody knows
  lu.assertEquals(said { record(1, 0), bad(2, 0.1, { source = ODD, fits = false }) }, { title, text .. "1 with a bad CRC" })
  local noise = record(2, 0.1, { kind = "skipped", source = { bus = "can0" }, values = { length = 7 }, fits = false })
  lu.assertEquals(said({ record(1, 0), noise }, { drops = { { count = 5, frame = 2 } } }),
    { title, text .. "5 lost while capturing, 1 in bytes of no frame" })
end

function T.test_sizes_that_no_preference_decodes()
  local short = record(2, 0, { payload = payload(10):sub(1, 9), fits = false })
  short.time, short.at = 2, 2
  lu.assertEquals(said({ unknown(1, "", 0x300, 20), short }), { "YAPP faults: 0",
    "2 messages were not decoded: 0x300 (20 bytes, the size of no known message); can0 0x210 (9 bytes, Motor Data has 11)" })
  local twin = { name = "twin", title = "Twin", id = 0x400, size = 15, { "text", "string", "Text", length = 15 } }
  local with = { catalogue = { messages = { MOTOR, catalogue_of.compile({ twin }).messages[1] } } }
  local long = record(2, 0, { payload = payload(10) .. "1234", undecoded = 4, change = raised(1, 1) })
  local printed = run({ "faults" }, { long }, with) -- what it begins with counts, not the message of that size
  lu.assertStrContains(printed, "1 message was decoded in part: can0 0x210 (15 bytes, Motor Data has 11)\n")
  lu.assertStrContains(printed, "hot   raised") -- a fault in it counts
  lu.assertEquals(lines(run({ "events,json" }, { long }))[1], '{"kind":"unknown","time":1700000000.000000005,"frame":2,' ..
    '"bus":"can0","id":528,"source":"left","message":"motor","size":15,"count":1,"like":null}')
  lu.assertEquals(verdicts("fault=9", { long })[2], "unknown=0 left false 1 2")
  lu.assertEquals(said({ unknown(1, "", 70000, 11) })[2], -- an ID that no preference takes
    "1 message was not decoded: 0x11170 (11 bytes, the size of Motor Data)")
end

function T.test_preferences_that_decode()
  local function advice(records, with) return said(records, with)[2]:match("Try (.*)") end
  lu.assertEquals(advice({ unknown(1, "a", 0x300, 11), unknown(2, "a", 0x301, 8) }, { ids = { motor = { 0x20, 0x21, 0x7ff } } }),
    "-o yapp.motor_ids:0x20-0x21,0x300,0x7ff -o yapp.health_ids:0x200,0x301")
  lu.assertEquals(advice { unknown(1, "a", 0x300, 11), unknown(2, "b", 0x300, 11), unknown(3, "c", 0x302, 11) },
    "-o yapp.motor_ids:0x210,0x300,0x302") -- one ID on two buses
  local catalogue = catalogue_of.compile { { name = "one", title = "One", id = 1, size = 3, { "a", "uint24", "A" } },
    { name = "two", title = "Two", id = 2, size = 3, { "a", "uint24", "A" } } }
  lu.assertEquals(said({ unknown(1, "a", 0x300, 3) }, { catalogue = catalogue })[2],
    "1 message was not decoded: a 0x300 (3 bytes, the size of One and of Two)")
  -- one ID, several messages: no preference of IDs tells them apart
  lu.assertNil(advice({ unknown(1, "a", 0x300, 11), unknown(2, "b", 0x300, 8) }))
  lu.assertNil(advice({ unknown(1, "a", 0x210, 8, { type = MOTOR }) }))
  -- two sizes of one source
  lu.assertEquals(advice { unknown(1, "a", 0x300, 11), unknown(2, "a", 0x300, 20) }, "-o yapp.motor_ids:0x210,0x300")
end

function T.test_nothing_to_judge_by()
  local function note(rules, records, with)
    return run({ "check" .. rules }, records, with):match("NOT JUDGED  %S+  +(%S[^\n]*)\n")
  end
  lu.assertEquals(note("", {}, { extended = 1 }),
    "no YAPP message found; 1 extended CAN frame was not dissected: see yapp.motor_ids, yapp.all_extended")
  lu.assertStrContains(note(",source=who,crc=0", { record(1, 0) }), answers.TOO_FEW)
  lu.assertStrContains(note(",absent=0", { record(1, 0) }), "no source is named with a message: see yapp.sources")
  lu.assertStrContains(note(",motor.volts.spread=1", { record(1, 0) }), answers.TOO_FEW)
  lu.assertStrContains(run({ "check" }, { record(1, 0) }, { matches = {} }), "no message matches the filter\n")
end

local CHANGED = { missing = { 3, '"count":3', "messages missing by Seq No: 3" },
  reboot = { 12.3, "", "controller rebooted (its clock went back by 12.300 s)" },
  stale = { true, "", "controller clock did not advance" },
  jump = { 3.25, '"length":3.250000000', "controller clock jumped ahead by 3.250 s" },
  shared = { true, "", "two controllers appear to send this ID" } }

-- fields.json describes each key of JSON, once.
function T.test_each_value_of_a_kind_is_a_column()
  local described = {}
  for _, column in ipairs(options_of.BY_NAME.events.columns.all) do
    if column.type then
      lu.assertNil(described[column.name])
      lu.assertStrContains(column.help, " ")
      described[column.name] = true
    end
  end
  for _, row in ipairs(kinds_of.LIST) do
    for key in (row.keys or ""):gmatch("%S+") do lu.assertTrue(described[key], key) end
  end
end

function T.test_kinds_that_are_changes()
  for _, row in ipairs(kinds_of.LIST) do
    local expected = CHANGED[row.name]
    lu.assertEquals(expected ~= nil, row.change ~= nil, row.name .. ": a row of CHANGED")
    if expected then
      local records = { record(1, 0), record(2, 0.1, { change = { [row.name] = expected[1] } }) }
      local json = lines((run({ "events,json" }, records)))
      lu.assertEquals({ #json, json[1] }, { 1, ('{"kind":"%s","time":1700000000.100000005,"frame":2,"bus":"can0","id":528,'):format(
        row.name) .. '"source":"left","message":"motor"' .. (expected[2] ~= "" and "," or "") .. expected[2] .. "}" })
      lu.assertStrContains(run({ "events" }, records), expected[3])
      local missing = ('"missing":%d,'):format(row.name == "missing" and expected[1] or 0)
      lu.assertStrContains(run({ "summary,json" }, records), missing)
      local seen = type(expected[1]) == "number" and row.amount and expected[1] or 1
      local rules = ("%s=%d,%s=%d"):format(row.name, seen - 1, row.name, seen)
      lu.assertEquals(verdicts(rules, records), { ("%s=%d left false %d 2"):format(row.name, seen - 1, seen),
        ("%s=%d left true %d 2"):format(row.name, seen, seen), "unknown=0 null true 0 null" })
    end
  end
end

-- Once two controllers share a source, what follows from its messages is unreliable; and that is said.
function T.test_a_source_that_two_controllers_share()
  local records = { record(1, 0), record(2, 0.1, { change = { shared = true }, is_unreliable = true }),
    record(3, 0.2, { is_unreliable = true }) }
  local text = "two controllers appear to send can0 0x210: from frame 2 on changes of faults, reboots and gaps are " ..
    "unreliable and left out"
  for _, what in ipairs { "faults", "events", "summary" } do
    local printed, code, texts = run({ what }, records, { last = 9 })
    lu.assertEquals({ lines(printed)[2], code, texts }, { text, 21, { text } })
    lu.assertEquals(select(2, run({ what .. ",json" }, records)), 21)
  end
  lu.assertEquals(found("events,json", "kind", records, { last = 9 }), { '{"kind":"shared",}' }) -- no silence
  local faulty = { record(1, 0, { change = raised(1, 1) }), record(2, 0.1), records[3] }
  lu.assertEquals(found("faults,json", "active\"", faulty)[2], -- up to the last message of which that is known
    '{,"field":"fault_flags","flag":"hot","event":"active","active":0.100000000,"help":null}')
  lu.assertEquals(verdicts("shared=0,fault=0,motor.gap=9,motor.rate=1,crc=0", records), { "shared=0 left false 1 2",
    "fault=0 left null 0 null", "motor.gap=9 left null 0.1 2", "motor.rate=1 left null 10 3", "crc=0 left true 0 null",
    "unknown=0 null true 0 null" })
end

-- Words ----------------------------------------------------------------------------------------------------------

-- A field may be called as a measure, a suffix or an option is: no rule is about another thing than it says.
function T.test_names_cannot_collide()
  for _, name in ipairs { "count", "rate", "gap", "mean", "spread", "over", "special", "value", "when", "json", "fault", "crc" } do
    local catalogue = catalogue_of.compile { { name = name, title = "Own", id = 1, size = 1, { name, "uint8", "Own" } } }
    local function rule_of(text)
      local options = options_of.parse("yapp,check," .. text:gsub("NAME", name), catalogue)
      return options.rules[1], options.problems[1]
    end
    local field, rule, problem = catalogue.messages[1].by_name[name], rule_of("NAME.NAME=3..4")
    if input.find(measures_of.OF_MESSAGE, name) then
      lu.assertStrContains(problem or rule.kind.name, name)
    else
      lu.assertEquals({ rule.field, rule.kind.name }, { field, "value" })
    end
    lu.assertEquals(rule_of("NAME.NAME.value=3..4").field, field)
    rule = rule_of("NAME.NAME.over(NAME)=1:2..3;4:5..6 when=NAME=7 for=8")
    lu.assertEquals({ rule.kind.name, rule.field, rule.other, rule.tests[1].field, rule.hold },
      { "over", field, field, field, 8 })
    if kinds_of.BY_NAME[name] then lu.assertEquals(rule_of("NAME=0").kind.name, name) end
  end
end

function T.test_the_clock_of_the_capture()
  local records = { record(1, 100), record(2, 100.1), record(3, 50), record(4, 50.05), record(5, 50.049) }
  lu.assertEquals(found("events,json", "clock", records, { last = 50.2 }), { '{"kind":"clock",,"length":-50.100000000}' })
  lu.assertStrContains(run({ "events,json" }, records), '"kind":"clock","time":1700000050.000000005,"frame":3,"bus":null,' ..
    '"id":null,"source":null,"message":null,"length":-50.1')
  lu.assertStrContains(run({ "events" }, records), "the capture's own clock went back by 50.100 s")
  lu.assertEquals(verdicts("clock=0,clock=1", records), { "clock=0 null false 1 3", "clock=1 null true 1 3",
    "unknown=0 null true 0 null" })
  -- the motor is dead behind the step: a silence of 30 s to the end
  lu.assertEquals(found("events,json", "silence", { record(1, 100), record(2, 100.1) }, { last = 50 })[1], nil)
  local with = { unfinished = {}, last = 80 }
  local dead = { record(1, 100), record(2, 100.1), record(3, 50, { source = ODD, fits = false }) }
  lu.assertEquals(found("events,json", "silence", dead, with), { '{"kind":"silence",,"length":30.000000000}' })
  lu.assertEquals(verdicts("motor.gap=1", dead, with)[1], "motor.gap=1 left false 30 2")
  for frame = 3, 6 do dead[frame] = record(frame, 100 + frame % 2 / 50, { source = ODD, fits = false }) end -- in turns
  lu.assertEquals(verdicts("motor.gap=1", dead, { unfinished = {}, last = 130 })[1], "motor.gap=1 left false 29.82 2")
  lu.assertEquals(select(2, verdicts("", { record(1, 0.5), record(2, 0.4991) }, { last = 0.5 })), 0) -- interfaces take turns
end

-- Two buses whose packets were written in turns of 0.2 s; and a raw dump, whose times are those of the controllers.
function T.test_times_of_each_bus_or_controller_ascend()
  local records = {}
  for turn = 0, 3 do
    for _, source in ipairs { LEFT, RIGHT } do
      for i = 0, 1 do
        records[#records + 1] = record(#records + 1, 0.2 * turn + 0.1 * i, { source = source })
      end
    end
  end
  for row = 1, 2 do
    lu.assertStrContains(verdicts("motor.gap=0.1,motor.rate=10", records)[row], "true 0.1")
  end
  lu.assertEquals(found("events,json", "silence", records), {})
  local dump = { record(1, 900), record(2, 20, { source = RIGHT }), record(3, 900.1), record(4, 20.1, { source = RIGHT }) }
  lu.assertEquals(verdicts("motor.gap=0.1,clock=0", dump, { lacks_clock = true }), { "motor.gap=0.1 left true 0.1 3",
    "motor.gap=0.1 null true 0.1 4", "clock=0 null true 0 null", "unknown=0 null true 0 null" })
end

function T.test_packets_that_were_dropped()
  local drops = { { time = 1700000000.25, frame = 3, bus = "can0", count = 37 }, { count = 5 } }
  lu.assertEquals(lines((run({ "events,json" }, { record(1, 0), record(2, 0.1) }, { drops = drops }))), {
    '{"kind":"dropped","time":1700000000.250000005,"frame":3,"bus":"can0","id":null,"source":null,"message":null,"count":37}',
    '{"kind":"dropped","time":null,"frame":null,"bus":null,"id":null,"source":null,"message":null,"count":5}' })
  lu.assertStrContains(run({ "events" }, { record(1, 0) }, { drops = drops }), "packets lost while capturing: 37")
  local order = {} -- by time; those without one come last
  for i, line in ipairs(lines((run({ "events,json" }, { record(1, 0), bad(4, 0.5) }, { drops = drops })))) do
    order[i] = line:match('"kind":"(%w+)"')
  end
  lu.assertEquals(order, { "silence", "dropped", "crc", "dropped" })
  lu.assertEquals(verdicts("dropped=41,dropped=42", { record(1, 0) }, { drops = drops }), { "dropped=41 null false 42 3",
    "dropped=42 null true 42 3", "unknown=0 null true 0 null" })
  lu.assertEquals(lines((run({ "faults,json" }, { record(1, 0) }, { drops = drops }))), {})
end

-- An adapter without a clock of its own gives all packets one time, not always 0.
function T.test_stamps_that_are_all_equal_are_none()
  local why = "all packets of this capture have the same time stamp"
  for _, time in ipairs { 0, 7.5 } do
    local records = { record(1, time, { change = raised(1, 1) }), record(2, time, { change = raised(0, 0, 1) }),
      record(3, time, { change = raised(2, 2) }) }
    for _, what in ipairs(IN_TEXT) do lu.assertStrContains(run({ what }, records), why, what) end
    for _, what in ipairs(AS_DATA) do
      lu.assertStrContains(table.concat(select(3, run({ what }, records)), "\n"), why, what)
    end
    local _, count = run({ "faults,json" }, records):gsub('"active":null', "")
    lu.assertEquals(count, 4) -- raised, cleared, raised, still active
    lu.assertNotStrContains(run({ "events" }, records), "after 0")
    lu.assertEquals(select(2, verdicts("silence=0,motor.gap=0.3,motor.rate=1", records)), 21)
    lu.assertStrContains(run({ "summary,json" }, records), '"rate":null,"gap_min":null,"gap_mean":null,"gap_max":null')
    records[4] = record(4, time + 0.001)
    for _, what in ipairs(IN_TEXT) do lu.assertNotStrContains(run({ what }, records), why, what) end
  end
  lu.assertNotStrContains(run({ "check" }, { record(1, 0) }), why) -- a single packet has one time by nature
end

-- Rules about time cannot be judged where packets have no time stamps.
function T.test_packets_without_time_stamps()
  local with = { lacks_times = true }
  local records = { record(1, 0), record(2, 0, { change = { stale = true, jump = 2 } }) }
  local judged = {}
  local rules = { "motor.rate=1", "motor.rate=..9", "motor.gap=1", "motor.volts.spread=1", "motor.volts=..1 for=1",
    "motor.volts=..1 when=mode=3 after=1" }
  for _, row in ipairs(kinds_of.LIST) do
    if row.needs_time then rules[#rules + 1] = row.name .. "=0" end
  end
  for _, rule in ipairs(rules) do
    local printed, code = run({ "check," .. rule }, records, with)
    lu.assertEquals(code, 21, rule)
    lu.assertStrContains(printed, "packets of this capture have no time stamps")
    judged[rule:match("(%l+)=")] = true
  end
  for _, row in ipairs(measures_of.LIST) do lu.assertEquals(judged[row.name], row.needs_time, row.name .. ": a rule of it above, if it needs times") end
  lu.assertEquals(select(2, verdicts("fault=0,crc=0,motor.count=2,motor.volts=..10", records, with)), 0)
  lu.assertEquals(run({ "events,json" }, records, with), "")
  lu.assertStrContains(run({ "summary,json" }, records, with), '"rate":null,"gap_min":null,"gap_mean":null,"gap_max":null,"gap_max_frame":null')
end

-- Options -------------------------------------------------------------------------------------------------------

function T.test_options()
  local function read_options(text) return options_of.parse("yapp," .. text, CATALOGUE) end
  local options = read_options("summary,json,filter=a == 1, b,filter=c")
  lu.assertEquals({ options.what, options.json, options.filter, options.problems },
    { "summary", true, "a == 1, b,filter=c", {} })
  options = read_options("csv,a/b,all,replace,json")
  lu.assertEquals({ options.folder, options.all, options.replace, options.json }, { "a/b", true, true, true })
  lu.assertEquals(read_options("csv,-,motor,all").chosen, MOTOR)
  options = read_options("fault,3,frame=7")
  lu.assertEquals({ options.number, options.frame, options.problems }, { 3, 7, {} })
  lu.assertEquals(read_options("check,crc=0,junit=a=b.xml").junit, "a=b.xml")
  options = read_options("check, fault = 0 ,motor.volts = 1..2 , filter = a == 1")
  lu.assertEquals({ options.rules[1].text, options.rules[2].text, options.rules[2].points[1].high, options.filter, options.problems },
    { "fault=0", "motor.volts=1..2", 2, " a == 1", {} })
  options = read_options("check, motor.volts = 1..2  when = fault.hot&!fault.stall  after = 1")
  lu.assertEquals({ options.rules[1].text, options.rules[1].limit, options.problems },
    { "motor.volts=1..2 when=fault.hot&!fault.stall after=1", "1..2", {} })
  lu.assertEquals({ read_options("csv, a b , all").folder, read_options("summary , json").json }, { "a b", true })
end

-- The start of tshark registers these names before it loads the rows.
function T.test_the_names_of_the_statistics()
  local names = {}
  for i, row in ipairs(options_of.LIST) do names[i] = row.name end
  lu.assertEquals(require("yapp.stat.names"), names, "yapp/stat/names.lua")
  lu.assertEquals({ names[#names], #options_of.MENUS }, { "watch", #names - 1 }) -- in tshark alone
end

function T.test_wrong_options_are_named()
  local RANGE = "a range is A..B, A.. or ..B, from the lower to the higher end"
  local POINTS = "the points are X:A..B;X:A..B, from the lowest X to the highest"
  local expected = {
    ["csv"] = "csv: it is csv,FOLDER or csv,-,MESSAGE",
    ["csv,-,moter"] = 'moter: no message "moter"; known: motor, note, health',
    ["watch,stop=rule"] = "watch: stop=rule is about rules=FILE",
    ["check,fault"] = 'fault: "" is not a number',
    ["check,source=a,source=b,crc=0"] = "check: no rule follows source=a",
    ["check,crc=0,source=a"] = "check: no rule follows source=a",
    ["check,crc=-1"] = 'crc=-1: "-1" is not a number',
    ["check,motor.rate=nan"] = 'motor.rate=nan: "nan" is not a number',
    ["check,motor.volt=1..2"] = 'motor.volt=1..2: no field "volt"; known: volts, fault_flags, mode, clock',
    ["check,motor.volts.men=3"] = 'motor.volts.men=3: no measure "men"; known: ' .. select(2, input.find(measures_of.OF_FIELD, "")),
    ["check,motor.volts=.."] = "motor.volts=..: " .. RANGE,
    ["check,motor.volts=5..4"] = "motor.volts=5..4: " .. RANGE,
    ["check,motor.volts=0x5..9"] = "motor.volts=0x5..9: " .. RANGE,
    ["check,rules=none.txt"] = "rules=none.txt: none.txt: No such file or directory",
    ["check,crc=1 0"] = 'crc=1 0: no suffix "0"; known: ' .. select(2, input.find(measures_of.SUFFIXES, "")),
    ["check,crc=1 for=1"] = "crc=1 for=1: for= is for rules about values, such as motor.dc_voltage=40..55",
    ["check,motor.volts.mean=..3 for=1"] = "motor.volts.mean=..3 for=1: for= is for rules about values, such as motor.dc_voltage=40..55",
    ["check,motor.volts=..3 after=x"] = 'motor.volts=..3 after=x: "x" is not a number',
    ["check,motor.volts=..3 when=fault.hto"] = 'motor.volts=..3 when=fault.hto: no flag "fault.hto"; known: fault.hot, fault.stall',
    ["check,motor.volts=..3 when=!mode=3"] = 'motor.volts=..3 when=!mode=3: no field "!mode"; known: volts, fault_flags, mode, clock',
    ["check,motor.volts.over(mod)=0:1..2;3:1..2"] = 'motor.volts.over(mod)=0:1..2;3:1..2: no field "mod"; known: volts, fault_flags, mode, clock',
    ["check,motor.volts.over(mode)=3:1..2;0:1..2"] = "motor.volts.over(mode)=3:1..2;0:1..2: " .. POINTS,
  }
  for _, text in ipairs { "summary,jsn", "csv,x,over", "fault,x", "buses,bitrate=fast", "watch,stop=now" } do
    local row, part = options_of.BY_NAME[text:match("%l+")], text:match("[^,]+$")
    expected[text] = ("%s: the options of %s are %s, filter=EXPRESSION"):format(part, row.name, row.options)
  end
  for text, problem in pairs(expected) do
    lu.assertEquals(options_of.parse("yapp," .. text, CATALOGUE).problems[1], problem)
  end
  lu.assertStrContains(options_of.parse("yapp,check,x=1", CATALOGUE).problems[1], 'x=1: no rule "x"; known: ' .. kinds_of.RULES[1].name)
  lu.assertStrContains(options_of.parse("yapp,nonsense", CATALOGUE).problems[1], "nonsense: no such statistic; known: " .. options_of.LIST[1].name)
end

-- One a line; a # begins a comment, but for one in the name of a source.
function T.test_a_file_of_rules()
  with_folder(function(folder)
    local path = folder .. "/rules.txt"
    local function read_file(text, more)
      local file = assert(io.open(path, "wb"))
      file:write(text)
      file:close()
      local options, texts = options_of.parse(("yapp,check,rules=%s%s"):format(path, more or ""), CATALOGUE), {}
      for i, rule in ipairs(options.rules) do texts[i] = (rule.source and rule.source .. ": " or "") .. rule.text end
      return table.concat(texts, " "), options.problems
    end
    lu.assertEquals({ read_file("\239\187\191# rules\r\n fault = 0 # none\r\n\r\ncrc=1 #\r\nunknown=2", ",motor.rate=9") },
      { "fault=0 crc=1 unknown=2 motor.rate=9", {} })
    lu.assertEquals(read_file("source=any#3 # left\nfault=0\nunknown=0\n"), "any#3: fault=0 any#3: unknown=0")
    -- a source of the file is not one of the rules behind it
    lu.assertStrContains((read_file("source=left\nfault=0\n", ",crc=0")), "left: fault=0")
    lu.assertNotStrContains((read_file("source=left\nfault=0\n", ",crc=0")), "left: crc=0")
    lu.assertEquals(options_of.parse(("yapp,watch,stop=rule,rules=%s"):format(path), CATALOGUE).problems, {})
    local text, problems = read_file("fault=0\nmotor.rate=fast\n\nrules=x\n", ",crc=a")
    lu.assertEquals({ text, problems[1], problems[3] }, { "fault=0 unknown=0", path .. ':2: motor.rate=fast: "fast" is not a number',
      'crc=a: "a" is not a number' })
    lu.assertStrContains(problems[2], path .. ':4: rules=x: no rule "rules"')
    lu.assertEquals(select(2, read_file("fault=x\n")), { path .. ':1: fault=x: "x" is not a number' })
    for _, empty in ipairs { "", "# fault=0\n\n" } do
      lu.assertEquals({ read_file(empty) }, { "unknown=0", { ("rules=%s: there is no rule in it"):format(path) } })
    end
  end)
end

return T
