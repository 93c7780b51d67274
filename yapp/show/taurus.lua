-- SPDX-License-Identifier: GPL-2.0-or-later
-- What a user sees of the Taurus messages: their trees and expert items.  Wireshark's API; the values come from
-- message.decode, what changed from the history.

local decode = require("yapp.message.decode")
local fields = require("yapp.show.fields")
local items_of = require("yapp.show.items")

local M = {}

local add, add_le, add_generated = items_of.add, items_of.add_le, items_of.add_generated
local append_text, set_hidden = items_of.append_text, items_of.set_hidden
local relative_time, referenced, range_of = items_of.relative_time, items_of.referenced, items_of.range
local format, band, flag_names = string.format, decode.band, decode.flag_names

local NONE = {}

local Taurus = {}
Taurus.__index = Taurus

--- Makes the fields and expert items of the messages and hands them to the protocol.
-- taurus     Proto
-- catalogue  compiled
function M.new(taurus, catalogue)
  local self = setmetatable({ taurus = taurus, rows = {}, steady = {} }, Taurus)
  self.messages, self.fields, self.experts, self.standing = fields.of_taurus(taurus, catalogue)
  return self
end

--- To be called before each file: what is wanted of a tree may be other than before.
function Taurus:reset()
  self.steady = {}
end

-- What is added for a ProtoField, by kind: (row, parent, range, raw, m) -> item or nil; row: see rows_of.
local adders = {}

local function with_unit(item, field, m)
  if field.unit and m.is_shown then append_text(item, " " .. field.unit) end
  return item
end

-- What Wireshark reads itself.
function adders.uint(row, parent, range, _, m)
  return with_unit(add_le(parent, row.pf, range), row.field, m)
end

adders.int, adders.bool, adders.bytes = adders.uint, adders.uint, adders.uint

function adders.flag(row, parent, range)
  add_le(parent, row.pf, range)
end

-- A number with a fraction; nil where a special is there instead.
function adders.float(row, parent, range, raw, m)
  local field, value = row.field, row.value(row.field, raw)
  if not value then return nil end
  if not row.digits then return with_unit(add(parent, row.pf, range, decode.rounded(field, value)), field, m) end
  local digits = format(row.digits, value)
  if not m.is_shown then return add(parent, row.pf, range, tonumber(digits)) end
  return add(parent, row.pf, range, tonumber(digits), row.label .. digits .. row.unit)
end

adders.ieee = adders.float

function adders.special(row, parent, range, raw)
  local field, _, special = row.field, row.value(row.field, raw)
  if not special then return nil end
  local text = row.label .. decode.SPECIALS[special]
  if field.kind == "float" and raw > 0 then text = format("%s (0x%0" .. field.size * 2 .. "x)", text, raw) end
  return items_of.set_text(add(parent, row.pf, range, special), text)
end

function adders.string(row, parent, range, raw)
  return add(parent, row.pf, range, decode.text(raw))
end

-- A time has no raw value: whether it is there depends on the payload, and on its case.
function adders.time(row, parent, range, _, m)
  local field, when, payload = row.field, row.field.when, m.payload
  if when and m.raws[when.index] ~= when.value then return nil end
  return add(parent, row.pf, range, NSTime.new(decode.time(payload, field.offset)))
end

function adders.flags(row, parent, range, raw, m)
  local item = add_le(parent, row.pf, range)
  local names = m.is_shown and raw ~= 0 and flag_names(row.field, raw) or ""
  if names ~= "" then append_text(item, " (" .. names .. ")") end
  return item
end

function adders.undefined(row, parent, range, raw)
  local bits = raw ~= 0 and decode.undefined(row.field, raw) or 0
  if bits ~= 0 then add(parent, row.pf, range, bits) end
end

-- For columns, which show no labels.
function adders.names(row, parent, _, raw)
  if raw ~= 0 then set_hidden(add_generated(parent, row.pf, flag_names(row.field, raw))) end
end

function adders.difference(row, parent, _, _, m)
  local value = decode.difference(m.message, row.field, m.raws)
  if value then with_unit(add_generated(parent, row.pf, value), row.field, m) end
end

-- What is wanted ----------------------------------------------------------------------------------------------------

