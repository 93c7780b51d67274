-- SPDX-License-Identifier: GPL-2.0-or-later
-- What a user sees of the Taurus messages: their trees and expert items.  Wireshark's API; the
-- values come from message.decode, what changed from the history.

local bits = require "yapp.base.bits"
local decode = require "yapp.message.decode"
local frame_key = require "yapp.base.frame_key"
local show_fields = require "yapp.show.fields"

local M = {}

local add = show_fields.add
local add_expert = show_fields.add_expert
local add_generated = show_fields.add_generated
local add_le = show_fields.add_le
local append_text = show_fields.append_text
local flag_names, number_text, value_of = decode.flag_names, decode.number_text, decode.value
local format = string.format
local range_of = Tvb.range
local referenced = TreeItem.referenced
local set_hidden = TreeItem.set_hidden
local set_text = TreeItem.set_text

local NONE = {}

local Taurus = {}
Taurus.__index = Taurus

--- Make the fields and expert items of the messages and hand them to the protocol.
-- taurus    Proto
-- messages  of the catalogue
function M.new(taurus, messages)
  return setmetatable({
    taurus = taurus,
    messages = messages,
    fields = show_fields.of_taurus(taurus, messages),
  }, Taurus)
end

-- Adding a field ----------------------------------------------------------------------------------

-- How a field is added, by kind: function(field, fields), which returns a function(parent, range,
-- raw) -> item.
-- fields  { [filter] = ProtoField }: of flags those that are wanted
local ADD = {}

local function append_unit(item, field)
  return field.unit and append_text(item, " " .. field.unit) or item
end

-- What Wireshark reads itself.
function ADD.uint(field, fields)
  local pf = fields[field.filter]
  return function(parent, range)
    return append_unit(add_le(parent, pf, range), field)
  end
end

ADD.int, ADD.bool, ADD.bytes = ADD.uint, ADD.uint, ADD.uint

-- A number with a fraction, or the special that is there instead.
function ADD.float(field, fields)
  local pf, special_pf = fields[field.filter], fields[field.special]
  local label, unit = (field.array or field).title .. ": ", field.unit and " " .. field.unit or ""
  local bytes = " (0x%0" .. field.size * 2 .. "x)"
  return function(parent, range, raw)
    local value, special = value_of(field, raw)
    if special then
      local text = label .. decode.SPECIALS[special]
      if field.kind == "float" and raw >= 0 then text = text .. format(bytes, raw) end
      return set_text(add(parent, special_pf, range, special), text)
    end
    local text = number_text(field, value)
    return add(parent, pf, range, tonumber(text), label .. text .. unit)
  end
end

ADD.ieee, ADD.scaled = ADD.float, ADD.float

function ADD.string(field, fields)
  local pf = fields[field.filter]
  return function(parent, range, raw)
    return add(parent, pf, range, value_of(field, raw))
  end
end

function ADD.time(field, fields)
  local pf = fields[field.filter]
  return function(parent, range, raw)
    return add(parent, pf, range, NSTime.new(decode.time(raw, 0)))
  end
end

