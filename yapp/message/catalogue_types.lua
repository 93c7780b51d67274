-- SPDX-License-Identifier: GPL-2.0-or-later
-- The types that a row of the catalogue may have, and the options of each.  Pure Lua, 5.2 and 5.4.

local M = {}

local tointeger = rawget(math, "tointeger")

--- COMPAT 5.4: powers and quotients are floats there, and "%d" wants integers.
local function whole(n) return tointeger and tointeger(n) or n end
M.whole = whole

local function set(text)
  local names = {}
  for name in text:gmatch("%S+") do names[name] = true end
  return names
end

local SCALED = "unit scale offset count"
local OPTIONS = {
  uint = set("values invalid flags group alarm bits " .. SCALED), int = set("values invalid " .. SCALED),
  wide = set(SCALED), float = set("min max unit count"), time = set(""), bool = set("count"),
  text = set("length count"), padding = set("length"), variants = set("by cases"),
}

--- [name] = { size (bytes; nil: the row says it), kind, options, top, bottom (highest and lowest count) }
M.TYPES = {
  int64_ns = { size = 8, kind = "time", options = OPTIONS.time },
  bool = { size = 1, kind = "bool", top = 1, bottom = 0, options = OPTIONS.bool },
  string = { kind = "string", options = OPTIONS.text }, bytes = { kind = "bytes", options = OPTIONS.text },
  padding = { kind = "padding", options = OPTIONS.padding },
  variants = { kind = "variants", options = OPTIONS.variants },
}

for _, size in ipairs { 1, 2, 3, 4, 8 } do
  local span = 2 ^ (size * 8)
  M.TYPES["uint" .. size * 8] = { size = size, kind = "uint", top = whole(span - 1), bottom = 0,
    options = size > 4 and OPTIONS.wide or OPTIONS.uint }
  M.TYPES["int" .. size * 8] = { size = size, kind = "int", top = whole(span / 2 - 1), bottom = whole(-span / 2),
    options = size > 4 and OPTIONS.wide or OPTIONS.int }
end
-- Compressed with min and max; without them float32 and float64 are those of IEEE 754.
for size = 1, 8 do
  M.TYPES["float" .. size * 8] = { size = size, kind = "float", top = whole(2 ^ (size * 8) - 1),
    options = OPTIONS.float }
end

local order = {}
for name in pairs(M.TYPES) do order[#order + 1] = name end
-- By the letters, then the number: int8 before int16.
local function key(name) return name:match("^%a+") .. ("%03d"):format(name:match("%d+") or 0) .. name end
table.sort(order, function(a, b) return key(a) < key(b) end)

--- The names of all types, for a message.
M.NAMES = table.concat(order, ", ")

--- The options of a part of a field that lies in some of its bits.
M.PART_OPTIONS = set("values invalid unit scale offset")

--- The options of a message.
M.MESSAGE_OPTIONS = set("name title id size info every answers differences")

return M
