-- SPDX-License-Identifier: GPL-2.0-or-later
-- The preference yapp.sources: which names the user gave to sources.  Pure Lua.
--
--   0x210=motor:left_fore, can1/0x210=motor:right_fore, can0/0x210+0x200+0x000=left, can2=tail
--   0x213=motor:, can0/0x210-0x213=motor:M1..M4
--
-- A part is [BUS/]ID[+ID...]=[MESSAGE:]NAME, or BUS=NAME for every ID of a bus.  A range of IDs may
-- stand for an ID, 0x210-0x213; its names count up, M1..M4.  ID is decimal, or 0x and hexadecimal.
-- MESSAGE is the catalogue's short name of what the ID carries.  A part without BUS is for each bus
-- without a part of its own.  Spaces around each do not count.
-- BUS is the name that statistics print, or one that it has together with others, see name_above.
-- It stands in quotes if it has a comma, "=" or a quote.  So does one that begins with a digit, is
-- no address and has no ID behind it.  Its own quotes are doubled: "USB, left"/0x210=motor:a.
-- The last "/" ends the bus: vcan/0/0x210 is ID 0x210 on vcan/0.

local input = require "yapp.base.input"
local memo = require "yapp.base.memo"
local utf8 = require "yapp.base.utf8"

local M = {}

local trim = input.trim

local SHAPE = "write [BUS/]ID=[MESSAGE:]NAME or BUS=NAME"
local IPV4 = "%d+%.%d+%.%d+%.%d+"

local Sources = {}
Sources.__index = Sources

-- Signs between quotes are hidden while a text is taken apart.
local HIDDEN = { [","] = "\0c", ["="] = "\0e", ["/"] = "\0s" }
local SHOWN = { c = ",", e = "=", s = "/" }

local function hide(quoted)
  return (quoted:gsub("[,=/]", HIDDEN))
end

local function reveal(text)
  return (text:gsub("\0(.)", SHOWN))
end

-- Raise a problem and an advice unless a condition holds.
local function demand(condition, problem, advice)
  if not condition then error({ problem = problem, advice = advice }, 0) end
end

-- Split a part at its "=".
-- returns  the bus or nil, the text of the IDs or nil, and the text behind the "="
local function split_part(part)
  local address, value = part:match("^(.-)%s*=(.*)$")
  demand(address, 'no "="', SHAPE)
  value = reveal(value)
  local begins_with_id = address:find("^[%d+-]") and not address:find("^" .. IPV4)
  if begins_with_id and not address:find("/", 1, true) then return nil, address, value end
  local bus, ids = address:match("^(.*)/([^/]*)$")
  bus = trim(bus or address)
  if bus:sub(1, 1) == '"' then
    local quoted = bus:match('^"(.*)"$')
    demand(quoted, 'no "/" or "=" behind the quotes', SHAPE)
    bus = reveal(quoted):gsub('""', '"')
  end
  demand(bus ~= "", "no bus or ID", SHAPE)
  return bus:match("^%[([^]]+)%]$") or bus, ids, value -- [fe80::1] is fe80::1
end

local function parse_id(text)
  local digits = trim(text)
  local id = (digits:find("^%d+$") or digits:find("^0[xX]%x+$")) and tonumber(digits)
  demand(id and id <= input.MAX_ID, ('no ID "%s"'):format(digits), "IDs are 0 to 0x7FF")
  return id
end

