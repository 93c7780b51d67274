-- SPDX-License-Identifier: GPL-2.0-or-later
-- The filters of a message type: its own, those of its fields, of the values that are worked out
-- from two fields, and of its state.  Pure Lua.

local field_kinds = require "yapp.message.field_kinds"
local input = require "yapp.base.input"

local M = {}

-- Digits behind the point in a column, by unit.
local DIGITS = { RPM = 0, V = 2, A = 2, W = 0, ["°C"] = 0, ["%"] = 0 }

-- Return the description of a field, a flag or a generated value.
-- item  { title; unit, min and max, or nil }
local function describe(message_type, item)
  local text = item.title
  if item.unit then text = text .. " in " .. item.unit end
  if item.min then text = ("%s, %.10g to %.10g"):format(text, item.min, item.max) end
  text = text .. ", of " .. message_type.title
  local section = message_type.section
  if section and not item.operator then text = ('%s (section "%s")'):format(text, section) end
  return text
end

local function add_flags(message_type, field, about, add)
  local title, group, bits = field.title, field.group, field.size * 8
  add(group .. ".undefined", "UINT32", "Undefined bits", "Bits that nothing defines: " .. about,
    "HEX")
  for _, flag in ipairs(field.flags) do
    local item = { title = flag.title .. ", one of " .. title }
    local text = describe(message_type, item)
    if flag.help then text = text .. ". " .. flag.help end
    add(flag.filter, "BOOLEAN", flag.title, text, bits, nil, flag.mask)
  end
  add(field.filter .. ".names", "STRING", title, "Names of the bits that are set: " .. about)
  for _, way in ipairs { "raised", "cleared" } do
    add(group .. "." .. way, "UINT" .. bits, title .. " " .. way,
      ("Bits %s since the source's previous good message: %s"):format(way, about), "HEX")
  end
end

local function add_field(message_type, field, add)
  local about = describe(message_type, field)
  local kind, base = field_kinds.BY_NAME[field.kind].filter, nil
  if kind:find("INT") then kind = kind .. (field.size > 4 and 64 or 8 * field.size) end
  if kind:find("^UINT") and (field.values or field.flags) then base = "HEX" end
  if field.flags then add_flags(message_type, field, about, add) end
  if field.special then
    local why = "Why there is no number, a reserved count, NaN or infinity: " .. about
    add(field.special, "UINT8", field.title, why, nil, field_kinds.SPECIALS)
  end
  add(field.filter, kind, field.title, about, base, field.values)
end

-- Add the filters of a state of message.history.
local function add_state(message_type, add)
  local fault, states = message_type.alarms[1], message_type.states
  local filter, answered = message_type.filter, message_type.answers
  if message_type.time then
    states.drift = add(filter .. ".clock_drift", "RELATIVE_TIME", "Clock drift",
      "Controller's clock less the capture's since the source's first message or reboot")
  end
  if answered then
    local title = answered:gsub("^%l", string.upper):gsub("_", " ")
    states.command_in = add(("%s.%s_in"):format(filter, answered), "FRAMENUM",
      ("Latest %s in"):format(title),
      ("The latest %s on this bus before the message"):format(title), nil, "REQUEST")
  end
  if not fault then return end
  states.active_time = add(fault.group .. ".active_time", "RELATIVE_TIME",
    "Time since the oldest fault was raised",
    "Since the oldest fault that is still set was raised")
  for _, way in ipairs { "previous", "next" } do
    states[way .. "_change"] = add(("%s.%s_change"):format(fault.group, way), "FRAMENUM",
      ("%s: %s change in"):format(fault.title, way),
      ("The source's %s message that changes a fault"):format(way))
  end
end

-- Add the filter of a value with as many digits as a column needs.
local function add_rounded(message_type, item, add)
  local digits = DIGITS[item.unit]
  if not digits or not item.shape then return end
  item.rounded = ("%%.%df"):format(digits)
  table.insert(message_type.rounded, {
    filter = add(item.filter .. ".rounded", "DOUBLE", item.title,
      ("%s of %s, rounded for a column: not among a packet's details")
        :format(item.title, message_type.title)),
    field = item,
  })
end

--- Add all filters of a message type.  Raise that a name is there twice.
-- context  the subject of errors, see message.catalogue
function M.add(message_type, context)
  local taken, filters = {}, {}
  local function add(filter, ...)
    input.demand(not taken[filter], "the filter name %s is taken", filter)
    input.demand(filter:find("^[a-z0-9_.]+$"), "%q is no filter name (a-z, 0-9, _)", filter)
    taken[filter] = true
    table.insert(message_type.filters, { filter, ... })
    filters[#filters + 1] = filter
    return filter
  end
  local title = message_type.title
  add(message_type.filter, "NONE", title, "A whole message: " .. title)
  add_state(message_type, add)
  for _, item in ipairs(message_type.generated) do
    add(item.filter, "DOUBLE", item.title, describe(message_type, item))
  end
  for _, field in ipairs(message_type.fields) do
    context.field, filters = ", field " .. field.name, {}
    add_field(message_type, field, add)
    field.filters = filters
  end
  context.field, filters = "", {}
  for _, list in ipairs { message_type.fields, message_type.generated } do
    for _, item in ipairs(list) do add_rounded(message_type, item, add) end
  end
end

return M
