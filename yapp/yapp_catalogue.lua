-- The catalogue compiler: checks taurus_fields.lua once, at load, and works out what decoding needs.
-- Pure Lua, 5.2 and 5.4.

local M = {}

M.MAX_ID = 2047
local MAX_SIZE = 65535
local MAX_ROWS = 1024
local MAX_ITEMS = 50000 -- fields, values and flags of all messages; each costs Wireshark time and memory
local MAX_PROBLEMS = 20

-- width in bytes, the highest value, what kind of value
local TYPES = {
  uint8 = { 1, 0xFF, "uint" }, uint16 = { 2, 0xFFFF, "uint" }, uint32 = { 4, 0xFFFFFFFF, "uint" },
  int64_ns = { 8, nil, "time" },
  float8 = { 1, 0xFF, "float" }, float16 = { 2, 0xFFFF, "float" },
}

-- The expert items for a value that is not one of those listed.
local INVALID = { ["value.invalid"] = true, ["command.key.invalid"] = true }
-- The filter names of expert items.
local EXPERTS = {
  ["taurus.fault.active"] = true, ["taurus.command.key.invalid"] = true, ["taurus.value.special"] = true,
  ["taurus.value.invalid"] = true, ["taurus.flags.undefined"] = true,
}

local function is_integer(v) return type(v) == "number" and v % 1 == 0 end
local function is_name(v) return type(v) == "string" and #v <= 64 and v:find("^[a-z][a-z0-9_]*$") ~= nil end

-- Whether it is UTF-8 of at most so many bytes, without control characters: over some other texts Wireshark ends at
-- once.
-- (Wireshark also runs each file of a plugin folder by itself, when nothing can be required yet.)
local function is_utf8(v, most)
  if type(v) ~= "string" or #v > most or v:find("%c") then return false end
  return not require("yapp_utf8").ascii(v):find("[\128-\255]")
end

local function is_text(v) return is_utf8(v, 200) and #v > 0 end