-- Return a function(raw) -> the ProtoFields of flags, those that are set first: of thirty faults
-- the one that is there is seen at once.  It keeps the latest order.
-- flags  { { pf, mask }, ... }
local function ordered(flags)
  local order, latest = {}, nil
  return function(raw)
    if raw == latest then return order end
    local unset = {}
    order, latest = {}, raw
    for _, flag in ipairs(flags) do
      local list = bits.band(raw, flag[2]) ~= 0 and order or unset
      list[#list + 1] = flag[1]
    end
    for _, pf in ipairs(unset) do order[#order + 1] = pf end
    return order
  end
end

-- Flags, with those of their ProtoFields that are wanted.
function ADD.flags(field, fields)
  local pf, names_pf = fields[field.filter], fields[field.filter .. ".names"]
  local undefined_pf, flags = fields[field.group .. ".undefined"], {}
  for _, flag in ipairs(field.flags) do
    local own = fields[flag.filter]
    if own then flags[#flags + 1] = { own, flag.mask } end
  end
  local order_of = ordered(flags)
  return function(parent, range, raw)
    local item = pf and add_le(parent, pf, range) or parent
    local order = order_of(raw)
    for i = 1, #order do add_le(item, order[i], range) end
    if raw == 0 then return item end
    local undefined, names = bits.band(raw, field.undefined), flag_names(field, raw)
    if undefined_pf and undefined ~= 0 then add(item, undefined_pf, range, undefined) end
    if names == "" then return item end
    if pf then append_text(item, " (" .. names .. ")") end
    if names_pf then set_hidden(add_generated(item, names_pf, names)) end
    return item
  end
end

-- What is wanted ----------------------------------------------------------------------------------

-- Return the ProtoFields that a tree wants, by filter; nil for none.
local function wanted_of(self, tree, filters)
  local wanted = {}
  for _, filter in pairs(filters) do
    local pf = self.fields[filter]
    if referenced(tree, pf) then wanted[filter] = pf end
  end
  return next(wanted) and wanted
end

--- Return whether a tree wants a field that comes from the history's state, which each message has.
function Taurus:wants_state(tree)
  for _, message in ipairs(self.messages) do
    if wanted_of(self, tree, message.states) then return true end
  end
  return false
end

-- Return how the tree of a message is built: a list of steps { field, index, parent = index of the
-- field that it is a part of, add = see ADD }; own = whether the message's field is wanted;
-- generated = a list of the items that are wanted.
local function make_plan(self, message, tree)
  local plan, fields = { generated = {} }, self.fields
  plan.own = referenced(tree, fields[message.filter])
  for index, field in ipairs(message.fields) do
    local wanted = wanted_of(self, tree, field.filters)
    if wanted then
      plan[#plan + 1] = {
        field = field,
        index = index,
        parent = field.inside and field.inside.index,
        add = ADD[field.kind](field, field.flags and wanted or fields),
      }
    end
  end
  for _, item in ipairs(message.generated) do
    if referenced(tree, fields[item.filter]) then table.insert(plan.generated, item) end
  end
  return plan
end

-- Return the plan for a tree.  In tshark's first pass it is kept in what is wanted, which holds for
-- all packets: without plans a filter for one fault takes 1.9 times as long.
local function plan_of(self, message, view)
  local plans = view.wants.plans or {}
  plans[message] = plans[message] or make_plan(self, message, view.tree)
  return plans[message]
end

-- The tree of a message ---------------------------------------------------------------------------

-- Return the text of an element of an array, whose item begins with the array's title.  In a tree
-- that is not shown, an item has no text.
local function element_text(item, field)
  return field.title .. (item.text or ""):sub(#field.array.title + 1)
end

-- Build it; return it, and the items by index of field, for the expert items.
local function build(self, m, view)
  local raws, items, message = m.raws, {}, m.source.message
  local plan, tvb, offset = plan_of(self, message, view), view.payload_tvb, view.payload_offset
  local whole = range_of(tvb, offset, math.min(message.size, #m.payload))
  local top = add(view.tree, self.taurus, whole, "Taurus " .. message.title)
  if plan.own then set_hidden(add(top, self.fields[message.filter], whole)) end
  for i = 1, #plan do
    local step = plan[i]
    local field, index = step.field, step.index
    local raw = raws[index]
    if raw then
      local range = range_of(tvb, offset + field.offset, field.size)
      local item = step.add(items[step.parent] or top, range, raw)
      if field.array then set_text(item, element_text(item, field)) end
      items[index] = item
    end
  end
  for _, item in ipairs(plan.generated) do
    local value, pf = decode.derived(message, item, raws), self.fields[item.filter]
    if value then
      append_unit(add_generated(top, pf, tonumber(number_text(item, value))), item)
    end
  end
  return top, items
end

-- Append what the catalogue says of the flags that are set.
local function append_help(item, field, raw)
  for _, flag in ipairs(field.flags) do
    if flag.help and bits.fast_band(raw, flag.mask) ~= 0 then
      append_text(item, ("; %s: %s"):format(flag.name, flag.help))
    end
  end
end

-- Say that faults are set: one expert item a message, on the first field that has some; its label
-- names those of the other fields, too.
-- active  the item that says so already, nil for none
-- returns  the item that says so
local function add_active(m, index, item, active, other)
  local source, field, raw = m.source, m.source.message.fields[index], m.raws[index]
  if active then
    local names = flag_names(field, decode.faults(field, raw))
    if item then append_text(active, ", " .. names) end
  elseif item and source.label ~= source.message.title then
    append_text(item, " of " .. source.label)
  end
  if item then append_help(active or item, field, raw) end
  if not active then add_expert(item or other, "taurus.fault.active") end
  return active or item or other
end

--- Show a message, and its expert items.
-- m, view  as Tree:show_message takes them
-- returns  the Taurus item; nil without a tree
function Taurus:show(m, view)
  local top, items, active = nil, NONE, nil
  if view.payload_tvb and m.payload ~= "" then top, items = build(self, m, view) end
  for _, remark in ipairs(m.remarks or NONE) do
    local index, name = remark[1], remark[2]
    local item, other = items[index], top or view.item
    if name == "fault.active" then
      active = add_active(m, index, item, active, other)
    else
      add_expert(item or other, "taurus." .. name)
    end
  end
  return top
end

-- Changes -----------------------------------------------------------------------------------------

-- What message.history says of a state, in the order of the tree, and how it is shown.
local STATES = {
  { "drift", show_fields.relative_time },
  { "command_in", frame_key.number },
  { "active_time", show_fields.relative_time },
  { "previous_change", frame_key.number },
  { "next_change", frame_key.number },
}

-- Add a generated field, if the value is there and wanted.
local function add_wanted(item, pf, value)
  return pf and value and referenced(item, pf) and add_generated(item, pf, value)
end

-- Add the bits of a flags field that rose or fell; return the names of the faults among them, nil
-- for none.
-- way  "raised" or "cleared"
local function add_flags_change(self, item, one, way, is_tree)
  local field, raw = one.field, one[way]
  local faults = decode.faults(field, raw)
  if raw == 0 then return nil end
  local added = is_tree and add_wanted(item, self.fields[field.group .. "." .. way], raw)
  if added then append_text(added, " (" .. flag_names(field, raw) .. ")") end
  if faults == 0 then return nil end
  if added and way == "raised" then append_help(added, field, faults) end
  add_expert(added or item, "taurus.fault." .. way)
  return flag_names(field, faults)
end

-- Add what changed in the flags; return what the Info column says of it.
local function add_flags_changes(self, item, changes, is_tree)
  local cleared = {}
  for _, one in ipairs(changes) do
    add_flags_change(self, item, one, "raised", is_tree)
    cleared[#cleared + 1] = add_flags_change(self, item, one, "cleared", is_tree)
  end
  return cleared[1] and "  cleared " .. table.concat(cleared, ", ") or ""
end

--- Add what the history says of a message, all of it generated, with its expert items.
-- m        a message of reading.messages
-- top      the Taurus item; nil if no tree is wanted: then add expert items only
-- other    the item for these if top is nil
-- returns  what the Info column says of it: "  cleared motor_overcurrent, hall_timeout  REBOOT"
function Taurus:add_change(m, top, other)
  local change, item = m.change or NONE, top or other
  local info = add_flags_changes(self, item, change.flags or NONE, top)
  for _, row in ipairs(top and m.state and STATES or NONE) do
    local value, pf = m.state[row[1]], self.fields[m.source.message.states[row[1]]]
    add_wanted(item, pf, value and row[2](value))
  end
  for _, row in ipairs(show_fields.CHANGES) do
    local value, label, word = change[row.change], row.label, row.word
    if value then
      add_expert(item, row[1], label and label:format(value))
      if word then info = info .. "  " .. word end
    end
  end
  return info
end

return M
