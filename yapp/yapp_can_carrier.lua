-- YAPP on SocketCAN: which frames are ours, and what is shown of them.  Wireshark's API.

local M = {}

local STATUS_TEXT = {
  bad = "  [BAD CRC]", short = "  [INCOMPLETE]", overrun = "  [OVERRUN]", unverified = "  [CUT SHORT]",
}
local MAX_KEPT = 64 -- texts kept for the parts of long messages

-- Remote frames come with as many zeros as their DLC says; SocketCAN does not tell a dissector.
local ZEROS = {}
for length = 0, 8 do ZEROS[("\0"):rep(length)] = true end

local address_of, KINDS, START, LONE, ORPHAN -- of yapp_can and yapp_reassembly; set in M.new

local Carrier = {}
Carrier.__index = Carrier

--- The CAN side of the plugin.
-- parts   the modules { can =, crc =, interleave =, reassembly =, serials = }
-- tree    a tree builder
-- bus_of  function(pinfo) -> number of the bus; nil where the capture does not say, false where only this pass does not
-- is_remote   function(pinfo) -> whether the frame is a remote frame, nil where nothing says
-- on_unknown  function(id): a frame of a message that is not in the catalogue was taken
function M.new(parts, tree, bus_of, is_remote, on_unknown)
  local self = setmetatable({ parts = parts, tree = tree, bus_of = bus_of, is_remote = is_remote,
    on_unknown = on_unknown }, Carrier)
  address_of, KINDS, START = parts.can.address, parts.can.KINDS, parts.can.START
  LONE, ORPHAN = parts.reassembly.LONE, parts.reassembly.ORPHAN
  self:reset()
  return self
end

--- Forgets the capture file: nothing survives into the next one.
-- mixed  whether the next one is known to have several buses
function Carrier:reset(mixed)
  self.serials = self.parts.serials.new()
  self.known = {}
  self.since = {} -- [ID of an unknown message]: serial of its first frame
  self.state, self.second, self.guessed, self.mixed, self.first_bus = self:new_state(), nil, false, mixed, nil
  self.again, self.reached = false, 0
end

--- The first pass (of tshark -2, of sharkd) builds no tree and had to guess: the bus, the id of a frame, or whether it
-- was a remote frame.
function Carrier:guess()
  self.guessed = true
end

-- Whether a frame of an unknown message came before its first Start: then the first pass was not asked about it, and
-- what it may know under this serial is another frame's, which a read filter rejected.
function Carrier:is_early(id, serial)
  return not self.tree.by_id[id] and serial < (self.since[id] or math.huge)
end

-- What is known of the capture so far: a reassembler, and when each message came last.
function Carrier:new_state()
  local by_id = self.tree.by_id
  local state = self.parts.reassembly.new(self.parts, function(id)
    local message = by_id[id]
    return message and message.size
  end)
  local serials = self.serials
  state.last_time, state.deltas, state.history = {}, {}, require("yapp_history").new { late = 2.5 }
  function state.number_of(serial) return serials:number(serial) end
  return state
end

-- The time since the previous message with this ID on this bus; kept, because only a pass that comes in order knows it.
local function note_time(state, pinfo, bus, id, serial)
  local now, key, last_time = pinfo.rel_ts, (bus or -1) * 0x800 + id, state.last_time
  local before = last_time[key]
  last_time[key] = now
  if before then state.deltas[serial] = now - before end
end

function Carrier:note_bus(bus, doubtful)
  if bus == false or doubtful then self.guessed = true end
  if bus then
    self.first_bus = self.first_bus or bus
    if bus ~= self.first_bus then self.mixed = true end
  end
end

-- What history and statistics are told of a message.
local function look_of(self, pinfo, bus, address, entry, data, reported, serial)
  local message, payload = self.tree.by_id[address.id], entry.payload
  if entry == LONE then
    local padding = message and self.parts.can.padding(data, reported, message.size)
    payload = padding and padding > 0 and data:sub(1, message.size) or data
  end
  local fits = message and #payload == message.size
  local good = entry == LONE or entry.status == "good"
  return { source = (bus or -1) * 0x800 + address.id, bus = bus or nil, message = message, id = address.id,
    raws = fits and self.parts.decode.read(message, payload) or nil, payload = payload, seq = address.seq,
    number = serial, time = pinfo.rel_ts, good = good, is_bad = entry ~= LONE and entry.status == "bad" }
