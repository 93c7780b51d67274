-- SPDX-License-Identifier: GPL-2.0-or-later
-- What other layers say of a packet: its bus, interface or direction, its CAN id, whether it is a remote frame.
-- Wireshark's API.
--
-- A dissector is not told.  Fields say it, but only where a tree is built, and a Field extractor would build one for
-- every packet of every capture.  So a file is looked at when it is opened, its first bytes only, and only where these
-- say that it has several sources of ours a tap asks for the fields.  CAN's own fields are asked for where there is a
-- tree without them: Wireshark 4.4 and later leave out what nobody wants.

local M = {}

local BUS_FIELDS = "frame.interface_id || frame.interface_name || sll.ifindex || rtacser.eventtype"
local CAN_FIELDS = "can.id || can.flags.xtd || can.flags.rtr || canfd.flags.brs"
local NAMES, NOTHING = {}, {}
-- What tells the sources of a link type apart, besides the interface: Linux cooked v2, RTAC serial.
local TELLS = { [276] = "sll.ifindex", [250] = "rtacser.eventtype" }
local SOCKETCAN = wtap.SOCKETCAN -- an encapsulation, as frame.encap_type has it
for name in (BUS_FIELDS .. " || " .. CAN_FIELDS):gmatch("[%w_.]+") do NAMES[name] = true end

-- Remote frames come with as many zeros as their DLC says; SocketCAN does not tell a dissector.
local ZEROS = {}
for length = 0, 8 do ZEROS[("\0"):rep(length)] = true end

local IN_WIRESHARK = gui_enabled() -- tshark numbers frames anew (-R), and all of a pass has a tree or none

local length_of, raw_of, reported_of, offset_of = Tvb.len, Tvb.raw, Tvb.reported_len, Tvb.offset -- see show.items

local told -- the reader of candump text: { current_bus, current_bus_name, plain_bus }; set in M.watch

local DIRECTION = { 0, 1, 0, 1 } -- of RTAC events: data sent, data received, ...
local MASK = 0x20000000 -- of the 29 bits of an id

local REFUSED = "yapp.refused" -- in the private table of a packet

local Facts = {}
Facts.__index = Facts

--- Looks at files from now on.  Call it once.
-- head     the module host.file_head
-- candump  what `told` says
function M.watch(head, candump)
  told = candump
  local self = setmetatable({ seen = head.read(""), record = {} }, Facts)
  -- A reader that never reads: the only place where the API shows a file.  It names both arguments: what a reader does
  -- not hold may be collected while it reads, and Wireshark writes into both when it is back.
  local handler = FileHandler.new("YAPP's look at files (opens none)", "yapp_look", "Looks at the first bytes", "rms")
  function handler.read_open(file, _)
    self.seen, told.plain_bus = head.read(file:read(head.LENGTH) or ""), nil
    return false
  end
  function handler.read() return false end
  function handler.seek_read() return false end
  register_filehandler(handler)
  self:init()
  return self
end

local function remove(tap)
  if tap then tap:remove() end
end

-- The tap that asks for the fields which tell buses: there while they are needed, as it makes Wireshark build trees.
local function tap_buses(self)
  if self.found.sources or self.found.begins or self.is_wanted and self.later then
    self.bus_tap = self.bus_tap or Listener.new("frame", BUS_FIELDS)
  else
    remove(self.bus_tap)
    self.bus_tap = nil
  end
end

--- A new file is about to be dissected.  What was seen since the last one may be of others, which did not open or were
-- only looked at in a file dialog: nothing of it counts before.
function Facts:init()
  self.found = self.seen
  self.only_name = self.found.name or told.plain_bus
  self.own_name = self.found.own_name or self.only_name
  -- A log that Wireshark's own reader takes was looked at to its end: it has one bus.
  self.later = self.found.later and not told.plain_bus
  tap_buses(self)
  self.place = self.found.place
  self.asks_bus, self.is_apart = self.found.sources or self.later, self.found.sources
  remove(self.can_tap)
  self.can_tap, self.asked_at = nil, nil
  self.says_bus, self.numbers, self.names, self.count = {}, {}, {}, 0
  self.buses = {} -- [number of a frame] = its bus: in Wireshark a later look may have no tree, and so no fields
  self.is_swapped = get_preference("can.byte_swap") -- of records that a little endian machine wrote as they were
  self.header_number, self.header_id, self.refused, self.asked = 0, nil, {}, nil
end

--- Sees to it that the names of buses are known, whatever the file's first bytes say; or, no more.
function Facts:want_buses(is_wanted)
  self.is_wanted = is_wanted
  tap_buses(self)
end

--- Whether the file tells several sources apart, by its first bytes.
function Facts:are_several()
  return self.found.sources
end

--- Whether the file may have YAPP frames in TCP or UDP, by its first bytes.
function Facts:may_have_frames()
  return self.found.frames
end

-- Fields ------------------------------------------------------------------------------------------------------------

