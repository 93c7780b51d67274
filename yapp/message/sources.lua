-- SPDX-License-Identifier: GPL-2.0-or-later
-- The names that the user gave to sources: the preference.  Pure Lua.
--
--   0x210=motor:left_fore, can1/0x210=motor:right_fore, can0/0x210+0x200+0x000=left, can2=tail
--   0x213=motor:
--
-- A part is [BUS/]ID[+ID...]=[MESSAGE:]NAME, or BUS=NAME for every ID of a bus.  BUS is the name
-- that the capture gives a bus, ID is decimal or 0x and hexadecimal, MESSAGE the catalogue's short
-- name of what the ID carries.  Without BUS it is for every bus that has no part of its own.
-- Spaces around each do not count.  A bus with a comma, "=" or a quote in its name stands in
-- quotes, its own quotes doubled: "USB, left"/0x210=motor:a; so does one that begins with a digit
-- and has no ID.  The last "/" ends the bus: vcan/0/0x210 is ID 0x210 on vcan/0.

local check = require("yapp.message.check")

local M = {}

local MAX_ID = 2047
local MAX_NAME = 64 -- bytes
local SHAPE = "a source is [BUS/]ID=[MESSAGE:]NAME or BUS=NAME"

local demand = check.demand

local Sources = {}
Sources.__index = Sources

local function trim(text)
  return text:match("^%s*(.-)%s*$")
end

-- Splits at commas outside of quotes; what is blank is no part.
local function split(text)
  local parts = {}
  local hidden = text:gsub('"[^"]*"', function(quoted) return (quoted:gsub(",", "\0")) end)
  for text_of_part in hidden:gmatch("[^,]+") do
    local part = trim((text_of_part:gsub("\0", ",")))
    if part ~= "" then parts[#parts + 1] = part end
  end
  return parts
end

-- Parts from here on raise what is wrong with them.

-- A bus in quotes, and what comes behind it.  One with quotes in it is several quoted texts in a
-- row: "a ""b""" is "a ", "b" and "".
local function take_quoted(part)
  local stop
  local behind = part:match('^"[^"]*"()')
  while behind do
    stop = behind
    behind = part:match('^"[^"]*"()', stop)
  end
  demand(stop, "the quote is not closed")
  local sign, rest = part:match("^%s*([/=])(.*)$", stop)
  demand(sign, "a bus in quotes is followed by / or =")
  local bus = part:sub(2, stop - 2):gsub('""', '"')
  return bus, sign, rest
end

-- The bus, the text of the IDs, and what is behind the "="; either of the first two may be nil.
local function take_address(part)
  if part:sub(1, 1) == '"' then
    local bus, sign, rest = take_quoted(part)
    if sign == "=" then return bus, nil, rest end
    local ids, value = rest:match("^(.-)=(.*)$")
    demand(ids, SHAPE)
    return bus, ids, value
  end
  local address, value = part:match("^(.-)%s*=(.*)$")
  demand(address, SHAPE)
  local bus, ids = address:match("^(.*)/([^/]*)$")
  if bus then return trim(bus), ids, value end
  if address:find("^[%d+-]") then return nil, address, value end
  return address, nil, value
end

local function read_ids(text)
  local ids = {}
  for part in (text .. "+"):gmatch("([^+]*)%+") do
    local one = trim(part)
    local is_number = one:find("^%d+$") or one:find("^0[xX]%x+$")
    local id = is_number and tonumber(one)
    demand(id and id <= MAX_ID, "the ID %q is not one of 0 .. 0x%X", one, MAX_ID)
    ids[#ids + 1] = id
  end
  return ids
end

-- The message of the catalogue that has a name.
local function find_message(catalogue, name)
  local names = {}
  for i, message in ipairs(catalogue.messages) do
    if message.name == name then return message end
    names[i] = message.name
  end
  demand(false, "there is no message %q, but %s", name, table.concat(names, ", "))
end

-- What a part says.
-- returns  the bus, the IDs, the compiled message and the name: nil for each that it does not say
local function read_part(part, catalogue)
  local bus, id_text, value = take_address(part)
  local ids = id_text and read_ids(id_text)
  local message_name, name = value:match("^(.-):(.*)$")
  name = trim(name or value)
  demand(not name:find(";.*="), "sources are parted by commas")
  demand(#name <= MAX_NAME, "the name has more than %d bytes", MAX_NAME)
  demand(name == "" or check.is_text(name), "the name is not a text")
  if not message_name then
    demand(name ~= "", "the name is missing")
    return bus, ids, nil, name
  end
  demand(ids, "a message is for an ID, not for a bus")
  local message = find_message(catalogue, trim(message_name))
  return bus, ids, message, name ~= "" and name or nil
end

local EVERY = { "every" } -- ID of a bus

-- Adds a row for each ID of a part that is new.
local function add_part(self, part, catalogue)
  local bus, ids, message, name = read_part(part, catalogue)
  local of_bus = self.by_bus[bus or false] or {}
  self.by_bus[bus or false] = of_bus
  local is_known = false
  for _, id in ipairs(ids or EVERY) do
    if of_bus[id] then
      is_known = true
    else
      local row = { bus = bus, id = ids and id, message = message, name = name }
      of_bus[id] = row
      self.rows[#self.rows + 1] = row
    end
  end
  demand(not is_known, "this bus and ID stand there before: the first one holds")
end

--- Reads the preference.
-- text       of the user
-- catalogue  compiled
-- returns    the sources; and a list of texts of what is wrong, each with the part that it is
--            about: such a part is left out, the others hold
function M.parse(text, catalogue)
  local self = setmetatable({ by_bus = { [false] = {} }, rows = {} }, Sources)
  local problems = {}
  for _, part in ipairs(split(text)) do
    local ok, problem = pcall(add_part, self, part, catalogue)
    if not ok then problems[#problems + 1] = ("sources: %s: %s"):format(part, problem) end
  end
  return self, check.few(problems)
end

--- The name of a source, nil where the user gave none: that of its ID on its bus, of its bus, or of
-- its ID anywhere.
-- bus  the name that the capture gives it, or nil; id: message ID
function Sources:name(bus, id)
  local of_bus = bus and self.by_bus[bus] or {}
  local own, of_every_id = of_bus[id], of_bus.every
  if own and own.name then return own.name end
  if of_every_id then return of_every_id.name end
  local anywhere = not own and self.by_bus[false][id]
  return anywhere and anywhere.name or nil
end

--- The compiled message that the user said an ID carries on a bus; nil where this preference says
-- nothing of it.
function Sources:message(bus, id)
  local of_bus = self.by_bus[bus or false]
  local row = of_bus and of_bus[id] or self.by_bus[false][id]
  return row and row.message
end

--- All that was read: a list of { bus = name or nil, id = nil for all of a bus, message = compiled
-- or nil, name = or nil }.
function Sources:list()
  return self.rows
end

return M
