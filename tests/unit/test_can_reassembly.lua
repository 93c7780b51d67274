-- SPDX-License-Identifier: GPL-2.0-or-later
-- Reassembly where it is known on which bus a frame was: each rule by itself, as text: "S32 M8 M8 M8 E8" is a good
-- message of 32 bytes.
--
-- A word is a frame: [sender a, b, ...] S M E (Start, Middle, End), X (CAN CTRL 9) or L (single), a number, marks.
--   S32    a Start that says 32 bytes, with the right CRC for the sender's next payload
--   M8 E3  the next 8, or 3, bytes of that payload          L7   a single frame of 7 bytes
-- marks: ! wrong CRC, r reserved bytes 5 (the CRC covers them), /7 only 7 bytes long (or longer, with zeros),
--        ~4 only 4 bytes captured, ? bytes that nobody sent, p12 zeros up to 12 bytes, = the frame before it once more
-- Each sender has payloads of its own; all have the same key unless the test gives ids.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local can_id = require("yapp.wire.can_id")
local crc = require("yapp.wire.crc")
local levels = require("levels")
local reassembly = require("yapp.can.reassembly")
local little_endian = require("stream_generator").little_endian

local unpack = rawget(table, "unpack")
local bus = {} -- also for test_interleave

local KIND = { L = 0, S = 1, M = 2, E = 3, X = 9 }
bus.known = { [0x000] = 7, [0x200] = 17, [0x210] = 32 }

function bus.can_id(id, ctrl, ctl, seq)
  return id * 0x40000 + ctrl * 0x4000 + ctl * 0x100 + seq
end

