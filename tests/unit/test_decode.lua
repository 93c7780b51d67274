-- SPDX-License-Identifier: GPL-2.0-or-later
-- Values: compressed floats against the document's table, times, flags, the Info column.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local bytes = require("support").bytes
local catalogue = require("yapp.message.catalogue")
local binary = require("yapp.message.binary")
local field_kinds = require("yapp.message.field_kinds")
local decode = require("yapp.message.decode")
local text_of = require("yapp.message.text")

local T = {}

local function field(kind, min, max)
  local compiled, problems = catalogue.compile {
    { name = "m", title = "M", id = 1, size = kind == "float16" and 2 or 1, { "f", kind, "F", min = min, max = max } } }
  lu.assertEquals(problems, {})
  field_kinds.choose_divisor(5)
  return compiled.messages[1].fields[1]
end

function T.test_floats()
  for _, row in ipairs { -- type, min, max, counts, value
    { "float16", -10, 5, 0, -10 }, { "float16", -10, 5, 65530, 5 }, -- the document's table
    { "float16", -10, 5, 43687, 0.0000763 },
    { "float16", -128, 128, 32765, 0 }, { "float16", -128, 128, 0, -128 }, { "float16", -128, 128, 65530, 128 },
    { "float8", -40, 210, 0, -40 }, { "float8", -40, 210, 24, -16 }, { "float8", -40, 210, 250, 210 },
    { "float8", 0, 12.5, 125, 6.25 },
    { "float16", -200, 200, 32847, 0.5005 }, { "float16", -100000, 100000, 33011, 750.80 },
  } do
    local f = field(row[1], row[2], row[3])
    lu.assertAlmostEquals(field_kinds.value(f, row[4]), row[5], 0.01 * math.abs(row[5]) + 1e-4)
  end
end

-- A message is recognised by its values only if enough of them can be wrong.
function T.test_what_bytes_look_like()
  local taurus = catalogue.compile(dofile("taurus_fields.lua"))
  local command, health = taurus.by_id[0], taurus.by_id[0x200]
  for text, expected in pairs {
    ["\1\165\1\0\0\0\0"] = true, ["\0\90\0\255\255\0\0"] = true, -- a reserved count is defined
    ["\2\165\1\0\0\0\0"] = false, ["\1\0\1\0\0\0\0"] = false, ["\1\165\2\0\0\0\0"] = false,
  } do
    lu.assertEquals(decode.is_plausible(command, text), expected)
  end
  local motor = taurus.by_id[0x210]
  lu.assertFalse(decode.is_plausible(motor, ("\0"):rep(32))) -- as other programs send them
  lu.assertTrue(decode.is_plausible(motor, "\1" .. ("\0"):rep(31)))
  lu.assertFalse(decode.is_plausible(motor, ("\1"):rep(32))) -- bits that nothing defines
  lu.assertFalse(decode.is_plausible(health, "\1" .. ("\0"):rep(16))) -- one of its fields has bits that nothing defines
  local all = { { "all", 0xFF, "All" } } -- anything is defined
  local own = catalogue.compile { { name = "own", title = "Own", id = 1, size = 2,
    { "a", "uint8", "A", group = "a", flags = all }, { "b", "uint8", "B", group = "b", flags = all } } }
  lu.assertFalse(decode.is_plausible(own.by_id[1], "\1\1"))
  for count = 1, 3 do -- of fields with values that nothing defines two are enough
    local entry = { name = "own", title = "Own", id = 1, size = count }
    for i = 1, count do entry[i] = { "f" .. i, "uint8", "F", values = { [0] = "Off", "On" } } end
    lu.assertEquals(decode.is_plausible(catalogue.compile({ entry }).by_id[1], ("\1"):rep(count)), count > 1)
  end
end

function T.test_every_count()
  for _, kind in ipairs { "float8", "float16" } do
    local f = field(kind, -40, 210)
    local before = -math.huge
    for raw = 0, f.top do
      local value, special = field_kinds.value(f, raw)
      if raw <= f.top - 5 then
        lu.assertTrue(value > before and value >= -40 and value <= 210 and special == nil)
        before = value
      else
        lu.assertEquals({ value or "none", special }, { "none", f.top - raw })
      end
    end
  end
end

