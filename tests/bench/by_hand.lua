-- SPDX-License-Identifier: GPL-2.0-or-later
-- What one would write by hand for the benchmark's Motor Data and nothing else: reassembly, CRC, values, columns, and
-- the items of the plugin's tree.  No other message, frame that is missing or comes twice, bus, history, expert item or
-- special value of a float: what is above it is the price of these.
--   tshark -X lua_script:by_hand.lua -X lua_script1:run -r yapp.pcap ...
if ... ~= "run" then return end -- run by Wireshark, in a plugin folder

-- As in yapp.lua, so that the same collector runs.
collectgarbage("setpause", 150)
collectgarbage("setstepmul", 1000)

local source = debug.getinfo(1, "S").source -- the plugin is beside it, or it is in a clone
local top = source:match("^@(.*)tests/bench/") or source:match("^@(.*/)") or ""
package.path = top .. "?.lua;" .. package.path
local crc, can_id = require("yapp.wire.crc"), require("yapp.wire.can_id")

local yapp, taurus = Proto("by_hand", "YAPP by hand"), Proto("by_hand_taurus", "Taurus by hand")
local add, add_le, append, generated = TreeItem.add, TreeItem.add_le, TreeItem.append_text, TreeItem.set_generated
local byte, format = string.byte, string.format
-- Every dissector adds its protocol's name to a tree that is not shown, too: -z io,phs counts it.
-- From 4.6 on Wireshark says whether anyone asks for it.
local ALWAYS_NAMES, needs_name = get_version():find("^4%.[0-5]%.")

-- Fields: those of a frame, of a message, and of Motor Data in the order of its payload ------------------------------

local fields, of_taurus = {}, {}
for name, kind in pairs { id = "uint32", ctl = "uint8", seq = "uint8", ctrl = "uint8", crc = "uint32", size = "uint16",
    reserved = "uint16", reassembled_in = "framenum", status = "uint8", fragments = "none", fragment = "framenum",
    count = "uint32", length = "uint32", data = "bytes", delta = "relative_time", source = "string",
    fault = "bool" } do
  fields[name] = ProtoField[kind]("by_hand." .. name, name)
end
yapp.fields = fields