--- The data of a Start.
function bus.start(id, ctl, seq, payload, options)
  options = options or {}
  local header = can_id.header({ id = id, ctl = ctl, seq = seq }, #payload, options.reserved)
  local sum = crc.of(header .. payload)
  if options.wrong then sum = require("yapp.base.bits").bxor(sum, 1) end
  return little_endian(sum, 4) .. little_endian(options.size or #payload, 2) .. little_endian(options.reserved or 0, 2)
end

--- A reassembler; with counts of the CRC steps in its field steps.
function bus.reassembler()
  local counted = setmetatable({}, { __index = crc })
  local state
  function counted.update(...)
    state.steps = state.steps + 1
    return crc.update(...)
  end
  state = reassembly.new({ can_id = can_id, crc = counted, can_frames = require("yapp.can.frames"),
    can_interleave = require("yapp.can.interleave"), can_repeated = require("yapp.can.repeated") },
    function(id) return bus.known[id] end)
  state.steps = 0
  return state
end

--- Gives a reassembler a frame: { can_id, look =, data =, reported = (as data), bus =, wide = }; returns its message.
function bus.frame(state, frame)
  frame.reported = frame.reported or #frame.data
  state:frame(can_id.address(frame[1]), frame)
  return (state.kept:entry(frame.look))
end

local function payload_of(sender, count, size)
  local bytes = {}
  for i = 1, size do bytes[i] = string.char((sender:byte() * 31 + count * 17 + i * i + i) % 255 + 1) end
  return table.concat(bytes)
end

-- One word: the kind, and the data on the bus and as captured.
local function frame(word, senders, ids)
  local name, kind, number, marks = word:match("^(%l?)([SMELX])(%d+)(.*)$")
  local sender = senders[name]
  if not sender then
    sender = { count = 0, payload = "", at = 1 }
    senders[name] = sender
  end
  local id = ids[name] or ids[""] or { 0x123, 0, 0 }
  number = tonumber(number)
  local data
  if kind == "S" then
    sender.count = sender.count + 1
    sender.payload, sender.at = payload_of(name .. "x", sender.count, number), 1
    data = bus.start(id[1], id[2], id[3], sender.payload,
      { wrong = marks:find("!", 1, true) and true, reserved = marks:find("r", 1, true) and 5 or nil })
  elseif marks:find("?", 1, true) then
    data = ("?"):rep(number)
  elseif marks:find("=", 1, true) then
    data = sender.payload:sub(sender.at - number, sender.at - 1)
  else
    data = sender.payload:sub(sender.at, sender.at + number - 1)
    data = data .. ("x"):rep(number - #data)
    sender.at = sender.at + number
  end
  local padded, length, captured = marks:match("p(%d+)"), marks:match("/(%d+)"), marks:match("~(%d+)")
  length = tonumber(padded or length or #data)
  data = data:sub(1, length) .. ("\0"):rep(length - #data)
  return bus.can_id(id[1], KIND[kind], id[2], id[3]), captured and data:sub(1, captured) or data, #data, name
end

local ALONE = { [0] = "single", "start", "orphan", "orphan" } -- by CAN CTRL

-- What a frame is, in words.
local function named(kept, number)
  local entry, alone = kept:entry(number)
  if alone then return ALONE[can_id.address(alone).ctrl] or "invalid" end
  if not entry then return "-" end
  return entry.last == number and entry.status or "part"
end

--- Sends frames; returns what each of them is, in words, and the reassembler.
-- text     words; ids: { [sender] = { id, ctl, seq } }
-- options  wide, buses (true: each sender has a bus of its own, which the capture tells), interface (true: all have the
--          same, and nothing else is told), ids
function bus.send(text, options)
  options = options or {}
  local state, senders, list, number = bus.reassembler(), {}, {}, 0
  for word in text:gmatch("%S+") do
    number = number + 1
    local id, data, reported, name = frame(word, senders, options.ids or {})
    state:frame(can_id.address(id), { look = number, data = data, reported = reported, wide = options.wide,
      bus = options.buses and ("_" .. name):byte(-1) or options.interface and 1 or nil, is_apart = options.buses })
    list[number] = named(state.kept, number)
  end
  for i = 1, number do
    local faults = {}
    for _, fault in ipairs(state.kept.faults[i] or {}) do faults[#faults + 1] = fault.expert end
    table.sort(faults)
    if #faults > 0 then list[i] = list[i] .. "+" .. table.concat(faults, "+") end
  end
  return table.concat(list, " "), state
end

-- The rules ---------------------------------------------------------------------------------------------------------

local T = { bus = bus }

local MOTOR, HEALTH, COMMAND = { [""] = { 0x210, 0, 0 } }, { [""] = { 0x200, 0, 0 } }, { [""] = { 0, 0, 0 } }

local function check(rows, options)
  for _, row in ipairs(rows) do
    local all = { buses = true }
    for _, more in ipairs { options or {}, row[3] or {} } do
      for k, v in pairs(more) do all[k] = v end
    end
    lu.assertEquals((bus.send(row[1], all)), row[2], row[1])
  end
end

function T.test_whole_messages()
  check {
    { "S32 M8 M8 M8 E8", "part part part part good" },
    { "S9 M8 E1", "part part good" },
    { "S9 E8 E1", "part short+fragment.incomplete -" },
    { "S32 M8 M8 M8 E8 S32 M8 M8 M8 E8", "part part part part good part part part part good" },
    { "S32 M4 M8 M8 M8 E4", "part part part part part good" }, -- any lengths that add up
    { "S32! M8 M8 M8 E8", "part part part part bad" },
    { "S65 M64 E1", "part part good" },
    { "S73 M64 E9p12", "part part good" },
    { "S40 E40p48", "part good" },
    { "S40 E40p64", "part overrun+fragment.overrun" }, -- 48 would have done
    { "S16 M8 E8/12", "part part overrun+fragment.overrun" },
  }
end

function T.test_what_breaks_is_named()
  check({
    { "S32 M8 M8 M8 E8 E8", "part part part part good orphan+fragment.orphan" },
    { "S32 S32 M8 M8 M8 E8", "part part+fragment.incomplete part part part good" },
    { "S32 M8 S32 M8 M8 M8 E8", "part part part+fragment.incomplete part part part good" },
    { "S32 M8 S32 M8 M8 E8", "part part part+fragment.incomplete part part short+fragment.incomplete" },
    { "S32 M8 M8 E8", "part part part short+fragment.incomplete" },
    { "S32 M8 M8 M8 M8 E8", "part part part part part overrun+fragment.overrun" },
    { "S32 M8 M8 M8 M8 M8 E8", "part part part part part part+fragment.overrun part+fragment.overrun" },
    { "S32 M8 M8 M8 M8 M8 S32 M8 M8 M8 E8",
      "part part part part part part+fragment.overrun part part part part good" },
    { "M8 M8 E8 S32 M8 M8 M8 E8", "orphan+fragment.orphan orphan+fragment.orphan orphan+fragment.orphan " ..
      "part part part part good" },
    { "S32 M8 M8? M8 E8", "part part part part bad" },
  }, { ids = MOTOR })
end

function T.test_malformed_starts()
  check({
    { "S32/7 M8", "start+fragment.incomplete orphan+fragment.orphan" },
    { "S32/1 E8", "start+fragment.incomplete orphan+fragment.orphan" },
    { "S32 M8 S32/7 M8", "part part start+fragment.incomplete+fragment.incomplete orphan+fragment.orphan" },
    { "S0 E8", "start+size.mismatch orphan+fragment.orphan" },
    { "S32r M8 M8 M8 E8", "part+reserved.nonzero part part part good" },
    { "S32/12 M8 M8 M8 E8", "part+size.mismatch part part part good" },
    { "S32/12~4 M8", "start+size.mismatch orphan+fragment.orphan" },
    { "S5 E5", "part good" },
    { "X8", "invalid+can.ctrl.invalid" },
    { "S32 X8? M8 M8 M8 E8", "part invalid+can.ctrl.invalid part part part good" },
  }, { wide = true })
  check({
    { "S33 M8 M8 M8 M8 E1", "part+size.mismatch part part part part good" },
    { "L32", "single" },
    { "L8", "single" },
  }, { wide = true, ids = MOTOR })
end

function T.test_cut_by_the_snap_length()
  check({
    { "S32 M8~3 M8 M8 E8", "part part part part unverified" },
    { "S32 M8 M8 M8 E8~0", "part part part part unverified" },
    { "S32~4 M8", "start orphan+fragment.orphan" },
    { "S32 M8 S32~4 M8", "part part start+fragment.incomplete orphan+fragment.orphan" },
    { "S32 M8~3 M8 E8", "part part part short+fragment.incomplete" },
    { "S32 M8~3 M8 M8 M8 M8", "part part part part part part+fragment.overrun" },
  }, { ids = MOTOR })
end

function T.test_only_what_is_surely_yapp_is_claimed()
  check {
    { "L8", "-" }, { "L7", "-" }, { "X8", "-" }, { "M8", "-" }, { "E8", "-" },
    { "S8 E8", "- -" },      -- would fit one frame
    { "S9/7", "-" }, { "S9/12", "-" }, { "S9~7", "-" },
    { "S9r", "-" }, { "S0", "-" },
    { "S9", "part" }, { "S9 M8 E1", "part part good" }, { "S65535", "part" },
    { "S9 M8 E1 E1", "part part good -" },
    { "L7", "single", { ids = COMMAND } }, { "L8", "-", { ids = COMMAND } }, { "L6", "-", { ids = COMMAND } },
    { "L32", "single", { ids = MOTOR } }, { "L8", "-", { ids = MOTOR } },
    { "L17p20", "single", { ids = HEALTH } }, { "L17p24", "-", { ids = HEALTH } },
    { "L7", "-", { ids = { [""] = { 0, 1, 0 } } } }, { "L7", "single", { ids = { [""] = { 0, 0, 255 } } } },
    { "M8 E1", "orphan+fragment.orphan orphan+fragment.orphan", { ids = MOTOR } },
    { "M8 E1", "- -", { ids = { [""] = { 0x210, 1, 0 } } } },
    { "S33 M8", "- orphan+fragment.orphan", { ids = MOTOR } },
    { "S32 M8 S33 M8 M8 E8", "part part - part part bad", { ids = MOTOR } },
    { "S9", "-", { ids = { [""] = { 0x123, 1, 0 } } } },
    { "aS9 aM8 aE1 bS9 bM8 bE1 aS9 aM8 aE1", "- - - part part good part part good", -- once the ID is known as YAPP's
      { ids = { a = { 0x123, 0, 9 }, b = { 0x123, 0, 0 } }, buses = false } },
    { "S32 M8", "part part", { ids = { [""] = { 0x210, 0, 9 } } } },
    { "X8", "-", { ids = MOTOR } },
  }
  check({ -- the user says that all is YAPP
    { "L8", "single" }, { "M8", "orphan+fragment.orphan" }, { "S9 M8 E1", "part part good" },
    { "S9 M8 E1", "part part good", { ids = { [""] = { 0x123, 63, 255 } } } },
  }, { wide = true })
end

function T.test_keys()
  for _, ids in ipairs {
    { a = { 0x210, 0, 0 }, b = { 0x210, 0, 1 } },   -- Seq
    { a = { 0x210, 0, 255 }, b = { 0x210, 1, 255 } }, -- YAPP CTL
    { a = { 0x210, 0, 0 }, b = { 0x211, 0, 0 } },   -- Msg ID
  } do
    check({ { "aS32 bS32 aM8 bM8 aM8 bM8 bM8 bE8 aM8 aE8", "part part part part part part part good part good" } },
      { ids = ids, wide = true, buses = false })
  end
  check { { "aS32 bS32 aM8 bM8 aM8 bM8 bM8 bE8 aM8 aE8", "part part part part part part part good part good" },
    { "aS32 bM8 aM8 bE8 aM8 aM8 aE8", "part - part - part part good" } } -- two buses
end

function T.test_faults_say_which_frames()
  local _, state = bus.send("S32 M8 M8 E8", { buses = true })
  lu.assertStrContains(state.kept.faults[4][1].text, "started in frame 1 ends with 24 of 32 bytes")
  _, state = bus.send("S32 M8 S32", { buses = true })
  lu.assertStrContains(state.kept.faults[3][1].text, "8 of 32 bytes")
end

-- A later look finds what the first one found.
function T.test_later_looks()
  for text, count in pairs { ["S32 M8 M8 M8 E8"] = 5, ["S32r M8 M8 M8 E8"] = 5, ["S73 M64 E9p12"] = 3,
    ["S1000 " .. ("M8 "):rep(124) .. "E8"] = 126 } do
    local _, state = bus.send(text, { buses = true, wide = true })
    for number = 1, count do
      local entry = state.kept:entry(number)
      lu.assertEquals({ entry.status, entry.last, entry.count }, { "good", count, count }, text)
      lu.assertEquals(#entry.payload, entry.size)
      for i = 1, count do lu.assertEquals(entry[i], i) end
    end
  end
end

function T.test_what_is_kept_of_a_message()
  for id, ids in pairs { [0x210] = MOTOR, [0x7FF] = { [""] = { 0x7FF, 63, 255 } } } do
    local _, state = bus.send("S32 M8 M8 M8 E8", { ids = ids, wide = true })
    local entry = state.kept:entry(2)
    lu.assertEquals(entry.address.id, id)
    lu.assertEquals(entry.crc, crc.of(can_id.header(entry.address, entry.size) .. entry.payload))
  end
end

-- CAN delivers a frame twice: proved by the CRC, on a bus that is told and on one that is not.
function T.test_a_frame_delivered_twice()
  local rows = {
    { "S32 M8 M8 M8= M8 E8", "part part part part+fragment.duplicate part good" },
    { "S32 M8 M8= M8 M8 E8", "part part part+fragment.duplicate part part good" },
    { "S32 M8 M8 M8 M8= E8", "part part part part part+fragment.duplicate good" },
    { "S32 M8 M8= M8 M8= M8 M8= E8",
      "part part part+fragment.duplicate part part+fragment.duplicate part part+fragment.duplicate good" },
    { "S32 M8 M8= M8= M8 M8 E8",
      "part part part+fragment.duplicate part+fragment.duplicate part part good" },
    { "S32! M8 M8= M8 M8 E8", "part part part part part overrun+fragment.overrun" }, -- the CRC proves nothing
    { "S32 M8 M8= M8? M8 E8", "part part part part part overrun+fragment.overrun" },
    { "S32 M8 M8 M8= E8", "part part part part bad" }, -- one lost, one twice: as long as it should be
  }
  check(rows, { ids = MOTOR })
  check(rows, { ids = MOTOR, buses = false })
  check { { "S41 M8 M8= M8 M8 M8 E9p12", "part part part+fragment.duplicate part part part good" } }
  check({ { "S32 S32 M8 M8= M8 M8 E8", "part part+fragment.incomplete part part+fragment.duplicate part part good" } },
    { ids = MOTOR, buses = false })
end

function T.test_a_frame_delivered_twice_belongs_to_its_message()
  local _, state = bus.send("S32 M8 M8 M8= M8 E8", { buses = true })
  local entry = state.kept:entry(4)
  lu.assertEquals({ entry.last, entry.count, unpack(entry, 1, 5) }, { 6, 5, 1, 2, 3, 5, 6 })
end

function T.test_the_search_for_repeated_frames_is_bounded()
  local state, zeros = bus.reassembler(), ("\0"):rep(8)
  local start = bus.start(0x123, 0, 0, "", { size = 8000 })
  bus.frame(state, { bus.can_id(0x123, 1, 0, 0), look = 1, bus = 1, data = start })
  for look = 2, 1000 do -- pairs of equal frames: each may be one too many
    local data = look % 4 < 2 and ("%08d"):format((look - look % 2) / 2) or zeros
    bus.frame(state, { bus.can_id(0x123, 2, 0, 0), look = look, bus = 1, data = data })
  end
  for look = 1001, 1006 do bus.frame(state, { bus.can_id(0x123, 2, 0, 0), look = look, bus = 1, data = zeros }) end
  local entry = bus.frame(state, { bus.can_id(0x123, 3, 0, 0), look = 1007, bus = 1, data = zeros })
  lu.assertEquals(entry.status, "overrun")
  lu.assertTrue(state.steps < 100)
end

-- Looks with fractions, as yapp_can_memory gives them.
function T.test_looks_that_are_no_numbers_of_frames()
  local state, payload = bus.reassembler(), ("x"):rep(16)
  local last = 7 + 2 * 2 ^ -21
  state.kept.has_fractions = true
  bus.frame(state, { bus.can_id(0x123, 1, 0, 0), look = 7, bus = 1, data = bus.start(0x123, 0, 0, payload) })
  bus.frame(state, { bus.can_id(0x123, 2, 0, 0), look = 7 + 2 ^ -21, bus = 1, data = payload:sub(1, 8) })
  local entry = bus.frame(state, { bus.can_id(0x123, 3, 0, 0), look = last, bus = 1, data = payload:sub(9) })
  lu.assertEquals({ entry.status, entry.last, state.kept:entry(7).last }, { "good", last, last })
  local start = bus.start(0x210, 0, 0, payload .. payload)
  bus.frame(state, { bus.can_id(0x210, 1, 0, 0), look = 12 + 2 ^ -21, bus = 1, data = start })
  bus.frame(state, { bus.can_id(0x210, 3, 0, 0), look = 13, bus = 1, data = "12345678" })
  lu.assertEquals(state.kept.faults[13][1].text, "The message that started in frame 12 ends with 8 of 32 bytes")
end

-- Bounds ----------------------------------------------------------------------------------------------------------

local function kilobytes()
  collectgarbage()
  collectgarbage()
  return collectgarbage("count")
end

function T.test_a_flood_of_starts_keeps_no_more_than_some_open()
  local state = bus.reassembler()
  local data = bus.start(0x123, 0, 0, ("x"):rep(2000))
  for number = 1, levels.size(10000, 50000) do
    local id = (number - number % 256) / 256
    bus.frame(state, { bus.can_id(id, 1, 0, number % 256), look = number, data = data, bus = 1, wide = true })
    lu.assertTrue(state.open.count <= 1024 and state.open.queue_length <= 4096)
  end
  local open = 0
  for _ in pairs(state.slots) do open = open + 1 end
  lu.assertEquals(open, state.open.count)
end

function T.test_the_newest_messages_survive_a_flood()
  local state = bus.reassembler()
  local payload = ("y"):rep(16)
  local function send(seq, ctrl, data, number)
    return bus.frame(state, { bus.can_id(0x123, ctrl, 0, seq), look = number, data = data, bus = 1, wide = true })
  end
  local other = bus.start(5, 0, 0, ("x"):rep(2000))
  send(1, 1, bus.start(0x123, 0, 1, payload), 1)
  for number = 2, 400 do
    bus.frame(state, { bus.can_id(number, 1, 0, 0), look = number, data = other, bus = 1, wide = true })
  end
  send(1, 2, payload:sub(1, 8), 401)
  lu.assertEquals(send(1, 3, payload:sub(9), 402).status, "good")
end

function T.test_a_message_that_never_ends()
  local half = levels.size(15000, 60000)
  for _, number_of_bus in ipairs { 1, false } do
    local state = bus.reassembler()
    local start = bus.start(0x123, 0, 0, "", { size = 65535 })
    for number = 1, 3 do
      bus.frame(state, { bus.can_id(0x123, 1, 0, 0), look = number, data = start, bus = number_of_bus or nil })
    end
    local middle, before = bus.can_id(0x123, 2, 0, 0), nil
    for number = 4, 2 * half do
      bus.frame(state, { middle, look = number, data = ("%08d"):format(number), bus = number_of_bus or nil })
      if number == half then before = kilobytes() end
    end
    local bytes = (kilobytes() - before) * 1024 / half
    lu.assertTrue(bytes < 500, ("%.0f bytes a frame"):format(bytes)) -- each frame says that it is one too many
  end
end

function T.test_good_messages_cost_little()
  local state = bus.reassembler()
  local payload = ("z"):rep(32)
  local start = bus.start(0x210, 0, 0, payload)
  local number, before, half = 0, nil, levels.size(3000, 10000)
  for message = 1, 2 * half do
    for index = 0, 4 do
      number = number + 1
      local ctrl = index == 0 and 1 or index == 4 and 3 or 2
      bus.frame(state, { bus.can_id(0x210, ctrl, 0, 0), look = number, bus = 1,
        data = index == 0 and start or payload:sub(index * 8 - 7, index * 8) })
    end
    if message == half then before = kilobytes() end
  end
  lu.assertTrue((kilobytes() - before) * 1024 / (5 * half) < 60, "bytes a frame")
end

return T
