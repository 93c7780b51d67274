-- SPDX-License-Identifier: GPL-2.0-or-later
-- What is kept of the packets of one pass over byte streams and datagrams, by number of the packet and place in it.
-- Pure Lua, 5.2 and 5.4.
--
-- In the archive: of a packet that is one good frame its place, and of most others their piece as a text.  In pieces,
-- by number: a piece that may still change, or that a text has no room for; one more of the same packet is in `other`.

local archive = require("yapp.base.archive")
local serial_piece = require("yapp.serial.piece")

local M = {}

local Kept = {}
Kept.__index = Kept

--- Nothing is known yet.  It has archive, whose deltas are those of packets that are one good frame.  And is_only_pass,
-- to be set: whether nobody will look at a packet again.
function M.new()
  return setmetatable({ archive = archive.new(), pieces = {} }, Kept)
end

--- Whether anything is known of the newest packet.
function Kept:has(number)
  return self.archive.extras[number] ~= nil or self.pieces[number] ~= nil
end

-- Makes room for a packet, before anything is written of it: what is old is packed, or in the only pass goes.
local function make_room(self, number)
  local kept = self.archive
  if number < kept.due then return end
  if self.is_only_pass then kept:forget(number) else kept:pack(number) end
end

--- A packet that is one good frame.
-- place  of its bytes
function Kept:keep_place(number, place)
  make_room(self, number)
  self.archive.extras[number] = place
end

-- Nothing is known any more of a piece: a packet that a read filter rejected had the same number.
local function drop(self, number, place)
  local kept = self.archive
  if kept.extras[number] == place then kept.extras[number], kept.deltas[number] = nil, nil end
  local before, piece = nil, self.pieces[number]
  while piece and piece.place ~= place do before, piece = piece, piece.other end
  if not piece then return end
  if before then before.other = piece.other else self.pieces[number] = piece.other end
end

--- Any packet.
-- piece    of serial.memory; fact: of its packet
-- returns  whether it is kept as one good frame: then the piece is not needed
function Kept:keep(piece, fact)
  local number, place, event = fact.number, fact.place, piece.events[1]
  make_room(self, number)
  if self.is_only_pass then return false end
  drop(self, number, place)
  if event and event.good and event.from == piece.base and event.to - event.from == #fact.bytes and
    not self.archive.extras[number] then
    self:keep_place(number, place)
    return true
  end
  piece.place, piece.number, piece.other = place, number, self.pieces[number]
  self.pieces[number] = piece
  return false
end

--- Pieces that nothing changes any more become texts.  One of the number that may come again (-R) waits; one that has
-- been dropped, or is not the only piece of its packet, is let be.
-- settled  list of pieces: gets those that wait
function Kept:settle(settled, number)
  local count, waiting, kept = #settled, 0, self.archive
  for i = 1, count do
    local piece = settled[i]
    local at, is_only = piece.number, self.pieces[piece.number] == piece and not piece.other
    settled[i] = nil
    if at == number and is_only then
      waiting = waiting + 1
      settled[waiting] = piece
    elseif is_only and not self.is_only_pass and not kept:get(at) then
      local text = serial_piece.pack(piece)
      if text then self.pieces[at], kept.extras[at] = nil, text end
    end
  end
end

--- What is known of a packet.
-- returns  its piece, nil for none; or nil and true for one good frame
function Kept:recall(number, place)
  local extra = self.archive:get(number)
  if extra == place then return nil, true end
  local piece = type(extra) == "string" and serial_piece.unpack(extra, number) or self.pieces[number]
  while piece and piece.place ~= place do piece = piece.other end
  return piece
end

return M
