-- Reassembly of YAPP over CAN: Start, Middle, End ("Multi-Frame CAN YAPP").  Pure Lua, 5.2 and 5.4: it takes
-- (bus, address, bytes, a number that grows) and says what each frame is.

local M = {}

local byte, char, concat = string.byte, string.char, table.concat
local unpack = rawget(table, "unpack")

-- Bounds.  An open message costs memory until something ends it.
local MAX_OPEN = 1024 -- open messages; the oldest make room
local CREDIT_PER_FRAME, MAX_CREDIT = 32, 4096 -- steps of the search among interleaved messages
local MAX_DISTANCE, MAX_COUNT = 255, 64 -- what fits the small form of a good message

-- What a claimed frame is that belongs to no message.
M.LONE = { kind = "single" }
M.ORPHAN = { kind = "orphan" }
M.BAD_START = { kind = "start" }
M.INVALID = { kind = "invalid" }

local Reassembler = {}
Reassembler.__index = Reassembler

--- A reassembler for one capture file.
-- parts    the modules { can =, crc =, interleave = }
-- size_of  function(id) -> payload size of a known message, nil for an unknown one
-- It has faults, by frame number: a list of { expert, text }; what was said of a message that came out good after all
-- is taken back.  Where the numbers that it is given are not those that texts shall name, give it a function
-- number_of(given).
--
-- A message has address, size, crc, reserved (nil when 0; all from its Start), the numbers of its frames at
-- 1 .. count, received (bytes), and when it has ended status: "good", "bad" (CRC), "short", "overrun", "cut" (by a
-- new Start), "unverified" (bytes not captured), payload, padding (nil when 0), calculated (a bad CRC), and last (the
-- number of its last frame).
function M.new(parts, size_of)
  return setmetatable({
    can = parts.can, crc = parts.crc, interleave = parts.interleave, size_of = size_of,
    faults = {}, frames = {}, open = {}, open_count = 0, queue = {}, queue_length = 0,
    credit = MAX_CREDIT, seeds = {}, seed_count = 0, distances = {},
  }, Reassembler)
end