local function taurus_field(kind, name, ...)
  local field = ProtoField[kind]("by_hand." .. name, ...)
  of_taurus[#of_taurus + 1] = field
  return field
end

local rows, offset = {}, 0
for _, row in ipairs(dofile(top .. "taurus_fields.lua")[2]) do
  local name, kind, title, size = row[1], row[2], row[3], tonumber(row[2]:match("%d+")) / 8
  local pf_kind = kind:find("float") and "double" or kind == "int64_ns" and "relative_time" or kind
  local made = { kind = pf_kind, offset = offset, size = size, title = title .. ": ", unit = " " .. (row.unit or ""),
    min = row.min, step = row.min and (row.max - row.min) / (size == 2 and 65530 or 250), flags = {} }
  made.pf = taurus_field(pf_kind, name, title, kind:find("uint") and base.HEX or nil, row.values)
  for i, flag in ipairs(row.flags or {}) do
    local pf = taurus_field("bool", row.group .. "." .. flag[1], flag[3], 8 * size, nil, flag[2])
    made.flags[i] = { name = flag[1], mask = flag[2], pf = pf }
  end
  made.names = row.flags and taurus_field("string", name .. ".names", title)
  rows[#rows + 1], offset = made, offset + size
end
local torque_error = taurus_field("double", "torque_iq_error", "Torque IQ Error")
local rpm_error = taurus_field("double", "rpm_error", "RPM Error")
local dc_power = taurus_field("double", "dc_power", "DC Power")
local drift = taurus_field("relative_time", "clock_drift", "Clock drift")
local motor = taurus_field("none", "motor", "Motor Data")
taurus.fields = of_taurus
local fault_flags = rows[10]
local overcurrent = fault_flags.flags[17].pf

-- Trees --------------------------------------------------------------------------------------------------------------

local KINDS = { "Start", "Middle", "End" }

local function add_frame(tree, tvb, id, seq, kind)
  local item = add(tree, yapp, tvb(), "YAPP by hand, Motor Data, " .. KINDS[kind])
  generated(add(item, fields.id, id))
  generated(add(item, fields.ctl, 0))
  generated(add(item, fields.seq, seq))
  generated(add(item, fields.ctrl, kind))
  generated(add(item, fields.source, "0x210"))
  return item
end

local function add_message(item, tvb, number, message)
  generated(add(item, fields.reassembled_in, number))
  generated(add(item, fields.size, message.size))
  generated(add(item, fields.reserved, 0))
  generated(add(item, fields.crc, message.crc))
  generated(add(item, fields.status, 1))
  local list = generated(add(item, fields.fragments, tvb()))
  for i = 1, 5 do generated(add(list, fields.fragment, message.frames[i])) end
  generated(add(list, fields.count, 5))
  generated(add(list, fields.length, message.size))
  generated(add(list, fields.data, tvb()))
  generated(add(item, fields.delta, NSTime.new(0, message.delta * 1e9)))
  generated(add(item, fields.fault, message.fault ~= 0))
  append(item, ", CRC good")
end

-- The names of the flags that are set: they seldom change.
local function names_of(row, raw)
  if row.named == raw then return row.text end
  local names = {}
  for _, flag in ipairs(row.flags) do
    if raw % (2 * flag.mask) >= flag.mask then names[#names + 1] = flag.name end
  end
  row.named, row.text = raw, table.concat(names, ", ")
  return row.text
end

local function add_flags(item, range, row, raw)
  for _, flag in ipairs(row.flags) do add_le(item, flag.pf, range) end
  if raw == 0 then return end
  local names = names_of(row, raw)
  append(item, " (" .. names .. ")")
  generated(add(item, row.names, names)):set_hidden()
end

local function add_row(parent, tvb, row, value, payload)
  local range = tvb(row.offset, row.size)
  if row.kind == "double" then
    local text = format("%.7g", value)
    return add(parent, row.pf, range, tonumber(text), row.title .. text .. row.unit)
  elseif row.kind == "relative_time" then
    local a, b, c, d, e, f, g, h = byte(payload, row.offset + 1, row.offset + 8)
    local low, high = a + b * 0x100 + c * 0x10000 + d * 0x1000000, e + f * 0x100 + g * 0x10000 + h * 0x1000000
    local rest = (low + high % 1e9 * 2^32) % 1e9 -- enough for the seconds of a flight
    local seconds = (low + high * 2^32 - rest) / 1e9
    return add(parent, row.pf, range, NSTime.new(seconds, rest)), seconds + rest / 1e9
  end
  local item = add_le(parent, row.pf, range)
  if row.names then add_flags(item, range, row, range:le_uint()) end
end

local first -- of the controller's clock less the capture's

local function add_values(tree, tvb, payload, values, time)
  local item = add(tree, taurus, tvb(), "Taurus Motor Data")
  add(item, motor, tvb()):set_hidden()
  local clock
  for i, row in ipairs(rows) do
    local _, seconds = add_row(item, tvb, row, values[i], payload)
    clock = clock or seconds
  end
  append(generated(add(item, torque_error, tonumber(format("%.7g", values[2] - values[1])))), " A")
  append(generated(add(item, rpm_error, tonumber(format("%.7g", values[4] - values[3])))), " RPM")
  append(generated(add(item, dc_power, tonumber(format("%.7g", values[5] * values[6])))), " W")
  first = first or clock - time
  generated(add(item, drift, NSTime.new(0, (clock - time - first) % 1 * 1e9)))
end

-- Frames -------------------------------------------------------------------------------------------------------------

local open, seeds, latest = {}, {}, 0

local function begin(item, tvb, data, number, id, seq)
  local sent, size = can_id.start(data)
  seeds[seq] = seeds[seq] or crc.of(can_id.header({ id = id, seq = seq, ctl = 0 }, size))
  open[seq] = { crc = sent, size = size, frames = { number } }
  if item then
    add_le(item, fields.crc, tvb(0, 4))
    add_le(item, fields.size, tvb(4, 2))
    add_le(item, fields.reserved, tvb(6, 2))
  end
  return "Motor Data  Start of 32 bytes"
end

local function read_values(payload)
  local values = {}
  for i, row in ipairs(rows) do
    if row.kind == "double" then
      local low, high = byte(payload, row.offset + 1, row.offset + row.size)
      values[i] = row.min + (low + (high or 0) * 0x100) * row.step
    end
  end
  return values
end

local function finish(tree, item, message, pinfo, seq)
  local payload = table.concat(message)
  if crc.update(seeds[seq], payload) ~= message.crc then return "bad CRC" end
  local values, time = read_values(payload), pinfo.rel_ts
  message.delta, latest = time - latest, time
  local a, b, c, d = byte(payload, fault_flags.offset + 1, fault_flags.offset + 4)
  message.fault = a + b * 0x100 + c * 0x10000 + d * 0x1000000
  local wants_all = item or tree:referenced(rows[1].pf) -- from 4.4 on -T fields shows no tree
  if wants_all or tree:referenced(overcurrent) then
    local tvb = ByteArray.new(payload, true):tvb("Reassembled")
    if item then add_message(item, tvb, pinfo.number, message) end
    if wants_all then
      add_values(tree, tvb, payload, values, time)
    else -- as the plugin: with its bytes, which a filter may ask for
      add_le(add(tree, taurus, tvb(), "Taurus Motor Data"), overcurrent, tvb(fault_flags.offset, fault_flags.size))
    end
  end
  return format("Motor Data  %.1f/%.1f RPM  %.2f V  %.2f A%s", values[3], values[4], values[5], values[6],
    message.fault ~= 0 and "  FAULT" or "")
end

function yapp.dissector(tvb, pinfo, tree)
  local raw_id, number, data = pinfo.match_uint, pinfo.number, tvb:raw()
  local seq, kind, id = raw_id % 0x100, math.floor(raw_id / 0x4000) % 4, math.floor(raw_id / 0x40000)
  local item = tree.visible and add_frame(tree, tvb, id, seq, kind)
  if needs_name == nil then needs_name = tree.hidden and (ALWAYS_NAMES or tree:referenced(Dissector.get("by_hand"))) end
  if needs_name and not item then add(tree, yapp) end
  local message = open[seq]
  local info
  if kind == 1 then
    info = begin(item, tvb, data, number, id, seq)
  else
    message[#message + 1], message.frames[#message.frames + 1] = data, number
    info = kind == 2 and format("Motor Data  part %d of 5", #message.frames) or finish(tree, item, message, pinfo, seq)
  end
  local columns = pinfo.cols
  columns.protocol, columns.src, columns.info = "YAPP", "0x210", info
  return 8
end

DissectorTable.get("can.extended_id"):add("138428416-138477567", yapp)