--- Whether somebody wants of a tree what the history says of every message, not only of one that changes something.
function Taurus:wants_standing(tree)
  for _, pf in ipairs(self.standing) do
    if referenced(tree, pf) then return true end
  end
  return false
end

-- All that a message's tree may have, in its order: a list of { pf, field, index = of the field, inside = index of that
-- whose item it stands below, add = of adders, ... }.
local function rows_of(self, message)
  local rows, index = {}, message.index
  for i, field in ipairs(message.fields) do
    for place, made in ipairs(self.fields[field]) do
      local is_below = field.kind == "flags" and place > 1
      rows[#rows + 1] = { pf = made[2], add = adders[made[1]], field = field, index = i,
        inside = is_below and i or index[field.inside or false], is_time = field.kind == "time",
        label = (field.array_title or field.title) .. ": ", unit = field.unit and " " .. field.unit or "",
        digits = decode.format_of(field), value = field.kind == "float" and decode.float or decode.value }
    end
  end
  for i, difference in ipairs(message.differences) do
    rows[#rows + 1] = { pf = self.messages[message].differences[i], add = adders.difference, field = difference,
      index = difference.a }
  end
  return rows
end

-- Those of a message's rows that are wanted of a tree.  Of one that is shown that is all; of another it is asked once
-- where the answer cannot change, on the first pass of tshark, else each time: without it a filter for one fault takes
-- 1.9 times as long.
local function wanted_rows(self, m, tree)
  local message = m.message
  local rows = self.rows[message] or rows_of(self, message)
  self.rows[message] = rows
  if m.is_shown then return rows end
  local wanted = m.is_steady and self.steady[message]
  if wanted then return wanted end
  wanted = {}
  for i = 1, #rows do
    if referenced(tree, rows[i].pf) then wanted[#wanted + 1] = rows[i] end
  end
  if m.is_steady then self.steady[message] = wanted end
  return wanted
end

-- The tree of a message ---------------------------------------------------------------------------------------------

-- Builds it; returns it, and the items by index of field, for the expert items.
local function build(self, tree, m)
  local message, raws, tvb, at, items, range, latest = m.message, m.raws, m.tvb, m.at, {}, nil, nil
  m.is_shown = tree.visible
  local whole = range_of(tvb, at, math.min(message.size, #m.payload))
  local top = add(tree, self.taurus, whole, "Taurus " .. message.title)
  set_hidden(add(top, self.messages[message].pf, whole))
  local rows = wanted_rows(self, m, tree)
  for i = 1, #rows do
    local row = rows[i]
    local field, index = row.field, row.index
    local raw = raws[index]
    if raw or row.is_time and #m.payload >= field.offset + field.size then
      if index ~= latest and field.offset then range, latest = range_of(tvb, at + field.offset, field.size), index end
      local item = row.add(row, items[row.inside] or top, range, raw, m)
      if item and field.element and m.is_shown then
        item.text = field.title .. (item.text or ""):sub(#field.array_title + 1)
      end
      items[index] = items[index] or item
    end
  end
  return top, items
end

-- What the catalogue says of the flags that are set.
local function append_help(item, field, bits)
  for _, flag in ipairs(field.flags) do
    if flag.help and band(bits, flag.mask) ~= 0 then append_text(item, ("; %s: %s"):format(flag.name, flag.help)) end
  end
end

--- Shows a message, and its expert items.
-- m        of message.reader, as Tree:payload takes it, and label = what the message is called where its title does not
--          tell it, or nil; is_steady = whether what is wanted of a tree cannot change before the next reset
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

-- Changes -----------------------------------------------------------------------------------------------------------

-- The bits of a change that rose or fell, and those of them that are faults.
local function bits_of(one, way)
  local alarms = one["alarm_" .. way]
  if alarms then return one[way], alarms end
  local bits = band(one[way], one.field.watched) -- of a history that tells no alarms
  return bits, one.field.alarm and bits or 0
end

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

-- Adds the bits of a flags field that rose or fell; returns the names of the faults among them, nil for none.
local function add_bits(self, item, one, way, is_tree)
  local field, bits, alarms = one.field, bits_of(one, way)
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
