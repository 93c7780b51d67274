-- SPDX-License-Identifier: GPL-2.0-or-later
-- Messages that were not decoded, or only in part: their number, sources and sizes, and the
-- preferences that decode them.  Pure Lua, 5.2 to 5.5.

local compiler = require "yapp.message.catalogue"
local input = require "yapp.base.input"
local memo = require "yapp.base.memo"
local output = require "yapp.stat.output"
local source_names = require "yapp.message.sources"

local M = {}

local MAX_NAMED = 30 -- sources, or sizes, in a text

local bus_and_id = output.bus_and_id

local Undecoded = {}
Undecoded.__index = Undecoded

local function new_list()
  return {}
end

--- Make an empty list.
-- settings  see stat.taps
function M.new(settings)
  return setmetatable({
    settings = settings,
    -- Messages that were not decoded at all: { source, size, likes = messages of this size,
    -- is_own = true if that of the source is one, is_decodable = true if a preference of IDs can
    -- decode it, about = a text, values = of its events } each.
    whole = {},
    parts = {}, -- the same of those whose first bytes were decoded
    sizes = {}, -- by ID: the size of decodable messages; false for several, or if it has a message
    by_source = memo(new_list), -- by source, by size
  }, Undecoded)
end

-- Return the text about a size.
-- own     the source's message, is_own = true if this message has the size
-- titles  of the messages that have it
local function describe(own, is_own, titles)
  if is_own then return ("%s with a YAPP CTL other than 0"):format(own.title) end
  if titles[1] then return "the size of " .. table.concat(titles, " and of ") end
  return own and ("%s has %d"):format(own.title, own.size) or "the size of no known message"
end

local function new_entry(self, source, size, rest)
  local own, titles, is_own = source.type, {}, false
  local is_grown = own and size > own.size -- it begins with the own message
  local likes = is_grown and {} or compiler.of_size(self.settings.catalogue.messages, size)
  for i, of_type in ipairs(likes) do
    titles[i] = of_type.title
    is_own = is_own or of_type == own
  end
  local about, like = describe(own, is_own, titles), likes[1]
  local note = rest and ("the last %d not decoded, "):format(rest) or "not decoded, "
  return {
    source = source,
    size = size,
    likes = likes,
    is_own = is_own,
    is_decodable = not (rest or is_own) and like and source.id <= input.MAX_ID,
    about = about,
    values = { size = size, count = 0, note = note .. about, like = like and like.name },
  }
end

local function add(self, entry, list)
  local id, sizes, size = entry.source.id, self.sizes, entry.size
  list[#list + 1] = entry
  if entry.is_decodable then
    local is_only = sizes[id] == nil or sizes[id] == size
    sizes[id] = is_only and not entry.source.type and size
  end
end

--- Count a message.
-- source   see stat.kinds
-- size     of its payload; rest: how many bytes of it were not decoded, nil for all
-- returns  the values of an `unknown` event: one table for each source and size, whose count grows
function Undecoded:count(source, size, rest)
  local by_size = self.by_source[source]
  local entry = by_size[size]
  if not entry then
    entry = new_entry(self, source, size, rest)
    by_size[size] = entry
    add(self, entry, rest and self.parts or self.whole)
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
  local source = entry.source
  local address = source_names.address_text(source.bus, source.id)
  return ("%s=%s:%s"):format(address, entry.likes[1].name, source.name or "")
end

-- Return the preferences that decode the entries: by message the IDs for all buses, parts of
-- yapp.sources for other IDs, and a list of other options.
local function plan(self)
  local ids, parts, options, taken = {}, {}, {}, {}
  for _, row in ipairs(self.settings.sources:list()) do
    if row.id then taken[bus_and_id(row)] = true end -- the first part for a bus and ID holds
  end
  for _, entry in ipairs(self.whole) do
    local id, key = entry.source.id, bus_and_id(entry.source)
    if entry.is_own then
      options[1] = "-o yapp.all_extended:TRUE"
    elseif entry.is_decodable and self.sizes[id] then
      for _, of_type in ipairs(entry.likes) do
        ids[of_type] = ids[of_type] or {}
        table.insert(ids[of_type], id)
      end
    elseif entry.is_decodable and not taken[key] then
      taken[key], parts[#parts + 1] = true, part_of(entry)
    end
  end
  return ids, parts, options
end

-- Return a text in quotes that a shell takes as it is.  Windows has double quotes alone, but a name
-- with one of these signs would end them, or run a program.
local function in_quotes(text)
  if not text:find('["$`\\!]') then return '"' .. text .. '"' end
  return "'" .. text:gsub("'", "'\\''") .. "'"
end

-- Return the complete preferences that decode the rest: a text, "" for none.
local function advice_of(self)
  local settings, sizes = self.settings, {}
  local ids, parts, texts = plan(self)
  for _, of_type in ipairs(settings.catalogue.messages) do
    local list = ids[of_type]
    if list then
      for _, id in ipairs(settings.ids[of_type.name]) do list[#list + 1] = id end
      local option = ("-o yapp.%s_ids:%s"):format(of_type.name, ranges_of(list))
      texts[#texts + 1] = sizes[of_type.size] and "or " .. option or option
      sizes[of_type.size] = true
    end
  end
  if parts[1] then
    if settings.sources_text:find("%S") then table.insert(parts, 1, settings.sources_text) end
    texts[#texts + 1] = "-o " .. in_quotes("yapp.sources:" .. table.concat(parts, ","))
  end
  return texts[1] and ". Try " .. table.concat(texts, " ") or ""
end

-- Texts -------------------------------------------------------------------------------------------

-- Join the first of many texts.
local function join(texts, between)
  local more = #texts - MAX_NAMED
  if more > 0 then texts[MAX_NAMED + 1] = ("and %d more"):format(more) end
  return table.concat(texts, between, 1, math.min(#texts, MAX_NAMED + 1))
end

-- "can1 0x211, 0x212 (32 bytes each, the size of Motor Data)": entries of one size, which are
-- sorted; and how many messages they are.
local function group_text(entries)
  local texts, count, bus = {}, 0, nil
  output.sort(entries, function(entry) return entry.source.bus or "", entry.source.id end)
  for i, entry in ipairs(entries) do
    local source = entry.source
    texts[i] = source.bus == bus and ("0x%x"):format(source.id) or bus_and_id(source)
    bus = source.bus
    count = count + entry.values.count
  end
  local shape = count > 1 and "%s (%d bytes each, %s)" or "%s (%d bytes, %s)"
  return shape:format(join(texts, ", "), entries[1].size, entries[1].about), count
end

-- "648 messages were not decoded: ...", of entries; nil if there are none.
local function text_of(entries, what)
  local groups, texts, total = {}, {}, 0
  local by_shape = memo(new_list, groups)
  for _, entry in ipairs(entries) do
    table.insert(by_shape[entry.size .. entry.about], entry)
  end
  for i, group in ipairs(groups) do
    local text, count = group_text(group)
    texts[i], total = text, total + count
  end
  if total == 0 then return nil end
  local count, were = output.count(total, "message"), total == 1 and "was" or "were"
  return ("%s %s %s: %s"):format(count, were, what, join(texts, "; "))
end

--- Return the texts on undecoded messages and the preferences that decode them: a list, empty for
-- none.
function Undecoded:texts()
  local texts, whole = {}, text_of(self.whole, "not decoded")
  if whole then texts[1] = whole .. advice_of(self) end
  texts[#texts + 1] = text_of(self.parts, "decoded in part")
  return texts
end

return M