-- all_field_infos raises where there is no tree; and on 4.0 the value of an item without bytes, such as a packet
-- comment, throws past Lua: only what is wanted is asked for its value.
-- is_for_bus  whether only what tells the bus is asked for: on SocketCAN nothing behind the encapsulation does
local function by_name(is_for_bus, ok, ...)
  local found, infos = {}, ok and { ... } or NOTHING
  for i = 1, #infos do
    local info = infos[i]
    local name = info.name
    if NAMES[name] then
      found[name] = info.value
    elseif is_for_bus and name == "frame.encap_type" and info.value == SOCKETCAN then
      break
    end
  end
  return found, ok
end

-- The fields of a CAN frame that are in the tree so far.
-- returns  { [filter name] = value }, empty on a pass that builds no tree; and whether none of CAN's own is left out
local function can_fields(self, number)
  local fields, has_tree = by_name(false, pcall(all_field_infos))
  if not has_tree then return fields, false end
  local is_asked = self.can_tap and self.asked_at ~= number
  local is_whole = fields["can.id"] ~= nil and fields["can.flags.xtd"] ~= nil and
    (is_asked or fields["can.flags.rtr"] ~= nil or fields["canfd.flags.brs"] ~= nil)
  -- Not in Wireshark: a profile that switches by itself shows one packet with a tree while the file is loaded without,
  -- and the next packet would meet the new tap without one (4.4 and 4.6 end there).  Its columns say the same.
  if not is_whole and not self.can_tap and not gui_enabled() then
    self.can_tap, self.asked_at = Listener.new("frame", CAN_FIELDS), number
  end
  return fields, is_whole
end

local function is_true(value) return value == true or value == 1 end

-- "Ext. ID: 138428416 (0x8404000), Length: 8", as SocketCAN leaves it in the Info column.
-- returns  the text, nil where the columns are not there
local function column(pinfo)
  local text = tostring(pinfo.cols.info)
  return (text:find("ID: ", 1, true) or text:find("^ERR")) and text or nil
end

-- Buses -------------------------------------------------------------------------------------------------------------

-- The number of a source: 1, 2, 3, as they show.  (Exact for a million interfaces of 2^32 indexes each.)
local function number_of(self, interface, index, direction)
  local source = interface * 2 ^ 33 + index * 2 + direction
  local number = self.numbers[source]
  if not number then
    number = self.count + 1
    self.numbers[source], self.count = number, number
  end
  return number
end

-- Whether a pass knows all that tells where a packet was captured: with -2 the first one has only the fields that a
-- filter names.
local function says_all(found, fields)
  local interface, id = fields["frame.interface_id"], next(found.interfaces)
  if interface == nil and id and next(found.interfaces, id) then return false end
  local other = TELLS[found.interfaces[interface or id]]
  if other then return fields[other] ~= nil end
  return interface ~= nil or fields["sll.ifindex"] ~= nil or fields["rtacser.eventtype"] ~= nil
end

--- Where the current packet was captured.
-- returns  number, nil where nothing says; and whether this pass can know it
function Facts:bus(pinfo)
  local bus = told.current_bus
  if bus then
    self.names[bus] = self.names[bus] or told.current_bus_name
    return bus, true
  end
  if not self.asks_bus then return nil, true end
  local visited = pinfo.visited
  bus = visited and self.buses[pinfo.number]
  if bus then return bus, true end
  if self.says_bus[visited] == false then return nil, false end
  local fields = by_name(true, pcall(all_field_infos))
  local interface, index, event = fields["frame.interface_id"], fields["sll.ifindex"], fields["rtacser.eventtype"]
  local says_bus = says_all(self.found, fields)
  -- One or the other for all of a pass: a message does not begin on a bus and end on none.
  if self.says_bus[visited] == nil then self.says_bus[visited] = says_bus end
  if not says_bus then return nil, false end
  bus = number_of(self, interface or 0, index or 0, DIRECTION[event] or 0)
  -- A file's only interface may stand for several buses: Linux's "any" does, and two captures merged into one.
  self.is_apart = self.is_apart or self.count > 1 or index ~= nil or event ~= nil
  if IN_WIRESHARK then self.buses[pinfo.number] = bus end
  if self.names[bus] == nil then self.names[bus] = self:interface_name(interface, fields["frame.interface_name"]) end
  return bus, true
end

--- The name of an interface, where the capture has one: false if not.
function Facts:interface_name(interface, shown)
  local name = self.found.names and self.found.names[interface or 0]
  if not name and shown and shown ~= "unknown" then name = shown end
  return name or false
end

--- What a bus is called.
-- bus      its number; nil where the capture has one source or tells none apart
-- is_ip    whether it came in UDP or TCP, so by any interface
-- returns  text, or nil where the capture names none
function Facts:bus_name(bus, is_ip)
  if bus then return self.names[bus] or nil end
  return is_ip and self.only_name or not is_ip and self.own_name or nil