function T.test_the_divisor_of_the_worked_examples()
  local f = field("float16", -200, 200)
  field_kinds.choose_divisor(4)
  lu.assertAlmostEquals(field_kinds.value(f, 32847), 0.4975, 0.0005)
  f = field("float16", -100000, 100000)
  field_kinds.choose_divisor(4)
  lu.assertAlmostEquals(field_kinds.value(f, 33011), 749.26, 0.005)
  field_kinds.choose_divisor(5)
end

function T.test_times()
  for _, row in ipairs { -- little endian, seconds, nanoseconds
    { "0000000000000000", 0, 0 },
    { "0100000000000000", 0, 1 },
    { "FFFFFFFFFFFFFFFF", 0, -1 },
    { "00CA9A3B00000000", 1, 0 },
    { "FFC99A3B00000000", 0, 999999999 },
    { "003665C4FFFFFFFF", -1, 0 },
    { "FF3565C4FFFFFFFF", -1, -1 },
    { "E38CD23CE04E0000", 86725, 72419 }, -- the document's example
    { "FFFFFFFFFFFFFF7F", 9223372036, 854775807 },
    { "0000000000000080", -9223372036, -854775808 },
    { "0100000000000080", -9223372036, -854775807 },
    { "00000000000000C0", -4611686018, -427387904 },
  } do
    local seconds, nanoseconds = binary.time(bytes(row[1]))
    lu.assertEquals({ string.format("%d %d", seconds, nanoseconds) }, { string.format("%d %d", row[2], row[3]) })
  end
end

-- The real catalogue ------------------------------------------------------------------------------------------------

local TAURUS = catalogue.compile(dofile("taurus_fields.lua"))
local MOTOR, COMMAND = TAURUS.by_id[0x210], TAURUS.by_id[0]
local EXAMPLE = bytes("FD7FFD7FFD7FFD7FF5AFFD7F18010000014000000000E38CD23CE04E000005FF")

function T.test_the_document_s_example()
  local raws, remarks = MOTOR.read(EXAMPLE)
  lu.assertEquals(raws[MOTOR.by_name.dc_voltage.index], 0xAFF5)
  lu.assertEquals(raws[MOTOR.by_name.status_flags.index], 0x40010000)
  lu.assertEquals(text_of.flag_names(MOTOR.by_name.status_flags, 0x40010000), "stopped, mpos_update")
  lu.assertEquals(text_of.flag_names(MOTOR.by_name.motor_state, 0xA3), "faulted, ready, running, undefined 0x80")
  lu.assertEquals(MOTOR.info(raws), "0.0/0.0 RPM  47.97 V  0.00 A")
  lu.assertEquals(MOTOR.info_rest(raws), "ESC NaN °C  0.00 A torque")
  lu.assertEquals(text_of.faults(MOTOR, raws), "")
  lu.assertEquals({ #remarks, remarks[1][2] }, { 1, "value.special" }) -- no thermistor on the ESC
end

function T.test_remarks()
  for hex, expected in pairs {
    ["01A5010000" .. "0000"] = "", ["005A000000" .. "0000"] = "",
    ["02A5010000" .. "0000"] = "value.invalid", ["0100010000" .. "0000"] = "command.key.invalid",
    ["01A5020000" .. "0000"] = "value.invalid", ["01A501FFFF" .. "FBFF"] = "value.special value.special",
    ["01A501FAFF" .. "FAFF"] = "",
  } do
    local found = {}
    for _, remark in ipairs(select(2, COMMAND.read(bytes(hex))) or {}) do
      found[#found + 1] = remark[2]
    end
    lu.assertEquals(table.concat(found, " "), expected, hex)
  end
end

-- Document: "Taurus Motor Data", Fault Flags and Motor State.
function T.test_faults_in_the_info_column()
  for changed, expected in pairs { ["00000000/05"] = "", ["00000110/05"] = "motor_overcurrent, hall_timeout",
    ["00000000/25"] = "faulted", ["01000000/20"] = "oc_limit_unmeasurable, faulted",
    ["00000800/05"] = "undefined 0x80000" } do
    local fault, state = changed:match("(.*)/(.*)")
    local payload = EXAMPLE:sub(1, 18) .. bytes(fault) .. EXAMPLE:sub(23, 30) .. bytes(state) .. "\0"
    local raws, remarks = MOTOR.read(payload)
    lu.assertEquals(remarks and remarks.has_fault, expected ~= "")
    lu.assertEquals(text_of.faults(MOTOR, raws), expected)
  end
end

return T
