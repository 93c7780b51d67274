-- SPDX-License-Identifier: GPL-2.0-or-later
-- What a user sees of the Taurus messages: their trees and expert items.  Wireshark's API; the values come from
-- message.decode, what changed from the history.

local decode = require("yapp.message.decode")
local items_of = require("yapp.show.items")
local source = require("yapp.show.source")
local tree_fields = require("yapp.show.fields")

local M = {}

M.make_experts = tree_fields.make_experts

local format, min = string.format, math.min

local add, append_text, set_generated = items_of.add, items_of.append_text, items_of.set_generated
local relative_time = items_of.relative_time

local Taurus = {}
Taurus.__index = Taurus

--- Makes the fields and expert items of the messages and hands them to the protocol.
-- taurus     Proto
-- catalogue  compiled
function M.new(taurus, catalogue)
  local self = setmetatable({ taurus = taurus, builders = {}, asked = {} }, Taurus)
  self.messages, self.fields, self.experts, self.standing = tree_fields.make(taurus, catalogue, decode.SPECIALS)
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

-- What is wanted ----------------------------------------------------------------------------------------------------

--- To be called before each file: what is wanted of a tree may be other than before.
function Taurus:reset()
  self.asked = {}
  for _, builder in pairs(self.builders) do builder.steady = nil end
end

--- Whether somebody wants of a tree what the history says of every message, not only of one that changes something.
function Taurus:wants_standing(tree)
  for _, pf in ipairs(self.standing) do
    if tree:referenced(pf) then return true end
  end
  return false
end

-- Whether somebody wants a ProtoField.  While the answer cannot change it is kept.
local function is_wanted(self, item, m, pf)
  if m.is_shown then return true end
  if not m.is_steady then return item:referenced(pf) end
  local answer = self.asked[pf]
  if answer == nil then
    answer = item:referenced(pf)
    self.asked[pf] = answer
  end
  return answer
end

-- Builders ----------------------------------------------------------------------------------------------------------

-- A tree is built by a way: { is_shown = whether it is for one that is shown, build = of show.source,
-- elements = indices of an array's, is_named = whether it has the message's own field, differences = list of
-- { difference, ProtoField } }.  There is one for a tree that is shown and, of one that is not, one for all that is
-- wanted of it together.
local MAX_WAYS = 16 -- kept of a message