function Reassembler:fault(number, expert, text, message)
  local list = self.faults[number]
  if not list then
    list = {}
    self.faults[number] = list
  end
  list[#list + 1] = { expert, text, message }
  if message then
    message.blamed = message.blamed or {}
    message.blamed[#message.blamed + 1] = number
  end
end

function Reassembler:orphan(number, is_end)
  self.frames[number] = M.ORPHAN
  self:fault(number, "fragment.orphan",
    ("%s of a message whose Start is not here"):format(is_end and "End" or "Middle"))
  return M.ORPHAN
end

-- The frame that a message started in, as texts name it.
local function start_of(self, message)
  return self.number_of and self.number_of(message[1]) or message[1]
end

-- The message has more or fewer bytes than its size; returns the status.
function Reassembler:misfit(message, received, number)
  if received < message.size then
    self:fault(number, "fragment.incomplete", ("The message that started in frame %d ends with %d of %d bytes")
      :format(start_of(self, message), received, message.size), message)
    return "short"
  elseif received > message.size then
    self:fault(number, "fragment.overrun", ("%d bytes for the %d of the message that started in frame %d")
      :format(received, message.size, start_of(self, message)), message)
    return "overrun"
  end
end

--- The CRC register behind the header of a message: messages of one kind have the same header again and again.
function Reassembler:seed(message)
  local key = message.address.key * 0x10000 + message.size
  local seed = not message.reserved and self.seeds[key]
  if not seed then
    seed = self.crc.of(self.can.header(message))
    if self.seed_count == self.can.MAX_KEPT then self.seeds, self.seed_count = {}, 0 end
    if not message.reserved then self.seeds[key], self.seed_count = seed, self.seed_count + 1 end
  end
  return seed
end

-- A frame changes hands: what was said of it as an orphan is void.
function Reassembler:give(number, message)
  if self.frames[number] == M.ORPHAN then self.faults[number] = nil end
  self.frames[number] = message
end

--- A good message has another frame with the same bytes instead of one of its frames.
function Reassembler:exchange(number, other)
  local message = self:entry(number)
  for i = 1, message.count do
    if message[i] == number then message[i] = other end
  end
  table.sort(message)
  for i = 1, message.count do self:give(message[i], message) end
end

-- Takes back what was said of a message that came out good after all.
function Reassembler:forgive(message)
  for _, number in ipairs(message.blamed) do
    local list = self.faults[number] or {}
    for i = #list, 1, -1 do
      if list[i][3] == message then table.remove(list, i) end
    end
  end
end

-- Ends a message: status when it is known, else the CRC decides.
function Reassembler:finish(message, payload, number, status)
  message.payload, message.last = payload, number
  if status or message.truncated then
    message.status = status or "unverified"
  else
    local calculated = self.crc.update(self:seed(message), payload)
    if calculated == message.crc then
      message.status = "good"
      if message.blamed then return self:forgive(message) end
      return self:put_away(message)
    end
    message.status, message.calculated = "bad", calculated
  end
  message.chunks = nil
end

-- What a later look at a good message needs is little: its payload and which frames it had.  The last frame keeps
-- both as one string, each other frame the number of the last; the table serves the next message.
function Reassembler:put_away(message)
  local count, last = message.count, message.last
  if message.reserved or message.padding or count > MAX_COUNT or last - message[1] > MAX_DISTANCE then
    message.chunks = nil
    return
  end
  local frames, distances = self.frames, self.distances
  for i = 1, count do
    local number = message[i]
    frames[number], distances[i] = last, last - number
  end
  frames[last] = char(count, unpack(distances, 1, count)) .. message.payload
  self.spare = message
end

local function take_out(packed, number)
  local count = byte(packed)
  local message = { byte(packed, 2, count + 1) }
  for i = 1, count do message[i] = number - message[i] end
  message.count, message.last, message.status, message.payload = count, number, "good", packed:sub(count + 2)
  message.size = #message.payload
  message.received = message.size
  return message
end

--- What a frame is, on a later look.
-- returns  a message, one of M.LONE .. M.INVALID, or nil for a frame that is not YAPP's.  A good message may come
--          without address and crc: see Reassembler:restore.
function Reassembler:entry(number)
  local entry = self.frames[number]
  if type(entry) == "number" then
    number, entry = entry, self.frames[entry]
  end
  if type(entry) == "string" then return take_out(entry, number) end
  return entry
end

--- Gives a good message that was put away its address and CRC back.
function Reassembler:restore(message, address)
  if message.crc then return end
  message.address = address
  message.crc = self.crc.update(self:seed(message), message.payload)
end

function Reassembler:close(key)
  self.open[key] = nil
  self.open_count = self.open_count - 1
end

-- A message that did not come out whole and that nobody will look into again.
local function give_up(message)
  message.status = message.status or "cut"
  message.chunks = nil
end

-- Makes room for more open messages: the queue has their keys, oldest first, and keys long closed.
function Reassembler:make_room()
  local live, seen = {}, {}
  for i = self.queue_length, 1, -1 do -- a key is as old as its newest Start
    local key = self.queue[i]
    if self.open[key] and not seen[key] then
      seen[key] = true
      live[#live + 1] = key
    end
  end
  local keep = math.min(#live, MAX_OPEN / 2)
  local queue = {}
  for i = #live, 1, -1 do
    local key = live[i]
    if i <= keep then
      queue[#queue + 1] = key
    else
      for _, message in ipairs(self.open[key].messages or { self.open[key] }) do give_up(message) end
      self:close(key)
    end
  end
  self.queue, self.queue_length = queue, #queue
end

function Reassembler:enter(key, message)
  if self.open_count >= MAX_OPEN or self.queue_length >= 4 * MAX_OPEN then self:make_room() end
  self.open[key], self.open_count = message, self.open_count + 1
  self.queue_length = self.queue_length + 1
  self.queue[self.queue_length] = key
end

-- A Start arrived while something is open under its key.  On a known bus that is cut off; else it may be another
-- bus's, and what follows decides.
function Reassembler:overtake(key, bus, open, number)
  local newest = open.messages and open.messages[#open.messages] or open
  if not newest.status and not newest.overtaken then
    local received = open.messages and open:received() or open.received
    self:fault(number, "fragment.incomplete",
      ("A new Start cuts off the message that started in frame %d: %d of %d bytes")
      :format(start_of(self, newest), received, newest.size), newest)
  end
  if bus or newest.status or newest.truncated then
    for _, message in ipairs(open.messages or { open }) do give_up(message) end
    self:close(key)
  else
    if not open.messages then
      open = self.interleave.new(self, open)
      self.open[key] = open
    end
    if not open:overtake() then self:close(key) end
  end
end

-- What is wrong with a Start whose 8 bytes were captured, in their order.
function Reassembler:check_start(number, known, size, reserved)
  if size == 0 then
    self:fault(number, "size.mismatch", "The size of the message is 0")
  elseif known and size ~= known then
    self:fault(number, "size.mismatch", ("The size is %d bytes, the catalogue says %d"):format(size, known))
  end
  if reserved ~= 0 then
    self:fault(number, "reserved.nonzero", ("The reserved bytes are 0x%04x, not 0"):format(reserved))
  end
end

-- A Start that opens no message: too short, cut by the capture, or of size 0.
function Reassembler:bad_start(number, reported)
  self.frames[number] = M.BAD_START
  if reported < 8 then
    self:fault(number, "fragment.incomplete",
      ("A Start has 8 bytes, this one has %d: its message cannot be put together"):format(reported))
  end
  return M.BAD_START
end

function Reassembler:start(key, bus, address, data, reported, number, wide)
  local a, b, c, d, e, f, g, h = byte(data, 1, 8)
  local size, reserved = f and e + f * 0x100, h and g + h * 0x100
  local known = self.size_of(address.id)
  if not wide then -- a plausible Start, or for a known ID one that the capture cut
    if address.ctl ~= 0 or reported ~= 8 then return end
    if h and not (reserved == 0 and size > 8 and (not known or size == known)) then return end
    if not h and not known then return end
  end
  local open = self.open[key]
  if open then
    self:overtake(key, bus, open, number)
    open = self.open[key]
  end
  if reported > 8 then
    self:fault(number, "size.mismatch", ("A Start has 8 bytes, this one has %d"):format(reported))
  end
  if h and (size ~= known or reserved ~= 0) then self:check_start(number, known, size, reserved) end
  local message
  if h and size > 0 then
    message = self.spare or { chunks = {} }
    self.spare = nil
    message[1], message.count, message.parts, message.received = number, 1, 0, 0
    message.address, message.size, message.crc = address, size, a + b * 0x100 + c * 0x10000 + d * 0x1000000
    message.reserved = reserved ~= 0 and reserved or nil
    message.status, message.last, message.payload = false, false, ""
    self.frames[number] = message
  end
  if message and open then
    open:add(message)
  elseif message then
    self:enter(key, message)
  end
  return message or self:bad_start(number, reported)
end

-- The End of the only message under its key.
function Reassembler:complete(message, data, reported, number)
  local padding = self.can.padding(data, reported, message.size - message.received + reported)
  local payload = concat(message.chunks, "", 1, message.parts)
  if not padding then
    return self:finish(message, payload, number, self:misfit(message, message.received, number))
  end
  if padding > 0 then
    message.padding, payload = padding, payload:sub(1, message.size)
  end
  self:finish(message, payload, number)
end

-- A Middle or End.
function Reassembler:continue(key, address, data, reported, number, wide, doubtful)
  local is_end = address.ctrl == self.can.END
  local message = self.open[key]
  if not message then
    if not wide and not (address.ctl == 0 and self.size_of(address.id)) then return end
    return self:orphan(number, is_end)
  end
  if doubtful and not message.messages and not message.status and not message.truncated then
    message = self.interleave.new(self, message)
    self.open[key] = message
  end
  if message.messages then -- a pool
    local entry = message:frame(data, reported, number, is_end, doubtful)
    if #message.messages == 0 then self:close(key) end
    return entry
  end
  self.frames[number] = message
  local count = message.count + 1
  message.count, message[count] = count, number
  message.received = message.received + reported
  if message.status then -- it had too many bytes before
    self:misfit(message, message.received, number)
    if is_end then self:close(key) end
    return message
  end
  if not message.truncated then
    message.parts, message.chunks[message.parts + 1] = message.parts + 1, data
    if #data < reported then message.truncated = true end
  end
  if is_end then
    self:complete(message, data, reported, number)
    self:close(key)
  elseif message.received > message.size then
    message.status = self:misfit(message, message.received, number)
    message.chunks = nil
  end
  return message
end

--- Takes one CAN frame; frames come in order.
-- bus       number, or nil where the capture does not say
-- address   can.address of its 29-bit id
-- data      captured bytes; reported: its length on the bus
-- number    of the frame, or of this look at it: it grows, and every frame that is taken has its own
-- wide      true when the user says that every extended frame is YAPP; else only what is surely YAPP is claimed
-- doubtful  true for a frame of zeros that may be a remote frame: size and CRC say whether it belongs
-- returns   what the frame is (see entry), nil when it is not YAPP's.  A good message is valid until the next call.
function Reassembler:frame(bus, address, data, reported, number, wide, doubtful)
  if reported == 0 then return end
  if self.credit < MAX_CREDIT then self.credit = math.max(self.credit, 0) + CREDIT_PER_FRAME end
  local ctrl = address.ctrl
  local key = address.key
  if bus then key = key + (bus + 1) * 0x20000000 end
  if ctrl == 1 then return self:start(key, bus, address, data, reported, number, wide) end
  if ctrl == 2 or ctrl == 3 then return self:continue(key, address, data, reported, number, wide, doubtful) end
  if ctrl == 0 then
    local size = self.size_of(address.id)
    if not wide and not (size and address.ctl == 0 and self.can.padding(data, reported, size)) then return end
    self.frames[number] = M.LONE
    return M.LONE
  end
  if not wide then return end
  self.frames[number] = M.INVALID
  self:fault(number, "can.ctrl.invalid", ("CAN CTRL is %d; 0 to 3 are defined"):format(ctrl))
  return M.INVALID
end

return M
