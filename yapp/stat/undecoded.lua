-- SPDX-License-Identifier: GPL-2.0-or-later
-- Messages that were not decoded, or only in part: their number, sources and sizes, and the
-- preferences of IDs that decode them.  Pure Lua, 5.2 to 5.5.

local compiler = require "yapp.message.catalogue"
local input = require "yapp.base.input"
local memo = require "yapp.base.memo"
local output = require "yapp.stat.output"

local M = {}

local MAX_NAMED = 30 -- sources, or sizes, in a text

local OTHER_CTL = " with a YAPP CTL other than 0, see yapp.all_extended"

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
    -- Messages that were not decoded at all: { source, size, likes = messages of this size or those
    -- that a preference of IDs can decode, about = a text, values = of its events } each.
    whole = {},
    parts = {}, -- the same of those whose first bytes were decoded
    by_source = memo(new_list), -- by source, by size
  }, Undecoded)
end

-- Return the text about a size.
-- own    the source's message type, or nil; likes: message types of this size
local function describe(own, likes)
  local titles = {}
  for i, message_type in ipairs(likes) do
    if message_type == own then return own.title .. OTHER_CTL end
    titles[i] = message_type.title
  end
  if titles[1] then return "the size of " .. table.concat(titles, " and of ") end
  return own and ("%s has %d"):format(own.title, own.size) or "the size of no known message"
end

local function new_entry(self, source, size, rest)
  local own, messages = source.type, self.settings.catalogue.messages
  local is_grown = own and size > own.size -- it begins with the own message
  local likes = is_grown and {} or compiler.of_size(messages, size)
  local about, like = describe(own, likes), likes[1]
  local note = rest and ("the last %d not decoded, "):format(rest) or "not decoded, "
  return {
    source = source,
    size = size,
    likes = likes,
    about = about,
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
function M.ranges_of(ids)
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
-- all messages of the ID that have a size of the catalogue.
local function types_by_id(self)
  local types, is_known = {}, {}
  for _, entry in ipairs(self.whole) do
    local id, like = entry.source.id, entry.likes[1]
    local is_only = not (entry.source.type or entry.likes[2]) and id <= input.MAX_ID
    if like and types[id] ~= like then
      types[id] = is_only and not is_known[id] and like or nil
      is_known[id] = true
    end
  end
  return types
end

-- Return the complete preferences that decode the rest: a text, "" for none.
local function advice_of(self)
  local settings, ids, texts = self.settings, memo(new_list), {}
  for id, message_type in pairs(types_by_id(self)) do table.insert(ids[message_type], id) end
  for _, message_type in ipairs(settings.catalogue.messages) do
    local list = ids[message_type]
    if list[1] then
      for _, id in ipairs(settings.ids[message_type.name]) do list[#list + 1] = id end
      texts[#texts + 1] = ("-o yapp.%s_ids:%s"):format(message_type.name, M.ranges_of(list))
    end
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
  return ("%s %s: %s"):format(output.were(total, "message"), what, join(texts, "; "))
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
