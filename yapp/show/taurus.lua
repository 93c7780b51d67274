-- SPDX-License-Identifier: GPL-2.0-or-later
-- What a user sees of the Taurus messages: their trees and expert items.  Wireshark's API; the
-- values come from message.decode, what changed from the history.

local decode = require("yapp.message.decode")
local fields = require("yapp.show.fields")

local M = {}

local add = fields.add
local add_le = fields.add_le
local add_generated = fields.add_generated
local append_text = fields.append_text
local relative_time = fields.relative_time
local set_hidden = TreeItem.set_hidden
local set_text = TreeItem.set_text
local referenced = TreeItem.referenced
local range_of = Tvb.range
local format = string.format
local common = require("yapp.base.bits").common
local flag_names = decode.flag_names

local IS_TSHARK = not gui_enabled()
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

-- Adding a field ----------------------------------------------------------------------------------

-- How a field is added to a tree, by kind: a function(parent, range, raw) -> item.
-- made      its ProtoFields
-- unit      what stands behind the value, "" for nothing
-- is_shown  whether somebody reads the tree
local adders = {}

-- What Wireshark reads itself.
function adders.uint(_, made, unit)
  local pf = made.pf
  return function(parent, range)
    local item = add_le(parent, pf, range)
    if unit ~= "" then append_text(item, unit) end
    return item
  end
end

adders.int, adders.bool, adders.bytes = adders.uint, adders.uint, adders.uint

-- What a special is called; a reserved count with its bytes.
local function special_text(field, raw, special)
  local text = decode.SPECIALS[special]
  if field.kind == "ieee" or raw < 0 then return text end
  return format("%s (0x%0" .. field.size * 2 .. "x)", text, raw)
end

-- A number with a fraction, or the special that is there instead.
function adders.float(field, made, unit, is_shown)
  local pf, digits = made.pf, decode.format_of(field)
  local value_of = field.kind == "float" and decode.float or decode.value
  local label = (field.array_title or field.title) .. ": "
  return function(parent, range, raw)
    local value, special = value_of(field, raw)
    if special then
      local item = add(parent, made.special, range, special)
      return set_text(item, label .. special_text(field, raw, special))
    end
    if not digits then
      return append_text(add(parent, pf, range, decode.rounded(field, value)), unit)
    end
    local text = format(digits, value)
    if not is_shown then return add(parent, pf, range, tonumber(text)) end
    return add(parent, pf, range, tonumber(text), label .. text .. unit)
  end
end

adders.ieee = adders.float

function adders.string(_, made)
  return function(parent, range, raw)
    return add(parent, made.pf, range, decode.text(raw))
  end
end

function adders.time(_, made)
  return function(parent, range, raw)
    return add(parent, made.pf, range, NSTime.new(decode.time(raw, 0)))
  end
end

local function add_names(item, pf, is_shown, names)
  if names == "" then return end
  if is_shown then append_text(item, " (" .. names .. ")") end
  if pf then set_hidden(add_generated(item, pf, names)) end
end

