-- SPDX-License-Identifier: GPL-2.0-or-later
-- Messages that were not decoded, or only in part: how many, of which sources and sizes, and which
-- preference decodes them.  Pure Lua, 5.2 to 5.5.

local output = require("yapp.stat.output")

local M = {}

local MAX_ID = 2047 -- the highest that a preference takes
local MAX_NAMED = 30 -- sources, or sizes, in a text

local place = output.place

local Undecoded = {}
Undecoded.__index = Undecoded

--- Make an empty list.
-- settings  see stat.taps
function M.new(settings)
  return setmetatable({
    settings = settings,
    -- { source, size, is_part = whether the first bytes were decoded, is_own = whether the size is
    -- that of the source's message, likes = messages of this size, about = a text, values = of its
    -- events } each
    entries = {},
    by_source = {}, -- by source, by size
  }, Undecoded)
end

-- Return what to say of a size: which messages have it.
-- is_own  whether it is the size of the source's message
local function describe(source, likes, is_own)
  local titles, own = {}, source.message
  if is_own then return ("%s with a YAPP CTL other than 0"):format(own.title) end
  for i, message in ipairs(likes) do titles[i] = message.title end
  if likes[1] then return "the size of " .. table.concat(titles, " and of ") end
  return own and ("%s has %d"):format(own.title, own.size) or "the size of no known message"
end

