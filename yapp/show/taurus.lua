-- SPDX-License-Identifier: GPL-2.0-or-later
-- What a user sees of the Taurus messages: their trees and expert items.  Wireshark's API; the
-- values come from
-- message.decode, what changed from the history.

local decode = require("yapp.message.decode")
local fields = require("yapp.show.fields")
local items_of = require("yapp.show.items")

local M = {}

local add, add_le, add_generated = items_of.add, items_of.add_le, items_of.add_generated
local append_text, set_text = items_of.append_text, items_of.set_text
local set_hidden, set_generated = items_of.set_hidden, items_of.set_generated
local relative_time, referenced = items_of.relative_time, items_of.referenced
local range_of = items_of.range
local format, band, flag_names = string.format, decode.band, decode.flag_names

local NONE = {}

local Taurus = {}
Taurus.__index = Taurus

--- Makes the fields and expert items of the messages and hands them to the protocol.
-- taurus     Proto
-- catalogue  compiled
function M.new(taurus, catalogue)
  local self = setmetatable({ taurus = taurus, shown = {}, steady = {} }, Taurus)
  self.messages, self.fields, self.experts, self.standing = fields.of_taurus(taurus, catalogue)
  return self
end

--- To be called before each file: what is wanted of a tree may be other than before.
function Taurus:reset()
  self.steady = {}
end

-- Adding a field, by kind: (step, parent, range, raw) -> item; see step_of.
local adders = {}

local function with_unit(item, step)
  if step.unit then append_text(item, step.unit) end
  return item
end

-- What Wireshark reads itself.
function adders.uint(step, parent, range)
  return with_unit(add_le(parent, step.made.pf, range), step)
end

adders.int, adders.bool, adders.bytes = adders.uint, adders.uint, adders.uint

local function add_special(step, parent, range, raw, special)
  local field, text = step.field, decode.SPECIALS[special]
  if field.kind == "float" and raw > 0 then
    text = format("%s (0x%0" .. field.size * 2 .. "x)", text, raw)
  end
  return set_text(add(parent, step.made.special, range, special), step.label .. text)
end

-- A number with a fraction, or the special that is there instead.
function adders.float(step, parent, range, raw)
  local field, pf = step.field, step.made.pf
  local value, special = step.value(field, raw)
  if special then return add_special(step, parent, range, raw, special) end
  if not step.digits then
    return with_unit(add(parent, pf, range, decode.rounded(field, value)), step)
  end
  local digits = format(step.digits, value)
  if not step.is_shown then return add(parent, pf, range, tonumber(digits)) end
  return add(parent, pf, range, tonumber(digits), step.label .. digits .. (step.unit or ""))
end

adders.ieee = adders.float

function adders.string(step, parent, range, raw)
  return add(parent, step.made.pf, range, decode.text(raw))
end

function adders.time(step, parent, range, raw)
  return add(parent, step.made.pf, range, raw)
end

local function add_names(step, item, range, raw)
  local undefined, names = decode.undefined(step.field, raw), flag_names(step.field, raw)
  if undefined ~= 0 and step.undefined then add(item, step.undefined, range, undefined) end
  if names == "" then return end
  if step.is_shown then append_text(item, " (" .. names .. ")") end
  if step.names then set_hidden(add_generated(item, step.names, names)) end
end

function adders.flags(step, parent, range, raw)
  local flags, item = step.flags, parent
  if step.pf then item = add_le(parent, step.pf, range) end
  for i = 1, #flags do add_le(item, flags[i], range) end
  if raw ~= 0 then add_names(step, item, range, raw) end
  return item
end

-- What is wanted ----------------------------------------------------------------------------------

--- Whether somebody wants of a tree what the history says of every message, not only of one that
--  changes something.
function Taurus:wants_standing(tree)
  for _, pf in ipairs(self.standing) do
    if referenced(tree, pf) then return true end
  end
  return false
