-- SPDX-License-Identifier: GPL-2.0-or-later
-- The view of the Taurus messages: their values, faults and changes.  Wireshark's API; the values
-- come from message.field_kinds, the changes from the history.

local band = require "yapp.base.bits".band
local binary = require "yapp.message.binary"
local field_kinds = require "yapp.message.field_kinds"
local mapped = require "yapp.base.mapped"
local number_of = require "yapp.base.frame_key".number
local show_fields = require "yapp.show.fields"
local text_of = require "yapp.message.text"

local Taurus = {}
Taurus.__index = Taurus

local add, add_le, append_text = TreeItem.add, TreeItem.add_le, TreeItem.append_text
local referenced, set_generated = TreeItem.referenced, TreeItem.set_generated
local set_hidden = TreeItem.set_hidden
local add_expert = show_fields.add_expert
local fault_names, flag_names = text_of.fault_names, text_of.flag_names
local range_of, value_of = Tvb.range, field_kinds.value

local NONE = {}
local WAYS = { "raised", "cleared" }

--- Make the view of values.
-- taurus  Proto
-- fields  of show.fields
function Taurus.new(taurus, fields)
  return setmetatable({
    taurus = taurus,
    fields = fields,
    wants = false, -- what was wanted when the plans were made
    plans = {}, -- [message type] = a plan, see find_plan
  }, Taurus)
end

--- Add the name of the protocol to a tree.
function Taurus:add_name(tree)
  add(tree, self.taurus)
end

-- Adding a field ----------------------------------------------------------------------------------

-- How a field is added, by `shown` of its kind, see message.field_kinds: function(field, fields),
-- which returns a function(parent, range, raw) -> item.
-- fields  { [filter] = ProtoField }: of flags those that are wanted
local ADD = {}

local function append_unit(item, unit)
  return unit and append_text(item, " " .. unit) or item
end

-- A field whose bytes Wireshark reads itself.
function ADD.plain(field, fields)
  local pf = fields[field.filter]
  return function(parent, range)
    return append_unit(add_le(parent, pf, range), field.unit)
  end
end

-- A number with a fraction, or the special that is there instead.
function ADD.number(field, fields)
  local pf, special_pf = fields[field.filter], fields[field.special]
  local label, unit = field.title .. ": ", field.unit and " " .. field.unit or ""
  return function(parent, range, raw)
    local text, special = field_kinds.text(field, raw)
    if text then return add(parent, pf, range, tonumber(text), label .. text .. unit) end
    return add(parent, special_pf, range, special)
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
ADD.time = new_adder(function(_, raw) return NSTime.new(binary.time(raw)) end)

-- Flags, with those of their ProtoFields that are wanted.
function ADD.flags(field, fields)
  local pf, names_pf = fields[field.filter], fields[field.filter .. ".names"]
  local undefined_pf = fields[field.group .. ".undefined"]
  local flags = mapped(field.flags, function(flag) return fields[flag.filter] end)
  return function(parent, range, raw)
    local item = pf and add_le(parent, pf, range) or parent
    for _, flag in ipairs(flags) do add_le(item, flag, range) end
    if raw == 0 then return item end
    local undefined, names = band(raw, field.undefined), flag_names(field, raw)
    if undefined_pf and undefined ~= 0 then add(item, undefined_pf, range, undefined) end
    if names == "" then return item end
    if pf then append_text(item, " (" .. names .. ")") end
    if names_pf then set_hidden(set_generated(add(item, names_pf, names))) end
    return item
  end
end

-- Plans: what of a message type is wanted ---------------------------------------------------------

-- Return the ProtoFields that a tree wants, by filter; nil for none.
local function find_wanted(self, tree, filters)
  local wanted = {}
  for _, filter in ipairs(filters) do
    local pf = self.fields[filter]
    if referenced(tree, pf) then wanted[filter] = pf end
  end
  return next(wanted) and wanted
end

