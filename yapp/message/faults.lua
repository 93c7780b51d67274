-- SPDX-License-Identifier: GPL-2.0-or-later
-- The faults of a source: the one place that knows when each of them began and ended.  Pure Lua.

local band = require "yapp.base.bits".band
local last_until = require "yapp.base.frame_key".last_until
local memo = require "yapp.base.memo"

local Faults = {}
Faults.__index = Faults

--- Make the faults of a source: none is set.
function Faults.new()
  return setmetatable({
    set = {}, -- list of the faults that are set, as they rose; a new one for each change
    incident = nil, -- see Faults:update
    keys = {}, -- ascending: frame keys of the messages that change a fault
    since = {}, -- of each: when the oldest fault that was set behind it rose, or false
  }, Faults)
end

-- By field: the flags that are faults, with the bits that no table defines.
local fault_flags = memo(function(field)
  local list, undefined = {}, band(field.undefined, field.alarm_bits)
  for _, flag in ipairs(field.flags) do
    if band(flag.mask, field.alarm_bits) ~= 0 then list[#list + 1] = flag end
  end
  for bit = 0, 31 do
    local mask = 2 ^ bit
    if band(undefined, mask) ~= 0 then
      list[#list + 1] = { name = ("undefined_0x%x"):format(mask), mask = mask }
    end
  end
  return list
end)

-- Return the fault of a flag that is set, and the list without it; nil and a copy for none.
local function remove_fault(set, flag)
  local others, found = {}, nil
  for _, fault in ipairs(set) do
    if fault.flag == flag then found = fault else others[#others + 1] = fault end
  end
  return found, others
end

-- Add the steps of one field.
local function update_field(self, change, key, time, steps)
  local field, now = change.field, change.value
  local before = now - change.raised + change.cleared
  for _, flag in ipairs(fault_flags[field]) do
    local is_set = band(now, flag.mask) ~= 0
    if is_set ~= (band(before, flag.mask) ~= 0) then
      local fault, set = remove_fault(self.set, flag)
      fault = fault or {
        field = field.name,
        flag = flag,
        key = key,
        time = time,
        incident = self.incident,
      }
      if is_set then set[#set + 1] = fault end
      self.set = set
      steps[#steps + 1] = { fault = fault, is_raised = is_set }
    end
  end
end

--- Update the faults with a message.
-- changes  list of { field, value, raised = mask, cleared = mask }, see message.history
-- key      frame key of the message; time = seconds of the capture
-- returns  the steps, a list of { fault, is_raised = true if it rises or falls }, with set = list
--          of the faults that are set behind the message; nil if no bit of a fault changes.
--          A fault is one table from its rise to its fall: { field = name, flag,
--            key, time  of the message in which it rose
--            incident   a table for the time in which a fault is set without a break }
function Faults:update(changes, key, time)
  local steps, keys = {}, self.keys
  -- An incident goes on if one field falls and another rises in the same message.
  if not self.set[1] then self.incident = {} end
  for _, change in ipairs(changes) do update_field(self, change, key, time, steps) end
  if not steps[1] then return nil end
  local oldest = self.set[1]
  keys[#keys + 1], steps.set = key, self.set
  self.since[#keys] = oldest and oldest.time or false
  return steps
end

--- Return the state at a message, whether the message changes it or not, three values: seconds
-- since the oldest fault that is set rose, nil if the capture's clock went back behind that; the
-- frame keys of the messages before and behind it that changed a fault.  Nil while none is set.
function Faults:state(key, time)
  local keys = self.keys
  local last = last_until(keys, key)
  local since, is_change = self.since[last], keys[last] == key
  if not (since or is_change) then return nil end
  local active_time = since and time >= since and time - since or nil
  return active_time, keys[is_change and last - 1 or last], keys[last + 1]
end

return Faults
