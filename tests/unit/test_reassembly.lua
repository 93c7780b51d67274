-- Reassembly where it is known on which bus a frame was: each rule by itself, as text: "S32 M8 M8 M8 E8" is a good
-- message of 32 bytes.
--
-- A word is a frame: [sender a, b, ...] S M E (Start, Middle, End), X (CAN CTRL 9) or L (single), a number, marks.
--   S32    a Start that says 32 bytes, with the right CRC for the sender's next payload
--   M8 E3  the next 8, or 3, bytes of that payload          L7   a single frame of 7 bytes
-- marks: ! wrong CRC, r reserved bytes 5 (the CRC covers them), /7 only 7 bytes long (or longer, with zeros),
--        ~4 only 4 bytes captured, ? bytes that nobody sent, p12 zeros up to 12 bytes
-- Each sender has payloads of its own; all have the same key unless the test gives ids.
if not arg then return end -- run by Wireshark, see run.lua
local lu = require("luaunit")
local can = require("yapp_can")
local crc = require("yapp_crc")
local reassembly = require("yapp_reassembly")
local interleave = require("yapp_interleave")
local little_endian = require("stream_generator").little_endian

local bus = {} -- also for test_interleave

local KIND = { L = 0, S = 1, M = 2, E = 3, X = 9 }
bus.known = { [0x000] = 7, [0x200] = 17, [0x210] = 32 }

function bus.can_id(id, ctrl, ctl, seq)
  return id * 0x40000 + ctrl * 0x4000 + ctl * 0x100 + seq
end