local function list_fields(self, message_type, tree)
  return mapped(message_type.fields, function(field)
    local wanted = find_wanted(self, tree, field.filters)
    local new_add = ADD[field_kinds.BY_NAME[field.kind].shown]
    return wanted and {
      field = field,
      add = new_add(field, field.flags and wanted or self.fields),
    }
  end)
end

-- List the values that are worked out: those of two fields, and those for columns, with as many
-- digits as a column needs.  The latter are not among the details.
local function list_values(self, message_type, tree)
  local list = {}
  local function append(filter, item, shape, unit)
    local pf = self.fields[filter]
    if not referenced(tree, pf) then return end
    list[#list + 1] = { pf = pf, item = item, shape = shape, unit = unit }
  end
  for _, item in ipairs(message_type.generated) do
    append(item.filter, item, item.shape, item.unit)
  end
  for _, row in ipairs(tree.visible and NONE or message_type.rounded) do
    append(row.filter, row.field, row.field.rounded)
  end
  return list
end

-- The parts of a state of message.history, in the order of the tree: name, form, and whether it is
-- about faults.
local STATES = {
  { "previous_change", number_of, true },
  { "next_change", number_of, true },
  { "active_time", show_fields.relative_time, true },
  { "drift", show_fields.relative_time, false },
  { "command_in", number_of, false },
}

-- Return the plan of a message type's tree: has_own = true if the message's field is wanted, and
-- what is wanted of its fields and of the values that are worked out from them.  In tshark's first
-- pass the same is wanted of all packets: without plans a filter for one fault takes 1.9 times as
-- long.
local function find_plan(self, message_type, view)
  if view.wants ~= self.wants then self.wants, self.plans = view.wants, {} end
  local plan, tree = self.plans[message_type], view.tree
  if plan then return plan end
  plan = {
    has_own = referenced(tree, self.fields[message_type.filter]),
    fields = list_fields(self, message_type, tree),
    values = list_values(self, message_type, tree),
  }
  self.plans[message_type] = plan
  return plan
end

-- Faults ------------------------------------------------------------------------------------------

-- Return the names of the faults that changed.
-- change  of a message, or false
-- way     "raised" or "cleared"
local function changed_faults(change, way)
  local names = mapped(change and change.flags or NONE, function(flags)
    local faults = fault_names(flags.field, flags[way])
    return faults ~= "" and faults
  end)
  return table.concat(names, ", ")
end

-- Add the faults above the values: "[Faults: motor_overcurrent, raised here]",
-- "[Faults: none; hall_timeout cleared here]".
-- returns  its item, nil for none
local function add_faults(message, top)
  local active, here = text_of.faults(message.source.type, message.raws), ""
  for _, way in ipairs(WAYS) do
    local names = changed_faults(message.change, way)
    if names ~= "" then
      here = here .. (names == active and ", " or "; " .. names .. " ") .. way .. " here"
    end
  end
  if active == "" and here == "" then return nil end
  return set_generated(add(top, "Faults: " .. (active == "" and "none" or active) .. here))
end

-- Return the text at the beginning of the Info column:
-- "FAULT faulted  cleared motor_overcurrent, hall_timeout  ".
local function faults_text(message)
  local text, cleared = "", changed_faults(message.change, "cleared")
  if message.has_fault then
    text = "FAULT " .. text_of.faults(message.source.type, message.raws) .. "  "
  end
  return cleared == "" and text or text .. "cleared " .. cleared .. "  "
end

-- The tree of a message ---------------------------------------------------------------------------

-- Add the fields; return their items by index.
local function add_fields(message, plan, view, top)
  local raws, tvb, offset, items = message.raws, view.tvb, view.offset, {}
  for _, step in ipairs(plan.fields) do
    local field = step.field
    local index = field.index
    local raw = raws[index]
    if raw then
      local range = range_of(tvb, offset + field.offset, field.size)
      items[index] = step.add(top, range, raw)
    end
  end
  return items
end

-- Add the values that are worked out.
local function add_values(message, plan, top)
  for _, step in ipairs(plan.values) do
    local item, raw = step.item, message.raws
    if item.index then raw = raw[item.index] end
    local value = value_of(item, raw)
    if value then
      local number = step.shape:format(value) + 0 -- adding 0 makes -0 a 0
      local label = item.title .. ": " .. step.shape:format(number)
      append_unit(set_generated(add(top, step.pf, number, label)), step.unit)
    end
  end
end

-- Build it; return it, the items by index of field, for the expert items, and the one of faults.
local function build_tree(self, message, view)
  local message_type, tree, faults = message.source.type, view.tree, nil
  local plan = find_plan(self, message_type, view)
  local size = math.min(message_type.size, #message.payload)
  local range = range_of(view.tvb, view.offset, size)
  local top = add(tree, self.taurus, range, "Taurus " .. message_type.title)
  if plan.has_own then set_hidden(add(top, self.fields[message_type.filter], range)) end
  if tree.visible and (message.has_fault or message.change) then
    faults = add_faults(message, top)
  end
  local items = add_fields(message, plan, view, top)
  add_values(message, plan, top)
  for _, row in ipairs(message.state and STATES or NONE) do
    local name, show, is_about_faults = row[1], row[2], row[3]
    local value, pf = message.state[name], self.fields[message_type.states[name]]
    if value and pf and referenced(tree, pf) then
      set_generated(add(is_about_faults and faults or top, pf, show(value)))
    end
  end
  return top, items, faults
end

-- Append the catalogue's help on the flags that are set.
local function append_help(item, field, raw)
  for _, flag in ipairs(field.flags) do
    if flag.help and band(raw, flag.mask) ~= 0 then
      append_text(item, ("; %s: %s"):format(flag.name, flag.help))
    end
  end
end

-- Expert items ------------------------------------------------------------------------------------
--
-- item    of the message, for what has no item of its own
-- faults  the item for faults

-- Add those of the remarkable values.
-- items  by index of field
local function add_remarks(message, items, item, faults)
  for _, remark in ipairs(message.remarks) do
    local index, name = remark[1], remark[2]
    if name ~= "fault.active" then
      add_expert(items[index] or item, "taurus." .. name)
    elseif items[index] then
      append_help(items[index], message.source.type.fields[index], message.raws[index])
    end
  end
  if message.has_fault then add_expert(faults, "taurus.fault.active") end
end

-- Add the bits of flags fields that rose or fell, and one expert item if faults are among them.
-- way  "raised" or "cleared"
-- top  nil without a tree
local function add_flags_changes(self, changes, way, top, faults)
  local has_faults = false
  for _, change in ipairs(changes) do
    local field, raw = change.field, change[way]
    local pf = self.fields[field.group .. "." .. way]
    has_faults = has_faults or band(raw, field.alarm_bits) ~= 0
    if top and raw ~= 0 and referenced(top, pf) then
      append_text(set_generated(add(top, pf, raw)), " (" .. flag_names(field, raw) .. ")")
    end
  end
  if has_faults then add_expert(faults, "taurus.fault." .. way) end
end

-- Add the changes of a message, all of them generated, with their expert items.
-- returns  the text at the end of the Info column: "  REBOOT"
local function add_changes(self, change, top, item, faults)
  local words = ""
  for _, way in ipairs(WAYS) do
    add_flags_changes(self, change.flags or NONE, way, top, faults)
  end
  for _, row in ipairs(show_fields.EXPERTS) do
    local value, label, word = row.change and change[row.change], row.label, row.word
    if value then
      add_expert(item, row[1], label and label:format(value))
      if word then words = words .. "  " .. word end
    end
  end
  return words
end

--- Show a message: the tree of its values, and its expert items.
-- view     a show.view
-- returns  the texts at the beginning and at the end of the Info column
function Taurus:show(message, view)
  local top, items, faults = nil, NONE, nil
  if message.raws and view.wants.tree and message.payload ~= "" then
    top, items, faults = build_tree(self, message, view)
  end
  local item = top or view.item
  add_remarks(message, items, item, faults or item)
  local words = message.change and add_changes(self, message.change, top, item, faults or item)
  return view.wants.columns and faults_text(message) or "", words or ""
end

return Taurus
