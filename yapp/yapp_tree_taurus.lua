-- What a user sees of the Taurus messages: the fields of the catalogue, their expert items, the message trees.
-- Wireshark's API; the values come from yapp_decode.

local M = {}

-- filter, what it says by itself, group, severity
local EXPERTS = {
  { "fault.active", "Fault flags are set", "RESPONSE_CODE", "ERROR" },
  { "command.key.invalid", "Key is not valid: the command is ignored", "PROTOCOL", "WARN" },
  { "value.special", "Reserved count of a compressed float", "PROTOCOL", "NOTE" },
  { "flags.undefined", "A bit is set that no table defines", "PROTOCOL", "NOTE" },
  { "value.invalid", "Value that the document does not define", "PROTOCOL", "WARN" },
}

--- Makes the expert items of a protocol.
-- proto   Proto; prefix: of their filters, with the dot
-- rows    { filter, text, name in expert.group, name in expert.severity }
-- returns { [filter without prefix] = ProtoExpert }
function M.make_experts(proto, prefix, rows)
  local experts = {}
  for _, row in ipairs(rows) do
    experts[row[1]] = ProtoExpert.new(prefix .. row[1], row[2], expert.group[row[3]], expert.severity[row[4]])
  end
  proto.experts = experts
  return experts
end

-- The ProtoFields of one catalogue field: pf, and special, flags (by index), undefined.
local function make_field(field, specials, add)
  local bits, made = field.size * 8, {}
  if field.kind == "float" then
    made.pf = add(ProtoField.double(field.filter, field.title))
    made.special = add(ProtoField.uint8(field.filter .. ".special", field.title, base.DEC, specials))
  elseif field.kind == "time" then
    made.pf = add(ProtoField.relative_time(field.filter, field.title))
  elseif field.kind == "flags" then
    made.pf, made.flags = add(ProtoField["uint" .. bits](field.filter, field.title, base.HEX)), {}
    for i, flag in ipairs(field.flags) do
      made.flags[i] = add(ProtoField.bool(flag.filter, flag.title, bits, nil, flag.mask))
    end
    made.undefined = add(ProtoField.uint32(field.undefined_filter, "Undefined bits", base.HEX))
  else
    made.pf = add(ProtoField["uint" .. bits](field.filter, field.title, field.values and base.HEX or base.DEC,
      field.values))
  end
  return made
end

local Taurus = {}
Taurus.__index = Taurus

--- Makes the fields and expert items of the messages and hands them to the protocol.
-- taurus     Proto
-- catalogue  compiled
-- decode     the module yapp_decode
function M.new(taurus, catalogue, decode)
  local self = setmetatable({ taurus = taurus, decode = decode, message_fields = {}, fields = {} }, Taurus)
  local list = {}
  local function add(pf)
    list[#list + 1] = pf
    return pf
  end
  for _, message in ipairs(catalogue.messages) do
    self.message_fields[message] = add(ProtoField.none(message.filter, message.title))
    for _, field in ipairs(message.fields) do self.fields[field] = make_field(field, decode.SPECIALS, add) end
  end
  taurus.fields = list
  self.experts = M.make_experts(taurus, "taurus.", EXPERTS)
  return self
end

local adders = {}

function adders.float(self, parent, range, field, raw)
  local value, special = self.decode.float(field, raw)
  local made = self.fields[field]
  if value then
    local item = parent:add(made.pf, range, self.decode.round(value))
    if field.unit then item:append_text(" " .. field.unit) end
    return item
  end
  local item = parent:add(made.special, range, special)
  item:set_text(string.format("%s: %s (0x%0" .. field.size * 2 .. "x)", field.title,
    self.decode.SPECIALS[special], raw))
  return item
end

function adders.uint(self, parent, range, field)
  local item = parent:add_le(self.fields[field].pf, range)
  if field.unit then item:append_text(" " .. field.unit) end
  return item
end

function adders.flags(self, parent, range, field, raw)
  local made = self.fields[field]
  local item = parent:add_le(made.pf, range)
  if raw ~= 0 then item:append_text(" (" .. self.decode.flag_names(field, raw) .. ")") end
  for _, flag in ipairs(made.flags) do item:add_le(flag, range) end
  local undefined = self.decode.undefined(field, raw)
  if undefined ~= 0 then item:add(made.undefined, range, undefined) end
  return item
end

function adders.time(self, parent, range, field, _, payload)
  return parent:add(self.fields[field].pf, range, NSTime.new(self.decode.time(payload, field.offset)))
end

-- Whether a field is wanted when the tree is built but not shown: it, or one of those below it.
local function field_wanted(tree, made)
  if tree:referenced(made.pf) then return true end
  if made.special then return tree:referenced(made.special) end
  for _, flag in ipairs(made.flags or {}) do
    if tree:referenced(flag) then return true end
  end
  return made.undefined and tree:referenced(made.undefined)
end

-- The tree of a message; returns it, and the items by index of field, for the expert items.
local function build(self, tree, what)
  local message, payload, tvb, at = what.message, what.payload, what.tvb, what.at
  local range = tvb(at, math.min(message.size, #payload))
  local top = tree:add(self.taurus, range)
  top:set_text("Taurus " .. message.title)
  top:add(self.message_fields[message], range):set_hidden()
  local all, items = tree.visible, {}
  for i, field in ipairs(message.fields) do
    if field.offset + field.size > #payload then break end
    if all or field_wanted(tree, self.fields[field]) then
      items[i] = adders[field.kind](self, top, tvb(at + field.offset, field.size), field, what.raws[i], payload)
    end
  end
  return top, items
end

--- Shows a message, and its expert items.
-- tree, item  where the Taurus tree goes, and YAPP's own item, for the expert items of a message without a tree
-- what        { message = compiled, payload = string, may be cut short, raws and look = from decode.read,
--             tvb, at = where the payload lies; tvb nil when nobody wants a tree }
-- returns     the Taurus item; nil without a tree
function Taurus:show(tree, item, what)
  local top, items
  if what.tvb then top, items = build(self, tree, what) end
  local remarks = what.look and self.decode.remarks(what.message, what.raws)
  for _, remark in ipairs(remarks or {}) do
    local target = items and items[remark[1]] or top or item
    target:add_proto_expert_info(self.experts[remark[2]], remark[3])
  end
  return top
end

return M