-- Says what is wrong and where; a catalogue with a thousand errors gets the first ones.
local function complainer(where, problems)
  return function(format, ...)
    if #problems < MAX_PROBLEMS then
      problems[#problems + 1] = where .. ": " .. string.format(format, ...)
    end
  end
end

local function shown(v)
  return type(v) == "string" and string.format("%q", v:sub(1, 40)) or tostring(v)
end

local function check_values(row, top, complain)
  if type(row.values) ~= "table" then return complain("values must be a table, not %s", shown(row.values)) end
  local count = 0
  for value, meaning in pairs(row.values) do
    count = count + 1
    if count > MAX_ROWS then return complain("more than %d values", MAX_ROWS) end
    if not is_integer(value) or value < 0 or value > top then
      complain("value %s does not fit the type %s", shown(value), row[2])
    elseif not is_text(meaning) then
      complain("value %s has no meaning in words", shown(value))
    end
  end
end

-- The flags of a field, with their filter names; and the mask of the bits that nobody defines.
local function compile_flags(row, top, prefix, complain)
  local flags, defined, names = {}, 0, {}
  if type(row.flags) ~= "table" then
    complain("flags must be a list, not %s", shown(row.flags))
    return flags, top
  end
  if not is_name(row.group) then complain("flags need a group, a name for their filters") end
  if #row.flags > 32 then complain("more flags than bits") end
  for i = 1, math.min(#row.flags, 32) do
    local flag = row.flags[i]
    local name, mask, title = nil, nil, nil
    if type(flag) == "table" then name, mask, title = flag[1], flag[2], flag[3] end
    if not is_name(name) then
      complain("flag %d: %s is not a filter name (a-z, 0-9, _)", i, shown(name))
    elseif not is_integer(mask) or mask < 1 or mask > top then
      complain("flag %s: mask %s does not fit the type %s", name, shown(mask), row[2])
    elseif not is_text(title) then
      complain("flag %s has no title", name)
    elseif names[name] or name == "undefined" then
      complain("flag %s: the name is taken", name)
    else
      names[name] = true
      for bit = 0, 31 do
        local place = 2 ^ bit
        if mask % (2 * place) >= place then
          if defined % (2 * place) >= place then
            complain("flag %s: bit 0x%X is already another flag's", name, place - place % 1)
          else
            defined = defined + place
          end
        end
      end
      flags[#flags + 1] = { name = name, mask = mask, title = title,
        filter = prefix .. "." .. tostring(row.group) .. "." .. name }
    end
  end
  return flags, top - defined
end

local function compile_row(row, prefix, offset, complain)
  local name, kind, title = row[1], row[2], row[3]
  if not is_name(name) then return complain("%s is not a filter name (a-z, 0-9, _)", shown(name)) end
  local def = TYPES[kind]
  if not def then return complain("unknown type %s", shown(kind)) end
  if not is_text(title) then return complain("the title is missing") end
  local field = {
    name = name, title = title, type = kind, kind = def[3], filter = prefix .. "." .. name,
    offset = offset, size = def[1], top = def[2], unit = row.unit, values = row.values or nil, alarm = row.alarm,
    invalid = row.invalid or row.values and "value.invalid" or nil,
  }
  if row.invalid ~= nil and not (INVALID[row.invalid] and row.values) then
    complain("invalid is value.invalid or command.key.invalid, for a field with values")
  end
  if row.unit ~= nil and not is_text(row.unit) then complain("unit must be a text") end
  if row.alarm ~= nil and not (is_text(row.alarm) and row.flags) then
    complain("alarm is a word, for a field with flags")
  end
  if field.kind == "float" then
    local ordered = type(row.min) == "number" and type(row.max) == "number" and row.min < row.max
    if not ordered or row.min == -math.huge or row.max == math.huge then
      complain("%s needs min and max, min below max", kind)
    else
      field.min, field.max, field.ordinary = row.min, row.max, field.top - 5
    end
  end
  if (row.values or row.flags) and field.kind ~= "uint" then
    complain("values and flags are for unsigned integers, not for %s", kind)
  elseif row.values and row.flags then
    complain("a field has values or flags, not both")
  elseif row.values then
    check_values(row, field.top, complain)
  elseif row.flags then
    field.kind, field.ordinary = "flags", row.alarm and 0 or nil
    field.flags, field.undefined = compile_flags(row, field.top, prefix, complain)
    field.undefined_filter = prefix .. "." .. tostring(row.group) .. ".undefined"
  end
  return field
end

-- "{name:%.1f} V" -> parts { { field = f, index = i, format = "%.1f" }, " V" }; and the same as one format with
-- the fields it takes, for the usual message that has nothing special to show.
local function compile_info(text, message, complain)
  local parts, fields, formats, at = {}, {}, { "  " }, 1
  if not is_utf8(text, 1000) then
    complain("info must be a text, not %s", shown(text))
    text = ""
  end
  while true do
    local from, to, name, format = text:find("{([%w_]+):?([^}]*)}", at)
    local literal = text:sub(at, (from or 0) - 1)
    if literal ~= "" then
      parts[#parts + 1] = literal
      formats[#formats + 1] = literal:gsub("%%", "%%%%")
    end
    if not from then break end
    local field = message.by_name[name]
    if not field then
      complain("info names a field %s that is not there", shown(name))
    elseif format ~= "" and not (field.kind == "float" and format:find("^%%%.?%d?[fg]$")) then
      complain("info: the format %s is not one for %s", shown(format), name)
    else
      local part = { field = field, index = message.index[field], format = format ~= "" and format or "%.4g" }
      parts[#parts + 1], fields[#fields + 1] = part, part
      formats[#formats + 1] = field.kind == "float" and part.format or "%s"
    end
    at = to + 1
  end
  message.info, message.info_fields, message.info_format = parts, fields, table.concat(formats)
end

local function compile_message(entry, where, problems)
  local complain = complainer(where, problems)
  local message = { name = entry.name, title = entry.title, id = entry.id, size = entry.size,
    filter = "taurus." .. entry.name, fields = {}, by_name = {}, index = {}, alarms = {}, raws = {} }
  if not is_text(entry.title) then complain("the title is missing") end
  if not is_integer(entry.id) or entry.id < 0 or entry.id > M.MAX_ID then
    complain("id %s is not one of 0 .. %d", shown(entry.id), M.MAX_ID)
  end
  if #entry == 0 then complain("it has no fields") end
  if #entry > MAX_ROWS then complain("more than %d fields", MAX_ROWS) end
  local offset, filters = 0, { [message.filter] = true }
  for i = 1, math.min(#entry, MAX_ROWS) do
    local row = entry[i]
    local at = where .. ", field " .. (type(row) == "table" and is_name(row[1]) and row[1] or tostring(i))
    local complain_of_row = complainer(at, problems)
    local field
    if type(row) == "table" then
      field = compile_row(row, message.filter, offset, complain_of_row)
    else
      complain_of_row("a field is a row { name, type, title }, not %s", shown(row))
    end
    if field then
      if message.by_name[field.name] then complain_of_row("the name is there twice") end
      message.fields[#message.fields + 1] = field
      message.by_name[field.name], message.index[field] = field, #message.fields
      if field.kind == "time" then message.time = message.time or field end
      if field.alarm then message.alarms[#message.alarms + 1] = field end
      offset = offset + field.size
      local new = { field.filter, field.kind == "float" and field.filter .. ".special", field.undefined_filter }
      for _, flag in ipairs(field.flags or {}) do new[#new + 1] = flag.filter end
      for j = 1, #new + 1 do
        local filter = new[j]
        if filter and (EXPERTS[filter] or filters[filter] and filter ~= field.filter) then
          complain_of_row("the filter name %s is taken", filter)
        end
        if filter then filters[filter] = true end
      end
    end
  end
  if not is_integer(entry.size) or entry.size < 1 or entry.size > MAX_SIZE then
    complain("size %s is not one of 1 .. %d", shown(entry.size), MAX_SIZE)
  elseif offset ~= entry.size then
    complain("size is %d, but the fields add up to %d bytes", entry.size, offset)
  end
  if is_text(message.title) then compile_info(entry.info or "", message, complain) end
  return message
end

-- Compiles a message into the catalogue; found gets what is wrong with it, and then it stays out.
local function add_message(catalogue, entry, names, found)
  local where = "message " .. entry.name
  local complain = complainer(where, found)
  local message = compile_message(entry, where, found)
  if names[entry.name] then complain("the name is there twice") end
  local other = catalogue.by_id[message.id]
  if other then complain("id 0x%X is that of message %s", message.id, other.name) end
  names[entry.name] = true
  if #found > 0 then return end
  catalogue.messages[#catalogue.messages + 1] = message
  catalogue.by_id[message.id] = message
end

-- The number of fields, values and flags of a message; counts no further than it must to know that it is above most.
local function items(entry, most)
  local count = 0
  for i = 1, math.min(#entry, MAX_ROWS) do
    local row = entry[i]
    count = count + 1
    if type(row) == "table" and type(row.flags) == "table" then count = count + math.min(#row.flags, 32) end
    if type(row) == "table" and type(row.values) == "table" then
      local value, values = next(row.values), 0
      while value ~= nil and values <= MAX_ROWS do value, values = next(row.values, value), values + 1 end
      count = count + values
    end
    if count > most then break end
  end
  return count
end

--- Checks a catalogue and compiles it.
-- entries  what taurus_fields.lua returns: a list of messages, described there
-- returns  { messages = list, by_id = { [id] = message } } of the messages without a fault, and a list of texts,
--          each saying which message and field is wrong and why; empty when all is well.  Never raises.
-- A field's ordinary is the highest count that needs no second look (nil: none does).
-- A compiled message has name, title, id, size, filter, info, alarms and fields; a field has name, title, filter,
-- offset, size, kind ("uint", "flags", "float", "time") and what its kind needs.
function M.compile(entries)
  local catalogue, problems, names, left = { messages = {}, by_id = {} }, {}, {}, MAX_ITEMS
  if type(entries) ~= "table" then
    return catalogue, { "the file must return a list of messages, not " .. shown(entries) }
  end
  if #entries > M.MAX_ID + 1 then
    return catalogue, { string.format("%d messages, but there are only %d IDs", #entries, M.MAX_ID + 1) }
  end
  for i = 1, #entries do
    local entry, found = entries[i], {}
    local complain = complainer("message " .. i, found)
    if type(entry) ~= "table" then
      complain("a message is a table, not %s", shown(entry))
    elseif not is_name(entry.name) then
      complain("name %s is not a filter name (a-z, 0-9, _)", shown(entry.name))
    else
      left = left - items(entry, left)
      if left < 0 then
        complainer("message " .. entry.name, found)(
          "with it the catalogue has more than %d fields, values and flags: it ends here", MAX_ITEMS)
      else
        add_message(catalogue, entry, names, found)
      end
    end
    for j = 1, #found do
      if #problems < MAX_PROBLEMS then problems[#problems + 1] = found[j] end
    end
    if left < 0 then break end
  end
  return catalogue, problems
end

--- Which message each ID carries.
-- catalogue  compiled
-- ids        { [message name] = list of IDs }, the user's choice
-- returns    { [id] = message }, and a list of texts for IDs that two messages claim: the first keeps it
function M.assign(catalogue, ids)
  local by_id, problems, claims = {}, {}, 0
  for _, message in ipairs(catalogue.messages) do
    for _, id in ipairs(ids[message.name] or { message.id }) do
      local other = by_id[id]
      if other and other ~= message then
        claims = claims + 1
        if claims <= MAX_PROBLEMS then
          problems[claims] = string.format("ID 0x%X is given to %s and to %s: it stays with %s",
            id, other.title, message.title, other.title)
        end
      else
        by_id[id] = message
      end
    end
  end
  if claims > MAX_PROBLEMS then problems[#problems + 1] = ("and so on: %d IDs in all"):format(claims) end
  return by_id, problems
end

return M
