-- SPDX-License-Identifier: GPL-2.0-or-later
-- The bits of a field of the catalogue: its flags, and the parts of several bits.  Pure Lua, 5.2 and 5.4.

local check = require("yapp.message.catalogue_check")
local types = require("yapp.message.catalogue_types")

local shown, is_integer, is_name, is_text = check.shown, check.is_integer, check.is_name, check.is_text

local M = {}

-- What the plugin itself puts under a group's name.
local RESERVED = { undefined = true, raised = true, cleared = true, active_time = true, previous_change = true,
  next_change = true }

-- The bits of mask that are already taken, as the lowest of them; else takes them.
local function take(field, mask)
  local place = 1
  while place <= mask do
    local taken = field.undefined % (2 * place) < place
    if mask % (2 * place) >= place then
      if taken then return place end
      field.undefined = field.undefined - place
    end
    place = place * 2
  end
end

-- A flag, or a part: { name, mask, title }; says what is wrong with it and returns nothing, or takes its bits.
local function check_bits(field, row, what, complain)
  local name, mask, title = row[1], row[2], row[3]
  if not is_name(name) then return complain("%s: %s is not a filter name (a-z, 0-9, _)", what, shown(name)) end
  what = what:match("%a+") .. " " .. name
  if not is_integer(mask) or mask < 1 or mask > field.top then
    return complain("%s: mask %s does not fit the type %s", what, shown(mask), field.type)
  end
  if not is_text(title) then return complain("%s has no title", what) end
  local bit = take(field, mask)
  if bit then return complain("%s: bit 0x%X is already another's", what, bit) end
  return what
end

local function add_flag(field, row, i, complain)
  if type(row) ~= "table" then return complain("flag %d: %s is not { name, mask, title }", i, shown(row)) end
  local name = row[1]
  for _, flag in ipairs(field.flags) do
    if flag.name == name then return complain("flag %s: the name is taken", name) end
  end
  if RESERVED[name] then return complain("flag %s: the name is taken", name) end
  local what = check_bits(field, row, "flag " .. i, complain)
  if not what then return end
  check.check_options(row, what, {}, complain, 3)
  field.flags[#field.flags + 1] = { name = name, mask = row[2], title = row[3], filter = field.group .. "." .. name }
end

-- Takes the flags of a row; field.undefined is what is left.
local function add_flags(field, row, complain)
  if type(row.flags) ~= "table" then return complain("flags must be a list, not %s", shown(row.flags)) end
  if #row.flags > 32 then return complain("more flags than bits") end
  for i = 1, #row.flags do add_flag(field, row.flags[i], i, complain) end
end

-- A part of a field, as a row of its own: a field with a mask, whose counts begin at the mask's lowest bit.
local function make_part(field, row, i, complain)
  if type(row) ~= "table" then return complain("bits %d: %s is not { name, mask, title }", i, shown(row)) end
  local what = check_bits(field, row, "bits " .. i, complain)
  if not what then return end
  local mask, low = row[2], 1
  while mask % (2 * low) == 0 do low = low * 2 end
  local span = mask / low + 1
  while span % 2 == 0 do span = span / 2 end
  if span ~= 1 then return complain("%s: the bits of mask 0x%X are not side by side", what, mask) end
  if not check.check_options(row, what, types.PART_OPTIONS, complain, 3) then return end
  field.watched = field.watched - mask
  return { name = row[1], title = row[3], type = field.type, kind = "uint", filter = row[1], size = field.size,
    mask = mask, low = low, top = types.whole(mask / low), bottom = 0, inside = field }
end

--- Makes a field one of flags, parts, or both.
-- field   compiled as far as its type says; gets kind = "flags", flags = { { name, mask, title, filter } },
--         group (the filter above its flags), undefined (the mask of the bits that nobody defines) and
--         watched (the mask of all bits that are not in parts: what can rise and fall)
-- row     of the catalogue; prefix: the filter of the message
-- returns a list of { field, row } of the parts
function M.add(field, row, prefix, complain)
  if row.flags ~= nil and not is_name(row.group) then
    complain("flags need a group, a name for their filters")
    return {}
  end
  if row.group ~= nil and not is_name(row.group) then complain("group %s is not a filter name", shown(row.group)) end
  field.kind, field.flags, field.alarm = "flags", {}, row.alarm
  field.group = prefix .. "." .. (is_name(row.group) and row.group or field.name)
  field.undefined, field.watched = field.top, field.top
  if row.flags ~= nil then add_flags(field, row, complain) end
  local parts = {}
  if row.bits == nil then return parts end
  if type(row.bits) ~= "table" or #row.bits > 32 then
    complain("bits must be a list of at most 32 rows, not %s", shown(row.bits))
    return parts
  end
  for i = 1, #row.bits do
    local part = make_part(field, row.bits[i], i, complain)
    if part then parts[#parts + 1] = { part, row.bits[i] } end
  end
  return parts
end

return M
