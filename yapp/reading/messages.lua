-- SPDX-License-Identifier: GPL-2.0-or-later
-- From a transfer to the message that it carries: its values, and the changes since the source's
-- previous message.  Pure Lua.

local compiler = require "yapp.message.catalogue"

local M = {}

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
    advised = {}, -- [id of an unknown message] = the frame key whose Info has the whole advice
  }, Messages)
end

-- Begin the record of a message: it may have served another one.
local function begin_message(message, frame, transfer)
  message.transfer = transfer
  message.source = frame.source
  message.seq = frame.seq
  message.key = frame.key
  message.number = frame.number
  message.time = frame.time
  message.visited = frame.visited
  message.status = transfer.status
  message.size = transfer.size
  message.payload = transfer.payload
  message.raws, message.remarks = false, false
  message.has_fault, message.undecoded = false, false
  message.like, message.is_advised = false, false
  message.copy_of = false
  message.change, message.delta, message.state = false, false, false
  message.is_unreliable = not (frame.visited or frame.is_bus_known)
end

-- Decode the values.  The payload has min_size bytes of its type at least.  Only a good message may
-- have more than the type's size.
local function decode_values(message, of_type)
  local size, is_good = message.size, message.status == "good"
  local is_longer = size > of_type.size
  if size < of_type.min_size or is_longer and not is_good then return end
  local raws, remarks = of_type.read(message.payload)
  message.raws, message.remarks = raws, remarks
  message.has_fault = remarks and remarks.has_fault or false
  if is_longer then message.undecoded = size - of_type.size end
end

-- Find the type that an unknown message could be of by its size.
local function find_like(self, message)
  local same = message.status == "good" and compiler.of_size(self.types.messages, message.size)[1]
  if not same then return end
  local advised, id = self.advised, message.source.id
  advised[id] = advised[id] or message.key
  message.like, message.is_advised = same, advised[id] == message.key
end

-- Set the history's values of a message.
local function add_history(self, message, frame)
  local change, delta
  if message.visited then
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
  return not (message.remarks or message.undecoded or message.copy_of or message.change)
end

--- Read the message of a transfer.
-- message   its record, see reading.records
-- frame     that ends it, see there
-- transfer  { status, size, payload }; status = "good" if it is proved complete; "bad" (CRC);
--           "truncated" by the capture; "incomplete"; "overrun"
-- returns   the message
function Messages:fill(message, frame, transfer)
  local of_type = frame.source.message
  begin_message(message, frame, transfer)
  if not of_type then
    find_like(self, message)
  elseif not IS_BROKEN[message.status] then
    decode_values(message, of_type)
  end
  if message.status == "good" or message.status == "bad" then
    message.copy_of = self.copies:find(message, frame.is_only_pass) or false
  end
  if not (message.is_unreliable or message.copy_of) then add_history(self, message, frame) end
  message.is_usual = is_usual(message)
  return message
end

return M