--- The data of a Start.
function bus.start(id, ctl, seq, payload, options)
  options = options or {}
  local message = { address = can.address(bus.can_id(id, 1, ctl, seq)), size = #payload, reserved = options.reserved }
  local sum = crc.of(can.header(message) .. payload)
  if options.wrong then sum = crc.xor(sum, 1) end
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
  state = reassembly.new({ can = can, crc = counted, interleave = interleave }, function(id) return bus.known[id] end)
  state.steps = 0
  return state
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

-- What a frame is, in words.
local function named(entry, number)
  if not entry then return "-" end
  if entry.kind then return entry.kind end
  return entry.last == number and entry.status or "part"
end

--- Sends frames; returns what each of them is, in words, and the reassembler.
-- text     words; ids: { [sender] = { id, ctl, seq } }
-- options  wide, buses (true: each sender has a bus of its own, which the capture tells), ids
function bus.send(text, options)
  options = options or {}
  local state, senders, list, number = bus.reassembler(), {}, {}, 0
  for word in text:gmatch("%S+") do
    number = number + 1
    local can_id, data, reported, name = frame(word, senders, options.ids or {})
    local place = options.buses and ("_" .. name):byte(-1) or nil
    list[number] = named(state:frame(place, can.address(can_id), data, reported, number, options.wide), number)
  end
  for i = 1, number do
    local faults = {}
    for _, fault in ipairs(state.faults[i] or {}) do faults[#faults + 1] = fault[1] end
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
    { "X8", "-", { ids = MOTOR } },
  }
  check({ -- the user says that all is YAPP
    { "L8", "single" }, { "M8", "orphan+fragment.orphan" }, { "S9 M8 E1", "part part good" },
    { "S9 M8 E1", "part part good", { ids = { [""] = { 0x123, 63, 255 } } } },
  }, { wide = true })
end

function T.test_a_frame_without_data_is_nobodys()
  local state = bus.reassembler()
  for ctrl = 0, 15 do
    lu.assertNil(state:frame(1, can.address(bus.can_id(0x210, ctrl, 0, 0)), "", 0, 1, true))
  end
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
  lu.assertStrContains(state.faults[4][1][2], "started in frame 1 ends with 24 of 32 bytes")
  _, state = bus.send("S32 M8 S32", { buses = true })
  lu.assertStrContains(state.faults[3][1][2], "8 of 32 bytes")
end

-- A later look finds what the first one found.
function T.test_later_looks()
  for text, count in pairs { ["S32 M8 M8 M8 E8"] = 5, ["S32r M8 M8 M8 E8"] = 5, ["S73 M64 E9p12"] = 3,
    ["S1000 " .. ("M8 "):rep(124) .. "E8"] = 126 } do
    local _, state = bus.send(text, { buses = true, wide = true })
    for number = 1, count do
      local entry = state:entry(number)
      lu.assertEquals({ entry.status, entry.last, entry.count }, { "good", count, count }, text)
      lu.assertEquals(#entry.payload, entry.size)
      for i = 1, count do lu.assertEquals(entry[i], i) end
    end
  end
end

function T.test_a_message_put_away_gets_its_crc_back()
  local _, state = bus.send("S32 M8 M8 M8 E8", { ids = MOTOR })
  local entry = state:entry(5)
  state:restore(entry, can.address(0x0840C000))
  lu.assertEquals(entry.crc, state.crc.of(can.header { address = entry.address, size = 32 } .. entry.payload))
end

-- Where the numbers are not those of frames, texts name the frames.
function T.test_texts_name_frames()
  local state = bus.reassembler()
  function state.number_of(number) return number - 5 end
  state:frame(1, can.address(bus.can_id(0x210, 1, 0, 0)), bus.start(0x210, 0, 0, ("x"):rep(32)), 8, 12)
  state:frame(1, can.address(bus.can_id(0x210, 3, 0, 0)), "12345678", 8, 13)
  lu.assertEquals(state.faults[13][1][2], "The message that started in frame 7 ends with 8 of 32 bytes")
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
  for number = 1, 50000 do
    local id = (number - number % 256) / 256
    state:frame(1, can.address(bus.can_id(id, 1, 0, number % 256)), data, 8, number, true)
    lu.assertTrue(state.open_count <= 1024 and state.queue_length <= 4096)
  end
  local open = 0
  for _ in pairs(state.open) do open = open + 1 end
  lu.assertEquals(open, state.open_count)
end

function T.test_the_newest_messages_survive_a_flood()
  local state = bus.reassembler()
  local payload = ("y"):rep(16)
  local function send(seq, ctrl, data, number)
    return state:frame(1, can.address(bus.can_id(0x123, ctrl, 0, seq)), data, #data, number)
  end
  local other = bus.start(5, 0, 0, ("x"):rep(2000))
  send(1, 1, bus.start(0x123, 0, 1, payload), 1)
  for number = 2, 400 do
    state:frame(1, can.address(bus.can_id(number, 1, 0, 0)), other, 8, number, true)
  end
  send(1, 2, payload:sub(1, 8), 401)
  lu.assertEquals(send(1, 3, payload:sub(9), 402).status, "good")
end

function T.test_a_message_that_never_ends()
  for _, number_of_bus in ipairs { 1, false } do
    local state = bus.reassembler()
    local start = bus.start(0x123, 0, 0, "", { size = 65535 })
    for number = 1, 3 do
      state:frame(number_of_bus or nil, can.address(bus.can_id(0x123, 1, 0, 0)), start, 8, number)
    end
    local middle = can.address(bus.can_id(0x123, 2, 0, 0))
    local before
    for number = 4, 120000 do
      state:frame(number_of_bus or nil, middle, ("%08d"):format(number), 8, number)
      if number == 60000 then before = kilobytes() end
    end
    local bytes = (kilobytes() - before) * 1024 / 60000
    lu.assertTrue(bytes < 400, ("%.0f bytes a frame"):format(bytes)) -- each frame says that it is one too many
  end
end

function T.test_good_messages_cost_little()
  local state = bus.reassembler()
  local payload = ("z"):rep(32)
  local start = bus.start(0x210, 0, 0, payload)
  local number, before = 0, nil
  for message = 1, 20000 do
    for index = 0, 4 do
      number = number + 1
      local ctrl = index == 0 and 1 or index == 4 and 3 or 2
      state:frame(1, can.address(bus.can_id(0x210, ctrl, 0, 0)),
        index == 0 and start or payload:sub(index * 8 - 7, index * 8), 8, number)
    end
    if message == 10000 then before = kilobytes() end
  end
  lu.assertTrue((kilobytes() - before) * 1024 / 50000 < 60, "bytes a frame")
end

return T
