-- SPDX-License-Identifier: GPL-2.0-or-later
-- The preference yapp.sources: which names the user gave to sources.  Pure Lua.
--
--   0x210=motor:left_fore, can1/0x210=motor:right_fore, can0/0x210+0x200+0x000=left, can2=tail
--   0x213=motor:, can0/0x210-0x213=motor:M1..M4
--
-- A part is [BUS/]ID[+ID...]=[MESSAGE:]NAME, or BUS=NAME for every ID of a bus.  A range of IDs may
-- stand for an ID, 0x210-0x213; its names count up, M1..M4.  ID is decimal, or 0x and hexadecimal.
-- MESSAGE is the catalogue's short name of what the ID carries.  A part without BUS is for each bus
-- without a part of its own.  BUS is the name that statistics print, or one that it has together
-- with others, see name_above.  The last "/" ends the bus: vcan/0/0x210 is ID 0x210 on vcan/0.

local input = require "yapp.base.input"
local memo = require "yapp.base.memo"

local Sources = {}
Sources.__index = Sources

local demand, trim = input.demand, input.trim

local IPV4 = "%d+%.%d+%.%d+%.%d+"

local function parse_id(text)
  local digits = trim(text)
  local id = (digits:find("^%d+$") or digits:find("^0[xX]%x+$")) and tonumber(digits)
  return demand(id and id <= input.MAX_ID and id, "no ID %q; IDs are 0 to 0x7FF", digits)
end

-- Return the name of an ID in a range: of M1..M4 M1, M2, M3, M4.
-- step   from the first ID of the range
-- steps  from there to the last one
local function nth_name(name, step, steps)
  local stem, first, last = (name or ""):match("^(.-)(%d+)%.%.%1(%d+)$")
  if not stem then return name end
  demand(last - first == steps, "%d names for %d IDs; write one name for each ID: " ..
    "0x210-0x213=M1..M4", last - first + 1, steps + 1)
  return ("%s%0" .. #first .. "d"):format(stem, first + step) -- M08..M11 are M08, M09, M10, M11
end

-- Add a row for an ID, or for all of a bus.
local function add_row(self, bus, id, message_type, name)
  local rows = self.by_bus[bus or false]
  demand(not rows[id or "every"], "a bus and ID once more; the first part that names them holds")
  local row = { bus = bus, id = id, type = message_type, name = name }
  rows[id or "every"] = row
  self.rows[#self.rows + 1] = row
end

-- Return the message type and the name of a part, nil for each that it does not give.
-- value  "motor:left", "motor:" or "left"
local function parse_value(value, catalogue)
  local message_name, name = value:match("^(.-)%s*:%s*(.*)$")
  if not name then return nil, value end
  local message_type, known = input.find(catalogue.messages, message_name)
  demand(message_type, "no message %q; known messages: %s", message_name, known)
  return message_type, name ~= "" and name or nil
end

-- Add the rows of a part.
local function add_part(self, part, catalogue)
  local address, value = part:match("^([^=]*[^=%s])%s*=%s*([^=]+)$")
  demand(address, "a part that is not understood; write [BUS/]ID=[MESSAGE:]NAME or BUS=NAME")
  local message_type, name = parse_value(value, catalogue)
  local bus, ids = address:match("^(.-)%s*/([^/]*)$")
  if not bus then
    local is_id = address:find("^%d") and not address:find("^" .. IPV4)
    if is_id then ids = address else bus = address end
  end
  bus = bus and bus:gsub("^%[(.*)%]$", "%1") -- [fe80::1] is fe80::1
  if not ids then
    demand(not message_type, "a message for a whole bus; name its ID, too")
    return add_row(self, bus, nil, nil, name)
  end
  for range in (ids .. "+"):gmatch("([^+]*)%+") do
    local first, last = range:match("^(.+)%-(.+)$")
    first, last = parse_id(first or range), parse_id(last or range)
    demand(first <= last, "no ID in %q; write the lower ID first", trim(range))
    for id = first, last do
      add_row(self, bus, id, message_type, nth_name(name, id - first, last - first))
    end
  end
end

--- Read the preference.
-- text       of the user
-- catalogue  compiled
-- returns    the sources; and a list of errors: a part that cannot be read is left out, the others
--            hold
function Sources.parse(text, catalogue)
  local self, problems = setmetatable({
    -- The parts: a list of { bus = name or nil, id = nil for all of a bus, type = message type or
    -- nil, name = or nil }.
    rows = {},
    by_bus = memo(), -- [bus or false][ID or "every"] = a row
  }, Sources), {}
  for piece in text:gmatch("[^,%s][^,]*") do
    local part = trim(piece)
    local ok, wrong = pcall(add_part, self, part, catalogue)
    if not ok then
      local problem, advice = wrong:match("^(.-)(; .*)$")
      problems[#problems + 1] = ('yapp.sources: %s in "%s"%s'):format(problem, part, advice)
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

--- Find what the user says of a source: the part about its ID on its bus, else about its ID
-- anywhere.  Its name is that of its ID on its bus, of its bus, or of its ID anywhere.
-- bus      the name that the capture gives it, or nil
-- id       message ID
-- returns  the message type, the name, the row of the part; each nil for none
function Sources:find(bus, id)
  local row, name = nil, nil
  while bus do
    local rows = self.by_bus[bus]
    row = row or rows[id]
    name = name or rows[id] and rows[id].name or rows.every and rows.every.name
    bus = name_above(bus)
  end
  row = row or self.by_bus[false][id]
  return row and row.type, name or row and row.name, row
end

--- Return whether a part names a bus, itself and not one that includes it.
function Sources:names_bus(bus)
  return next(self.by_bus[bus]) ~= nil
end

return Sources
