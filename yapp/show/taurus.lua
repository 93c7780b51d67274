-- SPDX-License-Identifier: GPL-2.0-or-later
-- The view of the Taurus messages: their trees and expert items.  Wireshark's API; the values come
-- from message.field_kinds, the changes from the history.

local binary = require "yapp.message.binary"
local band = require "yapp.base.bits".band
local field_kinds = require "yapp.message.field_kinds"
local frame_key = require "yapp.base.frame_key"
local show_fields = require "yapp.show.fields"
local text_of = require "yapp.message.text"

local M = {}

local add = show_fields.add
local add_expert = show_fields.add_expert
local set_generated = show_fields.set_generated
local add_le = show_fields.add_le
local append_text = show_fields.append_text
local fault_names, flag_names = text_of.fault_names, text_of.flag_names
local value_of = field_kinds.value
local format = string.format
local range_of = Tvb.range
local referenced = TreeItem.referenced
local set_hidden = TreeItem.set_hidden
local set_text = TreeItem.set_text

local NONE = {}
local WAYS = { "raised", "cleared" }

local Taurus = {}
Taurus.__index = Taurus

--- Make the view of values.
-- taurus  Proto
-- types   the message types of the catalogue
-- fields  of show.fields
function M.new(taurus, types, fields)
  return setmetatable({
    taurus = taurus,
    types = types,
    fields = fields,
  }, Taurus)
end

-- Adding a field ----------------------------------------------------------------------------------

-- How a field is added, by `shown` of its kind, see message.field_kinds: function(field, fields),
-- which returns a function(parent, range, raw) -> item.
-- fields  { [filter] = ProtoField }: of flags those that are wanted
local ADD = {}

local function append_unit(item, field)
  return field.unit and append_text(item, " " .. field.unit) or item
end

-- A field whose bytes Wireshark reads itself.
function ADD.plain(field, fields)
  local pf = fields[field.filter]
  return function(parent, range)
    return append_unit(add_le(parent, pf, range), field)
  end
end

-- A number with a fraction, or the special that is there instead.
function ADD.number(field, fields)
  local pf, special_pf = fields[field.filter], fields[field.special]
  local label, unit = (field.array or field).title .. ": ", field.unit and " " .. field.unit or ""
  local bytes, write = " (0x%0" .. field.size * 2 .. "x)", field_kinds.new_number_text(field)
  return function(parent, range, raw)
    local text, special = write(raw)
    if text then return add(parent, pf, range, tonumber(text), label .. text .. unit) end
    text = label .. field_kinds.SPECIALS[special]
    if field.kind == "float" and raw >= 0 then text = text .. format(bytes, raw) end
    return set_text(add(parent, special_pf, range, special), text)
  end
end

-- A value that is worked out from the bytes.
local function new_adder(value)
  return function(field, fields)
    local pf = fields[field.filter]
    return function(parent, range, raw)
      return add(parent, pf, range, value(field, raw))
    end
  end
end

ADD.text = new_adder(value_of)
ADD.time = new_adder(function(_, raw) return NSTime.new(binary.time(raw, 0)) end)

-- Return a function(raw) -> the ProtoFields of flags, those that are set first: of thirty faults
-- the one that is there is seen at once.  It keeps the latest order.
-- flags  { { pf, mask }, ... }
local function new_order(flags)
  local order, latest = {}, nil
  return function(raw)
    if raw == latest then return order end
    local unset = {}
    order, latest = {}, raw
    for _, flag in ipairs(flags) do
      local list = band(raw, flag[2]) ~= 0 and order or unset
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
  local order_of = new_order(flags)
  return function(parent, range, raw)
    local item = pf and add_le(parent, pf, range) or parent
    local order = order_of(raw)
    for i = 1, #order do add_le(item, order[i], range) end
    if raw == 0 then return item end
    local undefined, names = band(raw, field.undefined), flag_names(field, raw)
    if undefined_pf and undefined ~= 0 then add(item, undefined_pf, range, undefined) end
    if names == "" then return item end
    if pf then append_text(item, " (" .. names .. ")") end
    if names_pf then set_hidden(set_generated(add(item, names_pf, names))) end
    return item
  end
end

-- The parts that are wanted -----------------------------------------------------------------------

-- Return the ProtoFields that a tree wants, by filter; nil for none.
local function wanted_of(self, tree, filters)
  local wanted = {}
  for _, filter in pairs(filters) do
    local pf = self.fields[filter]
    if referenced(tree, pf) then wanted[filter] = pf end
  end
  return next(wanted) and wanted
end

-- The parts of a state of message.history, in the order of the tree: name, form, and whether it is
-- about faults.
local STATES = {
  { "raised_in", frame_key.number, true },
  { "cleared_in", frame_key.number, true },
  { "previous_change", frame_key.number, true },
  { "next_change", frame_key.number, true },
  { "active_time", show_fields.relative_time, true },
  { "drift", show_fields.relative_time, false },
  { "command_in", frame_key.number, false },
}

