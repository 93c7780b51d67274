-- SPDX-License-Identifier: GPL-2.0-or-later
-- Every type that a row of the catalogue may have, at its limits: the raw value, the value, the row of CSV.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local bytes = require("support").bytes
local catalogue = require("yapp.message.catalogue")
local field_kinds = require("yapp.message.field_kinds")
local text_of = require("yapp.message.text")

local T = {}

-- A message with these rows, as large as they say.
local function message(size, ...)
  local compiled, problems = catalogue.compile { { name = "m", title = "M", id = 1, size = size, ... } }
  lu.assertEquals(problems, {})
  return compiled.messages[1]
end

-- The row of CSV of a payload.
local function row_of(m, payload)
  return text_of.row_writer(m)((m.read(payload)))
end

-- The row of CSV of a payload, and the experts of its remarks.
local function shown(m, hex)
  local _, remarks = m.read(bytes(hex))
  local experts = {}
  for _, remark in ipairs(remarks or {}) do
    experts[#experts + 1] = m.fields[remark[1]].name .. " " .. remark[2]
  end
  return row_of(m, bytes(hex)), table.concat(experts, ", ")
end

-- type, options, payload, row, experts
local LIMITS = {
  { "uint8", {}, "00", "0" }, { "uint8", {}, "ff", "255" }, { "uint16", {}, "0100", "1" },
  { "uint16", {}, "feff", "65534" },
  { "uint24", {}, "010000", "1" }, { "uint24", {}, "ffffff", "16777215" },
  { "uint32", {}, "ffffffff", "4294967295" }, { "uint32", {}, "00000080", "2147483648" },
  { "uint40", {}, "ffffffffff", "1099511627775" }, { "uint48", {}, "ffffffffffff", "281474976710655" },
  { "uint56", {}, "ffffffffffffff", "72057594037927935" }, { "uint56", {}, "01000000000000", "1" },
  { "int40", {}, "0000000080", "-549755813888" }, { "int48", {}, "ffffffffff7f", "140737488355327" },
  { "int56", {}, "00000000000080", "-36028797018963968" }, { "int56", {}, "ffffffffffffff", "-1" },
  { "uint64", {}, "0000000000000000", "0" }, { "uint64", {}, "ffffffffffffffff", "18446744073709551615" },
  { "uint64", {}, "0000000000002000", "9007199254740992" }, { "uint64", {}, "0100000000002000", "9007199254740993" },
  { "uint64", {}, "ffffffffffff1f00", "9007199254740991" }, { "uint64", {}, "0000000000000080", "9223372036854775808" },
  { "int8", {}, "7f", "127" }, { "int8", {}, "80", "-128" }, { "int8", {}, "ff", "-1" },
  { "int16", {}, "ff7f", "32767" }, { "int16", {}, "0080", "-32768" }, { "int16", {}, "ffff", "-1" },
  { "int24", {}, "ffff7f", "8388607" }, { "int24", {}, "000080", "-8388608" }, { "int24", {}, "ffffff", "-1" },
  { "int32", {}, "ffffff7f", "2147483647" }, { "int32", {}, "00000080", "-2147483648" },
  { "int32", {}, "ffffffff", "-1" },
  { "int64", {}, "ffffffffffffff7f", "9223372036854775807" },
  { "int64", {}, "0000000000000080", "-9223372036854775808" },
  { "int64", {}, "ffffffffffffffff", "-1" }, { "int64", {}, "00000000ffffffff", "-4294967296" },
  { "int64", {}, "00ca9a3b00000000", "1000000000" }, { "int64", {}, "0100000000000080", "-9223372036854775807" },

  { "float32", {}, "0000803f", "1," }, { "float32", {}, "cdcccc3d", "0.1," }, { "float32", {}, "000080bf", "-1," },
  { "float32", {}, "cdcc8c3f", "1.1," }, { "float32", {}, "6666863f", "1.05," },
  { "float32", {}, "0000804b", "1.677722e+07," },
  { "float32", {}, "ffff7f7f", "3.402823e+38," }, { "float32", {}, "01000000", "1.401298e-45," },
  { "float32", {}, "00008000", "1.175494e-38," }, { "float32", {}, "00000000", "0," },
  { "float32", {}, "00000080", "-0," },
  { "float32", {}, "0000807f", ",inf", "f value.special" }, { "float32", {}, "000080ff", ",-inf", "f value.special" },
  { "float32", {}, "0100807f", ",nan", "f value.special" }, { "float32", {}, "ffffffff", ",nan", "f value.special" },
  { "float64", {}, "000000000000f03f", "1," }, { "float64", {}, "9a9999999999b93f", "0.1," },
  { "float64", {}, "182d4454fb210940", "3.14159265358979," },
  { "float64", {}, "0000000000004043", "9.00719925474099e+15," },
  { "float64", {}, "ffffffffffffef7f", "1.79769313486232e+308," },
  { "float64", {}, "0100000000000000", "4.94065645841247e-324," },
  { "float64", {}, "000000000000f07f", ",inf", "f value.special" },
  { "float64", {}, "000000000000f0ff", ",-inf", "f value.special" },
  { "float64", {}, "010000000000f07f", ",nan", "f value.special" },

  { "float8", { min = -40, max = 210 }, "fa", "210," },
  { "float8", { min = -40, max = 210 }, "fb", ",below", "f value.special" },
  { "float16", { min = -10, max = 5 }, "fcff", ",above", "f value.special" },
  { "float32", { min = 0, max = 4294967290 }, "ffffff7f", "2147483647," },
  { "float32", { min = -1, max = 1 }, "faffffff", "1," },
  { "float32", { min = -1, max = 1 }, "feffffff", ",inf", "f value.special" },

  { "int16", { scale = 0.1, unit = "°C" }, "97ff", "-10.5" }, { "int16", { scale = 0.1 }, "0300", "0.3" },
  { "uint8", { scale = 0.5, offset = -40 }, "00", "-40" }, { "uint8", { offset = -50 }, "ff", "205" },
  { "int32", { scale = 1e-7 }, "b168de3a", "98.7654321" }, { "uint64", { scale = 0.001 }, "e803000000000000", "1" },
  { "uint8", { values = { [1] = "one, two" } }, "01", '1,"one, two"' },
  { "uint8", { values = { [1] = "one" } }, "02", "2,", "f value.invalid" },
  { "int8", { values = { [-1] = "lost" } }, "ff", "-1,lost" },
  { "int8", { values = {} }, "80", "-128,", "f value.invalid" },
  { "string", { length = 6 }, "616200000000", "ab" }, { "string", { length = 2 }, "6162", "ab" },
  { "string", { length = 4 }, "00616263", "" }, { "string", { length = 3 }, "c2b043", "\194\176C" },
  { "string", { length = 3 }, "61ff0a", "a\\xff\\x0a" }, { "string", { length = 3 }, "612c62", '"a,b"' },
  { "string", { length = 3 }, "612262", '"a""b"' },
  -- UTF-8 stays text beside what cannot be shown: a control character, a byte that is no UTF-8.
  { "string", { length = 8 }, "67c3b6c39fe280a8", "g\195\182\195\159\226\128\168" },
  { "string", { length = 5 }, "c3b61bffb0", "\195\182\\x1b\\xff\\xb0" },
  { "bytes", { length = 4 }, "00ff7f80", "00ff7f80" },
  { "int64_ns", {}, "ffffffffffffffff", "-0.000000001" },
  { "int64_ns", {}, "ffffffffffffff7f", "9223372036.854775807" },
  { "int64_ns", {}, "0000000000000080", "-9223372036.854775808" },
  { "int64_ns", {}, "00ca9a3b00000000", "1.000000000" },
  { "int64_ns", {}, "ff3565c4ffffffff", "-1.000000001" }, { "int64_ns", {}, "e38cd23ce04e0000", "86725.000072419" },
}

-- The types of fields that Wireshark's API makes: it refuses FT_UINT40 to FT_UINT56, and others.
local API = {}
for name in ("NONE BOOLEAN UINT8 UINT16 UINT24 UINT32 UINT64 INT8 INT16 INT24 INT32 INT64 FLOAT DOUBLE " ..
  "RELATIVE_TIME STRING BYTES FRAMENUM"):gmatch("%S+") do API[name] = true end

function T.test_limits()
  for _, case in ipairs(LIMITS) do
    local kind, options, hex, wanted, experts = case[1], case[2], case[3]:gsub(" ", ""), case[4], case[5] or ""
    local row = { "f", kind, "F" }
    for key, value in pairs(options) do row[key] = value end
    local m = message(#hex / 2, row)
    lu.assertEquals({ shown(m, hex) }, { wanted, experts }, kind .. " " .. hex)
    for _, filter in ipairs(m.filters) do lu.assertTrue(API[filter[2]], kind .. ": " .. filter[2]) end
    local names = {}
    for i, column in ipairs(text_of.columns(m, {})) do names[i] = column.name end
    lu.assertEquals(select(2, wanted:gsub('"[^"]*"', ""):gsub(",", "")), #names - 1, kind)
  end
end

-- Of a field with an alarm all bits are remarkable; of another one those that nobody defines, and a flag's alarm.
function T.test_each_bit_alone()
  local flags = { { "a", 0x1, "A" }, { "b", 0x6, "B", alarm = true } }
  for alarm, defined in pairs { [false] = 0x1, [true] = 0 } do
    local m = message(1, { "f", "uint8", "F", group = "g", flags = flags, alarm = alarm or nil })
    lu.assertEquals(text_of.flag_names(m.fields[1], 0x3), alarm and "a, b" or "b, a") -- faults first
    for bit = 0, 7 do
      local _, experts = shown(m, ("%02x"):format(math.floor(2 ^ bit)))
      local is_flag = 2 ^ bit <= 0x4
      local expected = (2 ^ bit == defined and "" or is_flag and "f fault.active") or
        alarm and "f fault.active, f flags.undefined" or "f flags.undefined"
      lu.assertEquals(experts, expected, bit)
    end
  end
end

-- No digits beyond those that a count carries: a tenth of a count is told as such.
function T.test_digits_of_compressed_floats()
  for _, size in ipairs { 2, 4 } do
    local m = message(size, { "f", "float" .. 8 * size, "F", min = 0, max = (2 ^ (8 * size) - 6) / 10 })
    for count = 1, 1000 do
      local payload = string.char(count % 256, math.floor(count / 256)) .. ("\0"):rep(size - 2)
      lu.assertEquals(row_of(m, payload), ("%g,"):format(count / 10), size)
    end
  end
end

-- The generated values of a payload, "-" for none.
local function generated(m, hex)
  local raws, values = m.read(bytes(hex)), {}
  for i, item in ipairs(m.generated) do
    local value = field_kinds.value(item, raws)
    values[i] = value and tonumber(field_kinds.text(item, raws)) or "-"
  end
  return values
end

function T.test_generated_values()
  local compiled, problems = catalogue.compile { { name = "m", title = "M", id = 1, size = 4,
    differences = { { "d", "a", "b", "D" } },
    derived = { { "p", "a * b", "P", unit = "W" }, { "s", "b+b", "S" }, { "n", " a -b ", "N" } },
    { "a", "float16", "A", min = -10, max = 5, unit = "V" }, { "b", "int16", "B", scale = 0.5 } } }
  lu.assertEquals(problems, {})
  local m = compiled.messages[1]
  lu.assertEquals(generated(m, "faff0300"), { 3.5, 7.5, 3, 3.5 })
  lu.assertEquals(generated(m, "ffff0300"), { "-", "-", 3, "-" }) -- a is not a number
  lu.assertEquals(generated(m, "faff03"), { "-", "-", "-", "-" }) -- b does not fit
  local about = {}
  for i, item in ipairs(m.generated) do
    for _, row in ipairs(m.filters) do
      if row[1] == item.filter then about[i] = ("%s %s %s"):format(item.filter, item.unit or "-", row[4]) end
    end
  end
  lu.assertEquals(about, { "taurus.m.d V D in V, of M", "taurus.m.p W P in W, of M", "taurus.m.s - S, of M",
    "taurus.m.n - N, of M" })
end

-- Only derived ones are in tables, behind the fields; a name that is taken gets a number.
function T.test_columns()
  local compiled = catalogue.compile { { name = "m", title = "M", id = 1, size = 3,
    differences = { { "d", "a", "b", "D" } }, derived = { { "p", "a * b", "P", unit = "W" } },
    { "a", "uint8", "A" }, { "b", "float8", "B", min = 0, max = 2.5 }, { "b_special", "uint8", "C" } } }
  local m, names = compiled.messages[1], {}
  for i, column in ipairs(text_of.columns(m, { { name = "a", type = "string" } })) do
    names[i] = ("%s %s %s"):format(column.name, column.type, column.unit or "-")
  end
  lu.assertEquals(table.concat(names, ", "),
    "a string -, a_2 integer -, b float -, b_special string -, b_special_2 integer -, p float W")
  lu.assertEquals(row_of(m, "\7\1\2"), "7,0.01,,2,0.07")
  lu.assertEquals(row_of(m, "\7\255\2"), "7,,nan,2,")
  lu.assertEquals(row_of(m, "\7"), "7,,,,")
end

-- Every length from min_size up to size: what does not fit wholly is not there, in nothing that shows it.
function T.test_payloads_that_are_shorter()
  local compiled, problems = catalogue.compile { { name = "m", title = "M", id = 1, size = 17, min_size = 1,
    info = "{a} {t} {s} {k}", { "a", "uint8", "A", values = { [1] = "One" } }, { "t", "int64_ns", "T" },
    { "s", "string", "S", length = 2 }, { "f", "uint8", "F", group = "g", flags = { { "x", 1, "X" } } },
    { "k", "uint8", "K" }, { "z", "uint32", "Z" } } }
  lu.assertEquals(problems, {})
  local m, payload = compiled.messages[1], bytes("01" .. "00ca9a3b00000000" .. "6162" .. "30" .. "01" .. "05000000")
  local rows = { [1] = "1,One,,,,,,", [8] = "1,One,,,,,,", [9] = "1,One,1.000000000,,,,,",
    [10] = "1,One,1.000000000,,,,,", [11] = "1,One,1.000000000,ab,,,,", [12] = "1,One,1.000000000,ab,48,0,,",
    [13] = "1,One,1.000000000,ab,48,0,1,", [16] = "1,One,1.000000000,ab,48,0,1,",
    [17] = "1,One,1.000000000,ab,48,0,1,5" }
  for length, row in pairs(rows) do lu.assertEquals(row_of(m, payload:sub(1, length)), row, length) end
  local infos = { [1] = "One - - -", [9] = "One 1.000000000 s - -", [17] = "One 1.000000000 s ab 1" }
  for length, text in pairs(infos) do
    local raws = m.read(payload:sub(1, length))
    lu.assertEquals({ m.info(raws), text_of.faults(m, raws) }, { text, "" })
  end
end

-- A unit follows a value if its placeholder says so, also a reserved value and one that is not there.
function T.test_info_with_units()
  local units = catalogue.compile({ { name = "m", title = "M", id = 1, size = 3, min_size = 2,
    info = "{a unit}, {b:%.1f unit} {b:%.0f} {c unit}", { "a", "uint8", "A", unit = "%" },
    { "b", "float8", "B", min = 0, max = 25, unit = "V" }, { "c", "uint8", "C", unit = "°C" } } }).messages[1]
  lu.assertEquals(units.info { 7, 100, 9 }, "7 %, 10.0 V 10 9 °C")
  lu.assertEquals(units.info { 7, 255, nil }, "7 %, NaN V NaN - °C")
end

return T
