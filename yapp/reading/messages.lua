-- SPDX-License-Identifier: GPL-2.0-or-later
-- From a transfer to the message that it carries: its values, and the changes since the source's
-- previous message.  Pure Lua.

local M = {}

local NONE = {} -- to be read only

-- A transfer that lacks bytes, or has too many, at an unknown offset.
local IS_BROKEN = { incomplete = true, overrun = true }

local Messages = {}
Messages.__index = Messages

--- Make the reader of the messages of one capture.
-- types    a message.types
-- history  a message.history
-- copies   a reading.copies
function M.new(types, history, copies)
  return setmetatable({
    types = types,
    history = history,
    copies = copies,
  }, Messages)
end

-- Make the record of the message of a transfer.
-- frame  that ends it
local function new_message(frame, transfer)
  return { -- Lua makes room for 16 fields or for 32: more than 16 cost 2 % of a packet list
    transfer = transfer,
    source = frame.source, -- see message.types
    seq = frame.seq,
    key = frame.key,
    time = frame.time, -- seconds since the first packet
    status = transfer.status,
    payload = transfer.payload, -- the bytes of it that came
    raws = false, -- the values by index of field (message.decode); false if the size does not fit
    remarks = NONE, -- the remarkable values (message.decode)
    undecoded = false, -- number of payload bytes behind the type's size, false for none
    has_fault = false, -- true if a fault flag is set; a damaged message has none
    copy_of = false, -- frame key of the message that it is a copy of, or false
    -- Of message.history:
    change = false, -- the change, or false
    delta = false, -- seconds since the source's previous good message, or false
    state = false, -- the state at the message, or false if it is not known or not wanted
    -- True if its past is not known: nothing tells its bus, or controllers share its source.
    is_unreliable = not (frame.visited or frame.is_bus_known),
  }
end

-- Decode the values.  The payload has min_size bytes of its type at least.  Only a good message may
-- have more than the type's size.
local function decode_values(message, of_type)
  local size, is_good = message.transfer.size, message.status == "good"
  local is_longer = size > of_type.size
  if size < of_type.min_size or is_longer and not is_good then return end
  local raws, remarks = of_type.read(message.payload)
  message.raws = raws
  if remarks then
    message.remarks = remarks
    message.has_fault = message.status ~= "bad" and remarks.has_fault or false
  end
  if is_longer then message.undecoded = size - of_type.size end
end

-- Set the history's values of a message.
local function add_history(self, message, frame)
  local change, delta
  if frame.visited then
    change, delta = self.history:change(message)
  else
    change, delta = self.history:add(message, frame.is_only_pass)
  end
  message.change, message.delta = change or false, delta or false
  if delta == nil or change and change.unreliable then message.is_unreliable = true end
  message.state = frame.wants_state and self.history:state(message) or false
  -- In a stream, the ID of a damaged frame may be damaged, too.
  if message.source.line and message.status ~= "good" then message.delta = false end
end

local function is_usual(message)
  if message.status ~= "good" or not message.raws then return false end
  return not (message.remarks[1] or message.undecoded or message.copy_of or message.change)
end

--- Read the message of a transfer.
-- frame     that ends it, see reading.records
-- transfer  { status, size, payload }; status = "good" if it is proved complete; "bad" (CRC);
--           "truncated" by the capture; "incomplete"; "overrun"
-- returns   the message, and whether it is good and decoded and has nothing else to show
function Messages:read(frame, transfer)
  local of_type, message = frame.source.type, new_message(frame, transfer)
  if of_type and not IS_BROKEN[message.status] then decode_values(message, of_type) end
  if message.status == "good" or message.status == "bad" then
    message.copy_of = self.copies:find(message, frame.visited, frame.is_only_pass) or false
  end
  if not (message.is_unreliable or message.copy_of) then add_history(self, message, frame) end
  return message, is_usual(message)
end

return M