--- Return whether a tree wants a field that comes from the history's state, which each message has.
function Taurus:wants_state(tree)
  for _, of_type in ipairs(self.types) do
    if wanted_of(self, tree, of_type.states) then return true end
  end
  return false
end

-- Add to a plan which names of faults and states are wanted.
local function add_state_steps(self, of_type, tree, plan)
  for _, row in ipairs(STATES) do
    local pf = self.fields[of_type.states[row[1]]]
    if pf and referenced(tree, pf) then
      local states = row[3] and plan.fault_states or plan.other_states
      table.insert(states, { name = row[1], show = row[2], pf = pf })
    end
  end
  local pf = self.fields[of_type.fault_names]
  plan.names = pf and referenced(tree, pf) and pf
end

-- Return the plan of a message type's tree: a list of steps { field, index, parent = index of the
-- field that it is a part of, add = see ADD }; own = true if the message's field is wanted; and the
-- wanted ones of generated, rounded, fault_states, other_states = lists; names = ProtoField of the
-- names of faults.
local function make_plan(self, of_type, tree)
  local fields = self.fields
  local plan = { generated = {}, rounded = {}, fault_states = {}, other_states = {} }
  plan.own = referenced(tree, fields[of_type.filter])
  for index, field in ipairs(of_type.fields) do
    local wanted = wanted_of(self, tree, field.filters)
    if wanted then
      plan[#plan + 1] = {
        field = field,
        index = index,
        parent = field.inside and field.inside.index,
        add = ADD[field_kinds.BY_NAME[field.kind].shown](field, field.flags and wanted or fields),
      }
    end
  end
  for _, item in ipairs(of_type.generated) do
    local pf = fields[item.filter]
    if referenced(tree, pf) then
      local write = field_kinds.new_number_text(item)
      table.insert(plan.generated, { item = item, pf = pf, write = write })
    end
  end
  -- Values for columns are not among the details.
  for _, step in ipairs(tree.visible and NONE or of_type.rounded) do
    if referenced(tree, fields[step.filter]) then table.insert(plan.rounded, step) end
  end
  add_state_steps(self, of_type, tree, plan)
  return plan
end

-- Return the plan for a tree.  In tshark's first pass it is kept in view.wants, which holds for
-- all packets: without plans a filter for one fault takes 1.9 times as long.
local function plan_of(self, of_type, view)
  local plans = view.wants.plans or {}
  plans[of_type] = plans[of_type] or make_plan(self, of_type, view.tree)
  return plans[of_type]
end

-- The tree of a message ---------------------------------------------------------------------------