end

-- A CAN frame -------------------------------------------------------------------------------------------------------

--- What the wrapper around SocketCAN read in the header of the current frame (can.wrapper).
-- can_id  29 bits; nil for a frame that is not an extended data frame
function Facts:note_header(number, can_id)
  self.header_number, self.header_id = number, can_id
end

--- The table of ids had the current frame, whose facts are those of the last can_frame, and left it to Decode As.
function Facts:note_refused(pinfo, can_id)
  local refused = self.refused
  refused.number, refused.place, refused.can_id = self.record.number, self.record.place, can_id
  pinfo.private[REFUSED] = "" -- of this look at the packet only
end

local function is_refused(self, tvb, pinfo)
  local refused = self.refused
  return refused.number == pinfo.number and refused.place == tvb:offset() and pinfo.private[REFUSED] ~= nil
end

--- The id of the current frame, which came by Decode As.
-- returns  29-bit id; nil where it is not an extended frame; nil and true where nothing says
function Facts:find_id(tvb, pinfo)
  if self.header_number == pinfo.number then return self.header_id end
  if is_refused(self, tvb, pinfo) then return self.refused.can_id end
  local fields, is_whole = can_fields(self, pinfo.number)
  local id, extended = fields["can.id"], fields["can.flags.xtd"]
  if is_whole then return is_true(extended) and id and id % MASK or nil end
  local text = column(pinfo)
  if not text then return nil, true end
  return tonumber(text:match("Ext%. ID: (%d+)"))
end

--- Whether the current frame, which came with 0 for its id, did so by Decode As and not from the table of ids: it has
-- another id, or the table had it already.
function Facts:is_decode_as(tvb, pinfo)
  if is_refused(self, tvb, pinfo) then return true end
  local can_id, is_unknown = self:find_id(tvb, pinfo)
  return not is_unknown and can_id ~= 0
end

-- Whether the current frame is a remote frame: those have no data, but captures give them zeros.
-- returns  true or false; nil where nothing says
local function is_remote(self, pinfo)
  if self.header_number == pinfo.number then return not self.header_id end -- or not extended: then it is not ours
  local fields, is_whole = can_fields(self, pinfo.number)
  local rtr = fields["can.flags.rtr"]
  if rtr ~= nil then return is_true(rtr) end
  if is_whole then return false end -- CAN FD has no remote frames
  local text = column(pinfo)
  if not text then return nil end
  return text:find("Remote", 1, true) ~= nil and tostring(pinfo.cols.protocol) ~= "CANFD"
end

--- What there is to know of a frame that is new, whole, where frames usually are, and surely no remote frame: most are.
-- highest  as for can_frame; usual: where the first frame of the file was in its packet
-- returns  number, data, bus; nothing for a frame that can_frame has to look at
function Facts:plain_frame(tvb, pinfo, highest, usual)
  local number, bus = pinfo.number, told.current_bus
  if number <= highest or length_of(tvb) == 0 then return nil end
  local data = raw_of(tvb)
  if #data ~= reported_of(tvb) or ZEROS[data] or not self.place and offset_of(tvb) ~= usual then return nil end
  if bus then
    if not self.names[bus] then return nil end -- its first frame: the long way notes what it is called
  elseif self.asks_bus then
    bus = self:bus(pinfo)
  end
  return number, data, bus
end

--- What a look at a CAN frame needs to know, asked for once.
-- highest  the highest number so far: one above it is new, and Wireshark cannot have shown it before
-- returns  { number, place, is_again, data, reported, bus, is_apart = whether no other bus can have its number,
--            informed = whether this pass can tell the bus, remote = whether it is a remote frame, doubtful = whether
--            it may be one and nothing says, is_odd = whether it may be either }: the same table for every frame
function Facts:can_frame(tvb, pinfo, highest)
  local record, number = self.record, pinfo.number
  -- raw() of nothing would throw past Lua, to Wireshark: what no Lua can catch.
  local data = length_of(tvb) > 0 and raw_of(tvb) or ""
  record.number, record.place = number, self.place or offset_of(tvb)
  record.is_again = number <= highest and pinfo.visited
  record.reported, record.data = reported_of(tvb), data
  if self.asked ~= record.is_again then -- at a pass's first frame: a later one may need them
    self.asked = record.is_again
    can_fields(self, number)
  end
  if self.asks_bus or told.current_bus then
    record.bus, record.informed = self:bus(pinfo)
    record.is_apart = self.is_apart or told.current_bus ~= nil
  elseif record.bus or not record.informed then
    record.bus, record.is_apart, record.informed = nil, false, true
  end
  local is_odd = ZEROS[data] and record.reported > 0
  if is_odd or record.is_odd then
    local remote = false
    if is_odd then remote = is_remote(self, pinfo) end
    record.is_odd, record.remote, record.doubtful = is_odd, remote or false, remote == nil
  end
  return record
end

return M
