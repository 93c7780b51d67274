-- SPDX-License-Identifier: GPL-2.0-or-later
-- luacheck: no max line length (tables of errors)
-- The catalogue's checks: every error names the file, the message and the field.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local bits = require("yapp.base.bits")
local catalogue = require("yapp.message.catalogue")

local T = {}

-- A good message with changes: of the message, or (field) of its first field.
local function message(changes, field)
  local row = { "f", "uint8", "F" }
  for k, v in pairs(field or {}) do row[k] = v end
  local entry = { name = "m", title = "M", id = 1, size = 1, row }
  for k, v in pairs(changes or {}) do entry[k] = v end
  return entry
end

-- A file of these messages is read, and answered with one problem for the message that is wrong.
local function problem_of(entry)
  local compiled, problems = catalogue.compile { entry }
  lu.assertEquals({ #compiled.messages, #problems }, { 0, 1 })
  lu.assertStrContains(problems[1], "; this message is not decoded")
  return problems[1]
end

-- Unknown options and types, overlaps, sizes, and what is there twice.
function T.test_what_is_wrong_with_a_message_is_said()
  for _, row in ipairs {
    { { id = 2048 }, "message m: id 2048" }, { { id = -1 }, "message m: id -1" }, { { id = 1.5 }, "message m: id 1.5" },
    { { every = "x" }, 'message m: every is "x", not a number' }, { { min_size = "1" }, 'message m: min_size is "1", not a number' },
    { { [1] = { "f", "uint8", "F", values = { Off = 0 } } }, "message m, field f: values are { [number] = text }" },
    { { [1] = { "f", "uint8", "F", values = { [0] = 1 } } }, "message m, field f: values are { [number] = text }" },
    { { [1] = { "f", "uint8", "F", group = "g", flags = { { "a", 0, "A" } } } }, "message m, field f: a: bit 0x0 is" },
    { { [1] = { "f", "uint8", "F", scale = 0 } }, "message m, field f: scale is 0" },
    { { [1] = { "f", "uint8", "F", scale = 2, values = { "a" } } }, "field f: an integer has one of values, flags and scale;" },
    { { [1] = { "f", "float8", "F", min = 1, max = 2, values = { "a" } } }, "field f: an integer has one of" },
    { { [1] = { "f", "uint8", "F", unit = 5 } }, "message m, field f: unit is 5, not a string" },
    { { [1] = { "f", "float8", "F", min = 2, max = 1 } }, "message m, field f: min and max are missing, or no range" },
    { { [1] = { "f", "float8", "F", max = 1 } }, "message m, field f: min and max are missing, or no range" },
    { { size = 2 }, "message m: size is 2, but the fields add up to 1" }, { { title = "\255" }, "title has a sign that" },
    { { info = "{g}" }, 'message m: info names a field "g"' }, { { [1] = 5 }, "message m, field 1: " },
    { { rate = 5 }, 'message m: unknown option "rate"; a message has ' }, { { rate = 5 }, ", every, " },
    { { derived = { { "d", "f * g", "D" } } }, 'message m: d: "f * g" is not two fields of numbers' },
    { { derived = { { "d", "f / f", "D" } } }, 'message m: d: "f / f" is not two fields of numbers with *, + or -' },
    { { derived = { { "d", "f*f", "D" } }, [1] = { "f", "uint8", "F", values = {} } }, '"f*f" is not two fields of' },
    { { differences = { { "f", "f", "f", "D" } } }, "message m, field f: the filter name taurus.m.f is taken" },
    { { [1] = { "f", "int64_ns", "F" }, [2] = { "clock_drift", "uint8", "C" }, size = 9 },
      "message m, field clock_drift: the filter name taurus.m.clock_drift is taken" },
    { { [2] = { "f", "uint8", "F" }, size = 2 }, "message m, field f: the filter name taurus.m.f is taken" },
  } do
    lu.assertStrContains(problem_of(message(row[1])), row[2])
  end
  lu.assertStrContains(problem_of(message { name = "Bad" }), '"taurus.Bad" is no filter name')
end

function T.test_what_is_wrong_with_a_field_is_said()
  for _, row in ipairs {
    { { [1] = "F x" }, 'field F x: "taurus.m.F x" is no filter name' }, { { unit = "\176C" }, "unit has a sign that" },
    { { [2] = "int7" }, 'field f: unknown type "int7"; the types are ' }, { { [2] = "int7" }, ", int64_ns, " },
    { { units = "V" }, 'field f: unknown option "units"; a row has ' }, { { units = "V" }, ", group, " },
    { { [4] = "V" }, "field f: unknown option 4" },
    { { [2] = "float8" }, "field f: " }, { { [2] = "string" }, "field f: " }, { { flags = {} }, "field f: " },
    { { flags = { { "a", 256, "A" } }, group = "g" }, "field f: a: bit 0x100 is another's, or not in the field" },
    { { flags = { { "a", 3, "A" }, { "b", 2, "B" } }, group = "g" }, "field f: b: bit 0x2 is another's" },
    { { flags = { { "a", 1, "A" }, { "a", 2, "A" } }, group = "g" }, "field f: the filter name taurus.m.g.a is taken" },
    { { flags = { { "a", 1, "A", unit = "V" } }, group = "g" }, 'unknown option "unit"; a flag has ' },
  } do
    local problem = problem_of(message(nil, row[1]))
    lu.assertStrContains(problem, "message m, field ")
    lu.assertStrContains(problem, row[2])
  end
end

-- Wireshark's types of all filters of a message, with base and mask.
function T.test_types_of_filters()
  local compiled, problems = catalogue.compile { { name = "m", title = "M", id = 1, size = 39, answers = "command",
    { "u", "uint16", "U" }, { "e", "uint8", "E", values = { [0] = "off" } }, { "i", "int16", "I" },
    { "t", "int64_ns", "T" }, { "f", "float8", "F", min = 0, max = 1 }, { "d", "float64", "D" },
    { "s", "string", "S", length = 2 }, { "y", "bytes", "Y", length = 2 }, { "c", "uint8", "C", scale = 0.5 },
    { "w", "uint64", "W" },
    { "g", "uint32", "G", group = "x", alarm = true, flags = { { "hot", 8, "Hot" } } } } }
  lu.assertEquals(problems, {})
  local found = {}
  for _, row in ipairs(compiled.messages[1].filters) do
    found[row[1]:gsub("taurus%.m%.?", "")] = ("%s %s %s"):format(row[2], row[5] or "", row[7] or ""):gsub(" +$", "")
  end
  lu.assertEquals(compiled.messages[1].by_name.f.filters, { "taurus.m.f.special", "taurus.m.f" }) -- and those below it
  lu.assertEquals(found, { [""] = "NONE", clock_drift = "RELATIVE_TIME", command_in = "FRAMENUM", u = "UINT16",
    e = "UINT8 HEX", i = "INT16", t = "RELATIVE_TIME", f = "DOUBLE", ["f.special"] = "UINT8",
    d = "DOUBLE", ["d.special"] = "UINT8", s = "STRING", y = "BYTES", c = "DOUBLE", w = "UINT64", g = "UINT32 HEX",
    ["g.names"] = "STRING", ["x.hot"] = "BOOLEAN 32 8", ["x.undefined"] = "UINT32 HEX", ["x.raised"] = "UINT32 HEX",
    ["x.cleared"] = "UINT32 HEX", ["x.active_time"] = "RELATIVE_TIME", ["x.previous_change"] = "FRAMENUM",
    ["x.next_change"] = "FRAMENUM" })
end

-- Of values with a unit whose digits are known; not of integers.
function T.test_values_for_columns()
  local compiled, problems = catalogue.compile { { name = "m", title = "M", id = 1, size = 9,
    { "v", "float16", "V", min = -100, max = 100, unit = "V" }, { "t", "uint8", "T", scale = 0.5, unit = "°C" },
    { "n", "uint8", "N", unit = "RPM" }, { "p", "float8", "P", min = 0, max = 1, unit = "bar" },
    { "w", "uint32", "W", scale = 0.1, unit = "A" },
    derived = { { "power", "v * w", "Power", unit = "W" } } } }
  lu.assertEquals(problems, {})
  local found = {}
  for i, one in ipairs(compiled.messages[1].rounded) do
    found[i] = one.filter .. " " .. one.field.rounded .. " " .. one.field.name
  end
  lu.assertEquals(found, { "taurus.m.v.rounded %.2f v", "taurus.m.t.rounded %.0f t", "taurus.m.w.rounded %.2f w",
    "taurus.m.power.rounded %.0f power" })
  lu.assertEquals(compiled.messages[1].by_name.v.filters, { "taurus.m.v.special", "taurus.m.v" })
end

-- Alarms and texts --------------------------------------------------------------------------------------------------

-- The alarm bits of a field with these options, and whether the message has it as an alarm.
local function alarm_of(options)
  local compiled, problems = catalogue.compile { message(nil, options) }
  lu.assertEquals(problems, {})
  local m = compiled.messages[1]
  return { m.fields[1].alarm_bits, m.alarms[1] == m.fields[1] }
end

function T.test_which_bits_are_alarms()
  local a, b = { "a", 1, "A" }, { "b", 6, "B", alarm = true }
  lu.assertEquals(alarm_of { flags = { a }, group = "g" }, { 0, false })
  lu.assertEquals(alarm_of { flags = { a, b }, group = "g" }, { 6, true })
  lu.assertEquals(alarm_of { flags = { a, b }, group = "g", alarm = true }, { 0xFF, true })
end

-- Each fault of the vendor's has help.  What the document does not say is marked.
function T.test_each_fault_has_help()
  local seen = 0
  for _, m in ipairs(catalogue.compile(dofile "taurus_fields.lua").messages) do
    for _, field in ipairs(m.alarms) do
      for _, flag in ipairs(field.flags) do
        if bits.band(flag.mask, field.alarm_bits) ~= 0 then
          seen = seen + 1
          local is_ours = (flag.help or ""):find("%w %(our note%)$") ~= nil
          lu.assertEquals(is_ours, flag.name ~= "atpi_warning", flag.name .. " needs a help that ends with (our note)")
        end
      end
    end
  end
  lu.assertTrue(seen >= 31)
end

-- The description of a filter of a message.
local function about(m, name)
  for _, row in ipairs(m.filters) do
    if row[1] == m.filter .. "." .. name then return row[4] end
  end
end

function T.test_descriptions()
  local entry = message({ title = "Pump", section = "Pumps" }, { unit = "bar" })
  entry.size, entry[2] = 2, { "g", "uint8", "Flags", group = "g",
    flags = { { "a", 1, "Leak", help = "Look at the seal" }, { "b", 2, "Dry" } } }
  local m = catalogue.compile({ entry }).messages[1]
  lu.assertEquals({ m.section, about(m, "f"), m.by_name.g.flags[1].help, about(m, "g.a"),
    about(m, "g.b") },
    { "Pumps", 'F in bar, of Pump (section "Pumps")', "Look at the seal",
      'Leak, one of Flags, of Pump (section "Pumps"). Look at the seal',
      'Dry, one of Flags, of Pump (section "Pumps")' })
  lu.assertEquals(about(catalogue.compile({ message() }).messages[1], "f"), "F, of M")
  local volts = message({}, { [2] = "float8", min = -1.5, max = 40, unit = "V" })
  lu.assertEquals(about(catalogue.compile({ volts }).messages[1], "f"), "F in V, -1.5 to 40, of M")
end

-- Files -------------------------------------------------------------------------------------------------------------

local made = {}

local function write(text)
  local path = os.tmpname()
  made[#made + 1] = path
  local file = assert(io.open(path, "wb"))
  file:write(text)
  file:close()
  return path
end

function T.tearDown()
  for _, path in ipairs(made) do os.remove(path) end
  made = {}
end

local function entry_text(name, id, kind)
  return ('{ name = "%s", title = "T", id = %d, size = 1, { "f", "%s", "F" } },'):format(name, id, kind or "uint8")
end

-- The names, IDs and types of what was loaded from files with these texts, and the problems.
local function load(...)
  local list = {}
  for i, text in ipairs { ... } do list[i] = write(text) end
  local compiled, problems = catalogue.load(list)
  local names = {}
  for i, one in ipairs(compiled.messages) do
    names[i] = ("%s %d %s"):format(one.name, one.id, one.fields[1].type)
  end
  return table.concat(names, ", "), problems, list
end

function T.test_own_messages_and_replacements()
  local names, problems = load("return {" .. entry_text("a", 1) .. entry_text("b", 2) .. "}",
    "return {" .. entry_text("c", 3) .. entry_text("a", 7, "int8") .. "}", "return {" .. entry_text("c", 4) .. "}")
  lu.assertEquals({ names, problems }, { "a 7 int8, b 2 uint8, c 4 uint8", {} })
end

function T.test_an_error_names_file_message_and_field()
  local names, problems, list = load("return {" .. entry_text("a", 1) .. "}", "return {" .. entry_text("b", 2, "uint9") ..
    entry_text("c", 1) .. entry_text("d", 4) .. entry_text("d", 5) .. "{} }")
  lu.assertEquals(names, "a 1 uint8, d 4 uint8")
  local path = list[2]
  lu.assertStrContains(problems[1], path .. ': message b, field f: unknown type "uint9"; the types are')
  lu.assertEquals(problems[2], path .. ": message c: id 0x1 is that of message a; this message is not decoded")
  lu.assertEquals(problems[3], path .. ": message d: the name is there twice; this message is not decoded")
  lu.assertStrContains(problems[4], path .. ": message 6: ")
  lu.assertEquals(#problems, 4)
end

-- What a file has is read, or it is said: an error of its own, a value that is no list, an entry beside the list.
function T.test_a_file_that_is_no_catalogue()
  local list_of = "the file must return a list of messages, {"
  for text, said in pairs {
    ["return 5"] = "cannot be read: ", [""] = list_of, ["return {"] = "cannot be read: ",
    ["error('planted')"] = ":1: planted", ["return { b = " .. entry_text("b", 2) .. "}"] = list_of,
    ["return { nothing, " .. entry_text("b", 2) .. "}"] = list_of,
    ["return { name = 'c', id = 3, { 'f', 'uint8', 'F' } }"] = list_of,
  } do
    local names, problems, list = load("return {" .. entry_text("a", 1) .. "}", text)
    lu.assertEquals({ names, #problems }, { "a 1 uint8", 1 }, text)
    lu.assertStrContains(problems[1], list[2])
    lu.assertStrContains(problems[1], said)
  end
end

function T.test_a_file_that_is_not_there()
  local path = write("return {" .. entry_text("a", 1) .. "}")
  local compiled, problems = catalogue.load { path, "" }
  lu.assertEquals({ #compiled.messages, problems }, { 1, {} })
  compiled, problems = catalogue.load { path .. ".no", path }
  lu.assertEquals({ #compiled.messages, #problems }, { 1, 1 })
  lu.assertStrContains(problems[1], path .. ".no: cannot be read: ")
end

-- docs/catalogue.md names every option and type: an unknown one is answered with the list of those there are.
function T.test_the_page_names_every_option_and_type()
  local file = assert(io.open("docs/catalogue.md"))
  local page = file:read("*a")
  file:close()
  local entries = { message { z = 1 },
    message(nil, { group = "g", flags = { { "a", 1, "A", z = 1 } } }), message(nil, { [2] = "z" }),
    message(nil, { z = 1 }) }
  for _, entry in ipairs(entries) do
    local problem = problem_of(entry)
    local list = problem:match("has ([%w_, ]+);") or problem:match("the types are ([%w_, ]+);")
    for name in list:gmatch("[%w_]+") do
      lu.assertNotNil(page:find("`" .. name .. "`", 1, true), name .. ": a row of docs/catalogue.md")
    end
  end
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
