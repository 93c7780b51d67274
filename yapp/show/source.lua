-- SPDX-License-Identifier: GPL-2.0-or-later
-- Makes the function that builds the tree of a message: straight Lua source, made from the compiled catalogue.
--
-- It runs for every message that is shown, and what is known of a message when it loads (places, masks, scales, labels)
-- stands in it as numbers and texts:
--   a = raws[5]
--   if a then
--     if a > 65530 then items[5] = others[5](top, range(tvb, at + 8, 2), a)
--     else
--       a = format("%.7g", (-8387840.0 + a * 256.0) / 65530.0)
--       items[5] = add(top, P[9], range(tvb, at + 8, 2), tonumber(a), "DC Voltage: " .. a .. " V")
--     end
--   end
-- P goes by numbers that count the ProtoFields of the message. Where a tree is not shown, its function has of this what
-- somebody wants, and no labels.

local decode = require("yapp.message.decode")

local M = {}

local format, concat = string.format, table.concat

-- Adds a ProtoField to the plan's; returns its number, and whether it is wanted.
local function take(plan, pf)
  local list, want = plan.list, plan.want
  list[#list + 1] = pf
  return #list, not want or want[#list]
end

local function range_of(field)
  return format("range(tvb, at + %d, %d)", field.offset, field.size)
end

-- Lines for a field, by kind: (plan, field, i, made = its ProtoFields, parent = source); nil where nobody wants it.
-- plan  { list = ProtoFields by number, want = { [number] = true }, or nil where all are wanted }
local lines_of = {}

-- A rare kind is not written out: a function of show.taurus adds it.
local function other_lines(plan, field, i, made, parent)
  local _, is_wanted = take(plan, made.pf)
  if made.special then is_wanted = select(2, take(plan, made.special)) or is_wanted end
  return is_wanted and { format("items[%d] = others[%d](%s, %s, a, payload)", i, i, parent, range_of(field)) }
end

function lines_of.float(plan, field, i, made, parent)
  if field.size > 6 then return other_lines(plan, field, i, made, parent) end
  local pf, is_wanted = take(plan, made.pf)
  local _, wants_special = take(plan, made.special)
  local number = format("format(%q, %s)", decode.format_of(field), require("yapp.message.straight").float_source(field, "a"))
  local unit = field.unit and " " .. field.unit or ""
  local label = plan.want and "" or format(", %q .. a .. %q", field.title .. ": ", unit)
  return (is_wanted or wants_special) and {
    format("if a > %d then", field.ordinary),
    wants_special and format("items[%d] = others[%d](%s, %s, a)", i, i, parent, range_of(field)) or "",
    is_wanted and format("else\na = %s", number) or "",
    is_wanted and format("items[%d] = add(%s, P[%d], %s, tonumber(a)%s)", i, parent, pf, range_of(field), label) or "",
    "end",
  }
end

function lines_of.uint(plan, field, i, made, parent)
  if field.scale then return other_lines(plan, field, i, made, parent) end
  local pf, is_wanted = take(plan, made.pf)
  return is_wanted and {
    format("a = add_le(%s, P[%d], %s)", parent, pf, range_of(field)),
    field.unit and not plan.want and format("append(a, %q)", " " .. field.unit) or "",
    format("items[%d] = a", i),
  }
end

lines_of.int, lines_of.bool = lines_of.uint, lines_of.uint

function lines_of.flags(plan, field, i, made, parent)
  local pf, wants_field = take(plan, made.pf)
  local rows = {}
  for _, flag in ipairs(made.flags) do
    local number, is_wanted = take(plan, flag)
    if is_wanted then rows[#rows + 1] = format("add_le(item, P[%d], r)", number) end
  end
  local undefined, wants_undefined = take(plan, made.undefined)
  return (wants_field or wants_undefined or rows[1]) and {
    format("local r, item = %s, %s", range_of(field), parent),
    wants_field and format("item = add_le(item, P[%d], r)", pf) or "",
    plan.want and "" or format("if a ~= 0 then local names = names(F[%d], a)", i),
    plan.want and "" or 'if names ~= "" then append(item, " (" .. names .. ")") end end',
    concat(rows, "\n"),
    format("items[%d], a = item, band(a, %d)", i, field.undefined),
    wants_undefined and format("if a ~= 0 then add(item, P[%d], r, a) end", undefined) or "",
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
local BEGIN, END = "parts[#parts + 1] = function(top, tvb, at, raws, payload, items)\nlocal a", "end"
local FIELDS_OF_A_PART = 50

--- Makes the function that adds the fields of a message.
-- message   compiled; fields: the ProtoFields by field
-- others    [index of field] = function(parent, range, raw, payload) that adds what is not written out here
-- api       { add, add_le, append_text of TreeItem, range of Tvb }
-- want      { [number] = true } of the ProtoFields that are wanted of a tree that is not shown; nil for one that is
-- returns   function(top, tvb, at, raws, payload, items): items gets the items by index of field; and a list of the
--           ProtoFields by number
function M.make(message, fields, others, api, want)
  local plan, lines = { list = {}, want = want }, { HEAD, BEGIN }
  for i, field in ipairs(message.fields) do
    local inside = field.inside and message.index[field.inside]
    local parent = inside and format("(items[%d] or top)", inside) or "top"
    local source = (lines_of[field.kind] or other_lines)(plan, field, i, fields[field], parent)
    if source then lines[#lines + 1] = condition_of(field, i) .. "\n" .. concat(source, "\n") .. "\nend" end
    if i % FIELDS_OF_A_PART == 0 then lines[#lines + 1] = END .. "\n" .. BEGIN end
  end
  lines[#lines + 1] = END .. "\nreturn parts"
  local chunk = assert(load(concat(lines, "\n"), "=tree of " .. message.name))
  local parts = chunk(api.add, api.add_le, api.append_text, api.range, decode.band, decode.flag_names, message.fields,
    plan.list, others)
  if #parts == 1 then return parts[1], plan.list end
  return function(...)
    for _, part in ipairs(parts) do part(...) end
  end, plan.list
end

return M
