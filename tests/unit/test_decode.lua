-- SPDX-License-Identifier: GPL-2.0-or-later
-- Values: each count of a compressed float, and what bytes look like.  What messages say, tests/e2e/model.py compares.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local bytes = require("support").bytes
local catalogue = require("yapp.message.catalogue")
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

-- Document: "Taurus Motor Data", Fault Flags and Motor State.
function T.test_faults_in_the_info_column()
  local motor = catalogue.compile(dofile("taurus_fields.lua")).by_id[0x210]
  local example = bytes("FD7FFD7FFD7FFD7FF5AFFD7F18010000014000000000E38CD23CE04E000005FF")
  for changed, expected in pairs { ["00000000/05"] = "", ["00000110/05"] = "motor_overcurrent, hall_timeout",
    ["00000000/25"] = "faulted", ["01000000/20"] = "oc_limit_unmeasurable, faulted",
    ["00000800/05"] = "undefined 0x80000" } do
    local fault, state = changed:match("(.*)/(.*)")
    local payload = example:sub(1, 18) .. bytes(fault) .. example:sub(23, 30) .. bytes(state) .. "\0"
    local raws, remarks = motor.read(payload)
    lu.assertEquals(remarks and remarks.has_fault, expected ~= "")
    lu.assertEquals(text_of.faults(motor, raws), expected)
  end
end

return T