-- Return the text of an element of an array, whose item begins with the array's title.  In a tree
-- that is not shown, an item has no text.
local function element_text(item, field)
  return field.title .. (item.text or ""):sub(#field.array.title + 1)
end

-- Add the names of the faults among a field's flags to a list.
local function list_faults(names, field, raw)
  local faults = fault_names(field, raw)
  if faults ~= "" then names[#names + 1] = faults end
end

-- Return the names of the faults that are set in a message: "motor_overcurrent, faulted", "" for
-- none.
local function active_faults(message)
  local names = {}
  for _, field in ipairs(message.source.type.alarms) do
    list_faults(names, field, message.raws[field.index])
  end
  return table.concat(names, ", ")
end

-- Return the names of the faults that changed.
-- changes  of message.history
-- way      "raised" or "cleared"
local function changed_faults(changes, way)
  local names = {}
  for _, one in ipairs(changes) do list_faults(names, one.field, one[way]) end
  return table.concat(names, ", ")
end

-- Return the change of the faults here: ", raised here" if that is all that are set,
-- "; hall_timeout raised here; motor_overcurrent cleared here", "" for nothing.
local function changes_text(message, active)
  local text = ""
  for _, way in ipairs(WAYS) do
    local names = changed_faults(message.change and message.change.flags or NONE, way)
    if names ~= "" then
      text = text .. (names == active and ", " or "; " .. names .. " ") .. way .. " here"
    end
  end
  return text
end

-- Add states.
-- steps  of a plan
local function add_states(state, steps, item)
  for i = 1, state and #steps or 0 do
    local step = steps[i]
    local value = state[step.name]
    if value then set_generated(add(item, step.pf, step.show(value))) end
  end
end

-- Add the faults above the values, with links to where they began and ended:
-- "[Faults: motor_overcurrent, raised here]".
-- returns  its item, nil for none
local function add_faults(message, plan, tree, top)
  local item
  local is_change = message.change and message.change.flags and tree.visible
  if plan.names and (message.remarks.has_fault or is_change) then
    local active = active_faults(message)
    local here = changes_text(message, active)
    if here == "" and message.state and message.state.active_time then
      here = (", for %.3f s"):format(message.state.active_time)
    end
    if active ~= "" then
      item = append_text(set_generated(add(top, plan.names, active)), here)
    elseif here ~= "" then
      item = set_generated(add(top, "Faults: none" .. here))
    end
  end
  add_states(message.state, plan.fault_states, item or top)
  return item
end

-- Add the values that are worked out from others.
local function add_generated_values(self, message, plan, top)
  local raws, fields = message.raws, self.fields
  for _, step in ipairs(plan.generated) do
    local text = step.write(raws)
    if text then append_unit(set_generated(add(top, step.pf, tonumber(text))), step.item) end
  end
  for _, step in ipairs(plan.rounded) do
    local field, raw = step.field, raws
    if field.index then raw = raws[field.index] end
    local value = value_of(field, raw)
    -- Adding 0 makes -0 a 0.
    if value then set_generated(add(top, fields[step.filter], step.shape:format(value) + 0)) end
  end
end

-- Build it; return it, the items by index of field, for the expert items, and the one of faults.
local function build_tree(self, message, view)
  local raws, items, of_type = message.raws, {}, message.source.type
  local plan, tvb, offset = plan_of(self, of_type, view), view.payload_tvb, view.payload_offset
  local whole = range_of(tvb, offset, math.min(of_type.size, #message.payload))
  local top = add(view.tree, self.taurus, whole, "Taurus " .. of_type.title)
  if plan.own then set_hidden(add(top, self.fields[of_type.filter], whole)) end
  local above = add_faults(message, plan, view.tree, top)
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
  add_generated_values(self, message, plan, top)
  add_states(message.state, plan.other_states, top)
  return top, items, above
end

-- Append the catalogue's help on the flags that are set.
local function append_help(item, field, raw)
  for _, flag in ipairs(field.flags) do
    if flag.help and band(raw, flag.mask) ~= 0 then
      append_text(item, ("; %s: %s"):format(flag.name, flag.help))
    end
  end
end

-- Add the expert items of the remarkable values.
-- items  by index of field
-- other  the item for a value without one; above: the item of faults, nil for none
local function add_remarks(message, items, other, above)
  for _, remark in ipairs(message.remarks) do
    local index, name = remark[1], remark[2]
    local item = items[index]
    if name ~= "fault.active" then
      add_expert(item or other, "taurus." .. name)
    elseif item then
      append_help(item, message.source.type.fields[index], message.raws[index])
    end
  end
  if message.remarks.has_fault then add_expert(above or other, "taurus.fault.active") end
end

-- Changes -----------------------------------------------------------------------------------------

-- Add the bits of flags fields that rose or fell, and one expert item if faults are among them.
-- way   "raised" or "cleared"
-- top   nil without a tree
-- item  for the expert item
local function add_flags_changes(self, changes, way, top, item)
  local has_faults = false
  for _, one in ipairs(changes) do
    local field, raw = one.field, one[way]
    local pf = self.fields[field.group .. "." .. way]
    has_faults = has_faults or band(raw, field.alarm_bits) ~= 0
    if top and raw ~= 0 and referenced(top, pf) then
      local added = set_generated(add(top, pf, raw))
      append_text(added, " (" .. flag_names(field, raw) .. ")")
      if way == "raised" then append_help(added, field, band(raw, field.alarm_bits)) end
    end
  end
  if has_faults then add_expert(item, "taurus.fault." .. way) end
end

-- Add the changes of a message, all of them generated, with their expert items.
-- top      the Taurus item, nil without a tree
-- item     for these: top, or YAPP's
-- above    the item of its faults, nil for none
-- returns  the text at the end of the Info column: "  REBOOT"
local function add_changes(self, change, top, item, above)
  local words = ""
  for _, way in ipairs(WAYS) do
    add_flags_changes(self, change.flags or NONE, way, top, above or item)
  end
  for _, row in ipairs(show_fields.CHANGES) do
    local value, label, word = change[row.change], row.label, row.word
    if value then
      add_expert(item, row[1], label and label:format(value))
      if word then words = words .. "  " .. word end
    end
  end
  return words
end

-- Return the text at the beginning of the Info column, about faults:
-- "FAULT faulted  cleared motor_overcurrent, hall_timeout  ".
local function faults_text(message, change)
  local text, cleared = "", changed_faults(change.flags or NONE, "cleared")
  if message.remarks.has_fault then
    text = text_of.faults(message.source.type, message.raws) .. "  "
  end
  return cleared == "" and text or text .. "cleared " .. cleared .. "  "
end

--- Show a message, with its changes, and its expert items.
-- message, view  as Tree:show_message takes them
-- returns  the texts at the beginning and at the end of the Info column
function Taurus:show(message, view)
  local top, items, above = nil, NONE, nil
  local change, item = message.change, view.item
  if message.raws and view.payload_tvb and message.payload ~= "" then
    top, items, above = build_tree(self, message, view)
    item = top
  end
  add_remarks(message, items, item, above)
  local words = change and add_changes(self, change, top, item, above) or ""
  return view.wants.columns and faults_text(message, change or NONE) or "", words
end

return M