-- want     { [number] = true } of the ProtoFields that are wanted; nil for a tree that is shown
-- returns  the way, and all ProtoFields by number
local function make_way(self, message, want)
  local others, own = {}, self.messages[message]
  local way = { is_shown = not want, elements = {}, is_named = true, differences = {} }
  for i, field in ipairs(message.fields) do
    local adder = adders[field.kind]
    others[i] = adder and function(parent, range, raw, payload)
      return adder(self, parent, range, field, field.kind == "time" and payload or raw)
    end
    if field.element and not want then way.elements[#way.elements + 1] = i end
  end
  local list
  way.build, list = source.make(message, self.fields, others, items_of, want)
  list[#list + 1] = own.pf
  if want then way.is_named = want[#list] end
  for i, difference in ipairs(message.differences) do
    list[#list + 1] = own.differences[i]
    if not want or want[#list] then way.differences[#way.differences + 1] = { difference, list[#list] } end
  end
  return way, list
end

-- How the tree of a message is built: { shown = way, list = of all its ProtoFields, ways = { [what is wanted] = way },
-- count = of these, steady = the way that stays until the next reset, or nil }.
local function builder_of(self, message)
  local version = decode.divisor()
  if version ~= self.version then self.builders, self.version = {}, version end
  local builder = self.builders[message]
  if not builder then
    builder = { ways = {}, count = 0 }
    builder.shown, builder.list = make_way(self, message)
    self.builders[message] = builder
  end
  return builder
end

-- The way for a tree that is not shown.
local function hidden_way(self, builder, message, tree)
  local want, key = {}, {}
  for number, pf in ipairs(builder.list) do
    if tree:referenced(pf) then want[number], key[#key + 1] = true, number end
  end
  key = table.concat(key, " ")
  local way = builder.ways[key]
  if not way then
    if builder.count == MAX_WAYS then builder.ways, builder.count = {}, 0 end
    way = make_way(self, message, want)
    builder.ways[key], builder.count = way, builder.count + 1
  end
  return way
end

local function way_of(self, message, tree, is_steady)
  local builder = builder_of(self, message)
  local way = is_steady and builder.steady
  if not way then
    way = tree.visible and builder.shown or hidden_way(self, builder, message, tree)
    if is_steady then builder.steady = way end
  end
  return way
end

-- The tree of a message; returns it, and the items by index of field, for the expert items.
local function build(self, tree, what)
  local message, payload, raws, tvb, at = what.message, what.payload, what.raws, what.tvb, what.at
  local way, items = way_of(self, message, tree, what.is_steady), {}
  what.is_shown = way.is_shown
  local range = tvb(at, min(message.size, #payload))
  local top = add(tree, self.taurus, range, "Taurus " .. message.title)
  if way.is_named then items_of.set_hidden(add(top, self.messages[message].pf, range)) end
  way.build(top, tvb, at, raws, payload, items)
  for _, i in ipairs(way.elements) do
    local item, field = items[i], message.fields[i]
    if item then item.text = field.title .. (item.text or ""):sub(#field.array_title + 1) end
  end
  for _, one in ipairs(way.differences) do
    local value = decode.difference(message, one[1], raws)
    if value then set_generated(with_unit(add(top, one[2], value), one[1])) end
  end
  return top, items
end

--- Shows a message, and its expert items.
-- tree, item  where the Taurus tree goes, and YAPP's own item, for the expert items of a message without a tree
-- what        { message = compiled, payload = string, may be cut short, raws and look = from decode.read,
--             tvb, at = where the payload lies; tvb nil when nobody wants a tree,
--             label = what the message is called where its title does not tell it, for a fault's label, or nil,
--             is_steady = whether what is wanted of a tree cannot change before the next reset: on the first pass of
--             tshark; in Wireshark, and on later looks of sharkd, it may }: gets is_shown = whether its tree is
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
local function add_generated(self, item, m, pf, value)
  if not pf or value == nil or not is_wanted(self, item, m, pf) then return nil end
  return items_of.add_generated(item, pf, value)
end

-- The same for a time in seconds.
local function add_time(self, item, m, pf, seconds)
  if not pf or not seconds or not is_wanted(self, item, m, pf) then return nil end
  return items_of.add_generated(item, pf, relative_time(seconds))
end

-- Adds what changed; returns the item of the clock's drift.
local function add_values(self, item, m)
  local message, change = m.message, m.change
  local own, alarm, since = self.messages[message], message.alarms[1], change.active_since
  if alarm then
    local made = self.fields[alarm]
    add_time(self, item, m, made.active_time, since and m.time - since)
    add_generated(self, item, m, made.previous, change.previous_change)
    add_generated(self, item, m, made.next, change.next_change)
  end
  add_generated(self, item, m, own.command_in, change.command_in)
  return add_time(self, item, m, own.drift, change.drift)
end

--- Adds what the history says of a message, all of it generated, with its expert items.
-- item     the Taurus item, or YAPP's where no tree is wanted
-- m        a message of message.reader, with its change; the frames in that are frame numbers
-- is_tree  whether it is the Taurus item; else there are expert items only
function Taurus:add_change(item, m, is_tree)
  local change = m.change
  for _, one in ipairs(change.flags or NONE) do
    local field = one.field
    for _, way in ipairs(WAYS) do
      local bits = one[way]
      local added = bits ~= 0 and is_tree and add_generated(self, item, m, self.fields[field][way], bits)
      if added then append_text(added, " (" .. decode.flag_names(field, bits) .. ")") end
      if one["alarm_" .. way] ~= 0 then (added or item):add_proto_expert_info(self.experts["fault." .. way]) end
    end
  end
  local drift = is_tree and add_values(self, item, m)
  if change.reboot then (drift or item):add_proto_expert_info(self.experts.reboot) end
  if change.stale then (drift or item):add_proto_expert_info(self.experts.stale) end
end

return M
