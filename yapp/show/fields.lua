-- SPDX-License-Identifier: GPL-2.0-or-later
-- The ProtoFields and expert items of the Taurus messages, made from the compiled catalogue.  Wireshark's API.

local M = {}

-- filter, what it says by itself, group, severity
local EXPERTS = {
  { "fault.active", "Fault flags are set", "RESPONSE_CODE", "ERROR" },
  { "fault.raised", "A fault was raised", "RESPONSE_CODE", "ERROR" },
  { "fault.cleared", "A fault was cleared", "RESPONSE_CODE", "NOTE" },
  { "reboot", "The controller's time went back: it was started anew", "SEQUENCE", "WARN" },
  { "stale", "The controller's time stood still", "SEQUENCE", "WARN" },
  { "command.key.invalid", "Key is not valid: the command is ignored", "PROTOCOL", "WARN" },
  { "value.special", "No ordinary number: a reserved count, NaN or infinity", "PROTOCOL", "NOTE" },
  { "flags.undefined", "A bit is set that no table defines", "PROTOCOL", "NOTE" },
  { "value.invalid", "Value that is not defined", "PROTOCOL", "WARN" },
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

-- What a flags field has below it: flags (a list), undefined, and what its changes show.
-- add  function(ProtoField, is_standing) -> the ProtoField; is_standing: see M.make
local function make_flags(field, made, add)
  local bits, kind = field.size * 8, "uint" .. field.size * 8
  made.pf = add(ProtoField[kind](field.filter, field.title, base.HEX))
  made.undefined = add(ProtoField.uint32(field.group .. ".undefined", "Undefined bits", base.HEX))
  made.flags = {}
  for i, flag in ipairs(field.flags) do
    made.flags[i] = add(ProtoField.bool(flag.filter, flag.title, bits, nil, flag.mask))
  end
  if #field.flags == 0 then return end
  made.raised = add(ProtoField[kind](field.group .. ".raised", field.title .. " raised", base.HEX))
  made.cleared = add(ProtoField[kind](field.group .. ".cleared", field.title .. " cleared", base.HEX))
  if not field.alarm then return end
  made.active_time = add(ProtoField.relative_time(field.group .. ".active_time",
    "Time since the oldest of them was raised"), true)
  for _, way in ipairs { "previous", "next" } do
    made[way] = add(ProtoField.framenum(("%s.%s_change"):format(field.group, way),
      ("%s: %s change in"):format(field.title, way), base.NONE), true)
  end
end

local function make_number(field, made, title, build)
  local add = build.add
  if field.kind == "float" or field.kind == "ieee" or field.scale then
    made.pf = add(ProtoField.double(field.filter, title))
    if field.scale then return end
    made.special = add(ProtoField.uint8(field.filter .. ".special", title, base.DEC, build.specials))
  else
    local kind = field.kind .. field.size * 8
    made.pf = add(ProtoField[kind](field.filter, title, field.values and field.kind == "uint" and base.HEX or base.DEC,
      field.values, field.mask))
  end
end

local function make_field(field, build)
  local add, made, title = build.add, {}, field.array_title or field.title
  if field.kind == "time" then
    made.pf = add(ProtoField.relative_time(field.filter, title))
  elseif field.kind == "flags" then
    make_flags(field, made, add)
  elseif field.kind == "bool" or field.kind == "string" or field.kind == "bytes" then
    made.pf = add(ProtoField[field.kind](field.filter, title))
  else
    make_number(field, made, title, build)
  end
  return made
end

-- What belongs to a message as a whole.
local function make_message(message, add)
  local own = { pf = add(ProtoField.none(message.filter, message.title)), differences = {} }
  for i, difference in ipairs(message.differences) do
    own.differences[i] = add(ProtoField.double(difference.filter, difference.title))
  end
  if message.time then
    own.drift = add(ProtoField.relative_time(message.filter .. ".clock_drift", "Clock drift"), true)
  end
  if message.answers then
    local title = message.answers:sub(1, 1):upper() .. message.answers:sub(2)
    own.command_in = add(ProtoField.framenum(("%s.%s_in"):format(message.filter, message.answers),
      ("Latest %s in"):format(title:gsub("_", " ")), base.NONE, frametype.REQUEST), true)
  end
  return own
end

--- Makes the fields and expert items of the messages and hands them to the protocol.
-- taurus     Proto; catalogue: compiled; specials: { [0] = text } of the values that are no numbers
-- returns    { [message] = { pf, differences (list), drift, command_in } },
--            { [field] = { pf, special, flags (list), undefined, raised, cleared, active_time, previous, next } },
--            where the elements of an array share theirs; { [filter without "taurus."] = ProtoExpert }; and a list of
--            the ProtoFields that the history has also for a message that changes nothing
function M.make(taurus, catalogue, specials)
  local list, standing, messages, fields, by_filter = {}, {}, {}, {}, {}
  local function add(pf, is_standing)
    list[#list + 1] = pf
    if is_standing then standing[#standing + 1] = pf end
    return pf
  end
  local build = { add = add, specials = specials }
  for _, message in ipairs(catalogue.messages) do
    messages[message] = make_message(message, add)
    for _, field in ipairs(message.fields) do
      by_filter[field.filter] = by_filter[field.filter] or make_field(field, build)
      fields[field] = by_filter[field.filter]
    end
  end
  taurus.fields = list
  return messages, fields, M.make_experts(taurus, "taurus.", EXPERTS), standing
end

return M
