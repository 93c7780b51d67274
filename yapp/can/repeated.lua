-- SPDX-License-Identifier: GPL-2.0-or-later
-- CAN may deliver a frame twice (its sender did not see the acknowledgement): which Middles of a message that is too
-- long are there once too often.  Pure Lua, 5.2 and 5.4.  The CRC is the proof; nothing is left out without it.

local M = {}

-- Runs of the same bytes: { first = index of the first frame, spare = how many of it may be left out, length = bytes }.
-- The last chunk is the End's: it ends the message the first time.
local function runs_of(chunks, parts)
  local runs, i = {}, 1
  while i < parts do
    local first = i
    while i + 1 < parts and chunks[i + 1] == chunks[first] do i = i + 1 end
    if i > first then runs[#runs + 1] = { first = first, spare = i - first, length = #chunks[first] } end
    i = i + 1
  end
  return runs
end

-- Tries every way to leave frames out, the fewest of the earliest runs first; leave[i] is how many of run i.
-- returns  whether one is good; nil when it costs too much to know
local function search(hunt, at, excess)
  local run = hunt.runs[at]
  if not run then return hunt.is_good(excess) end
  if not hunt.reassembly:spend(1) then return nil end
  for count = 0, run.spare do
    local rest = excess - count * run.length
    if rest < 0 then break end
    hunt.leave[at] = count
    local found = search(hunt, at + 1, rest)
    if found ~= false then return found end
  end
  hunt.leave[at] = 0
  return false
end

-- The chunks that are left, the looks of their frames, and those of the frames left out.
local function without(message, hunt)
  local is_out, chunks, looks, out = {}, {}, { message[1] }, {}
  for i, run in ipairs(hunt.runs) do
    for k = 1, hunt.leave[i] do is_out[run.first + k] = true end -- the first of a run stays
  end
  for i = 1, message.parts do
    if is_out[i] then
      out[#out + 1] = message[i + 1]
    else
      chunks[#chunks + 1], looks[#looks + 1] = message.chunks[i], message[i + 1]
    end
  end
  return chunks, looks, out
end

--- Leaves out of a message that is too long the frames that are there twice, if it is good without them.
-- reassembly  gives seed, spend, crc, can_id, kept
-- message     with all its frames, the last one just come
-- frame       that last one
-- returns     the bytes of padding in it when the message is good now, else nil and the message is as it was
function M.take_out(reassembly, message, frame)
  local hunt = { reassembly = reassembly, runs = runs_of(message.chunks, message.parts), leave = {} }
  local excess, padding = message.received - message.size, nil
  function hunt.is_good(rest)
    padding = reassembly.can_id.padding(frame.data, frame.reported, frame.reported - rest)
    if not padding then return false end
    if not reassembly:spend(message.parts) then return nil end
    local payload = table.concat((without(message, hunt))):sub(1, message.size)
    return reassembly.crc.update(reassembly:seed(message), payload) == message.crc
  end
  if excess <= 0 or not search(hunt, 1, excess) then return nil end
  local chunks, looks, out = without(message, hunt)
  for i = 1, message.count do message[i] = looks[i] end
  message.chunks, message.parts, message.count, message.duplicates = chunks, #chunks, #looks, #out
  message.received = message.size + padding
  for _, look in ipairs(out) do reassembly.kept:duplicate(look, message) end
  return padding
end

return M
