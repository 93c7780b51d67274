-- SPDX-License-Identifier: GPL-2.0-or-later
-- What a user sees of the Taurus messages: their trees and expert items.  Wireshark's API; the values come from
-- yapp_decode, what changed from the history.

local decode = require("yapp_decode")
local items_of = require("yapp_tree_items")
local source = require("yapp_tree_taurus_source")
local tree_fields = require("yapp_tree_taurus_fields")

local M = {}

M.make_experts = tree_fields.make_experts

local format = string.format

local add, append_text, set_generated = items_of.add, items_of.append_text, items_of.set_generated
local relative_time = items_of.relative_time

local Taurus = {}
Taurus.__index = Taurus

--- Makes the fields and expert items of the messages and hands them to the protocol.
-- taurus     Proto
-- catalogue  compiled
function M.new(taurus, catalogue)
  local self = setmetatable({ taurus = taurus, builders = {} }, Taurus)
  self.messages, self.fields, self.experts = tree_fields.make(taurus, catalogue, decode.SPECIALS)
  return self
end

local function with_unit(item, field)
  if field.unit then append_text(item, " " .. field.unit) end
  return item
end

-- Adds a field that the generated functions leave to others, by kind: (self, parent, range, field, raw).
local adders = {}

-- A number with a fraction, or the special that is there instead.
local function add_real(self, parent, range, field, raw)
  local made = self.fields[field]
  local value, special = decode.value(field, raw)
  if value then return with_unit(add(parent, made.pf, range, decode.rounded(field, value)), field) end
  local item = add(parent, made.special, range, special)
  if field.kind == "float" and raw > 0 then
    item:set_text(format("%s: %s (0x%0" .. field.size * 2 .. "x)", field.title, decode.SPECIALS[special], raw))
  else
    item:set_text(format("%s: %s", field.title, decode.SPECIALS[special]))
  end
  return item
end

adders.float, adders.ieee, adders.uint, adders.int = add_real, add_real, add_real, add_real

function adders.string(self, parent, range, field, raw)
  return add(parent, self.fields[field].pf, range, decode.text(raw))
end

function adders.bytes(self, parent, range, field)
  return add(parent, self.fields[field].pf, range)
end

-- A time has no raw value: it gets the payload.
function adders.time(self, parent, range, field, payload)
  return add(parent, self.fields[field].pf, range, NSTime.new(decode.time(payload, field.offset)))
end

-- Builders ----------------------------------------------------------------------------------------------------------

