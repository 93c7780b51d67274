-- SPDX-License-Identifier: GPL-2.0-or-later
-- Runs in front of a copy of the plugin, see plant.py: gives one thing that the plugin tells Wireshark a wrong value,
-- by its name.  It knows Wireshark's API alone, nothing of the plugin's modules.
--
-- Its argument is { kind, name }: what is planted; or {}: print the rows "kind<tab>name" of all that can be.
local row = ...
if type(row) ~= "table" then return end -- run by Wireshark, in a plugin folder
if package.loaded["yapp.plugin"] then return end -- the plugin is there already: this copy does not load

local unpack_all = table.unpack or unpack -- 5.2 has both
local kind, name = row[1], row[2]

local function is_planted(what, title) return kind == what and name == title end

local listed = {}
local function list(what, title)
  if kind or listed[what .. title] then return end
  listed[what .. title] = true
  io.stderr:write("plant\t", what, "\t", title, "\n")
end

-- Values ------------------------------------------------------------------------------------------

local types, new_field = {}, ProtoField.new -- types: by ProtoField, of those planted
function ProtoField.new(title, filter, field_type, ...)
  local field = new_field(title, filter, field_type, ...)
  list("field", filter)
  if is_planted("field", filter) then types[field] = field_type end
  return field
end

local function is_range(value) return type(value) == "userdata" and typeof(value) == "TvbRange" end

-- Another value of a type: a range of the packet's bytes gives what it would show.
local function other(field_type, value, range, is_little)
  local length = is_range(range) and range:len() or 0
  if field_type == ftypes.BOOLEAN then
    if type(value) == "boolean" then return not value end
    return value == nil and (length > 4 and range:le_uint64():bxor(-1) or 0xFFFFFFFF - range:le_uint()) or 1
  elseif field_type == ftypes.STRING then
    return tostring(value) .. "?"
  elseif field_type == ftypes.RELATIVE_TIME then
    return value and NSTime.new(value.secs + 1, value.nsecs) or NSTime.new(1, 1)
  elseif field_type == ftypes.BYTES then
    return value and (type(value) == "string" and value .. "?" or ByteArray.new("00")) or nil
  elseif field_type == ftypes.UINT64 or field_type == ftypes.INT64 then
    return (value or is_little and range:le_uint64() or range:uint64()) + 1
  elseif type(value) == "number" then
    return value + 1
  end
  return length > 0 and length <= 4 and (is_little and range:le_uint() or range:uint()) + 1 or nil
end

-- The arguments behind a field, with a wrong value: without a range, with one, or a range alone.
local function spoil_arguments(field_type, is_little, count, range, value, ...)
  if not is_range(range) then return other(field_type, range), value, ... end
  if field_type == ftypes.BYTES and count == 1 then return range(0, range:len() - 1) end
  local wrong = other(field_type, value, range, is_little)
  if wrong == nil then return range(0, range:len() - 1), value, ... end
  return range, wrong, ...
end

for _, method in ipairs { "add", "add_le" } do
  local add = TreeItem[method]
  TreeItem[method] = function(item, field, ...)
    local field_type = types[field]
    if not field_type then return add(item, field, ...) end
    if field_type == ftypes.NONE then return item end
    return add(item, field, spoil_arguments(field_type, method == "add_le", select("#", ...), ...))
  end
end

-- Expert items ------------------------------------------------------------------------------------

local new_expert, missing = ProtoExpert.new, {}
function ProtoExpert.new(filter, text, group, severity)
  list("severity", filter)
  list("expert", filter)
  if is_planted("severity", filter) then
    severity = severity == expert.severity.WARN and expert.severity.NOTE or expert.severity.WARN
  end
  local made = new_expert(filter, text, group, severity)
  missing[made] = is_planted("expert", filter) or nil
  return made
end
if kind == "expert" then -- a method of an item is not looked up in TreeItem
  local items = debug.getregistry().TreeItem
  local method_of = items.__index
  local function add_expert(item, made, ...)
    if missing[made] then return item end
    return method_of(item, "add_proto_expert_info")(item, made, ...)
  end
  function items.__index(item, key)
    return key == "add_proto_expert_info" and add_expert or method_of(item, key)
  end
end

-- Preferences -------------------------------------------------------------------------------------

