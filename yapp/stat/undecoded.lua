-- SPDX-License-Identifier: GPL-2.0-or-later
-- Messages that were not decoded, or only in part: their number, sources and sizes, and the
-- preferences of IDs that decode them.  Pure Lua, 5.2 to 5.5.

local compiler = require "yapp.message.catalogue"
local input = require "yapp.base.input"
local joined = require "yapp.base.joined"
local mapped = require "yapp.base.mapped"
local memo = require "yapp.base.memo"
local output = require "yapp.stat.output"

local Undecoded = {}
Undecoded.__index = Undecoded

local OTHER_CTL = " with a YAPP CTL other than 0, see yapp.all_extended"

--- Make an empty list.
-- settings  see stat.taps
function Undecoded.new(settings)
  return setmetatable({
    settings = settings,
    -- Messages that were not decoded at all, an entry for each source and size: { source, likes =
    -- message types of this size, about = a text, values = of its events }.
    whole = {},
    parts = {}, -- the same of those whose first bytes were decoded
    by_source = memo(), -- by source, by size
  }, Undecoded)
end

-- Return the text about a size.
-- own    the source's message type, or nil; likes: message types of this size
local function describe(own, likes, size)
  if own and compiler.of_size({ own }, size)[1] then return own.title .. OTHER_CTL end
  local titles = mapped(likes, function(message_type) return message_type.title end)
  if titles[1] then return "the size of " .. table.concat(titles, " and of ") end
  return own and ("%s has %d"):format(own.title, own.size) or "the size of no known message"
end

local function new_entry(self, source, size, rest)
  local own, likes = source.type, {}
  -- What is longer than its own message begins with it.
  if not own or size <= own.size then
    likes = compiler.of_size(self.settings.catalogue.messages, size)
  end
  local about, like = describe(own, likes, size), likes[1]
  local note = rest and ("the last %d not decoded, "):format(rest) or "not decoded, "
  return {
    source = source,
    likes = likes,
    about = size .. " bytes, " .. about,
    values = { size = size, count = 0, note = note .. about, like = like and like.name },
  }
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
    table.insert(rest and self.parts or self.whole, entry)
  end
  entry.values.count = entry.values.count + 1
  return entry.values
end

--- Return of how many sources messages were not decoded at all.
-- came  a set of sources: these are added
function Undecoded:count_sources(came)
  local seen, count = {}, 0
  for _, entry in ipairs(self.whole) do
    if not seen[entry.source] then count = count + 1 end
    seen[entry.source], came[entry.source] = true, true
  end
  return count
end

-- Preferences -------------------------------------------------------------------------------------

--- Return IDs, which it sorts, as a preference has them: "0x210-0x213,0x300".
function Undecoded.ranges_of(ids)
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

-- Return the message type by ID that a preference may give it: the only one of this size, and of
-- all messages of the ID that have a size of the catalogue; false for none.
local function types_by_id(self)
  local types = {}
  for _, entry in ipairs(self.whole) do
    local id, like, other = entry.source.id, entry.likes[1], entry.likes[2]
    if like then
      local is_only = not (entry.source.type or other) and id <= input.MAX_ID
      types[id] = is_only and (types[id] == nil or types[id] == like) and like
    end
  end
  return types
end

-- Return the complete preferences that decode the rest: a text, "" for none.
local function advice_of(self)
  local settings, ids_by_type, advice = self.settings, memo(), ""
  for id, like in pairs(types_by_id(self)) do table.insert(ids_by_type[like], id) end
  for _, message_type in ipairs(settings.catalogue.messages) do
    local ids = ids_by_type[message_type]
    if ids[1] then
      ids = Undecoded.ranges_of(joined(ids, settings.ids[message_type.name]))
      advice = advice .. (" -o yapp.%s_ids:%s"):format(message_type.name, ids)
    end
  end
  return advice ~= "" and ". Try" .. advice or ""
end

-- Texts -------------------------------------------------------------------------------------------

-- "648 messages were not decoded: can1 0x211, 0x212 (32 bytes each, the size of Motor Data)", of
-- entries, which it sorts; nil if there are none.
local function text_of(entries, what)
  if not entries[1] then return nil end
  local list, total = {}, 0
  local by_about = memo(function(about) return { about = about, names = {}, count = 0 } end, list)
  output.sort(entries, function(entry) return entry.source.bus or "", entry.source.id end)
  for _, entry in ipairs(entries) do
    local source, count, same = entry.source, entry.values.count, by_about[entry.about]
    local is_on_bus = same.bus == source.bus -- which stands there, if there is one
    table.insert(same.names, is_on_bus and ("0x%x"):format(source.id) or output.bus_and_id(source))
    same.bus, same.count, total = source.bus, same.count + count, total + count
  end
  local texts = mapped(list, function(same)
    local about = same.count > 1 and same.about:gsub("bytes", "bytes each", 1) or same.about
    return ("%s (%s)"):format(table.concat(same.names, ", "), about)
  end)
  return ("%s %s: %s"):format(output.were(total, "message"), what, table.concat(texts, "; "))
end

--- Return the texts on undecoded messages and the preferences that decode them: a list, empty for
-- none.
function Undecoded:texts()
  local texts, whole = {}, text_of(self.whole, "not decoded")
  if whole then texts[1] = whole .. advice_of(self) end
  texts[#texts + 1] = text_of(self.parts, "decoded in part")
  return texts
end

return Undecoded
