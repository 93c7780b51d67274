-- SPDX-License-Identifier: GPL-2.0-or-later
-- Random CAN frames: messages of several buses that interleave, good and damaged in every way.
local words = require("can_words")

local M = {}

local FD = { 8, 12, 16, 20, 24, 32, 48, 64 }
local IDS = { { 0x210, 32 }, { 0x200, 17 }, { 0x123, 40 }, { 0x210, 34 } } -- with a usual size

-- The frames of a message, { CAN CTRL, data }; some of CAN FD with padding.
local function message_of(random, id, size)
  local bytes, step = {}, random(6) == 1 and 64 or 8
  for i = 1, size do
    bytes[i] = string.char(random(12) == 1 and random(256) - 1 or 65 + random(2))
  end
  local payload = table.concat(bytes)
  local frames = { { 1, words.start(id.id, payload,
    { ctl = id.ctl, seq = id.seq, wrong = random(30) == 1,
    reserved = random(30) == 1 and 5 or nil, size = random(40) == 1 and random(70) - 1 or nil }) } }
  for at = 1, size, step do
    local data = payload:sub(at, at + step - 1)
    for _, length in ipairs(step == 64 and FD or {}) do
      if length >= #data then
        data = data .. ("\0"):rep(length - #data)
        break
      end
    end
    frames[#frames + 1] = { at + step > size and 3 or 2, data }
  end
  return frames
end

local DAMAGE = {
  function(frames, at) table.remove(frames, at) end,                                -- lost
  function(frames, at) table.insert(frames, at, frames[at]) end,                    -- came twice
  function(frames, at) table.insert(frames, at, { 2, "strangers" }) end,            -- too many
  function(frames, at) frames[at] = { frames[at][1], frames[at][2]:sub(1, 3) } end, -- short
  -- cut by the capture
  function(frames, at) frames[at] = { frames[at][1], frames[at][2], 3 } end,
  function(frames, at) frames[at] = { frames[at][1], "?" .. frames[at][2]:sub(2) } end,
  -- no CAN CTRL that is defined
  function(frames, at) frames[at] = { 4 + at % 12, frames[at][2] } end,
  function(frames, at) for _ = 1, at do table.insert(frames, 1, frames[1]) end end, -- new Starts
  function(frames, at) for _ = at, #frames do table.remove(frames) end end,         -- cut off
  function(frames) table.insert(frames, { 0, "single" }) end,
}

--- Frames of one or several buses, some of them lost, damaged, twice.
-- returns  list of frames as can_words.visit takes them
function M.frames(random)
  local streams, accepts_all = {}, random(3) == 1
  for bus = 1, random(3) do
    streams[bus] = {}
    for _ = 1, 2 + random(8) do
      local kind = IDS[random(#IDS)]
      local id = { id = kind[1], ctl = accepts_all and random(9) == 1 and 7 or 0,
        seq = random(9) == 1 and 3 or 0 }
      local frames = message_of(random, id, random(4) == 1 and 8 + random(60) or kind[2])
      if random(2) == 1 then DAMAGE[random(#DAMAGE)](frames, random(#frames)) end
      for _, frame in ipairs(frames) do
        table.insert(streams[bus], { can_id = words.can_id(id.id, frame[1], id.ctl, id.seq),
          reported = #frame[2],
          data = frame[2]:sub(1, frame[3] or -1), bus = bus, accepts_all = accepts_all })
      end
    end
  end
  local list = {}
  while #streams > 0 do
    local at = random(#streams)
    for _ = 1, random(3) do
      list[#list + 1] = table.remove(streams[at], 1)
      list[#list].number = #list
      if not streams[at][1] then
        table.remove(streams, at)
        break
      end
    end
  end
  return list
end

return M