-- The preferences of YAPP by their titles: another value by default.
for _, constructor in ipairs { "bool", "string", "range", "enum", "uint" } do
  local make = Pref[constructor]
  Pref[constructor] = function(title, value, ...)
    list("preference", title)
    if is_planted("preference", title) then
      if type(value) == "boolean" then
        value = not value
      elseif constructor == "enum" then
        value = value == 5 and 6 or 5
      elseif type(value) == "number" then
        value = value + 1
      else
        value = constructor == "range" and "148" or tonumber(value) and tostring(value + 1) or "0x7=nobody"
      end
    end
    return make(title, value, ...)
  end
end

-- What the user sets, ignored: the plugin reads the default.
local defaults = {}
if kind == "effect" or not kind then
  local prefs_class = getmetatable(Proto("plant_prefs", "Plant").prefs)
  local set_pref, get_pref = prefs_class.__newindex, prefs_class.__index
  function prefs_class.__newindex(prefs, key, value)
    list("effect", key)
    set_pref(prefs, key, value)
    if not is_planted("effect", key) then return end
    defaults[key] = get_pref(prefs, key)
    if defaults[key] == nil then defaults[key] = "" end -- of a range without a number
  end
  function prefs_class.__index(prefs, key)
    if defaults[key] ~= nil then return defaults[key] end
    return get_pref(prefs, key)
  end
end

-- Statistics --------------------------------------------------------------------------------------

-- Of -z: the name of a statistic, and the keys of its JSON: a wrong value behind one.
local register = register_stat_cmd_arg
function _G.register_stat_cmd_arg(argument, ...)
  list("statistic", argument)
  if is_planted("statistic", argument) then return end
  return register(argument, ...)
end

local function literal(text) return (text:gsub("%p", "%%%0")) end

-- Of a table of CSV a column, of whatever message.
local file_now, places = nil, {} -- places: of the column in the table's lines, by file
local function spoil_cells(text)
  local place, count = places[file_now or "printed"], 0
  if text:find("^time,frame,") then
    for title in text:gmatch("[^,\n]+") do
      count = count + 1
      list("csv", title)
      if is_planted("csv", title) then places[file_now or "printed"] = count end
    end
  elseif place and text:find("^%d+%.%d+,%d+,") then
    return (text:gsub("([^,\n]*)([,\n])", function(cell, mark)
      count = count + 1
      if count == place then return (tonumber(cell) and cell + 1 or cell .. "?") .. mark end
    end))
  end
  return text
end

-- Of the JSON a key or a kind of event, of the tables a title.
local function spoil(text)
  if not kind then
    for key in text:gmatch('"([%a_][%w_.]*)":') do list("key", key) end
    for event in text:gmatch('"kind":"(.-)"') do list("event", event) end
    for line in text:gmatch("[^\n]+") do
      if line:find("source  ") and not line:find("[{}]") then
        for title in line:gmatch("(%S+)%s*") do list("column", title) end
      end
    end
    return spoil_cells(text)
  elseif kind == "csv" then
    return spoil_cells(text)
  elseif kind == "event" then
    return (text:gsub('("kind":"' .. literal(name) .. ')"', '%1?"'))
  elseif kind == "column" then
    return (text:gsub("%f[%S]" .. literal(name) .. "%f[%s]", name .. "?"))
  end
  local key = '("' .. literal(name) .. '":)'
  text = text:gsub(key .. '"', '%1"?'):gsub('("' .. literal(name) .. ')":([{%[])', '%1?":%2')
  return (text:gsub(key .. "(%-?[%d.]+)", function(before, number) return before .. number + 1 end)
    :gsub(key .. "true", "%1false"):gsub(key .. "null", "%10"))
end

local function spoiled(...)
  local texts = { ... }
  for i, text in ipairs(texts) do texts[i] = type(text) == "string" and spoil(text) or text end
  return unpack_all(texts)
end

if kind == "key" or kind == "event" or kind == "column" or kind == "csv" or not kind then
  local print_all, write, lines = print, io.write, getmetatable(io.stdout).__index
  local write_file = lines.write
  local function printed(...)
    file_now = nil
    return spoiled(...)
  end
  function _G.print(...) return print_all(printed(...)) end
  function io.write(...) return write(printed(...)) end
  if type(lines) == "table" then
    lines.write = function(file, ...)
      if file == io.stderr then return write_file(file, ...) end
      file_now = file
      return write_file(file, spoiled(...))
    end
  end
end