local function new_entry(self, source, size, rest)
  local likes, is_own = {}, false
  for _, message in ipairs(self.settings.catalogue.messages) do
    if size <= message.size and size >= (message.min_size or message.size) then
      likes[#likes + 1] = message
      is_own = is_own or message == source.message
    end
  end
  local about = describe(source, likes, is_own)
  local note = rest and ("the last %d not decoded, "):format(rest) or "not decoded, "
  local values = { size = size, count = 0, note = note .. about }
  if likes[1] then values.like = likes[1].name end
  return {
    source = source,
    size = size,
    is_part = rest ~= nil,
    is_own = is_own,
    likes = likes,
    about = about,
    values = values,
  }
end

--- Note a message.
-- source   see stat.kinds
-- size     of its payload; rest: how many bytes of it were not decoded, nil for all
-- returns  the values of an `unknown` event: one table for each source and size, whose count grows
function Undecoded:note(source, size, rest)
  local by_size = self.by_source[source] or {}
  self.by_source[source] = by_size
  local entry = by_size[size]
  if not entry then
    entry = new_entry(self, source, size, rest)
    by_size[size], self.entries[#self.entries + 1] = entry, entry
  end
  entry.values.count = entry.values.count + 1
  return entry.values
end

-- Preferences -------------------------------------------------------------------------------------

-- "0x210-0x213,0x300"
local function ranges_of(ids)
  local texts, first = {}, nil
  table.sort(ids)
  for i, id in ipairs(ids) do
    first = first or id
    if ids[i + 1] ~= id and ids[i + 1] ~= id + 1 then
      texts[#texts + 1] = (first == id and "0x%x" or "0x%x-0x%x"):format(first, id)
      first = nil
    end
  end
  return table.concat(texts, ",")
end

-- "can1/0x210=health:left", a part of yapp.sources.
local function part_of(entry)
  local source, bus = entry.source, entry.source.bus
  if bus and bus:find('[,="%s]') then bus = '"' .. bus:gsub('"', '""') .. '"' end
  local message, name = entry.likes[1].name, source.name or ""
  return ("%s0x%x=%s:%s"):format(bus and bus .. "/" or "", source.id, message, name)
end

-- Whether a preference of IDs can decode an entry.
local function is_decodable(entry)
  local is_other = not (entry.is_part or entry.is_own)
  return is_other and entry.likes[1] and entry.source.id <= MAX_ID
end

-- Return by ID the size of its messages; false if these have several sizes, or if the ID has a
-- message already.
local function sizes_of(entries)
  local sizes = {}
  for _, entry in ipairs(entries) do
    local id, size = entry.source.id, entry.size
    if is_decodable(entry) then
      if sizes[id] == nil then sizes[id] = size end
      if sizes[id] ~= size or entry.source.message then sizes[id] = false end
    end
  end
  return sizes
end

-- Return what decodes the entries: by message the IDs that can carry it on all buses, parts of
-- yapp.sources for other IDs, and a list of other options.
local function plan(self)
  local ids, parts, options, taken, sizes = {}, {}, {}, {}, sizes_of(self.entries)
  for _, row in ipairs(self.settings.sources:list()) do
    if row.id then taken[place(row)] = true end -- the first part for a bus and ID holds
  end
  for _, entry in ipairs(self.entries) do
    local id, key = entry.source.id, place(entry.source)
    if sizes[id] and is_decodable(entry) then
      for _, message in ipairs(entry.likes) do
        ids[message] = ids[message] or {}
        table.insert(ids[message], id)
      end
    elseif is_decodable(entry) and not taken[key] then
      taken[key], parts[#parts + 1] = true, part_of(entry)
    elseif entry.is_own then
      options[1] = "-o yapp.all_extended:TRUE"
    end
  end
  return ids, parts, options
end

-- The preferences that decode what can be decoded, complete: a text, "" for none.
local function advice_of(self)
  local settings, sizes = self.settings, {}
  local ids, parts, texts = plan(self)
  for _, message in ipairs(settings.catalogue.messages) do
    local list = ids[message]
    if list then
      for _, id in ipairs(settings.ids[message.name]) do list[#list + 1] = id end
      local option = ("-o yapp.%s_ids:%s"):format(message.name, ranges_of(list))
      texts[#texts + 1] = sizes[message.size] and "or " .. option or option
      sizes[message.size] = true
    end
  end
  if parts[1] then
    if settings.sources_text:find("%S") then table.insert(parts, 1, settings.sources_text) end
    local option = "yapp.sources:" .. table.concat(parts, ",")
    texts[#texts + 1] = (option:find('"') and "-o '%s'" or '-o "%s"'):format(option)
  end
  return texts[1] and ". Try " .. table.concat(texts, " ") or ""
end

-- Texts -------------------------------------------------------------------------------------------

-- Joins the first of many texts.
local function join(texts, between)
  local more = #texts - MAX_NAMED
  if more <= 0 then return table.concat(texts, between) end
  return ("%s%sand %d more"):format(table.concat(texts, between, 1, MAX_NAMED), between, more)
end

-- "can1 0x211, 0x212 (32 bytes each, the size of Motor Data)": entries of one size, which are
-- sorted; and how many messages they are.
local function group_text(entries)
  local texts, count, bus = {}, 0, nil
  output.sort(entries, function(entry) return entry.source.bus or "", entry.source.id end)
  for i, entry in ipairs(entries) do
    local source = entry.source
    texts[i] = source.bus == bus and ("0x%x"):format(source.id) or place(source)
    bus = source.bus
    count = count + entry.values.count
  end
  local shape = count > 1 and "%s (%d bytes each, %s)" or "%s (%d bytes, %s)"
  return shape:format(join(texts, ", "), entries[1].size, entries[1].about), count
end

-- The entries that were decoded in part, or not at all.
local function text_of(self, is_part)
  local groups, by_name, total = {}, {}, 0
  for _, entry in ipairs(self.entries) do
    if entry.is_part == is_part then
      local name = entry.size .. entry.about
      local group = by_name[name] or {}
      if not group[1] then
        by_name[name], groups[#groups + 1] = group, group
      end
      group[#group + 1] = entry
    end
  end
  for i, group in ipairs(groups) do
    local count
    groups[i], count = group_text(group)
    total = total + count
  end
  if total == 0 then return nil end
  local were = total == 1 and "was" or "were"
  local what = is_part and "decoded in part" or "not decoded"
  return ("%s %s %s: %s"):format(output.count(total, "message"), were, what, join(groups, "; "))
end

--- Return what was not decoded, and which preference decodes it: a list of texts, empty for
-- nothing.
function Undecoded:texts()
  local texts, all = {}, text_of(self, false)
  if all then texts[1] = all .. advice_of(self) end
  texts[#texts + 1] = text_of(self, true)
  return texts
end

return M