end

local LOST = { ["fragment.incomplete"] = "incomplete", ["fragment.orphan"] = "orphan",
  ["fragment.overrun"] = "overrun" }

local NONE = {}

local function record_of(self, frame, rel, bus, address)
  local key = (bus or -1) * 0x800 + address.id
  local source = self.known[key]
  if not source then
    local name = bus and self.bus_name(bus)
    source = { key = key, bus_key = bus or nil, bus = name or nil, name = self.sources():name(name, address.id),
      id = address.id, message = self.tree.by_id[address.id] }
    self.known[key] = source
  end
  return { frame = frame, rel = rel, source = source, seq = address.seq, payload = "", good = false, fits = false,
    change = false }
end

-- The statistics are told of a message that ends here, and of what is lost.
function Carrier:tell(pinfo, bus, address, entry, state, serial, look, change)
  local faults = state.faults[serial]
  for _, fault in ipairs(faults or NONE) do
    if LOST[fault[1]] then
      local record = record_of(self, pinfo.number, pinfo.rel_ts, bus, address)
      record.lost, record.is_end = LOST[fault[1]], address.ctrl == 3
      self.stat:offer(record, pinfo.visited)
    end
  end
  if look and (look.good or look.is_bad) then
    local record = record_of(self, pinfo.number, look.time, bus, address)
    record.payload, record.fits, record.good, record.is_bad = look.payload, look.raws ~= nil, look.good, look.is_bad
    record.change = change
    self.stat:offer(record, pinfo.visited)
  elseif not entry.kind and not entry.status then
    entry.rel, entry.bus = pinfo.rel_ts, bus
  end
end

