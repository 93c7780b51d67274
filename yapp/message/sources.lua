-- SPDX-License-Identifier: GPL-2.0-or-later
-- The names that the user gave to sources, and what a source is called.  Pure Lua, 5.2 and 5.4.
--
--   0x210=motor:left_fore, 0x211=motor:left_aft, can1/0x210=motor:right_fore, 0x212=left_tail, 0x213=motor:
--
-- A part is [BUS/]ID=[MESSAGE:]NAME.  BUS is the name that the capture gives a bus, ID is decimal or 0x and
-- hexadecimal, MESSAGE the catalogue's short name of what the ID carries.  Without BUS it is for every bus that has no
-- part of its own.  Spaces around each do not count.  A bus with a comma, "=" or a quote in its name stands in quotes,
-- its own quotes doubled: "USB, left"/0x210=motor:a.  The last "/" ends the bus: vcan/0/0x210 is ID 0x210 on vcan/0.

local M = {}

local MAX_ID = 2047
local MAX_NAME = 64 -- bytes
local MAX_PROBLEMS = 20
local SHAPE = "a source is [BUS/]ID=[MESSAGE:]NAME"

local Sources = {}
Sources.__index = Sources

local function trim(text) return (text:match("^%s*(.-)%s*$")) end

-- Splits at commas outside of quotes.
local function split(text)
  local parts, at, from = {}, 1, 1
  while true do
    local place = text:find('[,"]', at)
    if place and text:sub(place, place) == '"' then
      at = (text:find('"', place + 1, true) or #text) + 1
    else
      parts[#parts + 1] = trim(text:sub(from, (place or 0) - 1))
      if not place then return parts end
      at, from = place + 1, place + 1
    end
  end
end

-- The bus, or nil, and the rest of a part; nil and why where its quotes do not fit.
local function take_bus(part)
  if part:sub(1, 1) == '"' then
    local at = 2
    while true do
      local quote = part:find('"', at, true)
      if not quote then return nil, nil, "the quote is not closed" end
      if part:sub(quote + 1, quote + 1) ~= '"' then
        local rest = part:match("^%s*/(.*)$", quote + 1)
        if not rest then return nil, nil, "a bus in quotes is followed by /" end
        return (part:sub(2, quote - 1):gsub('""', '"')), rest
      end
      at = quote + 2
    end
  end
  local address = part:match("^[^=]*")
  local bus, id = address:match("^(.*)/([^/]*)$")
  if not bus then return nil, part end
  return trim(bus), id .. part:sub(#address + 1)
end

-- What is wrong with a name, nil for nothing.
local function check_name(name)
  if name:find(";.*=") then return "sources are parted by commas" end
  if #name > MAX_NAME then return ("the name has more than %d bytes"):format(MAX_NAME) end
  if name:find("%c") or require("yapp.base.utf8").ascii(name):find("[\128-\255]") then
    return "the name is not a text"
  end
end

local function message_names(catalogue)
  local names = {}
  for i, message in ipairs(catalogue.messages) do names[i] = message.name end
  return table.concat(names, ", ")
end

-- Takes one part apart: { bus =, id =, message =, name = }; or nil and what is wrong.
local function read_part(part, catalogue)
  local bus, rest, problem = take_bus(part)
  if not rest then return nil, problem end
  local id_text, value = rest:match("^(.-)=(.*)$")
  if not id_text then return nil, SHAPE end
  local id = trim(id_text):match("^%d+$") and tonumber(id_text, 10) or
    trim(id_text):match("^0[xX]%x+$") and tonumber(trim(id_text))
  if not id or id > MAX_ID then return nil, ("the ID %q is not one of 0 .. 0x%X"):format(trim(id_text), MAX_ID) end
  local message_name, name = value:match("^(.-):(.*)$")
  name = trim(name or value)
  if not message_name and name == "" then return nil, "the name is missing" end
  local message
  for _, one in ipairs(catalogue.messages) do
    if message_name and one.name == trim(message_name) then message = one end
  end
  if message_name and not message then
    return nil, ("there is no message %q, but %s"):format(trim(message_name), message_names(catalogue))
  end
  problem = check_name(name)
  if problem then return nil, problem end
  return { bus = bus, id = id, message = message, name = name ~= "" and name or nil }
end

--- Reads the preference.
-- text       of the user
-- catalogue  compiled
-- returns    the sources; and a list of texts of what is wrong, each with the part that it is about: such a part is
--            left out, the others hold
function M.parse(text, catalogue)
  local self = setmetatable({ anywhere = {}, by_bus = {}, rows = {}, several = {}, labels = {} }, Sources)
  local problems = {}
  for _, part in ipairs(split(text)) do
    local row, problem
    if part ~= "" then row, problem = read_part(part, catalogue) end
    if row then
      local rows = self.anywhere
      if row.bus then
        rows = self.by_bus[row.bus] or {}
        self.by_bus[row.bus] = rows
      end
      if rows[row.id] then
        problem = "this bus and ID stand there before: the first one holds"
      else
        rows[row.id], self.rows[#self.rows + 1] = row, row
      end
    end
    if problem and #problems < MAX_PROBLEMS then problems[#problems + 1] = ("sources: %s: %s"):format(part, problem) end
  end
  self:use_ids {}
  return self, problems
end

--- Tells which message each ID carries elsewhere (the preferences of message IDs): { [id] = compiled message }.
function Sources:use_ids(by_id)
  local ids = {} -- [message] = { [id] = true }
  local function note(message, id)
    ids[message] = ids[message] or {}
    ids[message][id] = true
  end
  for id, message in pairs(by_id) do note(message, id) end
  for _, row in ipairs(self.rows) do
    if row.message then note(row.message, row.id) end
  end
  self.several, self.labels = {}, {}
  for message, list in pairs(ids) do
    self.several[message] = next(list, (next(list))) ~= nil
  end
end

local function find(self, bus, id)
  local rows = bus and self.by_bus[bus]
  return rows and rows[id] or self.anywhere[id]
end

--- The name of a source, nil where the user gave none.
-- bus  the name that the capture gives it, or nil; id: message ID
function Sources:name(bus, id)
  local row = find(self, bus, id)
  return row and row.name
end

--- The compiled message that the user said an ID carries on a bus; nil where this preference says nothing of it.
function Sources:message(bus, id)
  local row = find(self, bus, id)
  return row and row.message
end

--- The name of that message in the catalogue.
function Sources:message_name(bus, id)
  local message = self:message(bus, id)
  return message and message.name
end

--- All that was read: a list of { bus = name or nil, id =, message = compiled or nil, name = or nil }.
function Sources:list()
  return self.rows
end

--- Whether some source has this name.
function Sources:has_name(name)
  for _, row in ipairs(self.rows) do
    if row.name == name then return true end
  end
  return false
end

-- "Motor Data left_fore", "Motor Data 0x212 (can1)", "Motor Data", "ID 0x123 left_tail"
local function make_label(self, bus, id, message)
  local title, name = message and message.title or ("ID 0x%x"):format(id), self:name(bus, id)
  if name then return title .. " " .. name end
  if not message or id == message.id and not self.several[message] then return title end
  return ("%s 0x%x%s"):format(title, id, bus and " (" .. bus .. ")" or "")
end

--- What a message is called where rows stand for themselves: its title; and where more than one ID carries it, or its
-- ID is not the default, the source's name, or ID and bus.
-- message  compiled, nil for an unknown ID
function Sources:label(bus, id, message)
  local of_bus = self.labels[bus or false]
  if not of_bus then
    of_bus = {}
    self.labels[bus or false] = of_bus
  end
  local label = of_bus[id]
  if not label then
    label = make_label(self, bus, id, message)
    of_bus[id] = label
  end
  return label
end

return M
