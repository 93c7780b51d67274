-- SPDX-License-Identifier: GPL-2.0-or-later
-- The archive says the same of a look at any later time: held against tables that keep all as it was written.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local archive = require("yapp.base.archive")
local levels = require("levels")

local T = {}

local random = math.random
local unpack = rawget(table, "unpack")

local function text_of(length)
  local list = {}
  for i = 1, length do list[i] = string.char(random(0, 255)) end
  return table.concat(list)
end

-- A delta to the nanosecond, some at the limits of what a note has room for.
local DELTAS = { 0, 1e-9, -1e-9, 0.1, 86400, 140737, 140738, 1e9, -5 }
local function some_delta()
  if random(3) == 1 then return DELTAS[random(#DELTAS)] end
  return random(0, 2000000) / 1e6
end

-- The head of a text to which looks before it belong: those that nobody else has, and its own.
local function head_of(truth, look)
  local distances = { 0 }
  for distance = 1, random(archive.MAX_DISTANCE) do
    local before = look - distance
    if before >= 0 and not truth[before] and random(20) == 1 then
      truth[before], distances[#distances + 1] = { last = look }, distance
    end
  end
  return string.char(#distances, unpack(distances))
end

-- Writes looks in order, of which some are missing, and now and then an older one once more.
local function written(count, has_groups)
  local kept, truth, look = archive.new(has_groups), {}, 0
  for _ = 1, count do
    look = look + (random(50) == 1 and random(2000) or random(20) == 1 and 0.25 or random(3))
    local at = random(40) == 1 and look > 1200 and look - random(1000) or look
    if has_groups and truth[at] and (truth[at].last or type(truth[at].extra) == "string") then at = look end
    local old, row = truth[at], {}
    if random(2) == 1 then
      row.extra = random(4) == 1 and 2 ^ 32 - 1 or random(0, 2 ^ 29)
    else
      row.extra = (has_groups and at == look and head_of(truth, look) or has_groups and "\0" or "") ..
        text_of(random(50) == 1 and 65000 or random(0, 60))
    end
    kept.extras[at], kept.deltas[at], kept.faulty[at] = row.extra, nil, nil
    if old then
      row.is_again = true
    else -- as for messages: a look ends one, once
      row.delta, row.is_faulty = random(5) > 1 and some_delta() or nil, random(4) == 1
      kept.deltas[at], kept.faulty[at] = row.delta, row.is_faulty or nil
    end
    truth[at] = row
    if look >= kept.due then kept:pack(look) end
  end
  return kept, truth, look
end

-- Holds a look against what was written.
local function check(kept, look, row, message)
  lu.assertEquals(kept:get(look), row.extra, message)
  if row.last then
    lu.assertEquals(kept:last_of(look), row.last, message)
  elseif not row.is_again then
    lu.assertEquals(kept:is_faulty(look), row.is_faulty or false, message)
    local delta = kept:delta(look)
    lu.assertEquals(delta ~= nil, row.delta ~= nil, message)
    if delta then lu.assertAlmostEquals(delta, row.delta, 1e-10, message) end
  end
end

function T.test_as_written()
  for seed = 1, levels.size(6, 100) do
    math.randomseed(seed)
    local has_groups = seed % 2 == 0
    local kept, truth, last = written(1000, has_groups)
    local looks = {}
    for look in pairs(truth) do looks[#looks + 1] = look end
    table.sort(looks)
    for i = 1, 2 * #looks do -- first in order, then in any
      local look = looks[i] or looks[random(#looks)]
      check(kept, look, truth[look], ("seed %d, look %s"):format(seed, look))
    end
    for look = 0, last do
      if not truth[look] then
        local found = kept:get(look) or has_groups and kept:last_of(look) or nil
        lu.assertNil(found, ("seed %d, look %d"):format(seed, look))
      end
    end
  end
end

-- What it is for: of a long capture next to nothing stays in tables.
function T.test_is_packed()
  local kept = archive.new(true)
  for look = 5, 100000, 5 do
    kept.extras[look], kept.deltas[look] = "\5\0\1\2\3\4" .. ("x"):rep(40), 0.001
    if look >= kept.due then kept:pack(look) end
  end
  for _, name in ipairs { "extras", "deltas" } do
    local count = 0
    for _ in pairs(kept[name]) do count = count + 1 end
    lu.assertTrue(count < 120, name .. ": " .. count)
  end
  local bytes = 0
  for _, block in pairs(kept.blocks) do bytes = bytes + #block end
  lu.assertTrue(bytes < 100000 * 12, "bytes: " .. bytes)
end

return T