end

-- How a field is added to a tree: { field, made = its ProtoFields, index, inside = index of the
-- field that it is a part
-- of, add = of adders, ... }.
local function new_step(message, index, made, is_shown)
  local field = message.fields[index]
  return {
    field = field, made = made, index = index, is_shown = is_shown,
    inside = field.inside and message.index[field.inside],
    add = field.scale and adders.float or adders[field.kind],
    unit = is_shown and field.unit and " " .. field.unit,
    title = is_shown and field.element and field.title,
    label = (field.array_title or field.title) .. ": ",
    digits = decode.format_of(field),
    value = field.kind == "float" and decode.float or decode.value,
  }
end

-- The same, nil where nobody wants the field; for flags with those that are wanted of pf, flags,
-- names and undefined.
local function step_of(self, message, index, tree, is_shown)
  local made = self.fields[message.fields[index]]
  local function wanted(pf) return pf and referenced(tree, pf) and pf or nil end
  local pf = wanted(made.pf)
  if not made.flags then
    return (pf or wanted(made.special)) and new_step(message, index, made, is_shown)
  end
  local flags, names, undefined = {}, wanted(made.names), wanted(made.undefined)
  for _, flag in ipairs(made.flags) do flags[#flags + 1] = wanted(flag) end
  if not (pf or names or undefined or flags[1]) then return nil end
  local step = new_step(message, index, made, is_shown)
  step.pf, step.flags, step.names, step.undefined = pf, flags, names, undefined
  return step
end

-- How the tree of a message is built: a list of steps, and own = the message's own ProtoField,
-- where it is wanted,
-- differences = a list of { difference, pf, unit }.
local function make_plan(self, message, tree, is_shown)
  local own = self.messages[message]
  local plan = { title = "Taurus " .. message.title, differences = {} }
  plan.own = referenced(tree, own.pf) and own.pf
  for i = 1, #message.fields do
    plan[#plan + 1] = step_of(self, message, i, tree, is_shown) or nil
  end
  for i, difference in ipairs(message.differences) do
    local pf, unit = own.differences[i], is_shown and difference.unit
    local one = { difference = difference, pf = pf, unit = unit and " " .. unit }
    if referenced(tree, pf) then plan.differences[#plan.differences + 1] = one end
  end
  return plan
end

-- The plan for a tree.  Of one that is shown everything is wanted; of another it is asked once
-- where the answer cannot
-- change, on the first pass of tshark, else each time: without it a filter for one fault takes 1.9
-- times as long.
local function plan_of(self, m, tree)
  local message = m.message
  local plan = m.is_steady and self.steady[message]
  if plan then return plan end
  local is_shown = tree.visible
  plan = is_shown and self.shown[message] or make_plan(self, message, tree, is_shown)
  if is_shown then self.shown[message] = plan end
  if m.is_steady then self.steady[message] = plan end
  return plan
end

-- The tree of a message ---------------------------------------------------------------------------

-- A time has no raw value: whether it is there depends on the payload, and on its case.
local function time_of(field, m)
  local when, payload = field.when, m.payload
  if #payload < field.offset + 8 or when and m.raws[when.index] ~= when.value then return nil end
  return NSTime.new(decode.time(payload, field.offset))
end

-- Builds it; returns it, and the items by index of field, for the expert items.
local function build(self, tree, m)
  local plan, raws, tvb, at, items = plan_of(self, m, tree), m.raws, m.tvb, m.at, {}
  local whole = range_of(tvb, at, math.min(m.message.size, #m.payload))
  local top = add(tree, self.taurus, whole, plan.title)
  if plan.own then set_hidden(add(top, plan.own, whole)) end
  for i = 1, #plan do
    local step = plan[i]
    local field, index = step.field, step.index
    local raw = raws[index]
    if field.kind == "time" then raw = time_of(field, m) end
    if raw then
      local range = range_of(tvb, at + field.offset, field.size)
      local item = step.add(step, items[step.inside] or top, range, raw)
      if step.title then item.text = step.title .. (item.text or ""):sub(#field.array_title + 1) end
      items[index] = item
    end
  end
  for _, one in ipairs(plan.differences) do
    local value = decode.difference(m.message, one.difference, raws)
    if value then set_generated(with_unit(add(top, one.pf, value), one)) end
  end
  return top, items
end

-- What the catalogue says of the flags that are set.
local function append_help(item, field, bits)
  for _, flag in ipairs(field.flags) do
    if flag.help and band(bits, flag.mask) ~= 0 then
      append_text(item, ("; %s: %s"):format(flag.name, flag.help))
    end
  end
end

--- Shows a message, and its expert items.
-- m        of message.reader, as Tree:payload takes it, and label = what the message is called
--          where its title does not
--          tell it, or nil; is_steady = whether what is wanted of a tree cannot change before the
-- next reset
-- returns  the Taurus item; nil without a tree
function Taurus:show(m)
  local top, items
  if m.tvb then top, items = build(self, m.tree, m) end
  for _, remark in ipairs(m.look and decode.remarks(m.message, m.raws) or NONE) do
    local index, name = remark[1], remark[2]
    local place = items and items[index]
    if place and name == "fault.active" then
      if m.label then append_text(place, " of " .. m.label) end
      append_help(place, m.message.fields[index], m.raws[index])
    end
    (place or top or m.item):add_proto_expert_info(self.experts[name])
  end
  return top
end

-- Changes -----------------------------------------------------------------------------------------

-- Adds a generated field where somebody wants it; nil for a value or a field that is not there.
local function add_wanted(item, pf, value, convert)
  if not pf or value == nil or not referenced(item, pf) then return nil end
  return add_generated(item, pf, convert and convert(value) or value)
end

-- Adds what changed; returns the item of the clock's drift.
local function add_values(self, item, m)
  local own, change = self.messages[m.message], m.change
  local since = change.active_since
  add_wanted(item, own.active_time, since and m.time - since, relative_time)
  add_wanted(item, own.previous, change.previous_change)
  add_wanted(item, own.next, change.next_change)
  add_wanted(item, own.command_in, change.command_in)
  return add_wanted(item, own.drift, change.drift, relative_time)
end

-- Adds the bits of a flags field that rose or fell; returns the names of the faults among them,
-- nil for none.
local function add_bits(self, item, one, way, is_tree)
  local field, bits, alarms = one.field, one[way], one["alarm_" .. way]
  if bits == 0 then return nil end
  local added = is_tree and add_wanted(item, self.fields[field][way], bits)
  if added then append_text(added, " (" .. flag_names(field, bits) .. ")") end
  if alarms == 0 then return nil end
  if added and way == "raised" then append_help(added, field, alarms) end
  (added or item):add_proto_expert_info(self.experts["fault." .. way])
  return flag_names(field, alarms)
end

--- Adds what the history says of a message, all of it generated, with its expert items.
-- item     the Taurus item, or YAPP's where no tree is wanted
-- m        a message of message.reader, with its change; the frames in that are frame numbers
-- is_tree  whether it is the Taurus item; else there are expert items only
-- returns  a list of the names of faults that were cleared: { "motor_overcurrent, hall_timeout" }
function Taurus:add_change(item, m, is_tree)
  local change, cleared = m.change, {}
  for _, one in ipairs(change.flags or NONE) do
    add_bits(self, item, one, "raised", is_tree)
    cleared[#cleared + 1] = add_bits(self, item, one, "cleared", is_tree)
  end
  local drift = is_tree and add_values(self, item, m)
  if change.reboot then (drift or item):add_proto_expert_info(self.experts.reboot) end
  if change.stale then (drift or item):add_proto_expert_info(self.experts.stale) end
  return cleared
end

return M
