-- SPDX-License-Identifier: GPL-2.0-or-later
-- The catalogue's checks: every error names the message and the field.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local catalogue = require("yapp.message.catalogue")
local text_of = require("yapp.message.text")

local T = {}

-- A good message with changes: of the message, or (field) of its first field.
local function message(changes, field)
  local row = { "f", "uint8", "F" }
  for k, v in pairs(field or {}) do row[k] = v end
  local entry = { name = "m", title = "M", id = 1, size = 1, row }
  for k, v in pairs(changes or {}) do entry[k] = v end
  return entry
end

function T.test_the_real_catalogue()
  local compiled, problems = catalogue.compile(dofile("taurus_fields.lua"))
  lu.assertEquals(problems, {})
  for id, size in pairs { [0] = 7, [0x200] = 17, [0x210] = 32 } do lu.assertEquals(compiled.by_id[id].size, size) end
  lu.assertEquals(compiled.by_id[0x210].by_name.fault_flags.offset, 18)
  lu.assertEquals(compiled.by_id[0x210].by_name.fault_flags.flags[1].filter, "taurus.motor.fault.oc_limit_unmeasurable")
  lu.assertEquals(compiled.by_id[0x210].by_name.status_flags.undefined, 0xBC000FFD)
end

function T.test_what_is_wrong_with_a_message_is_said()
  for _, row in ipairs {
    { { name = "Bad" }, 'message 1: name "Bad"' },
    { { name = false }, "message 1: name false" },
    { { name = ("N"):rep(50) }, ('message 1: name "%s" is'):format(("N"):rep(40)) },
    { { section = ("s"):rep(1001) }, "message m: section must be a text" },
    { { name = "m", title = "" }, "message m: the title" },
    { { title = ("t"):rep(201) }, "message m: the title has more than 200 bytes" },
    { { min_size = 0 }, "message m: min_size 0" }, { { min_size = 2 }, "message m: min_size 2" },
    { { id = 2048 }, "message m: id 2048" }, { { id = -1 }, "message m: id -1" }, { { id = 1.5 }, "message m: id 1.5" },
    { { id = "1" }, 'message m: id "1"' }, { { id = 0 / 0 }, "message m: id" },
    { { size = 2 }, "message m: size is 2, but the fields add up to 1" },
    { { size = 0 }, "message m: size 0" }, { { size = 65536 }, "message m: size 65536" },
    { { size = "1" }, 'message m: size "1"' },
    { { info = 5 }, "message m: info must be a text" },
    { { info = "{g}" }, 'message m: info names a field "g"' },
    { { info = "{f unit}" }, "message m: info: f has no unit" },
    { { info = "{f:%d}" }, "message m: info: the format" }, { { info = "{f:%.1f}" }, "message m: info: the format" },
    { { info = "{f:%d}", [1] = { "f", "float8", "F", min = 0, max = 1 } }, "message m: info: the format" },
    { { info = "{f:%99.1f}", [1] = { "f", "float8", "F", min = 0, max = 1 } }, "message m: info: the format" },
    { { name = ("n"):rep(65) }, "is not a filter name" },
    { { [1] = 5 }, "message m, field 1: a field is a row" },
    { { section = "" }, "message m: section must be a text" },
    { { rate = 5 }, 'message m: unknown option "rate"; a message has answers, derived, differences, every, id,' },
    { { every = 0 }, "message m: every 0 is not a period" }, { { every = "1" }, 'message m: every "1" is not' },
    { { answers = "A b" }, 'message m: answers "A b" is not the name of a message' },
    { { differences = 5 }, "message m: differences must be a table" },
    { { differences = { { "d", "f", "g", "D" } } }, 'message m: difference d: "g" is no field of numbers' },
    { { differences = { { "d", "f", "f" } } }, "message m: difference d has no title" },
    { { derived = { { "d", "f * g", "D" } } }, 'message m: derived d: "g" is no field of numbers' },
    { { derived = { { "d", "f / f", "D" } } }, 'message m: derived d: "f / f" is not two fields with *, + or -' },
    { { derived = { { "d", "f * f * f", "D" } } }, 'derived d: "f * f * f" is not two fields' },
    { { derived = { { "d", 5, "D" } } }, "message m: derived d: 5 is not two fields" },
    { { derived = { { "d", nil, "D" } } }, "message m: derived d: nil is not two fields" },
    { { derived = { { "d", "f*f" } } }, "message m: derived d has no title" },
    { { [1] = { "f", "bool", "F" }, [2] = { "v", "variants", by = "f", cases = { [2] = {} } } },
      "field v: value 2 does not fit the type bool" },
    { { [1] = { "f", "uint8", "F" }, [2] = { "v", "variants", by = "f" } }, "field v: cases is missing" },
    { { size = 8, [1] = { "f", "uint64", "F" }, [2] = { "v", "variants", by = "f", cases = {} } },
      'field v: by "f" is not an earlier integer' },
    { { derived = { { "d", "f*f", "D", units = "V" } } }, 'unknown option "units"; derived d has unit' },
    { { derived = { { "d", "f*f", "D", unit = 5 } } }, "message m: unit must be a text" },
    { { derived = { { "f", "f*f", "D" } } }, "message m, field f: the filter name taurus.m.f is taken" },
    { { derived = { 5 } }, "message m: derived 1: 5 is not { name" },
    { { derived = "f*f" }, "message m: derived must be a table" },
    { { derived = { { "d", "f*f", "D" } }, [1] = { "f", "uint8", "F", values = {} } }, '"f" is no field of' },
    { { min_size = 0 }, "message m: min_size 0 is not one of 1 .. 1" }, { { min_size = 2 }, "min_size 2 is" },
    { { min_size = "1" }, 'message m: min_size "1"' }, { { min_size = 0.5 }, "message m: min_size 0.5" },
    { { size = 3, min_size = 2, [2] = { "g", "uint16", "G" } }, "message m, field g: min_size 2 ends inside it" },
    { { differences = { { "f", "f", "f", "D" } } }, "message m, field f: the filter name taurus.m.f is taken" },
    { { [1] = { "f", "int64_ns", "F" }, [2] = { "clock_drift", "uint8", "C" }, size = 9 },
      "message m, field clock_drift: the filter name taurus.m.clock_drift is taken" },
    { { [2] = { "f", "uint8", "F" }, size = 2 }, "message m, field f: the name is there twice" },
  } do
    local compiled, problems = catalogue.compile { message(row[1]) }
    lu.assertStrContains(problems[1] or "nothing", row[2])
    lu.assertEquals({ #compiled.messages, #problems }, { 0, 1 }, row[2])
  end
end

function T.test_what_is_wrong_with_a_field_is_said()
  for _, row in ipairs {
    { { [1] = "F" }, 'field 1: "F" is not a filter name' }, { { [1] = false }, "field 1: false is not a filter name" },
    { { [2] = "int7" }, 'field f: unknown type "int7"; the types are ' },
    { { [2] = false }, "field f: unknown type false" },
    { { [3] = "" }, "field f: the title" },
    { { unit = 5 }, "field f: unit" }, { { group = "g" }, "field f: group and alarm are for" },
    { { alarm = "FAULT" }, "field f: group and alarm" },
    { { [2] = "float8" }, "field f: float8 needs min and max" },
    { { [2] = "float8", min = 1, max = 1 }, "field f: float8 needs min and max" },
    { { [2] = "float8", min = 2, max = 1 }, "field f: float8 needs min and max" },
    { { [2] = "float8", min = 0, max = math.huge }, "field f: float8 needs min and max" },
    { { [2] = "float8", min = 0 / 0, max = 1 }, "field f: float8 needs min and max" },
    { { [2] = "float8", min = "0", max = 1 }, "field f: float8 needs min and max" },
    { { [2] = "float32", min = -1.7e308, max = 1.7e308 }, "the range from -1.7e+308 to 1.7e+308 is too large" },
    { { [2] = "float64", min = 1e300, max = 1.1e300 }, "field f: the range from 1e+300 to 1.1e+300 is too large" },
    { { [2] = "uint32", scale = 1e308 }, "field f: scale 1e+308 is too large" },
    { { [2] = "float8", min = 0, max = 1, values = {} }, 'field f: unknown option "values"; type float8 has count' },
    { { units = "V" }, 'field f: unknown option "units"; type uint8 has alarm, bits, count' },
    { { [4] = "V" }, "field f: unknown option 4" },
    { { [2] = "int64_ns", unit = "s" }, 'unknown option "unit"; type int64_ns has section', 8 },
    { { scale = 0 }, "field f: scale 0 is not" }, { { scale = "x" }, 'field f: scale "x" is not' },
    { { offset = 1 / 0 }, "field f: offset" },
    { { scale = 2, values = {} }, "field f: a field has a scale, or values" },
    { { count = 0 }, "field f: count 0 is not" }, { { count = 65536 }, "field f: count 65536 is not" },
    { { count = 2, flags = {}, group = "g" }, "field f: flags and bits are not for an array" },
    { { [2] = "string" }, "field f: string needs a length" }, { { [2] = "bytes", length = 0 }, "bytes needs a" },
    { { [2] = "padding" }, "field f: padding needs a length" },
    { { [2] = "variants", by = "g", cases = {} }, 'field f: by "g" is not an earlier' },
    { { bits = 5 }, "field f: bits must be a table" }, { { bits = { 5 } }, "field f: bits 1: 5 is not" },
    { { bits = { { "a", 5, "A" } } }, "field f: bits a: the bits of mask 0x5 are not side by" },
    { { bits = { { "a", 3, "A" }, { "b", 2, "B" } } }, "field f: bits b: bit 0x2 is already another's" },
    { { bits = { { "a", 256, "A" } } }, "field f: bits a: mask 256 does not fit" },
    { { bits = { { "a", 3, "A", values = { [4] = "x" } } } }, "field f: value 4 does not fit" },
    { { bits = { { "a", 3, "A", min = 1 } } }, 'field f: unknown option "min"; bits a has invalid' },
    { { bits = { { "a", 3, "A" } },
      flags = { { "x", 1, "X" } }, group = "g" }, "bits a: bit 0x1 is already" },
    { { [2] = "int8", values = { [128] = "x" } }, "field f: value 128 does not fit the type int8" },
    { { values = 5 }, "field f: values must be a table" },
    { { values = { [256] = "x" } }, "field f: value 256" }, { { values = { [-1] = "x" } }, "field f: value -1" },
    { { values = { x = "x" } }, 'field f: value "x"' }, { { values = { [1] = 5 } }, "field f: value 1 has no meaning" },
    { { values = {}, flags = {}, group = "g" }, "field f: a field has values or flags" },
    { { flags = 5, group = "g" }, "field f: flags must be a table" }, { { flags = {} }, "field f: flags need a group" },
    { { flags = { 5 }, group = "g" }, "field f: flag 1" },
    { { flags = { { "A", 1, "A" } }, group = "g" }, 'field f: flag 1: "A"' },
    { { flags = { { "a", 0, "A" } }, group = "g" }, "field f: flag a: mask 0" },
    { { flags = { { "a", 256, "A" } }, group = "g" }, "field f: flag a: mask 256" },
    { { flags = { { "a", 1 } }, group = "g" }, "field f: flag a has no title" },
    { { flags = { { "a", 1, "A" }, { "a", 2, "A" } }, group = "g" }, "field f: the filter name taurus.m.g.a is taken" },
    { { flags = { { "a", 1, "A", alarm = "X" } }, group = "g" }, "field f: flag a: alarm is true" },
    { { flags = { { "a", 1, "A", help = 5 } }, group = "g" }, "field f: help must be a text" },
    { { flags = { { "a", 1, "A", unit = 5 } }, group = "g" }, 'unknown option "unit"; flag a has alarm, help' },
    { { section = 5 }, "field f: section must be a text" },
    { { flags = { { "undefined", 1, "A" } }, group = "g" }, "field f: the filter name taurus.m.g.undefined is taken" },
    { { flags = { { "a", 3, "A" }, { "b", 2, "B" } }, group = "g" }, "field f: flag b: bit 0x2 is already another" },
  } do
    local compiled, problems = catalogue.compile { message(row[3] and { size = row[3] }, row[1]) }
    lu.assertStrContains(problems[1] or "nothing", row[2])
    lu.assertStrContains(problems[1] or "nothing", "message m, field ")
    lu.assertEquals({ #compiled.messages, #problems }, { 0, 1 }, row[2])
  end
end

function T.test_filter_names_that_meet()
  local _, problems = catalogue.compile { message({ size = 2, [2] = { "g", "uint8", "G", group = "f",
    flags = { { "x", 1, "X" } } }, [3] = nil }) }
  lu.assertEquals(problems, {})
  _, problems = catalogue.compile { message({ size = 3,
    [2] = { "g", "uint8", "G", group = "s", flags = { { "x", 1, "X" } } },
    [3] = { "h", "uint8", "H", group = "s", flags = { { "x", 1, "X" } } } }) }
  lu.assertStrContains(problems[1], "message m, field h: the filter name taurus.m.s.")
end

function T.test_the_longest_names_and_the_largest_messages()
  local compiled, problems = catalogue.compile {
    message { name = ("n"):rep(64), title = ("t"):rep(200), section = ("s"):rep(1000), id = 2047, min_size = 1 },
    message({ size = 65535 }, { "b", "bytes", "B", length = 65535 }),
    message({ name = "array", id = 2, size = 300 }, { "a", "uint8", "A", count = 300 }),
    message({ name = "by", id = 3, size = 5,
      [2] = { "v", "variants", by = "f", cases = { [0] = { { "w", "uint8", "W" } } } } },
      { "f", "uint32", "F" }) }
  lu.assertEquals({ #compiled.messages, problems }, { 4, {} })
end

-- Wireshark's types of all filters of a message, with base and mask.
function T.test_types_of_filters()
  local compiled, problems = catalogue.compile { { name = "m", title = "M", id = 1, size = 41, answers = "command",
    { "u", "uint16", "U" }, { "e", "uint8", "E", values = { [0] = "off" } }, { "i", "int16", "I" },
    { "t", "int64_ns", "T" }, { "b", "bool", "B" }, { "f", "float8", "F", min = 0, max = 1 }, { "d", "float64", "D" },
    { "s", "string", "S", length = 2 }, { "y", "bytes", "Y", length = 2 }, { "c", "uint8", "C", scale = 0.5 },
    { "w", "uint64", "W" }, { "k", "uint8", "K", group = "z", bits = { { "low", 0x0F, "Low" } } },
    { "g", "uint32", "G", group = "x", alarm = "A", flags = { { "hot", 8, "Hot" } } } } }
  lu.assertEquals(problems, {})
  local found = {}
  for _, row in ipairs(compiled.messages[1].filters) do
    found[row[1]:gsub("taurus%.m%.?", "")] = ("%s %s %s"):format(row[2], row[5] or "", row[7] or ""):gsub(" +$", "")
  end
  lu.assertEquals(compiled.messages[1].by_name.f.filters, { "taurus.m.f.special", "taurus.m.f" }) -- and those below it
  lu.assertEquals(found, { [""] = "NONE", clock_drift = "RELATIVE_TIME", command_in = "FRAMENUM", u = "UINT16",
    e = "UINT8 HEX", i = "INT16", t = "RELATIVE_TIME", b = "BOOLEAN", f = "DOUBLE", ["f.special"] = "UINT8",
    d = "DOUBLE", ["d.special"] = "UINT8", s = "STRING", y = "BYTES", c = "DOUBLE", w = "UINT64", g = "UINT32 HEX",
    ["g.names"] = "STRING", ["x.hot"] = "BOOLEAN 32 8", ["x.undefined"] = "UINT32 HEX", ["x.raised"] = "UINT32 HEX",
    ["x.cleared"] = "UINT32 HEX", ["x.active_time"] = "RELATIVE_TIME", ["x.previous_change"] = "FRAMENUM",
    ["x.next_change"] = "FRAMENUM", ["x.raised_in"] = "FRAMENUM", ["x.cleared_in"] = "FRAMENUM",
    ["x.active_names"] = "STRING", k = "UINT8 HEX", low = "UINT8  15", ["z.undefined"] = "UINT32 HEX" })
end

function T.test_digits_for_columns()
  for unit, shape in pairs { RPM = "%.0f", V = "%.2f", A = "%.2f", W = "%.0f", ["°C"] = "%.0f", ["%"] = "%.0f" } do
    local compiled = catalogue.compile { message(nil, { "f", "uint8", "F", scale = 0.5, unit = unit }) }
    lu.assertEquals(compiled.messages[1].rounded[1].shape, shape, unit)
  end
end

-- Of values with a unit whose digits are known; not of arrays, and not of integers.
function T.test_values_for_columns()
  local compiled, problems = catalogue.compile { { name = "m", title = "M", id = 1, size = 11,
    { "v", "float16", "V", min = -100, max = 100, unit = "V" }, { "t", "uint8", "T", scale = 0.5, unit = "°C" },
    { "n", "uint8", "N", unit = "RPM" }, { "p", "float8", "P", min = 0, max = 1, unit = "bar" },
    { "x", "float8", "X", min = 0, max = 1, unit = "A", count = 2 }, { "w", "uint32", "W", scale = 0.1, unit = "A" },
    derived = { { "power", "v * w", "Power", unit = "W" } } } }
  lu.assertEquals(problems, {})
  local found = {}
  for i, one in ipairs(compiled.messages[1].rounded) do
    found[i] = one.filter .. " " .. one.shape .. " " .. one.field.name
  end
  lu.assertEquals(found, { "taurus.m.v.rounded %.2f v", "taurus.m.t.rounded %.0f t", "taurus.m.w.rounded %.2f w",
    "taurus.m.power.rounded %.0f power" })
  lu.assertEquals(compiled.messages[1].by_name.v.filters, { "taurus.m.v.special", "taurus.m.v" })
end

function T.test_reserved_filter_names()
  local reserved = { ["taurus.reboot"] = true, ["taurus.m.g.x"] = true }
  local entries = { message { name = "reboot" }, message({ id = 2 }, { group = "g", flags = { { "x", 1, "X" } } }) }
  local compiled, problems = catalogue.compile(entries, nil, reserved)
  lu.assertEquals({ #compiled.messages, problems }, { 0, { "message reboot: the filter name taurus.reboot is taken",
    "message m, field f: the filter name taurus.m.g.x is taken" } })
end

function T.test_the_smallest_payload()
  local entry = message { size = 5, [2] = { "gap", "padding", length = 2 }, [3] = { "g", "uint16", "G" } }
  lu.assertEquals(catalogue.compile({ entry }).messages[1].min_size, 5)
  for min_size = 1, 5 do
    entry.min_size = min_size
    local compiled, problems = catalogue.compile { entry }
    if min_size == 4 then
      lu.assertEquals(problems, { "message m, field g: min_size 4 ends inside it" })
    else
      lu.assertEquals({ compiled.messages[1].min_size, problems }, { min_size, {} })
    end
  end
end

function T.test_one_bad_message_does_not_take_the_others_along()
  local compiled, problems = catalogue.compile { message { id = 9999 }, message { name = "n" } }
  lu.assertEquals({ #compiled.messages, compiled.by_id[1].name, #problems }, { 1, "n", 1 })
end

function T.test_two_messages_that_meet()
  local _, problems = catalogue.compile { message(), message { name = "n" } }
  lu.assertStrContains(problems[1], "message n: id 0x1 is that of message m")
  _, problems = catalogue.compile { message(), message { id = 2 } }
  lu.assertStrContains(problems[1], "message m: the name is there twice")
end

function T.test_messages_that_are_none()
  local compiled, problems = catalogue.compile { 5, "x", {} }
  lu.assertEquals(#compiled.messages, 0)
  lu.assertEquals(problems, { "message 1: a message is a table, not 5", 'message 2: a message is a table, not "x"',
    "message 3: name nil is not a filter name (a-z, 0-9, _)" })
end

-- Alarms and texts --------------------------------------------------------------------------------------------------

-- Of a field with these options: its alarm bits in hexadecimal, its word, and whether the message has it as an alarm.
local function alarm_of(options)
  local compiled, problems = catalogue.compile { message(nil, options) }
  lu.assertEquals(problems, {})
  local m = compiled.messages[1]
  return { ("%x"):format(m.fields[1].alarm_bits), m.fields[1].fault_word or "none", m.alarms[1] == m.fields[1] }
end

function T.test_which_bits_are_alarms()
  local a, b = { "a", 1, "A" }, { "b", 6, "B", alarm = true }
  local gear = { "gear", 0x30, "Gear" }
  lu.assertEquals(alarm_of { flags = { a }, group = "g" }, { "0", "none", false })
  lu.assertEquals(alarm_of { flags = { a, b }, group = "g" }, { "6", "FAULT", true })
  lu.assertEquals(alarm_of { flags = { a, b }, group = "g", alarm = "ALARM" }, { "ff", "ALARM", true })
  lu.assertEquals(alarm_of { flags = { a }, group = "g", alarm = "ALARM", bits = { gear } }, { "cf", "ALARM", true })
  lu.assertEquals(alarm_of { bits = { gear } }, { "0", "none", false })
  local motor = catalogue.compile(dofile("taurus_fields.lua")).by_id[0x210]
  local fault, state = motor.by_name.fault_flags, motor.by_name.motor_state
  lu.assertEquals(motor.alarms, { fault, state })
  -- A flag before them that becomes a fault does not give its name to what is shown of all faults.
  local entries = dofile("taurus_fields.lua")
  for _, entry in ipairs(entries) do
    for _, row in ipairs(entry.name == "motor" and entry or {}) do
      if row[1] == "status_flags" then row.flags[1].alarm = true end
    end
  end
  local changed = catalogue.compile(entries).by_id[0x210]
  lu.assertEquals({ #changed.alarms, changed.fault_field }, { 3, changed.by_name.fault_flags })
  lu.assertEquals({ fault.alarm_bits, state.alarm_bits, state.fault_word, motor.by_name.status_flags.alarm_bits },
    { 0xFFFFFFFF, 0x20, "FAULT", 0 })
end

-- The description of a filter of a message.
local function about(m, name)
  for _, row in ipairs(m.filters) do
    if row[1] == m.filter .. "." .. name then return row[4] end
  end
end

function T.test_descriptions()
  local entry = message({ title = "Pump", section = "Pumps" }, { unit = "bar" })
  entry.size, entry[2] = 2, { "g", "uint8", "Flags", section = "Flags of pumps", group = "g",
    flags = { { "a", 1, "Leak", help = "Look at the seal" }, { "b", 2, "Dry" } }, bits = { { "n", 0x30, "Count" } } }
  local m = catalogue.compile({ entry }).messages[1]
  lu.assertEquals({ m.section, about(m, "f"), m.by_name.g.flags[1].help, about(m, "g.a"),
    about(m, "g.b"), about(m, "n") },
    { "Pumps", 'F in bar, of Pump (section "Pumps")', "Look at the seal",
      'Leak, one of Flags, of Pump (section "Flags of pumps"). Look at the seal',
      'Dry, one of Flags, of Pump (section "Flags of pumps")', 'Count, of Pump (section "Pumps")' })
  lu.assertEquals(about(catalogue.compile({ message() }).messages[1], "f"), "F, of M")
  local volts = message({}, { [2] = "float8", min = -1.5, max = 40, unit = "V" })
  lu.assertEquals(about(catalogue.compile({ volts }).messages[1], "f"), "F in V, -1.5 to 40, of M")
end

function T.test_long_texts_are_cut()
  local _, problems = catalogue.compile { message { name = ("x"):rep(1000000) } }
  lu.assertTrue(#problems[1] < 200)
end

local NONSENSE = { 5, -1, 0.5, 2 ^ 53, 2 ^ 1000, 0 / 0, 1 / 0, "x", "", "f", true, false, {}, { {} }, { 5 },
  { { 5 } }, { { "a", 1, "A" } }, { [0] = {}, [1] = { 5 }, x = {} }, { [1] = { { "v", "uint8", "V" } } }, print,
  ("x"):rep(300), "\255", "%s%n" }
local TYPE_OPTIONS = {
  uint8 = { "values", "invalid", "flags", "group", "alarm", "bits", "unit", "scale", "offset", "count" },
  float32 = { "min", "max", "unit", "count" }, string = { "length", "count" }, padding = { "length" },
  variants = { "by", "cases" }, int64_ns = { "x" }, bool = { "count" } }

-- Each option as anything: no error is raised, and what is compiled can be read.
function T.test_nonsense_in_every_option()
  local count = 0
  for kind, options in pairs(TYPE_OPTIONS) do
    for _, key in ipairs(options) do
      for _, other in ipairs { "none", "flags", "bits", "values", "cases", "by", "length", "min" } do
        for _, value in ipairs(NONSENSE) do
          local row = { "g", kind, "G", [key] = value }
          if other ~= "none" then row[other] = value end
          for _, size in ipairs { 2, 5, 9 } do
            local compiled, problems = catalogue.compile { { name = "m", title = "M", id = 1, size = size,
              { "f", "uint8", "F" }, row, differences = key == "x" and value or nil } }
            lu.assertEquals(#compiled.messages + math.min(#problems, 1), 1)
            for _, one in ipairs(compiled.messages) do
              local raws = one.read(("\255"):rep(size))
              count = count + 1
              lu.assertEquals(text_of.writer_of(one.info)(raws), "")
              lu.assertStrMatches(text_of.row_writer(one)(raws), "255,.*")
            end
          end
        end
      end
    end
  end
  lu.assertTrue(count > 10, count)
end

-- The user's IDs ----------------------------------------------------------------------------------------------------

function T.test_assign()
  local compiled = catalogue.compile { message(), message { name = "n", title = "N", id = 2 } }
  local by_id, problems = catalogue.assign(compiled, { m = { 5, 6 } })
  lu.assertEquals({ by_id[5].name, by_id[6].name, by_id[2].name, by_id[1] or "none", #problems },
    { "m", "m", "n", "none", 0 })
  by_id, problems = catalogue.assign(compiled, { m = { 5 }, n = { 4, 5 } })
  lu.assertEquals({ by_id[5].name, by_id[4].name }, { "m", "n" })
  lu.assertEquals(problems, { "ID 0x5 is given to M and to N: it stays with M" })
  by_id, problems = catalogue.assign(compiled, { m = {}, n = { 5, 5 } })
  lu.assertEquals({ by_id[5].name, by_id[1] or "none", #problems }, { "n", "none", 0 })
end

return T