-- How the tree of a message is built: { build, list (of yapp_tree_taurus_source), elements (indices), wanted }.
local function make_builder(self, message)
  local others, elements = {}, {}
  for i, field in ipairs(message.fields) do
    local adder = adders[field.kind]
    others[i] = adder and function(parent, range, raw, payload)
      return adder(self, parent, range, field, field.kind == "time" and payload or raw)
    end
    if field.element then elements[#elements + 1] = i end
  end
  local build, list = source.make(message, self.fields, others, items_of)
  return { build = build, list = list, elements = elements, wanted = nil }
end

local function builder_of(self, message)
  local _, version = decode.divisor()
  if version ~= self.version then self.builders, self.version = {}, version end
  local builder = self.builders[message]
  if not builder then
    builder = make_builder(self, message)
    self.builders[message] = builder
  end
  return builder
end

--- To be called before each file: what is wanted of a tree may be other than before.
function Taurus:reset()
  for _, builder in pairs(self.builders) do builder.wanted = nil end
end

-- Which of the ProtoFields somebody wants of a tree that is not shown.  Asking is a call for each; while what is wanted
-- cannot change the answers are kept.
local function wanted(builder, tree, is_steady)
  if builder.wanted and is_steady then return builder.wanted end
  local list, want = builder.list, { flags = {} }
  for number, pf in ipairs(list) do want[number] = tree:referenced(pf) or nil end
  for i, numbers in pairs(list.flags) do
    local few = (want[numbers.first] or want[numbers.last]) and {} or nil
    for number = numbers.first + 1, numbers.last - 1 do
      if want[number] then
        few = few or {}
        few[#few + 1] = list[number]
      end
    end
    want.flags[i] = few
  end
  builder.wanted = want
  return want
end

local function add_differences(self, top, message, raws)
  local all, items = top.visible, self.messages[message].differences
  for i, difference in ipairs(message.differences) do
    if all or top:referenced(items[i]) then
      local value = decode.difference(message, difference, raws)
      if value then set_generated(with_unit(add(top, items[i], value), difference)) end
    end
  end
end

-- The tree of a message; returns it, and the items by index of field, for the expert items.
local function build(self, tree, what)
  local message, payload, raws, tvb, at = what.message, what.payload, what.raws, what.tvb, what.at
  local range = tvb(at, math.min(message.size, #payload))
  local top = add(tree, self.taurus, range, "Taurus " .. message.title)
  items_of.set_hidden(add(top, self.messages[message].pf, range))
  local builder, items = builder_of(self, message), {}
  local want = not tree.visible and wanted(builder, tree, what.is_steady) or nil
  builder.build(top, tvb, at, raws, payload, items, want)
  for _, i in ipairs(builder.elements) do
    local item, field = items[i], message.fields[i]
    if item then item.text = field.title .. (item.text or ""):sub(#field.array_title + 1) end
  end
  if message.differences[1] then add_differences(self, top, message, raws) end
  return top, items
end

--- Shows a message, and its expert items.
-- tree, item  where the Taurus tree goes, and YAPP's own item, for the expert items of a message without a tree
-- what        { message = compiled, payload = string, may be cut short, raws and look = from decode.read,
--             tvb, at = where the payload lies; tvb nil when nobody wants a tree,
--             label = what the message is called where its title does not tell it, for a fault's label, or nil,
--             is_steady = whether what is wanted of a tree cannot change before the next reset: on the first pass of
--             tshark; in Wireshark, and on later looks of sharkd, it may }
-- returns     the Taurus item; nil without a tree
function Taurus:show(tree, item, what)
  local top, items
  if what.tvb then top, items = build(self, tree, what) end
  local remarks = what.look and decode.remarks(what.message, what.raws)
  if not remarks then return top end
  for _, remark in ipairs(remarks) do
    local place, name = items and items[remark[1]], remark[2]
    if place and name == "fault.active" and what.label then place:append_text(" of " .. what.label) end
    (place or top or item):add_proto_expert_info(self.experts[name])
  end
  return top
end

-- Changes -----------------------------------------------------------------------------------------------------------

local NONE, WAYS = {}, { "raised", "cleared" }

-- Adds a generated field where somebody wants it; nil for a value or a field that is not there.
-- all  whether the tree is shown; else it is asked who wants the field
local function add_generated(item, all, pf, value)
  if not pf or value == nil or not (all or item:referenced(pf)) then return nil end
  return items_of.add_generated(item, pf, value)
end

-- The same for a time in seconds.
local function add_time(item, all, pf, seconds)
  if not pf or not seconds or not (all or item:referenced(pf)) then return nil end
  return items_of.add_generated(item, pf, relative_time(seconds))
end

-- Adds what changed; returns the item of the clock's drift.
local function add_values(self, item, all, m)
  local message, change = m.message, m.change
  local own, alarm, since = self.messages[message], message.alarms[1], change.active_since
  if alarm then
    local made = self.fields[alarm]
    add_time(item, all, made.active_time, since and m.time - since)
    add_generated(item, all, made.previous, change.previous_change)
    add_generated(item, all, made.next, change.next_change)
  end
  add_generated(item, all, own.command_in, change.command_in)
  return add_time(item, all, own.drift, change.drift)
end

--- Adds what the history says of a message, all of it generated, with its expert items.
-- item     the Taurus item, or YAPP's where no tree is wanted
-- m        a message of yapp_reader, with its change; the frames in that are frame numbers
-- is_tree  whether it is the Taurus item; else there are expert items only
function Taurus:add_change(item, m, is_tree)
  local change, all = m.change, is_tree and item.visible
  for _, one in ipairs(change.flags or NONE) do
    local field = one.field
    for _, way in ipairs(WAYS) do
      local bits = decode.band(one[way], field.watched)
      local added = bits ~= 0 and is_tree and add_generated(item, all, self.fields[field][way], bits)
      if added then append_text(added, " (" .. decode.flag_names(field, bits) .. ")") end
      if bits ~= 0 and field.alarm then (added or item):add_proto_expert_info(self.experts["fault." .. way]) end
    end
  end
  local drift = is_tree and add_values(self, item, all, m)
  if change.reboot then (drift or item):add_proto_expert_info(self.experts.reboot) end
  if change.stale then (drift or item):add_proto_expert_info(self.experts.stale) end
end

return M
