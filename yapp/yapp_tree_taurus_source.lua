-- SPDX-License-Identifier: GPL-2.0-or-later
-- Makes the function that builds the tree of a message: straight Lua source, made from the compiled catalogue.
--
-- It runs for every message that is shown, and what is known of a message when it loads (places, masks, scales, labels)
-- stands in it as numbers and texts:
--   a = raws[5]
--   if a and (all or want[9]) then
--     if a <= 65530 then
--       a = format("%.7g", (-8387840.0 + a * 256.0) / 65530.0)
--       items[5] = add(top, P[9], range(tvb, at + 8, 2), tonumber(a), all and "DC Voltage: " .. a .. " V")
--     else items[5] = others[5](top, range(tvb, at + 8, 2), a, payload) end
--   end
-- P and want go by numbers that count the ProtoFields of the message.

local decode = require("yapp_decode")

local M = {}

local format, concat = string.format, table.concat

-- Adds a ProtoField to the list; returns its number.
local function number_of(list, pf)
  list[#list + 1] = pf
  return #list
end

local function range_of(field)
  return format("range(tvb, at + %d, %d)", field.offset, field.size)
end

-- Lines for a field, by kind: (field, i, made = its ProtoFields, list = the numbered ones, parent = source).
local lines_of = {}

-- A rare kind is not written out: a function of yapp_tree_taurus adds it.
local function other_lines(field, i, made, list, parent)
  local pf = number_of(list, made.pf)
  local wanted = format("all or want[%d]", pf)
  if made.special then wanted = format("%s or want[%d]", wanted, number_of(list, made.special)) end
  return { format("if %s then items[%d] = others[%d](%s, %s, a, payload) end", wanted, i, i, parent, range_of(field)) }
end

function lines_of.float(field, i, made, list, parent)
  if field.size > 6 then return other_lines(field, i, made, list, parent) end
  local pf, special = number_of(list, made.pf), number_of(list, made.special)
  local number = format("format(%q, %s)", decode.format_of(field), decode.float_source(field, "a"))
  local unit = field.unit and " " .. field.unit or ""
  return {
    format("if a > %d then", field.ordinary),
    format("if all or want[%d] then items[%d] = others[%d](%s, %s, a) end", special, i, i, parent, range_of(field)),
    format("elseif all then a = %s", number),
    format("items[%d] = add(%s, P[%d], %s, tonumber(a), %q .. a .. %q)", i, parent, pf, range_of(field),
      field.title .. ": ", unit),
    format("elseif want[%d] then", pf),
    format("items[%d] = add(%s, P[%d], %s, tonumber(%s)) end", i, parent, pf, range_of(field), number),
  }
end

function lines_of.uint(field, i, made, list, parent)
  if field.scale then return other_lines(field, i, made, list, parent) end
  local pf = number_of(list, made.pf)
  local lines = { format("if all or want[%d] then local item = add_le(%s, P[%d], %s)", pf, parent, pf,
    range_of(field)) }
  if field.unit then lines[2] = format("if all then append(item, %q) end", " " .. field.unit) end
  lines[#lines + 1] = format("items[%d] = item end", i)
  return lines
end

lines_of.int, lines_of.bool = lines_of.uint, lines_of.uint

-- The flags of a tree that is not shown are a list of those that somebody wants: want.flags[i].
function lines_of.flags(field, i, made, list, parent)
  local pf, rows = number_of(list, made.pf), {}
  for j, flag in ipairs(made.flags) do rows[j] = format("add_le(item, P[%d], r)", number_of(list, flag)) end
  local undefined = number_of(list, made.undefined)
  list.flags[i] = { first = pf, last = undefined }
  return {
    format("local few = want and want.flags[%d]", i),
    "if all or few then",
    format("local r = %s", range_of(field)),
    format("local item = add_le(%s, P[%d], r)", parent, pf),
    "if all then",
    format("if a ~= 0 then local names = names(F[%d], a)", i),
    'if names ~= "" then append(item, " (" .. names .. ")") end end',
    concat(rows, "\n"),
    "else for j = 1, #few do add_le(item, few[j], r) end end",
    format("items[%d], a = item, band(a, %d)", i, field.undefined),
    format("if a ~= 0 then add(item, P[%d], r, a) end", undefined),
    "end",
  }
end

-- A time has no raw value: whether it is there depends on the payload, and on its case.
local function condition_of(field, i)
  if field.kind ~= "time" then return format("a = raws[%d]\nif a then", i) end
  local when = field.when and format(" and raws[%d] == %d", field.when.index, field.when.value) or ""
  return format("if #payload >= %d%s then", field.offset + field.size, when)
end

local HEAD = [[local add, add_le, append, range, band, names, F, P, others = ...
local format, tonumber = string.format, tonumber
local parts = {}
]]

-- A function may not be of any length: some fields each.
local BEGIN = "parts[#parts + 1] = function(top, tvb, at, raws, payload, items, want)\nlocal all, a = not want"
local FIELDS_OF_A_PART = 50

--- Makes the function that adds the fields of a message.
-- message   compiled; fields: the ProtoFields by field
-- others    [index of field] = function(parent, range, raw, payload) that adds what is not written out here
-- api       { add, add_le, append_text of TreeItem, range of Tvb }
-- returns   function(top, tvb, at, raws, payload, items, want): items gets the items by index of field; want is nil
--           when all is shown, else { [number] = true, flags = { [index of a flags field] = list } } of the ProtoFields
--           that are wanted, a list where the field or any flag is; and the ProtoFields by number, with flags =
--           { [index] = { first =, last = } }, the numbers of a flags field, its flags, and its undefined bits
function M.make(message, fields, others, api)
  local list, lines = { flags = {} }, { HEAD }
  for i, field in ipairs(message.fields) do
    if i % FIELDS_OF_A_PART == 1 then lines[#lines + 1] = BEGIN end
    local inside = field.inside and message.index[field.inside]
    local parent = inside and format("(items[%d] or top)", inside) or "top"
    lines[#lines + 1] = condition_of(field, i)
    local source = (lines_of[field.kind] or other_lines)(field, i, fields[field], list, parent)
    lines[#lines + 1] = concat(source, "\n")
    lines[#lines + 1] = "end"
    if i % FIELDS_OF_A_PART == 0 or i == #message.fields then lines[#lines + 1] = "end" end
  end
  lines[#lines + 1] = "return parts"
  local chunk = assert(load(concat(lines, "\n"), "=tree of " .. message.name))
  local parts = chunk(api.add, api.add_le, api.append_text, api.range, decode.band, decode.flag_names, message.fields,
    list, others)
  if #parts == 1 then return parts[1], list end
  return function(...)
    for _, part in ipairs(parts) do part(...) end
  end, list
end

return M