-- Flags with what is wanted of them: wanted(pf) -> the ProtoField, or nil.
local function add_flags(field, made, is_shown, wanted)
  local pf, names_pf, undefined_pf = wanted(made.pf), wanted(made.names), wanted(made.undefined)
  local flags = {}
  for _, flag in ipairs(made.flags) do flags[#flags + 1] = wanted(flag) end
  if not (pf or names_pf or undefined_pf or flags[1]) then return nil end
  return function(parent, range, raw)
    local item = pf and add_le(parent, pf, range) or parent
    for i = 1, #flags do add_le(item, flags[i], range) end
    local undefined = undefined_pf and decode.undefined(field, raw) or 0
    if undefined ~= 0 then add(item, undefined_pf, range, undefined) end
    if raw ~= 0 then add_names(item, names_pf, is_shown, flag_names(field, raw)) end
    return item
  end
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

-- How a field is added, nil where nobody wants it.
local function adder_of(self, field, tree, is_shown)
  local made = self.fields[field]
  local function wanted(pf) return pf and referenced(tree, pf) and pf or nil end
  if made.flags then return add_flags(field, made, is_shown, wanted) end
  if not (wanted(made.pf) or wanted(made.special)) then return nil end
  local make = field.scale and adders.float or adders[field.kind]
  return make(field, made, is_shown and field.unit and " " .. field.unit or "", is_shown)
end

-- How the tree of a message is built: a list of { field, index, inside = index of the field that it
-- is a part of, add, title = of an array's element }, and own = the message's own ProtoField, where
-- it is wanted, generated = a list of { item, pf, unit }.
local function make_plan(self, message, tree, is_shown)
  local own, plan = self.messages[message], { title = "Taurus " .. message.title }
  plan.own = referenced(tree, own.pf) and own.pf
  for index, field in ipairs(message.fields) do
    local adder = adder_of(self, field, tree, is_shown)
    plan[#plan + 1] = adder and {
      field = field,
      index = index,
      inside = message.index[field.inside or false],
      add = adder,
      title = is_shown and field.element and field.title,
    }
  end
  plan.generated = {}
  for i, item in ipairs(message.generated) do
    local pf = own.generated[i]
    local unit = is_shown and item.unit and " " .. item.unit or ""
    if referenced(tree, pf) then
      plan.generated[#plan.generated + 1] = { item = item, pf = pf, unit = unit }
    end
  end
  return plan
end

-- The plan for a tree.  Of one that is shown everything is wanted; of another it is asked once
-- where the answer cannot change, on the first pass of tshark, else each time: without it a filter
-- for one fault takes 1.9 times as long.
local function plan_of(self, m, tree)
  local is_shown = tree.visible
  local plans = is_shown and self.shown or IS_TSHARK and not m.visited and self.steady or {}
  local plan = plans[m.message] or make_plan(self, m.message, tree, is_shown)
  plans[m.message] = plan
  return plan
end

-- The tree of a message ---------------------------------------------------------------------------

-- Builds it; returns it, and the items by index of field, for the expert items.
local function build(self, m)
  local plan, raws, tvb, at, items = plan_of(self, m, m.tree), m.raws, m.tvb, m.at, {}
  local whole = range_of(tvb, at, math.min(m.message.size, #m.payload))
  local top = add(m.tree, self.taurus, whole, plan.title)
  if plan.own then set_hidden(add(top, plan.own, whole)) end
  for i = 1, #plan do
    local step = plan[i]
    local field, index = step.field, step.index
    local raw = raws[index]
    if raw then
      local range = range_of(tvb, at + field.offset, field.size)
      local item = step.add(items[step.inside] or top, range, raw)
      if step.title then item.text = step.title .. (item.text or ""):sub(#field.array_title + 1) end
      items[index] = item
    end
  end
  for _, step in ipairs(plan.generated) do
    local value = decode.derived(m.message, step.item, raws)
    if value then append_text(add_generated(top, step.pf, value), step.unit) end
  end
  return top, items
end

-- What the catalogue says of the flags that are set.
local function append_help(item, field, bits)
  for _, flag in ipairs(field.flags) do
    if flag.help and common(bits, flag.mask) ~= 0 then
      append_text(item, ("; %s: %s"):format(flag.name, flag.help))
    end
  end
end

--- Shows a message, and its expert items.
-- m        of message.reader, as Tree:payload takes it
-- returns  the Taurus item; nil without a tree
function Taurus:show(m)
  local top, items = nil, NONE
  if m.tvb and m.payload ~= "" then top, items = build(self, m) end
  for _, remark in ipairs(m.look and decode.remarks(m.message, m.raws) or NONE) do
    local index, name = remark[1], remark[2]
    local place = items[index]
    if place and name == "fault.active" then
      if m.name ~= m.message.title then append_text(place, " of " .. m.name) end
      append_help(place, m.message.fields[index], m.raws[index])
    end
    (place or top or m.item):add_proto_expert_info(self.experts["taurus." .. name])
  end
  return top
end

-- Changes -----------------------------------------------------------------------------------------

-- Adds a generated field where somebody wants it; nil or false for a value or a field that is not
-- there.
local function add_wanted(item, pf, value)
  return pf and value and referenced(item, pf) and add_generated(item, pf, value)
end

-- Adds how things stand.
local function add_standing(self, item, m)
  local own, standing = self.messages[m.message], m.standing
  local since, drift = standing.active_since, standing.drift
  add_wanted(item, own.active_time, since and relative_time(m.time - since))
  add_wanted(item, own.previous, standing.previous_change)
  add_wanted(item, own.next, standing.next_change)
  add_wanted(item, own.command_in, standing.command_in)
  add_wanted(item, own.drift, drift and relative_time(drift))
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
  (added or item):add_proto_expert_info(self.experts["taurus.fault." .. way])
  return flag_names(field, alarms)
end

-- What a user sees of a change: its name, the expert item, its label with the change's number, and
-- the word in the Info column.
local CHANGES = {
  { "late", "yapp.late", "Silent for %.3f s" },
  { "shared", "yapp.source.shared" },
  { "reboot", "taurus.reboot", "Controller rebooted (its clock went back by %.1f s)", "  REBOOT" },
  { "stale", "taurus.stale", nil, "  STALE" },
  { "jump", "taurus.jump", "Controller's clock jumped ahead by %.1f s", "  JUMP" },
}

--- Adds what the history says of a message, all of it generated, with its expert items.
-- m        a message of message.reader
-- top      the Taurus item; nil or false where nobody wants a tree: then there are expert items
--          only
-- experts  of YAPP
-- returns  what the Info column says of it: "  cleared motor_overcurrent, hall_timeout  REBOOT"
function Taurus:add_change(m, top, experts)
  local change, cleared, item, info = m.change or NONE, {}, top or m.item, ""
  for _, one in ipairs(change.flags or NONE) do
    add_bits(self, item, one, "raised", top)
    cleared[#cleared + 1] = add_bits(self, item, one, "cleared", top)
  end
  if top and m.standing then add_standing(self, item, m) end
  if cleared[1] then info = "  cleared " .. table.concat(cleared, ", ") end
  for _, row in ipairs(CHANGES) do
    local value, name, label, word = change[row[1]], row[2], row[3], row[4]
    if value then
      label = label and type(value) == "number" and label:format(value) or nil
      fields.add_expert(item, self.experts[name] or experts[name], label)
      info = info .. (word or "")
    end
  end
  return info
end

return M
