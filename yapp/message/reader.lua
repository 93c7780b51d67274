-- SPDX-License-Identifier: GPL-2.0-or-later
-- What a finished message means: its values, and what changed in its source.  Pure Lua.  Dissectors
-- bring messages; the tree and the statistics get them here.

local compiler = require "yapp.message.catalogue"
local decode = require "yapp.message.decode"

local M = {}

-- Such a message lacks bytes, or has too many, at an unknown offset.
local IS_BROKEN = { incomplete = true, overrun = true }

local Reader = {}
Reader.__index = Reader

--- Make a reader.
-- catalogue  compiled
-- intake     a stat.intake, which gets messages while it is wanted
function M.new(catalogue, intake)
  return setmetatable({
    messages = catalogue.messages,
    intake = intake,
    by_id = catalogue.by_id, -- [id] = message, see Reader:use; file readers may ask before
    sources = nil, -- the names that the user gave, see Reader:use
    several_ids = nil, -- [message] = whether more than one ID carries it
    hides_source = nil, -- see Reader:use
    has_several = false, -- see Reader:reset
    hinted = {}, -- [id of an unknown message] = the frame key whose Info has the whole advice
  }, Reader)
end

--- Forget the capture file.
-- has_several  whether the next one has several buses: then the name of a source includes its bus
function Reader:reset(has_several)
  self.hinted, self.has_several = {}, has_several
end

--- Use the user's choice of IDs and names.
-- by_id         { [id] = compiled message }
-- sources       a message.sources
-- hides_source  whether a label leaves out the source
-- visit         function(id), called for each ID that carries a message
function Reader:use(by_id, sources, hides_source, visit)
  self.by_id, self.sources, self.hides_source = by_id, sources, hides_source
  local first, several = {}, {}
  local function count(message, id)
    visit(id)
    first[message] = first[message] or id
    if first[message] ~= id then several[message] = true end
  end
  for _, row in ipairs(sources:list()) do
    if row.message then count(row.message, row.id) end
  end
  for id in pairs(by_id) do count(self:message_of(id), id) end
  self.several_ids = several
end

--- Return the message of the catalogue that an ID carries on a bus, nil for none.
-- bus        name, nil where the capture has none
-- interface  of a sender in UDP or TCP, or nil
function Reader:message_of(id, bus, interface)
  return self.sources and self.sources:message(bus, id, interface) or self.by_id[id]
end

--- Return the payload size of that message and the smallest that it may have, nil for none.
function Reader:size_of(id)
  local message = self:message_of(id)
  if message then return message.size, message.min_size end
end

-- Return what a message is called: its title and the name of its source.  Without a name, the ID or
-- bus follows if it tells the source from others: "Motor Data left", "Motor Data 0x212 (can1)",
-- "Motor Data", "ID 0x123".  With hides_source it is the title.
local function label_of(self, message, name, id, bus)
  local number, needs_bus = ("0x%x"):format(id), self.has_several and bus
  local title, suffix = "ID " .. number, ""
  if message then title, suffix = message.title, " " .. number end
  local is_usual = not message or id == message.id and not self.several_ids[message]
  if self.hides_source or is_usual and not (name or needs_bus) then return title end
  if name then return title .. " " .. name end
  return title .. suffix .. (bus and (" (%s)"):format(bus) or "")
end

--- Make a source, which is a bus or stream, and an ID.
-- bus_key  of the bus or stream, or false
-- bus      its name, nil if the capture names none
-- line     of a stream, see serial.dissector; nil on CAN
-- returns  {
--   id, bus, bus_key, line
--   name      that the user gave it, or nil
--   message   that it carries, compiled, or nil; size, min_size = of its payload, or nil
--   label     what its messages are called in Info
--   text      for the column Source: the name, else what tells the source from others, and the ID
--   texts     of the fragments of its messages, see can.dissector }
function Reader:new_source(id, bus_key, bus, line)
  local interface = line and line.interface or nil
  local message = self:message_of(id, bus, interface)
  local name = self.sources:name(bus, id, interface)
  local before = line and line.label or not line and self.has_several and bus
  return {
    id = id,
    bus = bus,
    bus_key = bus_key,
    line = line,
    name = name,
    message = message,
    size = message and message.size,
    min_size = message and message.min_size,
    label = label_of(self, message, name, id, bus),
    text = name or (before and before .. " " or "") .. ("0x%x"):format(id),
    texts = {},
  }
end

--- Return what to say of a message that is not in the catalogue; if one of its size is, also which
-- preference decodes it.
-- m        a message, as for Reader:read
-- returns  a text for the packet; and, if one is, what the Info column adds, and its name
function Reader:hint(m)
  local id = m.source.id
  local text = ("Message ID 0x%x is not in the catalogue"):format(id)
  local same = m.status == "good" and compiler.of_size(self.messages, m.size)[1]
  if not same then return text end
  local size = "the size of " .. same.title
  local advice = (': see the preference "%s message IDs"'):format(same.title)
  text = ("%s; %d bytes, %s%s"):format(text, m.size, size, advice)
  self.hinted[id] = self.hinted[id] or m.key
  if self.hinted[id] ~= m.key then advice = "" end
  return text, ", " .. size .. advice, same.name
end

-- Set the change, the delta and the state of a message, from the history.
local function ask(m, history, wants)
  m.change, m.delta, m.state = false, false, false
  if m.is_unreliable then return end
  local change, delta
  if m.visited then
    change, delta = history:change(m)
  else
    change, delta = history:note(m, wants.is_only_pass)
  end
  m.change, m.delta = change or false, delta or false
  if delta == nil or change and change.unreliable then m.is_unreliable = true end
  m.state = wants.state and history:state(m) or false
end

--- Read a finished message, for show.tree and stat.intake.
-- m  {
--   source         of Reader:new_source
--   seq, size      as its header says; payload = the bytes of it that came
--   key            frame key; time = seconds since the first packet; visited
--   status         "good" if it is proved complete; "bad" (CRC); "truncated" by the capture;
--                  "incomplete"; "overrun"
--   is_unreliable  whether its history is not known, as nothing tells the bus }, and gets
--   raws, is_remarkable  from message.read, if the size fits: min_size of the message at least,
--                  and more than its size only of a good one
--   undecoded      number of payload bytes behind the message's size, nil for none
--   has_fault      whether a fault flag is set
--   change         what changes with it, or false (see message.history)
--   delta          seconds since the source's previous good one, or false
--   state          state at the message, or false (see message.history)
--   is_unreliable  true if controllers share its source, or if it was unreliable before its revisit
-- history  a message.history
-- wants    of Tree:wants
-- returns  whether its bytes have known offsets: false of an incomplete or overrun one
function Reader:read(m, history, wants)
  local message, is_broken, raws, is_remarkable = m.source.message, IS_BROKEN[m.status], nil, nil
  local is_longer = message and m.size > message.size
  if message and not is_broken and m.size >= message.min_size and
    (m.status == "good" or not is_longer) then
    raws, is_remarkable = message.read(m.payload)
  end
  m.raws, m.is_remarkable = raws, is_remarkable
  m.undecoded = raws and is_longer and m.size - message.size or nil
  m.has_fault = is_remarkable and decode.has_alarm(message, raws)
  ask(m, history, wants)
  if self.intake.wanted then self.intake:message(m) end
  return not is_broken
end

return M