function Carrier:unfinished()
  local list, state = {}, self.second or self.state
  for _, open in pairs(state.open) do
    for _, message in ipairs(open.messages or { open }) do
      if message.rel and not message.status then
        local record = record_of(self, self.serials:number_of(message[message.count]), message.rel, message.bus,
          message.address)
        record.lost, list[#list + 1] = "unfinished", record
      end
    end
  end
  table.sort(list, function(a, b) return a.frame < b.frame end)
  return list
end

-- A look at a frame, in the order of the capture.
function Carrier:look(state, bus, pinfo, address, data, reported, serial, wide, doubtful)
  if bus ~= nil or doubtful then self:note_bus(bus, doubtful) end
  local entry = state:frame(bus, address, data, reported, serial, wide, doubtful)
  if entry and (entry == LONE or entry.last == serial) then
    note_time(state, pinfo, bus, address.id, serial)
    local look = look_of(self, pinfo, bus, address, entry, data, reported, serial)
    local change = state.history:note(look)
    if self.stat.wanted then self:tell(pinfo, bus, address, entry, state, serial, look, change) end
  elseif entry and self.stat.wanted then
    self:tell(pinfo, bus, address, entry, state, serial)
  end
  return entry
end

--- Dissects one frame.
-- id    29-bit CAN id
-- wide  true when the user says that every extended frame is YAPP
-- returns the number of bytes that are ours, 0 for a frame that is not
function Carrier:dissect(tvb, pinfo, tree, id, wide)
  local reported = tvb:reported_len()
  if reported == 0 then return 0 end
  local number, state, leads_to = pinfo.number, self.state, nil
  -- raw() of nothing would throw past Lua, to Wireshark: what no Lua can catch.
  local address, data = address_of(id), tvb:len() > 0 and tvb:raw() or ""
  local doubtful = false
  if ZEROS[data] then
    local remote = self.is_remote(pinfo)
    doubtful = remote == nil
    if remote or doubtful and data == "" then
      self:pass_over(tvb, pinfo, doubtful)
      return 0
    end
  end
  local entry, serial
  local serials = self.serials
  -- Numbers grow on the first pass: this saves a call for most frames.
  if number > serials.highest and not (self.again and pinfo.visited) or not pinfo.visited then
    serial = serials:next(number, tvb:offset(), state.frames)
    entry = self:look(state, self.bus_of(pinfo), pinfo, address, data, reported, serial, wide, doubtful)
  else
    if not self.again then
      self.again = true
      self.is_remote(pinfo) -- asks for the fields that a later frame may need
    end
    serial = serials:find(number, tvb:offset(), state.frames)
    if not serial then return 0 end
    if not wide and (serials.filtered or not self.guessed) and self:is_early(address.id, serial) then return 0 end
    entry, state, leads_to = self:look_again(pinfo, address, data, reported, serial, wide, doubtful)
  end
  if not entry then return 0 end
  local builder = self.tree
  if not builder.by_id[address.id] and not self.since[address.id] then
    self.since[address.id] = serial
    self.on_unknown(address.id)
  end
  local wanted = builder:wanted(tree, entry.kind or entry.last == serial)
  local item = wanted and self:item(tvb, tree, address) or tree
  local columns = pinfo.cols
  columns.protocol = "YAPP"
  if entry.kind then
    columns.info = self:show_lone(tvb, tree, item, address, data, reported, entry, wanted)
  elseif entry.last == serial then
    columns.info = self:show_message(tvb, tree, item, address, data, entry, wanted)
  else
    columns.info = self:show_part(tvb, item, address, data, entry, serial, wanted, entry.last or leads_to)
  end
  if #data < reported then
    builder:expert(item, "truncated", ("The capture has %d of the frame's %d bytes"):format(#data, reported))
  end
  local faults = state.faults[serial]
  if faults then
    for _, fault in ipairs(faults) do builder:expert(item, fault[1], fault[2]) end
  end
  if wanted then builder:add_delta(item, state.deltas[serial]) end
  return reported
end

--- A frame that is YAPP's by the user's word, but whose CAN id nothing says: Decode As on its first frame, on a pass
-- that builds no tree.  Shown as bytes.
function Carrier:without_id(tvb, pinfo, tree)
  local builder = self.tree
  local item = tree
  self.guessed = true
  if builder:wanted(tree, false) then
    item = tree:add(builder.yapp, tvb())
    if tvb:len() > 0 then item:add(builder.fields.payload, tvb()) end
  end
  pinfo.cols.protocol = "YAPP"
  builder:expert(item, "can.id.missing", "The CAN id of this frame is not known yet; reload or redissect to see it")
  return tvb:reported_len()
end

-- YAPP's own tree item, with what the CAN id says.
function Carrier:item(tvb, tree, address)
  local builder = self.tree
  local fields = builder.fields
  local item = tree:add(builder.yapp, tvb())
  item:append_text((", %s, %s"):format(builder:name(address.id), KINDS[address.ctrl] or "undefined frame"))
  builder:add_id(item, nil, address.id)
  item:add(fields.ctl, address.ctl):set_generated()
  item:add(fields.seq, address.seq):set_generated()
  item:add(fields["can.ctrl"], address.ctrl):set_generated()
  return item
end

-- A later look at a frame.  Where the first pass had to guess, a second one that comes in order knows better; but what
-- will come it has from the first.  In Wireshark a look for the packet list may not have the bus that a look for the
-- details has: the second pass is made of looks of one kind.
function Carrier:look_again(pinfo, address, data, reported, serial, wide, doubtful)
  local first, second = self.state, self.second
  local entry = second and serial <= self.reached and second:entry(serial)
  local left = not entry and wide and serial == self.reached -- the table of ids had it, and left it to us
  if not second or serial > self.reached or left then
    local bus = self.guessed and self.bus_of(pinfo)
    if not self.guessed or self.serials.filtered or second and bus == false and self.second_has_bus or
      not (left or self:follows(serial)) then
      entry = first:entry(serial)
      if not entry and wide then entry = self:late(address, serial) end
      if entry and self.stat.wanted then
        local ends = entry == LONE or entry.last == serial
        bus = self.bus_of(pinfo)
        local look = ends and look_of(self, pinfo, bus, address, entry, data, reported, serial)
        if look then look.delta = first.deltas[serial] end
        self:tell(pinfo, bus, address, entry, first, serial, look, look and first.history:change(look))
      end
      return entry, first
    end
    if not second then
      second = self:new_state()
      self.second, self.second_has_bus = second, bus ~= false
    end
    self.reached = serial
    entry = self:look(second, self.second_has_bus and bus, pinfo, address, data, reported, serial, wide, doubtful)
  end
  return entry, second, entry and not entry.kind and self:foreseen(entry[1])
end

-- A frame that is not ours after all.
function Carrier:pass_over(tvb, pinfo, doubtful)
  if doubtful then
    self.guessed = true
  elseif pinfo.visited then
    local serial = self.serials:find(pinfo.number, tvb:offset(), self.state.frames)
    if serial and serial > self.reached and self:follows(serial) then self.reached = serial end
  end
end

-- Whether a second pass goes on here: it has seen all frames that came to us before.  Who asks for a frame here and
-- there, as sharkd does, gets what the first pass knows.  A read filter leaves gaps: then there is no second pass.
function Carrier:follows(serial)
  local frames = self.state.frames
  for before = self.reached + 1, serial - 1 do
    if frames[before] then return false end
    self.reached = before
  end
  return true
end

-- Where the message that begins with a frame ends, by the first pass; if that mixed buses, it has this from the CRC.
function Carrier:foreseen(serial)
  local message = self.state:entry(serial)
  return message and (message.status == "good" or not self.mixed) and message.last or nil
end

-- A frame whose id was not known on the first pass, the first one under Decode As: what stands alone can still be
-- shown, but a message that it began or ended is lost.
function Carrier:late(address, serial)
  local state = self.state
  if address.ctrl == 0 or address.ctrl > 3 then
    return state:frame(nil, address, "?", 1, serial, true)
  end
  if not state.faults[serial] then
    state:fault(serial, "can.id.missing", "The CAN id was not known on the first pass: reload to see the message")
  end
  return ORPHAN
end

--- Whether a frame of a single-frame id would be taken.
function Carrier:takes_single(tvb, pinfo, id, wide)
  local reported = tvb:reported_len()
  local data = tvb:len() > 0 and tvb:raw() or ""
  if reported == 0 then return false end
  if ZEROS[data] and self.is_remote(pinfo) then
    self:pass_over(tvb, pinfo)
    return false
  end
  local message = self.tree.by_id[id]
  return wide or message ~= nil and self.parts.can.padding(data, reported, message.size) ~= nil
end

-- A frame that stands alone: a single-frame message, or what belongs to none.
function Carrier:show_lone(tvb, tree, item, address, data, reported, entry, wanted)
  local builder = self.tree
  if entry == LONE then return self:show_single(tvb, tree, item, address.id, data, reported, wanted) end
  if wanted and address.ctrl == START then
    self:start_tree(tvb, item, #data)
  elseif wanted and #data > 0 then
    item:add(builder.fields["fragment.data"], tvb())
  end
  local kind = KINDS[address.ctrl] or "CAN CTRL " .. address.ctrl
  return ("%s  %s%s"):format(builder:name(address.id), kind, entry == ORPHAN and " without a Start" or "")
end

function Carrier:show_single(tvb, tree, item, msg, data, reported, wanted)
  local builder = self.tree
  local message = builder.by_id[msg]
  local fits = message and self.parts.can.padding(data, reported, message.size)
  local padding = fits or 0
  local payload = padding > 0 and data:sub(1, message.size) or data
  local info = builder:payload(tree, item, msg, payload, wanted and tvb, 0, fits and message.size or reported)
  if wanted and padding > 0 and #data > #payload then item:add(builder.fields.padding, tvb(#payload)) end
  return info
end

-- "Motor Data  part 2 of 5": the texts are the same for every message of an ID and size, so they are kept.
local function part_info(builder, address, entry, serial, length)
  local texts, size = address.part_info, entry.size
  if not texts or texts.by_id ~= builder.by_id or texts.size ~= size then
    texts = { by_id = builder.by_id, name = builder:name(address.id), size = size }
    address.part_info = texts
  end
  if address.ctrl == START then
    texts.start = texts.start or ("%s  Start of %d bytes"):format(texts.name, size)
    return texts.start
  end
  local index = entry.count
  while index > 1 and entry[index] ~= serial do index = index - 1 end
  -- How many parts there are is sure in the end; before that, it is what classic CAN needs.
  local parts = entry.status == "good" and entry.count or
    length == 8 and 1 + (size + 7 - (size + 7) % 8) / 8
  if not parts or index > parts then return ("%s  part %d"):format(texts.name, index) end
  local key = parts * 0x100 + index
  local text = texts[key] or ("%s  part %d of %d"):format(texts.name, index, parts)
  if parts <= MAX_KEPT then texts[key] = text end
  return text
end

-- A Start, a Middle, or an End that completes nothing.
function Carrier:show_part(tvb, item, address, data, entry, serial, wanted, leads_to)
  local fields = self.tree.fields
  leads_to = leads_to and self.serials:number_of(leads_to)
  if wanted then
    if address.ctrl == START then
      self:start_tree(tvb, item, #data)
      item:append_text((" of %d bytes"):format(entry.size))
    elseif #data > 0 then
      item:add(fields["fragment.data"], tvb())
    end
    if leads_to then item:add(fields["reassembled.in"], leads_to):set_generated() end
  end
  local text = part_info(self.tree, address, entry, serial, #data)
  return leads_to and ("%s  [Reassembled in #%d]"):format(text, leads_to) or text
end

-- What a Start says, as far as it was captured.
function Carrier:start_tree(tvb, item, length)
  local fields = self.tree.fields
  if length >= 4 then item:add_le(fields.crc, tvb(0, 4)) end
  if length >= 6 then item:add_le(fields.size, tvb(4, 2)):append_text(" bytes") end
  if length >= 8 then item:add_le(fields.reserved, tvb(6, 2)) end
end

function Carrier:fragments_tree(item, tvb, entry)
  local fields = self.tree.fields
  local list = item:add(fields.fragments, tvb())
  list:set_text(("%d fragments (%d bytes)"):format(entry.count, #entry.payload))
  list:set_generated()
  for i = 1, entry.count do
    local number = self.serials:number_of(entry[i])
    if number then list:add(fields.fragment, number):set_generated() end
  end
  list:add(fields["fragment.count"], entry.count):set_generated()
  list:add(fields["reassembled.length"], #entry.payload):set_generated()
end

-- The last frame of a message: what was put together.
function Carrier:show_message(tvb, tree, item, address, data, entry, wanted)
  local builder, payload, status = self.tree, entry.payload, entry.status
  local whole
  if wanted then
    if #payload > 0 then whole = ByteArray.new(payload, true):tvb("Reassembled YAPP") end
    item:add(builder.fields["reassembled.in"], self.serials:number_of(entry.last)):set_generated()
    item:add(builder.fields.size, entry.size):append_text(" bytes"):set_generated()
    item:add(builder.fields.reserved, entry.reserved or 0):set_generated()
    self.state:restore(entry, address)
    builder:add_crc(item, nil, entry)
    self:fragments_tree(item, whole or tvb, entry)
    if entry.padding and entry.padding <= #data then
      item:add(builder.fields.padding, tvb(#data - entry.padding))
    end
    item:append_text(", CRC " .. (status == "good" and "good" or status == "bad" and "BAD" or "unverified"))
  end
  if status == "bad" then builder:bad_crc(item, entry) end
  if status == "short" or status == "overrun" then
    if whole then item:add(builder.fields.payload, whole()) end
    return ("%s  %d of %d bytes%s"):format(builder:name(address.id), entry.received, entry.size, STATUS_TEXT[status])
  end
  local info = builder:payload(tree, item, address.id, payload, whole, 0, entry.size)
  return info .. (STATUS_TEXT[status] or "")
end

return M