-- Return a list of ranges { first, last }; of a single ID both are the same.
local function parse_ids(text)
  local ranges = {}
  for part in (text .. "+"):gmatch("([^+]*)%+") do
    local first, last = part:match("^([^-]+)%-([^-]+)$")
    local range = { parse_id(first or part), parse_id(last or part) }
    demand(range[1] <= range[2], ('no ID in "%s"'):format(trim(part)), "write the lower ID first")
    ranges[#ranges + 1] = range
  end
  return ranges
end

-- Return the names of the IDs of each range, M1..M4 for four; nil for a name without "..".
local function expand_names(name, ranges)
  local stem, first, other, last = name:match("^(.-)(%d+)%.%.(.-)(%d+)$")
  if not stem or stem ~= other or #last > 4 then return nil end
  local names, shape = {}, "%s%0" .. #first .. "d" -- M08..M11 are M08, M09, M10, M11
  for number = tonumber(first), tonumber(last) do names[#names + 1] = shape:format(stem, number) end
  for _, range in ipairs(ranges) do
    local count = range[2] - range[1] + 1
    demand(#names == count, ("number of names is %d, of IDs %d"):format(#names, count),
      "write one name for each ID: 0x210-0x213=M1..M4")
  end
  return names
end

-- Read what a part says of its IDs: "motor:left" or "left".
-- returns  the message type and the name, nil for each that it does not give
local function parse_value(value, ids, catalogue)
  local message_name, name = value:match("^(.-):(.*)$")
  name = trim(name or value)
  demand(name == "" or input.is_text(name), "a name that cannot be shown", "use letters")
  if not message_name then
    demand(name ~= "", "no name", SHAPE)
    return nil, name
  end
  demand(ids, "a message for a whole bus", "name its ID, too")
  message_name = trim(message_name)
  local message_type, known = input.find(catalogue.messages, message_name)
  local problem = ('no message "%s"'):format(message_name)
  demand(message_type, problem, "known messages: " .. (known or ""))
  return message_type, name ~= "" and name or nil
end

-- Add a row for an ID, or for all of a bus; return whether an earlier part has it.
local function add_row(self, bus, id, message_type, name)
  local rows = self.by_bus[bus or false]
  if rows[id or "every"] then return true end
  local row = { bus = bus, id = id, type = message_type, name = name }
  rows[id or "every"] = row
  self.rows[#self.rows + 1] = row
end

-- Add the rows of a part; raise if an earlier part has one.
local function add_part(self, part, catalogue)
  local bus, ids, value = split_part(part)
  local ranges = ids and parse_ids(ids)
  local message_type, name = parse_value(value, ids, catalogue)
  local names = ranges and expand_names(name or "", ranges)
  local is_repeated = not ranges and add_row(self, bus, nil, nil, name)
  for _, range in ipairs(ranges or {}) do
    for id = range[1], range[2] do
      local own = names and names[id - range[1] + 1] or name
      is_repeated = add_row(self, bus, id, message_type, own) or is_repeated
    end
  end
  demand(not is_repeated, "a bus and ID once more", "the first part that names them holds")
end

--- Return the address of an ID, the text before the "=" of a part: can1/0x210, "a,b"/0x210.
-- bus  name, or nil; id = message ID
function M.address_text(bus, id)
  if bus and bus:find('[,="%s]') then bus = '"' .. bus:gsub('"', '""') .. '"' end
  return ("%s0x%x"):format(bus and bus .. "/" or "", id)
end

--- Read the preference.
-- text       of the user
-- catalogue  compiled
-- returns    the sources; and a list of errors: a part that cannot be read is left out, the others
--            hold
function M.parse(text, catalogue)
  local by_bus, problems = memo(function() return {} end), {} -- [bus or false][ID] = a row
  local self = setmetatable({ by_bus = by_bus, rows = {} }, Sources)
  local hidden = text:gsub('"[^"]*"', hide)
  for piece in hidden:gmatch("[^,]+") do
    local part = trim(piece)
    local ok, wrong = true, nil
    if part ~= "" then ok, wrong = pcall(add_part, self, part, catalogue) end
    if not ok then
      local shape = 'yapp.sources: %s in "%s"; %s'
      local problem = shape:format(wrong.problem, reveal(part), wrong.advice)
      problems[#problems + 1] = utf8.printable(problem)
    end
  end
  return self, problems
end

-- Return a name that a bus has together with others, nil for none: ttyS0 of ttyS0#rx, usb1.6 of
-- usb1.6.1, the address of a sender of UDP or TCP without its port.
local function name_above(bus)
  return bus:match("^(.+)#[rt]x$") or bus:match("^(usb%d+%.%d+)%.%d+$") or
    bus:match("^(" .. IPV4 .. "):%d+$") or bus:match("^%[(.+)%]:%d+$")
end

-- Return the rows by ID that hold for a bus: a list, those of its own name first.
local function rows_of(self, bus, interface)
  local list = {}
  while bus do
    list[#list + 1], bus = self.by_bus[bus], name_above(bus)
  end
  if interface then list[#list + 1] = self.by_bus[interface] end
  return list
end

--- Find what the user says of a source: the part about its ID on its bus, else about its ID
-- anywhere.  Its name is that of its ID on its bus, of its bus, or of its ID anywhere.
-- bus        the name that the capture gives it, or nil
-- id         message ID
-- interface  of a sender in UDP or TCP: the name of the interface, or nil
-- returns    the message type, the name, the row of Sources:list; each nil for none
function Sources:find(bus, id, interface)
  local row, name = nil, nil
  for _, rows in ipairs(rows_of(self, bus, interface)) do
    row = row or rows[id]
    name = name or rows[id] and rows[id].name or rows.every and rows.every.name
  end
  row = row or self.by_bus[false][id]
  return row and row.type, name or row and row.name, row
end

--- Return whether a part is about an ID on a bus, or on a bus with a name that includes that one.
-- bus  name, nil for a part without a bus
function Sources:has_part(bus, id)
  local row = select(3, self:find(bus, id))
  return row ~= nil and (row.bus ~= nil or not bus)
end

--- Return whether a part names a bus, itself and not one that includes it.
function Sources:names_bus(bus)
  return next(self.by_bus[bus]) ~= nil
end

--- Return all that was read: a list of { bus = name or nil, id = nil for all of a bus, type =
-- message type or nil, name = or nil }.
function Sources:list()
  return self.rows
end

return M
